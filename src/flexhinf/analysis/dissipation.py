"""Dissipation budget of a run: how much of a level set is used up by everything that is not the exact law.

A plant driven by u = u* + k(x − x*, e) + v instead of the law alone obeys, wherever the dissipation inequality holds,

    V̇ ≤ ½ γ²|d|² − ½ |z|² + ½ vᵀ R2 v

(complete the square in v). So as long as V(x0) + ½ γ² ∫|d|² + ½ ∫ vᵀ R2 v ≤ c, the state stays in {V ≤ c} with the
gain that was checked there. v stands for all of sampling, delay, estimator, limits of the input and noise, and is
known afterwards, where the true state is.

Between two samples u is held and the law moves on with the state: v is taken at both ends of every period, with the
input that acts in it, and as a straight line in between, whose square is integrated exactly. The error is a share of
the run of the order of the period over its shortest time constant (0.1 % for the paper's arm at 1 ms).

e is the problem's integral, ė = x_i − r of the true state. The controller's own may differ: it stands still while the
input is limited, and integrates noise. Its initial value is free, so e is chosen to agree with the controller's
integral at the end of the run: what limits changed on the way is spent before, and V(x0) is that of this e.

At the corners of the tolerances the inequality is checked for the linear part. A law of `solve_hji` with the storage V
= ½ xᵀ P x to second order and the gain u = K x keeps

    V̇ ≤ ½ γ²|d|² − ½ |z|²   for all x and d   ⟺   Q = P A_K + A_Kᵀ P + CᵀC + Kᵀ R2 K + γ⁻² P B1 B1ᵀ P ≤ 0,

A_K = A + B2 K with the matrices of the true robot at its own equilibrium (complete the square in d). For the robot
that the law was made for, Q = 0 or below. At a corner of the tolerances it is one eigenvalue problem: no linear matrix
inequality has to be solved, as P and K are given. A synthesis that covers each tolerance alone need not cover products
of them, such as m·g·l or k_t/R; here all of them act.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.analysis.corners import Corners, ParametersAt, Population, corner_plants
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller, Loop, Trajectory
from flexhinf.loop.controller.options import checked_latency
from flexhinf.plant import Estimator, GeneralisedPlant, Law, Plant
from flexhinf.plant.parameters import ParameterValues

#: Deviations of a command or torque below this are none.
NONE = 1e-12


@dataclass(frozen=True, eq=False)
class DissipationBudget:
    """The budget along one run, which assumes the law's own plant as the true one."""

    times: np.ndarray  # (N,), s
    level: float  # c of {V ≤ c}; infinite if none was given
    start: float  # V at the first sample
    spent: np.ndarray  # (N,), ½ ∫ vᵀ R2 v until each sample
    disturbance: np.ndarray  # (N,), ½ γ² ∫|d|²
    value: np.ndarray  # (N,), V
    complete: bool  # whether the run came to its end

    @property
    def total(self) -> float:
        """½ ∫ vᵀ R2 v of the whole run; infinite if it diverged."""
        return float(self.spent[-1]) if self.complete else float("inf")

    @property
    def left(self) -> float:
        """c − V(x0) − ½ γ² ∫|d|² − ½ ∫ vᵀ R2 v; negative if more was spent than there was."""
        return float(self.level - self.start - self.disturbance[-1] - self.total)

    @property
    def kept(self) -> bool:
        """Whether the run stayed within its budget."""
        return self.left >= 0.0


