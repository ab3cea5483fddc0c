"""Links as rigid bodies: mass, first moment and inertia about the joint, in the aligned frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flexhinf.robot.dynamics.folded import (
    Matrix,
    Vector,
    apply_transposed,
    minus,
    plus,
    rotated_symmetric,
    scaled,
    times,
    transpose,
)
from flexhinf.robot.dynamics.tree import Tree


class Body(NamedTuple):
    """Inertial parameters of one link, seen from the origin of its aligned frame.

    Attributes
    ----------
    mass : element
        kg.
    moment : (3,)
        First moment m c, kg·m.
    inertia : 3 × 3
        About the frame's origin, kg·m².
    """

    mass: Any
    moment: Vector
    inertia: Matrix


def bodies_of(tree: Tree, mass: Any, centre_of_mass: Any, inertia: Any) -> list[Body]:
    """Bodies from the parameters of the links.

    Parameters
    ----------
    mass : (n,)
        kg.
    centre_of_mass : (n, 3)
        In the link's frame, m.
    inertia : (n, 6)
        xx, xy, xz, yy, yz, zz about the centre of mass, in axes parallel to the link's frame, kg·m².
    """
    return [
        _body(joint.alignment, mass[i], list(centre_of_mass[i]), list(inertia[i]))
        for i, joint in enumerate(tree.joints)
    ]


def _body(alignment: Matrix, mass: Any, centre: Vector, six: Vector) -> Body:
    xx, xy, xz, yy, yz, zz = six
    to_aligned = transpose(alignment)
    x, y, z = apply_transposed(alignment, centre)
    moment = scaled(mass, (x, y, z))
    (a, b, c), (_, d, e), (_, _, f) = rotated_symmetric(
        to_aligned, ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    )
    mxx, myy, mzz = times(moment[0], x), times(moment[1], y), times(moment[2], z)
    b, c = minus(b, times(moment[0], y)), minus(c, times(moment[0], z))  # Steiner: I + m (cᵀc 1 − c cᵀ)
    e = minus(e, times(moment[1], z))
    a, d, f = plus(a, plus(myy, mzz)), plus(d, plus(mxx, mzz)), plus(f, plus(mxx, myy))
    return Body(mass, moment, ((a, b, c), (b, d, e), (c, e, f)))


# Numbers ----------------------------------------------------------------------------------------------
def lumped(bodies: Sequence[tuple[float, np.ndarray, np.ndarray]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Several bodies that move together as one.

    Parameters
    ----------
    bodies : sequence of (mass, centre, inertia)
        kg; (3,) m in a common frame; (3, 3) kg·m² about the own centre. The masses have a positive sum.

    Returns
    -------
    mass, centre, inertia
        The same of the whole.
    """
    mass = sum(body[0] for body in bodies)
    centre: Any = sum(body[0] * np.asarray(body[1]) for body in bodies) / mass
    inertia = np.zeros((3, 3))
    for m, c, about in bodies:
        r = np.asarray(c) - centre
        inertia += about + m * (r @ r * np.eye(3) - np.outer(r, r))
    return float(mass), centre, inertia


def matrix_of(six: Any) -> np.ndarray:
    """xx, xy, xz, yy, yz, zz as a symmetric matrix."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], dtype=float)


def six_of(matrix: np.ndarray) -> list[float]:
    """The inverse of `matrix_of`."""
    return [float(matrix[i, j]) for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
