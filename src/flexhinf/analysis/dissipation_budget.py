"""What a run spends of its level set: the budget of everything that is not the exact law.

A plant driven by u = u* + k(x − x*, e) + v instead of the law alone obeys, wherever the dissipation inequality holds,

    V̇ ≤ ½ γ²|d|² − ½ |z|² + ½ vᵀ R2 v

(complete the square in v). So as long as V(x0) + ½ γ² ∫|d|² + ½ ∫ vᵀ R2 v ≤ c, the state stays in {V ≤ c} with the
gain that was checked there. v stands for all of sampling, delay, estimator, limits of the input and noise, and is
known afterwards, where the true state is.

Between two samples u is held and the law moves on with the state: v is taken at both ends of every period, with the
input that acts in it, and as a straight line in between, whose square is integrated exactly. What that leaves of a run
is a share of the order of the period over its shortest time constant (0.1 % for the paper's arm at 1 ms).

e is the problem's integral, ė = x_i − r of the true state. The controller's own may differ: it stands still while the
input is limited, and integrates noise. Its start is ours to choose, so e agrees with the controller's integral at the
end of the run: what limits changed on the way is spent before, and V(x0) is that of this e.

What sampling, delay, estimator and limits spend of a level set, one after the other in the same loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller, Loop, Trajectory
from flexhinf.plant import GeneralisedPlant, Law, Plant

#: Deviations of a command or torque below this are none.
NONE = 1e-12


@dataclass(frozen=True, eq=False)
class DissipationBudget:
    """The budget along one run, which assumes the law's own plant as the true one.

    Attributes
    ----------
    times : (N,) array
        s.
    level : float
        c of {V ≤ c}; infinite if none was given.
    start : float
        V at the first sample.
    spent, disturbance : (N,) arrays
        ½ ∫ vᵀ R2 v and ½ γ² ∫|d|² until each sample.
    value : (N,) array
        V at each sample.
    complete : bool
        Whether the run came to its end.
    """

    times: np.ndarray
    level: float
    start: float
    spent: np.ndarray
    disturbance: np.ndarray
    value: np.ndarray
    complete: bool

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
        """Whether the budget lasted."""
        return self.left >= 0.0


def dissipation_budget(
    run: Trajectory, loop: Loop, level: float = np.inf, initial_input: Any = None
) -> DissipationBudget:
    """The budget of a run of a loop about its law's operating point.

    Parameters
    ----------
    loop : Loop
        That made it; its law has a value function V, as a solution of `solve_hji`.
    level : float
        c, for example ``solution.sampled_region().level``.
    initial_input : (m,) array, optional
        As given to `Loop.run`.

    Raises
    ------
    InvalidInput
        If the law has no V, the true state is not known, or something disturbs that the problem does not know.
    """
    law, controller = _checked(loop), loop.controller
    states = tuple(run.names["state"])
    if not set(controller.states) <= set(states):
        raise InvalidInput(
            "The true state of the run is not known.", f"expected {list(controller.states)}, got {list(states)}",
            "a loop round a Plant",
        )  # fmt: skip
    x = run.signals["state"][:, [states.index(name) for name in controller.states]]
    before = controller.input_before(initial_input)
    integral = _integrals(run, controller, x, before)
    moved = np.hstack([x, integral]) - law.operating_point
    with np.errstate(all="ignore"):  # a run that diverges is not complete
        value, wanted = law.value_and_gradient(moved)[0], law.operating_input + law.inputs(moved)
    late = loop.channel.delay
    applied = np.vstack([np.tile(before, (late, 1)), run.signals["input"]])[: len(x) - 1]
    first, last = applied - wanted[:-1], applied - wanted[1:]
    r2, period = law.expansion.r2, controller.period
    square = lambda a, b: np.einsum("ki,ij,kj->k", a, r2, b)  # noqa: E731
    spent = 0.5 * period / 3.0 * (square(first, first) + square(first, last) + square(last, last))
    d = _disturbances(run, loop, law)[:-1]
    energy = 0.5 * law.gamma**2 * period * (d**2).sum(axis=1) if d.any() else np.zeros(len(d))
    spent, energy = _running(spent), _running(energy)
    complete = bool(np.all(np.isfinite(spent)) and np.all(np.isfinite(value)))
    return DissipationBudget(run.time, float(level), float(value[0]), spent, energy, value, complete)


def _running(parts: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(parts)])


def _checked(loop: Loop) -> HJISolution:
    law = loop.controller.law
    if not isinstance(law, HJISolution):
        raise InvalidInput(
            "The law has no value function to keep below a level.",
            f"got {type(law).__name__}",
            "a solution of solve_hji or linear_law",
        )
    return law


def _integrals(run: Trajectory, controller: Controller, x: np.ndarray, before: np.ndarray) -> np.ndarray:
    """The problem's integrals (N, k) of the true state, equal to the controller's at the end."""
    names, mode = controller.tracked, controller.mode
    reference = run.signals["reference"]
    if mode.moving:
        still = np.abs(reference - controller.operating_reference).max() <= NONE
        if not still:
            raise InvalidInput(
                "The reference moves: level sets are about the operating point.",
                f"got up to {np.abs(reference - controller.operating_reference).max():.3g} from it",
                "a run at the operating point, or moving=False",
            )
        reference = reference[:, [controller.states.index(name) for name in names]]
    position = x[:, [controller.states.index(name) for name in names]]
    growth = controller.period * (0.5 * (position[1:] + position[:-1]) - reference[:-1])
    whole = np.vstack([np.zeros((1, len(names))), np.cumsum(growth, axis=0)])
    return whole - whole[-1] + _own_integrals(run, controller, before)


def _own_integrals(run: Trajectory, controller: Controller, before: np.ndarray) -> np.ndarray:
    """The controller's integrals (k,) at the last sample: it is given again what it was given."""
    again = controller.fresh()
    again.reset(input=before)
    reference = run.signals["reference"]
    for y, r in zip(run.signals["output"], reference, strict=True):
        again.step(y, r if again.commanded else None)
    return again.integrals


