"""The log of a run in real time: CSV and Parquet, as PlotJuggler opens them, and MCAP, as Foxglove does too.

Columns are named ``state/link_position[rad]``: PlotJuggler makes a tree of the slashes and splits a header at commas
and spaces, so names have none, and a unit has ``_per_`` for its own slash. In MCAP each kind of signal is a topic with
messages of JSON and their JSON schema, the names without units, which the schema states.

A recorded run of a controller: measurements, commands and outputs of every sample. The C code must give the same.
"""

from __future__ import annotations

import importlib.util
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.export.realtime import RealTimeRun
from flexhinf.files import write_file
from flexhinf.loop import Controller, Loop, Samples
from flexhinf.validation import checked_path

#: The first part of a column's name, and its topic, where they are not the kind of the trajectory's signal.
KINDS = {"output": "measured"}

#: An input that is nearer than this to a limit, relative to its size, is at it.
AT_LIMIT = 1e-9


class LogColumn(NamedTuple):
    """One signal: its kind, name and unit, and its values (N,)."""

    kind: str
    name: str
    unit: str
    values: np.ndarray

    @property
    def label(self) -> str:
        """Its name in a table."""
        unit = self.unit.replace("/", "_per_").replace(" ", "_")
        name = self.name.replace(",", ";").replace(" ", "_").replace('"', "'")
        return f"{self.kind}/{name}" + (f"[{unit}]" if unit else "")


def log_columns(run: RealTimeRun) -> list[LogColumn]:
    """Everything that is logged: signals of the trajectory, flags, times of the samples.

    Flags are 0 or 1: ``missed_deadline`` and ``overrun`` as `Timing` has them, ``at_limit`` where an input is as large
    as it may be; ``code`` is how the controller's step ended, 0 for OK.
    """
    trajectory, timing = run.trajectory, run.timing
    u, (low, high) = trajectory.signals["input"], run.input_range
    with np.errstate(invalid="ignore"):  # an infinite limit is reached by nothing: ∞ − ∞ is NaN
        limited = (u <= low + AT_LIMIT * np.abs(low)) | (u >= high - AT_LIMIT * np.abs(high))
    flags = {
        "missed_deadline": timing.missed, "overrun": timing.overrun, "at_limit": limited.any(axis=1), "code": run.codes,
    }  # fmt: skip
    times = {
        "lateness": timing.woken, "step_time": timing.computed, "input_ready": timing.ready, "over": timing.over,
    }  # fmt: skip
    return [
        *(
            LogColumn(KINDS.get(kind, kind), *column)
            for kind, values in trajectory.signals.items()
            for column in zip(trajectory.names[kind], trajectory.units[kind], values.T, strict=True)
        ),
        *(LogColumn("flags", name, "", np.asarray(values, dtype=float)) for name, values in flags.items()),
        *(LogColumn("timing", name, "s", values) for name, values in times.items()),
    ]


def _table(run: RealTimeRun) -> dict[str, np.ndarray]:
    """Values by label, the time first; a label that occurs twice gets a number."""
    table: dict[str, np.ndarray] = {"time[s]": run.trajectory.time}
    for column in log_columns(run):
        label, count = column.label, 2
        while label in table:
            label, count = f"{column.label}_{count}", count + 1
        table[label] = column.values
    return table


def _write_csv(run: RealTimeRun, name: str) -> None:
    table = _table(run)
    np.savetxt(
        name, np.column_stack(list(table.values())), "%.17g", ",", header=",".join(table), comments="", encoding="utf-8"
    )  # fmt: skip


def _write_parquet(run: RealTimeRun, name: str) -> None:
    from pyarrow import parquet, table

    # compressed by snappy, which every reader has
    parquet.write_table(table(_table(run)).replace_schema_metadata(_settings(run)), name)


