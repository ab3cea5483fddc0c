"""Motors, gears and springs: the numbers of each joint, reflected to the link side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from flexhinf.errors import InvalidInput
from flexhinf.robot.extras import DEFAULTS
from flexhinf.robot.quantities import per_joint

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
    """Names of the parameters that the joints must have; a motor's inertia comes in one of two ways.

    Raises
    ------
    InvalidInput
        For an unknown drive.
    """
    if drive not in DRIVES:
        raise InvalidInput(
            "The motors are driven in an unknown way.",
            f"expected one of {list(DRIVES)}, got {drive!r}",
            "'voltage'",
        )
    required = []
    for joint in joints:

        def own(quantity: str, joint: str = joint) -> str:
            return per_joint(quantity, joint, len(joints))

        inertia = ("rotor_inertia", "gear_ratio") if own("rotor_inertia") in names else ("motor_inertia",)
        spring = () if joint in rigid else ("stiffness",)
        required += [own(quantity) for quantity in (*spring, *inertia, "friction", *CONSTANTS[drive])]
    return required


def reflected(
    values: Mapping[str, float], drive: str, joints: Sequence[str], rigid: Sequence[str] = ()
) -> dict[str, list[float]]:
    """What the plant's equations need, one number per joint, all seen from the link.

    J = N² J_rotor + J_hub; with a gear τ = η_g η_m N k_t (V − N k_b q̇2) / R, so the constants of the reflected
    motor are η_g η_m N k_t and N k_b. Stiffness, friction and what the joint adds are stated on the link side.

    Parameters
    ----------
    values : mapping of str to float
        The robot's parameters by name.
    drive : {"voltage", "current", "torque"}
    rigid : sequence of str
        Joints without a spring: the numbers of springs are those of the others.
    """

    def of(quantity: str, joint: str, default: Any = None) -> float:
        name = per_joint(quantity, joint, len(joints))
        return values[name] if default is None else values.get(name, default)

    dry = _dry(values)
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
    """Torque of a motor at rest per unit of its input, on the link side: k_t / R for volts, k_t for amperes, or one.

    Parameters
    ----------
    drive : {"voltage", "current", "torque"}
    p : object
        With the plant's parameters as attributes, see `reflected`.
    """
    if drive == "torque":
        return 1.0
    return p.torque_constant / p.resistance if drive == "voltage" else p.torque_constant


def _dry(values: Mapping[str, float]) -> bool:
    return any(name.startswith(("coulomb_friction", "static_friction")) for name in values)
