"""Rest of links after a move: the worst move is made again with a longer one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexhinf.copies import shared_out
from flexhinf.designs import judge
from flexhinf.designs.loop_setup import DEVIATIONS
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.responses import Move
from flexhinf.designs.workspace.setup import WorkspaceSetup

#: Rest of the move that is made again to see whether links rest, s; largest deviation by noise in some 10,000 samples,
#: as a multiple of its standard deviation.
LONG, LARGEST_OF_NOISE = 20.0, 4.5

#: What the requirement that links rest does not look at.
UNSEEN = (
    "one move of {} is looked at: after short moves links with dry friction were seen to swing by up to 0.7 mrad, and "
    "near the limit another seed may judge otherwise"
)


def standstill_requirement(setup: WorkspaceSetup, runs: Sequence[Any], moves: Sequence[Move]) -> Requirement:
    """The requirement that links rest, for the move at whose end they swing most by their own limits, made again with a
    longer rest; `runs` are the arguments of `WorkspaceSetup.move`. What the linear loop does by noise is no limit
    cycle."""

    def judged(k: int, swing: np.ndarray, where: str) -> Requirement:
        noisy = LARGEST_OF_NOISE * setup.noise_spread(setup.linear(runs[k][0][1], runs[k][1]))[1]
        noisy[~np.isfinite(noisy)] = 0.0  # an unstable loop, which friction may hold for a while
        resolution = np.maximum(setup.position_resolution(DEVIATIONS), noisy)
        return judge.standstill_requirement(setup.specification, setup.limits, swing, resolution, where)

    lines = shared_out(lambda k: judged(k, moves[k].swing, ""), range(len(moves)), compiles=False)
    worst = int(np.argmax([line.found / line.limit for line in lines]))
    swing = setup.move(*runs[worst], dwell=LONG).swing
    line = judged(worst, swing, f"{LONG:g} s of rest after the worst move")
    return replace(line, criterion=f"{line.criterion}; {UNSEEN.format(len(moves))}")
