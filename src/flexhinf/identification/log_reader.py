"""Logs read from files: the columns of a plant's signals, by name, with their units."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.identification.log import FEWEST_ROWS, Log, check_times, delayed_inputs
from flexhinf.identification.log_files import FileColumns, Loaded, file_columns
from flexhinf.identification.log_units import is_other, unit_in, unit_size, units_of, with_unit
from flexhinf.identification.sensing import moved_back
from flexhinf.plant import Plant
from flexhinf.robot.parameters import SECONDS, respelled
from flexhinf.robot.table import name_and_unit
from flexhinf.validation import (
    checked_kind,
    checked_path,
    is_integer,
    is_real,
    nearest,
    one_of,
    real_number,
    value_text,
)

#: Names of the column of times that need not be stated.
TIMES = ("time", "t", "timestamp", "stamp")

#: What stands before a signal's name in files that flexhinf writes, by its kind: ``state.link_velocity [rad/s]`` in a
#: report's folder, ``measured/link_position[rad]`` in the log of a run.
PREFIXES = {"input": ("input.", "input/"), "output": ("output.", "measured/"), "state": ("state.", "state/")}

MOST_LATENCY = 1000  # samples: a second at 1 kHz


def read_log(
    path: str | os.PathLike[str],
    plant: Plant,
    columns: Mapping[str, str] | None = None,
    time: str | None = None,
    units: Mapping[str, str | float] | None = None,
    hold_inputs: bool = False,
    latency: int = 0,
    delays: Mapping[str, int] | None = None,
) -> Log:
    """A log from a file: CSV, Parquet (columns) or MCAP (messages in JSON, or of ROS 2).

    A column with the name of an input or an output of the plant is that signal; ``state.link_velocity`` is a true
    state, to judge estimates by. Without ``state.`` it is none: what a drive calls its velocity has errors of its own.
    Names of files that flexhinf writes are known: ``measured/link_position[rad]``, ``state/link_position[rad]``. Every
    input and every output of the plant needs a column, whose values may be missing where a sensor is slower than
    others.

    Numbers are in SI units, or in the unit behind the column's name: ``link_position [deg]``, or ``pos_deg`` of a
    column that is stated. Times of the day or since 1970 begin with 0 at the first row; differences are taken of all
    their digits. Without a unit stamps of the size of milliseconds, microseconds or nanoseconds since 1970 are such,
    and others seconds. Dates are 2026-01-31T12:00:00.5 or 31.01.2026 12:00:00,5, in UTC or with an offset, +02:00.

    Parameters
    ----------
    path : path
        .csv, .txt or .tsv: a header, then rows of numbers with decimal points between commas, semicolons or tabs,
        nothing or nan where a value is missing. .parquet and .mcap need ``flexhinf[log]``. In MCAP a column is
        ``topic/field``, of several topics at their own times: those of the log, or with ``time="topic/header/stamp"``
        those of the header, of every topic that has one.
    plant : Plant
        ``robot.plant(measured=...)``.
    columns : mapping of str to str, optional
        Columns by the signal's name: ``{"motor_position": "motor/pos", "drive_torque": "effort [mNm]"}``; a number in
        the place of a unit is what one is in the signal's SI unit, ``"counts [0.00153]"``. ``state.NAME`` is a true
        state.
    time : str, optional
        The column of times, also with its unit, ``"stamp [ms]"``; by default one called time, t, timestamp or stamp.
    units : mapping of str to str or float, optional
        Units by the name of a column or of a signal: ``{"pos": "deg"}``.
    hold_inputs : bool
        Whether an input acts until the next row that has one; rows before the first one are left out. Without it a row
        without an input is refused.
    latency : int
        Samples from the row of an input to the row from which on it acts: 1 where a controller writes down what it
        sends and the drive gets it a sample later, as in files of flexhinf's own runs. So many first rows are left out.
    delays : mapping of str to int, optional
        Samples by which a sensor is late, by the name of an output or of a group of them: ``{"motor_position": 1}``.
        Its values are moved back to the rows at which they were true.

    Raises
    ------
    InvalidInput
        For a file that cannot be read, columns or units that are not known or do not fit, text among numbers, inputs
        that are missing, times that do not increase, and what `Log` refuses. The message names line and column.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import tempfile
    >>> from pathlib import Path
    >>> text = "time [ms],motor_voltage,link_position [deg]\\n0,1,0\\n10,1,0.5\\n20,1,1.5\\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = Path(folder, "log.csv").write_text(text)
    ...     log = fh.read_log(f"{folder}/log.csv", fh.paper_arm().plant())
    >>> log.times.tolist()
    [0.0, 0.01, 0.02]
    """
    checked_kind(
        "A log is read for a plant.", plant, Plant, "a Plant", "robot.plant(measured=('motor_position',))"
    )
    for what, mapping in (("columns", columns), ("units", units), ("delays", delays)):
        checked_kind(
            f"The {what} of a log are no mapping.", {} if mapping is None else mapping, Mapping, "a mapping by name",
            "delays={'motor_position': 1}" if what == "delays" else "columns={'motor_position': 'pos [deg]'}",
        )  # fmt: skip
    _check_samples("The latency of a log", latency, "1, where an input acts from the next sample on")
    file = file_columns(checked_path("The log", path))
    heading = _Heading(file, units or {})
    stamp = heading.stamp(time)
    chosen = _chosen(heading, plant, columns or {}, stamp)
    loaded = file.load(stamp.place, [column.place for column in chosen.values()])
    times = loaded.stamps * heading.seconds(stamp, loaded)
    refuse_if(
        len(times) < FEWEST_ROWS,
        f"{file.path.name} has too few rows.",
        f"expected at least {FEWEST_ROWS} below the header, got {len(times)}",
        "a log of some seconds, at the rate of the controller",
    )
    check_times(times, lambda k: f"{file.path.name}, {loaded.place(k)}")
    scales = [heading.scale(column, signal, plant) for signal, column in chosen.items()]
    values = loaded.values * np.array(scales)
    log = delayed_inputs(_log(file, plant, chosen, times, values, loaded, hold_inputs), latency)
    return replace(log, outputs=moved_back(log.outputs, _late(plant, delays or {})))


def _check_samples(what: str, samples: Any, advice: str) -> None:
    refuse_if(
        not is_integer(samples) or not 0 <= samples <= MOST_LATENCY,
        f"{what} is a number of samples.",
        f"expected an integer from 0 to {MOST_LATENCY}, got {value_text(samples)}",
        advice,
    )


def _late(plant: Plant, delays: Mapping[str, int]) -> np.ndarray:
    """Samples (p,) by which each output is late."""
    late = np.zeros(len(plant.outputs), dtype=int)
    for name, samples in delays.items():
        _check_samples(f"The delay of {value_text(name, 60)}", samples, "delays={'motor_position': 1}")
        for one in plant.expanded(name) or (name,):
            one_of(f"There is no measured signal {value_text(one, 60)}.", one, plant.outputs)
            late[plant.outputs.index(one)] = samples
    return late


class Signal(NamedTuple):
    """A signal of a plant: "input", "output" or "state", and its place there."""

    kind: str
    index: int
    name: str


class _Column(NamedTuple):
    """A column of the file: its place, its name without the unit, and the unit or number that stands there."""

    place: int
    name: str
    unit: str


class _Heading:
    """The columns of a file, by the names that people call them."""

    def __init__(self, file: FileColumns, units: Mapping[str, str | float]) -> None:
        self.file, self.units = file, units
        self.columns = []
        for place, text in enumerate(file.names):
            name, unit = name_and_unit(text)
            if unit.isdigit():  # position[0] of an array
                name, unit = text.strip(), ""
            self.columns.append(_Column(place, name, unit))
        self._unused = dict.fromkeys(map(str, units))

    def named(self, text: str) -> list[_Column]:
        """The columns that are called so, with their unit or without it."""
        exact = [column for column in self.columns if self.file.names[column.place].strip() == text.strip()]
        return exact or [column for column in self.columns if column.name == text.strip()]

    def column(self, text: Any, what: str) -> _Column:
        """The column of a stated name, with the unit that is stated behind it."""
        checked_kind(f"The column of {what} has no name.", text, str, "text", "'pos' or 'pos [deg]'")
        columns, (name, unit) = self.named(text), name_and_unit(text)
        if not columns and unit:
            columns = [column._replace(unit=unit) for column in self.named(name)]
        if not columns:
            raise InvalidInput(
                f"{self.file.path.name} has no column {value_text(text, 60)} for {what}.",
                f"expected one of {[name.strip() for name in self.file.names]}",
                nearest(name, [column.name for column in self.columns], "a name of the header"),
            )
        return self.only(columns, what)

    def only(self, columns: Sequence[_Column], what: str) -> _Column:
        """The one of several columns of a name; refused if there are more."""
        count = {2: "two", 3: "three"}.get(len(columns), str(len(columns)))
        places = ", ".join(f"column {column.place + 1}" for column in columns)
        refuse_if(
            len(columns) > 1,
            f"{self.file.path.name} has {count} columns for {what}: {places}.",
            f"expected one, got {[self.file.names[column.place].strip() for column in columns]}",
            f"other names in the file for all but one of the columns {columns[0].name!r}",
        )
        return columns[0]

    def in_stated_unit(self, column: _Column, signal: str = "") -> _Column:
        """The column with the unit that is stated for it or for its signal, else as it is."""
        for key in (signal, column.name, self.file.names[column.place].strip()):
            if key in self.units:
                self._unused.pop(key, None)
                unit = self.units[key]
                text = unit if isinstance(unit, str) else repr(float(unit)) if is_real(unit) else ""
                refuse_if(
                    not text, f"The unit of {key!r} is none.", f"expected text or a number, got {value_text(unit)}",
                    f"units={{{key!r}: 'deg'}}",
                )  # fmt: skip
                column = column._replace(unit=text.strip())
        return column

    def check_units(self) -> None:
        """Refuse units of columns and signals that are not read."""
        for key in self._unused:
            names = [column.name for column in self.columns]
            raise InvalidInput(
                f"A unit is stated for {value_text(key, 60)}, which is not read from {self.file.path.name}.",
                f"expected a signal of the plant or one of {names}",
                nearest(key, names, "leave it out"),
            )

    def stamp(self, time: str | None) -> _Column:
        """The column of times."""
        if time is not None:
            stated = self.column(time, "the time")
            self._check_whole(stated)
            return self.in_stated_unit(stated)
        called = [
            [column for column in self.columns if column.name.casefold().lstrip("%_ ") == name]
            for name in TIMES
        ]
        columns = next(filter(None, called), [])
        if not columns:
            names = [column.name for column in self.columns]
            refuse_if(
                len(names) == 1 or all(_is_finite(name) for name in names),
                f"{self.file.path.name} has no header.",
                f"expected the names of columns in the first row, got {names}",
                "a header 'time,motor_torque,motor_position' as the first row; what stands before it begins with #",
            )
            for column in self.columns:
                self._check_whole(column)
            raise InvalidInput(
                f"{self.file.path.name} has no column of times.",
                f"expected one of {list(TIMES)}, got {names}",
                self._advised_time(),
            )
        return self.in_stated_unit(self.only(columns, "the time"))

    def _advised_time(self) -> str:
        """What to state where no column has a name of times: one with a unit of times before all others."""
        free = [column for column in self.columns if not is_other(column.name, column.unit, "time", "s")]
        choices = [each for each in free if unit_in(each.unit or each.name, "s")] or free or self.columns
        near = nearest("time", [column.name for column in choices], "")
        column = next((each for each in choices if repr(each.name) == near), choices[0])
        name = column.name
        text, what = (f"{name} [{column.unit}]", "") if column.unit else with_unit(name, "s", TIMES)
        plain = text == name
        return f"time={text!r}{what}" + f", or with the unit of its numbers: time='{name} [ms]'" * plain

    def _check_whole(self, stamp: _Column) -> None:
        """Refuse seconds whose fractions are another column's."""
        start = re.sub(r"secs?$", "", stamp.name)
        beside = {f"{start}{part}" for part in ("nanosec", "nsec", "nsecs")} if start != stamp.name else set()
        parts = [column.name for column in self.columns if column.name in beside]
        refuse_if(
            bool(parts),
            f"{self.file.path.name}: the times are in two columns.",
            f"expected one, got {[stamp.name, *parts]}",
            f"a column 'time [ns]' of 1000000000 * {stamp.name} + {''.join(parts[:1])}, in whole numbers",
        )

    def seconds(self, stamp: _Column, loaded: Loaded) -> float:
        """What a unit of the stamps is in seconds."""
        unit = stamp.unit or unit_in(stamp.name, "s")
        return self.size(stamp._replace(unit=unit), "the time", ("s",)) if unit else SECONDS[loaded.unit()]

    def scale(self, column: _Column, signal: Signal, plant: Plant) -> float:
        """What a unit of the column is in the unit of the plant's signal: ``pos_deg`` is in deg."""
        unit = plant.unit(signal.name)
        if not column.unit and column.name not in _signals(plant):
            column = column._replace(unit=unit_in(column.name, unit))
        if not column.unit:
            return 1.0
        return self.size(column, f"the {signal.kind} {signal.name!r}", (unit,) if unit else ())

    def size(self, column: _Column, what: str, si: Sequence[str]) -> float:
        """What a unit of the column is in one of these SI units; a plant without units takes SI units as they are."""
        size = real_number(_float(column.unit.strip()))
        if np.isfinite(size) and size != 0.0:
            return size
        with suppress(ValueError):
            return unit_size(column.unit, si)
        meant = [spelled.removeprefix("1 ") for spelled in respelled(f"1 {column.unit.strip()}", *si)]
        raise InvalidInput(
            f"{self.file.path.name}: the unit of {column.name!r} does not fit {what}.",
            f"expected {' or '.join(si) or 'the unit of a plant that states one'}, or what measures the same, got "
            f"{column.unit!r}",
            " or ".join(meant)
            or f"in the place of {column.unit!r} "
            + (units_of(si[0]) if si else "a number: what one is in the unit of the plant"),
        )


