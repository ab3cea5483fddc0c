"""Spong's model (Eq. 2) of n elastic joints: links, springs and motors as one ẋ.

What a real joint adds to Spong's model: one switch each, for the true plant.

========================  ===============================================================================
switch                    adds
========================  ===============================================================================
``inductance``            the motor coil: L di/dt = V − R i − k_b q̇2; one more state per joint
``joint_damping``         the spring's own damping D (q̇2 − q̇1)
``spring_hardening``      a cubic part of the spring: K δ + K₃ δ³, δ = q2 − q1
``stiffness_curve``       the curve of a gear's catalogue in the place of K δ, see `flexhinf.robot.gears`
``kinematic_error``       the error of a gear's teeth, A sin(2 N q2 + φ), see there
``torque_ripple``         their ripple on the motor side, R sin(2 N q2 + φ_R)
``backlash``              a dead zone of the spring of this total width
``coulomb_friction``      dry friction on the motor side, F_c tanh(q̇2 / v₀)
``stribeck_friction``     the same, larger at low speed: F_c + (F_s − F_c) exp(−(q̇2 / v_s)²)
``load_friction``         dry friction that grows with the load of the gear: μ |τ_J| beside F_c
``drive_torque_limit``    the largest torque of a motor within its drive's own loop
========================  ===============================================================================

Dry friction is smoothed over the velocity v₀ (`friction_smoothing`), so a stuck joint creeps by less than v₀
as long as the torque is below F_c. `Sticking` is set-valued and holds a joint: it is no part of a flow, and acts at the
end of each step of a simulation. Backlash is not smooth: a synthesis refuses it by name.

Inverse dynamics gives the state and the input of a motion of the links [deluca2016]: the link positions are a flat
output of Spong's model, q and its first four derivatives give all else.

    τ_J = M(q) q̈ + C(q, q̇) q̇ + G(q)        θ = q + K⁻¹ τ_J
    J θ̈ + B θ̇ + F(θ̇) + τ_J = τ              τ = k_t (V − k_b θ̇) / R

A drive with an inner loop takes a velocity or a position, τ = k_v (c − θ̇) or τ = k_p (c − θ) − k_d θ̇, with the gains
k_p = J ω², k_d = 2ζωJ, k_v = J ω of a loop with the bandwidth ω and the damping ratio ζ. Of what loads the motor
(spring and friction) a share σ moves it: 1 if the loop has these gains alone, 0 if it also rejects its load. A limit
of the motor's torque holds for both together, |τ + (1 − σ) load| ≤ τ_max.

The derivatives of τ_J are exact: the Newton–Euler recursion runs on power series in time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from flexhinf.arrays import Elements, Number
from flexhinf.errors import refuse_if
from flexhinf.plant.model import ParameterTable
from flexhinf.robot.drive_limits import limited_torques
from flexhinf.robot.drives import DRIVES, DriveKind, MotorTorque
from flexhinf.robot.gears import (
    CURVE,
    curve_number,
    curve_softness,
    curve_torque,
    curve_twist,
    over_stiffness,
    tooth_error,
    tooth_ripple,
)
from flexhinf.robot.layout import Layout
from flexhinf.robot.parameters import QUANTITIES, per_joint
from flexhinf.scalars import absolute, clip, derivative, series, trace
from flexhinf.validation import one_of

#: The parameter that each switch needs.
EXTRAS = {
    "inductance": "inductance",
    "joint_damping": "damping",
    "spring_hardening": "spring_hardening",
    "stiffness_curve": "first_stiffness",
    "kinematic_error": "kinematic_error",
    "torque_ripple": "torque_ripple",
    "backlash": "backlash",
    "coulomb_friction": "coulomb_friction",
    "stribeck_friction": "static_friction",
    "load_friction": "load_friction",
    "drive_torque_limit": "drive_torque_limit",
}

#: Switches of what the teeth of gears add, each of which needs the gear's ratio.
TEETH = ("kinematic_error", "torque_ripple")

#: Switches of dry friction.
DRY = ("coulomb_friction", "stribeck_friction", "load_friction")

#: Values of what a joint does not state: nothing is added, and the velocities of the friction models (rad/s).
DEFAULTS = {name: known.default for name, known in QUANTITIES.items() if known.default is not None}


def checked_extras(extras: Any, inductance: bool, stated: Collection[str], robot: str) -> tuple[str, ...]:
    """The switches that are on, in a fixed order; an unknown one, or one without its number, is refused."""
    requested: Iterable[str] = (extras,) if isinstance(extras, str) else extras
    requested = {*requested, "inductance"} if inductance else set(requested)
    for name in sorted(requested):
        one_of(f"Nothing that a real joint adds is called {name!r}.", name, EXTRAS)
        refuse_if(
            EXTRAS[name] not in stated,
            f"The robot {robot!r} does not state {EXTRAS[name]!r}, which {name!r} needs.",
            f"expected it beside {sorted(stated)}",
            f"robot.with_parameters(Parameter({EXTRAS[name]!r}, ...)), or the key in the robot's file",
        )
    return tuple(name for name in EXTRAS if name in requested)


def left_out(values: Mapping[str, float], extras: Collection[str]) -> list[str]:
    """Switches that are off although the robot states numbers of them that are not zero, by its numbers by name."""
    stated = [name for name, value in values.items() if value]
    return [
        extra
        for extra, quantity in EXTRAS.items()
        if extra not in extras and any(n == quantity or n.startswith(f"{quantity}_") for n in stated)
    ]


def inactive_parameters(
    extras: Collection[str], joints: Sequence[str], stated: Collection[str] = ()
) -> set[str]:
    """A robot's parameters that do not act in a plant with these extras, by name; `stated` are all that it has.

    Where the curve of a gear acts, it has the place of the stiffness.
    """
    on = {*extras, *(("coulomb_friction",) if "stribeck_friction" in extras else ())}
    off = [quantity for name, quantity in EXTRAS.items() if name not in on]
    off += [] if "stiffness_curve" in on else CURVE
    curved = [
        joint
        for joint in joints
        if "stiffness_curve" in on and per_joint(CURVE[0], joint, len(joints)) in stated
    ]
    pairs = [(quantity, joint) for quantity in off for joint in joints] + [
        ("stiffness", joint) for joint in curved
    ]
    return {per_joint(quantity, joint, len(joints)) for quantity, joint in pairs}


def spring_torque(twist: Any, rate: Any, p: Any, extras: Collection[str]) -> Elements:
    """Torque of the spring on the link, from the twist δ = q2 − q1 and its rate."""
    if "backlash" in extras:
        half = 0.5 * p.backlash
        twist = twist - clip(twist, -half, half)
    torque = curve_torque(twist, p) if "stiffness_curve" in extras else p.stiffness * twist
    if "spring_hardening" in extras:
        torque = torque + p.spring_hardening * (twist * twist * twist)
    if "joint_damping" in extras:
        torque = torque + p.damping * rate
    return torque


def spring_torques(
    q: Any, dq: Any, theta: Any, dtheta: Any, p: Any, extras: Collection[str], ratio: Any = None
) -> tuple[Any, Any]:
    """Torques of the springs on the links, and against the motors; `ratio` N is that of these joints."""
    if "kinematic_error" not in extras:
        torque = spring_torque(theta - q, dtheta - dq, p, extras)
        return torque, torque
    error, slope = tooth_error(theta, ratio, p)
    torque = spring_torque(theta + error - q, (1.0 + slope) * dtheta - dq, p, extras)
    return torque, (1.0 + slope) * torque


@dataclass(frozen=True)
class Sticking:
    """Set-valued Coulomb friction, |τ_F| ≤ F at rest and F sgn q̇2 in motion: the `Model.arrest` of a robot.

    Moreau's time stepping: a step of h takes up to F h / J from each motor's velocity, and never turns it round. The
    velocity is taken as lost evenly within the step, so the motor is behind by half of that times h: what sticks does
    not creep. With "stribeck_friction" F is that of the velocity before, with "load_friction" that of the spring then.
    Of an inner loop σ F is left.
    """

    layout: Layout
    extras: tuple[str, ...]
    others: tuple[str, ...] = ()  # the plant's other extras, which the load is of
    drive: str = "torque"

    def __call__(self, x: Any, step: Any, p: Any) -> Elements:
        """The state after friction, on any element."""
        n = self.layout.n
        velocity, load = x[3 * n : 4 * n], 0.0
        if "load_friction" in self.extras:
            ratio = p.gear_ratio if "kinematic_error" in self.others else None
            at, moving = (self.layout.at_springs(x[k * n : (k + 1) * n]) for k in (0, 1))
            load = spring_torques(at, moving, x[2 * n : 3 * n], velocity, p, self.others, ratio)[1]
        level = dry_level(velocity, load, p, self.extras)
        kind = DRIVES[self.drive]
        level = kind.share(p) * level if kind.inner else level
        most = np.broadcast_to((step / p.motor_inertia) * level, velocity.shape)
        lost = np.array([clip(speed, -limit, limit) for speed, limit in zip(velocity, most)])
        return np.concatenate([x[: 2 * n], x[2 * n : 3 * n] - 0.5 * step * lost, velocity - lost, x[4 * n :]])


def stated_friction(parameters: Any) -> tuple[str, ...]:
    """Switches of the dry friction that a robot has, by its plant's parameters: those whose number is above zero."""
    return tuple(name for name in DRY if np.any(np.asarray(parameters.get(EXTRAS[name], 0.0)) > 0.0))


