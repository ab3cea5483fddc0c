"""Findings about signals that are late, early, or of the other sign: logs that are likelier, with what to do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from flexhinf.errors import FlexhinfError
from flexhinf.identification.alternatives import Alternative
from flexhinf.identification.defaults import standing
from flexhinf.identification.doctor.finding import LogFinding
from flexhinf.identification.log import FileColumn, Log
from flexhinf.plant import Plant
from flexhinf.robot import Robot
from flexhinf.robot.parameters import per_joint

#: Numbers that may be others than a robot's file says, by quantity.
NUMBERS = ("stiffness", "friction", "motor_inertia", "rotor_inertia")

#: Joints of a robot whose model is looked at, and rows of a log, at most.
MOST_JOINTS, MOST_ROWS = 3, 4000


def alternative_advice(
    other: Alternative,
    plant: Plant,
    late: Mapping[str, int] | None = None,
    columns: Mapping[str, FileColumn] | None = None,
) -> str:
    """What to try where a log with a signal at another time, or of another sign, is likelier.

    `late`: samples by which signals were stated late when the log was read: the latency of inputs, delays of sensors.
    `columns`: of the log's file.
    """
    if other.kind == "sign":
        column = (columns or {}).get(other.signal, FileColumn(other.signal))
        stated = f'--column "{other.signal}={column.name} [{-column.size:.6g}]"'
        return f"To try: {other.signal} times −1: `{stated}`."
    if other.kind == "moving":
        return (
            "To try: a log with a row whenever the input changes, or the mean of the input between two rows."
        )
    is_input, stated_late = other.signal in plant.inputs, (late or {}).get(other.signal, 0)
    samples = stated_late + round(other.samples)
    if samples >= 0:
        option = f"--latency {samples}" if is_input else f"--sensor-delay {other.signal}={samples}"
        return f"To try: `{option}`{f' in the place of {stated_late}' if stated_late else ''}."
    rows = f"{-samples} row{'s' if samples < -1 else ''}"
    first = f"{'`--latency 0`' if is_input else 'no `--sensor-delay` of it'}, and " if stated_late else ""
    where, again = ("up", "later") if is_input else ("down", "earlier")
    return (
        f"To try: {first}the column of {other.signal} moved {where} by {rows} in the file, beside all others, as no "
        f"option does it: each row gets the value that stood {rows} {again}. Leave out the "
        f"{'last' if is_input else 'first'} {rows}, where then none stands."
    )


def likelier_finding(
    other: Alternative,
    plant: Plant,
    late: Mapping[str, int] | None = None,
    columns: Mapping[str, FileColumn] | None = None,
) -> LogFinding:
    """The log that is likelier, as a finding; arguments as of `alternative_advice`."""
    column = (columns or {}).get(other.signal, FileColumn(other.signal))
    return LogFinding(
        other.kind,
        "fault" if other.kind == "sign" else "doubt",
        f"{other.text[0].upper()}{other.text[1:]}.",
        alternative_advice(other, plant, late, columns),
        other.signal,
        column.name,
    )


def beside_model(log: Log, robot: Robot, late: Mapping[str, int] | None = None) -> Iterator[LogFinding]:
    """A signal that is late or of the other sign, by the robot's model, with `NUMBERS` sought beside.

    What friction, springs and gears explain better is no delay: it is said of the model, as a note. `late`: as of
    `alternative_advice`. Of more than `MOST_JOINTS` joints, and of a robot that stands, nothing is said.
    """
    from flexhinf.identification.explanations import DELAY, believed, explanations
    from flexhinf.identification.identify import identify

    joints, part = len(robot.joint_names), liveliest(log, MOST_ROWS)
    if joints > MOST_JOINTS or standing(part.inputs, part.outputs) or not np.ptp(part.inputs, axis=0).any():
        return
    stated = {parameter.name for parameter in robot.parameters}
    names = [
        name
        for quantity in NUMBERS
        for joint in robot.joint_names
        if (name := per_joint(quantity, joint, joints)) in stated
    ]
    try:
        found = identify(robot, part, names, measured=log.names.get("output") or ("link_position",))
        causes = () if found.consistent else explanations(found, part)
    except FlexhinfError:  # a model that cannot be filtered says nothing of the log
        return
    other = believed(found, causes)
    if other is not None:
        yield likelier_finding(other, found.plant, late, log.columns)
    elif causes and causes[0].kind != DELAY:
        yield LogFinding(
            "model",
            "note",
            f"The robot's model does not fit the log; what is left is explained best by {causes[0].text}.",
            "To try: `flexhinf identify`, which says more.",
        )


def liveliest(log: Log, rows: int) -> Log:
    """The part of a log of so many rows in which the inputs change most."""
    if len(log) <= rows:
        return log
    busy = np.abs(np.diff(log.inputs, axis=0, prepend=log.inputs[:1]))
    scale = np.maximum(log.inputs.std(axis=0), 1e-300)
    total = np.append(0.0, np.cumsum((busy / scale).sum(axis=1)))
    first = int(np.argmax(total[rows:] - total[:-rows]))
    part = log[first : first + rows]
    return replace(part, times=part.times - part.times[0])
