"""What the drives of a robot ask of a loop: its period, its latency, its sensors."""

from __future__ import annotations

import numpy as np

from flexhinf.designs.specification import Specification
from flexhinf.errors import refuse_if
from flexhinf.plant.instruments import SENSORS
from flexhinf.robot import Robot, signals
from flexhinf.robot.parameters import per_joint


def check_loop_of_drives(robot: Robot, s: Specification) -> None:
    """Refuse a period shorter than that of the drives, delays that do not contain those of drives and sensors, and
    motors as the only sensors where drives reject their load.

    A value that is late by d says of an input what the true one says d later: for a loop both delays are one.
    """
    slowest = robot.drive_period
    refuse_if(
        s.period < slowest * (1.0 - 1e-9),
        f"The drives of {robot.name!r} take a command every {slowest:g} s.",
        f"expected a period of at least that, got {s.period:g} s",
        f"--period {slowest:g}",
    )
    _check_seen(robot, s)
    sensing = sensor_delay(robot, s)
    if robot.drive_delay + sensing == 0.0:
        return
    late = (s.known_latency + s.unknown_samples) * s.period
    needed = int(np.ceil((robot.drive_delay + sensing) / s.period - 1e-9))
    delays = {"drives": robot.drive_delay, "sensors": sensing}
    whose = " and ".join(f"{name} of {robot.name!r} by {time:g} s" for name, time in delays.items() if time)
    refuse_if(
        late < (robot.drive_delay + sensing) * (1.0 - 1e-9),
        f"The design's latency is less than the delays of its robot: {whose}.",
        f"expected a latency of at least {needed} samples of {s.period:g} s, got {late / s.period:g}",
        f"--latency {needed}; one more where the computation takes a sample too",
    )


def _check_seen(robot: Robot, s: Specification) -> None:
    """Refuse motors as the only sensors of joints whose drives reject their load: they tell nothing of the links."""
    if not robot.drive_kind.inner or s.estimator == "none":
        return
    joints = robot.joint_names
    share = np.broadcast_to(robot.plant_parameters()["load_share"], len(joints))
    names = signals.expanded(s.measured, SENSORS, joints, robot.rigid)
    of_links = [name for name, kind in SENSORS.items() if kind.tells_links]
    blind = [
        joint
        for joint, felt in zip(joints, share)
        if felt == 0.0 and not {per_joint(quantity, joint, len(joints)) for quantity in of_links} & {*names}
    ]
    refuse_if(
        blind,
        f"Nothing that is measured tells of the links at {', '.join(blind)}: their drives reject the load.",
        f"expected {', '.join(of_links[:-1])} or {of_links[-1]} there, got {', '.join(names)}",
        "--measured link_position,motor_position; or without a sensor of the links commands without feedback, flexhinf "
        "export c --feedforward",
    )


def sensor_delay(robot: Robot, s: Specification) -> float:
    """Longest delay of the sensors that a specification measures with, s; those that are sooner wait for it."""
    if s.estimator == "none" or not robot.sensors:
        return 0.0
    names = signals.expanded(s.measured, SENSORS, robot.joint_names, robot.rigid)
    return max((sensor.delay for sensor in robot.sensors if sensor.signal in names), default=0.0)
