"""Forward dynamics: Featherstone's articulated-body algorithm, in blocks of three."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from flexhinf.robot.dynamics.bodies import Body
from flexhinf.robot.dynamics.folded import (
    ZERO,
    Matrix,
    Vector,
    add,
    add_matrices,
    apply,
    apply_transposed,
    dot,
    minus,
    plus,
    product,
    rotated_symmetric,
    scaled,
    skew,
    subtract_matrices,
    symmetric,
    times,
    transpose,
)
from flexhinf.robot.dynamics.motion import Frame, Twist, bias_force, frames_of, opposite, velocity_of
from flexhinf.robot.dynamics.tree import Tree

__all__ = ["forward_dynamics"]


class Inertia(NamedTuple):
    """An articulated body's inertia: force = A a + B α, moment = Bᵀ a + D α; A and D are symmetric."""

    a: Matrix
    b: Matrix
    d: Matrix

    @staticmethod
    def of(body: Body) -> Inertia:
        """Of a rigid body."""
        m = body.mass
        return Inertia(
            ((m, 0.0, 0.0), (0.0, m, 0.0), (0.0, 0.0, m)), skew(opposite(body.moment)), body.inertia
        )

    def __add__(self, other: Inertia) -> Inertia:  # type: ignore[override]
        return Inertia(*(add_matrices(m, n) for m, n in zip(self, other)))

    def seen_by_parent(self, frame: Frame) -> Inertia:
        """The same inertia about the parent's origin, in the parent's components."""
        r, offset = frame.rotation, skew(frame.translation)
        a, d = rotated_symmetric(r, self.a), rotated_symmetric(r, self.d)
        b = product(product(r, self.b), transpose(r))
        moved = subtract_matrices(b, product(a, offset))
        columns, before, after = transpose(offset), transpose(b), transpose(moved)

        def entry(i: int, j: int) -> Any:  # D + [r] B' − Bᵀ [r]
            return plus(d[i][j], minus(dot(offset[i], after[j]), dot(before[i], columns[j])))

        return Inertia(a, moved, symmetric(entry))


class Axis(NamedTuple):
    """What the joint's own axis sees of an inertia.

    Attributes
    ----------
    force, moment : (3,)
        U = I S: what a unit acceleration of the joint takes.
    inverse : element
        1 / (Sᵀ I S).
    """

    force: Vector
    moment: Vector
    inverse: Any


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

    Parameters
    ----------
    tree : Tree
    bodies : sequence of Body
    q, dq, torque : (n,)
        Positions, velocities and torques (forces of prismatic joints) of the joints, of any element.
    gravity : (3,)
        Acceleration of free fall in the world's frame, m/s².
    armature : (n,), optional
        Inertia that turns (mass that slides) with a joint alone: a rotor behind a rigid gear, M + diag(armature).
        0.0 for none.
    """
    own = [0.0] * len(tree) if armature is None else armature
    frames = frames_of(tree, q)
    n, parents = len(tree), tree.parents
    bias, products = _outwards_velocity(tree, bodies, frames, dq)
    inertias = [Inertia.of(body) for body in bodies]
    axes: list[Any] = [None] * n
    left: list[Any] = [None] * n  # torque left for the acceleration
    for i in reversed(range(n)):
        slides, (force, moment) = tree.joints[i].slides, bias[i]
        axes[i] = axis = _axis(slides, inertias[i], own[i])
        left[i] = minus(torque[i], force[2] if slides else moment[2])
        if parents[i] < 0:
            continue
        rest = _without(slides, inertias[i], axis, _nothing(own[i]))
        linear, angular = products[i]
        drive = times(axis.inverse, left[i])
        force = add(force, add(add(apply(rest.a, linear), apply(rest.b, angular)), scaled(drive, axis.force)))
        carried = add(apply_transposed(rest.b, linear), apply(rest.d, angular))
        moment = add(moment, add(carried, scaled(drive, axis.moment)))
        force, moment = frames[i].to_parent(force, moment)
        above = parents[i]
        inertias[above] += rest.seen_by_parent(frames[i])
        bias[above] = add(bias[above][0], force), add(bias[above][1], moment)
    return _outwards_acceleration(tree, frames, axes, left, products, gravity)


def _outwards_velocity(
    tree: Tree, bodies: Sequence[Body], frames: list[Frame], dq: Any
) -> tuple[list[Any], list[Twist]]:
    velocities: list[Twist] = []
    bias, products = [], []
    for i, (joint, parent) in enumerate(zip(tree.joints, tree.parents)):
        before = Twist(ZERO, ZERO) if parent < 0 else velocities[parent]
        velocity, product_ = velocity_of(joint.slides, frames[i].to_child(before), dq[i])
        velocities.append(velocity)
        products.append(product_)
        bias.append(bias_force(bodies[i], velocity))
    return bias, products


def _outwards_acceleration(
    tree: Tree, frames: list[Frame], axes: list[Axis], left: list[Any], products: list[Twist], gravity: Vector
) -> list[Any]:
    accelerations: list[Twist] = []
    result = []
    for i, (joint, parent) in enumerate(zip(tree.joints, tree.parents)):
        before = (
            Twist(opposite(gravity), ZERO) if parent < 0 else accelerations[parent]
        )  # the base falls upwards
        linear, angular = frames[i].to_child(before)
        linear, angular = add(linear, products[i].linear), add(angular, products[i].angular)
        axis = axes[i]
        rate = times(axis.inverse, minus(minus(left[i], dot(axis.force, linear)), dot(axis.moment, angular)))
        result.append(rate)
        along = (0.0, 0.0, rate)
        accelerations.append(
            Twist(add(linear, along), angular) if joint.slides else Twist(linear, add(angular, along))
        )
    return result


def _nothing(armature: Any) -> bool:
    return isinstance(armature, (float, int)) and armature == 0


def _axis(slides: bool, inertia: Inertia, armature: Any) -> Axis:
    if slides:
        force = tuple(row[2] for row in inertia.a)
        return Axis(force, inertia.b[2], 1.0 / plus(force[2], armature))
    moment = tuple(row[2] for row in inertia.d)
    return Axis(tuple(row[2] for row in inertia.b), moment, 1.0 / plus(moment[2], armature))


def _without(slides: bool, inertia: Inertia, axis: Axis, bare: bool) -> Inertia:
    """I − U Uᵀ / (Sᵀ I S + armature): what is felt through the joint; exactly zero along a bare one's axis."""
    f, m = axis.force, axis.moment
    g, k = scaled(axis.inverse, f), scaled(axis.inverse, m)

    def a(i: int, j: int) -> Any:
        return 0.0 if bare and slides and i == 2 else minus(inertia.a[i][j], times(f[i], g[j]))

    def d(i: int, j: int) -> Any:
        return 0.0 if bare and not slides and i == 2 else minus(inertia.d[i][j], times(m[i], k[j]))

    def b(i: int, j: int) -> Any:
        free = i == 2 if slides else j == 2
        return 0.0 if bare and free else minus(inertia.b[i][j], times(f[i], k[j]))

    return Inertia(symmetric(a), tuple(tuple(b(i, j) for j in range(3)) for i in range(3)), symmetric(d))
