"""The law in error coordinates about a moving reference, against plain NumPy and against the fixed point."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from tests.builders import PlantBox
from tests.loop.conftest import moving_commands as commands
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.hinf import solve_hji
from flexhinf.loop import Controller, Loop, Samples, Sine, Step
from flexhinf.loop.controller import controller
from flexhinf.robot import paper_arm

# Kernels that run once each: 2 s instead of 5 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

H = 1e-2


def plain_law(gain, states, positions, references, limit):
    """u of every sample: error coordinates, trapezoidal integral of the error, back-calculation."""
    integral, inputs, before = 0.0, [], None
    for x, position, r in zip(states, positions, references):
        error = position - r[0]
        growth = 0.0 if before is None else 0.5 * H * (before + error)
        wanted = r[4:] + gain @ np.append(x - r[:4], integral + growth)
        u = np.clip(wanted, -limit, limit)
        integral += growth - 0.2 * (wanted - u)[0] / gain[0, 4]
        inputs.append(u)
        before = error
    return np.array(inputs)


@pytest.mark.oracle
@pytest.mark.parametrize("limit", [np.inf, 1.8])
def test_state_feedback_of_a_linear_law(made, limit):
    plant, law = made.two_inputs()
    control = Controller(law, None, H, None if limit == np.inf else limit, moving=True)
    run = Loop(plant, control).run(commands, {"push": 0.7}, duration=3.0, initial_state=[0.5, 0, 0, 0.2])
    r = commands(run.time)
    np.testing.assert_allclose(run.signals["reference"], r, atol=1e-14)
    x, integral, before, states, inputs = np.array([0.5, 0, 0, 0.2]), 0.0, None, [], []
    for k in range(len(r)):
        error = x[0] - r[k, 0]
        growth = 0.0 if before is None else 0.5 * H * (before + error)
        wanted = r[k, 4:] + law.gain @ np.append(x - r[k, :4], integral + growth)
        u = np.clip(wanted, -limit, limit)
        integral += growth - made.taken_back(law.gain[:, 4], wanted - u, limit)
        states.append(x)
        inputs.append(u)
        rate = np.array([u[0] + 0.7, 2.0 * u[1]])  # exact between samples
        x = x + H * np.array([x[1], rate[0], x[3], rate[1]])
        x = x + 0.5 * H**2 * np.array([rate[0], 0.0, rate[1], 0.0])
        before = error
    np.testing.assert_allclose(run.signals["input"], inputs, atol=1e-10)
    np.testing.assert_allclose(run.signals["state"], states, atol=1e-10)
    assert np.any(np.abs(run.signals["input"]) == limit) == np.isfinite(limit)


@pytest.mark.oracle
def test_output_feedback_integrates_the_error_of_the_measurement(made):
    plant, law = made.two_inputs()
    plant = replace(plant, outputs=("a", "b"))
    ukf = UnscentedKalmanFilter(plant, H, 1e-4, 1e-4, np.zeros(4), 1e-2)
    run = Loop(plant, Controller(law, ukf, H, 3.0, moving=True, latency=0)).run(
        commands, noise=1e-2, duration=2.0
    )
    s = run.signals
    inputs = plain_law(law.gain, s["estimate"], s["output"][:, 0], s["reference"], 3.0)
    np.testing.assert_allclose(s["input"], inputs, atol=1e-11)
    assert np.abs(s["output"][:, 0] - s["estimate"][:, 0]).max() > 1e-3


@pytest.mark.oracle
def test_perfect_feedforward_needs_no_feedback(made):
    """On the reference, with its input held as the plant's is: an exact run has no error to feed back."""
    plant, law = made.two_inputs()
    t, rates = np.arange(201) * H, np.random.default_rng(0).normal(size=(201, 2))
    x = np.zeros((201, 4))
    for k in range(200):
        x[k + 1] = x[k] + H * np.array([x[k, 1], rates[k, 0], x[k, 3], rates[k, 1]])
        x[k + 1] += 0.5 * H**2 * np.array([rates[k, 0], 0.0, rates[k, 1], 0.0])
    r = np.hstack([x, rates / [1.0, 2.0]])
    run = Loop(plant, Controller(law, None, H, moving=True)).run(Samples(t, r), duration=2.0)
    np.testing.assert_allclose(run.signals["state"], x, atol=1e-9)
    np.testing.assert_allclose(run.signals["input"], r[:, 4:], atol=1e-7)
    assert run.metrics()["tracking_rmse"] < 1e-9


