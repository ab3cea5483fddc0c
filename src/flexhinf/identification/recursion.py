"""A filter over a whole log as one compiled program, with steps of any length between the rows.

A row of the log is corrected with, and then predicted to the next one. The time to the next row is a parameter of the
plant: dx/dτ = T f(x, u) over one unit of τ, so that every filter takes irregular stamps, and nothing is compiled for
them. A gap of more than one period is several predictions, and R^v grows with the time that a prediction spans.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeVar, cast
from weakref import WeakKeyDictionary

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.codegen import (
    Block,
    Buffer,
    Composer,
    Copy,
    Guard,
    Kernel,
    Program,
    Repeat,
    Slice,
    compile_program,
)
from flexhinf.codegen.shared import share
from flexhinf.errors import NumericalFailure, refuse_if
from flexhinf.estimation.compiled import as_arrays
from flexhinf.estimation.filter import RecursiveFilter
from flexhinf.loop.controller.measured import by_flag
from flexhinf.loop.controller.memory import VectorLayout
from flexhinf.plant import Plant
from flexhinf.plant.parameters import Parameters
from flexhinf.scalars import cholesky, solve_lower
from flexhinf.validation import checked_kind

#: A parameter of the plant beside its own: the time of a prediction, s.
SECONDS = "prediction_seconds"

#: A prediction spans at most this much more than the filter's period; a gap that is longer is several predictions.
LONGER = 1.01


class Rows(NamedTuple):
    """A log as rows of the program: those between two samples, in a long gap, measure nothing.

    `seconds`: (K, 1), to the next row. `inputs`: (K + 1, m), u from a row on, after the one before the first row.
    `outputs`: (K, p). `measured`: (K, 1), whether any output is there. `places`: (N,), the rows of the log's samples.
    """

    seconds: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    measured: np.ndarray
    places: np.ndarray


def rows_of(times: np.ndarray, inputs: np.ndarray, outputs: np.ndarray, period: float) -> Rows:
    """Rows of at most one `period` (s) each, of times (N,), s, inputs (N, m) held from then on, and outputs (N, p)."""
    steps = np.append(np.diff(times), period)
    counts = np.maximum(1, np.ceil(steps / (LONGER * period))).astype(int)
    places = np.append(0, np.cumsum(counts)[:-1])
    measured = np.full((counts.sum(), outputs.shape[1]), np.nan)
    measured[places] = outputs
    held = np.repeat(inputs, counts, axis=0)
    return Rows(
        np.repeat(steps / counts, counts)[:, None],
        np.vstack([np.zeros((1, inputs.shape[1])), held]),
        measured,
        np.isfinite(measured).any(axis=1).astype(float)[:, None],
        places,
    )


class TimedFlow:
    """The flow of a plant per unit of the time of a prediction; of a map, the map itself."""

    def __init__(self, plant: Plant) -> None:
        self.flow, self.sampled = plant.flow, plant.sampled

    def __call__(self, x: Elements, u: Elements, d: Elements, p: Parameters) -> Elements:
        """dx/dτ (n,), on any element."""
        if self.sampled:
            return self.flow(x, u, d, p)
        return getattr(p, SECONDS) * np.asarray(self.flow(x, u, d, p))


#: A filter of the same kind.
FilterKind = TypeVar("FilterKind", bound=RecursiveFilter)


#: Filters whose time of a prediction is a parameter, as long as those that they are made of.
_TIMED = WeakKeyDictionary[RecursiveFilter, RecursiveFilter]()


def timed(filter: FilterKind) -> FilterKind:
    """The same filter with the time of a prediction as the last parameter of its plant; each is traced once."""
    if filter not in _TIMED:
        _TIMED[filter] = _timed(filter)
    return cast(FilterKind, _TIMED[filter])


def _timed(filter: FilterKind) -> FilterKind:
    plant = filter.plant
    scaled = replace(
        plant, flow=TimedFlow(plant), parameters={**plant.parameters.values, SECONDS: filter.period}
    )
    settings: dict[str, Any] = {**filter.settings()}
    settings |= {"plant": scaled, "period": 1.0}
    return type(filter)(**settings)


@dataclass(frozen=True, eq=False)
class Recursion:
    """The compiled pass of one filter over any log, whatever the parameters and the noises."""

    filter: RecursiveFilter

    def __post_init__(self) -> None:
        checked_kind(
            "A log is filtered by a Kalman filter.",
            self.filter,
            RecursiveFilter,
            "a RecursiveFilter",
            "fh.ExtendedKalmanFilter(plant, period, ...)",
        )

    @cached_property
    def timed(self) -> RecursiveFilter:
        """The filter with the time of a prediction as a parameter."""
        return timed(self.filter)

    @cached_property
    def layout(self) -> VectorLayout:
        """Of a belief as a flat vector."""
        return VectorLayout(self.filter.initial._asdict())

    @cached_property
    def written(self) -> dict[str, int]:
        """Numbers of a row by name, as `passed` returns them."""
        n, p = self.filter.plant.n, len(self.filter.plant.outputs)
        sizes = {"predictions": n, "expected": p, "innovations": p, "spreads": p * p, "facts": 2}
        return {**sizes, "beliefs": self.layout.size}

    def beliefs(self, rows: np.ndarray) -> Any:
        """Beliefs as flat rows (N, size) by part: a named tuple of arrays (N, ...)."""
        parts = {
            name: rows[:, place].reshape(len(rows), *cast("tuple[int, ...]", self.layout.parts[name]))
            for name, place in self.layout.places.items()
        }
        return type(self.filter.initial)(**parts)

    def deviations(self, beliefs: Any) -> np.ndarray:
        """Standard deviations (N, n) of the states, of beliefs as `beliefs` gives them."""
        if self.filter.form == "square_root":
            return np.sqrt(np.square(beliefs.root).sum(axis=1))
        return np.sqrt(np.maximum(np.diagonal(beliefs.covariance, axis1=1, axis2=2), 0.0))

    def covariances(self, beliefs: Any) -> np.ndarray:
        """Covariances (N, n, n) of beliefs as `beliefs` gives them."""
        rooted = self.filter.form == "square_root"
        return np.swapaxes(beliefs.root, 1, 2) @ beliefs.root if rooted else beliefs.covariance

    @property
    def kernel(self) -> Kernel:
        """The compiled program; filters of one kind and one plant's code share it."""
        key = ("log", type(self.filter), self.timed.estimator_key, self.timed.plant.code_key)
        return share(key, lambda: compile_program(self._program()))

    def _program(self) -> Program:
        filter, run = self.timed, Composer()
        n, p, m = filter.plant.n, len(filter.plant.outputs), len(filter.plant.inputs)
        sizes = {
            "parameters": filter.plant.parameters.size - 1,
            "process_noise": n * n,
            "measurement_noise": p * p,
        }
        rows = {"seconds": 1, "outputs": p, "measured": 1}

        def write(name: str, block: Block, first: int = 0) -> None:
            write_row(run, name, block, self.written[name], first)

        values, q, r = (
            Block(Slice(name, size=size) if size else None, shape)
            for (name, size), shape in zip(sizes.items(), ((sizes["parameters"],), (n, n), (p, p)))
        )
        kept = Block(Slice("belief", size=self.layout.size), (self.layout.size,))
        prior = type(filter.initial)(**vars(self.layout.named(kept)))
        before, u = read_row(run, "inputs", m), read_row(run, "inputs", m, m)
        seconds, y, flag = (read_row(run, name, size) for name, size in rows.items())
        vector = run.call(joined, values, seconds)
        write("predictions", prior.mean)
        write("expected", run.call(filter.output, prior.mean, before, vector))
        with run.when(flag):
            corrected, innovation, spread = filter.innovation_stages(
                run.as_run, prior, *as_arrays(y, before, vector, r)
            )
            facts = run.call(facts_of, innovation, spread)
        belief = type(prior)(*(run.call(by_flag, new, old, flag) for new, old in zip(corrected, prior)))
        for name, block in {"innovations": innovation, "spreads": spread, "facts": facts}.items():
            write(name, cast("Block", block))
        for part, place in self.layout.pairs(belief._asdict()):
            write("beliefs", part, place.start)
        predicted = filter.time_stages(run.as_run, belief, *as_arrays(u, vector, run.call(grown, q, seconds)))
        for part, place in self.layout.pairs(predicted._asdict()):
            run.copy(part, kept[place].reshape(part.shape))
        run.body.append(Guard(kept.place, 1))
        buffers = [
            Buffer("belief", self.layout.size, "state"),
            *(Buffer(name, size, "in") for name, size in sizes.items() if size),
            *(Buffer(name, None, "in") for name in (*rows, *(("inputs",) if m else ()))),
            *(Buffer(name, None, "out") for name in self.written),
        ]
        return Program(
            "filtered_log", (*buffers, *run.buffers), (Repeat("rows", tuple(run.body)),), ("rows",)
        )

    def passed(self, rows: Rows) -> dict[str, np.ndarray]:
        """What the filter makes of the rows of a log, by name, in arrays of so many rows (K, ...).

        `predictions` (K, n), x(k|k−1); `expected` (K, p), the outputs there; `innovations` (K, p) and `spreads`
        (K, p, p), zero and those of a unit where nothing is measured; `facts` (K, 2): squared innovations over their
        covariance, and the logarithm of its determinant; `beliefs`, x(k|k), flat. Raises NumericalFailure: at the
        sample after which a number is not finite.
        """
        filter, count = self.filter, len(rows.seconds)
        check_spacing(filter.plant, filter.period, rows.seconds[:, 0])
        arrays = {
            "process_noise": (filter.process_noise / filter.period).ravel(),  # per second
            "measurement_noise": np.ascontiguousarray(filter.measurement_noise).ravel(),
        }
        if filter.plant.parameters.size:
            arrays["parameters"] = filter.plant.parameters.vector()
        arrays |= {
            name: np.ascontiguousarray(getattr(rows, name))
            for name in ("seconds", "inputs", "outputs", "measured")
            if getattr(rows, name).size
        }
        arrays["belief"] = self.layout.flat(filter.initial._asdict()).copy()
        results = {name: np.empty((count, size)) for name, size in self.written.items()}
        status = self.kernel.run(arrays | results, {"rows": count})
        if status.code:
            sample = int(np.searchsorted(rows.places, status.step, side="right"))
            raise NumericalFailure(
                "The estimate is not finite: the model diverged, or the log does not fit it.",
                f"the last good one is at sample {sample} of {len(rows.places)}",
                "a smaller initial covariance, a larger process noise, or other parameters",
            )
        return results


