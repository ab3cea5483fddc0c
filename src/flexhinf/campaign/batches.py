"""A campaign as a value, and the rows of its batches: a pure function of the campaign and the number of the batch."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from itertools import chain, pairwise
from typing import TypeAlias, get_args

import numpy as np

from flexhinf import __version__
from flexhinf.campaign.damping import LinearDamping, LinearPlant
from flexhinf.campaign.draws import (
    DIGITS,
    Draw,
    DrawFunction,
    FunctionDraw,
    campaign_digest,
    fingerprint,
    is_library_code,
    number_hash,
    option_text,
    sample_seed,
    sample_seeds,
)
from flexhinf.campaign.metrics import (
    COMPLETED,
    DIVERGED,
    NOT_RUN,
    UNSTABLE,
    MetricsLike,
    chosen_metrics,
    is_unstable,
    stability_reduction,
)
from flexhinf.campaign.samples import Sample, SampleColumns, index_array, taken
from flexhinf.codegen import cuda
from flexhinf.codegen.gpu import Device
from flexhinf.codegen.program import Unsupported
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.loop import Ensemble, EnsembleResult, Loop, Trajectory
from flexhinf.loop.simulation.inputs import (
    EnsembleArguments,
    RunOptions,
    SampleOptions,
    sample_count,
    starting_state,
)
from flexhinf.plant import Plant
from flexhinf.validation import checked_kind, is_integer, one_of, value_text

#: Largest number of samples: the length of a Sobol sequence, and of a 32-bit counter.
MOST_SAMPLES = 1 << 29

#: Length of a run, by default, s.
DURATION = 8.0

#: Samples of a batch, by default and at most.
BATCH, LARGEST_BATCH = 256, 65_536

#: Steps of a batch by default, times the cube of the states: 0.2 s of a core. A file costs some ms whatever it holds,
#: so that of short runs it holds more, at most so many times `BATCH`.
WORK, MOST_TIMES = 1 << 27, 16

#: Instants at which signals are kept, and the number of runs (the first ones) whose signals are kept.
INSTANTS, TRACED = 200, 10_000

#: Prefix of the columns of kept signals; and the columns that every campaign has.
TRACE = "trace."
OWN = ("sample", "seed", "status", "diverged_at_s", "failure")

#: Kind of a column with the metric of a part, such as one joint; another column has the worst of all parts.
PART = "part metric"

#: The execution mode of samples that run one by one.
ALONE = "alone"

#: Samples by which a campaign is judged to be one for a GPU.
FIRST = 8

#: Options in which the samples of one ensemble may differ, besides parameters, noise and loads.
_BATCHABLE = frozenset({"initial_state", "initial_input"})

#: Length, in samples, of the run that distinguishes loops.
PROBE = 100


@dataclass(frozen=True)
class TableColumn:
    """A column of the table; its kind is own, parameter, metric, `PART` or trace."""

    name: str
    kind: str
    unit: str = ""

    @property
    def judged(self) -> bool:
        """Whether the column is a metric, of the whole run or of a part such as one joint."""
        return self.kind in ("metric", PART)


class Campaign:
    """Description of a campaign: everything that its samples depend on.

    `loop`: with the nominal true plant; controller and estimator stay as they are.
    `seed`: 0 … 2⁶³ − 1.
    `options`: of `Loop.run`, for every sample.
    `metrics`: see `chosen_metrics`.
    `signals`: states that are kept at some instants, for bands; by default the tracked ones.
    `batch`: samples of a batch; by default `BATCH`, or more of short runs. No sample depends on it.
    `about`: further settings that are compared when the campaign continues, such as the specification of a design.
    `linear_plant`: the true plant of linear loops, by default that of the runs.

    `batches`: their number. `instants`, `time`: samples (T,) at which signals are kept, and their times, s; the first
    and the last of a run are among them.

    Raises InvalidInput, before any work: for numbers out of range, unknown metrics or signals, a draw that does not fit
    the plant.
    """

    def __init__(
        self,
        loop: Loop,
        draw: Draw | DrawFunction,
        samples: int,
        seed: int = 0,
        options: RunOptions | None = None,
        metrics: MetricsLike = None,
        signals: Sequence[str] | None = None,
        batch: int | None = None,
        about: Mapping[str, str] | None = None,
        linear_plant: LinearPlant | None = None,
    ) -> None:
        checked_kind("A campaign needs a loop.", loop, Loop, "a Loop", "fh.Loop(plant, controller)")
        if not isinstance(draw, Draw):
            refuse_if(
                not callable(draw),
                "The draw is no function.",
                f"expected a Draw or a function of a generator, got {value_text(draw)}",
                "robot.draw, or flexhinf.campaign.Tolerances([...])",
            )
            draw = FunctionDraw(draw)
        check_counts(samples, seed, BATCH if batch is None else batch)
        self.loop, self.draw, self.samples, self.seed, self.about = loop, draw, samples, seed, about or {}
        self.linear_plant = linear_plant
        stated: RunOptions = options or {}
        self.duration = stated.get("duration", DURATION)
        self.options: RunOptions = {"duration": self.duration, **stated}
        tracked = loop.controller.judged
        self.metrics = chosen_metrics(
            metrics, bool(tracked), loop.controller.doubts, loop.controller.protection is not None
        )
        self.signals = tuple(tracked if signals is None else signals)
        last = sample_count(self.duration, loop.controller.period) - 1
        self.instants = np.unique(np.linspace(0, last, min(INSTANTS, last + 1)).round().astype(int))
        self.time = self.instants * loop.controller.period
        self.batch = self._usual_batch(last + 1) if batch is None else batch
        self.batches = -(-samples // self.batch)
        names = [*OWN, *self._first.row(), *(name for metrics in self.metrics for name in metrics.units)]
        clash = sorted({name for name in names if names.count(name) > 1})
        refuse_if(
            clash,
            "Two columns of the campaign have one name.",
            f"expected names that are neither those of parameters and metrics at once nor of {list(OWN)}, "
            f"got {clash}",
            "another name for the metric or the variable",
        )
        known = list(dict.fromkeys((*loop.true_plant.states, *loop.controller.measured)))
        for name in self.signals:
            one_of(f"There is no signal {name!r}.", name, known)
        if not self._first.failure and isinstance(loop.true_plant, Plant):
            first = self._first
            self.loop_of(first).prepared(**self._options_of(first), seed=sample_seed(self.seed, 0))

    @cached_property
    def _some(self) -> Sequence[Sample]:
        return self.draw.samples([0], self.samples, self.seed)

    @property
    def _first(self) -> Sample:
        return self._some[0]

    def _usual_batch(self, steps: int) -> int:
        """Samples of a batch of runs of so many steps; runs that are made one by one are slower than `WORK` says."""
        alone = not self._reduces or self._mode(self._first) == ALONE
        times = WORK // (BATCH * steps * len(self.loop.true_plant.states) ** 3)
        return BATCH if alone else BATCH * max(1, min(times, MOST_TIMES))

    def indices(self, batch: int) -> range:
        """Indices of the samples of a batch."""
        return range(batch * self.batch, min((batch + 1) * self.batch, self.samples))

    @cached_property
    def columns(self) -> tuple[TableColumn, ...]:
        """Columns of the table, in their order."""
        units, plant = self.draw.units, self.loop.true_plant.units
        return (
            *(TableColumn(name, "own", "s" if name.endswith("_s") else "") for name in OWN),
            *(TableColumn(name, "parameter", units.get(name, "")) for name in self._first.row()),
            *(
                TableColumn(name, PART if name in metric.parts else "metric", unit)
                for metric in self.metrics
                for name, unit in metric.units.items()
            ),
            *(TableColumn(TRACE + name, "trace", plant.get(name, "")) for name in self.signals),
        )

    def loop_of(self, sample: Sample) -> Loop:
        """The loop of one sample; it has the campaign's sub-steps, so that all samples share a kernel."""
        plant = self.loop.true_plant if sample.plant is None else sample.plant
        if sample.parameters:
            if not isinstance(plant, Plant):
                raise InvalidInput(
                    "The true plant has no parameters that could be drawn.",
                    f"expected a Plant, got {type(plant).__name__}",
                    "a draw that returns Sample(plant=…), a plant of its own for each sample",
                )
            plant = plant.with_parameters(**sample.parameters)
        return self.loop.with_plant(plant, sample.delay)

    def _options_of(self, sample: Sample) -> SampleOptions:
        options: SampleOptions = {**self.options, **sample.options}
        if "reference" in sample.options:  # what a signal keeps of a run goes with the copy
            options["reference"] = copy(sample.options["reference"])
        return options

    def sample(self, index: int) -> Sample:
        """The sample of this number; InvalidInput if there is none."""
        checked_integer("sample", index, 0, self.samples - 1, "0")
        return self.draw.samples([index], self.samples, self.seed)[0]

    def replay(self, index: int) -> Trajectory:
        """Run one sample alone, bit by bit as in the campaign; InvalidInput where it cannot be run."""
        sample = self.sample(index)
        refuse_if(sample.failure, f"Sample {index} cannot be run.", sample.failure, "another sample")
        return next(self.trajectories([index], [sample]))

    def trajectories(self, indices: Sequence[int], samples: Sequence[Sample]) -> Iterator[Trajectory]:
        """Simulate samples one after the other, with all their signals and the noise of these indices, in order."""
        modes = [self._mode(sample) for sample in samples]
        runs: dict[str, Iterator[Trajectory]] = {}
        for mode in dict.fromkeys(modes):
            some = [(index, sample) for index, sample, own in zip(indices, samples, modes) if own == mode]
            runs[mode] = (
                (
                    self.loop_of(sample).run(**self._options_of(sample), seed=sample_seed(self.seed, k))
                    for k, sample in some
                )
                if mode == ALONE
                else self._recorder.trajectories(**self.plants(*zip(*some)))
            )
        yield from (next(runs[mode]) for mode in modes)

    def plants(
        self, indices: Sequence[int], samples: Sequence[Sample], *, seeds: np.ndarray | None = None
    ) -> EnsembleArguments:
        """Arguments of `Ensemble.run` for samples of one mode: their plants, seeds (those of their indices), starts
        and loads."""
        seeds = sample_seeds(self.seed, indices) if seeds is None else seeds
        if isinstance(samples, SampleColumns):
            return self._columns(seeds, samples)
        plant = self.loop.true_plant
        common = self.options.get("initial_state")
        starts = [sample.options.get("initial_state", common) for sample in samples]
        inputs = [sample.options["initial_input"] for sample in samples if "initial_input" in sample.options]
        self._check_loads({name for sample in samples for name in sample.loads})
        loaded = self.options.get("disturbance") is not None or any(sample.loads for sample in samples)
        loads = [[sample.loads.get(name, 1.0) for name in plant.disturbances] for sample in samples]
        return {
            "parameters": [sample.parameters for sample in samples],
            "seeds": seeds,
            "initial_states": np.array(
                [starting_state(start, plant.states, self.loop.controller) for start in starts]
            ),
            "initial_inputs": np.array(inputs) if inputs else None,
            "loads": np.array(loads) if loaded else None,
        }

    def _columns(self, seeds: np.ndarray, samples: SampleColumns) -> EnsembleArguments:
        """`plants` of samples that are columns already."""
        plant, states = self.loop.true_plant, samples.initial_states
        self._check_loads(samples.loads)
        if states is None:
            start = starting_state(self.options.get("initial_state"), plant.states, self.loop.controller)
            states = np.broadcast_to(start, (len(samples), len(start)))
        loads = None
        if self.options.get("disturbance") is not None or samples.loads:
            loads = np.ones((len(samples), len(plant.disturbances)))
            for name, column in samples.loads.items():
                loads[:, plant.disturbances.index(name)] = column
        return {"parameters": samples.parameters, "seeds": seeds, "initial_states": states, "loads": loads}

    def _check_loads(self, names: Iterable[str]) -> None:
        for name in names:
            one_of(
                f"There is no disturbance {name!r} that a load could be a factor of.",
                name,
                self.loop.true_plant.disturbances,
            )

    def _mode(self, sample: Sample) -> str:
        """Execution mode of a sample: alone, or batched with samples that all have an initial input, or all have
        none."""
        shared = isinstance(self.loop.true_plant, Plant) and sample.plant is None and not sample.delay
        mode = "with input" if "initial_input" in sample.options else "lanes"
        return mode if shared and set(sample.options) <= _BATCHABLE else ALONE

    def modes(self, samples: Sequence[Sample]) -> dict[str, list[int]]:
        """Positions of the samples by execution mode; samples whose signals are needed are under `ALONE`."""
        places: dict[str, list[int]] = {}
        if isinstance(samples, SampleColumns):  # all alike
            own = ALONE if self.ensemble is None else self._mode(samples[0])
            return {own: list(range(len(samples)))}
        for place, sample in enumerate(samples):
            if not sample.failure:
                places.setdefault(ALONE if self.ensemble is None else self._mode(sample), []).append(place)
        return places

    def check_device(self, device: object, here: bool = True) -> None:
        """Refuse what is no device, and a GPU for runs that are made one by one, or where there is none `here`.

        The first samples stand for all: where only some are, such as those with a plant of their own, these run on the
        processor.
        """
        one_of("There is no such device.", device, get_args(Device))
        if device == "cpu":
            return
        whole = [name for m in self.metrics if m.reduced is None for name in m.units]
        first = self.draw.samples(range(min(FIRST, self.samples)), self.samples, self.seed)
        refuse_if(
            not self._reduces or all(self._mode(sample) == ALONE for sample in first),
            "The runs of this campaign are made one by one, which a GPU does not.",
            "expected metrics that need no signals, and samples without a plant, delay, reference or disturbance of "
            f"their own, got {', '.join(whole) or 'others'}",
            cuda.ON_CPU,
        )
        if here:
            cuda.card()

    @property
    def is_library_code(self) -> bool:
        """Whether samples are drawn, run and reduced by code of flexhinf alone, many at once: in any thread."""
        draw = self.draw.function if isinstance(self.draw, FunctionDraw) else type(self.draw)
        batched = self.ensemble is not None and self._mode(self._first) != ALONE
        return batched and isinstance(self._some, SampleColumns) and is_library_code(draw)

    @property
    def _reduces(self) -> bool:
        """Whether no metric needs whole signals."""
        return isinstance(self.loop.true_plant, Plant) and all(m.reduced is not None for m in self.metrics)

    @cached_property
    def ensemble(self) -> Ensemble | None:
        """Simulation of many runs at once that keeps only numbers; None where a metric needs whole signals."""
        if not self._reduces:
            return None
        reductions = [reduction for metrics in self.metrics for reduction in metrics.reductions]
        ensemble = self._own_loop().ensemble(
            **self.options, reductions=reductions, kept=self.signals, instants=self.instants
        )
        return replace(ensemble, common=(*ensemble.common, stability_reduction(ensemble)))

    @cached_property
    def _recorder(self) -> Ensemble:
        return self._own_loop().ensemble(**self.options)

    @cached_property
    def linear_damping(self) -> LinearDamping:
        """Damping of the linear loop about the last command; InvalidInput where it is not known."""
        return LinearDamping.of(self.loop, self._recorder.command.last, self.linear_plant)

    def _own_loop(self) -> Loop:
        loop = Loop(self.loop.true_plant, self.loop.controller, self.loop.sub_steps)
        loop.channel = self.loop.channel
        return loop

    def __getstate__(self) -> dict[str, object]:
        """State to pickle for other processes: compiled code is left out."""
        return {
            name: value
            for name, value in vars(self).items()
            if name not in ("ensemble", "_recorder", "_some", "linear_damping")
        }

    @cached_property
    def settings(self) -> dict[str, str]:
        """Settings that the rows depend on, as text by name; two campaigns with the same settings are the same."""
        own = [m for m in self.metrics if m.function is not None and not is_library_code(m.function)]
        # controller, plant and the end of a short run distinguish two loops of the same description
        plant, controller = self.loop.true_plant, self.loop.controller
        duration = min(PROBE * controller.period, float(self.duration))
        short: RunOptions = {**self.options, "duration": duration}
        run = self.loop_of(Sample()).run(**short, seed=sample_seed(self.seed, 0))
        last = np.concatenate([run.signals[kind][-1] for kind in ("state", "estimate", "input")])
        return {
            "version": __version__,
            "samples": str(self.samples),
            "seed": str(self.seed),
            "batch": str(self.batch),
            **self.about,
            **self.draw.settings,
            **{name: option_text(value) for name, value in sorted(self.options.items())},
            # this distinguishes draws with the same code
            "first sample": ", ".join(
                f"{name} {value:.{DIGITS}g}" for name, value in self._first.row().items()
            ),
            "metrics": ", ".join(name for m in self.metrics for name in m.units),
            **{f"metric {', '.join(m.units)}": fingerprint(m.function) for m in own},
            "signals": ", ".join(self.signals),
            "period": repr(controller.period),
            "measured": ", ".join(controller.measured),
            "controller": number_hash(controller.data_vector),
            "sub-steps": str(self.loop.sub_steps),
            **({"plant": number_hash(plant.parameters.vector())} if isinstance(plant, Plant) else {}),
            "short run": " ".join(f"{value:.{DIGITS}g}" for value in last),
        }

    @cached_property
    def digest(self) -> str:
        """Digest of everything that the rows depend on, and of their columns."""
        return campaign_digest(
            self.settings, [astuple(column) for column in self.columns], self.time.tolist()
        )