@pytest.mark.ci("compiles two loops")
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("degree", [2, 4])
@pytest.mark.parametrize("given", [True, False])
def test_a_constant_reference_is_the_operating_point(made, degree, given):
    problem = paper_arm().problem(pose=[0.8])
    law = solve_hji(problem, gamma=math.inf, degree=degree)
    settings = {"noise": 1e-3, "duration": 1.0, "initial_state": {"link_position": 0.5}, "seed": 3}
    settings["disturbance"] = {"link_torque": Step(2.0, at=0.2)}
    start = law.operating_point[:4]
    fixed, moving = (
        Controller(law, made.ukf(mean=start), saturation=12.0, moving=mode) for mode in (False, True)
    )
    one = Loop(paper_arm().plant(), fixed).run(**settings)
    held = np.append(start, law.operating_input) if given else None
    two = Loop(paper_arm().plant(), moving).run(reference=held, **settings)
    for name in ("state", "estimate", "output", "input"):
        np.testing.assert_allclose(two.signals[name], one.signals[name], atol=1e-11)
    assert np.abs(one.signals["input"]).max() == 12.0
    figures = [{k: np.array(v, dtype=float) for k, v in run.metrics().items()} for run in (one, two)]
    for name, value in figures[0].items():
        np.testing.assert_allclose(figures[1][name], value, rtol=1e-8)


def test_by_name_the_rest_stays_at_the_operating_point(made):
    law = made.law_about([1.0])
    loop = Loop(paper_arm().plant(), Controller(law, None, moving=True))
    run = loop.run({"link_position": Step(1.5, at=0.1), "motor_position": 1.2}, duration=0.3)
    point, r = law.operating_point, run.signals["reference"]
    assert run.names["reference"] == (*paper_arm().plant().states, "motor_voltage")
    assert run.units["reference"] == ("rad", "rad/s", "rad", "rad/s", "V")
    np.testing.assert_array_equal(r[[0, -1], 0], [0.0, 1.5])
    np.testing.assert_array_equal(r[:, 2], 1.2)
    np.testing.assert_array_equal(r[:, [1, 3]], np.broadcast_to(point[[1, 3]], (len(r), 2)))
    np.testing.assert_array_equal(r[:, 4], law.operating_input[0])
    assert re.match(r"link_position: step .*1\.5", run.settings["reference"])


def test_the_command_of_the_last_good_sample_holds(made):
    law = made.law_about([1.0])
    said, kept = (Controller(law, made.ukf(), moving=True) for _ in range(2))
    r = np.array([1.2, 0.1, 1.3, 0.0, 5.0])
    for k in range(6):
        if k == 3:
            with refused_with(NumericalFailure, "command", "finite", "reference=array([nan"):
                kept.step(0.0, np.full(5, np.nan))
        np.testing.assert_array_equal(said.step(0.01 * k, r), kept.step(0.01 * k, r if k == 0 else None))
    fresh = Controller(law, None, moving=True)
    np.testing.assert_allclose(fresh.step(law.operating_point[:4]), law.operating_input, rtol=1e-12)


