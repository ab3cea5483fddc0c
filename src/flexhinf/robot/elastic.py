"""Spong's model (Eq. 2) of n elastic joints: links, springs and motors as one ẋ.

What a real joint adds to Spong's model: one switch each, for the true plant.

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

Inverse dynamics gives the state and the input of a motion of the links [deluca2016]: the link positions are a flat
output of Spong's model, q and its first four derivatives give all else.

    τ_J = M(q) q̈ + C(q, q̇) q̇ + G(q)        θ = q + K⁻¹ τ_J
    J θ̈ + B θ̇ + F(θ̇) + τ_J = τ              τ = k_t (V − k_b θ̇) / R

The derivatives of τ_J are exact: the Newton–Euler recursion runs on power series in time.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant.parameters import ParameterTable
from flexhinf.plant.plant import pose_values
from flexhinf.robot.parameters import per_joint
from flexhinf.robot.units import TURNING, Stated
from flexhinf.scalars import clip, derivative, series, trace
from flexhinf.validation import real_array, unknown_name

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
    """The switches that are on, in a fixed order; an unknown one, or one without its number, is refused."""
    requested: Iterable[str] = (extras,) if isinstance(extras, str) else extras
    requested = {*requested, "inductance"} if inductance else set(requested)
    for name in sorted(requested):
        if name not in EXTRAS:
            what = f"Nothing that a real joint adds is called {name!r}."
            raise unknown_name(what, name, EXTRAS, "extras=('joint_damping', 'coulomb_friction')")
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
    """A state with every spring beyond its backlash: what `Model.engaged` wants of a robot."""

    layout: Any

    def __call__(self, x: Any, p: Any) -> Any:
        """The motors turned on by the whole width: out of the dead zone from anywhere inside."""
        moved = np.array(x, dtype=float)
        self.layout.split(moved)[2][:] += np.asarray(p.backlash, dtype=float)  # a view of the copy
        return moved


@dataclass(frozen=True)
class Sticking:
    """Coulomb's friction as it is, |τ_F| ≤ F at rest and F sgn q̇2 in motion: what `Model.arrest` wants of a robot.

    Moreau's time stepping: a step of h takes up to F h / J from each motor's velocity, and never turns it round. The
    velocity is taken as lost evenly within the step, so the motor is behind by half of that times h: what sticks does
    not creep. With "stribeck_friction" F is that of the velocity before.
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


#: What the input is: the motor's voltage (V), its current (A), or its torque on the link side (N·m).
DRIVES = {"voltage": "motor_voltage", "current": "motor_current", "torque": "drive_torque"}

#: The motor's constants, which say what drives it: all three, the torque constant alone, or none.
CONSTANTS = {
    "voltage": ("resistance", "torque_constant", "back_emf_constant"),
    "current": ("torque_constant",),
    "torque": (),
}

#: What belongs to the spring, of which a rigid joint has none.
SPRING = ("stiffness", "damping", "spring_hardening", "backlash")

#: What a joint may state beyond its model; a joint that does not has the value of `DEFAULTS`.
OPTIONAL = ("inductance", *DEFAULTS)


def required_of_drive(
    drive: str, names: Sequence[str], joints: Sequence[str], rigid: Sequence[str] = ()
) -> list[str]:
    """Names of the parameters that the joints must have; a motor's inertia comes in one of two ways."""
    if drive not in DRIVES:
        raise unknown_name("The motors are driven in an unknown way.", drive, DRIVES, "'voltage'")
    required, count = [], len(joints)
    for joint in joints:
        rotor = per_joint("rotor_inertia", joint, count) in names
        inertia = ("rotor_inertia", "gear_ratio") if rotor else ("motor_inertia",)
        spring = () if joint in rigid else ("stiffness",)
        quantities = (*spring, *inertia, "friction", *CONSTANTS[drive])
        required += [per_joint(quantity, joint, count) for quantity in quantities]
    return required


