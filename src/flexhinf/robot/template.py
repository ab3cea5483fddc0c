"""A robot file of a chain of joints, as a template whose numbers are guesses to be replaced."""

from __future__ import annotations

from types import SimpleNamespace

from flexhinf.robot.drive_text import DriveLines, drive_lines
from flexhinf.robot.drives import DRIVES, DriveKind
from flexhinf.robot.estimates import estimated_joint
from flexhinf.robot.parameters import ESTIMATE

#: Links of the template from the base on: length m, mass kg of the first; each next one is this much shorter, lighter.
LENGTH, MASS, TAPER = 0.4, 4.0, 0.8

#: The motor of the template by what it is driven with: constants before the gear, which its input's limit is for.
GEAR, TORQUE_CONSTANT, RESISTANCE = 100.0, 0.06, 1.2

#: How much more voltage a winding needs that is hot, whose resistance is larger, with room for control.
HOTTER = 1.5

#: What the largest torque of the first joint is, N·m, and of each next one a part of it.
EFFORT, PART = 80.0, 0.5

#: Range of every joint, rad, and its speed, rad/s.
RANGE, SPEED = (-2.5, 2.5), 2.0


def template_text(joints: int, drive: str) -> str:
    """A robot file of so many joints in a vertical plane, whose motors take what `drive` says."""
    lines = [
        f"# A template: every number is a guess ({ESTIMATE}). Replace it by that of your robot, with its source.",
        'name = "my-arm"',
        "down = [1.0, 0.0, 0.0]  # x points down, z is the axis of every joint; position zero hangs",
    ]
    for k in range(joints):
        length, mass, effort = (round(x, 4) for x in (LENGTH * TAPER**k, MASS * TAPER**k, EFFORT * PART**k))
        guess = estimated_joint(effort, True, SPEED, False)
        moment = round(mass * length**2 / 12.0, 6)
        source = f'source = "{ESTIMATE}: template"'
        gap = f"\nxyz = [{LENGTH * TAPER ** (k - 1):.4g}, 0.0, 0.0]  # m" if k else ""
        motor = _motor(DRIVES[drive], effort, source)
        ending = "".join(f"\n{line}" for line in motor.motor)
        lines.append(f"""
[[joint]]
name = "joint{k + 1}"
axis = [0.0, 0.0, 1.0]{gap}
limits = {list(RANGE)}  # rad
speed_limit = {SPEED}  # rad/s
{motor.limit}

[joint.link]
mass = {{ value = {mass:g}, tolerance = 5, {source} }}  # kg
centre_of_mass = {{ value = [{0.5 * length:g}, 0.0, 0.0], {source} }}  # m
inertia = {{ xx = {0.05 * moment:.3g}, yy = {moment:.3g}, zz = {moment:.3g}, {source} }}  # kg·m²

[joint.spring]
stiffness = {{ value = {guess.stiffness.value:g}, tolerance = 10, {source} }}  # N·m/rad

[joint.motor]
motor_inertia = {{ value = {guess.motor_inertia.value:g}, tolerance = 10, {source} }}  # kg·m², seen from the link
friction = {{ value = {guess.friction.value:g}, tolerance = 30, {source} }}  # N·m·s/rad{ending}""")
    return "\n".join(lines) + "\n"


def _motor(drive: DriveKind, effort: float, source: str) -> DriveLines:
    """The largest command of a motor with a largest torque, N·m, and its constants or its loop."""
    if drive.inner:
        return drive_lines(drive, RANGE, SPEED, False)
    constant = TORQUE_CONSTANT * GEAR
    numbers = {
        "resistance": (RESISTANCE, "Ω"),
        "torque_constant": (constant, "N·m/A at the link"),
        "back_emf_constant": (constant, "V·s/rad at the link"),
    }
    p = SimpleNamespace(**{name: number for name, (number, _) in numbers.items()})
    room = HOTTER if "resistance" in drive.constants else 1.0
    most = float(drive.input_for(room * effort, 0.0, SPEED, p))
    lines = [(name, *numbers[name]) for name in drive.constants]
    return DriveLines(
        f"effort_limit = {most:.3g}  # {drive.units[0]}",
        tuple(f"{name} = {{ value = {number:g}, {source} }}  # {unit}" for name, number, unit in lines),
    )
