"""Where the truncated solution can be trusted, judged at sampled points: a `SampledCheck`, not a proof.

The margin between the designed pair of γ and penalty and the weaker pair that is checked
------------------------------------------------------------------------------------------
With the exact fields, u = −R2⁻¹ g2ᵀ V_xᵀ satisfies V̇ ≤ ½ γ²|d|² − ½ |z|² wherever

    r(x) = V_x f + ½ hᵀh + ½ V_x (g1 g1ᵀ/γ² − g2 R2⁻¹ g2ᵀ) V_xᵀ ≤ 0.

For the designed γ and h, r is a remainder of either sign. So a weaker pair is checked, a larger γ_c and a smaller
penalty h_c. Its quadratic part is then, by the Riccati equation, r_2 = −½ xᵀMx with the margin

    M = CᵀC − C_cᵀC_c + (1/γ² − 1/γ_c²) P B1 B1ᵀ P,    C = ∂h/∂x, C_c = ∂h_c/∂x.

Where M is positive definite, r < 0 near the operating point, and there is a largest level set of V on which nothing
fails. Where xᵀMx = 0 for some x ≠ 0, the remainder decides there, and it may be positive arbitrarily near 0: then no
region is claimed.

The level
---------
It is the smallest V at which r becomes positive, or V stops increasing along the ray from 0. Rays give an upper bound;
ascent from many starts then looks for violations inside the level set, and each lowers it (`rays.py`), until two rounds
find none. The result does not depend on the first rays.
"""

# Not checked strictly: a penalty may be of any kind until it is read; parts of arrays have no type.
# pyright: reportUnknownArgumentType=false, reportUnknownLambdaType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import NamedTuple

import numpy as np

from flexhinf.errors import NumericalFailure, refuse_if
from flexhinf.hinf.rays import Landscape, RayInequality, Stops, ascend, touching_point
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.notebook import Summarised
from flexhinf.numerals import number_text
from flexhinf.plant.penalty import Penalty, StateWeights
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.validation import real_array

GAMMA_MARGIN = 1.1  # default: checked gamma over designed gamma
PENALTY_MARGIN = 0.9  # default: checked penalty over designed penalty

#: The margin is definite where its smallest rate exceeds this fraction of the fastest rate of V̇: rounding in M is far
#: below, and what is smaller could not be distinguished from a remainder.
DEFINITE = 1e-9

_SLOPE_STEP = 1e-4  # deviation for the slope of a penalty function

#: h of a check: a `Penalty` with the R2 of the design, or the weights, the matrix or the function h(x) alone.
CheckedPenalty = Penalty | StateWeights


class CheckedPair(NamedTuple):
    """The γ and penalty that are checked instead of the designed ones.

    `output`: The checked h from x (N, n) and the designed h (N, s). `text`: How the pair differs from the designed one.
    """

    gamma: float
    output: Callable[[np.ndarray, np.ndarray], np.ndarray]
    text: str


@dataclass(frozen=True, eq=False, repr=False)
class CheckedMargin(Summarised):
    """How much weaker the checked pair is than the designed one, near the operating point: r_2 = −½ xᵀMx.

    Attributes
    ----------
    gamma : float
        The checked attenuation level.
    text : str
        How the checked pair differs from the designed one.
    rate : float
        Smallest eigenvalue of M relative to P, 1/s: r_2 ≤ −`rate` V_2.
    fastest : float
        Largest rate of the terms of V̇ in the same sense, 1/s.
    direction : ndarray, shape (n,)
        Where the margin is smallest.
    """

    gamma: float
    text: str
    rate: float
    fastest: float
    direction: np.ndarray
    state_names: tuple[str, ...]

    @property
    def definite(self) -> bool:
        """Whether r_2 < 0 in every direction, by more than 1e-9 of the fastest rate."""
        return self.rate > DEFINITE * self.fastest

    @property
    def semidefinite(self) -> bool:
        """Whether r_2 ≤ 0 in every direction, up to 1e-9 of the fastest rate."""
        return self.rate >= -DEFINITE * self.fastest

    def reason(self) -> str:
        """Why there is a region, or none, in one sentence."""
        if self.definite:
            return f"the margin is definite: r <= -{self.rate:.3g}/s * V near the operating point"
        shares = np.abs(self.direction) / np.abs(self.direction).max()
        where = ", ".join(name for name, share in zip(self.state_names, shares, strict=True) if share > 0.1)
        if not self.semidefinite:
            return f"the checked pair is not weaker than the designed one (mainly in {where})"
        return f"r has no margin at the operating point in some direction (mainly {where}); treat it as unchecked"

    def summary(self) -> dict[str, str]:
        """Rate, whether it is definite, and the checked pair, for ``repr``."""
        return {
            "definite": "yes" if self.definite else "no",
            "rate": number_text(self.rate, "1/s"),
            "fastest rate": number_text(self.fastest, "1/s"),
            "checked gamma": number_text(self.gamma),
            "checked pair": self.text,
        }