def reflected(
    values: Mapping[str, float], drive: str, joints: Sequence[str], rigid: Sequence[str] = ()
) -> dict[str, list[float]]:
    """What the plant's equations need, one number per joint (of springs: per elastic joint), all seen from the link.

    J = N² J_rotor + J_hub; with a gear τ = η_g η_m N k_t (V − N k_b q̇2) / R, so the constants of the reflected
    motor are η_g η_m N k_t and N k_b. Stiffness, friction and what the joint adds are stated on the link side.
    """

    def of(quantity: str, joint: str, default: Any = None) -> float:
        name = per_joint(quantity, joint, len(joints))
        return values[name] if default is None else values.get(name, default)

    dry = any(name.startswith(("coulomb_friction", "static_friction")) for name in values)
    packed: dict[str, list[float]] = {"stiffness": [], "motor_inertia": [], "friction": []}
    packed |= {quantity: [] for quantity in CONSTANTS[drive]}
    packed |= {
        quantity: []
        for quantity in OPTIONAL
        if any(per_joint(quantity, joint, len(joints)) in values for joint in joints)
        or (quantity in ("friction_smoothing", "stribeck_velocity", "coulomb_friction") and dry)
    }
    for joint in joints:
        ratio = of("gear_ratio", joint, 1.0)
        factor = {
            "torque_constant": ratio * of("gear_efficiency", joint, 1.0) * of("motor_efficiency", joint, 1.0),
            "back_emf_constant": ratio,
        }
        for quantity, column in packed.items():
            if quantity in SPRING and joint in rigid:
                continue
            if quantity == "motor_inertia" and per_joint("rotor_inertia", joint, len(joints)) in values:
                column.append(ratio * ratio * of("rotor_inertia", joint) + of("hub_inertia", joint, 0.0))
            elif quantity in OPTIONAL and quantity != "inductance":
                column.append(of(quantity, joint, DEFAULTS[quantity]))
            else:
                column.append(factor.get(quantity, 1.0) * of(quantity, joint))
    return packed


def torque_per_input(drive: str, p: Any) -> Any:
    """Torque of a motor at rest per unit of its input, on the link side: k_t / R for volts, k_t for amperes, or one."""
    if drive == "torque":
        return 1.0
    return p.torque_constant / p.resistance if drive == "voltage" else p.torque_constant


@dataclass(frozen=True)
class Layout:
    """Where the joints stand in x = (q1 (n), q̇1 (n), q2 (e), q̇2 (e) (, i (n))): e of the n joints are elastic.

    The rotor of a joint in `rigid` turns with the link: q2 = q1.
    """

    n: int
    rigid: tuple[int, ...] = ()

    @staticmethod
    def of(states: Sequence[str]) -> Layout:
        """From the names of the states: a joint without a motor's position is rigid."""
        joints = [name.removeprefix("link_position") for name in states if name.startswith("link_position")]
        joints = [joint for joint in joints if not joint.endswith("_integral")]
        rigid = tuple(i for i, joint in enumerate(joints) if f"motor_position{joint}" not in states)
        return Layout(len(joints), rigid)

    @property
    def elastic(self) -> list[int]:
        """The joints with a spring."""
        return [i for i in range(self.n) if i not in self.rigid]

    @property
    def mechanical(self) -> int:
        """Number of states without the coils' currents."""
        return 4 * self.n - 2 * len(self.rigid)

    def split(self, x: Any) -> tuple[Any, Any, Any, Any]:
        """q1 (n,), q̇1 (n,), q2 (e,), q̇2 (e,)."""
        n, e = self.n, self.n - len(self.rigid)
        return x[:n], x[n : 2 * n], x[2 * n : 2 * n + e], x[2 * n + e : 2 * n + 2 * e]

    def motors(self, links: Any, motors: Any) -> Any:
        """One entry per motor (n,): its own of an elastic joint, the link's of a rigid one."""
        if not self.rigid:
            return motors
        own = iter(motors)
        return np.array([links[i] if i in self.rigid else next(own) for i in range(self.n)])

    def whole(self, x: Any) -> np.ndarray:
        """q1, q̇1, q2, q̇2 (4 n,) with the motors of rigid joints where their links are; or (4 n, N) of columns."""
        q, dq, theta, dtheta = self.split(x)
        return np.concatenate([q, dq, self.motors(q, theta), self.motors(dq, dtheta)])


