"""PD and feedback of the joint torque, with and without the integral of the link's error.

Over a workspace they are linear about the moving reference, which has the feedforward of the inverse dynamics: with e
the deviation from it, Ω = diag(ω_j), M̄ = M(q_d) + J_θ and integral I = ∫ e_q,

    u' = −(1 + 2ζσ) Ω M̄ Ω e_θ − ((2ζ + σ) √Ω M̄ √Ω − (J_θ/J) B) ė_θ − σ Ω^1.5 M̄ Ω^1.5 I + ∂ḡ/∂θ e_θ,
    τ = (J/J_θ) u' + (1 − J/J_θ) K (e_θ − e_q) − 2ζ_v ω_v J (ė_θ − ė_q),

for one joint with a rigid spring the poles of (s² + 2ζ ω s + ω²)(s + σ ω). PD has J_θ = J and ζ_v = 0, and of M̄ the
diagonal at home, as it is set by hand; the others have all of it at the commanded pose. ḡ(θ) is the weight that a motor
at θ carries at rest. Joints that vibrate fast, ω_v, have no feedback of the torque, which the latency would turn round.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from flexhinf.designs.laws.kinds import BOTH, MOTOR, TORQUE, TORQUE_BOTH, LawKind, LawOver, register
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Matrix, Vector
    from flexhinf.designs.laws.pose_model import PoseModel
else:
    np = late_package("numpy")

#: Damping ratio ζ of a PD, and rate σ of an integral in parts of ω, where the user states none.
DAMPING, INTEGRAL_RATE = 0.8, 0.4

#: Vibrations with a free motor, rad/s, from which on a joint has no feedback of the torque, and none of its rate.
TORQUE_FAST, RATE_FAST = 180.0, 400.0


def _at_pose(
    model: PoseModel, numbers: Mapping[str, Vector], fixed: bool, weight: bool, integral: bool
) -> Matrix:
    j, n = model.joints, len(model.pose)
    turns, w = model.turns, model.bandwidths(numbers, fixed)
    ratio = np.where(model.elastic & (turns < TORQUE_FAST), numbers.get("rotor_inertia", 1.0), 1.0)
    rotor = ratio * j.motor_inertia
    inertia = np.diag(np.diag(model.home.link_inertia)) if fixed else j.link_inertia
    inertia = inertia + np.diag(rotor)
    zeta = numbers.get("damping", DAMPING)
    rate = numbers.get("integral_rate", INTEGRAL_RATE) if integral else np.zeros(1)

    def scaled(power: float) -> Matrix:
        return inertia * np.outer(w, w) ** power

    friction = ratio * j.motor_damping
    p, d, i = scaled(1.0), scaled(0.5), scaled(1.5)
    p = _both(p, 1.0 + 2.0 * zeta * rate)
    d = _both(d, 2.0 * zeta + rate) - np.diag(friction)
    i = _both(i, np.broadcast_to(rate, n))
    if fixed:  # a motor that damps itself by more keeps its damping
        d = np.maximum(d, 0.0)
    p, d, i = (
        np.diag(np.broadcast_to(numbers[name], n).astype(float)) if name in numbers else found
        for name, found in (("kp", p), ("kd", d), ("ki", i))
    )
    if weight:
        slope = j.gravity_slope
        p = p - slope @ np.linalg.inv(np.eye(n) + slope / j.stiffness[:, None])
    scale = 1.0 / ratio
    soft = np.diag((1.0 - scale) * j.stiffness)
    rates = np.where(model.elastic & (turns < RATE_FAST), numbers.get("vibration_damping", 0.0), 0.0)
    damper = np.diag(2.0 * rates * turns * j.motor_inertia)
    rows = np.diag(scale)
    return np.hstack([-soft, damper, soft - rows @ p, -damper - rows @ d, -rows @ i])


def _both(matrix: Matrix, factor: Vector | float) -> Matrix:
    """The matrix with √factor on both sides, of one number or one for each joint."""
    root = np.sqrt(np.broadcast_to(factor, len(matrix)))
    return root[:, None] * matrix * root


_SHARES = ({"share": 1.0}, {"share": 2.0}, {"share": 0.5})
_SLOW_INTEGRAL = {"integral_rate": 0.1}
_TORQUES = (
    {"share": 1.0, "rotor_inertia": 0.5, "vibration_damping": 0.42},
    {"share": 1.0, "vibration_damping": 0.42},
    {"share": 1.0, "vibration_damping": 0.2},
)
_GAINS = ("bandwidth", "damping", "kp", "kd")
_INTEGRAL = ("integral_rate", "ki")
_OF_TORQUE = ("rotor_inertia", "vibration_damping")


register(
    LawKind(
        "pd",
        "PD on the motor side, weight at the goal compensated",
        "Tomei 1991",
        LawOver(partial(_at_pose, fixed=True, weight=False, integral=False), _GAINS, _SHARES),
        MOTOR,
        place=7,
    )
)
register(
    LawKind(
        "pd-gravity",
        "PD on the motor side, weight compensated from the motor at every pose",
        "De Luca, Siciliano & Zollo 2005",
        LawOver(partial(_at_pose, fixed=True, weight=True, integral=False), _GAINS, _SHARES),
        MOTOR,
        usual=True,
        place=8,
    )
)
register(
    LawKind(
        "pid",
        "PD on the motor side with the integral of the link's error",
        "Tomei 1991, with an integral",
        LawOver(
            partial(_at_pose, fixed=False, weight=False, integral=True),
            (*_GAINS, *_INTEGRAL),
            (*_SHARES, *({**each, **_SLOW_INTEGRAL} for each in _SHARES)),
        ),
        BOTH,
        usual=True,
        place=9,
    )
)
register(
    LawKind(
        "torque",
        "PD with feedback of the spring's torque, weight compensated from the motor",
        "Albu-Schäffer, Ott & Hirzinger 2007",
        LawOver(
            partial(_at_pose, fixed=False, weight=True, integral=False), (*_GAINS, *_OF_TORQUE), _TORQUES
        ),
        TORQUE,
        place=10,
    )
)
register(
    LawKind(
        "torque-i",
        "torque with the integral of the link's error",
        "Albu-Schäffer, Ott & Hirzinger 2007, with an integral",
        LawOver(
            partial(_at_pose, fixed=False, weight=True, integral=True),
            (*_GAINS, *_INTEGRAL, *_OF_TORQUE),
            (*_TORQUES, *({**each, **_SLOW_INTEGRAL} for each in _TORQUES)),
        ),
        TORQUE_BOTH,
        usual=True,
        place=11,
    )
)
