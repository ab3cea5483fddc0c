"""A controller composed of pieces in loops against one trace, the interpreter, plain floats, and NumPy's law."""

import numpy as np
import pytest
from tests.interpreter import interpret

from flexhinf.codegen import Program, compile_program
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.loop import Controller, Loop, Step
from flexhinf.loop.controller import controller, law_code
from flexhinf.loop.controller.memory import step_program
from flexhinf.loop.controller.step import controller_step
from flexhinf.plant import Law, Plant
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import PolynomialLaw
from flexhinf.robot import paper_arm
from flexhinf.scalars import jacobian

# Kernels that run once each: 3 s instead of 8 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

SETTINGS = {"process_noise": 1e-8, "measurement_noise": 1e-6, "covariance": 1e-4}


@pytest.fixture
def routes(monkeypatch):
    """``routes(make)``: what `make` makes as one trace, and composed with every law that can be as a table."""

    def both(make):
        made = []
        for limit, table in ((10**9, 10**9), (-1, 0)):
            monkeypatch.setattr(controller, "ONE_TRACE", limit)
            monkeypatch.setattr(law_code, "TABLE", table)
            made.append(make())
            assert made[-1].composed == (limit < 0)
            _ = made[-1].data_vector
        return made

    return both


def arm_filter(kind, **changes):
    settings = {"plant": paper_arm().plant(), "period": 1e-3, "mean": np.zeros(4), **SETTINGS, **changes}
    return kind(**settings)


KINDS = {
    "ukf": lambda: arm_filter(UnscentedKalmanFilter),
    "sub-steps": lambda: arm_filter(UnscentedKalmanFilter, period=0.05),
    "points kept": lambda: arm_filter(UnscentedKalmanFilter, redraw=False),
    "bounds": lambda: arm_filter(UnscentedKalmanFilter, bounds={"link_velocity": (-0.4, 0.4)}),
    "kept and bounds": lambda: arm_filter(
        UnscentedKalmanFilter, redraw=False, bounds={"link_velocity": (-0.4, 0.4)}
    ),
    "a known state": lambda: arm_filter(UnscentedKalmanFilter, covariance=[0.0, 1e-4, 0.0, 1e-4]),
    "negative weight": lambda: arm_filter(UnscentedKalmanFilter, alpha=0.9, kappa=-0.5),
    "two outputs": lambda: arm_filter(
        UnscentedKalmanFilter, plant=paper_arm().plant(("motor_position", "link_position"))
    ),
    "ekf": lambda: arm_filter(ExtendedKalmanFilter),
    "ekf and sub-steps": lambda: arm_filter(ExtendedKalmanFilter, period=0.05),
    "none": lambda: None,
}


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.filterwarnings("ignore:The central covariance weight")
@pytest.mark.parametrize("kind", KINDS)
def test_composed_equals_one_trace(made, routes, kind):
    estimator = KINDS[kind]()
    period = 1e-3 if estimator is None else estimator.period
    one, composed = routes(lambda: Controller(made.law, estimator, period, saturation=6.0))
    rng = np.random.default_rng(0)
    for k in range(50):
        y, r = 0.05 * rng.normal(size=len(one.measured)) + 0.02 * k, np.array([0.02 * k])
        np.testing.assert_allclose(composed.step(y, r), one.step(y, r), rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(composed.estimate, one.estimate, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(composed._history.memory, one._history.memory, rtol=1e-8, atol=1e-12)


def program_of(composed):
    sizes = {"y": len(composed.measured), "r": max(1, len(composed.tracked)), "data": composed.data.size}
    sizes |= {
        "memory": composed.memory.size,
        "u": len(composed.law.input_names),
        "estimate": len(composed.states),
    }
    return step_program(sizes, bool(composed.commanded), composed.gaps, composed.steps)


def stepped(program: Program, composed, make, lanes=1, steps=5):
    """u of some steps, with the same numbers in every lane."""
    rng = np.random.default_rng(1)
    memory, data = composed.initial_memory(), composed.data_vector
    arrays = {b.name: np.zeros((b.size, lanes)) for b in program.buffers if b.role != "work"}
    arrays["memory"][:], arrays["data"][:] = memory[:, None], data[:, None]
    kernel, inputs = make(program, lanes), []
    for _ in range(steps):
        arrays["y"][:] = 0.05 * rng.normal(size=(len(arrays["y"]), 1))
        assert kernel.run(arrays).fine
        inputs.append(arrays["u"].copy())
    return np.array(inputs)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["ukf", "points kept", "ekf", "two outputs"])
def test_composed_equals_interpreted_and_any_lanes(made, routes, kind):
    _, composed = routes(lambda: Controller(made.law, KINDS[kind](), saturation=6.0))
    program = program_of(composed)
    one = stepped(program, composed, compile_program)
    np.testing.assert_allclose(one, stepped(program, composed, interpret), rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(stepped(program, composed, compile_program, 3), np.repeat(one, 3, axis=2))


@pytest.mark.ci("compiles a loop in both forms; steps in both are quick")
@pytest.mark.oracle
def test_the_composed_loop_equals_that_of_one_trace(made, routes):
    plant = paper_arm().plant(inductance=True)
    one, composed = routes(lambda: Controller(made.law, made.ukf(), saturation=9.0))
    runs = [Loop(plant, c).run(Step(1.0), {"link_torque": 0.5}, 1e-3, 1.0) for c in (one, composed)]
    for name, values in runs[0].signals.items():
        np.testing.assert_allclose(runs[1].signals[name], values, atol=1e-9)
    for y, r, u in zip(*(runs[1].signals[name] for name in ("output", "reference", "input"))):
        np.testing.assert_array_equal(composed.step(y, r), u)


@pytest.mark.ci("compiles two controllers")
@pytest.mark.oracle
def test_two_inputs_and_a_state_that_is_not_tracked(made, routes):
    plant, law = made.two_inputs()
    ukf = UnscentedKalmanFilter(plant, 1e-2, 1e-4, 1e-6, np.zeros(4), 1e-2)
    one, composed = routes(lambda: Controller(law, ukf, 1e-2, saturation=2.0))
    for k in range(20):
        y = np.array([0.1 * k, -0.05 * k])
        np.testing.assert_allclose(composed.step(y, 0.3), one.step(y, 0.3), rtol=1e-10, atol=1e-12)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter])
