"""Logs of a robot: when which input acted, what the sensors measured, and the true state where it is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.notebook import Summarised, names_text
from flexhinf.numerals import number_text
from flexhinf.validation import (
    HUGE,
    checked_array,
    checked_kind,
    read_only,
    real_array,
    value_text,
)

if TYPE_CHECKING:
    import xarray as xr

    from flexhinf.identification.doctor.finding import LogFinding
    from flexhinf.loop import Trajectory

#: Fewest rows, and the longest gap relative to the time between most samples (the 90 % quantile).
FEWEST_ROWS, LONGEST_GAP = 3, 1000.0


class FileColumn(NamedTuple):
    """The column of a signal in a log's file: its name without the unit, and what one of its unit is in SI units."""

    name: str
    size: float = 1.0


class LoggedArrays(Protocol):
    """What has the arrays of a log: times (N,), s, inputs (N, m), None without any, and outputs (N, p)."""

    @property
    def times(self) -> np.ndarray:
        """Of the rows, s."""
        ...

    @property
    def inputs(self) -> np.ndarray | None:
        """From the time of a row on."""
        ...

    @property
    def outputs(self) -> np.ndarray:
        """At the time of a row."""
        ...


#: A log, these arrays in this order, or a run or its data.
LogLike: TypeAlias = "LoggedArrays | tuple[ArrayLike, ArrayLike | None, ArrayLike] | Trajectory | xr.Dataset"


@dataclass(frozen=True, eq=False, repr=False)
class Log(Summarised):
    """What happened to a robot: times, inputs, measurements, and the true state where it is known.

    Parameters
    ----------
    times : (N,) array
        Times of the samples, s: strictly increasing, at any distances.
    inputs : (N, m) array
        u from the time of its row on, until the next one; None of a plant without inputs.
    outputs : (N, p) array
        y at the time of its row; NaN where a sensor has no value there.
    truth : (N, n) array, optional
        The true state, as a simulation or another instrument knows it; NaN where it is not known. It is used to judge
        an estimate and for nothing else.
    names : mapping of str to sequence of str, optional
        Names of the columns by "input", "output" and "state".
    source : str, optional
        Where the log comes from.
    columns : mapping of str to FileColumn, optional
        Columns of a file by signal, and by "time"; `read_log` states them.
    findings : tuple of LogFinding, optional
        What `read_log` noticed; `examine` begins with it.

    Raises
    ------
    InvalidInput
        For arrays that do not fit each other, inputs that are not finite, infinite numbers, fewer than three samples,
        times that do not increase, and a gap a thousand times as long as the time between most samples.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> log = fh.Log(0.01 * np.arange(100), np.zeros(100), np.zeros(100), source="a robot at rest")
    >>> len(log), round(log.period, 9)
    (100, 0.01)
    """

    times: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    truth: np.ndarray | None = None
    names: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    source: str = ""
    columns: Mapping[str, FileColumn] = field(default_factory=dict[str, FileColumn])
    findings: tuple[LogFinding, ...] = ()

    def __post_init__(self) -> None:
        times = log_numbers("times", self.times)
        count = len(times) if times.ndim == 1 else 0
        refuse_if(
            count < FEWEST_ROWS,
            "The log has too few samples.",
            f"expected times (N,) of at least {FEWEST_ROWS} samples, got shape {times.shape}",
            "a log of some seconds, at the rate of the controller",
        )
        check_times(times, lambda k: f"sample {k + 1}")
        arrays = {"times": times}
        for what in ("inputs", "outputs", "truth"):
            if what == "truth" and self.truth is None:
                continue
            stated = getattr(self, what)
            empty = what == "inputs" and stated is None
            stated = np.zeros((count, 0)) if empty else log_numbers(what, stated)
            array = stated[:, None] if stated.ndim == 1 else stated
            kind = {"inputs": "input", "outputs": "output", "truth": "state"}[what]
            names = self.names.get(kind)
            width = array.shape[1] if names is None and array.ndim == 2 else len(names or ())
            refuse_if(
                array.shape != (count, width) or (not width and what == "outputs"),
                f"The {what} of the log do not fit its times.",
                f"expected ({count}, {f'{width} for {list(names)}' if names else 'columns'}), got shape {stated.shape}",
                "one row per sample, one column per signal",
            )
            missing = np.isnan(array)
            refuse_if(
                not (np.abs(array[~missing]) <= HUGE).all() or (what == "inputs" and missing.any()),
                f"The {what} of the log hold what is no usable number.",
                f"expected finite numbers of at most {HUGE:g}{', NaN where one is missing' * (what != 'inputs')}; the "
                "filter's model needs the input at every sample",
                "leave the samples out"
                if what != "inputs"
                else "the input that acted, held where none was logged",
            )
            arrays[what] = array
        for what, array in arrays.items():
            object.__setattr__(self, what, read_only(array))
        object.__setattr__(self, "names", {kind: tuple(names) for kind, names in self.names.items()})

    def __setstate__(self, state: dict[str, object]) -> None:
        vars(self).update(read_only(state))  # copies share their arrays

    def summary(self) -> dict[str, str]:
        """Where it comes from, how long it is, and its signals."""
        length = f"{number_text(float(self.times[-1] - self.times[0]), 's')}, {len(self)} samples"
        counts = {"input": str(self.inputs.shape[1]), "output": str(self.outputs.shape[1])}
        names = {kind: names_text(names) for kind, names in self.names.items() if kind in counts}
        return {"source": self.source or "not stated", "time": length, **counts, **names}

    def __len__(self) -> int:
        """The number of samples."""
        return len(self.times)

    def __getitem__(self, part: slice) -> Log:
        """Consecutive samples, ``log[:1000]``: for a fit on one part and its judgement on another."""
        checked_kind("A part of a log is a slice.", part, slice, "a slice", "log[:1000]")
        truth = None if self.truth is None else self.truth[part]
        return replace(
            self,
            times=self.times[part],
            inputs=self.inputs[part],
            outputs=self.outputs[part],
            truth=truth,
            findings=(),  # their rows are those of the whole log
        )

    @property
    def period(self) -> float:
        """The median time between samples, s."""
        return float(np.median(np.diff(self.times)))


