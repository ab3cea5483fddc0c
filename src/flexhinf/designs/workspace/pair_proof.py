"""Find a certificate of pairs: intervals in which the checker accepts the storage functions of the search."""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable
from itertools import pairwise, product
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
from flexhinf.copies import shared_out
from flexhinf.modal.motor_multipliers import motor_tolerance
from flexhinf.modal.multipliers import PopovTolerance, popov_tolerance
from flexhinf.modal.pair_errors import NONE, Errors, MotorWeights, Sector
from flexhinf.modal.popov import PairStorages, Storages
from flexhinf.modal.sampled_pairs import SampledPairs

#: Length in log λ of a part of the range that is proved by itself.
PART = 1.0

#: Lengths of an interval in log λ: the first, the largest, and the smallest of a room.
FIRST, LONGEST, SHORTEST = 0.1, 0.5, 1e-3

#: Rooms of P: the largest and the smallest; successes after which a larger one is tried again.
MOST_ROOM, SMALLEST_ROOM, SUCCESSES = 0.06, 2e-5, 12

#: λ and θ of an interval through which P is a polynomial of each.
OF_LINKS, OF_DELAY = 4, 3

#: Intervals of an unknown delay: how many at first, the shortest as a share of it, how often all are kept before fewer
#: are tried, and the length of an interval in log λ that is made shorter before they are divided.
HALVES, FINEST, UNDIVIDED, DIVIDED = 2, 1.0 / 64.0, 2, 0.07

#: Shares of a tolerance that are tried in turn, and with errors of springs; of the slowest decay, tried as a rate.
SHARES, SPRUNG, RATES = (0.97, 0.9, 0.7), (0.9, 0.7), (0.005, 0.0)

#: Errors of masses that stand beside those of springs alone with unlike motors, as a share of these.
FEW = 1e-3

#: Factors of a length after a success and after a failure.
LONGER, SHORTER = 1.2, 0.7

Numbers = dict[str, Any]


def pair_certificate(storages: PairStorages, progress: Callable[[float], None]) -> Numbers | None:
    """The numbers of a file that the checker accepts, over all λ of the gains; None where an interval gets too short.

    Parts of the range are shared out; they depend on the range alone. `progress` is called with the share of it that is
    proved.
    """
    low, high = map(float, storages.pairs.gains.ends)
    count, here = max(1, int(np.log(high / low) / PART)), os.getpid()
    ends = [low, *np.geomspace(low, high, count + 1)[1:-1].tolist(), high]
    done = np.frombuffer(mmap.mmap(-1, 8 * count))  # which copies write too

    def proved(k: int) -> list[Numbers] | None:
        def reached(share: float) -> None:
            done[k] = share / count
            if os.getpid() == here:
                progress(float(done.sum()))

        return _part(storages, (ends[k], ends[k + 1]), reached)

    parts = shared_out(proved, range(count), compiles=False)
    if any(part is None for part in parts):
        return None
    return claim_numbers(storages, [one for part in parts for one in part or []])


def _part(
    storages: PairStorages, ends: tuple[float, float], progress: Callable[[float], None]
) -> list[Numbers] | None:
    """The intervals between two λ; None where one gets too short."""
    (low, high), length, room, successes = ends, FIRST, MOST_ROOM, 0
    place, boxes, intervals, shortest = low, _Boxes(storages), list[Numbers](), SHORTEST
    while place < high:
        end = min(high, place * float(np.exp(length)))
        found = boxes.proved((place, end), room)
        if found is None:
            room *= 0.5
        elif found:
            intervals.append(found)
            place, length, successes = end, min(LONGEST, LONGER * length), successes + 1
            if successes % SUCCESSES == 0:
                room = min(MOST_ROOM, 2.0 * room)
            progress(float(np.log(place / low) / np.log(high / low)))
        elif boxes.irregular:
            return None
        elif (length := SHORTER * length) < shortest:
            length, room = 10.0 * shortest, 0.5 * room
        if room < SMALLEST_ROOM:
            return None
    return intervals