def stated_curve(parameters: Any) -> tuple[str, ...]:
    """The switch of the stiffness curve, of a robot with one, by its plant's parameters."""
    return ("stiffness_curve",) if CURVE[0] in parameters else ()


def stated_curves(parameters: Any, layout: Layout) -> list[list[float]] | None:
    """Curves of the springs of all joints (5, n), over the stiffness of straight ones, see `over_stiffness`, by a
    plant's parameters; None of a robot without one."""
    if not stated_curve(parameters):
        return None
    table = np.ones((len(CURVE), layout.n))
    table[:, layout.elastic] = over_stiffness(SimpleNamespace(**parameters))
    return table.tolist()


def stated_teeth(parameters: Any) -> tuple[str, ...]:
    """Switches of what the teeth of gears add, by a plant's parameters: those whose number is above zero."""
    return tuple(name for name in TEETH if np.any(np.asarray(parameters.get(name, 0.0)) > 0.0))


def with_dry_friction(extras: Sequence[str], parameters: Any) -> tuple[str, ...]:
    """Extras with the dry friction that a robot has, of which they may name one kind; that of loads is beside each."""
    dry = stated_friction(parameters)
    kinds = [name for name in dry if name != "load_friction"]
    named = [name for name in kinds if name in extras] or kinds
    return tuple(dict.fromkeys((*extras, *named, *(name for name in dry if name not in kinds))))