def test_without_parameters_or_commands(made, routes, kind):
    plant = Plant(
        lambda x, u, d, p: np.array([x[1], u[0] - np.sin(x[0])]), lambda x, u, p: x[0], ("x", "v"), ("u",)
    )
    law = made.LinearLaw(plant.states, plant.inputs, [-2.0, -3.0])
    estimator = kind(plant, 1e-2, 1e-6, 1e-6, np.zeros(2), 1e-4)
    one, composed = routes(lambda: Controller(law, estimator, 1e-2))
    for k in range(10):
        np.testing.assert_allclose(composed.step(0.1 * k), one.step(0.1 * k), rtol=1e-11, atol=1e-14)


# The law --------------------------------------------------------------------------------------------
class RandomLaw(Law):
    """A polynomial of these degrees, as a law of the paper's arm."""

    state_names = (
        "link_position",
        "link_velocity",
        "motor_position",
        "motor_velocity",
        "link_position_integral",
    )
    input_names = ("motor_voltage",)
    operating_point, operating_input = np.zeros(5), np.zeros(1)

    def __init__(self, degrees):
        size = sum(basis.count(5, k) for k in degrees)
        self.polynomial = PolynomialLaw(5, degrees, np.random.default_rng(0).normal(size=(1, size)))
        self.degrees = degrees

    @property
    def law_data(self):
        return self.polynomial.coefficients.ravel()

    @property
    def law_key(self):
        return f"random {self.degrees}"

    @property
    def law_table(self):
        return self.polynomial

    def evaluate_law(self, x, data):
        return self.polynomial.evaluate(x, np.asarray(data).reshape(1, -1))