def checked_margin(
    solution: ValueFunction, gamma: float | None = None, penalty: CheckedPenalty | None = None
) -> CheckedMargin:
    """The margin M between the designed pair and the checked one; arguments as `HJISolution.sampled_region`."""
    pair = checked_pair(solution, gamma, penalty)
    plant, p = solution.expansion, solution.P
    steps = _SLOPE_STEP * np.eye(len(p))  # h_c is a function: its slope is differenced
    plus, minus = (pair.output(x, x @ plant.h_parts[1].T) for x in (steps, -steps))
    checked_h = (plus - minus).T / (2 * _SLOPE_STEP)
    b1, b2 = p @ plant.g1_parts[0][:, :, 0], p @ plant.g2_parts[0][:, :, 0]
    designed, attenuated = plant.h_parts[1].T @ plant.h_parts[1], b1 @ b1.T / solution.gamma**2
    margin = designed - checked_h.T @ checked_h + attenuated - b1 @ b1.T / pair.gamma**2
    terms = designed + attenuated + b2 @ np.linalg.solve(plant.r2, b2.T)
    values, vectors = np.linalg.eigh(p)
    root = vectors / np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    rates, directions = np.linalg.eigh(root.T @ margin @ root)
    return CheckedMargin(
        pair.gamma,
        pair.text,
        float(rates[0]),
        float(np.linalg.eigvalsh(root.T @ terms @ root)[-1]),
        root @ directions[:, 0],
        tuple(solution.state_names),
    )


def checked_pair(
    solution: ValueFunction, gamma: float | None = None, penalty: CheckedPenalty | None = None
) -> CheckedPair:
    """The checked γ and penalty; arguments as `HJISolution.sampled_region`."""
    checked = GAMMA_MARGIN * solution.gamma if gamma is None else gamma
    refuse_if(
        not isinstance(checked, Real) or not checked >= solution.gamma,
        "The check cannot be made with these numbers.",
        f"expected gamma ≥ the designed {solution.gamma:.6g}, got {checked!r}",
        "a weaker level than the designed one, for example 1.1 times it",
    )
    finite, designed = np.isfinite(solution.gamma), solution.expansion.r2
    level = f"{checked / solution.gamma:.4g} times the designed gamma" if finite else "gamma = inf"
    if isinstance(penalty, Penalty):  # the check is about the law, which was made with the designed R2
        refuse_if(
            not np.allclose(penalty.r2(len(designed)), designed, rtol=1e-9, atol=0.0),
            "The checked penalty has another R2 than the design.",
            f"expected {designed.tolist()}, got {penalty.r2(len(designed)).tolist()}",
            "Penalty(states, effort=…) with the R2 of the design, or its states alone: penalty.states",
        )
        refuse_if(
            callable(penalty.states),
            "A penalty of code has parameters that a solution does not know.",
            f"expected weights, a matrix, or a function of x alone, got {penalty.states!r}",
            "penalty=lambda x: … of deviations x (N, n)",
        )
        penalty = penalty.states
    if penalty is None:
        text = f"{level}, {PENALTY_MARGIN} times the designed penalty"
        return CheckedPair(float(checked), lambda x, h: PENALTY_MARGIN * h, text)
    if callable(penalty):
        return CheckedPair(
            float(checked), lambda x, h: np.asarray(penalty(x)), f"{level}, a given penalty function"
        )
    n, names = len(solution.P), solution.state_names
    if isinstance(penalty, Mapping):
        groups = {}  # link_position_elbow is one joint's of link_position, and so for integrals
        for group in [name for name in penalty if name not in names]:
            stem, integral = group.removesuffix("_integral"), group.endswith("_integral")
            members = [name for name in names if name.startswith(f"{stem}_")]
            if members := [name for name in members if name.endswith("_integral") == integral]:
                groups[group] = members
        penalty = Penalty(penalty).expanded(groups).states
        assert isinstance(penalty, Mapping)
        unknown = sorted(set(penalty) - set(names))
        refuse_if(
            unknown,
            "The penalty names a state that does not exist.",
            f"expected names among {', '.join(names)}, got {', '.join(unknown)}",
            "the names of the problem's states",
        )
        penalty = [penalty.get(name, 0.0) for name in names]
    weights = real_array(penalty)
    matrix: np.ndarray = np.diag(weights) if weights.ndim == 1 else weights
    refuse_if(
        matrix.ndim != 2 or matrix.shape[1] != n or not np.isfinite(matrix).all(),
        "The penalty does not fit the states.",
        f"expected {n} finite weights or a matrix with {n} columns, got shape {weights.shape}: {penalty!r}",
        "one weight per state, or {name: weight}",
    )
    text = f"{level}, penalty weights {np.array2string(weights, precision=6)}"
    return CheckedPair(float(checked), lambda x, h: x @ matrix.T, text)


