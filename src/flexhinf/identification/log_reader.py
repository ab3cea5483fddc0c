"""Logs read from files: the columns of a plant's signals, by name, with their units."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.identification.doctor import jumps
from flexhinf.identification.doctor.finding import LogFinding
from flexhinf.identification.log import FEWEST_ROWS, FileColumn, Log, check_times, delayed_inputs
from flexhinf.identification.log_columns import FileColumns, Loaded
from flexhinf.identification.log_files import file_columns
from flexhinf.identification.log_heading import Heading, NamedColumn
from flexhinf.identification.log_series import advised_series, expanded_columns
from flexhinf.identification.log_units import is_other, unit_in, with_unit, without_unit
from flexhinf.identification.quantisation import smallest_step
from flexhinf.identification.sensing import moved_back
from flexhinf.plant import Plant
from flexhinf.validation import (
    checked_kind,
    checked_names,
    checked_path,
    is_integer,
    nearest,
    one_of,
    real_array,
    value_text,
)

#: What stands before a signal's name in files that flexhinf writes, by its kind: ``state.link_velocity [rad/s]`` in a
#: report's folder, ``measured/link_position[rad]`` in the log of a run.
PREFIXES = {"input": ("input.", "input/"), "output": ("output.", "measured/"), "state": ("state.", "state/")}

MOST_LATENCY = 1000  # samples: a second at 1 kHz

#: Where counters and clocks of stamps begin anew, in their unit, and by how many usual steps they may be late there.
CLOCKS, STALE = (2.0**16, 2.0**24, 2.0**32, 2.0**31, 60.0, 1e3, 3600.0, 86400.0, 86.4e6, 1e6, 1e9), 20.0


def read_log(
    path: str | os.PathLike[str],
    plant: Plant,
    columns: Mapping[str, str] | None = None,
    time: str | None = None,
    units: Mapping[str, str | float] | None = None,
    hold_inputs: bool = False,
    latency: int = 0,
    delays: Mapping[str, int] | None = None,
    missing: float | Sequence[float] = (),
    unwrap: str | Sequence[str] = (),
    repeated: str | Sequence[str] = (),
) -> Log:
    """A log from a file: CSV, Parquet (columns) or MCAP (messages in JSON, or of ROS 2).

    A column with the name of an input or an output of the plant is that signal; ``state.link_velocity`` is a true
    state, to judge estimates by. Without ``state.`` it is none: what a drive calls its velocity has errors of its own.
    Names of files that flexhinf writes are known: ``measured/link_position[rad]``, ``state/link_position[rad]``. Every
    input and every output of the plant needs a column, whose values may be missing where a sensor is slower than
    others.

    Numbers are in SI units, or in the unit behind the column's name: ``link_position [deg]``, ``link_position_deg``, or
    ``pos_deg`` of a column that is stated. Times of the day or since 1970 begin with 0 at the first row; differences
    are taken of all their digits. Without a unit stamps of the size of milliseconds, microseconds or nanoseconds since
    1970 are such, and others seconds. Dates are 2026-01-31T12:00:00.5 or 31.01.2026 12:00:00,5, in UTC or with an
    offset, +02:00.

    Parameters
    ----------
    path : path
        .csv, .txt, .tsv or .dat: a header, then rows of numbers with decimal points between commas, semicolons or tabs,
        nothing or nan where a value is missing. .parquet and .mcap need ``flexhinf[log]``. In MCAP a column is
        ``topic/field``, of several topics at their own times: those of the log, or with ``time="topic/header/stamp"``
        those of the header, of every topic that has one.
    plant : Plant
        ``robot.plant(measured=...)``.
    columns : mapping of str to str, optional
        Columns by the signal's name: ``{"motor_position": "motor/pos", "drive_torque": "effort [mNm]"}``; a number in
        the place of a unit is what one is in the signal's SI unit, ``"counts [0.00153]"``. ``{"link_position": "q#"}``
        are the columns q1, q2, … of all joints, in their order. ``state.NAME`` is a true state.
    time : str, optional
        The column of times, also with its unit, ``"stamp [ms]"``; by default one called time, t, timestamp or stamp,
        also with a unit behind it, ``time_ms``; or ``header.stamp.sec`` with ``header.stamp.nanosec`` beside it.
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
    missing : float or sequence of float
        Values that stand for missing ones, in the units of the file: −9999.
    unwrap : sequence of str
        Measured signals that begin anew after a turn, or when a counter is full, and are to go on counting; ``"time"``
        of stamps that do so.
    repeated : sequence of str
        Measured signals of which a value that repeats the one before is none: the sensor is slower than the rows.

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
            f"The {what} of a log are no mapping.",
            {} if mapping is None else mapping,
            Mapping,
            "a mapping by name",
            "delays={'motor_position': 1}" if what == "delays" else "columns={'motor_position': 'pos [deg]'}",
        )
    _check_samples("The latency of a log", latency, "1, where an input acts from the next sample on")
    marks = real_array(missing).ravel()
    again, held = (
        _measured(what, names, plant) for what, names in (("unwrap", unwrap), ("repeated", repeated))
    )
    file = file_columns(checked_path("The log", path))
    heading = Heading(file, units or {})
    stamp = heading.stamp(time)
    chosen = _chosen(heading, plant, columns or {}, stamp)
    loaded = file.load(stamp.places, [column.place for column in chosen.values()])
    stamps = _going_on(loaded.stamps) if "time" in again else loaded.stamps
    second = heading.seconds(stamp, loaded)
    times = stamps * second
    refuse_if(
        len(times) < FEWEST_ROWS,
        f"{file.path.name} has too few rows.",
        f"expected at least {FEWEST_ROWS} below the header, got {len(times)}",
        "a log of some seconds, at the rate of the controller",
    )
    _refuse_renewed(file, stamp, stamps, loaded)
    check_times(times, lambda k: f"{file.path.name}, {loaded.place(k)}")
    names = _signals(plant)
    sizes = [
        heading.scale(
            column, f"the {signal.kind} {signal.name!r}", plant.unit(signal.name), column.name in names
        )
        for signal, column in chosen.items()
    ]
    values = np.where(np.isin(loaded.values, marks), np.nan, loaded.values) * np.array(sizes)
    for k, (signal, size) in enumerate(zip(chosen, sizes)):
        if signal.kind == "output" and signal.name in again:
            values[:, k] = _unwrapped(values[:, k], size)
        if signal.kind == "output" and signal.name in held:
            values[:, k] = _without_repeats(values[:, k])
    log = delayed_inputs(_log(file, plant, chosen, times, values, loaded, hold_inputs), latency)
    places = {
        signal.name: FileColumn(column.name, float(size))
        for (signal, column), size in zip(chosen.items(), sizes)
        if signal.kind != "state"
    }
    return replace(
        log,
        outputs=moved_back(log.outputs, _late(plant, delays or {})),
        columns={**places, "time": FileColumn(stamp.name, second)},
        findings=tuple(_noticed(plant, chosen, stamp)),
    )


