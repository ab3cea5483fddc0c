"""A description is examined as a whole, and completed with estimates that say so."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from benchmarks.drives import SLOWER
from tests.refusals import refused_with, unnamed

from flexhinf import load_robot
from flexhinf.errors import InvalidInput
from flexhinf.robot import catalogue
from flexhinf.robot.drives import DRIVES
from flexhinf.robot.estimates import LOST, SPEED, estimated_joints
from flexhinf.robot.examination import examine_robot, joint_facts
from flexhinf.robot.init_file import description_of, robot_file_text
from flexhinf.robot.parts import RobotFileWarning
from flexhinf.robot.rigid_arm import nearest_inertia
from flexhinf.robot.template import template_text

GOOD = '<inertia ixx="0.01" iyy="0.01" izz="0.002" ixy="0" ixz="0" iyz="0"/>'
NO_BODY = '<inertia ixx="0.01" iyy="0.01" izz="0.03" ixy="0" ixz="0" iyz="0"/>'


def link(name: str, inertia: str = GOOD, mass: float = 1.0) -> str:
    inside = f'<origin xyz="0 0 -0.2"/><mass value="{mass}"/>{inertia}' if inertia else ""
    return f'<link name="{name}"><inertial>{inside}</inertial></link>' if inside else f'<link name="{name}"/>'


def joint(name: str, parent: str, child: str, inside: str = "", kind: str = "revolute") -> str:
    limit = inside or '<limit lower="-1" upper="2" effort="40" velocity="3"/>'
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="0 0 -0.4"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 1 0"/>{limit}</joint>'
    )


def written(folder: Path, *parts: str) -> Path:
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm"><link name="base"/>{"".join(parts)}</robot>', encoding="utf-8")
    return path


def begun(path: Path, drive: str = "torque") -> Path:
    """The robot file that `flexhinf init` writes for a description."""
    out = path.with_name("begun.toml")
    found = description_of(path)
    out.write_text(robot_file_text(found, found.arm(), out, drive), encoding="utf-8")
    return out


def examined_changes(path: Path) -> list[str]:
    """What `flexhinf check` says that `flexhinf init` changes, beside what stands in quotes."""
    return [found.what.split(": ", 1)[1] for found in examine_robot(path).findings if "init" in found.what]


def test_all_faults_are_found_at_once_and_got_round(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        link("upper", NO_BODY), link("lower", NO_BODY), link("hand", ""), link("finger"),
        joint("shoulder", "base", "upper"), joint("elbow", "upper", "lower", '<limit effort="-1" velocity="0"/>'),
        joint("wrist", "lower", "hand"),
        joint("grip", "lower", "finger", '<limit lower="2" upper="1" effort="3" velocity="1"/>'),
    )  # fmt: skip
    found = examine_robot(path)
    faults = [finding for finding in found.findings if finding.severity == "fault"]
    places = {place for finding in faults for place in finding.place.split(", ")}
    assert places >= {"upper", "lower", "wrist", "grip"}
    with pytest.warns(RobotFileWarning, match="upper.*lower"):
        robot = load_robot(begun(path))
    assert robot.joint_names == ("shoulder",)  # the elbow has no motor, the wrist no mass, the grip no room
    assert robot.estimated == dict.fromkeys(("stiffness", "motor_inertia", "friction"), ("shoulder",))
    text = begun(path).read_text()
    assert "[links.upper]" in text
    assert "[links.lower]" in text


@pytest.mark.parametrize("moment", [0.0203, 0.03])
def test_every_inertia_that_no_body_has_is_named_with_little_missing_too(
    moment: float, tmp_path: Path
) -> None:
    """As links 2 and 3 of an xArm6: one lacks 1 %, which readers take as the nearest, and the other a third."""
    path = written(
        tmp_path, link("upper", NO_BODY.replace("0.03", "0.0203")), link("lower", NO_BODY.replace("0.03", f"{moment}")),
        joint("shoulder", "base", "upper"), joint("elbow", "upper", "lower"),
    )  # fmt: skip
    wrong = next(found for found in examine_robot(path).findings if "no body" in found.what)
    assert wrong.severity == ("fault" if moment > 0.021 else "doubt")
    assert moment < 0.021 or {"[links.upper]", "[links.lower]"} <= {*wrong.advice.split()}
    assert [change.split("'")[1::2] for change in examined_changes(path)] == [["upper", "lower"]]
    assert tomllib.loads(begun(path).read_text(encoding="utf-8"))["links"] == {
        name: {"inertia": "nearest"} for name in ("upper", "lower")
    }


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_robot_of_the_catalogue_is_examined_without_a_fault(name: str) -> None:
    """Those of a single link too, which have an inertia about their axis and no mass."""
    result = examine_robot(catalogue()[name])
    assert result.robot is not None
    assert {finding.severity for finding in result.findings} <= {"doubt", "note"}
    assert [joint.name for joint in result.joints] == [*result.robot.joint_names]


@pytest.mark.parametrize(("mass", "told"), [(1.0, 1), (1.1, 0)])
def test_links_that_are_one_placeholder_are_told_of_both_files(
    mass: float, told: int, tmp_path: Path
) -> None:
    path = written(
        tmp_path, link("a"), link("b"), link("c", mass=mass),
        joint("i", "base", "a"), joint("j", "a", "b"), joint("k", "b", "c"),
    )  # fmt: skip
    for file in (path, begun(path)):
        findings = examine_robot(file).findings
        alike = [
            f.numbers
            for f in findings
            if (f.severity, f.what) == ("doubt", "All links have one mass and one inertia.")
        ]
        assert ["got 1 kg and 0.01 kg·m², 3 times" in numbers for numbers in alike] == [True] * told


def test_of_several_joints_of_a_body_the_last_one_is_left(tmp_path: Path) -> None:
    """A base that slides twice before it turns, as those of mobile arms do: no link is between these joints."""
    pytest.importorskip("mujoco")
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><worldbody><body name="base"><joint name="x" type="slide" axis="1 0 0"/>'
        '<joint name="y" type="slide" axis="0 1 0"/><joint name="turn" axis="0 0 1" pos="0.1 0 0"/>'
        '<geom size="0.2"/><body name="upper" pos="0 0 0.4"><joint name="shoulder" axis="0 1 0"/>'
        '<geom size="0.1" pos="0.3 0 0"/></body></body></worldbody><actuator><motor joint="x"/><motor joint="y"/>'
        '<motor joint="turn"/><motor joint="shoulder"/></actuator></mujoco>'
    )
    (fault,) = [found for found in examine_robot(path).findings if found.severity == "fault"]
    assert fault.place == "x, y"
    assert load_robot(begun(path)).joint_names == ("turn", "shoulder")
    assert "# 'x', 'y' stand still" in begun(path).read_text(encoding="utf-8")


#: An arm of one motor with a gripper like Robotiq's: a loop of two bars, and fingers that one motor pulls.
LOOPED = """<mujoco><worldbody><body name="upper"><joint name="arm" axis="0 1 0"/><geom size="0.1" pos="0 0 0.3"/>
<body name="crank" pos="0.1 0 0"><joint name="crank" axis="0 1 0"/><geom size="0.05" pos="0 0 0.1"/>
<body name="rod" pos="0 0 0.2"><joint name="rod" axis="0 1 0"/><geom size="0.05" pos="0 0 0.1"/>
<site name="end"/></body></body>
<body name="rocker" pos="0.2 0 0"><joint name="rocker" axis="0 1 0"/><geom size="0.05" pos="0 0 0.1"/></body>
<body name="thumb" pos="0.3 0 0"><joint name="thumb" axis="0 1 0"/><geom size="0.05" pos="0 0 0.1"/></body>
<body name="f" pos="0.4 0 0"><joint name="f" axis="0 1 0"/><geom size="0.05" pos="0 0 0.1"/>
<site name="tip" pos="0 0 0.2"/></body></body><site name="post" pos="0.4 0 0.1"/></worldbody>
<equality><connect body1="rod" body2="rocker" anchor="0 0 0.2"/></equality>
<tendon><fixed name="split"><joint joint="thumb" coef="1"/><joint joint="f" coef="1"/></fixed>{}</tendon>
<actuator><motor joint="arm"/><motor joint="crank"/>{}</actuator></mujoco>"""


def test_joints_of_closed_loops_and_of_tendons_stand_still_and_are_named(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    path = tmp_path / "arm.xml"
    path.write_text(LOOPED.format("", '<motor tendon="split"/>'))
    loop, pulled = examined_changes(path)
    assert unnamed(loop, "'crank', 'rod', 'rocker'", "connect of 'rod, rocker'") == []
    assert pulled.split("'")[1::2] == ["thumb", "f"]
    assert load_robot(begun(path)).joint_names == ("arm",)
    cable = '<spatial name="cable" stiffness="40"><site site="post"/><site site="tip"/></spatial>'
    path.write_text(LOOPED.format(cable, ""))
    assert [change.partition(" stand still")[0] for change in examined_changes(path)][:2] == [
        "'crank', 'rod', 'rocker'", "'arm', 'f'"
    ]  # fmt: skip
    path.write_text(LOOPED.format(cable.replace("tip", "end"), '<motor tendon="split"/>'))
    with refused_with(InvalidInput, "'crank', 'rod', 'rocker'", "connect", "'arm'", "cable"):
        description_of(path, ()).arm()


@pytest.mark.parametrize("point", ['<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>', " "])
def test_a_link_that_states_no_inertia_is_a_plastic_ball(point: str, tmp_path: Path) -> None:
    path = written(tmp_path, link("upper", point, mass=2.0), joint("shoulder", "base", "upper"))
    text = begun(path).read_text(encoding="utf-8")
    inertia = tomllib.loads(text)["links"]["upper"]["inertia"]
    radius = (3.0 * 2.0 / (4.0 * np.pi * 1000.0)) ** (1.0 / 3.0)  # of 1000 kg/m³
    moment = pytest.approx(0.4 * 2.0 * radius**2, rel=0.01)
    assert inertia == dict.fromkeys(("xx", "yy", "zz"), moment) | dict.fromkeys(("xy", "xz", "yz"), 0.0)
    assert load_robot(tmp_path / "begun.toml").joint_names == ("shoulder",)


def test_every_element_that_stands_twice_is_named(tmp_path: Path) -> None:
    twice = f'{GOOD}<mass value="3"/>'
    path = written(
        tmp_path, link("upper", twice), link("lower", twice),
        joint("shoulder", "base", "upper"), joint("elbow", "upper", "lower"),
    )  # fmt: skip
    assert [found.place for found in examine_robot(path).findings if "<mass>" in found.what] == [
        "upper",
        "lower",
    ]


def test_what_a_file_states_is_taken_and_the_rest_is_estimated(tmp_path: Path) -> None:
    gear = (
        '<transmission name="t"><joint name="elbow"/><actuator name="m">'
        "<mechanicalReduction>-80</mechanicalReduction>"
        '<rotor_inertia value="2e-5"/></actuator></transmission>'
    )
    path = written(
        tmp_path, link("upper"), link("lower"), joint("shoulder", "base", "upper"),
        joint("elbow", "upper", "lower", '<limit lower="0.5" upper="2" effort="20"/><dynamics damping="0.7"/>'),
        gear,
    )  # fmt: skip
    robot = load_robot(begun(path))
    assert robot.home == pytest.approx((0.5, 1.25))  # the middle of the limits
    assert robot.nominal["friction_elbow"] == 0.7
    assert robot["friction_elbow"].source == "arm.urdf"
    assert robot.plant_parameters()["motor_inertia"][1] == pytest.approx(80.0**2 * 2e-5)
    assert robot.estimated["motor_inertia"] == robot.estimated["friction"] == ("shoulder",)
    assert robot["stiffness_elbow"].value == pytest.approx(20.0 / 8e-3)


def test_grippers_are_locked_and_a_torque_that_nobody_states_holds_the_arm(tmp_path: Path) -> None:
    follows = '<limit lower="0" upper="0.04" effort="10"/><mimic joint="left"/>'
    path = written(
        tmp_path, link("upper"), link("lower"), link("l"), link("r"),
        joint("shoulder", "base", "upper", '<limit lower="-2" upper="2"/>'),
        joint("elbow", "upper", "lower", "<limit/>"),
        joint("left", "lower", "l", '<limit lower="0.01" upper="0.04"/>', "prismatic"),
        joint("right", "lower", "r", follows, "prismatic"),
    )  # fmt: skip
    assert [change.split("'")[1::2] for change in examined_changes(path)] == [["left", "right"]]
    robot = load_robot(begun(path))
    assert robot.joint_names == ("shoulder", "elbow")
    facts = joint_facts(robot)
    assert all(1.5 * fact.weight < fact.effort < np.inf for fact in facts)


def test_a_range_without_numbers_of_a_motor_is_no_joint_that_nothing_drives(tmp_path: Path) -> None:
    """Exporters write 0 for torque and speed of joints that move; a caster carries no motor, and stands still."""
    path = written(
        tmp_path, link("upper"), link("lower"), link("wheel"),
        joint("shoulder", "base", "upper", '<limit lower="-2" upper="2" effort="0" velocity="0"/>'),
        joint("elbow", "upper", "lower"),
        joint("caster", "base", "wheel", '<limit lower="-1" upper="1" effort="0" velocity="0"/>'),
    )  # fmt: skip
    assert load_robot(begun(path)).joint_names == ("shoulder", "elbow")
    assert [change.split("'")[1::2] for change in examined_changes(path)] == [["caster"]]


@pytest.mark.parametrize("drive", ["torque", "current", "voltage", "velocity", "position"])
def test_a_template_is_a_robot_whose_motors_hold_it(drive: str, tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(template_text(3, drive), encoding="utf-8")
    result = examine_robot(path)
    assert result.robot is not None
    assert result.robot.drive == drive
    assert {finding.severity for finding in result.findings} == {"doubt", "note"}
    assert all(fact.weight < fact.effort for fact in result.joints) or DRIVES[drive].inner
    assert all(np.isfinite(result.robot.effort_limits))
    for bandwidth in (result.robot[name] for name in result.robot.nominal if "bandwidth" in name):
        # 30 % slower is what benchmarks take for slow drives.
        assert bandwidth.interval == pytest.approx(
            (SLOWER * bandwidth.value, (2.0 - SLOWER) * bandwidth.value)
        )


def test_facts_of_joints_are_those_of_the_robot(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(template_text(1, "torque"), encoding="utf-8")
    (fact,) = examine_robot(path).joints
    # a rod of 0.4 m and 4 kg on a spring of 80 N·m / 8 mrad, its motor of 80 N·m / 70 rad/s²
    inertia, spring, rotor = 4.0 * 0.4**2 / 3.0, 80.0 / 8e-3, 80.0 / 70.0
    assert fact.weight == pytest.approx(1.05 * 4.0 * 9.81 * 0.2, rel=2e-3)  # its mass is known to ± 5 %
    assert fact.twist == pytest.approx(fact.weight / spring)
    assert fact.fastest == pytest.approx(
        np.sqrt(spring * (1.0 / inertia + 1.0 / rotor)) / (2.0 * np.pi), rel=2e-2
    )


def test_the_limit_of_a_command_is_no_torque(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    drive = 'drive = "position"\ndrive_bandwidth = "20 Hz"\ndrive_damping_ratio = 0.9'
    path.write_text(f"{template_text(1, 'torque')}{drive}\n", encoding="utf-8")
    result = examine_robot(path)
    assert result.robot is not None
    assert np.isnan(result.joints[0].effort)
    (doubt,) = [finding for finding in result.findings if "joint1" in finding.place.split(", ")]
    assert "rad" in doubt.numbers
    assert "drive_torque_limit" in doubt.advice
    path.write_text(path.read_text().replace("effort_limit = 80", "effort_limit = 3.5"), encoding="utf-8")
    assert all("joint1" not in finding.place.split(", ") for finding in examine_robot(path).findings)


@pytest.mark.parametrize("drive", sorted(name for name, kind in DRIVES.items() if kind.inner))
def test_the_torque_of_a_file_is_that_of_the_motor_within_its_drive(tmp_path: Path, drive: str) -> None:
    path = written(tmp_path, link("upper"), joint("shoulder", "base", "upper"))
    result = examine_robot(begun(path, drive))
    assert result.robot is not None
    assert result.robot.effort_limits == (2.4 if drive == "position" else 3.6,)
    assert result.joints[0].effort == 40.0


def test_friction_by_the_load_is_dry_friction(tmp_path: Path) -> None:
    path, said = tmp_path / "arm.toml", []
    for more in ("", "load_friction = 0.1\n"):
        path.write_text(f"{template_text(1, 'torque')}{more}", encoding="utf-8")
        said.append(any("coulomb_friction" in finding.advice for finding in examine_robot(path).findings))
    assert said == [True, False]


def test_doubtful_numbers_of_a_robot_file_are_named(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    text = template_text(2, "torque")
    path.write_text(
        text.replace("effort_limit = 80", "effort_limit = 20").replace(
            "value = 5e+03, tol", "value = 5, tol"
        ),
        encoding="utf-8",
    )
    found = {finding.place: finding.what for finding in examine_robot(path, period=0.02).findings}
    assert {"joint1", "joint2"} <= set(found)
    path.write_text(text.replace("stiffness", "stifness").replace("friction", "fricton"), encoding="utf-8")
    result = examine_robot(path)
    assert result.robot is None
    assert sum(finding.severity == "fault" for finding in result.findings) >= 4  # two keys of two joints


@pytest.mark.oracle
def test_the_nearest_inertia_is_that_of_a_body_and_no_other_is_nearer() -> None:
    """Against a search over bodies made of points, which have all inertias that there are."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        square = rng.normal(size=(3, 3))
        wrong = 0.5 * (square + square.T) + 0.5 * np.eye(3)

        def moments(inertia: np.ndarray) -> np.ndarray:
            return 0.5 * np.trace(inertia) * np.eye(3) - inertia

        near = nearest_inertia(wrong)
        assert np.linalg.eigvalsh(moments(near)).min() > -1e-12
        distance = np.linalg.norm(moments(near) - moments(wrong))
        for _ in range(50):
            points = (
                moments(near) + 0.1 * (step := rng.normal(size=(3, 3))) @ step.T
            )  # another body's, near to it
            assert np.linalg.norm(points - moments(wrong)) >= distance - 1e-12


