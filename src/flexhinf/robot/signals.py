"""Names, units and sensors of the signals of n elastic joints.

With one joint a signal has its plain name, ``link_position``. With several each has the joint's name behind
it, ``link_position_elbow``, and the plain name stands for all of them, wherever names are expected.

Penalties on more than states: the torque of the springs and its rate, which sees the vibrations alone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.errors import refuse_if
from flexhinf.plant.penalty import Penalty, check_weighted
from flexhinf.robot.elastic import spring_torques
from flexhinf.robot.layout import Layout
from flexhinf.robot.parameters import parameter_units, per_joint
from flexhinf.validation import checked_names, nearest

#: The state of a joint, in the order of x: all link positions, all link velocities, and so on.
MECHANICAL = ("link_position", "link_velocity", "motor_position", "motor_velocity")

#: What a sensor can measure. Motor signals are seen from the link: the motor's angle over the gear ratio.
SENSORS = (*MECHANICAL, "joint_torque", "deflection")

#: Sensors of what twists, which a rigid joint has not: the torque of its spring, and motor minus link.
TWISTS = ("joint_torque", "deflection")

#: Parts of the names of instruments, and the signal that each measures: a load cell in the drive sees its torque.
INSTRUMENTS = {
    "load": "joint_torque",
    "cell": "joint_torque",
    "strain": "joint_torque",
    "force": "joint_torque",
    "torque": "joint_torque",
    "tacho": "motor_velocity",
    "gyro": "link_velocity",
    "resolver": "motor_position",
    "encoder": "motor_position",
}

#: Units for joints that turn and joints that slide.
UNITS = {
    "link_position": ("rad", "m"),
    "link_velocity": ("rad/s", "m/s"),
    "motor_position": ("rad", "m"),
    "motor_velocity": ("rad/s", "m/s"),
    "coil_current": ("A", "A"),
    "motor_voltage": ("V", "V"),
    "motor_current": ("A", "A"),
    "drive_torque": ("N·m", "N"),
    "velocity_command": ("rad/s", "m/s"),
    "position_command": ("rad", "m"),
    "link_torque": ("N·m", "N"),
    "motor_torque": ("N·m", "N"),
    "joint_torque": ("N·m", "N"),
    "deflection": ("rad", "m"),
    "joint_torque_rate": ("N·m/s", "N/s"),
}


#: Signals that a rigid joint has not: its motor is where its link is, and between them is nothing that twists.
OF_SPRINGS = ("motor_position", "motor_velocity", *TWISTS, "joint_torque_rate")


def signal_names(quantity: str, joints: Sequence[str], rigid: Sequence[str] = ()) -> tuple[str, ...]:
    """One name per joint, but for those of `rigid` that have no such state or torque of their own."""
    return tuple(
        per_joint(quantity, joint, len(joints))
        for joint in joints
        if joint not in rigid or quantity not in OF_SPRINGS
    )


def units_of(
    joints: Sequence[str], slides: Sequence[bool], parameters: Mapping[str, Any] | None = None
) -> dict[str, str]:
    """Unit of each signal and of each of a plant's parameters, by name; see `parameter_units`."""
    units = {
        name: pair[sliding]
        for quantity, pair in UNITS.items()
        for name, sliding in zip(signal_names(quantity, joints), slides)
    }
    units |= {f"{name}_integral": f"{unit}·s" for name, unit in units.items() if "position" in name}
    return parameter_units(parameters or {}, slides) | units


def expanded(
    names: str | Sequence[str],
    quantities: Sequence[str],
    joints: Sequence[str],
    rigid: Sequence[str] = (),
) -> tuple[str, ...]:
    """Names of single joints' signals from single and plain names, each once; a rigid joint has none of `TWISTS`."""
    requested = checked_names("The sensors", names)
    every = {
        quantity: signal_names(quantity, joints, rigid if quantity in TWISTS else ())
        for quantity in quantities
    }
    known = {**{name: (name,) for group in every.values() for name in group}, **every}
    unknown = [name for name in requested if name not in known]
    one = per_joint(quantities[0], joints[-1], len(joints))
    single = f", or one joint's, as {one!r}; the joints are {list(joints)}"
    refuse_if(
        unknown or not requested,
        f"Nothing measures {unknown[0]!r}." if unknown else "Nothing is measured.",
        f"expected names among {list(quantities)}{single if len(joints) > 1 else ''}, got {list(requested)}",
        _of_joints(requested, quantities, joints, known)
        or _of_all_joints(requested, quantities) + _why(unknown, quantities, joints),
    )
    singles = tuple(name for part in requested for name in known[part])
    twice = [name for name in known if singles.count(name) > 1]
    refuse_if(
        twice,
        f"{''.join(twice[:1])!r} is measured twice.",
        f"expected each signal once, got {list(requested)}",
        _of_all_joints(requested, quantities),
    )
    return singles