@dataclass(frozen=True)
class ElasticFlow:
    """ẋ (of any element) of M(q1) q̈1 + C q̇1 + G = K(q2 − q1) + d_link,   J q̈2 + B q̇2 + K(q2 − q1) = τ + d_motor.

    τ is the input itself, k_t i of a current i, or k_t (V − k_b q̇2) / R; with the coil k_t i, where L di/dt = V − R i
    − k_b q̇2. x = (q1, q̇1, q2, q̇2 (, i)), each with one entry per joint; d = (d_link, d_motor).

    A rigid joint has neither spring nor q2: its row is (M(q1) + J) q̈1 + C q̇1 + G + B q̇1 = τ + d_link + d_motor.
    """

    links: Any
    drive: str = "voltage"
    extras: tuple[str, ...] = ()
    rigid: tuple[int, ...] = ()

    def __call__(self, x: Any, u: Any, d: Any, p: Any) -> Any:
        """The rates of all states, of any element."""
        layout = Layout(len(self.links.joint_names), self.rigid)
        n, elastic = layout.n, layout.elastic
        q, dq, theta, dtheta = layout.split(x)
        current, speed = x[layout.mechanical :], layout.motors(dq, dtheta)
        torque, damping = u, p.friction  # the motor's torque, and what multiplies −q̇2
        if "inductance" in self.extras and self.drive != "torque":
            torque = p.torque_constant * current
        elif self.drive != "torque":
            gain = torque_per_input(self.drive, p)
            torque, damping = (
                gain * u,
                p.friction + (gain * p.back_emf_constant if self.drive == "voltage" else 0.0),
            )
        if not self.rigid:
            spring = spring_torque(theta - q, dtheta - dq, p, self.extras)
            left = torque - damping * dtheta - friction_torque(dtheta, p, self.extras) - spring + d[n:]
            link_acceleration = self.links.accelerations(q, dq, spring + d[:n], p)
            motor_acceleration = (1.0 / p.motor_inertia) * left  # a quotient of parameters: computed once
        else:
            spring = spring_torque(theta - q[elastic], dtheta - dq[elastic], p, self.extras)
            driven = torque - damping * speed - friction_torque(speed, p, self.extras) + d[n:]
            rotors = [p.motor_inertia[i] if i in self.rigid else 0.0 for i in range(n)]
            on_links = layout.motors(driven, spring) + d[:n]
            link_acceleration = self.links.accelerations(q, dq, on_links, p, rotors)
            motor_acceleration = (1.0 / p.motor_inertia[elastic]) * (driven[elastic] - spring)
        rates = [dq, link_acceleration, dtheta, motor_acceleration]
        if "inductance" in self.extras:
            rates.append((u - p.resistance * current - p.back_emf_constant * speed) / p.inductance)
        return np.concatenate(rates)


# Inverse dynamics ---------------------------------------------------------------------------------
#: A torque (force) of less than this times the robot's weight, at a metre, is rounding.
ROUNDING = 1e-12


def operating_point(
    links: Any, drive: str, q: np.ndarray, p: Any, extras: Collection[str], layout: Layout
) -> tuple[np.ndarray, np.ndarray]:
    """State x* = (q, 0, q + K⁻¹ G(q), 0 (, i*)) and input u*, in the order of `Robot.plant`.

    With a hardening spring or backlash among the `extras` the twist is that of the spring as it is.
    """
    held = links.gravity_torque(q, p)
    weight = np.asarray(held)[layout.elastic]
    twist = weight / np.atleast_1d(p.stiffness)
    if "spring_hardening" in extras:
        # K δ + K₃ δ³ = G, each joint by Newton's method from outside: it falls to the only root.
        stiffness, cubic = np.atleast_1d(p.stiffness), np.atleast_1d(p.spring_hardening)
        for _ in range(100):
            error = stiffness * twist + cubic * twist**3 - weight
            step = error / (stiffness + 3.0 * cubic * twist**2)
            twist = twist - step
            if np.all(np.abs(step) <= 1e-16 * np.abs(twist)):
                break
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


#: A pose beyond one turn was probably meant in degrees.
TURN = 2.0 * np.pi * (1.0 + 1e-9)


