"""A kind of sensor in a file of its own, as CONTRIBUTING.md prints it: no other file names it."""

from math import inf

from flexhinf.plant.instruments import SensorKind, register

register(
    SensorKind(
        "twist_rate",
        units=("rad/s", "m/s"),
        side="spring",
        measure=lambda joints: joints.twist_rates,
        plausible=lambda known: (-(known.speed + known.motor_speed), known.speed + known.motor_speed, inf),
        coarsest=(1e3, 1e3),
        interface="twist_rate",
        pair=((0.0, -1.0, 0.0, 1.0), 1),
        rate=True,
        instruments=("differential",),
    )
)
