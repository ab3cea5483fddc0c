"""True plants within the tolerances, and the linear loop with them, over choices of the estimator's noise.

A corner has every uncertain number at one end of its interval: 2^p corners of p numbers. A loop is stable at a corner
if its multipliers there are inside the unit circle, at the equilibrium that it has with that plant.

The gain of a Kalman filter depends on the ratio of R^v to R^n alone, and on which states R^v has on its diagonal: every
state, all velocities (model errors are torques), those of the links or those of the motors. A loop that is stable at
all corners with one R^v may be unstable with another, so each result names its R^v.

No robot is needed here, only a function from signs (−1, 0 or 1 for each uncertain number) to parameters of a plant,
`flexhinf.robot.Robot.corner`, and one from a random generator, `Robot.draw`.
"""

from __future__ import annotations

import abc
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.linear_loop import Modes
from flexhinf.copies import shared_out
from flexhinf.errors import refuse_if
from flexhinf.plant.parameters import ParameterValues
from flexhinf.robot.parameters import random_signs

#: Signs (one per uncertain number) → parameters of a plant: `Robot.corner`. Parameters that a plant does not have are
#: left out.
ParametersAt = Callable[[Sequence[float]], ParameterValues]

# Process noise -----------------------------------------------------------------------------------------
ALL_STATES, VELOCITIES = "all states", "velocities only"
LINK_VELOCITIES, MOTOR_VELOCITIES = "link velocities only", "motor velocities only"

#: Words in the name of a disturbed state, by form of R^v; none if every state is disturbed.
DISTURBED: dict[str, set[str]] = {
    ALL_STATES: set(),
    VELOCITIES: {"velocity"},
    LINK_VELOCITIES: {"velocity", "link"},
    MOTOR_VELOCITIES: {"velocity", "motor"},
}
FORMS = tuple(DISTURBED)

#: Largest number of states of a small linear loop; for a large one fewer choices of R^v are evaluated.
LARGE = 40

#: Ratios q / R^n that are swept over, for loops of up to `LARGE` states and larger ones.
RATIOS: tuple[tuple[float, ...], ...] = (tuple(10.0**k for k in range(-4, 13, 2)), (1e-2, 1e2, 1e6))


@dataclass(frozen=True)
class ProcessNoise:
    """R^v = q on the diagonal, for the states of a form.

    Velocities are states with "velocity" as a word of their name, "link" and "motor" words of it too; q is the
    variance per sample, in the states' units squared. Another form, or a q that is negative or not finite, is an
    InvalidInput.
    """

    form: str
    q: float

    def __post_init__(self) -> None:
        refuse_if(
            self.form not in FORMS or not (np.isfinite(self.q) and self.q >= 0.0),
            "The process noise is not known.",
            f"expected one of {list(FORMS)} and a finite q >= 0, got {self.form!r} and {self.q!r}",
            f"ProcessNoise({ALL_STATES!r}, 1e-6)",
        )

    def disturbed(self, states: Sequence[str]) -> np.ndarray:
        """Which of the states have noise, (n,)."""
        return np.array([DISTURBED[self.form] <= set(name.split("_")) for name in states])

    def covariance(self, states: Sequence[str]) -> np.ndarray:
        """R^v (n, n) of a plant with these states; an InvalidInput if none of them is of the form."""
        disturbed = self.disturbed(states)
        refuse_if(
            not disturbed.any(),
            f"No state is disturbed by noise on {self.form}.",
            f"expected names with the words {sorted(DISTURBED[self.form])}, got {list(states)}",
            f"ProcessNoise({ALL_STATES!r}, …)",
        )
        return self.q * np.diag(disturbed.astype(float))


def standard_noises(
    loop: EquilibriumLoop, measurement_noise: float | None = None
) -> tuple[ProcessNoise, ...]:
    """All forms that the loop's states have, each with q over a range of ratios to R^n; none without a Kalman filter.

    R^n, to which the ratios are, is by default the smallest variance of the filter's measurements.
    """
    forms = [form for form in FORMS if ProcessNoise(form, 0.0).disturbed(loop.step.states).any()]
    variance = _smallest_variance(loop) if measurement_noise is None else measurement_noise
    ratios = RATIOS[int(loop.states > LARGE)]
    noises = (ProcessNoise(form, k * variance) for form in forms for k in ratios)
    return tuple(noises) if loop.tunable else ()


