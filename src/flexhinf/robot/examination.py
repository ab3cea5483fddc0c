"""What is wrong or doubtful in a description of a robot, all at once and before any design."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.findings import Severity, ordered
from flexhinf.plant import Parameters
from flexhinf.robot.drive_limits import largest_drive_torques
from flexhinf.robot.elastic import DRY, EXTRAS, stated_curve
from flexhinf.robot.estimates import FASTEST, has_placeholder_effort, largest_weight, weak_joints
from flexhinf.robot.faults import PartFault, collected_faults
from flexhinf.robot.gears import curve_twist
from flexhinf.robot.init_file import branches_text, description_of
from flexhinf.robot.parts import file_warnings
from flexhinf.robot.robot import Robot
from flexhinf.robot.robot_file import format_readers, load_robot

#: Share of the largest weight below which one is an error of rounding.
ROUNDING = 1e-12

#: Poses at which weights and vibrations are looked at, and their seed.
POSES, SEED = 60, 0

#: A spring that its weight twists by more, rad (m), was probably stated in another unit.
MOST_TWIST = (0.2, 0.05)

#: Share of the largest torque beyond which the weight leaves little for a motion.
HEAVY = 0.7

#: The largest command of a drive over its joint's range or speed limit: more is another quantity, such as a torque.
FAR = 5.0

#: So many links of one mass and inertia are placeholders.
ALIKE = 3

#: Samples in a period of the fastest vibration, below which no controller of this period damps it.
FEWEST_SAMPLES = 2.5

#: Of a controller, s, where neither its user nor the drives of the robot say another one.
PERIOD = 1e-3


@dataclass(frozen=True)
class RobotFinding:
    """Something about a robot's description: a fault with which no design is made, a doubt, or a note."""

    severity: Severity
    what: str
    place: str = ""  # links or joints
    numbers: str = ""  # what was expected, and what there is
    advice: str = ""
    count: int = 1


@dataclass(frozen=True)
class JointFacts:
    """What the weight and the springs of a robot do to one joint, over its range: SI units."""

    name: str
    slides: bool
    limits: tuple[float, float] | None
    mass: float  # of its link, with what is fixed to it
    weight: float  # the largest torque that holds a pose
    # the largest torque of the motor; infinite where none is stated, NaN of a drive whose command is limited
    effort: float
    twist: float  # of the spring under that weight; NaN of a rigid joint
    slowest: float  # vibration that is mostly of this joint, Hz; NaN where there is none
    fastest: float


@dataclass
class RobotExamination:
    """Findings about a description, and the facts of each joint where the robot could be made."""

    path: Path
    findings: list[RobotFinding] = field(default_factory=list[RobotFinding])
    joints: list[JointFacts] = field(default_factory=list[JointFacts])
    robot: Robot | None = None

    def add(self, severity: Severity, what: str, **others: Any) -> None:
        """Add a finding."""
        self.findings.append(RobotFinding(severity, what, **others))

    def add_of(self, names: Sequence[str], severity: Severity, what: str, **others: Any) -> None:
        """Add a finding of the joints or links of these names, if there are any."""
        if names:
            self.add(severity, what, place=", ".join(names), count=len(names), **others)


def examine_robot(
    path: Path, elastic: str | Path | None = None, period: float | None = None
) -> RobotExamination:
    """Examine a robot file, or a URDF or MJCF file with or without the elastic data in another one.

    Vibrations are compared with `period`, s; where it is None, with that of the robot's drives, or `PERIOD`.

    Raises InvalidInput where the file is not there, or is no such file at all.
    """
    result = RobotExamination(path)
    if path.suffix.lower() != ".toml" and elastic is None and not format_readers(path):
        _examine_links(path, result)
    else:
        result.robot = _loaded(path, elastic, result)
    if result.robot is not None:
        result.joints = joint_facts(result.robot)
        drives = result.robot.drive_period
        of_joints = _of_joints(result.joints, period or drives or PERIOD, drives)
        result.findings += [*_of_numbers(result.robot), *of_joints, *_of_commands(result.robot)]
    result.findings = [*ordered(result.findings)]
    return result


