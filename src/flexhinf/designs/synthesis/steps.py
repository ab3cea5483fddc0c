"""From a specification to a law: weights, noise levels of the estimator, V of several degrees, laws at other poses.

The preset `robust` searches the whole loop with its estimator for the largest factor of all tolerances up to which no
corner of them is unstable: docs/weights.md has the five factors that are searched (the scalings of a μ-synthesis, with
the fraction of the tolerances that the channels stand for) and the conditions. The search begins with the weights of
the preset `damped` and with weights whose channels stand for all tolerances. The channels model the law alone; with the
estimator in the loop they may reduce the robustness. `damped` itself is the first candidate, so by this criterion the
result is never worse than `damped`.

A candidate is evaluated at the few corners that are nearest to instability or overshoot most. A candidate that would be
the best is evaluated at all corners; the corners at which it fails are added to the few.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from flexhinf.analysis import (
    EquilibriumLoop,
    Judgement,
    Margins,
    Optimum,
    ToleranceBox,
    excess,
    margins,
    minimise,
)
from flexhinf.designs import checks, monte_carlo, plans, proved_step, responses
from flexhinf.designs.loop_setup import LoopPlants, LoopSetup
from flexhinf.designs.noise_levels import EstimatorNoise, sensor_steps
from flexhinf.designs.problem.presets import DesignProblem, preset_of, required_damping, tolerance_channels
from flexhinf.designs.problem.weights import SearchResult, WeightCandidate, behaviour_of
from flexhinf.designs.requirements.requirement import TOLERANCE
from flexhinf.designs.specification import MIN_DAMPING, RINGS, Specification, SpecificationError
from flexhinf.designs.stated_units import check_stated_units
from flexhinf.designs.synthesis import by_step
from flexhinf.designs.synthesis.by_step import DegreeChoice, Task
from flexhinf.designs.synthesis.noise import NO_DELAY, NoiseSearch, search_noise
from flexhinf.errors import FlexhinfError, refuse_if
from flexhinf.hinf import HJISolution, solve_hji
from flexhinf.loop import Schedule
from flexhinf.plant import GeneralisedPlant, Law, Penalty, Plant
from flexhinf.robot import Robot, kinematics

#: Largest noise of a motor input, as a multiple of the noise with the preset `damped`.
NOISE = 3.0

#: Largest factor of the tolerances that is searched for, and the relative accuracy of the result.
MOST, WIDTH = 16.0, 0.01

#: Number of candidates, and of corners at which each runs a step, by the number of states: steps of many joints are
#: slow.
CANDIDATES = ((10, 45, 12), (15, 60, 12), (10_000, 25, 4))

#: Corners nearest to instability that are evaluated from the beginning; corners that are added at once; and the largest
#: number of corners at which the result runs a step. `damped` runs the same number, for the comparison.
NEAREST, JOIN, STEPPED = 12, 4, 200

#: Smallest fraction of the tolerances in the channels.
MIN_FRACTION = 0.01

#: Ranges of the search: factors of ω, of ζ and of both noise levels; and the fraction of the tolerances that the
#: channels stand for (smaller ones have no effect).
RANGES = {
    "frequency": (0.6, 1.5),
    "damping": (0.2, 8.0),
    "links": (1e-3, 1e3),
    "motors": (1e-3, 1e3),
    "fraction": (MIN_FRACTION, 1.0),
}
NOISES = ("links", "motors")

#: Worst overshoot that is preferred, as a fraction of that of `damped`, since the other corners differ by a few per
#: cent; and the number of the best candidates that run the step at all corners.
LESS, CONFIRMED = 0.95, 5

#: Allowance for rounding of ln(metric/limit).
ALLOWED = 2e-3

#: A step is as long as `run_length` for a slowest decay rate of this fraction of the bandwidth.
SLOWEST = 0.5


@dataclass(frozen=True, eq=False)
class LoopCandidate:
    """A problem with the noise levels of its estimator, and the metrics of its loop that the search compares."""

    solved: DesignProblem
    levels: EstimatorNoise | None
    scale: float  # factor of all tolerances at which the first corner is unstable, at most `MOST`
    corner: int  # that corner, of the corners of `tolerance_corners`; −1 for none
    overshoot: float  # largest of all joints and of the corners that stepped, per cent
    used: float  # largest share of a limit of input or speed that a step used; 0 without limits
    margins: Margins
    noises: np.ndarray  # (m,), RMS of each input, V or N·m; zeros with the true state fed back


@dataclass(frozen=True, eq=False)
class WholeLoopSearch:
    """Result of the search, and the preset `damped` that it began with.

    `frequency`, `damping`, `links` and `motors` are factors of ω, of ζ and of the noise levels, over those of `damped`.
    """

    damped: LoopCandidate
    chosen: LoopCandidate  # that of `damped` where nothing is better
    frequency: float
    damping: float
    links: float
    motors: float
    fraction: float  # of what the channels can cover
    count: int  # candidates
    corner: str  # the corner at which the loop becomes unstable first, by its changes

    @property
    def better(self) -> bool:
        """Whether any candidate was better than `damped`."""
        return self.chosen is not self.damped


class _WholeLoop:
    """The search from a problem of the preset damped with its noise `levels` (None where they are not free).

    The law that steps at the corners has V of the `degree`.
    """

    def __init__(self, task: Task, damped: DesignProblem, levels: EstimatorNoise | None, degree: int) -> None:
        assert damped.search is not None
        assert damped.target is not None
        task.progress("channels of the tolerances")  # they stand for these with the true state fed back
        robust = task.choose(bandwidth=damped.target.bandwidth.tolist(), damping=damped.target.damping)
        assert robust.channels is not None
        assert robust.search is not None
        plants = LoopPlants(task.robot, task.s.of_loop)
        self.task, self.noise, self.damped, true = task, plants.noise, damped.search, plants.true.robot
        self.target, self.first = damped.target, damped.search.chosen
        self.channels, self.robust = robust.channels, robust.search.chosen
        self.levels, self.degree, self.best = levels, degree, 0.0
        states = len(damped.problem.state_names)
        self.most, stepping = next((count, few) for most, count, few in CANDIDATES if states <= most)
        self.duration = responses.run_length(SLOWEST * float(np.min(self.target.bandwidth)))
        # Metrics of `damped`, and the corners at which candidates are evaluated.
        loop = self.loop(damped, levels)
        self.box = ToleranceBox.of(loop, true.corner, true.uncertain)
        every = np.arange(len(self.box.away))
        scale, corner = self.edge(loop)
        nearest = self.box.unstable(loop, 1.1 * scale)[:NEAREST] if corner >= 0 else every[:0]
        places = every if len(every) <= STEPPED else np.linspace(0, len(every) - 1, STEPPED).astype(int)
        self.compared = np.unique(np.concatenate([places, nearest]))
        overshoots, used = self.stepped(damped, levels, self.compared)
        worst = self.compared[np.argsort(-overshoots, kind="stable")]
        self.stepping_at, self.active = worst[:stepping], np.unique(np.concatenate([nearest, worst[:JOIN]]))
        self.own = LoopCandidate(
            damped, levels, scale, corner, float(overshoots.max()), used, *self.judged(loop)
        )

    def run(self) -> tuple[DesignProblem, EstimatorNoise | None, WholeLoopSearch]:
        # The weights whose channels cover the tolerances are the second start.
        ranges = {name: r for name, r in RANGES.items() if self.levels is not None or name not in NOISES}
        start = {**dict.fromkeys(ranges, 1.0), "fraction": MIN_FRACTION}
        frequency = np.log(self.robust.target_frequency / self.first.target_frequency).mean()
        ratio = np.maximum(self.robust.damping_weights, 1e-3) / np.maximum(self.first.damping_weights, 1e-3)
        factors = {"frequency": float(np.exp(frequency)), "damping": float(np.exp(np.log(ratio).mean()))}
        search = minimise(self.judge, start, ranges, self.most, [{**start, **factors, "fraction": 1.0}])
        x, best = self.preferred(search)
        count, own = len(search.candidates), self.own
        self.task.progress(f"weights and noise levels for the tolerances: {count} loops tried")
        corner = "" if best.corner < 0 else self.box.population.describe(best.corner)
        outcome = WholeLoopSearch(
            own, best, **{**dict.fromkeys(RANGES, 1.0), **x}, count=count, corner=corner
        )
        if best is own:
            return replace(own.solved, preset="robust"), self.levels, outcome
        weights = frequency, damping, fraction = self.settings(x)
        design, star = self.channels.linear(*weights).design(best.solved.gamma), best.solved.gamma_star
        chosen = WeightCandidate(
            frequency, damping, design, star, behaviour_of(self.channels.family, design.gain)
        )
        source = (
            f"searched on the running loop: its corners are stable up to {best.scale:.3g} times the tolerances, "
            f"{own.scale:.3g} with the preset damped"
        )
        result = SearchResult(chosen, (*self.damped.candidates, chosen))
        problem = self.channels.checked(best.solved, result, fraction)
        return replace(problem, source=source, target=self.target), best.levels, outcome

    def preferred(self, search: Optimum) -> tuple[Mapping[str, float], LoopCandidate]:
        """Best candidate by overshoot at the corners: clearly below `damped`, else not above it, else `damped`."""
        second: tuple[Mapping[str, float], LoopCandidate] | None = None
        better = [each for each in search.path if each.judgement.result is not None]
        for each in reversed(better[-CONFIRMED:]):
            candidate = each.judgement.result
            overshoots, used = self.stepped(candidate.solved, candidate.levels, self.compared)
            candidate = replace(candidate, overshoot=float(overshoots.max()), used=used)
            if any(self.step_limits(candidate.overshoot, used).values()):
                continue
            if candidate.overshoot <= LESS * self.own.overshoot:
                return each.parameters, candidate
            second = second or (each.parameters, candidate)
        return second or (search.candidates[0].parameters, self.own)

    def judge(self, x: Mapping[str, float]) -> Judgement:
        """ln of the factor of `damped` over that of the candidate, and the conditions that fail. A candidate that is no
        more robust than the best needs no further runs, nor one that fails a condition of the linear loop."""
        problem, levels = self.channels.problem(*self.settings(x), 1e-4), self.levels
        if levels is not None:
            levels = levels.scaled(x["links"], x["motors"] / x["links"], "searched on the running loop")
        loop = self.loop(problem, levels)
        scale, corner = self.edge(loop, self.active)
        cost = -float(np.log(scale / self.own.scale)) if scale > 0.0 else np.inf
        if cost >= self.best:
            return Judgement(cost)
        loop_margins, noises = self.judged(loop)
        if any((limits := self.limits(loop_margins, noises)).values()):
            return Judgement(cost, limits)
        overshoots, used = self.stepped(problem, levels, self.stepping_at)
        overshoot = float(overshoots.max())
        if any((limits := self.step_limits(overshoot, used)).values()):
            return Judgement(cost, limits)
        # By the factor of all corners; those that were missing are computed from now on.
        if len(beyond := self.box.unstable(loop, (1.0 - WIDTH) * scale)):
            self.active = np.union1d(self.active, beyond[:JOIN])
            scale, corner = self.edge(loop, beyond)
            cost = -float(np.log(scale / self.own.scale))
        if cost >= self.best:
            return Judgement(cost)
        self.best = cost
        return Judgement(
            cost, result=LoopCandidate(problem, levels, scale, corner, overshoot, used, loop_margins, noises)
        )

    def settings(self, x: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray, float]:
        """Of a point of the search: target frequencies ω (n,), rad/s, damping weights ζ (n,), and the fraction of the
        tolerances that the channels stand for."""
        first = self.first
        return x["frequency"] * first.target_frequency, x["damping"] * first.damping_weights, x["fraction"]

    def loop(self, solved: DesignProblem, levels: EstimatorNoise | None) -> EquilibriumLoop:
        return self.task.solved(solved, 2, levels).equilibrium_loop(estimated=self.task.s.estimator != "none")

    def edge(self, loop: EquilibriumLoop, which: np.ndarray | None = None) -> tuple[float, int]:
        """Smallest factor of the tolerances at which one of these corners (default: all) is unstable, and that
        corner."""
        scale, corner = self.box.edge(loop, which, most=MOST, width=WIDTH)
        return min(scale, MOST), corner

    def stepped(
        self, solved: DesignProblem, levels: EstimatorNoise | None, which: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Overshoot (N,) of the step at corners, and the largest share of a limit that a step used."""
        setup = replace(self.task.solved(solved, self.degree, levels), unlimited=True)
        duration, limits = self.duration + setup.command_time, setup.limits
        nominal = setup.step(duration)
        if nominal.diverged_at is not None:
            return np.full(len(which), np.inf), np.inf
        runs = monte_carlo.sampled_runs(
            setup,
            [self.box.population.values[int(k)] for k in which],
            duration,
            nominal.run.settings["sub_steps"],
        )
        shares = [runs.inputs / limits.peak, runs.speeds / limits.speed]
        used = np.max([np.where(np.isfinite(share), share, 0.0).max() for share in shares])
        return runs.overshoot, float(used)

    def judged(self, loop: EquilibriumLoop) -> tuple[Margins, np.ndarray]:
        loop_margins = margins(loop)
        if self.noise is None:
            return loop_margins, np.zeros(len(loop_margins.noise_to_input))
        return loop_margins, np.linalg.norm(loop_margins.noise_to_input * self.noise, axis=1)

    def limits(self, loop_margins: Margins, noises: np.ndarray) -> dict[str, float]:
        """ln(metric/limit) of the linear conditions that fail; each limit is the specification's or the value of
        `damped`, whichever is wider."""
        own, s = self.own.margins, self.task.s
        most = s.period * s.limit("delay_margin")
        bandwidth = np.minimum(self.target.bandwidth, np.nan_to_num(own.bandwidth))
        ratios = {
            "peak sensitivity": loop_margins.peak_sensitivity
            / max(s.limit("peak_sensitivity"), own.peak_sensitivity),
            "gain margin": min(s.limit("gain_margin"), own.gain_margin) / loop_margins.gain_margin,
            "damping": min(required_damping(s.damping, self.target), own.damping)
            / max(loop_margins.damping, 1e-9),
            "delay margin": own.delay_margin_within(most)
            / max(loop_margins.delay_margin_within(most), NO_DELAY * s.period),
            "bandwidth": float(np.max(bandwidth / np.maximum(np.nan_to_num(loop_margins.bandwidth), 1e-9))),
            "noise": float((noises / (NOISE * np.maximum(self.own.noises, 1e-300))).max()),
        }
        return {what: excess(ratio, 1.0 + ALLOWED) for what, ratio in ratios.items()}

    def step_limits(self, overshoot: float, used: float) -> dict[str, float]:
        """The same for the steps: the overshoot is at most that of `damped`, and limits of input and speed are kept, or
        exceeded by no more."""
        own = self.own
        return {
            "overshoot": excess(overshoot, own.overshoot + ALLOWED * max(own.overshoot, 0.5)),
            "limits of the step": excess(used, (1.0 + ALLOWED) * max(1.0, own.used)),
        }


