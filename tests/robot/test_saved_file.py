"""Robot files with other numbers: what is written is this robot's, whatever file it is written like."""

from __future__ import annotations

import pickle
import tomllib

import pytest
from tests.refusals import refused_with
from tests.robot.test_urdf import ARM, JOINT

import flexhinf as fh

TEXT = """# An arm.
name = "arm"
down = [1.0, 0.0, 0.0]

[[joint]]
name = "elbow"
[joint.link]
mass = 1.0                                 # kg
centre_of_mass = [0.2, 0.0, 0.0]
inertia = { xx = 0.01, yy = 0.02, zz = 0.02 }
[joint.spring]
stiffness = "0.1 kNm/rad"                  # data sheet
[joint.motor]
motor_inertia = { value = 0.1, tolerance = 5 }
friction = { value = 0.1, range = [0.05, 0.2] }
"""


@pytest.fixture
def arm(write):
    return fh.load_robot(write(TEXT))


def joint_of(path):
    (joint,) = tomllib.loads(path.read_text(encoding="utf-8"))["joint"]
    return joint


@pytest.mark.parametrize(
    ("table", "key", "line", "other"),
    [
        ("spring", "stiffness", 'stiffness = "0.1 kNm/rad"', "stiffness = 70.0"),
        ("spring", "stiffness", 'stiffness = "0.1 kNm/rad"', "stiffness = { value = 100.0, tolerance = 9 }"),
        ("motor", "motor_inertia", "{ value = 0.1, tolerance = 5 }", "{ value = 0.1, tolerance = 30 }"),
        ("motor", "friction", "range = [0.05, 0.2]", "range = [0.0, 0.3]"),
        ("link", "mass", "mass = 1.0 ", "mass = 1.5 "),
    ],
)
def test_numbers_in_which_the_other_file_differs_are_written(arm, write, tmp_path, table, key, line, other):
    like = write(TEXT.replace(line, other), "other.toml")
    assert like.read_text(encoding="utf-8") != TEXT
    arm.save(tmp_path / "saved.toml", like=like)
    stated, parameter = joint_of(tmp_path / "saved.toml")[table][key], arm[key]
    assert stated["value"] == parameter.value
    assert stated.get("tolerance", 0.0) == parameter.tolerance
    assert tuple(stated.get("range", parameter.range or ())) == (parameter.range or ())
    saved, old = (tmp_path / "saved.toml").read_text(encoding="utf-8"), like.read_text(encoding="utf-8")
    assert sum(a != b for a, b in zip(saved.splitlines(), old.splitlines(), strict=True)) == 1
    assert ("# data sheet" in saved) == ("# data sheet" in old)


def test_a_number_that_was_changed_to_what_the_other_file_states_stays_as_it_is_there(arm, write, tmp_path):
    like = write(TEXT.replace('"0.1 kNm/rad"', '"70 Nm/rad"'), "other.toml")
    arm.with_values({"stiffness": 70.0}).save(tmp_path / "saved.toml", like=like)
    assert (tmp_path / "saved.toml").read_text(encoding="utf-8") == like.read_text(encoding="utf-8")


def test_a_vector_in_which_the_other_file_differs_is_refused(arm, write, tmp_path):
    like = write(TEXT.replace("[0.2, 0.0, 0.0]", "[0.3, 0.0, 0.0]"), "other.toml")
    with refused_with(fh.InvalidInput, "other.toml", "centre_of_mass_x", 0.2):
        arm.save(tmp_path / "saved.toml", like=like)
    assert not (tmp_path / "saved.toml").exists()


def test_a_file_with_numbers_of_another_robot_is_refused(arm, write, tmp_path):
    like = write(TEXT.replace("friction =", "coulomb_friction = 0.2\nfriction ="), "other.toml")
    with refused_with(fh.InvalidInput, "other.toml", "coulomb_friction"):
        arm.save(tmp_path / "saved.toml", like=like)


@pytest.mark.parametrize("between", [None, (85.0, 95.0)])
def test_a_number_takes_no_tolerance_from_a_table_that_states_another(write, tmp_path, between):
    stated = fh.Parameter("stiffness", 90.0, unit="N·m/rad", range=between)
    robot = fh.load_robot(write("tolerances = { stiffness = 12 }\n" + TEXT)).with_parameters(stated)
    robot.save(tmp_path / "saved.toml")
    assert fh.load_robot(tmp_path / "saved.toml")["stiffness"].interval == (between or (90.0, 90.0))


def test_a_robot_of_python_and_one_from_a_pickle_are_written(arm, write, tmp_path):
    fh.paper_arm().with_values({"stiffness": 80.0}).save(tmp_path / "paper.toml", fh.load_robot("paper").file)
    assert fh.load_robot(tmp_path / "paper.toml").nominal == {**fh.paper_arm().nominal, "stiffness": 80.0}
    pickle.loads(pickle.dumps(arm)).with_values({"friction": 0.15}).save(tmp_path / "saved.toml")
    assert joint_of(tmp_path / "saved.toml")["motor"]["friction"]["value"] == 0.15


def test_of_several_joints_that_of_the_robot_is_written(write, tmp_path):
    write(ARM, "arm.urdf")
    joints = write("".join(map(JOINT.format, ("shoulder", "elbow"))), "joints.toml")
    robot = fh.load_robot(tmp_path / "arm.urdf", joints, joints=["elbow"]).with_values({"stiffness": 300.0})
    robot.save(tmp_path / "saved.toml")
    rows = tomllib.loads((tmp_path / "saved.toml").read_text(encoding="utf-8"))["joint"]
    values = {row["name"]: row["spring"]["stiffness"] for row in rows}
    assert (values["shoulder"], values["elbow"]["value"]) == (500.0, 300.0)
    again = fh.load_robot(tmp_path / "arm.urdf", tmp_path / "saved.toml", joints=["elbow"])
    assert again.nominal == robot.nominal
