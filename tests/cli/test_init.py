"""From a vendor's description to a robot file and its check, at the command line."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from tests.refusals import unnamed
from tests.robot.test_mjcf import known_model

from flexhinf import load_robot
from flexhinf.cli import main
from flexhinf.robot.parts import RobotFileWarning

URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="2" effort="40" velocity="3"/></joint></robot>"""


def test_a_vendors_file_becomes_a_robot_that_says_what_is_estimated(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("arm.urdf").write_text(URDF, encoding="utf-8")
    assert main(["check", "arm.urdf"]) == 2  # its inertia is that of no body
    said = capsys.readouterr().out
    assert "upper" in said
    assert "flexhinf init arm.urdf" in said
    assert main(["design", "arm.urdf"]) == 2
    assert unnamed(capsys.readouterr().err, "flexhinf init arm.urdf") == []
    assert main(["init", "arm.urdf"]) == 0  # the advice, followed
    assert "'upper'" in capsys.readouterr().err
    assert main(["check", "arm.toml", "--out", "checked"]) == 1
    assert unnamed(capsys.readouterr().out, "stiffness", "shoulder") == []
    numbers = json.loads(Path("checked/check.json").read_text(encoding="utf-8"))
    assert {row["severity"] for row in numbers["findings"]} == {"doubt", "note"}
    assert numbers["joints"][0]["name"] == "shoulder"
    page = Path("checked/index.html").read_text(encoding="utf-8")
    assert unnamed(page, "shoulder", 'id="figure-robot"', "height (m)") == []


def test_of_what_a_file_states_twice_it_is_told_what_is_read_and_what_is_left(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = '<inertial><mass value="7.5"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    good = URDF.replace('izz="0.03"', 'izz="0.02"')
    text = good.replace("</inertial></link>", f"</inertial>{other}</link>")
    for base in (text, text.replace('<link name="base"/>', f'<link name="base">{other}<inertial/></link>')):
        Path("arm.urdf").write_text(base, encoding="utf-8")
        assert main(["check", "arm.urdf"]) == 1
        said = " ".join(capsys.readouterr().out.split())
        assert unnamed(said, "<inertial> of 'upper'", 'mass value="1"', "left", 'mass value="7.5"') == []
        assert "'base'" not in said  # which nothing moves
        assert main(["init", "arm.urdf", "--force"]) == 0
        assert unnamed(capsys.readouterr().err, "<inertial> of 'upper'", 'mass value="7.5"') == []
        with pytest.warns(RobotFileWarning, match="'upper'"):
            assert load_robot("arm.toml")["mass"].value == 1.0


def test_a_part_of_an_mjcf_is_told_what_it_is_and_the_advice_makes_it_whole(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco")
    part = MJCF.format('<motor joint="shoulder"/><motor joint="elbow"/>').replace("mujoco>", "mujocoinclude>")
    Path("part.xml").write_text(part, encoding="utf-8")
    assert main(["check", "part.xml"]) == 2
    assert main(["init", "part.xml"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert unnamed(said, "part of", "<mujocoinclude>", "<mujoco>") == []
    advice = said.split("try: ")[-1]
    file, command = advice.split("one that says ")[1].split("; of either, ")
    Path("this.xml").write_text(file, encoding="utf-8")
    code = f"import mujoco, pathlib; {command.split(' writes it')[0]}"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    assert main(["init", "whole.xml"]) == 0
    assert load_robot("whole.toml").joint_names == ("shoulder", "elbow")


def test_of_several_arms_one_is_named_as_a_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    second = URDF.split("</robot>")[0].split('<link name="base"/>')[1].replace("upper", "other")
    two = URDF.replace("</robot>", second.replace("shoulder", "second") + "</robot>").replace("0.03", "0.02")
    Path("two arms.urdf").write_text(two.replace("shoulder", "left;shoulder"), encoding="utf-8")
    assert main(["check", "two arms.urdf"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert unnamed(said, "2 branches", "'second'") == []
    command = shlex.split(said.split("for one alone: flexhinf ")[1].split("'. ")[0] + "'")
    assert main(command) == 0  # the advice, followed in a shell, to which its names are no commands
    assert load_robot("two arms.toml").joint_names == ("left;shoulder",)
    assert "branches" not in capsys.readouterr().err
    assert main(["init", "two arms.urdf", "--force", "--out", "left.toml"]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "branches" in said
    command = said.split("for one alone: flexhinf ")[1].split(" note:")[0].removesuffix(".")
    assert main(shlex.split(command)) == 0  # again, though a file is there
    assert load_robot("left.toml").joint_names == ("left;shoulder",)


def test_a_robot_that_is_right_ends_with_0(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "planar-two-link"]) == 0
    assert "doubt" not in capsys.readouterr().out
    assert main(["check", "planar-two-link", "--period", "50ms"]) == 1
    assert "--period" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["init"], ["--joints 3"]),
        (["init", "arm.urdf", "--joints", "3"], ["--joints 3"]),
        (["init", "arm.urdf", "--drive", "current"], ["torque_constant"]),
        (["init", "--joints", "2", "--move", "a"], ["--move a"]),
        (["init", "--joints", "2", "--out", "arm.urdf"], ["--out arm.toml"]),
        (["init", "--joints", "2", "--out", "there.toml"], ["--force"]),
        (["init", "nowhere.urdf"], ["nowhere.urdf"]),
        (["check", "arm.urdf", "--unwrap", "motor_position"], ["--unwrap", "a log"]),
        (["check", "nowhere.toml"], ["nowhere.toml"]),
        (["check", "design.toml"], ["design.toml", "robot"]),
    ],
)
def test_what_does_not_fit_is_refused(
    words: list[str], said: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("arm.urdf").write_text(URDF, encoding="utf-8")
    Path("there.toml").write_text("mine", encoding="utf-8")
    Path("design.toml").write_text('[design]\nrobot = "paper"\n', encoding="utf-8")
    assert main(words) == 2
    assert unnamed(capsys.readouterr().err, "found:", "try:", *said) == []
    assert Path("there.toml").read_text(encoding="utf-8") == "mine"


def test_a_template_replaces_a_file_where_it_is_asked_to(folder: Path) -> None:
    Path("there.toml").write_text("mine", encoding="utf-8")
    assert main(["init", "--joints", "2", "--drive", "current", "--out", "there.toml", "--force"]) == 0
    assert load_robot("there.toml").drive == "current"


JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 {height}"/><axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="{effort}" velocity="3"/></joint>
<link name="{child}"><inertial><origin xyz="0 0 0.1"/><mass value="{mass}"/>
<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""


def urdf_of(first: str, second: str, mass: float, more: str = "") -> str:
    """Two joints, of which the second carries so much, kg."""
    joints = [
        JOINT.format(name=first, parent="base", child="a", height=0, effort=87, mass=4, moment=0.05),
        JOINT.format(
            name=second, parent="a", child="b", height=0.3, effort=87, mass=mass, moment=0.01 * mass
        ),
    ]
    return f'<robot name="two"><link name="base"/>{"".join(joints)}{more}</robot>'


def test_a_file_that_is_written_takes_what_is_published_and_leaves_out_springs_that_no_sample_shows(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("arm.urdf").write_text(urdf_of("fr3_joint1", "fr3_joint2", 0.002), encoding="utf-8")
    assert main(["init", "arm.urdf"]) == 0
    assert unnamed(capsys.readouterr().err, "fr3_joint2", "rigid", "1 ms") == []
    robot = load_robot("arm.toml")
    assert robot.rigid == ("fr3_joint2",)
    assert robot["motor_inertia_fr3_joint1"].value == 0.6057
    assert set(robot.estimated) == {"stiffness", "friction"}
    assert list(Path().glob(".*")) == []


def test_a_joint_whose_stiffness_is_published_gets_no_estimate(folder: Path) -> None:
    Path("arm.urdf").write_text(urdf_of("left_s0", "shoulder", 4), encoding="utf-8")
    assert main(["init", "arm.urdf"]) == 0
    robot = load_robot("arm.toml")
    assert robot["stiffness_left_s0"].value == 843.0
    assert robot.estimated["stiffness"] == ("shoulder",)


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        (
            "arm.xacro",
            '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include/></robot>',
            "xacro",
        ),
        ("arm.sdf", '<?xml version="1.0"?><sdf><model name="a"/></sdf>', "<sdf>"),
    ],
)
def test_xml_that_is_no_urdf_is_told_what_it_is_and_is_no_log(
    name: str, text: str, what: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path(name).write_text(text, encoding="utf-8")
    for command in ("check", "init"):
        assert main([command, name]) == 2
        said = capsys.readouterr()
        assert what in said.out + said.err
        assert unnamed(said.out + said.err, "--robot", "moves") == ["--robot", "moves"]


@pytest.mark.parametrize(
    ("kind", "rows"),
    [
        ("DifferentialTransmission", ((1.0, 0.5), (1.0, -0.5))),
        ("FourBarLinkageTransmission", ((1.0, 0.0), (1.0, 1.0))),
        ("SimpleTransmission", ()),
    ],
)
def test_motors_that_share_joints_are_coupled_as_their_transmission_says(
    kind: str, rows: tuple[tuple[float, float], ...], folder: Path
) -> None:
    shared = f"""<transmission><type>transmission_interface/{kind}</type><actuator name="a"/><actuator name="b"/>
    <joint name="pitch"><mechanicalReduction>2</mechanicalReduction></joint><joint name="roll"/></transmission>"""
    Path("wrist.urdf").write_text(urdf_of("pitch", "roll", 1.0, shared), encoding="utf-8")
    assert main(["init", "wrist.urdf"]) == 0
    assert load_robot("wrist.toml").coupling == rows


MJCF = """<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" range="-90 90"/>
<inertial pos="0 0 0.2" mass="3" diaginertia="0.02 0.02 0.01"/>
<body name="fore" pos="0 0 0.4"><joint name="elbow" axis="0 1 0" range="-90 90"/>
<inertial pos="0 0 0.15" mass="1.5" diaginertia="0.01 0.01 0.005"/></body></body></worldbody>
<actuator>{}</actuator></mujoco>"""
DC = """<dcmotor joint="shoulder" motorconst="0.06" resistance="1.2" gear="100" armature="2e-5" ctrlrange="-24 24"/>
<dcmotor name="CSG-20-100" joint="elbow" motorconst="0.05" resistance="2" gear="100" saturation="1.2"/>"""


@pytest.mark.parametrize(
    ("words", "drive", "limits"),
    [
        ([], "voltage", (24.0, 48.0)),
        (["--drive", "current"], "current", (20.0, 24.0)),
        (["--drive", "torque"], "torque", (120.0, 120.0)),
    ],
)
def test_dc_motors_of_an_mjcf_state_gears_rotors_and_constants(
    words: list[str], drive: str, limits: tuple[float, float], folder: Path
) -> None:
    mujoco = pytest.importorskip("mujoco")
    Path("arm.xml").write_text(MJCF.format(DC), encoding="utf-8")
    known_model(mujoco, Path("arm.xml").read_text(encoding="utf-8"))
    assert main(["init", "arm.xml", "--gear", "shoulder=csg-25-100", *words]) == 0
    robot = load_robot("arm.toml")
    assert (robot.drive, tuple(robot.effort_limits or ())) == (drive, limits)
    assert robot["rotor_inertia_shoulder"].value == 2e-5
    if drive != "torque":  # of a torque on the link side no gear is needed
        assert [robot[f"{name}_elbow"].value for name in ("gear_ratio", "torque_constant")] == [100.0, 0.05]
    # the option names the gear of one joint, the file that of the other
    assert [robot[f"second_stiffness_{name}"].value for name in ("shoulder", "elbow")] == [5e4, 2.5e4]


def test_a_gear_that_is_named_states_the_stiffness(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = urdf_of(
        "a1", "a2", 1.0, '<transmission><joint name="a2"/><actuator name="CSG-20-100"/></transmission>'
    )
    Path("arm.urdf").write_text(text, encoding="utf-8")
    assert main(["init", "arm.urdf", "--gear", "CSG-25-10"]) == 2
    said = capsys.readouterr().err
    assert unnamed(said, "CSG-25-10", "CSG-25-100") == []
    assert main(["init", "arm.urdf", "--gear", "a3=CSG-25-100"]) == 2
    assert unnamed(capsys.readouterr().err, "a3", "a1") == []
    assert main(["init", "arm.urdf", "--gear", "a1=CSG-25-100"]) == 0
    robot = load_robot("arm.toml")
    assert "stiffness" not in robot.estimated
    assert [robot[f"second_stiffness_{name}"].value for name in ("a1", "a2")] == [5e4, 2.5e4]


def test_a_base_that_floats_stands_still_and_hands_move_what_one_motor_moves_alone(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco")
    trunk = """<body name="trunk"><freejoint/><inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/><body name="upper">"""
    rope = '<tendon><fixed name="rope"><joint joint="elbow" coef="1"/></fixed></tendon><actuator>'
    text = MJCF.format('<motor joint="shoulder"/><motor tendon="rope"/>').replace("<actuator>", rope)
    text = text.replace('<body name="upper">', trunk).replace("</worldbody>", "</body></worldbody>")
    Path("dog.xml").write_text(text, encoding="utf-8")
    assert main(["check", "dog.xml"]) == 1
    assert "trunk" in capsys.readouterr().out
    assert main(["init", "dog.xml"]) == 0
    with pytest.warns(RobotFileWarning) as told:
        assert load_robot("dog.toml").joint_names == ("shoulder", "elbow")
    assert unnamed(" ".join(str(each.message) for each in told), "trunk", "motor") == []
    Path("scene.xml").write_text('<mujoco><include file="dog.xml"/></mujoco>', encoding="utf-8")
    assert main(["init", "scene.xml"]) == 2
    assert unnamed(capsys.readouterr().err, "<include>", "dog.xml") == []
