"""Numbers in another unit: a question where one may be meant, a refusal where it is surely wrong, both at once."""

from __future__ import annotations

import math
import re

import pytest
from tests.builders import joint_text
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.robot import RobotFileWarning, load_robot
from flexhinf.robot.kinematics import check_delay, check_fast, heavy_motors


def text_of(
    stiffness=400.0, motor=0.3, static=1.5, centre=0.25, inertia=0.06, gravity=9.81, down=(1, 0, 0), **keys
):
    joint = joint_text(
        "shoulder", **{"limits": [-3.0, 3.0], **keys}, mass=3.0, centre=(centre, 0.0, 0.0),
        inertia=(0.01, inertia, inertia), spring=f"stiffness = {stiffness}",
        motor=f"motor_inertia = {motor}\ncoulomb_friction = 1.0\nstatic_friction = {static}",
    )  # fmt: skip
    return f"gravity = {gravity}\ndown = {list(down)}\n{joint}"


def loaded(tmp_path, **changes):
    path = tmp_path / "arm.toml"
    path.write_text(text_of(**changes), encoding="utf-8")
    return load_robot(path)


@pytest.mark.parametrize(
    ("changes", "refused", "text"),
    [
        ({"stiffness": 25.0}, False, r"° under(.|\n)*N·m/deg(.|\n)*1432.4 for 25 N·m/deg"),
        ({"stiffness": 2.0}, True, r"'shoulder'[\s\S]* 114\.59 for 2 N·m/deg"),
        ({"centre": 6.0, "stiffness": 1e4}, False, r"millimetres(.|\n)*0\.006 .* 6 mm"),
        ({"centre": 250.0}, True, r"millimetres(.|\n)*0\.25 .* 250 mm"),
        ({"inertia": 600000.0}, True, r"inertia[\s\S]* 0\.06 .*6e\+05 g·cm²"),
        ({"inertia": 600.0}, True, r"inertia[\s\S]* 0\.06 .*600 kg·cm²"),
        ({"inertia": 20.0}, False, r"inertia[\s\S]* 0\.002 .*20 kg·cm²"),
        ({"motor": 3.3e6}, True, r"0.33 if 3.3e\+06 g·cm²"),
        ({"motor": 5000.0}, False, r"motor[\s\S]* 0\.5 .*5000 kg·cm²"),
        ({"motor": 450.0}, False, r"motor[\s\S]* 0\.045 .*450 kg·cm²"),
        ({"motor": '{ value = 4500.0, source = "estimate: a guess" }'}, False, r"18,182 [\s\S]*data sheet"),
        ({"motor": 1e-5}, False, r"rotor_inertia = 1e-05.*gear_ratio"),
        ({"limits": [-170.0, 170.0]}, True, r"degrees(.|\n)*-2\.9671 .* 2\.9671 rad"),
        ({"limits": [-31.4, 31.4]}, False, r"continuous"),
        ({"rpy": [0.0, 90.0, 0.0]}, True, r"degrees(.|\n)*\[0\.0, 1\.5708, 0\.0\]"),
        ({"down": [0, 0, -1]}, False, r"gravity[\s\S]*down = \[0\.0, 0\.0, -1\.0\]"),
        ({"gravity": 981.0, "stiffness": 4e4}, False, r"cm/s²(.|\n)*9.81"),
        ({"static": 0.5}, False, r"static_friction >= coulomb_friction.* 0\.5 "),
    ],
)
def test_what_is_probably_in_another_unit_is_asked_or_refused(tmp_path, changes, refused, text):
    if refused:
        with pytest.raises(InvalidInput, match=text):
            loaded(tmp_path, **changes)
    else:
        with pytest.warns(RobotFileWarning, match=text) as caught:
            robot = loaded(tmp_path, **changes)
        assert len(caught) == 1
        assert robot.joint_names == ("shoulder",)


@pytest.mark.parametrize("mass", ["1e29kg", "0..1e29kg", "600"])
def test_a_payload_of_many_times_the_robots_mass_is_refused(mass):
    """The spring was blamed, and a range taken whatever its upper end."""
    with refused_with(InvalidInput, "payload", "kg", "5 kg", "grams"):
        load_robot("planar-two-link", payload=mass)


def test_a_heavy_payload_is_asked_about_and_named_where_a_spring_twists():
    with pytest.warns(RobotFileWarning, match=r"payload.* 20 (.|\n)* 0\.1kg .*100 g"):
        load_robot("planar-two-link", payload="0..100kg")
    with pytest.warns(RobotFileWarning), refused_with(InvalidInput, "'shoulder'", "125°", "payload"):
        load_robot("planar-two-link", payload="100kg")


def test_usual_numbers_are_not_asked_about(tmp_path):
    assert loaded(tmp_path).nominal["stiffness"] == 400.0
    assert loaded(tmp_path, gravity=0.0, down=[0, 0, -1]).nominal["gravity"] == 0.0
    assert loaded(tmp_path, limits=[-6.2832, 6.2832]).links.limits == ((-6.2832, 6.2832),)


