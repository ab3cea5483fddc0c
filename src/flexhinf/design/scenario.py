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

from flexhinf.design.responses import Plan
from flexhinf.design.specification import Specification
from flexhinf.robot import Robot

#: Default step: rad for a joint that turns, m for one that slides.
TURN, SLIDE = 0.1, 0.01

#: A run lasts so many time constants of the slowest mode, and at least and at most so many seconds.
TIME_CONSTANTS, SHORTEST, LONGEST = 8.0, 0.5, 20.0

#: Default load: this fraction of the torque that the motors give at the peak input of the step.
LOAD_FRACTION = 0.1

#: The load begins at this fraction of its run.
LOAD_START = 0.1

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
    plan : Plan
        The move from start to goal, or the stated one.
    robots : tuple of mapping
        Parameters of the robots sampled within their tolerances.
    sub_steps : int
        Runge–Kutta steps per period of the true plant.
    rest : float or None
        How long the move is observed at its end, s; None for half of its duration.
    """

    step_duration: float
    load: np.ndarray
    load_duration: float
    plan: Plan
    robots: tuple[Mapping[str, Any], ...]
    sub_steps: int
    rest: float | None = None


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


def start_and_goal(robot: Robot, s: Specification, move: Plan | None) -> tuple[np.ndarray, np.ndarray]:
    """Link positions (n,) between which the step goes: as stated; the goal is by default the end of a move."""
    n = len(robot.joint_names)
    end = None if move is None else np.reshape(move(move.duration), -1)
    goal = robot.operating_point(end if s.pose is None else s.pose)[0][:n]
    start = default_start(robot, goal) if s.start is None else robot.operating_point(s.start)[0][:n]
    return start, goal


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
