"""Rest-to-rest steps inside a proved region: where they start, the largest one, and its run.

A step of the moved state by a starts at the equilibrium at −a, relative to the goal. The equilibrium follows from the
plant's terms: a rate without input in which one unknown state is linear determines that state. The start of the
integrators is the controller's choice: where V is smallest, or where the input does not jump. The path of starts over a
begins at 0 and V ≤ level along it, so its starts lie in the proved component.

In a box of robots, a robot's step by a starts at its own equilibrium at −a. Its integrator starts at the value at which
the law's input equals the holding input. For a linear law both are terms in a and in the robot's parameters. For
another law the integrator is a table over a, such that the input of the nominal robot does not jump.

This file also computes the data of a certificate's figures: slices of the region with r on them, and a step with the
worst disturbance. They illustrate the theorem and are not part of it.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Protocol, cast

import numpy as np

from flexhinf.arrays import Matrix, Vector
from flexhinf.certify.certificate import Certificate, path_start, path_states
from flexhinf.certify.claim import Claim, Function, Start, Term, Terms
from flexhinf.errors import FlexhinfError, NumericalFailure
from flexhinf.hinf.rays import RayInequality
from flexhinf.hinf.sampled import CheckedPenalty, checked_pair, sample_region, settled, step_roles
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.loop.simulation.metrics import StepShape, peak_of, step_metrics

SMALLEST_VALUE = "each integrator starts where V is smallest"
UNCHANGED_INPUT = "each integrator starts where the input does not jump"
NOMINAL_INPUT = "the integrator starts where the input of the nominal robot does not jump, whatever the robot"

_STEPS, _LONGEST = 30, 20  # of the amplitude that the quadratic part of V predicts; over it, where to give up
_BELOW = 1 - 1e-4  # V stays below this share of the level, so that the check of a path is quick

#: Points of a path at which V is looked at, and the share of the level that it stays below, so that the check is quick.
PATH_POINTS, PATH_SHARE = 400, 1 - 1e-3

_KNOTS = 200  # of a table
_FURTHEST = 3  # how far a path is followed, over the amplitude that its beginning predicts
_ROUNDING = 1e-14  # terms below this, relative to the largest, are rounding errors of a sum that cancels


class _NoForm(Exception):
    """Raised for a state that is no sum of terms in a and the parameters."""


def starts_of(solution: ValueFunction, statement: Certificate) -> tuple[Start, ...]:
    """The path of starts for each rule, up to the amplitude at which V reaches the certificate's level."""
    equilibrium = equilibrium_path(statement)
    if equilibrium is None:
        return ()
    path, free = equilibrium
    level, probe, paths = statement.start_level, 1e-3, list[Start]()
    for rule, place in ((SMALLEST_VALUE, settled), (UNCHANGED_INPUT, unchanged_input)):
        first = place(solution, path_start(statement, path, probe), free)
        step = 0.0 if first is None else probe * float(np.sqrt(level / solution.value(first))) / _STEPS
        amplitudes, starts = [0.0], [np.zeros(len(free))]
        for _ in range(_LONGEST * _STEPS if step else 0):
            amplitude, before = amplitudes[-1], starts[-1]
            middle, guess = (path_start(statement, path, amplitude + part) for part in (step / 2, step))
            guess[free] = before[free] * ((amplitude + step) / amplitude if amplitude else 0.0)
            start: np.ndarray | None = place(solution, guess, free)
            middle[free] = (before[free] + (before if start is None else start)[free]) / 2
            if start is not None and (solution.value(np.stack([middle, start])) < _BELOW * level).all():
                amplitudes.append(amplitude + step)
                starts.append(start)
            elif step < 1e-4 * amplitude or amplitude == 0.0:
                break
            else:
                step /= 2
        if len(starts) > 1:
            columns, grid = np.transpose(starts).tolist(), tuple(amplitudes)
            table = tuple(tuple(column) if moves else () for column, moves in zip(columns, free))
            paths.append(replace(path, rule=rule, amplitude=grid[-1], amplitudes=grid, table=table))
    return tuple(paths)