def _smallest_variance(loop: EquilibriumLoop) -> float:
    return float(np.diag(loop.filter.measurement_noise).min()) if loop.tunable else np.nan


# Plants ------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Population:
    """True plants: the parameters of each by name, numbers or arrays; its kind, "draw", "corner", "single" or
    "nominal"; the signs (N, p) of its uncertain numbers, NaN for draws; and the parameters of the nominal plant."""

    values: tuple[ParameterValues, ...]
    kinds: np.ndarray
    signs: np.ndarray
    nominal: ParameterValues

    def __len__(self) -> int:
        return len(self.values)

    def describe(self, k: int) -> str:
        """A plant by its changes in per cent: ``stiffness 2 -12 %, mass 1 +3 %``."""
        parts: list[str] = []
        for name, value in self.values[k].items():
            new, old = (np.ravel(np.asarray(v, dtype=float)) for v in (value, self.nominal[name]))
            text = name.replace("_", " ")
            for i in np.flatnonzero((new != 0.0) & (old != 0.0)):
                change = 100.0 * (new[i] / old[i] - 1.0)
                if abs(change) > 1e-9:
                    parts.append(f"{text}{f' {i + 1}' if len(new) > 1 else ''} {change:+.3g} %")
        return ", ".join(parts) or "nominal"


def corners(uncertain: int, count: int, seed: int = 0) -> np.ndarray:
    """Signs (N, p) of corners: all 2^p of them if they are at most `count`, else `count` random ones."""
    for name, number in (("uncertain", uncertain), ("count", count), ("seed", seed)):
        refuse_if(
            isinstance(number, bool) or not isinstance(number, Integral) or number < 0,
            "The corners cannot be counted.",
            f"expected integers >= 0, got {name}={number!r}",
            "count=400",
        )
    if uncertain < 63 and 2**uncertain <= count:
        return np.array(list(itertools.product((-1.0, 1.0), repeat=uncertain))).reshape(
            2**uncertain, uncertain
        )
    return random_signs(uncertain, count, [seed, 1])


def corner_population(
    at: ParametersAt,
    uncertain: int,
    count: int = 400,
    seed: int = 0,
    draw: Callable[[np.random.Generator], ParameterValues] | None = None,
    draws: int = 100,
    singles: bool = True,
) -> Population:
    """Draws, corners, every uncertain number alone at both of its ends, and the nominal plant, in this order.

    Of the `uncertain` numbers (``len(robot.uncertain)``) there are `count` corners, if there are more than so many.
    Corners and draws have a generator each, of one seed; `draw` makes parameters of one, as `Robot.draw`, and without
    it nothing is drawn. `singles` says whether plants with one number at one end are among them.
    """
    rng, ends = np.random.default_rng(seed), corners(uncertain, count, seed)
    samples = [] if draw is None else [draw(rng) for _ in range(draws)]
    unit = np.eye(uncertain) if singles else np.zeros((0, uncertain))
    alone = np.array([sign * row for row in unit for sign in (-1.0, 1.0)]).reshape(-1, uncertain)
    signs = np.vstack([ends, alone, np.zeros((1, uncertain))])
    values = (*samples, *(at(row.tolist()) for row in signs))
    kinds = ["draw"] * len(samples) + ["corner"] * len(ends) + ["single"] * len(alone) + ["nominal"]
    whole = np.vstack([np.full((len(samples), uncertain), np.nan), signs])
    return Population(values, np.array(kinds), whole, values[-1])


#: All corners are computed of up to so many uncertain numbers (4096 corners), unless that takes more operations than
#: these (the cube of the states for each corner): with eleven numbers more than a hundred states.
ALL_OF, OPERATIONS = 12, 3e9

#: With more uncertain numbers so many sampled corners; the second number for a large loop.
SAMPLED = (400, 60)