def dissipation_budget(
    run: Trajectory, loop: Loop, level: float = np.inf, initial_input: ArrayLike | None = None
) -> DissipationBudget:
    """The budget of a run of a loop about its law's operating point; the loop is that which made it.

    `level` is c, for example ``solution.sampled_region().level``, and `initial_input` (m,) as given to `Loop.run`. A
    law without a value function V (as a solution of `solve_hji` has), a run whose true state is not known, and
    disturbances that the problem does not know are refused.
    """
    controller, law = loop.controller, loop.controller.law
    if not isinstance(law, HJISolution):
        raise InvalidInput(
            "The law has no value function to keep below a level.",
            f"got {type(law).__name__}",
            "a solution of solve_hji or linear_law",
        )
    states = tuple(run.names["state"])
    refuse_if(
        not set(controller.states) <= set(states),
        "The true state of the run is not known.",
        f"expected {list(controller.states)}, got {list(states)}",
        "a loop round a Plant",
    )
    x = run.signals["state"][:, [states.index(name) for name in controller.states]]
    before = controller.input_before(initial_input)
    moved = np.hstack([x, _integrals(run, controller, x, before)]) - law.operating_point
    with np.errstate(all="ignore"):  # a run that diverges is not complete
        value, wanted = law.value_and_gradient(moved)[0], law.operating_input + law.inputs(moved)
    applied = np.vstack([np.tile(before, (loop.channel.delay, 1)), run.signals["input"]])[: len(x) - 1]
    first, last = applied - wanted[:-1], applied - wanted[1:]
    r2, period = law.expansion.r2, controller.period
    ends = ((first, first), (first, last), (last, last))
    spent = 0.5 * period / 3.0 * sum(np.einsum("ki,ij,kj->k", a, r2, b) for a, b in ends)
    d = _disturbances(run, controller, law.problem)[:-1]
    energy = 0.5 * law.gamma**2 * period * (d**2).sum(axis=1) if d.any() else np.zeros(len(d))
    spent, energy = (np.concatenate([[0.0], np.cumsum(parts)]) for parts in (spent, energy))
    complete = bool(np.all(np.isfinite(spent)) and np.all(np.isfinite(value)))
    return DissipationBudget(run.time, float(level), float(value[0]), spent, energy, value, complete)


def _integrals(run: Trajectory, controller: Controller, x: np.ndarray, before: np.ndarray) -> np.ndarray:
    places = [controller.states.index(name) for name in controller.tracked]
    position, reference = x[:, places], run.signals["reference"]
    if controller.mode.moving:
        away = np.abs(reference - controller.operating_reference).max()
        refuse_if(
            not away <= NONE,
            "The reference moves: level sets are about the operating point.",
            f"got up to {away:.3g} from it",
            "a run at the operating point, or moving=False",
        )
        reference = reference[:, places]
    growth = controller.period * (0.5 * (position[1:] + position[:-1]) - reference[:-1])
    whole = np.vstack([np.zeros((1, len(places))), np.cumsum(growth, axis=0)])
    own = controller.fresh()  # given again what it was given
    own.reset(input=before)
    for y, r in zip(run.signals["output"], run.signals["reference"], strict=True):
        own.step(y, r if own.commanded else None)
    return whole - whole[-1] + own.integrals  # of the true state, equal to the controller's at the end


def _disturbances(run: Trajectory, controller: Controller, problem: object) -> np.ndarray:
    names = problem.disturbance_names if isinstance(problem, GeneralisedPlant) else ()
    columns = {name: run.signals["disturbance"][:, i] for i, name in enumerate(run.names["disturbance"])}
    if not controller.mode.moving:
        reference = run.signals["reference"] - controller.operating_reference
        columns |= {f"{name}_command": reference[:, i] for i, name in enumerate(controller.tracked)}
    foreign = [name for name, column in columns.items() if name not in names and np.abs(column).max() > NONE]
    if foreign:
        raise InvalidInput(
            f"The run was disturbed by {foreign[0]!r}, which the law's problem does not know.",
            f"expected disturbances out of {list(names)}",
            "a problem with this disturbance, or a run without it",
        )
    return np.column_stack([columns.get(name, np.zeros(len(run.time))) for name in names or ("none",)])


