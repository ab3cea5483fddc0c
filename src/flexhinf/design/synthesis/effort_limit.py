"""A problem whose step keeps the limits of inputs and speeds, joint by joint: bandwidths are lowered until the
nonlinear loop keeps them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.design.estimators import EstimatorNoise
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.problem.presets import DesignProblem
from flexhinf.design.requirements import sampled_runs
from flexhinf.design.responses import ROBOT, JointLimits, Response, joint_limits, run_length, sample_robots
from flexhinf.design.specification import TOLERANCE
from flexhinf.design.synthesis.degrees import tried_degrees
from flexhinf.design.synthesis.task import Task
from flexhinf.errors import FlexhinfError, InvalidInput

#: The bandwidths of joints beyond a limit are lowered by the first factor, to at least the second of what they were;
#: then all are raised together until the third, relative, is left between kept and not kept.
COARSE, LEAST, WIDTH = 0.7, 0.05, 0.04

#: A joint whose share of a limit falls by less than this factor when its bandwidth is lowered is moved by the others:
#: then all are lowered.
HELPS = 0.97

#: Robots sampled within their tolerances whose peak counts, beside the nominal one's.
SAMPLES = 12

#: The step is run for the time constants of this fraction of the bandwidth.
SLOWEST = 0.4


def problem_within_effort(task: Task, problem: DesignProblem, levels: EstimatorNoise | None) -> DesignProblem:
    """The same problem, or with limits of inputs or speeds that its step exceeds, one of lower bandwidths.

    Default bandwidths are lowered until every joint keeps its limits. Those that the specification states are not:
    beyond a limit that it states too it is refused, beyond one of the robot the loop is judged as it is.

    `levels`: R^v of the estimator in these runs; by default what the specification states. Raises `InvalidInput` if a
    limit is not kept: with the best bandwidth found within it.
    """
    limits, s = joint_limits(task.robot, task.s), task.s
    if not (limits.limits_peak or limits.limits_speed) or problem.target is None:
        return problem
    task.progress("the peak input of the step")
    search = _Search(task, levels, limits, problem)
    peaks, most = search.peaks(problem), 1.0 + TOLERANCE
    if not peaks.exceeds(most).any():
        return problem
    stated = limits.peak_source != ROBOT, limits.speed_source != ROBOT
    if s.bandwidth is not None and not peaks.exceeds(most, *stated).any():
        return problem
    bandwidth = problem.target.bandwidth
    best, fractions = search.confirmed(*search.slower(bandwidth, peaks), bandwidth)
    if best is not None and s.bandwidth is None:
        return best
    by_input, by_speed = peaks.shares(speeds=False), peaks.shares(inputs=False)
    at_speed = bool(by_speed.max() > by_input.max())
    joint = int(np.argmax(by_speed if at_speed else by_input))
    what, name = ("speed of a link", "peak_speed") if at_speed else ("peak of the input", "peak_effort")
    limit, peak = (limits.speed, peaks.speeds) if at_speed else (limits.peak, peaks.inputs)
    unit = (limits.speed_units if at_speed else limits.effort_units)[joint]
    several = len(limits.joints) > 1
    found = f"no loop down to {LEAST:g} of it keeps the limit either"
    advice = f"a larger `{name}`, or a shorter step (`start`)"
    if best is not None:
        slower = fractions * bandwidth
        same = np.ptp(slower) < 1e-9 * slower.max()
        text = f"{slower[0]:.3g}" if same else ", ".join(f"{each:.3g}" for each in slower)
        found = f"the best found within the limit is a bandwidth of {text} rad/s"
        advice = f"bandwidth={text if same else f'({text})'}, or {advice}"
    demands = "diverges" if np.isinf(peak[joint]) else f"takes {peak[joint]:.4g}"
    where = f" {unit} in {limits.joints[joint]}" if several and np.isfinite(peak[joint]) else ""
    of = f" {unit} of {limits.joints[joint]}" if several else ""
    raise InvalidInput(
        f"The specification cannot be met: the {what} binds.",
        f"expected at most {limit[joint]:g}{of}; with a bandwidth of {float(np.max(bandwidth)):.3g} rad/s the step of "
        f"the nonlinear loop {demands}{where}, within the tolerances; {found}",
        advice,
    )


@dataclass(frozen=True, eq=False)
class _Peaks:
    """Largest inputs (V, N·m or N) and speeds (rad/s or m/s) of a step, (n,); infinite where it diverged."""

    inputs: np.ndarray
    speeds: np.ndarray
    limits: JointLimits

    def shares(self, inputs: bool = True, speeds: bool = True) -> np.ndarray:
        """Largest share (n,) of the limits of each joint; of the inputs alone, or the speeds alone, on request."""
        found = [
            np.where(np.isfinite(limit), peak / limit, 0.0)
            for peak, limit, counts in (
                (self.inputs, self.limits.peak, inputs),
                (self.speeds, self.limits.speed, speeds),
            )
            if counts
        ]
        return np.max(found, axis=0) if found else np.zeros(len(self.inputs))

    def exceeds(self, share: float, inputs: bool = True, speeds: bool = True) -> np.ndarray:
        """Which joints (n,) use more than this share of a limit."""
        return self.shares(inputs, speeds) > share


class _Search:
    """Bandwidths whose step keeps the limits.

    While bandwidths are tried only the nominal robot is run. What sampled ones took more than it in the last step that
    was run on all of them is added, and the bandwidth that is found is confirmed by another such step.
    """

    def __init__(
        self, task: Task, levels: EstimatorNoise | None, limits: JointLimits, first: DesignProblem
    ) -> None:
        self.task, self.levels, self.limits, self.first = task, levels, limits, first
        self.more: tuple[np.ndarray, np.ndarray] = (np.zeros(len(task.goal)), np.zeros(len(task.goal)))

    def slower(self, bandwidth: np.ndarray, peaks: _Peaks) -> tuple[DesignProblem | None, np.ndarray]:
        """The problem of large fractions (n,) of the bandwidths (n,) that keeps the limits, and the fractions.

        `peaks` are those of the bandwidths themselves. Where every joint is beyond its limit, or a joint is moved by
        the others, the fractions are the same; otherwise joints within their limits keep their bandwidth.
        """
        high = low = np.ones(len(bandwidth))
        best, before = None, np.full(len(bandwidth), np.inf)
        if self.needs_too_much():
            return None, low
        while best is None and low.min() > LEAST:
            shares = peaks.shares()
            lowered = (shares > 1.0) | ~np.isfinite(shares)
            if np.any(lowered & np.isfinite(before) & (shares > HELPS * before)) or not lowered.any():
                lowered[:] = True
            high, low = low, np.where(lowered, COARSE * low, low)
            before = np.where(lowered, shares, np.inf)
            best, peaks = self.tried(low * bandwidth)
        while best is not None and float(np.max(high / low)) > 1.0 / (1.0 - WIDTH):
            middle = np.sqrt(low * high)
            better, _ = self.tried(middle * bandwidth)
            low, high = (middle, high) if better is not None else (low, middle)
            best = best if better is None else better
        return best, low

    def confirmed(
        self, best: DesignProblem | None, fractions: np.ndarray, bandwidth: np.ndarray
    ) -> tuple[DesignProblem | None, np.ndarray]:
        """The same, or a little slower until the step of all sampled robots keeps the limits."""
        while best is not None and self.peaks(best).exceeds(1.0).any():
            best = None
            while best is None and fractions.min() > LEAST:
                fractions = (1.0 - WIDTH) * fractions
                best, _ = self.tried(fractions * bandwidth)
        return best, fractions

    def needs_too_much(self) -> bool:
        """Whether holding a sampled robot at the goal takes more than a limit: then no bandwidth helps."""
        return bool(np.any(np.abs(self.held) > self.limits.peak))

    @cached_property
    def held(self) -> np.ndarray:
        """Inputs (1 + N, n) that hold the nominal and the sampled robots at the goal."""
        robot, extras = self.task.robot, self.task.s.extras
        points = [robot.operating_point(self.task.goal, extras, values) for values in (None, *self.sampled)]
        return np.array([u for _, u in points])

    @cached_property
    def sampled(self) -> tuple[Mapping[str, Any], ...]:
        """Parameters of a few robots within the tolerances; none where none are to be looked at."""
        robot, s = self.task.robot, self.task.s
        return sample_robots(robot, SAMPLES, s.seed) if robot.uncertain and s.draws != 0 else ()

    def tried(self, bandwidth: np.ndarray) -> tuple[DesignProblem | None, _Peaks]:
        """The problem of bandwidths (n,), None if its step exceeds a limit or there is none; and the expected peaks."""
        try:
            assert self.first.target is not None
            damping = self.first.target.damping
            problem = self.task.choose(self.first, bandwidth=bandwidth.tolist(), damping=damping)
            peaks, *_ = self.nominal_step(problem)
            peaks = _Peaks(peaks.inputs + self.more[0], peaks.speeds + self.more[1], self.limits)
        except FlexhinfError:
            nothing = np.full(len(bandwidth), np.inf)
            return None, _Peaks(nothing, nothing, self.limits)
        return (None if peaks.exceeds(1.0).any() else problem), peaks

    def peaks(self, problem: DesignProblem) -> _Peaks:
        """Largest inputs and speeds of the step, of the nominal robot and of a few sampled ones.

        What holds each of them at the goal counts too: a slow step may end before it is there.
        """
        nominal, setup, response, length = self.nominal_step(problem)
        if response.diverged_at is not None or not self.sampled:
            return nominal
        samples = sampled_runs(setup, self.sampled, length, response.run.settings["sub_steps"])
        inputs = np.maximum(nominal.inputs, samples.inputs.max(axis=0))
        speeds = np.maximum(nominal.speeds, samples.speeds.max(axis=0))
        self.more = inputs - nominal.inputs, speeds - nominal.speeds
        return _Peaks(inputs, speeds, self.limits)

    def nominal_step(self, problem: DesignProblem) -> tuple[_Peaks, LoopSetup, Response, float]:
        """Peaks of the nominal robot, what holds all robots at the goal among them; loop, step and its length (s)."""
        s = self.task.s
        degree = min(tried_degrees(len(problem.problem.state_names), s.degrees))
        setup = self.task.solved(problem.problem, problem.gamma, degree, self.levels, saturation=np.inf)
        length = s.duration
        if length is None:
            assert problem.target is not None
            length = run_length(SLOWEST * float(np.min(problem.target.bandwidth))) + setup.command_time
        response = setup.step(length)
        if response.diverged_at is not None:
            nothing = np.full(len(self.task.goal), np.inf)
            return _Peaks(nothing, nothing, self.limits), setup, response, length
        inputs = np.abs(np.concatenate([response.inputs, self.held])).max(axis=0)
        peaks = _Peaks(inputs, np.abs(response.velocities).max(axis=0), self.limits)
        return peaks, setup, response, length
