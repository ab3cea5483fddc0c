"""Numbers in another unit: a question where one may be meant, a refusal where it is surely wrong, both at once."""

from __future__ import annotations

import math
import re

import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.robot import RobotFileWarning, load_robot
from flexhinf.robot.kinematics import check_delay, check_fast

ARM = """
gravity = {gravity}
down = {down}
[[joint]]
name = "shoulder"
limits = {limits}
rpy = {rpy}
[joint.link]
mass = 3.0
centre_of_mass = [{centre}, 0.0, 0.0]
inertia = {{ xx = 0.01, yy = {inertia}, zz = {inertia} }}
[joint.spring]
stiffness = {stiffness}
[joint.motor]
motor_inertia = {motor}
coulomb_friction = 1.0
static_friction = {static}
"""

USUAL = {
    "gravity": 9.81, "down": [1, 0, 0], "limits": [-3.0, 3.0], "rpy": [0.0, 0.0, 0.0], "centre": 0.25,
    "inertia": 0.06, "stiffness": 400.0, "motor": 0.3, "static": 1.5,
}  # fmt: skip


def loaded(tmp_path, **changes):
    path = tmp_path / "arm.toml"
    path.write_text(ARM.format(**USUAL | changes), encoding="utf-8")
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
        ({"motor": 5000.0}, False, r"motor[\s\S]* 0\.0005 .*5000 g·cm²"),
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
    path.write_text(ARM.format(**USUAL | {"static": '"' + "x" * 100_000 + '"'}), encoding="utf-8")
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
