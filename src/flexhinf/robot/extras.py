"""What a real joint adds to Spong's model: one switch each, for the true plant.

========================  ===============================================================================
switch                    adds
========================  ===============================================================================
``inductance``            the motor coil: L di/dt = V − R i − k_b q̇2; one more state per joint
``joint_damping``         the spring's own damping D (q̇2 − q̇1)
``spring_hardening``      a cubic part of the spring: K δ + K₃ δ³, δ = q2 − q1
``backlash``              a dead zone of the spring of this total width
``coulomb_friction``      dry friction on the motor side, F_c tanh(q̇2 / v₀)
``stribeck_friction``     the same, larger at low speed: F_c + (F_s − F_c) exp(−(q̇2 / v_s)²)
========================  ===============================================================================

Dry friction is smoothed over the velocity v₀ (`friction_smoothing`), so a stuck joint creeps by less than v₀
as long as the torque is below F_c. `Sticking` is the sharp one, which holds: it is no part of a flow, and acts at the
end of each step of a simulation. Backlash is not smooth: a synthesis refuses it by name.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.quantities import per_joint
from flexhinf.scalars import clip

#: The parameter that each switch needs.
EXTRAS = {
    "inductance": "inductance",
    "joint_damping": "damping",
    "spring_hardening": "spring_hardening",
    "backlash": "backlash",
    "coulomb_friction": "coulomb_friction",
    "stribeck_friction": "static_friction",
}

#: Switches of dry friction.
DRY = ("coulomb_friction", "stribeck_friction")

#: Values of what a joint does not state: nothing is added, and the velocities of the friction models (rad/s).
DEFAULTS = {
    "damping": 0.0, "spring_hardening": 0.0, "backlash": 0.0, "coulomb_friction": 0.0, "static_friction": 0.0,
    "stribeck_velocity": 0.1, "friction_smoothing": 0.01,
}  # fmt: skip


def checked_extras(extras: Any, inductance: bool, given: Collection[str], robot: str) -> tuple[str, ...]:
    """The switches that are on, in a fixed order.

    Raises
    ------
    InvalidInput
        For an unknown switch, or one whose number the robot does not state.
    """
    requested: Iterable[str] = (extras,) if isinstance(extras, str) else extras
    requested = {*requested, "inductance"} if inductance else set(requested)
    for name in sorted(requested):
        if name not in EXTRAS:
            raise InvalidInput(
                f"Nothing that a real joint adds is called {name!r}.",
                f"expected names out of {list(EXTRAS)}",
                "extras=('joint_damping', 'coulomb_friction')",
            )
        if EXTRAS[name] not in given:
            raise InvalidInput(
                f"The robot {robot!r} does not state {EXTRAS[name]!r}, which {name!r} needs.",
                f"expected it beside {sorted(given)}",
                f"robot.with_parameters(Parameter({EXTRAS[name]!r}, ...)), or the key in the robot's file",
            )
    return tuple(name for name in EXTRAS if name in requested)


def inactive_parameters(extras: Collection[str], joints: Sequence[str]) -> set[str]:
    """A robot's parameters that do not act in a plant with these extras, by name."""
    on = {EXTRAS[name] for name in extras}
    if "stribeck_friction" in extras:
        on.add(EXTRAS["coulomb_friction"])
    off = set(EXTRAS.values()) - on
    return {per_joint(name, joint, len(joints)) for name in off for joint in joints}


def spring_torque(twist: Any, rate: Any, p: Any, extras: Collection[str]) -> Any:
    """Torque of the spring on the link, of the twist δ = q2 − q1 and its rate."""
    if "backlash" in extras:
        half = 0.5 * p.backlash
        twist = twist - clip(twist, -half, half)
    torque = p.stiffness * twist
    if "spring_hardening" in extras:
        torque = torque + p.spring_hardening * (twist * twist * twist)
    if "joint_damping" in extras:
        torque = torque + p.damping * rate
    return torque


@dataclass(frozen=True)
class Engaged:
    """A state with every spring beyond its backlash: what `Model.engaged` wants of a robot.

    Parameters
    ----------
    layout : Layout
        Of the state.
    """

    layout: Any

    def __call__(self, x: Any, p: Any) -> Any:
        """The motors turned on by the whole width: out of the dead zone from anywhere inside."""
        moved = np.array(x, dtype=float)
        motors = self.layout.split(moved)[2]
        motors += np.asarray(p.backlash, dtype=float)  # a view of the copy
        return moved


@dataclass(frozen=True)
class Sticking:
    """Coulomb's friction as it is, |τ_F| ≤ F at rest and F sgn q̇2 in motion: what `Model.arrest` wants of a robot.

    Moreau's time stepping: a step of h takes up to F h / J from each motor's velocity, and never turns it round. The
    velocity is taken as lost evenly within the step, so the motor is behind by half of that times h: what sticks does
    not creep.

    Parameters
    ----------
    extras : sequence of str
        With "stribeck_friction" F is that of the velocity before.
    """

    joints: int
    extras: tuple[str, ...]

    def __call__(self, x: Any, step: Any, p: Any) -> Any:
        """The state after friction, on any element."""
        n = self.joints
        velocity = x[3 * n : 4 * n]
        most = (step / p.motor_inertia) * dry_level(velocity, p, self.extras)
        most = np.broadcast_to(most, velocity.shape)
        lost = np.array([clip(one, -limit, limit) for one, limit in zip(velocity, most)])
        return np.concatenate(
            [x[: 2 * n], x[2 * n : 3 * n] - (0.5 * step) * lost, velocity - lost, x[4 * n :]]
        )


def stated_friction(parameters: Any) -> tuple[str, ...]:
    """The switches of dry friction whose number a robot states above zero, of its plant's parameters by name."""
    return tuple(name for name in DRY if np.any(np.asarray(parameters.get(EXTRAS[name], 0.0)) > 0.0))


def dry_level(velocity: Any, p: Any, extras: Collection[str]) -> Any:
    """F: F_c, or with stribeck_friction F_c + (F_s − F_c) exp(−(q̇2 / v_s)²)."""
    level = p.coulomb_friction
    if "stribeck_friction" in extras:
        ratio = velocity / p.stribeck_velocity
        level = level + (p.static_friction - level) * np.exp(-(ratio * ratio))
    return level


def friction_torque(velocity: Any, p: Any, extras: Collection[str]) -> Any:
    """Dry friction against the motor's velocity (viscous friction is not in it); 0.0 without a switch."""
    if not set(DRY) & set(extras):
        return 0.0
    return dry_level(velocity, p, extras) * np.tanh(velocity / p.friction_smoothing)
