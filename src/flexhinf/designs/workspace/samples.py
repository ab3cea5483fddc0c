"""Poses, moves, robots of random samples by which a controller for a workspace is judged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexhinf.designs.responses import Move
from flexhinf.designs.specification import Specification
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.robot import Robot
from flexhinf.robot.parameters import PlantValues

#: Rounds of further moves of robots at corners: how many there are where the worst of those before uses a share of a
#: limit between these. Of 40 goals in another simulator 9 passed a limit of which the worst of the first 20 had used
#: 0.7; of 240 by other seeds 5 passed one of which the worst of 60 had used 0.96, by up to 1.8 times.
FURTHER = ((40, 0.6, 3.0), (100, 0.8, 1.0))

#: Poses and goals that are judged, and seeds, to which 100 times the seed of the specification is added.
POSES, GOALS = 200, 20
POSES_SEED, GOALS_SEED, SAMPLED_SEED = 1, 7, 11


def sampled_moves(robot: Robot, s: Specification) -> int:
    """How many robots at corners of their tolerances make a move each; none without tolerances."""
    return (GOALS if s.draws is None else s.draws) if robot.uncertain else 0


def corner_moves(
    setup: WorkspaceSetup, after: int, first: Sequence[np.ndarray]
) -> list[tuple[np.ndarray, PlantValues, int]]:
    """Arguments of `WorkspaceSetup.move` of robots at corners: of the first round along the nominal moves, whose ends
    (2, n) are the `first`, of each round `after` it between goals of their own."""
    own = 100 * setup.specification.seed + after
    count = FURTHER[after - 1][0] if after else sampled_moves(setup.robot, setup.specification)
    before = GOALS + sum(count for count, *_ in FURTHER[: after - 1]) if after else 0
    move_ends = setup.move_ends(count, GOALS_SEED + own)[0] if after else first
    robots = setup.true.robot.random_corners(count, SAMPLED_SEED + own)
    return [(move_ends[k % len(move_ends)], values, before + k) for k, values in enumerate(robots)]


def ends_of(moves: Sequence[Move]) -> np.ndarray:
    """Starts and goals (M, 2, n) of M moves, rad or m."""
    return np.array([(move.response.start, move.response.goal) for move in moves])