# From a specification to a law --------------------------------------------------------------------------
#: How often a default bandwidth or damping is lowered at most. The peak sensitivity grows about with the root of the
#: bandwidth, the noise at the motors with this power of the damping.
LOWERINGS, BANDWIDTH_POWER, NOISE_POWER = 3, 2.0, 1.5


@dataclass(frozen=True, eq=False)
class Synthesis:
    """The law of a design, with the results of the searches that led to it."""

    goal: np.ndarray  # (n,), link positions, rad or m
    start: np.ndarray  # (n,), likewise
    design_problem: DesignProblem  # penalty, disturbances and level, with their sources
    noise_search: NoiseSearch | None  # of the estimator's noise levels; None where they are stated
    choices: tuple[DegreeChoice, ...]  # every degree that was solved
    chosen: DegreeChoice  # the degree that is used
    rays: int  # rays in which regions were sampled
    law: Law  # the chosen solution, or a schedule with those of other poses
    along: checks.AlongMove | None = None  # margins of the running loop along the stated move
    robust: WholeLoopSearch | None = None  # of weights and noise levels for the tolerances; preset robust
    proved: proved_step.ProvedLaw | None = None  # with its certificate for all tolerances; preset proved

    @property
    def solution(self) -> HJISolution:
        """The chosen solution at the goal."""
        return self.chosen.solution

    @property
    def problem(self) -> GeneralisedPlant:
        """The nominal problem about the goal."""
        return self.design_problem.nominal

    @property
    def sampled(self) -> bool:
        """Whether the chosen solution has a sampled region."""
        return self.chosen.looked and not np.isnan(self.chosen.level)

    def setup(self, robot: Robot, s: Specification) -> LoopSetup:
        """The loop that the law runs in."""
        levels = self.noise_search and self.noise_search.chosen.levels
        return Task(robot, s, self.goal, self.start).setup(self.law, levels)