def checked_pose(pose: Any, default: np.ndarray, links: Any, robot: str) -> np.ndarray:
    """Link positions (n,) within the limits, from a sequence, a mapping by joint, a number for one joint, or None."""
    names = links.joint_names
    pose = default if pose is None else pose
    if isinstance(pose, Mapping):
        named = {name.removeprefix("link_position_"): value for name, value in pose.items()}
        if len(names) == 1 and "link_position" in named:
            named[names[0]] = named.pop("link_position")
        pose = dict(zip(names, default)) | named
    values = pose_values(pose, names, f"robot {robot!r}")
    given = list(
        pose.values() if isinstance(pose, Mapping) else np.atleast_1d(np.asarray(pose, dtype=object))
    )
    for k, (name, limits, slides) in enumerate(zip(names, links.limits, links.slides)):
        _check_position(name, values[k], given[k], limits, slides)
    return values


def _check_position(
    joint: str, value: float, given: Any, limits: tuple[float, float] | None, slides: bool
) -> None:
    """Refuse a position outside the joint's limits, or more than once around where the robot states none.

    Whether degrees were meant is asked for a number without a unit, where as many degrees would be allowed.
    """
    low, high = limits or ((-np.inf, np.inf) if slides else (-TURN, TURN))
    if low <= value <= high:
        return
    unit, size = "m" if slides else "rad", 1.0
    if isinstance(given, Stated) and given.unit.lower() in TURNING and not slides:
        unit, size = given.unit, TURNING[given.unit.lower()]
    got = f"{given.number}{given.unit}" if isinstance(given, Stated) and given.number else f"{value:g} {unit}"
    plain = not isinstance(given, Stated) and not slides and abs(value) > TURN
    asked = plain and low <= np.deg2rad(value) <= high
    advice = f"{value:g}deg on the command line and in a specification, np.deg2rad({value:g}) elsewhere; or "
    if limits is None:
        what = f"The pose turns joint {joint!r} by {got}, more than once around."
        advice += "limits in the robot's file, as a joint that turns further has them"
        other = "an angle within one turn, or limits in the robot's file"
    else:
        what = f"The pose is outside the limits of joint {joint!r}."
        advice += "a pose within the limits"
        other = "a pose within the limits, which the robot's file states"
    expected = f"{low / size:.6g} to {high / size:.6g} {unit}"
    raise InvalidInput(
        what,
        f"expected {expected}, got {got}{'; were degrees meant?' if asked else ''}",
        advice if asked else other,
    )


#: What a real joint adds that the inverse dynamics can follow: torques on the motor that its velocity gives.
MODELLED = ("coulomb_friction", "stribeck_friction")

WHY_NOT = {
    "inductance": "the coil needs a fifth derivative",
    "joint_damping": "a damped spring takes away the flat output: its twist obeys a differential equation",
    "spring_hardening": "the spring would have to be inverted at each time",
    "backlash": "a spring with a dead zone has no inverse",
}

ORDERS = ("q", "dq", "ddq", "dddq", "ddddq")


@dataclass(frozen=True)
class InverseFlow:
    """(q, q̇, q̈, q⃛, q⁗) → (x, u) with ẋ = flow(x, u, 0, p) of `ElasticFlow`, on any element.

    With q⁗ = v a law's wish, u is the input of exact feedback linearisation [spong1987]. Rigid joints have
    J q̈ + B q̇ + F(q̇) + τ_J = τ. Extras out of `MODELLED`; others are refused by name.
    """

    links: Any
    drive: str = "voltage"
    extras: tuple[str, ...] = ()
    rigid: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name in self.extras:
            if name not in MODELLED:
                raise InvalidInput(
                    f"The inverse dynamics do not model {name!r}: {WHY_NOT.get(name, 'it is unknown')}.",
                    f"expected extras out of {list(MODELLED)}, got {list(self.extras)}",
                    f"the feedforward without {name!r}; the law feeds back what it leaves",
                )

    def __call__(self, q: Any, dq: Any, ddq: Any, dddq: Any, ddddq: Any, p: Any) -> tuple[Any, Any]:
        """State (4n,) and input (n,) from link positions and four derivatives, (n,) each."""
        torque = self.links.torques(
            series(q, dq, ddq), series(dq, ddq, dddq), series(ddq, dddq, ddddq), p
        )  # fmt: skip
        load, rate, jerk = (derivative(torque, order) for order in range(3))
        layout = Layout(len(self.links.joint_names), self.rigid)
        softness, links, torques = 1.0 / p.stiffness, (q, dq, ddq), (load, rate, jerk)
        if self.rigid:
            links, torques = (tuple(v[layout.elastic] for v in part) for part in (links, torques))
        own = [at + softness * twisting for at, twisting in zip(links, torques)]
        _, speed, acceleration = (layout.motors(at, motor) for at, motor in zip((q, dq, ddq), own))
        drive = p.motor_inertia * acceleration + p.friction * speed + load
        if self.extras:
            drive = drive + friction_torque(speed, p, self.extras)
        if self.drive == "current":
            drive = (1.0 / p.torque_constant) * drive
        elif self.drive == "voltage":
            drive = (p.resistance / p.torque_constant) * drive + p.back_emf_constant * speed
        return np.concatenate([q, dq, own[0], own[1]]), drive


