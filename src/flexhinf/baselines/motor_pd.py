"""PD control on the motor side with the goal's gravity compensated [tomei1991]: what most elastic robots run.

    τ = K_p (θ_d − θ) − K_d θ̇ + G(q_d),   θ_d = q_d + K⁻¹ G(q_d).

With energy E of links, rotors, springs and gravity, V = E + ½ (θ_d − θ)ᵀ K_p (θ_d − θ) + (θ_d − θ)ᵀ G(q_d) falls by
θ̇ᵀ (K_d + B) θ̇, so the goal is stable where it is the minimum of V's potential: where

    [ K + ∂G/∂q   −K      ]
    [ −K           K + K_p ]   is positive definite.

A voltage-driven motor gets V = (R/k_t) τ. Its back-EMF is **not** compensated: it is passive damping, k_t k_b/R, which
a compensation would take away with a velocity that is only estimated. `MotorPD.tuned` counts it as part of the
damping asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.baselines.equilibrium_law import LinearFeedback, equilibrium_of
from flexhinf.baselines.gains import INTEGRAL_RATE, check_goal, check_integral, per_joint, rigid_gains
from flexhinf.baselines.joints import ElasticJoints, elastic_joints
from flexhinf.plant import GeneralisedPlant


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MotorPD(LinearFeedback):
    """k(x) = −(K_p δθ + K_d δθ̇ + K_i e) in units of the input; about a moving reference its θ̇_d counts too.

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`. The integral is that of what is named in
        `integrate`, one signal per joint: link_position or motor_position.
    proportional, derivative, integral : float or (n,) array
        K_p (N·m/rad), K_d (N·m·s/rad) and K_i (N·m/(rad·s)) of each joint, as torques.

    Raises
    ------
    InvalidInput
        If gains do not fit, or the goal would not be a minimum of the potential (K_p too small for the gravity).
    """

    proportional: Any
    derivative: Any
    integral: Any = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        n = len(self.joints.stiffness)
        for name in ("proportional", "derivative", "integral"):
            object.__setattr__(self, name, per_joint(name, getattr(self, name), n))
        check_integral(self.integrate, self.integral, n)
        check_goal(self.joints, self.proportional)

    @staticmethod
    def tuned(
        problem: GeneralisedPlant,
        bandwidth: float,
        damping: float = 0.7,
        integral: str | None = None,
        integral_rate: float = INTEGRAL_RATE,
    ) -> MotorPD:
        """Gains from a bandwidth and a damping ratio, as if the joints were rigid and moved one by one.

        I s² + (K_d + B + k_t k_b/R) s + K_p = I (s² + 2ζω s + ω²) with I = M_jj(q*) + J_j; with an integral a
        further factor s + σ, σ = integral_rate · ω. K_d is not made negative: a motor that damps itself by more
        than was asked keeps doing so. The spring is not seen: where ω nears √(K/I) the link's own bandwidth stays
        behind.

        Parameters
        ----------
        problem : GeneralisedPlant
            Plant and equilibrium; its penalty does not matter.
        bandwidth : float
            ω, rad/s.
        damping : float
            ζ.
        integral : {"link_position", "motor_position"}, optional
            Whose error is integrated.
        integral_rate : float
            σ/ω.
        """
        equilibrium = equilibrium_of(problem)
        joints = elastic_joints(problem.plant, *equilibrium)
        rate = integral_rate if integral else 0.0
        gains = rigid_gains(joints.joint_inertia, joints.motor_damping, bandwidth, damping, rate)
        return MotorPD(
            plant=problem.plant, equilibrium=equilibrium, integrate=(integral,) if integral else (),
            proportional=gains[0], derivative=gains[1], integral=gains[2],
        )  # fmt: skip

    @cached_property
    def joints(self) -> ElasticJoints:
        """The joints' numbers at the equilibrium."""
        return elastic_joints(self.plant, *self.equilibrium)

    @cached_property
    def gain(self) -> np.ndarray:
        """K, (n, states), in units of the input."""
        nothing = np.zeros((len(self.joints.stiffness),) * 2)
        columns = [nothing, nothing, np.diag(self.proportional), np.diag(self.derivative)]
        if self.integrate:
            columns.append(np.diag(self.integral))
        return -np.hstack(columns) / self.joints.torque_per_input[:, None]
