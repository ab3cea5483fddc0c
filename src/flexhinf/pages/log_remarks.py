"""Sentences about what a log shows of itself: they come before anything that blames the model."""

from __future__ import annotations

from collections.abc import Mapping

from flexhinf.identification import Log
from flexhinf.identification.alternatives import Alternative
from flexhinf.identification.blemishes import blemishes
from flexhinf.pages.estimate_figures import signal_label
from flexhinf.plant import Plant
from flexhinf.report import number
from flexhinf.robot import Robot


def alternative_advice(other: Alternative, plant: Plant, late: Mapping[str, int] | None = None) -> str:
    """What to try where a log with a signal at another time, or of another sign, is likelier.

    `late`: samples by which signals were stated late when the log was read: the latency of inputs, delays of sensors.
    """
    if other.kind == "sign":
        return (
            f"To try: {other.signal} times −1: its column with [-1] behind the name, as a unit, in --column."
        )
    if other.kind == "moving":
        return (
            "To try: a log with a row whenever the input changes, or the mean of the input between two rows."
        )
    is_input, stated = other.signal in plant.inputs, (late or {}).get(other.signal, 0)
    samples = stated + round(other.samples)
    if samples >= 0:
        option = f"--latency {samples}" if is_input else f"--sensor-delay {other.signal}={samples}"
        return f"To try: `{option}`{f' in the place of {stated}' if stated else ''}."
    rows = f"{-samples} row{'s' if samples < -1 else ''}"
    first = f"{'`--latency 0`' if is_input else 'no `--sensor-delay` of it'}, and " if stated else ""
    where, again = ("up", "later") if is_input else ("down", "earlier")
    return (
        f"To try: {first}the column of {other.signal} moved {where} by {rows} in the file, beside all others, as no "
        f"option does it: each row gets the value that stood {rows} {again}. Leave out the "
        f"{'last' if is_input else 'first'} {rows}, where then none stands."
    )


def likelier_remark(other: Alternative, plant: Plant, late: Mapping[str, int] | None = None) -> str:
    """The log that is likelier, and what to try; `late` as in `alternative_advice`."""
    return f"{other.text[0].upper()}{other.text[1:]}. {alternative_advice(other, plant, late)}"


def log_remarks(robot: Robot, log: Log) -> list[str]:
    """What is conspicuous in a log of a robot, in sentences."""
    found, units = blemishes(robot, log), robot.plant(log.names.get("output") or ("link_position",)).unit
    texts = [
        f"{signal_label(name).capitalize()} never changes in the log, it is always {number(value, 4)} {units(name)}: "
        "the sensor may be dead, or the column another one."
        for name, value in found.dead.items()
    ]
    texts += [
        f"{signal_label(name).capitalize()} jumps by {number(turns.size, 3)} {units(name)} in {turns.count} "
        f"{'place' if turns.count == 1 else 'places'}, as an encoder does that begins anew after a turn: it must go on "
        "counting, as numpy.unwrap makes it."
        for name, turns in found.turns.items()
    ]
    texts += [
        f"{signal_label(name).capitalize()} jumps to {number(lost.value, 4)} {units(name)} and back in {lost.count} "
        f"{'place' if lost.count == 1 else 'places'}: a value that was lost, it seems. Leave such cells empty."
        for name, lost in found.lost.items()
    ]
    if found.gaps is not None:
        count, longest, at = found.gaps
        many = "a gap" if count == 1 else f"{count} gaps, the longest"
        texts.append(
            f"The log has {many} of {number(longest, 3)} s after {number(at, 4)} s. The last input was held over it; "
            "where another acted, cut the log there."
        )
    if found.apart is not None:
        apart, fastest = found.apart
        texts.append(
            f"Rows are {number(1e3 * apart, 3)} ms apart, and the robot's fastest vibration has a period of "
            f"{number(1e3 * fastest, 3)} ms: the log does not show it, or the unit of its times is another one."
        )
    return texts
