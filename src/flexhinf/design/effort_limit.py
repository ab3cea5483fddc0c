"""A problem whose step keeps the limit of the inputs: the bandwidth is lowered until the nonlinear loop keeps it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from flexhinf.design.degrees import tried_degrees
from flexhinf.design.estimators import EstimatorNoise
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.monte_carlo import sampled_runs
from flexhinf.design.scenario import run_length, sample_robots
from flexhinf.design.specification import TOLERANCE, Specification
from flexhinf.design.weights.choose import BANDWIDTH_FRACTION, DesignProblem, choose
from flexhinf.design.weights.scales import JointScales
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.hinf import solve_hji
from flexhinf.robot import Robot

__all__ = ["problem_within_effort"]

#: The fraction of the bandwidth that is tried goes down by the first factor, at least to the second; then it is
#: bisected to the third, relative.
COARSE, LEAST, WIDTH = 0.7, 0.05, 0.04

#: Robots sampled within their tolerances whose peak counts, beside the nominal one's.
SAMPLES = 12

#: The step is run for the time constants of this fraction of the bandwidth.
SLOWEST = 0.4


def problem_within_effort(
    robot: Robot,
    goal: np.ndarray,
    start: np.ndarray,
    s: Specification,
    problem: DesignProblem,
    levels: EstimatorNoise | None,
    progress: Callable[[str], None],
) -> DesignProblem:
    """The same problem, or with a limit of the inputs that its step exceeds, one of a lower bandwidth.

    A default bandwidth is lowered until the limit is kept; one that the specification states is not.

    Parameters
    ----------
    robot, goal, start, s
    problem : DesignProblem
    levels : EstimatorNoise or None
        R^v of the estimator in these runs; by default what the specification states.
    progress : callable

    Raises
    ------
    InvalidInput
        If the limit is not kept: with the best bandwidth found within it.
    """
    if s.peak_effort is None or problem.target is None:
        return problem
    progress("the peak input of the step")
    search = _Search(robot, goal, start, s, levels)
    peak = search.peak(problem)
    if peak <= (1.0 + TOLERANCE) * s.peak_effort:
        return problem
    scales = JointScales.of(robot.plant(), robot.operating_point(goal))
    bandwidth = BANDWIDTH_FRACTION * scales.held if s.bandwidth is None else s.bandwidth
    best, fraction = search.slower(np.asarray(bandwidth, dtype=float))
    if best is not None and s.bandwidth is None:
        return best
    raise _limit_exceeded(s, problem.target.bandwidth, peak, best, fraction)


class _Search:
    """Bandwidths whose step keeps the limit."""

    def __init__(
        self,
        robot: Robot,
        goal: np.ndarray,
        start: np.ndarray,
        s: Specification,
        levels: EstimatorNoise | None,
    ) -> None:
        self.robot, self.goal, self.start, self.s, self.levels = robot, goal, start, s, levels

    def slower(self, bandwidth: np.ndarray) -> tuple[DesignProblem | None, float]:
        """The problem of the largest fraction of a bandwidth that keeps the limit, and the fraction."""
        high = low = 1.0
        best = None
        while best is None and low > LEAST:
            high, low = low, COARSE * low
            best = self.kept(low * bandwidth)
        while best is not None and high - low > WIDTH * high:
            middle = float(np.sqrt(low * high))
            better = self.kept(middle * bandwidth)
            low, high = (middle, high) if better is not None else (low, middle)
            best = best if better is None else better
        return best, low

    def kept(self, bandwidth: np.ndarray) -> DesignProblem | None:
        """The problem of a bandwidth; None if its step exceeds the limit, or there is none."""
        try:
            problem = choose(self.robot, self.goal, self.start, replace(self.s, bandwidth=bandwidth.tolist()))
            return problem if self.peak(problem) <= float(self.s.peak_effort or np.inf) else None
        except FlexhinfError:
            return None

    def peak(self, problem: DesignProblem) -> float:
        """Largest input of the step, of the nominal robot and of a few sampled ones; infinite if one diverges.

        What holds each of them at the goal counts too: a slow step may end before it is there.
        """
        s, robot = self.s, self.robot
        degree = max(tried_degrees(len(problem.problem.state_names), s))
        law = solve_hji(problem.problem, problem.gamma, degree)
        free = replace(s, saturation=None)
        setup = LoopSetup(robot, free, law, self.goal, self.start, estimator_noise=self.levels)
        assert problem.target is not None
        length = s.duration
        if length is None:
            length = run_length(SLOWEST * float(np.min(problem.target.bandwidth)))
        response = setup.step(length)
        if response.diverged_at is not None:
            return np.inf
        peak = max(response.peak_input, float(np.abs(setup.equilibrium(self.goal)[1]).max()))
        if not robot.uncertain or s.draws == 0:
            return peak
        robots = sample_robots(robot, SAMPLES, s.seed)
        samples = sampled_runs(setup, robots, length, response.run.settings["sub_steps"])
        held = max(float(np.abs(setup.equilibrium(self.goal, values)[1]).max()) for values in robots)
        return max(peak, held, float(samples.peak.max()))


def _limit_exceeded(
    s: Specification, bandwidth: np.ndarray, peak: float, best: DesignProblem | None, fraction: float
) -> InvalidInput:
    found = f"no loop down to {LEAST:g} of it keeps the limit either"
    advice = "a larger `peak_effort`, or a shorter step (`start`)"
    if best is not None:
        slower = fraction * float(np.min(bandwidth))
        found = f"the best found within the limit is a bandwidth of {slower:.3g} rad/s"
        advice = f"bandwidth={slower:.3g}, or {advice}"
    demands = "diverges" if np.isinf(peak) else f"takes {peak:.4g}"
    return InvalidInput(
        "The specification cannot be met: the peak of the input binds.",
        f"expected at most {s.peak_effort:g}; with a bandwidth of {float(np.max(bandwidth)):.3g} rad/s the step of the "
        f"nonlinear loop {demands}, within the tolerances; {found}",
        advice,
    )