def check_counts(samples: object, seed: object, batch: object) -> None:
    """Check the number of samples, the seed and the batch size of a campaign; InvalidInput if one is out of range."""
    checked_integer("samples", samples, 1, MOST_SAMPLES, "10000")
    checked_integer("seed", seed, 0, 2**63 - 1, "0")
    checked_integer("batch", batch, 1, LARGEST_BATCH, str(BATCH))


def checked_integer(name: str, value: object, smallest: int, largest: int, example: str) -> int:
    """Return an integer between `smallest` and `largest`; anything else is refused with InvalidInput."""
    if is_integer(value) and smallest <= int(value) <= largest:
        return int(value)
    raise InvalidInput(
        f"No such {name}." if name != "samples" else "The number of the campaign's samples is not usable.",
        f"expected an integer from {smallest} to {largest}, got {name}={value_text(value)}",
        f"{name}={example}",
    )


#: Rows of some samples: columns (N,) by name; a kept signal (N, T) of 32 bits, NaN where it is not kept and after a run
#: diverged.
Rows = dict[str, np.ndarray]

#: What one caller at a time holds; and what all may hold.
Turn: TypeAlias = AbstractContextManager[object]
ANY_TIME: Turn = nullcontext()


def run_batch(campaign: Campaign, batch: int, device: Device = "cpu") -> Rows:
    """The rows of one batch. They are the same on every machine of one kind, whatever else runs, on either device.

    InvalidInput if there is no such batch, or a sample's run or metric is refused; the message names the sample.
    """
    checked_integer("batch", batch, 0, campaign.batches - 1, "0")
    return rows_of(campaign, campaign.indices(batch), device=device)