def _disturbances(run: Trajectory, loop: Loop, law: Any) -> np.ndarray:
    """d of the problem at each sample (N, md), as the run was given it."""
    problem, controller = law.problem, loop.controller
    names = problem.disturbance_names if isinstance(problem, GeneralisedPlant) else ()
    commands = [name for name in controller.tracked if f"{name}_command" in names]
    reference = run.signals["reference"] - controller.operating_reference
    columns = {name: run.signals["disturbance"][:, i] for i, name in enumerate(run.names["disturbance"])}
    if not controller.mode.moving:
        columns |= {f"{name}_command": reference[:, i] for i, name in enumerate(controller.tracked)}
    foreign = [name for name, column in columns.items() if name not in names and np.abs(column).max() > NONE]
    if foreign:
        raise InvalidInput(
            f"The run was disturbed by {foreign[0]!r}, which the law's problem does not know.",
            f"expected disturbances out of {list(names)}{' (commands too)' if commands else ''}",
            "a problem with this disturbance, or a run without it",
        )
    return np.column_stack([columns.get(name, np.zeros(len(run.time))) for name in names or ("none",)])


@dataclass(frozen=True, eq=False)
class BudgetTerm:
    """One row: the loop with all that stands in the rows above, and this.

    Attributes
    ----------
    name : str
        "sampling", "delay", "estimator", "saturation".
    budget : DissipationBudget
        Of this loop.
    added : float
        ½ ∫ vᵀ R2 v more than in the row above; infinite if the loop diverged.
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
    delay: float | None = None,
    estimator: Any = None,
    saturation: Any = None,
    start: str = "zero",
    **run: Any,
) -> tuple[BudgetTerm, ...]:
    """Run the same law with the exact state at the samples, then with delay, estimator and limits added in turn.

    Parameters
    ----------
    law : Law
        With a value function: a solution of `solve_hji`.
    plant : Plant
        The law's own: a budget says nothing of another.
    period, delay : float
        s; the delay a whole number of periods. None leaves the row out, as for the following.
    level : float
        c of {V ≤ c}.
    estimator, saturation, start
        As of `flexhinf.loop.Controller`.
    **run
        As of `Loop.run`: initial_state, duration, noise, …; the noise only where the estimator is.

    Raises
    ------
    InvalidInput
        As `dissipation_budget`, and if something does not fit.
    """
    rows: list[BudgetTerm] = []
    added = {"sampling": True, "delay": delay, "estimator": estimator, "saturation": saturation}
    so_far: dict[str, Any] = {}
    for name, part in added.items():
        if part is None:
            continue
        so_far[name] = part
        observer = so_far.get("estimator")
        controller = Controller(law, observer, period, so_far.get("saturation"), start=start)
        loop = Loop(plant, controller, delay=so_far.get("delay", 0.0))
        settings = {**run, "noise": run.get("noise") if observer is not None else None}
        found = _budget_of(loop, level, settings)
        above = rows[-1].budget.total if rows else 0.0
        more = found.total - above if np.isfinite(above) else float("inf")
        rows.append(BudgetTerm(name, found, more))
    return tuple(rows)


def _budget_of(loop: Loop, level: float, settings: dict[str, Any]) -> DissipationBudget:
    """Of one run; one that diverged has spent everything."""
    given = settings.get("initial_input")
    run = loop.run(**settings)
    if run.diverged_at is None:
        return dissipation_budget(run, loop, level, given)
    nothing = np.full(len(run.time), np.nan)
    return DissipationBudget(run.time, float(level), float("nan"), nothing, nothing, nothing, False)
