"""A law that takes over continues from the last input: against closed forms, and where no integral does it."""

import re
from functools import cache

import numpy as np
import pytest
from tests.builders import PlantBox
from tests.loop.conftest import moving_commands

from flexhinf.errors import InvalidInput
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.hinf import smallest_gamma, solve_hji
from flexhinf.loop import Controller, Loop, Quintic, Step
from flexhinf.loop.controller import controller, law_code, options
from flexhinf.plant import Law, Plant, equilibrium
from flexhinf.robot import paper_arm

# Kernels that run once each: 2 s instead of 3 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

H = 1e-2
LAST = [1.2, -0.7]


@pytest.fixture(scope="module")
def arm_laws():
    """The paper's problem about rest, and its law of a degree."""
    problem = paper_arm().problem()
    gamma = 2.0 * smallest_gamma(problem)
    return cache(lambda degree: solve_hji(problem, gamma=gamma, degree=degree + 1))


def remembered(made_controller):
    return made_controller.memory.named(made_controller._history.memory)


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("limit", [np.inf, 1.25])
def test_a_linear_law_in_closed_form(made, moving, limit):
    """One integral for two inputs: least squares, and a bias that fades with the stated time constant."""
    plant, law = made.two_inputs()
    law = made.LinearLaw(law.state_names, law.input_names, law.gain, [0.2, 0, 0.1, 0, 0.05], [0.3, 0.1])
    control = Controller(
        law, None, H, None if limit == np.inf else limit, moving=moving, start="bumpless", blend_time=0.3
    )
    t = np.arange(301) * H
    r = moving_commands(t) if moving else np.where(t >= 1.0, 9.0, 0.2)[:, None]
    start = np.array([0.5, 0.0, 0.0, 0.2])
    run = Loop(plant, control).run(
        moving_commands if moving else Step(9.0, at=1.0, initial=0.2),
        {"push": 0.7}, duration=3.0, initial_state=start, initial_input=LAST,
    )  # fmt: skip
    states, inputs, _ = made.plain_loop(
        [law], r, start, moving=moving, limit=limit, bumpless=True, last=LAST, blend_time=0.3, push=0.7
    )
    np.testing.assert_allclose(run.signals["input"], inputs, atol=1e-10)
    np.testing.assert_allclose(run.signals["state"], states, atol=1e-10)
    np.testing.assert_allclose(inputs[0], LAST, atol=1e-12)
    assert np.any(np.abs(inputs) == limit) == np.isfinite(limit)


@pytest.mark.quick_cases(4)
@pytest.mark.oracle
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("degree", [1, 3, 5])
@pytest.mark.parametrize("last", [-9.0, 0.0, 9.8, 20.0])
def test_the_integral_is_a_root_of_the_law_far_from_its_pose(arm_laws, degree, last, moving):
    law, x = arm_laws(degree), np.array([2.0, 0.3, 2.09, -0.2])
    control = Controller(law, None, moving=moving, start="bumpless")
    control.reset(input=last)
    command = np.array([2.1, 0.0, 2.2, 0.0, 9.0]) if moving else 2.0
    np.testing.assert_allclose(control.step(x, command), [last], atol=1e-9)
    memory, reference = remembered(control), np.append(np.zeros(4), 0.0)
    reference = command if moving else reference
    found = reference[4] + law.law(np.append(x - reference[:4], memory.integral))
    np.testing.assert_allclose(found, [last], atol=1e-9)
    assert abs(memory.bias[0]) < 1e-9
    assert abs(memory.integral[0]) < 3.0


@pytest.mark.ci("solves a law, and runs it twice")
@pytest.mark.oracle
def test_a_held_arm_does_not_move_when_the_law_takes_over(arm_laws, made):
    """At an equilibrium held by its input: from zero the arm falls, bumpless it stays."""
    plant = paper_arm().plant()
    x, u = equilibrium(plant, ("link_position",), np.array([2.0]))
    settings = {"reference": 2.0, "initial_state": x, "initial_input": u, "duration": 1.0}
    moves = {}
    for start in ("zero", "bumpless"):
        control = Controller(arm_laws(3), made.ukf(mean=x, covariance=1e-8), start=start)
        run = Loop(plant, control).run(**settings)
        moves[start] = np.abs(run.signals["state"] - x).max()
        assert (abs(run.signals["input"][0, 0] - u[0]) < 1e-9) == (start == "bumpless")
    assert moves["bumpless"] < 1e-6
    assert moves["zero"] > 0.1