_INTEGRAL = "_integral"
_STEPS = 200  # continuation steps up to the amplitude that the quadratic part predicts
_LONGEST = 50  # give up at this many times that amplitude
_DIFFERENCE = 1e-6


def step_amplitude(
    solution: ValueFunction,
    level: float,
    moved: str | Mapping[str, float] | None = None,
    integrals: Sequence[str] | None = None,
) -> float:
    """Largest step a such that the equilibrium at −a from the goal lies in {V ≤ level}, connected to 0.

    Parameters
    ----------
    solution : ValueFunction
        About the goal.
    moved : str or mapping, optional
        The state that is commanded, or {state: share} for several. Default: those whose integral is a state
        (``NAME`` for a state ``NAME_integral``), in equal shares.
    integrals : sequence of str, optional
        Integral states: their start is the controller's choice, taken where V is smallest. Default: the
        states named ``…_integral``.

    Returns
    -------
    float
        In the unit of the moved state; infinite if the level is.

    Notes
    -----
    Followed by continuation from a = 0, because the minimum over the integrals can jump to another
    component of the level set. At an equilibrium every rate but the integrals' vanishes, with some constant input.
    """
    shares, free = step_roles(solution.state_names, moved, integrals)
    if not np.isfinite(level) or level <= 0:
        return float(max(level, 0.0))
    probe = 1e-3
    state = settled(solution, equilibrium_state(solution, -probe * shares, free), free)
    step = probe * float(np.sqrt(level / solution.value(state))) / _STEPS
    reached, state = 0.0, np.zeros(len(shares))
    for index in range(1, _LONGEST * _STEPS + 1):
        amplitude = index * step
        start = equilibrium_state(
            solution, -amplitude * shares, free, guess=state * amplitude / max(reached, step)
        )
        state = settled(solution, start, free)
        if solution.value(state) > level:
            return reached
        reached = amplitude
    return reached


