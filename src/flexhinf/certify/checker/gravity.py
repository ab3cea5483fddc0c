"""Bound in ball arithmetic, at every pose of an arm, how the torques of gravity change with the pose.

Of a body behind turning joints i and j, i the one nearer to the base, |∂²U/∂qᵢ∂qⱼ| = m |(g × ωᵢ)·(ωⱼ × r)|, r from
joint j to the centre of mass: at most m |g × ωᵢ| |r|. Where j slides, ωⱼ × r is its axis; where i slides it is zero
(docs/theorem.md).
"""

# Not checked strictly: parts of NumPy have no types.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from flint import arb, arb_mat

from flexhinf.certify.checker.taylor_matrix import frobenius, positive_definite


class ArmJoint(NamedTuple):
    """One joint, with the frame of the link behind it."""

    parent: int  # −1 for the base
    slides: bool
    rotation: arb_mat  # (3, 3) of its frame at position zero in the parent's
    translation: arb_mat  # (3, 1), m
    axis: arb_mat  # (3, 1) in its frame
    ends: tuple[float, float]  # rad or m
    stiffness: arb  # N·m/rad or N/m


class Weight(NamedTuple):
    """A body on a link, at most."""

    joint: int
    mass: arb  # kg
    moment: arb  # of its centre about the frame's origin, kg·m


def within_slope(
    joints: Sequence[ArmJoint], gravity: arb_mat, weights: Sequence[Weight], slope: float
) -> bool:
    """Whether −γK ≤ ∂G/∂q ≤ γK at every pose, K the stiffness of the joints.

    |xᵀ(∂G/∂q)x| ≤ |x|ᵀB|x| with the bounds B of the entries, so γK − B > 0 suffices.
    """
    bounds = slope_bounds(joints, gravity, weights)
    if all(entry == 0 for row in bounds for entry in row):
        return True
    springs = [joint.stiffness * arb(slope) for joint in joints]
    room = [[-entry for entry in row] for row in bounds]
    for k, spring in enumerate(springs):
        room[k][k] += spring
    return positive_definite(arb_mat(room))


def slope_bounds(joints: Sequence[ArmJoint], gravity: arb_mat, weights: Sequence[Weight]) -> list[list[arb]]:
    """B, a bound of each entry of ∂G/∂q."""
    across = [_across(joints, gravity, k) for k in range(len(joints))]
    bounds = [[arb(0) for _ in joints] for _ in joints]
    for weight in weights:
        moment, place = weight.moment, weight.joint
        while place >= 0:
            joint = joints[place]
            lever = weight.mass if joint.slides else moment
            lever = lever * _length(joint.axis)
            above = place
            while above >= 0:
                if not joints[above].slides:
                    size = (lever * across[above]).abs_upper()
                    bounds[above][place] += size
                    if above != place:
                        bounds[place][above] += size
                above = joints[above].parent
            moment = (moment + weight.mass * _reach(joint)).abs_upper()
            place = joint.parent
    return bounds


def _length(vector: arb_mat) -> arb:
    return frobenius(vector.entries())


def _reach(joint: ArmJoint) -> arb:
    """How far a joint's frame may lie from its parent's origin."""
    travel = max(map(abs, joint.ends)) if joint.slides else 0.0
    return _length(joint.translation) + _length(joint.axis) * arb(travel)


def _across(joints: Sequence[ArmJoint], gravity: arb_mat, k: int) -> arb:
    """|g × ω| of the axis of a joint at any pose: that at position zero, and how far the axis may turn from there."""
    joint, fall = joints[k], _length(gravity)
    axis, turn = joint.rotation * joint.axis, joint.parent
    while turn >= 0:
        axis, turn = joints[turn].rotation * axis, joints[turn].parent
    x, y, z = gravity.entries()
    a, b, c = axis.entries()
    still = frobenius([y * c - z * b, z * a - x * c, x * b - y * a])
    turned = still + fall * _turned(joints, joint.parent, joint.rotation * joint.axis)
    whole = fall * _length(joint.axis)
    return turned if turned < whole else whole


def _turned(joints: Sequence[ArmJoint], frame: int, vector: arb_mat) -> arb:
    """How far a constant vector of a frame may lie from where it is at position zero."""
    if frame < 0:
        return arb(0)
    joint = joints[frame]
    if joint.slides:
        return _turned(joints, joint.parent, joint.rotation * vector)
    size = _length(joint.axis)
    along = (vector.transpose() * joint.axis)[0, 0] / size**2
    across = _length(vector - joint.axis * along)
    return abs(along) * _turned(joints, joint.parent, joint.rotation * joint.axis) + 2 * across
