import warnings

import numpy as np
import pytest
from tests.builders import pairs
from tests.estimation import kalman
from tests.estimation.kalman import LinearCase

from flexhinf.codegen import DIRECT
from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.plant import Gaussian, Plant, rk4_step
from flexhinf.robot import paper_arm

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

SIZES = [(4, 2, 2), (1, 1, 1), (2, 1, 1), (5, 1, 5), (7, 3, 2)]


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("n", "m", "p", "scale", "scaling"),
    [
        (*size, *rest)  # standard deviations of 1e-6 to 1e3: variances of 1e-12 to 1e6
        for size, *rest in pairs(SIZES, [1e-6, 1.0, 1e3], [{}, {"alpha": 1.3, "kappa": 0.5}])
    ],
)
def test_on_a_linear_plant_it_is_the_kalman_filter(n, m, p, scale, scaling):
    case = LinearCase(n, m, p, seed=10 * n + p, scale=scale)
    ukf = UnscentedKalmanFilter(**case.arguments(), **scaling)
    f, g = case.map(ukf.stages, ukf.sub_steps)
    mean, covariance = case.mean, case.p0
    for _ in range(60):
        y, u = scale * case.rng.normal(size=p), scale * case.rng.normal(size=m)
        ukf.correct(y)
        mean, covariance = kalman.correct(mean, covariance, case.c, y, case.r)
        assert kalman.relative(ukf.mean, ukf.covariance, mean, covariance) < 1e-12
        ukf.predict(u)
        mean, covariance = kalman.predict(mean, covariance, f, g, u, case.q)
        assert kalman.relative(ukf.mean, ukf.covariance, mean, covariance) < 1e-12


@pytest.mark.ci("60 samples of four states, compiled")
@pytest.mark.oracle
def test_states_of_different_scales_and_a_singular_process_noise():
    case = LinearCase(4, 1, 2, seed=4)
    units = np.diag([1e-6, 1.0, 1e3, 1e-2])
    case.a, case.b = units @ case.a @ np.linalg.inv(units), units @ case.b
    case.c = case.c @ np.linalg.inv(units)
    case.mean, case.p0 = units @ case.mean, units @ case.p0 @ units
    direction = units @ np.ones(4)
    case.q = np.outer(direction, direction)  # one direction only
    ukf = UnscentedKalmanFilter(**case.arguments())
    f, g = case.map(ukf.stages, ukf.sub_steps)
    mean, covariance = case.mean, case.p0
    for _ in range(60):
        y, u = case.rng.normal(size=2), case.rng.normal(size=1)
        ukf.correct(y)
        ukf.predict(u)
        mean, covariance = kalman.correct(mean, covariance, case.c, y, case.r)
        mean, covariance = kalman.predict(mean, covariance, f, g, u, case.q)
    assert kalman.relative(ukf.mean, ukf.covariance, mean, covariance) < 1e-12


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("known", [slice(None), slice(0, 2)])
def test_exactly_known_states(known):
    case = LinearCase(4, 1, 2, seed=6)
    case.p0[known, :] = case.p0[:, known] = 0.0
    ukf = UnscentedKalmanFilter(**case.arguments())
    f, g = case.map(ukf.stages, ukf.sub_steps)
    mean, covariance = case.mean, case.p0
    for _ in range(20):
        y = case.rng.normal(size=2)
        ukf.correct(y)
        mean, covariance = kalman.correct(mean, covariance, case.c, y, case.r)
        assert kalman.relative(ukf.mean, ukf.covariance, mean, covariance) < 1e-12
        ukf.predict([0.3])
        mean, covariance = kalman.predict(mean, covariance, f, g, [0.3], case.q)


def arm_flow(x, u):
    """Sec. 6 again, in floats."""
    q, dq, theta, dtheta = x
    spring = 100.0 * (q - theta)
    return np.array([dq, -9.8 * np.sin(q) - spring, dtheta, spring - 0.1 * dtheta + 0.9 * (u - dtheta)])


def arm_step(x, dt, u):
    return rk4_step(lambda s, v: arm_flow(s, v), x, (u, u, u), dt)