def flat_coordinates(links: Any, x: Any, p: Any, layout: Layout) -> tuple[Any, Any, Any, Any]:
    """(q, q̇, q̈, q⃛), (n,) each, of an undisturbed state x = (q1, q̇1, q2, q̇2), on any element.

    They are the coordinates in which `InverseFlow` makes the robot n chains of four integrators. The state of a robot
    with rigid joints, whose accelerations depend on the input, does not give them.
    """
    if layout.rigid:
        raise InvalidInput(
            "A robot with rigid joints has no flat coordinates: its state alone does not give q̈ and q⃛.",
            f"expected elastic joints only, got the rigid {[links.joint_names[i] for i in layout.rigid]}",
            "a law without exact linearisation",
        )
    q, dq, theta, dtheta = layout.split(x)
    spring, rate = p.stiffness * (theta - q), p.stiffness * (dtheta - dq)
    ddq = links.accelerations(q, dq, spring, p)
    moved = links.accelerations(series(q, dq), series(dq, ddq), series(spring, rate), p)
    return q, dq, ddq, derivative(moved, 1)


def state_and_input(
    flow: InverseFlow, values: Mapping[str, Any], motion: tuple[Any, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """x (4n,) or (N, 4n) and u (n,) or (N, n) of positions and four derivatives, of a plant with these parameters."""
    joints, arrays = flow.links.joint_names, []
    for name, value in zip(ORDERS, motion):
        array = np.zeros(len(joints)) if value is None else np.atleast_1d(real_array(value))
        if array.ndim not in (1, 2) or array.shape[-1] != len(joints) or not np.all(np.isfinite(array)):
            got = repr(value) if array.size <= 8 else f"shape {array.shape}, or numbers that are not finite"
            raise InvalidInput(
                f"The motion's {name} does not fit the robot.",
                f"expected finite numbers, ({len(joints)},) or (N, {len(joints)}) for {list(joints)}, got {got}",
                "one column per joint, one row per time",
            )
        arrays.append(array)
    counts = {len(array) for array in arrays if array.ndim == 2} or {1}
    if len(counts) > 1:
        raise InvalidInput(
            "The motion's derivatives have different numbers of times.",
            f"expected one, got {[array.shape for array in arrays]}",
            "a row per time",
        )
    count, table = counts.pop(), ParameterTable(values)
    if not count:
        return np.zeros((0, Layout(len(joints), flow.rigid).mechanical)), np.zeros((0, len(joints)))
    shapes = tuple((name, value.shape) for name, value in table.values.items())
    columns = [np.broadcast_to(array, (count, len(joints))).T for array in arrays]
    numbers = np.broadcast_to(table.vector()[:, None], (table.size, count))
    x, u = (np.array(rows, dtype=float).T for rows in _traced(flow, shapes)(*columns, numbers))
    return (x[0], u[0]) if all(array.ndim == 1 for array in arrays) else (x, u)


@lru_cache(maxsize=64)
def _traced(flow: InverseFlow, shapes: tuple[tuple[str, tuple[int, ...]], ...]) -> Any:
    """As a CasADi function of (q, q̇, q̈, q⃛, q⁗, parameter vector): other parameters trace nothing again."""
    table = ParameterTable({name: np.zeros(shape) for name, shape in shapes})
    n = len(flow.links.joint_names)

    def inverse(q: Any, dq: Any, ddq: Any, dddq: Any, ddddq: Any, vector: Any) -> tuple[Any, Any]:
        return flow(q, dq, ddq, dddq, ddddq, table.named(vector))

    return trace(inverse, *(n,) * 5, table.size, name="inverse", names=(*ORDERS, "p"))