def corner_plants(
    states: int, at: ParametersAt, uncertain: int | Sequence[object], seed: int = 0
) -> tuple[Population, bool]:
    """The corners at which `tolerance_corners` looks, the nominal plant last, and whether these are all corners.

    `states`: of the loop, which sets the cost of a corner; 0 where it costs nothing.
    """
    number = uncertain if isinstance(uncertain, int) else len(uncertain)
    complete = number <= ALL_OF and 2.0**number * states**3 <= OPERATIONS
    count = 2**number if complete else SAMPLED[states > LARGE]
    return corner_population(at, number, count, seed, singles=False), complete


def _vectors(loop: EquilibriumLoop, population: Population) -> np.ndarray:
    return loop.plant.parameters.vectors(
        [loop.plant.parameters.known(values) for values in population.values]
    )


@dataclass(frozen=True, eq=False)
class Corners:
    """A population of which the nominal plant is the last, and whether all corners are among it; otherwise they are
    sampled."""

    population: Population
    complete: bool

    @property
    @abc.abstractmethod
    def worst(self) -> int:
        """Place of the worst corner."""

    @property
    def count(self) -> int:
        """Number of corners."""
        return len(self.population) - 1

    def describe(self, k: int | None = None) -> str:
        """A corner, the worst one by default, by its changes in per cent: ``stiffness -12 %, mass +3 %``."""
        return self.population.describe(self.worst if k is None else k)


# Growth rates ------------------------------------------------------------------------------------------
#: Rows (plants times choices of R^v) that are computed at once: with few plants, several R^v.
ROWS = 1024


@dataclass(frozen=True, eq=False)
class GrowthRates:
    """Growth rates of a loop with each of several plants, at one R^v."""

    noise: ProcessNoise | None  # None: the loop as it is designed, or the true state fed back
    #: (N,), log of the largest multiplier per period, 1/s: negative where stable, infinite without equilibrium
    rates: np.ndarray
    kinds: np.ndarray  # (N,) of str, as of `Population`
    plants: np.ndarray  # (N,) of int, which plants of it these are

    @property
    def unstable(self) -> int:
        """How many of the plants make the loop unstable."""
        return int((self.rates >= 0.0).sum())

    @property
    def fastest(self) -> float:
        """Growth rate with the worst plant, 1/s."""
        return float(self.rates.max())

    @property
    def worst(self) -> int:
        """The plant of the population with which the loop grows fastest."""
        return int(self.plants[np.argmax(self.rates)])

    def share(self, kind: str | None = None) -> float:
        """Fraction of unstable plants of a kind ("corner", …), or of all; NaN where there is none."""
        chosen = self.rates if kind is None else self.rates[self.kinds == kind]
        return float(np.mean(chosen >= 0.0)) if len(chosen) else float("nan")


