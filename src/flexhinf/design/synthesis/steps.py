"""From a specification to a law: weights, noise levels of the estimator, V of several degrees, laws at other poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from flexhinf.design.checks import AlongMove, MarginLimits, scheduled
from flexhinf.design.design_file import check_stated_units
from flexhinf.design.loop_setup import EstimatorNoise, LoopPlants, LoopSetup, sensor_steps
from flexhinf.design.plans import stated_move
from flexhinf.design.problem.channels import tolerance_channels
from flexhinf.design.problem.presets import DesignProblem, preset_of, required_damping
from flexhinf.design.proved_step import LENGTH, ProvedLaw, proved_law
from flexhinf.design.responses import (
    ROBOT,
    JointLimits,
    Plan,
    integral_dead_zone,
    joint_limits,
    start_and_goal,
)
from flexhinf.design.specification import RINGS, TOLERANCE, Specification, SpecificationError
from flexhinf.design.synthesis.by_step import (
    DegreeChoice,
    Task,
    choose_degree,
    problem_within_effort,
    rays_of,
    solve_degrees,
    tried_degrees,
    with_region,
)
from flexhinf.design.synthesis.noise import NoiseSearch, search_noise
from flexhinf.design.synthesis.whole_loop import WholeLoopSearch, search_whole_loop
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
    """The law of a design, and how it was searched for."""

    goal: np.ndarray  # (n,), link positions, rad or m
    start: np.ndarray  # (n,), likewise
    design_problem: DesignProblem  # penalty, disturbances and level, with their sources
    noise_search: NoiseSearch | None  # of the estimator's noise levels; None where they are stated
    choices: tuple[DegreeChoice, ...]  # every degree that was solved
    chosen: DegreeChoice  # the degree that is used
    rays: int  # rays in which regions were sampled
    law: Law  # the chosen solution, or a schedule with those of other poses
    along: AlongMove | None = None  # margins of the running loop along the stated move; None without one
    robust: WholeLoopSearch | None = None  # of weights and noise levels for the tolerances; preset robust
    proved: ProvedLaw | None = None  # the law with its certificate for all tolerances; preset proved

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
        levels = self.noise_search and self.noise_search.chosen.levels
        return Task(robot, s, self.goal, self.start).setup(self.law, levels)


def synthesise(robot: Robot, s: Specification, progress: Progress) -> Synthesis:
    """Weights, noise levels, every degree, the best of them, and laws at other poses.

    Raises `InvalidInput`, `InfeasibleGamma`, `NotStabilisable` or `NotDetectable` with what to change.
    """
    check_stated_units(robot, s)
    move = stated_move(robot, s)
    start, goal = start_and_goal(robot, s, move)
    check_fast(robot, s.period)
    check_delay(robot, s.delay)
    _refuse_early(robot, s, goal, start)
    steps = _Steps(robot, s, goal, start, progress)
    synthesis = steps.proved() if preset_of(robot, s) == "proved" else steps.synthesis()
    return synthesis if move is None else steps.along(synthesis, move)


class _Steps(Task):
    def synthesis(self) -> Synthesis:
        """The law about the goal, or a schedule with the poses that are stated."""
        whole = None
        if preset_of(self.robot, self.s) == "robust":
            problem, noise, whole = self.robust_problem()
        else:
            problem, noise = self.searched_problem()
        chosen, choices, rays = self.degrees(problem, noise)
        laws = [self.law_at(problem, chosen.degree, pose, whole) for pose in self.s.via]
        law = Schedule([chosen.solution, *laws]) if laws else chosen.solution
        return Synthesis(self.goal, self.start, problem, noise, choices, chosen, rays, law, robust=whole)

    def proved(self) -> Synthesis:
        """The preset proved: the law of the smallest proved γ of the step within the largest input, for all tolerances.

        The search is about the law with the true state fed back; noise levels are found for it as for other laws.
        """
        proved = proved_law(self.robot, self.s, self.goal, self.start, self.keeps_effort, self.progress)
        problem, law = replace(proved.design_problem, preset="proved"), proved.solution
        noise = self.noise_search(problem)
        (solved,) = solve_degrees(problem.problem, (law.degree,), problem.gamma)
        chosen, rays = replace(solved, solution=law), rays_of(len(law.state_names), self.s.rays)
        return Synthesis(self.goal, self.start, problem, noise, (chosen,), chosen, rays, law, proved=proved)

    def keeps_effort(self, law: ProvedLaw) -> str:
        """The input that the step of a law takes on the running loop, as text; "" where it is within the limit."""
        limits = joint_limits(self.robot, self.s)
        if not limits.limits_effort:
            return ""
        self.progress("the step on the running loop")
        noise = self.noise_search(law.design_problem)
        setup = self.setup(law.solution, noise and noise.chosen.levels)
        peak = setup.step(LENGTH / float(np.min(law.bandwidth))).peak_input
        kept = peak <= (1.0 + TOLERANCE) * limits.effort[0]
        return "" if kept else f"with the estimator the step takes an input of {peak:.3g}"

    def degrees(
        self, problem: DesignProblem, noise: NoiseSearch | None
    ) -> tuple[DegreeChoice, tuple[DegreeChoice, ...], int]:
        """The degree that is used, all that were solved, and the rays of a region.

        The region of the degree that is used is sampled, and those of all degrees that the specification states.
        """
        s, states = self.s, len(problem.problem.state_names)
        degrees = tried_degrees(states, s.degrees)
        solved = list(solve_degrees(problem.problem, degrees, problem.gamma, self.progress))
        if len(solved) > 1:
            self.progress("the degree of V: the step with each")
        setup = self.setup(solved[0].solution, noise and noise.chosen.levels)
        chosen, choices = choose_degree(setup, problem.nominal, solved)
        rays, place, regions = rays_of(states, s.rays), choices.index(chosen), list(choices)
        if rays:
            gamma, penalty = s.checked_gamma_ratio * problem.gamma_star, checked_penalty(s, problem)
            for k, choice in enumerate(choices):
                if choice is chosen or s.degrees is not None:
                    self.progress(f"degree {choice.degree}: sample the region")
                    regions[k] = with_region(choice, gamma, penalty, rays, s.seed)
        return regions[place], tuple(regions), rays

    def along(self, synthesis: Synthesis, move: Plan) -> Synthesis:
        """The synthesis with margins along a move, and with laws at poses on it where one law does not keep them."""
        self.progress("margins along the move")
        problem, most = synthesis.design_problem, 1.0 + TOLERANCE
        damping = None if problem.target is None else required_damping(self.s, problem.target)
        limits = MarginLimits(
            most * self.s.peak_sensitivity_limit, self.s.gain_margin_limit / most, damping and damping / most
        )

        more = None
        if not (self.s.via or synthesis.proved):
            more = partial(self.law_at, problem, synthesis.solution.degree, whole=synthesis.robust)
        law, along = scheduled(synthesis.setup(self.robot, self.s), move, limits, more)
        return replace(synthesis, law=law, along=along)

    def robust_problem(self) -> tuple[DesignProblem, NoiseSearch | None, WholeLoopSearch]:
        """The preset robust: weights and noise levels for the tolerances, searched from those of the preset damped."""
        tolerance_channels(self.robot, [self.goal, self.start])  # refuses a robot without tolerances
        plain = replace(self, s=replace(self.s, preset="damped", rays=0))
        damped, noise = plain.searched_problem()
        assert damped.target is not None
        self.progress("channels of the tolerances")
        robust = self.choose(bandwidth=damped.target.bandwidth.tolist(), damping=damped.target.damping)
        problem, levels, whole = search_whole_loop(
            self, damped, robust, noise and noise.chosen.levels, plain.degrees(damped, noise)[0].degree
        )
        if noise is None or levels is None or not whole.better:
            return problem, noise, whole
        own = self.noise_search(problem, levels)
        return (damped, noise, replace(whole, chosen=whole.damped)) if own is None else (problem, own, whole)

    def searched_problem(self) -> tuple[DesignProblem, NoiseSearch | None]:
        """The problem within the limits of the running loop and of the joints, and the noise levels for it.

        A default bandwidth or damping is lowered where no levels keep the limits: the margins of the running loop ask
        for a lower bandwidth, the noise at the motors for less damping, at least `RINGS`. What the specification states
        is not lowered.
        """
        problem = self.choose()
        noise = self.noise_search(problem)
        best = problem, noise
        for _ in range(LOWERINGS):
            if noise is None or problem.target is None:
                break
            target, missed = problem.target, noise.chosen.missed
            short = max(missed.get("peak sensitivity", 0.0), missed.get("gain margin", 0.0))
            loud = max(missed.get("damping", 0.0), missed.get("noise", 0.0))
            slower, damping = 1.0, target.damping
            if self.s.bandwidth is None:
                slower = float(np.clip(np.exp(-BANDWIDTH_POWER * short), 0.6, 1.0))
            if self.s.damping is None:
                damping = max(min(damping, RINGS), damping * float(np.exp(-loud / NOISE_POWER)))
            if slower == 1.0 and damping >= target.damping:
                break
            bandwidth = slower * target.bandwidth
            self.progress(
                f"limits of the running loop missed: weights for {float(bandwidth.min()):.3g} rad/s, "
                f"damping {damping:.2g}"
            )
            try:
                problem = self.choose(problem, bandwidth=bandwidth.tolist(), damping=damping)
            except FlexhinfError:
                break
            noise = self.noise_search(problem)
            if noise and best[1] and noise.chosen.score(True) < best[1].chosen.score(True):
                best = problem, noise
        problem, noise = best
        slower = problem_within_effort(self, problem, noise and noise.chosen.levels)
        return (problem, noise) if slower is problem else (slower, self.noise_search(slower))

    def noise_search(
        self, problem: DesignProblem, levels: EstimatorNoise | None = None
    ) -> NoiseSearch | None:
        damping = None if problem.target is None else required_damping(self.s, problem.target)
        return search_noise(self.solved(problem.problem, problem.gamma, 2), damping, self.progress, levels)

    def law_at(
        self, problem: DesignProblem, degree: int, pose: Any, whole: WholeLoopSearch | None = None
    ) -> HJISolution:
        """The law of this design at another pose.

        Preset, behaviour, γ/γ* and degree are the same at all poses; weights are found for each, of the preset robust
        with the same factors. Penalties that are stated are the same everywhere.
        """
        self.progress(f"the law at {', '.join(f'{value:.3g}' for value in pose)}")
        there = replace(self, goal=self.robot.operating_point(pose)[0][: len(self.start)])
        target = problem.target
        same: dict[str, Any] = {"bandwidth": None, "damping": self.s.damping}
        if target is not None:
            damping = min(required_damping(self.s, target), target.damping)
            same = {"bandwidth": target.bandwidth.tolist(), "damping": damping}
        chosen = there.choose(**same)
        if whole is not None:
            damped = there.choose(**same, preset="damped")
            assert chosen.channels is not None
            assert damped.search is not None
            first, channels = damped.search.chosen, chosen.channels
            chosen = damped
            if whole.better:
                chosen = channels.problem(
                    whole.frequency * first.target_frequency,
                    whole.damping * first.damping_weights,
                    whole.fraction,
                )
        return solve_hji(chosen.problem, chosen.gamma, degree)


def _refuse_early(robot: Robot, s: Specification, goal: np.ndarray, start: np.ndarray) -> None:
    """Refuse before the work: a step to where it starts, extras, sensors and estimator, poses that cannot be held."""
    if not np.any(goal != start):
        raise InvalidInput(
            "There is nothing to move: the step starts at its goal.",
            f"expected another start than {goal.tolist()}",
            "another `start` or `pose`",
        )
    robot.plant(s.measured, extras=s.extras)
    LoopPlants(robot, s).estimator_at(start, goal, EstimatorNoise.stated(s))
    sensor_steps(robot, s.measured, s.quantisation, s.estimator)
    zone, step = integral_dead_zone(robot, s, None), np.abs(goal - start)
    if zone is not None and ((step > 0.0) & (zone >= step)).any():
        joint = int(np.argmax((step > 0.0) & (zone >= step)))
        unit = "m" if robot.links.slides[joint] else "rad"
        raise SpecificationError(
            "integral_dead_zone",
            f"The dead zone of joint {robot.joint_names[joint]!r} is as large as its step: nothing is integrated.",
            f"expected less than {step[joint]:.3g} {unit}, got {zone[joint]:.3g} {unit}",
        )
    limits = joint_limits(robot, s)
    for pose in (goal, start, *s.via):
        check_holding(robot, pose, limits.effort, partial(_stated, limits))


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
