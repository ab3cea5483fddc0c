"""The equilibrium of a robot: the springs hold the weight, the motors hold the springs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.elastic import Layout, Links
from flexhinf.untrusted import real_array, value_text

#: A torque (force) of less than this times the robot's weight, at a metre, is rounding.
ROUNDING = 1e-12


def operating_point(
    links: Links, drive: str, q: np.ndarray, p: Any, extras: Collection[str], layout: Layout
) -> tuple[np.ndarray, np.ndarray]:
    """State x* = (q, 0, q + K⁻¹ G(q), 0 (, i*)) and input u*, in the order of `Robot.plant`.

    Parameters
    ----------
    drive : {"voltage", "current", "torque"}
    q : (n,)
        Link positions.
    p : Parameters
        Of the plant.
    extras : collection of str
        With a hardening spring or backlash the twist is that of the spring as it is.
    layout : Layout
        Which joints have a spring.
    """
    held = links.gravity_torque(q, p)
    weight = np.asarray(held)[layout.elastic]
    twist = weight / np.atleast_1d(p.stiffness)
    if "spring_hardening" in extras:
        twist = _hardened_twist(weight, np.atleast_1d(p.stiffness), np.atleast_1d(p.spring_hardening))
    if "backlash" in extras:
        # A joint that carries nothing may stand anywhere in its gap: in the middle, not where rounding pushes it.
        carries = np.abs(weight) > ROUNDING * np.sum(p.mass) * abs(p.gravity)
        twist = twist + 0.5 * np.sign(weight) * carries * p.backlash
    still = np.zeros(len(q))
    states = [q, still, q[layout.elastic] + twist, still[layout.elastic]]
    if drive == "torque":
        return np.concatenate(states), np.array(held, dtype=float)
    current = np.asarray(held / p.torque_constant, dtype=float)
    if drive == "current":
        return np.concatenate(states), current
    if "inductance" in extras:
        states.append(current)
    return np.concatenate(states), np.asarray(p.resistance * current, dtype=float)


def _hardened_twist(weight: np.ndarray, stiffness: np.ndarray, cubic: np.ndarray) -> np.ndarray:
    """Solution of K δ + K₃ δ³ = G, each joint by Newton's method from outside: it falls to the only root."""
    twist = weight / stiffness
    for _ in range(100):
        error = stiffness * twist + cubic * twist**3 - weight
        step = error / (stiffness + 3.0 * cubic * twist**2)
        twist = twist - step
        if np.all(np.abs(step) <= 1e-16 * np.abs(twist)):
            break
    return twist


#: A pose beyond one turn was probably meant in degrees.
TURN = 2.0 * np.pi * (1.0 + 1e-9)


def checked_pose(pose: Any, default: np.ndarray, links: Links, robot: str) -> np.ndarray:
    """Link positions (n,) from a sequence, a mapping by joint name, a number for one joint, or None.

    Raises
    ------
    InvalidInput
        For an unknown joint, another number of values, or a position outside the joint's limits.
    """
    names = links.joint_names
    if pose is None:
        pose = default
    if isinstance(pose, Mapping):
        named = {name.removeprefix("link_position_"): value for name, value in pose.items()}
        if len(names) == 1 and "link_position" in named:
            named[names[0]] = named.pop("link_position")
        unknown = [name for name in named if name not in names]
        if unknown:
            raise InvalidInput(
                f"The pose names a joint that the robot {robot!r} does not have: {unknown[0]!r}.",
                f"expected names out of {list(names)}",
                "one of these",
            )
        pose = [named.get(name, value) for name, value in zip(names, default)]
    values = np.atleast_1d(real_array(pose))
    if values.shape != (len(names),) or not np.all(np.isfinite(values)):
        raise InvalidInput(
            f"The pose does not fit the robot {robot!r}.",
            f"expected {len(names)} finite positions for {list(names)}, got {value_text(pose)}",
            "one link position per joint, rad (m for a prismatic joint)",
        )
    for name, value, limits, slides in zip(names, values, links.limits, links.slides):
        if not slides and abs(value) > TURN and (limits is None or not limits[0] <= value <= limits[1]):
            raise InvalidInput(
                f"The pose turns joint {name!r} by {value:g} rad, more than once around.",
                f"expected an angle in rad within ±2π, got {value:g}; were degrees meant?",
                f"{value:g}deg on the command line and in a specification, np.deg2rad({value:g}) elsewhere; a joint "
                "that turns more than once around states its limits in the robot's file",
            )
        if limits is not None and not limits[0] <= value <= limits[1]:
            raise InvalidInput(
                f"The pose is outside the limits of joint {name!r}.",
                f"expected {limits[0]:g} to {limits[1]:g} {'m' if slides else 'rad'}, got {value:g}",
                "a pose within the limits; angles are in rad",
            )
    return values
