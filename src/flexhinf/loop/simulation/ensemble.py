"""The same run of many plants, each with its own parameters, noise and initial state, of which only metrics are kept.

The runs go side by side in the lanes of vector registers, on several threads; noise is made and metrics are reduced
inside the compiled code. Memory grows neither with the plants that have gone nor, unless signals are kept, with the
samples. The numbers of a plant do not depend on the other plants, on the lanes or on the threads, bit by bit, and
`Loop.run` of the same plant and seed makes the same run. Few runs are not worth a kernel of their own: they are made on
that of a single run, and their signals are reduced afterwards, to the same bits.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import islice
from typing import Any, NamedTuple, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Numbers, Vector
from flexhinf.codegen import Kernel, Program, aligned, compile_program
from flexhinf.codegen.gpu import Device, GpuKernel, PlantArrays
from flexhinf.codegen.noise import seed_key
from flexhinf.codegen.shared import share
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.controller.memory import Told
from flexhinf.loop.simulation.inputs import (
    PlantParameters,
    check_seed,
    operating_state,
    sample_disturbance,
    sample_noise,
    start_text,
)
from flexhinf.loop.simulation.metrics import CommandFacts, EnsembleResult, Reduction
from flexhinf.loop.simulation.own_laws import law_rows
from flexhinf.loop.simulation.places import signal_names
from flexhinf.loop.simulation.prepared import PreparedRun, zeros
from flexhinf.loop.simulation.program import (
    Channel,
    EnsembleOptions,
    LoopCode,
    capacity,
    loop_program,
    reduction_program,
)
from flexhinf.loop.simulation.trajectory import Trajectory
from flexhinf.plant import Plant, fastest_modes, sub_steps
from flexhinf.processors import thread_count
from flexhinf.validation import checked_array, one_of, real_array, value_text

#: Runs side by side in one kernel. Eight numbers are one register of AVX-512 and two of AVX2.
LANES = 8

#: Samples of all runs together from which on a kernel of its own is worth compiling: a second, once on a machine.
WORTH = 50_000


def worth_lanes() -> int:
    """Samples of all runs together from which on they go side by side.

    It is the environment variable ``FLEXHINF_LANES_FROM``, without which it is `WORTH`. No number that is computed
    depends on it. Raises InvalidInput: for another value than a whole number.
    """
    stated = os.environ.get("FLEXHINF_LANES_FROM", str(WORTH))
    refuse_if(
        not (stated.isdecimal() and stated.isascii() and len(stated) <= 18),
        "FLEXHINF_LANES_FROM is no number of samples.",
        f"expected a whole number such as {WORTH}, got {stated[:40]!r}",
        "unset FLEXHINF_LANES_FROM, for the fastest runs",
    )
    return int(stated)


#: Values of the disturbance by the number of sub-steps; empty without one.
Disturbances = Mapping[int, np.ndarray]


@dataclass(frozen=True, eq=False)
class EnsemblePlants:
    """N plants: parameters (N, P), Runge–Kutta steps of a sample (N,), seeds (N,) of noise of 64 bits, and in `own`,
    by buffer, other arrays with one row per plant."""

    truth: np.ndarray
    parts: np.ndarray
    seeds: np.ndarray
    own: Mapping[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.truth)


class Recorded(NamedTuple):
    """Records of N runs."""

    codes: np.ndarray  # (N,), of their `RunStatus`
    steps: np.ndarray  # (N,), the last sample
    reduction_memory: np.ndarray  # (k, N), memories of the reductions
    kept: np.ndarray  # (N, T, j), signals at some samples, NaN after the last one of a run that failed
    told: np.ndarray  # (3, N), `Told` of each


@dataclass(frozen=True, eq=False)
class Ensemble:
    """A run to be made of many plants; see `Loop.ensemble`."""

    plant: Plant  # the nominal true plant
    controller: Controller
    channel: Channel
    command: CommandFacts
    commands: np.ndarray  # (N, r), which these are the facts about, and those that a latency looks ahead to
    start: Mapping[str, np.ndarray]  # what every run starts with, unless it has its own, by buffer
    shared: Mapping[str, np.ndarray]  # what all runs read, by buffer
    disturbance: Any  # as for `Loop.run`
    tracking: Mapping[str, tuple[Reduction, ...]]  # of each judged state
    common: tuple[Reduction, ...]
    kept: tuple[tuple[str, int], ...]  # signals that are kept, see `EnsembleOptions`
    instants: np.ndarray  # (T,) of int, samples at which they are
    sub_steps: int | None  # of all plants, instead of the number that each one's fastest mode asks for
    settings: Mapping[str, Any]  # what trajectories name, besides seed, sub-steps and start
    placed: bool  # whether the state of the start was given
    initial_input: Numbers = None  # before the first sample, as it was given

    def run(
        self,
        parameters: PlantParameters,
        seeds: ArrayLike = 0,
        initial_states: Numbers = None,
        loads: Numbers = None,
        *,
        initial_inputs: Numbers = None,
        threads: int | None = None,
        lanes: int | None = None,
        device: Device = "cpu",
        traced: int | None = None,
        controllers: Sequence[Controller] | None = None,
        turn: AbstractContextManager[object] | None = None,
    ) -> EnsembleResult:
        """Make N runs.

        Parameters
        ----------
        parameters : (N, P) array, sequence of N mappings by name, or mapping of arrays (N, …) by name
            Of each plant; an array in the order of `ParameterTable.vector`, mappings have those that differ from the
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
        threads, lanes : int, optional
            Results do not depend on them. By default `thread_count`, and `LANES` where the runs are worth a kernel
            of them.
        device : {"cpu", "gpu"}
            Where the runs are made; few of them are on the processor. Results do not depend on it.
        traced : int, optional
            The first runs, whose signals are kept; all by default.
        controllers : N Controllers, optional
            Of each run, which differ from the ensemble's in numbers alone: see `own_laws`.
        turn : context manager, optional
            Held from the first run until a thread has none left, for callers that make runs side by side.

        Raises
        ------
        InvalidInput
            For arrays that do not fit, and for a plant that is too fast for this period.
        FlexhinfError
            Without a GPU, where there should be one, and for a model that calls the C library, such as tanh.
        """
        one_of("There is no such device.", device, get_args(Device))
        plants = self._plants(parameters, seeds, initial_states, loads, initial_inputs, controllers)
        threads = thread_count() if threads is None else threads
        few = lanes is None and self._few(plants)
        lanes = LANES if lanes is None else lanes
        recorded = self._room(len(plants), traced)
        if not few and device == "cpu":
            self._in_lanes(plants, lanes, threads, recorded, turn=turn)
        else:
            with turn or nullcontext():
                if few:
                    self._alone(plants, threads, recorded)
                else:
                    self._on_gpu(plants, recorded)
        failed = recorded.codes != 0
        diverged_at = np.where(failed, recorded.steps * self.command.period, np.nan)
        recorded.reduction_memory[:, failed] = np.nan
        ends = np.cumsum([len(reduction.start) for reduction in self.reductions])[:-1]
        memories = iter(np.split(recorded.reduction_memory, ends))
        results: list[dict[str, Vector]] = []
        for several in (*self.tracking.values(), self.common):
            named = [reduction.result(next(memories), self.command) for reduction in several]
            results.append({key: np.array(row, dtype=float) for part in named for key, row in part.items()})
            for values in results[-1].values():
                values[failed] = np.nan
        *by_state, common = results
        return EnsembleResult(
            recorded.codes,
            diverged_at,
            plants.parts,
            dict(zip(self.tracking, by_state)),
            common,
            recorded.kept,
            Told(*recorded.told.astype(int)),
        )

    def trajectories(
        self,
        parameters: PlantParameters,
        seeds: ArrayLike = 0,
        initial_states: Numbers = None,
        loads: Numbers = None,
        *,
        initial_inputs: Numbers = None,
    ) -> Iterator[Trajectory]:
        """The same runs with all signals, a few at a time, for metrics without a reduction; arguments as for `run`."""
        plants = self._plants(parameters, seeds, initial_states, loads, initial_inputs)
        disturbances = self._disturbances(plants)
        threads = thread_count()
        if self._few(plants):
            settings = [self._settings(plants, k) for k in range(len(plants))]
            yield from (run for run, _, _ in self._in_turn(plants, settings, threads))
            return
        names = signal_names(self.plant, self.controller)
        kept = tuple((kind, k) for kind, some in names.items() for k in range(len(some)))
        everything = np.arange(self.command.samples)
        whole = replace(self, tracking={}, common=(), kept=kept, instants=everything)
        ends, times = np.cumsum([len(some) for some in names.values()])[:-1], everything * self.command.period
        for first in range(0, len(plants), threads * LANES):
            rows = slice(first, first + threads * LANES)
            own = {name: values[rows] for name, values in plants.own.items()}
            some = EnsemblePlants(plants.truth[rows], plants.parts[rows], plants.seeds[rows], own)
            result = whole._in_lanes(some, LANES, threads, whole._room(len(some)), disturbances)
            for k, row in enumerate(result.kept):
                recorded = dict(zip(names, np.split(row, ends, axis=1)))
                acting = (
                    disturbances[int(some.parts[k])][:, 0, 0] * some.own["load"][k]
                    if disturbances
                    else np.zeros((len(times), len(self.plant.disturbances)))
                )
                kinds = ("state", "estimate", "output", "input")
                signals = {kind: recorded[kind] for kind in kinds} | {
                    "reference": self.commands[: len(times)],
                    "disturbance": acting,
                }
                yield Trajectory.until(
                    self.plant,
                    self.controller,
                    times,
                    signals,
                    self._settings(some, k),
                    int(result.codes[k]),
                    int(result.steps[k]),
                    Told(*result.told[:, k].astype(int).tolist()),
                )

    def single(self, seed: int, parts: int) -> PreparedRun:
        """The run of the nominal plant, with so many sub-steps, before it is made."""
        check_seed(seed)
        truth, own = self.plant.parameters.vector(), {"x": self.start["x"][None, :]}
        plants = EnsemblePlants(truth[None, :], np.array([parts]), np.array([seed], np.uint64), own)
        start = start_text(self.plant, self.start["x"], self.placed, self.controller, self.start["held"])
        settings = {**self.settings, "seed": seed, "sub_steps": parts, "start": start}
        return self._prepared(plants, self._disturbances(plants), 0, settings)

    # Execution modes --------------------------------------------------------------------------------
    def _few(self, plants: EnsemblePlants) -> bool:
        return len(plants) < LANES or len(plants) * self.command.samples < worth_lanes()

    def _room(self, count: int, traced: int | None = None) -> Recorded:
        kept = (count if traced is None else min(traced, count), len(self.instants), len(self.kept))
        memories = len(self.reduction_memory), count
        codes, steps = (np.zeros(count, int) for _ in range(2))
        return Recorded(codes, steps, np.zeros(memories), np.zeros(kept), np.zeros((3, count)))

    def _in_lanes(
        self,
        plants: EnsemblePlants,
        lanes: int,
        threads: int,
        recorded: Recorded,
        disturbances: Disturbances | None = None,
        turn: AbstractContextManager[object] | None = None,
    ) -> Recorded:
        works: list[Callable[[], None]] = []
        for rows, number, data in self._arrays(plants, disturbances):
            batches = [rows[k : k + lanes] for k in range(0, len(rows), lanes)]
            work = partial(
                self._work, self.kernel(number, lanes, "data" in plants.own), data, iter(batches), recorded
            )
            works += [work] * min(threads, len(batches))
        with ThreadPoolExecutor(max(1, min(threads, len(works)))) as pool:
            with turn or nullcontext():
                begun = [pool.submit(work) for work in works]
                # then a thread has nothing left to do, and those of the next turn need not wait for the last one
                for done in islice(as_completed(begun), max(1, len(begun) - threads + 1)):
                    done.result()
            for done in begun:
                done.result()
        return recorded

    def _on_gpu(self, plants: EnsemblePlants, recorded: Recorded) -> None:
        told, whole = Told.places(self.controller.memory.places), self.reduction_memory
        instants = self.instants if len(recorded.kept) else self.instants[:1]  # where no signal is kept
        columns = np.add.outer(instants * len(self.kept), np.arange(len(self.kept)))
        places = {"reduction_memory": np.arange(len(whole)), "kept": columns.ravel()}
        places["memory"] = np.array([place for _, place in told], dtype=int)
        places = {name: some for name, some in places.items() if len(some)}
        for rows, number, data in self._arrays(plants):
            kernel = self._gpu_kernel(number, tuple(places), "data" in plants.own)
            ended = kernel.run(data.taken(rows), len(rows), places)
            recorded.codes[rows], recorded.steps[rows] = ended.codes, ended.steps
            for (row, _), counts in zip(told, ended.returned.get("memory", ()), strict=True):
                recorded.told[row, rows] = counts
            if len(whole):
                recorded.reduction_memory[:, rows] = ended.returned["reduction_memory"]
            if self.kept:
                kept = ended.returned["kept"].reshape(*columns.shape, -1)
                self._keep(recorded, rows, kept)

    def _arrays(
        self, plants: EnsemblePlants, disturbances: Disturbances | None = None
    ) -> Iterator[tuple[np.ndarray, int, PlantArrays]]:
        """Rows of plants with one number of sub-steps, that number, and the arrays of all plants."""
        own = {**plants.own, "truth": np.column_stack([self.command.period / plants.parts, plants.truth])}
        if "deviation" in self.shared:
            own["key"] = np.column_stack([np.zeros(len(plants)), *seed_key(plants.seeds)])
        samples = self.command.samples
        start = {**self.start, "step": np.zeros(1), "reduction_memory": self.reduction_memory}
        start = {name: column for name, column in start.items() if name not in own}
        counts, waiting = {"steps": samples, "parts": 0}, self.channel.delay
        if waiting and "held" in own:
            own["inputs"] = np.tile(own["held"], (1, waiting))
        elif waiting:
            start["inputs"] = np.tile(start["held"], waiting)
        sizes = {name: column.shape[-1] for name, column in (start | own).items()}
        if waiting:
            sizes["inputs"], counts["late"] = (samples + waiting) * sizes["held"], waiting * sizes["held"]
        sizes["kept"] = samples * len(self.kept)
        values = self._disturbances(plants) if disturbances is None else disturbances
        for number in np.unique(plants.parts).tolist():
            shared = {name: array for name, array in self.shared.items() if name not in own}
            shared |= {"disturbance": values[number].ravel()} if values else {}
            data = PlantArrays(start, own, shared, {**counts, "parts": number}, sizes)
            yield np.flatnonzero(plants.parts == number), number, data

    def _work(
        self, kernel: Kernel, data: PlantArrays, queue: Iterator[np.ndarray], recorded: Recorded
    ) -> None:
        samples, lanes, start, own = self.command.samples, kernel.lanes, data.start, data.own
        arrays = {
            name: aligned(size * lanes).reshape(size, lanes) for name, size in data.sizes.items() if size
        }
        run = kernel.bind({**data.shared, **arrays}, data.counts)
        for rows in queue:  # an iterator of a list, from which each thread takes the next
            count = len(rows)
            filled = np.append(rows, np.repeat(rows[-1:], lanes - count))  # idle lanes repeat one
            for name in arrays.keys() & start.keys():
                arrays[name][: len(start[name])] = start[name][:, None]
            for name in arrays.keys() & own.keys():
                arrays[name][: own[name].shape[1]] = own[name][filled].T
            run()
            ends = np.array([run.status.code, run.status.step]).reshape(2, -1)
            recorded.codes[rows], recorded.steps[rows] = ends[:, :count]
            told = Told.in_memory(self.controller.memory.places, arrays["memory"])
            recorded.told[:, rows] = [counts[:count] for counts in told]
            if "reduction_memory" in arrays:
                recorded.reduction_memory[:, rows] = arrays["reduction_memory"][:, :count]
            if self.kept and rows[0] < len(recorded.kept):
                kept = arrays["kept"].reshape(samples, len(self.kept), -1)[self.instants]
                self._keep(recorded, rows, kept)

    def _keep(self, recorded: Recorded, rows: np.ndarray, kept: np.ndarray) -> None:
        """Enter signals (T, j, N) of some runs, but for what is after the last sample of one that failed."""
        rows = rows[rows < len(recorded.kept)]
        recorded.kept[rows] = kept[..., : len(rows)].transpose(2, 0, 1)
        for row in rows[recorded.codes[rows] != 0]:
            recorded.kept[row, self.instants > recorded.steps[row]] = np.nan

    def _alone(self, plants: EnsemblePlants, threads: int, recorded: Recorded) -> None:
        settings = [dict(self.settings) for _ in range(len(plants))]
        for k, (run, code, last) in enumerate(self._in_turn(plants, settings, threads)):
            recorded.codes[k], recorded.steps[k] = code, last
            recorded.told[:, k] = run.told
            if code == 0 and len(recorded.reduction_memory):
                reduction_memory = self.reduction_memory
                arrays = {
                    **{name: run.signals[name].ravel() for name in ("state", "estimate", "output", "input")},
                    **self.shared,
                    **{"reduction_memory": reduction_memory, "step": np.zeros(1)},
                }
                names = [buffer.name for buffer in self._reducer.program.buffers]
                self._reducer.run({name: arrays[name] for name in names}, {"steps": len(run.time)})
                recorded.reduction_memory[:, k] = reduction_memory
            passed = self.instants < len(run.time)
            recorded.kept[k : k + 1, ~passed] = np.nan  # nothing, of a run that is not traced
            for j, (kind, column) in enumerate(self.kept):
                recorded.kept[k : k + 1, passed, j] = run.signals[kind][self.instants[passed], column]

    def _in_turn(
        self, plants: EnsemblePlants, settings: Sequence[dict[str, Any]], threads: int
    ) -> Iterator[tuple[Trajectory, int, int]]:
        disturbances = self._disturbances(plants)

        def run_of(k: int) -> tuple[Trajectory, int, int]:
            return self._prepared(plants, disturbances, k, settings[k]).run()

        with ThreadPoolExecutor(threads) as pool:
            yield from pool.map(run_of, range(len(plants)))

    def _prepared(
        self, plants: EnsemblePlants, disturbances: Disturbances, k: int, settings: dict[str, Any]
    ) -> PreparedRun:
        parts, samples = int(plants.parts[k]), self.command.samples
        code = LoopCode(self.plant, self.controller, self.channel, parts)
        own = {**self.start, **{name: rows[k] for name, rows in plants.own.items()}}
        noise = sample_noise(
            self.shared.get("deviation"), int(plants.seeds[k]), samples, self.controller.measured
        )
        acting = np.zeros((samples, code.sizes["d"]))
        if disturbances:
            values = disturbances[parts] * own["load"] if "load" in own else disturbances[parts]
            acting = values[:, 0, 0].copy()
        else:  # one array for all runs: pages that are never written take no memory
            values = zeros(samples * code.sizes["capacity"] * 3 * code.sizes["d"])
        arrays = {
            **{name: own[name] for name in ("x", "held", "memory")},
            "u": own["held"].copy(),
            "data": own.get("data", self.shared["data"]),
            "noise": noise.ravel(),
            "truth": np.concatenate([[self.command.period / parts], plants.truth[k]]),
            "reference": self.commands.ravel(),
            "disturbance": values.ravel(),
        }
        arrays |= {
            name: array for name, array in (own | dict(self.shared)).items() if name in ("waiting", "gaps")
        }
        recorded = {"reference": self.commands[:samples], "disturbance": acting}
        times = np.arange(samples) * self.command.period
        return PreparedRun(code, times, arrays, recorded, settings, self.shared.get("deviation"))

    # What the runs have -----------------------------------------------------------------------------
    def _plants(
        self, parameters: Any, seeds: Any, states: Any, loads: Any, inputs: Any, controllers: Any = None
    ) -> EnsemblePlants:
        plant, controller, table = self.plant, self.controller, self.plant.parameters
        several: Any = parameters
        if isinstance(parameters, Mapping) or (
            isinstance(parameters, Sequence) and all(isinstance(row, Mapping) for row in several)
        ):
            truth = table.vectors(several)
        else:
            truth = real_array(cast(object, parameters))
            if truth.ndim != 2 or truth.shape[1] != table.size or not np.all(np.isfinite(truth)):
                raise InvalidInput(
                    "The parameters do not fit the plant.",
                    f"expected rows of {table.size} finite numbers for {list(table.names)}, "
                    f"got {value_text(cast(object, parameters))}",
                    "plant.parameters.vectors([...]), or mappings by name",
                )
        count = len(truth)

        def rows(what: str, values: Any, default: np.ndarray) -> np.ndarray:
            shape = (count, len(default))
            if values is None:
                return np.broadcast_to(default, shape)
            return checked_array(
                f"The {what} do not fit the plants.",
                values,
                shape,
                f"finite numbers of shape {shape}",
                "one row for each plant",
            )

        own = {"x": rows("initial states", states, self.start["x"])}
        if self.disturbance is not None:
            own["load"] = rows("loads", loads, np.ones(len(plant.disturbances)))
        elif loads is not None:
            raise InvalidInput(
                "There is no disturbance that loads could be factors of.",
                "expected loads=None",
                "a disturbance in Loop.ensemble",
            )
        if inputs is not None:
            held = rows("initial inputs", inputs, self.start["held"])
            own["held"] = np.array([controller.input_before(row) for row in held]).reshape(held.shape)
            own["memory"] = np.array([controller.initial_memory(input=row) for row in held]).reshape(
                count, -1
            )
        if controllers is not None:
            own |= law_rows(self.start["memory"], controller, controllers, count, inputs, self.initial_input)
        if self.sub_steps is None:  # those of a `Loop` of each plant alone
            point = operating_state(plant.states, controller)
            modes = fastest_modes(plant, truth, point, controller.law.operating_input)
            parts = np.array([sub_steps(controller.period, mode) for mode in modes.tolist()], dtype=int)
        else:
            parts = np.full(count, self.sub_steps)
        return EnsemblePlants(truth, parts, _seeds(seeds, count), own)

    def _disturbances(self, plants: EnsemblePlants) -> Disturbances:
        if self.disturbance is None:
            return {}
        arguments = self.disturbance, self.command.period, self.command.samples
        return {
            parts: sample_disturbance(*arguments, parts, self.plant.disturbances, capacity(parts))
            for parts in np.unique(plants.parts).tolist()
        }

    def _settings(self, plants: EnsemblePlants, k: int) -> dict[str, Any]:
        own = {**self.start, **{name: rows[k] for name, rows in plants.own.items()}}
        plant = self.plant.with_parameters(**vars(self.plant.parameters.named(plants.truth[k])))
        placed = self.placed or not np.array_equal(own["x"], self.start["x"])
        return {
            **self.settings,
            "seed": int(plants.seeds[k]),
            "sub_steps": int(plants.parts[k]),
            "start": start_text(plant, own["x"], placed, self.controller, own["held"]),
        }

    # What is compiled -----------------------------------------------------------------------------
    @cached_property
    def reductions(self) -> tuple[Reduction, ...]:
        """All reductions, in the order of their memories."""
        return (*(reduction for several in self.tracking.values() for reduction in several), *self.common)

    @property
    def reduction_memory(self) -> np.ndarray:
        """Memory of all reductions before the first sample."""
        return np.array([number for reduction in self.reductions for number in reduction.start])

    def kernel(self, sub_steps: int, lanes: int = LANES, own_law: bool = False) -> Kernel:
        """Compiled program of as many runs as lanes; without a disturbance it serves any number of sub-steps."""
        key, program = self._program(sub_steps, own_law)
        return share((*key, lanes), lambda: compile_program(program(), lanes, self.controller.fused))

    def _gpu_kernel(self, sub_steps: int, returned: tuple[str, ...], own_law: bool) -> GpuKernel:
        key, program = self._program(sub_steps, own_law)
        return share((*key, returned), lambda: GpuKernel(program(), returned, self.controller.fused))

    def _program(
        self, sub_steps: int, own_law: bool = False
    ) -> tuple[tuple[object, ...], Callable[[], Program]]:
        """Key of the program of many runs, and what writes it."""
        disturbed = self.disturbance is not None
        code = LoopCode(self.plant, self.controller, self.channel, sub_steps if disturbed else 1)
        delayed = self.channel.delay > 0
        options = EnsembleOptions("deviation" in self.shared, disturbed, delayed, self.kept, own_law)
        key = *code.key, "ensemble", options, tuple(reduction.code_key for reduction in self.reductions)
        return key, lambda: loop_program(code, options, self.reductions)

    @cached_property
    def _reducer(self) -> Kernel:
        sizes = LoopCode(self.plant, self.controller, self.channel, 1).sizes
        return share(
            ("reductions", *sizes.values(), tuple(reduction.code_key for reduction in self.reductions)),
            lambda: compile_program(reduction_program(sizes, self.reductions)),
        )


def _seeds(seeds: Any, count: int) -> np.ndarray:
    """Seeds (N,) of 64 bits, from one of all runs or from one of each; others are refused."""
    if np.ndim(seeds) == 0:
        check_seed(seeds)
        return np.full(count, seeds, dtype=np.uint64)
    if getattr(seeds, "dtype", None) != np.uint64:  # else no other number fits
        for seed in seeds:
            check_seed(seed)
    refuse_if(
        len(seeds) != count,
        "The seeds do not fit the plants.",
        f"expected {count} integers, got {len(seeds)}",
        "one for each plant",
    )
    return np.array(seeds, dtype=np.uint64)