def step_roles(
    names: tuple[str, ...], moved: str | Mapping[str, float] | None, integrals: Sequence[str] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Share of every state in the step, and which states are integrals."""
    if integrals is None:
        integrals = [name for name in names if name.endswith(_INTEGRAL)]
    if moved is None:
        moved = {name.removesuffix(_INTEGRAL): 1.0 for name in integrals}
    elif isinstance(moved, str):
        moved = {moved: 1.0}
    unknown = sorted({*moved, *integrals} - set(names))
    refuse_if(
        unknown or not moved,
        "The step does not say which state moves." if not unknown else "The step names unknown states.",
        f"expected names among {', '.join(names)}, got moved={moved!r}, integrals={list(integrals)!r}",
        "moved='link_position', integrals=['link_position_integral']",
    )
    shares = np.array([float(moved.get(name, 0.0)) for name in names])
    return shares, np.array([name in integrals for name in names])


def equilibrium_state(
    solution: ValueFunction, moved: np.ndarray, integral: np.ndarray, guess: np.ndarray | None = None
) -> np.ndarray:
    """Deviation (n,) at which every rate but the integrals' vanishes, given the moved states.

    `moved`: (n,), deviation of the moved states, zero elsewhere. `integral`: (n,), integral states; they keep the
    guess. `guess`: (n,). Raises NumericalFailure: no equilibrium was found there.
    """
    n, _, m, _ = solution.expansion.size
    x = np.where(moved != 0, moved, np.zeros(n) if guess is None else guess)
    unknown, u = np.flatnonzero(~(integral | (moved != 0))), np.zeros(m)

    def rates(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        f, _, g2, _ = solution.exact_fields(points)
        return (f + np.einsum("aij,j->ai", g2, u))[:, ~integral], g2[0][~integral]

    size = len(unknown)
    for _ in range(30):
        points = np.repeat(x[None], 1 + 2 * size, axis=0)
        points[1 + np.arange(size), unknown] += _DIFFERENCE
        points[1 + size + np.arange(size), unknown] -= _DIFFERENCE
        values, by_input = rates(points)
        by_state = (values[1 : 1 + size] - values[1 + size :]).T / (2 * _DIFFERENCE)
        step = np.linalg.lstsq(np.hstack([by_state, by_input]), -values[0], rcond=None)[0]
        x[unknown] += step[:size]
        u += step[size:]
        if np.abs(step[:size]).max(initial=0.0) <= 1e-10 * max(1.0, float(np.abs(x).max())):
            break
    left = float(np.abs(rates(x[None])[0]).max())
    at = ", ".join(f"{name} = {number_text(value)}" for name, value in zip(solution.state_names, x.tolist()))
    if not left <= 1e-6 * max(1.0, float(np.abs(solution.expansion.f_parts[1]).max())):
        raise NumericalFailure(
            "There is no equilibrium at the start of the step.",
            f"a rate is still {number_text(left, digits=3)} per s at {at}, in the units of the model",
            "a step of states that some input can hold, or name the integral states",
        )
    return x


def settled(solution: ValueFunction, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The nearest minimum of V over the free states, by damped Newton steps."""
    index = np.flatnonzero(free)
    if len(index) == 0:
        return x
    x = x.copy()
    scale = np.sqrt(2 * max(float(solution.value(x)), 1e-300) / np.diag(solution.P)[index])
    difference = np.maximum(1e-5 * scale, 1e-12)
    count = len(index)
    for _ in range(20):
        around = np.repeat(x[None], 1 + 2 * count, axis=0)
        around[1 + np.arange(count), index] += difference
        around[1 + count + np.arange(count), index] -= difference
        values, gradients = solution.value_and_gradient(around)
        value, slope, slopes = values[0], gradients[0, index], gradients[1:, index]
        hessian = (slopes[:count] - slopes[count:]) / (2 * difference[:, None])
        hessian = (hessian + hessian.T) / 2
        if np.linalg.eigvalsh(hessian)[0] <= 0:
            hessian = solution.P[np.ix_(index, index)]
        step = -np.linalg.solve(hessian, slope)
        for _ in range(10):
            moved = x.copy()
            moved[index] += step
            if solution.value(moved) <= value:
                break
            step = step / 2
        else:
            break
        x = moved
        if np.abs(step / scale).max() < 1e-9:
            break
    return x


_SMALLEST, _GROWTH = 1e-4, 1.08  # first deviation on a ray, and its growth from point to point along a ray
_FINE = 1.02  # the same for the single rays that are followed again
_STARTS, _PER_STATE = 64, 8  # starts of an ascent: so many, or so many per state
_ASCENT = 150  # evaluations of one ascent
_ROUNDS, _QUIET = 20, 2  # rounds of the search at most, and rounds without a violation after which it ends
# violations followed per round, and the cosine of the angle they keep from each other
_TOUCHES, _APART = 4, 0.98
MOST_RAYS = 100_000  # far beyond what changes a level, which ascent finds; their points take 100 MB
_LOWER = 1e-9  # relative lowering of the level that counts


@dataclass(frozen=True, eq=False, repr=False)
class SampledCheck(Summarised):
    """The largest level set {V ≤ level} around 0 on which nothing against it was found.

    Attributes
    ----------
    gamma : float
        The checked attenuation level.
    margin : str
        How the checked pair differs from the designed one.
    level : float
        Infinite if no ray stopped within `largest`.
    worst_point : ndarray, shape (n,)
        Deviation at which the limiting ray stopped.
    limit : str
        Why it stopped: "inequality", "V stops increasing", or "nothing found".
    largest : float
        Largest deviation (in any state) that was tried.
    """

    solution: ValueFunction
    gamma: float
    margin: str
    level: float
    worst_point: np.ndarray
    limit: str
    rays: int
    seed: int
    largest: float

    def step_amplitude(
        self, moved: str | Mapping[str, float] | None = None, integrals: Sequence[str] | None = None
    ) -> float:
        """Largest step between equilibria whose start lies in the level set; see `flexhinf.hinf.sampled`."""
        return step_amplitude(self.solution, self.level, moved, integrals)

    def summary(self) -> dict[str, str]:
        """Level, limit, checked pair and number of rays, for ``repr``."""
        return {
            "level of V": number_text(self.level),
            "limited by": self.limit,
            "checked gamma": number_text(self.gamma),
            "checked pair": self.margin,
            "rays": f"{self.rays}, not a proof",
        }

    def report(self) -> str:
        """Level, limiting point and checked pair as text."""
        names = ", ".join(
            f"{name} = {value:.4g}"
            for name, value in zip(self.solution.state_names, self.worst_point, strict=True)
        )
        return "\n".join(
            [
                f"sampled check, {self.rays} rays and ascent on the worst (seed {self.seed}); not a proof",
                f"checked: gamma = {self.gamma:.6g}; {self.margin}",
                f"largest level set: V <= {self.level:.6g}, limited by: {self.limit}",
                f"worst point, deviations in the units of the model: {names}",
            ]
        )


def sample_region(
    solution: ValueFunction,
    gamma: float | None = None,
    penalty: CheckedPenalty | None = None,
    *,
    rays: int = 500,
    seed: int = 0,
    largest: float = 1e3,
) -> SampledCheck | None:
    """Largest level set on which the dissipation inequality held at every point tried; not a proof.

    Parameters
    ----------
    gamma : float, optional
        The attenuation level to check, not below the designed one. Default: 1.1 times the designed one.
    penalty : Penalty, callable, mapping, sequence or matrix, optional
        The penalty to check, smaller than the designed one: a `Penalty` with the designed R2, h(x) from (N, n) to
        (N, s), {state or group of states: weight}, one weight per state, or a matrix (s, n). Default: 0.9 times
        the designed h.
    rays : int
        Directions that are followed outwards first, at most 100,000. The level does not depend on them: violations
        are then looked for by ascent from many starts.
    seed : int
        Of the directions and of the starts.
    largest : float
        Largest deviation in any state that is tried.

    Returns
    -------
    SampledCheck or None
        None where the checked pair has no margin in some direction; `checked_margin` says in which. This
        module's docstring says what is checked, and how.

    Raises
    ------
    InvalidInput
        A γ below the designed one, a penalty that does not fit the states, or no rays or too many.
    """
    refuse_if(
        not (
            all(isinstance(count, Integral) for count in (rays, seed))
            and isinstance(largest, Real)
            and 0 < rays <= MOST_RAYS
            and seed >= 0
            and largest > _SMALLEST
        ),
        "The check cannot be made with these numbers.",
        f"expected whole rays from 1 to {MOST_RAYS} and seed ≥ 0, and largest > {_SMALLEST}, "
        f"got {rays!r}, {seed!r}, {largest!r}",
        "the defaults",
    )
    margin, pair = checked_margin(solution, gamma, penalty), checked_pair(solution, gamma, penalty)
    if not margin.definite:
        plant, linear = solution.problem, False
        if isinstance(plant, PolynomialPlant) and set(solution.value_parts) == {2}:
            highest = max(plant.f_parts), max(plant.h_parts), max(plant.g1_parts), max(plant.g2_parts)
            linear = highest == (1, 1, 0, 0)  # r is its quadratic part everywhere
        if not (linear and margin.semidefinite):
            return None
    search = _RegionSearch(
        RayInequality(solution, pair.gamma, pair.output), np.random.default_rng(seed), largest
    )
    with np.errstate(all="ignore"):
        contact = search.lowest(rays)
    level = float(contact.level[0])
    if not np.isfinite(level):
        limit, point = "nothing found", np.zeros(len(solution.P))
    else:
        limit, point = ("inequality" if contact.broken[0] else "V stops increasing"), contact.point[0]
        level = level if contact.radius[0] > search.first else 0.0
    return SampledCheck(solution, pair.gamma, pair.text, level, point, limit, rays, seed, float(largest))


class _RegionSearch:
    """The lowest level at which a ray from 0 stops, over all directions; no state is larger than `largest`.

    `first`: Radius at which rays start, for directions with V_2 = ½.
    """

    def __init__(self, inequality: RayInequality, rng: np.random.Generator, largest: float) -> None:
        self.inequality, self.rng, self.largest = inequality, rng, largest
        self.states = len(inequality.solution.P)
        self.first = _SMALLEST / float(np.abs(inequality.root).max())

    def lowest(self, rays: int) -> Stops:
        """The stop (one ray) of lowest level; its level is infinite if none was found."""
        directions = self.inequality.directions(self.rng.standard_normal((rays, self.states)))
        stops = self.follow(directions, np.inf)
        best = stops.chosen([int(np.argmin(stops.level))])
        if best.radius[0] <= self.first:  # at once: no level set is free of violations
            return best
        quiet = 0
        for _ in range(_ROUNDS):
            best = self.touched(stops, best)
            stops = self.violations(float(best.level[0]))
            quiet = 0 if len(stops.level) else quiet + 1
            if quiet == _QUIET:
                break
        return self.touched(best, best)

    def follow(
        self, directions: np.ndarray, cap: float, growth: float = _GROWTH, start: float | None = None
    ) -> Stops:
        radii = np.full(len(directions), self.first if start is None else start)
        return self.inequality.follow(directions, radii, growth, self.largest, cap)

    def touched(self, stops: Stops, best: Stops) -> Stops:
        """The lowest contact of a level set with the violations at which rays stopped."""
        sphere, chosen = self.inequality.on_sphere(stops.direction), []
        # Rays that stopped lowest, no two in nearly the same direction.
        for place in np.argsort(stops.level):
            if not np.isfinite(stops.level[place]) or len(chosen) == _TOUCHES:
                break
            if all(sphere[place] @ sphere[other] < _APART for other in chosen):
                chosen.append(int(place))
        for place in chosen:
            stop = stops.chosen([place])
            landscape = self.landscape(float(stop.level[0]), not stop.broken[0])
            x = landscape.scale @ touching_point(landscape, np.linalg.solve(landscape.scale, stop.point[0]))
            direction = self.inequality.directions(self.inequality.on_sphere(x[None]))
            again = self.follow(
                direction, np.inf, _FINE, 0.3 * float(np.linalg.norm(x) / np.linalg.norm(direction))
            )
            for candidate in (stop, again):
                if candidate.level[0] < float(best.level[0]):
                    best = candidate
        return best

    def violations(self, level: float) -> Stops:
        """Rays towards the violations that ascent finds inside {V ≤ level}, as far as they stop below that level."""
        count = max(_STARTS, _PER_STATE * self.states)
        rays = [np.zeros((0, self.states))]
        for growth in (False, True) if max(self.inequality.solution.value_parts) > 2 else (False,):
            landscape = self.landscape(level, growth)
            sphere = self.rng.standard_normal((count, self.states))
            sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
            radius = (0.05 if np.isfinite(level) else 1e-4) ** self.rng.uniform(0.0, 1.0, (count, 1))
            points = ascend(landscape, sphere * radius, _ASCENT) @ landscape.scale.T
            points = points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
            rays.append(self.inequality.directions(self.inequality.on_sphere(points)))
        directions = np.concatenate(rays)
        if not len(directions):
            return Stops(*(np.zeros(shape) for shape in (0, 0, (0, self.states), 0, (0, self.states))))
        stops = self.follow(directions, level, growth=1.04)
        return stops.chosen(np.flatnonzero(stops.level < level * (1 - _LOWER)))

    def landscape(self, level: float, growth: bool) -> Landscape:
        """q in coordinates y with V_2 = `level` |y|²; for an infinite level, with |x| ≤ `largest` where |y| ≤ 1."""
        root = self.inequality.root
        size = np.sqrt(2 * level) if np.isfinite(level) else self.largest / float(np.abs(root).max())
        return Landscape(self.inequality, root * size, level, self.largest, growth)
