"""From a specification to a law: weights, noise levels of the estimator, V of several degrees, laws at other poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from flexhinf.design.along_move import AlongMove, MarginLimits, scheduled
from flexhinf.design.design_file import check_stated_units
from flexhinf.design.estimators import EstimatorNoise, estimator_for, noise_variances, sensor_steps
from flexhinf.design.joint_limits import ROBOT, JointLimits, integral_dead_zone, joint_limits
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.plans import stated_move
from flexhinf.design.problem.presets import (
    DesignProblem,
    choose,
    preset_of,
    required_damping,
    tolerance_channels,
)
from flexhinf.design.proved_step import LENGTH, ProvedLaw, proved_law
from flexhinf.design.responses import Plan, start_and_goal
from flexhinf.design.specification import RINGS, TOLERANCE, Specification, SpecificationError
from flexhinf.design.synthesis.degrees import (
    DegreeChoice,
    choose_degree,
    rays_of,
    solve_degrees,
    tried_degrees,
    with_region,
)
from flexhinf.design.synthesis.effort_limit import problem_within_effort
from flexhinf.design.synthesis.noise import NoiseSearch, search_noise
from flexhinf.design.synthesis.whole_loop import Search, WholeLoopSearch, at_pose, search_whole_loop
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.hinf import HJISolution, solve_hji
from flexhinf.loop import Schedule
from flexhinf.plant import GeneralisedPlant, Law, Penalty
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import check_holding
from flexhinf.robot.plausibility import check_delay, check_fast

Progress = Callable[[str], None]

#: A default bandwidth or damping is lowered at most so many times. The peak sensitivity goes about with the root of the
#: bandwidth, the noise at the motors with this power of the damping.
LOWERINGS, BANDWIDTH_POWER, NOISE_POWER = 3, 2.0, 1.5


@dataclass(frozen=True, eq=False)
class Synthesis:
    """The law of a design.

    Attributes
    ----------
    goal, start : (n,)
        Link positions of the step, rad or m.
    design_problem : DesignProblem
        Penalty, disturbances and level, with their sources.
    noise_search : NoiseSearch or None
        How the noise levels of the estimator were found; None where they are stated.
    choices : tuple of DegreeChoice
        Every degree that was solved.
    chosen : DegreeChoice
        The degree that is used.
    rays : int
        Rays in which regions were sampled.
    law : Law
        The chosen solution, or a schedule with those of other poses.
    along : AlongMove or None
        Margins of the running loop along the stated move; None without one.
    robust : WholeLoopSearch or None
        How weights and noise levels were found for the tolerances; of the preset robust.
    proved : ProvedLaw or None
        The law with its certificate for all tolerances; of the preset proved.
    """

    goal: np.ndarray
    start: np.ndarray
    design_problem: DesignProblem
    noise_search: NoiseSearch | None
    choices: tuple[DegreeChoice, ...]
    chosen: DegreeChoice
    rays: int
    law: Law
    along: AlongMove | None = None
    robust: WholeLoopSearch | None = None
    proved: ProvedLaw | None = None

    @property
    def solution(self) -> HJISolution:
        """The chosen solution at the goal."""
        return self.chosen.solution

    @property
    def sampled(self) -> bool:
        """Whether there is a sampled region of the chosen solution."""
        return self.chosen.looked and not np.isnan(self.chosen.level)

    @property
    def problem(self) -> GeneralisedPlant:
        """The nominal problem about the goal."""
        return self.design_problem.nominal

    def setup(self, robot: Robot, s: Specification) -> LoopSetup:
        """The loop that the law runs in."""
        levels = None if self.noise_search is None else self.noise_search.chosen.levels
        return LoopSetup(robot, s, self.law, self.goal, self.start, self.solution, levels)


def synthesise(robot: Robot, s: Specification, progress: Progress) -> Synthesis:
    """Weights, noise levels, every degree, the best of them, and laws at other poses.

    Raises
    ------
    InvalidInput, InfeasibleGamma, NotStabilisable, NotDetectable
        With what to change.
    """
    check_stated_units(robot, s)
    move = stated_move(robot, s)
    start, goal = start_and_goal(robot, s, move)
    check_fast(robot, s.period)
    check_delay(robot, s.delay)
    _refuse_early(robot, s, goal, start)
    steps = _Steps(robot, s, goal, start, progress)
    made = steps.synthesis()
    return made if move is None else steps.along(made, move)


@dataclass(frozen=True, eq=False)
class _Steps:
    """The steps of one synthesis, and what all of them are about.

    Attributes
    ----------
    goal, start : (n,)
        Link positions of the step, rad or m.
    progress : callable
        Called with what comes next.
    """

    robot: Robot
    s: Specification
    goal: np.ndarray
    start: np.ndarray
    progress: Progress

    def synthesis(self) -> Synthesis:
        """The law about the goal, or a schedule with the poses that are stated."""
        found = None
        if preset_of(self.robot, self.s) == "proved":
            return self.proved_synthesis()
        if preset_of(self.robot, self.s) == "robust":
            problem, noise, found = self.robust_problem()
        else:
            problem, noise = self.searched_problem()
        chosen, choices, rays = self.degrees(problem, noise)
        law = self.law_of(problem, chosen.solution, found)
        return Synthesis(self.goal, self.start, problem, noise, choices, chosen, rays, law, robust=found)

    def proved_synthesis(self) -> Synthesis:
        """The preset proved: the law of the smallest proved γ of the step within the largest input, for all tolerances.

        The search is about the law with the true state fed back; noise levels are found for it as for other laws.
        """
        found = proved_law(self.robot, self.s, self.goal, self.start, self.keeps_effort, self.progress)
        problem = replace(found.design_problem, preset="proved")
        noise = self.noise_search(problem)
        (solved,) = solve_degrees(problem.problem, (found.solution.degree,), problem.gamma)
        chosen = replace(solved, solution=found.solution)
        rays = rays_of(len(problem.problem.state_names), self.s)
        law = found.solution
        return Synthesis(self.goal, self.start, problem, noise, (chosen,), chosen, rays, law, proved=found)

    def keeps_effort(self, law: ProvedLaw) -> str:
        """ "", or how much input the step of a law takes on the running loop, where that is beyond the limit."""
        limits = joint_limits(self.robot, self.s)
        if not limits.limits_effort:
            return ""
        self.progress("the step on the running loop")
        noise = self.noise_search(law.design_problem)
        levels = None if noise is None else noise.chosen.levels
        setup = LoopSetup(self.robot, self.s, law.solution, self.goal, self.start, estimator_noise=levels)
        peak = setup.step(LENGTH / float(np.min(law.bandwidth))).peak_input
        if peak <= (1.0 + TOLERANCE) * limits.effort[0]:
            return ""
        return f"with the estimator the step takes an input of {peak:.3g}"

    def degrees(
        self, problem: DesignProblem, noise: NoiseSearch | None
    ) -> tuple[DegreeChoice, tuple[DegreeChoice, ...], int]:
        """The degree that is used, all that were solved, and the rays of a region.

        The region of the degree that is used is sampled, and those of all degrees that the specification states.
        """
        s, states = self.s, len(problem.problem.state_names)
        degrees, rays = tried_degrees(states, s), rays_of(states, s)
        solved = tuple(solve_degrees(problem.problem, degrees, problem.gamma, self.progress))
        levels = None if noise is None else noise.chosen.levels
        setup = LoopSetup(self.robot, s, solved[0].solution, self.goal, self.start, estimator_noise=levels)
        if len(solved) > 1:
            self.progress("the degree of V: the step with each")
        chosen, choices = choose_degree(setup, problem.nominal, solved)
        if not rays:
            return chosen, choices, rays
        gamma, penalty = s.checked_gamma_ratio * problem.gamma_star, checked_penalty(s, problem)
        found = []
        for choice in choices:
            if choice is chosen or s.degrees is not None:
                self.progress(f"degree {choice.degree}: sample the region")
                choice = with_region(choice, gamma, penalty, rays, s.seed)
            found.append(choice)
        return found[choices.index(chosen)], tuple(found), rays

    def along(self, made: Synthesis, move: Plan) -> Synthesis:
        """The same with the margins along a move, and with laws at poses on it where they do not hold with one."""
        self.progress("margins along the move")
        target, solution = made.design_problem.target, made.solution
        damping = None if target is None else required_damping(self.s, target)
        most = 1.0 + TOLERANCE
        least = MarginLimits(
            most * self.s.peak_sensitivity_limit, self.s.gain_margin_limit / most, damping and damping / most
        )

        def another(pose: np.ndarray) -> Law:
            return self.law_at(made.design_problem, solution.degree, pose, made.robust)

        law, along = scheduled(
            made.setup(self.robot, self.s), move, least, None if self.s.via or made.proved else another
        )
        return replace(made, law=law, along=along)

    def searched_problem(self) -> tuple[DesignProblem, NoiseSearch | None]:
        """The problem within the limits of the running loop and of the joints, and the noise levels for it."""
        problem, noise = self.affordable(choose(self.robot, self.goal, self.start, self.s))
        levels = None if noise is None else noise.chosen.levels
        slower = problem_within_effort(
            self.robot, self.goal, self.start, self.s, problem, levels, self.progress
        )
        return (problem, noise) if slower is problem else (slower, self.noise_search(slower))

    def robust_problem(self) -> tuple[DesignProblem, NoiseSearch | None, WholeLoopSearch]:
        """The preset robust: from what the preset damped comes to, weights and noise levels for the tolerances."""
        tolerance_channels(self.robot, [self.goal, self.start])
        plain = replace(self, s=replace(self.s, preset="damped", rays=0))
        damped, noise = plain.searched_problem()
        assert damped.target is not None
        self.progress("channels of the tolerances")
        same = replace(self.s, bandwidth=damped.target.bandwidth.tolist(), damping=damped.target.damping)
        covered = choose(self.robot, self.goal, self.start, same)
        levels = None if noise is None else noise.chosen.levels
        degree = plain.degrees(damped, noise)[0].degree
        search = Search(self.robot, self.goal, self.start, self.s, damped, covered, levels, degree)
        problem, levels, found = search_whole_loop(search, self.progress)
        if noise is None or levels is None or not found.better:
            return problem, noise, found
        setup, damping = self.linear_setup(problem), required_damping(self.s, damped.target)
        own = search_noise(setup, damping, self.progress, levels)
        return (damped, noise, replace(found, found=found.damped)) if own is None else (problem, own, found)

    def affordable(self, problem: DesignProblem) -> tuple[DesignProblem, NoiseSearch | None]:
        """The problem with its noise levels; a default bandwidth or damping lowered where no levels keep the limits.

        The margins of the running loop ask for a lower bandwidth, the noise at the motors for less damping, at least
        `RINGS`. What the specification states is not lowered.
        """
        noise = self.noise_search(problem)
        best = problem, noise
        for _ in range(LOWERINGS):
            if noise is None or problem.target is None:
                break
            target, missed = problem.target, noise.chosen.missed
            short = max(missed.get("peak sensitivity", 0.0), missed.get("gain margin", 0.0))
            loud = max(missed.get("damping", 0.0), missed.get("noise", 0.0))
            slower = (
                1.0
                if self.s.bandwidth is not None
                else float(np.clip(np.exp(-BANDWIDTH_POWER * short), 0.6, 1.0))
            )
            damping = target.damping
            if self.s.damping is None:
                damping = max(min(damping, RINGS), damping * float(np.exp(-loud / NOISE_POWER)))
            if slower == 1.0 and damping >= target.damping:
                break
            lower = replace(self.s, bandwidth=(slower * target.bandwidth).tolist(), damping=damping)
            self.progress(
                f"limits of the running loop missed: weights for {float(slower * target.bandwidth.min()):.3g} rad/s, "
                f"damping {damping:.2g}"
            )
            try:
                problem = choose(self.robot, self.goal, self.start, lower, near=problem)
            except FlexhinfError:
                break
            noise = self.noise_search(problem)
            before = best[1]
            if (
                noise is not None
                and before is not None
                and noise.chosen.whole_score < before.chosen.whole_score
            ):
                best = problem, noise
        return best

    def linear_setup(self, problem: DesignProblem) -> LoopSetup:
        """The loop of the problem's linear law."""
        law = solve_hji(problem.problem, problem.gamma, 2)
        return LoopSetup(self.robot, self.s, law, self.goal, self.start)

    def noise_search(self, problem: DesignProblem) -> NoiseSearch | None:
        """Noise levels of the estimator for the problem's linear law; None where they are stated."""
        damping = None if problem.target is None else required_damping(self.s, problem.target)
        return search_noise(self.linear_setup(problem), damping, self.progress)

    def law_of(
        self, problem: DesignProblem, solution: HJISolution, found: WholeLoopSearch | None = None
    ) -> Law:
        """The solution at the goal; with ``via`` a `Schedule` of it and of the same design at each of these poses.

        Preset, behaviour, γ/γ* and degree are the same at all poses; weights are found for each. Penalties that are
        stated are the same everywhere.
        """
        laws = [self.law_at(problem, solution.degree, pose, found) for pose in self.s.via]
        return Schedule([solution, *laws]) if laws else solution

    def law_at(
        self, problem: DesignProblem, degree: int, pose: Any, found: WholeLoopSearch | None = None
    ) -> HJISolution:
        """The same design at another pose; of the preset robust, with the same factors on the weights."""
        self.progress(f"the law at {', '.join(f'{value:.3g}' for value in pose)}")
        place = self.robot.operating_point(pose)[0][: len(self.start)]
        bandwidth = None if problem.target is None else problem.target.bandwidth.tolist()
        damping = self.s.damping
        if problem.target is not None:
            damping = min(required_damping(self.s, problem.target), problem.target.damping)
        same = replace(self.s, bandwidth=bandwidth, damping=damping)
        there = choose(self.robot, place, self.start, same)
        if found is not None:
            damped = choose(self.robot, place, self.start, replace(same, preset="damped"))
            return solve_hji(*at_pose(there, damped, found), degree)
        return solve_hji(there.problem, there.gamma, degree)


