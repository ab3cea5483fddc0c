"""The numbers of a move, of the true link positions, as docs/workspace.md defines them.

Joints that slide count in m where others count in rad. Where a travel is compared with the largest one, that of a joint
of the other kind counts by its share of the joint range.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.workspace.arm import PERIOD
from benchmarks.workspace.goals import Move

__all__ = ["ARRIVED", "MOST", "PUSH", "PUSHED", "STEPS", "TAIL", "MoveMetrics", "metrics", "summary"]

#: The end of a move that counts for arriving and for ripple, samples; the largest error there of one that arrives.
TAIL, ARRIVED = 300, 1e-3
#: The criterion: most of a motion the wrong way, and of the ripple, per cent; and of bare steps, the wrong way and the
#: excursion of the joints that rest.
MOST, STEPS = {"wrong_way": 1.0, "ripple": 1.5}, {"wrong_way": 5.0, "excursion": 25.0}
#: A push on all links: share of the limits, samples before the end of the move, length in samples.
PUSH, PUSHED, PUSH_LENGTH = 0.3, 750, 50
#: Where a joint is back after a push, in parts of the largest travel.
BACK = 0.02
#: Share of a limit from which an input counts as saturated.
SATURATED = 0.999
#: Travel that counts at least, in parts of the largest.
LEAST = 0.05


@dataclass(frozen=True)
class MoveMetrics:
    """One move. A robot that is lost has no other numbers than these of its inputs."""

    lost: bool
    remaining: float  # largest |q − goal| of the last 0.3 s, rad or m
    wrong_way: float  # per cent of the joint's travel
    excursion: float  # of joints at rest, per cent of the largest travel
    path: float  # largest |q − q_d|, rad or m
    ripple: float  # largest standard deviation of an input over the last 0.3 s, per cent of its limit
    saturation: float  # per cent of samples with a motor at its limit
    samples: int
    peak: float  # largest |q − goal| from the push on, rad or m; 0 without a push
    back: float  # from the push until all joints stay within 2 % of the largest travel, s; infinite if never

    @property
    def arrives(self) -> bool:
        """Whether it ends below 1 mrad."""
        return not self.lost and self.remaining < ARRIVED


def metrics(
    move: Move, q: np.ndarray, u: np.ndarray, limit: np.ndarray, slides: np.ndarray, span: np.ndarray,
    pushed: bool = False,
) -> MoveMetrics:  # fmt: skip
    """Of a move with true link positions q (N, n) and inputs u (N, n); `span` is the joint range (n,)."""
    n = len(limit)
    saturation = 100.0 * float(np.mean(np.any(np.abs(u) >= SATURATED * limit, axis=1)))
    ripple = 100.0 * float(np.max(np.std(u[-TAIL:], axis=0) / limit))
    if len(q) < len(move):
        return MoveMetrics(True, np.inf, np.inf, np.inf, np.inf, ripple, saturation, len(u), np.inf, np.inf)
    wanted, travel = move.states[:, :n], np.abs(move.goal - move.start)
    largest = np.array(
        [np.where(slides == kind, travel, own * travel / span).max() for kind, own in zip(slides, span)]
    )
    scale = np.maximum(travel, LEAST * largest)
    low, high = (np.minimum(move.start, move.goal), np.maximum(move.start, move.goal))
    up = move.goal > move.start
    wrong = np.where(up, low - q.min(axis=0), q.max(axis=0) - high)
    moving = travel > 0.0
    away = np.max(np.abs(q - wanted), axis=0)
    error = np.abs(q - move.goal)
    peak, back = 0.0, 0.0
    if pushed:
        after = error[-PUSHED:]
        outside = np.any(after > BACK * largest, axis=1)
        peak = float(after.max())
        back = np.inf if outside[-1] else PERIOD * float(np.max(np.flatnonzero(outside), initial=-1) + 1)
    return MoveMetrics(
        False,
        float(error[-TAIL:].max()),
        float(np.max(100.0 * np.maximum(wrong, 0.0)[moving] / scale[moving], initial=0.0)),
        float(np.max(100.0 * away[~moving] / largest[~moving], initial=0.0)),
        float(away.max()),
        ripple,
        saturation,
        len(u),
        peak,
        back,
    )


def summary(rows: list[MoveMetrics]) -> dict[str, Any]:
    """All moves: how many arrive, the worst of each number, saturation of all samples; None for what is infinite."""

    def number(value: float) -> float | None:
        return float(f"{value:.6g}") if np.isfinite(value) else None

    remaining = [row.remaining for row in rows]
    worst = {
        name: number(max(getattr(row, name) for row in rows))
        for name in ("wrong_way", "excursion", "path", "ripple", "peak", "back")
    }
    return {
        "moves": len(rows),
        "arrived": sum(row.arrives for row in rows),
        "lost": sum(row.lost for row in rows),
        "remaining_median": number(float(np.median(remaining))),
        "remaining_worst": number(max(remaining)),
        **worst,
        "saturation": number(
            sum(row.saturation * row.samples for row in rows) / sum(row.samples for row in rows)
        ),
        "remaining": [number(value) for value in remaining],
    }
