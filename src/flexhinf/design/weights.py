"""Weights for a robot that states none: from one bandwidth, scaled by what its motors move.

For a motor that moves the inertia M + J against a damping d, uᵀu costs as much as (w q)² at the angular frequency ω if
w = |(M + J) ω² − i d ω| per unit of input. So R2 = 1, and each joint has

    w_position = ω √((M + J)² ω² + d²) / k,   w_velocity = w_position / ω,   w_integral = w_position ω / 2

with k the torque per unit of input, all at the goal pose. The weights of the velocities are what damps: that of the
motor's acts on the vibrations too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.modes import stiffness_and_inertia
from flexhinf.plant import Penalty

__all__ = ["BANDWIDTH_SHARE", "ScaledWeights", "scaled_weights"]

#: The bandwidth, over the lowest frequency at which the links vibrate while the motors are held.
BANDWIDTH_SHARE = 0.5

#: Weight of the integral over that of the position times the bandwidth.
INTEGRAL_SHARE = 0.5


@dataclass(frozen=True)
class ScaledWeights:
    """A penalty and where it comes from.

    Attributes
    ----------
    penalty : Penalty
    bandwidth, held : float
        Hz: of the weights, and the lowest vibration with held motors.
    """

    penalty: Penalty
    bandwidth: float
    held: float

    @property
    def source(self) -> str:
        """In words."""
        return (
            f"ours: scaled for {self.bandwidth:.3g} Hz; the links vibrate at {self.held:.3g} Hz or more while the "
            "motors are held"
        )


def scaled_weights(robot: Any, pose: Any, bandwidth: float | None, effort: float | None) -> ScaledWeights:
    """Weights at a pose.

    Parameters
    ----------
    robot : Robot
    pose : sequence or None
    bandwidth : float or None
        Hz; by default half of the lowest frequency with held motors.
    effort : float or None
        R2; the weights of the states stay, so that more than 1 asks for less.
    """
    plant, rest = robot.plant(), robot.operating_point(pose)
    stiffness, inertia = stiffness_and_inertia(plant, rest)
    n = len(stiffness)
    a, b, _, _ = plant.linearise(*rest)
    motors, total = np.diag(inertia)[n:], np.diag(inertia)[:n] + np.diag(inertia)[n:]
    per_input = np.diag(b[3 * n : 4 * n]) * motors
    damping = -np.diag(a[3 * n : 4 * n, 3 * n : 4 * n]) * motors
    held = float(np.sqrt(np.linalg.eigvals(np.linalg.solve(inertia[:n, :n], np.diag(stiffness))).real.min()))
    omega = BANDWIDTH_SHARE * held if bandwidth is None else 2.0 * np.pi * bandwidth
    position = omega * np.hypot(total * omega, damping) / np.abs(per_input)
    weights = {
        "link_position": position,
        "link_position_integral": INTEGRAL_SHARE * position * omega,
        "link_velocity": position / omega,
        "motor_velocity": position / omega,
    }
    named = {name: w.tolist() if n > 1 else float(w[0]) for name, w in weights.items()}
    penalty = Penalty(named, 1.0 if effort is None else effort)
    return ScaledWeights(penalty, omega / (2.0 * np.pi), held / (2.0 * np.pi))
