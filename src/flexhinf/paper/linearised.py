"""The sampled closed loop linearised where it rests: whether it is stable, and how fast it grows or decays.

What is differentiated is the very step that the compiled loop runs (measure, correct, integrate, law, time
update, then the true plant over one period with u held), with one change: the estimator corrects with its
stationary gain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from flexhinf.codegen import Kernel
from flexhinf.errors import NumericalFailure
from flexhinf.estimation import ConstantGainFilter, RecursiveFilter, linear_model, stationary_gain
from flexhinf.loop import Controller, Loop
from flexhinf.loop.program import measure_function
from flexhinf.loop.shared import share
from flexhinf.paper.rows import compile_rows, one_period, slopes_in_rows
from flexhinf.plant import Law, Plant
from flexhinf.plant.equilibrium import equilibrium
from flexhinf.scalars import trace

__all__ = ["Modes", "RestingLoop"]

#: Newton steps towards the rest of the loop at most, and the relative size of the last one.
ITERATIONS, LAST_STEP = 12, 1e-7

#: Where the integral that holds the goal is looked for, rad·s.
INTEGRALS = np.linspace(-30.0, 30.0, 601)

INTEGRAL = "_integral"


@dataclass(frozen=True)
class Modes:
    """Multipliers of one period, for N true plants.

    Attributes
    ----------
    period : float
    rest : (N, k) array
        State of the loop at rest (true plant, then what the controller remembers); NaN where there is none.
    multipliers : (N, k) complex array
        Eigenvalues of one period; infinite where the loop has no rest.
    """

    period: float
    rest: np.ndarray
    multipliers: np.ndarray

    @property
    def radius(self) -> np.ndarray:
        """Largest |multiplier|, (N,)."""
        return np.abs(self.multipliers).max(axis=1)

    @property
    def stable(self) -> np.ndarray:
        """Which loops are stable, (N,)."""
        return self.radius < 1.0

    @property
    def rate(self) -> np.ndarray:
        """log(radius) / period, (N,) in 1/s: positive for a loop that grows, infinite for one without."""
        return np.log(self.radius) / self.period

    def slowest(self, count: int) -> np.ndarray:
        """The `count` slowest exponents log(multiplier) / period, (N, count) in 1/s."""
        order = np.argsort(-np.abs(self.multipliers), axis=1, kind="stable")[:, :count]
        chosen = np.take_along_axis(self.multipliers, order, axis=1)
        with np.errstate(invalid="ignore"):
            return np.log(chosen) / self.period


class RestingLoop:
    """A law with an estimator at its stationary gain, or fed back the true state, at rest at a goal.

    Parameters
    ----------
    law : Law
    filter : RecursiveFilter or None
        None feeds back the true state.
    true_plant : Plant
        Its parameters are given to `modes`.
    period, goal : float
        s; wanted value of the tracked state.
    """

    def __init__(
        self, law: Law, filter: RecursiveFilter | None, true_plant: Plant, period: float, goal: float
    ) -> None:
        self.law, self.filter, self.plant, self.period, self.goal = law, filter, true_plant, period, goal
        tracked = [name.removesuffix(INTEGRAL) for name in law.state_names if name.endswith(INTEGRAL)]
        model = true_plant if filter is None else filter.plant
        self.model_rest = equilibrium(model, tracked, np.array([goal]))
        self.plant_rest = equilibrium(true_plant, tracked, np.array([goal]))
        steady: Any = None if filter is None else ConstantGainFilter(filter, self.gain(filter.process_noise))
        self.controller = Controller(law, steady, period)
        self.sub_steps = Loop(true_plant, self.controller).sub_steps

    @cached_property
    def _model(self) -> tuple[np.ndarray, np.ndarray]:
        assert self.filter is not None
        return linear_model(self.filter, *self.model_rest)

    def gain(self, process_noise: np.ndarray) -> np.ndarray:
        """The estimator's stationary gain (n, p) at the goal for this R^v (n, n)."""
        assert self.filter is not None
        return stationary_gain(self._model, process_noise, self.filter.measurement_noise)

    # One period ----------------------------------------------------------------------------------------
    @cached_property
    def _places(self) -> dict[str, np.ndarray]:
        """Where in the controller's memory the parts are.

        "moving" leaves out the gain, the command and the flag of the first step.
        """
        memory = self.controller.memory
        named = vars(memory.named(np.arange(memory.size)))
        moving = [named["u"], named["integral"], named["position"]]
        if self.filter is not None:
            moving.append(named["belief"][0])
            named["gain"] = named["belief"][1].ravel()
        return {**named, "moving": np.sort(np.concatenate(moving))}

    @cached_property
    def _control(self) -> Kernel:
        """(moving part z, p, memory, data) → u and the controller's moving part after, with their Jacobians."""
        key = ("control at rest", self.plant.code_key, self.controller.code_key, self.period)
        return share(key, lambda: compile_rows(self._traced_control(), ("memory", "data")))

    def _traced_control(self) -> ca.Function:
        plant, controller, places = self.plant, self.controller, self._places
        moving, n = places["moving"].tolist(), plant.n
        z, p = ca.SX.sym("z", n + len(moving)), ca.SX.sym("p", plant.parameters.size)
        fixed, data = ca.SX.sym("memory", controller.memory.size), ca.SX.sym("data", controller.data.size)
        memory, noise = ca.SX(fixed), ca.SX.zeros(len(controller.measured))
        memory[moving] = z[n:]
        # The output does not see the sub-step's length, the first number of `truth`.
        y = measure_function(plant, controller)(
            z[:n], memory[places["u"].tolist()], noise, ca.vertcat(0.0, p)
        )
        u, _, after = controller.traced(y, memory[places["reference"].tolist()], memory, data)
        later = after[moving]
        results = [u, later, slopes_in_rows(ca.jacobian(u, z)), slopes_in_rows(ca.jacobian(later, z))]
        names = (["z", "p", "memory", "data"], ["u", "after", "u_slope", "after_slope"])
        return ca.Function("control_at_rest", [z, p, fixed, data], results, *names, {"cse": True})

    def _period(
        self, z: np.ndarray, vectors: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """z (N, k) one period later, and the Jacobian (N, k, k)."""
        (count, k), n, m = z.shape, self.plant.n, len(self.plant.inputs)
        sizes = {"u": m, "after": k - n, "u_slope": m * k, "after_slope": (k - n) * k}
        arrays = {"z": z, "p": vectors, "memory": memory, "data": self.controller.data_vector}
        arrays |= {name: np.zeros((count, size)) for name, size in sizes.items()}
        arrays = {name: np.ascontiguousarray(array).ravel() for name, array in arrays.items()}
        self._control.run(arrays, {"rows": count})
        u, by_z = arrays["u"].reshape(count, m), arrays["u_slope"].reshape(count, m, k)
        x, by_state, by_input = one_period(self.plant, self.period, self.sub_steps, z[:, :n], u, vectors)
        slope = np.empty((count, k, k))
        slope[:, :n] = by_input @ by_z
        slope[:, :n, :n] += by_state
        slope[:, n:] = arrays["after_slope"].reshape(count, k - n, k)
        return np.hstack([x, arrays["after"].reshape(count, k - n)]), slope

    # Rest ----------------------------------------------------------------------------------------------
    @cached_property
    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """(moving part, whole memory) where the nominal plant is held at the goal.

        Raises
        ------
        NumericalFailure
            If no integral makes the law give the voltage that holds the goal.
        """
        (x, u), goal = self.model_rest, np.array([self.goal])
        parts: dict[str, Any] = {
            "u": u,
            "integral": self._integral(),
            "position": goal,
            "reference": goal,
            "started": 1.0,
        }
        if self.filter is not None:
            parts["belief"] = [x, self.controller.estimator.initial[1]]  # type: ignore[union-attr,index]
        memory = self.controller.memory.flat(parts)
        return np.concatenate([self.plant_rest[0], memory[self._places["moving"]]]), memory

    def _integral(self) -> float:
        """Of the integrals that hold the nominal plant at the goal, the one nearest to zero."""
        states, u = (
            self.plant_rest[0][[self.plant.index(name) for name in self.controller.states]],
            self.model_rest[1],
        )
        points = np.column_stack([np.tile(states, (len(INTEGRALS), 1)), INTEGRALS]) - self.law.operating_point
        numbers = np.ravel(self.law.law_data)
        key = ("law", self.law.law_key, points.shape[1], numbers.size)
        law = share(key, lambda: trace(self.law.evaluate_law, points.shape[1], numbers.size, name="law"))
        held_by = np.asarray(law(points.T, np.repeat(numbers[:, None], len(points), axis=1)), dtype=float)[0]
        excess = np.sign(held_by + self.law.operating_input[0] - u[0])
        crossings = np.flatnonzero(excess[1:] != excess[:-1])
        if not len(crossings):
            raise NumericalFailure(
                "The law does not hold the arm at the goal.",
                f"no integral up to {INTEGRALS[-1]:g} rad·s gives {u[0]:.6g} V at {self.goal:.6g} rad",
                "another degree",
            )
        return float(INTEGRALS[crossings[np.argmin(np.abs(INTEGRALS[crossings]))]])

    def modes(
        self, values: Sequence[Mapping[str, float]] | np.ndarray, process_noise: np.ndarray | None = None
    ) -> Modes:
        """Rest and multipliers with these true plants.

        Parameters
        ----------
        values : sequence of mapping by name, or (N, p) array in the order of the true plant's parameters
            Names that are left out keep their nominal value.
        process_noise : (n, n) array, optional
            R^v instead of the filter's.
        """
        vectors = values if isinstance(values, np.ndarray) else self.vectors(values)
        try:
            start, memory = self.start
        except NumericalFailure:
            return self._judged(
                np.full((len(vectors), self.plant.n + 1), np.nan), np.zeros(0), np.zeros(len(vectors), bool)
            )
        if process_noise is not None:
            memory = memory.copy()
            memory[self._places["gain"]] = self.gain(process_noise).ravel()
        return self._judged(*self._newton(np.tile(start, (len(vectors), 1)), vectors, memory))

    def vectors(self, values: Sequence[Mapping[str, float]]) -> np.ndarray:
        """Parameter vectors (N, p) of true plants with these values."""
        nominal = {name: float(value) for name, value in self.plant.parameters.values.items()}
        return np.array([[{**nominal, **v}[name] for name in nominal] for v in values])

    def _newton(
        self, z: np.ndarray, vectors: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(rest, Jacobian there, whether it was found), all plants at once."""
        count, k = z.shape
        slope, size = np.zeros((count, k, k)), np.full(count, np.inf)
        for _ in range(ITERATIONS):
            later, slope = self._period(z, vectors, memory)
            flat, gap = slope.reshape(count, -1), later - z
            fine = np.isfinite(flat).all(axis=1) & np.isfinite(gap).all(axis=1)
            size[~fine] = np.inf
            if not fine.any() or np.all(size[fine] <= LAST_STEP):
                break
            try:
                move = np.linalg.solve((np.eye(k) - slope)[fine], gap[fine][:, :, None])[:, :, 0]
            except np.linalg.LinAlgError:
                break
            z[fine] += move
            size[fine] = np.abs(move).max(axis=1) / np.maximum(1.0, np.abs(z[fine]).max(axis=1))
        return z, slope, size <= LAST_STEP

    def _judged(self, z: np.ndarray, slope: np.ndarray, found: np.ndarray) -> Modes:
        multipliers = np.full(z.shape, np.inf, dtype=complex)
        if found.any():
            multipliers[found] = np.linalg.eigvals(slope[found])
        return Modes(self.period, np.where(found[:, None], z, np.nan), multipliers)
