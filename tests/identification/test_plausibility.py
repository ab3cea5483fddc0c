"""Units that cannot be right are refused: times beside vibrations, positions beside the joints' ranges."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.identification.plausibility import check_plausible, vibration_periods


def log_of(scale: float = 1.0, gear: float = 1.0, rows: int = 400) -> fh.Log:
    """Motor and voltage of a slow motion, the times and the positions in another unit."""
    times = 0.01 * np.arange(rows)
    position = gear * 0.5 * np.sin(2.0 * times)
    names = {"input": ("motor_voltage",), "output": ("motor_position",)}
    return fh.Log(scale * times, np.sin(times), position, names=names)


def arm() -> fh.Robot:
    return fh.load_robot("vertical-rig")


def test_what_is_plausible_is_taken() -> None:
    check_plausible(arm(), log_of())


@pytest.mark.parametrize("scale", [1e3, 1e6, 1e-3])
def test_times_in_another_unit_are_refused(scale: float) -> None:
    with refused_with(InvalidInput, "times", "time='stamp [us]'"):
        check_plausible(arm(), log_of(scale))


@pytest.mark.parametrize("counts", [256, 2048, 100_000])
def test_counts_of_an_encoder_are_named_and_the_advice_has_its_column(counts: int) -> None:
    """As fast as they change, it is not the times that are wrong."""
    counted = log_of(gear=counts / (2.0 * np.pi))
    whole = fh.Log(counted.times, counted.inputs, np.rint(counted.outputs), names=counted.names)
    with refused_with(
        InvalidInput, "'motor_position'", "counts", "columns={'motor_position': 'enc [0.00306796]'}"
    ):
        check_plausible(arm(), whole, {"motor_position": "enc"})
    check_plausible(
        arm(), fh.Log(whole.times, whole.inputs, whole.outputs * 2 * np.pi / counts, names=whole.names)
    )


def test_positions_before_a_gear_are_refused() -> None:
    limited = fh.load_robot("planar-two-link")
    names = {"input": limited.plant().inputs, "output": ("motor_position_elbow",)}
    log = log_of(gear=80.0)
    wide = fh.Log(10.0 * log.times, np.zeros((len(log), 2)), log.outputs, names=names)
    with refused_with(InvalidInput, "'motor_position_elbow'", "gear"):
        check_plausible(limited, wide)


def test_periods_of_vibrations_are_those_of_the_spring_between_two_inertias() -> None:
    """A rig with a motor as heavy as its link: ω² = K (1/I + 1/J), with the gravity of the hanging link beside."""
    robot = fh.load_robot("paper")
    p = robot.nominal
    expected = np.sqrt(p["stiffness"] * (1.0 / p["link_inertia"] + 1.0 / p["motor_inertia"]))
    assert 2.0 * np.pi / vibration_periods(robot)[0] == pytest.approx(expected, rel=0.05)
