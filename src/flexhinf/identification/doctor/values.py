"""Checks of a signal's own values: lost ones, turns, single ones far off, dead sensors, steps, equal ones that last."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from flexhinf.identification.doctor import jumps
from flexhinf.identification.doctor.finding import LogFinding
from flexhinf.identification.doctor.record import LoggedSignal, LogRecord

#: Fewest equal values in a row that may be of a sensor that stopped, and how many times as far as the signal moves
#: beside it jumps afterwards.
FROZEN, AFTER = 10, 5.0

#: A sensor that is slower than the rows: most rows between new values, fewest new values, share of them at the right
#: rows, and their size in steps.
SLOWEST, FEWEST, REGULAR, CLEAR = 100, 20, 0.95, 3.0

#: A joint moved if another of its sensors did by so much, rad or m; and so many steps of a sensor are few.
MOVED, FEW_STEPS = 0.05, 20.0

#: Values at one end, between moves of so many steps, by which a sensor is at its limit, and how often it is there.
AT_LIMIT, OFTEN = 4, 3


def cleaned(record: LogRecord) -> tuple[list[LogFinding], LogRecord]:
    """What the values of each signal show, and the record without what is none: lost values, turns that begin anew."""
    findings, channels = list[LogFinding](), list[LoggedSignal]()
    for channel in record.channels:
        for check in (_marks, _renewal, _lost):
            for finding, better in check(channel):
                findings.append(finding)
                channel = better
        channels.append(channel)
    clean = replace(record, channels=channels)
    for channel in clean.outputs:
        for check in (dead, frozen, slow, at_limit, steps):
            several = list(check(channel, clean))
            findings += several
            if several:
                break  # what follows from it is no finding of its own
    return findings, clean


def _marks(channel: LoggedSignal) -> Iterator[tuple[LogFinding, LoggedSignal]]:
    if (gone := jumps.marks(channel.values, channel.column.size)) is not None:
        yield _lost_finding(channel, gone), channel.without(_flags(channel, gone.places))


def _lost(channel: LoggedSignal) -> Iterator[tuple[LogFinding, LoggedSignal]]:
    if channel.is_input or not channel.values.size:  # an input may jump
        return
    gone = jumps.lost(channel.values, channel.step)
    if gone is None:
        return
    better = channel.without(_flags(channel, gone.places))
    if gone.value is not None:
        yield _lost_finding(channel, gone), better
        return
    count = gone.excursions
    worst = gone.places[np.argmax(np.abs(channel.values[gone.places] - np.median(channel.values)))]
    yield (
        LogFinding(
            "outliers",
            "doubt",
            f"{channel.subject} has {_many(count, 'value')} far off, for a moment, such as "
            f"{channel.text(float(channel.values[worst]))} in row {channel.rows[worst] + 1}.",
            "To try: `--gate 0.999` of `flexhinf estimate` skips them; for `flexhinf identify` leave such cells empty.",
            channel.name,
            channel.column.name,
            channel.rows_of(gone.places),
            count,
        ),
        better,
    )


def _lost_finding(channel: LoggedSignal, gone: jumps.Lost) -> LogFinding:
    value = gone.value or 0.0
    written = f"{channel.in_file(value):.10g}"
    return LogFinding(
        "lost",
        "fault",
        f"{channel.subject} is {written} in {_many(len(gone.places), 'row')}, and far from it else: a value that was "
        "lost, it seems.",
        f"To try: `--missing {written}`, which takes such a value for none"
        f"{', with `--hold-inputs`' if channel.is_input else ''}.",
        channel.name,
        channel.column.name,
        channel.rows_of(gone.places),
        gone.excursions,
    )


def _renewal(channel: LoggedSignal) -> Iterator[tuple[LogFinding, LoggedSignal]]:
    if channel.is_input:
        return
    again = jumps.renewal(channel.values, channel.step, channel.column.size)
    if again is None:
        return
    far = channel.text(again.modulus, 3)
    what = f", {again.what}" if again.what else ""
    counts = "counter that begins anew" if "bits" in again.what else "encoder that begins anew after a turn"
    finding = LogFinding(
        "turns",
        "fault",
        f"{channel.subject} jumps by {far}{what}, in {_many(len(again.places), 'place')}, and goes on there: "
        f"a{'n' if counts[0] == 'e' else ''} {counts}.",
        f"To try: `--unwrap {channel.name}`, which makes it go on counting.",
        channel.name,
        channel.column.name,
        channel.rows_of(again.places),
        len(again.places),
    )
    yield finding, replace(channel, values=jumps.unwrapped(channel.values, again.modulus))


def dead(channel: LoggedSignal, record: LogRecord) -> Iterator[LogFinding]:
    """A signal that never changes though its joint moves, or an input acts."""
    if channel.values.size < 2 or channel.span > 0.0:
        return
    same_joint = [o for o in record.outputs if o.joint == channel.joint and o.name != channel.name]
    moving = [o for o in same_joint if o.span > MOVED and o.span > FEW_STEPS * o.step]
    driven = [i for i in record.inputs if i.joint in ("", channel.joint) and i.span > 0.0]
    value, severity = channel.text(float(channel.values[0])), "note"
    why = "and nothing else of its joint moves far."
    if moving:
        severity, why = "fault", f"while {moving[0].label} moves by {moving[0].text(moving[0].span, 3)}."
    elif not same_joint and any(i.span > 0.5 * np.abs(i.values).max() for i in driven):
        severity, why = "doubt", f"while {driven[0].label} does."
    advice = (
        "Robot and inputs are at rest, it seems."
        if severity == "note"
        else (
            "The sensor may be dead, or the column another one: to try: `--column "
            f"{channel.name}=COLUMN` with another column, or `--measured` without it."
        )
    )
    yield LogFinding(
        "dead",
        severity,
        f"{channel.subject} never changes in the log, it is always {value}, {why}",
        advice,
        channel.name,
        channel.column.name,
        count=len(channel.values),
    )


def frozen(channel: LoggedSignal, record: LogRecord) -> Iterator[LogFinding]:
    """Equal values that last while the signal moves, and a jump to where it would be."""
    ends = np.flatnonzero(channel.moves > 0.0)
    starts = np.append(0, ends[:-1] + 1)[: ends.size]
    long = (ends - starts + 1 >= FROZEN) & (starts > 0) & (ends + 2 < len(channel.values))
    before, behind = jumps.moves_around(channel.moves)
    found = [
        (first, last)
        for first, last in zip(starts[long].tolist(), ends[long].tolist())
        if channel.moves[last] > AFTER * max(before[first], behind[last], channel.step)
        and np.count_nonzero(channel.moves[max(0, first - jumps.BESIDE_ROWS) : first])
        > 0.5 * jumps.BESIDE_ROWS
    ]
    if found:
        longest = max(last - first + 1 for first, last in found)
        places = np.array(found)
        yield LogFinding(
            "frozen",
            "doubt",
            f"{channel.subject} keeps one value for up to {longest} rows, in {_many(len(found), 'place')}, and then "
            "jumps to where it would be: the sensor or its bus stopped there, it seems.",
            "To try: leave repeated cells empty, or cut the log there.",
            channel.name,
            channel.column.name,
            channel.rows_of(places.ravel()),
            len(found),
        )


def slow(channel: LoggedSignal, record: LogRecord) -> Iterator[LogFinding]:
    """A sensor that is slower than the rows, whose value is repeated until the next one."""
    changes = np.flatnonzero(channel.moves > 0.0)
    if changes.size < FEWEST or len(channel.rows) < len(record.log):
        return
    if np.median(channel.moves[changes]) < CLEAR * channel.step or (
        not channel.coarse and channel.step == 0.0
    ):
        return
    apart = np.diff(changes)
    every = int(np.median(apart))
    if not 2 <= every <= SLOWEST:
        return
    residues = np.bincount(changes % every, minlength=every) / changes.size
    if residues.max() > REGULAR and np.mean(apart == every) > 0.5:
        yield LogFinding(
            "slow",
            "doubt",
            f"{channel.subject} has a new value in every {_ordinal(every)} row alone, and repeats it in between: the "
            "sensor is slower than the rows.",
            f"To try: `--repeated {channel.name}`, which takes repeated values for none.",
            channel.name,
            channel.column.name,
            None,
            len(channel.rows) - changes.size - 1,
        )


def at_limit(channel: LoggedSignal, record: LogRecord) -> Iterator[LogFinding]:
    """A sensor at the end of its range: moves, one and the same extreme value, moves back."""
    if channel.span == 0.0 or channel.quantity.endswith("position"):
        return
    for extreme, end in ((channel.values.max(), "largest"), (channel.values.min(), "smallest")):
        at = np.concatenate([[0], (channel.values == extreme).astype(int), [0]])
        starts, ends = np.flatnonzero(np.diff(at) > 0), np.flatnonzero(np.diff(at) < 0)
        count = 0
        for first, behind in zip(starts.tolist(), ends.tolist()):
            if behind - first < AT_LIMIT or first == 0 or behind == len(channel.values):
                continue
            into, out = channel.moves[first - 1], channel.moves[behind - 1]
            count += min(into, out) > max(STEEP * channel.step, 1e-3 * channel.span)
        if count >= OFTEN:
            yield LogFinding(
                "limit",
                "doubt",
                f"{channel.subject} stands at its {end} value, {channel.text(extreme)}, in {_many(count, 'place')}, "
                "between moves: the sensor is at the end of its range, it seems.",
                "To try: a log that moves less, or leave such cells empty.",
                channel.name,
                channel.column.name,
                None,
                count,
            )


#: Steps of a sensor by which it moves to the end of its range, and back.
STEEP = 3.0


def steps(channel: LoggedSignal, record: LogRecord) -> Iterator[LogFinding]:
    """The step of an encoder, which counts as noise, and how few of them the log has."""
    if not channel.coarse or channel.values.size < 2:
        return
    counts = 2.0 * np.pi / channel.step if channel.unit == "rad" else 0.0
    per_turn = (
        f", {counts:.6g} in a turn" if counts > 4.0 and abs(counts - round(counts)) < 1e-3 * counts else ""
    )
    noise = channel.text(channel.step / np.sqrt(12.0), 3)
    few = channel.span < FEW_STEPS * channel.step
    yield LogFinding(
        "step",
        "note",
        f"{channel.subject} has steps of {channel.text(channel.step, 4)}{per_turn}: they count as noise of {noise} at "
        f"least{f'. It moves by {channel.span / channel.step:.3g} of them' if few else ''}.",
        "To try: a log that moves farther." if few else "",
        channel.name,
        channel.column.name,
    )


def _flags(channel: LoggedSignal, places: np.ndarray) -> np.ndarray:
    flags = np.zeros(len(channel.values), dtype=bool)
    flags[places] = True
    return flags


def _many(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def _ordinal(count: int) -> str:
    ends = {1: "st", 2: "nd", 3: "rd"}
    return f"{count}{'th' if 10 <= count % 100 <= 20 else ends.get(count % 10, 'th')}"
