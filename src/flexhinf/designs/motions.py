"""Motion of all joints from rest to rest: a jump of the command, or a plan that it follows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from flexhinf.loop import Signal

#: How far commands may lie beyond the ends of a motion: a share of the largest travel of a joint, and at least so much,
#: rad or m.
ROOM = (0.1, 0.05)

#: Instants at which the extreme positions of a plan are looked for.
INSTANTS = 41


class Plan(Signal, Protocol):
    """A motion of all joints from rest to rest: link positions (N, n) at times (N,), and their derivatives."""

    @property
    def duration(self) -> float:
        """From its beginning at time 0 to its end, s."""
        ...


@dataclass(frozen=True, eq=False)
class Jump:
    """A plan that is at its goal at once."""

    goal: np.ndarray  # (n,), rad or m
    duration = 0.0
    name = "jump"

    def __call__(self, t: Any) -> np.ndarray:
        """The goal (…, n) at times t."""
        return np.broadcast_to(self.goal, (*np.shape(t), len(self.goal)))

    def derivatives(self, t: Any, order: int = 4) -> np.ndarray:
        """The goal, and no velocity and more, (order + 1, …, n)."""
        at = self(t)
        return np.stack([at, *[np.zeros_like(at)] * order])


def plan_ends(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Link positions (n,) where a plan begins, and where it ends."""
    return np.reshape(plan(0.0), -1), np.reshape(plan(plan.duration), -1)


@dataclass(frozen=True, eq=False)
class Motion:
    """One motion of all joints from rest to rest."""

    start: np.ndarray  # (n,), rad or m
    goal: np.ndarray  # (n,), likewise
    plan: Plan  # from start to goal
    length: float | None = None  # of its run, s; None: by the loop, or by the plan

    @property
    def jumps(self) -> bool:
        """Whether the command is at the goal at once."""
        return self.plan.duration == 0.0

    @property
    def ends(self) -> np.ndarray:
        """Start and goal (2, n), rad or m."""
        return np.array([self.start, self.goal])

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n,) each, rad or m, between which commands lie, with `ROOM`."""
        times = np.linspace(0.0, self.plan.duration, INSTANTS)
        poses = np.vstack([self.ends, np.reshape(self.plan(times), (INSTANTS, -1))])
        share, smallest = ROOM
        margin = max(share * float(np.ptp(poses, axis=0).max()), smallest)
        return poses.min(axis=0) - margin, poses.max(axis=0) + margin
