"""Sizes of columns: times beside vibrations, positions beside ranges, two sensors of a joint beside each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.identification.doctor import refuse_unusable
from flexhinf.identification.log import FileColumn
from flexhinf.identification.vibrations import vibration_periods


def log_of(scale: float = 1.0, gear: float = 1.0, rows: int = 400) -> fh.Log:
    """Motor and voltage of a slow motion, the times and the positions in another unit."""
    times = 0.01 * np.arange(rows)
    position = gear * 0.5 * np.sin(2.0 * times)
    names = {"input": ("motor_voltage",), "output": ("motor_position",)}
    return fh.Log(scale * times, np.sin(times), position, names=names)


def arm() -> fh.Robot:
    return fh.load_robot("vertical-rig")


def faults(robot: fh.Robot, log: fh.Log) -> list[fh.LogFinding]:
    return [finding for finding in fh.examine(log, robot, model=False) if finding.severity == "fault"]


def test_what_is_plausible_is_taken() -> None:
    assert faults(arm(), log_of()) == []


@pytest.mark.parametrize("scale", [1e3, 1e6, 1e-3, 1e-6])
def test_times_in_another_unit_are_named(scale: float) -> None:
    found = faults(arm(), log_of(scale))[0]
    assert unnamed(found.text, "times", "--time", "[us]") == []


@pytest.mark.parametrize("counts", [256, 2048, 100_000])
def test_counts_of_an_encoder_are_named_and_the_advice_has_its_column(counts: int) -> None:
    """As fast as they change, it is not the times that are wrong; and no filter is to see them."""
    counted = log_of(gear=counts / (2.0 * np.pi))
    columns = {"motor_position": FileColumn("enc")}
    whole = replace(counted, outputs=np.rint(counted.outputs), columns=columns)
    with refused_with(
        InvalidInput, "'motor_position'", "counts", '--column "motor_position=enc [0.00306796]"'
    ):
        refuse_unusable(fh.examine(whole, arm(), model=False))
    assert faults(arm(), replace(whole, outputs=whole.outputs * 2 * np.pi / counts)) == []


def test_positions_before_a_gear_are_named() -> None:
    limited = fh.load_robot("planar-two-link")
    names = {"input": limited.plant().inputs, "output": ("motor_position_elbow",)}
    log = log_of(gear=80.0)
    wide = fh.Log(10.0 * log.times, np.zeros((len(log), 2)), log.outputs, names=names)
    found = faults(limited, wide)[0]
    assert found.refused
    assert unnamed(found.text, "'motor_position_elbow'", "gear") == []


SLOW = 0.01 * np.arange(2000)


def two_sensors(motor: float = 1.0, link: float = 1.0) -> fh.Log:
    slow = np.sin(0.5 * SLOW)
    noise = 1e-4 * np.random.default_rng(0).normal(size=(2, len(slow)))
    outputs = np.column_stack([motor * (slow + noise[0]), link * (slow + noise[1])])
    names = {"input": ("drive_torque",), "output": ("motor_position", "link_position")}
    return fh.Log(SLOW, np.sin(SLOW), outputs, names=names)


@pytest.mark.parametrize(
    ("motor", "link", "signal", "words"),
    [
        (100.0, 1.0, "motor_position", ("100 times", "gear", "[0.01]")),
        (-100.0, 1.0, "motor_position", ("opposite", "[-0.01]")),
        (180.0 / np.pi, 1.0, "motor_position", ("deg", "[0.0174533]")),
        (1.0, 180.0 / np.pi, "link_position", ("deg", "[0.0174533]")),
        (-1.0, 1.0, "motor_position", ("other sign", "[-1]")),
    ],
)
def test_two_sensors_of_a_joint_that_disagree_are_named_with_what_puts_them_right(
    motor: float, link: float, signal: str, words: tuple[str, ...]
) -> None:
    log = two_sensors(motor, link)
    found = faults(arm(), log)
    assert [one.signal for one in found] == [signal]
    assert unnamed(found[0].text, *words) == []
    factor = float(found[0].advice.split("[")[1].split("]")[0])
    k = log.names["output"].index(signal)
    right = log.outputs * np.where(np.arange(2) == k, factor, 1.0)
    assert faults(arm(), replace(log, outputs=right)) == []


def test_a_link_that_swings_against_its_motor_has_no_other_sign() -> None:
    """Above the vibration both move against each other, and slowly the link follows."""
    fast = 0.2 * np.sin(40.0 * SLOW)
    log = two_sensors()
    assert faults(arm(), replace(log, outputs=log.outputs + np.column_stack([fast, -fast]))) == []
    assert faults(arm(), replace(log, outputs=np.column_stack([fast, -fast]))) == []


@pytest.mark.parametrize("size", [30.0 / np.pi, 180.0 / np.pi, -1.0])
def test_a_velocity_is_compared_with_the_slope_of_its_position(size: float) -> None:
    outputs = np.column_stack([np.sin(0.5 * SLOW), size * 0.5 * np.cos(0.5 * SLOW)])
    names = {"input": ("drive_torque",), "output": ("motor_position", "motor_velocity")}
    log = fh.Log(SLOW, np.sin(SLOW), outputs, names=names)
    found = faults(arm(), log)
    assert [one.signal for one in found] == ["motor_velocity"]
    assert float(found[0].advice.split("[")[1].split("]")[0]) == pytest.approx(1.0 / size, rel=0.02)


def test_a_voltage_in_millivolts_is_beyond_what_the_drive_can() -> None:
    robot = replace(arm(), effort_limits=(2.0,))
    log = replace(two_sensors(), inputs=1e3 * np.sin(SLOW))
    found = faults(robot, log)
    assert [one.signal for one in found] == ["drive_torque"]
    assert unnamed(found[0].text, "2", "mN·m") == []


def test_periods_of_vibrations_are_those_of_the_spring_between_two_inertias() -> None:
    """A rig with a motor as heavy as its link: ω² = K (1/I + 1/J), with the gravity of the hanging link beside."""
    robot = fh.load_robot("paper")
    p = robot.nominal
    expected = np.sqrt(p["stiffness"] * (1.0 / p["link_inertia"] + 1.0 / p["motor_inertia"]))
    assert 2.0 * np.pi / vibration_periods(robot)[0] == pytest.approx(expected, rel=0.05)
