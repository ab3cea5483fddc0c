"""The sampled closed loop linearised at its equilibrium: whether it is stable, and how fast it grows or decays.

The derivatives are those of the step that the compiled loop runs (measure, correct, integrate, law, time update, then
the true plant over one period with u held), with two changes: the estimator corrects with its stationary gain, and the
input has no limits.

Also the frequency response of the running loop: sampled, with its estimator and its own delay.
"""

# Not checked strictly: what a caller passes may be of another type than stated; parts of arrays have none.
# pyright: reportUnknownArgumentType=false, reportUnnecessaryIsInstance=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.analysis.linear_loop import LinearLoop, Modes, with_queue
from flexhinf.analysis.sampled_controller import (
    DerivativeRows,
    SampledController,
    StepDerivatives,
    check_states,
    equilibrium_integrals,
    model_rows,
    near_equilibrium,
    solved,
)
from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.estimation import (
    ConstantGainFilter,
    ModalFilter,
    OutputInjectionObserver,
    RecursiveFilter,
    stationary_gain,
)
from flexhinf.loop import Loop
from flexhinf.loop.controller.options import checked_latency
from flexhinf.loop.simulation.program import LONGEST_LINEAR, check_delay
from flexhinf.plant import Estimator, Law, Plant, equilibrium as plant_equilibrium
from flexhinf.plant.parameters import ParameterValues
from flexhinf.plant.plant import pose_values
from flexhinf.scalars import trace
from flexhinf.validation import value_text

#: Newton steps towards the equilibrium of the loop at most, and the relative size of the last one.
ITERATIONS, LAST_STEP = 12, 1e-7

#: So many entries of the loops' matrices are computed at once: they fit the memory near the processor.
AT_ONCE = 300_000


