"""The problem of a design, with the channels of the tolerances and without.

Weights from a target frequency per joint and a damping weight, scaled by what each motor moves.

For a motor that moves the inertia M + J against a damping d, uᵀu costs as much as (w q)² at the angular frequency ω if
w = |(M + J) ω² − i d ω| per unit of input. So R2 = 1, and each joint has

    w_position = ω √((M + J)² ω² + d²) / k,   w_velocity = w_position / 2ω,   w_integral = w_position ω / 2

with k the torque per unit of input, all at the goal pose. The vibration has a weight of its own, on the rate of the
spring's torque: a spring between M and J alone, its motor paid with uᵀu, gets the damping ratio ζ from a weight
2 ζ ω_v J/k on the rate of its twist, ω_v² = K (1/M + 1/J); on the rate of its torque that is

    w_torque_rate = 2 ζ ω_v J / (k K).

It hardly touches the slow motion. A rigid joint has M + J in one, no vibration, and the weights of both velocities on
its link's. The search is over the target frequency ω of each joint and one damping weight ζ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis import LinearCorners
from flexhinf.design.modes import stiffness_and_inertia
from flexhinf.design.specification import Specification
from flexhinf.design.weights.linear_family import Families, LinearFamily, LinearProblem
from flexhinf.design.weights.robust import (
    PREFIX,
    Channel,
    RobustProblem,
    Scalings,
    dissipation_of,
    with_channels,
)
from flexhinf.design.weights.search import SearchResult, TargetBehaviour
from flexhinf.plant import GeneralisedPlant, Penalty
from flexhinf.robot.elastic import Layout

#: Weight of the integral over that of the position times ω; weight of the velocities over that of the position per ω.
INTEGRAL_WEIGHT, VELOCITY_WEIGHT = 0.5, 0.5


#: All joints have a spring, however many there are.
EVERY = Layout(0)


@dataclass(frozen=True, eq=False)
class JointScales:
    """What weights are scaled by, at a pose.

    Attributes
    ----------
    stiffness, link_inertia, motor_inertia : (n,)
        K, M, J of each joint; M is the diagonal of the links' inertia at the pose.
    damping : (n,)
        Of each motor, back-EMF included, N·m·s/rad.
    per_input : (n,)
        Torque per unit of input.
    held : float
        Lowest frequency at which the links vibrate while the motors are held, rad/s.
    layout : Layout, optional
        Which joints have a spring, all by default; of the others K is infinite, J zero and part of M.
    """

    stiffness: np.ndarray
    link_inertia: np.ndarray
    motor_inertia: np.ndarray
    damping: np.ndarray
    per_input: np.ndarray
    held: float
    layout: Layout = EVERY

    def __post_init__(self) -> None:
        if self.layout is EVERY:
            object.__setattr__(self, "layout", Layout(len(self.stiffness)))

    @staticmethod
    def of(plant: Any, equilibrium: tuple[np.ndarray, np.ndarray]) -> JointScales:
        """Of a robot's plant at equilibrium."""
        stiffness, inertia = stiffness_and_inertia(plant, equilibrium)
        layout = Layout.of(plant.states)
        n, elastic = layout.n, layout.elastic
        a, b, _, _ = plant.linearise(*equilibrium)
        motors, links = np.diag(inertia)[n:], inertia[:n, :n]
        free = links[np.ix_(elastic, elastic)]
        held = np.linalg.eigvals(np.linalg.solve(free, np.diag(stiffness[elastic]))).real.min()
        rows = slice(2 * n + len(elastic), layout.mechanical)
        damping, per_input = (
            layout.motors(np.diag(links @ of_links), np.diag(of_motors) * motors[elastic])
            for of_links, of_motors in (
                (-a[n : 2 * n, n : 2 * n], -a[rows, rows]),
                (b[n : 2 * n], b[rows][:, elastic]),
            )
        )
        return JointScales(
            stiffness, np.diag(links), motors, damping, np.abs(per_input), float(np.sqrt(held)), layout
        )

    @property
    def vibration(self) -> np.ndarray:
        """ω_v (n,), rad/s; of a rigid joint, which does not vibrate, the slowest of the others."""
        elastic, found = self.layout.elastic, np.zeros(self.layout.n)
        links, motors = self.link_inertia[elastic], self.motor_inertia[elastic]
        found[elastic] = np.sqrt(self.stiffness[elastic] * (1.0 / links + 1.0 / motors))
        return np.where(found > 0.0, found, found[elastic].min())

    @property
    def sides(self) -> tuple[np.ndarray, np.ndarray]:
        """Inertia before and behind each spring (n,); of a rigid joint half of its own each."""
        both = self.link_inertia, self.motor_inertia
        rigid = self.motor_inertia == 0.0
        return tuple(np.where(rigid, 0.5 * (both[0] + both[1]), side) for side in both)  # type: ignore[return-value]

    def weights(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> dict[str, np.ndarray]:
        """Weight by name, (n,), or (e,) of what elastic joints have.

        Parameters
        ----------
        target_frequency : (n,)
            ω of each joint, rad/s.
        damping : float or (n,)
            ζ, of all joints or of each; 0 leaves the rates of the springs' torques free.
        """
        total = self.link_inertia + self.motor_inertia
        position = target_frequency * np.hypot(total * target_frequency, self.damping) / self.per_input
        velocity = VELOCITY_WEIGHT * position / target_frequency
        elastic, both = self.layout.elastic, np.ones(len(velocity))
        both[list(self.layout.rigid)] = np.sqrt(2.0)
        motors, per_input = self.motor_inertia[elastic], self.per_input[elastic]
        ratio = np.broadcast_to(damping, len(velocity))[elastic]
        twist_rate = 2.0 * ratio * self.vibration[elastic] * motors / per_input
        return {
            "link_position": position,
            "link_velocity": both * velocity,
            "motor_velocity": velocity[elastic],
            "joint_torque_rate": twist_rate / self.stiffness[elastic],
            "link_position_integral": INTEGRAL_WEIGHT * position * target_frequency,
        }

    def rows(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> np.ndarray:
        """h(x) = C x of the same weights, for (q1, q̇1, q2, q̇2, ∫); without rows of zeros."""
        n, e, w = self.layout.n, len(self.layout.elastic), self.weights(target_frequency, damping)
        ends = np.cumsum([0, n, n, e, e, n])
        own = [slice(*ends[k : k + 2]) for k in range(5)]
        rows = np.zeros((ends[-1], ends[-1]))
        names = "link_position", "link_velocity", "", "motor_velocity", "link_position_integral"
        for place, name in zip(own, names):
            if name:
                np.fill_diagonal(rows[place, place], w[name])
        rate = np.diag(w["joint_torque_rate"] * self.stiffness[self.layout.elastic])
        rows[own[2], n + np.array(self.layout.elastic)], rows[own[2], own[3]] = -rate, rate
        return rows[np.any(rows != 0.0, axis=1)]

    def penalty(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> Penalty:
        """The same as a penalty of the robot with R2 = 1."""
        named = {
            name: weight.tolist() if len(weight) > 1 else float(weight[0])
            for name, weight in self.weights(np.asarray(target_frequency, dtype=float), damping).items()
            if np.any(weight)
        }
        return Penalty(named, 1.0)


def nominal_problem(robot: Any, goal: np.ndarray, s: Specification, penalty: Penalty) -> GeneralisedPlant:
    """The problem of a penalty about a goal (n,), without channels of the tolerances."""
    return robot.problem(
        penalty, pose=goal, measured=s.measured, command=command_of(s), disturbances=s.disturbances
    )


def command_of(s: Specification) -> str | None:
    """How the command enters the problem: as a disturbance, or not."""
    return "disturbance" if s.command or s.disturbances is None else None


@dataclass(frozen=True, eq=False)
class Robustness:
    """What the channels of the tolerances cost and cover.

    Attributes
    ----------
    fraction : float
        Of the tolerances, that the channels stand for.
    gamma_star : float
        Smallest level for every robot within that fraction.
    nominal_gamma_star : float
        Of the same penalty without tolerances.
    nominal_gain, robust_gain : float
        Level that the nominal robot attains (linear part) with the gain made without channels, and with them.
    scalings : mapping of str to (float, float)
        Smallest and largest s of the channels of each quantity.
    enlarged : float
        Factor by which the tolerances of the channels were enlarged, so that products of tolerances are covered too.
    corners, failing_corners : int
        Corners of the tolerances at which the inequality of the linear part was checked, each at its own equilibrium,
        and how many of them break it: with any, each tolerance alone is covered, and not all of them together.
    all_corners : bool
        Whether these are all corners; otherwise they are sampled.
    """

    fraction: float
    channels: int
    gamma_star: float
    nominal_gamma_star: float
    nominal_gain: float
    robust_gain: float
    scalings: Mapping[str, tuple[float, float]]
    enlarged: float
    corners: int
    failing_corners: int
    all_corners: bool


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """What is solved, and who states it.

    Attributes
    ----------
    preset : {"paper", "damped", "robust", "given"}
    penalty : Penalty
        In the robot's names.
    problem : GeneralisedPlant
        What is solved, about the goal.
    nominal : GeneralisedPlant
        The same without channels of the tolerances.
    target, search : TargetBehaviour, SearchResult or None
        What weights were searched for, and how; of a preset that searches.
    families : Families or None
        Of the robot within its tolerances, for which weights were searched.
    covering : Covering or None
        What the channels of the tolerances are made of; of the preset robust.
    """

    preset: str
    penalty: Penalty
    source: str
    effort_source: str
    problem: GeneralisedPlant
    nominal: GeneralisedPlant
    gamma_star: float
    gamma: float
    target: TargetBehaviour | None = None
    search: SearchResult | None = None
    robustness: Robustness | None = None
    families: Families | None = None
    covering: Covering | None = None


# Channels of the tolerances ------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Covering:
    """What problems with channels of the tolerances are made of: of any weights, for any fraction of the tolerances.

    Attributes
    ----------
    torques : (2 joints, k) or None
        Which torques at links and motors are physical disturbances.
    scalings : Scalings
        Of the channels, with the fraction of the tolerances for which there is a solution.
    corners : LinearCorners
        At which the inequality of the linear part is checked.
    enlarged : float
        Factor of all tolerances, so that their products are covered too.
    """

    robot: Any
    goal: np.ndarray
    s: Specification
    scales: JointScales
    family: LinearFamily
    torques: np.ndarray | None
    tolerances: tuple[Channel, ...]
    scalings: Scalings
    corners: LinearCorners
    enlarged: float = 1.0

    def linear(self, target_frequency: np.ndarray, damping: np.ndarray) -> RobustProblem:
        """The linear problem of the weights for ω (n,) and ζ (n,)."""
        rows = self.scales.rows(target_frequency, damping)
        nominal = LinearProblem.of(self.family, rows, command_of(self.s) is not None, self.torques)
        return RobustProblem(nominal, self.family.torques, self.tolerances)

    def channels_at(self, fraction: float) -> Scalings:
        """Scalings for a fraction of what is covered at most."""
        return replace(self.scalings, fraction=fraction * self.enlarged * self.scalings.fraction)

    def problem(
        self, target_frequency: np.ndarray, damping: np.ndarray, fraction: float, accuracy: float = 1e-6
    ) -> ChannelledProblem:
        """The nonlinear problem, its smallest level found to an accuracy.

        Raises
        ------
        NoFeasibleGamma
            If no level does.
        """
        linear, scalings = self.linear(target_frequency, damping), self.channels_at(fraction)
        star = linear.gamma_star(scalings, accuracy)
        gamma = self.s.gamma_ratio * star
        enter, seen, price = linear.parts(scalings)
        base = self.scales.penalty(target_frequency, damping)
        nominal = nominal_problem(self.robot, self.goal, self.s, base)
        rows = np.vstack([self.scales.rows(target_frequency, damping), seen])
        physical = (nominal.disturbances or ()) if self.s.disturbances is not None else ()
        names = tuple(f"{PREFIX}_{k + 1}" for k in range(enter.shape[1]))
        problem = with_channels(nominal.plant, gamma * enter).with_objective(
            Penalty(rows, nominal.r2 + price),
            command=command_of(self.s),
            integrate=nominal.integrate,
            disturbances=(*physical, *names),
            equilibrium=self.robot.operating_point(self.goal),
        )
        return ChannelledProblem(self, linear, scalings, base, nominal, problem, star, gamma)


@dataclass(frozen=True, eq=False)
class ChannelledProblem:
    """A nonlinear problem with channels for a fraction of the tolerances.

    Attributes
    ----------
    covering, linear, scalings
        What it was made of.
    penalty, nominal
        Without the channels.
    """

    covering: Covering
    linear: RobustProblem
    scalings: Scalings
    penalty: Penalty
    nominal: GeneralisedPlant
    problem: GeneralisedPlant
    gamma_star: float
    gamma: float

    def checked(self, target: TargetBehaviour, found: SearchResult, source: str) -> DesignProblem:
        """The problem of a design, its inequality checked at the corners of the tolerances."""
        covering, linear, enlarged = self.covering, self.linear, self.covering.enlarged
        checked = dissipation_of(covering.corners, self.nominal, self.problem, self.gamma)
        lowest = linear.nominal.gamma_star()
        plain = linear.nominal.design(covering.s.gamma_ratio * lowest, lowest)
        robustness = Robustness(
            self.scalings.fraction / enlarged,
            len(linear.channels),
            self.gamma_star,
            lowest,
            linear.nominal.attained(plain.gain),
            linear.nominal.attained(self.gain),
            self._by_quantity,
            enlarged,
            checked.count,
            checked.failing,
            checked.complete,
        )
        return DesignProblem(
            "robust", self.penalty, source, "ours", self.problem, self.nominal, self.gamma_star, self.gamma, target,
            found, robustness, covering=covering,
        )  # fmt: skip

    @cached_property
    def gain(self) -> np.ndarray:
        """K (m, n) of the linear law."""
        return self.linear.scaled(self.gamma, self.scalings).design(self.gamma, self.gamma_star).gain

    @property
    def _by_quantity(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest s of the channels of each quantity."""
        values: dict[str, list[float]] = {}
        for channel, log in zip(self.linear.channels, self.scalings.log):
            values.setdefault("_by_".join(channel.group), []).append(float(np.exp(log)))
        return {group: (min(found), max(found)) for group, found in values.items()}