def _of_joints(
    names: Sequence[str], quantities: Sequence[str], joints: Sequence[str], known: Collection[str]
) -> str:
    """As an advice, the same sensors with the joints that are meant; "" where none is like a joint that is named."""
    meant = list[str]()
    for name in names:
        quantity = next((one for one in quantities if name.startswith(f"{one}_")), "")
        joint = nearest(name.removeprefix(f"{quantity}_"), joints, "").strip("'") if quantity else ""
        meant.append(name if name in known else f"{quantity}_{joint}" if joint else "")
    return f"measured={tuple(dict.fromkeys(meant))}" if all(meant) and len(joints) > 1 else ""


def _why(names: Sequence[str], quantities: Sequence[str], joints: Sequence[str]) -> str:
    """What makes the advice plausible: the only joint, or what a load cell measures."""
    if len(joints) == 1 and any(name.startswith(f"{quantity}_") for name in names for quantity in quantities):
        return f"; the only joint is {joints[0]!r}, and needs no name"
    if any(part in name.lower() for name in names for part in ("load", "cell", "strain", "force")):
        return "; a load cell or strain gauge in the drive measures joint_torque"
    return ""


def _of_all_joints(names: Sequence[str], quantities: Sequence[str]) -> str:
    """As an advice, what wrong names are likely to mean, of all joints; with a position, which an estimator needs."""
    meant = [
        next((quantity for quantity in quantities if word.startswith(quantity)), None)
        or next((quantity for part, quantity in INSTRUMENTS.items() if part in word), None)
        or nearest(word, quantities, "").strip("'")
        for word in " ".join(names).lower().split()
    ]
    meant = [name for name in meant if name in quantities]
    position = () if any("position" in name for name in meant) else ("link_position",)
    return f"measured={tuple(dict.fromkeys([*position, *filter(None, meant)]))}"


@dataclass(frozen=True)
class Sensors:
    """y: the measured signals by their single names; with `extras` a torque sensor sees the real spring."""

    names: tuple[str, ...]
    joints: tuple[str, ...]
    extras: tuple[str, ...]
    layout: Layout

    def __call__(self, x: Any, u: Any, p: Any) -> Elements:
        """The measured signals (p,) of any element; the motor of a rigid joint is where its link is."""
        q, dq, theta, dtheta = self.layout.split(x)
        columns = q, dq, self.layout.motors(q, theta), self.layout.motors(dq, dtheta)
        signals = {
            name: part[i]
            for quantity, part in zip(MECHANICAL, columns)
            for i, name in enumerate(signal_names(quantity, self.joints))
        }
        torques, twists = (
            [signal_names(kind, self.joints)[i] for i in self.layout.elastic] for kind in TWISTS
        )
        if {*torques, *twists} & set(self.names):
            q, dq = (self.layout.at_springs(links) for links in (q, dq))
            ratio = self.layout.of_springs(p.gear_ratio) if "kinematic_error" in self.extras else None
            signals |= dict(zip(torques, spring_torques(q, dq, theta, dtheta, p, self.extras, ratio)[0]))
            signals |= dict(zip(twists, theta - q))
        return np.array([signals[name] for name in self.names])


@dataclass(frozen=True)
class WeightedStatesAndTorques:
    """h(x): weighted states, then weighted torques K (q2 − q1) of the springs and their rates, as deviations.

    One weight per state, integrals included, and per elastic joint: of torques 1/(N·m) or 1/N, of rates s/(N·m) or s/N.
    """

    states: tuple[float, ...]
    torques: tuple[float, ...]
    rates: tuple[float, ...]
    layout: Layout

    def __call__(self, x: Any, p: Any) -> Elements:
        """h (s,) of any element."""
        q, dq, theta, dtheta = self.layout.split(x)
        torque, rate = (p.stiffness * (b - self.layout.at_springs(a)) for a, b in ((q, theta), (dq, dtheta)))
        weighted = [weight * x[i] for i, weight in enumerate(self.states) if weight]
        for weights, values in ((self.torques, torque), (self.rates, rate)):
            weighted += [weight * values[i] for i, weight in enumerate(weights) if weight]
        return np.array(weighted)


def robot_penalty(
    penalty: Penalty,
    joints: Sequence[str],
    states: Sequence[str],
    groups: Mapping[str, Sequence[str]],
    layout: Layout,
) -> Penalty:
    """The penalty (single names only) with torques and their rates as functions of the state; others are unchanged.

    `states` include the integrals; the names of `groups`, which stand for all joints, an error lists first.
    """
    rigid = [joints[i] for i in layout.rigid]
    named = [signal_names(quantity, joints, rigid) for quantity in ("joint_torque", "joint_torque_rate")]
    weighted = penalty.states
    if not isinstance(weighted, Mapping):
        return penalty
    stated = cast("Mapping[str, float]", weighted)
    singles = (*states, *named[0], *named[1])
    plain = [group for group, members in groups.items() if set(members) <= set(singles)]
    check_weighted(stated, list(dict.fromkeys((*plain, *singles))))
    if not {*named[0], *named[1]} & set(stated):
        return penalty
    weights = dict(stated)
    torques, rates = (tuple(float(weights.pop(name, 0.0)) for name in names) for names in named)
    kept = replace(penalty, states=weights).weights(states)
    return replace(penalty, states=WeightedStatesAndTorques(tuple(kept.tolist()), torques, rates, layout))
