"""Requirements on the loops and moves of a controller for a workspace."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexhinf.copies import shared_out
from flexhinf.design import judgement
from flexhinf.design.loop_setup import DEVIATIONS
from flexhinf.design.requirements import REQUIREMENTS, Requirement, loop_margins
from flexhinf.design.responses import Move
from flexhinf.design.specification import TOLERANCE, Specification
from flexhinf.design.workspace.setup import (
    CornerLoop,
    PoseLoop,
    WorkspaceSetup,
    corner_damping,
    gain_limit,
    pose_limits,
)

#: Rest of the move that is made again to see whether links rest, s; largest deviation by noise in some 10,000 samples,
#: as a multiple of its standard deviation.
LONG, LARGEST_OF_NOISE = 20.0, 4.5

#: What the requirement that links rest does not look at.
UNSEEN = (
    "one move of {} is looked at: after short moves links with dry friction were seen to swing by up to 0.7 mrad, and "
    "near the limit another seed may judge otherwise"
)

#: The requirement that the motors hold the robot.
UNHELD = "poses that the motors cannot hold"


def missed_by(line: Requirement) -> float:
    """How far a requirement is missed, found over allowed or the other way round; a limit of 0 counts as one of 1."""
    found, limit = (line.found, line.limit) if line.at_most else (line.limit, line.found)
    return found / limit if limit > 0.0 else 1.0 + found if line.at_most else math.inf


def pose_requirements(s: Specification, loops: Sequence[PoseLoop]) -> list[Requirement]:
    """Requirements on the loops at all poses."""
    where, (damping, ripple), gain = f"{len(loops)} random poses, sampled loop", pose_limits(s), gain_limit(s)
    extra = 1e3 * s.period * (s.delay_margin_limit or 0.0)
    late = [loop.late for loop in loops]
    gains = [max(loop.louder, loop.softer) for loop in loops]
    outside = "a pole outside the unit circle"
    nearly = (
        f"{outside} even with {100.0 * TOLERANCE:g} % less of it: a margin that lacks so little counts as met"
    )
    unstable = (
        ("unstable poses", "", outside, [loop.growth for loop in loops]),
        (f"poses unstable with {extra:g} ms more delay", "delay_margin", nearly, late),
        (f"poses unstable with a gain of {gain:g} or {1.0 / gain:.3g}", "gain_margin", nearly, gains),
    )
    row = REQUIREMENTS["corners"]
    return [
        *(
            replace(row, what=what, field=field, criterion=criterion).judge(
                s, 0.0, int(np.sum(np.array(growths) >= 1.0)), where
            )
            for what, field, criterion, growths in unstable
        ),
        loop_margins.damping_requirement(
            s, damping, min(l.damping for l in loops), s.damped_below_limit, where
        ),
        REQUIREMENTS["ripple"].judge(
            s,
            ripple,
            max(loop.ripple for loop in loops),
            where,
            criterion="largest standard deviation of an input by the noise of the sensors, per cent of its limit",
        ),
        *_growing(s, min(loop.fast_damping for loop in loops), where),
    ]


def loop_requirements(setup: WorkspaceSetup, poses: np.ndarray) -> list[Requirement]:
    """Requirements on loops that have a file of their own, for the worst of poses (N, n)."""
    where = f"{len(poses)} random poses, sampled loop"
    return loop_margins.loop_requirements(
        setup.specification, lambda: [setup.linear(pose) for pose in poses], where
    )


def holding_requirement(setup: WorkspaceSetup, poses: np.ndarray) -> list[Requirement]:
    """The requirement that the motors hold the robot at poses (N, n), where it is not met."""
    row = replace(
        REQUIREMENTS["corners"],
        what=UNHELD,
        criterion="poses at which the nominal robot needs more than a motor's limit to rest",
    )
    unheld = int(np.sum(setup.needs(poses) > 1.0))
    line = row.judge(None, 0.0, unheld, f"{len(poses)} random poses, at rest")
    return [line] if line.missed else []


def corner_requirements(s: Specification, loops: Sequence[CornerLoop]) -> list[Requirement]:
    """Requirements on the loops of robots at corners of their tolerances."""
    if not loops:
        return []
    where = f"{len(loops)} random poses, each of another robot at a corner of the tolerances"
    unstable = int(np.sum([loop.growth >= 1.0 for loop in loops]))
    damping = min(loop.damping for loop in loops)
    return [
        REQUIREMENTS["corners"].judge(None, 0.0, unstable, where),
        loop_margins.damping_requirement(None, corner_damping(s), damping, s.damped_below_limit, where),
        *_growing(s, min(loop.fast_damping for loop in loops), where),
    ]


def _growing(s: Specification, fast: float, where: str) -> list[Requirement]:
    """The requirement on fast oscillations where it is not met."""
    lines = loop_margins.fast_damping_requirement(fast, s.damped_below_limit, where)
    return [line for line in lines if line.missed]


def move_requirements(setup: WorkspaceSetup, moves: Sequence[Move], which: str) -> list[Requirement]:
    """Requirements on each kind of motion, on the limits of the joints, and on the time at those of the inputs, for the
    worst of the moves."""
    lines: dict[str, Requirement] = {}
    s, where = setup.specification, f"the worst of {len(moves)} moves, {which}"
    for move in moves:
        for line in judgement.motion_requirements(s, setup.limits, move.motion, 0.0, where, rests=True):
            other = lines.get(line.what)
            if other is None or missed_by(line) > missed_by(other):
                lines[line.what] = line
    runs = [move.response for move in moves]
    return [
        *lines.values(),
        *judgement.limit_requirements(setup.limits, runs, where),
        *judgement.saturation_requirement(setup.limits, runs, where),
    ]


def standstill_requirement(setup: WorkspaceSetup, runs: Sequence[Any], moves: Sequence[Move]) -> Requirement:
    """The requirement that links rest, for the move at whose end they swing most by their own limits, made again with a
    longer rest; `runs` are the arguments of `WorkspaceSetup.move`. What the linear loop does by noise is no limit
    cycle."""

    def judged(k: int, swing: np.ndarray, where: str) -> Requirement:
        noisy = LARGEST_OF_NOISE * setup.noise_spread(setup.linear(runs[k][0][1], runs[k][1]))[1]
        noisy[~np.isfinite(noisy)] = 0.0  # an unstable loop, which friction may hold for a while
        resolution = np.maximum(setup.position_resolution(DEVIATIONS), noisy)
        return judgement.standstill_requirement(setup.specification, setup.limits, swing, resolution, where)

    lines = shared_out(lambda k: judged(k, moves[k].swing, ""), range(len(moves)), compiles=False)
    worst = int(np.argmax([line.found / line.limit for line in lines]))
    swing = setup.move(*runs[worst], dwell=LONG).swing
    line = judged(worst, swing, f"{LONG:g} s of rest after the worst move")
    return replace(line, criterion=f"{line.criterion}; {UNSEEN.format(len(moves))}")