# The equilibrium ----------------------------------------------------------------------------------
def equilibrium_path(statement: Certificate, side: float = -1.0) -> tuple[Start, np.ndarray] | None:
    """The equilibrium at −a, or with `side` 1 at +a, as terms in a, and which states are integrators (n,); None without
    integrators, and where the rates do not give the states one by one."""
    try:
        shares, free = step_roles(tuple(signal.name for signal in statement.states), None, None)
    except FlexhinfError:  # no integrator: nothing is commanded
        return None
    path: dict[int, Terms] = {i: (Term(side * float(s), (1,)),) for i, s in enumerate(shares) if s}
    path |= dict.fromkeys(np.flatnonzero(free).tolist(), ())
    functions: list[Function] = []
    rates = [i for i in range(len(shares)) if not free[i] and not any(statement.g2[i])]
    while rates:
        for i in rates:
            with suppress(_NoForm):
                path |= _solved(statement, i, path, functions)
                rates.remove(i)
                break
        else:
            return None
    if len(path) < len(shares):
        return None
    return Start(UNCHANGED_INPUT, 1.0, tuple(path[i] for i in range(len(shares))), tuple(functions)), free


def _solved(
    statement: Certificate, rate: int, path: dict[int, Terms], functions: list[Function]
) -> dict[int, Terms]:
    """The one unknown state of a rate whose other states are known; {} if all are known."""
    known, unknown = list[Term](), list[Term]()
    for term in statement.drift[rate]:
        slope = () if term.function is None else statement.functions[term.function].slope
        states = [i for factors in (term.powers, slope) for i, factor in enumerate(factors) if factor]
        (known if all(i in path for i in states) else unknown).append(term)
    if len(unknown) > 1 or any(t.function is not None or sum(t.powers) != 1 for t in unknown):
        raise _NoForm
    return {
        divisor.powers.index(1): tuple(
            divided(part, divisor) for term in known for part in term_along(term, path, statement, functions)
        )
        for divisor in unknown
    }


def term_along(
    term: Term, path: Mapping[int, Terms], statement: Certificate, functions: list[Function]
) -> list[Term]:
    """A term of the drift along the path; only multiples of a may be multiplied or be arguments of functions."""
    if term.function is None and sum(term.powers) == 1:
        return [multiplied(part, term.coefficient, term.parameters) for part in path[term.powers.index(1)]]
    factor, power, index = term.coefficient, sum(term.powers), None
    for i, times in enumerate(term.powers):
        factor *= _multiple(path[i]) ** times if times else 1.0
    if factor == 0.0:
        return []
    if term.function is not None:
        function = statement.functions[term.function]
        along = replace(
            function, slope=(sum((s * _multiple(path[i]) for i, s in enumerate(function.slope) if s), 0.0),)
        )
        if along not in functions:
            functions.append(along)
        index = functions.index(along)
    return [Term(factor, (power,), term.parameters, index)]


def _multiple(terms: Terms) -> float:
    for term in terms:
        if len(terms) > 1 or (term.powers, term.parameters, term.function) != ((1,), (), None):
            raise _NoForm
    return sum(term.coefficient for term in terms)


def multiplied(term: Term, coefficient: float, parameters: Iterable[tuple[str, int]]) -> Term:
    """A term times a number and powers of parameters."""
    mine, others = dict(term.parameters), dict(parameters)
    powers = {name: mine.get(name, 0) + others.get(name, 0) for name in mine | others}
    return replace(
        term,
        coefficient=term.coefficient * coefficient,
        parameters=tuple(sorted((name, power) for name, power in powers.items() if power)),
    )


def divided(term: Term, divisor: Term) -> Term:
    """−term / divisor."""
    return multiplied(
        term, -1.0 / divisor.coefficient, [(name, -power) for name, power in divisor.parameters]
    )


# The integrators ----------------------------------------------------------------------------------
def unchanged_input(solution: ValueFunction, x: np.ndarray, free: np.ndarray) -> np.ndarray | None:
    """Integrator states for which the law's input keeps the start in equilibrium, by Newton's method."""
    index, count = np.flatnonzero(free), int(free.sum())
    f, _, g2, _ = solution.exact_fields(x[None])
    input_at_goal = cast("Vector", np.linalg.lstsq(g2[0][~free], -f[0][~free], rcond=None)[0])
    if len(input_at_goal) != count:
        return None
    x, scale = x.copy(), 1 / np.sqrt(np.diag(solution.P)[index])
    for _ in range(30):
        difference = 1e-5 * np.maximum(np.abs(x[index]), 1e-3 * scale)
        moves = np.diag(difference) @ np.eye(len(x))[index]
        inputs = solution.inputs(x + np.vstack([np.zeros_like(x), moves, -moves]))
        slope = (inputs[1 : 1 + count] - inputs[1 + count :]).T / (2 * difference)
        if not np.isfinite(slope).all() or np.linalg.matrix_rank(slope) < count:
            return None
        step = cast("Vector", -np.linalg.solve(slope, inputs[0] - input_at_goal))
        x[index] += step
        if np.abs(step / np.maximum(np.abs(x[index]), scale * 1e-6)).max() < 1e-10:
            return x
    return None


