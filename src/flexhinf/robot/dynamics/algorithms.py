"""Rigid-body equations of a tree on any element: bodies, mass matrix, inverse and forward dynamics.

Bodies have mass, first moment and inertia about the joint, in the aligned frame; inverse dynamics is the recursive
Newton–Euler algorithm, the mass matrix the composite-rigid-body algorithm, factored from the leaves to the base.
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
    opposite,
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

    Mass, kg; first moment m c (3,), kg·m; inertia 3 × 3 about the frame's origin, kg·m².
    """

    mass: Any
    moment: Vector
    inertia: Matrix


def bodies_of(tree: Tree, mass: Any, centre_of_mass: Any, inertia: Any) -> list[Body]:
    """Bodies from the parameters of the links.

    Mass (n,), kg; centre of mass (n, 3) in the link's frame, m; inertia (n, 6), xx, xy, xz, yy, yz, zz about the centre
    of mass, in axes parallel to the link's frame, kg·m².
    """
    bodies = []
    for i, joint in enumerate(tree.joints):
        xx, xy, xz, yy, yz, zz = list(inertia[i])
        x, y, z = apply_transposed(joint.alignment, list(centre_of_mass[i]))
        moment = scaled(mass[i], (x, y, z))
        (a, b, c), (_, d, e), (_, _, f) = rotated_symmetric(
            transpose(joint.alignment), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
        )
        mxx, myy, mzz = times(moment[0], x), times(moment[1], y), times(moment[2], z)
        b, c = minus(b, times(moment[0], y)), minus(c, times(moment[0], z))  # Steiner: I + m (cᵀc 1 − c cᵀ)
        e = minus(e, times(moment[1], z))
        a, d, f = plus(a, plus(myy, mzz)), plus(d, plus(mxx, mzz)), plus(f, plus(mxx, myy))
        bodies.append(Body(mass[i], moment, ((a, b, c), (b, d, e), (c, e, f))))
    return bodies


