"""The mass matrix: the composite-rigid-body algorithm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.robot.dynamics.bodies import Body
from flexhinf.robot.dynamics.folded import minus
from flexhinf.robot.dynamics.motion import frames_of, joined, seen_by_parent
from flexhinf.robot.dynamics.tree import Tree


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