@dataclass(frozen=True, eq=False)
class BudgetTerm:
    """One row of a budget: the loop with the effects of all rows above and one more, "sampling", "delay", "estimator"
    or "saturation".

    `added` is ½ ∫ vᵀ R2 v more than in the row above; infinite if the loop diverged.
    """

    name: str
    budget: DissipationBudget
    added: float


def budget_terms(
    law: Law,
    plant: Plant,
    period: float = 1e-3,
    level: float = np.inf,
    *,
    latency: int | None = None,
    delay: float | None = None,
    estimator: Estimator | None = None,
    saturation: Any = None,
    start: str = "zero",
    **run: Any,
) -> tuple[BudgetTerm, ...]:
    """Run the same law with the exact state at the samples, then with delay, estimator and limits added in turn.

    The law has a value function, and the plant is its own: a budget says nothing of another. Period and delay are in
    s, the delay a whole number of periods; None leaves a row out. The estimator knows the `latency`, samples that come
    on top of the delay; before it is added, nothing does. `level` is c of {V ≤ c}; `estimator`, `saturation`
    and `start` are as of `flexhinf.loop.Controller`, `run` as of `Loop.run`, with noise only where the estimator is.
    What does not fit is refused as by `dissipation_budget`.
    """
    rows: list[BudgetTerm] = []
    latency = checked_latency(latency, estimator)
    late = latency * period + (delay or 0.0)
    added = {"sampling": True, "delay": late or delay, "estimator": estimator, "saturation": saturation}
    so_far: dict[str, Any] = {}
    for name, part in added.items():
        if part is None:
            continue
        so_far[name] = part
        observer = so_far.get("estimator")
        known = 0 if observer is None else latency
        controller = Controller(law, observer, period, so_far.get("saturation"), start=start, latency=known)
        loop = Loop(plant, controller, delay=so_far.get("delay", 0.0) - known * period)
        arguments: dict[str, Any] = {**run, "noise": run.get("noise") if observer is not None else None}
        trajectory = loop.run(**arguments)
        if trajectory.diverged_at is None:
            budget = dissipation_budget(trajectory, loop, level, run.get("initial_input"))
        else:  # it has spent everything
            nan = np.full(len(trajectory.time), np.nan)
            budget = DissipationBudget(trajectory.time, float(level), float("nan"), nan, nan, nan, False)
        above = rows[-1].budget.total if rows else 0.0
        rows.append(BudgetTerm(name, budget, budget.total - above if np.isfinite(above) else float("inf")))
    return tuple(rows)


#: Eigenvalues of Q below this share of its terms are rounding: Q = 0 for the robot of a nominal synthesis.
ROUNDING = 1e-8


@dataclass(frozen=True, eq=False, repr=False)
class DissipationCorners(Corners):
    """By how much the inequality with this γ fails at the corners.

    `excess` (N + 1,) is the largest eigenvalue of D⁻¹ Q D⁻¹ for each plant, 1/s, with D = diag(P)^½: positive where V̇
    may exceed ½ γ²|d|² − ½ |z|², by up to ½ excess Σ P_ii x_i²; what is rounding is zero.
    """

    excess: np.ndarray
    gamma: float

    def __repr__(self) -> str:
        return f"DissipationCorners({self.failing} of {self.count} corners fail at gamma = {self.gamma:.6g})"

    @property
    def failing(self) -> int:
        """Corners at which the inequality does not hold."""
        return int((self.excess[:-1] > 0.0).sum())

    @property
    def worst(self) -> int:
        """The corner with the largest excess."""
        return int(np.argmax(self.excess[:-1]))


