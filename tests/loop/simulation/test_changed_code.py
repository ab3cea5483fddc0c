"""A run is that of the plant it is given: what a flow reads may change between two plants, but not in one.

The pairs of numbers ask for the same number of sub-steps, so that nothing but the code itself distinguishes the loops.
"""

import copy
import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest
from tests.builders import runge_kutta
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty, Plant

# Kernels that run once each: 1 s instead of 2 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

GRAVITY = 9.81
SCALE = 1.0


class Spring:
    """A model whose numbers are attributes, not parameters."""

    def __init__(self, stiffness):
        self.stiffness = stiffness

    def flow(self, x, u, d, p):
        return np.array([x[1], -self.stiffness * x[0] - x[1] + u[0] + d[0]])

    def output(self, x, u, p):
        return np.array([x[0]])


def falling(x, u, d, p):
    return np.array([x[1], -GRAVITY * np.sin(x[0]) - x[1] + u[0] + d[0]])


def measured(x, u, p):
    return np.array([SCALE * x[0]])


def plant_of(flow, output):
    return Plant(flow, output, ("a", "da"), ("u",), ("push",), {"mass": 1.0})


def built(plant):
    """Problem, law, estimator, loop: everything anew."""
    problem = plant.with_objective({"a": 3.0, "da": 1.0}, disturbances=("push",))
    solution = fh.solve_hji(problem, gamma=2.0 * fh.smallest_gamma(problem), degree=4)
    ukf = fh.UnscentedKalmanFilter(plant, 0.01, 1e-6, 1e-6, np.zeros(2), 1e-4)
    return fh.Loop(plant, fh.Controller(solution, ukf, period=0.01, latency=0))


def run_of(plant):
    return built(plant).run(initial_state=[0.5, 0.0], duration=0.5)


def simulated(run, flow):
    """The same plant in plain NumPy, with the inputs of the run."""
    x = np.array(run.data.state[0])
    states = [x]
    for u in run.data.input.values[:-1]:
        for _ in range(10):
            x = runge_kutta(lambda x, u=u: flow(x, u, [0.0], None), x, 1e-3)
        states.append(x)
    return np.array(states)


def test_a_changed_global_is_in_the_next_plant(monkeypatch):
    for gravity in (9.81, 5.0, 9.81):
        monkeypatch.setitem(globals(), "GRAVITY", gravity)
        run = run_of(plant_of(falling, measured))
        np.testing.assert_allclose(run.data.state, simulated(run, falling), rtol=0, atol=1e-8)


def test_a_changed_global_of_the_output_is_in_the_next_plant(monkeypatch):
    for scale in (1.0, 0.25):
        monkeypatch.setitem(globals(), "SCALE", scale)
        run = run_of(plant_of(falling, measured))
        np.testing.assert_allclose(run.data.output[:, 0], scale * run.data.state[:, 0], rtol=1e-13)


def test_a_changed_object_of_a_bound_method_is_in_the_next_plant():
    spring = Spring(4.0)
    for stiffness in (30.0, 40.0):
        spring.stiffness = stiffness
        run = run_of(plant_of(spring.flow, spring.output))
        np.testing.assert_allclose(run.data.state, simulated(run, spring.flow), rtol=0, atol=1e-8)


def test_equal_code_is_compiled_once():
    one, two = (built(plant_of(spring.flow, spring.output)) for spring in (Spring(3.0), Spring(3.0)))
    assert one.prepared().code.kernel() is two.prepared().code.kernel()
    assert (
        built(plant_of(Spring(5.0).flow, Spring(5.0).output)).prepared().code.kernel()
        is not one.prepared().code.kernel()
    )


def test_a_plant_stays_what_it_was_and_models_are_not_mixed():
    spring = Spring(4.0)
    plant = plant_of(spring.flow, spring.output)
    first = run_of(plant)
    loop = built(plant)
    spring.stiffness = 40.0
    np.testing.assert_array_equal(
        loop.run(initial_state=[0.5, 0.0], duration=0.5).data.state, first.data.state
    )
    with refused_with(InvalidInput, "flow(x, u, d, p)", "plant", "with_parameters"):
        run_of(plant)  # its expansion would be that of the other spring
    spring.stiffness = 4.0
    np.testing.assert_array_equal(run_of(plant).data.state, first.data.state)


class Curved:
    """g2(x) by an attribute: the law has the exact one in it."""

    def __init__(self, slope):
        self.slope = slope

    def flow(self, x, u, d, p):
        return np.array([x[1], -x[0] - x[1] + (1.0 + self.slope * x[0]) * u[0] + d[0]])


def test_the_input_matrix_of_a_law_is_its_own():
    model, keys = Curved(0.1), []
    for slope in (0.1, 0.3, 0.1):
        model.slope = slope
        loop = built(plant_of(model.flow, measured))
        run = loop.run(initial_state=[0.5, 0.0], duration=0.2)
        law: Any = loop.controller.law
        estimate = run.data.estimate.values
        np.testing.assert_allclose(run.data.input[:, 0], law.law(estimate)[:, 0], rtol=1e-12, atol=1e-12)
        keys.append(law.law_key)
    assert keys[0] == keys[2] != keys[1]


class Halved(fh.HJISolution):
    """A law of one's own from another: half of it, or a third."""

    part = 0.5

    def evaluate_law(self, x, data):
        return self.part * super().evaluate_law(x, data)