def growth_rates(
    loop: EquilibriumLoop,
    population: Population,
    noises: Sequence[ProcessNoise | None] = (None,),
    plants: np.ndarray | None = None,
    vectors: np.ndarray | None = None,
) -> tuple[GrowthRates, ...]:
    """Growth rates of a loop with every plant, for every R^v; few plants with several R^v at once.

    None among the `noises` means the loop with its own R^v; R^v without a Kalman filter in the loop is refused. Only
    the `plants` (N,) of the population are taken, if given, and `vectors` (M, q) are the parameters of the whole
    population, where they are known.
    """
    chosen = np.arange(len(population)) if plants is None else plants
    taken = (_vectors(loop, population) if vectors is None else vectors)[chosen]
    count, remaining, parts = len(chosen), list(noises), list[list[ProcessNoise | None]]()
    while remaining:
        together = remaining[: max(1, ROWS // max(count, 1))]
        parts.append(list(itertools.takewhile(lambda noise: noise is not None, together)) or remaining[:1])
        del remaining[: len(parts[-1])]

    def grown(part: Sequence[ProcessNoise | None], near: np.ndarray | None) -> Modes:
        own = [noise.covariance(loop.step.states) for noise in part if noise is not None]
        # (n, n); (N, n, n) of several
        per_row = np.repeat(np.array(own), count, axis=0) if len(own) > 1 else own[0] if own else None
        return loop.modes(
            np.tile(taken, (len(part), 1)), per_row, None if near is None else np.tile(near, (len(part), 1))
        )

    if not parts:
        return ()
    first = grown(parts[0], None)
    near = first.equilibrium[-count:]
    later = shared_out(lambda part: grown(part, near).rate, parts[1:], compiles=False)
    return tuple(
        GrowthRates(noise, row, population.kinds[chosen], chosen)
        for part, rates in zip(parts, [first.rate, *later])
        for noise, row in zip(part, rates.reshape(len(part), count))
    )


# Corners -----------------------------------------------------------------------------------------------
#: A large loop is swept over R^v at so many corners only: those that grow fastest as designed.
SWEPT_OF_LARGE = 100

#: Finer grid of q per decade, corners tried on it for each q of the coarse one, and peaks found on it that are kept.
PER_DECADE, FEW, PEAKS = 4, 4, 2

#: A peak stands out from both of its neighbours on the grid by so much of its growth rate; less is rounding.
PROMINENT = 1e-4

#: Stands for an infinite growth rate where rates are compared, 1/s.
LARGEST = 1e300


@dataclass(frozen=True, eq=False, repr=False)
class ToleranceCorners(Corners):
    """Growth rates of a loop at the corners of the tolerances."""

    designed: GrowthRates  # with the estimator's noise as designed, or without an estimator
    #: over other R^v; of a large loop at the corners only that grow fastest as designed
    swept: tuple[GrowthRates, ...]
    measurement_noise: float  # R^n that ratios are to; NaN without a Kalman filter

    @property
    def unstable(self) -> int:
        """Corners at which the loop as designed is unstable."""
        return self.designed.unstable

    @property
    def worst(self) -> int:
        """The corner at which the loop as designed grows fastest."""
        return self.designed.worst

    def __repr__(self) -> str:
        unstable = f"{self.unstable} of {self.count} corners unstable"
        return f"ToleranceCorners({unstable}, {len(self.swept)} other R^v)"

    @property
    def forms(self) -> tuple[str, ...]:
        """Forms of R^v that were swept over."""
        return tuple(dict.fromkeys(swept.noise.form for swept in self.swept if swept.noise is not None))

    def of_form(self, form: str) -> dict[float, GrowthRates]:
        """Growth rates by the ratio q / R^n, of one form."""
        return {
            swept.noise.q / self.measurement_noise: swept
            for swept in self.swept
            if swept.noise is not None and swept.noise.form == form
        }

    def stable_ratios(self, form: str) -> tuple[float, ...]:
        """Ratios q / R^n of a form with which no corner was unstable: where the estimator may be retuned to."""
        return tuple(ratio for ratio, rates in self.of_form(form).items() if not rates.unstable)

    @property
    def retunable(self) -> tuple[str, ...]:
        """Forms with which no corner was unstable at any ratio that was swept over."""
        return tuple(form for form in self.forms if len(self.stable_ratios(form)) == len(self.of_form(form)))


def tolerance_corners(
    loop: EquilibriumLoop,
    at: ParametersAt,
    uncertain: int | Sequence[object],
    noises: Sequence[ProcessNoise] | None = None,
    *,
    seed: int = 0,
) -> ToleranceCorners:
    """Growth rates at all corners of up to 12 uncertain numbers, at seeded samples of the corners of more.

    Loops of more than a hundred states, and delays of thousands of samples, are sampled too; the result says so.

    The estimator's noise is taken as designed, then as each of `noises` (`standard_noises` by default), and for each
    form of R^v that is stable so far as a q between two of these with which the loop grows fastest. `uncertain` are the
    uncertain numbers, or how many there are: ``robot.uncertain``. R^v without a Kalman filter is an InvalidInput.
    """
    population, complete = corner_plants(loop.states, at, uncertain, seed)
    every, vectors = np.arange(len(population) - 1), _vectors(loop, population)
    designed = growth_rates(loop, population, (None,), every, vectors=vectors)[0]
    noises = standard_noises(loop) if noises is None else noises
    if loop.states > LARGE:
        every = np.sort(np.argsort(-designed.rates, kind="stable")[:SWEPT_OF_LARGE])
    swept = growth_rates(loop, population, noises, every, vectors=vectors)
    # A loop may be stable at two neighbours on the grid of q and not between them. A finer grid is tried with the few
    # corners that grow fastest at each q of the grid; a q of it that grows faster than its neighbours is taken too.
    between: list[ProcessNoise] = []
    for form in FORMS:
        grid = [
            (rates, rates.noise.q) for rates in swept if rates.noise is not None and rates.noise.form == form
        ]
        levels = sorted(q for _, q in grid)
        if len(grid) < 2 or levels[0] <= 0.0 or any(rates.unstable for rates, _ in grid):
            continue
        few = np.unique([rates.plants[np.argsort(-rates.rates, kind="stable")[:FEW]] for rates, _ in grid])
        count = round(PER_DECADE * np.log10(levels[-1] / levels[0])) + 1
        tried = [ProcessNoise(form, float(q)) for q in np.geomspace(levels[0], levels[-1], count)]
        # infinite where no finite linear loop exists: a peak as well
        rates = [each.fastest for each in growth_rates(loop, population, tried, few, vectors=vectors)]
        fastest = np.clip(rates, -LARGEST, LARGEST)
        higher = fastest[1:-1] - PROMINENT * np.abs(fastest[1:-1])
        peaks = np.flatnonzero((higher > fastest[:-2]) & (higher > fastest[2:])) + 1
        between += [tried[k] for k in peaks[np.argsort(-fastest[peaks], kind="stable")][:PEAKS]]
    swept += growth_rates(loop, population, between, every, vectors=vectors)
    return ToleranceCorners(population, complete, designed, swept, _smallest_variance(loop))


# How far the tolerances may grow, all by one factor -----------------------------------------------------
#: Doublings of the tolerances until a corner is unstable; width of the bisection afterwards, relative to the factor.
DOUBLINGS, WIDTH = 4, 2.5e-4


@dataclass(frozen=True, eq=False)
class ToleranceBox:
    """The corners of the tolerances as parameter vectors, to be moved away from the nominal plant.

    Parameters are moved along the straight line through each corner. A corner that would change a parameter's sign is
    none from there on. `middle` (q,) is the nominal plant, the last of the population, and `away` (N, q) leads from
    there to each corner.
    """

    population: Population
    middle: np.ndarray
    away: np.ndarray

    @staticmethod
    def of(
        loop: EquilibriumLoop, at: ParametersAt, uncertain: int | Sequence[object], seed: int = 0
    ) -> ToleranceBox:
        """Parameters as for `tolerance_corners`."""
        population, _ = corner_plants(loop.states, at, uncertain, seed)
        *ends, middle = _vectors(loop, population)
        return ToleranceBox(population, middle, np.array(ends) - middle)

    def unstable(
        self,
        loop: EquilibriumLoop,
        scale: float,
        which: np.ndarray | None = None,
        process_noise: np.ndarray | None = None,
    ) -> np.ndarray:
        """The corners, out of some or all, that are unstable with all tolerances times a factor, the fastest first."""
        which = np.arange(len(self.away)) if which is None else which
        moved = self.middle + scale * self.away[which]
        which = which[np.all((moved * self.middle > 0.0) | (self.away[which] == 0.0), axis=1)]
        if not len(which):
            return which
        rates = loop.modes(self.middle + scale * self.away[which], process_noise).rate
        order = np.argsort(-rates, kind="stable")
        return which[order][rates[order] >= 0.0]

    def edge(
        self,
        loop: EquilibriumLoop,
        which: np.ndarray | None = None,
        process_noise: np.ndarray | None = None,
        most: float = 2.0**DOUBLINGS,
        width: float = WIDTH,
    ) -> tuple[float, int]:
        """Smallest factor with which one of some corners (all by default) is unstable, and this corner, found by
        doubling and bisection up to `most` and to the relative `width`.

        With `process_noise` R^v (n, n) instead of the filter's. The factor is infinite, and the corner −1, if no
        corner is unstable up to `most`; zero and −1 if the nominal loop is unstable.
        """
        if loop.modes(self.middle[None, :], process_noise).rate[0] >= 0.0:
            return 0.0, -1
        low, high = 0.0, 1.0
        while not len(unstable := self.unstable(loop, high, which, process_noise)):
            if high >= most:
                return np.inf, -1
            low, high = high, min(2.0 * high, most)
        while high - low > width * high:
            centre = 0.5 * (low + high)
            now = self.unstable(loop, centre, which, process_noise)
            low, high, unstable = (low, centre, now) if len(now) else (centre, high, unstable)
        return high, int(unstable[0])
