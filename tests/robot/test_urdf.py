"""URDF: what is merged, chosen, locked and refused; equal to Pinocchio's reader."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.errors import InvalidInput
from flexhinf.robot import load_robot
from flexhinf.robot.dynamics import Tree, bodies_of, forward_dynamics
from flexhinf.robot.parts import RobotFileWarning, file_warnings
from flexhinf.robot.urdf import read_urdf
from flexhinf.validation import read_xml

ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="world"/>
  <link name="base"><inertial><mass value="9"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="stand" type="fixed"><parent link="world"/><child link="base"/>
    <origin xyz="0 0 0.2" rpy="0.1 0 0"/></joint>
  <link name="upper"><inertial><origin xyz="0.1 0.02 0.3" rpy="0.2 -0.1 0.3"/><mass value="2.5"/>
    <inertia ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.04" iyz="0.003" izz="0.02"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0.1 0 0.3" rpy="0 0.4 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="1.5" effort="9" velocity="1"/></joint>
  <link name="bracket"><inertial><origin xyz="0 0.1 0"/><mass value="0.4"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.0015"/></inertial></link>
  <joint name="weld" type="fixed"><parent link="upper"/><child link="bracket"/>
    <origin xyz="0 0 0.5" rpy="0.7 0 0.2"/></joint>
  <link name="fore"><inertial><origin xyz="0 0 0.2"/><mass value="1.2"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.004"/></inertial></link>
  <joint name="elbow" type="continuous"><parent link="bracket"/><child link="fore"/><origin xyz="0.05 0 0.1"/>
    <axis xyz="0.6 0 0.8"/></joint>
  <link name="ram"><inertial><mass value="0.5"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.0005"/></inertial></link>
  <joint name="lift" type="prismatic"><parent link="fore"/><child link="ram"/><origin xyz="0 0 0.4" rpy="0 0.3 0"/>
    <axis xyz="0 0 -1"/><limit lower="0" upper="0.3" effort="9" velocity="1"/></joint>
  <link name="finger"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="grip" type="prismatic"><parent link="ram"/><child link="finger"/><origin xyz="0.02 0 0.1"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.04" effort="9" velocity="1"/></joint>
  <link name="twin"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="follow" type="prismatic"><parent link="ram"/><child link="twin"/><origin xyz="-0.02 0 0.1"/>
    <axis xyz="-1 0 0"/><limit lower="0" upper="0.04" effort="9" velocity="1"/><mimic joint="grip"/></joint>
</robot>
"""

JOINT = '[[joint]]\nname = "{}"\n[joint.spring]\nstiffness = 500.0\n[joint.motor]\nmotor_inertia = 0.2\n'


@pytest.fixture
def urdf(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM, encoding="utf-8")
    return path


@pytest.fixture
def elastic(tmp_path):
    def file(*names, head=""):
        path = tmp_path / "joints.toml"
        path.write_text(head + "".join(JOINT.format(name) for name in names), encoding="utf-8")
        return path

    return file


ROUND = '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/>'

#: Elements that stand before another one of their name, and after what.
TWICE = [
    ('<link name="fore">', f'<inertial><mass value="2"/>{ROUND}</inertial>'),
    ('<link name="bracket"><inertial>', '<origin xyz="0 0 9"/>'),
    ('<parent link="bracket"/><child link="fore"/>', '<origin xyz="0 0 9"/>'),
    ('<parent link="world"/><child link="base"/>', '<origin xyz="0 0 9"/>'),
]


