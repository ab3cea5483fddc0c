"""Quantised measurements and delayed inputs."""

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop import BlackBox, Controller, Loop, Step
from flexhinf.loop.simulation.channel import MOST_QUEUED, Channel
from flexhinf.robot import paper_arm

STEP = 2 * np.pi / 4096


class Wrapped(BlackBox):
    """The paper's arm as a black box, integrated by its own loop of one sub-step."""

    def __init__(self):
        self.plant = paper_arm().plant()
        self.states, self.disturbances = self.plant.states, self.plant.disturbances

    def reset(self, initial_state):
        self.x = np.zeros(4) if initial_state is None else np.array(initial_state, dtype=float)

    def step(self, u, disturbance, period):
        from flexhinf.plant import rk4_step

        inputs = (u, u, u)
        for _ in range(2):
            self.x = rk4_step(
                lambda x, v: self.plant.derivative(x, v, disturbance), self.x, inputs, period / 2
            )

    def output(self):
        return self.x[:1]

    def state(self):
        return self.x


def test_measurements_lie_on_the_grid(made):
    run = Loop(paper_arm().plant(), Controller(made.law, made.ukf()), quantisation=STEP).run(
        Step(1.0), duration=2.0
    )
    grid = run.signals["output"] / STEP
    np.testing.assert_allclose(grid, np.round(grid), atol=1e-9)
    assert np.abs(run.signals["output"] - run.signals["state"][:, :1]).max() <= STEP / 2 * (1 + 1e-9)
    assert run.settings["quantisation"] == [STEP]


@pytest.mark.parametrize("samples", [1, 3])
def test_a_delayed_input_acts_later(made, samples):
    late = Loop(paper_arm().plant(), Controller(made.law, made.ukf()), delay=samples * 1e-3)
    run = late.run(Step(1.0), duration=0.5)
    plant, x = paper_arm().plant(), np.zeros(4)
    from flexhinf.plant import rk4_step

    inputs = np.concatenate([np.zeros((samples, 1)), run.signals["input"]])
    for k in range(len(run.time) - 1):
        np.testing.assert_allclose(run.signals["state"][k], x, atol=1e-11)
        u = inputs[k]
        for _ in range(late.sub_steps):
            x = rk4_step(plant.derivative, x, (u, u, u), 1e-3 / late.sub_steps)


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
    theirs = Loop(Wrapped(), controller, **options).run(Step(1.0), noise=1e-3, duration=0.4)
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
    assert Channel.of(None, 0.2, 1e-3, ("y",)).delay == MOST_QUEUED == 200
    with pytest.raises(
        InvalidInput, match=r"(?s)5 s = 5000 samples of 0.001 s.*delay=0.005 if 5 ms was meant"
    ):
        Channel.of(None, 5, 1e-3, ("y",))


def test_the_inputs_of_all_motors_wait_in_one_queue():
    assert Channel.of(None, 0.028, 1e-3, ("y",), inputs=7).delay == 28
    with pytest.raises(InvalidInput, match=r"at most 28 samples = 0\.028 s with 7 inputs"):
        Channel.of(None, 0.029, 1e-3, ("y",), inputs=7)
