"""A shaper of streamed paths whose periods follow the pose: zero vibration and derivative [singer1990].

The path passes one filter for each vibration of the springs while the motors are held, of the frequency f,

    y(t) = (q(t) + 2 q(t − 1/2f) + q(t − 1/f)) / 4.

It has a double zero at f, so a frequency that is wrong by 10 % leaves 2.5 %. f changes with the pose: it is that of a
first pass, which has f of the path itself, as the arm is later than its path. Delays are continuous in the pose, and
samples are interpolated linearly, so that nothing jumps. The sum of weights is 1 at all times.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flexhinf.errors import refuse_if

if TYPE_CHECKING:
    from flexhinf.robot.robot import Robot

#: Step of central differences of gravity's torques, rad or m.
STEP = 1e-4


def vibration_frequencies(robot: Robot, poses: np.ndarray) -> np.ndarray:
    """Frequencies (N, m) of the m elastic joints' vibrations at poses (N, n), slowest first, Hz.

    Motors are held by their drives; what a position drive yields to its load is part of the springs.
    Raises InvalidInput: where gravity is stronger than the springs.
    """
    layout, p = robot.layout, robot.plant_parameters()
    stiffness = np.atleast_1d(np.asarray(p["stiffness"], dtype=float))

    def torques(at: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        still = np.zeros_like(at)
        state, _ = robot.inverse_dynamics(at, still, acceleration, still, still)
        q, _, theta, _ = layout.split(state.T)
        return stiffness * (theta - layout.at_springs(q)).T

    still, size = np.zeros_like(poses), len(layout.elastic)
    weight = torques(poses, still)
    mass, gravity = np.empty((2, len(poses), size, size))
    for column, joint in enumerate(layout.elastic):
        unit = np.zeros_like(poses)
        unit[:] = layout.inverse[:, joint]  # what moves the output of this gear alone
        mass[:, :, column] = torques(poses, unit) - weight
        above, below = (torques(poses + sign * STEP * unit, still) for sign in (1.0, -1.0))
        gravity[:, :, column] = (above - below) / (2.0 * STEP)
    softness = 1.0 / stiffness
    if robot.drive == "position":
        yields = np.broadcast_to(np.divide(p["load_share"], p["drive_stiffness"]), poses.shape[1])
        softness = softness + yields[layout.elastic]
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(mass, np.diag(1.0 / softness) + gravity)).real)
    worst = divmod(int(np.argmin(squares)), size)[0] if size else 0
    refuse_if(
        bool(size) and squares.min() <= 0.0,
        "The springs do not hold the links at a pose of the path.",
        f"expected springs stronger than gravity, got none at {poses[worst].round(4).tolist()}",
        "the unit of the stiffness; or the path without a shaper",
    )
    return np.sqrt(squares) / (2.0 * np.pi)


def delayed(path: np.ndarray, period: float, by: np.ndarray) -> np.ndarray:
    """A path (N, n), which rested at its first row before, later by a time (N,) of each sample, s."""
    times = period * np.arange(len(path))
    return np.stack([np.interp(times - by, times, column) for column in path.T], axis=1)


def shaped_by(frequencies: np.ndarray, path: np.ndarray, period: float) -> np.ndarray:
    """A path (N, n) through the filters of frequencies (N, m), Hz, one after the other."""
    for hertz in frequencies.T:
        path = (path + 2.0 * delayed(path, period, 0.5 / hertz) + delayed(path, period, 1.0 / hertz)) / 4.0
    return path


def shaped_path(robot: Robot, path: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """A path (N, n), shaped, and by how much it is later at each sample (N,), s."""
    frequencies = vibration_frequencies(robot, shaped_by(vibration_frequencies(robot, path), path, period))
    return shaped_by(frequencies, path, period), np.sum(0.5 / frequencies, axis=1)
