"""A requirement in a file of its own, as CONTRIBUTING.md prints it: no other file names it."""

import numpy as np

from flexhinf.designs.requirements import RequirementKind, register


def rise_times(motion):
    """Times from 10 to 90 % of the way of each joint that travels, s."""
    way = np.where(motion.moves, motion.path[-1] - motion.path[0], np.nan)
    share = (motion.positions - motion.path[0]) / way
    low, high = (motion.time[np.argmax(share >= part, axis=0)] for part in (0.1, 0.9))
    return np.where(motion.moves, high - low, np.nan)


register(
    RequirementKind(
        "rise_time",
        what="rise time",
        criterion="from 10 to 90 % of the way, of the slowest joint",
        unit="s",
        help="Longest rise time of a joint in a step or a move.",
        example="0.5",
        of_motion=rise_times,
    )
)
