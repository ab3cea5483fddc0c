"""Search for the multipliers that let a loop of pairs tolerate the largest errors."""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from flexhinf.modal.pair_errors import (
    NONE,
    SYMMETRIC,
    ChannelWeights,
    Errors,
    FilterWeights,
    Multipliers,
    Sector,
)
from flexhinf.modal.pair_period import worst_period
from flexhinf.modal.popov import gain_peak, near_modes
from flexhinf.modal.sampled_pairs import SampledPairs

#: Relative accuracy of a tolerance, and the smallest one.
ACCURACY, FIRST = 0.01, 1e-4

#: First step of log₁₀ of one multiplier, and of several; the last one, and what a larger share than before is.
FIRST_STEP, LAST_STEP, MORE = (0.1, 0.5), 0.03, 1.02

#: Weights from which a search begins: ρ and μ₁ of a slope, μ₂ γ of it; of a slope in the model μ̂ γ, with a filter and
#: without, the filter's pole and its weight times γ; those of damping and of springs; the smallest; log₁₀.
SLOPE_STARTS, SLOPE_RATE = ((-2.5, -3.3), (-2.0, -2.5), (-2.0, -3.0)), (-1.0, 0.0)
PREDICTION, HIGH = (-5.0, -4.0), (-0.4, -1.0)
DAMPING_STARTS = (-2.0, 0.0), (-1.0, 0.5)
SPRING_STARTS, SMALLEST = ((-2.0, 0.0), (-3.0, -1.0), (-1.0, 0.5, 2.0)), (-4.0, -4.0, -3.0, -6.0, -2.0, -4.0)

#: Shares of what masses alone would have from which τ begins beside other errors.
BESIDE = (1.0, 0.1, 0.01)

#: log₁₀ of the poles of filters that are tried, in periods, and how many filters at most; how much more one must bring.
POLES, FILTERS, WORTH = (-2.0, -1.5, -1.0, -0.5, 0.0), 2, 1.05

#: λ and frequencies of the responses by which a multiplier is chosen; bisections of a share; how much more room the
#: inequality has where it depends on τ.
LINKS, FREQUENCIES, BISECTIONS, ROOM = 40, 60, 7, 10.0

#: Poles that are tried in the loop itself, and the parts of the largest share at which their numbers are sought.
CHOSEN, PARTS = 2, (0.98, 0.9, 0.75)


class PopovTolerance(NamedTuple):
    """The largest errors that multipliers cover at some λ."""

    errors: Errors
    multipliers: Multipliers
    share: float  # of the shape; 0 where nothing is covered


def popov_tolerance(
    pairs: SampledPairs, shape: Errors = SYMMETRIC, count: int = 25, fixed: Errors = NONE
) -> PopovTolerance:
    """The largest multiple of some errors that multipliers cover at `count` λ, at all frequencies, beside errors of a
    fixed size, if motors were alike; computed.

    No Δ and no E reach −1, where links are infinitely heavy or springs have no stiffness.
    """
    pairs = pairs.alike
    search, starts = _Largest(pairs, shape, count, fixed), list(_starts(pairs, shape, fixed))
    best, place = _best(search, starts)
    if place is None and any(fixed.channels):
        # From what covers the most of the fixed errors by themselves.
        beside = _Largest(pairs, fixed, count, NONE)
        most, place = _best(beside, starts)
        if place is not None:
            most, place = _climbed(beside, most, place, enough=1.0)
            best, place = _best(search, [place])
    if place is None:
        return PopovTolerance(search.errors(0.0), Multipliers(0.0), 0.0)
    best, place = _climbed(search, best, place)
    if not any(place.counts):
        best, place = _with_more(search, starts, best, place)
    return PopovTolerance(search.errors(best), place.multipliers, best)