# Boxes of robots ----------------------------------------------------------------------------------
def robot_start(statement: Certificate, side: float = -1.0) -> Start | None:
    """Each robot's own path of starts without a jump of the input; None if it is no sum of terms.

    Steps of an amplitude a start at −a, seen from the goal, or with `side` 1 at +a.
    """
    driven = [(i, row[0]) for i, row in enumerate(statement.g2) if row[0]]
    equilibrium = equilibrium_path(statement, side)
    if equilibrium is None or not (
        equilibrium[1].sum() == len(statement.law) == len(driven) == len(driven[0][1]) == 1
        and all(sum(powers) == 1 for law in statement.law for powers, _ in law)
    ):
        return None
    start, integrators = equilibrium
    path, functions, place = start.path, list(start.functions), int(np.flatnonzero(integrators)[0])
    ((rate, (divisor,)),), known = driven, dict(enumerate(path))
    try:  # the input at −a: −f_i/g2_i
        parts = [p for t in statement.drift[rate] for p in term_along(t, known, statement, functions)]
    except _NoForm:
        return None
    gains = {powers.index(1): value for powers, value in statement.law[0]}
    terms = [
        *(
            replace(term, coefficient=term.coefficient / gains[place])
            for term in _gathered(divided(part, divisor) for part in parts)
        ),
        *(
            replace(term, coefficient=-gain / gains[place] * term.coefficient)
            for i, gain in gains.items()
            if i != place
            for term in path[i]
        ),
    ]
    return Start(
        UNCHANGED_INPUT, 1.0, (*path[:place], _gathered(terms), *path[place + 1 :]), tuple(functions)
    )


def tabled_start(
    solution: ValueFunction, statement: Certificate, step: float, side: float = -1.0
) -> Start | None:
    """The path of starts up to a step, with a table of the integrator for which the nominal input does not jump; or
    None."""
    equilibrium = equilibrium_path(statement, side)
    if equilibrium is None:
        return None
    path, free = equilibrium
    amplitudes = np.linspace(0.0, step, _KNOTS + 1)
    states = path_states(path, statement.middle, amplitudes)
    for k in range(1, len(states)):
        states[k, free] = 2 * states[k - 1, free] - states[max(k - 2, 0), free] if k > 1 else 0.0
        if (start := unchanged_input(solution, states[k], free)) is None:
            return None
        states[k] = start
    table = tuple(tuple(column.tolist()) if moves else () for column, moves in zip(states.T, free))
    return replace(
        path, rule=NOMINAL_INPUT, amplitude=float(step), amplitudes=tuple(amplitudes.tolist()), table=table
    )


def _gathered(terms: Iterable[Term]) -> tuple[Term, ...]:
    """Terms with equal powers added; separate intervals would not cancel."""
    sums: dict[tuple[tuple[int, ...], tuple[tuple[str, int], ...], int | None], list[float]] = {}
    for term in terms:
        key = term.powers, tuple(sorted(term.parameters)), term.function
        sums.setdefault(key, []).append(term.coefficient)
    largest = max((abs(c) for part in sums.values() for c in part), default=0.0)
    return tuple(
        Term(math.fsum(part), *key)
        for key, part in sums.items()
        if abs(math.fsum(part)) > _ROUNDING * largest
    )


def largest_values(statement: Certificate, start: Start, amplitudes: np.ndarray) -> np.ndarray:
    """The largest V over the corners of the box at starts of some amplitudes, in doubles."""
    used = {name for row in start.path for term in row for name, _ in term.parameters}
    ends = {p.name: (p.low, p.high) for p in statement.parameters if p.name in used and p.low < p.high}
    powers, coefficients = (np.array(column) for column in zip(*statement.value))
    largest = np.full(len(amplitudes), -np.inf)
    for corner in itertools.product(*ends.values()):
        x = path_states(start, statement.middle | dict(zip(ends, corner)), amplitudes)
        largest = np.maximum(largest, (coefficients * np.prod(x[:, None, :] ** powers, axis=2)).sum(axis=1))
    return largest


