"""The mass of a payload, weighed by the motors at rest.

A robot that stands still is held by its motors, and with an integral of the position error it stands where it was
commanded to, whatever it carries. So what the motors give there is u = u0(q) + Σ m_i s_i(q), where u0 holds the robot
itself and s_i is what a kilogram of the payload i adds: the masses follow by least squares. What the links' own masses
are uncertain by falls on the payload; two weighings at one pose, before and after it is gripped, cancel that. Dry
friction holds a part of the weight that the motors do not show, and bounds what can be known.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.extras import DRIVES, torque_per_input
from flexhinf.robot.robot import Robot
from flexhinf.untrusted import real_array, value_text

#: A payload whose lever arm is shorter than this, m, loads no motor: its weight is lost in rounding.
SHORTEST_LEVER = 1e-6


@dataclass(frozen=True)
class Weighing:
    """What the motors say.

    Attributes
    ----------
    masses : dict of str to float
        kg, by the robot's parameters: ``robot.with_values(weighing.masses)`` is the robot that carries them.
    hidden : dict of str to float
        kg that dry friction may hide, at most: with every joint held by all of it, in the worst directions.
    unexplained : (n,)
        Torque of each motor that these masses do not explain, N·m (N).
    """

    masses: dict[str, float]
    hidden: dict[str, float]
    unexplained: np.ndarray


def weigh_payload(robot: Robot, pose: Any, effort: Any, unloaded: Any = None) -> Weighing:
    """The masses of the robot's payloads, from what its motors give at rest.

    Parameters
    ----------
    robot : Robot
        With one payload or several; where they are fixed is known, their masses are not.
    pose : (n,)
        Link positions at rest, rad or m.
    effort : (n,)
        What each motor gives there, V, A, or N·m (N): a mean over the noise.
    unloaded : (n,), optional
        The same at this pose with the masses that the robot states (its nominal ones); by default what the model says.

    Raises
    ------
    InvalidInput
        For a robot without a payload, numbers that do not fit the joints, or a pose at which the weight of a payload
        cannot be told from that of another, or does not load any motor.
    """
    names = [p.name for p in robot.parameters if p.name.startswith("payload_mass")]
    if not names:
        raise InvalidInput(
            f"The robot {robot.name!r} has no payload to weigh.",
            "expected [[payload]] in its file, got none",
            "load_robot(..., payload='0..3kg@LINK')",
        )
    _, model = robot.operating_point(pose)
    base = model if unloaded is None else _efforts(robot, unloaded, "unloaded")
    per_input = _per_input(robot)
    extra = per_input * (_efforts(robot, effort, "effort") - base)
    heavier = [robot.plant_parameters({**robot.nominal, name: robot[name].value + 1.0}) for name in names]
    per_kilogram = np.array([per_input * (robot.operating_point(pose, (), p)[1] - model) for p in heavier]).T
    least = SHORTEST_LEVER * abs(robot["gravity"].value)
    if np.linalg.matrix_rank(per_kilogram, tol=least) < len(names):
        raise InvalidInput(
            "The motors do not show the mass of every payload at this pose.",
            f"expected a pose at which each of {names} loads a motor in its own way, got {value_text(pose)}",
            "a pose with a lever arm across gravity",
        )
    inverse = np.linalg.pinv(per_kilogram)
    hidden = np.abs(inverse) @ _dry_friction(robot) * (1.0 if unloaded is None else 2.0)
    added = inverse @ extra
    return Weighing(
        {name: float(robot[name].value + more) for name, more in zip(names, added)},
        dict(zip(names, hidden.tolist())),
        extra - per_kilogram @ added,
    )


def _efforts(robot: Robot, values: Any, name: str) -> np.ndarray:
    """One finite number for each motor."""
    n, found = len(robot.joint_names), np.atleast_1d(real_array(values))
    if found.shape != (n,) or not np.isfinite(found).all():
        raise InvalidInput(
            f"The {name} does not fit the joints of the robot {robot.name!r}.",
            f"expected {n} finite numbers ({DRIVES[robot.drive]}), got {value_text(values)}",
            "one mean of each motor's input at rest",
        )
    return found


def _per_input(robot: Robot) -> np.ndarray:
    """Torque (n,) at rest per unit of input."""
    each = torque_per_input(robot.drive, SimpleNamespace(**robot.plant_parameters()))
    return np.broadcast_to(np.asarray(each, dtype=float), len(robot.joint_names))


def _dry_friction(robot: Robot) -> np.ndarray:
    """Largest torque (n,) that holds each joint at rest."""
    p, n = robot.plant_parameters(), len(robot.joint_names)
    found = [np.broadcast_to(p.get(name, 0.0), n) for name in ("coulomb_friction", "static_friction")]
    return np.max(found, axis=0)
