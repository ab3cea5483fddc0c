"""A known latency between measurement and input: matrices, poles of the loop without it, other forms of the step."""

from __future__ import annotations

import copy
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from tests.builders import linear_law, linear_plant
from tests.interpreter import interpret

import flexhinf as fh
from flexhinf.analysis import EquilibriumLoop
from flexhinf.designs.specification import Specification
from flexhinf.errors import InvalidInput
from flexhinf.estimation import (
    ConstantGainFilter,
    ExtendedKalmanFilter,
    OutputInjectionObserver,
    stationary_gain,
)
from flexhinf.files import read_arrays, write_arrays
from flexhinf.loop import Controller, Loop

# Kernels that run once each: 1 s instead of 2 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

PERIOD = 1e-2
A = np.array([[0.0, 1.0], [-30.0, -0.4]])
B = np.array([[0.0], [9.0]])
C = np.array([[1.0, 0.0]])
GAINS = np.array([[2.5, 0.6, 4.0]])  # of position, speed, and the integral of the position


def plant() -> fh.Plant:
    return linear_plant(A, B, C, states=("x", "v"), inputs=("u",), outputs=("x",))


LAW = linear_law(plant(), -GAINS, integrals=("x",))


def kalman(mean: tuple[float, float] = (0.0, 0.0)) -> ExtendedKalmanFilter:
    return ExtendedKalmanFilter(plant(), PERIOD, 1e-4, 1e-3, np.array(mean), 1e-4)


def estimator(mean: tuple[float, float] = (0.0, 0.0)) -> ConstantGainFilter:
    ekf, phi = kalman(mean), sampled()[0]
    assert ekf.sub_steps == 1
    return ConstantGainFilter(ekf, stationary_gain((phi, C), 1e-4 * np.eye(2), 1e-3 * np.eye(1)))