@pytest.mark.ci("reads arms by Pinocchio too")
@pytest.mark.oracle
@pytest.mark.parametrize(("place", "first"), [("</robot>", ""), *TWICE])
def test_the_same_arm_as_pinocchio_reads(place, first, urdf):
    pin, moving = pytest.importorskip("pinocchio"), ["shoulder", "elbow", "lift"]
    with file_warnings():
        root = changed(urdf, (place, place + first))
        arm = read_urdf(root, moving, {"grip": 0.03, "follow": 0.03})
    full = pin.buildModelFromUrdf(str(urdf))
    rest = pin.neutral(full)
    locked = [full.getJointId(name) for name in ("grip", "follow") if full.existJointName(name)]
    for joint in locked:
        rest[full.joints[joint].idx_q] = 0.03
    model = pin.buildReducedModel(full, locked, rest)
    assert [joint.name for joint in arm.joints] == list(model.names)[1:] == ["shoulder", "elbow", "lift"]
    assert arm.joints[0].limits == (-2.0, 1.5)
    tree, rng = Tree(arm.joints), np.random.default_rng(0)
    columns = zip(*((link.mass, link.centre_of_mass, link.inertia) for link in arm.links))
    bodies = bodies_of(tree, *columns)
    for _ in range(10):
        q, dq, torque = rng.normal(size=(3, 3))
        position = np.array([q[0], np.cos(q[1]), np.sin(q[1]), q[2]])
        expected = pin.aba(model, model.createData(), position, dq, torque)
        found = np.array(forward_dynamics(tree, bodies, q, dq, torque, (0.0, 0.0, -9.81)))
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


def test_joints_are_chosen_or_locked_by_name(urdf, elastic):
    robot = load_robot(urdf, elastic=elastic("shoulder", "lift"), joints=["shoulder", "lift"])
    assert robot.joint_names == ("shoulder", "lift")
    assert robot.plant().unit("link_position_lift") == "m"
    assert robot["mass_shoulder"].value == pytest.approx(2.5 + 0.4 + 1.2)
    names = ("shoulder", "elbow", "lift")
    head = 'urdf = "arm.urdf"\nlocked = { grip = 0.0, follow = 0.0 }\n'
    assert load_robot(elastic(*names, head=head)).joint_names == names
    head = 'urdf = "arm.urdf"\njoints = ["elbow"]\n'
    assert load_robot(elastic("elbow", head=head)).plant().states[0] == "link_position"


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (None, {"locked": {"grip": 0.0}}, ["'follow'", "mimic"]),
        (None, {"joints": ["shoulder", "wrist"]}, ["'wrist'", "'elbow'"]),
        (None, {"joints": ["sholder"]}, ["'sholder'", "try:   'shoulder'"]),
        (None, {"joints": ["grip"], "locked": {"grip": 0.0}}, ["'grip'", "chosen", "locked"]),
        (None, {"locked": {"lift": 99.0}}, ["'lift'", "limits", "0 to 0.3, got 99"]),
        (("<?xml", "not <<xml"), {}, ["no XML"]),
        (("<robot name", "<model name"), {}, ["no XML"]),
        (('type="revolute"', 'type="floating"'), {}, ["'shoulder'", "'floating'"]),
        (('<axis xyz="0 1 0"/>', '<axis xyz="0 1"/>'), {}, ["'shoulder'", "3 numbers"]),
        (('<mass value="2.5"/>', '<mass value="heavy"/>'), {}, ["'upper'", "'heavy'"]),
        (('ixx="0.03"', 'ixx="0.3"'), {"joints": ["shoulder"]}, ["'upper'", "triangle"]),
        (('<child link="fore"/>', '<child link="for"/>'), {}, ["'elbow'", "'for'"]),
        (('<parent link="world"/>', '<parent link="ram"/>'), {}, ["tree", "['world']", "'ram'"]),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(urdf, change, options, words):
    if change:
        assert change[0] in ARM
        urdf.write_text(ARM.replace(*change, 1), encoding="utf-8")
    with pytest.raises(InvalidInput) as caught:
        read_urdf(read_xml(urdf), **options)
    error = caught.value
    assert all((error.what, error.found, error.advice))
    assert [word for word in words if word not in str(error)] == []


