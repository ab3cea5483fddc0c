"""Checks of the size of a column: beside the robot's limits, and beside another sensor of the same joint."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.identification.doctor.finding import LogFinding
from flexhinf.identification.doctor.record import LoggedSignal, LogRecord
from flexhinf.identification.doctor.times import UNIT

#: A link that moves faster, rad/s or m/s, is none; nor are positions that span so many times a joint's range, and
#: inputs that are so many times a limit.
FAST, BEYOND, OVER = 100.0, 4.0, 20.0

#: Whole numbers that span so many are no rad; so many first values are looked at for different ones.
COUNTS, COUNTED = 30.0, 100_000

#: Two sensors of a joint differ by a unit or a gear if one moves so many times as far as the other, in slow motions of
#: so many steps of both, which correlate so much, and are this share of all that they do.
RATIO, CLEAR, RELATED, SLOW = 3.0, 30.0, 0.9, 0.3

#: What a ratio of two columns may be, and how near a measured one is to it.
NEAR = 0.05
UNITS = {
    180.0 / np.pi: "deg",
    1e3: "mrad or mm",
    30.0 / np.pi: "rpm",
    0.5 / np.pi: "rev",
    180e3 / np.pi: "mdeg",
}


def plausible(record: LogRecord) -> Iterator[LogFinding]:
    """Positions that are counts, too fast, or too far for their joint: no filter is to see them."""
    robot = record.robot
    if robot is None:
        return
    for channel in record.outputs:
        if not channel.quantity.endswith("position"):
            continue
        moves, seconds = channel.moves, np.diff(record.log.times[channel.rows])
        speed = (moves / seconds)[moves > 0.0]
        fast = float(np.median(speed)) if speed.size else 0.0
        joints = robot.joint_names
        limits = robot.links.limits[joints.index(channel.joint) if channel.joint in joints else 0]
        span, reach = channel.span, float(np.ptp(limits or (0.0, np.inf)))
        column = channel.column.name
        kind = channel.quantity.partition("_")[0]
        stated = f'`--column "{channel.name}={column} '
        if (ends := _counted(channel, fast)) is not None:
            yield _refusal(
                channel,
                f"{channel.name!r} has whole numbers alone: counts of an encoder, or degrees, and no rad or m.",
                f"expected positions in rad or m, got whole numbers from {ends[0]:g} to {ends[1]:g}",
                f'what a count is: {stated}[0.00306796]"` of 2048 counts a turn, 2π/2048 (over the ratio of a gear '
                f'that comes after the encoder); or {stated}[deg]"`',
            )
        elif fast > FAST:
            time = record.log.columns.get("time")
            yield _refusal(
                channel,
                "The times of the log do not fit its positions.",
                f"expected a {kind} that moves by less than {FAST:g} rad/s or m/s, got {fast:.3g} in "
                f"{channel.name!r}",
                f"{UNIT.format(column='time' if time is None else time.name)}; or that of the positions, "
                f'{stated}[deg]"`',
            )
        elif span > BEYOND * reach:
            yield _refusal(
                channel,
                f"{channel.name!r} goes too far for its joint.",
                f"expected a span within the joint's range of {reach:.4g} rad or m, got {span:.4g}",
                f'its unit, {stated}[deg]"`; or what one of it is behind the gear: encoder degrees of a motor before '
                f'a gear of 80 are {stated}[0.000218166]"`, π/180/80',
            )


def _refusal(channel: LoggedSignal, what: str, numbers: str, advice: str) -> LogFinding:
    return LogFinding(
        "scale",
        "fault",
        what,
        f"To try: {advice}.",
        channel.name,
        channel.column.name,
        refused=True,
        numbers=numbers,
    )


def _counted(channel: LoggedSignal, fast: float) -> tuple[float, float] | None:
    """The ends of positions that are whole numbers and go far, or as `fast`, rad/s, as no joint does; else None."""
    values = channel.values
    if (
        not values.size
        or not np.array_equal(values, np.rint(values))
        or len(np.unique(values[:COUNTED])) <= 2
    ):
        return None
    low, high = float(values.min()), float(values.max())
    return (low, high) if fast > FAST or high - low > COUNTS else None


def inputs(record: LogRecord) -> Iterator[LogFinding]:
    """Inputs beyond what the drive can."""
    limits = (record.robot.effort_limits or ()) if record.robot is not None else ()
    for channel, limit in zip(record.inputs, limits):
        most = float(np.abs(channel.values).max(initial=0.0))
        if limit is not None and np.isfinite(limit) and most > OVER * limit:
            yield LogFinding(
                "scale",
                "fault",
                f"{channel.subject} is up to {channel.text(most, 3)}, and the robot's limit is "
                f"{channel.text(float(limit), 3)}: another unit, or a torque before a gear.",
                f'To try: `--column "{channel.name}={channel.column.name} [m{channel.unit}]"`, or what one of it is in '
                f"{channel.unit}, as a number there.",
                channel.name,
                channel.column.name,
            )


def ratios(record: LogRecord) -> Iterator[LogFinding]:
    """Motor and link of a joint that do not move as far, or not into the same direction."""
    outputs = {channel.name: channel for channel in record.outputs}
    for motor in record.outputs:
        if motor.quantity != "motor_position" or (record.robot is not None and record.robot.coupling):
            continue  # a motor of coupled joints moves as far as the sum of several
        link = outputs.get(motor.name.replace("motor", "link", 1))
        slope = None if link is None else _slope(record, motor, link)
        if link is None or slope is None or 1.0 / RATIO < slope < RATIO:
            continue
        size = abs(slope)
        if 1.0 / RATIO < size < RATIO:
            yield LogFinding(
                "sign",
                "fault",
                f"{motor.subject} and {link.label} move in opposite directions: one of them has the other sign.",
                f"To try: {_stated(motor, -1.0)}, or the same of {link.name}.",
                motor.name,
                motor.column.name,
            )
            continue
        far, near = (motor, link) if size > 1.0 else (link, motor)
        much = max(size, 1.0 / size)
        unit = next((name for ratio, name in UNITS.items() if abs(much / ratio - 1.0) < NEAR), "")
        gear = "" if far is link else f", or a motor before a gear of {much:.3g}"
        yield LogFinding(
            "scale",
            "fault",
            f"{far.subject} moves {much:.3g} times as far as {near.label}"
            f"{' and in the opposite direction' if slope < 0.0 else ''}: "
            f"{f'numbers in {unit}' if unit else 'another unit'}{gear}.",
            f"To try: {_stated(far, np.sign(slope) / _exact(record, much))}"
            + (
                f', or `--column "{far.name}={far.column.name} [{unit}]"`.'
                if unit and " " not in unit
                else "."
            ),
            far.name,
            far.column.name,
        )


def _exact(record: LogRecord, ratio: float) -> float:
    """The ratio of a gear or of units that a measured one is near to; else that, with three digits."""
    robot = record.robot
    gears = [] if robot is None else [n for name, n in robot.nominal.items() if name.startswith("gear_ratio")]
    known = [*gears, *UNITS]
    return next((each for each in known if abs(ratio / each - 1.0) < NEAR), float(f"{ratio:.3g}"))


def _stated(channel: LoggedSignal, factor: float) -> str:
    """The option by which a column is times a factor."""
    return f'`--column "{channel.name}={channel.column.name} [{channel.column.size * factor:.6g}]"`'


def _slope(record: LogRecord, motor: LoggedSignal, link: LoggedSignal) -> float | None:
    """How far the motor moves for one of the link in slow motions; None where that is not clear.

    Above its vibration a link moves against its motor: only what lasts longer counts.
    """
    count = len(record.log)
    slow = 2.0 * float(record.vibrations[-1]) if record.vibrations is not None else 0.1
    width = max(1, int(np.ceil(slow / record.period)))
    if count < 6 * width:
        return None
    tables: list[Vector] = []
    for channel in (motor, link):
        if len(channel.rows) < 4:
            return None
        filled = channel.filled(count)
        blocks = filled[: count // width * width].reshape(-1, width).mean(axis=1)
        if np.ptp(blocks) <= max(SLOW * channel.span, CLEAR * channel.step):
            return None
        tables.append(blocks - blocks.mean())
    sizes = [float(np.sqrt(table @ table)) for table in tables]
    correlation = float(tables[0] @ tables[1]) / (sizes[0] * sizes[1])
    return np.sign(correlation) * sizes[0] / sizes[1] if abs(correlation) > RELATED else None


def speeds(record: LogRecord) -> Iterator[LogFinding]:
    """Velocities that are not the slope of the position beside them."""
    outputs = {channel.name: channel for channel in record.outputs}
    for velocity in record.outputs:
        if not velocity.quantity.endswith("velocity"):
            continue
        position = outputs.get(velocity.name.replace("velocity", "position", 1))
        if position is None or len(velocity.rows) < 20 or len(position.rows) < 20:
            continue
        times = record.log.times
        rate, moved = (channel.filled(len(times)) for channel in (velocity, position))
        travelled = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(times))])
        drift = np.column_stack([np.ones(len(times)), times])
        both = np.column_stack([moved, travelled])
        both = both - drift @ np.linalg.lstsq(drift, both, rcond=None)[0]
        sizes: Vector = np.sqrt((both**2).sum(axis=0))
        if np.ptp(both[:, 0]) <= CLEAR * position.step or not (sizes > 0.0).all():
            continue
        correlation = float(both[:, 0] @ both[:, 1]) / float(np.prod(sizes))
        slope = (1.0 if correlation > 0.0 else -1.0) * float(sizes[1] / sizes[0])
        if abs(correlation) < RELATED or 1.0 / RATIO < slope < RATIO:
            continue
        unit = next((name for ratio, name in UNITS.items() if abs(abs(slope) / ratio - 1.0) < NEAR), "")
        unit = {"deg": "deg/s", "rev": "rev/s"}.get(unit, unit)
        negative = 1.0 / RATIO < abs(slope) < RATIO
        yield LogFinding(
            "sign" if negative else "scale",
            "fault",
            f"{velocity.subject} is {f'{slope:.3g} times ' if not negative else 'against '}the slope of "
            f"{position.label}: {'the other sign' if negative else f'numbers in {unit}' if unit else 'another unit'}.",
            f"To try: {_stated(velocity, -1.0 if negative else np.sign(slope) / _exact(record, abs(slope)))}.",
            velocity.name,
            velocity.column.name,
        )