def _with_more(
    search: _Largest, starts: Sequence[_Place], best: float, place: _Place
) -> tuple[float, _Place]:
    """The best place, or one with more filters that is better after it has climbed too."""
    more = [one for one in starts if len(one.powers) > len(place.powers)]
    share, other = _best(search, more)
    if other is not None:
        share, other = _climbed(search, share, other)
        if share > best:
            return share, other
    return best, place


def _best(search: _Largest, starts: Sequence[_Place]) -> tuple[float, _Place | None]:
    """The place with the largest share, and that share; None where all are 0."""
    best, place = 0.0, None
    for one in starts:
        if (share := search.share(one.multipliers, best)) > best:
            best, place = share, one
    return best, place


def _climbed(search: _Largest, best: float, place: _Place, enough: float = np.inf) -> tuple[float, _Place]:
    """The largest share by steps along the axes, from a place with a share; one that is enough ends it."""
    step = FIRST_STEP[len(place.powers) > 1]
    while step > LAST_STEP and best <= enough:
        before = best
        for other in place.neighbours(step):
            if (share := search.share(other.multipliers, best)) > best:
                best, place = share, other
        step *= 1.0 if len(place.powers) > 1 and best > MORE * before else 0.5
    return best, place


@dataclass(frozen=True)
class _Place:
    """Logarithms of multipliers and their signs: τ of slow vibrations; weights of springs, of a slope and of damping;
    then the pole of each filter, with what is added to τ beyond it."""

    counts: tuple[int, int, int]  # how many weights springs, a slope and damping have
    signs: tuple[float, ...]
    powers: tuple[float, ...]

    @classmethod
    def of(cls, masses: Sequence[float], counts: tuple[int, int, int], weights: Sequence[float]) -> _Place:
        """Of τ, poles and steps, and of logarithms of the weights of each channel."""
        slow, *filters = masses
        powers = [np.log10(abs(slow)), *weights, *np.log10(np.abs(filters))]
        signs = [np.sign(slow), *(1.0 for _ in weights), *np.sign(filters)]
        return cls(counts, tuple(map(float, signs)), tuple(map(float, powers)))

    @property
    def multipliers(self) -> Multipliers:
        """These, as numbers."""
        slow, *others = (sign * 10.0**power for sign, power in zip(self.signs, self.powers))
        (springs, _), (slope, prediction), (damping, _) = (
            (ChannelWeights(*[0.0] * (3 - count), *own[:3]), own[3:])
            for count in self.counts
            for own in ([others.pop(0) for _ in range(count)],)
        )
        slope = slope._replace(prediction=sum(prediction[:1]))
        of_slope = (FilterWeights(*prediction[1:]),) if prediction[1:] else ()
        # τ + (step) ω²/(ω² + p²)
        filters = [
            FilterWeights(pole, -0.5 * step * pole**2) for pole, step in zip(others[::2], others[1::2])
        ]
        tau = slow + sum(others[1::2])
        return Multipliers(tau, springs, slope, damping, tuple(filters), prediction_filters=of_slope)

    def neighbours(self, step: float) -> Iterator[_Place]:
        """A step along each axis, either way; of several weights, then all of them together."""
        size, weights = len(self.powers), sum(self.counts)
        steps, least = np.eye(size), np.full(size, -np.inf)
        if weights:
            steps = np.vstack([steps, [0.0] + [1.0] * weights + [0.0] * (size - 1 - weights)])
            least[1 : 1 + weights] = [
                one for count in self.counts for one in SMALLEST[max(0, 3 - count) :][:count]
            ]
            least[0] = -1.0
        for way in (*steps, *-steps):
            other = np.array(self.powers) + step * way
            if (other >= least).all():
                yield _Place(self.counts, self.signs, tuple(other.tolist()))


