"""Estimates of what a description of a robot leaves out: spring and motor of a joint, from its largest torque.

They rest on few published arms, and are wide. A parameter whose source begins with `ESTIMATE` is one.

- **Spring.** It twists by 8 mrad at the largest torque: gears of strain-wave drives with their sensors and bearings
  twist by 3 to 20 mrad there. A sliding joint gives way by 0.5 mm.
- **Motor.** Largest torque over the rotor's inertia, seen from the link, is 70 rad/s². Of Franka's FR3 it is 58 to 188
  (0.6057, 0.4625 and 0.2055 kg·m² at 87, 87 and 12 N·m, of Drake's model of it), of DLR's LWR II 27 to 96 (1.836,
  4.447, 3.242, 1.817, 1.392, 1.402 and 1.392 kg·m²; Ott, "Cartesian Impedance Control of Redundant and Flexible-Joint
  Robots", Springer 2008, Table A.2, at 176, 176, 100, 100, 100, 38 and 38 N·m). A sliding joint has 50 m/s².
- **Friction.** A tenth of the largest torque at the largest speed, 2 rad/s or 0.5 m/s where none is stated, or a
  placeholder.
- **Torque.** Where none is stated, or a placeholder, twice what the heaviest pose asks for, and 5 rad/s² (m/s²) of the
  joint's inertia. Where all joints state one torque of which none asks for a thirtieth, the motors are equal, but that
  number is none of theirs: twice what the joint that needs most asks for. Where they state one that holds less than
  half of their weight, such as 1, it says nothing of any motor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.plant import Parameters
from flexhinf.robot.arm import Arm
from flexhinf.robot.dynamics import Tree, bodies_of, inverse_dynamics
from flexhinf.robot.parameters import ESTIMATE, Parameter
from flexhinf.robot.rigid_arm import RigidArm

#: Twist at the largest torque, rad and m; largest torque over inertia, rad/s² and m/s²; speed where none is stated.
TWIST, ACCELERATION, SPEED = (0.008, 0.0005), (70.0, 50.0), (2.0, 0.5)

#: Share of the largest torque that friction takes at the largest speed.
LOST = 0.1

#: Tolerances of the estimates, per cent.
STIFFNESS_TOLERANCE, INERTIA_TOLERANCE, FRICTION_TOLERANCE = 50.0, 50.0, 80.0

#: A stated torque of more than this times what weight and inertia ask for is no motor's, but a placeholder, where no
#: other joint with as large a one needs it: a wrist without a tool needs next to nothing.
PLACEHOLDER = 1e5

#: A stated speed of more than this, rad/s or m/s, is no joint's, but a placeholder.
FASTEST = 100.0

#: One torque of all joints, of which none asks for more than this share, is a placeholder too.
SMALLEST_SHARE = 1.0 / 30.0

#: One torque of all joints that holds a smaller share of their weight is none of a motor either.
HELD = 0.5

#: Poses at which the weight is looked at, and their seed; the range of a joint without one, rad or m.
POSES, SEED, RANGE = 200, 0, np.pi

#: Acceleration beside the weight where no torque is stated, rad/s² or m/s².
SPARE = 5.0


@dataclass(frozen=True)
class EstimatedJoint:
    """Numbers of a joint of which its description says nothing: SI units, seen from the link."""

    effort: float
    stated: bool  # whether the largest torque is the description's
    stiffness: Parameter
    motor_inertia: Parameter
    friction: Parameter


def estimated_joints(arm: RigidArm) -> dict[str, EstimatedJoint]:
    """Estimates for the joints of an arm, by their names."""
    weights = largest_weight(arm)
    equal, small = has_placeholder_effort(arm, weights), len(weak_joints(arm)) > 0
    plausible = [e for e, weight in zip(arm.efforts, weights.tolist()) if e <= PLACEHOLDER * weight]
    joints = dict[str, EstimatedJoint]()
    for joint, effort, speed, weight in zip(arm.joints, arm.efforts, arm.speeds, weights.tolist()):
        known = effort <= max(plausible, default=0.0) and not equal and not small
        needed = weights.max() if equal else weight
        joints[joint.name] = estimated_joint(effort if known else 2.0 * needed, known, speed, joint.slides)
    return joints


def has_placeholder_effort(arm: RigidArm, weights: np.ndarray) -> bool:
    """Whether all joints state one torque of which `weights` (n,), N·m (N), ask for `SMALLEST_SHARE` nowhere."""
    efforts = np.array(arm.efforts, dtype=float)
    same = len(efforts) > 1 and bool((efforts == efforts[0]).all()) and np.isfinite(efforts[0])
    return bool(same and weights.max() < SMALLEST_SHARE * efforts[0])


def weak_joints(arm: RigidArm) -> list[str]:
    """Joints of which the one torque, N·m (N), that all joints state holds less than `HELD` of the weight; none where
    torques differ."""
    efforts = np.array(arm.efforts, dtype=float)
    if len(efforts) < 2 or not (efforts == efforts[0]).all():
        return []
    weak = HELD * largest_weight(arm, 0.0) > efforts
    return [joint.name for joint, too_much in zip(arm.joints, weak.tolist()) if too_much]


def estimated_joint(effort: float, stated: bool, speed: float, slides: bool) -> EstimatedJoint:
    """Estimates for one joint of a largest torque, N·m (N), and speed, rad/s (m/s; infinite where none is stated)."""
    twist, acceleration = TWIST[slides], ACCELERATION[slides]
    most = speed if speed <= FASTEST else SPEED[slides]
    of = "the largest torque" if not slides else "the largest force"

    def number(name: str, value: float, tolerance: float, why: str) -> Parameter:
        return Parameter(name, float(f"{value:.3g}"), tolerance, source=f"{ESTIMATE}: {why}")

    unit = "mm" if slides else "mrad"
    return EstimatedJoint(
        float(f"{effort:.3g}"),
        stated,
        number("stiffness", effort / twist, STIFFNESS_TOLERANCE, f"{1e3 * twist:g} {unit} at {of}"),
        number(
            "motor_inertia",
            effort / acceleration,
            INERTIA_TOLERANCE,
            f"{of} moves the motor alone with {acceleration:g} {'m' if slides else 'rad'}/s²",
        ),
        number(
            "friction",
            LOST * effort / most,
            FRICTION_TOLERANCE,
            f"{100 * LOST:g} % of {of} at the largest speed",
        ),
    )


def largest_weight(arm: RigidArm, spare: float = SPARE) -> np.ndarray:
    """The largest torque (n,), N·m (N), that an arm's weight asks of each joint at random poses of its range, and
    `spare`, rad/s² (m/s²), of the inertia that the joint moves there."""
    tree = Tree(tuple(arm.joints))
    links = Arm(tree, (0.0, 0.0, -1.0) if arm.down is None else arm.down)
    ends = np.array([joint.limits or (-RANGE, RANGE) for joint in arm.joints])
    q = np.random.default_rng(SEED).uniform(ends[:, 0], ends[:, 1], (POSES, len(arm.joints))).T
    mass = np.array([link.mass for link in arm.links], dtype=float)
    centre, inertia = (
        np.array([getattr(link, name) for link in arm.links], dtype=float)
        for name in ("centre_of_mass", "inertia")
    )
    p = Parameters({"gravity": arm.gravity, "mass": mass, "centre_of_mass": centre, "inertia": inertia})
    held = np.abs(links.gravity_torque(q, p)).max(axis=1)
    if not spare:
        return held
    bodies, still, unit = bodies_of(*links.rigid(p)), [0.0] * len(q), np.eye(len(q)).tolist()
    moved = [  # the diagonal of M(q)
        np.max(inverse_dynamics(tree, bodies, q, still, unit[k], (0.0, 0.0, 0.0))[k]) for k in range(len(q))
    ]
    return held + spare * np.array(moved)
