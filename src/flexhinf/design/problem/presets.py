"""The problem of a specification: penalty with its source, disturbances and level, by preset.

========  ========================================================================================================
preset    penalty
========  ========================================================================================================
paper     the robot's own; for a robot that states none, the form of Eq. (11): positions and their integrals alone
damped    searched for a bandwidth and a damping, see `flexhinf.design.problem.weights`
robust    the same, and every uncertain parameter a disturbance channel, see `flexhinf.design.problem.channels`
given     the penalty of the specification
========  ========================================================================================================

Without a preset: `given` with weights; `damped` with a bandwidth or a damping, or where the robot states no penalty of
its own; otherwise `paper`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from flexhinf.analysis import LinearCorners
from flexhinf.analysis.modes import JointScales
from flexhinf.design.problem.channels import (
    PREFIX,
    Channel,
    RobustProblem,
    Scalings,
    acting_corners,
    enlarge_tolerances,
    find_scalings,
    tolerance_channels,
    with_channels,
)
from flexhinf.design.problem.weights import (
    DampingOutOfReach,
    LinearDesign,
    LinearFamily,
    LinearProblem,
    SearchResult,
    TargetBehaviour,
    behaviour_of,
    search,
)
from flexhinf.design.specification import RINGS, Specification
from flexhinf.errors import InvalidInput
from flexhinf.hinf import linear_law, smallest_gamma
from flexhinf.plant import GeneralisedPlant, Penalty
from flexhinf.robot import Robot

#: Most turns in which a default damping yields to what weights reach.
YIELDS = 4

#: Default bandwidth over the lowest frequency at which the links vibrate while the motors are held; default damping.
BANDWIDTH_FRACTION, DAMPING = 0.3, 0.2


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
    """Tolerances that the channels cover, and the cost in γ and gain.

    The inequality of the linear part is checked at corners of the tolerances, each at its own equilibrium. Where some
    of them break it, each tolerance alone is covered, and not all of them together.
    """

    fraction: float  # of the tolerances, that the channels stand for
    channels: int
    gamma_star: float  # smallest level for every robot within that fraction
    nominal_gamma_star: float  # of the same penalty without tolerances
    nominal_gain: float  # level that the nominal robot attains (linear part) without channels
    robust_gain: float  # the same with channels
    scalings: Mapping[str, tuple[float, float]]  # smallest and largest s of the channels of each quantity
    enlarged: float  # factor on the tolerances, so that products of tolerances are covered too
    corners: int  # corners that were checked
    failing_corners: int
    all_corners: bool  # whether these are all corners; otherwise they are sampled


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """The problem that is solved about the goal, and who states it."""

    preset: str  # paper, damped, robust, proved or given
    penalty: Penalty  # in the robot's names
    source: str
    effort_source: str
    problem: GeneralisedPlant
    nominal: GeneralisedPlant  # the same without channels of the tolerances
    gamma_star: float
    gamma: float
    target: TargetBehaviour | None = None  # behaviour that weights were searched for
    search: SearchResult | None = None  # of the weights
    robustness: Robustness | None = None
    family: LinearFamily | None = None  # the robots for which weights were searched
    channels: ToleranceChannels | None = None  # of the preset robust


@dataclass(frozen=True, eq=False)
class ToleranceChannels:
    """The channels of the tolerances, from which the problem of any weights and any fraction of them is made."""

    s: Specification
    scales: JointScales
    family: LinearFamily
    torques: np.ndarray | None  # (2 joints, k), which torques at links and motors are physical disturbances
    tolerances: tuple[Channel, ...]
    scalings: Scalings  # with the fraction of the tolerances for which there is a solution
    corners: LinearCorners  # at which the inequality of the linear part is checked
    enlarged: float = 1.0  # factor of all tolerances, so that their products are covered too

    def linear(self, target_frequency: np.ndarray, damping: np.ndarray) -> RobustProblem:
        """The linear problem of the weights for ω (n,) and ζ (n,)."""
        rows = self.scales.rows(target_frequency, damping)
        nominal = LinearProblem.of(self.family, rows, command_of(self.s) is not None, self.torques)
        return RobustProblem(nominal, self.family.torques, self.tolerances)

    def scaled(self, fraction: float) -> Scalings:
        """Scalings for a fraction of the largest tolerances that the channels can cover."""
        return replace(self.scalings, fraction=fraction * self.enlarged * self.scalings.fraction)

    def problem(
        self, target_frequency: np.ndarray, damping: np.ndarray, fraction: float, accuracy: float = 1e-6
    ) -> DesignProblem:
        """The nonlinear problem with channels for a fraction of the tolerances, its smallest level to an accuracy.

        Raises `NoFeasibleGamma` if no level does.
        """
        robot, goal, weights = self.family.robot, self.family.goal, (target_frequency, damping)
        linear, scalings, base = self.linear(*weights), self.scaled(fraction), self.scales.penalty(*weights)
        star = linear.gamma_star(scalings, accuracy)
        gamma, (enter, seen, price) = self.s.gamma_ratio * star, linear.parts(scalings)
        nominal = nominal_problem(robot, goal, self.s, base)
        physical = (nominal.disturbances or ()) if self.s.disturbances is not None else ()
        problem = with_channels(nominal.plant, gamma * enter).with_objective(
            Penalty(np.vstack([self.scales.rows(*weights), seen]), nominal.r2 + price),
            command=command_of(self.s),
            integrate=nominal.integrate,
            disturbances=(*physical, *(f"{PREFIX}_{k + 1}" for k in range(enter.shape[1]))),
            equilibrium=robot.operating_point(goal),
        )
        return DesignProblem("robust", base, "", "ours", problem, nominal, star, gamma, channels=self)

    def design(
        self, problem: DesignProblem, target_frequency: np.ndarray, damping: np.ndarray, fraction: float
    ) -> LinearDesign:
        """The linear law of a `problem` of these weights and this fraction."""
        linear = self.linear(target_frequency, damping).scaled(problem.gamma, self.scaled(fraction))
        return linear.design(problem.gamma, problem.gamma_star)

    def checked(
        self,
        problem: DesignProblem,
        fraction: float,
        target: TargetBehaviour,
        result: SearchResult,
        source: str,
    ) -> DesignProblem:
        """A `problem` of the chosen weights and this fraction, its inequality checked at corners of the tolerances."""
        weights, scalings = result.chosen.weights, self.scaled(fraction)
        nominal, law = self.linear(*weights).nominal, linear_law(problem.problem, problem.gamma)
        # The inequality with d and z of the nominal problem, for the linear law of the robust one.
        check = replace(self.corners, problem=problem.nominal).dissipation(law.P, law.gain, problem.gamma)
        plain, own = nominal.design_at(self.s.gamma_ratio), self.design(problem, *weights, fraction)
        by_quantity: dict[str, list[float]] = {}
        for channel, log in zip(self.tolerances, scalings.log):
            by_quantity.setdefault("_by_".join(channel.group), []).append(float(np.exp(log)))
        robustness = Robustness(
            scalings.fraction / self.enlarged, len(self.tolerances), problem.gamma_star, plain.gamma_star,
            nominal.attained(plain.gain), nominal.attained(own.gain),
            {group: (min(each), max(each)) for group, each in by_quantity.items()}, self.enlarged,
            check.count, check.failing, check.complete,
        )  # fmt: skip
        return replace(problem, source=source, target=target, search=result, robustness=robustness)


# From a specification to its problem --------------------------------------------------------------------
def preset_of(robot: Robot, s: Specification) -> str:
    """The preset of a specification. Raises `InvalidInput` if the specification contradicts itself."""
    behaviour, weights = (
        next((f"`{name}`" for name in names if getattr(s, name) is not None), "")
        for names in (("bandwidth", "damping"), ("penalty", "effort"))
    )
    searched, paper = s.preset in ("damped", "robust", "proved"), s.preset == "paper"
    for contradicts, both, advice in (
        (behaviour and weights, f"{behaviour} and {weights}", "leave out one of them"),
        (searched and weights, f"preset={s.preset!r} and {weights}", f"leave out {weights}, or `preset`"),
        (paper and behaviour, f"preset='paper' and {behaviour}", "preset='damped'"),
        (paper and s.penalty is not None, "preset='paper' and `penalty`", "leave out `preset`"),
    ):
        if contradicts:
            other = "a behaviour for which weights are found, or the preset paper; got both"
            raise InvalidInput(
                f"{both} contradict each other.", f"expected either weights, or {other}", advice
            )
    default = "damped" if behaviour or (robot.penalty is None and s.effort is None) else "paper"
    return s.preset or ("given" if s.penalty is not None else default)


def required_damping(s: Specification, target: TargetBehaviour | None = None) -> float:
    """Damping ratio that every oscillation must have, where weights are searched for: as stated, or `DAMPING`, or less
    where a design that states none was given less, see `flexhinf.design.synthesis.steps`; then at least `RINGS`."""
    if s.damping is not None:
        return s.damping
    return DAMPING if target is None else max(RINGS, min(DAMPING, target.damping))


def choose(
    robot: Robot, goal: np.ndarray, start: np.ndarray, s: Specification, near: DesignProblem | None = None
) -> DesignProblem:
    """The problem of a specification; a search begins at `near`, weights of this robot for another behaviour.

    A default damping that no weights reach yields to what they reach; the loop is judged by `required_damping`. Raises
    `InvalidInput` for a contradiction, or a behaviour that cannot be met: which limit binds, and the best found;
    otherwise as the synthesis does.
    """
    preset = preset_of(robot, s)
    if preset in ("damped", "robust", "proved"):
        family = (near and near.family) or LinearFamily.of(robot, goal, period=s.period)
        begun, tried = near and near.search, s
        for turn in range(YIELDS + 1):  # a second search looks at more corners, and may ask for another turn
            try:
                return replace(_searched(family, start, tried, preset, begun), family=family)
            except DampingOutOfReach as refused:
                if s.damping is not None or not refused.reached or turn == YIELDS:
                    raise
                begun, tried = None, replace(s, damping=refused.reached)
    return _without_channels(robot, goal, s, preset, _stated(robot, goal, s))


def measured_problem(robot: Robot, goal: np.ndarray, s: Specification) -> GeneralisedPlant:
    """The problem of which a gain is proved for all tolerances, the same for all laws.

    Its penalty is the checked one; else the robot's own; else that of Eq. (11), scaled to the robot.
    """
    return nominal_problem(robot, goal, s, _stated(robot, goal, replace(s, penalty=s.checked_penalty))[0])


def _without_channels(
    robot: Robot,
    goal: np.ndarray,
    s: Specification,
    preset: str,
    stated: tuple[Penalty, str, str],
    target: TargetBehaviour | None = None,
    result: SearchResult | None = None,
) -> DesignProblem:
    problem = nominal_problem(robot, goal, s, stated[0])
    star = smallest_gamma(problem)
    return DesignProblem(preset, *stated, problem, problem, star, s.gamma_ratio * star, target, result)


def _stated(robot: Robot, goal: np.ndarray, s: Specification) -> tuple[Penalty, str, str]:
    own, penalty, source, priced = robot.penalty, robot.penalty, "the robot's file", "the robot's file"
    if s.penalty is not None:
        penalty, source = Penalty.of(s.penalty), "option --penalty"
        whole = isinstance(s.penalty, Penalty)
        priced = source if whole else "ours" if own is None else priced
        penalty = penalty if whole or own is None else replace(penalty, effort=own.effort)
    elif penalty is None:
        scales = JointScales.of(robot.plant(), robot.operating_point(goal))
        weights: Any = scales.penalty(np.full(len(goal), BANDWIDTH_FRACTION * scales.held), 0.0).states
        penalty = Penalty({name: weights[name] for name in ("link_position", "link_position_integral")}, 1.0)
        source, priced = "ours: the form of Eq. (11), scaled to the robot", "ours"
    if s.effort is not None:
        penalty, priced = replace(penalty, effort=s.effort), "option --effort"
    return penalty, source, priced


def _searched(
    few: LinearFamily, start: np.ndarray, s: Specification, preset: str, near: SearchResult | None
) -> DesignProblem:
    robot, goal, joints = few.robot, few.goal, len(few.goal)
    scales = JointScales.of(robot.plant(), robot.operating_point(goal))
    bandwidth = np.atleast_1d(
        np.asarray(BANDWIDTH_FRACTION * scales.held if s.bandwidth is None else s.bandwidth, dtype=float)
    )
    if len(bandwidth) not in (1, joints):
        raise InvalidInput(
            "The bandwidths do not fit the joints.",
            f"expected one number or {joints}, got {bandwidth.tolist()}",
            "one bandwidth for all joints",
        )
    target = TargetBehaviour(np.broadcast_to(bandwidth, (joints,)).copy(), required_damping(s))
    torques, base = None, partial(nominal_problem, robot, goal, s, scales.penalty(target.bandwidth, 0.0))
    if s.disturbances is not None:
        every = robot.plant().disturbances
        torques = np.eye(len(every))[:, [every.index(name) for name in base().disturbances or ()]]

    def nominal(target_frequency: np.ndarray, damping: np.ndarray) -> LinearProblem:
        rows = scales.rows(target_frequency, damping)
        return LinearProblem.of(few, rows, command_of(s) is not None, torques)

    def synthesis(target_frequency: np.ndarray, damping: np.ndarray) -> LinearDesign:
        return nominal(target_frequency, damping).design_at(s.gamma_ratio)

    result, family = _widened(few, target, few, synthesis, scales.held, near)
    weights, source = result.chosen.weights, f"found for {target.text}"
    if preset == "damped":
        stated = scales.penalty(*weights), source, "ours"
        return _without_channels(robot, goal, s, preset, stated, target, result)
    tolerances, corners = tolerance_channels(robot, [goal, start]), acting_corners(robot, goal, base())
    scalings = find_scalings(RobustProblem(nominal(*weights), family.torques, tolerances), s.gamma_ratio)

    def robust_problem(factor: float) -> DesignProblem:
        larger = ToleranceChannels(s, scales, family, torques, tolerances, scalings, corners, factor)

        def robust_synthesis(target_frequency: np.ndarray, damping: np.ndarray) -> LinearDesign:
            return larger.linear(target_frequency, damping).design(s.gamma_ratio, larger.scaled(1.0))

        result, _ = _widened(few, target, family, robust_synthesis, scales.held)
        problem = larger.problem(*result.chosen.weights, 1.0)
        return larger.checked(
            problem, 1.0, target, result, f"{source}, beside the channels of the tolerances"
        )

    def failing(problem: DesignProblem) -> int:
        assert problem.robustness is not None
        return problem.robustness.failing_corners

    first = robust_problem(1.0)
    return first if scalings.fraction < 1.0 else enlarge_tolerances(first, robust_problem, failing)


def _widened(
    few: LinearFamily,
    target: TargetBehaviour,
    family: LinearFamily,
    synthesis: Any,
    held: float,
    near: SearchResult | None = None,
) -> tuple[SearchResult, LinearFamily]:
    """Search weights for a family, then for the family with the worst of many corners added; and that family."""
    start = None if near is None else near.chosen
    if len(family.a) == 1:
        return search(target, family, synthesis, held, near=start), family
    result = search(target, family, synthesis, held, each=False) if near is None else near
    worst = sorted(set(behaviour_of(few.many, result.chosen.design.gain).worst))
    a, b = np.concatenate([family.a, few.many.a[worst]]), np.concatenate([family.b, few.many.b[worst]])
    wider = replace(family, a=a, b=b)
    return search(target, wider, synthesis, held, near=start), wider