def _starts(pairs: SampledPairs, shape: Errors, fixed: Errors) -> Iterator[_Place]:
    """Places from which a search begins."""
    errors = fixed.and_share(1.0, shape)
    alone = errors.of_springs_alone
    springs, slope, damped = errors.channels
    foreseen = (1 if errors.any_motion else 3) * (slope and pairs.predicts)
    counts = (0, 0, 0) if alone else (3 * springs, (3 + foreseen) * slope, 2 * damped)
    masses = shape.masses if max(shape.masses) > 0.0 else Sector(1.0, 1.0)
    chosen = list(_of_masses_or_springs(pairs, shape.springs if alone else masses, alone))
    if not any(counts):
        for one in chosen:
            yield _Place.of(one, counts, ())
        return
    for (slow, *filters), share in product(chosen[1 :: len(PARTS)], BESIDE):
        own = [abs(slow) * share, *(own * (share if k % 2 else 1.0) for k, own in enumerate(filters))]
        for weights in _channel_starts(errors, foreseen):
            yield _Place.of(own, counts, weights)


def _channel_starts(errors: Errors, foreseen: int) -> Iterator[tuple[float, ...]]:
    """Weights of springs, of a slope and of damping from which a search begins, log₁₀."""
    springs, slope, damping = errors.channels
    of_springs = list(product(*SPRING_STARTS)) if springs else [()]
    of_slope: list[tuple[float, ...]] = [()]
    if slope:
        size = float(np.log10(max(errors.slope)))
        own = PREDICTION[foreseen == 1] - size, HIGH[0], HIGH[1] - size
        of_slope = [
            (*start, rate - size, *own[:foreseen]) for start, rate in product(SLOPE_STARTS, SLOPE_RATE)
        ]
    of_damping: list[tuple[float, ...]] = [*product(*DAMPING_STARTS)] if damping else [()]
    for parts in product(of_springs, of_slope, of_damping):
        yield tuple(one for part in parts for one in part)


def _of_masses_or_springs(pairs: SampledPairs, shape: Sector, of_springs: bool) -> Iterator[list[float]]:
    """τ of slow vibrations, then pole and step of filters: by responses these cover errors of masses alone, or of
    springs alone, without filters and with as few as bring more."""
    seen = _Responses(replace(pairs, delay=0.0, late=0.0), shape, of_springs)
    best = 0.0
    for count in range(FILTERS + 1):
        tried = [(seen.largest(poles), poles) for poles in combinations(POLES, count)]
        if (most := max(tried)[0]) <= (WORTH if count else 1.0) * best:
            return
        best = most
        for share, poles in sorted(tried)[-CHOSEN:]:
            for part in PARTS:
                if (one := seen.fitted(poles, part * share)) is not None:
                    yield one


class _Responses:
    """What pairs answer to errors of masses, or of springs, at frequencies; what samples mix of other frequencies is
    left out."""

    def __init__(self, pairs: SampledPairs, shape: Sector, of_springs: bool) -> None:
        self._shape = shape
        self._at, self._values = np.hstack(
            [_response(pairs, link, of_springs) for link in map(float, pairs.gains.links(LINKS, np.inf))]
        )

    def largest(self, poles: Sequence[float]) -> float:
        """The largest share of the shape that filters with these poles, log₁₀, cover."""
        low, high = 0.0, 1.0 / max(self._shape)
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.fitted(poles, middle) is None else (middle, high)
        return low

    def fitted(self, poles: Sequence[float], share: float) -> list[float] | None:
        """The numbers with the largest room at which a share is covered; None where there are none."""
        from scipy.optimize import linprog

        at, values = self._at.real, self._values
        parts = np.array([np.ones(len(at)), *(at**2 / (at**2 + 100.0**pole) for pole in poles)])
        rows = (-2.0 * at * values.imag)[:, None] * parts.T
        lower, upper = share * np.array(self._shape)
        known = (upper - lower) * values.real + lower * upper * np.abs(values) ** 2 - 1.0
        whole = np.hstack([rows, 1.0 + ROOM * np.abs(rows[:, :1])])
        bounds = [*[(None, None)] * len(parts), (None, 1.0)]
        found = linprog([*[0.0] * len(parts), -1.0], whole, -known, bounds=bounds)
        if found.status != 0 or found.x[-1] <= 0.0:
            return None
        slow, *steps = (float(one) or 1e-9 for one in found.x[:-1])
        return [slow, *(one for pole, step in zip(poles, steps) for one in (10.0**pole, step))]


