"""What every law is tested with: durations, the load, the planned move, and the sampled robots.

All of it is fixed once, by the design's own law, and given to every evaluation: laws that are compared see the same
command, load, move, robots and seeds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.joint_limits import JointLimits, joint_limits
from flexhinf.design.specification import Specification
from flexhinf.errors import InvalidInput
from flexhinf.loop import JerkLimited
from flexhinf.robot import Robot, check_reference

__all__ = [
    "COMPARED_SAMPLES", "LOAD_FRACTION", "LOAD_START", "LONGEST", "Scenario", "default_load", "default_start",
    "plan_move", "run_length", "sample_count", "sample_robots",
]  # fmt: skip

#: Default step: rad for a joint that turns, m for one that slides.
TURN, SLIDE = 0.1, 0.01

#: A run lasts so many time constants of the slowest mode, and at least and at most so many seconds.
TIME_CONSTANTS, SHORTEST, LONGEST = 8.0, 0.5, 20.0

#: Default load: this fraction of the torque that the motors give at the peak input of the step.
LOAD_FRACTION = 0.1

#: The load begins at this fraction of its run.
LOAD_START = 0.1

#: Limits of the move's velocity, acceleration and jerk, over the way times ω, ω², ω³ for a bandwidth ω.
VELOCITY, ACCELERATION, JERK = 0.4, 0.4, 0.8

#: Largest fraction of what an effort limit leaves beside the weight that the feedforward may use; the rest is left for
#: feedback. The move is slowed down by the second factor until it does, at most so many times.
EFFORT_FRACTION, STRETCH, STRETCHES = 0.7, 1.15, 25

#: A joint that does not move still needs limits of its plan: those of this fraction of the largest way.
LEAST_WAY = 1e-3

#: Robots sampled within the tolerances by default: (largest number of states, robots).
SAMPLES = ((15, 200), (10_000, 20))

#: The same of a comparison, for each of its laws.
COMPARED_SAMPLES = ((15, 50), (10_000, 20))


@dataclass(frozen=True, eq=False)
class Scenario:
    """The runs that every law is evaluated in.

    Attributes
    ----------
    step_duration : float
        Of the step, bumpless or as a jump, s.
    load : (n,)
        Constant torques on the links, N·m or N.
    load_duration : float
        Of the run with the load, s; the load begins at `LOAD_START` of it.
    plan : JerkLimited
        The move from start to goal.
    robots : tuple of mapping
        Parameters of the robots sampled within their tolerances.
    sub_steps : int
        Runge–Kutta steps per period of the true plant.
    """

    step_duration: float
    load: np.ndarray
    load_duration: float
    plan: JerkLimited
    robots: tuple[Mapping[str, Any], ...]
    sub_steps: int


def default_start(robot: Robot, goal: np.ndarray) -> np.ndarray:
    """Start (n,) of a small step to the goal, towards the middle of each joint's range (down where it has none)."""
    start = np.array(goal, dtype=float)
    for joint, (limits, slides) in enumerate(zip(robot.links.limits, robot.links.slides)):
        size, low, high = SLIDE if slides else TURN, -np.inf, np.inf
        if limits is not None:
            low, high = limits
        up = np.isfinite(low + high) and goal[joint] < (low + high) / 2.0
        start[joint] = np.clip(goal[joint] + (size if up else -size), low, high)
    return start


def run_length(slowest: float) -> float:
    """Length of a run, s, for the slowest decay rate (1/s); `LONGEST` for a loop that does not decay."""
    if slowest <= 0.0:
        return LONGEST
    return min(max(math.ceil(2.0 * TIME_CONSTANTS / slowest) / 2.0, SHORTEST), LONGEST)


def default_load(per_input: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """`LOAD_FRACTION` of the torques (n,) that the motors give at the peak inputs of a step, with the same signs.

    Parameters
    ----------
    per_input : (n,)
        Torque per unit of input.
    peak : (n,)
        Peak input of each motor; a motor that hardly acts counts with a tenth of the largest.
    """
    return LOAD_FRACTION * per_input * np.maximum(peak, LOAD_FRACTION * peak.max())


def sample_count(
    robot: Robot, states: int, s: Specification, default: Sequence[tuple[int, int]] = SAMPLES
) -> int:
    """How many robots are sampled: as stated, or by the number of states; none for a robot without tolerances."""
    if not robot.uncertain:
        return 0
    return next(count for most, count in default if states <= most) if s.draws is None else s.draws


def sample_robots(robot: Robot, count: int, seed: int) -> tuple[Mapping[str, Any], ...]:
    """Parameters of robots that are uniformly distributed within their tolerances, the same for the same seed."""
    rng = np.random.default_rng([seed, 7])
    return tuple(robot.draw(rng) for _ in range(count))


def plan_move(
    robot: Robot,
    s: Specification,
    start: np.ndarray,
    goal: np.ndarray,
    bandwidth: np.ndarray,
    slowest_vibration: float,
    held: Sequence[np.ndarray],
) -> JerkLimited:
    """The move from start to goal as fast as the loop follows, slower until it keeps the joints' speeds and efforts.

    Parameters
    ----------
    robot, s
        Limits of effort and speed are the specification's, or the robot's.
    start, goal, bandwidth : (n,)
        Link positions, rad or m, and rad/s.
    slowest_vibration : float
        Its period smooths the plan, rad/s.
    held : sequence of (m,)
        Inputs that hold the robot at start and goal, beside which the limit leaves room.

    Raises
    ------
    InvalidInput
        If the move leaves the joints' ranges, or no slower move keeps the other limits.
    """
    way = np.abs(goal - start)
    way = np.maximum(way, LEAST_WAY * max(float(way.max()), 1e-6))
    limits = joint_limits(robot, s)
    limit = _feedforward_limit(limits, held)
    for k in range(STRETCHES):
        rate = np.asarray(bandwidth, dtype=float) / STRETCH**k
        plan = JerkLimited(
            start, goal, VELOCITY * way * rate, ACCELERATION * way * rate**2, JERK * way * rate**3,
            smoothing=2.0 * math.pi / slowest_vibration,
        )  # fmt: skip
        try:
            check_reference(robot, plan, plan.duration, limit, s.period, limits.speed)
        except InvalidInput:
            if (limit is None and not limits.limits_speed) or k == STRETCHES - 1:
                raise
            continue
        return plan
    raise AssertionError("unreachable")


def _feedforward_limit(limits: JointLimits, held: Sequence[np.ndarray]) -> np.ndarray | None:
    """The largest input (n,) that the feedforward may use of each motor; None without an effort limit."""
    if not limits.limits_effort:
        return None
    needed = np.abs(held).max(axis=0)
    return needed + EFFORT_FRACTION * np.maximum(0.0, limits.effort - needed)
