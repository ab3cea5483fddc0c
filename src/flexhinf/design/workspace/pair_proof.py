"""Find a certificate of pairs: intervals in which the checker accepts the storage functions of the search."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from flexhinf.certify.checker.pair_claim import (
    DAMPING_WEIGHTS,
    ERRORS,
    SLOPE_WEIGHTS,
    SPRING_WEIGHTS,
    PairClaim,
    pair_claim,
)
from flexhinf.certify.checker.pairs import Box, box_proved, regular_at_first
from flexhinf.modal.multipliers import PopovTolerance, popov_tolerance
from flexhinf.modal.popov import NONE, Errors, PairStorages
from flexhinf.modal.sampled_pairs import SampledPairs

#: Lengths of an interval in log λ: the first, the largest, and the smallest of a room, without and with unknown delay.
FIRST, LONGEST, SHORTEST = 0.1, 0.3, (3e-5, 1e-3)

#: Rooms of P: the largest and the smallest; successes after which a larger one is tried again.
MOST_ROOM, SMALLEST_ROOM, SUCCESSES = 0.06, 2e-5, 12

#: First intervals of an unknown delay, the shortest as a share of it; how often all are kept before fewer are tried.
HALVES, FINEST, UNDIVIDED = 2, 1.0 / 64.0, 4

#: Shares of a tolerance that are tried in turn, and with errors of springs; of the slowest decay, tried as a rate.
SHARES, SPRUNG, RATES = (0.97, 0.9, 0.7), (0.9, 0.7), (0.005, 0.0)

Numbers = dict[str, Any]


def pair_certificate(storages: PairStorages, progress: Callable[[float], None]) -> Numbers | None:
    """The numbers of a file that the checker accepts, over all λ of the gains; None where an interval gets too short.

    `progress` is called with the share of the range that is proved.
    """
    low, high = map(float, storages.pairs.gains.ends)
    place, length, room, successes = low, FIRST, MOST_ROOM, 0
    boxes, intervals, shortest = _Boxes(storages), list[Numbers](), SHORTEST[storages.pairs.delay > 0.0]
    while place < high:
        end = min(high, place * float(np.exp(length)))
        found = boxes.proved((place, end), room)
        if found is None:
            room *= 0.5
        elif found:
            intervals.append(found)
            place, length, successes = end, min(LONGEST, 1.4 * length), successes + 1
            if successes % SUCCESSES == 0:
                room = min(MOST_ROOM, 2.0 * room)
            progress(float(np.log(place / low) / np.log(high / low)))
        elif boxes.irregular:
            return None
        elif (length := 0.6 * length) < shortest:
            length, room = 10.0 * shortest, 0.5 * room
        if room < SMALLEST_ROOM:
            return None
    return claim_numbers(storages, intervals)


class _Boxes:
    """Intervals of λ, each divided into intervals of the unknown delay θ as the last one was, or finer."""

    def __init__(self, storages: PairStorages) -> None:
        self._storages = storages
        self._claim: PairClaim | None = None
        self._delays = np.linspace(0.0, storages.pairs.delay, HALVES + 1).tolist()
        self._whole = 0  # intervals one after another that were not divided further
        self._kept: dict[tuple[float, float, float], np.ndarray | None] = {}
        self.irregular = False  # whether Φ₂₂ is singular within a period

    def proved(self, links: tuple[float, float], room: float) -> Numbers | None:
        """What a file says of an interval; nothing where the checker does not accept it, None where no P is found."""
        most = self._storages.pairs.delay
        if not most:
            return self._without_delay(links, room)
        waiting, done = [*self._thinned()], [0.0]
        divided = False
        while waiting:
            first, last = done[-1], waiting[0]
            ends = [self._at(links, late, room) for late in (first, last)]
            if any(p is None for row in ends for p in row):
                return None
            if self._accepts(links, (first, last), np.array(ends)):
                done.append(waiting.pop(0))
            elif last - first <= FINEST * most or not self._accepts(
                links, (first, first), np.array(ends[:1])
            ):
                return {}  # too long in λ
            else:
                waiting.insert(0, 0.5 * (first + last))
                divided = True
        self._delays, self._whole = done, 0 if divided else self._whole + 1
        self._kept = {key: p for key, p in self._kept.items() if key[0] == links[1]}
        rows = [self._at(links, late, room) for late in done]
        one = _interval(*links, *(p for row in rows for p in row if p is not None))
        parts = one["storages"]
        return {**one, "delays": done, "storages": [parts[k : k + 2] for k in range(0, len(parts), 2)]}

    def _without_delay(self, links: tuple[float, float], room: float) -> Numbers | None:
        first, last = self._at(links, 0.0, room)
        if first is None or last is None:
            return None
        return (
            _interval(*links, first, last)
            if self._accepts(links, (0.0, 0.0), np.array([[first, last]]))
            else {}
        )

    def _thinned(self) -> list[float]:
        """The ends of the last intervals of θ but 0; now and then every second one."""
        ends = self._delays[1:]
        if self._whole < UNDIVIDED or len(ends) < 3:
            return ends
        self._whole = 0
        return [*ends[1:-1:2], ends[-1]]

    def _at(self, links: tuple[float, float], late: float, room: float) -> list[np.ndarray | None]:
        for link in links:
            if (link, late, room) not in self._kept:
                self._kept[link, late, room] = self._storages.at(link, room, late)
        return [self._kept[link, late, room] for link in links]

    def _accepts(self, links: tuple[float, float], delays: tuple[float, float], ends: np.ndarray) -> bool:
        if self._claim is None:
            one = _interval(*links, *ends[0])
            if most := self._storages.pairs.delay:
                one |= {"delays": [0.0, most], "storages": [one["storages"]] * 2}
            self._claim = pair_claim(claim_numbers(self._storages, [one]))
            self.irregular = not regular_at_first(self._claim)
        return not self.irregular and box_proved(self._claim, Box(links, delays, ends))


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
    shares = SPRUNG if tolerance.errors.states(tolerance.multipliers)[0] else SHARES
    parts = [share * tolerance.share for share in shares if tolerance.share > 0.0]
    if whole and tolerance.share > 1.0:
        parts = [max(1.0, parts[-1])]
    for size in parts:
        errors = fixed.and_share(size, shape)
        for part in RATES[errors.any_motion :]:  # a rate is of linear loops
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
        "delay": float(pairs.delay),
        "poles": gains.poles.tolist(),
        "coefficients": gains.coefficients[:5].tolist(),
        "observer": observer,
        **dict(zip(ERRORS, map(float, storages.errors.numbers))),
        "multiplier": multipliers.masses,
        **dict(zip(SPRING_WEIGHTS, multipliers.springs)),
        **dict(zip(SLOPE_WEIGHTS, multipliers.slope)),
        "spring_damping": float(storages.errors.damping),
        **dict(zip(DAMPING_WEIGHTS, multipliers.damping[1:])),
        "any_motion": storages.errors.any_motion,
        "filters": [list(one) for one in multipliers.filters],
        "rate": float(storages.rate),
        "intervals": intervals,
    }


def _interval(low: float, high: float, *ends: np.ndarray) -> Numbers:
    return {"low": low, "high": high, "storages": [p[np.tril_indices(len(p))].tolist() for p in ends]}
