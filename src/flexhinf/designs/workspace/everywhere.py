"""What holds at every pose of a workspace's robots: numbers of an arm for `flexhinf.certify.checker.arm`.

Bodies of links are compared one by one, so that no pose is looked at. What depends on poses, the range of λ and
payloads, is shown in boxes of joint positions where there are few joints.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterator
from decimal import ROUND_CEILING, Context, Decimal
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from flexhinf.certify.checker.arm import (
    JOINTS_IN_BOXES,
    ArmClaim,
    CheckedArm,
    arm_claim,
    check_arm,
    weights_of,
)
from flexhinf.certify.checker.gravity import slope_bounds
from flexhinf.designs.responses import with_values
from flexhinf.designs.workspace.masses import (
    OF_INERTIA,
    POSES,
    PROPORTIONAL,
    StatedErrors,
    stated_errors,
)
from flexhinf.designs.workspace.samples import POSES_SEED
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal.pair_errors import Sector
from flexhinf.plant.joints import coupling_of, elastic_joints, link_compliance
from flexhinf.robot import Robot
from flexhinf.robot.arm import Pendulum
from flexhinf.robot.dynamics import bodies_of, mass_matrix, matrix_of
from flexhinf.robot.parameters import INERTIA, VECTOR, per_joint
from flexhinf.robot.springs import DAMPING

#: Poses at which the arm's inertia matrix is compared with the plant's, and how near they must be.
COMPARED, NEAR = 20, 1e-9

#: A share by which errors of bodies are stated larger than they are found; t for a centre of mass without a tolerance.
ROOM, EXACT = 1e-6, 1e-9

#: Half of the range of joint positions for which a single pose stands, rad or m.
POINT = 1e-9

#: Sampled errors with a payload are tried so many times larger.
WIDER = 1.05

Numbers = dict[str, Any]


def file_errors(setup: WorkspaceSetup) -> StatedErrors:
    """The sectors of a setup's robots, by their tolerances, with gravity's slope and the damping of springs.

    The slope is a bound at every pose where bodies are known, else a twentieth more than at sampled poses. Of one joint
    it is one of gravity's whole torque.
    """
    stated = stated_errors(setup)
    if (arm := _arm(setup)) is not None:
        slope, poses = float(arm.numbers["slope"]), 0
    else:
        slope, poses = WIDER * _sampled_slope(setup), POSES
    slope, damping = _rounded_up(slope), _rounded_up(_damping(setup))
    alone = len(setup.joints) == 1 and slope > 0.0 and not poses  # large motions leave what was sampled
    errors = stated.errors._replace(slope=Sector(slope, slope), damping=damping, any_motion=alone)
    others = tuple(name for name in stated.others if name not in (DAMPING, "gravity"))
    return stated._replace(errors=errors, slope_poses=poses, others=others)


def _rounded_up(value: float) -> float:
    """A number of three digits that is not smaller, as texts have it."""
    rounded = Context(prec=3, rounding=ROUND_CEILING).create_decimal(Decimal(value))
    return max(value, float(rounded))


def _damping(setup: WorkspaceSetup) -> float:
    """The largest damping of a spring over its stiffness, s."""
    robot = setup.true.robot
    ends, names = {p.name: p.interval[1] for p in robot.parameters}, robot.joint_names
    return max(
        ends.get(per_joint(DAMPING, joint, len(names)), 0.0) / stiffness
        for joint, stiffness in zip(names, setup.law.joints.stiffness.tolist())
    )


def _sampled_slope(setup: WorkspaceSetup) -> float:
    """The largest slope of gravity over the stiffness at sampled poses, of robots with all masses at their largest."""
    robot = setup.true.robot
    heavy = {p.name: p.interval[1] for p in robot.uncertain if PROPORTIONAL.match(p.name)}
    plant, largest = with_values(setup.true_plant, robot.varied(heavy)), 0.0
    root = np.sqrt(setup.law.joints.stiffness)
    for pose in setup.workspace.sample(POSES, POSES_SEED):
        joints = elastic_joints(plant, *robot.operating_point(pose), rigid=True, coupled=True)
        largest = max(largest, *np.abs(np.linalg.eigvals(joints.gravity_slope / np.outer(root, root))))
    return float(largest)


class Everywhere(NamedTuple):
    """What is shown at every pose of the joint ranges."""

    arm: Numbers  # what the checker reads
    checked: CheckedArm


def everywhere(
    setup: WorkspaceSetup, proved: Sector, ends: tuple[float, float], sampled: Sector | None = None
) -> Everywhere | None:
    """That all robots of the tolerances are within a proved sector at every pose, and their λ between proved ends where
    that can be shown; None where the robots are not bodies with intervals, or have larger errors.

    Of robots with a payload a sector that is little wider than the `sampled` one is tried first.
    """
    known = _arm(setup)
    if known is None:
        return None
    bodies = known.bodies
    if not (bodies.lower <= proved.lower and bodies.upper <= proved.upper):
        return None
    arm: Numbers = {**known.numbers, "bodies_lower": bodies.lower, "bodies_upper": bodies.upper}
    wholes = [bodies]
    if arm["payloads"]:
        wholes = [proved]
        if sampled is not None:
            near = (max(part, WIDER * seen) for part, seen in zip(bodies, sampled))
            wholes.insert(0, Sector(*map(min, proved, near)))
    few = len(arm["joints"]) <= JOINTS_IN_BOXES
    for stated, whole in product(([*map(float, ends)], None) if few else (None,), wholes):
        numbers = {**arm, "lower": whole.lower, "upper": whole.upper, "range": stated}
        if isinstance(checked := check_arm(arm_claim(numbers)), CheckedArm):
            return Everywhere(numbers, checked)
    return None


class _Arm(NamedTuple):
    numbers: Numbers  # joints, bodies, payloads and gravity's slope
    bodies: Sector  # errors of the bodies, each the largest of all


@lru_cache(8)  # what is stated is asked for before what is shown at every pose
def _arm(setup: WorkspaceSetup) -> _Arm | None:
    """What is known of a setup's robots, for nobody to change; None where they are not bodies with intervals."""
    own, true = setup.robot, setup.true.robot
    if own.rigid or coupling_of(setup.law.plant) is not None or own.links != true.links:
        return None
    parts = _Parts(own, true)
    gravity = max(true_gravity(true))
    numbers: Numbers = {
        "gravity": [gravity * float(entry) for entry in own.links.down],
        "slope": None,
        "joints": list(_joints(setup)),
        "bodies": [parts.body(name) for name in own.joint_names],
        "payloads": list(parts.payloads()),
    }
    held = all(p.name in parts.used for p in true.uncertain if p.name.startswith(OF_INERTIA))
    if not held or not _is_the_plants(setup, numbers):
        return None
    bodies = Sector(*(max(part) for part in zip(*map(_body_sector, numbers["bodies"]))))
    exact = dict.fromkeys(("lower", "upper", "bodies_lower", "bodies_upper"), 0.0)
    return _Arm(numbers | {"slope": _slope(arm_claim({**numbers, **exact, "range": None}))}, bodies)


