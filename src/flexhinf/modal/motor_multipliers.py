"""Search for the multipliers that let a loop of pairs with unlike motors tolerate the largest errors.

The share of the errors, and how unlike motors are, grow together from nearly nothing, where what alike motors need and
heavy sectors of N and Φ suffice. What the slowest and the fastest pairs gain pulls the same numbers to opposite sides,
so that steps along axes stall. All numbers move at once instead, by quadratic programs: the share is to
grow most while no pair gains more than one, to first order, at the frequencies where it gains most; the curvature is
learnt from how slopes change.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from flexhinf.modal.multipliers import PopovTolerance
from flexhinf.modal.pair_errors import (
    NONE,
    ChannelWeights,
    Errors,
    FilterWeights,
    MotorWeights,
    Multipliers,
)
from flexhinf.modal.pair_period import WorstPeriod, worst_period
from flexhinf.modal.popov import gains_at, seen_frequencies
from flexhinf.modal.sampled_pairs import Motors, SampledPairs

#: λ of the programs, and of the last look; the part of the share of alike motors at which motors are as unlike as they
#: are; a share that is enough.
LINKS, LOOKED, WHOLE, ENOUGH = 9, 25, 0.3, 1.5

#: Logarithms of gains: what is left to one, how far below the largest others are looked at, their ends; and the step of
#: a slope.
LEFT, NEAR, ENDS, STEP = -0.01, 1.2, (1e-3, 1e3), 0.01

#: Curvature of the numbers and of the share at first; which part of these is added where a step fails: at
#: first, by which factor more each time and less where a whole step holds, and at most; parts of a step that are tried;
#: the largest step of a number.
FLAT, ADDED, PARTS, FARTHEST = (1.0, 0.1), (0.3, 4.0, 5.0, 1e4), (1.0, 0.5, 0.2), 2.0

#: Programs at most, by how much one has to raise the logarithm of the share, and a round of them the share; parts of a
#: share at which rounds begin in turn; and at the last look by how much it falls at once.
PROGRAMS, RAISED, WORTH, ROOMS, LESS = 300, 0.002, 1.01, (0.9, 0.7, 0.5), 0.99

#: Part of the share of alike motors below which another place is tried: from one, rounding decides where it ends.
FEW = 0.5

#: The smallest part of a share, and bisections of its logarithm.
SMALLEST, BISECTIONS = 1e-3, 8


def motor_tolerance(
    pairs: SampledPairs, alike: PopovTolerance, shape: Errors, fixed: Errors = NONE
) -> PopovTolerance:
    """The largest multiple of some errors, up to `ENOUGH`, that multipliers cover with unlike motors beside errors of a
    fixed size; from what alike motors tolerate of the same. Computed; its share is 0 where none is found."""
    if not alike.share:
        return alike._replace(errors=fixed)
    path = _Path(pairs, shape, fixed, alike)
    share, place, left = 0.0, np.zeros(0), PROGRAMS
    for first, start in _begun(path, alike.share):
        found = _raised(path, first, start, left)
        left -= found.programs
        if found.share > share or not len(place):
            share, place = found.share, found.place
        if share >= FEW * alike.share or left <= 0:
            break
    multipliers = path.multipliers(place)
    every = _Path(pairs, shape, fixed, alike, LOOKED)
    while share >= path.whole and not every.covers(share, multipliers):
        share *= LESS
    share = share if share >= path.whole else 0.0
    return PopovTolerance(path.errors(share), multipliers, share)


def _begun(path: _Path, most: float) -> list[tuple[float, np.ndarray]]:
    """Places from which a search begins, each with its share; the best first."""
    tried = [
        (path.largest(path.multipliers(one), SMALLEST * most, most), one) for one in path.numbers.starts()
    ]
    order = sorted(range(len(tried)), key=lambda k: -tried[k][0])
    return [tried[k] for k in order if k == order[0] or tried[k][0]]


def _raised(path: _Path, share: float, place: np.ndarray, most: int) -> _Grown:
    """The largest share of rounds of programs that begin at a place, of which there are at most some."""
    left, rooms = most, list(ROOMS)
    while rooms and 0.0 < share < ENOUGH and left > 0:
        found = _grown(path, rooms.pop(0) * share, place, left)
        left -= found.programs
        if found.share > WORTH * share:
            rooms = list(ROOMS)
        if found.share > share:
            share, place = found.share, found.place
        if share >= path.whole:  # smaller shares are for what would else be no proof
            rooms = [room for room in rooms if room == ROOMS[0]]
    return _Grown(share, place, most - left)


class _Numbers:
    """What multipliers follow from beside those of alike motors: logarithms, base ten, and parts of others."""

    def __init__(self, pairs: SampledPairs, alike: Multipliers, damping: float) -> None:
        motors = pairs.motors or Motors()
        self._rubs = max(motors.less_friction, motors.more_friction) > 0.0
        self._alike, self._kappa = alike, pairs.gains.pair(1.0).motor * pairs.gains.period**2
        self._damping = damping / pairs.gains.period
        # ρ, μ₁ and μ₂ of springs, of a slope and of damping; the weight of a slope in the model
        channels = (*alike.springs[:3], *alike.slope[:3], *alike.damping[:3])
        self._channels = (*channels, alike.slope.prediction)
        self._weights = [k for k, one in enumerate(self._channels) if one > 0.0]

    def starts(self) -> Iterator[np.ndarray]:
        """From where a search begins: without filters and products of different signals."""
        filters = len(self._alike.filters) + len(self._alike.prediction_filters)
        others = np.zeros(len(self._weights) + 2 * filters)
        for scale, weight, part in product((-2.0, -1.0, 0.0), (-3.0, -2.0, -1.0, 0.0), (0.7, 0.0)):
            own = [scale, *[weight] * 3, *[0.0] * 6, part, -0.5, 0.0, 0.0, 0.0]
            yield np.concatenate([own, np.full(3 if self._rubs else 0, 2.0), others])

    def multipliers(self, numbers: np.ndarray) -> Multipliers:
        """Multipliers of an integral inequality, whatever the numbers are."""
        left = iter(numbers.tolist())
        factor = 10.0 ** next(left)
        tau = self._alike.masses * factor
        motors = self._of_motors(left, tau * self._kappa)
        channels = list(self._channels)
        for k in self._weights:
            channels[k] *= factor * 10.0 ** next(left)
        if self._damping:  # within what stands with τ
            channels[8] = min(channels[8], 1.999 * tau / self._damping)
        filters, predicted = (
            tuple(
                FilterWeights(one.pole * 10.0 ** next(left), one.multiplier * factor * 10.0 ** next(left))
                for one in own
            )
            for own in (self._alike.filters, self._alike.prediction_filters)
        )
        springs, slope, damping = (ChannelWeights(*channels[k : k + 3]) for k in (0, 3, 6))
        slope = slope._replace(prediction=channels[9])
        return Multipliers(tau, springs, slope, damping, filters, motors, predicted)

    def _of_motors(self, left: Iterator[float], popov: float) -> MotorWeights:
        """Those of N and Φ; τκ is a unit of them."""
        sizes = np.array([10.0 ** (0.5 * next(left)) for _ in range(3)])
        root = np.eye(3)
        root[np.tril_indices(3, -1)] = [next(left) for _ in range(3)]
        root *= (sizes / np.linalg.norm(root, axis=1))[:, None]
        one, two, three = sizes.tolist()
        skew = next(left) * one * two, next(left) * one * three, next(left) * two * three
        multiplier = popov * next(left)
        pole, part = 10.0 ** next(left), next(left)
        of_twist = FilterWeights(pole, 0.5 * popov * part * pole**2)
        pole, part = 10.0 ** next(left), next(left)
        of_error = FilterWeights(pole, two**2 * part * pole**2)
        friction = (1.0, 1.0, 1.0)
        if self._rubs:
            friction = 10.0 ** next(left), 10.0 ** next(left), 10.0 ** next(left)
        weights = (root @ root.T)[np.tril_indices(3)].tolist()
        return MotorWeights(tuple(weights), skew, friction, multiplier, (of_twist,), (of_error,))


class _Path:
    """Worst periods of a share of errors, with motors that are the more unlike the larger it is."""

    def __init__(
        self, pairs: SampledPairs, shape: Errors, fixed: Errors, alike: PopovTolerance, count: int = LINKS
    ) -> None:
        self._pairs, self._shape, self._fixed = pairs, shape, fixed
        #: The share from which on motors are as unlike as they are.
        self.whole = WHOLE * alike.share
        self.numbers = _Numbers(pairs, alike.multipliers, self.errors(1.0).damping)
        self.links = list(map(float, pairs.gains.links(count, np.inf)))
        self._order, self._last = self.links[::-1], (0.0, pairs)

    def errors(self, share: float) -> Errors:
        """The errors of a share."""
        return self._fixed.and_share(share, self._shape)

    def multipliers(self, place: np.ndarray) -> Multipliers:
        """The multipliers of a place."""
        return self.numbers.multipliers(place)

    def worst(self, link: float, share: float, multipliers: Multipliers) -> WorstPeriod:
        """What the worst errors of a share do."""
        part = min(1.0, share / self.whole)
        if self._last[0] != part:  # loops keep what they know of each λ
            motors = self._pairs.motors or Motors()
            self._last = part, replace(self._pairs, motors=motors.share(part))
        try:
            return worst_period(self._last[1], link, self.errors(share), multipliers)
        except np.linalg.LinAlgError:  # an end at which errors gain without bound
            return WorstPeriod.unbounded(1)

    def gains(self, link: float, share: float, multipliers: Multipliers, at: np.ndarray) -> np.ndarray:
        """Logarithms of gains at frequencies, of a pair."""
        return np.log(np.clip(gains_at(self.worst(link, share, multipliers), at), *ENDS))

    def peaks(self, link: float, share: float, multipliers: Multipliers) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies at which a pair gains more than beside them, and logarithms of what it gains there."""
        worst = self.worst(link, share, multipliers)
        at = seen_frequencies(worst)
        values = np.log(np.clip(gains_at(worst, at), *ENDS))
        beside = np.r_[-np.inf, values, -np.inf]
        kept = (values >= beside[:-2]) & (values > beside[2:])
        kept[np.argmax(values)] = True
        return at[kept], values[kept]

    def covers(self, share: float, multipliers: Multipliers) -> bool:
        """Whether all pairs gain less than one."""
        for k, link in enumerate(self._order):
            if self.peaks(link, share, multipliers)[1].max() >= 0.0:
                self._order.insert(0, self._order.pop(k))  # the next question is likely to fail here too
                return False
        return True

    def largest(self, multipliers: Multipliers, low: float, high: float) -> float:
        """The largest share of multipliers between two; 0 where it is smaller."""
        if not 0.0 < low < high or not self.covers(low, multipliers):
            return 0.0
        for _ in range(BISECTIONS):
            middle = float(np.sqrt(low * high))
            low, high = (middle, high) if self.covers(middle, multipliers) else (low, middle)
        return low


