"""What a strain-wave gear is beside a spring: the curve of its catalogue, the error of its teeth, their ripple.

A catalogue states slopes K₁, K₂, K₃ of torque over twist, and the torques T₁, T₂ at which one follows the other. With
the dead zone dz(x, w) = x − clip(x, −w, w), and the twists of the corners δ₁ = T₁/K₁, δ₂ = δ₁ + (T₂ − T₁)/K₂,

    T(δ) = K₁ δ + (K₂ − K₁) dz(δ, δ₁) + (K₃ − K₂) dz(δ, δ₂),

    δ(T) = T/K₁ + (1/K₂ − 1/K₁) dz(T, T₁) + (1/K₃ − 1/K₂) dz(T, T₂).

Both are exact inverses of each other. Hysteresis is not in the curve.

The wave generator's two lobes pass the same teeth twice in a turn of the motor, N θ on its own side [tuttle1996]: the
output is off by e(θ) = A sin(2 N θ + φ), and the torque of the motor by R sin(2 N θ + φ_R). A spring whose twist is
δ = θ + e(θ) − q pushes the link with T(δ) and the motor with (1 + e′(θ)) T(δ): no work is lost between them. An encoder
of the motor sees θ, one of the link q.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.scalars import absolute, clip, where

T = TypeVar("T")

#: Numbers of a curve: its three slopes, then the torques of its two corners.
CURVE = ("first_stiffness", "second_stiffness", "third_stiffness", "first_torque", "second_torque")

#: What the corner at T₂ adds; a curve may have the one at T₁ alone.
SECOND_CORNER = ("third_stiffness", "second_torque")

#: Source of a stiffness that is computed from a curve.
SECANT = "secant of the stiffness curve to T₂; its range are the slopes"


def curve_number(quantity: str, stated: Mapping[str, T], fallback: T) -> T | float:
    """One number of a joint's curve: what it states by name, else what makes its curve straight from there on.

    `fallback` is its plain stiffness, of a joint without a curve.
    """
    before = {"second_stiffness": "first_stiffness", "third_stiffness": "second_stiffness"}
    if quantity in stated:
        return stated[quantity]
    if quantity in before:
        return curve_number(before[quantity], stated, fallback)
    if quantity == "second_torque":
        return curve_number("first_torque", stated, fallback)
    return fallback if quantity == "first_stiffness" else 0.0


def corners(p: Any) -> tuple[Any, Any]:
    """Twists δ₁ and δ₂ of the corners, rad or m."""
    first = p.first_torque / p.first_stiffness
    return first, first + (p.second_torque - p.first_torque) / p.second_stiffness


def curve_parts(p: Any) -> list[tuple[Any, Any]]:
    """Slopes and half widths of the dead zones of the three springs side by side that make T(δ)."""
    first, second = corners(p)
    return [
        (p.first_stiffness, 0.0 * first),
        (p.second_stiffness - p.first_stiffness, first),
        (p.third_stiffness - p.second_stiffness, second),
    ]


def curve_torque(twist: Any, p: Any) -> Elements:
    """T(δ) on any element."""
    _, (second, at_first), (third, at_second) = curve_parts(p)
    beyond = twist - clip(twist, -at_first, at_first), twist - clip(twist, -at_second, at_second)
    return p.first_stiffness * twist + second * beyond[0] + third * beyond[1]


def curve_twist(torque: Any, p: Any) -> Elements:
    """δ(T) on any element."""
    one, two, three = (1.0 / slope for slope in (p.first_stiffness, p.second_stiffness, p.third_stiffness))
    beyond = [torque - clip(torque, -at, at) for at in (p.first_torque, p.second_torque)]
    return one * torque + (two - one) * beyond[0] + (three - two) * beyond[1]


def over_stiffness(p: Any) -> np.ndarray:
    """Numbers of curves (5, e), over the stiffness K of straight springs: K₁/K, K₂/K and K₃/K, and the twists T₁/K and
    T₂/K, rad or m, of these springs at the corners."""
    return np.array([np.atleast_1d(getattr(p, name)) for name in CURVE]) / p.stiffness


def curve_softness(torque: Any, p: Any) -> Elements:
    """dδ/dT at a torque on any element, rad/(N·m) or m/N: the inverse of the slope there."""
    one, two, three = (1.0 / slope for slope in (p.first_stiffness, p.second_stiffness, p.third_stiffness))
    size = absolute(torque)
    rows = zip(
        *(
            np.broadcast_to(each, np.shape(torque))
            for each in (
                size,
                p.first_torque,
                p.second_torque,
                one,
                two,
                three,
            )
        )
    )
    return np.array([where(s > b, k3, where(s > a, k2, k1)) for s, a, b, k1, k2, k3 in rows])


def tooth_error(angle: Any, ratio: Any, p: Any) -> tuple[Any, Any]:
    """e(θ), rad or m, and its slope e′(θ), at motors' angles seen from the link; the ratio is N, rad/rad or rad/m."""
    phase = 2.0 * ratio * angle + p.kinematic_error_phase
    return p.kinematic_error * np.sin(phase), (2.0 * ratio) * p.kinematic_error * np.cos(phase)


def tooth_ripple(angle: Any, p: Any) -> Elements:
    """R sin(2 N θ + φ_R), N·m or N, against the motor."""
    return p.torque_ripple * np.sin(2.0 * p.gear_ratio * angle + p.torque_ripple_phase)


def meshed(wanted: Any, ratio: Any, p: Any) -> np.ndarray:
    """θ of θ + e(θ) = wanted, on numbers: Newton's method, whose slope 1 + e′ is positive."""
    angle, done = np.array(wanted, dtype=float), np.array(False)
    for _ in range(100):
        error, slope = tooth_error(angle, ratio, p)
        step = (angle + error - wanted) / (1.0 + slope)
        angle = np.where(done, angle, angle - np.clip(step, -1.0 / ratio, 1.0 / ratio))
        done = done | np.all(np.abs(step) <= 1e-15 * np.maximum(np.abs(angle), 1e-3), axis=0)
        if np.all(done):
            break
    return angle


def secant(first: float, second: float, low: float, high: float) -> float:
    """T₂/δ(T₂), of slopes K₁, K₂ and torques T₁, T₂; K₂ of a curve with one corner, whose T₂ is infinite."""
    return high / (low / first + (high - low) / second) if np.isfinite(high) else second
