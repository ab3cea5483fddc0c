"""Limits that drives state."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np

from flexhinf.arrays import Elements, Number
from flexhinf.robot.parameters import UNLIMITED
from flexhinf.scalars import clip


def largest_drive_torques(p: Any, count: int) -> np.ndarray:
    """Largest torques (n,) of motors within their drives' own loops, by a plant's parameters; infinite without one."""
    numbers = cast("dict[str, Number]", vars(p))
    stated = np.broadcast_to(np.asarray(numbers.get("drive_torque_limit", UNLIMITED), dtype=float), count)
    return np.where(stated < UNLIMITED, stated, np.inf)


def limited_torques(torque: Any, load: Any, p: Any) -> Elements:
    """Torques (n,) of motors within their drives' limits, of any element: those of the loops, and the rejected share of
    the load."""
    wanted = torque + (1.0 - p.load_share) * load
    most = np.broadcast_to(p.drive_torque_limit, wanted.shape)
    return np.array([clip(one, -limit, limit) for one, limit in zip(wanted, most)])


#: Limits of a command and of its two derivatives in a robot file, in this order.
OF_COMMANDS: Final = ("effort_limit", "drive_rate_limit", "drive_acceleration_limit")


def per_second(unit: str, order: int) -> str:
    """Unit of the derivative of an order of what has a unit.

    >>> per_second("rad", 2), per_second("rad/s", 1), per_second("N·m", 1), per_second("A", 0)
    ('rad/s²', 'rad/s²', 'N·m/s', 'A')
    """
    head, divided, _ = unit.partition("/s")
    order += bool(divided)
    return f"{head}/s{('', '²', '³')[order - 1]}" if order else head
