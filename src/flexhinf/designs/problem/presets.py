"""The problem of a specification: penalty with its source, disturbances and level, by preset.

========  ========================================================================================================
preset    penalty
========  ========================================================================================================
paper     the robot's own; for a robot that states none, the form of Eq. (11): positions and their integrals alone
damped    searched for a bandwidth and a damping, see `flexhinf.designs.problem.weights`
robust    the same, and every uncertain parameter a disturbance channel, see below
given     the penalty of the specification
========  ========================================================================================================

Without a preset: `given` with weights; `damped` with a bandwidth or a damping, or where the robot states no penalty of
its own; otherwise `paper`.

Tolerances as disturbances [shen1995]: a parameter p in p0 ± δ changes the linear part, each robot at its own
equilibrium, by torques w = Δ (T_x x + T_u u), |Δ| ≤ 1, at links and motors. The change is split into rank-one parts;
each is a torque t w' that depends on one signal z_Δ = c x or z_Δ = e u. For the stiffness t = δ^½ (−1, 1), z_Δ = δ^½
(q1 − q2). For a change that is not linear in p, as of 1/R, the larger of both ends sizes the part, so that |Δ| ≤ 1
holds at both. Constant terms, such as the weight of a payload, are compensated by integral action.

A channel models one tolerance alone, but at a corner products such as m·g·l and k_t/R change together. So the linear
part of the dissipation inequality is checked at the corners, and the channels are enlarged step by step until it holds
there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from flexhinf.analysis import LinearCorners, modes
from flexhinf.arrays import Elements
from flexhinf.designs.problem.weights import (
    BANDWIDTH_FRACTION,
    DampingOutOfReach,
    LinearFamily,
    LinearProblem,
    RobustProblem,
    SearchResult,
    TargetBehaviour,
    UncertaintyChannel,
    behaviour_of,
    find_scalings,
    required_bandwidth,
    search,
)
from flexhinf.designs.specification import RINGS, Specification, per_joint
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.hinf import HJISolution, linear_law, smallest_gamma
from flexhinf.plant import GeneralisedPlant, Penalty, Plant
from flexhinf.robot import Robot

# Tolerances as channels ---------------------------------------------------------------------------------
#: Rank-one parts smaller than this fraction of the parameter's largest part are left out.
SMALL = 1e-3

#: A change smaller than this, relative to the robot's own torques, is rounding.
ROUNDING = 1e-10

#: Factors by which the tolerances are enlarged, one after the other, until the inequality holds at the corners.
ENLARGED = (1.0, 1.05, 1.1, 1.15, 1.2, 1.3)


def _linearised(robot: Robot, plant: Any, signs: dict[str, float], pose: np.ndarray) -> np.ndarray:
    """[A B] (n, n + m) at a corner of the tolerances, the robot at its own equilibrium at a pose."""
    known = plant.parameters.known(robot.corner(signs))
    equilibrium = robot.operating_point(pose, parameters=known)
    return np.hstack(plant.with_parameters(**known).linearise(*equilibrium)[:2])


def channels(robot: Robot, poses: Sequence[np.ndarray]) -> tuple[UncertaintyChannel, ...]:
    """Channels of all uncertain parameters, each at the pose where it changes the robot most."""
    plant = robot.plant()
    channel_list: list[UncertaintyChannel] = []
    linear = [(pose, plant.linearise(*robot.operating_point(pose))) for pose in poses]
    no_state, no_input = np.zeros(plant.n), np.zeros(len(plant.inputs))
    for parameter in robot.uncertain:
        name, changes = parameter.name, list[np.ndarray]()
        for pose, (a, b, torques, _) in linear:
            # [T_x T_u] from the nominal robot to each end of the interval, each at its own equilibrium.
            nominal = np.hstack([a, b])
            rounding = ROUNDING * np.abs(np.linalg.lstsq(torques, nominal, rcond=None)[0]).max()
            differences = (_linearised(robot, plant, {name: sign}, pose) - nominal for sign in (1.0, -1.0))
            ends = np.array([np.linalg.lstsq(torques, each, rcond=None)[0] for each in differences])
            changes.append(np.where(np.abs(ends) > rounding, ends, 0.0))  # (2, 2 joints, n + m)
        largest = max(changes, key=lambda ends: float(np.abs(ends).max()))
        joint = next((joint for joint in robot.joint_names if name.endswith(f"_{joint}")), "")
        quantity = name.removesuffix(f"_{joint}") if joint else name
        # Singular vectors of half the difference between the ends; the farther end sizes each part.
        for kind, (up, down) in zip(("state", "input"), np.split(largest, [plant.n], axis=2)):
            left, sizes, right = np.linalg.svd(0.5 * (up - down), full_matrices=False)
            for size, t, c in zip(sizes, left.T, right):
                if size > SMALL * sizes[0]:
                    root = np.sqrt(max(size, abs(t @ up @ c), abs(t @ down @ c)))
                    driven = (no_state, root * c) if kind == "input" else (root * c, no_input)
                    channel_list.append(UncertaintyChannel((quantity, kind), root * t, *driven))
    return tuple(channel_list)


def tolerance_channels(robot: Robot, poses: Sequence[np.ndarray]) -> tuple[UncertaintyChannel, ...]:
    """The `channels` of a robot. Raises `InvalidInput` if there are none."""
    if channel_list := channels(robot, poses):
        return channel_list
    raise InvalidInput(
        f"The robot {robot.name!r} states no tolerances that the preset robust could stand for.",
        "expected parameters with a tolerance that changes how the robot moves, got none",
        "tolerance = 10 beside a value in the robot's file, or preset='damped'",
    )


# Products of tolerances ---------------------------------------------------------------------------------
def acting_corners(robot: Robot, goal: np.ndarray, problem: GeneralisedPlant) -> LinearCorners:
    """The plant of a problem without channels at the corners of those tolerances that change it, each at its own
    equilibrium at the goal (n,), link positions in rad or m."""
    plant = problem.plant
    nominal = np.hstack(plant.linearise(*robot.operating_point(goal))[:2])  # traced once, for all corners
    ends = {p.name: _linearised(robot, plant, {p.name: 1.0}, goal) for p in robot.uncertain}
    names = [name for name, end in ends.items() if not np.allclose(end, nominal, rtol=1e-12, atol=0.0)]
    return LinearCorners.of(
        problem,
        lambda signs: robot.corner(dict(zip(names, signs, strict=True))),
        len(names),
        lambda values: robot.operating_point(goal, parameters=values),
    )


def enlarge_tolerances(problem_at: Callable[[float], DesignProblem]) -> DesignProblem:
    """The problem with the smallest factor of `ENLARGED` whose inequality holds at every corner; with the first if none
    does."""

    def failing(problem: DesignProblem) -> bool:
        assert problem.robustness is not None
        return problem.robustness.failing_corners > 0

    first = problem_at(ENLARGED[0])
    for factor in ENLARGED[1:] if failing(first) else ():
        try:
            larger = problem_at(factor)
        except FlexhinfError:
            break  # no factor suffices: the page has the number of failing corners of the first problem
        if not failing(larger):
            return larger
    return first


#: Names of the disturbances that stand for tolerances, numbered from 1.
PREFIX = "tolerance"


def uncertain_flow(
    flow: Callable[..., Elements], torques: int, x: Elements, u: Elements, d: Elements, p: Any
) -> Elements:
    """The robot's ẋ, on any element, with additional torques L w at links and motors. The first `torques` disturbances
    are the robot's own; L is a parameter."""
    return flow(x, u, d[:torques] + np.asarray(p.tolerance_channels) @ d[torques:], p)