def _is_finite(text: str) -> bool:
    return bool(np.isfinite(_float(text)))


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _signals(plant: Plant) -> dict[str, Signal]:
    """Signals by every name that a column of theirs may have; a plain name is that of an input or an output."""
    known: dict[str, Signal] = {}
    kinds = (("input", plant.inputs), ("output", plant.outputs), ("state", plant.states))
    for kind, names in kinds:
        for index, name in enumerate(names):
            signal = Signal(kind, index, name)
            if kind != "state":
                known.setdefault(name, signal)
            known |= {f"{prefix}{name}": signal for prefix in PREFIXES[kind]}
    return known


def _chosen(
    heading: _Heading, plant: Plant, columns: Mapping[str, str], stamp: _Column
) -> dict[Signal, _Column]:
    """The column of each signal, those of all inputs and outputs first, in the plant's order."""
    known, chosen = _signals(plant), dict[Signal, list[_Column]]()
    for name, text in columns.items():
        if name not in known:
            raise InvalidInput(
                f"The plant has no signal {value_text(name, 60)}.",
                f"expected one of the inputs {list(plant.inputs)}, the outputs {list(plant.outputs)}, or a true state "
                f"of {['state.' + state for state in plant.states]}",
                nearest(name, known),
            )
        chosen.setdefault(known[name], []).append(heading.column(text, repr(name)))
    stated, used = (
        set(chosen),
        {column.place for several in chosen.values() for column in several} | {stamp.place},
    )
    for column in heading.columns:
        signal = known.get(column.name)
        if signal is not None and signal not in stated and column.place not in used:
            chosen.setdefault(signal, []).append(column)
    for signal, several in chosen.items():
        one = several[0]
        refuse_if(
            len(several) > 1 and len(heading.named(one.name)) == 1,
            f"{heading.file.path.name} has two columns for the {signal.kind} {signal.name!r}.",
            f"expected one, got {[heading.file.names[column.place] for column in several]}",
            f"columns={{{signal.name!r}: {one.name!r}}}",
        )
        heading.only(several, f"the {signal.kind} {signal.name!r}")
    file = heading.file.path.name
    places = [column.place for several in chosen.values() for column in several] + [stamp.place]
    twice = next((place for place in places if places.count(place) > 1), None)
    refuse_if(
        twice is not None,
        f"{file}: one column is used for two signals: {heading.file.names[twice or 0]!r}.",
        f"expected a column for each, got {dict(columns)}",
        "the name of the other column",
    )
    _check_complete(heading, plant, chosen, places)
    order = sorted(chosen, key=lambda signal: (list(PREFIXES).index(signal.kind), signal.index))
    read = {signal: heading.in_stated_unit(chosen[signal][0], signal.name) for signal in order}
    heading.check_units()
    return read