def _measured(what: str, names: str | Sequence[str], plant: Plant) -> tuple[str, ...]:
    """Measured signals by name, or "time" of what is to go on counting; a group's name stands for all of them."""
    known = (*plant.outputs, *(("time",) if what == "unwrap" else ()))
    several = [one for name in checked_names(f"The {what}", names) for one in plant.expanded(name) or (name,)]
    for name in several:
        one_of(f"There is no measured signal {value_text(name, 60)} for {what}.", name, known)
    return tuple(several)


def _unwrapped(values: np.ndarray, size: float) -> np.ndarray:
    """A signal (N,) that goes on counting where it begins anew."""
    known = np.isfinite(values)
    again = jumps.renewal(values[known], smallest_step(values), size)
    if again is not None:
        values = values.copy()
        values[known] = jumps.unwrapped(values[known], again.modulus)
    return values


def _without_repeats(values: np.ndarray) -> np.ndarray:
    """A signal (N,) without the values that repeat the one before."""
    before = _previous(np.append(np.nan, values[:-1]))
    return np.where(values == before, np.nan, values)


def _going_on(stamps: np.ndarray) -> np.ndarray:
    """Stamps (N,) of a counter of any bits, or of a clock, that go on where it begins anew."""
    steps = np.diff(stamps)
    usual = float(np.median(steps))
    for k in np.flatnonzero(steps < 0.0).tolist():
        fitting = [size for size in CLOCKS if 0.0 < size + steps[k] < max(STALE * usual, 0.1 * size)]
        if fitting:
            stamps = np.append(stamps[: k + 1], stamps[k + 1 :] + fitting[0])
    return stamps