def synthesise(robot: Robot, s: Specification, progress: Callable[[str], None]) -> Synthesis:
    """Weights, noise levels, every degree, the best of them, and laws at other poses.

    Raises `InvalidInput`, `InfeasibleGamma`, `NotStabilisable` or `NotDetectable` with what to change.
    """
    check_stated_units(robot, s)
    move = plans.stated_move(robot, s)
    start, goal = responses.start_and_goal(robot, s, move)
    kinematics.check_fast(robot, s.period)
    kinematics.check_delay(robot, s.unknown_delay)
    _refuse_early(robot, s.of_loop, goal, start)
    steps = _Steps(robot, s, goal, start, progress)
    synthesis = steps.proved() if preset_of(robot, s) == "proved" else steps.synthesis()
    if move is None:
        return synthesis
    # Margins along the move, and laws at poses on it where one law does not keep them.
    progress("margins along the move")
    problem, most = synthesis.design_problem, 1.0 + TOLERANCE
    damping = max(steps.damping(problem) or 0.0, MIN_DAMPING) / most
    limits = checks.MarginLimits(
        most * s.limit("peak_sensitivity"), s.limit("gain_margin") / most, damping, s.damped_below_limit
    )
    more = partial(steps.law_at, problem, synthesis.solution.degree, whole=synthesis.robust)
    law, along = checks.scheduled(
        synthesis.setup(robot, s), move, limits, None if s.via or synthesis.proved else more
    )
    return replace(synthesis, law=law, along=along)