def start_inside(statement: Certificate, start: Start, step: float | None) -> tuple[Start, ...]:
    """The path up to `step`, or as far as V stays below the level at all corners; empty if `step` is not inside."""
    if step is not None:
        inside = largest_values(statement, start, np.linspace(0.0, step, PATH_POINTS)).max() < statement.level
        if inside or start.table:
            return (replace(start, amplitude=float(step)),) if inside else ()
    amplitude = 1e-3
    amplitude *= float(np.sqrt(statement.level / largest_values(statement, start, np.array([amplitude]))[0]))
    grid = np.linspace(0.0, _FURTHEST * amplitude, _FURTHEST * PATH_POINTS + 1)
    beyond = np.flatnonzero(largest_values(statement, start, grid) >= PATH_SHARE * statement.level)
    last = float(grid[max(beyond[0] - 1, 0) if len(beyond) else -1])
    return (replace(start, amplitude=last),) if last > 0.0 else ()


# Runs from the largest starts --------------------------------------------------------------------------
_SETTLED, _RUN_STEPS = 1e-6, 20_000  # share of the first V at which a run ends, and its steps at least
_TIME_CONSTANTS = 100.0  # time constants of the slowest mode of the linear loop


@dataclass(frozen=True, eq=False)
class ProvedStep:
    """The rest-to-rest step of the largest proved amplitude, for one rule of the integrators' start."""

    rule: str
    amplitude: float  # in the unit of the moved state
    overshoot_percent: float  # of the step, in its direction
    first_input: np.ndarray  # (m,) at the start; absolute values in the unit of the input
    peak_input: np.ndarray  # (m,) largest magnitudes
    time: np.ndarray  # (N,)
    state: np.ndarray  # (N, n), deviations from the goal


class _Run(Protocol):
    """What SciPy returns of a run."""

    status: int  # 1 where an event ended it
    t: Vector
    y: Matrix  # a state per column


def longest_run(solution: ValueFunction) -> float:
    """Duration in s after which a run has settled: `_TIME_CONSTANTS` of the slowest mode of the linear loop."""
    plant = solution.expansion
    b = plant.g2_parts[0][:, :, 0]
    return _TIME_CONSTANTS / float(
        -np.linalg.eigvals(plant.f_parts[1] - b @ np.linalg.solve(plant.r2, b.T @ solution.P)).real.max()
    )


def proved_steps(solution: ValueFunction, certificate: Claim) -> tuple[ProvedStep, ...]:
    """A run from the last start of each path of a certificate.

    Raises
    ------
    NumericalFailure
        A run that does not settle.
    """
    from scipy.integrate import solve_ivp

    def rates(_: float, x: np.ndarray) -> np.ndarray:
        f, _g1, g2, _h = solution.exact_fields(x[None])
        return f[0] + g2[0] @ solution.inputs(x[None])[0]

    longest, steps = longest_run(solution), list[ProvedStep]()
    for start in certificate.starts:
        first = path_start(certificate, start, start.amplitude)
        end = _SETTLED * float(solution.value(first))

        def below(_: float, x: np.ndarray, end: float = end) -> float:
            return float(solution.value(x)) - end

        below.terminal = True  # type: ignore[attr-defined]
        run = cast(
            "_Run",
            solve_ivp(
                rates,
                (0.0, longest),
                first,
                "LSODA",
                events=below,
                rtol=1e-8,
                atol=1e-10,
                max_step=longest / _RUN_STEPS,
            ),
        )
        if run.status != 1:
            raise NumericalFailure(
                "The run from the largest proved start does not settle.",
                f"V is {float(solution.value(run.y[:, -1])):.3g} after {run.t[-1]:.3g} s",
                "a smaller level",
            )
        state = run.y.T
        inputs = solution.operating_input + solution.inputs(state)
        moved = [i for i, value in enumerate(first) if abs(value) == start.amplitude]
        shapes = {i: StepShape(float(first[i]), 0.0, 0.0) for i in moved}
        overshoots = [
            step_metrics(run.t, state[:, i], shape)["overshoot_percent"] for i, shape in shapes.items()
        ]
        steps.append(
            ProvedStep(
                start.rule,
                start.amplitude,
                overshoot_percent=max(filter(None, overshoots), default=0.0),
                first_input=inputs[0],
                peak_input=peak_of(inputs),
                time=run.t,
                state=state,
            )
        )
    return tuple(steps)


