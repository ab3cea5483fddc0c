import numpy as np
import pytest
from scipy import stats

from flexhinf.loop.signals.sampling import philox, standard_normal

#: Random123's kat_vectors, philox4x32-10: counter, key, result.
KNOWN = [
    ((0, 0, 0, 0), (0, 0), "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        "d16cfe09 94fdcceb 5001e420 24126ea1",
    ),
]


@pytest.mark.oracle
@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN)
def test_known_answers(counter, key, expected):
    assert " ".join(f"{int(word):08x}" for word in philox(counter, key)) == expected


@pytest.mark.oracle
def test_arrays_of_counters_are_the_counters_one_by_one():
    a = np.array([0, 0xFFFFFFFF, 0x243F6A88])
    words = philox((a, 5, 7, 0), (1, 2))
    for k, first in enumerate(a):
        assert [int(w[k]) for w in words] == [int(w) for w in philox((int(first), 5, 7, 0), (1, 2))]


def test_normal_independent_and_reproducible():
    z = standard_normal(0, 40_000, 3)
    assert stats.kstest(z.ravel(), "norm").pvalue > 0.01
    assert np.abs(np.corrcoef(z.T) - np.eye(3)).max() < 0.02
    assert np.abs([np.corrcoef(c[:-1], c[1:])[0, 1] for c in z.T]).max() < 0.02
    assert np.all(np.isfinite(z))
    np.testing.assert_array_equal(z, standard_normal(0, 40_000, 3))


def test_any_number_can_be_asked_for_alone():
    z = standard_normal(9, 100, 4, sample=3)
    np.testing.assert_array_equal(z[:40, :2], standard_normal(9, 40, 2, sample=3))
    assert abs(np.corrcoef(z.ravel(), standard_normal(9, 100, 4, sample=4).ravel())[0, 1]) < 0.2


def test_all_64_bits_of_the_seed_count():
    seeds = (0, 1, 2**32, 2**63)
    assert len({standard_normal(seed, 1, 1)[0, 0] for seed in seeds}) == len(seeds)