class _Slopes(NamedTuple):
    """Logarithms of what pairs gain where they gain most, and slopes by the numbers and the logarithm of the share."""

    values: np.ndarray  # (m,)
    rows: np.ndarray  # (m, n)
    links: np.ndarray  # (m,)
    frequencies: np.ndarray  # (m,)

    @classmethod
    def at(cls, path: _Path, share: float, place: np.ndarray) -> _Slopes:
        """At a place with a share."""
        peaks = [(link, *path.peaks(link, share, path.multipliers(place))) for link in path.links]
        least = max(values.max() for *_, values in peaks) - NEAR
        near = [(link, at[values > least], values[values > least]) for link, at, values in peaks]
        larger = share * float(np.exp(STEP))
        moved = [(share, path.multipliers(place + STEP * step)) for step in np.eye(len(place))]
        moved.append((larger, path.multipliers(place)))
        near = [one for one in near if len(one[1])]
        values = np.concatenate([own for *_, own in near])
        columns = [np.concatenate([path.gains(link, *one, at) for link, at, _ in near]) for one in moved]
        links = np.concatenate([np.full(len(at), link) for link, at, _ in near])
        rows = (np.array(columns).T - values[:, None]) / STEP
        return cls(values, rows, links, np.concatenate([at for _, at, _ in near]))

    def changed(self, before: _Slopes, weights: np.ndarray) -> np.ndarray:
        """By how much the slope of a sum of gains has changed; each with the nearest frequency of its pair."""
        change = np.zeros(self.rows.shape[1])
        for k in np.flatnonzero(weights > 0.0):
            apart = np.abs(np.log(self.frequencies / before.frequencies[k]))
            apart[self.links != before.links[k]] += 1.0 / STEP
            change += weights[k] * (self.rows[np.argmin(apart)] - before.rows[k])
        return change