def _refuse_early(robot: Robot, s: Specification, goal: np.ndarray, start: np.ndarray) -> None:
    """Refuse before the work: a step to where it starts, extras, sensors and estimator, poses that cannot be held."""
    if not np.any(goal != start):
        raise InvalidInput(
            "There is nothing to move: the step starts at its goal.",
            f"expected another start than {goal.tolist()}",
            "another `start` or `pose`",
        )
    robot.plant(s.measured, extras=s.extras)
    model = robot.plant(s.measured)
    estimator_for(
        s.estimator, model, robot.operating_point(goal), robot.operating_point(start)[0], s.period,
        EstimatorNoise.stated(s).covariance(model.states), noise_variances(model, s.measurement_noise),
    )  # fmt: skip
    sensor_steps(robot, s)
    _check_dead_zone(robot, s, np.abs(goal - start))
    limits = joint_limits(robot, s)
    for pose in (goal, start, *s.via):
        check_holding(robot, pose, limits.effort, partial(_stated, limits))


def _check_dead_zone(robot: Robot, s: Specification, step: np.ndarray) -> None:
    """Refuse a dead zone in which a joint's whole step (n,) is never integrated."""
    zone = integral_dead_zone(robot, s, None)
    if zone is None:
        return
    beyond = (step > 0.0) & (zone >= step)
    if beyond.any():
        joint = int(np.argmax(beyond))
        unit = "m" if robot.links.slides[joint] else "rad"
        raise SpecificationError(
            "integral_dead_zone",
            f"The dead zone of joint {robot.joint_names[joint]!r} is as large as its step: nothing is integrated.",
            f"expected less than {step[joint]:.3g} {unit}, got {zone[joint]:.3g} {unit}",
        )


def _stated(limits: JointLimits, joint: int) -> tuple[str, str]:
    """Who states the smaller limit of a joint's input, and the fields of the specification that raise it.

    Files are often written with an effort of 1 or 10 where nobody knew the motor.
    """
    if limits.peak_source == ROBOT == limits.saturation_source:
        return f"; {ROBOT} states it: is it a placeholder?", "`peak_effort` and `saturation` (inf: no limit)"
    name, source = "saturation", limits.saturation_source
    if limits.peak[joint] <= limits.saturation[joint]:
        name, source = "peak_effort", limits.peak_source
    return f"; {ROBOT} states it" if source == ROBOT else "", f"`{name}`"


def checked_penalty(s: Specification, problem: DesignProblem) -> Any:
    """The checked penalty, its plain names spelled out for every joint."""
    if s.checked_penalty is None or callable(s.checked_penalty):
        return s.checked_penalty
    return Penalty.of(s.checked_penalty).expanded(problem.nominal.plant.groups).states