def _loaded(path: Path, elastic: str | Path | None, result: RobotExamination) -> Robot | None:
    robot = None
    if not path.is_file():
        load_robot(path, elastic)  # says what it may have meant
    with file_warnings() as remarks, collected_faults() as faults:
        try:
            robot = load_robot(path, elastic)
        except InvalidInput as error:
            if not faults:  # else the first of those that are collected
                faults.append(_fault(error))
    _tell(faults, remarks, result)
    return None if faults else robot


def _examine_links(path: Path, result: RobotExamination) -> None:
    """What a URDF or MJCF file says by itself: all its faults, and what a design needs besides."""
    found = description_of(path)
    with file_warnings() as remarks, collected_faults() as faults:
        try:
            found.read()
        except InvalidInput as error:
            faults.append(_fault(error))
    _tell(faults, remarks, result)
    try:
        arm = found.arm()
    except InvalidInput as error:
        if error.what not in {finding.what for finding in result.findings}:
            result.add("fault", error.what, numbers=error.found, advice=error.advice)
        return
    if faults:
        result.add(
            "note", "A robot file gets round these faults.", advice=f"flexhinf init {shlex.quote(str(path))}"
        )
    if branches := branches_text(arm, path):
        result.add("note", f"{branches}.")
    for change in found.changes:
        result.add("note", f"`flexhinf init` changes what the file says: {change}.")
    idle = [joint.name for joint, effort in zip(arm.joints, arm.efforts) if not np.isfinite(effort)]
    if idle:
        result.add_of(
            idle,
            "doubt",
            "The largest torque of joints is not stated.",
            numbers="expected <limit effort> greater than 0, got none, 0, −1 or a number that stands for none",
            advice="effort_limit in [[joint]] of the robot file",
        )
    elif has_placeholder_effort(arm, weights := largest_weight(arm)):
        result.add(
            "doubt",
            "All joints state one torque, and none needs a thirtieth of it.",
            numbers=f"expected torques of data sheets, got {arm.efforts[0]:g} for at most {weights.max():.2g}",
            advice="effort_limit in [[joint]] of the robot file; `flexhinf init` estimates from masses instead",
        )
    else:
        result.add_of(
            weak_joints(arm),
            "doubt",
            "All joints state one torque, which holds less than half of their weight.",
            numbers=f"expected torques of data sheets, got {arm.efforts[0]:g}",
            advice="effort_limit in [[joint]] of the robot file; `flexhinf init` estimates from masses instead",
        )
    masses, inertias = [link.mass for link in arm.links], [link.inertia for link in arm.links]
    result.findings += _of_masses(np.array(masses, dtype=float), np.array(inertias, dtype=float))
    fast = {joint.name: speed for joint, speed in zip(arm.joints, arm.speeds) if FASTEST < speed < math.inf}
    result.add_of(
        [*fast],
        "doubt",
        "Joints state a speed that no joint reaches.",
        numbers=f"expected <limit velocity> of a data sheet, got {max(fast.values(), default=0.0):g}",
        advice="speed_limit in [[joint]] of the robot file",
    )
    free = [joint.name for joint in arm.joints if joint.limits is None]
    result.add_of(free, "note", "Joints without limits.")
    away = [
        joint.name for joint in arm.joints if joint.limits and not joint.limits[0] <= 0.0 <= joint.limits[1]
    ]
    result.add_of(
        away, "note", "Zero is outside the limits of joints.", advice="home = […] in the robot file"
    )
    result.add_of(
        [joint.name for joint in arm.joints],
        "doubt",
        "No file of links states springs: stiffness, motor inertia and friction of each joint are missing.",
        advice=f"flexhinf init {shlex.quote(str(path))}, which estimates them, then numbers of data sheets or "
        "`flexhinf identify`",
    )


def _fault(error: InvalidInput) -> PartFault:
    return PartFault("", (), error.what, error.found, error.advice)


