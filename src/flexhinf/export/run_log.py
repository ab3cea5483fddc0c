"""The log of a run in real time: CSV or Parquet, as PlotJuggler opens them, or MCAP, as Foxglove does too.

Columns are named ``state/link_position[rad]``: PlotJuggler makes a tree of the slashes and splits a header at commas
and spaces, so names have none, and a unit has ``_per_`` for its own slash. In MCAP each kind of signal is a topic,
whose schema has units.
"""

# Not checked strictly: pyarrow has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false

from __future__ import annotations

import importlib.util
import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.export.realtime import RealTimeRun
from flexhinf.files import write_file
from flexhinf.validation import checked_path, install_advice

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
    as it may be; ``code`` is how the controller's step ended, 0 for OK; ``status`` and ``stop`` are bits of
    `flexhinf.Status` and `flexhinf.loop.Stop`.
    """
    trajectory, timing = run.trajectory, run.timing
    u, (low, high) = trajectory.signals["input"], run.input_range
    with np.errstate(invalid="ignore"):  # an infinite limit is reached by nothing: ∞ − ∞ is NaN
        limited = (u <= low + AT_LIMIT * np.abs(low)) | (u >= high - AT_LIMIT * np.abs(high))
    flags = {
        "missed_deadline": timing.missed, "overrun": timing.overrun, "at_limit": limited.any(axis=1), "code": run.codes,
        "status": run.status, "stop": run.stops,
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
            schema = writer.register_schema(
                f"flexhinf.{kind}",
                "jsonschema",
                json.dumps({"type": "object", "properties": properties}).encode(),
            )
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
    ended = run.stop_text or ("completed" if run.stopped is None else "stopped before its end")
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
    refuse_if(
        path.suffix not in FORMATS,
        "The format of the log is not known.",
        f"expected a name that ends with {', '.join(FORMATS)}, got {str(path)!r}",
        csv,
    )
    missing = [name for name in FORMATS[path.suffix][1] if importlib.util.find_spec(name) is None]
    refuse_if(
        missing,
        f"A log in {path.suffix[1:]} needs another package.",
        f"expected the package {', '.join(missing[:1])!r}, which is not installed, for {path.name}",
        f"{install_advice('log')}; or {csv}",
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
        raise InvalidInput(
            f"The {what} cannot be written.",
            f"{path}: {getattr(error, 'strerror', None) or error}",
            "a writable folder that exists",
        ) from error
    return path


def write_log(run: RealTimeRun, path: str | os.PathLike[str]) -> Path:
    """Write a run to a file, whole or not at all; its ending says the format, see `FORMATS`.

    Raises InvalidInput: as `check_log`.
    """
    path = check_log(path)
    write_file(path, "log", lambda name: FORMATS[path.suffix][0](run, name))
    return path
