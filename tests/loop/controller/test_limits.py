"""Limits of the command and of the input's rate, against the same loop in plain NumPy."""

import copy
import pickle
import re

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, Loop, Schedule, Step, load_controller

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

H = 1e-2

#: Two inputs: range and largest rate of the command, limits of the input and of its rate.
LOW, HIGH, RATE, INPUT, INPUT_RATE = -0.4, 0.6, 1.5, np.array([3.0, 1.0]), np.array([20.0, np.inf])
LIMITED = {
    "saturation": INPUT, "command_range": (LOW, HIGH), "command_rate": RATE, "input_rate": INPUT_RATE,
}  # fmt: skip


def plain(made, commands, x, last=(0.0, 0.0), range=(LOW, HIGH), rate=RATE, input_rate=INPUT_RATE):
    """States, inputs, limited commands and integrals of `two_inputs` under its law."""
    _, law = made.two_inputs()
    integral, before, u = 0.0, None, np.array(last)
    rows = []
    for r in commands:
        start = x[0] if before is None else before[1]
        r = min(max(min(max(r, range[0]), range[1]), start - rate * H), start + rate * H)
        growth = 0.0 if before is None else H * (0.5 * (before[0] + x[0]) - before[1])
        wanted = law.gain @ np.append(x, integral + growth)
        limited = np.clip(wanted, -INPUT, INPUT)
        limited = np.clip(limited, u - H * input_rate, u + H * input_rate)
        integral += growth - made.taken_back(law.gain[:, 4], wanted - limited, INPUT)
        u = limited
        rows.append((x, u, r, integral))
        before = x[0], r
        x = made.exact_step(x, u, 0.0)
    return [np.array(column) for column in zip(*rows)]


def stepped(made, controller, commands, x):
    inputs, limited, integrals = [], [], []
    for r in commands:
        u = controller.step(x, r)
        inputs.append(u)
        limited.append(controller.memory.named(controller._history.memory).command[0])
        integrals.append(controller.integrals[0])
        x = made.exact_step(x, u, 0.0)
    return np.array(inputs), np.array(limited), np.array(integrals)


@pytest.mark.oracle
def test_the_same_loop_in_plain_numpy(made):
    commands = [0.5] * 60 + [2.0] * 150 + [-3.0] * 150 + [0.1] * 60
    start = np.array([0.2, 0.0, -0.3, 0.1])
    _, inputs, limited, integrals = plain(made, commands, start)
    found = stepped(made, Controller(made.two_inputs()[1], None, H, **LIMITED), commands, start)
    for mine, theirs in zip(found, (inputs, limited, integrals)):
        np.testing.assert_allclose(mine, theirs, rtol=1e-10, atol=1e-12)
    assert limited.max() == HIGH
    assert limited.min() == LOW
    assert np.abs(np.diff(limited)).max() == pytest.approx(RATE * H)
    assert np.abs(np.diff(inputs[:, 0])).max() == pytest.approx(INPUT_RATE[0] * H)
    assert limited[0] == pytest.approx(0.2 + RATE * H)  # from where the joint is


@pytest.mark.parametrize("commands", [[2.0] * 800, [2.0] * 400 + [0.0] * 400])
def test_integrals_do_not_wind_up_under_a_command_out_of_range(made, commands):
    """Held at the end of its range, the joint stands there, and leaves at once when the command comes back."""
    law, start = made.two_inputs()[1], np.zeros(4)
    _, _, integrals = stepped(made, Controller(law, None, H, **LIMITED), commands, start)
    inside = np.clip(commands, LOW, HIGH)
    _, _, expected = stepped(made, Controller(law, None, H, **LIMITED), inside, start)
    np.testing.assert_array_equal(integrals, expected)


def test_the_requested_command_is_kept_for_samples_without_one(made):
    law = made.two_inputs()[1]
    said, kept = (Controller(law, None, H, command_rate=0.3) for _ in range(2))
    x = np.zeros(4)
    for k in range(40):
        np.testing.assert_array_equal(said.step(x, 1.0), kept.step(x, 1.0 if k == 0 else None))
    assert kept.memory.named(kept._history.memory).command[0] == pytest.approx(40 * 0.3 * H)


