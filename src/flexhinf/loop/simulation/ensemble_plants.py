"""What each plant of an ensemble has of its own: parameters, seed, initial state, loads, sub-steps.

Numbers of many runs with their names.

Many runs of one kernel, in its lanes and on several threads: each thread has arrays of its own and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.codegen import Kernel, aligned
from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.signals.sampling import check_seed
from flexhinf.loop.simulation.compiled_runs import operating_state
from flexhinf.loop.simulation.metrics import Command, Reduction
from flexhinf.plant import Plant, fastest_modes, sub_steps
from flexhinf.validation import real_array, value_text


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

    def metrics_of(self, k: int, name: str | None = None) -> dict[str, Any]:
        """Those of the k-th run, with None as in `Trajectory.metrics`."""
        row = {key: values[k].tolist() for key, values in self.metrics(name).items()}
        if not self.completed[k]:
            return dict.fromkeys(row)
        return {
            key: value if isinstance(value, list) or np.isfinite(value) else None
            for key, value in row.items()
        }


def named_numbers(
    found: Recorded,
    parts: np.ndarray,
    command: Command,
    tracking: Mapping[str, Sequence[Reduction]],
    common: Sequence[Reduction],
) -> EnsembleResult:
    """What N runs left behind, by the names of the reductions that made it.

    Parameters
    ----------
    parts : (N,) array of int
        Sub-steps.
    tracking : mapping of str to sequence of Reduction
        Of each judged state.
    common : sequence of Reduction
        Whose numbers stand behind those.
    """
    failed = found.codes != 0
    diverged_at = np.where(failed, found.steps * command.period, np.nan)
    found.remembered[:, failed] = np.nan
    reductions = (*(one for several in tracking.values() for one in several), *common)
    results, start = [], 0
    for reduction in reductions:
        some = found.remembered[start : start + len(reduction.start)]
        numbers = reduction.result(some, command)
        results.append({name: _blank(values, failed) for name, values in numbers.items()})
        start += len(reduction.start)
    rest = iter(results)
    by_state = {
        name: {key: value for _ in several for key, value in next(rest).items()}
        for name, several in tracking.items()
    }
    others = {key: value for result in rest for key, value in result.items()}
    return EnsembleResult(found.codes, diverged_at, parts, tuple(tracking), by_state, others, found.kept)


def _blank(values: np.ndarray, failed: np.ndarray) -> np.ndarray:
    values = np.array(values, dtype=float)
    values[failed] = np.nan
    return values


@dataclass(frozen=True, eq=False)
class EnsemblePlants:
    """N plants.

    Attributes
    ----------
    truth : (N, P) array
        Parameters.
    parts : (N,) array of int
        Runge–Kutta steps of a sample.
    seeds : tuple of int
        Of the noise.
    own : mapping of str to array
        What else they have of their own, by buffer, rows of N.
    """

    truth: np.ndarray
    parts: np.ndarray
    seeds: tuple[int, ...]
    own: Mapping[str, np.ndarray]

    @classmethod
    def of(
        cls,
        plant: Plant,
        controller: Controller,
        start: Mapping[str, np.ndarray],
        asked_sub_steps: int | None,
        given: tuple[Any, Any, Any, Any, Any],
        disturbed: bool,
    ) -> EnsemblePlants:
        """From what a user gives.

        Parameters
        ----------
        plant, controller
            The nominal true plant, and the controller of all.
        start : mapping of str to array
            What a run starts with, by buffer.
        asked_sub_steps : int or None
            Of all plants.
        given : tuple
            Parameters, seeds, initial states, loads and initial inputs, see `Ensemble.run`.
        disturbed : bool
            Whether there is a disturbance that loads could be factors of.

        Raises
        ------
        InvalidInput
            For arrays that do not fit, and for a plant that is too fast for this period.
        """
        parameters, seeds, states, loads, inputs = given
        truth = _parameters(plant, parameters)
        count = len(truth)
        own = {"x": _rows("initial states", states, count, start["x"])}
        if disturbed:
            own["load"] = _rows("loads", loads, count, np.ones(len(plant.disturbances)))
        elif loads is not None:
            raise InvalidInput(
                "There is no disturbance that loads could be factors of.",
                "expected loads=None",
                "a disturbance in Loop.ensemble",
            )
        if inputs is not None:
            rows = _rows("initial inputs", inputs, count, start["held"])
            memory = [controller.initial_memory(input=row) for row in rows]
            own["held"] = np.array([controller.input_before(row) for row in rows]).reshape(rows.shape)
            own["memory"] = np.array(memory).reshape(count, -1)
        return cls(truth, _parts(plant, controller, truth, asked_sub_steps), _seeds(seeds, count), own)

    def __len__(self) -> int:
        return len(self.truth)

    def some(self, rows: slice) -> EnsemblePlants:
        """Some of them."""
        own = {name: values[rows] for name, values in self.own.items()}
        return EnsemblePlants(self.truth[rows], self.parts[rows], self.seeds[rows], own)


def _parameters(plant: Plant, parameters: Any) -> np.ndarray:
    table = plant.parameters
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


def _rows(what: str, given: Any, count: int, default: np.ndarray) -> np.ndarray:
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


def _parts(plant: Plant, controller: Controller, truth: np.ndarray, asked: int | None) -> np.ndarray:
    """Sub-steps of each plant, (N,): those of a `Loop` of this plant alone."""
    if asked is not None:
        return np.full(len(truth), asked)
    point = operating_state(plant.states, controller)
    modes = fastest_modes(plant, truth, point, controller.law.operating_input)
    return np.array([sub_steps(controller.period, mode) for mode in modes.tolist()], dtype=int)


def _seeds(seeds: Any, count: int) -> tuple[int, ...]:
    given = [seeds] * count if np.ndim(seeds) == 0 else list(seeds)
    for seed in given[:1] if np.ndim(seeds) == 0 else given:
        check_seed(seed)
    if len(given) != count:
        raise InvalidInput(
            "The seeds do not fit the plants.",
            f"expected {count} integers, got {len(given)}",
            "one for each plant",
        )
    return tuple(int(seed) for seed in given)


@dataclass(frozen=True, eq=False)
class Recorded:
    """What N runs leave behind.

    Attributes
    ----------
    codes, steps : (N,) array of int
        See `flexhinf.codegen.Status`.
    remembered : (k, N) array
    kept : (N, T, j) array
        Signals at some samples; NaN after the last one of a run that failed.
    """

    codes: np.ndarray
    steps: np.ndarray
    remembered: np.ndarray
    kept: np.ndarray

    @classmethod
    def of(cls, count: int, remembered: np.ndarray, instants: int, signals: int) -> Recorded:
        """Room for so many runs."""
        codes, steps = (np.zeros(count, dtype=int) for _ in range(2))
        return cls(codes, steps, np.zeros((len(remembered), count)), np.zeros((count, instants, signals)))


@dataclass(frozen=True, eq=False)
class Task:
    """Runs that are made with the same kernel and the same counts.

    Attributes
    ----------
    shared : mapping of str to array
        What all runs read, by buffer.
    start : mapping of str to array
        What a run starts with, by buffer, one column; unless it is among its own.
    own : mapping of str to array
        What each run has of its own, by buffer: N rows.
    samples, parts, delay : int
        Of a run: its length, sub-steps of a sample, samples of delay.
    instants : (T,) array of int
        Samples at which signals are kept.
    """

    kernel: Kernel
    shared: Mapping[str, np.ndarray]
    start: Mapping[str, np.ndarray]
    own: Mapping[str, np.ndarray]
    samples: int
    parts: int
    delay: int
    instants: np.ndarray

    def run(self, rows: np.ndarray, found: Recorded, threads: int) -> None:
        """Make the runs of some rows and fill theirs."""
        lanes = self.kernel.lanes
        batches = [rows[k : k + lanes] for k in range(0, len(rows), lanes)]
        rest, count = iter(batches), max(1, min(threads, len(batches)))
        with ThreadPoolExecutor(count) as pool:
            for work in [pool.submit(self._work, rest, found) for _ in range(count)]:
                work.result()

    def _work(self, rest: Iterator[np.ndarray], found: Recorded) -> None:
        """Batches that no other thread has taken, on arrays of this thread."""
        start = {name: column for name, column in self.start.items() if name not in self.own}
        sizes = {name: len(column) for name, column in start.items()}
        sizes |= {name: rows.shape[1] for name, rows in self.own.items()}
        inputs, counts, own = sizes["held"], {"steps": self.samples, "parts": self.parts}, dict(self.own)
        if self.delay:
            sizes["inputs"], counts["late"] = (self.samples + self.delay) * inputs, self.delay * inputs
            if "held" in own:
                own["inputs"] = np.tile(own["held"], (1, self.delay))
            else:
                start["inputs"] = np.tile(start["held"], self.delay)
        sizes["kept"] = self.samples * found.kept.shape[2]
        lanes = self.kernel.lanes
        arrays = {name: aligned(size * lanes).reshape(size, lanes) for name, size in sizes.items() if size}
        run = self.kernel.bind({**self.shared, **arrays}, counts)
        for rows in rest:  # an iterator of a list, from which each thread takes the next
            filled = np.append(
                rows, np.repeat(rows[-1:], self.kernel.lanes - len(rows))
            )  # idle lanes repeat one
            for name in arrays.keys() & start.keys():
                arrays[name][: len(start[name])] = start[name][:, None]
            for name in arrays.keys() & own.keys():
                arrays[name][: own[name].shape[1]] = own[name][filled].T
            run()
            status = run.status
            ends = np.array([status.code, status.step]).reshape(2, -1)
            self._record(rows, ends, arrays, found)

    def _record(
        self, rows: np.ndarray, ends: np.ndarray, arrays: Mapping[str, np.ndarray], found: Recorded
    ) -> None:
        count, signals = len(rows), found.kept.shape[2]
        found.codes[rows], found.steps[rows] = ends[:, :count]
        if "remembered" in arrays:
            found.remembered[:, rows] = arrays["remembered"][:, :count]
        if signals:
            kept = arrays["kept"].reshape(self.samples, signals, -1)[self.instants]
            found.kept[rows] = kept[..., :count].transpose(2, 0, 1)
            for row in rows[found.codes[rows] != 0]:
                found.kept[row, self.instants > found.steps[row]] = np.nan
