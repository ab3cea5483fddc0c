"""Measurements beyond their limits are missing: in Python, in a loop, and in exported C with the same bits."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.export import protected
from flexhinf.robot import MuJoCoPlant

# Loops and libraries of some samples: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

LIMITS = ((-1.0, -1.5), (1.0, 1.5), (5.0, math.inf))
POSE = 0.3


def made(limits: object = LIMITS, gate: float | None = None, **options: object) -> fh.Controller:
    return arm_controller(
        kind=fh.ExtendedKalmanFilter, pose=POSE, measured=("link_position", "motor_position"), q=1e-6, r=1e-6,
        filter={"gate": gate}, measurement_limits=limits, **options,
    )  # fmt: skip


@pytest.fixture(scope="module")
def measured() -> np.ndarray:
    """Outputs (300, 2) of a loop, without a spike."""
    run = loop(made(None))
    return np.array(run.data["output"])[:300]


def loop(controller: fh.Controller) -> Any:
    arm = fh.load_robot("paper")
    plant = arm.plant(("link_position", "motor_position"))
    start, _ = arm.operating_point(POSE)
    return fh.Loop(plant, controller).run(fh.Step(0.5), duration=0.4, noise=1e-4, initial_state=start)


def spiked(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """With spikes, a sensor that sticks far away, and a range that is left; and the same with NaN in their places."""
    bad, gaps = y.copy(), y.copy()
    for k in range(3, len(y), 17):
        bad[k, 0], gaps[k, 0] = y[k, 0] + 0.1, math.nan
    for k in range(5, len(y), 41):
        bad[k, 1], gaps[k, 1] = 1.6, math.nan
    bad[200:204, 0], gaps[200:204, 0] = 0.9, math.nan
    bad[210:213], gaps[210:213] = [1.2, -1.7], math.nan
    return bad, gaps


@pytest.mark.ci("compiles two controllers")
def test_limits_that_are_kept_change_no_bit() -> None:
    for pieces in (False, True):
        plain, checked = made(None), made()
        if pieces:
            plain, checked = plain.in_pieces(), checked.in_pieces()
        runs = [loop(one) for one in (plain, checked)]
        assert np.array_equal(runs[0].data["input"], runs[1].data["input"])
        assert not checked.rejected.any()


@pytest.mark.ci("compiles a controller with its limits")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("pieces", [False, True])
@pytest.mark.parametrize("gate", [None, 0.9999])
def test_what_is_implausible_is_missing_and_counted(
    measured: np.ndarray, pieces: bool, gate: float | None
) -> None:
    """The oracle is a controller without limits, whose sensor gave nothing there."""
    checked, plain = made(gate=gate), made(None, gate=gate)
    if pieces:
        checked, plain = checked.in_pieces(), plain.in_pieces()
    bad, gaps = spiked(measured)
    for y, gap in zip(bad, gaps, strict=True):
        assert np.array_equal(checked.step(y, [0.5]), plain.step(gap, [0.5]))
    wrong = (bad != gaps).sum(axis=0)
    assert (checked.rejected - wrong).tolist() == plain.rejected.tolist()


@pytest.mark.ci("compiles two controllers and a library")
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_exported_c_does_the_same(
    measured: np.ndarray, build: Callable[..., object], real: str, tmp_path: Path
) -> None:
    controller = made()
    bad, _ = spiked(measured)
    bad[:4, 0], bad[:3, 1] = 1.5, -9.0  # nothing plausible: it waits
    compiled = build(controller, real)
    r, there = np.full((len(bad), 1), 0.5), np.ones(len(bad))
    u, x, codes = compiled.replay(bad, r, there, 1, 4)  # type: ignore[attr-defined]
    expected = made()
    inputs, estimates = [], []
    for y in bad:
        inputs.append(expected.step(y, [0.5]))
        estimates.append(expected.estimate)
    assert not np.isfinite(estimates[:3]).any()  # Python has none yet, and C that of the start
    estimates[:3] = [expected.estimator.initial[0]] * 3  # type: ignore[union-attr]
    waiting, predicted, ok = 7, 5, 0
    assert codes[:3].tolist() == [waiting] * 3
    assert codes[3] == ok
    assert codes[210:213].tolist() == [predicted] * 3
    assert set(codes[4:].tolist()) == {ok, predicted}
    if real == "double":
        assert np.array_equal(u, inputs)
        assert np.array_equal(x, estimates)
    else:
        np.testing.assert_allclose(u, inputs, atol=1e-2)
    if real == "double":
        library = fh.load_compiled(fh.compile_controller(controller, tmp_path / "arm.so"))
        for y in bad:
            library.step(y, [0.5])
        assert library.rejected.tolist() == expected.rejected.tolist()


@pytest.mark.ci("compiles a controller")
def test_a_sensor_that_stays_away_stops_the_controller(build: Callable[..., object]) -> None:
    """The watchdog counts samples in which nothing is plausible; ten are predicted over."""
    x = fh.load_robot("paper").operating_point(POSE)[0]
    y = np.tile(x[[0, 2]], (30, 1))
    y[5:] = 9.0
    compiled = build(made())
    _, _, codes = compiled.replay(y, np.full((30, 1), POSE), np.ones(30), 1, 4)  # type: ignore[attr-defined]
    assert codes.tolist() == [0] * 5 + [5] * 10 + [6] * 15


def test_a_step_that_is_longer_than_the_rate_is_believed_in_time() -> None:
    """The allowed move grows with the samples since the last plausible one: 0.098 rad at 5 rad/s take 20 samples."""
    one = made()
    x = fh.load_robot("paper").operating_point(POSE)[0]
    for k in range(60):
        one.step([x[0] + 0.098 * (k >= 10), x[2]], [POSE])
    assert one.rejected.tolist() == [19, 0]


def test_a_loop_waits_for_something_plausible_as_the_step_does() -> None:
    controller = made(((0.4, 0.4), (1.0, 1.5), math.inf))
    run = loop(controller)  # the arm rests at 0.3, and nobody moves it
    assert np.isnan(np.array(run.data["estimate"])).all()
    assert np.unique(np.array(run.data["input"])).size == 1
    stepped = controller.fresh()
    for y in np.array(run.data["output"])[:20]:
        assert np.array_equal(stepped.step(y, [0.5]), np.array(run.data["input"])[0])
    assert np.isnan(stepped.estimate).all()


def test_they_are_saved(tmp_path: Path, measured: np.ndarray) -> None:
    one = made()
    one.save(tmp_path / "controller")
    again = fh.load_controller(tmp_path / "controller")
    bad, _ = spiked(measured)
    for y in bad:
        assert np.array_equal(one.step(y, [0.5]), again.step(y, [0.5]))
    assert again.rejected.tolist() == one.rejected.tolist()
    assert again.rejected.any()


def test_those_of_a_robot() -> None:
    arm = fh.load_robot("scara")
    sensors = ("link_position", "motor_position", "motor_velocity")
    kind, noise = fh.ExtendedKalmanFilter, {"q": 1e-6, "r": 1e-8}
    plain = arm_controller(arm, kind, pose=arm.home, measured=sensors, limit=100.0, **noise)
    made, unchecked = protected(plain, arm)
    assert not unchecked
    assert made.measurement_limits is not None
    rows = dict(zip(made.measured, np.transpose(made.measurement_limits).tolist(), strict=True))
    noise = 6e-4
    low, high, rate = rows["link_position_quill"]
    assert (low, high) == pytest.approx((-0.009 - noise, 0.189 + noise))  # a twentieth of the range more
    assert rate == pytest.approx(2.0 + math.sqrt(2.0) * noise / 1e-3)  # twice the speed
    twist = 2.0 * 100.0 / arm["stiffness_elbow"].interval[0] + noise  # at the controller's limit, N·m
    assert rows["motor_position_elbow"] == pytest.approx(
        [-2.75 - twist, 2.75 + twist, 12.0 + math.sqrt(2.0) * 0.6]
    )
    assert rows["motor_velocity_wrist"] == pytest.approx([-20.0 - noise, 20.0 + noise, math.inf])
    assert protected(made, arm)[0].measurement_limits == made.measurement_limits  # it has limits of its own


SENSORS = ("link_position", "motor_position", "link_velocity", "motor_velocity", "joint_torque")


def with_all_sensors(robot: str, limit: float | None) -> tuple[fh.Controller, fh.Robot]:
    """Of robots whose files state ranges of positions alone."""
    arm = fh.load_robot(robot)
    kind, noise = fh.ExtendedKalmanFilter, {"q": 1e-6, "r": 1e-12}
    return arm_controller(arm, kind, pose=arm.home, measured=SENSORS, limit=limit, **noise), arm


@pytest.mark.oracle
def test_every_sensor_has_a_check_that_a_wild_robot_keeps() -> None:
    """A frame that was off by a turn moved an input by 50 V. The oracle is MuJoCo's robot under the whole voltage,
    which changes its sign at random; its links meet no end stop, so that ranges of positions are left out."""
    pytest.importorskip("mujoco")
    controller, arm = with_all_sensors("planar-two-link", 48.0)
    made, _ = protected(controller, arm)
    assert made.measurement_limits is not None
    lower, upper, rate = made.measurement_limits
    wild, rng, rows, u = MuJoCoPlant(arm, SENSORS), np.random.default_rng(3), [], np.zeros(2)
    wild.reset(arm.operating_point(arm.home)[0])
    for k in range(1_500):
        u = rng.choice([-48.0, 0.0, 48.0], 2) if k % 80 == 0 else u
        rows.append(wild.output())
        wild.step(u, [], 1e-3)
    y = np.array(rows)
    moved = np.abs(np.diff(y, axis=0)).max(axis=0)
    assert (np.abs(y)[:, 4:].max(axis=0) <= upper[4:]).all()
    assert (np.abs(y[:, 2:4] - y[:, :2]).max(axis=0) <= upper[2:4] - upper[:2]).all()
    assert (moved <= 1e-3 * rate).all()
    assert (1e-3 * rate[:4] <= 0.04).all()
    assert (upper[:4] - lower[:4] <= 3.0 * math.pi).all()


def test_what_cannot_be_checked_is_refused() -> None:
    arm = fh.load_robot("paper")
    law = fh.linear_law(arm.problem(), gamma=math.inf)
    with refused_with(InvalidInput, "estimator", "measurement_limits"):
        fh.Controller(law, None, 1e-3, measurement_limits=LIMITS)
    for wrong in (1.0, (1.0, 2.0), ((1.0, 1.0), (0.5, 1.0), 1.0), (-1.0, 1.0, -1.0), ([1.0] * 3, 2.0, 1.0)):
        with refused_with(InvalidInput, "measurement_limits"):
            made(wrong)
    with refused_with(InvalidInput, "no robot"):
        protected(made(None), None)
    with refused_with(InvalidInput, "no estimator"):
        protected(fh.Controller(law, None, 1e-3), arm)


def test_a_sensor_without_a_check_is_named_with_what_is_to_be_stated() -> None:
    """A torque has no back-EMF, and one without a limit twists a spring at will."""
    controller, arm = with_all_sensors("spatial-three-link", 40.0)
    made, unchecked = protected(controller, arm)
    for name in ("motor_velocity_elbow", "speed_limit", "--peak-speed", "shoulder"):
        assert name in unchecked
    assert "joint_torque" not in unchecked
    assert np.isinf(made.measurement_limits[2][[0, 3]]).all()  # type: ignore[index]
    _, unchecked = protected(controller, arm, np.array([2.0, 3.0, math.inf]))
    assert "link_position_elbow" in unchecked
    assert "shoulder" not in unchecked
    made, unchecked = protected(controller, arm, np.array([2.0, 3.0, 4.0]))
    assert not unchecked
    assert np.isfinite(made.measurement_limits[2][[0, 1, 2, 3, 4, 5]]).all()  # type: ignore[index]
    assert "inf" not in made.summary()["measurements"]
    free, _ = with_all_sensors("spatial-three-link", None)
    assert "joint_torque_base" in protected(free, arm, np.ones(3))[1]