def test_without_integrals_the_misfit_is_a_bias_that_fades(made):
    plant, _ = made.two_inputs()
    law = made.LinearLaw(plant.states, plant.inputs, [[-8.0, -5.0, 0.5, 0.0], [0.0, 0.0, -3.0, -2.0]])
    control = Controller(law, None, H, start="bumpless", blend_time=0.2)
    start = np.array([0.5, 0.0, 0.1, 0.2])
    run = Loop(plant, control).run(duration=1.0, initial_state=start, initial_input=LAST)
    misfit = np.array(LAST) - law.gain @ start
    expected = run.signals["state"] @ law.gain.T + np.outer(np.exp(-run.time / 0.2), misfit)
    np.testing.assert_allclose(run.signals["input"], expected, atol=1e-12)


class Parabola(Law):
    """u = −x + e² + e: no integral asks for less than −x − 1/4."""

    state_names, input_names, law_key = ("x", "x_integral"), ("u",), "parabola"
    operating_point, operating_input, law_data = np.zeros(2), np.zeros(1), np.array([1.0])

    def evaluate_law(self, x, data):
        return np.array([-x[0] + data[0] * x[1] * x[1] + x[1]])


@pytest.mark.parametrize(("last", "reached"), [(3.0, True), (-3.0, False)])
def test_what_no_integral_reaches_is_held_and_never_grows(last, reached):
    control = Controller(Parabola(), None, H, start="bumpless", blend_time=1.0)
    control.reset(input=last)
    np.testing.assert_allclose(control.step(0.5, 0.5), [last], atol=1e-12)
    memory = remembered(control)
    held = last - (-0.5 + memory.integral[0] ** 2 + memory.integral[0])
    np.testing.assert_allclose(memory.bias, [held], atol=1e-12)
    assert (abs(held) < 1e-9) == reached
    assert abs(held) <= abs(last + 0.5)
    bias = memory.bias.copy()
    second = control.step(0.5, 0.5)  # the error is zero: the integral rests
    np.testing.assert_allclose(second - last, bias * (np.exp(-H) - 1.0), atol=1e-12)


@pytest.mark.ci("compiles every controller twice")
@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["ukf", "none", "two inputs"])
@pytest.mark.parametrize("moving", [False, True])
def test_composed_equals_one_trace(made, arm_laws, monkeypatch, kind, moving):
    law = made.two_inputs()[1] if kind == "two inputs" else arm_laws(3)
    estimator = made.ukf(H) if kind == "ukf" else None
    made_of = []
    for limit, table in ((10**9, 10**9), (-1, 0)):
        monkeypatch.setattr(controller, "ONE_TRACE", limit)
        monkeypatch.setattr(law_code, "TABLE", table)
        made_of.append(Controller(law, estimator, H, 6.0, moving=moving, start="bumpless"))
        assert made_of[-1].composed == (limit < 0)
        _ = made_of[-1].data_vector
    one, composed = made_of
    rng = np.random.default_rng(0)
    last = rng.normal(size=len(law.input_names))
    for c in made_of:
        c.reset(input=last)
    for k in range(20):
        y, r = 0.1 * rng.normal(size=len(one.measured)) + 1.0, rng.normal(size=len(one.commanded))
        u = one.step(y, r)
        np.testing.assert_allclose(composed.step(y, r), u, rtol=1e-8, atol=1e-9)
        if k == 0:
            np.testing.assert_allclose(u, last, atol=1e-9)
    np.testing.assert_allclose(composed._history.memory, one._history.memory, rtol=1e-7, atol=1e-9)


@pytest.mark.ci("controllers of seven links")
def test_seven_links(seven):
    """Composed, a table of monomials, seven integrals: the law is made to ask for the last input."""
    solution, estimator, point, rest = seven
    rng = np.random.default_rng(0)
    x = point.copy()
    x[:7] += 0.3 * rng.normal(size=7)
    x[14:21] = x[:7] + 0.01 * rng.normal(size=7)
    for filter in (None, estimator(period=2e-4)):
        control = Controller(solution, filter, 2e-4, start="bumpless", latency=0)
        assert control.composed
        assert control.law_code.table is not None
        last = rest + 20.0 * rng.normal(size=7)
        control.reset(input=last)
        y = x if filter is None else point[:7] + 1e-3 * rng.normal(size=7)
        np.testing.assert_allclose(control.step(y), last, rtol=1e-12)
        memory = remembered(control)
        asked = rest + solution.law(np.append(control.estimate - point, memory.integral))
        np.testing.assert_allclose(asked, last, atol=1e-7)
        np.testing.assert_allclose(asked + memory.bias, last, atol=1e-8)