@pytest.mark.parametrize(("velocity", "doubted"), [("3", False), ("1000", True)])
def test_a_speed_that_no_joint_reaches_is_doubted_and_makes_no_friction(
    tmp_path: Path, velocity: str, doubted: bool
) -> None:
    limit = f'<limit lower="-1" upper="2" effort="40" velocity="{velocity}"/>'
    path = written(tmp_path, link("upper"), joint("shoulder", "base", "upper", limit))
    found = [finding for finding in examine_robot(path).findings if velocity in finding.numbers]
    assert [finding.place for finding in found] == ["shoulder"] * doubted
    robot = load_robot(begun(path))
    speed = SPEED[0] if doubted else float(velocity)
    assert robot.nominal["friction"] == pytest.approx(LOST * 40.0 / speed, rel=1e-2)


def test_one_torque_for_all_joints_that_none_needs_is_no_motors(tmp_path: Path) -> None:
    """The limits of hobby arms; a torque that the shoulder needs is the motors' own."""

    def arm(effort: float) -> Path:
        limit = f'<limit lower="-1" upper="2" effort="{effort}" velocity="3"/>'
        parts = (joint("shoulder", "base", "upper", limit), joint("elbow", "upper", "lower", limit))
        return written(tmp_path, link("upper"), link("lower"), *parts)

    needed = joint_facts(load_robot(begun(arm(40.0))))[0].weight
    for effort, own in ((40.0, True), (1e3, False)):
        path = arm(effort)
        doubts = [found for found in examine_robot(path).findings if f"{effort:g}" in found.numbers]
        assert bool(doubts) is not own
        shoulder, elbow = joint_facts(load_robot(begun(path)))
        assert shoulder.effort == elbow.effort
        assert shoulder.effort == effort if own else needed < shoulder.effort < 5.0 * needed