class _Grown(NamedTuple):
    """A share, its place, and how many programs it took."""

    share: float
    place: np.ndarray
    programs: int


def _grown(path: _Path, share: float, place: np.ndarray, most: int) -> _Grown:
    """The largest share of a round of programs, of which there are at most some."""
    flat = np.diag(np.r_[np.full(len(place), FLAT[0]), FLAT[1]])
    bent, added, count = flat, 0.0, 0
    seen = _Slopes.at(path, share, place)
    while count < most and share < ENOUGH and added < ADDED[3]:
        count += 1
        step, weights = _nearest(bent + added * flat, seen)
        for part in PARTS:
            moved = np.r_[part * step[:-1], min(1.0, part * step[-1])]
            other, more = place + moved[:-1], share * float(np.exp(moved[-1]))
            near = np.abs(moved).max() <= FARTHEST
            if near and moved[-1] > RAISED and path.covers(more, path.multipliers(other)):
                break
        else:
            added = max(ADDED[0], ADDED[1] * added)
            continue
        share, place, before = more, other, seen
        added = added / ADDED[2] if part == PARTS[0] else added
        seen = _Slopes.at(path, share, place)
        bent = _bent(bent, moved, seen.changed(before, weights))
    return _Grown(share, place, count)


def _nearest(bent: np.ndarray, seen: _Slopes) -> tuple[np.ndarray, np.ndarray]:
    """The least of ½ xᵀBx − x_last while all gains leave a distance to one, to first order, and the weights of the
    gains there; where the share does not grow, those that leave less may stay as they are."""
    step, weights = _bounded(bent, seen.rows, LEFT - seen.values)
    if step[-1] > RAISED:
        return step, weights
    return _bounded(bent, seen.rows, np.maximum(LEFT - seen.values, 0.0))


def _bounded(bent: np.ndarray, rows: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least of ½ xᵀBx − x_last with rows · x ≤ ends, 0 where there is none, and the weights of the rows: the
    nearest point of a polyhedron, by a least-squares problem."""
    from scipy.optimize import nnls

    back = np.linalg.inv(np.linalg.cholesky(bent)).T
    free = back @ back[-1]
    matrix, right = np.vstack([-(rows @ back).T, rows @ free - ends]), np.r_[np.zeros(len(free)), 1.0]
    weights = nnls(matrix, right)[0]
    left = matrix @ weights - right
    if left[-1] > -1e-12:
        return np.zeros(len(free)), np.zeros(len(rows))
    return free - back @ (left[:-1] / left[-1]), -weights / left[-1]


def _bent(bent: np.ndarray, moved: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The curvature after a step and the change of slopes by it, kept positive."""
    known = bent @ moved
    size, own = float(moved @ known), float(moved @ change)
    if own < 0.2 * size:
        part = 0.8 * size / (size - own)
        change = part * change + (1.0 - part) * known
        own = float(moved @ change)
    return bent - np.outer(known, known) / size + np.outer(change, change) / own