def test_the_estimators_first_step_sees_the_input(made):
    """Of a measurement with feedthrough, y = x + 2u, through the Kalman filter's equations."""
    plant = Plant(lambda x, u, d, p: -x + u, lambda x, u, p: x + 2.0 * u, ("x",), ("u",))
    law = made.LinearLaw(("x",), ("u",), [[-1.0]])
    control = Controller(law, ExtendedKalmanFilter(plant, H, 1e-6, 0.5, np.zeros(1), 1.5), H)
    for last in (None, 0.0, 0.4):
        control.reset(input=last)
        control.step(1.0)
        np.testing.assert_allclose(control.estimate, [0.75 * (1.0 - 2.0 * (last or 0.0))], rtol=1e-12)
    run = Loop(plant, control).run(duration=0.05, initial_state=[1.0], initial_input=0.4)
    np.testing.assert_allclose(run.signals["output"][0], [1.8], rtol=1e-12)
    np.testing.assert_allclose(run.signals["estimate"][0], [0.75], rtol=1e-12)


@pytest.mark.oracle
def test_a_black_box_and_a_late_input_run_the_same(made):
    plant, law = made.two_inputs()

    control = Controller(law, None, H, start="bumpless")
    runs = [
        Loop(true, control, delay=2 * H).run(Quintic(0.0, 1.0, 1.0), initial_input=LAST)
        for true in (plant, PlantBox(plant, seen=lambda x: x))
    ]
    for name in ("state", "input", "reference"):
        np.testing.assert_allclose(runs[1].signals[name], runs[0].signals[name], atol=1e-10)
    x = runs[0].signals["state"]
    np.testing.assert_allclose(
        x[1] - x[0], [0.5 * H**2 * 1.2, H * 1.2, -(H**2) * 0.7, -2 * H * 0.7], rtol=1e-9
    )
    np.testing.assert_allclose(runs[0].signals["input"][0], LAST, atol=1e-12)


def test_a_start_from_zero_costs_nothing(made):
    plain, zero = (
        Controller(made.law, made.ukf(), latency=0),
        Controller(made.law, made.ukf(), start="zero", latency=0),
    )
    assert plain.traced() is zero.traced()
    assert set(plain.memory.parts) == {
        "belief", "u", "integral", "position", "reference", "started", "doubt",
    }  # fmt: skip
    assert "inverse_slope" not in plain.data.parts
    bumpless = Controller(made.law, made.ukf(), start="bumpless", latency=0)
    assert bumpless.code_key != plain.code_key
    assert bumpless.fresh().code_key == bumpless.code_key
    assert bumpless.fresh().blend_time == options.BLEND_TIME
    faster = Controller(made.law, made.ukf(), start="bumpless", blend_time=0.1, latency=0)
    assert faster.code_key == bumpless.code_key
    assert faster.fresh().blend_time == 0.1


def test_misfits_are_refused(made):
    for settings, word in (
        ({"start": "smooth"}, r"start[\s\S]*'smooth'"),
        ({"start": None}, r"start[\s\S]* None"),
        ({"start": "bumpless", "blend_time": 0.0}, r"positive[\s\S]* 0\.0"),
        ({"start": "bumpless", "blend_time": "slow"}, r"positive[\s\S]*'slow'"),
        ({"blend_time": 0.5}, r"blend_time=None .* 0\.5"),
    ):
        with pytest.raises(InvalidInput, match=word) as caught:
            Controller(made.law, None, **settings)
        assert caught.value.advice
    control = Controller(made.law, None, saturation=5.0, start="bumpless")
    loop = Loop(paper_arm().plant(), control)
    for u in ([1.0, 2.0], np.nan, 6.0, "all", [[1.0]]):
        with pytest.raises(InvalidInput, match=rf"before[\s\S]*\['motor_voltage'\].* {re.escape(repr(u))}"):
            control.reset(input=u)
        with pytest.raises(InvalidInput, match=rf"before[\s\S]*\['motor_voltage'\].* {re.escape(repr(u))}"):
            loop.run(duration=0.1, initial_input=u)
