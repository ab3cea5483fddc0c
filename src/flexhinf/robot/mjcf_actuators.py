"""What the actuators of an MJCF file say of a joint's motor: its largest torque or force, inertia and constants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from flexhinf.robot.parts import ask
from flexhinf.validation import value_text

#: How an actuator says that it acts on a joint alone.
ON_JOINT = ("joint", "jointinparent")

_ON_JOINT = 1  # mjTRN_JOINT, mjTRN_JOINTINPARENT
_AFFINE, _NO_CLAMP = 1, 1 << 8  # mjBIAS_AFFINE; mjDSBL_CLAMPCTRL
_DIRECT = (0, 2, 3)  # mjDYN_NONE, mjDYN_FILTER, mjDYN_FILTEREXACT: the control is a force, if late
_DC, _VOLTAGE = 3, 8  # mjGAIN_DCMOTOR; the control of a <dcmotor> that is a voltage


@dataclass(frozen=True)
class DcMotor:
    """A <dcmotor> that drives a joint alone: SI units, before the gear, by their names in a robot file."""

    electrical: dict[
        str, float
    ]  # resistance, torque_constant, back_emf_constant; inductance where there is one
    gear_ratio: float
    rotor_inertia: float  # of the actuator alone; 0 where it states none
    hub_inertia: float  # of the joint, seen from it
    friction: dict[str, float]  # seen from the link
    takes_voltage: bool  # no controller of its own
    voltage: float  # largest, V; infinite where none is stated
    torque: float  # largest, N·m
    left_out: tuple[str, ...]  # what the robot has no number for


def _acting(model: Any, joint: int) -> list[int]:
    found = (model.actuator_trnid[:, 0] == joint) & (model.actuator_trntype <= _ON_JOINT)
    return [int(k) for k in np.flatnonzero(found)]


def _control(model: Any, actuator: int) -> int:
    """The place of an actuator's first control; before MuJoCo 4 each has one, and no list of them."""
    return int(getattr(model, "actuator_ctrladr", range(len(model.actuator_trnid)))[actuator])


def _behind_gears(model: Any, joint: int, name: str) -> float:
    """The armature, or the damping, of a joint's actuators, seen from the joint."""
    numbers = getattr(model, f"actuator_{name}", np.zeros(len(model.actuator_trnid)))  # none before MuJoCo 4
    return float(sum(model.actuator_gear[k, 0] ** 2 * np.ravel(numbers[k])[0] for k in _acting(model, joint)))


def motor_numbers(model: Any, joint: int) -> dict[str, float]:
    """Inertia and friction of a joint's motor by their names in a robot file, seen from the joint; those that are 0 are
    left out. MuJoCo multiplies those of actuators by the squares of their gears."""
    dof, motor = int(model.jnt_dofadr[joint]), dc_motor(model, joint)
    dry, sliding = float(model.dof_frictionloss[dof]), motor.friction if motor else {}
    numbers = {
        "motor_inertia": model.dof_armature[dof] + _behind_gears(model, joint, "armature"),
        "friction": np.ravel(model.dof_damping[dof])[0] + _behind_gears(model, joint, "damping"),
        "coulomb_friction": dry + sliding.get("coulomb_friction", 0.0),
        "static_friction": dry + sliding["static_friction"] if "static_friction" in sliding else 0.0,
        "stribeck_velocity": sliding.get("stribeck_velocity", 0.0),
    }
    return {name: float(value) for name, value in numbers.items() if value}


def dc_motor(model: Any, joint: int) -> DcMotor | None:
    """The <dcmotor> of a joint that no other actuator moves; None for any other joint.

    MuJoCo's compiled model has R and K, the geometric mean of torque and back-EMF constant, in gainprm, L/R in dynprm,
    cogging A sin(n θ + φ) and the friction of LuGre (τ_C, τ_S, v_S) in biasprm (https://mujoco.readthedocs.io,
    "MuJoCo DC Motor Model"). LuGre's bristles are left out: what is taken is the friction of a motor that slides.
    """
    acting = _acting(model, joint)
    if len(acting) != 1 or model.actuator_gaintype[acting[0]] != _DC:
        return None
    k = acting[0]
    ratio = abs(float(model.actuator_gear[k, 0]))
    resistance, constant = model.actuator_gainprm[k, :2].tolist()
    cogging, teeth, _, coulomb, static, slow = model.actuator_biasprm[k, :6].tolist()
    late, steepest = model.actuator_dynprm[k, :2].tolist()
    if not (ratio and constant and resistance):
        return None
    electrical = {
        "resistance": resistance,
        "torque_constant": constant,
        "back_emf_constant": constant,
        **({"inductance": late * resistance} if late else {}),
    }
    friction = {
        **({"coulomb_friction": ratio * coulomb} if coulomb else {}),
        **(
            {"static_friction": ratio * static, "stribeck_velocity": slow / ratio} if static > coulomb else {}
        ),
    }
    left = {
        f"cogging, {cogging:g} N·m {teeth:g} times in a radian of the motor": cogging,
        "the winding's temperature": np.any(model.actuator_dynprm[k, 2:5]),
        "its largest change of current": steepest,
        "its sign: a positive voltage turns the joint back": model.actuator_gear[k, 0] < 0.0,
    }
    takes_voltage = int(model.actuator_ctrlspec[k]) == _VOLTAGE
    place = _control(model, k)
    low, high = model.actuator_ctrlrange[place].tolist()
    limited = takes_voltage and model.actuator_ctrllimited[place]
    forces = model.actuator_forcerange[k].tolist() if model.actuator_forcelimited[k] else (-np.inf, np.inf)
    return DcMotor(
        electrical,
        ratio,
        rotor_inertia=_behind_gears(model, joint, "armature") / ratio**2,
        hub_inertia=float(model.dof_armature[model.jnt_dofadr[joint]]),
        friction=friction,
        takes_voltage=takes_voltage,
        voltage=min(-low, high) if limited else np.inf,
        torque=min(-forces[0], forces[1]),
        left_out=tuple(name for name, there in left.items() if there),
    )


