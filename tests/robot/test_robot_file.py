"""Robot files: what they say, and what is said when they are wrong."""

from __future__ import annotations

import re

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.errors import InvalidInput
from flexhinf.robot import RobotFileWarning, catalogue, load_robot, paper_arm

#: Calls of functions within which any file is refused.
CALLS = 5_000_000

GOOD = """
name = "two"
gravity = 9.8
home = [0.1, 0.2]

[penalty]
weights = { link_position = [1.0, 2.0], link_position_integral = 3.0 }
effort = 0.5

[[joint]]
name = "slide"
kind = "prismatic"
axis = [1, 0, 0]
limits = [-0.5, 0.5]
speed_limit = 0.4
effort_limit = 120
[joint.link]
mass = 2.0
centre_of_mass = [0.1, 0.0, 0.0]
inertia = { xx = 0.01, yy = 0.02, zz = 0.02 }
[joint.spring]
stiffness = { value = 1000.0, tolerance = 12, source = "data sheet" }
[joint.motor]
motor_inertia = 1.5

[[joint]]
name = "turn"
xyz = [0.2, 0.0, 0.0]
rpy = [0.0, 1.5707963267948966, 0.0]
[joint.link]
mass = { value = 1.0, tolerance = 5 }
centre_of_mass = { value = [0.0, 0.1, 0.2], tolerance = 3, source = "CAD" }
inertia = { xx = 0.02, yy = 0.02, zz = 0.01, xy = 0.001, tolerance = 4, source = "CAD" }
[joint.spring]
stiffness = 100.0
damping = 0.2
[joint.motor]
rotor_inertia = 1e-5
gear_ratio = 100
hub_inertia = 0.01
friction = 0.3
"""


def test_the_catalogue_holds_these_robots_and_loads_them_by_name():
    assert set(catalogue()) == {
        "paper", "quanser-rotflex", "vertical-rig", "planar-two-link", "spatial-three-link", "scara", "seven-link",
    }  # fmt: skip
    assert load_robot("vertical-rig").name == "vertical-rig"
    with pytest.raises(InvalidInput, match="quanser-rotflex"):
        load_robot("quanser-rotflx")


def test_the_papers_file_is_the_papers_arm():
    one, other = load_robot("paper"), paper_arm()
    assert {p.name: p for p in one.parameters} == {p.name: p for p in other.parameters}
    assert (one.penalty, one.links, one.drive) == (other.penalty, other.links, other.drive)
    assert one.plant(inductance=True).states == other.plant(inductance=True).states


def test_the_table_of_rotor_inertias():
    """Ott 2008, Table A.2."""
    robot = load_robot("seven-link")
    values = [1.836, 4.447, 3.242, 1.817, 1.392, 1.402, 1.392]
    assert robot.plant_parameters()["motor_inertia"].tolist() == values
    assert all("Ott 2008" in robot[f"motor_inertia_a{i}"].source for i in range(1, 8))


def test_the_gear_of_the_rotflex():
    p, v = load_robot("quanser-rotflex").plant_parameters(), load_robot("quanser-rotflex").nominal
    assert p["torque_constant"] == pytest.approx(0.9 * 0.69 * 70 * 0.00767)
    assert p["back_emf_constant"] == pytest.approx(70 * 0.00767)
    assert p["motor_inertia"] == v["motor_inertia"] == 2.58e-3


def test_everything_a_file_says_arrives(write):
    robot = load_robot(write(GOOD))
    assert robot.joint_names == ("slide", "turn")
    assert (robot.home, robot.drive) == ((0.1, 0.2), "torque")
    stiffness = robot["stiffness_slide"]
    assert (stiffness.tolerance, stiffness.unit, stiffness.source) == (12.0, "N/m", "data sheet")
    assert robot["mass_turn"].tolerance == 5.0
    p = robot.plant_parameters()
    assert p["motor_inertia"].tolist() == [1.5, pytest.approx(0.11)]
    assert p["friction"].tolist() == [0.0, 0.3]
    assert p["damping"].tolist() == [0.0, 0.2]
    assert p["inertia"][1].tolist() == [0.02, 0.001, 0.0, 0.02, 0.0, 0.01]
    assert robot.plant().unit("link_position_slide") == "m"
    assert robot.plant().unit("drive_torque_slide") == "N"
    assert robot.problem().penalty.weights(robot.problem().state_names)[:2].tolist() == [1.0, 2.0]
    assert robot.links.limits == ((-0.5, 0.5), None)
    assert (robot.speed_limits, robot.effort_limits) == ((0.4, np.inf), (120.0, np.inf))


