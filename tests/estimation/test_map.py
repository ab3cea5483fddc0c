"""Maps: plants that give the state one period later, in filters, loops, files and C."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from tests.builders import FORMS, KALMAN, linear_law, linear_plant, runge_kutta
from tests.estimation import kalman
from tests.estimation.composing import composed
from tests.estimation.kalman import LinearCase
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ConstantGainFilter, ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.estimation.stationary import linear_model, stationary_gain

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


PERIOD = 0.05


def turned(x, u, d, p):
    """A damped oscillator over one period, pushed by u and d."""
    return np.array([
        x[0] + 0.05 * x[1], x[1] - p.pull * np.sin(x[0]) - 0.02 * x[1] + 0.05 * u[0] + 0.1 * d[0],
    ])  # fmt: skip


def first(x, u, p):
    return x[:1]


def pendulum(**changes):
    names = {
        "states": ("angle", "speed"), "inputs": ("torque",), "disturbances": ("wind",), "outputs": ("angle_seen",),
        "parameters": {"pull": 0.3},
    }  # fmt: skip
    return fh.Plant(turned, first, **names, sampled=True, **changes)


# Filters -------------------------------------------------------------------------------------------------
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@KALMAN
@FORMS
@pytest.mark.parametrize(("n", "p"), [(3, 1), (6, 4)])
def test_on_a_linear_map_it_is_the_kalman_filter(kind, form, n, p):
    case = LinearCase(n, 2, p, seed=n)
    plant = linear_plant(case.a, case.b, case.c, sampled=True)
    estimator = kind(**case.arguments(plant=plant), form=form)
    assert (estimator.stages, estimator.sub_steps) == (1, 1)
    step, belief, expected = composed(estimator), estimator.initial, (case.mean, case.p0)
    for _ in range(5):
        y, u = case.rng.normal(size=p), case.rng.normal(size=2)
        belief = step(belief, y, u)
        estimator.correct(y)
        estimator.predict(u)
        expected = kalman.predict(*kalman.correct(*expected, case.c, y, case.r), case.a, case.b, u, case.q)
        for one in (belief, estimator):
            assert kalman.relative(one.mean, one.covariance, *expected) < 1e-11


@pytest.mark.oracle
@FORMS
def test_the_unscented_filter_of_a_map_is_its_formula(form):
    """Of Table 3 with α = 1, β = 2, κ = 0: 2n points of equal weight, and a centre that counts in the covariance."""
    plant, x, p0 = pendulum(), np.array([0.9, -0.4]), np.array([[0.04, 0.01], [0.01, 0.09]])
    estimator = UnscentedKalmanFilter(plant, PERIOD, 1e-4, 1e-3, x, p0, form=form)
    root = np.linalg.cholesky(p0) if form == "covariance" else estimator.initial.root.T
    points = np.column_stack([x, *(x + np.sqrt(2.0) * root.T), *(x - np.sqrt(2.0) * root.T)])
    moved = np.array([turned(at, [0.3], [0.0], plant.parameters.named(np.array([0.3]))) for at in points.T])
    mean = moved[1:].mean(axis=0)
    weights = np.array([2.0, *[0.25] * 4])
    estimator.predict([0.3])
    np.testing.assert_allclose(estimator.mean, mean, rtol=1e-14)
    spread = (moved - mean).T @ np.diag(weights) @ (moved - mean) + 1e-4 * np.eye(2)
    np.testing.assert_allclose(estimator.covariance, spread, rtol=1e-12)


@pytest.mark.oracle
def test_a_map_that_integrates_is_the_plant_that_it_integrates():
    """One Runge–Kutta step written as a map, against the filter that makes the step itself."""

    def flow(x, u, d, p):
        return np.array([x[1], -6.0 * np.sin(x[0]) - 0.4 * x[1] + u[0]])

    def step(x, u, d, p):
        return runge_kutta(lambda x: flow(x, u, d, p), x, PERIOD)

    names = (("angle", "speed"), ("torque",))
    given = (PERIOD, 1e-4, 1e-3, [0.5, 0.1], 0.04)
    for kind in (UnscentedKalmanFilter, ExtendedKalmanFilter):
        whole, mapped = (
            kind(fh.Plant(flow, first, *names), *given),
            kind(fh.Plant(step, first, *names, sampled=True), *given),
        )
        assert (whole.stages, whole.sub_steps) == (4, 1)
        for one in (whole, mapped):
            one.correct([0.45])
            one.predict([0.2])
            one.correct([0.4])
        np.testing.assert_allclose(mapped.mean, whole.mean, rtol=1e-13)
        np.testing.assert_allclose(mapped.covariance, whole.covariance, rtol=1e-12)


@pytest.mark.oracle
def test_the_stationary_gain_of_a_map_is_that_of_the_riccati_equation():
    from scipy.linalg import solve_discrete_are

    estimator = ExtendedKalmanFilter(pendulum(), PERIOD, [1e-5, 1e-4], 1e-3, np.zeros(2), 1.0)
    f, h = linear_model(estimator, np.zeros(2), np.zeros(1))
    np.testing.assert_allclose(f, [[1.0, 0.05], [-0.3, 0.98]])
    p = solve_discrete_are(f.T, h.T, np.diag([1e-5, 1e-4]), [[1e-3]])
    gain = stationary_gain((f, h), estimator.process_noise, estimator.measurement_noise)
    np.testing.assert_allclose(gain, p @ h.T / (h @ p @ h.T + 1e-3), rtol=1e-9)
    for _ in range(200):
        estimator.predict([0.0])
        estimator.correct([0.0])
    steady = ConstantGainFilter(estimator, gain)
    np.testing.assert_allclose(
        steady.time_update(steady.initial, np.array([1.0]), estimator._parameters, 0.0).mean, [0.0, 0.05]
    )


# Loops, files and C ---------------------------------------------------------------------------------------
def controller(form="covariance", **options):
    estimator = UnscentedKalmanFilter(pendulum(), PERIOD, [1e-6, 1e-5], 1e-4, [0.4, 0.0], 0.01, form=form)
    return fh.Controller(linear_law(pendulum(), [-2.0, -1.0]), estimator, PERIOD, **options)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@FORMS
@pytest.mark.parametrize("latency", [0, 1])
def test_a_loop_evaluates_the_map_once_a_period(form, latency):
    """Against the same loop step by step: the controller, then the map with the disturbance of the sample."""
    true = pendulum().with_parameters(pull=0.35)
    control = controller(form, latency=latency)
    loop = fh.Loop(true, control)
    assert loop.sub_steps == 1
    run = loop.run(
        disturbance={"wind": fh.Step(0.2, at=10 * PERIOD)}, duration=40 * PERIOD, initial_state=[0.5, 0.0]
    )
    stepped, x = control.fresh(), np.array([0.5, 0.0])
    acting = [control.input_before()] * latency
    for k in range(41):
        np.testing.assert_allclose(run.signals["state"][k], x, rtol=1e-9, atol=1e-12)
        acting.append(stepped.step(x[:1]))
        np.testing.assert_allclose(run.signals["estimate"][k], stepped.estimate, rtol=1e-9, atol=1e-12)
        wind = 0.2 if k >= 10 else 0.0
        x = turned(x, acting.pop(0), [wind], true.parameters.named(np.array([0.35])))
    assert loop.ensemble(duration=1.0).run([{}, {"pull": 0.4}], seeds=0).sub_steps.tolist() == [1, 1]


def test_the_controller_of_a_map_is_saved_pickled_and_copied(tmp_path):
    control = controller("square_root")
    control.save(tmp_path / "controller")
    others = (
        fh.load_controller(tmp_path / "controller"),
        pickle.loads(pickle.dumps(control)),
        copy.copy(control),
    )
    expected = [control.step([0.1 * k]) for k in range(5)]
    for other in others:
        plant = other.estimator.plant
        assert plant.sampled
        assert (other.estimator.stages, other.estimator.sub_steps) == (1, 1)
        other.reset()
        np.testing.assert_array_equal([other.step([0.1 * k]) for k in range(5)], expected)


@pytest.mark.ci("exports and compiles C")
def test_the_exported_code_of_a_map_steps_alike(tmp_path):
    control = controller("square_root")
    compiled = fh.load_compiled(fh.compile_controller(control, tmp_path / "library.so"))
    for k in range(6):
        np.testing.assert_allclose(compiled.step([0.05 * k]), control.step([0.05 * k]), rtol=1e-12)


def test_a_map_holds_where_it_maps_a_state_to_itself():
    """The input before the first sample, and the windup bound, are those of x⁺ = x."""
    held = 0.3 * np.sin(0.4) / 0.05
    assert controller().input_before()[0] == pytest.approx(held, rel=1e-12)
    plant = pendulum()
    np.testing.assert_allclose(plant.change([0.4, 0.0], [held]), 0.0, atol=1e-15)
    plant.check_equilibrium(np.array([0.4, 0.0]), np.array([held]), "", "")
    with refused_with(InvalidInput, "x⁺ = x", "speed"):
        plant.check_equilibrium(np.array([0.4, 0.0]), np.zeros(1), "No rest.", "another point")


def test_a_map_and_a_flow_of_the_same_text_are_different_plants():
    sampled, flowing = (
        pendulum(),
        fh.Plant(turned, first, ("angle", "speed"), ("torque",), ("wind",), {"pull": 0.3}, ("angle_seen",)),
    )
    assert sampled.code_key != flowing.code_key
    assert sampled.with_parameters(pull=0.2).sampled
    assert "map" in sampled.summary()["time"]
    assert "time" not in flowing.summary()


def test_a_map_is_a_sampled_system_of_python_control():
    system = pendulum().to_control(x=np.zeros(2))
    assert system.dt is True
    np.testing.assert_allclose(system.A, [[1.0, 0.05], [-0.3, 0.98]])
    np.testing.assert_allclose(system.B, [[0.0, 0.0], [0.05, 0.1]])
    loop = fh.Loop(pendulum(), controller()).to_control()
    state = np.concatenate([[0.5, 0.0], controller().initial_memory()])
    after = loop.updfcn(0.0, state, np.zeros(1), {})
    np.testing.assert_allclose(
        after[:2],
        turned([0.5, 0.0], controller().input_before(), [0.0], pendulum().parameters.named(np.array([0.3]))),
    )


# What has no map --------------------------------------------------------------------------------------------
REFUSED = {
    "derivative": lambda plant: plant.derivative(),
    "linearise": lambda plant: plant.linearise(),
    "synthesis": lambda plant: plant.with_objective({"angle": 1.0, "torque": 1.0}, disturbances=("wind",)),
    "observer": lambda plant: fh.OutputInjectionObserver(plant, PERIOD, 1e-4, 1e-4, np.zeros(2)),
    "linear plant": lambda plant: fh.plant.linear_plant(plant, np.zeros(2), np.zeros(1)),
    "FMU": lambda plant: __import__("flexhinf.export.fmu", fromlist=["x"]).export_plant_fmu(
        plant, "never.fmu"
    ),
    "linear loop": lambda plant: EquilibriumLoop(linear_law(pendulum(), [-2.0, -1.0]), None, plant, PERIOD),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_needs_a_derivative_refuses_a_map(what):
    with refused_with(InvalidInput, "map", "sampled=True"):
        REFUSED[what](pendulum())


def test_a_map_has_neither_sub_steps_nor_friction_of_its_own():
    with refused_with(InvalidInput, "sub_steps", 4):
        fh.Loop(pendulum(), controller(), sub_steps=4)
    with refused_with(InvalidInput, "arrest", "sampled=True"):
        pendulum(arrest=lambda x, h, p: x)
    with refused_with(InvalidInput, "sampled", "yes"):
        fh.Plant(turned, first, ("a", "b"), ("u",), ("d",), {"pull": 1.0}, sampled="yes")


@pytest.mark.oracle
def test_a_log_at_whole_periods_is_filtered_with_a_map():
    """Row by row with the filter's own `correct` and `predict`; a gap of two periods is two predictions."""
    estimator = UnscentedKalmanFilter(pendulum(), PERIOD, [1e-6, 1e-5], 1e-4, [0.4, 0.0], 0.01)
    times, rng = PERIOD * np.array([0.0, 1.0, 2.0, 4.0, 5.0]), np.random.default_rng(1)
    u, y = rng.normal(size=5), 0.4 + 0.01 * rng.normal(size=5)
    found = fh.filter_log(estimator, (times, u, y))["estimate"].values
    for k in range(5):
        estimator.correct(y[k : k + 1])
        np.testing.assert_allclose(found[k], estimator.mean, rtol=1e-9)
        for _ in range(round((times[min(k + 1, 4)] - times[k]) / PERIOD)):
            estimator.predict(u[k : k + 1])
    with refused_with(InvalidInput, "map", 0.05, 0.035):
        fh.filter_log(estimator, ([0.0, 0.07, 0.14], u[:3], y[:3]))
