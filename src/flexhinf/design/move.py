"""The same way as the step, as robots are commanded: a jerk-limited move with feedforward, in error coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.bench import Bench
from flexhinf.design.response import Response, run_to
from flexhinf.errors import InvalidInput
from flexhinf.loop import JerkLimited, Moving
from flexhinf.robot import check_reference

__all__ = ["Move", "move_response", "planned"]

#: Limits of velocity, acceleration and jerk, over the way times ω, ω², ω³ for a bandwidth ω.
VELOCITY, ACCELERATION, JERK = 0.4, 0.4, 0.8

#: Of what an effort limit leaves beside the weight, the share that the feedforward may use; the move is stretched by
#: this factor until it does, so many times at most.
EFFORT_SHARE, STRETCH, STRETCHES = 0.7, 1.15, 25

#: A joint that does not move still needs limits: those of this part of the largest way.
LEAST_WAY = 1e-3


@dataclass(frozen=True, eq=False)
class Move:
    """A move and how well it was followed.

    Attributes
    ----------
    plan : JerkLimited
    response : Response
    """

    plan: Any
    response: Response

    @property
    def error(self) -> np.ndarray:
        """Link positions minus the plan, (N, n)."""
        wanted = self.plan(self.response.run.time)
        return self.response.positions - np.reshape(wanted, (len(self.response.run.time), -1))

    @property
    def metrics(self) -> list[dict[str, Any]]:
        """Largest and root-mean-square error of each joint, and its peak input; nothing where the run diverged."""
        if self.response.diverged is not None:
            return [{} for _ in self.response.goal]
        u = self.response.run.signals["input"]
        return [
            {
                "largest_error": float(np.abs(error).max()),
                "rms_error": float(np.sqrt(np.mean(error**2))),
                "peak_input": float(np.abs(u[:, joint]).max()),
            }
            for joint, error in enumerate(self.error.T)
        ]


def planned(bench: Bench, bandwidth: np.ndarray) -> Any:
    """The move from start to goal at the pace of the loop, stretched until its feedforward keeps the effort limit.

    Parameters
    ----------
    bench : Bench
    bandwidth : (n,)
        rad/s.

    Raises
    ------
    InvalidInput
        If it leaves the joints' limits, or no slower move keeps the effort limit.
    """
    s, robot = bench.specification, bench.robot
    way = np.abs(bench.goal - bench.start)
    way = np.maximum(way, LEAST_WAY * max(float(way.max()), 1e-6))
    pace = np.asarray(bandwidth, dtype=float)
    limit = _allowed(bench)
    slowest = _slowest_vibration(robot, bench.goal)
    for k in range(STRETCHES):
        pace_k = pace / STRETCH**k
        plan = JerkLimited(
            bench.start, bench.goal, VELOCITY * way * pace_k, ACCELERATION * way * pace_k**2, JERK * way * pace_k**3,
            smoothing=2.0 * math.pi / slowest,
        )  # fmt: skip
        try:
            check_reference(robot, plan, plan.duration, limit, period=s.period)
        except InvalidInput:
            if limit is None or k == STRETCHES - 1:
                raise
            continue
        return plan
    raise AssertionError("unreachable")


def _allowed(bench: Bench) -> float | None:
    """The largest input that the feedforward may ask for: part of the way from what holds both ends to the limit."""
    limit = bench.specification.effort_limit
    if limit is None:
        return None
    held = max(float(np.abs(bench.rest(at)[1]).max()) for at in (bench.start, bench.goal))
    return held + EFFORT_SHARE * max(0.0, limit - held)


def _slowest_vibration(robot: Any, goal: np.ndarray) -> float:
    from flexhinf.design.presets.weights import JointScales

    return float(JointScales.of(robot.plant(), robot.operating_point(goal)).vibration.min())


def move_response(bench: Bench, plan: Any, law: Any = None, plant: Any = None) -> Move:
    """The plan followed by the law in error coordinates, and half its time more at the goal."""
    duration = round(1.5 * plan.duration / bench.specification.period) * bench.specification.period
    reference = Moving(plan, bench.robot.inverse_dynamics)
    x, u = bench.rest(bench.start)
    loop = bench.loop(bench.controller(bench.start, moving=True, law=law), plant)
    response = run_to(
        loop, bench.goal, bench.start, reference=reference, noise=bench.noise, duration=duration,
        initial_state=x, initial_input=u, seed=bench.specification.seed,
    )  # fmt: skip
    return Move(plan, response)
