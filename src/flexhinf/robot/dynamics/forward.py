"""Forward dynamics: the mass matrix, factored from the leaves to the base.

The mass matrix: the composite-rigid-body algorithm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.robot.dynamics.bodies import Body, frames_of, joined, regrouped, seen_by_parent
from flexhinf.robot.dynamics.newton_euler import inverse_dynamics
from flexhinf.robot.dynamics.tree import Tree, Vector, minus, plus, times


def mass_matrix(tree: Tree, bodies: Sequence[Body], q: Any) -> np.ndarray:
    """M(q), (n, n) of any element, [featherstone2008].

    Parameters
    ----------
    q : (n,)
        Positions of the joints.
    """
    frames = frames_of(tree, q)
    n, composite = len(tree), list(bodies)
    matrix = np.zeros((n, n), dtype=object)
    for i in reversed(range(n)):
        force, moment = _column(tree.joints[i].slides, composite[i])
        matrix[i, i] = force[2] if tree.joints[i].slides else moment[2]
        j = i
        while tree.parents[j] >= 0:
            force, moment = frames[j].to_parent(force, moment)
            j = tree.parents[j]
            matrix[i, j] = matrix[j, i] = force[2] if tree.joints[j].slides else moment[2]
        parent = tree.parents[i]
        if parent >= 0:
            composite[parent] = joined(composite[parent], seen_by_parent(composite[i], frames[i]))
    return matrix


def _column(slides: bool, body: Body) -> tuple[Any, Any]:
    """Force and moment for a unit acceleration of the joint."""
    x, y, _ = body.moment
    if slides:
        return (0.0, 0.0, body.mass), (y, minus(0.0, x), 0.0)
    return (minus(0.0, y), x, 0.0), tuple(row[2] for row in body.inertia)


def forward_dynamics(
    tree: Tree,
    bodies: Sequence[Body],
    q: Any,
    dq: Any,
    torque: Any,
    gravity: Vector,
    armature: Sequence[Any] | None = None,
) -> list[Any]:
    """Joint accelerations q̈ = M(q)⁻¹ (τ − C(q, q̇) q̇ − G(q)), [featherstone2008].

    With `regrouped` bodies that is less work, for up to twelve joints, than the articulated-body algorithm, and
    the chain of operations that wait for each other is half as long.

    Parameters
    ----------
    q, dq, torque : (n,)
        Positions, velocities and torques (forces of prismatic joints) of the joints, of any element.
    gravity : (3,)
        Acceleration of free fall in the world's frame, m/s².
    armature : (n,), optional
        Inertia that turns (mass that slides) with a joint alone: a rotor behind a rigid gear, M + diag(armature).
        0.0 for none.
    """
    n, fewer = len(tree), regrouped(tree, bodies)
    bias = inverse_dynamics(tree, fewer, q, dq, [0.0] * n, gravity)
    matrix = mass_matrix(tree, fewer, q)
    for i in range(n if armature is not None else 0):
        matrix[i, i] = plus(matrix[i, i], armature[i])  # type: ignore[index]
    return _solved(matrix, [minus(torque[i], bias[i]) for i in range(n)])


def _solved(matrix: np.ndarray, right: list[Any]) -> list[Any]:
    """x of M x = b by M = Lᵀ D L: from the leaves on, joints of different branches stay apart."""
    n, rows, x = len(right), [list(row) for row in matrix], list(right)
    lower: list[list[Any]] = [[] for _ in range(n)]
    inverse: list[Any] = [None] * n
    for k in reversed(range(n)):
        inverse[k] = 1.0 / rows[k][k]
        lower[k] = [times(rows[k][i], inverse[k]) for i in range(k)]
        for i in range(k):
            for j in range(i + 1):
                rows[i][j] = minus(rows[i][j], times(lower[k][i], rows[k][j]))
            x[i] = minus(x[i], times(lower[k][i], x[k]))
    for k in range(n):
        x[k] = times(x[k], inverse[k])
        for i in range(k):
            x[k] = minus(x[k], times(lower[k][i], x[i]))
    return x
