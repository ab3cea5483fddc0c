"""Choices by the step of the running loop: the degree of V, and bandwidths that keep the limits of the joints.

Laws of all degrees have the same linear part. They differ on steps so long that the linearisation no longer holds at
the start. So the deployed step decides. If the higher terms would hardly change the input along the step of the lowest
degree, the lowest degree is used. Otherwise a higher degree replaces a lower one if its step costs less and keeps every
limit of the specification that the lower one keeps, also on a few sampled robots (docs/degrees.md).

Limits of inputs and speeds: bandwidths are lowered, joint by joint, until the step of the nonlinear loop keeps them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from flexhinf.analysis.modes import closed_loop
from flexhinf.analysis.optimiser import bisected
from flexhinf.designs.judge import sample_requirements, step_requirements
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.monte_carlo import sampled_runs
from flexhinf.designs.noise_levels import EstimatorNoise
from flexhinf.designs.plans import true_robot
from flexhinf.designs.problem.presets import DesignProblem, choose
from flexhinf.designs.requirements.requirement import TOLERANCE
from flexhinf.designs.responses import ROBOT, JointLimits, Response, joint_limits, run_length, sample_robots
from flexhinf.designs.specification import Specification
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.loop.simulation.metrics import peak_of
from flexhinf.plant import GeneralisedPlant, Law
from flexhinf.robot import Robot

#: Number of rays by the largest number of states; with more states no region is sampled.
RAYS = ((10, 500), (20, 200))

#: Number of sampled robots that must keep the limits of a step, besides the nominal one.
SAMPLES = 12


@dataclass(frozen=True, eq=False)
class Task:
    """The step from `start` to `goal` (n,), link positions in rad or m; `progress` is called with what comes next."""

    robot: Robot
    s: Specification
    goal: np.ndarray
    start: np.ndarray
    progress: Callable[[str], None] = lambda text: None

    def choose(self, near: DesignProblem | None = None, **changes: Any) -> DesignProblem:
        """The problem of the specification with changes, searched from the weights of another one."""
        return choose(self.robot, self.goal, self.start, replace(self.s, **changes), near=near)

    def setup(self, law: Law, levels: EstimatorNoise | None = None) -> LoopSetup:
        """The loop of a law, with these noise levels."""
        return LoopSetup(self.robot, self.s.of_loop, law, self.goal, self.start, estimator_noise=levels)

    def solved(self, problem: DesignProblem, degree: int, levels: EstimatorNoise | None = None) -> LoopSetup:
        """The loop of the law that solves a problem."""
        return self.setup(solve_hji(problem.problem, problem.gamma, degree), levels)


# The degree of V -----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class DegreeChoice:
    """A degree of V with its solution, its sampled region and the cost of its step.

    The region is the largest level set {V ≤ level} in which sampling found no violation of the dissipation inequality.
    """

    degree: int  # of V; the law has one less
    solution: HJISolution
    residual: float  # largest relative residual of Eq. (8) in any degree, as measured
    solve_seconds: float  # wall time, s
    check_seconds: float = 0.0  # wall time, s
    level: float = math.nan  # of the region; nan where there is none, or none was looked for
    step_amplitude: float = math.nan  # largest step that starts in the region, unit of the states
    limit: str = "not sampled"  # what bounds the level set, or why there is none
    looked: bool = False  # whether the region was sampled
    acting: float = math.nan  # change of the input along the step of the lowest degree, see `_Trial.acting`
    cost: float = math.nan  # ∫|z|² of the step; inf if it diverges, nan if it was not run
    missed: tuple[str, ...] = ()  # requirements that the costlier step of a lower degree meets, this one not


#: States of the problem of one joint, with its integral.
STATES = 5


def tried_degrees(states: int, stated: Sequence[int] | None) -> tuple[int, ...]:
    """Degrees of V that are solved: as stated, or fewer for more states."""
    return tuple(stated) if stated is not None else ((2, 4, 6) if states <= 10 else (2, 4))


def rays_of(states: int, stated: int | None) -> int:
    """Rays in which a region is sampled: as stated, or fewer for more states."""
    return next((count for most, count in RAYS if states <= most), 0) if stated is None else stated


def solve_degrees(
    problem: GeneralisedPlant,
    degrees: Sequence[int],
    gamma: float,
    progress: Callable[[str], None] = lambda text: None,
) -> Iterator[DegreeChoice]:
    """Solve the problem about the goal to each degree; no region is sampled. Raises as `solve_hji`."""
    for degree in degrees:
        progress(f"degree {degree}: solve")
        start = time.perf_counter()
        solution = solve_hji(problem, gamma=gamma, degree=degree)
        largest = max((r.residual for r in solution.records), default=math.nan)
        yield DegreeChoice(degree, solution, largest, time.perf_counter() - start)


def with_region(
    choice: DegreeChoice, gamma: float, penalty: Any = None, rays: int = 500, seed: int = 0
) -> DegreeChoice:
    """The degree with the region of this inequality sampled, see `HJISolution.sampled_region`."""
    start, solution = time.perf_counter(), choice.solution
    check = solution.sampled_region(gamma=gamma, penalty=penalty, rays=rays, seed=seed)
    if check is None:
        choice = replace(choice, limit=f"no region: {solution.checked_margin(gamma, penalty).reason()}")
    else:
        choice = replace(choice, level=check.level, step_amplitude=check.step_amplitude(), limit=check.limit)
    return replace(choice, check_seconds=time.perf_counter() - start, looked=True)


def try_degrees(
    problem: GeneralisedPlant,
    degrees: Sequence[int],
    gamma_ratio: float = 1.5,
    checked_gamma_ratio: float = 1.6,
    checked_penalty: object = None,
    rays: int = 500,
    seed: int = 0,
    progress: Callable[[str], None] = lambda text: None,
    gamma_star: float | None = None,
) -> Iterator[DegreeChoice]:
    """Solve to each degree and sample the region where the solution holds; without rays no region is sampled.

    Parameters
    ----------
    gamma_ratio, checked_gamma_ratio : float
        γ/γ* of the design, and of the inequality that is checked.
    gamma_star : float, optional
        Of the ratios, by default the problem's own; of a robust problem that for all robots within the tolerances.

    Raises `InfeasibleGamma` or `InvalidInput` as `solve_hji` and `HJISolution.sampled_region`.
    """
    gamma_star = smallest_gamma(problem) if gamma_star is None else gamma_star
    for choice in solve_degrees(problem, degrees, gamma_ratio * gamma_star, progress):
        if rays:
            progress(f"degree {choice.degree}: sample the region")
            choice = with_region(choice, checked_gamma_ratio * gamma_star, checked_penalty, rays, seed)
        yield choice


def shrinking(choices: Sequence[DegreeChoice]) -> list[tuple[int, int]]:
    """Pairs (lower, higher) of neighbouring degrees whose higher one has the smaller sampled step."""
    ordered = sorted(choices, key=lambda choice: choice.degree)
    return [(a.degree, b.degree) for a, b in pairwise(ordered) if b.step_amplitude < a.step_amplitude]


#: Higher terms count if they change the input along the lowest degree's step by at least this fraction of its largest
#: value. Below it no step of the study became cheaper by more than 3 %.
ACTING = 0.5

#: A higher degree is used if it makes the step cheaper by more than this fraction. Every such step of the study settles
#: 18 to 44 % earlier; with 3 % some would settle later.
GAIN = 0.05

#: Instants of a run at which its cost is summed.
INSTANTS = 2000


def choose_degree(
    setup: LoopSetup, problem: GeneralisedPlant, choices: Sequence[DegreeChoice]
) -> tuple[DegreeChoice, tuple[DegreeChoice, ...]]:
    """The degree that is used, and all degrees in rising order, with the costs of their steps.

    `setup` is the loop of the design; its law does not matter. The cost is the penalty of the nominal `problem`.
    """
    lowest, *higher = sorted(choices, key=lambda choice: choice.degree)
    if not higher or setup.specification.via:  # with several laws the robot is never far from a law's pose
        return lowest, (lowest, *higher)
    first = used = _Trial(setup, problem, lowest)
    higher = [replace(choice, acting=acting) for choice, acting in zip(higher, first.acting(higher))]
    if all(choice.acting < ACTING for choice in higher):
        return first.choice, (first.choice, *higher)
    judged = [first.choice]
    for choice in higher:
        trial = _Trial(setup, problem, choice, first.length)
        if trial.choice.cost < (1.0 - GAIN) * used.choice.cost:
            missed = tuple(sorted(trial.missed - used.missed))
            trial.choice = replace(trial.choice, missed=missed)
            used = used if missed else trial
        judged.append(trial.choice)
    return used.choice, tuple(judged)


def step_cost(
    problem: GeneralisedPlant, response: Response, at: tuple[np.ndarray, np.ndarray] | None = None
) -> float:
    """Cost ∫|z|² dt of a run, without the penalty on the integrals of the error; infinite where the run diverged.

    Each law chooses its own integrals at the start of a step, so that the input does not jump; they count as zero. z is
    computed from deviations from the equilibrium `at` (state as in the run, and input), by default the problem's.
    """
    if response.diverged_at is not None:
        return math.inf
    run, few = response.run, slice(None, None, max(1, len(response.run.time) // INSTANTS))
    places = [run.names["state"].index(name) for name in problem.plant.states]
    states, holding_input = problem.operating_point[: len(places)], problem.operating_input
    if at is not None:
        states, holding_input = at[0][places], at[1]
    moved = np.zeros((len(run.time[few]), len(problem.state_names)))
    moved[:, : len(places)] = run.signals["state"][few][:, places] - states
    u, h = response.inputs[few] - holding_input, problem.fields(moved)[3]
    square = np.einsum("ki,ki->k", h, h) + np.einsum("ki,ij,kj->k", u, problem.r2, u)
    return float(np.trapezoid(square, run.time[few]))


class _Trial:
    """The step with the law of one degree, `length` seconds long; by default as stated, or by the slowest mode."""

    def __init__(
        self, setup: LoopSetup, problem: GeneralisedPlant, choice: DegreeChoice, length: float | None = None
    ) -> None:
        setup = replace(setup, law=choice.solution)
        length = setup.specification.duration if length is None else length
        if length is None:
            rates = np.linalg.eigvals(closed_loop(problem, choice.solution.gain)).real
            length = run_length(float(-rates.max())) + setup.command_time
        self.setup, self.problem, self.length, self.step = setup, problem, length, setup.step(length)
        self.choice = replace(choice, cost=step_cost(problem, self.step))

    def acting(self, others: Sequence[DegreeChoice]) -> list[float]:
        """For each other degree, the largest change of the input along this step as a fraction of this law's largest
        input. Inputs are deviations from the input at the goal, in the norm √(uᵀ R2 u)."""
        if self.step.diverged_at is not None:
            return [math.inf] * len(others)
        run, law, setup, r2 = self.step.run, self.choice.solution, self.setup, self.problem.r2
        command = setup.command
        wanted = setup.goal if command is None else np.reshape(command(run.time), (len(run.time), -1))
        grown = setup.specification.period * np.cumsum(self.step.positions - wanted, axis=0)
        columns = [run.names["state"].index(name) for name in self.problem.plant.states]
        about, integrals = law.operating_point[: len(columns)], setup.departure(law)[len(columns) :]
        if command is not None and setup.feeds_forward:  # in error coordinates
            about, integrals = setup.reference(command).state(run.time), 0.0
        moved = np.hstack([run.signals["state"][:, columns] - about, integrals + grown])
        moved = moved[:: max(1, len(run.time) // INSTANTS)]
        own, ratios = law.inputs(moved), list[float]()
        for other in others:
            with np.errstate(all="ignore"):
                more = other.solution.inputs(moved) - own
            change, largest = (float(np.einsum("ki,ij,kj->k", u, r2, u).max()) for u in (more, own))
            ratios.append(float(np.sqrt(change / largest)) if largest > 0.0 else 0.0)
        return ratios

    @cached_property
    def missed(self) -> frozenset[str]:
        """Requirements of the step that the nominal robot, or one of a few sampled robots, does not meet."""
        s, limits, setup = self.setup.specification, self.setup.limits, self.setup
        if limits.saturated is not None and limits.limits_peak:
            setup = replace(setup, unlimited=True)
        step = self.step if setup is self.setup else setup.step(self.length)
        lines = step_requirements(s, limits, step, "the step")
        if setup.robot.uncertain and s.draws != 0:
            runs = sampled_runs(
                setup,
                sample_robots(setup.true.robot, SAMPLES, s.seed),
                self.length,
                step.run.settings["sub_steps"],
            )
            lines += sample_requirements(s, limits, runs)
        return frozenset(line.what for line in lines if line.missed)


# Bandwidths within the limits of the joints --------------------------------------------------------------
#: Bandwidths of joints that exceed a limit are lowered by the first factor, down to the second fraction of the
#: original. Then all are raised together, until kept and exceeded differ by less than the third, relative.
COARSE, MIN_FRACTION, WIDTH = 0.7, 0.05, 0.04

#: Where lowering a joint's bandwidth reduces its use of a limit by less than this factor, the other joints move it;
#: then all bandwidths are lowered.
HELPS = 0.97

#: A step is as long as `run_length` for a slowest decay rate of this fraction of the bandwidth.
SLOWEST = 0.4


def problem_within_effort(task: Task, problem: DesignProblem, levels: EstimatorNoise | None) -> DesignProblem:
    """The problem, or one of lower bandwidths where its step exceeds limits of inputs or speeds.

    Default bandwidths are lowered until every joint keeps its limits. A stated bandwidth is not lowered: if it exceeds
    a stated limit it is refused, if it exceeds a limit of the robot the loop is judged as it is.

    `levels`: R^v of the estimator in these runs; by default what the specification states. Raises `InvalidInput` if a
    limit is not kept: with the best bandwidth found within it.
    """
    limits, s = joint_limits(task.robot, task.s), task.s
    if not (limits.limits_peak or limits.limits_speed) or problem.target is None:
        return problem
    task.progress("the peak input of the step")
    search, bandwidth = _BandwidthSearch(task, levels, limits, problem), problem.target.bandwidth
    peaks = search.peaks(problem)
    shares = search.shares(peaks)
    over, stated = shares > 1.0 + TOLERANCE, [limits.peak_source != ROBOT, limits.speed_source != ROBOT]
    if not over.any() or (s.bandwidth is not None and not over[stated].any()):
        return problem
    best, fractions = search.confirmed(*search.slower(bandwidth, peaks), bandwidth)
    if best is not None and s.bandwidth is None:
        return best
    kind, joint = divmod(int(np.argmax(shares)), len(bandwidth))
    peak, unit = peaks[kind, joint], (limits.effort_units, limits.speed_units)[kind][joint]
    what, name = (("peak of the input", "peak_effort"), ("speed of a link", "peak_speed"))[kind]
    where = f" in {limits.joints[joint]}" if len(limits.joints) > 1 else ""
    outcome = f"no loop down to {MIN_FRACTION:g} of it keeps the limit either"
    shaped = "shaping='quintic', " if s.bandwidth is None and s.shaping == "jump" else ""
    advice = f"{shaped}a larger `{name}`, or a shorter step (`start`)"
    if best is not None:
        slower = [f"{each:.3g}" for each in fractions * bandwidth]
        text = slower[0] if len(set(slower)) == 1 else f"({', '.join(slower)})"
        outcome = f"the best found within the limit is a bandwidth of {text} rad/s"
        advice = f"bandwidth={text}, or {advice}"
    raise InvalidInput(
        f"The specification cannot be met: the {what} binds.",
        f"expected at most {search.limits[kind, joint]:g} {unit}{where}; with a bandwidth of "
        f"{float(np.max(bandwidth)):.3g} rad/s the step of the nonlinear loop "
        f"{'diverges' if np.isinf(peak) else f'takes {peak:.4g} {unit}'}, within the tolerances; {outcome}",
        advice,
    )


class _BandwidthSearch:
    """Bandwidths whose step keeps the limits (2, n) of its peaks: inputs (V, N·m or N) and speeds (rad/s or m/s).

    While bandwidths are tried only the nominal robot runs. To its peaks the search adds `more`, the excess of the
    sampled robots' peaks in the last step that all of them ran. Another such step confirms the bandwidth found.
    """

    def __init__(
        self, task: Task, levels: EstimatorNoise | None, limits: JointLimits, first: DesignProblem
    ) -> None:
        self.task, self.levels, self.first = task, levels, first
        self.limits, robot, s = np.array([limits.peak, limits.speed]), task.robot, task.s
        self.more = np.zeros_like(self.limits)
        some = robot.uncertain and s.draws != 0
        self.sampled = sample_robots(true_robot(robot, s)[0], SAMPLES, s.seed) if some else ()
        # Inputs (1 + N, n) that hold the nominal and the sampled robots at the goal.
        self.holding_input = np.array(
            [robot.operating_point(task.goal, parameters=values)[1] for values in (None, *self.sampled)]
        )

    def shares(self, peaks: np.ndarray) -> np.ndarray:
        return np.where(np.isfinite(self.limits), peaks / self.limits, 0.0)

    def slower(self, bandwidth: np.ndarray, peaks: np.ndarray) -> tuple[DesignProblem | None, np.ndarray]:
        """The problem whose bandwidths are the largest fractions (n,) that keep the limits, and the fractions.

        `peaks` belong to the full bandwidths. Joints within their limits keep their bandwidth, unless every joint
        exceeds its limit or the others move a joint; then all fractions are the same. The problem is None where holding
        a sampled robot at the goal exceeds a limit: then no bandwidth helps.
        """
        high = low = np.ones(len(bandwidth))
        best, before = None, np.full(len(bandwidth), np.inf)
        if np.any(np.abs(self.holding_input) > self.limits[0]):
            return None, low
        while best is None and low.min() > MIN_FRACTION:
            shares = self.shares(peaks).max(axis=0)
            lowered = (shares > 1.0) | ~np.isfinite(shares)
            if np.any(lowered & np.isfinite(before) & (shares > HELPS * before)) or not lowered.any():
                lowered[:] = True
            high, low = low, np.where(lowered, COARSE * low, low)
            before = np.where(lowered, shares, np.inf)
            best, peaks = self.tried(low * bandwidth)
        if best is not None:
            width = 1.0 / (1.0 - WIDTH) - 1.0
            low, better = bisected(lambda part: self.tried(part * bandwidth)[0], low, high, width)
            best = better or best
        return best, low

    def confirmed(
        self, best: DesignProblem | None, fractions: np.ndarray, bandwidth: np.ndarray
    ) -> tuple[DesignProblem | None, np.ndarray]:
        """Problem and fractions, made a little slower until the step of all sampled robots keeps the limits."""
        while best is not None and (self.shares(self.peaks(best)) > 1.0).any():
            best = None
            while best is None and fractions.min() > MIN_FRACTION:
                fractions = (1.0 - WIDTH) * fractions
                best, _ = self.tried(fractions * bandwidth)
        return best, fractions

    def tried(self, bandwidth: np.ndarray) -> tuple[DesignProblem | None, np.ndarray]:
        """The problem of bandwidths (n,), None if it has no solution or its step exceeds a limit; and the expected
        peaks."""
        try:
            assert self.first.target is not None
            problem = self.task.choose(
                self.first, bandwidth=bandwidth.tolist(), damping=self.first.target.damping
            )
            peaks = self.nominal_step(problem)[0] + self.more
        except FlexhinfError:
            return None, np.full_like(self.limits, np.inf)
        return (None if (self.shares(peaks) > 1.0).any() else problem), peaks

    def peaks(self, problem: DesignProblem) -> np.ndarray:
        """Peaks of the nominal robot and of a few sampled ones.

        Inputs that hold each of them at the goal count too: a slow step may end before it is there.
        """
        nominal, setup, response, length = self.nominal_step(problem)
        if response.diverged_at is not None or not self.sampled:
            return nominal
        samples = sampled_runs(setup, self.sampled, length, response.run.settings["sub_steps"])
        peaks = np.maximum(nominal, [samples.inputs.max(axis=0), samples.speeds.max(axis=0)])
        self.more = peaks - nominal
        return peaks

    def nominal_step(self, problem: DesignProblem) -> tuple[np.ndarray, LoopSetup, Response, float]:
        """Peaks of the nominal robot, with inputs that hold all robots at the goal; loop, step and its length (s)."""
        length, degrees = self.task.s.duration, self.task.s.degrees
        degree = min(tried_degrees(len(problem.problem.state_names), degrees))
        setup = replace(self.task.solved(problem, degree, self.levels), unlimited=True)
        if length is None:
            assert problem.target is not None
            length = run_length(SLOWEST * float(np.min(problem.target.bandwidth))) + setup.command_time
        response = setup.step(length)
        peaks = np.full_like(self.limits, np.inf)
        if response.diverged_at is None:
            inputs = np.concatenate([response.inputs, self.holding_input])
            peaks = np.array([peak_of(inputs), peak_of(response.velocities)])
        return peaks, setup, response, length
