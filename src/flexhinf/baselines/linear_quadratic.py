"""LQR of a problem's linear part: the problem's own weights, and no disturbance thought of (γ = ∞).

LQR with the weight compensated exactly, through the springs: what a practitioner would try before any H∞.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.baselines.equilibrium_law import (
    EquilibriumLaw,
    PlacedLaw,
    check_joints,
    equilibrium_of,
)
from flexhinf.errors import NumericalFailure
from flexhinf.plant import GeneralisedPlant
from flexhinf.validation import checked_array, checked_positive, read_only

#: Pole of the integral, in bandwidths: slow beside the pair that it stands with.
INTEGRAL_RATE = 0.2


def lqr_gain(problem: GeneralisedPlant, effort: float = 1.0) -> np.ndarray:
    """K (m, n) of u = K x that minimises ½∫ hᵀh + uᵀ R2 u for the problem's linear part.

    K = −R2⁻¹ Bᵀ P with AᵀP + PA + HᵀH − P B R2⁻¹ Bᵀ P = 0 [anderson1990].

    `effort`: factor of R2, the one tuning parameter of an LQR: the larger, the less effort; refused if not positive. A
    NumericalFailure says that there is no stabilising solution: a mode that the input does not move or the penalty does
    not see.
    """
    from scipy.linalg import solve_continuous_are

    linear = problem.expand(1)
    a, b, h = linear.f_parts[1], linear.g2_parts[0][:, :, 0], linear.h_parts[1]
    r2 = checked_positive("The factor of the effort", effort, "a number", "effort=1.0") * problem.r2
    try:
        p = solve_continuous_are(a, b, h.T @ h, r2)
        gain = -np.linalg.solve(r2, b.T @ p)
        slowest = float(np.linalg.eigvals(a + b @ gain).real.max())
        if slowest < 0.0:
            return read_only(gain)
        got = f"closed loop with a mode at {slowest:.3g} 1/s"
    except np.linalg.LinAlgError as error:
        got = str(error)
    raise NumericalFailure(
        "The problem has no LQR.",
        f"expected a stabilising solution of the Riccati equation for {list(problem.state_names)}, got: {got}",
        "a weight on every integral and on one position of each joint",
    )


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LinearQuadratic(EquilibriumLaw):
    """u = u* + K (x − x*). The gain is data, so all such laws of one size share their code.

    `gain` (m, n): K, integrals included.
    """

    gain: Any

    def __post_init__(self) -> None:
        super().__post_init__()
        check_gain(self)

    @property
    def law_data(self) -> np.ndarray:
        """K, flat."""
        return self.gain.ravel()

    @property
    def law_key(self) -> str:
        """One text for all numbers."""
        return "linear feedback"

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """K x on any element."""
        return data.reshape(len(self.input_names), -1) @ x


def lqr(problem: GeneralisedPlant, effort: float = 1.0) -> LinearQuadratic:
    """The LQR of a problem, of any plant; see `lqr_gain`."""
    gain, rest = lqr_gain(problem, effort), equilibrium_of(problem)
    return LinearQuadratic(plant=problem.plant, equilibrium=rest, integrate=problem.integrate, gain=gain)


def check_gain(law: Any) -> None:
    """Make the gain of a law a finite array (m, n), or refuse it."""
    shape = len(law.input_names), len(law.state_names)
    advice = "one row per input and one column per state, integrals included"
    what, expected = "The gain does not fit the law's states and inputs.", f"finite numbers of shape {shape}"
    object.__setattr__(law, "gain", checked_array(what, law.gain, shape, expected, advice))


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GravityCompensatedLQR(PlacedLaw):
    """κ(x) = k_u⁻¹ G(q) + K (q, q̇, θ − K_s⁻¹ G(q), θ̇ − K_s⁻¹ Ġ(q), e): the LQR of the weightless robot, and its weight.

    At link positions q the weight G(q) is held by the springs, wound up by K_s⁻¹ G(q), and by the inputs; the gain
    acts on the motors relative to that wind-up, which itself moves at the rate K_s⁻¹ ∂G/∂q q̇. About a reference,
    k = κ(x_d + δ) − κ(x_d), so every pose held is an equilibrium.

    `gain` (n, states): K, of the weightless robot.
    """

    gain: Any

    def __post_init__(self) -> None:
        super().__post_init__()
        check_joints(self.plant)
        check_gain(self)

    @staticmethod
    def design(problem: GeneralisedPlant, effort: float = 1.0) -> GravityCompensatedLQR:
        """The LQR of the robot with g = 0 at the same pose, for the same penalty, and the weight of the robot; `effort`
        as of `lqr_gain`.

        A plant without elastic joints or a parameter ``gravity`` (m/s²) is refused.
        """
        plant, (x, u) = problem.plant, equilibrium_of(problem)
        n = check_joints(plant)
        weightless = plant.with_parameters(gravity=np.zeros_like(plant.parameters.values.get("gravity", 0.0)))
        relaxed = np.concatenate([x[:n], np.zeros(n), x[:n], np.zeros(n)])
        light = replace(problem, plant=weightless, pose=None, equilibrium=(relaxed, np.zeros_like(u)))
        gain = lqr_gain(light, effort)
        return GravityCompensatedLQR(plant=plant, equilibrium=(x, u), integrate=problem.integrate, gain=gain)

    @property
    def numbers(self) -> np.ndarray:
        """Gain, stiffness, torque per input, and the plant's parameters."""
        joints, p = self.joints, self.plant.parameters.vector()
        return np.concatenate([self.gain.ravel(), joints.stiffness, joints.torque_per_input, p])

    @property
    def law_key(self) -> str:
        """The code of G."""
        return f"LQR with gravity compensation {self._weight.key}"

    def feedback(self, x: Any, state: Any, input: Any, numbers: Any) -> Any:
        """k (n,) for a deviation x from the reference, of any element."""
        n, end = len(self.input_names), self.gain.size
        gain, states = numbers[:end].reshape(n, -1), self.plant.n
        stiffness, per_input, p = np.split(numbers[end:], [n, 2 * n])
        torque, rate = self._weight.torque_and_rate(state[:n] + x[:n], state[n : 2 * n] + x[n : 2 * n], p)
        torque_d, rate_d = self._weight.torque_and_rate(state[:n], state[n : 2 * n], p)
        held, moving = torque - torque_d, rate - rate_d
        motor, speed = x[2 * n : 3 * n] - held / stiffness, x[3 * n : states] - moving / stiffness
        return held / per_input + gain @ np.concatenate([x[: 2 * n], motor, speed, x[states:]])
