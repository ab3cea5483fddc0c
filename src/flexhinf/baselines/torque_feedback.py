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

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np

from flexhinf.baselines.equilibrium_law import (
    INTEGRAL_RATE,
    ElasticJoints,
    GravityTorque,
    PlacedLaw,
    elastic_joints,
    equilibrium_of,
)
from flexhinf.errors import InvalidInput
from flexhinf.plant import GeneralisedPlant
from flexhinf.validation import checked_positive, real_array

#: What the fixed number of turns leaves of ḡ, relative to the weight.
LEFT = 1e-6
MOST_TURNS = 30
#: Poses at which the contraction is sampled, uniform in ±π, and the seed of them.
POSES, SEED = 200, 0


def rigid_gains(
    inertia: np.ndarray, friction: np.ndarray, bandwidth: float, damping: float, integral_rate: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(K_p, K_d, K_i), (n,) each, that give I s² + (K_d + B) s + K_p + K_i/s the poles asked for; a bandwidth, damping
    or rate that is not a number of the right sign is refused."""
    checked_positive("The bandwidth", bandwidth, "rad/s", "bandwidth=6.0")
    checked_positive("The damping ratio", damping, "a number", "damping=0.7")
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


def check_goal(joints: ElasticJoints, proportional: np.ndarray) -> None:
    """The goal is a minimum of the potential of springs, gravity and a motor-side K_p with constant compensation: [[K
    + ∂G/∂q, −K], [−K, K + K_p]] is positive definite there [tomei1991], or refused."""
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


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TorqueFeedback(PlacedLaw):
    """Torque feedback and PD on the motor side; about a moving reference all in deviations from it.

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`; one signal per joint is integrated: link_position or
        motor_position.
    rotor_inertia : float or (n,) array, optional
        J_θ, kg·m², as the motors shall feel; J as it is (the default) leaves the torque out.
    proportional, derivative, integral : float or (n,) array
        K_θ (N·m/rad), D_θ (N·m·s/rad) and K_i (N·m/(rad·s)) of u'.
    compensation : {"motor", "goal"}
        ḡ(θ) from the motor position, or the constant G(q_d).

    Raises `InvalidInput` if numbers do not fit, the goal would not be a minimum of the potential (K_θ too small for
    the gravity), or q̄ is no contraction.
    """

    rotor_inertia: Any = None
    proportional: Any
    derivative: Any
    integral: Any = 0.0
    compensation: str = "motor"

    def __post_init__(self) -> None:
        super().__post_init__()
        n, rotor = len(self.joints.stiffness), self.rotor_inertia
        given = {name: getattr(self, name) for name in ("proportional", "derivative", "integral")}
        given["rotor_inertia"] = self.joints.motor_inertia if rotor is None else rotor
        for name, value in given.items():  # one finite number ≥ 0 per joint
            numbers = real_array(value)
            if numbers.shape not in ((), (1,), (n,)) or not np.all(np.isfinite(numbers) & (numbers >= 0.0)):
                raise InvalidInput(
                    f"The {name} gain does not fit the joints.",
                    f"expected a number >= 0, or {n} of them, got {value!r}",
                    "one gain per joint",
                )
            object.__setattr__(self, name, np.broadcast_to(numbers, (n,)).copy())
        if len(self.integrate) not in (0, n) or bool(len(self.integrate)) != bool(np.any(self.integral)):
            raise InvalidInput(
                "The integral gain and what is integrated do not fit each other.",
                f"expected {n} signals with gains, or neither, got {list(self.integrate)} and {self.integral.tolist()}",
                "integrate=('link_position',) and integral=..., or neither",
            )
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
            _ = self.turns  # raises where q̄ cannot be found

    @classmethod
    def tuned(
        cls,
        problem: GeneralisedPlant,
        bandwidth: float,
        damping: float = 0.7,
        inertia_ratio: float = 0.25,
        integral: str | None = None,
        integral_rate: float = INTEGRAL_RATE,
        **options: Any,
    ) -> Self:
        """Gains from a bandwidth and a damping ratio, as if the joints were rigid and moved one by one.

        I s² + (D_θ + B + k_t k_b/R) s + K_θ = I (s² + 2ζω s + ω²) with I = M_jj(q*) + J_θj; with an integral a further
        factor s + σ, σ = integral_rate · ω. D_θ is not made negative: a motor that damps itself by more than was asked
        keeps doing so. The spring is not seen: where ω nears √(K/I) the link's own bandwidth stays behind.

        Plant and equilibrium are the problem's; its penalty does not matter. `bandwidth`, `damping` and
        `inertia_ratio` are ω (rad/s), ζ and J_θ/J; `integral` is whose error is integrated, "link_position" or
        "motor_position"; `options` may have ``compensation``, see the class.
        """
        equilibrium = equilibrium_of(problem)
        joints = elastic_joints(problem.plant, *equilibrium)
        rotor = inertia_ratio * joints.motor_inertia
        gains = rigid_gains(
            np.diag(joints.link_inertia) + rotor, inertia_ratio * joints.motor_damping, bandwidth, damping,
            integral_rate if integral else 0.0,
        )  # fmt: skip
        return cls(
            plant=problem.plant, equilibrium=equilibrium, integrate=(integral,) if integral else (),
            rotor_inertia=rotor, proportional=gains[0], derivative=gains[1], integral=gains[2], **options,
        )  # fmt: skip

    # The weight from the motor position -------------------------------------------------------------

    @cached_property
    def contraction(self) -> float:
        """Largest factor ‖K^-½ ∂G/∂q K^-½‖ by which a turn of q̄ contracts, at the equilibrium and the sampled poses."""
        stiffness = self.joints.stiffness
        goal = self.equilibrium[0][: len(stiffness)]
        return _contraction(self.plant, tuple(goal.tolist()), tuple(stiffness.tolist()))

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


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MotorPD(TorqueFeedback):
    """k(x) = −(K_p δθ + K_d δθ̇ + K_i e) in units of the input: torque feedback that leaves the torque out.

    `proportional`, `derivative` and `integral` are K_p, K_d and K_i; about a moving reference its θ̇_d counts too.
    """

    compensation: str = "goal"

    @classmethod
    def tuned(
        cls,
        problem: GeneralisedPlant,
        bandwidth: float,
        damping: float = 0.7,
        integral: str | None = None,
        integral_rate: float = INTEGRAL_RATE,
    ) -> Self:
        """See `TorqueFeedback.tuned`, with the rotor as it is."""
        return super().tuned(problem, bandwidth, damping, 1.0, integral, integral_rate)


@lru_cache(maxsize=8)
def _contraction(plant: Any, goal: tuple[float, ...], stiffness: tuple[float, ...]) -> float:
    """See `TorqueFeedback.contraction`; gains have no part in it, so a search over them computes it once."""
    n, p, weight = len(stiffness), plant.parameters.vector(), GravityTorque(plant)
    poses = np.random.default_rng(SEED).uniform(-np.pi, np.pi, (POSES, n))
    root = np.sqrt(stiffness)
    largest = 0.0
    for q in (np.array(goal), *poses):
        slope = np.column_stack([weight.torque_and_rate(q, unit, p)[1] for unit in np.eye(n)])
        largest = max(largest, float(np.linalg.norm(slope / np.outer(root, root), 2)))
    return largest
