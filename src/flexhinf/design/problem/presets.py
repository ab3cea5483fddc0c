"""The problem of a design, with the channels of the tolerances and without.

The problem of a specification: penalty with its source, disturbances and level, by preset.

========  ========================================================================================================
preset    penalty
========  ========================================================================================================
paper     the robot's own; for a robot that states none, the form of Eq. (11): positions and their integrals alone
damped    found for a bandwidth and a damping, see `flexhinf.design.problem.weights`
robust    the same, and every uncertain parameter a disturbance channel, see `flexhinf.design.problem.channels`
given     the penalty of the specification
========  ========================================================================================================

Without a preset: `given` with weights; `damped` with a bandwidth or a damping, or where the robot states no penalty of
its own; otherwise `paper`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis import LinearCorners
from flexhinf.design.problem.channels import (
    PREFIX,
    Channel,
    RobustProblem,
    Scalings,
    acting_corners,
    channels,
    covering_products,
    dissipation_of,
    find_scalings,
    with_channels,
)
from flexhinf.design.problem.modes import JointScales
from flexhinf.design.problem.weights import (
    DampingOutOfReach,
    Families,
    LinearDesign,
    LinearFamily,
    LinearProblem,
    SearchResult,
    TargetBehaviour,
    search,
    worst_members,
)
from flexhinf.design.specification import RINGS, Specification
from flexhinf.errors import InvalidInput
from flexhinf.hinf import smallest_gamma
from flexhinf.plant import GeneralisedPlant, Penalty
from flexhinf.robot import Robot


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
    covering : ToleranceChannels or None
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
    covering: ToleranceChannels | None = None


# Channels of the tolerances ------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class ToleranceChannels:
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

    covering: ToleranceChannels
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


#: Most turns in which a default damping yields to what weights reach.
YIELDS = 4

#: Default bandwidth over the lowest frequency at which the links vibrate while the motors are held; default damping.
BANDWIDTH_FRACTION, DAMPING = 0.3, 0.2


def preset_of(robot: Robot, s: Specification) -> str:
    """The preset that is meant.

    Raises
    ------
    InvalidInput
        If the specification contradicts itself.
    """
    behaviour = [f"`{name}`" for name in ("bandwidth", "damping") if getattr(s, name) is not None]
    weights = [f"`{name}`" for name in ("penalty", "effort") if getattr(s, name) is not None]
    if behaviour and weights:
        raise _contradiction(f"{behaviour[0]} and {weights[0]}", "leave out one of them")
    if s.preset in ("damped", "robust", "proved") and weights:
        raise _contradiction(f"preset={s.preset!r} and {weights[0]}", f"leave out {weights[0]}, or `preset`")
    if s.preset == "paper" and (behaviour or s.penalty is not None):
        other = (behaviour or ["`penalty`"])[0]
        advice = "preset='damped'" if behaviour else "leave out `preset`"
        raise _contradiction(f"preset='paper' and {other}", advice)
    if s.preset is not None:
        return s.preset
    if s.penalty is not None:
        return "given"
    return "damped" if behaviour or (robot.penalty is None and s.effort is None) else "paper"


def required_damping(s: Specification, target: TargetBehaviour | None = None) -> float:
    """Damping ratio that every oscillation must have, where weights are searched for: as stated, or `DAMPING`, or less
    where a design that states none was given less, see `flexhinf.design.synthesis.steps`; then at least `RINGS`."""
    if s.damping is not None:
        return s.damping
    return DAMPING if target is None else max(RINGS, min(DAMPING, target.damping))


def _contradiction(both: str, advice: str) -> InvalidInput:
    return InvalidInput(
        f"{both} contradict each other.",
        "expected either weights, or a behaviour for which weights are found, or the preset paper; got both",
        advice,
    )


def choose(
    robot: Robot, goal: np.ndarray, start: np.ndarray, s: Specification, near: DesignProblem | None = None
) -> DesignProblem:
    """The problem of a specification.

    A default damping that no weights reach yields to what they reach; the loop is judged by `required_damping`.

    Parameters
    ----------
    near : DesignProblem, optional
        Of the same robot and preset for another bandwidth or damping, from whose weights the search begins.

    Raises
    ------
    InvalidInput
        For a contradiction, or a behaviour that cannot be met: which limit binds, and the best found.
    InfeasibleGamma, NoFeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        As the synthesis.
    """
    preset = preset_of(robot, s)
    if preset in ("damped", "robust", "proved"):
        families = Families(robot, goal, s.period) if near is None or near.families is None else near.families
        begun, tried = None if near is None else near.search, s
        for turn in range(YIELDS + 1):  # a second search looks at more corners, and may ask for another turn
            try:
                return replace(_searched(families, start, tried, preset, begun), families=families)
            except DampingOutOfReach as refused:
                if s.damping is not None or not refused.reached or turn == YIELDS:
                    raise
                begun, tried = None, replace(s, damping=refused.reached)
    penalty, source, priced = _stated(robot, goal, s)
    problem = nominal_problem(robot, goal, s, penalty)
    star = smallest_gamma(problem)
    return DesignProblem(preset, penalty, source, priced, problem, problem, star, s.gamma_ratio * star)


def measured_problem(robot: Robot, goal: np.ndarray, s: Specification) -> GeneralisedPlant:
    """The problem of which a gain is proved for all tolerances, the same for all laws.

    Its penalty is the checked one; else the robot's own; else that of Eq. (11), scaled to the robot.
    """
    return nominal_problem(robot, goal, s, _stated(robot, goal, replace(s, penalty=s.checked_penalty))[0])


def _stated(robot: Robot, goal: np.ndarray, s: Specification) -> tuple[Penalty, str, str]:
    """A penalty that is stated, with the sources of its weights and of R2."""
    own = robot.penalty
    if s.penalty is not None:
        penalty, source, priced = Penalty.of(s.penalty), "option --penalty", "ours"
        if isinstance(s.penalty, Penalty):
            priced = source
        elif own is not None:
            penalty, priced = replace(penalty, effort=own.effort), "the robot's file"
    elif own is not None:
        penalty, source, priced = own, "the robot's file", "the robot's file"
    else:
        scales = JointScales.of(robot.plant(), robot.operating_point(goal))
        weights = scales.weights(np.full(len(goal), BANDWIDTH_FRACTION * scales.held), 0.0)
        kept = ("link_position", "link_position_integral")
        penalty = Penalty({name: _number(weights[name]) for name in kept}, 1.0)
        source, priced = "ours: the form of Eq. (11), scaled to the robot", "ours"
    if s.effort is not None:
        penalty, priced = replace(penalty, effort=s.effort), "option --effort"
    return penalty, source, priced


def _number(values: np.ndarray) -> Any:
    return values.tolist() if len(values) > 1 else float(values[0])


def _searched(
    families: Families, start: np.ndarray, s: Specification, preset: str, near: SearchResult | None
) -> DesignProblem:
    robot, goal, family = families.robot, families.goal, families.few
    scales = JointScales.of(robot.plant(), robot.operating_point(goal))
    target = TargetBehaviour(_bandwidths(s, scales, len(goal)), required_damping(s))
    torques = None
    if s.disturbances is not None:
        names = nominal_problem(robot, goal, s, scales.penalty(target.bandwidth, 0.0)).disturbances or ()
        every = robot.plant().disturbances
        torques = np.eye(len(every))[:, [every.index(name) for name in names]]

    def nominal(target_frequency: np.ndarray, damping: np.ndarray) -> LinearProblem:
        return LinearProblem.of(
            family, scales.rows(target_frequency, damping), command_of(s) is not None, torques
        )

    def synthesis(target_frequency: np.ndarray, damping: np.ndarray) -> LinearDesign:
        linear = nominal(target_frequency, damping)
        star = linear.gamma_star()
        return linear.design(s.gamma_ratio * star, star)

    found, family = _widened(families, target, family, synthesis, scales.held, near)
    source = f"found for {target.words}"
    if preset == "damped":
        penalty = scales.penalty(found.chosen.target_frequency, found.chosen.damping_weights)
        problem = nominal_problem(robot, goal, s, penalty)
        star = smallest_gamma(problem)
        return DesignProblem(
            preset, penalty, source, "ours", problem, problem, star, s.gamma_ratio * star, target, found
        )

    tolerances = tolerance_channels(robot, [goal, start])
    scalings = find_scalings(
        RobustProblem(_linear_problem(found, nominal), family.torques, tolerances), s.gamma_ratio
    )

    covering = ToleranceChannels(
        robot, goal, s, scales, family, torques, tolerances, scalings,
        acting_corners(robot, goal, nominal_problem(robot, goal, s, scales.penalty(target.bandwidth, 0.0))),
    )  # fmt: skip

    def covered(factor: float) -> DesignProblem:
        """With all tolerances enlarged by a factor."""
        larger = replace(covering, enlarged=factor)

        def robust_synthesis(target_frequency: np.ndarray, damping: np.ndarray) -> LinearDesign:
            return larger.linear(target_frequency, damping).design(s.gamma_ratio, larger.channels_at(1.0))

        found, _ = _widened(families, target, family, robust_synthesis, scales.held)
        source = f"found for {target.words}, beside the channels of the tolerances"
        return larger.problem(found.chosen.target_frequency, found.chosen.damping_weights, 1.0).checked(
            target, found, source
        )

    first = covered(1.0)
    if scalings.fraction < 1.0:
        return first
    return covering_products(first, covered, _failing)


def tolerance_channels(robot: Robot, poses: Sequence[np.ndarray]) -> tuple[Channel, ...]:
    """The channels of a robot's tolerances, each at that of the poses where it does most.

    Raises
    ------
    InvalidInput
        If there are none.
    """
    found = channels(robot, poses)
    if not found:
        raise InvalidInput(
            f"The robot {robot.name!r} states no tolerances that the preset robust could stand for.",
            "expected parameters with a tolerance that changes how the robot moves, got none",
            "tolerance = 10 beside a value in the robot's file, or preset='damped'",
        )
    return found


def _failing(made: DesignProblem) -> int:
    assert made.robustness is not None
    return made.robustness.failing_corners


def _widened(
    families: Families,
    target: TargetBehaviour,
    family: LinearFamily,
    synthesis: Any,
    held: float,
    near: SearchResult | None = None,
) -> tuple[SearchResult, LinearFamily]:
    """A search, and again with the worst of many corners among the members."""
    start = None if near is None else near.chosen
    if len(family.a) == 1:
        return search(target, family, synthesis, held, near=start), family
    found = search(target, family, synthesis, held, each=False) if near is None else near
    wider = family.with_members(families.many, worst_members(families.many, found.chosen.design.gain))
    return search(target, wider, synthesis, held, near=start), wider


def _linear_problem(found: SearchResult, nominal: Any) -> LinearProblem:
    return nominal(found.chosen.target_frequency, found.chosen.damping_weights)


def _bandwidths(s: Specification, scales: JointScales, joints: int) -> np.ndarray:
    required = BANDWIDTH_FRACTION * scales.held if s.bandwidth is None else s.bandwidth
    values = np.atleast_1d(np.asarray(required, dtype=float))
    if len(values) not in (1, joints):
        raise InvalidInput(
            "The bandwidths do not fit the joints.",
            f"expected one number or {joints}, got {values.tolist()}",
            "one bandwidth for all joints",
        )
    return np.broadcast_to(values, (joints,)).copy()
