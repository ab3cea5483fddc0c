"""Kinds of drives: what the motors of a robot take, with the torque that follows of it.

`drive` says what a kind is, `kinds` has those of flexhinf. A file here registers a kind; a program or package of yours
adds one in the same way.
"""

from flexhinf.robot.drives.drive import DRIVES, DriveKind, Gain, InnerLoop, MotorTorque, input_units, register
from flexhinf.robot.drives.kinds import CURRENT, POSITION, TORQUE, VELOCITY, VOLTAGE

__all__ = [
    "CURRENT",
    "DRIVES",
    "POSITION",
    "TORQUE",
    "VELOCITY",
    "VOLTAGE",
    "DriveKind",
    "Gain",
    "InnerLoop",
    "MotorTorque",
    "input_units",
    "register",
]
