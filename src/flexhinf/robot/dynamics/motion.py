"""How a joint moves its link: the frame's rotation, the velocities and what crosses the joint."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from flexhinf.robot.dynamics.bodies import Body
from flexhinf.robot.dynamics.folded import (
    ZERO,
    Matrix,
    Vector,
    add,
    apply,
    apply_transposed,
    cross,
    minus,
    plus,
    product,
    scaled,
)
from flexhinf.robot.dynamics.tree import Tree

__all__ = ["Frame", "Twist", "bias_force", "frames_of", "momentum", "opposite", "velocity_of"]


class Twist(NamedTuple):
    """A velocity or an acceleration of a frame: of its origin (m/s, m/s²) and its rotation (rad/s, rad/s²)."""

    linear: Vector
    angular: Vector


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

    def to_child(self, parent: Twist) -> Twist:
        """A parent's twist as the child's, the joint standing still."""
        linear = add(parent.linear, cross(parent.angular, self.translation))
        return Twist(apply_transposed(self.rotation, linear), apply_transposed(self.rotation, parent.angular))

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


def velocity_of(slides: bool, carried: Twist, rate: Any) -> tuple[Twist, Twist]:
    """A link's velocity from the one carried over from its parent, and the product v × S q̇ of its acceleration."""
    if slides:
        linear = (carried.linear[0], carried.linear[1], plus(carried.linear[2], rate))
        velocity = Twist(linear, carried.angular)
        return velocity, Twist(cross(velocity.angular, (0.0, 0.0, rate)), ZERO)
    angular = (carried.angular[0], carried.angular[1], plus(carried.angular[2], rate))
    velocity = Twist(carried.linear, angular)
    along = (0.0, 0.0, rate)
    return velocity, Twist(cross(velocity.linear, along), cross(velocity.angular, along))


def momentum(body: Body, motion: Twist) -> tuple[Vector, Vector]:
    """Linear momentum, and angular momentum about the frame's origin (or force and moment, of an acceleration)."""
    linear = add(scaled(body.mass, motion.linear), cross(motion.angular, body.moment))
    return linear, add(apply(body.inertia, motion.angular), cross(body.moment, motion.linear))


def bias_force(body: Body, velocity: Twist) -> tuple[Vector, Vector]:
    """Force and moment that a body needs to keep its spatial velocity: v ×* I v."""
    linear, angular = momentum(body, velocity)
    force = cross(velocity.angular, linear)
    return force, add(cross(velocity.angular, angular), cross(velocity.linear, linear))


def opposite(a: Vector) -> Vector:
    """−a."""
    return tuple(minus(0.0, x) for x in a)