def replaced(old, new):
    assert GOOD.count(old) >= 1
    return GOOD.replace(old, new, 1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (replaced("stiffness = 100.0\n", ""), ["joint 2 ('turn'), spring", "stiffness", "N·m/rad"]),
        (
            replaced("[joint.spring]\nstiffness = 100.0\ndamping = 0.2\n", ""),
            ["'turn'", "'spring'", "stiffness"],
        ),
        (replaced("stiffness = 100.0", "stifness = 100.0"), ["'stifness'", "'stiffness'"]),
        (replaced("hub_inertia", "hub_inerta"), ["'hub_inerta'", "try:   'hub_inertia'"]),
        (
            replaced("stiffness = 100.0", "stiffness = -100.0"),
            [".toml: ", "stiffness_turn", "'turn'", "positive", "-100"],
        ),
        (replaced("motor_inertia = 1.5", "motor_inertia = 0.0"), ["motor_inertia_slide", "> 0 kg"]),
        (replaced("motor_inertia = 1.5", "friction = 1.0"), ["'slide'", "motor_inertia", "neither"]),
        (
            replaced("motor_inertia = 1.5", "motor_inertia = 1.5\ndrive = ['torque']"),
            ["'drive'", "'voltage'"],
        ),
        (replaced("gear_ratio = 100\n", ""), ["'turn'", "gear_ratio"]),
        (
            replaced("stiffness = 100.0", "stiffness = { value = 100.0, range = [-5.0, 120.0] }"),
            ["stiffness_turn", "positive", " -5 N·m/rad ", "range"],
        ),
        (
            replaced("stiffness = 100.0", "stiffness = { value = 100.0, range = [0.0, 120.0] }"),
            ["got 0 N·m/rad"],
        ),
        (
            replaced("stiffness = 100.0", "stiffness = { value = 100.0, range = [1e-31, 1e3] }"),
            ["'stiffness_turn'", "proportion", "1e-31"],
        ),
        (
            replaced("mass = 2.0", "mass = { value = 2.0, range = [-1.0, 3.0] }"),
            ["mass_slide", "negative", " -1 kg"],
        ),
        (replaced("effort_limit = 120", "effort_limit = 1e-40"), ["effort", "1e-40"]),
        (replaced("stiffness = 100.0", 'stiffness = "soft"'), ["stiffness", "N·m/rad", "'soft'"]),
        (replaced("tolerance = 5", "tolerance = 100"), ["tolerance", " 100"]),
        (replaced("xx = 0.01, yy", "xx = -0.01, yy"), ["'slide'", "inertia", "positive"]),
        (replaced("xx = 0.01, yy", "xx = 0.0, yy"), ["'slide'", "inertia", "positive"]),
        (replaced("xx = 0.01, yy", "xx = 0.05, yy"), ["'slide'", "triangle", "[0.02, 0.02, 0.05]"]),
        (replaced("mass = 2.0", "mass = 0.0"), ["'slide'", "mass", "> 0"]),
        (replaced("mass = 2.0\n", ""), ["'slide'", "mass"]),
        (replaced("home = [0.1, 0.2]", "home = [0.6, 0.2]"), ["limits", "'slide'", "0.6"]),
        (replaced('name = "turn"', 'name = "slide"'), ["'slide'", "distinct"]),
        (replaced('kind = "prismatic"', 'kind = "fixed"'), ["kind", "'revolute'", "'fixed'"]),
        (
            replaced("friction = 0.3", "friction = 0.3\nresistance = 1.0"),
            ["'turn'", "got ['resistance']"],
        ),
        (replaced("[joint.link]", "[joint.lnk]"), ["'lnk'", "'link'"]),
        ("name = [", ["TOML"]),
        ('name = "empty"', ["'joint'", "[[joint]]"]),
    ],
)
def test_a_mistake_is_told_with_its_place_and_what_is_allowed(write, text, words):
    with pytest.raises(InvalidInput) as caught:
        load_robot(write(text))
    error = caught.value
    assert all((error.what, error.found, error.advice))
    assert [word for word in words if word not in str(error)] == []


