"""A shaper of streamed paths whose periods follow the pose: zero vibration and derivative [singer1990].

The path passes one filter for each vibration of the springs while the motors are held, of the frequency f,

    y(t) = (q(t) + 2 q(t − 1/2f) + q(t − 1/f)) / 4.

It has a double zero at f, so a frequency that is wrong by 10 % leaves 2.5 %. f changes with the pose: it is that of a
first pass, which has f of the path itself, as the arm is later than its path. Delays are continuous in the pose, and
samples are interpolated linearly, so that nothing jumps. The sum of weights is 1 at all times.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.arrays import Matrix, Vector
from flexhinf.errors import refuse_if
from flexhinf.robot.drives import DRIVES, TORQUE

if TYPE_CHECKING:
    from flexhinf.robot.layout import Layout
    from flexhinf.robot.robot import Robot

#: Poses at which the slowest vibration is looked for, and the half of a range without ends, rad or m.
POSES, HALF_RANGE = 1000, np.pi
#: Share of the slowest frequency found with which memory is planned; how much slower than on the path may be planned.
SLOWER, WEAKER = 0.9, 5.0


def spring_matrices(robot: Robot) -> Any:
    """The links while the motors are held, as a CasADi function of the pose: mass and stiffness (m, m) at the springs.

    The stiffness is that of the springs and gravity's slope; what a position drive yields to its load is part of the
    springs. Exact, by the derivatives of the inverse dynamics.
    """
    from flexhinf.plant.model import ParameterTable

    table = ParameterTable(dict(robot.plant_parameters()))
    shapes = tuple((name, value.shape) for name, value in table.values.items())
    return _spring_matrices(robot.links, robot.drive, robot.layout, shapes, tuple(table.vector().tolist()))


@lru_cache(maxsize=16)
def _spring_matrices(
    links: Any,
    drive: str,
    layout: Layout,
    shapes: tuple[tuple[str, tuple[int, ...]], ...],
    vector: tuple[float, ...],
) -> Any:
    import casadi as ca

    from flexhinf.plant.model import ParameterTable
    from flexhinf.robot.elastic import InverseFlow, traced_inverse

    n, elastic = layout.n, layout.elastic
    still, moved = (
        ca.DM.zeros(n),
        ca.DM(layout.inverse[:, elastic]),
    )  # what moves the output of one gear alone
    p = vars(ParameterTable({name: np.zeros(shape) for name, shape in shapes}).named(np.array(vector)))
    stiffness = ca.DM(np.atleast_1d(p["stiffness"]))
    q, acceleration = ca.SX.sym("q", n), ca.SX.sym("a", n)
    inverse = traced_inverse(InverseFlow(links, TORQUE.name, layout=layout), shapes)
    state, _ = inverse(q, still, acceleration, still, still, ca.DM(vector))
    load = stiffness * (state[2 * n : 2 * n + len(elastic)] - (ca.DM(layout.matrix) @ q)[elastic])
    mass = ca.jacobian(load, acceleration) @ moved
    slope = ca.jacobian(ca.substitute(load, acceleration, still), q) @ moved
    softness = 1.0 / stiffness
    if DRIVES[drive].takes_positions:
        yields = np.broadcast_to(np.divide(p["load_share"], p["drive_stiffness"]), n)
        softness = softness + ca.DM(yields[elastic])
    parts = [
        ca.densify(ca.substitute(mass, acceleration, still)),
        ca.densify(ca.diag(1.0 / softness) + slope),
    ]
    return ca.Function("spring_matrices", [q], parts, ["q"], ["mass", "stiffness"], {"cse": True})


def _squares(robot: Robot, poses: Matrix) -> Matrix:
    """Squares of the vibrations' angular frequencies (N, m), lowest first; negative where the springs do not hold."""
    size, count = len(robot.layout.elastic), len(poses)
    mass, stiffness = (
        np.reshape(np.array(part, dtype=float), (size, count, size)).transpose(1, 0, 2)
        for part in spring_matrices(robot)(poses.T)
    )
    lower = np.linalg.cholesky(mass)
    half = np.linalg.solve(lower, stiffness)
    return np.array(np.linalg.eigvalsh(np.linalg.solve(lower, half.transpose(0, 2, 1))), dtype=float)


def vibration_frequencies(robot: Robot, poses: Matrix) -> Matrix:
    """Frequencies (N, m) of the m elastic joints' vibrations at poses (N, n), slowest first, Hz.

    Motors are held by their drives; what a position drive yields to its load is part of the springs.
    Raises InvalidInput: where gravity is stronger than the springs.
    """
    squares = _squares(robot, poses)
    worst = int(np.argmin(squares[:, 0]))
    refuse_if(
        squares[worst, 0] <= 0.0,
        "The springs do not hold the links at a pose of the path.",
        f"expected springs stronger than gravity, got none at {poses[worst].round(4).tolist()}",
        "the unit of the stiffness; or the path without a shaper",
    )
    return np.sqrt(squares) / (2.0 * np.pi)


def longest_period(robot: Robot, path: Matrix) -> float:
    """Longest period of a vibration, s, along a path (N, n) and at poses all over the joints' ranges, with a margin.

    Poses where the springs hardly hold the links do not count.
    """
    ends = [(-HALF_RANGE, HALF_RANGE) if pair is None else pair for pair in robot.links.limits]
    low, high = np.nan_to_num(np.array(ends).T, posinf=HALF_RANGE, neginf=-HALF_RANGE)
    on_path = float(vibration_frequencies(robot, path)[:, 0].min())
    squares = _squares(robot, np.random.default_rng(0).uniform(low, high, (POSES, len(ends))))[:, 0]
    elsewhere = np.sqrt(squares[squares > (2.0 * np.pi * on_path / WEAKER) ** 2]) / (2.0 * np.pi)
    return 1.0 / (SLOWER * min(on_path, *elsewhere.tolist()))


def delayed(path: Matrix, period: float, by: Matrix) -> Matrix:
    """A path (N, n), which rested at its first row before, later by a time (N,) of each sample, s."""
    times = period * np.arange(len(path))
    columns: list[Vector] = [np.interp(times - by, times, column) for column in path.T]
    return np.stack(columns, axis=1)


def shaped_by(frequencies: Matrix, path: Matrix, period: float) -> Matrix:
    """A path (N, n) through the filters of frequencies (N, m), Hz, one after the other."""
    for hertz in frequencies.T:
        path = (path + 2.0 * delayed(path, period, 0.5 / hertz) + delayed(path, period, 1.0 / hertz)) / 4.0
    return path


def shaped_path(robot: Robot, path: Matrix, period: float) -> tuple[Matrix, Matrix]:
    """A path (N, n), shaped, and by how much it is later at each sample (N,), s."""
    frequencies = vibration_frequencies(robot, shaped_by(vibration_frequencies(robot, path), path, period))
    return shaped_by(frequencies, path, period), np.sum(0.5 / frequencies, axis=1)