def largest_effort(model: Any, joint: int) -> float:
    """Largest torque or force that the actuators of a joint give in both directions; infinite where one of them has no
    limit that is known, or there is none."""
    low = high = 0.0
    acting, motor = _acting(model, joint), dc_motor(model, joint)
    unclear = list[str]()
    for k in acting:
        gear, ends = float(model.actuator_gear[k, 0]), np.array([-np.inf, np.inf])
        understood = not model.actuator_gaintype[k] and model.actuator_dyntype[k] in _DIRECT
        kind, clamped = model.actuator_biastype[k], not model.opt.disableflags & _NO_CLAMP
        unbiased = not kind or (kind == _AFFINE and not np.any(model.actuator_biasprm[k, :3]))
        place = _control(model, k)
        if understood and unbiased and model.actuator_ctrllimited[place] and clamped:
            ends = np.sort(model.actuator_gainprm[k, 0] * model.actuator_ctrlrange[place])
        elif motor is not None and motor.voltage < np.inf and clamped:  # at rest, where nothing is induced
            stalled = motor.voltage * motor.electrical["torque_constant"] / motor.electrical["resistance"]
            understood, ends = True, np.array([-stalled, stalled])
        if model.actuator_forcelimited[k]:  # which cuts the force before the gear
            ends = np.clip(ends, *model.actuator_forcerange[k])
        elif not understood:
            unclear.append(model.actuator(k).name or f"number {k + 1}")
        if gear:
            least, most = sorted(gear * float(end) for end in ends)
            low, high = low + least, high + most
    if not acting:
        low, high = -np.inf, np.inf
    if model.jnt_actfrclimited[joint]:
        own = model.jnt_actfrcrange[joint].tolist()
        low, high = max(low, own[0]), min(high, own[1])
    name = model.joint(joint).name
    same_sign = bool(acting) and not low < 0.0 < high
    ask(
        same_sign or (unclear and np.isinf(min(-low, high))),
        f"The motor limit of the joint {name!r} is unknown: "
        + (
            "its actuators push one way."
            if same_sign
            else f"actuator {', '.join(unclear)} is not understood."
        ),
        f"expected actuators with forcerange, or <motor> with ctrlrange, got {low:g} to {high:g}",
        f"effort_limit = … for {name!r} in [[joint]] of the elastic file",
    )
    return np.inf if same_sign else min(-low, high)


def warn_of_actuators(root: Element, moving: Sequence[str]) -> None:
    """Say which actuators are not read, since the limits of the motors are then unknown."""
    others = [
        part
        for group in root.findall("actuator")
        for part in group
        if all(part.get(key) is None for key in ON_JOINT) and part.tag != "adhesion"
    ]
    joints = {name for part in others for name in acted_on(root, part)}
    ask(
        others and (joints & set(moving) or any(not acted_on(root, part) for part in others)),
        "Not every actuator is read: the motors' limits that it would state are unknown.",
        f"expected actuators of a joint each, got {len(others)} of other kinds, such as "
        f"{value_text(others[0].get('name') or others[0].tag, 60) if others else ''}",
        "effort_limit = … in [[joint]] of the elastic file",
    )


def acted_on(root: Element, actuator: Element) -> set[str]:
    """The joints of the tendon that an actuator pulls; none where it pulls something else."""
    tendon = actuator.get("tendon")
    parts = [part for group in root.findall("tendon") for part in group if part.get("name") == tendon]
    return {str(joint.get("joint")) for part in parts for joint in part if joint.get("joint")}
