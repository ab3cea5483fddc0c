"""A log of a real actuator with a spring and a free output: what its motor side tells of the joint, and what not.

The file stays outside of the repository: FLEXHINF_DATA names its folder.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np
import pytest

import flexhinf as fh

pytestmark = pytest.mark.nightly("a real actuator's log, which is no part of the repository")

NAME = "series_elastic_actuator_100hz.csv"

#: Turns of the motor for one of the link.
GEAR = 272.22

#: Samples of a prediction: 0.1 s.
AHEAD = 10


@pytest.fixture(scope="module")
def columns():
    folder = os.environ.get("FLEXHINF_DATA")
    if not folder or not (Path(folder) / NAME).is_file():
        pytest.skip(f"FLEXHINF_DATA names no folder with {NAME}")
    with (Path(folder) / NAME).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_the_doctor_sees_the_gear_between_both_encoders_and_the_hall_sensors_of_the_motor(columns):
    """The data sheet's 272.22, and six counts in a turn of a motor with one pair of poles."""
    names = {"input": ("motor_voltage",), "output": ("motor_position", "link_position")}
    outputs = np.column_stack([columns["motor_position"], columns["position"]])
    volts = columns["pwm_command"] * columns["voltage"]
    log = fh.Log(columns["receive_time"] - columns["receive_time"][0], volts, outputs, names=names)
    found = fh.examine(log)
    faults = [one for one in found if one.severity == "fault"]
    assert [(one.kind, one.signal) for one in faults] == [("scale", "motor_position")]
    assert 1.0 / float(faults[0].advice.split("[")[1].split("]")[0]) == pytest.approx(GEAR, rel=0.02)
    (step,) = [one for one in found if one.kind == "step" and one.signal == "motor_position"]
    assert "1.047" in step.what
    right = fh.Log(log.times, volts, outputs * [1.0 / GEAR, 1.0], names=names)
    assert [one for one in fh.examine(right) if one.severity != "note"] == []


def joint():
    """A motor behind a gear and a spring, driven by a voltage; per motor inertia, as no torque is measured."""
    return fh.Plant(
        lambda x, u, d, p: np.array([
            x[1], (p.stiffness * (x[2] - x[0]) + p.damping * (x[3] - x[1]) + d[0]) / p.link_inertia,
            x[3], p.drive * u[0] - p.loss * x[3] - p.dry * np.tanh(x[3] / 0.05) + d[1],
        ]),
        lambda x, u, p: x[2:3],
        ("link_position", "link_velocity", "motor_position", "motor_velocity"), ("voltage",),
        ("link_torque", "motor_acceleration"),
        {"stiffness": 40.0, "damping": 0.1, "link_inertia": 1e-3, "drive": 60.0, "loss": 100.0, "dry": 5.0},
        ("motor_position",),
    )  # fmt: skip


@pytest.fixture(scope="module")
def halves(columns):
    times = columns["receive_time"] - columns["receive_time"][0]
    volts = (columns["pwm_command"] * columns["voltage"])[:, None]
    motor = columns["motor_position"][:, None] / GEAR
    middle = len(times) // 2
    return [(times[s] - times[s][0], volts[s], motor[s]) for s in (slice(middle), slice(middle, None))]


@pytest.fixture(scope="module")
def found(halves):
    return fh.identify(joint(), halves[0], ("drive", "loss", "dry", "stiffness", "link_inertia"))


def test_the_motor_side_tells_the_drive_and_neither_spring_nor_link(found):
    assert all(np.isfinite(found.standard_errors[name]) for name in ("drive", "loss"))
    hidden = {name for each in found.unidentifiable for name in each.direction}
    assert hidden == {"stiffness", "link_inertia", "dry"}
    assert not found.consistent  # and it says so: least squares finds more in the log
    assert found.values["drive"] / found.values["loss"] == pytest.approx(0.57, rel=0.05)  # rad/s of a volt


def least_squares(first, second):
    """Positions `AHEAD` samples on, of the second half, by a difference equation that is fitted to the first."""
    (_, u, y), (_, v, z) = first, second
    table = np.column_stack([y[1:-1], y[:-2], u[1:-1], u[:-2], np.ones(len(y) - 2)])
    weights, ends = np.linalg.lstsq(table, y[2:, 0], rcond=None)[0], []
    for k in range(2 * AHEAD, len(z), AHEAD):
        now, before = z[k - AHEAD, 0], z[k - AHEAD - 1, 0]
        for j in range(k - AHEAD, k):
            now, before = weights @ [now, before, v[j, 0], v[j - 1, 0], 1.0], now
        ends.append(now)
    return np.array(ends)


def test_the_second_half_is_predicted_from_the_first(found, halves):
    """Much better than by standing still; not as well as by least squares, which has a constant for what is missing."""
    times, volts, motor = halves[1]
    sparse = np.full_like(motor, np.nan)
    sparse[::AHEAD] = motor[::AHEAD]
    filter = found.filter(0.01)
    start = fh.ExtendedKalmanFilter(
        filter.plant,
        0.01,
        filter.process_noise,
        filter.measurement_noise,
        [motor[0, 0], 0.0, motor[0, 0], 0.0],
        1.0,
    )
    places = np.arange(2 * AHEAD, len(motor), AHEAD)
    ours = fh.filter_log(start, (times, volts, sparse)).prediction.values[places, 0]
    errors = {
        name: float(np.sqrt(np.mean((predicted - motor[places, 0]) ** 2)))
        for name, predicted in (
            ("ours", ours), ("least squares", least_squares(*halves)), ("standing", motor[places - AHEAD, 0]),
        )
    }  # fmt: skip
    assert errors["ours"] < 0.05 * errors["standing"]
    assert errors["ours"] < 1.5 * errors["least squares"]


def test_the_link_is_found_to_a_step_of_the_motor_s_encoder(found, halves, columns):
    times, volts, motor = halves[1]
    data = fh.filter_log(found.filter(0.01), (times, volts, motor))
    link, first = columns["position"], len(columns["position"]) // 2
    offset = np.mean(columns["motor_position"][:first] / GEAR - link[:first])
    errors = (data.estimate.values[:, 0] - offset - link[first:])[50:]
    assert np.sqrt(np.mean(errors**2)) < 0.008
    speed = (data.estimate.values[:, 1] - columns["velocity"][first:])[50:]
    assert np.sqrt(np.mean(speed**2)) < 0.1 * np.sqrt(np.mean(columns["velocity"] ** 2))