#: Points of a surface along each side, and its sides over where the proved region is expected to end.
POINTS, WIDTH_FACTOR = 121, 1.25

#: A plane's second direction keeps this from the first (1 − cosine, V_2 as the metric); how far the plane is looked at.
APART, FURTHEST = 0.1, 4.0

#: Amplitude of a step with a disturbance, as a fraction of the largest proved one (the rest is for d); and its samples.
SHARE, SAMPLES = 0.8, 1000


@dataclass(frozen=True, eq=False)
class SurfaceSlice:
    """V and r + αV (B, A) on a surface through the goal with the coordinates `across` (A,) and `up` (B,)."""

    across: np.ndarray
    up: np.ndarray
    value: np.ndarray
    residual: np.ndarray

    @property
    def rate(self) -> np.ndarray:
        """r/V, 1/s, shape (B, A): how fast V falls beyond what the gain needs, negative; nan where V ≤ 0."""
        positive = self.value > 0.0
        return np.where(positive, self.residual / np.where(positive, self.value, 1.0), np.nan)

    def worst(self, level: float) -> tuple[float, float, float]:
        """The point with the largest r/V among those with V ≤ level: across, up, and r/V."""
        inside = np.where(self.value <= level, self.rate, np.nan)
        place = np.unravel_index(int(np.nanargmax(inside)), inside.shape)
        return float(self.across[place[1]]), float(self.up[place[0]]), float(inside[place])


@dataclass(frozen=True, eq=False)
class StartSurface(SurfaceSlice):
    """Equilibria at −a with an integrator at e, where steps from rest to rest start: `across` is a, `up` is e.

    `paths` are a and e (N, 2) of the proved starts, in the order of the certificate's.
    """

    paths: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class LimitSlice(SurfaceSlice):
    """The plane through the goal, the point that limits the sampled level (`up` = 1) and a second point (`across` = 1).

    The second point is the largest proved start. If that is nearly in line with the first, one state is set to 1
    instead, and the other states to the values that minimise V_2.
    """

    limit: str  # what fails there, as `SampledCheck.limit`
    point: np.ndarray  # (n,): deviation at which the level ends
    moved: int | None  # index of the state that is 1, None for the largest start


@dataclass(frozen=True, eq=False)
class WorstStep:
    """A step from rest with the worst disturbance by V, d = g1ᵀV_xᵀ/γ², until the budget is used up."""

    rule: str
    amplitude: float
    time: np.ndarray  # (N,), s
    state: np.ndarray  # (N, n), deviations from the goal
    disturbance: np.ndarray  # (N, w)
    value: np.ndarray  # V
    spent: np.ndarray  # ½γ²∫|d|² until then


def start_surface(
    solution: ValueFunction, certificate: Claim, penalty: CheckedPenalty | None = None
) -> StartSurface | None:
    """V and r where steps start; None without starts, or with other than one integrator."""
    chosen = [(start, [i for i, row in enumerate(start.table) if row]) for start in certificate.starts]
    if not chosen or any(len(free) != 1 for _, free in chosen):
        return None
    start, (integral,) = max(chosen, key=lambda pair: pair[0].amplitude)
    paths = tuple(np.column_stack([s.amplitudes, s.table[free[0]]]) for s, free in chosen)
    width = WIDTH_FACTOR * max(start.amplitude, float(max(path[:, 0].max() for path in paths)))
    height = WIDTH_FACTOR * max(
        np.sqrt(2.0 * certificate.level * float(np.linalg.inv(solution.P)[integral, integral])),
        max(float(np.abs(p[:, 1]).max()) for p in paths),
    )
    a: Vector = np.linspace(-width, width, POINTS)
    e = cast("Vector", np.linspace(-height, height, POINTS))
    points = np.repeat(path_states(start, certificate.middle, a)[None], POINTS, axis=0)
    points[:, :, integral] = e[:, None]
    return StartSurface(a, e, *_on(solution, certificate, penalty, points), paths)