def arm_ukf(**changes):
    settings = {
        "plant": paper_arm().plant(), "period": 1e-3, "process_noise": np.diag([1e-9, 1e-6, 1e-9, 1e-6]),
        "measurement_noise": 1e-6, "mean": np.array([0.2, 0.0, 0.1, 0.0]), "covariance": [1e-2, 1e-1, 1e-2, 1e-1],
    }  # fmt: skip
    return UnscentedKalmanFilter(**{**settings, **changes})


def arm_run(steps, seed=2):
    rng = np.random.default_rng(seed)
    x = np.zeros(4)
    for k in range(steps):
        u = 5.0 * np.sin(0.01 * k)
        x = arm_step(x, 1e-3, u)
        yield u, x[0] + 1e-3 * rng.normal()


@pytest.mark.oracle
@pytest.mark.parametrize("alpha", [1.0, pytest.param(1.2, marks=pytest.mark.ci("400 steps of two filters"))])
def test_the_arm_equals_filterpy(alpha):
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter as Filterpy

    ours = arm_ukf(alpha=alpha)
    points = MerweScaledSigmaPoints(4, alpha, 2.0, 0.0)
    theirs = Filterpy(4, 1, 1e-3, lambda x: x[:1], arm_step, points)
    theirs.x, theirs.P = ours.mean, ours.covariance
    theirs.Q, theirs.R = ours.process_noise, ours.measurement_noise
    for u, y in arm_run(400):
        ours.predict(u)
        theirs.predict(u=u)
        ours.correct(y)
        theirs.update(np.array([y]))
    np.testing.assert_allclose(ours.mean, theirs.x, atol=1e-11)
    np.testing.assert_allclose(ours.covariance, theirs.P, rtol=1e-9, atol=1e-14)


def reference_without_redraw(ukf, run):
    """Algorithm 1 without step 5, on plain NumPy."""
    mean, covariance, r, q = ukf.mean, ukf.covariance, ukf.measurement_noise, ukf.process_noise
    wm, wc = np.full(9, 1 / 8), np.full(9, 1 / 8)
    wm[0], wc[0] = 0.0, 2.0
    for u, y in run:
        root = 2.0 * np.linalg.cholesky(covariance)
        points = mean[:, None] + np.hstack([np.zeros((4, 1)), root, -root])
        points = np.column_stack([arm_step(x, 1e-3, u) for x in points.T])
        mean = points @ wm
        e = points - mean[:, None]
        covariance = e * wc @ e.T + q
        s = points[:1] - points[:1] @ wm
        pyy, pxy = s * wc @ s.T + r, e * wc @ s.T
        gain = pxy / pyy
        mean = mean + gain @ (y - points[:1] @ wm)
        covariance = covariance - gain @ pyy @ gain.T
    return mean, covariance


@pytest.mark.ci("2,400 steps of three filters")
@pytest.mark.oracle
def test_without_redraw_the_propagated_points_are_measured():
    ukf = arm_ukf(redraw=False)
    for u, y in arm_run(800):
        ukf.predict(u)
        ukf.correct(y)
    mean, covariance = reference_without_redraw(arm_ukf(), arm_run(800))
    np.testing.assert_allclose(ukf.mean, mean, atol=1e-11)
    np.testing.assert_allclose(ukf.covariance, covariance, rtol=1e-8, atol=1e-14)
    redrawn = arm_ukf()
    for u, y in arm_run(800):
        redrawn.predict(u)
        redrawn.correct(y)
    assert abs(redrawn.covariance[0, 0] / covariance[0, 0] - 1.0) > 1e-3


def test_without_redraw_the_first_measurement_needs_no_prediction():
    case = LinearCase(3, 1, 1)
    ukf = UnscentedKalmanFilter(**case.arguments(), redraw=False)
    ukf.correct([0.3])
    mean, covariance = kalman.correct(case.mean, case.p0, case.c, [0.3], case.r)
    assert kalman.relative(ukf.mean, ukf.covariance, mean, covariance) < 1e-12