@pytest.mark.ci("compiles a loop, and its pieces")
def test_with_an_estimator_in_a_loop_and_in_pieces(made, monkeypatch):
    """The compiled loop, the step alone and the composed step do the same."""
    options = {"saturation": 12.0, "command_range": 0.4, "command_rate": 2.0, "input_rate": 300.0}
    plant = made.ukf().plant
    run = Loop(plant, Controller(made.law, made.ukf(), **options)).run(Step(1.0), duration=0.6)
    alone = Controller(made.law, made.ukf(), **options)
    again = [alone.step(y, 1.0) for y in run.signals["output"]]
    np.testing.assert_allclose(run.signals["input"], again, rtol=1e-9, atol=1e-10)
    assert np.abs(np.diff(run.signals["input"][:, 0])).max() <= 0.3 + 1e-9
    assert run.signals["state"][-1, 0] < 0.5
    monkeypatch.setattr("flexhinf.loop.controller.controller.ONE_TRACE", 0)
    composed = Controller(made.law, made.ukf(), **options)
    assert composed.composed
    pieces = [composed.step(y, 1.0) for y in run.signals["output"]]
    np.testing.assert_allclose(pieces, again, rtol=1e-9, atol=1e-10)


def test_the_law_that_is_nearest_to_the_limited_command_acts(made):
    laws = [made.LinearLaw(law.state_names, law.input_names, law.gain, point)
            for law, point in ((made.two_inputs()[1], np.zeros(5)), (made.two_inputs()[1], np.eye(5)[0]))]  # fmt: skip
    limited = Controller(Schedule(laws), None, H, command_range=(-1.0, 0.3))
    for r in (0.0, 5.0, 5.0):
        limited.step(np.zeros(4), r)
    assert limited.memory.named(limited._history.memory).active.tolist() == [1.0, 0.0]


def test_limits_are_saved_pickled_copied_and_said(made, tmp_path):
    law = made.two_inputs()[1]
    one = Controller(law, None, H, **LIMITED)
    one.step(np.zeros(4), 0.5)
    one.save(tmp_path / "limited.npz")
    fresh = [one.fresh(), load_controller(tmp_path / "limited.npz")]
    going = [pickle.loads(pickle.dumps(one)), copy.deepcopy(one)]
    x = np.array([0.3, -0.1, 0.2, 0.0])
    first = Controller(law, None, H, **LIMITED).step(x, -2.0)
    for other in fresh:
        np.testing.assert_array_equal(other.step(x, -2.0), first)
    after = one.step(x, -2.0)
    for other in going:
        np.testing.assert_array_equal(other.step(x, -2.0), after)
    assert re.search(r"command: -0\.4 .* 0\.6.* 1\.5 ", repr(one))
    assert re.search(r"rate: .* 20 ", repr(one))
    plain = Controller(law, None, H, 3.0)
    plain.save(tmp_path / "plain.npz")
    with np.load(tmp_path / "plain.npz") as file:
        assert not {"input_rate", "command_rate"} & set(file)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"command_range": (0.5, 0.5)}, r"range.*command[\s\S]*lower=\[0\.5\], upper=\[0\.5\]"),
        ({"command_range": [1.0, 2.0]}, r"range.*command[\s\S]*\[1\.0, 2\.0\]"),
        ({"command_range": "wide"}, r"range.*command[\s\S]*command_range="),
        ({"command_rate": 0.0}, r"rate.*command.*positive[\s\S]* 0\.0"),
        ({"command_rate": [1.0, 2.0]}, r"rate.*command[\s\S]*\[1\.0, 2\.0\]"),
        ({"command_rate": np.nan}, r"rate.*command.*positive[\s\S]* nan"),
        ({"input_rate": -5.0}, r"rate.*input.*positive[\s\S]* -5\.0"),
        ({"input_rate": [1.0, 2.0, 3.0]}, r"rate.*input[\s\S]*\[1\.0, 2\.0, 3\.0\]"),
        ({"command_rate": 1.0, "moving": True}, r"command[\s\S]*moving=True .* 1 integrals"),
    ],
)
def test_what_does_not_fit_is_refused(made, options, words):
    with pytest.raises(InvalidInput, match=words) as caught:
        Controller(made.two_inputs()[1], None, H, **options)
    assert all((caught.value.what, caught.value.found, caught.value.advice))