class _Steps(Task):
    def synthesis(self) -> Synthesis:
        robust = preset_of(self.robot, self.s) == "robust"
        problem, noise, whole = self.robust_problem() if robust else (*self.searched_problem(), None)
        chosen, choices, rays = self.degrees(problem, noise)
        laws = [self.law_at(problem, chosen.degree, pose, whole) for pose in self.s.via]
        law = Schedule([chosen.solution, *laws]) if laws else chosen.solution
        return Synthesis(self.goal, self.start, problem, noise, choices, chosen, rays, law, robust=whole)

    def proved(self) -> Synthesis:
        """The preset proved: the law of the smallest proved γ of the step within the largest input, for all tolerances.

        The search assumes that the true state is fed back; the noise levels of the estimator are searched for
        afterwards, as for other laws. A robot without tolerances counts as nominal. Values that the specification
        states are kept.
        """
        robot, s = self.robot, self.s
        stated = {
            "bandwidths": None if s.bandwidth is None else (1.0,),
            "dampings": None if s.damping is None else (s.damping,),
            "degrees": s.degrees,
            "ratios": None if s.gamma_ratio == Specification().gamma_ratio else (s.gamma_ratio,),
        }
        settings: dict[str, Any] = {name: values for name, values in stated.items() if values is not None}
        proved = proved_step.search_proved_step(
            robot,
            self.goal.tolist(),
            float((self.goal - self.start)[0]),
            specification=s,
            effort_limit=float(responses.joint_limits(robot, s).effort[0]),
            tolerances=1.0 if robot.uncertain else 0.0,
            most_seconds=s.proof_seconds,
            admits=self.keeps_effort,
            progress=self.progress,
            **settings,
        )
        problem, law = replace(proved.design_problem, preset="proved"), proved.solution
        noise, rays = self.noise_search(problem), by_step.rays_of(len(law.state_names), self.s.rays)
        (solved,) = by_step.solve_degrees(problem.problem, (law.degree,), problem.gamma)
        chosen = replace(solved, solution=law)
        return Synthesis(self.goal, self.start, problem, noise, (chosen,), chosen, rays, law, proved=proved)

    def keeps_effort(self, law: proved_step.ProvedLaw) -> str:
        """Text about a step of the running loop whose input exceeds the limit; "" where it stays within the limit."""
        limits = responses.joint_limits(self.robot, self.s)
        if not limits.limits_effort:
            return ""
        self.progress("the step on the running loop")
        noise = self.noise_search(law.design_problem)
        setup = replace(self.setup(law.solution, noise and noise.chosen.levels), unlimited=True)
        peak = setup.step(proved_step.LENGTH / float(np.min(law.bandwidth))).peak_input
        kept = peak <= (1.0 + TOLERANCE) * limits.effort[0]
        return "" if kept else f"with the estimator the step takes an input of {peak:.3g}"

    def degrees(
        self, problem: DesignProblem, noise: NoiseSearch | None
    ) -> tuple[DegreeChoice, tuple[DegreeChoice, ...], int]:
        """The degree that is used, all degrees that were solved, and the number of rays in which a region is sampled.

        A region is sampled for the degree that is used, and for every degree that the specification states.
        """
        s, states = self.s, len(problem.problem.state_names)
        degrees = by_step.tried_degrees(states, s.degrees)
        solved = list(by_step.solve_degrees(problem.problem, degrees, problem.gamma, self.progress))
        if len(solved) > 1:
            self.progress("the degree of V: the step with each")
        setup = self.setup(solved[0].solution, noise and noise.chosen.levels)
        chosen, choices = by_step.choose_degree(setup, problem.nominal, solved)
        rays, regions = by_step.rays_of(states, s.rays), list(choices)
        if rays:
            gamma = s.checked_gamma_ratio * problem.gamma_star
            penalty = checked_penalty(s.checked_penalty, problem.nominal.plant)
            for k, choice in enumerate(choices):
                if choice is chosen or s.degrees is not None:
                    self.progress(f"degree {choice.degree}: sample the region")
                    regions[k] = by_step.with_region(choice, gamma, penalty, rays, s.seed)
        return regions[choices.index(chosen)], tuple(regions), rays

    def robust_problem(self) -> tuple[DesignProblem, NoiseSearch | None, WholeLoopSearch]:
        tolerance_channels(self.robot, [self.goal, self.start])  # refuses a robot without tolerances
        plain = replace(self, s=replace(self.s, preset="damped", rays=0))
        damped, noise = plain.searched_problem()
        degree = plain.degrees(damped, noise)[0].degree
        problem, levels, whole = _WholeLoop(self, damped, noise and noise.chosen.levels, degree).run()
        if noise is None or levels is None or not whole.better:
            return problem, noise, whole
        own = self.noise_search(problem, levels)
        return (damped, noise, replace(whole, chosen=whole.damped)) if own is None else (problem, own, whole)

    def searched_problem(self) -> tuple[DesignProblem, NoiseSearch | None]:
        """The problem within the limits of the running loop and of the joints, and the noise levels for it.

        Where no noise levels keep the limits, a default bandwidth or damping is lowered: the bandwidth for the margins
        of the running loop, the damping (never below `RINGS`) for the noise at the motors; both for the delay margin,
        which a loop loses at the vibrations that it damps. Stated values are kept.
        """
        problem = self.choose()
        noise = self.noise_search(problem)
        best = problem, noise
        for _ in range(LOWERINGS):
            if noise is None or problem.target is None:
                break
            target, missed = problem.target, noise.chosen.missed
            slower, damping = 1.0, target.damping
            if self.s.bandwidth is None:
                short = max(
                    missed.get(name, 0.0) for name in ("peak sensitivity", "gain margin", "delay margin")
                )
                slower = float(np.clip(np.exp(-BANDWIDTH_POWER * short), 0.6, 1.0))
            if self.s.damping is None:
                loud = max(missed.get(name, 0.0) for name in ("damping", "noise", "delay margin"))
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
            if (
                noise
                and best[1]
                and noise.chosen.judgement(True).order < best[1].chosen.judgement(True).order
            ):
                best = problem, noise
        problem, noise = best
        slower = by_step.problem_within_effort(self, problem, noise and noise.chosen.levels)
        return (problem, noise) if slower is problem else (slower, self.noise_search(slower))

    def damping(self, problem: DesignProblem) -> float | None:
        return None if problem.target is None else required_damping(self.s.damping, problem.target)

    def noise_search(
        self, problem: DesignProblem, levels: EstimatorNoise | None = None
    ) -> NoiseSearch | None:
        return search_noise(self.solved(problem, 2), self.damping(problem), self.progress, levels)

    def law_at(
        self, problem: DesignProblem, degree: int, pose: Any, whole: WholeLoopSearch | None = None
    ) -> HJISolution:
        """The law of this design at another pose.

        Preset, bandwidth, damping, γ/γ* and degree are the same at all poses. Weights are searched for at each pose;
        those of the preset `robust` keep their factors. A stated penalty holds at all poses.
        """
        self.progress(f"the law at {', '.join(f'{value:.3g}' for value in pose)}")
        there = replace(self, goal=self.robot.operating_point(pose)[0][: len(self.start)])
        same: dict[str, Any] = {"bandwidth": None, "damping": self.s.damping}
        if (target := problem.target) is not None:
            same["bandwidth"] = target.bandwidth.tolist()
            same["damping"] = min(required_damping(self.s.damping, target), target.damping)
        chosen = there.choose(**same)
        if whole is not None:
            channels, chosen = chosen.channels, there.choose(**same, preset="damped")
            assert channels is not None
            assert chosen.search is not None
            first = chosen.search.chosen
            if whole.better:
                chosen = channels.problem(
                    whole.frequency * first.target_frequency,
                    whole.damping * first.damping_weights,
                    whole.fraction,
                )
        return solve_hji(chosen.problem, chosen.gamma, degree)


