"""Use of the joints' limits in a run: inputs with their changes, speeds of links, and ranges of positions."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import RequirementKind, register
from flexhinf.designs.requirements.requirement import SPEED
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Matrix
    from flexhinf.designs.requirements.measured import Motion
else:
    np = late_package("numpy")


def inputs(motion: Motion) -> Matrix:
    """Size of each input (N, n), V, A, N·m or N."""
    return np.abs(motion.inputs)


def speeds(motion: Motion) -> Matrix:
    """Speed of each link (N, n), rad/s or m/s."""
    return np.abs(motion.velocities)


def distances_beyond(motion: Motion) -> Matrix:
    """Distance of each link (N, n) beyond its range, rad or m."""
    q = motion.positions
    return np.maximum(np.maximum(motion.lower - q, q - motion.upper), 0.0)


def rates(motion: Motion) -> Matrix:
    """Changes of the inputs (N, n) from sample to sample, per s."""
    return np.abs(_changes(motion)[0])


def accelerations(motion: Motion) -> Matrix:
    """Changes of these rates (N, n), per s²."""
    return np.abs(_changes(motion)[1])


def _changes(motion: Motion) -> tuple[Matrix, Matrix]:
    from flexhinf.robot.command_limits import command_changes

    return command_changes(motion.inputs, motion.period)


def times_at_limit(motion: Motion) -> Matrix:
    """Time (N, n) for which an input, or its rate, stays at its limit, s, where that begins; elsewhere 0."""
    from flexhinf.loop.controller.status import NEAR_LIMIT

    share, time = 1.0 - NEAR_LIMIT, motion.time
    full = (np.abs(motion.inputs) >= share * motion.kept) | (rates(motion) >= share * motion.rate)
    edges = np.diff(np.pad(full.astype(int), ((1, 1), (0, 0))), axis=0).T
    period, lasting = float(time[-1]) / max(len(time) - 1, 1), np.zeros(full.shape)
    for k, edge in enumerate(edges):
        begun = np.flatnonzero(edge > 0)
        lasting[begun, k] = period * (np.flatnonzero(edge < 0) - begun)
    return lasting


for _kind in (
    RequirementKind("peak", "peak input", "largest |input| of all motors", of_motion=inputs),
    RequirementKind("speed", SPEED, "|velocity| of the link nearest to its limit", of_motion=speeds),
    RequirementKind(
        "range",
        "distance beyond a joint's range",
        "largest of all true link positions",
        of_motion=distances_beyond,
    ),
    RequirementKind(
        "input_rate",
        "rate of an input",
        "change of an input between two samples, per s, nearest to what its drive takes; the controller keeps it",
        of_motion=rates,
    ),
    RequirementKind(
        "input_acceleration",
        "acceleration of an input",
        "change of that rate between two samples, per s, nearest to what its drive takes",
        of_motion=accelerations,
    ),
    RequirementKind(
        "at_limit",
        "time at an input's limit",
        "longest time for which an input stays at {share:g} % of its limit",
        "s",
        of_motion=times_at_limit,
    ),
):
    register(replace(_kind, bounded=True, place=0.0))
