"""The same run of many plants, each with its own parameters, noise and initial state, of which only numbers are kept.

The runs go side by side in the lanes of vector registers, on several threads; noise is made and metrics are reduced
inside the compiled code. Memory grows neither with the plants that have gone nor, unless signals are kept, with the
samples. The numbers of a plant do not depend on the other plants, on the lanes or on the threads, bit by bit, and
`Loop.run` of the same plant and seed makes the same run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.codegen import Kernel, compile_program
from flexhinf.codegen.noise import seed_key
from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.shared import share
from flexhinf.loop.signals.sampling import by_name, check_seed, checked_deviation, sample_disturbance
from flexhinf.loop.simulation.channel import Channel
from flexhinf.loop.simulation.compiled_runs import LANES, THREADS, LoopCode, capacity
from flexhinf.loop.simulation.lane_runs import Recorded, Task
from flexhinf.loop.simulation.program import EnsembleOptions, ensemble_program
from flexhinf.loop.simulation.reductions import (
    Command,
    Place,
    Reduction,
    common_reductions,
    tracking_reductions,
)
from flexhinf.loop.simulation.run_arguments import starting_state
from flexhinf.plant import Plant, fastest_modes, sub_steps
from flexhinf.untrusted import real_array, value_text

__all__ = ["Ensemble", "EnsembleResult", "prepared_ensemble"]


@dataclass(frozen=True, eq=False)
class EnsembleResult:
    """Numbers of N runs.

    Attributes
    ----------
    codes : (N,) array of int
        0 for a run that came to its end; `CONTROL_FAILED` or `PLANT_FAILED` of `flexhinf.loop.simulation.program`
        where the controller's or the plant's numbers are no longer finite.
    diverged_at : (N,) array
        The time of the last sample of a run that diverged, s; NaN for the others.
    sub_steps : (N,) array of int
        Runge–Kutta steps per period.
    judged : tuple of str
        Tracked states, see `Controller.judged`.
    by_state : mapping of str to mapping of str to array
        For each of them its metrics, (N,).
    common : mapping of str to array
        Metrics of the whole run, (N,) or (N, j).
    kept : (N, T, k) array
        Signals that were asked for, at the instants that were asked for; NaN after a run diverged.
    """

    codes: np.ndarray
    diverged_at: np.ndarray
    sub_steps: np.ndarray
    judged: tuple[str, ...]
    by_state: Mapping[str, Mapping[str, np.ndarray]]
    common: Mapping[str, np.ndarray]
    kept: np.ndarray

    @property
    def completed(self) -> np.ndarray:
        """Which runs came to their end, (N,) of bool."""
        return self.codes == 0

    def metrics(self, name: str | None = None) -> dict[str, np.ndarray]:
        """Metrics (N,) of the first (or the named) tracked state, by the names of `Trajectory.metrics`.

        Where `Trajectory.metrics` has None they are NaN: for a command that is no step, and for runs that diverged. A
        settling time or a rise time is infinite where the run is not settled, or has not risen, at its end.
        `estimation_rmse` is (N, j), one column per estimated state whose true value is known.

        Raises
        ------
        InvalidInput
            If this state is not tracked.
        """
        if name is None and self.judged:
            name = self.judged[0]
        if name is not None and name not in self.by_state:
            raise InvalidInput(
                f"{name!r} is not tracked.", f"expected one of {list(self.judged)}", "one of these names"
            )
        return {**(self.by_state[name] if name is not None else {}), **self.common}


@dataclass(frozen=True, eq=False)
class Ensemble:
    """A run that can be made of many plants; see `Loop.ensemble`.

    Attributes
    ----------
    plant, controller, channel
        The nominal true plant, and what its runs have in common.
    command : Command
    start : mapping of str to array
        What every run starts with, by buffer, unless it has its own.
    shared : mapping of str to array
        What all runs read, by buffer.
    disturbance : any, or None
        As for `Loop.run`.
    tracking : mapping of str to tuple of Reduction
        Of each judged state.
    common : tuple of Reduction
    kept : tuple of (str, int)
        Signals that are kept: "state" or "output", and the column.
    instants : (T,) array of int
        Samples at which they are.
    sub_steps : int or None
        Of all plants, instead of the number that each one's fastest mode asks for.
    """

    plant: Plant
    controller: Controller
    channel: Channel
    command: Command
    start: Mapping[str, np.ndarray]
    shared: Mapping[str, np.ndarray]
    disturbance: Any
    tracking: Mapping[str, tuple[Reduction, ...]]
    common: tuple[Reduction, ...]
    kept: tuple[tuple[str, int], ...]
    instants: np.ndarray
    sub_steps: int | None

    def run(
        self,
        parameters: Any,
        seeds: Any = 0,
        initial_states: Any = None,
        loads: Any = None,
        *,
        initial_inputs: Any = None,
        threads: int = THREADS,
        lanes: int = LANES,
    ) -> EnsembleResult:
        """Make N runs.

        Parameters
        ----------
        parameters : (N, P) array, or sequence of N mappings by name
            Of each plant; an array in the order of `ParameterTable.vector`, a mapping has those that differ from the
            nominal ones.
        seeds : int, or N of them
            Of each run's noise, 0 … 2⁶⁴ − 1, as for `Loop.run`. One number is the seed of all, which then have the
            same noise.
        initial_states : (N, n) array, optional
            Of each true plant, in the order of its states.
        loads : (N, d) array, optional
            Factors of the disturbance, by channel.
        initial_inputs : (N, m) array, optional
            Of each run, as `initial_input` for `Loop.run`.
        threads, lanes : int
            Results do not depend on them.

        Raises
        ------
        InvalidInput
            For arrays that do not fit, and for a plant that is too fast for this period.
        """
        own = self._own(parameters, seeds, initial_states, loads)
        own |= self._begun(initial_inputs, len(own["truth"]))
        parts = self._parts(own["truth"])
        own["truth"] = np.column_stack([self.command.period / parts, own["truth"]])
        found = Recorded.of(len(parts), self.remembered, len(self.instants), len(self.kept))
        for number in np.unique(parts).tolist():
            start = {**self.start, "step": np.zeros(1), "remembered": self.remembered}
            task = Task(
                self.kernel(number, lanes), {**self.shared, **self._disturbance(number)}, start, own,
                self.command.samples, number, self.channel.delay, self.instants,
            )  # fmt: skip
            task.run(np.flatnonzero(parts == number), found, threads)
        return self._result(found, parts)

    # What is compiled -----------------------------------------------------------------------------
    @cached_property
    def reductions(self) -> tuple[Reduction, ...]:
        """All of them, in the order of what they remember."""
        return (*(one for several in self.tracking.values() for one in several), *self.common)

    @property
    def remembered(self) -> np.ndarray:
        """What they remember before the first sample."""
        return np.array([number for reduction in self.reductions for number in reduction.start])

    def kernel(self, sub_steps: int, lanes: int = LANES) -> Kernel:
        """All steps of so many runs; without a disturbance it serves any number of sub-steps."""
        capacity = 1 if self.disturbance is None else sub_steps
        code = LoopCode.of(self.plant, self.controller, self.channel, capacity)
        options = EnsembleOptions(
            "deviation" in self.shared, self.disturbance is not None, self.channel.delay > 0, self.kept
        )

        def build() -> Kernel:
            model = (self.plant, self.controller, code.sizes, self.channel)
            return compile_program(ensemble_program(*model, self.reductions, options), lanes)

        updates = tuple(one.code_key for one in self.reductions)
        return share((*code.key, "ensemble", options, updates, lanes), build)

    # Arrays ---------------------------------------------------------------------------------------
    def _own(self, parameters: Any, seeds: Any, initial_states: Any, loads: Any) -> dict[str, np.ndarray]:
        """What each run has of its own, by buffer: rows of N."""
        truth = self._parameters(parameters)
        count = len(truth)
        own = {"truth": truth, "x": self._rows("initial states", initial_states, count, self.start["x"])}
        if "deviation" in self.shared:
            own["key"] = _keys(seeds, count)
        if self.disturbance is not None:
            own["load"] = self._rows("loads", loads, count, np.ones(len(self.plant.disturbances)))
        elif loads is not None:
            raise InvalidInput(
                "There is no disturbance that loads could be factors of.",
                "expected loads=None",
                "a disturbance in Loop.ensemble",
            )
        return own

    def _begun(self, inputs: Any, count: int) -> dict[str, np.ndarray]:
        """The inputs before the first sample and the controller's memory of them, where each run has its own."""
        if inputs is None:
            return {}
        rows = self._rows("initial inputs", inputs, count, self.start["held"])
        before = np.array([self.controller.input_before(row) for row in rows]).reshape(rows.shape)
        memory = [self.controller.initial_memory(input=row) for row in rows]
        return {"held": before, "memory": np.array(memory).reshape(count, -1)}

    def _parameters(self, parameters: Any) -> np.ndarray:
        table = self.plant.parameters
        if isinstance(parameters, Sequence) and all(isinstance(row, Mapping) for row in parameters):
            return table.vectors(parameters)
        rows = real_array(parameters)
        if rows.ndim != 2 or rows.shape[1] != table.size or not np.all(np.isfinite(rows)):
            raise InvalidInput(
                "The parameters do not fit the plant.",
                f"expected rows of {table.size} finite numbers for {list(table.names)}, got {value_text(parameters)}",
                "plant.parameters.vectors([...]), or mappings by name",
            )
        return rows

    def _rows(self, what: str, given: Any, count: int, default: np.ndarray) -> np.ndarray:
        if given is None:
            return np.broadcast_to(default, (count, len(default)))
        rows = real_array(given)
        if rows.shape != (count, len(default)) or not np.all(np.isfinite(rows)):
            raise InvalidInput(
                f"The {what} do not fit the plants.",
                f"expected finite numbers of shape {(count, len(default))}, got {value_text(given)}",
                "one row for each plant",
            )
        return rows

    def _parts(self, truth: np.ndarray) -> np.ndarray:
        """Sub-steps of each plant, (N,): those of a `Loop` of this plant alone."""
        if self.sub_steps is not None:
            return np.full(len(truth), self.sub_steps)
        point = starting_state(None, self.plant.states, self.controller)
        modes = fastest_modes(self.plant, truth, point, self.controller.law.operating_input)
        return np.array([sub_steps(self.controller.period, mode) for mode in modes.tolist()], dtype=int)

    def _disturbance(self, parts: int) -> dict[str, np.ndarray]:
        if self.disturbance is None:
            return {}
        command, names = self.command, self.plant.disturbances
        values = sample_disturbance(
            self.disturbance, command.period, command.samples, parts, names, capacity(parts)
        )
        return {"disturbance": values.ravel()}

    def _result(self, found: Recorded, parts: np.ndarray) -> EnsembleResult:
        failed = found.codes != 0
        diverged_at = np.where(failed, found.steps * self.command.period, np.nan)
        found.remembered[:, failed] = np.nan
        results, start = [], 0
        for reduction in self.reductions:
            some = found.remembered[start : start + len(reduction.start)]
            results.append(
                {
                    name: _blank(values, failed)
                    for name, values in reduction.result(some, self.command).items()
                }
            )
            start += len(reduction.start)
        rest = iter(results)
        by_state = {
            name: {key: value for _ in several for key, value in next(rest).items()}
            for name, several in self.tracking.items()
        }
        common = {key: value for result in rest for key, value in result.items()}
        return EnsembleResult(
            found.codes, diverged_at, parts, tuple(self.tracking), by_state, common, found.kept
        )


