"""Links as rigid bodies: mass, first moment and inertia about the joint, in the aligned frame.

Where joints put their links, and bodies as they are seen from the parent.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flexhinf.robot.dynamics.tree import (
    IDENTITY,
    ZERO,
    Matrix,
    Tree,
    Vector,
    add,
    add_matrices,
    apply,
    apply_transposed,
    cross,
    dot,
    minus,
    plus,
    product,
    rotated_symmetric,
    scaled,
    symmetric,
    times,
    transpose,
)


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


class Frame(NamedTuple):
    """Where an aligned frame is in its parent's.

    Attributes
    ----------
    rotation : 3 × 3
        From this frame's components to the parent's.
    translation : (3,)
        In the parent's frame.
    """

    rotation: Matrix
    translation: Vector

    def to_parent(self, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
        """A force and a moment about the child's origin, as seen from the parent's."""
        turned = apply(self.rotation, force)
        return turned, add(apply(self.rotation, moment), cross(self.translation, turned))


def frames_of(tree: Tree, q: Any) -> list[Frame]:
    """Frames at the joint positions q (n,)."""
    frames = []
    for i, (joint, (rotation, translation)) in enumerate(zip(tree.joints, tree.aligned)):
        if joint.slides:
            along = tuple(row[2] for row in rotation)
            frames.append(Frame(rotation, add(translation, scaled(q[i], along))))
        else:
            s, c = np.sin(q[i]), np.cos(q[i])
            frames.append(Frame(product(rotation, ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))), translation))
    return frames


def joined(one: Body, other: Body) -> Body:
    """Two bodies that move together, seen from one frame."""
    return Body(
        plus(one.mass, other.mass), add(one.moment, other.moment), add_matrices(one.inertia, other.inertia)
    )


def seen_by_parent(body: Body, frame: Frame) -> Body:
    """The body about the parent's origin: h + m r, and I − [h][r] − [r][h + m r]."""
    r, h = frame.translation, apply(frame.rotation, body.moment)
    moment = add(h, scaled(body.mass, r))
    inertia = rotated_symmetric(frame.rotation, body.inertia)

    def entry(i: int, j: int) -> Any:
        felt = add(cross(h, cross(r, IDENTITY[j])), cross(r, cross(moment, IDENTITY[j])))
        return minus(inertia[i][j], dot(IDENTITY[i], felt))

    return Body(body.mass, moment, symmetric(entry))


def regrouped(tree: Tree, bodies: Sequence[Body]) -> list[Body]:
    """Other bodies that move in the same way, with zeros among their parameters [gautier1990].

    About the axis z of a revolute joint, a mass on the axis and equal moments of inertia about x and y, without one
    about z, are the same whatever its angle: a link's mass, its first moment along z and its inertia about y are
    given to its parent, by numbers that do not depend on the joints' positions. The base needs none. Equations of
    motion and the torques of joints are those of the given bodies; forces between links are not.
    """
    moved = list(bodies)
    for i in reversed(range(len(tree))):
        if tree.joints[i].slides:
            continue
        mass, (hx, hy, hz), ((xx, xy, xz), (_, yy, yz), (_, _, zz)) = moved[i]
        moved[i] = Body(0.0, (hx, hy, 0.0), ((minus(xx, yy), xy, xz), (xy, 0.0, yz), (xz, yz, zz)))
        if tree.parents[i] >= 0:
            given = Body(mass, (0.0, 0.0, hz), ((yy, 0.0, 0.0), (0.0, yy, 0.0), ZERO))
            above = moved[tree.parents[i]]
            moved[tree.parents[i]] = joined(above, seen_by_parent(given, Frame(*tree.aligned[i])))
    return moved