def test_a_urdf_without_inertials_or_without_elastic_data(urdf, elastic):
    with refused_with(InvalidInput, "arm.urdf", "elastic="):
        load_robot(urdf)
    with refused_with(InvalidInput, "'elbow'", "arm.urdf", "stiffness"):
        load_robot(urdf, elastic=elastic("shoulder"), joints=["shoulder", "elbow"])
    with refused_with(InvalidInput, "'elbw'", "arm.urdf"):
        load_robot(urdf, elastic=elastic("shoulder", "elbw"), joints=["shoulder", "elbow"])
    twice = elastic("shoulder").read_text().replace("[joint.spring]", "axis = [0, 0, 1]\n[joint.spring]")
    path = elastic("shoulder")
    path.write_text(twice, encoding="utf-8")
    with pytest.raises(InvalidInput, match="states 'axis'"):
        load_robot(urdf, elastic=path, joints=["shoulder"])
    urdf.write_text("<robot name='a'><link name='b'/><link name='c'/><joint name='j' type='revolute'>"
                    "<parent link='b'/><child link='c'/></joint></robot>", encoding="utf-8")  # fmt: skip
    with refused_with(InvalidInput, "'j'", "mass", "0 kg"):
        read_urdf(read_xml(urdf))
    urdf.write_text("<mujoco/>", encoding="utf-8")
    with pytest.raises(InvalidInput, match="<robot>"):
        read_urdf(read_xml(urdf))


BODY = """<robot name="two">
<link name="base"/>
<link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tool"><inertial><mass value="MASS"/><inertia ixx="IXX" iyy="0.001" izz="IZZ" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
<joint name="q" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="hand" type="KIND"><parent link="arm"/><child link="tool"/><origin xyz="0.4 0 0"/><axis xyz="AXIS"/></joint>
</robot>"""


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"MASS": "-0.4"}, r"'tool'.*negative.*mass:"),
        ({"IXX": "-0.002"}, r"'tool'.*negative.*inertia:"),
        ({"IZZ": "0.01"}, "'tool'.*triangle"),
        ({"KIND": "revolute", "AXIS": "0 0 0"}, r"axis.*'hand'[\s\S]*\(0\.0, 0\.0, 0\.0\)"),
    ],
)
def test_impossible_bodies_behind_a_fixed_joint_are_refused(tmp_path, changes, what):
    usual = {"MASS": "0.1", "IXX": "0.001", "IZZ": "0.001", "KIND": "fixed", "AXIS": "0 0 1"}
    text = BODY
    for key, value in {**usual, **changes}.items():
        text = text.replace(key, value)
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=what):
        read_urdf(read_xml(tmp_path / "arm.urdf"), joints=["q"])


def test_a_massless_body_keeps_its_inertia(tmp_path):
    text = BODY.replace("AXIS", "0 0 1").replace("KIND", "fixed").replace("MASS", "0")
    inertias = []
    for size in ("0.001", "0.0012"):
        path = tmp_path / f"{size}.urdf"
        path.write_text(text.replace("IXX", size).replace("IZZ", size), encoding="utf-8")
        inertias.append(read_urdf(read_xml(path), joints=["q"]).links[0].inertia)
    assert inertias[1][0] - inertias[0][0] == pytest.approx(0.0002)


def test_elements_stand_once_and_numbers_of_other_programs_are_told(tmp_path):
    for tag in ("dynamics", "limit", "axis", "mimic"):
        twice = ARM.replace('<child link="upper"/>', f'<child link="upper"/><{tag}/><{tag} a="1"/>')
        refused(tmp_path / "arm.urdf", twice, f"<{tag}>.* 'shoulder'")
    text = ARM.replace('<child link="upper"/>', '<child link="upper"/><dynamics damping="1" K="7000"/>')
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    with pytest.warns(RobotFileWarning, match="K of <dynamics> in 'shoulder'"):
        arm = read_urdf(read_xml(tmp_path / "arm.urdf"), joints=["shoulder"])
    assert arm.motors["shoulder"] == {"friction": 1.0}
    own = '<dynamics K="7" D="1"/><axis'  # joints that are alike are told together, however many there are
    (tmp_path / "arm.urdf").write_text(ARM.replace("<axis", own), encoding="utf-8")
    with pytest.warns(RobotFileWarning, match="K, D of <dynamics> in 'shoulder', 'elbow'[^…]*<axis xyz>"):
        read_urdf(read_xml(tmp_path / "arm.urdf"), joints=["shoulder", "elbow"])


# Hostile files ------------------------------------------------------------------------------------
LINK = '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'


def refused(path, text, match):
    """The message of a refusal, a few lines long."""
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=match) as caught:
        read_urdf(read_xml(path))
    assert len(str(caught.value)) < 2000


