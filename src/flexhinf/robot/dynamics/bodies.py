"""Links as rigid bodies: mass, first moment and inertia about the joint, in the aligned frame."""

from __future__ import annotations

from typing import Any, NamedTuple

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

__all__ = ["Body", "bodies_of"]


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
    tree : Tree
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
