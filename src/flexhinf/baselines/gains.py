"""Gains of a joint from a bandwidth and a damping ratio, and whether given gains are such."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.baselines.joints import ElasticJoints
from flexhinf.errors import InvalidInput
from flexhinf.untrusted import real_array

#: Pole of the integral, in bandwidths: slow beside the pair that it stands with.
INTEGRAL_RATE = 0.2


def rigid_gains(
    inertia: np.ndarray, friction: np.ndarray, bandwidth: float, damping: float, integral_rate: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(K_p, K_d, K_i), (n,) each, that give I s² + (K_d + B) s + K_p + K_i/s the poles asked for.

    Raises
    ------
    InvalidInput
        If bandwidth, damping or rate is not a number of the right sign.
    """
    if not (np.isfinite(bandwidth) and bandwidth > 0.0 and np.isfinite(damping) and damping > 0.0):
        raise InvalidInput(
            "The gains need a bandwidth and a damping ratio.",
            f"expected positive numbers, got bandwidth={bandwidth!r} rad/s, damping={damping!r}",
            "bandwidth=6.0, damping=0.7",
        )
    if not (np.isfinite(integral_rate) and integral_rate >= 0.0):
        raise InvalidInput(
            "The rate of the integral is negative or not a number.",
            f"expected a share of the bandwidth, got {integral_rate!r}",
            f"integral_rate={INTEGRAL_RATE}",
        )
    slow = integral_rate * bandwidth
    proportional = inertia * (bandwidth**2 + 2.0 * damping * bandwidth * slow)
    derivative = np.maximum(0.0, inertia * (2.0 * damping * bandwidth + slow) - friction)
    return proportional, derivative, inertia * bandwidth**2 * slow


def per_joint(what: str, value: Any, joints: int) -> np.ndarray:
    """One finite number ≥ 0 per joint.

    Raises
    ------
    InvalidInput
        For anything else.
    """
    try:
        numbers = np.broadcast_to(real_array(value), (joints,)).copy()
    except ValueError:
        numbers = np.array([np.nan])
    if not np.all(np.isfinite(numbers)) or np.any(numbers < 0.0):
        raise InvalidInput(
            f"The {what} gain does not fit the joints.",
            f"expected a number >= 0, or {joints} of them, got {value!r}",
            "one gain per joint",
        )
    return numbers


def check_integral(integrate: Sequence[str], gain: np.ndarray, joints: int) -> None:
    """An integral and its gain come together, one per joint.

    Raises
    ------
    InvalidInput
        If one is there without the other, or there are not as many as joints.
    """
    if len(integrate) not in (0, joints) or bool(len(integrate)) != bool(np.any(gain)):
        raise InvalidInput(
            "The integral gain and what is integrated do not fit each other.",
            f"expected {joints} signals with gains, or neither, got {list(integrate)} and {gain.tolist()}",
            "integrate=('link_position',) and integral=..., or neither",
        )


def check_goal(joints: ElasticJoints, proportional: np.ndarray) -> None:
    """The goal is a minimum of the potential of springs, gravity and a motor-side K_p with constant compensation.

    Raises
    ------
    InvalidInput
        If [[K + ∂G/∂q, −K], [−K, K + K_p]] is not positive definite: the condition of [tomei1991], at the goal.
    """
    stiffness = np.diag(joints.stiffness)
    slope = (joints.gravity_slope + joints.gravity_slope.T) / 2.0
    potential = np.block([[stiffness + slope, -stiffness], [-stiffness, stiffness + np.diag(proportional)]])
    smallest = float(np.linalg.eigvalsh(potential)[0])
    if smallest <= 0.0:
        raise InvalidInput(
            "The goal is not a minimum of the potential: the robot would fall away from it.",
            f"expected [[K + dG/dq, -K], [-K, K + K_p]] positive definite, got an eigenvalue {smallest:.3g}",
            "a proportional gain larger than the slope of the gravity torque, or a stiffer joint",
        )
