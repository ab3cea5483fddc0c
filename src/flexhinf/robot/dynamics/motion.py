"""Where joints put their links, and bodies as they are seen from the parent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flexhinf.robot.dynamics.bodies import Body
from flexhinf.robot.dynamics.folded import (
    IDENTITY,
    ZERO,
    Matrix,
    Vector,
    add,
    add_matrices,
    apply,
    cross,
    dot,
    minus,
    plus,
    product,
    rotated_symmetric,
    scaled,
    symmetric,
)
from flexhinf.robot.dynamics.tree import Tree


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
