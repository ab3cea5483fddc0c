"""Quantised measurements and delayed inputs."""

import numpy as np
import pytest
from tests.builders import PlantBox
from tests.interpreter import interpret
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, Loop, Step
from flexhinf.loop.simulation.program import LONGEST, Channel, check_delay, measure_function
from flexhinf.robot import paper_arm

# Kernels that run once each: 1 s instead of 3 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

STEP = 2 * np.pi / 4096


def test_measurements_lie_on_the_grid(made):
    run = Loop(paper_arm().plant(), Controller(made.law, made.ukf()), quantisation=STEP).run(
        Step(1.0), duration=2.0
    )
    grid = run.signals["output"] / STEP
    np.testing.assert_allclose(grid, np.round(grid), atol=1e-9)
    assert np.abs(run.signals["output"] - run.signals["state"][:, :1]).max() <= STEP / 2 * (1 + 1e-9)
    assert run.settings["quantisation"] == [STEP]


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("samples", [1, 3])
def test_a_delayed_input_acts_later(made, samples):
    late = Loop(paper_arm().plant(), Controller(made.law, made.ukf(), latency=0), delay=samples * 1e-3)
    run = late.run(Step(1.0), duration=0.5)
    plant, x = paper_arm().plant(), np.zeros(4)
    from flexhinf.plant import rk4_step

    inputs = np.concatenate([np.zeros((samples, 1)), run.signals["input"]])
    for k in range(len(run.time) - 1):
        np.testing.assert_allclose(run.signals["state"][k], x, atol=1e-11)
        u = inputs[k]
        for _ in range(late.sub_steps):
            x = rk4_step(plant.derivative, x, (u, u, u), 1e-3 / late.sub_steps)


@pytest.mark.ci("a loop of its own")
def test_a_delay_costs_damping(made):
    settling = []
    for delay in (0.0, 0.03):
        loop = Loop(paper_arm().plant(), Controller(made.law, made.ukf()), delay=delay)
        settling.append(loop.run(Step(1.0), duration=10.0).metrics()["overshoot_percent"])
    assert settling[1] > settling[0] + 1.0


def test_a_black_box_sees_the_same_channel(made):
    controller = Controller(made.law, made.ukf())
    options = {"quantisation": STEP, "delay": 2e-3}
    ours = Loop(paper_arm().plant(), controller, sub_steps=2, **options).run(
        Step(1.0), noise=1e-3, duration=0.4
    )
    theirs = Loop(PlantBox(paper_arm().plant(), 2), controller, **options).run(
        Step(1.0), noise=1e-3, duration=0.4
    )
    np.testing.assert_allclose(ours.signals["input"], theirs.signals["input"], atol=1e-7)


@pytest.mark.parametrize(
    ("quantisation", "delay", "what"),
    [(-1.0, 0.0, "quantisation"), ([1, 2], 0.0, "quantisation"), ("fine", 0.0, "quantisation"),
     (None, 1.5e-3, "delay"), (None, -1e-3, "delay"), (None, "late", "quantisation|delay"), (None, np.inf, "delay")],
)  # fmt: skip
def test_what_does_not_fit_is_refused(made, quantisation, delay, what):
    with pytest.raises(InvalidInput, match=what):
        Loop(paper_arm().plant(), Controller(made.law, None), quantisation=quantisation, delay=delay)


def test_no_quantum_and_no_delay_is_no_channel():
    assert Channel.of(0.0, 0.0, 1e-3, ("a", "b")) == Channel((), 0)


def test_a_delay_out_of_proportion_is_refused_early_with_the_unit_it_probably_was():
    assert Channel.of(None, 100.0, 1e-3, ("y",)).delay == LONGEST
    with refused_with(InvalidInput, "100 s", "1000 s", 1000000, "delay=1", "1000 ms"):
        Channel.of(None, 1e3, 1e-3, ("y",))


def test_a_linear_loop_takes_the_delays_of_a_run():
    check_delay(LONGEST, 1e-3)
    with refused_with(InvalidInput, "500 s", 500000, "delay=0.5", "500 ms"):
        check_delay(500_000, 1e-3)


def test_a_delay_of_any_length_is_data(made):
    loops = [
        Loop(paper_arm().plant(), Controller(made.law, made.ukf()), sub_steps=2, delay=samples * 1e-3)
        for samples in (0, 1, 10, 5000)
    ]
    assert len({id(loop.prepared().code.kernel()) for loop in loops}) == 1
    plain, *_, longest = (loop.run(Step(0.5), noise=1e-3, duration=5.1) for loop in loops)
    assert not longest.signals["state"][:5001].any()  # it hangs: nothing acts yet
    assert np.abs(longest.signals["state"][5001:]).max() > 1e-6
    assert np.abs(plain.signals["state"][:5001]).max() > 0.1


def test_two_motors_wait_for_their_own_inputs(made):
    plant, law = made.two_inputs()
    for delay in (0, 3):
        loop = Loop(plant, Controller(law, None, period=1e-2), sub_steps=1, delay=delay * 1e-2)
        run = loop.run(Step(0.3), initial_state=[0.1, -0.2, 0.3, 0.4], duration=0.2)
        x, inputs = np.array([0.1, -0.2, 0.3, 0.4]), np.vstack([np.zeros((delay, 2)), run.signals["input"]])
        for k, state in enumerate(run.signals["state"]):
            np.testing.assert_allclose(state, x, atol=1e-13)
            x = made.exact_step(x, inputs[k], 0.0)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("samples", [0, 1, 7, 60])
def test_interpreter_and_lanes_delay_alike(made, samples, monkeypatch):
    """Machine code for one run and for eight, and CasADi's evaluator."""
    monkeypatch.setenv("FLEXHINF_LANES_FROM", "0")
    loop = Loop(paper_arm().plant(), Controller(made.law, None), sub_steps=2, delay=samples * 1e-3)
    prepared = loop.prepared(Step(0.5), duration=0.05, initial_state=[0.2, 0.0, 0.1, 0.0])
    alone, walked = prepared.run()[0], prepared.run(interpret(prepared.code.program))[0]
    for name in ("state", "input", "output"):
        np.testing.assert_allclose(walked.signals[name], alone.signals[name], rtol=1e-12, atol=1e-13)
    inputs = 0.1 * np.arange(9.0)[:, None]
    wide = loop.ensemble(Step(0.5), duration=0.05).trajectories([{}] * 9, initial_inputs=inputs)
    for held, run in zip(inputs, wide, strict=True):
        one = loop.run(Step(0.5), duration=0.05, initial_input=held)
        for name in ("state", "input", "output"):
            np.testing.assert_array_equal(run.signals[name], one.signals[name])


def test_noise_is_added_to_what_is_measured(made):
    """States for a law that is fed them, outputs for an estimator."""
    plant, law = made.two_inputs()
    controller = Controller(law, None, 1e-3)
    x, noise = np.array([0.3, -0.2, 0.7, 0.1]), np.array([0.01, 0.02, -0.03, 0.04])
    measured = measure_function(plant, controller)(
        x, np.zeros(2), noise, np.r_[1e-3, plant.parameters.vector()]
    )
    np.testing.assert_array_equal(np.ravel(measured.full()), x + noise)