def limit_slice(
    solution: ValueFunction, certificate: Claim, penalty: CheckedPenalty | None = None
) -> LimitSlice | None:
    """The plane in which the sampled level ends; None where sampling finds no end."""
    check = sample_region(solution, certificate.gamma, penalty)
    if check is None or not 0.0 < check.level < np.inf:
        return None
    point, inverse = check.worst_point, np.linalg.inv(solution.P)

    def apart(choice: tuple[np.ndarray, int | None]) -> float:
        x = choice[0]
        return 1.0 - float(
            abs(x @ solution.P @ point) / np.sqrt((x @ solution.P @ x) * (point @ solution.P @ point))
        )

    starts = [path_start(certificate, start, start.amplitude) for start in certificate.starts]
    choices: list[tuple[np.ndarray, int | None]] = [
        *((x, None) for x in sorted(starts, key=lambda x: -float(solution.value(x)))[:1]),
        *((inverse[:, i] / inverse[i, i], i) for i in range(len(inverse))),
    ]
    other, moved = next((choice for choice in choices if apart(choice) > APART), max(choices, key=apart))

    angle = np.linspace(0.0, np.pi, 91)  # how far {V ≤ level} goes in this plane, along rays from the goal
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    ends = np.array([np.sqrt(2.0 * certificate.level / (x @ solution.P @ x)) for x in (other, point)])
    plane = np.linspace(0.0, FURTHEST, 200)[1:, None, None] * unit * ends
    value = np.asarray(solution.value((plane @ np.array([other, point])).reshape(-1, len(point))))
    inside = np.logical_and.accumulate(value.reshape(plane.shape[:2]) <= certificate.level, axis=0)
    across, up = (
        np.linspace(-WIDTH_FACTOR * length, WIDTH_FACTOR * length, POINTS)
        for length in (float(np.abs(plane[..., k][inside]).max(initial=0.1)) for k in (0, 1))
    )
    value, residual = _on(solution, certificate, penalty, across[:, None] * other + up[:, None, None] * point)
    return LimitSlice(across, up, value, residual, check.limit, point, moved)


def _on(
    solution: ValueFunction, certificate: Claim, penalty: CheckedPenalty | None, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """V and r + αV at deviations (B, A, n), each (B, A)."""
    flat, pair = points.reshape(-1, points.shape[-1]), checked_pair(solution, certificate.gamma, penalty)
    value, slope = solution.value_and_gradient(flat)
    residual = RayInequality(solution, pair.gamma, pair.output).terms(flat, slope).sum(axis=0)
    residual += certificate.decay * value
    return value.reshape(points.shape[:-1]), residual.reshape(points.shape[:-1])


def worst_step(solution: ValueFunction, certificate: Claim, start: Start) -> WorstStep:
    """The step of `SHARE` times the largest proved amplitude of a path, with the worst disturbance.

    Where the dissipation inequality is an equality, d = g1ᵀV_xᵀ/γ² maximises V̇ − ½γ²|d|². It acts from the
    beginning and ends where V(x0) + ½γ²∫|d|² reaches the proved level.
    """
    amplitude = SHARE * start.amplitude
    x = path_start(certificate, start, amplitude)
    h, gamma, level = longest_run(solution) / 8.0 / SAMPLES, certificate.gamma, certificate.level
    first = float(solution.value(x))

    def rates(x: np.ndarray, on: bool) -> tuple[np.ndarray, np.ndarray]:
        f, g1, g2, _ = solution.exact_fields(x[None])
        d = g1[0].T @ solution.gradient(x) / gamma**2 if on else np.zeros(g1.shape[2])
        return f[0] + g1[0] @ d + g2[0] @ solution.inputs(x[None])[0], d

    rows, spent, on = list[tuple[float, Vector, Vector, float, float]](), 0.0, True
    for k in range(SAMPLES + 1):
        rate, d = rates(x, on)
        on = on and first + spent + 0.5 * gamma**2 * h * float(d @ d) < level
        if not on and d.any():
            rate, d = rates(x, on)
        rows.append((k * h, x, d, float(solution.value(x)), spent))
        a, da = rates(x + 0.5 * h * rate, on)
        b, db = rates(x + 0.5 * h * a, on)
        c, dc = rates(x + h * b, on)
        x = x + h / 6.0 * (rate + 2.0 * a + 2.0 * b + c)
        spent += 0.5 * gamma**2 * h / 6.0 * float(d @ d + 2.0 * da @ da + 2.0 * db @ db + dc @ dc)
    return WorstStep(start.rule, amplitude, *(np.array(column) for column in zip(*rows)))
