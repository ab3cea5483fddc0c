"""Find a certificate of pairs: intervals in which the checker accepts the storage functions of the search."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from flexhinf.certify.checker.pairs import (
    ERRORS,
    SLOPE_WEIGHTS,
    SPRING_WEIGHTS,
    interval_proved,
    pair_claim,
    regular_at_first,
)
from flexhinf.modal.multipliers import PopovTolerance, popov_tolerance
from flexhinf.modal.popov import NONE, Errors, PairStorages
from flexhinf.modal.sampled_pairs import SampledPairs

#: Lengths of an interval in log λ: the first, the largest, and the smallest of a room.
FIRST, LONGEST, SHORTEST = 0.1, 0.3, 3e-5

#: Rooms of P: the largest and the smallest; successes after which a larger one is tried again.
MOST_ROOM, SMALLEST_ROOM, SUCCESSES = 0.06, 2e-5, 12

#: Shares of a tolerance that are tried in turn, and with errors of springs; of the slowest decay, tried as a rate.
SHARES, SPRUNG, RATES = (0.97, 0.9, 0.7), (0.9, 0.7), (0.005, 0.0)

Numbers = dict[str, Any]


def pair_certificate(storages: PairStorages, progress: Callable[[float], None]) -> Numbers | None:
    """The numbers of a file that the checker accepts, over all λ of the gains; None where an interval gets too short.

    `progress` is called with the share of the range that is proved.
    """
    low, high = map(float, storages.pairs.gains.ends)
    place, length, room, successes = low, FIRST, MOST_ROOM, 0
    intervals: list[Numbers] = []
    while place < high:
        end = min(high, place * float(np.exp(length)))
        first, last = storages.at(place, room), storages.at(end, room)
        if first is None or last is None:
            room *= 0.5
        else:
            one = _interval(place, end, first, last)
            claim = pair_claim(claim_numbers(storages, [one]))
            if not intervals and not regular_at_first(claim):
                return None
            if interval_proved(claim, 0):
                intervals.append(one)
                place, length, successes = end, min(LONGEST, 1.4 * length), successes + 1
                if successes % SUCCESSES == 0:
                    room = min(MOST_ROOM, 2.0 * room)
                progress(float(np.log(place / low) / np.log(high / low)))
            elif (length := 0.6 * length) < SHORTEST:
                length, room = 10.0 * SHORTEST, 0.5 * room
        if room < SMALLEST_ROOM:
            return None
    return claim_numbers(storages, intervals)


def largest_certificate(
    pairs: SampledPairs,
    shape: Errors,
    progress: Callable[[str], None],
    fixed: Errors = NONE,
    whole: bool = False,
) -> tuple[PopovTolerance, Numbers | None]:
    """The computed tolerance of a shape of errors beside fixed ones, and the certificate of what is proved.

    `whole`: where the computed tolerance holds all of the shape, one proof is tried, of all of it or more.
    """
    progress(f"errors of {fixed.and_share(1.0, shape).names} that are tolerated, computed")
    tolerance = popov_tolerance(pairs, shape, fixed=fixed)
    slowest = min(map(pairs.decay, pairs.gains.links(40, np.inf)))
    shares = SPRUNG if max(tolerance.errors.springs) > 0.0 else SHARES
    parts = [share * tolerance.share for share in shares if tolerance.share > 0.0]
    if whole and tolerance.share > 1.0:
        parts = [max(1.0, parts[-1])]
    for size in parts:
        for part in RATES:
            errors = fixed.and_share(size, shape)
            found = pair_certificate(
                PairStorages(pairs, errors, tolerance.multipliers, part * slowest).lifted(),
                lambda done, errors=errors: progress(
                    f"proof of {100 * errors.largest:.3g} %, {100 * done:.0f} % of it"
                ),
            )
            if found is not None:
                return tolerance, found
    return tolerance, None


def claim_numbers(storages: PairStorages, intervals: list[Numbers]) -> Numbers:
    """What a file says of pairs, see `flexhinf.certify.checker.pairs.PairClaim`."""
    pairs, gains = storages.pairs, storages.pairs.gains
    pair, observer, multipliers = gains.pair(1.0), None, storages.multipliers
    if pairs.filter is not None:
        seen, table, ends = pairs.filter.pair
        observer = {
            "seen": np.asarray(seen, dtype=float).tolist(),
            "table": table.tolist(),
            "range": [float(end) for end in ends],
        }
    return {
        "period": float(gains.period),
        "motor": float(pair.motor),
        "damping": float(pair.damping),
        "holding": float(pair.holding),
        "input": float(pair.input),
        "latency": pairs.latency,
        "poles": gains.poles.tolist(),
        "coefficients": gains.coefficients[:5].tolist(),
        "observer": observer,
        **dict(zip(ERRORS, map(float, storages.errors.numbers))),
        "multiplier": multipliers.masses,
        **dict(zip(SPRING_WEIGHTS, multipliers.springs)),
        **dict(zip(SLOPE_WEIGHTS, multipliers.slope)),
        "filters": [list(one) for one in multipliers.filters],
        "rate": float(storages.rate),
        "intervals": intervals,
    }


def _interval(low: float, high: float, *ends: np.ndarray) -> Numbers:
    return {"low": low, "high": high, "storages": [p[np.tril_indices(len(p))].tolist() for p in ends]}