def test_without_redraw_the_points_move_with_the_initial_mean():
    ukf = arm_ukf(redraw=False)
    other = ukf.initial_at([1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(other.points.mean(axis=1), [1.0, 2.0, 3.0, 4.0], rtol=1e-14)
    np.testing.assert_allclose(other.points[:, 0], other.mean)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("form", ["covariance", "square_root"])
@pytest.mark.parametrize("kappa", [0.0, 1.0])
def test_bounds_hold_whatever_is_measured(form, kappa):
    """The central sigma point too, whose weight is zero where kappa is."""
    bounds = {"link_position": (-0.3, 0.3), "motor_velocity": (-0.5, 0.5)}
    ukf = arm_ukf(bounds=bounds, form=form, kappa=kappa)
    for k, (u, y) in enumerate(arm_run(150)):
        ukf.predict(u)
        assert all(low <= ukf.mean[ukf.plant.index(s)] <= high for s, (low, high) in bounds.items())
        ukf.correct(y + (5.0 if k % 7 == 0 else 0.0))
        assert all(low <= ukf.mean[ukf.plant.index(s)] <= high for s, (low, high) in bounds.items())
    assert ukf.mean[0] == pytest.approx(0.3, abs=0.31)


@pytest.mark.parametrize("bounds", [None, {"x": (-9.0, 9.0)}])
@pytest.mark.parametrize("covariance", [-1.0, np.nan])
def test_a_damaged_belief_is_a_failure_that_bounds_do_not_hide(bounds, covariance):
    """Clipped NaN would look like an estimate."""
    plant = Plant(lambda x, u, d, p: -x + u, lambda x, u, p: x**2, ("x",), ("u",))
    ukf = UnscentedKalmanFilter(plant, 0.1, 1e-3, 1e-3, [0.0], 1.0, bounds=bounds, form="covariance")
    ukf._belief = Gaussian(np.zeros(1), np.full((1, 1), covariance))
    with pytest.warns(UserWarning, match="not finite"):
        ukf.predict([0.0])
    ukf.correct([2.0])
    assert [(entry.kind, entry.step, entry.count) for entry in ukf.diagnosis] == [("not finite", 0, 2)]
    np.testing.assert_array_equal(ukf.covariance, covariance)


def test_a_diverging_model_is_a_failure_and_keeps_the_last_belief():
    plant = Plant(lambda x, u, d, p: x**3 + u, lambda x, u, p: x, ("x",), ("u",))
    ukf = UnscentedKalmanFilter(plant, 0.1, 1e-3, 1e-3, [1.0], 1e-2)
    means = [ukf.mean]
    with warnings.catch_warnings(record=True, action="always") as said:
        while len(means) < 50:
            ukf.predict([0.0])
            means.append(ukf.mean)
    assert ["not finite" in str(one.message) for one in said] == [True]
    first = ukf.diagnosis[0]
    assert first.kind == "not finite"
    assert "diverge" in first.cure
    assert means[first.step] == pytest.approx([4.0829], abs=1e-4)
    np.testing.assert_array_equal(means[first.step :], [means[first.step]] * (50 - first.step))
    ukf.reset()
    assert ukf.diagnosis == ()


def test_the_covariance_is_exactly_symmetric():
    ukf = arm_ukf()
    for u, y in arm_run(50):
        ukf.predict(u)
        np.testing.assert_array_equal(ukf.covariance, ukf.covariance.T)
        ukf.correct(y)
        np.testing.assert_array_equal(ukf.covariance, ukf.covariance.T)


def test_keys_tell_code_apart():
    keys = [
        arm_ukf(**changes).estimator_key
        for changes in (
            {},
            {"period": 2e-3},
            {"alpha": 1.1},
            {"redraw": False},
            {"bounds": {"link_position": (-9, 9)}},
        )
    ]
    assert len(set(keys)) == len(keys)
    assert arm_ukf(measurement_noise=3.0, covariance=1.0).estimator_key == keys[0]


@pytest.mark.ci("100 samples with eigenvalues of each")
@pytest.mark.parametrize("period", [1e-3, 1e-2, 5e-2])
def test_bounds_that_bite_keep_the_covariance_positive(period):
    """Clipped points stand for a narrower prior; what a measurement takes away must not exceed it."""
    plant = paper_arm().plant()
    bounds = {"link_velocity": (-8.0, 8.0), "motor_position": (-4.0, 4.0), "motor_velocity": (-8.0, 8.0)}
    ukf = UnscentedKalmanFilter(plant, period, 1e-6, 1e-6, np.zeros(4), 10.0, bounds=bounds)
    rng = np.random.default_rng(0)
    for _ in range(100):
        ukf.correct([0.3 + 1e-3 * rng.normal()])
        assert np.linalg.eigvalsh(ukf.covariance)[0] >= -1e-14 * np.abs(ukf.covariance).max()
        for name, (low, high) in bounds.items():
            assert low <= ukf.mean[plant.index(name)] <= high
        ukf.predict([3.0])


@pytest.mark.oracle
@pytest.mark.parametrize("scaling", [{}, {"alpha": 0.7, "kappa": 1.0}])
def test_a_linear_output_needs_no_sigma_points(scaling, monkeypatch):
    """Steps 5 to 12 through the points, and through half as many columns of L, agree to rounding."""
    plant = paper_arm().plant()
    rng = np.random.default_rng(5)
    root = rng.normal(size=(4, 4))
    belief = Gaussian(rng.normal(size=4), 0.1 * root @ root.T)
    arguments = (belief, np.array([0.3]), np.zeros(1), plant.parameters.vector(), np.array([[1e-3]]))
    by_columns = UnscentedKalmanFilter(
        plant, 1e-3, 1e-6, 1e-3, np.zeros(4), 1e-4, **scaling, form="covariance"
    )
    assert by_columns.linear_output
    by_points = UnscentedKalmanFilter(
        plant, 1e-3, 1e-6, 1e-3, np.zeros(4), 1e-4, **scaling, form="covariance"
    )
    monkeypatch.setitem(vars(by_points), "linear_output", False)
    one, other = (f.innovation_stages(DIRECT, *arguments) for f in (by_columns, by_points))
    for a, b in zip((*one[0], *one[1:]), (*other[0], *other[1:]), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13)


@pytest.mark.oracle
@pytest.mark.parametrize("form", ["covariance", "square_root"])
def test_with_a_beta_of_zero_it_is_the_cubature_filter(form):
    """2n points of equal weight, about the mean that they have."""
    plant = Plant(lambda x, u, d, p: np.array([x[0] + 0.1 * x[1], x[1] + np.sin(x[0])]), lambda x, u, p: x[:1],
                  ("a", "b"), ("u",), sampled=True)  # fmt: skip
    root = np.array([[0.4, 0.0], [0.1, 0.3]])
    ukf = UnscentedKalmanFilter(plant, 1.0, 1e-3, 1e-3, [1.0, 0.5], root @ root.T, 1.0, 0.0, 0.0, form=form)
    if form == "square_root":
        ukf._belief = ukf.initial._replace(root=root.T)
    x = np.array([1.0, 0.5])[:, None] + np.sqrt(2.0) * np.hstack([root, -root])
    x = np.array([x[0] + 0.1 * x[1], x[1] + np.sin(x[0])])
    ukf.predict([0.0])
    np.testing.assert_allclose(ukf.mean, x.mean(axis=1), rtol=1e-13)
    np.testing.assert_allclose(ukf.covariance, np.cov(x, bias=True) + 1e-3 * np.eye(2), rtol=1e-12)


def test_an_output_that_switches_goes_through_sigma_points():
    """Its derivative is zero wherever there is one, and the points see the steps."""
    plant = Plant(
        lambda x, u, d, p: -x,
        states=("x",),
        inputs=("u",),
        outputs=("y",),
        output=lambda x, u, p: np.floor(x),
    )
    ukf = UnscentedKalmanFilter(plant, 1e-3, 1e-6, 1e-3, np.array([0.9]), 1.0)
    assert not ukf.linear_output
    ukf.correct(2.0)
    assert ukf.mean[0] > 1.0


def test_the_usual_weights_are_those_for_normal_distributions():
    """α = 1, β = 2, κ = 0: λ = 0, so the mean's weight is 0 and the covariance's is 1 − α² + β = 2."""
    arm = paper_arm().plant()
    filter = UnscentedKalmanFilter(arm, 1e-3, 1e-6, 1e-6, np.zeros(4), 1e-4)
    assert filter.sigma.covariance_weights[0] == 2.0
