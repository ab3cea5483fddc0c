"""Plants, controllers and loops as systems of python-control, and a system as a plant."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.plant import plant_from_control

ARM = fh.paper_arm()


def controller() -> fh.Controller:
    return arm_controller(kind=fh.ExtendedKalmanFilter)


@pytest.mark.oracle
def test_a_nonlinear_plant_moves_as_here() -> None:
    plant = fh.load_robot("planar-two-link").plant()
    system = plant.to_control()
    assert list(system.input_labels) == [*plant.inputs, *plant.disturbances]
    x, v = 0.1 * np.arange(8), 0.3 * np.arange(len(system.input_labels))
    m = len(plant.inputs)
    np.testing.assert_array_equal(system.dynamics(0.0, x, v), plant.derivative(x, v[:m], v[m:]))
    np.testing.assert_array_equal(system.output(0.0, x, v), x[:2])


@pytest.mark.oracle
def test_a_linearisation_has_what_goes_straight_through() -> None:
    """Joint torques are measured with the motor's input in them: D is not zero where acceleration is measured."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], -np.sin(x[0]) + p.k * u[0] + d[0]]),
        lambda x, u, p: np.array([x[0], p.k * u[0] - x[1]]),
        ("angle", "speed"), ("torque",), ("load",), {"k": 2.0}, ("angle", "force"),
    )  # fmt: skip
    linear = plant.to_control([0.5, 0.0], [0.2])
    np.testing.assert_allclose(linear.A, [[0.0, 1.0], [-math.cos(0.5), 0.0]])
    np.testing.assert_allclose(linear.B, [[0.0, 0.0], [2.0, 1.0]])
    np.testing.assert_allclose(linear.D, [[0.0, 0.0], [2.0, 0.0]])
    numerical = plant.to_control().linearize([0.5, 0.0], [0.2, 0.0])
    for name in "ABCD":
        np.testing.assert_allclose(getattr(linear, name), getattr(numerical, name), atol=1e-5)
    again = plant_from_control(linear, inputs=["torque"])
    a, b, g, _ = again.linearise()
    np.testing.assert_allclose(np.hstack([b, g]), linear.B)
    np.testing.assert_allclose(a, linear.A)
    assert again.disturbances == ("load",)


def test_a_transfer_function_is_controlled() -> None:
    import control

    oscillator = control.ss(
        [[0.0, 1.0], [-4.0, -0.2]], np.eye(2)[:, [1, 1]], [[1.0, 0.0]], 0, inputs=["u", "d"]
    )
    plant = plant_from_control(oscillator, inputs=["u"])
    assert plant_from_control(control.tf([1.0], [1.0, 0.2, 4.0])).n == 2
    problem = fh.GeneralisedPlant(plant, fh.Penalty([1.0, 1.0], 1.0))
    law = fh.linear_law(problem, gamma=math.inf)
    loop = np.linalg.eigvals(plant.linearise()[0] + plant.linearise()[1] @ gain(law))
    assert loop.real.max() < 0.0


def gain(law: object) -> np.ndarray:
    from flexhinf.loop.controller.law_code import law_slope

    return law_slope(law)  # type: ignore[arg-type]


@pytest.mark.oracle
def test_a_loop_runs_as_here() -> None:
    import control

    loop = fh.Loop(ARM.plant(), controller())
    run = loop.run(fh.Step(0.1), duration=0.05)
    system = loop.to_control()
    start = np.concatenate([np.zeros(4), loop.controller.initial_memory()])
    time = 1e-3 * np.arange(51)
    inputs = np.zeros((len(system.input_labels), 51))
    inputs[0] = 0.1
    response = control.input_output_response(system, time, inputs, start)
    np.testing.assert_allclose(
        response.outputs[1], run.signal("input", "motor_voltage"), rtol=1e-9, atol=1e-9
    )
    np.testing.assert_allclose(response.states[:4].T, np.asarray(run.data["state"]), rtol=1e-9, atol=1e-11)


@pytest.mark.ci("a controller in python-control")
@pytest.mark.oracle
def test_a_controller_answers_as_here() -> None:
    one = controller()
    system, memory = one.to_control(), one.initial_memory()
    assert system.dt == 1e-3
    rng = np.random.default_rng(0)
    for _ in range(20):
        v = np.array([0.01 * rng.normal(), 0.1])
        u = system.output(0.0, memory, v)
        np.testing.assert_allclose(u, one.step(v[:1], v[1:]), rtol=1e-9)
        memory = system.dynamics(0.0, memory, v)


def test_what_has_no_form_there(monkeypatch: pytest.MonkeyPatch) -> None:
    import control

    with refused_with(InvalidInput, "python-control", "delay=3"):
        fh.Loop(ARM.plant(), controller(), delay=2e-3).to_control()
    with refused_with(InvalidInput, "continuous", "dt=0.1"):
        plant_from_control(control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1))
    with refused_with(InvalidInput, "['u[0]']", "['force']"):
        plant_from_control(control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), inputs=["force"])
    with refused_with(InvalidInput, "measurement", "D = 0", "['u[1]']"):
        plant_from_control(control.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 1.0]]), inputs=["u[0]"])
    monkeypatch.setitem(sys.modules, "control", None)
    with refused_with(InvalidInput, "flexhinf[control]"):
        ARM.plant().to_control()