def dry_level(velocity: Any, load: Any, p: Any, extras: Collection[str]) -> Elements:
    """F: F_c, or with stribeck_friction F_c + (F_s − F_c) exp(−(q̇2 / v_s)²), and with load_friction μ |τ_J| more."""
    level = 0.0 * velocity if {*DRY} & {*extras} == {"load_friction"} else p.coulomb_friction
    if "load_friction" in extras:
        level = level + p.load_friction * absolute(load)
    if "stribeck_friction" in extras:
        ratio = velocity / p.stribeck_velocity
        level = level + (p.static_friction - p.coulomb_friction) * np.exp(-(ratio * ratio))
    return level


def friction_torque(velocity: Any, load: Any, p: Any, extras: Collection[str]) -> Elements | float:
    """Dry friction against the motor's velocity (viscous friction is not in it); 0.0 without a switch. The load is the
    torque of the spring."""
    dry = set(DRY) & set(extras)
    return dry_level(velocity, load, p, extras) * np.tanh(velocity / p.friction_smoothing) if dry else 0.0


#: What belongs to the spring, of which a rigid joint has none.
SPRING = tuple(name for name, known in QUANTITIES.items() if known.of_spring)

#: What a joint may state beyond its model; a joint that does not has the value of `DEFAULTS`.
OPTIONAL = ("inductance", *DEFAULTS, *CURVE)


