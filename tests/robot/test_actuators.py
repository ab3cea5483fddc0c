"""Published joints: every number has its source and a unit of ours, and a robot file takes what it does not state."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.cli import main
from flexhinf.errors import InvalidInput
from flexhinf.robot.actuators import published_gears, published_joints
from flexhinf.robot.elastic import SPRING
from flexhinf.robot.file_keys import MOTOR

ARM = """
name = "one"
[[joint]]
name = "shoulder"
link = {{ mass = 1.0, length = 0.3, axis_inertia = 0.2 }}
{joint}
"""


def arm(folder: Path, joint: str) -> fh.Robot:
    (folder / "one.toml").write_text(ARM.format(joint=joint), encoding="utf-8")
    return fh.load_robot(folder / "one.toml")


def test_every_number_has_a_source() -> None:
    for joint in published_joints().values():
        assert joint.about
        assert joint.numbers
        for name, number in joint.numbers.items():
            assert name in (*SPRING, *MOTOR)
            assert number["source"]
            low, high = number.get("range", (number["value"],) * 2)
            assert 0.0 < low <= number["value"] <= high


def test_springs_in_series_and_inertias_are_those_of_their_sources() -> None:
    """Gear and bar of the toolbox's files in series; the total inertia shared as their data sheets' parts."""
    big, orange = (published_joints()[name].numbers for name in ("walkman-big-10k", "compliant-orange80"))
    assert big["stiffness"]["value"] == pytest.approx(1.0 / (1.0 / 75e3 + 1.0 / 12823.0), rel=1e-4)
    assert orange["stiffness"]["value"] == pytest.approx(1.0 / (1.0 / 16e3 + 1.0 / 6e3), rel=1e-4)
    for name, gear, bar in (("lemon", 13e3, 6e3), ("pomegranate", 32e3, 9e3)):
        series = published_joints()[f"tree-{name}"].numbers["stiffness"]["value"]
        assert series == pytest.approx(1.0 / (1.0 / gear + 1.0 / bar), rel=2e-4)
    powerballs = ((5.23e-5, 160.0, "large"), (1.7e-5, 100.0, "small"))
    for inertia, ratio, size in powerballs:
        numbers = published_joints()[f"schunk-lwa4p-{size}"].numbers
        assert numbers["motor_inertia"]["value"] == pytest.approx(inertia * ratio**2, rel=1e-3)
    rotor, gear, load = 5.48e-5 * 100**2, 2.63e-5 * 100**2, 0.0867
    assert big["motor_inertia"]["value"] == pytest.approx(
        1.1001 * (rotor + gear) / (rotor + gear + load), rel=1e-4
    )
    assert big["friction"]["range"] == pytest.approx([0.9 * 14.786, 0.9 * 16.162], rel=1e-3)
    assert big["coulomb_friction"]["range"] == pytest.approx([0.9 * 1.8579, 0.9 * 2.4238], rel=1e-3)


def test_a_joint_takes_what_it_does_not_state(tmp_path: Path) -> None:
    robot = arm(tmp_path, 'actuator = "walkman-big-10k"')
    assert robot.nominal["stiffness"] == 10951.0
    assert unnamed(robot["stiffness"].source, "Toolbox") == []
    assert robot["friction"].interval == (13.31, 14.55)
    own = "spring = { stiffness = 500.0 }\nmotor = { rotor_inertia = 1e-5, gear_ratio = 50.0 }"
    robot = arm(tmp_path, f'actuator = "walkman-big-10k"\n{own}')
    assert robot.nominal["stiffness"] == 500.0
    assert "motor_inertia" not in robot.nominal
    assert robot.nominal["coulomb_friction"] == 1.927
    with refused_with(InvalidInput, "spring", "stiffness"):  # no source states a stiffness of it
        arm(tmp_path, 'actuator = "franka-fr3-1"')
    robot = arm(tmp_path, 'actuator = "franka-fr3-1"\nspring = { stiffness = 500.0 }')
    assert robot.nominal["motor_inertia"] == 0.6057


def test_a_saved_robot_states_what_was_changed(tmp_path: Path) -> None:
    """As `identify` does: the number moves into the file, and the others stay those of the actuator."""
    robot = arm(tmp_path, 'actuator = "walkman-big-10k"').with_values({"stiffness": 9e3, "friction": 14.0})
    robot.save(tmp_path / "saved.toml")
    again = fh.load_robot(tmp_path / "saved.toml")
    assert again.nominal == robot.nominal
    assert again["friction"].interval == robot["friction"].interval


def test_an_unknown_one_is_refused_with_the_nearest(tmp_path: Path) -> None:
    with refused_with(InvalidInput, "franka-fr3-2", "lwr2-1") as refusal:
        arm(tmp_path, 'actuator = "franka-fr3-2"')
    arm(tmp_path, f"{str(refusal.value).split('try:')[1].strip()}\nspring = {{ stiffness = 500.0 }}")


@pytest.mark.costs("reads all robots of the catalogue")
def test_the_list_names_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots"]) == 0
    shown = capsys.readouterr().out
    assert [name for name in (*published_joints(), *published_gears()) if name not in shown] == []


def test_gears_stiffen_as_their_makers_say() -> None:
    """Slopes grow with the torque, the size and the ratio; of a size all ratios have the same corners."""
    gears = published_gears()
    assert len(gears) == 2 * (5 * 1 + 8 * 5)
    for name, gear in gears.items():
        first, second, third, *torques, ratio = (number["value"] for number in gear.numbers.values())
        assert 0.0 < first < second < third < 2.2 * first
        assert 0.0 < torques[0] < torques[1] < 4.0 * torques[0]
        assert name.endswith(f"-{ratio:g}")
    values = {name: gear.numbers["second_stiffness"]["value"] for name, gear in gears.items()}
    sizes = [values[f"CSG-{size}-100"] for size in (14, 17, 20, 25, 32, 40, 50, 58)]
    assert sizes == sorted(sizes)
    assert values["CSG-25-30"] < values["CSG-25-50"] < values["CSG-25-100"] == values["CSF-25-160"]


def test_a_joint_takes_the_curve_of_its_gear(tmp_path: Path) -> None:
    robot = arm(tmp_path, 'gear = "csg-25-100"\nmotor = { rotor_inertia = 1e-4 }')
    assert robot.nominal["gear_ratio"] == 100.0
    assert robot.nominal["stiffness"] == pytest.approx(48.0 / (14.0 / 31e3 + 34.0 / 50e3))
    assert unnamed(robot["third_stiffness"].source, "Harmonic Drive") == []
    robot.with_values({"stiffness": 4e4, "first_stiffness": 3e4}).save(tmp_path / "saved.toml")
    again = fh.load_robot(tmp_path / "saved.toml")
    assert again.nominal == robot.nominal | {"stiffness": 4e4, "first_stiffness": 3e4}
    robot = arm(tmp_path, 'gear = "CSG-25-100"\nspring = { damping = 2.0 }\nmotor = { motor_inertia = 1.0 }')
    assert "gear_ratio" not in robot.nominal  # the motor is stated behind the gear
    assert robot.nominal["damping"] == 2.0
    with refused_with(InvalidInput, "gear", "CSG-25-50") as refusal:
        arm(tmp_path, 'gear = "CSG-25-60"\nmotor = { motor_inertia = 1.0 }')
    arm(tmp_path, f"{str(refusal.value).split('try:')[1].strip()}\nmotor = {{ motor_inertia = 1.0 }}")
