"""Gates and bounds of estimators with a constant gain: by SciPy's Lyapunov and Riccati equations and quantile."""

from __future__ import annotations

import pickle
import shutil

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov
from scipy.stats import chi2
from tests.builders import linear_law, still
from tests.estimation.test_modal import BOTH, arm, controller, modal
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.analysis.sampled_controller import SampledController
from flexhinf.errors import InvalidInput
from flexhinf.estimation import (
    ConstantGainFilter,
    ExtendedKalmanFilter,
    ModalFilter,
    OutputInjectionObserver,
    linear_model,
)
from flexhinf.estimation.stationary import stationary_error

# Kernels that run once each: 2 s instead of 4 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

PERIOD, Q, R = 0.02, np.diag([1e-5, 4e-5, 2e-5]), np.array([[4e-4, 1e-4], [1e-4, 9e-4]])


def plant():
    """Three states in a chain, the first and the last one measured."""
    return fh.Plant(
        lambda x, u, d, p: np.array([x[1], -4.0 * x[0] - 0.5 * x[1] + x[2] + u[0], -p.decay * x[2] + d[0]]),
        lambda x, u, p: np.array([x[0], x[2]]), ("a", "b", "c"), ("u",), ("push",), {"decay": 0.7}, ("ya", "yc"),
    )  # fmt: skip


def constant(**options):
    """A filter with the gain of SciPy's Riccati equation, and its model (F, H)."""
    filter = ExtendedKalmanFilter(plant(), PERIOD, Q, R, np.zeros(3), 1e-4, **options)
    a, c = linear_model(filter, np.zeros(3), np.zeros(1))
    p = solve_discrete_are(a.T, c.T, Q, R)
    return ConstantGainFilter(filter, p @ c.T @ np.linalg.inv(c @ p @ c.T + R)), a, c