@dataclass(frozen=True, eq=False)
class LinearCorners:
    """A problem's plant linearised at the corners of the tolerances, each at its own equilibrium; see `Corners`.

    The problem's d and z are meant; ẋ = A x + B1 d + B2 u with integrals, of (N, n, n), (N, n, k) and (N, n, m)
    arrays.
    """

    problem: GeneralisedPlant
    population: Population
    complete: bool
    a: np.ndarray
    b1: np.ndarray
    b2: np.ndarray

    @staticmethod
    def of(
        problem: GeneralisedPlant,
        at: ParametersAt,
        uncertain: int | Sequence[object],
        equilibrium: Callable[[ParameterValues], tuple[np.ndarray, np.ndarray]],
        seed: int = 0,
    ) -> LinearCorners:
        """All corners of up to 12 uncertain numbers, samples of the corners of more; see `dissipation_corners`."""
        (population, complete), plant = corner_plants(0, at, uncertain, seed), problem.plant
        plant.trace_jacobians()  # once: the plants of all corners share them
        expansion, count = problem.expand(1), len(population)
        nominal = (expansion.f_parts[1], expansion.g1_parts[0][:, :, 0], expansion.g2_parts[0][:, :, 0])
        a, b1, b2 = (np.tile(matrix, (count, 1, 1)) for matrix in nominal)
        names, n = tuple(problem.disturbance_names), plant.n
        torques = [k for k, name in enumerate(names) if name in plant.disturbances]
        places = [tuple(plant.disturbances).index(names[k]) for k in torques]
        for k, values in enumerate(population.values):
            known = plant.parameters.known(values)
            state, inputs, disturbed, _ = plant.with_parameters(**known).linearise(*equilibrium(known))
            a[k, :n, :n], b2[k, :n] = state, inputs
            b1[k, :n][:, torques] = disturbed[:, places]
        return LinearCorners(problem, population, complete, a, b1, b2)

    def dissipation(self, storage: np.ndarray, gain: np.ndarray, gamma: float) -> DissipationCorners:
        """The inequality with V = ½ xᵀ P x (n, n), u = K x (m, n) and γ at every corner."""
        c, r2 = self.problem.expand(1).h_parts[1], self.problem.r2
        scale = 1.0 / np.sqrt(np.diag(storage))
        moved, driven = storage @ (self.a + self.b2 @ gain), storage @ self.b1
        terms = (
            moved + np.swapaxes(moved, 1, 2),
            np.broadcast_to(c.T @ c + gain.T @ r2 @ gain, self.a.shape),
            driven @ np.swapaxes(driven, 1, 2) / gamma**2,
        )
        scaled = [scale[:, None] * term * scale for term in terms]
        size = sum(np.linalg.norm(term, 2, axis=(1, 2)) for term in scaled)
        excess = np.linalg.eigvalsh(np.sum(scaled, axis=0))[:, -1]
        return DissipationCorners(
            self.population, self.complete, np.where(excess > ROUNDING * size, excess, 0.0), float(gamma)
        )


def dissipation_corners(
    solution: HJISolution,
    problem: GeneralisedPlant,
    at: ParametersAt,
    uncertain: int | Sequence[object],
    equilibrium: Callable[[ParameterValues], tuple[np.ndarray, np.ndarray]],
    *,
    gamma: float | None = None,
    seed: int = 0,
) -> DissipationCorners:
    """Check the linear part of the inequality at all corners of up to 12 uncertain numbers, at sampled ones of more.

    P, K and γ (unless another `gamma` is given) are the solution's, which may come of another problem of the same
    states (else it is refused), with tolerance channels; d and z are the problem's, whose plant is changed. `at`,
    `uncertain` and `seed` are as for `tolerance_corners`, and `equilibrium` takes parameters to (x, u) where the plant
    with these is held at the goal: ``lambda values: robot.operating_point(goal, parameters=values)``.
    """
    refuse_if(
        tuple(solution.state_names) != tuple(problem.state_names),
        "The solution was not made for the problem's states.",
        f"expected {list(problem.state_names)}, got {list(solution.state_names)}",
        "the problem whose d and z are meant, with the same integrals",
    )
    linear = LinearCorners.of(problem, at, uncertain, equilibrium, seed)
    return linear.dissipation(solution.P, solution.gain, solution.gamma if gamma is None else gamma)