def run_batches(
    campaign: Campaign, batches: Sequence[int], turn: Turn = ANY_TIME, device: Device = "cpu"
) -> list[Rows]:
    """The rows of several batches, made at once, which is faster than one after the other; `run_batch` of each."""
    parts = [campaign.indices(batch) for batch in batches]
    adjacent = all(before.stop == after.start for before, after in pairwise(parts))
    indices = range(parts[0].start, parts[-1].stop) if adjacent else [*chain(*parts)]
    rows, ends = (
        rows_of(campaign, indices, turn=turn, device=device),
        np.cumsum([0, *map(len, parts)]).tolist(),
    )
    return [{name: column[a:b] for name, column in rows.items()} for a, b in pairwise(ends)]


def rows_of(
    campaign: Campaign,
    indices: Sequence[int],
    samples: Sequence[Sample] = (),
    turn: Turn = ANY_TIME,
    device: Device = "cpu",
    traced: int | None = None,
) -> Rows:
    """The rows of samples, from the campaign or others; sample k has the noise of the k-th index.

    `turn`: Held while they run. `traced`: Signals are kept of samples with a smaller number, by default `TRACED`.
    """
    traced = TRACED if traced is None else traced
    samples = samples or campaign.draw.samples(indices, campaign.samples, campaign.seed)
    count, names = len(indices), {column.name for column in campaign.columns if column.kind == "parameter"}
    numbers = index_array(indices)
    unknown: np.ndarray = np.broadcast_to(np.float32(math.nan), (count, len(campaign.instants)))
    columns: Rows = {
        column.name: np.full(count, math.nan)
        if column.kind != "trace"
        else unknown.copy()
        if numbers.min() < traced
        else unknown
        for column in campaign.columns
    }
    columns |= {
        "sample": numbers,
        "seed": sample_seeds(campaign.seed, indices),
        **{name: np.full(count, "", dtype=object) for name in ("status", "failure")},
    }
    _fill_numbers(columns, samples, indices, names)
    modes = campaign.modes(samples)
    alone, place = modes.pop(ALONE, []), 0
    try:
        for some in modes.values():
            assert campaign.ensemble is not None
            places = np.array(some)
            plants = campaign.plants((), taken(samples, some), seeds=columns["seed"][places])
            kept = np.flatnonzero(columns["sample"][places] < traced)
            first = 1 + max(kept[-1:].tolist(), default=-1)
            result = campaign.ensemble.run(**plants, traced=first, device=device, turn=turn)
            fill_reduced(campaign, columns, places, result, kept)
        runs = campaign.trajectories([indices[k] for k in alone], taken(samples, alone))
        for place in alone:
            _fill_run(campaign, columns, place, next(runs), traced)
    except (cuda.CardError, Unsupported):  # it is not the samples that are refused
        raise
    except FlexhinfError as error:
        raise InvalidInput(
            f"Sample {indices[place]} of the campaign, or one up to {indices[-1]}, is refused.",
            " ".join(str(error).split()),
            "a draw and metrics that fit every sample",
        ) from error
    return columns