def _check_complete(
    heading: _Heading, plant: Plant, chosen: Collection[Signal], used: Collection[int]
) -> None:
    names = [column.name for column in heading.columns]
    free = [
        column for column in heading.columns if column.place not in used and column.name not in plant.states
    ]
    for kind, signals in (("input", plant.inputs), ("output", plant.outputs)):
        for index, name in enumerate(signals):
            if Signal(kind, index, name) in chosen:
                continue
            why = "the model needs every input at every sample"
            if kind == "output":
                why = "the plant measures it; a plant that does not: robot.plant(measured=...)"
            raise InvalidInput(
                f"{heading.file.path.name} has no column for the {kind} {name!r}.",
                f"expected a column of that name ({why}); those of the file are {names}",
                _advised_column(name, plant.unit(name), free),
            )


def _advised_column(signal: str, si: str, free: Sequence[_Column]) -> str:
    """What to state for a signal without a column: the free one most like it, of those that may measure it."""
    fitting = [column for column in free if not is_other(column.name, column.unit, signal, si)]
    names = [column.name for column in fitting]
    inside = [column.name for column in fitting if si and unit_in(column.unit or column.name, si)]
    only = names if len(names) == 1 else inside if len(inside) == 1 else ["COLUMN"]
    like = nearest(signal, names, repr(only[0])).strip("'")
    column = next((column for column in fitting if column.name == like), None)
    if column is None:
        others = f"one of {names}" if names else "that of another file"
        return f"columns={{{signal!r}: COLUMN}}, where COLUMN is {others}"
    text, what = (like, "") if column.unit else with_unit(like, si, (signal,))
    return f"columns={{{signal!r}: {text!r}}}{what}"