def required_of_drive(
    drive: str, names: Sequence[str], joints: Sequence[str], rigid: Sequence[str] = ()
) -> list[str]:
    """Names of the parameters that the joints must have; a motor's inertia comes in one of two ways."""
    one_of("The motors are driven in an unknown way.", drive, DRIVES, "'voltage'")
    kind, required, count = DRIVES[drive], list[str](), len(joints)
    coils = any(per_joint("inductance", joint, count) in names for joint in joints)
    for joint in joints:
        geared = per_joint("rotor_inertia", joint, count) in names
        inertia = ("rotor_inertia", "gear_ratio") if geared else ("motor_inertia",)
        quantities = (*(() if joint in rigid else ("stiffness",)), *inertia, "friction", *kind.constants)
        if kind.inner:
            stated = any(per_joint(gain, joint, count) in names for gain in kind.gains[:1])
            quantities += kind.gains if stated else kind.loop
        quantities += ("inductance",) if coils and kind.coil else ()  # coils of some motors only are none
        required += [per_joint(quantity, joint, count) for quantity in quantities]
    return required


@lru_cache(maxsize=256)
def _stated(names: tuple[str, ...], joints: tuple[str, ...]) -> tuple[tuple[str, ...], bool]:
    """Of parameters with these names: the optional quantities that have columns, and whether gears have teeth."""

    def of_some(quantity: str) -> bool:
        return any(per_joint(quantity, joint, len(joints)) in names for joint in joints)

    dry = any(name.startswith(("coulomb_friction", "static_friction", "load_friction")) for name in names)
    toothed = [name for name in TEETH if of_some(name)]
    curved = of_some(CURVE[0])
    stated = [
        quantity
        for quantity in OPTIONAL
        if of_some(quantity)
        or (quantity in ("friction_smoothing", "stribeck_velocity", "coulomb_friction") and dry)
        or (quantity in CURVE and curved)
        or (quantity.removesuffix("_phase") in toothed)
    ]
    return tuple(stated), bool(toothed)


def reflected(
    values: Mapping[str, Number], drive: str, joints: Sequence[str], rigid: Sequence[str] = ()
) -> dict[str, list[Number]]:
    """Parameters of the plant's equations, one per joint (of springs: per elastic joint), reflected to the link side.

    J = N² J_rotor + J_hub; with a gear τ = η_g η_m N k_t (V − N k_b q̇2) / R, so the constants of the reflected
    motor are η_g η_m N k_t and N k_b. Stiffness, friction and what the joint adds are stated on the link side.
    """

    def of(quantity: str, joint: str, default: Number | None = None) -> Number:
        name = per_joint(quantity, joint, len(joints))
        return values[name] if default is None else values.get(name, default)

    def of_joint(joint: str) -> Callable[[str, Number], Number]:
        return lambda quantity, default: of(quantity, joint, default)

    stated, toothed = _stated(tuple(values), tuple(joints))
    packed: dict[str, list[Number]] = {
        quantity: []
        for quantity in ("stiffness", "motor_inertia", "friction", *DRIVES[drive].constants, *stated)
    }
    packed |= {"gear_ratio": []} if toothed else {}
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
            elif quantity == "static_friction":  # of a joint that states none, it does not fall with speed
                column.append(of(quantity, joint, of("coulomb_friction", joint, 0.0)))
            elif quantity == "gear_ratio":
                column.append(ratio)
            elif quantity in CURVE:
                own = {
                    name: of(name, joint) for name in CURVE if per_joint(name, joint, len(joints)) in values
                }
                column.append(curve_number(quantity, own, of("stiffness", joint)))
            elif quantity in OPTIONAL and quantity != "inductance":
                column.append(of(quantity, joint, DEFAULTS[quantity]))
            else:
                column.append(factor.get(quantity, 1.0) * of(quantity, joint))
    for joint, inertia in zip(joints, packed["motor_inertia"]):
        for quantity, number in DRIVES[drive].gains_of(of_joint(joint), inertia).items():
            packed.setdefault(quantity, []).append(number)
    return packed