@pytest.mark.parametrize(("others", "own"), [(40.0, True), (4.0, False)])
def test_a_wrist_that_needs_next_to_nothing_has_a_torque_as_large_as_others(
    others: float, own: bool, tmp_path: Path
) -> None:
    """The last axis of an arm without a tool; a torque far beyond those that joints need is a placeholder."""
    small = '<inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/>'
    limit = f'<limit lower="-1" upper="2" effort="{others}" velocity="3"/>'
    wrist = joint("wrist", "upper", "hand").replace("0 1 0", "0 0 1")
    path = written(
        tmp_path, link("upper"), link("hand", small), joint("shoulder", "base", "upper", limit), wrist
    )
    guess = estimated_joints(description_of(path).arm())
    assert [each.stated for each in guess.values()] == [True, own]


def test_one_torque_for_all_joints_that_does_not_hold_them_is_no_motors(tmp_path: Path) -> None:
    """Writers of files put 1 everywhere, for torques, masses and inertias; what differs is taken as stated."""

    def arm(effort: float, *masses: float) -> Path:
        limit = f'<limit lower="-1" upper="2" effort="{effort}" velocity="3"/>'
        names = ("base", *[f"link{k}" for k in range(len(masses))])
        links = [link(name, mass=mass) for name, mass in zip(names[1:], masses)]
        return written(
            tmp_path, *links, *(joint(f"j{k}", *names[k : k + 2], limit) for k in range(len(masses)))
        )

    for effort, last, alike, weak in (
        (1.0, 1.0, 1, 1),
        (1.0, 2.0, 0, 1),
        (20.0, 2.0, 0, 0),  # which holds most of its range
    ):
        path = arm(effort, 1.0, 1.0, last)
        doubts = [found for found in examine_robot(path).findings if found.severity == "doubt"]
        assert len([found for found in doubts if "kg" in found.numbers]) == alike
        assert len([found for found in doubts if "torques" in found.numbers]) == weak
        facts = joint_facts(load_robot(begun(path)))
        assert all(fact.effort > fact.weight for fact in facts) is (weak == 1)


@pytest.mark.parametrize(("period", "told"), [(None, "4 ms"), (1e-3, "1 ms")])
def test_vibrations_are_compared_with_the_period_of_the_drives(
    period: float | None, told: str, tmp_path: Path
) -> None:
    path = tmp_path / "arm.toml"
    first, spring, after = template_text(2, "position").rpartition("[joint.spring]\nstiffness =")
    after = after.replace("value = 5000", "value = 1e8", 1)
    path.write_text(first + spring + after, encoding="utf-8")
    (fast,) = (one for one in examine_robot(path, period=period).findings if told in one.numbers)
    assert "rigid = true" in fast.advice
    assert "--period" not in fast.advice
    path.write_text(f"{first}rigid = true  # {after}", encoding="utf-8")
    assert not [one for one in examine_robot(path, period=period).findings if told in one.numbers]