def sampled() -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ of one Runge–Kutta step, with which loop and filter integrate: the fourth-order polynomial of exp."""
    both = np.zeros((3, 3))
    both[:2, :2], both[:2, 2:] = PERIOD * A, PERIOD * B
    term, total = np.eye(3), np.eye(3)
    for k in range(1, 5):
        term = term @ both / k
        total = total + term
    return total[:2, :2], total[:2, 2:]


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("latency", [0, 1, 2, 5])
def test_a_linear_loop_is_the_recursion_of_its_matrices(latency: int) -> None:
    """With a queue of the inputs that wait and the prediction over them, written out; an unknown delay on top."""
    phi, gamma = sampled()
    gain = np.asarray(estimator().initial.gain)
    loop = Loop(plant(), Controller(LAW, estimator(), PERIOD, latency=latency), 1, delay=PERIOD)
    run = loop.run(1.0, duration=1.0, initial_state=[0.2, -0.1])
    assert loop.channel.delay == latency + 1
    x, guess, inputs, integral, before = np.array([0.2, -0.1]), np.zeros(2), [], 0.0, None

    def acting(k: int, late: int) -> np.ndarray:  # on the interval from sample k on
        return inputs[k - late] if k >= late else np.zeros(1)

    for k in range(101):
        y = C @ x
        guess = guess + gain @ (y - C @ guess)
        if before is not None:
            integral += PERIOD * (0.5 * (before[0] + y[0]) - 1.0)
        ahead = guess
        for j in range(latency):
            ahead = phi @ ahead + gamma @ acting(k + j, latency)
        inputs.append(-GAINS @ np.append(ahead, integral))
        assert run.signals["state"][k] == pytest.approx(x, abs=1e-12)
        assert run.signals["estimate"][k] == pytest.approx(guess, abs=1e-12)
        assert run.signals["input"][k] == pytest.approx(inputs[k], abs=1e-12)
        guess, before = phi @ guess + gamma @ acting(k, latency), y
        x = phi @ x + gamma @ acting(k, latency + 1)
    assert np.abs(run.signals["state"][:, 0]).max() > 0.2


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["gain", "observer"])
@pytest.mark.parametrize("latency", [1, 3])
def test_poles_are_those_of_the_loop_without_latency_and_zeros(latency: int, kind: str) -> None:
    """Prediction with the exact model: the predicted state obeys the loop without latency [manitius1979]."""
    made = (
        estimator()
        if kind == "gain"
        else OutputInjectionObserver(plant(), PERIOD, 1e-4, 1e-3, np.zeros(2), poles=-np.array([20.0, 25.0]))
    )
    law, goal = linear_law(plant(), -GAINS[:, :2]), (np.zeros(2), np.zeros(1))
    poles = []
    for samples in (0, latency):
        loop = EquilibriumLoop(law, made, plant(), PERIOD, equilibrium=goal, moving=True, latency=samples)
        values = loop.modes([{}]).multipliers[0]
        poles.append(np.sort_complex(values[np.abs(values) > 0.2]))
        assert loop.delay == samples
    assert len(poles[0]) == 4
    assert poles[1] == pytest.approx(poles[0], abs=1e-7)


@pytest.mark.oracle
def test_prediction_buys_delay_margin() -> None:
    """The margin counts from the latency on: a loop is unstable with more unknown samples than it says, and not with
    fewer."""
    from flexhinf.analysis import margins

    loop = EquilibriumLoop(LAW, estimator(), plant(), PERIOD, latency=2)
    whole = int(margins(loop).delay_margin_s / PERIOD)
    assert 1 <= whole < 50
    for more, stable in ((whole, True), (whole + 1, False)):
        late = EquilibriumLoop(LAW, estimator(), plant(), PERIOD, delay=more, latency=2)
        assert bool(late.modes([{}]).stable[0]) is stable


@pytest.mark.parametrize("latency", [1, 2])
def test_a_move_is_followed_without_lag(latency: int) -> None:
    """The command is that of the instant at which the input acts: no error remains on a ramp of exact feedforward."""
    speed, times = 0.3, np.arange(400) * PERIOD
    held = (30.0 * speed * (times + PERIOD / 2.0) + 0.4 * speed) / 9.0  # at the middle of its hold
    exact = {"x": fh.Samples(times, speed * times), "v": speed, "u": fh.Samples(times, held)}
    for samples in (0, latency):
        controller = Controller(LAW, estimator((0.0, speed)), PERIOD, moving=True, latency=samples)
        loop = Loop(plant(), controller)
        run = loop.run(exact, duration=3.0, initial_state=[0.0, speed], initial_input=held[:1])
        wanted = speed * run.time
        assert run.signals["reference"][:, 0] == pytest.approx(wanted, abs=1e-12)
        assert (
            np.abs(run.signals["state"][:, 0] - wanted).max() < 0.02 * latency * speed * PERIOD
        )  # and not its way


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("moving", [False, True])
def test_every_form_of_the_step_does_the_same(moving: bool, tmp_path: Path) -> None:
    made = kalman()
    options = {"latency": 2, "moving": moving, "saturation": 20.0, "start": "bumpless"}
    controller = Controller(LAW, made, PERIOD, **options)
    loop = Loop(plant(), controller)
    command = {"x": fh.Sine(0.3, 1.0), "v": 0.0, "u": 0.1} if moving else fh.Sine(0.3, 1.0)
    prepared = loop.prepared(command, noise=1e-3, duration=0.6)
    run, walked = prepared.run()[0], prepared.run(interpret(prepared.code.program))[0]
    assert walked.signals["input"] == pytest.approx(run.signals["input"], abs=1e-12)
    wide = next(iter(loop.ensemble(command, noise=1e-3, duration=0.6).trajectories([{}] * 9, 0)))
    assert np.array_equal(wide.signals["reference"], run.signals["reference"])
    pieces = Loop(plant(), controller.in_pieces()).run(command, noise=1e-3, duration=0.6)
    assert pieces.signals["input"] == pytest.approx(run.signals["input"], abs=1e-12)
    path = tmp_path / "controller.npz"
    controller.save(path)
    stepped = [controller.fresh(), fh.load_controller(path), pickle.loads(pickle.dumps(controller))]
    ahead = loop._commanded(command, None, None, 0.6, False)[1][2 * moving :]
    for k, y in enumerate(run.signals["output"]):
        if k == 20:
            stepped[0] = copy.copy(stepped[0])
        answers = [one.step(y, ahead[k]) for one in stepped]
        assert all(np.array_equal(u, run.signals["input"][k]) for u in answers)


def test_a_file_without_latency_means_none(tmp_path: Path) -> None:
    path = tmp_path / "controller.npz"
    Controller(LAW, kalman(), PERIOD, latency=2).save(path)
    arrays, _ = read_arrays(path)
    header = json.loads(str(arrays.pop("header")))
    assert header["options"].pop("latency") == 2 == fh.load_controller(path).mode.latency
    write_arrays(path, "controller", {"header": np.array(json.dumps(header)), **arrays})
    assert fh.load_controller(path).mode.latency == 0


@pytest.mark.ci("imports and runs python-control")
@pytest.mark.oracle
@pytest.mark.parametrize("latency", [1, 3])
def test_the_loop_in_python_control_has_the_queue(latency: int) -> None:
    import control

    controller = Controller(LAW, kalman(), PERIOD, latency=latency)
    loop = Loop(plant(), controller)
    run, system = loop.run(0.5, duration=0.4), loop.to_control()
    time, start = run.time, np.concatenate([np.zeros(2), controller.initial_memory()])
    response = control.input_output_response(system, time, np.full((1, len(time)), 0.5), start)
    assert pytest.approx(run.signals["state"], abs=1e-11) == response.states[:2].T
    with pytest.raises(InvalidInput, match="unknown delay"):
        Loop(plant(), controller, delay=PERIOD).to_control()


@pytest.mark.parametrize("latency", [-1, 0.5, 11, "one", True, np.nan])
def test_what_is_no_latency_is_refused(latency: object) -> None:
    with pytest.raises(InvalidInput, match=r"(?s)latency.* 0 to 10.*latency=1"):
        Controller(LAW, estimator(), PERIOD, latency=latency)  # type: ignore[arg-type]


def test_one_sample_is_the_default_where_something_predicts() -> None:
    """Of a controller, its linear loop and a specification; what is stated wins."""
    for made, samples in ((kalman(), 1), (None, 0)):
        assert Controller(LAW, made, PERIOD).mode.latency == samples
        assert EquilibriumLoop(LAW, made, plant(), PERIOD).delay == samples
        assert Specification(estimator="none" if made is None else "ukf").known_latency == samples
    assert Controller(LAW, kalman(), PERIOD, latency=0).mode.latency == 0
    assert Specification(latency=0).known_latency == 0


def test_without_an_estimator_nothing_predicts() -> None:
    assert Controller(LAW, None, PERIOD).mode.latency == 0
    with pytest.raises(InvalidInput, match=r"(?s)0 to 0.*latency=0"):
        Controller(LAW, None, PERIOD, latency=1)


def test_the_exponential_is_near_the_step_of_the_loop() -> None:
    """What the tests above call Φ."""
    assert sampled()[0] == pytest.approx(expm(PERIOD * A), abs=1e-7)
