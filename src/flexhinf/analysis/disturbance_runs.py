"""Eq. (3) as a run: disturbances of a problem held between samples, z at the samples, V on the way."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis.batch import Rows
from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.errors import InvalidInput
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller, Loop, Samples, Trajectory
from flexhinf.plant import GeneralisedPlant, Law
from flexhinf.scalars import trace

#: Horizons count from where this share of ∫|d|² has passed: before, both integrals are rounding.
BEGUN = 1e-6


class Held(Samples):
    """Samples, each held until the next."""

    def __call__(self, t: Any) -> Any:
        """The last sample at or before the time."""
        place = np.searchsorted(self.times, np.asarray(t) * (1.0 + 1e-12), side="right") - 1
        return self.values[np.maximum(place, 0)]


@dataclass(frozen=True, eq=False)
class Attained:
    """One disturbance and the gain it attained from rest at the operating point: a lower bound of the loop's gain.

    Attributes
    ----------
    gain : float
        √(∫|z|²/∫|d|²), the largest over all horizons; infinite if the run diverged.
    energy : float
        ∫|d|².
    largest_value : float
        Largest V on the way; NaN for a law without a value, infinite if the run diverged.
    times, disturbance : (N,) and (N, k) arrays
        s; each sample held until the next.
    trajectory : Trajectory
        As far as it went.
    """

    gain: float
    energy: float
    largest_value: float
    times: np.ndarray = field(repr=False)
    disturbance: np.ndarray = field(repr=False)
    trajectory: Trajectory = field(repr=False)


class DisturbanceRuns:
    """Runs of a law's loop under the disturbances of its problem.

    Parameters
    ----------
    problem : GeneralisedPlant
        Its penalty is z, its disturbances are d: commands (as deviations from the operating point's) first.
    estimator : Estimator or None
        None feeds back the true state.
    period, horizon : float
        s.

    Raises
    ------
    InvalidInput
        If law and problem do not have the same states.
    """

    def __init__(
        self, problem: GeneralisedPlant, law: Law, estimator: Any, period: float, horizon: float
    ) -> None:
        if tuple(law.state_names) != tuple(problem.state_names):
            raise InvalidInput(
                "The law was not made for the problem's states.",
                f"expected {list(problem.state_names)}, got {list(law.state_names)}",
                "z and the law must mean the same integrals",
            )
        self.problem, self.law, self.period, self.horizon = problem, law, period, horizon
        self.loop = Loop(problem.plant, Controller(law, estimator, period))
        self.times = np.arange(round(horizon / period) + 1) * period
        self.commands = len(problem.integrate) if problem.command else 0

    @property
    def channels(self) -> int:
        """Number of disturbances."""
        return len(self.problem.disturbance_names)

    def within(self, d: np.ndarray) -> np.ndarray:
        """Samples (N, k) with commands that the joints' limits allow: what lies beyond is cut off."""
        controller, limits, found = self.loop.controller, self.problem.plant.limits, np.array(d, dtype=float)
        for i, name in enumerate(controller.tracked[: self.commands]):
            if name in limits:
                low, high = np.asarray(limits[name]) - controller.operating_reference[i]
                found[:, i] = np.clip(found[:, i], low, high)
        return found

    def run(self, d: np.ndarray) -> tuple[Trajectory, bool]:
        """The run with d (N, k) held between samples, and whether it came to its end."""
        controller, channels = self.loop.controller, self.problem.disturbances or ()
        commands: Any = None
        if self.commands:
            commands = Samples(self.times, controller.operating_reference + d[:, : self.commands])
        torques = {name: Held(self.times, d[:, self.commands + i]) for i, name in enumerate(channels)}
        n, law = len(controller.states), self.law
        run = self.loop.run(
            commands,
            torques or None,
            None,
            self.horizon,
            law.operating_point[:n],
            initial_input=law.operating_input,
        )
        return run, run.diverged_at is None

    def deviations(self, run: Trajectory, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x − x* with the integrals as the controller has them (N, n + k), and u − u* (N, m)."""
        controller, x = self.loop.controller, run.signals["state"]
        position = self.tracked(run)
        wanted = np.broadcast_to(controller.operating_reference, position.shape).copy()
        wanted[:, : self.commands] += d[: len(x), : self.commands]
        growth = self.period * (0.5 * (position[1:] + position[:-1]) - wanted[:-1])
        integral = np.vstack([np.zeros(position.shape[1]), np.cumsum(growth, axis=0)])
        states = [tuple(self.problem.plant.states).index(name) for name in controller.states]
        moved = np.hstack([x[:, states] - self.law.operating_point[: len(states)], integral])
        return moved, run.signals["input"] - self.law.operating_input

    def tracked(self, run: Trajectory) -> np.ndarray:
        """What the integrals are given at each sample, (N, k)."""
        controller = self.loop.controller
        kind = [
            (
                "output" if controller.estimator is not None and name in controller.measured else "estimate",
                name,
            )
            for name in controller.tracked
        ]
        columns = [run.signal(source, name) for source, name in kind]
        return np.column_stack(columns) if columns else np.zeros((len(run.time), 0))

    @cached_property
    def _penalty(self) -> Rows:
        """|h|² of a deviation (n,)."""
        problem = self.problem
        p, n = problem.plant.parameters, len(problem.state_names)

        def squared(x: Any, _: Any) -> Any:
            h = np.asarray(problem.penalty_output(x, p.named(p.vector())))
            return np.array([h @ h])

        return Rows(("penalty", problem), lambda: trace(squared, n, 0, name="penalty"))

    def cost(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """|z|² (N,) at deviations x (N, n) and u (N, m), and its derivatives by both."""
        with np.errstate(over="ignore", invalid="ignore"):
            h, by_x = self._penalty(x)
            priced = u @ self.problem.r2
            return h[:, 0] + (u * priced).sum(axis=1), by_x[:, 0], 2.0 * priced

    def attained(self, d: np.ndarray, solution: HJISolution | None = None) -> Attained:
        """Of samples d (N, k), commands cut off at the joints' limits; V is that of the law, or of a solution."""
        d = self.within(d)
        run, whole = self.run(d)
        x, u = self.deviations(run, d)
        z = self.cost(x, u)[0]
        energy = float((d[:-1] ** 2).sum()) * self.period
        if not (whole and np.all(np.isfinite(z))):
            return Attained(np.inf, energy, np.inf, self.times, d, run)
        outer = np.cumsum((d[:-1] ** 2).sum(axis=1))
        begun = outer > BEGUN * outer[-1]
        ratio = np.cumsum(0.5 * (z[1:] + z[:-1]))[begun] / outer[begun]
        value = self.law if solution is None else solution
        largest = (
            float(np.max(value.value_and_gradient(x)[0])) if isinstance(value, HJISolution) else float("nan")
        )
        return Attained(float(np.sqrt(ratio.max())), energy, largest, self.times, d, run)

    # Small motions -------------------------------------------------------------------------------------
    @cached_property
    def equilibrium_loop(self) -> EquilibriumLoop:
        """The loop in equilibrium at the operating point, an estimator at its stationary gain."""
        controller = self.loop.controller
        return EquilibriumLoop(self.law, controller.estimator, self.problem.plant, self.period)