def test_a_law_that_is_written_anew_has_code_of_its_own():
    solution = built(plant_of(falling, measured)).controller.law
    inputs = []
    for part in (0.5, 0.25):
        law = object.__new__(Halved)
        vars(law).update(vars(solution))
        object.__setattr__(law, "part", part)
        inputs.append(fh.Controller(law, None, period=0.01).step([0.3, 0.1]))
    np.testing.assert_allclose(inputs[0], 2.0 * inputs[1], rtol=1e-14)


# Pickles, estimators alone, penalties -----------------------------------------------------------------
def test_a_pickle_is_the_plant_as_it_was_whatever_its_text_computes_where_it_is_read(monkeypatch):
    """`falling` is found by its name, and reads a global that has another value by then, as in another process."""
    monkeypatch.setitem(globals(), "GRAVITY", 5.0)
    loop: Any = built(plant_of(falling, measured))
    first = loop.run(initial_state=[0.5, 0.0], duration=0.5)
    plant, sent = loop.controller.estimator.plant, pickle.dumps(loop)
    rates = plant.derivative([0.5, 0.0])
    monkeypatch.setitem(globals(), "GRAVITY", 9.81)
    read = pickle.loads(sent)
    again = read.controller.estimator.plant
    np.testing.assert_array_equal(
        read.run(initial_state=[0.5, 0.0], duration=0.5).data.state, first.data.state
    )
    np.testing.assert_array_equal(again.derivative([0.5, 0.0]), rates)
    assert again.code_key == plant.code_key
    with refused_with(InvalidInput, "flow(x, u, d, p)", "plant", "with_parameters"):
        again.with_objective({"a": 3.0}, disturbances=("push",)).expand(2)
    monkeypatch.setitem(globals(), "GRAVITY", 5.0)
    assert again.with_objective({"a": 3.0}, disturbances=("push",)).expand(2).f_parts[1][1, 0] == -5.0


@pytest.mark.parametrize("kind", [fh.UnscentedKalmanFilter, fh.ExtendedKalmanFilter])
def test_an_estimator_alone_runs_the_plant_that_was_traced(monkeypatch, kind):
    """Its numbers are those of the controller's step: before and after a change, in copies and in pickles."""
    plant = plant_of(falling, measured)
    one = kind(plant, 0.01, 1e-6, 1e-6, np.array([1.0, 0.0]), 1e-2)
    others = [one, copy.deepcopy(one), pickle.loads(pickle.dumps(one))]
    fresh = copy.deepcopy(one)
    for step in (fresh.correct, fresh.predict, fresh.correct):
        step([0.9])
    monkeypatch.setitem(globals(), "GRAVITY", 5.0)
    monkeypatch.setitem(globals(), "SCALE", 0.5)
    for other in others:
        for step in (other.correct, other.predict, other.correct):
            step([0.9])
        np.testing.assert_array_equal(other.mean, fresh.mean)


WEIGHT = 3.0


def weighted(x, p):
    return np.array([WEIGHT * x[0], x[1]])


@pytest.mark.ci("solves for one more law")
def test_a_penalty_stays_what_it_was_and_a_changed_one_is_refused(monkeypatch):
    problem = plant_of(falling, measured).with_objective(Penalty(weighted), disturbances=("push",))
    solution = fh.solve_hji(problem, gamma=2.0 * fh.smallest_gamma(problem), degree=4)
    sent, x = pickle.dumps(solution), np.array([0.5, 0.1])
    monkeypatch.setitem(globals(), "WEIGHT", 30.0)
    assert abs(solution.residual(x)) < 0.01  # traced for the first time only now
    assert pickle.loads(sent).residual(x) == solution.residual(x)
    region: Any = solution.sampled_region()
    assert region.level > 0.1
    np.testing.assert_array_equal(problem.fields(x)[3], [[1.5, 0.1]])
    with refused_with(InvalidInput, "h(x, p)", "problem", "with_objective"):
        fh.solve_hji(problem, gamma=solution.gamma, degree=4)


def test_a_region_whose_inequality_fails_at_once_has_level_zero(monkeypatch):
    """A solution beside another problem: r > 0 at every point, however near to 0."""
    plant = plant_of(falling, measured)
    problem = plant.with_objective(Penalty(weighted), disturbances=("push",))
    solution = fh.solve_hji(problem, gamma=2.0 * fh.smallest_gamma(problem), degree=4)
    monkeypatch.setitem(globals(), "WEIGHT", 30.0)
    heavier = plant.with_objective(Penalty(weighted), disturbances=("push",))
    region: Any = dataclasses.replace(solution, problem=heavier).sampled_region()
    assert region.level == 0.0


def test_another_gamma_expands_and_traces_nothing_but_asks(monkeypatch):
    """The last expansion is kept, and whether the text has changed is told without a trace."""
    spring, traces = Spring(4.0), []
    problem = plant_of(spring.flow, spring.output).with_objective({"a": 3.0}, disturbances=("push",))
    first = problem.expand(3)
    traced = type(problem.plant)._trace_flow
    monkeypatch.setattr(type(problem.plant), "_trace_flow", lambda self: traces.append(self) or traced(self))
    assert problem.expand(3) is first
    assert not traces
    for same in (copy.copy(problem), copy.deepcopy(problem)):
        assert "_expansion" not in vars(same)
        np.testing.assert_array_equal(same.expand(3).f_parts[1], first.f_parts[1])
    spring.stiffness = 40.0
    with refused_with(InvalidInput, "flow(x, u, d, p)", "plant", "with_parameters"):
        problem.expand(3)
    spring.stiffness = 4.0
    assert problem.expand(3) is first
    assert problem.expand(1).f_parts[1][1, 0] == first.f_parts[1][1, 0]