@pytest.mark.ci("three loops of 8 s, drawn")
def test_a_law_without_integrals_follows_but_tracks_nothing(made):
    plant, _ = made.two_inputs()
    law = made.LinearLaw(plant.states, plant.inputs, [[-8.0, -5.0, 0.5, 0.0], [0.0, 0.0, -3.0, -2.0]])
    plants = plant, replace(plant, outputs=("b", "a"), output=lambda x, u, p: np.array([x[2], x[0]]))
    ukfs = [UnscentedKalmanFilter(p, H, 1e-4, 1e-6, np.zeros(4), 1e-2) for p in plants]
    for estimator, true, name in ((ukfs[0], plants[0], "a"), (ukfs[1], plants[1], "b"), (None, plant, "a")):
        run = Loop(true, Controller(law, estimator, H, moving=True, latency=0)).run(commands, duration=8.0)
        expected = (
            run.signals["reference"][:, 4:]
            + (run.signals["estimate"] - commands(run.time)[:, :4]) @ law.gain.T
        )
        np.testing.assert_allclose(run.signals["input"], expected, atol=1e-12)
        assert run.metrics() == run.metrics(name)
        assert 0.0 < run.metrics()["tracking_rmse"] < 0.5
        assert run.metrics("b")["tracking_rmse"] != run.metrics("a")["tracking_rmse"]
        assert len(run.plot().axes[0].lines) == 3 * len(run.judged)
    with refused_with(InvalidInput, "'ua'", "['a', 'da', 'b', 'db']"):
        run.metrics("ua")


@pytest.mark.ci("compiles two controllers and two loops")
@pytest.mark.oracle
@pytest.mark.parametrize("estimated", [True, False])
def test_composed_equals_one_trace(made, monkeypatch, estimated):
    plant, law = made.two_inputs()
    ukf = UnscentedKalmanFilter(plant, H, 1e-4, 1e-6, np.zeros(4), 1e-2) if estimated else None
    made_of = []
    for limit in (10**9, -1):
        monkeypatch.setattr(controller, "ONE_TRACE", limit)
        made_of.append(Controller(law, ukf, H, 2.0, moving=True))
        assert made_of[-1].composed == (limit < 0)
    one, composed = made_of
    rng = np.random.default_rng(0)
    for k in range(30):
        y, r = rng.normal(size=len(one.measured)), commands(k * H)
        np.testing.assert_allclose(composed.step(y, r), one.step(y, r), rtol=1e-10, atol=1e-12)
    runs = [Loop(plant, c).run(commands, duration=0.5, noise=1e-3) for c in made_of]
    for name, values in runs[0].signals.items():
        np.testing.assert_allclose(runs[1].signals[name], values, atol=1e-10)


@pytest.mark.ci("a black box in Python")
@pytest.mark.oracle
def test_a_black_box_runs_the_same(made):
    plant, law = made.two_inputs()

    ukf = UnscentedKalmanFilter(plant, H, 1e-4, 1e-6, np.zeros(4), 1e-2)
    control = Controller(law, ukf, H, moving=True)
    one, two = (
        Loop(true, control).run(commands, {"push": 0.5}, 1e-3, 1.0) for true in (plant, PlantBox(plant))
    )
    for name, values in one.signals.items():
        np.testing.assert_allclose(two.signals[name], values, atol=1e-11)


def test_codes_differ_and_fresh_keeps_the_mode(made):
    fixed, moving = (Controller(made.law, made.ukf(), moving=mode) for mode in (False, True))
    assert fixed.code_key != moving.code_key
    assert fixed.traced() is not moving.traced()
    assert moving.fresh().code_key == moving.code_key
    assert moving.traced() is moving.fresh().traced()


def test_misfits_are_refused(made):
    with refused_with(InvalidInput, "moving=True", "'yes'") as caught:
        Controller(made.law, None, moving="yes")
    assert caught.value.advice
    moving = Controller(made.law, None, moving=True)
    for r in (1.0, [1.0], np.zeros(4), np.zeros(6), "there"):
        with pytest.raises(InvalidInput, match="motor_voltage"):
            moving.step(np.zeros(4), r)
    loop = Loop(paper_arm().plant(), moving)
    for r in (1.0, Sine(1.0, 1.0), np.zeros(4), {"elbow": 1.0}, lambda t: np.zeros(4)):
        with pytest.raises(InvalidInput, match="motor_voltage"):
            loop.run(r, duration=0.1)
    with refused_with(InvalidInput, "reference", "finite", "[nan]", "0.05 s"):
        loop.run({"motor_voltage": lambda t: math.nan if t > 0.05 else 0.0}, duration=0.1)