def _refuse_early(robot: Robot, s: Specification, goal: np.ndarray, start: np.ndarray) -> None:
    """Refuse, before any work, a step of zero length, unusable extras, sensors or estimators, and poses that cannot be
    held."""
    refuse_if(
        not np.any(goal != start),
        "There is nothing to move: the step starts at its goal.",
        f"expected another start than {goal.tolist()}",
        "another `start` or `pose`",
    )
    robot.plant(s.measured, extras=s.extras)
    LoopPlants(robot, s).estimator_at(start, goal, EstimatorNoise.stated(s))
    sensor_steps(robot, s.measured, s.quantisation, s.estimator)
    step = np.abs(goal - start)
    zone = responses.integral_dead_zone(robot.joint_names, s.integral_dead_zone, None)
    if zone is not None and (within_zone := (step > 0.0) & (zone >= step)).any():
        joint = int(np.argmax(within_zone))
        unit = robot.links.position_units[joint]
        raise SpecificationError(
            "integral_dead_zone",
            f"The dead zone of joint {robot.joint_names[joint]!r} is as large as its step: nothing is integrated.",
            f"expected less than {step[joint]:.3g} {unit}, got {zone[joint]:.3g} {unit}",
        )
    limits = responses.joint_limits(robot, s)

    def stated(joint: int) -> tuple[str, str]:
        # Source of the smaller limit of a joint's input, and the fields of the specification that raise the limit.
        # Files are often written with an effort of 1 or 10 where nobody knew the motor.
        file = responses.ROBOT
        if limits.peak_source == file == limits.saturation_source:
            return (
                f"; {file} states it: is it a placeholder?",
                "`peak_effort` and `saturation` (inf: no limit)",
            )
        required = limits.peak[joint] <= limits.saturation[joint]
        name, source = (
            ("peak_effort", limits.peak_source) if required else ("saturation", limits.saturation_source)
        )
        return f"; {file} states it" if source == file else "", f"`{name}`"

    for pose in (goal, start, *s.via):
        kinematics.check_holding(robot, pose, limits.effort, stated)


def checked_penalty(stated: Any, plant: Plant) -> Any:
    """The checked penalty as stated, its plain names spelled out for every joint of a plant."""
    if stated is None or callable(stated):
        return stated
    return Penalty.of(stated).expanded(plant.groups).states