def _refuse_renewed(file: FileColumns, stamp: NamedColumn, stamps: np.ndarray, loaded: Loaded) -> None:
    """Refuse stamps (N,) of a counter that is full, or of a clock that begins anew, in one place or more."""
    back = np.flatnonzero(np.diff(stamps) < 0.0)
    refuse_if(
        bool(back.size)
        and not (np.diff(stamps) == 0.0).any()
        and bool((np.diff(_going_on(stamps)) > 0.0).all()),
        f"{file.path.name}: the times begin anew: {loaded.place(int(back[0]) + 1) if back.size else ''}.",
        f"expected increasing times, got a counter or a clock in {stamp.name!r} that begins anew in {len(back)} "
        f"place{'s' * (len(back) != 1)}",
        "unwrap=('time',)",
    )


def _noticed(
    plant: Plant, chosen: Mapping[SignalPlace, NamedColumn], stamp: NamedColumn
) -> Iterator[LogFinding]:
    """Units and times that the names of columns say."""
    known = _signals(plant)
    for signal, column in chosen.items():
        unit = "" if column.name in known or column.unit else unit_in(column.name, plant.unit(signal.name))
        if unit:
            yield LogFinding(
                "unit",
                "note",
                f"{signal.name} is read in {unit}, as the name of its column says.",
                "",
                signal.name,
                column.name,
            )
    if not stamp.unit and unit_in(stamp.name, "s") and without_unit(stamp.name, "s")[1]:
        unit = unit_in(stamp.name, "s")
        yield LogFinding(
            "unit",
            "note",
            f"Times are read in {unit}, as the name of their column says.",
            "",
            "time",
            stamp.name,
        )
    if stamp.nanoseconds is not None:
        yield LogFinding(
            "stamp",
            "note",
            "Times are whole seconds and nanoseconds, of two columns.",
            "",
            "time",
            stamp.name,
        )


def signals_in(path: str | os.PathLike[str], plant: Plant) -> tuple[str, ...]:
    """The inputs and outputs of a plant that a file has columns for, by their names alone. Raises as `read_log`."""
    known = _signals(plant)
    columns = Heading(file_columns(checked_path("The log", path)), {}).columns
    signals = (known.get(column.name) or _by_unit(column, plant, known) for column in columns)
    return tuple(dict.fromkeys(signal.name for signal in signals if signal and signal.kind != "state"))


def _check_samples(what: str, samples: object, advice: str) -> None:
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


class SignalPlace(NamedTuple):
    """A signal of a plant: "input", "output" or "state", and its place there."""

    kind: str
    place: int
    name: str


def _signals(plant: Plant) -> dict[str, SignalPlace]:
    """Signals by every name that a column of theirs may have; a plain name is that of an input or an output."""
    known: dict[str, SignalPlace] = {}
    kinds = (("input", plant.inputs), ("output", plant.outputs), ("state", plant.states))
    for kind, names in kinds:
        for index, name in enumerate(names):
            signal = SignalPlace(kind, index, name)
            if kind != "state":
                known.setdefault(name, signal)
            known |= {f"{prefix}{name}": signal for prefix in PREFIXES[kind]}
    return known


