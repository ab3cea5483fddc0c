"""Kinds of sensors of elastic joints: what each sees of them, with its units, its noise and its plausible values.

`sensor` says what a kind is, `kinds` has those of flexhinf. A file here registers a kind; a program or package of yours
adds one in the same way.
"""

from flexhinf.plant.instruments.sensor import (
    SENSORS,
    JointRanges,
    JointSignals,
    SensorKind,
    quantity_of,
    register,
    sensor_of,
)

__all__ = ["SENSORS", "JointRanges", "JointSignals", "SensorKind", "quantity_of", "register", "sensor_of"]