class EquilibriumLoop:
    """A law with an estimator at its stationary gain, or fed back the true state, in equilibrium at a goal.

    A law with integrals has its equilibrium at the goal, whatever the true plant. One without has it where the true
    plant and its input balance: off the goal, if the true plant is not the model.

    Parameters
    ----------
    filter : RecursiveFilter, ConstantGainFilter, OutputInjectionObserver or None
        A Kalman filter is taken at its stationary gain at the goal, a ModalFilter at its gain there. None feeds
        back the true state.
    true_plant : Plant
        May have more states than the law's plant (a coil); its parameters are given to `modes`.
    goal : float, (k,) array or mapping, optional
        Wanted values of the tracked states; those of the law's operating point by default.
    equilibrium : ((n,), (m,)) arrays, optional
        State and input of the law's plant at the goal, where they are known; instead of `goal`.
    moving : bool
        The law acts on deviations from the goal, and its input adds to the one that holds it there, as
        `flexhinf.loop.Controller` with ``moving=True``.
    period, delay, latency : float, int, int
        s; whole samples between an input and its effect, of which the estimator does not know, and samples that it
        knows, by default those of `flexhinf.loop.Controller`. At most 200 together, which is the loop's `delay`.
    positions : str or sequence of str, optional
        States that a command is for, in `linear`; the tracked ones by default.

    What does not fit is an InvalidInput; a law's plant without an equilibrium at the goal a NumericalFailure.
    """

    def __init__(
        self,
        law: Law,
        filter: Estimator | None,
        true_plant: Plant,
        period: float,
        goal: Mapping[str, float] | ArrayLike | None = None,
        *,
        equilibrium: tuple[np.ndarray, np.ndarray] | None = None,
        moving: bool = False,
        delay: int = 0,
        latency: int | None = None,
        positions: str | Sequence[str] | None = None,
    ) -> None:
        if goal is not None and equilibrium is not None:
            raise InvalidInput(
                "The equilibrium is given twice.",
                f"got goal={goal!r} and equilibrium={equilibrium!r}",
                "one of them",
            )
        if isinstance(delay, bool) or not isinstance(delay, int) or delay < 0:
            raise InvalidInput(
                "The delay is not a number of samples.", f"expected an integer >= 0, got {delay!r}", "delay=1"
            )
        true_plant.check_continuous("linear loop")
        check_states(law, filter)
        latency = checked_latency(latency, filter)
        check_delay(delay + latency, period, LONGEST_LINEAR)
        self.law, self.plant, self.period = law, true_plant, period
        self.filter: Any = filter  # each kind has parts of its own
        self.moving, self.delay = moving, delay + latency
        #: Whether the gain follows from R^v: that of a Kalman filter.
        self.tunable = isinstance(filter, RecursiveFilter) and not isinstance(filter, OutputInjectionObserver)
        self._nominal: LinearLoop | None = None
        self._states = law.plant_states
        #: The model of the estimator, or the true plant whose state is fed back.
        self._model = true_plant if filter is None else filter.plant
        #: State and input with which the law's plant is held at the goal, (n,) and (m,).
        x, u = (
            (law.operating_point[: len(self._states)], law.operating_input)
            if equilibrium is None
            else equilibrium
        )
        self.model_equilibrium = np.array(x, dtype=float), np.array(u, dtype=float)
        if goal is not None:
            if not law.tracked:
                raise InvalidInput(
                    "A law without integrals has no goal of its own.",
                    f"got goal={goal!r}",
                    "equilibrium=(x, u): state and input of its plant there, with moving=True",
                )
            x, u = plant_equilibrium(self._model, law.tracked, pose_values(goal, law.tracked))
            self.model_equilibrium = x[[self._model.index(name) for name in self._states]], u
        x, u = self.model_equilibrium
        steady = self.filter
        if self.tunable:
            steady = ConstantGainFilter(self.filter, self.gain(self.filter.process_noise))
        elif isinstance(filter, ModalFilter):
            steady = filter.at(x)
        self.step = SampledController(law, steady, period, moving, latency)
        #: (x*, u*) of the law, or of the goal it moves with.
        self.centre = np.concatenate([x, law.operating_point[len(x) :], u]) if moving else self.step.centre
        #: Wanted values of the tracked states, (k,).
        self.command = x[[self._states.index(name) for name in self.step.tracked]]
        #: Number of states of the linear loop: true plant, inputs that wait in the delay, controller.
        self.states = true_plant.n + self.delay * self.step.m + self.step.size
        self.positions = self.step.tracked if positions is None else true_plant.expanded(positions)
        self.sub_steps = Loop(true_plant, self.step.controller).sub_steps

    # The estimator -------------------------------------------------------------------------------------
    @cached_property
    def model(self) -> tuple[np.ndarray, np.ndarray]:
        """F (n, n) and H (p, n) of one sample of the filter's model, linearised at the goal."""
        x, u = self.model_equilibrium
        filter = self.filter
        plant, rows = filter.plant, model_rows(filter)
        _, slope = rows(np.concatenate([x, u])[None, :], plant.parameters.vector(), filter.sub_steps)
        return slope[0, : len(x), : len(x)], plant.slopes(x, u)[3]

    def gain(self, process_noise: np.ndarray) -> np.ndarray:
        """The filter's stationary gain (n, p) at the goal for this R^v (n, n)."""
        if not self.tunable:
            raise InvalidInput(
                "This loop has no filter whose gain depends on R^v.",
                f"got {type(self.filter).__name__}",
                "an unscented or extended Kalman filter",
            )
        return stationary_gain(self.model, process_noise, self.filter.measurement_noise)

    # One period ----------------------------------------------------------------------------------------
    @cached_property
    def measure(self) -> DerivativeRows:
        """(x, u, parameters) → the controller's measurement."""
        plant, n = self.plant, self.plant.n
        places = [plant.index(name) for name in self._states] if self.filter is None else None

        def measured(moving: Elements, held: Elements) -> Elements:
            return plant.evaluate_output(moving[:n], moving[n:], held) if places is None else moving[places]

        sizes = (n + len(plant.inputs), plant.parameters.size)
        return DerivativeRows(
            ("measure", plant.code_key, places), lambda: trace(measured, *sizes, name="measure")
        )

    def by_loop(self, by: np.ndarray, by_y: np.ndarray) -> np.ndarray:
        """Derivatives (N, j, n + s) by plant and memory, from those by memory and measurement (N, j, s + p …), with
        ∂y/∂(x, last input) (N, p, n + m)."""
        n, s, p, place = self.plant.n, self.step.size, self.step.p, self.step.acted
        through = by[:, :, s : s + p] @ by_y
        whole = np.concatenate([through[:, :, :n], by[:, :, :s]], axis=2)
        whole[:, :, n + place.start : n + place.stop] += through[:, :, n:]
        return whole

    def stepped(
        self, z: np.ndarray, vectors: np.ndarray, fixed: np.ndarray | None, outside: bool = True
    ) -> tuple[StepDerivatives, np.ndarray]:
        """The controller's step at loop states z (N, n + s), and ∂y/∂(x, last input) (N, p, n + m); with derivatives by
        command and centre if `outside`."""
        n = self.plant.n
        x, memory = z[:, :n], z[:, n:]
        y, by_y = self.measure(np.hstack([x, memory[:, self.step.acted]]), vectors)
        command = np.broadcast_to(self.command, (len(z), self.step.k))
        return self.step.step(memory, y, command, self.centre, fixed, outside=outside), by_y

    def _period(
        self, z: np.ndarray, vectors: np.ndarray, fixed: np.ndarray | None, waits: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """z (N, n + s) one period later, and the Jacobian (N, n + s, n + s): where it rests, exactly. If inputs wait,
        that of (true plant, input that acted last, memory, waiting inputs)."""
        n, m, s, p = self.plant.n, self.step.m, self.step.size, self.step.p
        stepped, by_y = self.stepped(z, vectors, fixed, outside=False)
        x, slope = near_equilibrium(
            self.plant, self.period, self.sub_steps, z[:, :n], stepped.u.value, vectors
        )
        after = np.hstack([x, stepped.memory.value])
        if not waits:
            moved = slope[:, :, n:] @ self.by_loop(stepped.u.by, by_y)
            moved[:, :, :n] += slope[:, :, :n]
            return after, np.concatenate([moved, self.by_loop(stepped.memory.by, by_y)], axis=1)
        by_u, by_memory = (
            np.concatenate([by[:, :, s : s + p] @ by_y, by[:, :, :s]], axis=2)
            for by in (stepped.u.by, stepped.memory.by)
        )
        a, e = np.zeros((len(z), n + m + s, n + m + s)), np.zeros((len(z), n + m + s, m))
        a[:, :n, :n], a[:, n + m :] = slope[:, :, :n], by_memory
        e[:, :n], e[:, n : n + m] = slope[:, :, n:], np.eye(m)
        return after, with_queue(a, e, by_u, self.delay)

    # Rest ----------------------------------------------------------------------------------------------
    @cached_property
    def start(self) -> np.ndarray:
        """State of the loop (n + s,) where the nominal plant is held at the goal; a NumericalFailure if no integrals
        make the law give the input that holds it."""
        x, u = self.model_equilibrium
        if self.moving:
            integral, position = self.law.operating_point[len(x) :], np.zeros(self.step.k)
        else:
            integral, position = equilibrium_integrals(self.step.law_rows, x, u), self.command
        waiting = self.step.latency_memory(u, self.command)
        return np.concatenate(
            [self._true_start(x, u), self.step.settled(x, u), u, integral, position, waiting]
        )

    def _true_start(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        plant, known = self.plant, dict(zip(self._states, x))
        state = np.array([known.get(name, 0.0) for name in plant.states])
        # States that the law's plant lacks are solved for.
        extra = [i for i, name in enumerate(plant.states) if name not in known]
        if extra:
            slope = plant.linearise(state, u)[0][:, extra]
            state[extra] -= np.linalg.lstsq(slope, plant.derivative(state, u), rcond=None)[0]
        return state

    def by_command(self) -> np.ndarray:
        """Derivatives of the controller's command and centre by the commanded positions.

        A law about its operating point has the command in its integrals only. About a moving reference the
        command is the whole equilibrium at the commanded positions: f(x_d, u_d) = 0 along x_d = x_d(q), u_d = u_d(q).
        """
        step, (x, u) = self.step, self.model_equilibrium
        tracked = np.array([[float(name == other) for other in self.positions] for name in step.tracked])
        by = np.zeros((step.k + step.n + step.k + step.m, len(self.positions)))
        by[: step.k] = tracked.reshape(step.k, len(self.positions))
        if self.moving:
            plant = self._model
            a, b, _ = plant.change_slopes(x if self.filter is not None else self._true_start(x, u), u)
            commanded = [plant.index(name) for name in self.positions]
            free = [i for i in range(plant.n) if i not in commanded]
            moved = np.linalg.lstsq(np.hstack([a[:, free], b]), -a[:, commanded], rcond=None)[0]
            state = np.zeros((plant.n, len(commanded)))
            state[commanded], state[free] = np.eye(len(commanded)), moved[: len(free)]
            states = [plant.index(name) for name in self._states]
            by[step.k : step.k + step.n], by[step.k + step.n + step.k :] = state[states], moved[len(free) :]
        return by

    def modes(
        self,
        values: Sequence[ParameterValues] | np.ndarray,
        process_noise: np.ndarray | None = None,
        near: np.ndarray | None = None,
    ) -> Modes:
        """Equilibrium and multipliers with these true plants, mappings by name (numbers, or arrays where there are
        joints; names that are left out keep their nominal value) or parameter vectors (N, q).

        `process_noise` is R^v instead of the filter's, (n, n) for all plants or (N, n, n). Equilibria are searched for
        from `near` (N, K), for example those with another R^v; where that is NaN, and by default, from the nominal
        plant's.
        """
        vectors = values if isinstance(values, np.ndarray) else self.plant.parameters.vectors(values)
        fixed = self._fixed(process_noise)
        each = max(1, AT_ONCE // self.states**2)
        parts: list[tuple[np.ndarray, np.ndarray]] = []
        for k in range(0, max(1, len(vectors)), each):
            at = slice(k, k + each)
            gains = fixed[at] if fixed is not None and fixed.ndim == 2 else fixed
            z, slope, exists = self._equilibrium(vectors[at], gains, None if near is None else near[at])
            z = np.where(exists[:, None], z, np.nan)
            if self.delay:
                slope = self._period(z, vectors[at], gains, waits=True)[1]
            multipliers = np.full(slope.shape[:2], np.inf, dtype=complex)
            multipliers[exists] = np.linalg.eigvals(slope[exists])
            parts.append((z, multipliers))
        equilibria, multipliers = (np.concatenate(each) for each in zip(*parts))
        return Modes(self.period, equilibria, multipliers)

    def linear(
        self, values: ParameterValues | None = None, process_noise: np.ndarray | None = None
    ) -> LinearLoop:
        """The loop linearised at its equilibrium with one true plant, the nominal one by default; a NumericalFailure if
        it has none with this plant."""
        nominal = not values and process_noise is None
        if nominal and self._nominal is not None:
            return self._nominal
        vectors, fixed = self.plant.parameters.vectors([values or {}]), self._fixed(process_noise)
        z, _, exists = self._equilibrium(vectors, fixed)
        if not exists[0]:
            raise NumericalFailure(
                "The loop has no equilibrium with this plant.",
                f"none was found near the goal {np.array2string(self.command, precision=6)}",
                "another law or goal",
            )
        stepped, by_y = self.stepped(z, vectors, fixed)
        plant, step, by_command = self.plant, self.step, self.by_command()
        n, m, known = plant.n, len(plant.inputs), step.size + step.p
        at = plant.with_parameters(**vars(plant.parameters.named(vectors[0])))
        a, b, g, _ = at.linearise(z[0, :n], stepped.u.value[0])
        law, memory, by_y = stepped.u.by[0], stepped.memory.by[0], by_y[0]
        positions = np.eye(n)[[plant.index(name) for name in self.positions]]
        linear = LinearLoop(
            self.period,
            a,
            b,
            by_y[:, :n],
            by_y[:, n : n + m],
            memory[:, :known],
            law[:, :known],
            memory[:, known:] @ by_command,
            law[:, known:] @ by_command,
            positions,
            tuple(self.positions),
            g,
            tuple(plant.disturbances),
            tuple(plant.inputs),
            not self.moving,
            self.delay * self.period,
        )
        if nominal:
            self._nominal = linear
        return linear

    def _fixed(self, process_noise: np.ndarray | None) -> np.ndarray | None:
        if process_noise is None:
            return None
        if process_noise.ndim == 2:
            return self.gain(process_noise).ravel()
        # (N, n p) for an R^v per plant: neighbours with the same R^v share one
        changes = np.any(process_noise[1:] != process_noise[:-1], axis=(1, 2))
        first = np.concatenate([[0], np.flatnonzero(changes) + 1])
        gains = np.array([self.gain(process_noise[k]).ravel() for k in first])
        return np.repeat(gains, np.diff([*first, len(process_noise)]), axis=0)

    def _equilibrium(
        self, vectors: np.ndarray, fixed: np.ndarray | None, near: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count, k = len(vectors), self.plant.n + self.step.size
        try:
            z = np.tile(self.start, (count, 1))
        except NumericalFailure:
            return np.full((count, k), np.nan), np.zeros((count, k, k)), np.zeros(count, bool)
        if near is not None:
            z = np.where(np.isfinite(near).all(axis=1, keepdims=True), near, z)
        slope, size = np.zeros((count, k, k)), np.full(count, np.inf)
        for _ in range(ITERATIONS):
            with np.errstate(over="ignore", invalid="ignore"):  # far from any rest: not fine, below
                later, slope = self._period(z, vectors, fixed)
            flat, gap = slope.reshape(count, -1), later - z
            fine = np.isfinite(flat).all(axis=1) & np.isfinite(gap).all(axis=1)
            size[~fine] = np.inf
            if not fine.any() or np.all(size[fine] <= LAST_STEP):
                break
            move = solved((np.eye(k) - slope)[fine], gap[fine])
            finite = np.isfinite(move.sum(axis=1))
            z[fine] += np.where(finite[:, None], move, 0.0)
            scale = np.maximum(1.0, np.abs(z[fine]).max(axis=1))
            size[fine] = np.where(finite, np.abs(move).max(axis=1) / scale, np.inf)
        return z, slope, size <= LAST_STEP


# Frequency response ----------------------------------------------------------------------------------
#: Decades of the grid below the slowest pole that oscillates or decays, and points of the grid.
BELOW, POINTS = 1.0, 400


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Responses of a linear loop of q positions, m inputs and k disturbances at z = e^{jωT}, complex.

    Commands and disturbances are held between samples; positions are those of the true plant at the samples. Responses
    of an unstable loop are those of its transfer functions.
    """

    linear: LinearLoop
    frequencies: np.ndarray  # (F,), rad/s, ascending, at most π/T
    command: np.ndarray  # (F, q, q), commanded position → position
    disturbance: np.ndarray  # (F, q, k), torque → position, rad/N·m or m/N
    loop_transfer: np.ndarray  # (F, m, m), L broken at all inputs, with negative feedback: S = (1 + L)⁻¹
    input_loops: np.ndarray  # (F, m), L_i broken at one input, the others closed: its Nyquist curve
    sensitivity: np.ndarray  # (F, m, m), S at the plant's inputs
    complementary: np.ndarray  # (F, m, m), T = 1 − S

    def __repr__(self) -> str:
        over = f"{len(self.frequencies)} frequencies, {self.frequencies[0]:.3g} to {self.frequencies[-1]:.3g} rad/s"
        return (
            f"FrequencyResponse({over}, {len(self.linear.inputs)} inputs, {len(self.linear.names)} positions)"
        )


def frequency_response(
    loop: EquilibriumLoop | LinearLoop,
    frequencies: ArrayLike | None = None,
    values: ParameterValues | None = None,
    process_noise: np.ndarray | None = None,
) -> FrequencyResponse:
    """Responses of a loop at its equilibrium, at frequencies (F,) in rad/s, positive and at most π/T, else refused.

    By default they are a logarithmic grid from a decade below the slowest pole to π/T, with points around every pole
    of the running and of the opened loop, so that no resonance is missed. `values` and `process_noise` are as for
    `EquilibriumLoop.linear`; a NumericalFailure says that the loop has no equilibrium with this plant.
    """
    linear = loop if isinstance(loop, LinearLoop) else loop.linear(values, process_noise)
    closed, opened, m, top = linear.closed_loop, linear.opened(), linear.b.shape[1], np.pi / linear.period
    if frequencies is None:
        sizes = np.abs(closed.poles)
        low = float(sizes[sizes > 1e-6 * top].min(initial=top)) / 10.0**BELOW
        near = np.concatenate([closed.frequencies(), opened.frequencies()])
        grid = np.unique(
            np.concatenate([np.geomspace(low, top, POINTS), near[(near >= low) & (near <= top)]])
        )
    else:
        grid = np.sort(np.atleast_1d(np.asarray(frequencies, dtype=float)))
        if grid.ndim != 1 or not len(grid) or not np.all((grid > 0.0) & (grid <= top * (1.0 + 1e-12))):
            raise InvalidInput(
                "The frequencies do not fit the sampled loop.",
                f"expected numbers above 0 and up to pi/T = {top:.6g} rad/s, got {value_text(grid)}",
                "numpy.geomspace(0.1, 1000, 200), in rad/s",
            )
    n, q, k = m + len(linear.c), len(linear.positions), linear.g.shape[1]
    answer = closed.response(grid, np.r_[0:m, n : n + q + k])  # one solve for all outputs by w, r and d
    if linear.late_command:
        answer[:, :, m : m + q] *= np.exp(-1j * grid * linear.period)[:, None, None]
    sensitivity, positions = answer[:, :m, :m], answer[:, 2 * m :]
    return FrequencyResponse(
        linear,
        grid,
        positions[:, :, m : m + q],
        positions[:, :, m + q :],
        -opened.response(grid),
        np.stack([-linear.opened(i=i).response(grid)[:, 0, 0] for i in range(m)], axis=1),
        sensitivity,
        np.eye(m) - sensitivity,
    )
