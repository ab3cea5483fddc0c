"""What a refusal of a robot's files advises works: it is read, applied to the file, and the robot loads.

Each row is a mistake. Its message is followed as a reader would: the line that it writes goes to the top of the robot
file, a key or an attribute goes where the mistake is. A robot may need more than one message; none may come twice.
"""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from tests.builders import joint_text
from tests.refusals import Anchor, unnamed

from flexhinf.errors import InvalidInput
from flexhinf.robot import RobotFileWarning, load_robot
from flexhinf.robot.file_keys import TABLES, key_advice
from flexhinf.robot.urdf import read_urdf


def urdf_link(name: str, mass: float = 1.0) -> str:
    return f"""<link name="{name}"><inertial><origin xyz="0 0 0.1"/>
<mass value="{mass}"/>
<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
"""


def urdf_joint(name: str, parent: str, child: str, more: str = "", kind: str = "revolute") -> str:
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 0.2" rpy="0 0 0"/>
<axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="30" velocity="3"/>
{more}</joint>
"""


#: An arm of two joints with a finger, and one that follows it.
URDF = (
    '<robot name="r"><link name="base"/>\n'
    + urdf_link("A") + urdf_link("B") + urdf_link("F", 0.05) + urdf_link("G", 0.05)
    + urdf_joint("a", "base", "A") + urdf_joint("b", "A", "B")
    + urdf_joint("f", "B", "F", kind="prismatic")
    + urdf_joint("g", "B", "G", kind="prismatic").replace("0 0 0.2", "0 0 0.3") + "</robot>"
)  # fmt: skip

MJCF = """<mujoco><worldbody>
<body name="A">
<joint name="a" axis="0 1 0" range="-90 90"/>
<inertial pos="0 0 0.1" mass="1" diaginertia="0.02 0.02 0.01"/>
<body name="B" pos="0 0 0.3">
<joint name="b" axis="0 1 0" range="-90 90"/>
<inertial pos="0 0 0.1" mass="1" diaginertia="0.02 0.02 0.01"/>
<body name="F" pos="0 0 0.2">
<joint name="f" type="slide"/>
<inertial pos="0 0 0" mass="0.1" diaginertia="1e-3 1e-3 1e-3"/>
</body></body></body>
<body name="table"><geom size="0.1"/></body>
</worldbody></mujoco>"""


def elastic(*names: str) -> str:
    given = {"mass": None, "spring": "stiffness = 800.0", "motor": "motor_inertia = 0.2"}
    return "".join(joint_text(name, **given) for name in names)


OWN = 'name = "own"\n' + joint_text(
    "a", axis=[0, 1, 0], spring="stiffness = 800.0", motor="rotor_inertia = 1e-5\ngear_ratio = 100.0\nfriction = 0.5"
) + joint_text(
    "b", axis=[0, 1, 0], xyz=[0.0, 0.0, 0.2], mass=0.5, inertia=(0.01, 0.01, 0.005), spring="stiffness = 400.0",
    motor="rotor_inertia = 1e-5\ngear_ratio = 90.0",
)  # fmt: skip

ONE = """[[joint]]
name = "a"
[joint.link]
axis_inertia = 0.5
length = 0.3
mass = 2.0
[joint.spring]
stiffness = 300.0
[joint.motor]
motor_inertia = 0.1
"""

SPRINGS = elastic("a", "b", "f", "g")
TINY = urdf_link("G", 1e-8).replace("0.02", "1e-8").replace("0.01", "1e-8")
PLACED = 'name = "b"\naxis = [0, 1, 0]\nxyz = [0.0, 0.0, 0.2]'
MIMIC = '<mimic joint="f" multiplier="-1"/>'
TENDON = "<tendon><fixed name='t' range='-1 1'><joint joint='a' coef='1'/></fixed></tendon>"
BALL = '<joint name="f" type="ball"/>'


@pytest.mark.parametrize(
    ("text", "old", "new", "named"),
    [
        # URDF
        (URDF, 'lower="-2" upper="2"', 'lower="0.5" upper="2"', ("'a'", "home = [")),
        (URDF, '<axis xyz="0 1 0"/>', f'<axis xyz="0 1 0"/>{MIMIC}', ("'a'", "mimic")),
        (URDF, 'upper="2" effort="30"', 'upper="2" effort="-7"', ("'a'", "-7")),
        (URDF, 'lower="-2" upper="2"', 'lower="2" upper="-2"', ("'a'", "no room")),
        (URDF, 'lower="-2" upper="2"', 'lower="1" upper="1"', ("'a'", "locked = {")),
        (URDF, 'xyz="0 0 0.2" rpy', 'xyz="0; 0; 0.2" rpy', ("'a'", "0; 0; 0.2")),
        (URDF, '<mass value="1.0"/>\n', '<mass value="0"/>\n', ("no mass", "'a'")),
        (URDF, 'ixx="0.02" iyy="0.02" izz="0.01"', 'ixx="0" iyy="0" izz="0"', ("'A'", "ball")),
        (URDF, 'ixx="0.02" iyy="0.02" izz="0.01"', 'ixx="0.02" iyy="0.02" izz="0.1"', ("'A'", "nearest")),
        (URDF, 'name="a" type="revolute"', 'name="a" type="floating"', ("'floating'", "'a'")),
        (URDF, urdf_link("G", 0.05), TINY, ("'g'", "placeholder", "rigid = true")),
        (URDF, 'xyz="0 0 0.1"', 'xzy="0 0 0.1"', ("'A'", "origin", "xzy")),
        (URDF, '<mass value="1.0"/>', '<mass value="1.0" unit="g"/>', ("'A'", "mass", "unit")),
        (URDF, "<axis", '<dynamics damp="0.7"/>\n<axis', ("'a'", "dynamics", "damp", "damping='0.7'")),
        (URDF, "<axis", '<dynamics frictoin="0.7"/>\n<axis', ("'a'", "dynamics", "friction='0.7'")),
        (URDF, 'upper="2" effort="30"', 'uper="2" effort="30"', ("'a'", "limit", "upper='2'")),
        (URDF, "<axis", f'{MIMIC.replace("multiplier", "multipler")}\n<axis', ("'a'", "mimic", "multipler")),
        (URDF, '"a" type="revolute"', '"a" type="Revolute"', ("'Revolute'", "type='revolute'")),
        # springs beside a URDF
        (SPRINGS, elastic("f"), "", ("'f'", "no stiffness", "joints = [")),
        (SPRINGS, elastic("a"), "locked = {f = 9.0}\n" + elastic("a"), ("'f'", "-2 to 2, got 9", "locked = {f = 2}")),
        # MJCF
        (MJCF, '<joint name="f" type="slide"/>', BALL, ("'ball'", "'f'")),
        (MJCF, '<joint name="f" type="slide"/>', '<joint name="f" axis="1 0 0"/><joint name="t"/>', ("'t'",)),
        (MJCF, '<joint name="f" type="slide"/>', '<joint name="f" type="slide" stiffness="9"/>', ("'f'", 9)),
        (MJCF, "</worldbody>", "</worldbody><equality><joint joint1='f' joint2='b'/></equality>", ("f, b",)),
        (MJCF, "</worldbody>", "</worldbody><option density='1.2'/>", ("density", 1.2)),
        (MJCF, "<mujoco>", f"<mujoco>{TENDON}", ("t", "-1 1")),
        # robot files
        (OWN, "gear_ratio = 100.0", "gear_ratio = -100.0", ("'gear_ratio_a'", "> 0, got -100")),
        (OWN, "gear_ratio = 100.0", 'gear_ratio = "100 s"', ("'gear_ratio'", "100 s")),
        (OWN, "friction = 0.5", "friction = -0.5", ("'friction_a'", -0.5)),
        (OWN, "friction = 0.5", "frition = 0.5", ("'frition'", "friction")),
        (OWN, 'name = "own"', "gravity = -9.81", ("'gravity'", -9.81, "9.81", "'down'")),
        (OWN, 'name = "own"', "gravity = [0, 0, -9.81]", ("'gravity'", "down = [0.0, 0.0, -1.0]")),
        (OWN, "axis = [0, 1, 0]", "rpy = [0.0, 90.0, 0.0]", ("'a'", "degrees", 1.5708)),
        (OWN, "stiffness = 800.0", 'stiffness = "800 Nm"', ("'stiffness'", "800 Nm")),
        (OWN, "rotor_inertia = 1e-5\ngear_ratio = 100.0", "rotor_inertia = 1e-5", ("gear ratio",)),
        (OWN, "stiffness = 800.0", "stiffness = 8.0", ("'a'", "twists")),
        (OWN, PLACED, 'axis = [1, 0, 0]\nname = "b"',
         ("'b'", "xyz = [0.0, 0.0, 0.2]")),
        (ONE, "axis_inertia = 0.5", "axis_inertia = 0.1", ("'a'", 0.18, 0.1, "axis_inertia = 0.28")),
        (ONE, "mass = 2.0\n", "", ("mass = 1.0",)),
        (ONE, "length = 0.3\n", "", ("length = 0.1",)),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, tuple) else "",
)  # fmt: skip
def test_advice_on_a_robot_file_works(
    text: str, old: str, new: str, named: tuple[Anchor, ...], tmp_path: Path
) -> None:
    assert old in text
    changed, told = text.replace(old, new, 1), list[str]()
    files = {"own.toml": changed}
    if text is SPRINGS:
        files = {"arm.urdf": URDF, "joints.toml": changed}
    elif text in (URDF, MJCF):
        joints = SPRINGS if text is URDF else elastic("a", "b", "f")
        files = {"arm.urdf" if text is URDF else "arm.xml": changed, "joints.toml": joints}
    while message := load(tmp_path, files, bool(told)):
        assert message not in told, message
        told.append(message)
        follow(message, files, new or "[joint.link]\n")
    assert unnamed("".join(told[:1]), *named) == [], told


@pytest.mark.parametrize(
    ("limits", "home", "places"), [("0.5, 1e16", 0.5, "0.5 to 3.5"), ("-1e16, -0.5", -0.5, "-3.5 to -0.5")]
)
def test_a_limit_on_one_side_advises_places_near_the_other(
    limits: str, home: float, places: str, tmp_path: Path
) -> None:
    text = OWN.replace("axis = [0, 1, 0]", f"axis = [0, 1, 0]\nlimits = [{limits}]", 1)
    line = f"home = [{home}, 0.0]"
    assert unnamed(load(tmp_path, {"own.toml": text}, True), line) == []
    message = load(tmp_path, {"own.toml": f"{line}\n{text}"}, True)
    assert unnamed(message.partition("try:")[2], places) == []


@pytest.mark.parametrize(
    ("table", "others", "meant"),
    [
        ("motor", "viscous_friction damping Friction friktion", "'friction'"),
        ("motor", "dry_friction friction_torque frictionloss stiction coulombFriction", "'coulomb_friction'"),
        ("motor", "reduction ratio gear-ratio gear_ration", "'gear_ratio'"),
        ("motor", "armature inertia", "'motor_inertia'"),
        ("motor", "max_velocity", "speed_limit in [[joint]], below its name"),
        ("joint", "velocity_limit max_velocity speed_limt", "'speed_limit'"),
        ("joint", "torque_limit max_torque Effort", "'effort_limit'"),
        ("joint", "reduction", "gear_ratio in [joint.motor]"),
        ("joint", "damping", "damping in [joint.spring]"),
        ("spring", "spring_constant stifness", "'stiffness'"),
        ("link", "center_of_mass com", "'centre_of_mass'"),
    ],
)
def test_a_key_by_another_name_is_advised_as_the_one_of_its_quantity(
    table: str, others: str, meant: str
) -> None:
    assert {other: key_advice(other, TABLES[table], False) for other in others.split()} == dict.fromkeys(
        others.split(), meant
    )


@pytest.mark.parametrize(
    ("old", "new", "place", "meant"),
    [
        ('effort="30"', 'effort="inf"', "efforts", math.inf),
        ('effort="30"', 'effort="1e308"', "efforts", math.inf),
        ('effort="30"', 'effort="30,5"', "efforts", 30.5),
        ('effort="30"', 'effort="0.5 kNm"', "efforts", 500.0),
        ('velocity="3"', 'velocity="Infinity"', "speeds", math.inf),
        ('velocity="3"', 'velocity="30rpm"', "speeds", math.pi),
        ('lower="-2"', 'lower="-pi"', "limits", (-math.pi, 2.0)),
        ('lower="-2"', 'lower="-90deg"', "limits", (-math.pi / 2.0, 2.0)),
        ('lower="-2" upper="2"', 'lower="-inf" upper="inf"', "limits", None),
        ('<mass value="1.0"/>', '<mass value="50g"/>', "mass", 0.05),
        ('<mass value="1.0"/>', '<mass value="50 Nm"/>', "mass", "kg"),
        ('<mass value="1.0"/>', '<mass value="1,000"/>', "mass", "kg"),
        ('rpy="0 0 0"', 'rpy="0 0 90deg"', "turn", math.pi / 2.0),
        ('rpy="0 0 0"', 'rpy="0 0 90"', "turn", math.pi / 2.0),
        ('rpy="0 0 0"', 'rpy="0, 0, pi/2"', "turn", math.pi / 2.0),
        ('xyz="0 0 0.2"', 'xyz="0 0 -300mm"', "height", -0.3),
        ('xyz="0 0 0.2"', 'xyz="0,0 0,0 0,2"', "height", 0.2),
        ('xyz="0 0 0.2"', 'xyz="0 0.2"', "height", "m"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1"/>', "axis", "3"),
    ],
    ids=str,
)  # fmt: skip
def test_a_number_of_a_urdf_that_cannot_be_read_is_advised_as_it_was_meant(
    old: str, new: str, place: str, meant: Any
) -> None:
    """A text keeps its unit; where nobody knows what was meant, the unit is named and no number is made up."""
    assert old in URDF
    text = URDF.replace(old, new, 1)
    while advice := advice_on(text):
        if isinstance(meant, str):
            assert unnamed(advice, meant) == []
            assert not re.search(r"='[^'…]+'", advice)
            return
        key, value = re.findall(r"(\w+)='([^']*)'", advice)[0]
        edited = re.sub(rf'\b{key}="[^"]*"', f'{key}="{value}"', new)
        assert edited != new, advice
        text, new = text.replace(new, edited, 1), edited
    arm = read_urdf(ElementTree.fromstring(text))
    joint = arm.joints[0]
    found = {
        "efforts": arm.efforts[0], "speeds": arm.speeds[0], "limits": joint.limits, "mass": arm.links[0].mass,
        "turn": math.atan2(joint.placement.rotation[1][0], joint.placement.rotation[0][0]),
        "height": joint.placement.translation[2],
    }[place]  # fmt: skip
    assert found == (meant if meant is None else pytest.approx(meant, rel=1e-5))


def advice_on(text: str) -> str:
    """What the refusal of a URDF advises; "" for one that is read."""
    try:
        read_urdf(ElementTree.fromstring(text))
    except InvalidInput as error:
        return error.advice
    return ""


def load(folder: Path, files: dict[str, str], followed: bool) -> str:
    """The message of a refusal, or the first warning; "" for a robot that loads, once something was followed with
    warnings too."""
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RobotFileWarning)
        try:
            load_robot(*(folder / name for name in files))
        except InvalidInput as error:
            return str(error)
    return "".join(str(warning.message) for warning in caught[: not followed])


def follow(message: str, files: dict[str, str], wrong: str) -> None:
    """Edit the files as the last part of a message says; `wrong` is the text with the mistake."""
    advice = message.partition("try:")[2].strip()
    rigid, toml = next(iter(files)), list(files)[-1]
    top = re.match(r".*?((joints|home|locked) = (?:\[.*?\]|\{.*?\}))", advice)
    attributes = re.findall(r"(\w+)='([^']*)'", advice)
    element = re.search(r"<\w+ name='\w+'", advice)
    joint = re.search(r"joint '(\w+)'", message)
    if top and " at the top" in advice:
        kept = [line for line in files[toml].splitlines() if not line.startswith(f"{top[2]} =")]
        files[toml] = "\n".join([top[1], *kept, ""])
    elif "leave out the [[joint]]" in advice:
        name = advice.split("'")[1]
        files[toml] = files[toml].replace(elastic(name), "")
    elif "rigid = true" in advice:
        assert joint, message
        files[toml] = files[toml].replace(
            elastic(joint[1]), elastic(joint[1]).replace("[joint.spring]\nstiffness = 800.0", "rigid = true")
        )
    elif rigid != toml and "without" in advice:
        word = advice.split("without ")[1].split()[0]
        files[rigid] = re.sub(rf' {word}=["\'][^"\']*["\']', "", files[rigid], count=1)
    elif rigid != toml and attributes:
        assert wrong in files[rigid]
        line = next(
            line
            for line in files[rigid].splitlines()
            if (element[0].replace("'", '"') if element else wrong) in line
        )
        edited = line
        for key, value in attributes:
            if key != "name":
                edited = re.sub(rf'\b{key}="[^"]*"', f'{key}="{value}"', edited)
        assert edited != line, advice
        files[rigid] = files[rigid].replace(line, edited)
    else:
        line = next(
            line for line in files[toml].splitlines() if line in wrong.splitlines()[-1:] or line == wrong
        )
        assigned = re.match(r"(?:add )?(\w+ = (?:'[^']*'|\[[^\]]*\]|[-\d.e]+))", advice)
        number, name = re.match(r"[-\d.e]+", advice), re.match(r"'(\w+)'", advice)
        key, _, value = line.partition(" = ")
        if name:
            better = f"{name[1]} = {value}"
        elif number:
            better = f"{key} = {number[0]}"
        else:
            assert assigned, advice
            same = assigned[1].startswith(f"{key} = ")
            better = assigned[1] if same else f"{line}\n{assigned[1]}"
        files[toml] = files[toml].replace(line, better, 1)