def chain(count, kind="fixed"):
    """A URDF of so many joints behind each other."""
    joints = "".join(
        f'<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(count)
    )
    return f"<robot>{''.join(LINK.format(f'l{k}') for k in range(count + 1))}{joints}</robot>"


@pytest.mark.parametrize("element", ["link", "joint"])
def test_a_name_that_stands_twice_is_refused(tmp_path, element):
    text = ARM.replace('<link name="bracket">', '<link name="upper">')
    text = text if element == "link" else ARM.replace('joint name="weld"', 'joint name="stand"')
    refused(tmp_path / "arm.urdf", text, f"{element} '(upper|stand)'.* 2 times")


@pytest.mark.parametrize("axis", ["0 1e200 1e200", "0 0 1e-300", "0 1e400 0"])
def test_an_axis_that_would_become_zero_is_refused(tmp_path, axis):
    refused(tmp_path / "arm.urdf", ARM.replace('xyz="0.6 0 0.8"', f'xyz="{axis}"'), "axis")


@pytest.mark.parametrize("name", ["", "a b", "a&#10;b", "a&#x202e;b", "a" * 101])
def test_a_joint_whose_name_cannot_be_printed_is_refused(tmp_path, name):
    refused(tmp_path / "arm.urdf", ARM.replace('"elbow"', f'"{name}"'), r"joint[\s\S]*printable")


def test_a_joint_without_a_name_is_refused(tmp_path):
    refused(tmp_path / "arm.urdf", ARM.replace('<joint name="elbow" ', "<joint "), r"joint[\s\S]*printable")


def test_too_many_links_and_joints_are_refused_in_a_second(tmp_path):
    refused(tmp_path / "arm.urdf", chain(2000), r"links[\s\S]* 2001")
    refused(tmp_path / "arm.urdf", chain(150, "continuous"), r"joints[\s\S]* 1 to 100, got 150")
    refused(
        tmp_path / "arm.urdf", "<robot>" + '<joint name="a"/>' * 90_000 + "</robot>", r"joints[\s\S]* 90000"
    )


def test_a_long_chain_of_fixed_links_is_one_link(tmp_path):
    text = chain(900).replace('name="j0" type="fixed"', 'name="j0" type="continuous"')
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    arm = read_urdf(read_xml(tmp_path / "arm.urdf"))
    assert [joint.name for joint in arm.joints] == ["j0"]
    assert arm.links[0].mass == 900.0


@pytest.mark.parametrize("mass", ["1e300", "nan", "inf", "9" * 5000, "1e31", "9" * 100_000 + "x"])
def test_masses_out_of_proportion_are_refused(tmp_path, mass):
    refused(
        tmp_path / "arm.urdf",
        ARM.replace('<mass value="2.5"/>', f'<mass value="{mass}"/>'),
        "value.*<mass>",
    )


@pytest.mark.parametrize("value", [np.ma.masked, "far", 1e300, np.nan, 10**400])
def test_a_joint_is_locked_at_a_number(urdf, value):
    with refused_with(InvalidInput, "'elbow'", "locked", "finite"):
        read_urdf(read_xml(urdf), locked={"elbow": value, "follow": 0.0})


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('<mass value="2.5"/>', '<mass value="99"/><mass value="2.5"/>', "<mass>.* 2 .*<inertial>"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="1 0 0"/><axis xyz="0 1 0"/>', "<axis> .* 2 times"),
        ('<parent link="base"/>', '<parent link="fore"/><parent link="base"/>', "<parent> .* 2 times"),
        ('<child link="upper"/>', '<child link="fore"/><child link="upper"/>', "<child> .* 2 times"),
        ('<limit lower="-2"', '<limit lower="-1" upper="1"/><limit lower="-2"', "<limit> .* 2 times"),
        ('<link name="fore">', '<link name="fore"><inertial/>', "<inertial>.*'fore'.*mass"),
        ("<inertia ixx", '<inertia ixx="1" iyy="1" izz="1"/><inertia ixx', "<inertia> .* 2 times"),
        ('<mass value="0.4"/>', '<mass kg="0.4"/>', "<mass>.*'bracket'.*'value'"),
        ('<mass value="0.4"/>', "", "<inertial>.*'bracket'.*mass"),
        ('<mass value="0.4"/>', '<mass value="0.4" unit="g"/>', "attribute 'unit'"),
        ('izz="0.004"', 'izZ="0.004"', "<inertia>.*'fore'.*'izz'"),
        ('<axis xyz="0 1 0"/>', '<axis XYZ="0 1 0"/>', "<axis>.*'shoulder'.*'xyz'"),
        ('<axis xyz="0 1 0"/>', '<Axis xyz="0 1 0"/>', "element <Axis>"),
        ('<parent link="base"/>', "<parent/>", "<parent>.*'shoulder'.*'link'"),
        ('lower="-2" upper="1.5"', 'lower="1.5" upper="-2"', r"limits.*'shoulder'[\s\S]* 1\.5 "),
        ('value="2.5"', 'value="2_5"', "value.*<mass>"),
        ('value="2.5"', 'value="\u0662"', "value.*<mass>"),
        ('value="2.5"', 'value="inf"', "value.*<mass>"),
    ],
)  # fmt: skip
def test_what_could_be_read_in_two_ways_is_refused(tmp_path, old, new, words):
    assert old in ARM
    refused(tmp_path / "arm.urdf", ARM.replace(old, new, 1), words)


