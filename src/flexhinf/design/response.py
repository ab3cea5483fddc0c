"""Runs from one rest to another in the nonlinear closed loop, and their figures of merit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.loop import Loop, Trajectory

__all__ = ["Response", "default_start", "run_length", "run_to", "step_response"]

#: Default step: rad for a joint that turns, m for one that slides.
TURN, SLIDE = 0.1, 0.01

#: A run lasts so many time constants of the slowest mode, and at least and at most so many seconds.
TIME_CONSTANTS, SHORTEST, LONGEST = 8.0, 0.5, 20.0


@dataclass(frozen=True, eq=False)
class Response:
    """One run.

    Attributes
    ----------
    run : Trajectory
        To its end, or to where it diverged.
    goal, start : (n,)
        Link positions.
    diverged : float or None
        When the loop left the finite numbers, s.
    """

    run: Trajectory
    goal: np.ndarray
    start: np.ndarray
    diverged: float | None = None

    @cached_property
    def positions(self) -> np.ndarray:
        """Link positions (N, n)."""
        return self.run.signals["state"][:, : len(self.goal)]

    @cached_property
    def metrics(self) -> list[dict[str, Any]]:
        """Figures of merit of each joint's true link position; nothing where the run diverged."""
        if self.diverged is not None:
            return [{} for _ in self.goal]
        from flexhinf.loop.simulation.metrics import StepShape
        from flexhinf.loop.simulation.metrics import step_response as judged

        rows = []
        for joint, (begin, end) in enumerate(zip(self.start, self.goal)):
            position = self.positions[:, joint]
            tail = max(1, math.ceil(0.1 * len(position)))
            shape = StepShape(float(begin), float(end), 0.0)
            last = float(np.abs(position[-tail:] - end).max())
            u = self.run.signals["input"][:, joint]
            rows.append(
                {
                    **judged(self.run.time, position, shape),
                    "steady_state_error": last,
                    "peak_input": float(np.abs(u).max()),
                    "input_noise": float(u[-tail:].std()),
                }
            )
        return rows


def default_start(robot: Any, goal: np.ndarray) -> np.ndarray:
    """A small step from the goal, towards the middle of each joint's range (down where there is none)."""
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


def run_to(loop: Loop, goal: np.ndarray, start: np.ndarray, **options: Any) -> Response:
    """A run of a loop; one that diverges is an answer too: the run so far, and when.

    Parameters
    ----------
    loop : Loop
    goal, start : (n,)
        Link positions.
    **options
        Of `Loop.run`.
    """
    try:
        run = loop.run(**options)
    except NumericalFailure as failure:
        partial: Trajectory | None = getattr(failure, "trajectory", None)
        if partial is None:
            raise
        return Response(partial, goal, start, float(partial.time[-1]))
    return Response(run, goal, start)


def step_response(
    loop: Loop,
    start: tuple[np.ndarray, np.ndarray],
    goal: np.ndarray,
    noise: np.ndarray | None,
    duration: float,
    seed: int,
) -> Response:
    """From the rest `start` = (x, u) of the true plant, with the goal commanded from the first sample on."""
    x, u = start
    return run_to(
        loop,
        goal,
        x[: len(goal)],
        noise=noise,
        duration=duration,
        initial_state=x,
        initial_input=u,
        seed=seed,
    )