def _tell(faults: Sequence[PartFault], remarks: Sequence[str], result: RobotExamination) -> None:
    for fault in faults:
        result.add(
            "fault",
            fault.what,
            place=", ".join(fault.parts),
            numbers=fault.found,
            advice=fault.advice,
            count=max(1, len(fault.parts)),
        )
    for remark in remarks:
        what, _, others = remark.partition("\n  found: ")
        numbers, _, advice = others.partition("\n  try:   ")
        result.add("doubt", what, numbers=numbers, advice=advice)


# Facts --------------------------------------------------------------------------------------------
def joint_facts(robot: Robot) -> list[JointFacts]:
    """Weight, twist and vibrations of each joint at random poses of its range, and at home.

    Weight and twist are of the heaviest robot of the tolerances, with the largest payload.
    """
    ends = np.array([limits or (-math.pi, math.pi) for limits in robot.links.limits])
    poses = np.random.default_rng(SEED).uniform(ends[:, 0], ends[:, 1], (POSES, len(ends)))
    poses = np.vstack([np.asarray(robot.home, dtype=float)[None, :], poses])
    numbers = robot.plant_parameters()
    p = Parameters(numbers)
    held = robot.links.gravity_torque(poses.T, Parameters(robot.heaviest))
    weights = np.abs(robot.layout.on_motors(held)).max(axis=1)
    weights[weights < ROUNDING * weights.max()] = 0.0  # an axis that gravity does not turn
    seen: dict[str, list[float]] = {name: [] for name in robot.joint_names}
    for pose in poses[:: max(1, POSES // 12)]:
        for mode in robot.modes(pose):
            if mode.name == "vibration":
                seen[mode.joint].append(mode.frequency)
    masses = np.atleast_1d(p.mass)
    elastic = robot.layout.elastic
    curved = bool(stated_curve(numbers))
    turned = curve_twist(weights[elastic], p) if curved else weights[elastic] / np.atleast_1d(p.stiffness)
    twists = dict(zip([robot.joint_names[k] for k in elastic], turned.tolist()))
    efforts = _largest_torques(robot, p)
    return [
        JointFacts(
            name,
            slides,
            limits,
            float(masses[k]),
            float(weights[k]),
            efforts[k],
            twists.get(name, math.nan),
            min(seen[name], default=math.nan),
            max(seen[name], default=math.nan),
        )
        for k, (name, slides, limits) in enumerate(
            zip(robot.joint_names, robot.links.slides, robot.links.limits)
        )
    ]


def _largest_torques(robot: Robot, p: Parameters) -> list[float]:
    """The largest torque of each motor at rest; infinite where no limit is stated, NaN of an inner loop that states
    none, whose limit is that of its command."""
    limits = robot.effort_limits or [None] * len(robot.joint_names)
    if robot.drive_kind.inner:
        own = largest_drive_torques(p, len(limits))
        return np.where(np.isfinite(own), own, math.nan).tolist()
    gain = np.broadcast_to(robot.drive_kind.torque_per_input(p), len(limits))
    return [math.inf if limit is None else float(limit * k) for limit, k in zip(limits, gain)]


def _of_masses(masses: np.ndarray, inertias: np.ndarray) -> Iterator[RobotFinding]:
    """That all links are one placeholder, by the mass, kg, and the inertia, kg·m², of each."""
    links = np.column_stack([masses, inertias])
    if len(links) >= ALIKE and bool((links == links[0]).all()):
        yield RobotFinding(
            "doubt",
            "All links have one mass and one inertia.",
            numbers=f"expected those of each link, got {links[0, 0]:g} kg and {links[0, 1:].max():g} kg·m², "
            f"{len(links)} times",
            advice="masses, centres of mass and inertias of CAD, or of another file of this robot",
        )


def _of_numbers(robot: Robot) -> Iterator[RobotFinding]:
    numbers = robot.plant_parameters()
    if "inertia" in numbers:  # not of a single link, with an inertia about its axis
        yield from _of_masses(np.atleast_1d(numbers["mass"]), np.atleast_1d(numbers["inertia"]))
    if robot.estimated:
        every = set(robot.joint_names)
        places = [
            f"{quantity.replace('_', ' ')} of {'every joint' if set(joints) == every else ', '.join(joints)}"
            for quantity, joints in robot.estimated.items()
        ]
        yield RobotFinding(
            "doubt",
            "Numbers are estimated, not measured.",
            "; ".join(places),
            count=len(places),
            advice="numbers of data sheets, or `flexhinf identify` with a log; code for a machine is exported with "
            "--accept-estimates only",
        )
    if not robot.uncertain:
        yield RobotFinding(
            "note",
            "No number has a tolerance.",
            numbers="a design is then tried on one robot alone",
            advice="[tolerances] with stiffness = 10 in the robot file",
        )
    if not any(name.startswith(tuple(EXTRAS[kind] for kind in DRY)) for name in robot.nominal):
        yield RobotFinding(
            "note",
            "No joint states dry friction.",
            numbers="gears have 2 to 10 % of their largest torque",
            advice="coulomb_friction in [joint.motor]",
        )


def _of_commands(robot: Robot) -> Iterator[RobotFinding]:
    """Findings about the largest commands of drives that take positions or velocities, beside what the joints do."""
    drive = robot.drive_kind
    if not (drive.takes_positions or drive.takes_velocities) or not robot.effort_limits:
        return
    n, kind = len(robot.joint_names), "range" if drive.takes_positions else "speed limit"
    ranges = [limits and max(map(abs, limits)) for limits in robot.links.limits]
    needs = ranges if drive.takes_positions else robot.speed_limits or [None] * n
    for name, slides, most, need in zip(robot.joint_names, robot.links.slides, robot.effort_limits, needs):
        if most is None or need is None or need <= most <= FAR * need:
            continue
        unit = drive.units[slides]
        yield RobotFinding(
            "doubt",
            f"The largest command is {'far beyond' if most > need else 'less than'} the joint's {kind}.",
            name,
            f"expected {need:.4g} {unit} or somewhat more, got {most:.4g} {unit}",
            f"effort_limit = … in {unit}: the largest command; the torque of the motor is drive_torque_limit",
        )


def _of_joints(joints: Sequence[JointFacts], period: float, shortest: float) -> Iterator[RobotFinding]:
    """Findings about each joint, for a controller of this period, s, and the shortest one that its drives take."""
    unlimited = [joint.name for joint in joints if math.isinf(joint.effort)]
    if unlimited:
        yield RobotFinding(
            "note",
            "The largest torque of motors is not stated.",
            ", ".join(unlimited),
            "a design then asks for what no motor may give",
            "effort_limit in [[joint]] of the robot file",
            count=len(unlimited),
        )
    for joint in joints:
        unit = "N" if joint.slides else "N·m"
        share = joint.weight / joint.effort
        if share > 1.0:
            yield RobotFinding(
                "doubt",
                "The motor does not hold the weight everywhere.",
                joint.name,
                f"expected at most {joint.effort:.4g} {unit}, got {joint.weight:.4g} at a pose of its range",
                "a workspace without these poses (--workspace), a smaller payload, or the motor's own limit",
            )
        elif share > HEAVY:
            yield RobotFinding(
                "note",
                "The weight takes most of the motor's torque.",
                joint.name,
                f"{100 * share:.0f} % of {joint.effort:.4g} {unit} at the heaviest pose",
            )
        if joint.twist > MOST_TWIST[joint.slides]:
            yield RobotFinding(
                "doubt",
                "The weight twists the spring far.",
                joint.name,
                f"{joint.twist:.3g} {'m' if joint.slides else 'rad'} at the heaviest pose",
                f"stiffness in {'N/m' if joint.slides else 'N·m/rad'}, seen from the link",
            )
        if joint.fastest * period * FEWEST_SAMPLES > 1.0:
            needed = 1.0 / (4.0 * joint.fastest)
            faster = f"--period {1e3 * needed:.2g}ms, or " if needed >= shortest else ""
            yield RobotFinding(
                "doubt",
                "A vibration is too fast for the period.",
                joint.name,
                f"expected at most {1.0 / (FEWEST_SAMPLES * period):.4g} Hz at {1e3 * period:g} ms, got "
                f"{joint.fastest:.4g} Hz",
                f"{faster}rigid = true in its [[joint]]",
            )