@dataclass(frozen=True)
class ElasticFlow:
    """ẋ (of any element) of M(q1) q̈1 + C q̇1 + G = K(q2 − q1) + d_link,   J q̈2 + B q̇2 + K(q2 − q1) = τ + d_motor.

    Where joints are coupled, `Layout`, the springs are K(q2 − T q1), and push the links with Tᵀ of that.

    τ is that of the drive, see `flexhinf.robot.drives`; with the coil k_t i, where L di/dt = V − R i − k_b q̇2. Of an
    inner loop spring and friction count by σ. x = (q1, q̇1, q2, q̇2 (, i)), each with one entry per joint; d = (d_link,
    d_motor).

    A rigid joint has neither spring nor q2: its row is (M(q1) + J) q̈1 + C q̇1 + G + B q̇1 = τ + d_link + d_motor.
    """

    links: Any
    drive: str
    extras: tuple[str, ...]
    layout: Layout

    @property
    def kind(self) -> DriveKind:
        """How the motors are driven."""
        return DRIVES[self.drive]

    def __call__(self, x: Any, u: Any, d: Any, p: Any) -> Elements:
        """The rates of all states, of any element."""
        layout, n, elastic = self.layout, self.layout.n, self.layout.elastic
        q, dq, theta, dtheta = layout.split(x)
        current, speed = x[layout.mechanical :], layout.motors(dq, dtheta)
        kind, limited = self.kind, "drive_torque_limit" in self.extras
        if "inductance" in self.extras:
            torque, damping, share = MotorTorque(p.torque_constant * current, p.friction)
        else:
            torque, damping, share = kind.driven(u, layout.motors(q, theta), speed, p, limited)
        if not layout.rigid:
            ratio = p.gear_ratio if "kinematic_error" in self.extras else None
            at, moving = layout.at_springs(q), layout.at_springs(dq)
            spring, on_motors = spring_torques(at, moving, theta, dtheta, p, self.extras, ratio)
            load = self._resistance(theta, dtheta, on_motors, p), on_motors
            if limited:
                torque = limited_torques(torque, damping * dtheta + load[0] + load[1], p)
            elif kind.inner:
                load = share * load[0], share * load[1]
            left = torque - damping * dtheta - load[0] - load[1] + d[n:]
            link_acceleration = self.links.accelerations(q, dq, layout.on_links(spring) + d[:n], p)
            motor_acceleration = (1.0 / p.motor_inertia) * left  # a quotient of parameters: computed once
        else:
            ratio = p.gear_ratio[elastic] if "kinematic_error" in self.extras else None
            at, moving = layout.at_springs(q), layout.at_springs(dq)
            spring, on_motors = spring_torques(at, moving, theta, dtheta, p, self.extras, ratio)
            load = layout.motors(0.0 * q, on_motors)
            dry = self._resistance(layout.motors(q, theta), speed, load, p)
            if limited:
                torque = limited_torques(torque, damping * speed + dry + load, p)
            elif kind.inner:
                dry, on_motors = share * dry, share[elastic] * on_motors
            driven = torque - damping * speed - dry + d[n:]
            rotors = [p.motor_inertia[i] if i in layout.rigid else 0.0 for i in range(n)]
            on_links = layout.on_links(layout.motors(driven, spring)) + d[:n]
            link_acceleration = self.links.accelerations(q, dq, on_links, p, rotors)
            motor_acceleration = (1.0 / p.motor_inertia[elastic]) * (driven[elastic] - on_motors)
        rates = [dq, link_acceleration, dtheta, motor_acceleration]
        if "inductance" in self.extras:
            rates.append((u - p.resistance * current - p.back_emf_constant * speed) / p.inductance)
        return np.concatenate(rates)

    def _resistance(self, angle: Any, speed: Any, load: Any, p: Any) -> Elements | float:
        """Dry friction and ripple against the motors, at their angles, speeds and loads."""
        dry = friction_torque(speed, load, p, self.extras)
        return dry + tooth_ripple(angle, p) if "torque_ripple" in self.extras else dry


# Inverse dynamics ---------------------------------------------------------------------------------
#: What a real joint adds that the inverse dynamics cannot follow; they can follow a torque of the motor's velocity.
WHY_NOT = {
    "inductance": "the coil needs a fifth derivative",
    "joint_damping": "a damped spring takes away the flat output: its twist obeys a differential equation",
    "spring_hardening": "the spring would have to be inverted at each time",
    "backlash": "a spring with a dead zone has no inverse",
    "kinematic_error": "its phase is known at no start",
    "torque_ripple": "its phase is known at no start",
    "drive_torque_limit": "beyond it no command follows the motion",
}

