"""Base of the laws to compare with: a plant, the equilibrium they are made for, and the integrated states.

Two laws are here: the LQR of a problem's linear part, which has the problem's own weights and no disturbance in mind
(γ = ∞), and the LQR with the weight compensated exactly, through the springs.
"""

# Not checked strictly: parts of SciPy, CasADi and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexhinf.arrays import Elements, Matrix, Vector
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.plant import GeneralisedPlant, Law, Plant
from flexhinf.plant.joints import ElasticJoints, GravityTorque, check_joints, elastic_joints
from flexhinf.scalars import jacobian
from flexhinf.validation import checked_array, checked_positive, read_only, real_array


def equilibrium_of(problem: GeneralisedPlant) -> tuple[np.ndarray, np.ndarray]:
    """(x*, u*) of a problem, (n,) and (m,) without integrals."""
    return problem.operating_point[: problem.plant.n], problem.operating_input


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class EquilibriumLaw(Law):
    """A `flexhinf.plant.Law` about an equilibrium (x*, u*), (n,) and (m,), of the plant that it was made from.

    `integrate` are states whose tracking error is integrated, single names or groups; ``NAME_integral`` are the last
    states. Names or shapes that do not fit the plant are refused.
    """

    plant: Plant
    equilibrium: tuple[Vector, Vector]
    integrate: Sequence[str] = ()

    def __post_init__(self) -> None:
        x, u = (real_array(part) for part in self.equilibrium)
        shapes = (self.plant.n,), (len(self.plant.inputs),)
        if (x.shape, u.shape) != shapes or not (np.all(np.isfinite(x)) and np.all(np.isfinite(u))):
            raise InvalidInput(
                "The equilibrium of the law does not fit its plant.",
                f"expected a finite state and input of shapes {shapes}, got {x.shape} and {u.shape}",
                "robot.operating_point(pose)",
            )
        integrate = self.plant.expanded(self.integrate)
        for name in integrate:
            self.plant.index(name)
        vars(self).update(
            equilibrium=read_only((x, u)),
            integrate=integrate,
            state_names=(*self.plant.states, *(f"{name}_integral" for name in integrate)),
            input_names=tuple(self.plant.inputs),
            operating_point=read_only(np.concatenate([x, np.zeros(len(integrate))])),  # with integrals
            operating_input=read_only(u),
        )

    @cached_property
    def slope(self) -> np.ndarray:
        """∂k/∂x at the equilibrium, (m, n)."""
        n, data = len(self.state_names), self.law_data
        return jacobian(self.evaluate_law, n, data.size, name="law")(np.zeros(n), data)[1]

    def closed_loop(self, plant: Plant | None = None) -> np.ndarray:
        """∂ẋ/∂x of a plant (its own by default) with this law at the equilibrium, the state fed back, (n, n)."""
        a, b, _, _ = (self.plant if plant is None else plant).linearise(*self.equilibrium)
        k, tracked = len(self.integrate), [self.plant.index(name) for name in self.integrate]
        moved = np.pad(a, ((0, 0), (0, k))) + b @ self.slope
        return np.vstack([moved, np.eye(len(self.state_names))[tracked]])


class PlacedLaw(EquilibriumLaw):
    """A law that depends on where it acts, not only on the deviation.

    `evaluate_about` is the law about any reference, to be written; `evaluate_law` is that about the equilibrium, which
    therefore is part of the law's numbers, behind all others.
    """

    @cached_property
    def joints(self) -> ElasticJoints:
        """The numbers of a robot's elastic joints at the equilibrium."""
        return elastic_joints(self.plant, *self.equilibrium)

    @cached_property
    def _weight(self) -> GravityTorque:
        return GravityTorque(self.plant)

    @property
    @abc.abstractmethod
    def numbers(self) -> np.ndarray:
        """Numbers of the law without its equilibrium, flat."""

    @abc.abstractmethod
    def evaluate_about(self, x: Elements, state: Elements, input: Elements, data: Elements) -> Elements:
        """k (m,) for a deviation x (n,), integrals last, from a reference state (n,) and its input (m,).

        The input of the plant is then input + k; k = 0 for x = 0.
        """

    @property
    def law_data(self) -> np.ndarray:
        """Numbers, then x* and u*, flat."""
        return np.concatenate([self.numbers, *self.equilibrium])

    def evaluate_law(self, x: Elements, data: Elements) -> Elements:
        """k(x), (m,), about the equilibrium."""
        inputs = len(self.input_names)
        return self.evaluate_about(x, data[-self.plant.n - inputs : -inputs], data[-inputs:], data)


#: Pole of the integral, in bandwidths: slow beside the pair that it stands with.
INTEGRAL_RATE = 0.2


