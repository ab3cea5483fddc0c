"""Limits of drives: of a motor's torque within its own loop, of how fast a command may change."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.scalars import clip

if TYPE_CHECKING:
    from flexhinf.robot.robot import Robot

#: Stands for the torque of a motor that has no limit within its drive, N·m: parameters are finite.
UNLIMITED: Final = 1e9


def largest_drive_torques(p: Any, count: int) -> np.ndarray:
    """Largest torques (n,) of motors within their drives' own loops, by a plant's parameters; infinite without one."""
    stated = np.broadcast_to(np.asarray(vars(p).get("drive_torque_limit", UNLIMITED), dtype=float), count)
    return np.where(stated < UNLIMITED, stated, np.inf)


def limited_torques(torque: Any, load: Any, p: Any) -> Any:
    """Torques (n,) of motors within their drives' limits, of any element: those of the loops, and the rejected share of
    the load."""
    wanted = torque + (1.0 - p.load_share) * load
    most = np.broadcast_to(p.drive_torque_limit, wanted.shape)
    return np.array([clip(one, -limit, limit) for one, limit in zip(wanted, most)])


#: Limits of a command and of its two derivatives in a robot file, in this order.
OF_COMMANDS: Final = ("effort_limit", "drive_rate_limit", "drive_acceleration_limit")

#: What is done to a command whose derivative of an order is beyond its limit.
_CHANGED: Final = {1: "changes faster", 2: "is accelerated more"}

#: A slower path is advised with this much room.
ROOM: Final = 1.05


def per_second(unit: str, order: int) -> str:
    """Unit of the derivative of an order of what has a unit.

    >>> per_second("rad", 2), per_second("rad/s", 1), per_second("N·m", 1), per_second("A", 0)
    ('rad/s²', 'rad/s²', 'N·m/s', 'A')
    """
    head, divided, _ = unit.partition("/s")
    order += bool(divided)
    return f"{head}/s{('', '²', '³')[order - 1]}" if order else head


def command_changes(commands: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Rates and accelerations (N, n) of commands (N, n), one per period, that rested at the first: the differences of
    samples that a drive sees, per s and per s²."""
    with np.errstate(invalid="ignore", over="ignore"):
        rates = np.diff(commands, axis=0, prepend=commands[:1]) / period
        return rates, np.diff(rates, axis=0, prepend=np.zeros_like(rates[:1])) / period


def command_limits(robot: Robot) -> np.ndarray:
    """Largest rates and accelerations (2, n) of a robot's commands, per s and per s²; infinite without a limit."""
    return np.array([robot.command_rates, robot.command_accelerations], dtype=float)


def command_shares(robot: Robot, commands: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Shares (N, n) of the largest rates and accelerations, of commands as of `command_changes`."""
    rates, accelerations = map(np.abs, command_changes(commands, period))
    most = command_limits(robot)
    return rates / most[0], accelerations / most[1]


def check_commands(robot: Robot, commands: np.ndarray, period: float, advice: str = "") -> None:
    """Refuse commands (N, n), one per period, that change faster or are accelerated more than the robot's drives take.

    `advice`: what else than a slower path helps.
    """
    from flexhinf.robot.elastic import DRIVES
    from flexhinf.robot.signals import UNITS

    limits = command_limits(robot)
    if not np.isfinite(limits).any():
        return
    for order, (rows, limit) in enumerate(zip(command_changes(commands, period), limits), 1):
        share = np.abs(rows) / limit
        row, joint = divmod(int(np.argmax(share)), share.shape[1])
        worst, name = float(share[row, joint]), robot.joint_names[joint]
        unit = per_second(UNITS[DRIVES[robot.drive]][robot.links.slides[joint]], order)
        refuse_if(
            worst > 1.0,
            f"The command of joint {name!r} {_CHANGED[order]} than its drive takes.",
            f"expected at most {limit[joint]:g} {unit}, got {abs(rows[row, joint]):.4g} {unit} "
            f"at t = {row * period:g} s",
            f"the same path in {ROOM * worst ** (1.0 / order):.3g} times its time{advice}",
        )