def _fill_numbers(columns: Rows, samples: Sequence[Sample], indices: Sequence[int], names: set[str]) -> None:
    """Enter the varied numbers of samples, and why some are not run."""

    def check(index: int, own: Iterable[str]) -> None:
        refuse_if(
            set(own) != names,
            f"Sample {index} has other numbers than the first one.",
            f"expected {sorted(names)}, got {list(own)}",
            "a draw that names the same parameters every time",
        )

    if isinstance(samples, SampleColumns):
        check(indices[0], samples.numbers)
        columns.update({name: np.array(column) for name, column in samples.numbers.items()})
        return
    for place, (index, sample) in enumerate(zip(indices, samples)):
        row = sample.row()
        check(index, row)
        for name, value in row.items():
            columns[name][place] = value
        if sample.failure:
            columns["status"][place], columns["failure"][place] = NOT_RUN, sample.failure


def fill_reduced(
    campaign: Campaign, columns: Rows, places: np.ndarray, result: EnsembleResult, kept: np.ndarray
) -> None:
    """Enter what runs at these places gave, and signals of those (K,) of them that are kept."""
    ended = np.where(result.common["unstable"] > 0.5, UNSTABLE, COMPLETED)
    columns["status"][places] = np.where(result.completed, ended, DIVERGED)
    columns["diverged_at_s"][places] = result.diverged_at
    for metrics in campaign.metrics:
        assert metrics.reduced is not None
        values = metrics.reduced(result)
        for name in metrics.units:
            columns[name][places] = np.where(result.completed, values[name], math.nan)
    with np.errstate(over="ignore"):  # values of a diverging run become infinite in 32 bits
        for k, name in enumerate(campaign.signals if len(kept) else ()):
            columns[TRACE + name][_span(places[kept])] = result.kept[_span(kept), :, k]


def _span(places: np.ndarray) -> np.ndarray | slice:
    """Ascending places, as a slice where none is left out: that copies nothing."""
    first, last = int(places[0]), int(places[-1])
    return slice(first, last + 1) if last - first + 1 == len(places) else places


def _fill_run(campaign: Campaign, columns: Rows, place: int, run: Trajectory, traced: int) -> None:
    if run.diverged_at is None:
        columns["status"][place] = UNSTABLE if is_unstable(run) else COMPLETED
        for metrics in campaign.metrics:
            for name, value in metrics(run).items():
                columns[name][place] = value
    else:
        columns["status"][place], columns["diverged_at_s"][place] = DIVERGED, run.diverged_at
    if columns["sample"][place] < traced:
        at = campaign.instants[: np.searchsorted(campaign.instants, len(run.time))]
        with np.errstate(over="ignore"):
            for name in campaign.signals:
                columns[TRACE + name][place, : len(at)] = run.tracked(name)[at]