@pytest.mark.parametrize(
    "options",
    [
        {"joints": 5}, {"joints": [1]}, {"joints": [None]}, {"joints": [["shoulder"]]}, {"joints": "shoulder"},
        {"joints": ["shoulder", "shoulder"]}, {"locked": ["elbow"]}, {"locked": {1: 0.0}}, {"locked": "elbow"},
        {"locked": {"elbow": np.array([0.0, 1.0])}}, {"locked": {"elbow": "0"}},
    ],
    ids=repr,
)  # fmt: skip
def test_joints_that_are_not_named_are_refused(urdf, elastic, options):
    with pytest.raises(InvalidInput) as caught:
        load_robot(urdf, elastic("shoulder", "elbow", "lift"), **options)
    assert all((caught.value.what, caught.value.found, caught.value.advice))


def test_limits_of_zero_are_none(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM.replace('lower="-2" upper="1.5"', 'lower="0" upper="0"'))
    assert read_urdf(read_xml(tmp_path / "arm.urdf"), locked={"follow": 0.0}).joints[0].limits is None


def test_efforts_and_speeds_come_from_the_urdf_and_the_file_wins(urdf, elastic):
    robot = load_robot(urdf, elastic("shoulder", "elbow", "lift"), locked={"grip": 0.0, "follow": 0.0})
    places = [robot.joint_names.index(name) for name in ("shoulder", "lift")]
    assert [robot.effort_limits[k] for k in places] == [9.0, 9.0]
    assert [robot.speed_limits[k] for k in places] == [1.0, 1.0]
    assert robot.effort_limits[1] == np.inf  # <limit> is not there
    file = elastic("shoulder", "elbow", "lift")
    text = file.read_text().replace('name = "lift"', 'name = "lift"\neffort_limit = 70.0')
    file.write_text(text)
    robot = load_robot(urdf, file, locked={"grip": 0.0, "follow": 0.0})
    assert robot.effort_limits[2] == 70.0
    text = text.replace(
        "motor_inertia = ",
        "resistance = 1.0\ntorque_constant = 1.0\nback_emf_constant = 1.0\nmotor_inertia = ",
    )
    file.write_text(text)
    volts = load_robot(urdf, file, locked={"grip": 0.0, "follow": 0.0})
    assert volts.drive == "voltage"
    assert volts.effort_limits == (np.inf, np.inf, 70.0)
    assert volts.speed_limits[0] == 1.0


@pytest.mark.parametrize("key", ["effort", "velocity"])
def test_limits_of_zero_and_below(tmp_path, elastic, key):
    file, names = tmp_path / "arm.urdf", ("shoulder", "elbow", "lift")
    stated = {"effort": "9", "velocity": "1"}[key]
    for value, words in (("0", ""), ("-4", f"{key}.*'shoulder'.*negative")):
        file.write_text(ARM.replace(f'{key}="{stated}"', f'{key}="{value}"', 1))
        options = {"locked": {"grip": 0.0, "follow": 0.0}}
        if words:
            with pytest.raises(InvalidInput, match=words):
                load_robot(file, elastic(*names), **options)
            continue
        robot = load_robot(file, elastic(*names), **options)
        assert (robot.effort_limits if key == "effort" else robot.speed_limits)[0] == np.inf


