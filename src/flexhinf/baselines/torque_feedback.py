"""Passivity-based torque feedback [albuschaeffer2007], [ott2008]: a rotor that feels lighter, then PD.

    τ = J J_θ⁻¹ u' + (I − J J_θ⁻¹) τ_J,   τ_J = K (θ − q) + D (θ̇ − q̇),
    u' = −K_θ (θ − θ_d) − D_θ θ̇ + ḡ(θ).

Feeding back the torque τ_J of the spring scales the rotor's inertia from J to J_θ: put into J θ̈ + B θ̇ + τ_J = τ it
gives J_θ θ̈ + (J_θ J⁻¹ B) θ̇ + τ_J = u'. The friction is scaled with it; nothing else changes, so the loop stays
passive. The torque is K (θ − q) + D (θ̇ − q̇) of the estimate, with the spring's numbers at the equilibrium.

The weight is compensated from the motor position alone, which passivity needs: ḡ(θ) = G(q̄(θ)), where q̄ is the link
position that would rest at θ, K (θ − q̄) = G(q̄). It is the fixed point of q̄ ← θ − K⁻¹ G(q̄), begun at θ; a fixed
number of turns, chosen from how fast it contracts. Or it is G(q_d), as in `flexhinf.baselines.MotorPD`.

PD control on the motor side with the goal's gravity compensated [tomei1991]: what most elastic robots run.

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

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from flexhinf.baselines.equilibrium_law import (
    ElasticJoints,
    GravityTorque,
    LinearFeedback,
    PlacedLaw,
    elastic_joints,
    equilibrium_of,
)
from flexhinf.baselines.linear_quadratic import (
    INTEGRAL_RATE,
    check_goal,
    check_integral,
    per_joint,
    rigid_gains,
)
from flexhinf.errors import InvalidInput
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


#: What the fixed number of turns leaves of ḡ, relative to the weight.
LEFT = 1e-6
MOST_TURNS = 30
#: Poses at which the contraction is sampled, uniform in ±π, and the seed of them.
POSES, SEED = 200, 0


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TorqueFeedback(PlacedLaw):
    """Torque feedback and PD on the motor side; about a moving reference all in deviations from it.

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`; integrals are of link_position or motor_position, as in
        `flexhinf.baselines.MotorPD`.
    rotor_inertia : float or (n,) array
        J_θ, kg·m², as the motors shall feel; J as it is leaves the torque out.
    proportional, derivative, integral : float or (n,) array
        K_θ (N·m/rad), D_θ (N·m·s/rad) and K_i (N·m/(rad·s)) of u'.
    compensation : {"motor", "goal"}
        ḡ(θ) from the motor position, or the constant G(q_d).
    gravity : callable, optional
        ``gravity(q, p)`` → G, see `flexhinf.baselines.equilibrium_law.GravityTorque`; from the plant's flow by default.

    Raises
    ------
    InvalidInput
        If numbers do not fit, the goal would not be a minimum of the potential, or q̄ is no contraction.
    """

    rotor_inertia: Any
    proportional: Any
    derivative: Any
    integral: Any = 0.0
    compensation: str = "motor"
    gravity: Callable[[Any, Any], Any] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        n = len(self.joints.stiffness)
        for name in ("rotor_inertia", "proportional", "derivative", "integral"):
            object.__setattr__(self, name, per_joint(name, getattr(self, name), n))
        check_integral(self.integrate, self.integral, n)
        if not np.all(self.rotor_inertia > 0.0) or self.compensation not in ("motor", "goal"):
            raise InvalidInput(
                "Torque feedback cannot be made so.",
                "expected positive rotor inertias and compensation 'motor' or 'goal', "
                f"got {self.rotor_inertia.tolist()}, {self.compensation!r}",
                "rotor_inertia=0.25 * J, compensation='motor'",
            )
        if self.compensation == "goal":
            check_goal(self.joints, self.proportional)
        else:
            _ = self.turns

    @staticmethod
    def tuned(
        problem: GeneralisedPlant,
        bandwidth: float,
        damping: float = 0.7,
        inertia_ratio: float = 0.25,
        integral: str | None = None,
        integral_rate: float = INTEGRAL_RATE,
        compensation: str = "motor",
        gravity: Callable[[Any, Any], Any] | None = None,
    ) -> TorqueFeedback:
        """Gains from a bandwidth and a damping ratio, as `MotorPD.tuned`, with the scaled rotor.

        Parameters
        ----------
        problem : GeneralisedPlant
            Plant and equilibrium; its penalty does not matter.
        bandwidth, damping, integral, integral_rate
            As for `MotorPD.tuned`, with I = M_jj(q*) + J_θj.
        inertia_ratio : float
            J_θ/J.
        compensation, gravity
            See the class.
        """
        equilibrium = equilibrium_of(problem)
        joints = elastic_joints(problem.plant, *equilibrium)
        rotor = inertia_ratio * joints.motor_inertia
        inertia = np.diag(joints.link_inertia) + rotor
        rate = integral_rate if integral else 0.0
        gains = rigid_gains(inertia, inertia_ratio * joints.motor_damping, bandwidth, damping, rate)
        return TorqueFeedback(
            plant=problem.plant, equilibrium=equilibrium, integrate=(integral,) if integral else (),
            rotor_inertia=rotor,
            proportional=gains[0], derivative=gains[1], integral=gains[2],
            compensation=compensation, gravity=gravity,
        )  # fmt: skip

    @cached_property
    def joints(self) -> ElasticJoints:
        """The joints' numbers at the equilibrium."""
        return elastic_joints(self.plant, *self.equilibrium)

    # The weight from the motor position -------------------------------------------------------------
    @cached_property
    def _weight(self) -> GravityTorque:
        return GravityTorque(self.plant, self.gravity)

    @cached_property
    def contraction(self) -> float:
        """Largest factor ‖K^-½ ∂G/∂q K^-½‖ by which a turn of q̄ contracts, at the equilibrium and the sampled poses."""
        stiffness = self.joints.stiffness
        goal = self.equilibrium[0][: len(stiffness)]
        return _contraction(self.plant, self.gravity, tuple(goal.tolist()), tuple(stiffness.tolist()))

    @cached_property
    def turns(self) -> int:
        """Turns of q̄: so many that ḡ is wrong by at most 1e-6 of the weight."""
        factor = max(self.contraction, LEFT)
        turns = np.ceil(np.log(LEFT) / np.log(factor)) - 1 if factor < 1.0 else np.inf
        if turns > MOST_TURNS:
            raise InvalidInput(
                "The link position cannot be found from the motor position by iteration.",
                f"expected springs stiffer than the gravity torque's slope, so that at most {MOST_TURNS} turns do; "
                f"got a contraction by {factor:.3g}",
                "compensation='goal', or stiffer joints",
            )
        return int(turns)

    def weight(self, theta: Any, stiffness: Any, p: Any) -> Any:
        """ḡ(θ), (n,), for motor positions (n,) and the parameter vector p, of any element."""
        q = theta
        for _ in range(self.turns):
            q = theta - self._weight.torque(q, p) / stiffness
        return self._weight.torque(q, p)

    # The law ----------------------------------------------------------------------------------------
    @cached_property
    def gain(self) -> np.ndarray:
        """The linear part, (n, states), in units of the input."""
        spring, scale = self.joints, self.joints.motor_inertia / self.rotor_inertia
        columns = [
            -(1.0 - scale) * spring.stiffness,
            -(1.0 - scale) * spring.spring_damping,
            (1.0 - scale) * spring.stiffness - scale * self.proportional,
            (1.0 - scale) * spring.spring_damping - scale * self.derivative,
        ]
        if self.integrate:
            columns.append(-scale * self.integral)
        return np.hstack([np.diag(column) for column in columns]) / spring.torque_per_input[:, None]

    @property
    def numbers(self) -> np.ndarray:
        """Gain; with ḡ also its share in the input, the stiffness, and the plant's parameters."""
        if self.compensation == "goal":
            return self.gain.ravel()
        share = self.joints.motor_inertia / self.rotor_inertia / self.joints.torque_per_input
        return np.concatenate(
            [self.gain.ravel(), share, self.joints.stiffness, self.plant.parameters.vector()]
        )

    @property
    def law_key(self) -> str:
        """The code of G and the number of turns."""
        if self.compensation == "goal":
            return "torque feedback, weight at the goal"
        return f"torque feedback, weight at the motor {self.turns} {self._weight.key}"

    def feedback(self, x: Any, state: Any, input: Any, numbers: Any) -> Any:
        """k (n,) for a deviation x from the reference, of any element."""
        n = len(self.input_names)
        end = self.gain.size
        k = numbers[:end].reshape(n, -1) @ x
        if self.compensation == "goal":
            return k
        share, stiffness, p = numbers[end : end + n], numbers[end + n : end + 2 * n], numbers[end + 2 * n :]
        motor, moved = state[2 * n : 3 * n], x[2 * n : 3 * n]
        return k + share * (self.weight(motor + moved, stiffness, p) - self.weight(motor, stiffness, p))


@lru_cache(maxsize=8)
def _contraction(
    plant: Any,
    gravity: Callable[[Any, Any], Any] | None,
    goal: tuple[float, ...],
    stiffness: tuple[float, ...],
) -> float:
    """See `TorqueFeedback.contraction`; gains have no part in it, so a search over them computes it once."""
    n, p, weight = len(stiffness), plant.parameters.vector(), GravityTorque(plant, gravity)
    poses = np.random.default_rng(SEED).uniform(-np.pi, np.pi, (POSES, n))
    root = np.sqrt(stiffness)
    largest = 0.0
    for q in (np.array(goal), *poses):
        slope = np.column_stack([weight.torque_and_rate(q, unit, p)[1] for unit in np.eye(n)])
        largest = max(largest, float(np.linalg.norm(slope / np.outer(root, root), 2)))
    return largest
