"""The sensors of flexhinf: of both sides of a joint, and of the spring between them."""

from __future__ import annotations

from math import inf, pi

from flexhinf.plant.instruments.sensor import SensorKind, register

#: Units with the coarsest steps of each: a whole turn, the size of a hall, a speed and a torque that no joint has.
_ANGLE, _COARSE_ANGLE = ("rad", "m"), (2.0 * pi, 10.0)
_SPEED, _COARSE_SPEED = ("rad/s", "m/s"), (1e3, 1e3)
_TORQUE, _COARSE_TORQUE = ("N·m", "N"), (1e6, 1e6)

register(
    SensorKind(
        "link_position",
        _ANGLE,
        "link",
        measure=lambda joints: joints.link_positions,
        plausible=lambda known: (known.low, known.high, known.speed),
        coarsest=_COARSE_ANGLE,
        interface="position",
        pair=((1.0, 0.0, 0.0, 0.0), 1),
        counted=True,
    )
)
register(
    SensorKind(
        "link_velocity",
        _SPEED,
        "link",
        measure=lambda joints: joints.link_velocities,
        plausible=lambda known: (-known.speed, known.speed, inf),
        coarsest=_COARSE_SPEED,
        interface="velocity",
        pair=((0.0, 1.0, 0.0, 0.0), 1),
        rate=True,
        instruments=("gyro",),
    )
)
register(
    SensorKind(
        "motor_position",
        _ANGLE,
        "motor",
        measure=lambda joints: joints.motor_positions,
        plausible=lambda known: (known.ends[0] - known.twist, known.ends[1] + known.twist, known.motor_speed),
        coarsest=_COARSE_ANGLE,
        interface="motor_position",
        pair=((0.0, 0.0, 1.0, 0.0), 1),
        counted=True,
        at_motor="motor angle /",
        instruments=("resolver", "encoder"),
    )
)
register(
    SensorKind(
        "motor_velocity",
        _SPEED,
        "motor",
        measure=lambda joints: joints.motor_velocities,
        plausible=lambda known: (-known.motor_speed, known.motor_speed, inf),
        coarsest=_COARSE_SPEED,
        interface="motor_velocity",
        pair=((0.0, 0.0, 0.0, 1.0), 1),
        rate=True,
        at_motor="motor speed /",
        instruments=("tacho",),
    )
)
register(
    SensorKind(
        "joint_torque",
        _TORQUE,
        "spring",
        measure=lambda joints: joints.spring_torques,
        plausible=lambda known: (
            -known.torque,
            known.torque,
            known.stiffness * (known.speed + known.motor_speed),
        ),
        coarsest=_COARSE_TORQUE,
        interface="effort",
        pair=((-1.0, 0.0, 1.0, 0.0), -1),
        force=True,
        instruments=("load", "cell", "strain", "force", "torque"),
        instrument="a load cell or strain gauge in the drive",
    )
)
register(
    SensorKind(
        "deflection",
        _ANGLE,
        "spring",
        measure=lambda joints: joints.twists,
        plausible=lambda known: (-known.twist, known.twist, known.speed + known.motor_speed),
        coarsest=_COARSE_ANGLE,
        interface="deflection",
        pair=((-1.0, 0.0, 1.0, 0.0), 1),
        counted=True,
    )
)