def changed(urdf, *changes):
    text = urdf.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    urdf.write_text(text, encoding="utf-8")
    return read_xml(urdf)


def test_what_stands_where_nobody_placed_it(urdf):
    """At the nearer limit where zero is outside; what mimics a locked joint where that one takes it, or nearly."""
    lower, mimic = 'lower="0" upper="0.04" effort="9" velocity="1"/></joint>', '<mimic joint="grip"/>'
    root = changed(
        urdf,
        (lower, lower.replace('"0"', '"0.01"')),
        (mimic, '<mimic joint="grip" multiplier="3" offset="0.01"/>'),
    )
    moving = ["shoulder", "elbow", "lift"]
    assert read_urdf(root, moving).locked == {"grip": 0.01, "follow": 0.04}
    place = {
        name: read_urdf(root, moving, {"grip": 0.01, **more}).links[-1].centre_of_mass
        for name, more in (("mimics", {}), ("placed", {"follow": 0.04}))
    }
    assert place["mimics"] == pytest.approx(place["placed"])
    assert read_urdf(root, moving).links[-1].centre_of_mass[0] != 0.0


def test_a_follower_of_a_joint_that_moves_is_told_to_stand_still_unless_it_is_placed(urdf):
    root, moving = read_xml(urdf), ["shoulder", "grip"]
    with pytest.warns(RobotFileWarning) as told:
        assert read_urdf(root, moving).locked["follow"] == 0.0
    message = str(told[0].message)
    assert unnamed(message, "'follow'", "mimic", "'grip'", "locked = {follow = 0}") == []
    read_urdf(root, moving, {"follow": 0.0})  # warnings are errors in tests
    read_urdf(root, ["shoulder"])  # the leader is left out too


@pytest.mark.parametrize("stated", ['damping="-1" friction="3"', 'damping="7" friction="-3"'])
def test_friction_of_dynamics_is_not_negative(urdf, elastic, stated):
    changed(urdf, ('<axis xyz="0 1 0"/>', f'<axis xyz="0 1 0"/><dynamics {stated}/>'))
    with refused_with(InvalidInput, "shoulder", "<dynamics>", ">= 0"):
        load_robot(urdf, elastic("shoulder", "elbow"))