@pytest.mark.quick_cases(3)
@pytest.mark.oracle
@pytest.mark.parametrize("degrees", [(1,), (1, 3), (1, 2, 3), (0, 1, 4), (2, 5), (3,)])
def test_a_law_as_a_table_is_the_law(routes, degrees):
    law = RandomLaw(degrees)
    one, composed = routes(lambda: Controller(law, None))
    assert one.law_code.table is None
    assert composed.law_code.table is law.polynomial
    traced = jacobian(law.evaluate_law, 5, law.law_data.size)(np.zeros(5), law.law_data)[1]
    np.testing.assert_allclose(law_code.law_slope(law), traced, atol=1e-15)
    for x in np.random.default_rng(1).normal(size=(5, 4)):
        for c in (one, composed):
            c.reset()
        expected = law.evaluate_law(np.append(x, 0.0), law.law_data)
        np.testing.assert_allclose(one.step(x, 0.0), expected, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(composed.step(x, 0.0), expected, rtol=1e-12, atol=1e-12)


def test_a_class_that_overrides_the_law_alone_is_no_table(routes):
    class Doubled(RandomLaw):
        def evaluate_law(self, x, data):
            return 2.0 * super().evaluate_law(x, data)

    doubled, plain = (
        routes(lambda kind=kind: Controller(kind((1, 3)), None))[1] for kind in (Doubled, RandomLaw)
    )
    assert doubled.law_code.table is None
    x = np.array([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(doubled.step(x, 0.0), 2.0 * plain.step(x, 0.0), rtol=1e-12)


@pytest.mark.ci("compiles three controllers")
def test_a_class_that_overrides_an_update_alone_is_one_piece(made, routes):
    class Nudged(UnscentedKalmanFilter):
        def time_update(self, belief, u, p, process_noise):
            moved = super().time_update(belief, u, p, process_noise)
            return type(moved)(moved.mean + 0.01, moved.covariance)

        def innovate(self, belief, y, u, p, measurement_noise):
            belief, *rest = super().innovate(belief, y, u, p, measurement_noise)
            return type(belief)(belief.mean + 0.1, belief.covariance), *rest

    one, composed = routes(lambda: Controller(made.law, arm_filter(Nudged)))
    plain = Controller(made.law, made.ukf())
    for k in range(5):
        u = composed.step(0.1 * k, 1.0)
        np.testing.assert_allclose(u, one.step(0.1 * k, 1.0), rtol=1e-10)
        assert np.abs(u - plain.step(0.1 * k, 1.0)) > 0.1


# Seven links ----------------------------------------------------------------------------------------
@pytest.mark.ci("a controller of seven links, compiled and in Python")
@pytest.mark.oracle
@pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter])
def test_seven_links_composed_equal_the_text_on_floats(seven, kind):
    solution, estimator, point, _ = seven
    composed = Controller(solution, estimator(kind), 2e-4, latency=0)
    assert composed.composed
    assert composed.law_code.table is not None
    assert composed.estimator.sub_steps == 1
    rng, memory, data = np.random.default_rng(0), composed.initial_memory(), composed.data_vector
    for k in range(2):
        y = point[:7] + 1e-3 * rng.normal(size=7)
        r = point[:7] + 0.01 * k
        named = composed.memory.named(memory), composed.data.named(data)
        u, estimate, after = controller_step(
            composed.law_code, composed.estimator, composed._sources, y, r, *named
        )
        memory = composed.memory.flat(after)
        np.testing.assert_allclose(composed.step(y, r), u, rtol=1e-9, atol=1e-9 * np.abs(u).max())
        np.testing.assert_allclose(composed.estimate, estimate, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(composed._history.memory, memory, rtol=1e-9, atol=1e-12)


@pytest.mark.ci("solves a law of seven links")
@pytest.mark.oracle
def test_the_law_of_seven_links_is_the_solutions(seven):
    solution, _, point, rest = seven
    composed = Controller(solution, None)
    for x in point + 0.05 * np.random.default_rng(0).normal(size=(3, 28)):
        composed.reset()
        deviation = np.append(x - point, np.zeros(7))
        np.testing.assert_allclose(composed.step(x) - rest, solution.law(deviation), rtol=1e-9)


@pytest.mark.ci("a controller of seven links, interpreted")
@pytest.mark.oracle
def test_seven_links_from_the_cache_are_the_same(seven, tmp_path, monkeypatch):
    """A step of eight stages, interpreted, compiled afresh and taken from the cache."""
    solution, estimator, point, _ = seven
    composed = Controller(solution, estimator(period=1e-3), 1e-3)
    assert (composed.estimator.stages, composed.estimator.sub_steps) == (8, 1)
    program = program_of(composed)
    monkeypatch.setenv("FLEXHINF_CACHE", str(tmp_path))
    results = []
    for make in (compile_program, compile_program, interpret):
        arrays = {b.name: np.zeros(b.size) for b in program.buffers if b.role != "work"}
        arrays["memory"][:], arrays["data"][:] = composed.initial_memory(), composed.data_vector
        arrays["y"][:] = arrays["r"][:] = point[:7] + 1e-4
        kernel = make(program)
        assert kernel.run(arrays).fine
        assert kernel.run(arrays).fine
        results.append(arrays["memory"])
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_allclose(results[0], results[2], rtol=1e-9, atol=1e-12)