def _response(pairs: SampledPairs, link: float, of_springs: bool) -> np.ndarray:
    """Frequencies, rad a period, dense where the modes of a pair are, and what a is there for d of size one, or s for
    e; (2, f)."""
    model, (acting, memory), h = pairs.model(link), pairs.memory(link), pairs.gains.period
    flow, pulls = expm(model), link * h**2
    turns = pulls + pairs.gains.pair(link).motor * h**2 if of_springs else pulls
    size = 1.0 if of_springs else np.sqrt(pulls)
    loop = np.vstack([(flow @ acting)[:4], memory])
    at = np.unique(np.r_[np.geomspace(1e-3, 2.0 * np.pi, FREQUENCIES), near_modes(np.linalg.eigvals(loop))])
    entry, z = np.array([0.0, pulls, 0.0, -turns, 0.0]) / size, np.exp(1j * at)
    inverse = np.linalg.inv(1j * at[:, None, None] * np.eye(5) - model)
    forced = inverse @ entry
    pushed = np.zeros((len(at), len(loop)), dtype=complex)
    pushed[:, :4] = (z[:, None] * forced - forced @ flow.T)[:, :4]
    states = np.linalg.solve(z[:, None, None] * np.eye(len(loop)) - loop, pushed[..., None])[..., 0]
    free = states @ acting.T - forced
    # the mean of x(t) exp(−jωt) over a period
    mean = forced + np.einsum("fij,fj->fi", inverse, free - (free @ flow.T) / z[:, None])
    return np.array([at, size * mean[:, 2]])


def small_gain_tolerance(pairs: SampledPairs, shape: Errors = SYMMETRIC, count: int = 25) -> Errors:
    """The largest multiple of errors of masses that is covered without a multiplier; computed at `count` λ. For a
    sector of one size this is small gain: errors may change with time, and need not be symmetric."""
    search = _Largest(pairs.alike, shape, count, NONE)
    return search.errors(search.share(Multipliers(0.0), 0.0))


class _Largest:
    """The largest multiples of errors that multipliers cover at some λ."""

    def __init__(self, pairs: SampledPairs, shape: Errors, count: int, fixed: Errors) -> None:
        self.shape, self.fixed = shape, fixed
        links = list(map(float, pairs.gains.links(count, np.inf)))[::-1]
        self.loops = list(product(pairs.some_late, links))
        slope = max(self.errors(1.0).slope) > 0.0
        # no proof has a slope in a prediction over several samples
        self.stable = not (slope and pairs.latency > 1) and all(
            loop.decay(link) > 0.0 for loop, link in self.loops
        )

    def errors(self, share: float) -> Errors:
        """The errors of a share."""
        return self.fixed.and_share(share, self.shape)

    def tolerates(self, share: float, multipliers: Multipliers) -> bool:
        """Whether errors of this share are covered at all λ."""
        if not self.stable:
            return False
        damping = self.errors(share).damping / self.loops[0][0].gains.period
        if multipliers.damping.rate * damping > 2.0 * multipliers.masses:
            return False
        for k, (loop, link) in enumerate(self.loops):
            if gain_peak(worst_period(loop, link, self.errors(share), multipliers)) >= 1.0:
                self.loops.insert(0, self.loops.pop(k))  # the next question is likely to fail here too
                return False
        return True

    def share(self, multipliers: Multipliers, above: float) -> float:
        """The largest share with multipliers, if it is larger than another one; else 0."""
        if not self.tolerates(above * (1.0 + ACCURACY) + FIRST, multipliers):
            return 0.0
        low, high = above, 1.0 / self.shape.largest
        while high - low > ACCURACY * max(low, FIRST):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.tolerates(middle, multipliers) else (low, middle)
        return low