def test_friction_of_dynamics_is_taken_where_the_elastic_file_states_none(urdf, tmp_path):
    changed(urdf, ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><dynamics damping="7" friction="3"/>'))
    joints = tmp_path / "joints.toml"
    options = 'joints = ["shoulder", "elbow"]\n'
    joints.write_text(options + JOINT.format("shoulder") + JOINT.format("elbow"), encoding="utf-8")
    with pytest.warns(RobotFileWarning) as told:
        robot = load_robot(urdf, joints)
    assert unnamed(str(told[0].message), "friction 7", "coulomb_friction 3", "shoulder") == []
    assert robot.nominal["friction_shoulder"] == 7.0
    assert robot.nominal["coulomb_friction_shoulder"] == 3.0
    own = JOINT.format("shoulder") + "friction = 1.0\ncoulomb_friction = 0.5\n"  # which the advice names
    joints.write_text(options + own + JOINT.format("elbow"), encoding="utf-8")
    robot = load_robot(urdf, joints)
    assert (robot.nominal["friction_shoulder"], robot.nominal["coulomb_friction_shoulder"]) == (1.0, 0.5)


@pytest.mark.parametrize(("upper", "taken"), [("0.0606", True), ("0.07", False)])
def test_an_inertia_that_nearly_is_one_is_the_nearest(urdf, upper, taken):
    old = 'ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.0015"'
    root = changed(urdf, (old, f'ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="{upper}"'))
    if not taken:
        with refused_with(InvalidInput, "bracket", "0.07"):
            read_urdf(root, ["shoulder", "elbow"])
        return
    with pytest.warns(RobotFileWarning, match="bracket"):
        read_urdf(root, ["shoulder", "elbow"])


def test_placeholders_are_no_limits(urdf):
    old = 'lower="-2" upper="1.5" effort="9" velocity="1"'
    arm = read_urdf(
        changed(urdf, (old, 'lower="-1e16" upper="1e16" effort="-1" velocity="1e16"')), ["shoulder", "elbow"]
    )
    assert arm.joints[0].limits is None
    assert arm.efforts[0] == arm.speeds[0] == np.inf


def test_what_vendors_leave_in_their_files_and_what_changes_nothing_is_read(urdf):
    """Calls of macros, the axis of a fixed joint, a whole inertia, and Drake's world, which no file states."""
    plain = read_urdf(read_xml(urdf), ["shoulder", "elbow"])
    six = 'ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.04" iyz="0.003" izz="0.02"'
    whole = f'{six} iyx="0.002" izx="-0.001" izy="0.003"'
    root = changed(
        urdf,
        (six, whole),
        ('<origin xyz="0 0 0.2" rpy="0.1 0 0"/>', '<origin xyz="0 0 0.2" rpy="0.1 0 0"/><axis xzy="0 0 1"/>'),
        ('<link name="world"/>', ""),
        ("</robot>", '<x:grey xmlns:x="http://www.ros.org/wiki/xacro"/></robot>'),
    )
    with pytest.warns(RobotFileWarning, match="grey"):
        read = read_urdf(root, ["shoulder", "elbow"])
    assert read.links == plain.links
    assert read.joints == plain.joints
    with refused_with(InvalidInput, "upper", "iyx", 0.002, 0.001):
        root = changed(urdf, ('iyx="0.002"', 'iyx="0.001"'), ("<x:grey", "<grey"))
        read_urdf(root, ["shoulder", "elbow"])


def test_what_says_the_same_twice_or_in_other_words_is_read(urdf):
    plain = read_urdf(read_xml(urdf), ["shoulder", "elbow"])
    place = '<origin xyz="0 0 0.2" rpy="0.1 0 0"/>'
    commas = place.replace("0 0 0.2", "0, 0, 0.2")
    root = changed(
        urdf,
        (place, commas + commas),
        ("</robot>", '<x:property name="width" value=".2" xmlns:x="http://www.ros.org/wiki/xacro"/></robot>'),
    )
    assert read_urdf(root, ["shoulder", "elbow"]).joints == plain.joints


@pytest.mark.parametrize(("place", "first"), TWICE)
def test_of_bodies_and_places_that_stand_twice_the_first_is_read(place, first, urdf):
    """The advice, followed either way, leaves one arm or the other."""
    moving = ["shoulder", "elbow"]
    plain = read_urdf(read_xml(urdf), moving)
    root = changed(urdf, (place, place + first))
    with pytest.warns(RobotFileWarning) as told:
        read = read_urdf(root, moving)
    tag = first[1:].split()[0].split(">")[0]
    assert unnamed(str(told[0].message), f"<{tag}>", "2 times", "without") == []
    assert (read.links, read.joints) != (plain.links, plain.joints)
    for left, same in ((1, read), (0, plain)):  # the file without the other one; without the first
        alone = copy.deepcopy(root)
        parent = next(part for part in alone.iter() if len(part.findall(tag)) > 1)
        parent.remove(parent.findall(tag)[left])
        arm = read_urdf(alone, moving)
        assert (arm.links, arm.joints) == (same.links, same.joints)


def test_a_file_that_xacro_has_to_expand_is_refused(urdf):
    with refused_with(InvalidInput, "xacro arm.xacro > arm.urdf", "optenv"):
        read_urdf(changed(urdf, ('xyz="0 0 0.2"', 'xyz="$(optenv PLACE 0 0 0.2)"')))
    for inside in ('<x:include filename="a.xacro"/>', '<x:arm length="${2*a}"/>'):
        space = f'xmlns:x="http://www.ros.org/wiki/xacro">{inside}</g>'
        with refused_with(InvalidInput, "xacro arm.xacro > arm.urdf"):
            read_urdf(changed(urdf, ("</robot>", f"<g {space}</robot>")))
        changed(urdf, (f"<g {space}", ""))