def with_channels(plant: Plant, enter: np.ndarray) -> Plant:
    """The robot's plant with disturbances w that enter as torques L w; `enter` (2 joints, k) is L."""
    names = tuple(f"{PREFIX}_{k + 1}" for k in range(enter.shape[1]))
    return Plant(
        partial(uncertain_flow, plant.flow, len(plant.disturbances)),
        plant.output,
        states=plant.states,
        inputs=plant.inputs,
        disturbances=(*plant.disturbances, *names),
        parameters={**plant.parameters.values, "tolerance_channels": enter},
        outputs=plant.outputs,
        units=plant.units,
        groups=plant.groups,
        limits=plant.limits,
    )


# The problem --------------------------------------------------------------------------------------------
#: How often a default damping is lowered to the damping that weights can reach.
YIELDS = 4

#: Default damping ratio.
DAMPING = 0.2


def nominal_problem(robot: Any, goal: np.ndarray, s: Specification, penalty: Penalty) -> GeneralisedPlant:
    """The problem of a penalty about a goal (n,), without channels of the tolerances."""
    return robot.problem(
        penalty, pose=goal, measured=s.measured, command=command_of(s), disturbances=s.disturbances
    )


def command_of(s: Specification) -> str | None:
    """How the command enters the problem: as a disturbance, or not."""
    return "disturbance" if s.command or s.disturbances is None else None


