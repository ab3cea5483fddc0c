"""Inverse dynamics: the recursive Newton–Euler algorithm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flexhinf.robot.dynamics.bodies import Body
from flexhinf.robot.dynamics.folded import ZERO, Vector, add
from flexhinf.robot.dynamics.motion import (
    Twist,
    bias_force,
    frames_of,
    momentum,
    opposite,
    velocity_of,
)
from flexhinf.robot.dynamics.tree import Tree

__all__ = ["inverse_dynamics"]


def inverse_dynamics(
    tree: Tree, bodies: Sequence[Body], q: Any, dq: Any, ddq: Any, gravity: Vector
) -> list[Any]:
    """Joint torques M(q) q̈ + C(q, q̇) q̇ + G(q) (forces of prismatic joints), [featherstone2008].

    Parameters
    ----------
    tree : Tree
    bodies : sequence of Body
    q, dq, ddq : (n,)
        Positions, velocities and accelerations of the joints, of any element. With numbers 0.0 for both of the
        latter only G(q) is computed.
    gravity : (3,)
        Acceleration of free fall in the world's frame, m/s².
    """
    frames = frames_of(tree, q)
    velocities: list[Twist] = []
    accelerations: list[Twist] = []
    wrenches: list[Any] = []
    for i, (joint, parent) in enumerate(zip(tree.joints, tree.parents)):
        before = Twist(ZERO, ZERO) if parent < 0 else velocities[parent]
        felt = Twist(opposite(gravity), ZERO) if parent < 0 else accelerations[parent]
        velocity, product = velocity_of(joint.slides, frames[i].to_child(before), dq[i])
        linear, angular = frames[i].to_child(felt)
        linear, angular = add(linear, product.linear), add(angular, product.angular)
        along = (0.0, 0.0, ddq[i])
        linear, angular = (add(linear, along), angular) if joint.slides else (linear, add(angular, along))
        velocities.append(velocity)
        accelerations.append(Twist(linear, angular))
        force, moment = momentum(bodies[i], accelerations[i])
        keep = bias_force(bodies[i], velocity)
        wrenches.append((add(force, keep[0]), add(moment, keep[1])))
    torques: list[Any] = [None] * len(tree)
    for i in reversed(range(len(tree))):
        force, moment = wrenches[i]
        torques[i] = force[2] if tree.joints[i].slides else moment[2]
        parent = tree.parents[i]
        if parent >= 0:
            force, moment = frames[i].to_parent(force, moment)
            wrenches[parent] = add(wrenches[parent][0], force), add(wrenches[parent][1], moment)
    return torques
