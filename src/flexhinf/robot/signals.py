"""Names, units and sensors of the signals of n elastic joints.

With one joint a signal has its plain name, ``link_position``. With several each has the joint's name behind
it, ``link_position_elbow``, and the plain name stands for all of them, wherever names are expected.

Penalties on more than states: the torque of the springs and its rate, which sees the vibrations alone.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.errors import refuse_if
from flexhinf.plant.instruments import SENSORS, sensor_of
from flexhinf.plant.penalty import Penalty, check_weighted
from flexhinf.robot.drives import input_units
from flexhinf.robot.elastic import spring_torques
from flexhinf.robot.layout import Layout
from flexhinf.robot.parameters import parameter_units, per_joint
from flexhinf.validation import checked_names, nearest

#: Penalties on springs, which see the vibrations alone: their torque, and its rate.
TORQUE, TORQUE_RATE = "joint_torque", "joint_torque_rate"

#: The state of a joint, in the order of x: all link positions, all link velocities, and so on.
MECHANICAL = ("link_position", "link_velocity", "motor_position", "motor_velocity")


class _Units(Mapping[str, tuple[str, str]]):
    """Units of states, inputs, disturbances and sensors, by quantity, of the drives that are registered when it is
    read."""

    @property
    def _all(self) -> dict[str, tuple[str, str]]:
        sensors = {kind.name: kind.units for kind in SENSORS.values()}
        return {
            **{quantity: sensors.pop(quantity) for quantity in MECHANICAL},
            "coil_current": ("A", "A"),
            **input_units(),
            "link_torque": ("N·m", "N"),
            "motor_torque": ("N·m", "N"),
            **sensors,
            TORQUE_RATE: ("N·m/s", "N/s"),
        }

    def __getitem__(self, quantity: str) -> tuple[str, str]:
        return self._all[quantity]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)


#: Units for joints that turn and joints that slide.
UNITS: Mapping[str, tuple[str, str]] = _Units()


def _is_of_springs(quantity: str) -> bool:
    """Whether a rigid joint has no such signal: its motor is where its link is, and nothing between them twists."""
    return quantity == TORQUE_RATE or (quantity in SENSORS and SENSORS[quantity].side != "link")


def signal_names(quantity: str, joints: Sequence[str], rigid: Sequence[str] = ()) -> tuple[str, ...]:
    """One name per joint, but for those of `rigid` that have no such state or torque of their own."""
    return tuple(
        per_joint(quantity, joint, len(joints))
        for joint in joints
        if joint not in rigid or not _is_of_springs(quantity)
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
    quantities: Collection[str],
    joints: Sequence[str],
    rigid: Sequence[str] = (),
) -> tuple[str, ...]:
    """Names of single joints' signals from single and plain names, each once; a rigid joint has none of springs."""
    requested = checked_names("The sensors", names)
    every = {
        quantity: signal_names(quantity, joints, rigid if SENSORS[quantity].of_springs else ())
        for quantity in quantities
    }
    known = {**{name: (name,) for group in every.values() for name in group}, **every}
    unknown = [name for name in requested if name not in known]
    one = per_joint(next(iter(quantities)), joints[-1], len(joints))
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
    names: Sequence[str], quantities: Collection[str], joints: Sequence[str], known: Collection[str]
) -> str:
    """As an advice, the same sensors with the joints that are meant; "" where none is like a joint that is named."""
    meant = list[str]()
    for name in names:
        quantity = next((one for one in quantities if name.startswith(f"{one}_")), "")
        joint = nearest(name.removeprefix(f"{quantity}_"), joints, "").strip("'") if quantity else ""
        meant.append(name if name in known else f"{quantity}_{joint}" if joint else "")
    return f"measured={tuple(dict.fromkeys(meant))}" if all(meant) and len(joints) > 1 else ""


def _why(names: Sequence[str], quantities: Collection[str], joints: Sequence[str]) -> str:
    """What makes the advice plausible: the only joint, or what a load cell measures."""
    if len(joints) == 1 and any(name.startswith(f"{quantity}_") for name in names for quantity in quantities):
        return f"; the only joint is {joints[0]!r}, and needs no name"
    for kind in SENSORS.values():
        parts = [part for part in kind.instruments if part not in kind.name]
        if kind.instrument and any(part in name.lower() for name in names for part in parts):
            return f"; {kind.instrument} measures {kind.name}"
    return ""


def _of_all_joints(names: Sequence[str], quantities: Collection[str]) -> str:
    """As an advice, what wrong names are likely to mean, of all joints; with a position, which an estimator needs."""
    instruments = {part: kind.name for kind in reversed([*SENSORS.values()]) for part in kind.instruments}
    meant = [
        next((quantity for quantity in quantities if word.startswith(quantity)), None)
        or next((quantity for part, quantity in instruments.items() if part in word), None)
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
        signals, state = dict[str, Any](), _JointState(self.layout, self.extras, x, p)
        for kind in dict.fromkeys(filter(None, map(sensor_of, self.names))):
            names = [per_joint(kind.name, joint, len(self.joints)) for joint in self.joints]
            seen = [names[i] for i in self.layout.elastic] if kind.of_springs else names
            signals |= zip(seen, kind.measure(state))
        return np.array([signals[name] for name in self.names])


@dataclass
class _JointState:
    """What sensors may see at a state, on any element; each is computed when a sensor sees it."""

    layout: Layout
    extras: tuple[str, ...]
    x: Any
    p: Any

    @cached_property
    def _parts(self) -> Any:
        return self.layout.split(self.x)

    @cached_property
    def link_positions(self) -> Any:
        return self._parts[0]

    @cached_property
    def link_velocities(self) -> Any:
        return self._parts[1]

    @cached_property
    def motor_positions(self) -> Any:
        return self.layout.motors(self._parts[0], self._parts[2])

    @cached_property
    def motor_velocities(self) -> Any:
        return self.layout.motors(self._parts[1], self._parts[3])

    @cached_property
    def twists(self) -> Any:
        return self._parts[2] - self.layout.at_springs(self._parts[0])

    @cached_property
    def twist_rates(self) -> Any:
        return self._parts[3] - self.layout.at_springs(self._parts[1])

    @cached_property
    def spring_torques(self) -> Any:
        q, dq = (self.layout.at_springs(links) for links in self._parts[:2])
        ratio = self.layout.of_springs(self.p.gear_ratio) if "kinematic_error" in self.extras else None
        theta, dtheta = self._parts[2:]
        return spring_torques(q, dq, theta, dtheta, self.p, self.extras, ratio)[0]


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
    named = [signal_names(quantity, joints, rigid) for quantity in (TORQUE, TORQUE_RATE)]
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