def _blank(values: np.ndarray, failed: np.ndarray) -> np.ndarray:
    values = np.array(values, dtype=float)
    values[failed] = np.nan
    return values


def _keys(seeds: Any, count: int) -> np.ndarray:
    """Sample and words of the seed of each run, (N, 3); the sample is zero, as in `Loop.run`."""
    given = [seeds] * count if np.ndim(seeds) == 0 else list(seeds)
    for seed in given[:1] if np.ndim(seeds) == 0 else given:
        check_seed(seed)
    if len(given) != count:
        raise InvalidInput(
            "The seeds do not fit the plants.",
            f"expected {count} integers, got {len(given)}",
            "one for each plant",
        )
    return np.array([(0, *seed_key(int(seed))) for seed in given], dtype=float).reshape(count, 3)


def prepared_ensemble(
    plant: Plant,
    controller: Controller,
    channel: Channel,
    commands: np.ndarray,
    run: tuple[Any, Any, Any, Any],
    wanted: tuple[Sequence[Reduction], Sequence[str], Any],
    asked_sub_steps: int | None,
) -> Ensemble:
    """See `Loop.ensemble`.

    Parameters
    ----------
    plant, controller, channel
    commands : (N, r) array
    run : tuple
        Disturbance, noise, initial state and initial input, as for `Loop.run`.
    wanted : tuple
        A user's reductions, names of signals that are kept, and samples at which they are.
    asked_sub_steps : int or None
    """
    disturbance, noise, initial_state, initial_input = run
    command = Command.of(commands, controller.period)
    start = {
        "x": starting_state(initial_state, plant.states, controller),
        "held": controller.input_before(initial_input),
        "memory": controller.initial_memory(input=initial_input),
    }
    shared = {"data": controller.data_vector, "facts": command.vector()}
    if commands.size:
        shared["reference"] = commands.ravel()
    if noise is not None:
        shared["deviation"] = np.ascontiguousarray(checked_deviation(noise, controller.measured))
    reductions, names, instants = wanted
    tracking = {name: tracking_reductions(_place(plant, controller, name)) for name in controller.judged}
    known = [
        (k, plant.states.index(name)) for k, name in enumerate(controller.states) if name in plant.states
    ]
    disturbance = None if disturbance is None else by_name(disturbance, plant)
    return Ensemble(
        plant, controller, channel, command, start, shared, disturbance, tracking,
        (*common_reductions(known), *reductions), tuple(_signal(plant, controller, name) for name in names),
        _instants(instants, command.samples), asked_sub_steps,
    )  # fmt: skip


def _place(plant: Plant, controller: Controller, name: str) -> Place:
    """As `Trajectory.tracked` finds a tracked state."""
    names = {"state": plant.states, "output": controller.measured, "estimate": controller.states}
    kind = next((kind for kind, several in names.items() if name in several), "state")
    return Place(kind, tuple(names[kind]).index(name), controller.commanded.index(name))


def _signal(plant: Plant, controller: Controller, name: str) -> tuple[str, int]:
    for kind, names in (("state", plant.states), ("output", controller.measured)):
        if name in names:
            return kind, tuple(names).index(name)
    raise InvalidInput(
        f"There is no signal {name!r}.",
        f"expected states and measured signals out of {[*plant.states, *controller.measured]}",
        "one of these",
    )


def _instants(given: Any, samples: int) -> np.ndarray:
    instants = np.asarray(given, dtype=int).reshape(-1)
    if np.any((instants < 0) | (instants >= samples)):
        raise InvalidInput(
            "An instant is outside of the run.",
            f"expected samples 0 to {samples - 1}, got {value_text(given)}",
            "numbers of samples, not times",
        )
    return instants