#: Stands for no share of a load that an input holds: that of a drive of velocities that rejects its load.
NO_LOAD = 1e-20


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
        gain = -np.linalg.solve(r2, b.T @ solve_continuous_are(a, b, h.T @ h, r2))
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

    gain: Matrix

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = len(self.input_names), len(self.state_names)
        advice = "one row per input and one column per state, integrals included"
        what = "The gain does not fit the law's states and inputs."
        gain = checked_array(what, self.gain, shape, f"finite numbers of shape {shape}", advice)
        object.__setattr__(self, "gain", gain)

    @property
    def law_key(self) -> str:
        """One text for all numbers."""
        return "linear feedback"

    @property
    def law_data(self) -> np.ndarray:
        """K, flat."""
        return self.gain.ravel()

    def evaluate_law(self, x: Elements, data: Elements) -> Elements:
        """K x on any element."""
        return data.reshape(len(self.input_names), -1) @ x


def lqr(problem: GeneralisedPlant, effort: float = 1.0) -> LinearQuadratic:
    """The LQR of a problem, of any plant; see `lqr_gain`."""
    gain, equilibrium = lqr_gain(problem, effort), equilibrium_of(problem)
    return LinearQuadratic(
        plant=problem.plant, equilibrium=equilibrium, integrate=problem.integrate, gain=gain
    )


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GravityCompensatedLQR(PlacedLaw, LinearQuadratic):
    """κ(x) = k_u⁻¹ G(q) + K (q, q̇, θ − K_s⁻¹ G(q), θ̇ − K_s⁻¹ Ġ(q), e): the LQR of the weightless robot, and its weight.

    At link positions q the weight G(q) is held by the springs, wound up by K_s⁻¹ G(q), and by the inputs; the gain
    acts on the motors relative to that wind-up, which itself moves at the rate K_s⁻¹ ∂G/∂q q̇. About a reference,
    k = κ(x_d + δ) − κ(x_d), so every pose held is an equilibrium.

    `gain` (n, states): K, of the weightless robot.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        check_joints(self.plant)

    @staticmethod
    def design(problem: GeneralisedPlant, effort: float = 1.0) -> GravityCompensatedLQR:
        """The LQR of the robot with g = 0 at the same pose, for the same penalty, and the weight of the robot; `effort`
        as of `lqr_gain`.

        A plant without elastic joints or a parameter ``gravity`` (m/s²) is refused.
        """
        plant, (x, u), n = problem.plant, equilibrium_of(problem), check_joints(problem.plant)
        weightless = plant.with_parameters(gravity=np.zeros_like(plant.parameters.values.get("gravity", 0.0)))
        relaxed, joints = (
            np.concatenate([x[:n], np.zeros(n), x[:n], np.zeros(n)]),
            elastic_joints(plant, x, u),
        )
        still = (
            joints.drive_stiffness * x[:n] / joints.torque_per_input
        )  # the place, of a drive that takes positions
        light = replace(problem, plant=weightless, pose=None, equilibrium=(relaxed, still))
        gain = lqr_gain(light, effort)
        return GravityCompensatedLQR(plant=plant, equilibrium=(x, u), integrate=problem.integrate, gain=gain)

    @property
    def numbers(self) -> np.ndarray:
        """Gain, stiffness, weight that an input holds, and the plant's parameters."""
        joints, p = self.joints, self.plant.parameters.vector()
        share = np.maximum(joints.load_share + joints.drive_stiffness / joints.stiffness, NO_LOAD)
        return np.concatenate([self.gain.ravel(), joints.stiffness, joints.torque_per_input / share, p])

    @property
    def law_key(self) -> str:
        """Key of the law's code: that of G."""
        return f"LQR with gravity compensation {self._weight.key}"

    def evaluate_about(self, x: Elements, state: Elements, input: Elements, data: Elements) -> Elements:
        """k (n,) for a deviation x from the reference, of any element."""
        n, end, states = len(self.input_names), self.gain.size, self.plant.n
        gain = data[:end].reshape(n, -1)
        stiffness, per_input, p = np.split(data[end : -states - n], [n, 2 * n])
        torque, rate = self._weight.torque_and_rate(state[:n] + x[:n], state[n : 2 * n] + x[n : 2 * n], p)
        torque_d, rate_d = self._weight.torque_and_rate(state[:n], state[n : 2 * n], p)
        held, moving = torque - torque_d, rate - rate_d
        motor, speed = x[2 * n : 3 * n] - held / stiffness, x[3 * n : states] - moving / stiffness
        return held / per_input + gain @ np.concatenate([x[: 2 * n], motor, speed, x[states:]])