def true_gravity(robot: Robot) -> tuple[float, ...]:
    """The ends of the acceleration of free fall."""
    return next(p.interval for p in robot.parameters if p.name == "gravity")


def _slope(claim: ArmClaim) -> float:
    """γ, a little more than the largest eigenvalue of the bounds of gravity's slope over the stiffness."""
    bounds = slope_bounds(claim.joints, claim.gravity, weights_of(claim))
    whole = np.array([[float(entry.upper()) for entry in row] for row in bounds])
    root = np.sqrt([float(joint.stiffness) for joint in claim.joints])
    largest = float(np.linalg.eigvalsh(whole / np.outer(root, root))[-1])
    return largest * (1.0 + ROOM) if largest > 0.0 else 0.0


class _Parts:
    """Numbers of a model's robot, with the ends of the true one's tolerances."""

    def __init__(self, own: Robot, true: Robot) -> None:
        self._own, self._true = ({p.name: p for p in robot.parameters} for robot in (own, true))
        self._robot, self._count = true, len(own.joint_names)
        self.used = set[str]()

    def _interval(self, quantity: str, joint: str, other: float | None = None) -> list[float]:
        name = per_joint(quantity, joint, self._count)
        if other is not None and name not in self._true:
            return [other, other, other]
        self.used.add(name)
        nominal = self._own[name].value if name in self._own else 0.0
        return [nominal, *map(float, self._true[name].interval)]

    def body(self, joint: str) -> Numbers:
        """The body of a joint's link."""
        scale, zero = self._interval("inertia_scale", joint, 1.0), [0.0, 0.0, 0.0]
        if isinstance(self._robot.links, Pendulum):
            # its inertia is stated about the axis, and nothing else counts
            about = self._interval("link_inertia", joint)
            inertia = [about if name in ("xx", "yy", "zz") else zero for name in INERTIA]
            mass, length = (self._interval(name, joint) for name in ("mass", "length"))
            moment = [own * other for own, other in zip(mass, length)]
            return {
                "mass": [1.0, 1.0, 1.0],
                "centre": [zero] * 3,
                "inertia": inertia,
                "scale": scale,
                "moment": moment,
            }
        return {
            "moment": None,
            "mass": self._interval("mass", joint),
            "centre": [self._interval(f"centre_of_mass_{x}", joint) for x in VECTOR],
            "inertia": [self._interval(f"inertia_{xx}", joint) for xx in INERTIA],
            "scale": scale,
        }

    def payloads(self) -> Iterator[Numbers]:
        """Bodies of a known place whose mass is not known."""
        for place, joint in enumerate(self._robot.joint_names):
            name = per_joint("payload_mass", joint, self._count)
            if name not in self._true:
                continue
            numbers = {
                quantity: [self._known(f"payload_{quantity}_{axis}", joint) for axis in axes]
                for quantity, axes in (("centre_of_mass", VECTOR), ("inertia_per_mass", INERTIA))
            }
            yield {
                "joint": place,
                "mass": self._interval("payload_mass", joint),
                "centre": numbers["centre_of_mass"],
                "inertia_per_mass": numbers["inertia_per_mass"],
            }

    def _known(self, quantity: str, joint: str) -> float:
        parameter = self._true.get(per_joint(quantity, joint, self._count))
        return 0.0 if parameter is None else parameter.value


