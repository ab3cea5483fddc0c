"""Inverse dynamics: the recursive Newton–Euler algorithm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from flexhinf.robot.dynamics.bodies import Body, Frame, frames_of
from flexhinf.robot.dynamics.tree import (
    ZERO,
    Matrix,
    Tree,
    Vector,
    add,
    apply,
    apply_transposed,
    cross,
    minus,
    opposite,
    plus,
    scaled,
    times,
)


def inverse_dynamics(
    tree: Tree, bodies: Sequence[Body], q: Any, dq: Any, ddq: Any, gravity: Vector
) -> list[Any]:
    """Joint torques M(q) q̈ + C(q, q̇) q̇ + G(q) (forces of prismatic joints), [featherstone2008].

    Parameters
    ----------
    q, dq, ddq : (n,)
        Positions, velocities and accelerations of the joints, of any element. With numbers 0.0 for both of the
        latter only G(q) is computed.
    gravity : (3,)
        Acceleration of free fall in the world's frame, m/s².
    """
    frames, still = frames_of(tree, q), _Motion(ZERO, ZERO, opposite(gravity), _change(ZERO, ZERO))
    motions: list[_Motion] = []
    wrenches: list[Any] = []
    for i, (joint, parent) in enumerate(zip(tree.joints, tree.parents)):
        before = still if parent < 0 else motions[parent]
        motion = before.carried(frames[i]).moved(joint.slides, dq[i], ddq[i])
        motions.append(motion)
        wrenches.append(_wrench(bodies[i], motion))
    torques: list[Any] = [None] * len(tree)
    for i in reversed(range(len(tree))):
        force, moment = wrenches[i]
        torques[i] = force[2] if tree.joints[i].slides else moment[2]
        parent = tree.parents[i]
        if parent >= 0:
            force, moment = frames[i].to_parent(force, moment)
            wrenches[parent] = add(wrenches[parent][0], force), add(wrenches[parent][1], moment)
    return torques


class _Motion(NamedTuple):
    """How a frame moves, in its own components.

    Attributes
    ----------
    angular, change : (3,)
        ω, rad/s, and its rate α, rad/s².
    linear : (3,)
        Acceleration of the origin less that of free fall, m/s².
    spread : 3 × 3
        U = [α] + [ω][ω]: a point r of the link is accelerated by U r more than the origin.
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


def _wrench(body: Body, motion: _Motion) -> tuple[Vector, Vector]:
    """Force, and moment about the frame's origin, that the body needs for its motion."""
    angular, change, linear, spread = motion
    force = add(scaled(body.mass, linear), apply(spread, body.moment))
    spin = add(apply(body.inertia, change), cross(angular, apply(body.inertia, angular)))
    return force, add(spin, cross(body.moment, linear))