class _Boxes:
    """Intervals of λ, each divided into intervals of the unknown delay θ as the last one was, or finer."""

    def __init__(self, storages: PairStorages) -> None:
        self._storages = storages
        self._claim: PairClaim | None = None
        self._delays = np.linspace(0.0, storages.pairs.delay, HALVES + 1).tolist()
        self._whole = 0  # intervals one after another that were not divided further
        self._kept: dict[tuple[float, float, float], Storages | None] = {}
        self.irregular = False  # whether Φ₂₂ is singular within a period

    def proved(self, links: tuple[float, float], room: float) -> Numbers | None:
        """What a file says of an interval; nothing where the checker does not accept it, None where no P is found."""
        most = self._storages.pairs.delay
        if not most:
            return self._without_delay(links, room)
        waiting, done, kept = [*self._thinned()], [0.0], list[np.ndarray]()
        usual = [*pairwise(self._delays)] if np.log(links[1] / links[0]) > DIVIDED else []
        divided = False
        while waiting:
            first, last = done[-1], waiting[0]
            ends = self._at(links, np.linspace(first, last, OF_DELAY), room)
            if ends is None:
                return None
            if self._accepts(links, (first, last), ends):
                done.append(waiting.pop(0))
                kept.append(ends)
            elif (
                (first, last) in usual
                or last - first <= FINEST * most
                or not self._accepts(links, (first, first), ends[:1])
            ):
                return {}  # too long in λ
            else:
                waiting.insert(0, 0.5 * (first + last))
                divided = True
        self._delays, self._whole = done, 0 if divided else self._whole + 1
        self._kept = {key: p for key, p in self._kept.items() if key[0] == links[1]}
        return {**_interval(*links, np.vstack(kept)), "delays": done}

    def _without_delay(self, links: tuple[float, float], room: float) -> Numbers | None:
        found = self._at(links, np.zeros(1), room)
        if found is None:
            return None
        whole = _interval(*links, found)
        return {**whole, "storages": whole["storages"][0]} if self._accepts(links, (0.0, 0.0), found) else {}

    def _thinned(self) -> list[float]:
        """The ends of the last intervals of θ but 0; now and then every second one."""
        ends = self._delays[1:]
        if self._whole < UNDIVIDED or len(ends) < 3:
            return ends
        self._whole = 0
        return [*ends[1:-1:2], ends[-1]]

    def _at(self, links: tuple[float, float], delays: np.ndarray, room: float) -> np.ndarray | None:
        """P (k, m, n, n) at some θ and at equidistant λ, all of the kind with the most room; None where one has
        none."""
        nodes = [*np.linspace(*links, OF_LINKS)[:-1].tolist(), links[1]]
        found = list[Storages]()
        for late, link in product(delays.tolist(), nodes):
            if (one := self._solved(link, late, room)) is None:
                return None
            found.append(one)
        kind = np.argmax(np.min([one.rooms for one in found], axis=0))
        matrices = np.array([one.matrices[kind] for one in found])
        return matrices.reshape(len(delays), len(nodes), *matrices.shape[1:])

    def _solved(self, link: float, late: float, room: float) -> Storages | None:
        if (link, late, room) not in self._kept:
            self._kept[link, late, room] = self._storages.at(link, room, late)
        return self._kept[link, late, room]

    def _accepts(self, links: tuple[float, float], delays: tuple[float, float], found: np.ndarray) -> bool:
        if self._claim is None:
            one = _interval(*links, found[:1])
            if most := self._storages.pairs.delay:
                one |= {"delays": [0.0, most]}
            else:
                one |= {"storages": one["storages"][0]}
            self._claim = pair_claim(claim_numbers(self._storages, [one]))
            self.irregular = not regular_at_first(self._claim)
        return not self.irregular and box_proved(self._claim, Box(links, delays, found))


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
    if pairs.motors is not None and fixed.and_share(1.0, shape).of_springs_alone:
        # with unlike motors errors of springs are a state, as beside others
        shape = shape._replace(masses=Sector(*(FEW * one for one in shape.springs)))
    names = fixed.and_share(1.0, shape).names
    progress(f"errors of {names} that are tolerated, computed")
    tolerance = popov_tolerance(pairs, shape, fixed=fixed)
    if pairs.motors is not None and tolerance.share > 0.0:
        progress(f"errors of {names} that are tolerated with unlike motors, computed")
        tolerance = motor_tolerance(pairs, tolerance, shape, fixed)
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
        "coefficients": gains.coefficients[: 5 if pairs.motors is None else 6].tolist(),
        "observer": observer,
        **dict(zip(ERRORS, map(float, storages.errors.numbers))),
        "multiplier": multipliers.masses,
        **dict(zip(SPRING_WEIGHTS, multipliers.springs)),
        **dict(zip(SLOPE_WEIGHTS, multipliers.slope)),
        "spring_damping": float(storages.errors.damping),
        **dict(zip(DAMPING_WEIGHTS, multipliers.damping[1:])),
        "any_motion": storages.errors.any_motion,
        "filters": [list(one) for one in multipliers.filters],
        "prediction_filters": [list(one) for one in multipliers.prediction_filters],
        "motors": _motor_numbers(storages),
        "rate": float(storages.rate),
        "intervals": intervals,
    }


def _motor_numbers(storages: PairStorages) -> Numbers | None:
    """What a file says of unlike motors."""
    motors, weights = storages.pairs.motors, storages.multipliers.motors or MotorWeights()
    if motors is None:
        return None
    return {
        **motors._asdict(),
        "weights": list(weights.weights),
        "skew": list(weights.skew),
        "friction_weights": list(weights.friction),
        "multiplier": weights.multiplier,
        "filters": [list(one) for one in weights.filters],
        "error_filters": [list(one) for one in weights.error_filters],
    }


def _interval(low: float, high: float, found: np.ndarray) -> Numbers:
    """Of P (k, m, n, n): lower triangles."""
    rows, columns = np.tril_indices(found.shape[-1])
    return {"low": low, "high": high, "storages": found[..., rows, columns].tolist()}
