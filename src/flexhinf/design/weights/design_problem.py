"""The problem of a design, with the channels of the tolerances and without."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis import LinearCorners
from flexhinf.design.specification import Specification
from flexhinf.design.weights.linear_family import Families, LinearFamily, LinearProblem
from flexhinf.design.weights.robust import PREFIX, RobustProblem, Scalings, with_channels
from flexhinf.design.weights.scales import JointScales
from flexhinf.design.weights.search import SearchResult, TargetBehaviour
from flexhinf.design.weights.uncertainty import Channel, dissipation_of
from flexhinf.plant import GeneralisedPlant, Penalty


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
