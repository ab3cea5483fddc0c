"""LQR of a problem's linear part: the problem's own weights, and no disturbance thought of (γ = ∞).

Gains of a joint from a bandwidth and a damping ratio, and whether given gains are such.

LQR with the weight compensated exactly, through the springs: what a practitioner would try before any H∞.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.baselines.equilibrium_law import (
    ElasticJoints,
    GravityTorque,
    LinearFeedback,
    PlacedLaw,
    check_joints,
    elastic_joints,
    equilibrium_of,
)
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.plant import GeneralisedPlant
from flexhinf.validation import read_only, real_array

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


def lqr_gain(problem: GeneralisedPlant, effort: float = 1.0) -> np.ndarray:
    """K (m, n) of u = K x that minimises ½∫ hᵀh + uᵀ R2 u for the problem's linear part.

    K = −R2⁻¹ Bᵀ P with AᵀP + PA + HᵀH − P B R2⁻¹ Bᵀ P = 0 [anderson1990].

    Parameters
    ----------
    effort : float
        Factor of R2, the one tuning parameter of an LQR: the larger, the less effort.

    Raises
    ------
    InvalidInput
        If the factor is not positive.
    NumericalFailure
        If there is no stabilising solution: a mode that the input does not move or the penalty does not see.
    """
    from scipy.linalg import solve_continuous_are

    if not (np.isfinite(effort) and effort > 0.0):
        raise InvalidInput(
            "The factor of the effort is not positive.",
            f"expected a number > 0, got {effort!r}",
            "effort=1.0",
        )
    linear = problem.expand(1)
    a, b, h = linear.f_parts[1], linear.g2_parts[0][:, :, 0], linear.h_parts[1]
    r2 = effort * problem.r2
    try:
        p = solve_continuous_are(a, b, h.T @ h, r2)
        gain = -np.linalg.solve(r2, b.T @ p)
        slowest = float(np.linalg.eigvals(a + b @ gain).real.max())
    except np.linalg.LinAlgError as error:
        raise _unsolved(problem, str(error)) from error
    if not slowest < 0.0:
        raise _unsolved(problem, f"closed loop with a mode at {slowest:.3g} 1/s")
    return read_only(gain)


def _unsolved(problem: GeneralisedPlant, got: str) -> NumericalFailure:
    return NumericalFailure(
        "The problem has no LQR.",
        f"expected a stabilising solution of the Riccati equation for {list(problem.state_names)}, got: {got}",
        "a weight on every integral and on one position of each joint",
    )


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LinearQuadratic(LinearFeedback):
    """u = u* + K (x − x*).

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`.
    gains : (m, n) array
        K, integrals included.
    """

    gains: Any

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(
            self, "gains", checked_gain(self.gains, len(self.input_names), len(self.state_names))
        )

    @property
    def gain(self) -> np.ndarray:
        """K, (m, n)."""
        return self.gains


def lqr(problem: GeneralisedPlant, effort: float = 1.0) -> LinearQuadratic:
    """The LQR of a problem, of any plant; see `lqr_gain`."""
    return LinearQuadratic(
        plant=problem.plant,
        equilibrium=equilibrium_of(problem),
        integrate=problem.integrate,
        gains=lqr_gain(problem, effort),
    )


def checked_gain(value: Any, inputs: int, states: int) -> np.ndarray:
    """A finite gain (m, n).

    Raises
    ------
    InvalidInput
        For anything else.
    """
    gain = real_array(value)
    if gain.shape != (inputs, states) or not np.all(np.isfinite(gain)):
        raise InvalidInput(
            "The gain does not fit the law's states and inputs.",
            f"expected finite numbers of shape ({inputs}, {states}), got shape {gain.shape}",
            "one row per input and one column per state, integrals included",
        )
    return gain


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GravityCompensatedLQR(PlacedLaw):
    """κ(x) = k_u⁻¹ G(q) + K (q, q̇, θ − K_s⁻¹ G(q), θ̇ − K_s⁻¹ Ġ(q), e): the LQR of the weightless robot, and its weight.

    At link positions q the weight G(q) is held by the springs, wound up by K_s⁻¹ G(q), and by the inputs; the gain
    acts on the motors relative to that wind-up, which itself moves at the rate K_s⁻¹ ∂G/∂q q̇. About a reference,
    k = κ(x_d + δ) − κ(x_d), so every pose held is an equilibrium.

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`; the plant has elastic joints.
    gains : (n, states) array
        K, of the weightless robot.
    gravity : callable, optional
        ``gravity(q, p)`` → G, see `flexhinf.baselines.equilibrium_law.GravityTorque`; from the plant's flow by default.
    """

    gains: Any
    gravity: Callable[[Any, Any], Any] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_joints(self.plant)
        object.__setattr__(
            self, "gains", checked_gain(self.gains, len(self.input_names), len(self.state_names))
        )

    @staticmethod
    def design(
        problem: GeneralisedPlant, effort: float = 1.0, gravity: Callable[[Any, Any], Any] | None = None
    ) -> GravityCompensatedLQR:
        """The LQR of the robot with g = 0 at the same pose, for the same penalty, with the weight of the robot.

        Parameters
        ----------
        problem : GeneralisedPlant
            Of a plant with a parameter ``gravity``, m/s².
        effort : float
            Factor of R2, see `lqr_gain`.
        gravity : callable, optional
            See the class.

        Raises
        ------
        InvalidInput
            If the plant has no elastic joints, or no parameter ``gravity``.
        NumericalFailure
            If the weightless robot has no LQR.
        """
        plant, (x, u) = problem.plant, equilibrium_of(problem)
        n = check_joints(plant)
        weightless = plant.with_parameters(gravity=np.zeros_like(plant.parameters.values.get("gravity", 0.0)))
        relaxed = np.concatenate([x[:n], np.zeros(n), x[:n], np.zeros(n)])
        light = replace(problem, plant=weightless, pose=None, equilibrium=(relaxed, np.zeros_like(u)))
        return GravityCompensatedLQR(
            plant=plant,
            equilibrium=(x, u),
            integrate=problem.integrate,
            gains=lqr_gain(light, effort),
            gravity=gravity,
        )

    @cached_property
    def joints(self) -> ElasticJoints:
        """The joints' numbers at the equilibrium."""
        return elastic_joints(self.plant, *self.equilibrium)

    @cached_property
    def _weight(self) -> GravityTorque:
        return GravityTorque(self.plant, self.gravity)

    @property
    def numbers(self) -> np.ndarray:
        """Gain, stiffness, torque per input, and the plant's parameters."""
        joints, p = self.joints, self.plant.parameters.vector()
        return np.concatenate([self.gains.ravel(), joints.stiffness, joints.torque_per_input, p])

    @property
    def law_key(self) -> str:
        """The code of G."""
        return f"LQR with gravity compensation {self._weight.key}"

    def feedback(self, x: Any, state: Any, input: Any, numbers: Any) -> Any:
        """k (n,) for a deviation x from the reference, of any element."""
        n, end = len(self.input_names), self.gains.size
        gain = numbers[:end].reshape(n, -1)
        stiffness, per_input, p = (
            numbers[end : end + n],
            numbers[end + n : end + 2 * n],
            numbers[end + 2 * n :],
        )
        states = self.plant.n
        torque, rate = self._weight.torque_and_rate(state[:n] + x[:n], state[n : 2 * n] + x[n : 2 * n], p)
        torque_d, rate_d = self._weight.torque_and_rate(state[:n], state[n : 2 * n], p)
        held, moving = torque - torque_d, rate - rate_d
        motor, speed = x[2 * n : 3 * n] - held / stiffness, x[3 * n : states] - moving / stiffness
        return held / per_input + gain @ np.concatenate([x[: 2 * n], motor, speed, x[states:]])
