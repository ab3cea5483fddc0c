"""LQR with gravity compensation: the law a practitioner would try before any H∞."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.hinf import linear_law
from flexhinf.plant import GeneralisedPlant, ProblemLaw
from flexhinf.robot import Robot

__all__ = ["GravityCompensatedLaw"]


@dataclass(frozen=True, eq=False)
class GravityCompensatedLaw(ProblemLaw):
    """u = u_g(x1) + K (x − x_g(x1)), K the LQR gain of the arm without gravity.

    At a link angle x1 gravity M g L sin x1 is held by the spring, wound up by x_g3 = (M g L / k) sin x1, and by
    the voltage u_g = (R / k_m) M g L sin x1. The gain acts on the motor relative to that wind-up.

    Parameters
    ----------
    problem : GeneralisedPlant
        Whose states, weights and R2 the gain is for.
    gain : ndarray, (1, 5)
    wind_up : float
        M g L / k, rad.
    holding_voltage : float
        (R / k_m) M g L, V.
    """

    problem: GeneralisedPlant
    gain: np.ndarray
    wind_up: float
    holding_voltage: float

    @staticmethod
    def design(arm: Robot, problem: GeneralisedPlant) -> GravityCompensatedLaw:
        """The LQR gain (γ = ∞) of the arm with g = 0, for the same penalty."""
        p = arm.nominal
        weightless = arm.with_values({"gravity": 0.0}).problem(problem.penalty)
        lqr = linear_law(weightless, gamma=np.inf)
        torque = p["mass"] * p["gravity"] * p["length"]
        gain = lqr.law(np.eye(5)).T
        return GravityCompensatedLaw(
            problem, gain, torque / p["stiffness"], torque * p["resistance"] / p["torque_constant"]
        )

    @property
    def law_key(self) -> str:
        """One text for all numbers."""
        return "LQR with gravity compensation"

    @property
    def law_data(self) -> np.ndarray:
        """Gain, wind-up and holding voltage, flat."""
        return np.concatenate([self.gain.ravel(), [self.wind_up, self.holding_voltage]])

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """The law on any element."""
        gain, wind_up, holding = data[:5], data[5], data[6]
        motor = x[2] - wind_up * np.sin(x[0])
        motor_rate = x[3] - wind_up * np.cos(x[0]) * x[1]
        relative = np.array([x[0], x[1], motor, motor_rate, x[4]])
        return np.array([holding * np.sin(x[0]) + gain @ relative])
