"""Inverse dynamics of elastic joints: the state and the input of a motion of the links, [deluca2016].

The link positions are a flat output of Spong's model: q and its first four derivatives give all else.

    τ_J = M(q) q̈ + C(q, q̇) q̇ + G(q)        θ = q + K⁻¹ τ_J
    J θ̈ + B θ̇ + F(θ̇) + τ_J = τ              τ = k_t (V − k_b θ̇) / R

The derivatives of τ_J are exact: the Newton–Euler recursion runs on power series in time.

The equilibrium of a robot: the springs hold the weight, the motors hold the springs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant.parameters import ParameterTable
from flexhinf.robot.arm import Links
from flexhinf.robot.elastic import Layout, friction_torque
from flexhinf.robot.units import TURNING, Stated
from flexhinf.scalars import derivative, series, trace
from flexhinf.validation import checked_array, real_array, unknown_name

#: A torque (force) of less than this times the robot's weight, at a metre, is rounding.
ROUNDING = 1e-12


def operating_point(
    links: Links, drive: str, q: np.ndarray, p: Any, extras: Collection[str], layout: Layout
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


def checked_pose(pose: Any, default: np.ndarray, links: Links, robot: str) -> np.ndarray:
    """Link positions (n,) within the limits, from a sequence, a mapping by joint, a number for one joint, or None."""
    names = links.joint_names
    if pose is None:
        pose = default
    if isinstance(pose, Mapping):
        named = {name.removeprefix("link_position_"): value for name, value in pose.items()}
        if len(names) == 1 and "link_position" in named:
            named[names[0]] = named.pop("link_position")
        unknown = [name for name in named if name not in names]
        if unknown:
            what = f"The pose names a joint that the robot {robot!r} does not have: {unknown[0]!r}."
            raise unknown_name(what, unknown[0], names)
        pose = [named.get(name, value) for name, value in zip(names, default)]
    given = list(pose) if isinstance(pose, (tuple, list)) else [pose]
    values = checked_array(
        f"The pose does not fit the robot {robot!r}.",
        pose,
        (len(names),),
        f"{len(names)} finite positions for {list(names)}",
        "one link position per joint, rad (m for a prismatic joint)",
    )
    for k, (name, limits, slides) in enumerate(zip(names, links.limits, links.slides)):
        _check_position(name, values[k], given[k] if len(given) == len(names) else None, limits, slides)
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

    links: Links
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


def flat_coordinates(links: Links, x: Any, p: Any, layout: Layout) -> tuple[Any, Any, Any, Any]:
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
    flow: InverseFlow, values: Mapping[str, Any], motion: tuple[np.ndarray, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """x (N, 4n) and u (N, n) of rows (N, n) of positions and four derivatives, and of the plant's parameters."""
    table = ParameterTable(values)
    shapes = tuple((name, value.shape) for name, value in table.values.items())
    count = len(motion[0])
    if not count:
        n = motion[0].shape[1]
        return np.zeros((0, Layout(n, flow.rigid).mechanical)), np.zeros((0, n))
    numbers = np.broadcast_to(table.vector()[:, None], (table.size, count))
    x, u = _traced(flow, shapes)(*(rows.T for rows in motion), numbers)
    return np.array(x, dtype=float).T, np.array(u, dtype=float).T


@lru_cache(maxsize=64)
def _traced(flow: InverseFlow, shapes: tuple[tuple[str, tuple[int, ...]], ...]) -> Any:
    """As a CasADi function of (q, q̇, q̈, q⃛, q⁗, parameter vector): other parameters trace nothing again."""
    table = ParameterTable({name: np.zeros(shape) for name, shape in shapes})
    n = len(flow.links.joint_names)

    def inverse(q: Any, dq: Any, ddq: Any, dddq: Any, ddddq: Any, vector: Any) -> tuple[Any, Any]:
        return flow(q, dq, ddq, dddq, ddddq, table.named(vector))

    return trace(inverse, *(n,) * 5, table.size, name="inverse", names=(*ORDERS, "p"))


def motion_rows(motion: tuple[Any, ...], joints: tuple[str, ...]) -> tuple[tuple[np.ndarray, ...], bool]:
    """Positions and derivatives as five (N, n) arrays, and whether they were one point; None is zero."""
    arrays = []
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
    counts = {len(array) for array in arrays if array.ndim == 2}
    if len(counts) > 1:
        found = f"expected one, got {[array.shape for array in arrays]}"
        raise InvalidInput(
            "The motion's derivatives have different numbers of times.", found, "one row per time"
        )
    count = counts.pop() if counts else 1
    rows = tuple(np.broadcast_to(array, (count, len(joints))) for array in arrays)
    return rows, all(array.ndim == 1 for array in arrays)