#: What they can follow.
FOLLOWED = (*DRY, "stiffness_curve")

ORDERS = ("q", "dq", "ddq", "dddq", "ddddq")


@dataclass(frozen=True)
class InverseFlow:
    """(q, q̇, q̈, q⃛, q⁗) → (x, u) with ẋ = flow(x, u, 0, p) of `ElasticFlow`, on any element.

    With q⁗ = v a law's wish, u is the input of exact feedback linearisation [spong1987]. Rigid joints have
    J q̈ + B q̇ + F(q̇) + τ_J = τ. Extras out of `FOLLOWED`; others are refused by name.

    With the curve of a gear θ = q + δ(τ_J), θ̇ = q̇ + δ′ τ̇_J and θ̈ = q̈ + δ′ τ̈_J. The impulse J τ̇_J Δ(1/K), with which
    the motor would have to pass a corner of the curve, is left out.
    """

    links: Any
    drive: str = "voltage"
    extras: tuple[str, ...] = ()
    layout: Layout | None = None  # without one all joints are elastic, each with its own motor

    def __post_init__(self) -> None:
        for name in self.extras:
            refuse_if(
                name not in FOLLOWED,
                f"The inverse dynamics do not model {name!r}: {WHY_NOT.get(name, 'it is unknown')}.",
                f"expected extras out of {list(FOLLOWED)}, got {list(self.extras)}",
                f"the feedforward without {name!r}; the law feeds back what it leaves",
            )

    def __call__(self, q: Any, dq: Any, ddq: Any, dddq: Any, ddddq: Any, p: Any) -> tuple[Any, Any]:
        """State (4n,) and input (n,) from link positions and four derivatives, (n,) each."""
        torque = self.links.torques(series(q, dq, ddq), series(dq, ddq, dddq), series(ddq, dddq, ddddq), p)
        layout = self.layout or Layout(len(self.links.tree))
        load, rate, jerk = (layout.on_motors(derivative(torque, order)) for order in range(3))
        twisting = [layout.of_springs(torques) for torques in (load, rate, jerk)]
        if "stiffness_curve" in self.extras:
            softness = curve_softness(twisting[0], p)
            twists = [curve_twist(twisting[0], p), softness * twisting[1], softness * twisting[2]]
        else:
            twists = [(1.0 / p.stiffness) * torques for torques in twisting]
        own = [layout.at_springs(at) + twist for at, twist in zip((q, dq, ddq), twists)]
        angle, speed, acceleration = (layout.motors(at, motor) for at, motor in zip((q, dq, ddq), own))
        kind = DRIVES[self.drive]
        torque = self._torque(speed, acceleration, load, p, kind)
        return np.concatenate([q, dq, own[0], own[1]]), kind.input_for(torque, angle, speed, p)

    def _torque(self, speed: Any, acceleration: Any, load: Any, p: Any, kind: DriveKind) -> Elements:
        """Torque (n,) that moves motors so under a load, of which a loop of their own leaves its share."""
        friction, moved = p.friction * speed, p.motor_inertia * acceleration
        dry = set(DRY) & set(self.extras)
        if kind.inner:
            friction = friction + friction_torque(speed, load, p, self.extras) if dry else friction
            return moved + kind.share(p) * (friction + load)
        torque = moved + friction + load
        return torque + friction_torque(speed, load, p, self.extras) if dry else torque


@lru_cache(maxsize=64)
def traced_inverse(flow: InverseFlow, shapes: tuple[tuple[str, tuple[int, ...]], ...]) -> Any:
    """`flow` as a CasADi function of (q, q̇, q̈, q⃛, q⁗, parameter vector), for any values of the parameters."""
    table = ParameterTable({name: np.zeros(shape) for name, shape in shapes})

    def inverse(q: Any, dq: Any, ddq: Any, dddq: Any, ddddq: Any, vector: Any) -> tuple[Any, Any]:
        return flow(q, dq, ddq, dddq, ddddq, table.named(vector))

    return trace(inverse, *[len(flow.links.tree)] * 5, table.size, name="inverse", names=(*ORDERS, "p"))
