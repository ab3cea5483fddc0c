"""Checks of the times of a log: gaps, dropped rows, stamps of arrival, rows too far apart or too close."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexhinf.identification.doctor.finding import LogFinding
from flexhinf.identification.doctor.record import LogRecord
from flexhinf.numerals import number_text

#: A step that is so near to a whole number of them is of
#: dropped rows; rows show a vibration that are at most this share of its period apart.
NEAR, SEEN = 0.25, 0.5

#: A step is odd that differs from the usual one by this share; stamps with this share of odd ones are of arrival.
ODD, ARRIVAL = 0.5, 0.1

#: Rows further apart than so many periods of the slowest vibration show nothing of it; no log has rows so close, s.
APART, CLOSE = 5.0, 2e-6

UNIT = 'the unit of the times: `--time "{column} [ms]"` or `--time "{column} [us]"`'


def gaps(record: LogRecord) -> Iterator[LogFinding]:
    """Times without a row, over which the last input is held."""
    steps, long = record.steps, np.flatnonzero(record.gaps)
    if not long.size:
        return
    worst = int(np.argmax(steps))
    many = "a gap" if long.size == 1 else f"{long.size} gaps, the longest"
    yield LogFinding(
        "gap",
        "doubt",
        f"The log has {many} of {number_text(float(f'{steps[worst]:.3g}'), 's')} after "
        f"{number_text(float(record.log.times[worst]), 's')}. The last input was held over it.",
        f"To try: where another acted, cut the log there: rows 1 to {worst + 1}, and those behind.",
        "time",
        _column(record),
        (worst, worst + 1),
        int(long.size),
    )


def arrival_or_drops(record: LogRecord) -> Iterator[LogFinding]:
    """Rows that are missing one by one, and stamps that come in bursts, as of messages that arrive."""
    steps = record.steps[~record.gaps]
    regular = np.abs(steps / record.period - 1.0) <= ODD
    usual = record.period if regular.mean() > 0.5 else float(steps.mean())
    parts = steps / usual
    whole = np.rint(parts)
    missing = (whole >= 2) & (np.abs(parts - whole) < NEAR)
    odd = (np.abs(parts - 1.0) > ODD) & ~(missing & (regular.mean() > 0.5))
    if odd.mean() > ARRIVAL:
        low, high = (number_text(float(f"{1e3 * q:.3g}"), "ms") for q in np.quantile(steps, (0.05, 0.95)))
        grid = _grid(steps)
        rounded = grid > 0.2 * usual
        yield LogFinding(
            "arrival",
            "note" if rounded else "doubt",
            f"Rows are {low} to {high} apart: "
            + (
                f"stamps are rounded to {number_text(1e3 * grid, 'ms')}."
                if rounded
                else "the times are those at which messages arrived or were written, it seems, and not those of the "
                "samples."
            ),
            "To try: the stamps of the samples, such as `--time header.stamp`, or a column of times with the row's "
            "number times the period.",
            "time",
            _column(record),
            None,
            int(odd.sum()),
        )
    elif missing.any():
        lost = int((whole[missing] - 1).sum())
        yield LogFinding(
            "dropped",
            "note",
            f"{lost} row{'s are' if lost != 1 else ' is'} missing, {100.0 * lost / (len(steps) + lost):.2g} %: the "
            "filter predicts over them, with the input held.",
            "",
            "time",
            _column(record),
            None,
            lost,
        )


def apart(record: LogRecord) -> Iterator[LogFinding]:
    """Rows too far apart for the robot's vibrations, or closer than any log has them."""
    column, step = _column(record), record.period
    if step < CLOSE:
        yield LogFinding(
            "times",
            "fault",
            f"Rows are {number_text(step, 's')} apart: the times are in another unit, it seems.",
            f"To try: {UNIT.format(column=column)}.",
            "time",
            column,
        )
    if record.vibrations is None:
        return
    fastest, slowest = float(record.vibrations[0]), float(record.vibrations[-1])
    if step > APART * slowest:
        yield LogFinding(
            "times",
            "fault",
            "The times of the log do not fit the robot.",
            f"To try: {UNIT.format(column=column)}.",
            "time",
            column,
            refused=True,
            numbers=f"expected rows at most {APART * slowest:.3g} s apart, five periods of its slowest vibration, got "
            f"{step:.3g} s",
        )
    elif step > SEEN * fastest:
        yield LogFinding(
            "apart",
            "doubt",
            f"Rows are {number_text(float(f'{1e3 * step:.3g}'), 'ms')} apart, and the robot's fastest vibration has a "
            f"period of {number_text(float(f'{1e3 * fastest:.3g}'), 'ms')}: the log does not show it.",
            f"To try: a log with more rows in a second, or {UNIT.format(column=column)}.",
            "time",
            column,
        )


def _grid(steps: np.ndarray) -> float:
    """What all steps (N,) are whole numbers of, s; 0 where there is no such time."""
    different = np.unique(np.round(steps, 9))
    grid = float(different[different > 0.0].min(initial=np.inf))
    places = different / grid
    return grid if len(different) <= 10 and np.abs(places - np.rint(places)).max() < 0.01 else 0.0


def _column(record: LogRecord) -> str:
    column = record.log.columns.get("time")
    return "time" if column is None else column.name