def _write_mcap(run: RealTimeRun, name: str) -> None:
    """One topic for each kind of signal; times are those of the run after the moment when it began."""
    from mcap.writer import Writer

    columns: dict[str, list[LogColumn]] = {}
    for column in log_columns(run):
        columns.setdefault(column.kind, []).append(column)
    with open(name, "wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="flexhinf")
        channels = dict[str, int]()
        for kind, group in columns.items():
            properties = {c.name: {"type": "number", "description": c.unit or "no unit"} for c in group}
            text = json.dumps({"type": "object", "properties": properties}).encode()
            schema = writer.register_schema(f"flexhinf.{kind}", "jsonschema", text)
            channels[kind] = writer.register_channel(f"/{kind}", "json", schema)
        for k, at in enumerate(run.trajectory.time.tolist()):
            moment = run.began + round(1e9 * at)
            for kind, group in columns.items():
                # numbers that are not finite have no JSON
                finite = {c.name: float(c.values[k]) for c in group if np.isfinite(c.values[k])}
                writer.add_message(channels[kind], moment, json.dumps(finite).encode(), moment, k)
        writer.add_metadata("flexhinf run", _settings(run))
        writer.finish()


def _settings(run: RealTimeRun) -> dict[str, str]:
    ended = "completed" if run.stopped is None else "stopped before its end"
    settings = {
        **run.trajectory.settings, "status": run.trajectory.message or ended, "codes": json.dumps(run.code_names),
        "began_ns_since_1970": run.began,
    }  # fmt: skip
    return {key: str(value) for key, value in settings.items()}


#: How a log is written, by its ending, and the packages that this needs.
FORMATS: dict[str, tuple[Callable[[RealTimeRun, str], None], tuple[str, ...]]] = {
    ".csv": (_write_csv, ()), ".parquet": (_write_parquet, ("pyarrow",)), ".mcap": (_write_mcap, ("mcap", "zstandard")),
}  # fmt: skip


def check_log(path: str | os.PathLike[str]) -> Path:
    """Refuse, before any work, a log that could not be written at its end.

    Raises InvalidInput: for another ending, a package that is missing, or a place that cannot be written.
    """
    path = checked_path("The log", path)
    csv = f"--log {path.stem or 'run'}.csv"
    found = f"expected a name that ends with {', '.join(FORMATS)}, got {str(path)!r}"
    refuse_if(path.suffix not in FORMATS, "The format of the log is not known.", found, csv)
    missing = [name for name in FORMATS[path.suffix][1] if importlib.util.find_spec(name) is None]
    refuse_if(
        missing,
        f"A log in {path.suffix[1:]} needs another package.",
        f"expected the package {', '.join(missing[:1])!r}, which is not installed, for {path.name}",
        f"pip install 'flexhinf[log]', or {csv}",
    )
    return check_place(path, "log")


def check_place(path: Path, what: str) -> Path:
    """Refuse a file in a folder that is missing or cannot be written, or with the name of a folder."""
    try:
        if path.is_dir():
            raise OSError("there is a folder of this name")
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except (OSError, ValueError) as error:
        found = f"{path}: {getattr(error, 'strerror', None) or error}"
        raise InvalidInput(
            f"The {what} cannot be written.", found, "a writable folder that exists"
        ) from error
    return path


def write_log(run: RealTimeRun, path: str | os.PathLike[str]) -> Path:
    """Write a run to a file, whole or not at all; its ending says the format, see `FORMATS`.

    Raises InvalidInput: as `check_log`.
    """
    path = check_log(path)
    write_file(path, "log", lambda name: FORMATS[path.suffix][0](run, name))
    return path


#: What a sample is, by the name of the code that a step in C returns for it.
MEASURED, MISSING, NOT_FINITE = "OK", "PREDICTED", "BAD_MEASUREMENT"

#: Size of the commands' swing about the operating point, in the unit of the tracked states, and its periods, samples.
SWING, PERIODS = 0.05, (97, 61)

#: Largest standard deviation of the noise in a recorded loop, in the unit of the measurement: the swing is to be seen.
LOUDEST = 0.1 * SWING


@dataclass(frozen=True, eq=False)
class Recording:
    """Recorded samples of a controller, in order.

    `y`, `r`: (K, p), (K, max(1, k)) arrays, measurements and commands. `u`, `estimate`: (K, m), (K, n) arrays, outputs
    of the controller, held where the sample was refused. `codes`: "OK", "PREDICTED" or "BAD_MEASUREMENT", one for each
    sample.
    """

    y: np.ndarray
    r: np.ndarray
    u: np.ndarray
    estimate: np.ndarray
    codes: list[str]


def record(
    controller: Controller,
    samples: int = 200,
    interrupted: bool = True,
    exact: type[np.floating] = np.float64,
) -> Recording:
    """Run a closed loop of the controller and the plant that its estimator believes in, with noise.

    The noise is that of the estimator's model: without it, measurements equal predictions, and a wrong gain would not
    be seen. The plant starts where the estimator believes it, as the design's own step does: started elsewhere, the
    estimate may be so wrong that the inputs stay at their limits, and any code would answer that. The commands swing
    about the operating point; without an estimator there is no plant, and the states swing too.

    `controller`: Only read. `interrupted`: Replay what was measured with samples left out and samples that are not
    finite. `exact`: Of numbers that hold the measurements and commands as they are.
    """
    time = np.arange(samples)[:, None]
    rest = controller.operating_reference
    j = np.arange(len(rest))
    r = np.tile(rest, (samples, 1))
    if not controller.mode.moving:
        r = rest + SWING * (np.sin(2.0 * np.pi * time / np.take(PERIODS, j % 2) + j) - np.sin(j))
    if controller.estimator is None:
        point = np.asarray(controller.law.operating_point)[: len(controller.states)]
        y = point + 0.01 * np.sin(2.0 * np.pi * time / (40 + 7 * np.arange(len(point))))
    else:
        y = _measured(controller, r)
    kinds = np.full(samples, MEASURED, dtype=object)
    if interrupted:
        kinds[samples // 3 : samples // 3 + 3] = NOT_FINITE
        if controller.estimator is not None:
            kinds[samples // 2 : samples // 2 + 5] = MISSING
    return replay(controller, y.astype(exact).astype(float), r.astype(exact).astype(float), list(kinds))


def _measured(controller: Controller, r: np.ndarray) -> np.ndarray:
    assert controller.estimator is not None
    loop = Loop(controller.estimator.plant, controller)
    time = controller.period * np.arange(len(r))
    reference = {name: Samples(time, column) for name, column in zip(controller.commanded, r.T, strict=True)}
    deviation = np.sqrt(np.diag(np.atleast_2d(controller.estimator.measurement_noise)))
    run = loop.run(
        reference,
        noise=np.minimum(deviation, LOUDEST),
        duration=controller.period * (len(r) - 1),
        initial_state=np.asarray(controller.estimator.initial[0], dtype=float),
    )
    return np.asarray(run.data["output"])[: len(r)]


def replay(controller: Controller, y: np.ndarray, r: np.ndarray, kinds: list[str]) -> Recording:
    """Feed samples to a fresh controller.

    `controller`: Only read. `y`, `r`: (K, p), (K, k) arrays. `kinds`: As `Recording.codes`: a sample that is missing
    is predicted over, one that is not finite refused.
    """
    fresh, y = controller.fresh(), np.array(y, dtype=float)
    held = np.asarray(fresh.input_before(), dtype=float)
    inputs, estimates = [], []
    for k, kind in enumerate(kinds):
        if kind == NOT_FINITE:
            y[k, 0] = np.nan
        try:
            held = fresh.step(None if kind == MISSING else y[k], r[k] if r.shape[1] else None)
        except NumericalFailure:
            if kind != NOT_FINITE:
                raise
        inputs.append(held)
        estimates.append(np.nan_to_num(fresh.estimate))
    r = r if r.shape[1] else np.zeros((len(y), 1))
    return Recording(y, r, np.array(inputs), np.array(estimates), kinds)