def test_motors_of_two_kinds_are_refused(write):
    motor = "friction = 0.3\nresistance = 1.0\ntorque_constant = 1.0\nback_emf_constant = 1.0"
    with pytest.raises(InvalidInput, match="'slide': 'torque', 'turn': 'voltage'"):
        load_robot(write(replaced("friction = 0.3", motor)))
    with pytest.raises(InvalidInput, match="'slide': 'torque', 'turn': 'current'"):
        load_robot(write(replaced("friction = 0.3", "friction = 0.3\ntorque_constant = 1.0")))


def test_a_tolerance_that_looks_like_a_fraction_is_warned_of(write):
    with pytest.warns(RobotFileWarning, match="tolerance = 5 for ±5 %"):
        robot = load_robot(write(replaced("tolerance = 5", "tolerance = 0.05")))
    assert robot["mass_turn"].tolerance == 0.05


def test_other_files(write, tmp_path):
    with refused_with(InvalidInput, "nothing.toml'", "catalogue"):
        load_robot(tmp_path / "nothing.toml")
    with refused_with(InvalidInput, "elastic=", "URDF", "'arm.toml'"):
        load_robot(write(GOOD), elastic=write(GOOD, "joints.toml"))
    with refused_with(InvalidInput, "joints", "locked", "URDF"):
        load_robot(write(GOOD), joints=["turn"])


def test_a_single_link_by_its_inertia_about_the_axis(write):
    text = '[[joint]]\nname = "a"\n[joint.link]\naxis_inertia = 0.5\n[joint.spring]\nstiffness = 10.0\n'
    robot = load_robot(write(text + "[joint.motor]\nmotor_inertia = 0.1\n"))
    assert robot.name == "arm"
    plant = robot.plant()
    assert plant.states == ("link_position", "link_velocity", "motor_position", "motor_velocity")
    np.testing.assert_allclose(plant.derivative([0.1, 0, 0, 0], [0.2]), [0, -2.0, 0, (0.2 + 1.0) / 0.1])
    with refused_with(InvalidInput, "axis_inertia", "3 joints"):
        load_robot(write(GOOD + text + "[joint.motor]\nmotor_inertia = 0.1\n"))


# Hostile files ------------------------------------------------------------------------------------
@pytest.mark.quick_cases(4)
@pytest.mark.parametrize(
    ("replaced", "by", "match"),
    [
        ('"turn"', r'"tu\nrn"', r"joint[\s\S]*printable.*'tu\\nrn'"),
        ('"turn"', r'"tu\u001b[31mrn"', r"joint[\s\S]*printable.*'tu\\x1b\[31mrn'"),
        ('"turn"', r'"tu\u202ern"', r"joint[\s\S]*printable.*'tu\\u202ern'"),
        ('"turn"', '"' + "t" * 101 + '"', r"joint[\s\S]*printable.*\(101 characters\)"),
        ('"turn"', '"integral"', r"'integral'[\s\S]*'world'"),
        ('name = "two"', r'name = "two\u0007"', r"robot[\s\S]*printable.*'two\\x07'"),
        ('name = "two"', r'description = "two\u0007"', r"description.*printed[\s\S]*'two\\x07'"),
        ('source = "CAD"', r'source = "C\u0000AD"', r"source.*'inertia'.*printed[\s\S]*'C\\x00AD'"),
        ("mass = 2.0", "mass = 1e31", r"'mass'.*proportion[\s\S]* 1e\+31"),
        (
            "stiffness = { value = 1000.0",
            "stiffness = { value = 1e-31",
            r"'stiffness_slide'.*proportion[\s\S]* 1e-31",
        ),
        ("axis = [1, 0, 0]", "axis = [0, 1e200, 1e200]", "axis"),
        (
            "home = [0.1, 0.2]",
            "home = [" + "0.1," * 200_000 + "]",
            r"pose[\s\S]* 2 finite.*\['slide', 'turn'\]",
        ),
        (
            "effort = 0.5",
            "effort = 0.5\n[[joint]]" * 1 + "\n[[joint]]" * 70_000,
            r"joints[\s\S]* 100, got 70003",
        ),
    ],
)
def test_what_no_robot_has_is_refused_with_little_work(tmp_path, replaced, by, match, bounded_work):
    assert replaced in GOOD
    path = tmp_path / "arm.toml"
    path.write_text(GOOD.replace(replaced, by), encoding="utf-8")
    with pytest.raises(InvalidInput, match=match) as caught, bounded_work(CALLS):
        load_robot(path)
    assert len(str(caught.value)) < 2000


