"""Sensors of their own period, delay, noise and quantisation in a loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.builders import PlantBox, forced_pendulum, linear_law
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput

# Kernels that run once each: 1 s instead of 3 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

PERIOD = 0.01


PLANT = forced_pendulum(("encoder", "gyro"), groups={"all": ("encoder", "gyro")})
#: About 0.3 rad, which 4 sin 0.3 holds.
SPRING = linear_law(PLANT, [-6.0, -3.0, -4.0], [0.3, 0.0], [4.0 * np.sin(0.3)], ("angle",))
SENSORS = (
    fh.Sensor("gyro", noise=1e-2, delay=2 * PERIOD),
    fh.Sensor("encoder", period=4 * PERIOD, delay=PERIOD, noise=1e-3, quantisation=2e-3),
)


def controller(sensors=SENSORS, **options):
    estimator = fh.UnscentedKalmanFilter(
        PLANT, PERIOD, [1e-8, 1e-5], None, [0.3, 0.0], [1e-4, 1e-4], form="square_root", sensors=sensors
    )
    return fh.Controller(SPRING, estimator, PERIOD, **options)


PARTS = 5


def expected_outputs(run, noise):
    """By the sensors' definition, from the true states and the noise of each sample."""
    y = run.signals["state"] + noise
    y[:, 0] = 2e-3 * np.floor(y[:, 0] / 2e-3 + 0.5)
    count = len(y)
    late = np.vstack([y[:1], y[:1], y])
    seen = np.column_stack([late[1 : count + 1, 0], late[:count, 1]])
    seen[np.arange(count) % 4 != 0, 0] = np.nan
    return seen


@pytest.mark.oracle
def test_what_is_measured_is_what_the_sensors_say():
    loop = fh.Loop(PLANT, controller(), sensors=SENSORS)
    run = loop.run(disturbance={"wind": 0.2}, duration=0.5, seed=3)
    assert run.status == "completed"
    from flexhinf.loop.simulation.inputs import sample_noise

    noise = sample_noise((1e-3, 1e-2), 3, len(run.time), ("encoder", "gyro"))
    np.testing.assert_allclose(run.signals["output"], expected_outputs(run, noise), atol=1e-12)
    quiet = loop.run(noise=0.0, disturbance={"wind": 0.2}, duration=0.5)
    np.testing.assert_allclose(quiet.signals["output"], expected_outputs(quiet, 0.0), atol=1e-12)


@pytest.mark.ci("compiles two loops of a filter with late states")
@pytest.mark.oracle
@pytest.mark.parametrize("latency", [0, 1])
def test_the_controller_step_by_step_makes_the_same_run(latency):
    control = controller(latency=latency)
    run = fh.Loop(PLANT, control, sensors=SENSORS).run(disturbance={"wind": 0.2}, duration=0.6, seed=1)
    stepped = control.fresh()
    assert np.isnan(run.signals["output"]).mean() > 0.3
    assert np.isfinite(run.signals["output"][0]).all()
    for y, u, estimate in zip(*(run.signals[name] for name in ("output", "input", "estimate"))):
        np.testing.assert_allclose(stepped.step(y), u, rtol=1e-8)
        if np.isfinite(stepped.estimate).all():
            np.testing.assert_allclose(stepped.estimate, estimate, rtol=1e-7, atol=1e-9)


@pytest.mark.ci("a kernel of lanes")
@pytest.mark.oracle
@pytest.mark.parametrize("delayed", [True, False])
def test_a_black_box_and_an_ensemble_have_the_same_sensors(delayed):
    sensors = SENSORS if delayed else [replace(sensor, delay=0.0) for sensor in SENSORS]
    control = controller(sensors)
    loop = fh.Loop(PLANT, control, sub_steps=PARTS, sensors=sensors)
    given = {"disturbance": {"wind": 0.2}, "duration": 0.6}
    run = loop.run(**given, seed=5)
    box = fh.Loop(PlantBox(PLANT, PARTS, [0.3, 0.0]), control, sensors=sensors).run(**given, seed=5)
    np.testing.assert_allclose(box.signals["output"], run.signals["output"], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(box.signals["input"], run.signals["input"], rtol=1e-7)
    names = ("output.encoder", "output.gyro", "input.torque")
    several = loop.ensemble(**given, kept=names, instants=np.arange(61)).run([{}] * 9, seeds=[5] * 9, lanes=8)
    kept = np.column_stack([run.signals["output"], run.signals["input"]])
    for row in several.kept:
        np.testing.assert_allclose(row, kept, rtol=1e-7, atol=1e-9)


@pytest.mark.ci("two filters of late states")
@pytest.mark.oracle
def test_a_delay_that_the_filter_knows_costs_less_than_one_that_it_does_not():
    """Angle 40 ms late, of an arm that follows a sine: the error of the estimate, with the delay known and not."""
    late = (fh.Sensor("encoder", noise=1e-4, delay=4 * PERIOD), fh.Sensor("gyro", noise=1.0))
    prompt = (fh.Sensor("encoder", noise=1e-4), fh.Sensor("gyro", noise=1.0))
    error = {}
    for name, known in (("known", late), ("unknown", prompt)):
        run = fh.Loop(PLANT, controller(known), sensors=late).run(
            reference={"angle": fh.Sine(0.3, 0.5)}, duration=4.0
        )
        error[name] = np.sqrt(
            np.mean(np.square(run.signal("estimate", "speed") - run.signal("state", "speed"))[100:])
        )
    assert error["known"] < 0.6 * error["unknown"]


def test_a_run_without_noise_of_its_own_has_that_of_the_sensors():
    quantised = (fh.Sensor("all", quantisation=1e-3),)
    loop = fh.Loop(PLANT, controller((fh.Sensor("all", noise=1e-3),)), sensors=quantised)
    run = loop.run(duration=0.2)
    np.testing.assert_allclose(
        run.signals["output"] / 1e-3, np.round(run.signals["output"] / 1e-3), atol=1e-9
    )
    assert run.settings["noise"] == "none"
    noisy = fh.Loop(PLANT, loop.controller, sensors=SENSORS)
    assert "encoder" not in str(noisy.run(duration=0.1).settings["noise"])
    assert "sensor delays" in noisy.summary()
    assert noisy.with_plant(PLANT.with_parameters(pull=3.0)).channel == noisy.channel


def test_sensors_that_do_not_fit_the_loop_are_refused():
    with refused_with(InvalidInput, "quantisation", "sensors"):
        fh.Loop(PLANT, controller(), quantisation=1e-3, sensors=SENSORS)
    with refused_with(InvalidInput, "estimator"):
        fh.Loop(PLANT, fh.Controller(SPRING, None, PERIOD), sensors=(
            fh.Sensor("angle", period=2 * PERIOD, noise=1e-3), fh.Sensor("speed", noise=1e-3),
        ))  # fmt: skip
    with refused_with(InvalidInput, "gyro"):
        fh.Loop(PLANT, controller(), sensors=fh.Sensor("encoder", noise=1e-3))
    with refused_with(InvalidInput, "python-control"):
        fh.Loop(PLANT, controller(), sensors=SENSORS).to_control()