@pytest.mark.oracle
def test_the_stationary_error_is_that_of_the_riccati_and_the_lyapunov_equation():
    one, a, c = constant()
    p = solve_discrete_are(a.T, c.T, Q, R)
    predicted, corrected, spread = stationary_error(one.filter, one.initial.gain, np.zeros(3))
    np.testing.assert_allclose(predicted, p, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(spread, c @ p @ c.T + R, rtol=1e-9)
    other = one.initial.gain * 0.6
    left = np.eye(3) - other @ c
    p = solve_discrete_lyapunov(left @ a, left @ Q @ left.T + other @ R @ other.T)
    predicted, corrected, _ = stationary_error(one.filter, other, np.zeros(3))
    np.testing.assert_allclose(corrected, p, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(predicted, a @ p @ a.T + Q, rtol=1e-9, atol=1e-15)


def measured(count=300):
    """Noise of the filter's own size, outliers, and elements that are missing."""
    rng = np.random.default_rng(3)
    y = rng.multivariate_normal(np.zeros(2), 2.0 * R, count)
    wild = rng.random((count, 2)) < 0.1
    y[wild] += 50.0
    y[rng.random((count, 2)) < 0.1] = np.nan
    return y


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("pieces", [False, True])
@pytest.mark.parametrize("gate", [0.9, 0.999])
def test_a_constant_gain_rejects_what_lies_beyond_the_quantile(gate, pieces):
    one, a, c = constant(gate=gate)
    gain, p = np.asarray(one.initial.gain), solve_discrete_are(a.T, c.T, Q, R)
    variances, mean, counts = np.diag(c @ p @ c.T + R), np.zeros(3), np.zeros(2, dtype=int)
    stepped = fh.Controller(still(one.plant), one, PERIOD, latency=0)
    stepped = stepped.in_pieces() if pieces else stepped
    started = False
    for y in measured():
        started = started or np.isfinite(y).any()
        stepped.step(y)
        if not started:
            continue
        innovation = np.nan_to_num(y - c @ mean)
        outliers = innovation**2 > variances * chi2.ppf(gate, 1)
        counts += outliers
        mean = mean + gain @ np.where(outliers, 0.0, innovation)
        np.testing.assert_allclose(stepped.estimate, mean, rtol=1e-8, atol=1e-11)
        mean = a @ mean
    assert stepped.rejected.tolist() == counts.tolist()
    assert counts.min() > 20


@pytest.mark.oracle
def test_of_good_measurements_a_constant_gain_rejects_as_many_as_stated():
    one, a, c = constant(gate=0.9)
    rng, samples, x = np.random.default_rng(0), 20_000, np.zeros(3)
    stepped = fh.Controller(still(one.plant), one, PERIOD, latency=0)
    noises = (
        rng.multivariate_normal(np.zeros(2), R, samples),
        rng.multivariate_normal(np.zeros(3), Q, samples),
    )
    for v, w in zip(*noises, strict=True):
        stepped.step(c @ x + v)
        x = a @ x + w
    share = stepped.rejected / samples
    assert np.abs(share - 0.1).max() < 0.02  # a sample that is left out makes the next ones worse


@pytest.mark.oracle
def test_a_constant_gain_projects_along_its_stationary_covariance():
    """One bound: x̂ + P eᵢ (b − x̂ᵢ)/Pᵢᵢ, with P of a prediction, and of a correction."""
    one, a, c = constant(bounds={"b": (-0.02, 0.03)})
    gain, predicted = np.asarray(one.initial.gain), solve_discrete_are(a.T, c.T, Q, R)
    corrected = (np.eye(3) - gain @ c) @ predicted

    def within(mean, p):
        return mean + p[:, 1] / p[1, 1] * (np.clip(mean[1], -0.02, 0.03) - mean[1])

    stepped, mean, met = fh.Controller(still(one.plant), one, PERIOD, latency=0), np.zeros(3), 0
    for k in range(200):
        y = np.array([0.05 * np.sin(0.1 * k), 0.02 * np.cos(0.07 * k)])
        stepped.step(y)
        free = mean + gain @ (y - c @ mean)
        mean = within(free, corrected)
        met += mean[1] != free[1]
        np.testing.assert_allclose(stepped.estimate, mean, rtol=1e-8, atol=1e-11)
        mean = within(a @ mean, predicted)
    assert met > 20


@pytest.mark.oracle
def test_the_variances_of_the_arm_of_one_joint_are_those_of_its_model():
    robot = fh.paper_arm()
    plant = robot.plant(BOTH).with_parameters(gravity=0.0)
    noise = np.diag([1e-14, 3e-9, 1e-15, 2e-8])
    filter = ExtendedKalmanFilter(plant, 1e-3, noise, [1e-8, 4e-8], np.zeros(4), 1e-8, gate=0.999)
    one = ModalFilter(filter)
    gain = one.gain(np.zeros(4))
    spread = stationary_error(filter, gain, np.zeros(4))[2]
    found = one.variances(np.zeros(4))
    np.testing.assert_allclose(found, np.diag(spread), rtol=1e-5)
    np.testing.assert_allclose(one.at(np.zeros(4)).initial.variances, found, rtol=1e-5)


def gated_modal():
    plain = modal()
    options = {**plain.filter.settings(), "gate": 0.9999}
    return plain, ModalFilter(ExtendedKalmanFilter(**options))


def injected(**options):
    """The paper's arm, whose gravity is a function of the link's encoder."""
    plant = fh.paper_arm().plant(BOTH)
    return OutputInjectionObserver(plant, 1e-3, 1e-8, np.diag([1e-6, 4e-6]), np.zeros(4), **options)


@pytest.mark.ci("compiles each filter")
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("pieces", [False, True])
@pytest.mark.parametrize("kind", ["modal", "injection", "constant"])
def test_an_outlier_is_a_missing_element(kind, pieces, tmp_path):
    """As the same estimator without a gate, which is told that the element is missing; the gain knows no gate."""
    if kind == "modal":
        plain, gated = (controller(one) for one in gated_modal())
    elif kind == "injection":
        plain, gated = (
            fh.Controller(still(one.plant), one, 1e-3) for one in (injected(), injected(gate=0.9999))
        )
    else:
        plain, gated = (
            fh.Controller(still(plant()), one[0], PERIOD) for one in (constant(), constant(gate=0.9999))
        )
    gated.save(tmp_path / "one")
    gated, plain = (c.in_pieces() if pieces else c for c in (gated, plain))
    estimator, rng = plain.estimator, np.random.default_rng(1)
    noise = np.linalg.cholesky(estimator.measurement_noise)
    p, start = len(plain.measured), np.asarray(estimator.initial.mean)
    seen = np.asarray(
        estimator.plant.evaluate_output(
            start, np.zeros(len(estimator.plant.inputs)), estimator.plant.parameters.vector()
        ),
        float,
    )
    r, wrong = plain.operating_reference if plain.commanded else None, np.zeros(p, dtype=int)
    samples = []
    for k in range(60):
        wild = seen + 0.3 * noise @ rng.normal(size=p)
        gap = wild.copy()
        if k % 4 == 3:
            wild[k % p], gap[k % p] = wild[k % p] + 1e3, np.nan
            wrong[k % p] += 1
        if k == 30:
            wild[:], gap[:] = 1e6, np.nan
            wrong += 1
        np.testing.assert_allclose(gated.step(wild, r), plain.step(gap, r), rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(gated.estimate, plain.estimate, rtol=1e-9, atol=1e-12)
        samples.append((wild, gated.estimate))
    assert gated.rejected.tolist() == wrong.tolist()
    if pieces:
        return
    for again in (pickle.loads(pickle.dumps(gated)), fh.load_controller(tmp_path / "one")):
        again.reset()
        for wild, estimate in samples:
            again.step(wild, r)
            np.testing.assert_array_equal(again.estimate, estimate)
        assert again.rejected.tolist() == wrong.tolist()


@pytest.mark.oracle
def test_the_shell_of_the_observer_counts_too():
    gated, plain = injected(gate=0.999), injected()
    for wild, gap in (
        ([1e-4, 5.0], [1e-4, np.nan]),
        ([2e-4, 1e-4], [2e-4, 1e-4]),
        ([9.0, 9.0], [np.nan, np.nan]),
    ):
        gated.correct(wild)
        plain.correct(gap)
        # Of a sample that is all outliers, φ goes on with the prediction: T²/12 of a slope more than without a sample.
        np.testing.assert_allclose(gated.mean, plain.mean, rtol=1e-8)
        np.testing.assert_allclose(gated.covariance, plain.covariance, rtol=1e-12)
        for one in (gated, plain):
            one.predict([0.1])
    assert gated.rejected.tolist() == [1, 2]
    assert gated.repairs["rejected"] == 3


@pytest.mark.ci("exports and compiles C")
@pytest.mark.oracle
def test_they_run_in_loops_and_in_c(tmp_path):
    one, _, _ = constant(gate=0.95, bounds={"b": (-0.05, 0.05), "c": (-0.2, 0.1)})
    law = linear_law(plant(), [-1.0, -0.2, -0.3])
    for estimator, chosen, period, noise in (
        (one, law, PERIOD, 0.05), (injected(gate=0.9), still(injected().plant), 1e-3, 2e-3),
    ):  # fmt: skip
        control = fh.Controller(chosen, estimator, period)
        run, stepped = (
            fh.Loop(estimator.plant, control).run(noise=noise, duration=200 * period),
            control.fresh(),
        )
        for y, estimate in zip(run.signals["output"], run.signals["estimate"], strict=True):
            stepped.step(y)
            np.testing.assert_array_equal(stepped.estimate, estimate)
        assert stepped.rejected.min() > 0
        if shutil.which("cc") is None:
            continue
        library = fh.load_compiled(fh.compile_controller(control, tmp_path / "arm.so"))
        for y, u in zip(run.signals["output"], run.signals["input"], strict=True):
            np.testing.assert_array_equal(library.step(y), u)
        assert library.rejected.tolist() == stepped.rejected.tolist()


def test_without_a_gate_nothing_changes():
    """Keys and beliefs are those of before: kernels and files stay valid."""
    one, _, _ = constant()
    assert one.initial._fields == ("mean", "gain")
    assert one.estimator_key == f"constant gain {PERIOD!r} {one.filter.sub_steps} x {one.filter.stages}"
    assert set(one.settings()) == {"filter", "gain"}
    assert injected().estimator_key == "output injection"
    assert "gate" not in injected().settings()
    assert modal().initial._fields == ("mean", "scale", "table")


def test_what_has_no_gate_or_bound_says_why():
    filter = ExtendedKalmanFilter(plant(), PERIOD, Q, R, np.zeros(3), 1e-4, gate=0.999)
    with refused_with(InvalidInput, "decay", "below 1"):
        ConstantGainFilter(filter, -2.0 * np.ones((3, 2)))
    plain = ExtendedKalmanFilter(plant(), PERIOD, Q, R, np.zeros(3), 1e-4)
    with refused_with(InvalidInput, "about", "gate"):
        ConstantGainFilter(plain, np.zeros((3, 2)), np.zeros(3))
    with refused_with(InvalidInput, "bounds", "linear", "link_position"):
        injected(bounds={"link_position": (-1.0, 1.0)})
    with refused_with(InvalidInput, "gate", "0", "1"):
        injected(gate=1.5)
    name = arm().plant(BOTH).states[0]
    bounded = {**modal().filter.settings(), "bounds": {name: (-9.0, 9.0)}}
    with refused_with(InvalidInput, "bounds", "covariance", name):
        ModalFilter(ExtendedKalmanFilter(**bounded))


@pytest.mark.oracle
def test_the_linear_loop_of_a_gated_and_bounded_filter_is_that_without():
    """About an equilibrium nothing is rejected, and no bound is met."""
    limits = {"gate": 0.999, "bounds": {"b": (-1.0, 1.0)}}
    one, two = constant()[0], constant(**limits)[0]
    law = linear_law(plant(), [-1.0, -0.2, -0.3])
    rng = np.random.default_rng(0)
    memory, y = rng.normal(size=(1, SampledController(law, one, PERIOD).size)), rng.normal(size=(1, 2))
    memory *= 1e-3
    stepped = [
        SampledController(law, each, PERIOD).step(memory, 1e-3 * y, np.zeros((1, 0))) for each in (one, two)
    ]
    for name in ("u", "memory"):
        first, second = (getattr(each, name) for each in stepped)
        np.testing.assert_allclose(second.value, first.value, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(second.by, first.by, rtol=1e-12, atol=1e-15)