@dataclass(frozen=True, eq=False)
class ToleranceFraction:
    """The fraction of the tolerances for which the channels stand, and its cost in γ and gain.

    The inequality of the linear part is checked at corners of the tolerances, each at its own equilibrium. If it fails
    at some of them, the law is robust to each tolerance alone, but not to all together.
    """

    fraction: float  # of the tolerances, that the channels stand for
    channels: int
    gamma_star: float  # smallest level for every robot within that fraction
    nominal_gamma_star: float  # of the same penalty without tolerances
    nominal_gain: float  # level that the nominal robot attains (linear part) without channels
    robust_gain: float  # level that the nominal robot attains (linear part) with channels
    scalings: Mapping[str, tuple[float, float]]  # smallest and largest s of the channels of each quantity
    enlarged: float  # factor on the tolerances, which accounts for products of tolerances
    corners: int  # corners that were checked
    failing_corners: int
    all_corners: bool  # whether these are all corners; otherwise they are sampled


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """The problem that is solved about the goal, with the sources of its parts."""

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
    robustness: ToleranceFraction | None = None
    family: LinearFamily | None = None  # the robots for which weights were searched
    channels: ToleranceChannels | None = None  # of the preset robust


@dataclass(frozen=True, eq=False)
class ToleranceChannels:
    """The channels of the tolerances; they make the problem of any weights and any fraction of the tolerances."""

    s: Specification
    scales: modes.JointScales
    family: LinearFamily
    torques: np.ndarray | None  # (2 joints, k), which torques at links and motors are physical disturbances
    first: RobustProblem  # problem of other weights, with the scalings and the largest possible fraction
    corners: LinearCorners  # plants at which the inequality of the linear part is checked
    enlarged: float = 1.0  # factor on all tolerances, which accounts for their products

    def linear(self, target_frequency: np.ndarray, damping: np.ndarray, fraction: float) -> RobustProblem:
        """The linear problem of the weights for ω (n,) and ζ (n,), with a fraction of the largest possible
        tolerances."""
        rows = self.scales.rows(target_frequency, damping)
        nominal = LinearProblem.of(
            self.family, rows, command_of(self.s) is not None, self.torques, self.scales.r2
        )
        return replace(self.first, nominal=nominal, fraction=fraction * self.enlarged * self.first.fraction)

    def problem(
        self, target_frequency: np.ndarray, damping: np.ndarray, fraction: float, accuracy: float = 1e-6
    ) -> DesignProblem:
        """The nonlinear problem with channels for a fraction of the tolerances, its smallest level to an accuracy.

        Raises `NoFeasibleGamma` if no level does.
        """
        robot, goal, weights = self.family.robot, self.family.goal, (target_frequency, damping)
        linear, base = self.linear(*weights, fraction), self.scales.penalty(*weights)
        star = linear.smallest_gamma(accuracy)
        gamma, (enter, seen, price) = self.s.gamma_ratio * star, linear.parts
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

    def checked(self, problem: DesignProblem, result: SearchResult, fraction: float) -> DesignProblem:
        """A `problem` of the chosen weights and this fraction, its inequality checked at corners of the tolerances."""
        linear = self.linear(*result.chosen.weights, fraction)
        law = linear_law(problem.problem, problem.gamma)
        # The inequality with d and z of the nominal problem, for the linear law of the robust one.
        check = replace(self.corners, problem=problem.nominal).dissipation(law.P, law.gain, problem.gamma)
        nominal, star = linear.nominal, linear.nominal.gamma_star
        plain, own = nominal.design(self.s.gamma_ratio * star), linear.design(problem.gamma)
        by_quantity: dict[str, list[float]] = {}
        for channel, log in zip(linear.channels, linear.log):
            by_quantity.setdefault("_by_".join(channel.group), []).append(float(np.exp(log)))
        robustness = ToleranceFraction(
            linear.fraction / self.enlarged,
            len(linear.channels),
            problem.gamma_star,
            star,
            nominal.attained(plain.gain),
            nominal.attained(own.gain),
            {group: (min(each), max(each)) for group, each in by_quantity.items()},
            self.enlarged,
            check.count,
            check.failing,
            check.complete,
        )
        return replace(problem, search=result, robustness=robustness)


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
        expected = "expected either weights, or a behaviour for which weights are found, or the preset paper; got both"
        refuse_if(contradicts, f"{both} contradict each other.", expected, advice)
    default = "damped" if behaviour or (robot.penalty is None and s.effort is None) else "paper"
    return s.preset or ("given" if s.penalty is not None else default)