# Numbers ----------------------------------------------------------------------------------------------
def lumped(bodies: Sequence[tuple[float, np.ndarray, np.ndarray]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Several bodies that move together as one: mass, centre, inertia of each and of the whole.

    Masses in kg, of a positive sum; centres (3,), m, in a common frame; inertias (3, 3), kg·m², about the own centre.
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
    """Where an aligned frame is in its parent's: rotation of components to the parent's, and translation in it."""

    rotation: Matrix
    translation: Vector


def _to_parent(frame: Frame, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
    """A force and a moment about the frame's origin, as seen from the parent's."""
    turned = apply(frame.rotation, force)
    return turned, add(apply(frame.rotation, moment), cross(frame.translation, turned))


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


def inverse_dynamics(
    tree: Tree, bodies: Sequence[Body], q: Any, dq: Any, ddq: Any, gravity: Vector
) -> list[Any]:
    """Joint torques M(q) q̈ + C(q, q̇) q̇ + G(q) (forces of prismatic joints), [featherstone2008].

    q, dq, ddq are (n,) of any element; with numbers 0.0 for both of the latter only G(q) is computed. `gravity` (3,) is
    the acceleration of free fall in the world's frame, m/s².
    """
    frames, still = frames_of(tree, q), _Motion(ZERO, ZERO, opposite(gravity), _change(ZERO, ZERO))
    motions: list[_Motion] = []
    wrenches: list[Any] = []
    for i, (joint, parent) in enumerate(zip(tree.joints, tree.parents)):
        before = still if parent < 0 else motions[parent]
        motion = before.carried(frames[i]).moved(joint.slides, dq[i], ddq[i])
        motions.append(motion)
        mass, moment, inertia = bodies[i]
        angular, change, linear, spread = motion
        spin = add(apply(inertia, change), cross(angular, apply(inertia, angular)))
        force = add(scaled(mass, linear), apply(spread, moment))
        wrenches.append((force, add(spin, cross(moment, linear))))
    torques: list[Any] = [None] * len(tree)
    for i in reversed(range(len(tree))):
        force, moment = wrenches[i]
        torques[i] = force[2] if tree.joints[i].slides else moment[2]
        parent = tree.parents[i]
        if parent >= 0:
            force, moment = _to_parent(frames[i], force, moment)
            wrenches[parent] = add(wrenches[parent][0], force), add(wrenches[parent][1], moment)
    return torques


class _Motion(NamedTuple):
    """How a frame moves, in its own components.

    `angular` and `change` are ω, rad/s, and its rate α, rad/s²; `linear` is the acceleration of the origin less that of
    free fall, m/s². `spread` is U = [α] + [ω][ω]: a point r of the link is accelerated by U r more than the origin.
    """

    angular: Vector
    change: Vector
    linear: Vector
    spread: Matrix

    def carried(self, frame: Frame) -> _Motion:
        """Of a child's frame, the joint standing still; U is still the parent's."""
        linear = add(self.linear, apply(self.spread, frame.translation))
        angular, change, linear = (
            apply_transposed(frame.rotation, vector) for vector in (self.angular, self.change, linear)
        )
        return _Motion(angular, change, linear, self.spread)

    def moved(self, slides: bool, rate: Any, acceleration: Any) -> _Motion:
        """The same with the joint moving along or about z."""
        angular, change, linear, _ = self
        coriolis, along = cross(angular, (0.0, 0.0, rate)), (0.0, 0.0, acceleration)
        if slides:
            linear = add(linear, add(scaled(2.0, coriolis), along))
        else:
            change = add(change, add(coriolis, along))
            angular = (angular[0], angular[1], plus(angular[2], rate))
        return _Motion(angular, change, linear, _change(angular, change))


def _change(angular: Vector, change: Vector) -> Matrix:
    """U = [α] + [ω][ω]."""
    (x, y, z), (a, b, c) = angular, change
    xx, yy, zz, xy, xz, yz = (times(*pair) for pair in ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z)))

    def both(p: Any, q: Any) -> Any:
        return minus(minus(0.0, p), q)

    return (
        (both(yy, zz), minus(xy, c), plus(xz, b)),
        (plus(xy, c), both(xx, zz), minus(yz, a)),
        (minus(xz, b), plus(yz, a), both(xx, yy)),
    )


def mass_matrix(tree: Tree, bodies: Sequence[Body], q: Any) -> np.ndarray:
    """M(q), (n, n) of any element, at joint positions q (n,), [featherstone2008]."""
    frames = frames_of(tree, q)
    n, composite = len(tree), list(bodies)
    matrix = np.zeros((n, n), dtype=object)
    for i in reversed(range(n)):
        # Force and moment for a unit acceleration of the joint.
        mass, (x, y, _), inertia = composite[i]
        if tree.joints[i].slides:
            force, moment = (0.0, 0.0, mass), (y, minus(0.0, x), 0.0)
        else:
            force, moment = (minus(0.0, y), x, 0.0), tuple(row[2] for row in inertia)
        matrix[i, i] = force[2] if tree.joints[i].slides else moment[2]
        j = i
        while tree.parents[j] >= 0:
            force, moment = _to_parent(frames[j], force, moment)
            j = tree.parents[j]
            matrix[i, j] = matrix[j, i] = force[2] if tree.joints[j].slides else moment[2]
        parent = tree.parents[i]
        if parent >= 0:
            composite[parent] = joined(composite[parent], seen_by_parent(composite[i], frames[i]))
    return matrix


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

    With `regrouped` bodies that is less work, for up to twelve joints, than the articulated-body algorithm, and the
    chain of operations that wait for each other is half as long. `armature` (n,) is inertia that turns (mass that
    slides) with a joint alone, a rotor behind a rigid gear, M + diag(armature); 0.0 for none. Other arguments as for
    `inverse_dynamics`.
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
