"""How large commands may be and how fast they may change, by the drives that take them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.plant import Parameters
from flexhinf.robot.drive_limits import largest_drive_torques, per_second
from flexhinf.robot.drives import TORQUE

if TYPE_CHECKING:
    from flexhinf.robot.robot import Robot

#: What is done to a command whose derivative of an order is beyond its limit.
_CHANGED: Final = {1: "changes faster", 2: "is accelerated more"}

#: What is beyond a limit by rounding alone.
ROUNDING: Final = 1e-9

#: A slower path is advised with this much room.
ROOM: Final = 1.05


def command_changes(commands: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Rates and accelerations (N, n) of commands (N, n), one per period, that rested at the first: the differences of
    samples that a drive sees, per s and per s²."""
    with np.errstate(invalid="ignore", over="ignore"):
        rates = np.diff(commands, axis=0, prepend=commands[:1]) / period
        return rates, np.diff(rates, axis=0, prepend=np.zeros_like(rates[:1])) / period


def command_limits(robot: Robot) -> np.ndarray:
    """Largest rates and accelerations (2, n) of a robot's commands, per s and per s²; infinite without a limit."""
    return np.array([robot.command_rates, robot.command_accelerations], dtype=float)


def motion_limits(robot: Robot) -> np.ndarray:
    """Largest velocities and accelerations (2, n) of joints that commands of positions or velocities may have as they
    are; infinite where none is limited, and of drives that take something else."""
    rates, accelerations = command_limits(robot)
    none = np.full_like(rates, np.inf)
    if robot.drive_kind.takes_positions:
        return np.array((rates, accelerations))
    return np.array((none, rates if robot.drive_kind.takes_velocities else none))


def size_limits(robot: Robot) -> np.ndarray:
    """Largest commands and torques of motors within their drives' loops (2, n); infinite without a limit."""
    n = len(robot.joint_names)
    commands = [np.inf if limit is None else limit for limit in robot.effort_limits or [None] * n]
    return np.array([commands, largest_drive_torques(Parameters(robot.plant_parameters()), n)], dtype=float)


def check_sizes(robot: Robot, commands: np.ndarray, torques: np.ndarray, period: float) -> None:
    """Refuse commands (N, n), one per period, or torques of the motors (N, n), N·m or N, beyond a robot's limits."""
    kinds = (robot.drive_kind, "effort_limit"), (TORQUE, "drive_torque_limit")
    for rows, limit, (kind, key) in zip((commands, torques), size_limits(robot), kinds):
        share = np.abs(rows) / limit
        row, joint = divmod(int(np.argmax(share)), share.shape[1])
        name, unit = robot.joint_names[joint], kind.units[robot.links.slides[joint]]
        refuse_if(
            float(share[row, joint]) > 1.0 + ROUNDING,
            f"The path asks for a larger {kind.quantity.replace('_', ' ')} of joint {name!r} than it has.",
            f"expected at most {limit[joint]:g} {unit}, got {abs(rows[row, joint]):.4g} {unit} "
            f"at t = {row * period:g} s",
            f"a path that is slower, or stays nearer to zero; or a larger {key} of this joint in the robot file",
        )


def command_shares(robot: Robot, commands: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Shares (N, n) of the largest rates and accelerations, of commands as of `command_changes`."""
    rates, accelerations = map(np.abs, command_changes(commands, period))
    most = command_limits(robot)
    return rates / most[0], accelerations / most[1]


def check_commands(robot: Robot, commands: np.ndarray, period: float, advice: str = "") -> None:
    """Refuse commands (N, n), one per period, that change faster or are accelerated more than the robot's drives take.

    `advice`: what else than a slower path helps.
    """
    limits = command_limits(robot)
    if not np.isfinite(limits).any():
        return
    for order, (rows, limit) in enumerate(zip(command_changes(commands, period), limits), 1):
        share = np.abs(rows) / limit
        row, joint = divmod(int(np.argmax(share)), share.shape[1])
        worst, name = float(share[row, joint]), robot.joint_names[joint]
        unit = per_second(robot.drive_kind.units[robot.links.slides[joint]], order)
        refuse_if(
            worst > 1.0,
            f"The command of joint {name!r} {_CHANGED[order]} than its drive takes.",
            f"expected at most {limit[joint]:g} {unit}, got {abs(rows[row, joint]):.4g} {unit} "
            f"at t = {row * period:g} s",
            f"the same path in {ROOM * worst ** (1.0 / order):.3g} times its time{advice}",
        )