def robust_applies(robot: Robot, s: Specification, goal: np.ndarray) -> bool:
    """Whether a specification can have the preset robust instead, and the robot tolerances that it stands for at the
    goal (n,)."""
    try:
        own, other = preset_of(robot, s), preset_of(robot, replace(s, preset="robust"))
    except InvalidInput:  # it contradicts the stated weights
        return False
    return own != other and bool(channels(robot, [goal]))


def required_damping(stated: float | None, target: TargetBehaviour | None = None) -> float:
    """Required damping ratio of every oscillation: the stated one, else `DAMPING`, or what the search lowered it to, at
    least `RINGS`; see `flexhinf.designs.synthesis.steps`."""
    if stated is not None:
        return stated
    return DAMPING if target is None else max(RINGS, min(DAMPING, target.damping))


def choose(
    robot: Robot, goal: np.ndarray, start: np.ndarray, s: Specification, near: DesignProblem | None = None
) -> DesignProblem:
    """The problem of a specification; a search begins at `near`, weights of this robot for another bandwidth or
    damping.

    If no weights reach a default damping, it is lowered to the best one; the loop is judged by `required_damping`.
    Raises `InvalidInput` for a contradiction, or for a requirement that cannot be met, with the active limit and the
    best result; and the errors of the synthesis.
    """
    preset = preset_of(robot, s)
    if preset in ("damped", "robust", "proved"):
        family = (near and near.family) or LinearFamily.of(robot, goal, period=s.period)
        begun, tried = near and near.search, s
        for turn in range(YIELDS + 1):  # a second search has more corners, and may need another turn
            try:
                return replace(_searched(family, start, tried, preset, begun), family=family)
            except DampingOutOfReach as refused:
                if s.damping is not None or not refused.reached or turn == YIELDS:
                    raise
                begun, tried = None, replace(s, damping=refused.reached)
    return _without_channels(robot, goal, s, preset, _stated(robot, goal, s))


def input_units(robot: Robot, s: Specification) -> np.ndarray:
    """The unit (n,) in which each input is weighed: its limit relative to the largest one, 1 where it has none."""
    stated = robot.effort_limits if s.saturation is None else s.saturation
    limits = per_joint(robot.joint_names, "saturation", stated)
    largest = limits[np.isfinite(limits)].max(initial=0.0)
    return np.divide(limits, largest, out=np.ones(len(limits)), where=np.isfinite(limits))


def joint_scales(robot: Robot, goal: np.ndarray, s: Specification) -> modes.JointScales:
    """Scales of a robot at a goal (n,) with its `input_units`."""
    scales, unit = modes.JointScales.of(robot.plant(), robot.operating_point(goal)), input_units(robot, s)
    return scales if np.all(unit == 1.0) else replace(scales, unit=unit)


def measured_problem(robot: Robot, goal: np.ndarray, s: Specification) -> GeneralisedPlant:
    """The problem whose gain is proved for all tolerances; it is the same for all laws.

    Its penalty is the `checked_penalty`, else the robot's own, else that of Eq. (11), scaled to the robot.
    """
    return nominal_problem(robot, goal, s, _stated(robot, goal, replace(s, penalty=s.checked_penalty))[0])


def _without_channels(
    robot: Robot, goal: np.ndarray, s: Specification, preset: str, stated: tuple[Penalty, str, str]
) -> DesignProblem:
    problem = nominal_problem(robot, goal, s, stated[0])
    star = smallest_gamma(problem)
    return DesignProblem(preset, *stated, problem, problem, star, s.gamma_ratio * star)