def _chosen(
    heading: Heading, plant: Plant, columns: Mapping[str, str], stamp: NamedColumn
) -> dict[SignalPlace, NamedColumn]:
    """The column of each signal, those of all inputs and outputs first, in the plant's order."""
    known, chosen = _signals(plant), dict[SignalPlace, list[NamedColumn]]()
    for name, text in expanded_columns(heading, plant, columns).items():
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
        {column.place for several in chosen.values() for column in several} | {*stamp.places},
    )
    for column in heading.columns:
        signal = known.get(column.name)
        if signal is not None and signal not in stated and column.place not in used:
            chosen.setdefault(signal, []).append(column)
    for column in heading.columns:
        signal = _by_unit(column, plant, known)
        if signal is not None and signal not in chosen and column.place not in used:
            chosen[signal] = [column]
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
    places = [column.place for several in chosen.values() for column in several] + stamp.places
    twice = next((place for place in places if places.count(place) > 1), None)
    refuse_if(
        twice is not None,
        f"{file}: one column is used for two signals: {heading.file.names[twice or 0]!r}.",
        f"expected a column for each, got {dict(columns)}",
        "the name of the other column",
    )
    _check_complete(heading, plant, chosen, places)
    order = sorted(chosen, key=lambda signal: (list(PREFIXES).index(signal.kind), signal.place))
    read = {signal: heading.in_stated_unit(chosen[signal][0], signal.name) for signal in order}
    heading.check_units()
    return read


def _by_unit(column: NamedColumn, plant: Plant, known: Mapping[str, SignalPlace]) -> SignalPlace | None:
    """The input or output whose name a column has with its unit behind it, ``link_position_deg``; else None."""
    if column.name in known or column.unit:
        return None
    for si in {plant.unit(name) for name in (*plant.inputs, *plant.outputs)} - {""}:
        name, unit = without_unit(column.name, si)
        signal = known.get(name) or known.get(name.casefold())
        if unit and signal is not None and signal.kind != "state" and plant.unit(signal.name) == si:
            return signal
    return None


def _check_complete(
    heading: Heading, plant: Plant, chosen: Collection[SignalPlace], used: Collection[int]
) -> None:
    names = [column.name for column in heading.columns]
    free = [
        column for column in heading.columns if column.place not in used and column.name not in plant.states
    ]
    missing = [
        signal
        for kind, signals in (("input", plant.inputs), ("output", plant.outputs))
        for signal in (SignalPlace(kind, index, name) for index, name in enumerate(signals))
        if signal not in chosen
    ]
    if not missing:
        return
    first, series = missing[0], advised_series([signal.name for signal in missing], free, plant)
    why = "the model needs every input at every sample"
    if first.kind == "output":
        why = "the plant measures it; a plant that does not: robot.plant(measured=...)"
    more = f", and for {len(missing) - 1} more" if len(missing) > 2 else ""
    more = f", and for {missing[1].name!r}" if len(missing) == 2 else more
    raise InvalidInput(
        f"{heading.file.path.name} has no column for the {first.kind} {first.name!r}{more}.",
        f"expected a column of that name ({why}); those of the file are {names}",
        f"columns={series}, if its columns are numbered in the order of the joints"
        if series
        else _advised_column(first.name, plant.unit(first.name), free),
    )


def _advised_column(signal: str, si: str, free: Sequence[NamedColumn]) -> str:
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
    chosen: Mapping[SignalPlace, NamedColumn],
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
        tables[signal.kind][:, signal.place] = column
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


def _place_of(chosen: Mapping[SignalPlace, NamedColumn], kind: str, index: int) -> str:
    return next(
        column.name for signal, column in chosen.items() if (signal.kind, signal.place) == (kind, index)
    )


def _previous(column: np.ndarray) -> np.ndarray:
    """Each missing value as the last one before it that is not; those before the first stay missing."""
    last = np.maximum.accumulate(np.where(np.isnan(column), -1, np.arange(len(column))))
    return np.where(last >= 0, column[last], np.nan)