def check_spacing(plant: Plant, period: float, seconds: np.ndarray) -> None:
    """Refuse times between rows (K,), s, over which a map of one `period`, s, does not go."""
    away = np.abs(seconds / period - 1.0)
    worst = int(np.argmax(away))
    refuse_if(
        plant.sampled and away[worst] > LONGER - 1.0,
        "A map goes over one period, and the rows of the log do not lie whole periods apart.",
        f"expected multiples of {period:g} s within 1 %, got steps of {seconds[worst]:g} s",
        "a plant in continuous time, or the log at regular times",
    )


def read_row(run: Composer, name: str, size: int, first: int = 0) -> Block:
    """A row (size,) of a record, `first` numbers further on, in memory that loops inside a row may read."""
    if not size:
        return Block(None, (0,))
    block = run.work((size,))
    run.body.append(Copy(Slice(name, first, size, strides=(size,)), block.place))
    return block


def write_row(run: Composer, name: str, block: Block, width: int, first: int = 0) -> None:
    """A block into a record's row of so many numbers (`width`), from its number `first` on."""
    run.copy(block, Block(Slice(name, first, block.size, strides=(width,)), block.shape))


def joined(first: Elements, second: Elements) -> Elements:
    """Two vectors as one."""
    return np.concatenate([first, second])


def grown(noise: Elements, seconds: Elements) -> Elements:
    """R^v (n, n) over so many seconds (1,), of that per second."""
    return noise * seconds[0]


def facts_of(innovation: Elements, spread: Elements) -> Elements:
    """The squared innovation (p,) over its covariance (p, p), and the logarithm of the determinant, (2,)."""
    factor = cholesky(spread)
    white = solve_lower(factor, innovation)
    return np.array([white @ white, 2.0 * np.log(np.diag(factor)).sum()])