def test_a_message_has_no_more_than_its_three_parts(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(text_of(static='"' + "x" * 100_000 + '"'), encoding="utf-8")
    with pytest.raises(InvalidInput) as caught:
        load_robot(path)
    assert max(map(len, str(caught.value).splitlines())) < 600


def test_a_joint_that_no_loop_of_this_period_can_follow_is_refused_before_any_work(tmp_path):
    """1e8 N·m/rad took minutes of sub-steps in silence."""

    def work(text: str) -> None:
        assert text.startswith("equilibrium")

    robot = loaded(tmp_path, stiffness=1e8)
    with refused_with(InvalidInput, "'shoulder'", "Hz", "stiffness =", "--period") as caught:
        fh.design(robot, fh.Specification(), work)
    softer = float(re.search(r"stiffness = ([0-9.e+]+)", str(caught.value))[1])
    check_fast(loaded(tmp_path, stiffness=softer), 1e-3)
    with pytest.raises(InvalidInput, match="vibrates"):
        fh.compare(robot, fh.Specification(), progress=work)


def test_a_delay_longer_than_the_lowest_vibration_is_asked_for_its_unit() -> None:
    robot = fh.load_robot("paper")
    longest = 2.0 * math.pi * math.sqrt(1.0 / 100.0)  # M and K of Table 1
    check_delay(robot, 0.999 * longest)
    with pytest.raises(InvalidInput, match=f"delay(.|\n)* {longest:.3g} s,.*vibration"):
        check_delay(robot, 1.001 * longest)
    for judged in (fh.design, fh.compare):
        with pytest.raises(InvalidInput, match="--unknown-delay 1ms"):
            judged(robot, fh.Specification(pose=0.0, period=0.01, unknown_delay=1.0))


def test_motors_with_a_doubtful_inertia_are_named_but_for_a_light_wrist_and_estimates(tmp_path) -> None:
    with pytest.warns(RobotFileWarning):
        assert heavy_motors(loaded(tmp_path, motor=450.0)) == ["shoulder"]
    assert heavy_motors(fh.load_robot("seven-link")) == []  # 930 times at its last joint
    assert heavy_motors(loaded(tmp_path, motor='{ value = 450.0, source = "estimate: a guess" }')) == []


@pytest.mark.parametrize(("stiffness", "said"), [(9.0, "9 kN·m/rad"), (9e6, "9 kN·m/rad"), (9e3, "")])
def test_a_spring_is_weighed_against_its_motor_where_nothing_else_loads_it(tmp_path, stiffness, said):
    """An arm without gravity; N·m/rad for kN·m/rad, and the other way round."""
    path = tmp_path / "scara.toml"
    text = 'gravity = 0\n[[joint]]\nname = "a"\neffort_limit = 60.0\n[joint.link]\nmass = 4.0\n'
    text += "centre_of_mass = [0.2, 0, 0]\ninertia = {xx = 5e-3, yy = 0.06, zz = 0.06}\n[joint.spring]\n"
    path.write_text(f"{text}stiffness = {stiffness}\n[joint.motor]\nmotor_inertia = 0.4\nfriction = 8.0\n")
    if said:
        with pytest.warns(RobotFileWarning) as caught:
            load_robot(path)
        assert unnamed(str(caught[0].message), "'a'", said, "60 N·m") == []
    else:
        load_robot(path)


def test_a_number_with_another_unit_keeps_its_number(tmp_path):
    with refused_with(InvalidInput, "stiffness") as refused:
        loaded(tmp_path, stiffness='"31 kNm"')
    assert unnamed(refused.value.advice, "31 kNm/rad") == []


def test_a_torque_constant_in_another_unit_is_named_and_not_the_spring(tmp_path):
    path = tmp_path / "arm.toml"
    text = text_of(stiffness=16000.0).replace(
        "motor_inertia = 0.3", "rotor_inertia = 3.5e-5\ngear_ratio = 100\ntorque_constant = 90"
    )
    path.write_text(text.replace("limits =", "effort_limit = 10\nlimits ="), encoding="utf-8")
    with pytest.warns(RobotFileWarning) as caught:
        load_robot(path)
    assert len(caught) == 1
    assert unnamed(str(caught[0].message), "torque_constant = 0.09", "gear_ratio 100", 9e4) == []


def test_a_stiffness_in_arc_minutes_is_offered(tmp_path):
    with refused_with(InvalidInput, "N·m/arcmin", 16157, "N·m/deg"):
        loaded(tmp_path, stiffness=4.7)


def test_a_urdf_that_is_not_there_is_named_with_the_file_that_names_it(tmp_path):
    (tmp_path / "ranger.urdf").write_text("<robot/>", encoding="utf-8")
    path = tmp_path / "arm.toml"
    path.write_text('urdf = "rangr.urdf"\n' + text_of(), encoding="utf-8")
    with refused_with(InvalidInput, "arm.toml", "'rangr.urdf'", "urdf = 'ranger.urdf'"):
        load_robot(path)