def _log(
    file: FileColumns,
    plant: Plant,
    chosen: Mapping[Signal, _Column],
    times: np.ndarray,
    values: np.ndarray,
    loaded: Loaded,
    hold_inputs: bool,
) -> Log:
    """The log of a table whose columns are in the order of `chosen`."""
    tables = {
        "input": np.zeros((len(times), len(plant.inputs))),
        "output": np.zeros((len(times), len(plant.outputs))),
        "state": np.full((len(times), plant.n), np.nan),
    }
    for signal, column in zip(chosen, values.T):
        tables[signal.kind][:, signal.index] = column
    name = file.path.name
    for index, output in enumerate(plant.outputs):
        refuse_if(
            np.isnan(tables["output"][:, index]).all(),
            f"{name}: the output {output!r} has no value at all.",
            f"expected numbers in {_place_of(chosen, 'output', index)!r}, got {len(times)} missing ones",
            "another column, or a plant that does not measure it",
        )
    if hold_inputs and plant.inputs:
        tables["input"] = np.column_stack([_previous(column) for column in tables["input"].T])
    missing = np.isnan(tables["input"])
    first = 0
    if hold_inputs and missing.any():
        first = len(times) if missing.all(axis=0).any() else int(np.argmin(missing.any(axis=1)))
    if missing[first:].any() or first == len(times):
        row, index = np.argwhere(missing)[0].tolist()
        raise InvalidInput(
            f"{name}, {loaded.place(row)}: the input {plant.inputs[index]!r} is missing.",
            f"expected a number in every row of {_place_of(chosen, 'input', index)!r}: the model needs every input at "
            f"every sample; got {int(missing[:, index].sum())} of {len(times)} rows without one",
            "hold_inputs=True, if an input acts until the next one, or another column",
        )
    known = not np.isnan(tables["state"]).all()
    return Log(
        times[first:] - times[first],
        tables["input"][first:],
        tables["output"][first:],
        tables["state"][first:] if known else None,
        {"input": tuple(plant.inputs), "output": tuple(plant.outputs), "state": tuple(plant.states)},
        name,
    )


def _place_of(chosen: Mapping[Signal, _Column], kind: str, index: int) -> str:
    return next(
        column.name for signal, column in chosen.items() if (signal.kind, signal.index) == (kind, index)
    )


def _previous(column: np.ndarray) -> np.ndarray:
    """Each missing value as the last one before it that is not; those before the first stay missing."""
    last = np.maximum.accumulate(np.where(np.isnan(column), -1, np.arange(len(column))))
    return np.where(last >= 0, column[last], np.nan)