def test_two_numbers_of_one_name_are_refused(tmp_path):
    path = tmp_path / "arm.toml"
    text = GOOD.replace('"slide"', '"a"').replace('"turn"', '"smoothing_a"')
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match="friction_smoothing_a"):
        load_robot(path)


def test_a_name_that_no_file_can_have_is_refused():
    for name in ("a" * 5000, "a\0b.toml"):
        with pytest.raises(InvalidInput, match="catalogue"):
            load_robot(name)


def test_a_misspelled_file_is_told_the_one_beside_it(tmp_path):
    (tmp_path / "belt.toml").write_text("", encoding="utf-8")
    with refused_with(InvalidInput, "belt.tml", "belt.toml"):
        load_robot(tmp_path / "belt.tml")


@pytest.mark.parametrize("stated", ["mass", "length"])
def test_half_a_weight_is_refused_and_its_advice_works(stated, tmp_path):
    """A forgotten line makes another robot: one without weight."""
    link = f"axis_inertia = 0.006\n{stated} = 0.1\n"
    motor = "[joint.spring]\nstiffness = 20.0\n[joint.motor]\nmotor_inertia = 0.01\n"
    text = f'[[joint]]\nname = "a"\n[joint.link]\n{{}}{motor}'
    path = tmp_path / "one.toml"
    path.write_text(text.format(link), encoding="utf-8")
    with pytest.raises(InvalidInput) as raised:
        load_robot(path)
    path.write_text(text.format(link + raised.value.advice.removeprefix("add ") + "\n"), encoding="utf-8")
    assert load_robot(path).nominal[stated] == 0.1


@pytest.mark.parametrize(
    ("stated", "named", "taken"),
    [
        ("", ("'shoulder'", "'elbow'", "0.5 to 1.5 rad", 0.0), [1.0, 1.0]),
        ('home = ["100deg", 0.7]\n', ("'shoulder'", "0.5 to 1.5 rad", 1.74533), [1.0, 0.7]),
        ("home = [0.6, 60]\n", ("'elbow'", "60 rad", "degrees"), [0.6, 1.047]),
    ],
)
def test_a_home_outside_the_limits_names_the_joints_and_the_line_to_write(tmp_path, stated, named, taken):
    robot = load_robot("planar-two-link")
    path = tmp_path / "arm.toml"
    robot.save(path)
    text = re.sub(r"(?m)^home = .*\n", "", path.read_text(encoding="utf-8"))
    text = re.sub(r"(?m)^(kind = .*)$", r"\1", text)
    text = re.sub(r"(?m)^limits = .*$", "limits = [0.5, 1.5]", text)
    path.write_text(stated + text, encoding="utf-8")
    with pytest.raises(InvalidInput) as raised:
        load_robot(path)
    assert unnamed(str(raised.value), *named) == []
    home = raised.value.advice.partition(" at the top")[0]
    path.write_text(f"{home}\n{text}", encoding="utf-8")
    assert list(load_robot(path).home) == taken
