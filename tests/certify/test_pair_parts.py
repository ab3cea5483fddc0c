"""Parts of the range of pairs that are proved at once."""

from functools import partial
from itertools import pairwise

import pytest

from flexhinf.certify.checker.pair_claim import pair_claim
from flexhinf.certify.checker.pairs import CheckedPairs, check_pairs
from flexhinf.copies import shared_out
from flexhinf.designs.workspace.pair_proof import pair_certificate
from flexhinf.modal import pair_gains
from flexhinf.modal.pair_errors import Errors, Multipliers, Sector
from flexhinf.modal.popov import PairStorages
from flexhinf.modal.sampled_pairs import SampledPairs
from flexhinf.processors import limited_threads


@pytest.mark.ci("proves the same range twice")
def test_any_number_of_threads_proves_the_same_whole_range() -> None:
    """And the progress moves with the work of all of them, to its end; an interval that fails is named."""
    ends = 150.0**2, 450.0**2
    loop = SampledPairs(pair_gains(ends, 110.0**2, 12.0, 1e-3), latency=1)
    storages = PairStorages(loop, Errors(Sector(0.3, 0.3)), Multipliers(20.0), 0.0)
    found, every = [], partial(shared_out, compiles=False)
    for threads in (1, 2):
        told: list[float] = []
        with limited_threads(threads):
            found.append(pair_certificate(storages, told.append))
            assert found[0] is not None
            checked = check_pairs(pair_claim(found[0]), every)
            assert isinstance(checked, CheckedPairs)
            assert (checked.low, checked.high) == ends
            places = 1, len(found[0]["intervals"]) - 1
            worse = [dict(one) for one in found[0]["intervals"]]
            for k in places:
                worse[k]["storages"] = [[-x for x in one] for one in worse[k]["storages"]]
            assert check_pairs(pair_claim({**found[0], "intervals": worse}), every) == places[0]
        assert len(told) > 3
        assert all(first <= second for first, second in pairwise(told))
        assert told[-1] <= 1.0 + 1e-12
    assert found[0] == found[1]