def _stated(robot: Robot, goal: np.ndarray, s: Specification) -> tuple[Penalty, str, str]:
    own, penalty, source, priced = robot.penalty, robot.penalty, "the robot's file", "the robot's file"
    if s.penalty is not None:
        penalty, source = Penalty.of(s.penalty), "option --set penalty"
        whole = isinstance(s.penalty, Penalty)
        priced = source if whole else "ours" if own is None else priced
        penalty = penalty if whole or own is None else replace(penalty, effort=own.effort)
    elif penalty is None:
        scales = joint_scales(robot, goal, s)
        weights: Any = scales.penalty(
            np.full(len(goal), BANDWIDTH_FRACTION * scales.antiresonance), 0.0
        ).states
        penalty = Penalty({name: weights[name] for name in ("link_position", "link_position_integral")}, 1.0)
        source, priced = "ours: the form of Eq. (11), scaled to the robot", "ours"
    if s.effort is not None:
        effort = per_joint(robot.joint_names, "effort", s.effort) if np.ndim(s.effort) else s.effort
        penalty, priced = replace(penalty, effort=effort), "option --set effort"
    unit = input_units(robot, s)
    if np.all(unit == 1.0):
        return penalty, source, priced
    return replace(penalty, effort=penalty.r2(len(unit)) / np.outer(unit, unit)), source, priced


def _searched(
    few: LinearFamily, start: np.ndarray, s: Specification, preset: str, near: SearchResult | None
) -> DesignProblem:
    robot, goal = few.robot, few.goal
    scales = joint_scales(robot, goal, s)
    target = TargetBehaviour(required_bandwidth(s.bandwidth, scales, len(goal)), required_damping(s.damping))
    torques, base = None, partial(nominal_problem, robot, goal, s, scales.penalty(target.bandwidth, 0.0))
    if s.disturbances is not None:
        every = robot.plant().disturbances
        torques = np.eye(len(every))[:, [every.index(name) for name in base().disturbances or ()]]

    def nominal(*weights: np.ndarray) -> LinearProblem:
        return LinearProblem.of(few, scales.rows(*weights), command_of(s) is not None, torques, scales.r2)

    def widened(
        family: LinearFamily,
        problem_of: Callable[..., LinearProblem | RobustProblem],
        begun: SearchResult | None,
    ) -> tuple[SearchResult, LinearFamily]:
        """Search weights for a family, then for that family with the worst of many corners; returns result and larger
        family."""

        def synthesis(*weights: np.ndarray) -> tuple[HJISolution, float]:
            problem = problem_of(*weights)
            star = problem.gamma_star
            return problem.design(s.gamma_ratio * star), star

        start = begun and begun.chosen
        if len(family.a) == 1:
            return search(target, family, synthesis, scales.antiresonance, near=start), family
        result = begun or search(target, family, synthesis, scales.antiresonance, each=False)
        worst = sorted(set(behaviour_of(few.many, result.chosen.design.gain).worst))
        a, b = np.concatenate([family.a, few.many.a[worst]]), np.concatenate([family.b, few.many.b[worst]])
        wider = replace(family, a=a, b=b)
        return search(target, wider, synthesis, scales.antiresonance, near=start), wider

    result, family = widened(few, nominal, near)
    weights, source = result.chosen.weights, f"found for {target.text}"
    if preset == "damped":
        problem = _without_channels(robot, goal, s, preset, (scales.penalty(*weights), source, "ours"))
        return replace(problem, target=target, search=result)
    tolerances, corners = tolerance_channels(robot, [goal, start]), acting_corners(robot, goal, base())
    first = find_scalings(nominal(*weights), family.torques, tolerances, s.gamma_ratio)

    def robust_problem(factor: float) -> DesignProblem:
        larger = ToleranceChannels(s, scales, family, torques, first, corners, factor)
        result, _ = widened(family, partial(larger.linear, fraction=1.0), None)
        problem = larger.checked(larger.problem(*result.chosen.weights, 1.0), result, 1.0)
        return replace(problem, source=f"{source}, beside the channels of the tolerances", target=target)

    return robust_problem(1.0) if first.fraction < 1.0 else enlarge_tolerances(robust_problem)