def log_numbers(what: str, values: object) -> np.ndarray:
    """The times, inputs, outputs or true states of a log as a new array; InvalidInput for what are no numbers."""
    with suppress(ValueError):
        array = real_array(values, strict=True)
        if values is not None:
            return array
    kind = getattr(values, "dtype", None)
    raise InvalidInput(
        f"The {what} of the log are no numbers.",
        f"expected real numbers{' of seconds' * (what == 'times')}, got "
        f"{value_text(values, 80) if kind is None else f'an array of {kind}'}",
        _remedy(what, values),
    )


def _remedy(what: str, values: object) -> str:
    """What to try instead of values that are no real numbers."""
    kind = ""
    with suppress(Exception):  # whatever a foreign object does when it is asked for elements
        array = np.asarray(values)
        kind = "M" if hasattr(array.ravel()[0], "timestamp") else array.dtype.kind
    if kind == "M":
        return "(t - t[0]) / np.timedelta64(1, 's'), of t = np.array(times, dtype='datetime64[ns]')"
    if kind == "m":
        return "times / np.timedelta64(1, 's')"
    if kind == "c":
        return "real parts and imaginary parts as two columns"
    if kind in ("U", "S"):
        return "np.array(values, dtype=float), or fh.read_log for a file"
    return "times in s from 0 on" if what == "times" else "one row per sample, one column per signal"


def check_increasing(times: np.ndarray, place: Callable[[int], str]) -> None:
    """Refuse times (N,) of which one is not later than the one before; `place` names it."""
    steps = np.diff(times)
    wrong = np.flatnonzero(~(steps > 0.0))
    if not wrong.size:
        return
    back = int(wrong[0])
    repeats, many = int((steps == 0.0).sum()), len(wrong)
    places = f", in {many} places" if many > 1 else ""
    advice = "sort the rows, and drop repeated times"
    if repeats > 0.1 * len(steps):
        advice = (
            "times with more digits, or a column of times of the row's number times the period: those here are "
            "rounded"
        )
    elif many == 1 and steps[back] < 0.0 and FEWEST_ROWS <= back + 1 <= len(times) - FEWEST_ROWS:
        advice = f"two logs: the first {back + 1} rows, and those behind them; or {advice}"
    raise InvalidInput(
        f"The times of the log {'repeat' if steps[back] == 0.0 else 'go backwards'}: {place(back + 1)}.",
        f"expected increasing times, got {times[back + 1]:.9g} s after {times[back]:.9g} s{places}",
        advice,
    )


def check_times(times: np.ndarray, place: Callable[[int], str]) -> None:
    """Refuse times that are not finite or do not increase, and gaps that belong between two logs."""
    checked_array(
        "The times of the log are no numbers.",
        times,
        times.shape,
        "finite seconds",
        "times in s from 0 on",
        HUGE,
    )
    check_increasing(times, place)
    steps = np.diff(times)
    usual, gap = float(np.quantile(steps, 0.9, method="lower")), int(np.argmax(steps))
    refuse_if(
        steps[gap] > LONGEST_GAP * usual,
        f"The log has a gap: {place(gap + 1)}.",
        f"expected at most {LONGEST_GAP:g} times the {usual:.3g} s between most samples, got {steps[gap]:.6g} s",
        f"two logs: the first {gap + 1} rows, and those behind them (in files each below the header)",
    )


def delayed_inputs(log: Log, latency: int) -> Log:
    """The log whose inputs act so many samples after their rows; rows on which none acts that is known are left out."""
    refuse_if(
        len(log) < latency + FEWEST_ROWS,
        "The log is shorter than the latency.",
        f"expected at least {latency + FEWEST_ROWS} samples, got {len(log)}",
        "a longer log",
    )
    if not latency:
        return log
    later = log[latency:]
    return replace(
        later,
        times=later.times - later.times[0],
        inputs=log.inputs[: len(later)],
        findings=log.findings,
    )