def _joints(setup: WorkspaceSetup) -> Iterator[Numbers]:
    tree, stiffness = setup.robot.links.tree, setup.law.joints.stiffness
    space = setup.workspace
    room = np.where(space.upper > space.lower, 0.0, POINT)  # the checker wants a range
    ends = zip((space.lower - room).tolist(), (space.upper + room).tolist())
    for joint, parent, own, k in zip(tree.joints, tree.parents, ends, stiffness.tolist()):
        yield {
            "parent": parent,
            "slides": joint.slides,
            "rotation": [[float(entry) for entry in row] for row in joint.placement.rotation],
            "translation": [float(entry) for entry in joint.placement.translation],
            "axis": [float(entry) for entry in joint.axis],
            "ends": list(own),
            "stiffness": k,
        }


def _is_the_plants(setup: WorkspaceSetup, arm: Numbers) -> bool:
    """Whether the bodies move as the plant's links at some poses."""
    bodies = arm["bodies"]
    mass = np.array([body["mass"][0] for body in bodies])
    centre = np.array([[entry[0] for entry in body["centre"]] for body in bodies])
    inertia = np.array([[entry[0] * body["scale"][0] for entry in body["inertia"]] for body in bodies])
    tree = setup.robot.links.tree
    parts = bodies_of(tree, mass, centre, inertia)
    compliance, own = link_compliance(setup.law.plant), setup.law.plant.parameters.vector()
    for pose in setup.workspace.sample(COMPARED, POSES_SEED):
        found = mass_matrix(tree, parts, pose).astype(float)
        if np.abs(found @ compliance.matrix(pose, own) - np.eye(len(found))).max() > NEAR:
            return False
    return True


def _body_sector(body: Numbers) -> Sector:
    """Errors of one body, and its t, by eigenvalues: lemma 4 of docs/theorem.md; t is put into the body."""
    from scipy.optimize import minimize_scalar

    mass, centre, scale = body["mass"], np.array(body["centre"]), body["scale"]
    inertia = matrix_of([entry[0] * scale[0] for entry in body["inertia"]])
    ends = [
        [end * factor - entry[0] * scale[0] for end in entry[1:] for factor in scale[1:]]
        for entry in body["inertia"]
    ]
    above, below = (
        matrix_of([max(0.0, *part) for part in ends]),
        matrix_of([max(0.0, -min(part)) for part in ends]),
    )
    beside = (np.maximum(above, below) * (1.0 - np.eye(3))).sum(axis=1)
    more, less = (np.diag(np.diag(part) + beside) for part in (above, below))
    model = _spatial(mass[0], centre[:, 0], inertia)
    values, vectors = np.linalg.eigh(model)
    if values[0] <= 0.0:
        body["split"] = EXACT
        return Sector(np.inf, np.inf)
    root = vectors / np.sqrt(values)
    corners = [np.array(one) for one in product(*({*entry[1:]} for entry in centre.tolist()))]
    most = max(
        np.linalg.eigvalsh(root.T @ _spatial(mass[2], corner, inertia + more) @ root)[-1]
        for corner in corners
    )

    def least(t: float) -> float:
        smallest = np.inf
        for corner in corners:
            turned = _crossed(corner - centre[:, 0])
            whole = _spatial((1.0 - t) * mass[1], centre[:, 0], np.zeros((3, 3)))
            whole[3:, 3:] += inertia - less - (1.0 / t - 1.0) * mass[1] * turned.T @ turned
            smallest = min(smallest, np.linalg.eigvalsh(root.T @ whole @ root)[0])
        return float(smallest)

    split = EXACT  # what is lost is concave in t
    if np.ptp(centre, axis=1).max() > 0.0:

        def lost(t: float) -> float:
            return -least(t)

        best: Any = minimize_scalar(lost, bounds=(EXACT, 1.0 - EXACT), method="bounded")
        split = float(best.x)
    body["split"] = split
    lightest = least(split)
    if lightest <= 0.0:
        return Sector(np.inf, np.inf)
    return Sector(*(float(max(0.0, end)) + ROOM for end in (1.0 - 1.0 / most, 1.0 / lightest - 1.0)))


def _crossed(c: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -c[2], c[1]], [c[2], 0.0, -c[0]], [-c[1], c[0], 0.0]])


def _spatial(mass: float, centre: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    moved = np.hstack([np.eye(3), -_crossed(centre)])
    whole = mass * moved.T @ moved
    whole[3:, 3:] += inertia
    return whole
