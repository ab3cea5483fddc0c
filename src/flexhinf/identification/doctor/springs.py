"""Check of the sign of what springs do: deflections and torques beside what the links need."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexhinf.identification.doctor.finding import LogFinding
from flexhinf.identification.doctor.record import LoggedSignal, LogRecord
from flexhinf.plant import Parameters
from flexhinf.plant.instruments import SENSORS

#: Deviation of the weights of a mean, in periods of the slowest vibration, which it takes out; a log has so many of
#: them at limit.
WIDTH, FEWEST = 0.5, 20

#: Of these deviations at each end of a log nothing is looked at.
EDGE = 4.0

#: A signal that correlates with what the links need by less has the other sign, or something else moves the links.
AGAINST = -0.5


def against_links(record: LogRecord) -> Iterator[LogFinding]:
    """Deflections and torques of springs that pull against the inertia and the weight of the links."""
    robot, log = record.robot, record.log
    pulls = [channel for channel in record.outputs if _is_pull(channel.quantity)]
    if robot is None or not pulls or record.gaps.any():
        return
    places = [_position(record, joint) for joint in robot.joint_names]
    width = WIDTH * float(0.0 if record.vibrations is None else record.vibrations[-1]) / record.period
    if None in places or not 1.0 <= width <= len(log) / FEWEST:
        return
    q = np.array([place.filled(len(log)) for place in places if place is not None])
    smooth, rate, acceleration = (_smooth(q, width, order) / record.period**order for order in range(3))
    needed = np.zeros(q.shape)
    needed[:] = robot.links.torques(smooth, rate, acceleration, Parameters(robot.plant_parameters()))
    inside = slice(int(EDGE * width), len(log) - int(EDGE * width))
    for channel in pulls:
        own: np.ndarray = needed[
            robot.joint_names.index(channel.joint) if channel.joint in robot.joint_names else 0
        ]
        both = np.array([own, _smooth(channel.filled(len(log)), width)])[:, inside]
        both = both - both.mean(axis=1, keepdims=True)
        sizes = np.sqrt((both**2).sum(axis=1))
        limit = AGAINST * float(sizes[0]) * float(sizes[1])
        if limit < 0.0 and float(both[0] @ both[1]) < limit:
            column, size = channel.column.name, -channel.column.size
            yield LogFinding(
                "sign",
                "doubt",
                f"{channel.subject} is against what moves and holds the links: it has the other sign, or something "
                "else pushes them.",
                f'To try: `--column "{channel.name}={column} [{size:.6g}]"`; a deflection is motor minus link.',
                channel.name,
                column,
            )


def _is_pull(quantity: str) -> bool:
    """Whether a quantity is positive where the motor pulls its link forward."""
    return quantity in SENSORS and SENSORS[quantity].tells_twist


def _position(record: LogRecord, joint: str) -> LoggedSignal | None:
    """The position of a joint's link, or of its motor, that is measured."""
    for quantity in ("link_position", "motor_position"):
        for channel in record.outputs:
            if channel.quantity == quantity and channel.joint in ("", joint) and len(channel.rows) > 1:
                return channel
    return None


def _smooth(values: np.ndarray, width: float, order: int = 0) -> np.ndarray:
    """Means (…, N) of values along rows, or their derivatives by the row, with Gaussian weights of a deviation `width`.

    The ends go on with each other: `EDGE` of these deviations there mean nothing.
    """
    turns = 2.0 * np.pi * np.fft.rfftfreq(values.shape[-1])
    weights = np.exp(-0.5 * (width * turns) ** 2) * (1j * turns) ** order
    return np.fft.irfft(np.fft.rfft(values) * weights, values.shape[-1])
