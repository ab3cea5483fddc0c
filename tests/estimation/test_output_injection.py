"""The error of the observer is linear: against matrix powers, integrators, the Kalman filter, and in the loop."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import place_poles
from scipy.stats import multivariate_normal
from tests.builders import pairs
from tests.estimation import kalman
from tests.estimation.kalman import LinearCase
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput, NotDetectable
from flexhinf.estimation import ExtendedKalmanFilter, OutputInjectionObserver, linear_model, stationary_gain
from flexhinf.plant import Estimator, Plant, equilibrium

FOUR = [-12.0, -15.0, -9.0 + 6.0j, -9.0 - 6.0j]


def arm():
    return fh.paper_arm().plant()


def oscillators(feedthrough=0.0):
    """Two oscillators, driven through functions of what is measured: a sum of states, and a velocity."""

    def flow(x, u, d, p):
        y1, y2 = x[0] + 0.5 * x[2], x[3]
        return np.array(
            [
                x[1] + np.sin(y1),
                x[2] - x[0] - p.hardening * y1**3 + (1.0 + y2**2) * u[0],
                x[3],
                -2.0 * x[2] + y2 - y2**3 / 3.0 + np.cos(y1) * u[1] + 0.3 * x[1],
            ]
        )

    def output(x, u, p):
        return np.array([x[0] + 0.5 * x[2] + feedthrough * u[0], 3.0 * x[3] + feedthrough * u[1] ** 2])

    return Plant(flow, output, ("a", "da", "b", "db"), ("u1", "u2"), parameters={"hardening": 0.7})


def observer(plant, period=0.01, mean=None, **settings):
    noise = {"process_noise": 1e-6, "measurement_noise": 1e-6, **settings}
    return OutputInjectionObserver(plant, period, mean=np.zeros(plant.n) if mean is None else mean, **noise)


def integrated(plant, x, u, period, extra=lambda t, z: [], tail=()):
    """The plant over one period with u held, by SciPy; `extra` is integrated beside it."""
    p, still, n = (
        plant.parameters.named(plant.parameters.vector()),
        np.zeros(len(plant.disturbances)),
        plant.n,
    )
    run = solve_ivp(
        lambda t, z: np.concatenate([plant.flow(z[:n], u, still, p), extra(t, z)]),
        (0.0, period), np.concatenate([x, tail]), "DOP853", rtol=1e-12, atol=1e-12,
    )  # fmt: skip
    return run.y[:n, -1], run.y[n:, -1]


def output(plant, x, u):
    return np.atleast_1d(plant.output(x, u, plant.parameters.named(plant.parameters.vector())))


@pytest.mark.ci("pairs of observers over 400 samples")
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("make", "poles", "period"),
    pairs([arm, oscillators, lambda: oscillators(0.4)], [None, FOUR], [1e-3, 0.05]),
)
def test_two_observers_differ_by_powers_of_a_matrix(make, poles, period):
    """Whatever the measurements are, which here no plant would give."""
    plant, rng = make(), np.random.default_rng(3)
    starts = rng.uniform(-3.0, 3.0, size=(2, plant.n))
    first, second = (observer(plant, period, start, poles=poles) for start in starts)
    rest = np.eye(plant.n) - first.gain @ first.plant.linearise()[3]
    difference = rest @ (starts[0] - starts[1])
    for _ in range(400):
        y = rng.normal(size=len(plant.outputs))
        first.correct(y)
        second.correct(y)
        np.testing.assert_allclose(first.mean - second.mean, difference, atol=1e-10)
        difference = first.error_matrix @ difference
        u = 5.0 * rng.normal(size=len(plant.inputs))
        first.predict(u)
        second.predict(u)


@pytest.mark.ci("runs at several periods")
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("make", [arm, lambda: oscillators(0.4)], ids=["arm", "two"])
def test_the_error_is_linear_up_to_the_period_squared(make):
    """Against the true plant, from any error: what is left over does not depend on the error, and is of order T²."""
    plant = make()
    left = []
    for period in (0.04, 0.02, 0.01):
        leftovers = []
        for start in (np.zeros(plant.n), np.array([2.0, -3.0, 1.0, 3.0])):
            rng = np.random.default_rng(5)
            x, u = np.full(plant.n, 0.4), np.zeros(len(plant.inputs))
            filter = observer(plant, period, x + start, poles=FOUR)
            error = (np.eye(plant.n) - filter.gain @ plant.linearise()[3]) @ start
            inputs = rng.normal(size=(5, len(plant.inputs)))  # of 0.2 s each, whatever the period
            for k in range(round(1.0 / period)):
                filter.correct(output(plant, x, u))
                rest = filter.mean - x - error
                error = filter.error_matrix @ error
                u = inputs[int(k * period / 0.2 + 1e-9)]
                x, _ = integrated(plant, x, u, period)
                filter.predict(u)
            leftovers.append(rest)
        np.testing.assert_allclose(*leftovers, atol=1e-9)
        left.append(np.abs(leftovers[0]).max())
    assert left[-1] > 1e-8  # or there would be no order to see
    assert 3.6 < left[0] / left[1] < 4.4
    assert 3.6 < left[1] / left[2] < 4.4


@pytest.mark.ci("integrates plant and observer for four periods")
@pytest.mark.oracle
def test_it_tends_to_the_continuous_observer():
    """x̂' = A x̂ + φ(y, u) + L (y − H x̂) with the same poles: the gain acts at samples only, so of first order."""
    plant, start = arm(), np.array([2.0, -1.0, -2.0, 3.0])
    a, _, _, c = plant.linearise()
    poles = np.array([-12.0, -15.0, -18.0, -21.0])
    gain = place_poles(a.T, c.T, poles).gain_matrix.T
    differences = []
    for period in (0.02, 0.01, 0.005, 0.0025):
        filter, rng = observer(plant, period, start, poles=poles), np.random.default_rng(1)
        np.testing.assert_allclose(filter.error_poles.real, np.sort(poles)[::-1], rtol=1e-6)
        x, other, u, inputs = np.zeros(4), start, np.zeros(1), 20.0 * rng.normal(size=(2, 1))
        p = plant.parameters.named(plant.parameters.vector())

        def observed(t, z):
            same_output = np.array([z[0], *z[5:]])  # φ from the measurement: exactly linear error
            flow = plant.flow(same_output, u, np.zeros(2), p) - a @ same_output  # noqa: B023
            return a @ z[4:] + flow + gain @ (c @ (z[:4] - z[4:]))

        for k in range(round(0.3 / period) + 1):
            filter.correct(output(plant, x, u))
            difference = np.abs(filter.mean - other).max()
            u = inputs[int(k * period / 0.2 + 1e-9)]
            x, other = integrated(plant, x, u, period, observed, other)
            filter.predict(u)
        differences.append(difference)
    ratios = np.array(differences[:-1]) / np.array(differences[1:])
    assert np.all((ratios > 1.7) & (ratios < 2.3))


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("r", [1e-8, 1e-2])
@pytest.mark.parametrize("make", [arm, oscillators])
def test_the_gain_is_that_of_python_control(make, r):
    import control

    plant, period = make(), 1e-3
    filter = observer(plant, period, process_noise=[1e-8, 1e-6, 1e-7, 1e-4], measurement_noise=r)
    a, _, _, h = plant.linearise()
    predictor, p, poles = control.dlqe(
        expm(a * period), np.eye(4), h, filter.process_noise, filter.measurement_noise
    )
    expected = p @ h.T @ np.linalg.inv(h @ p @ h.T + filter.measurement_noise)
    np.testing.assert_allclose(filter.gain, expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(filter.covariance, p, rtol=1e-6, atol=1e-9 * np.abs(p).max())
    found = np.exp(filter.error_poles * period)
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(poles), rtol=1e-6)
    assert np.all(np.diff(filter.error_poles.real) <= 1e-9)
    assert predictor.shape == filter.gain.shape


def test_at_the_asked_point_the_gain_is_that_of_the_extended_filter():
    plant = arm()
    x, u = equilibrium(plant, ["link_position"], np.array([2.5]))
    settings = (plant, 1e-3, 1e-6, 1e-6, np.zeros(4))
    ekf = ExtendedKalmanFilter(*settings, 0.0)
    expected = stationary_gain(linear_model(ekf, x, u), ekf.process_noise, ekf.measurement_noise)
    gain = OutputInjectionObserver(*settings, about=x).gain
    np.testing.assert_allclose(gain, expected, rtol=1e-8)
    assert np.abs(OutputInjectionObserver(*settings).gain - expected).max() > 1e-2


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(("n", "m", "p"), [(3, 2, 1), (1, 1, 1), (5, 1, 3)])
def test_on_a_linear_plant_it_is_the_kalman_filter_at_rest(n, m, p):
    """From the first sample on: by default the initial covariance is that of the predictions at rest."""
    case = LinearCase(n, m, p, seed=n)
    filter = OutputInjectionObserver(case.plant, case.period, case.q, case.r, case.mean)
    both = expm(case.period * np.block([[case.a, case.b], [np.zeros((m, n + m))]]))
    f, g = both[:n, :n], both[:n, n:]
    mean, covariance = case.mean, filter.covariance
    for _ in range(60):
        y, u = case.rng.normal(size=p), case.rng.normal(size=m)
        density = multivariate_normal(case.c @ mean, case.c @ covariance @ case.c.T + case.r)
        filter.correct(y)
        assert filter.log_likelihood == pytest.approx(density.logpdf(y), rel=1e-9)
        mean, covariance = kalman.correct(mean, covariance, case.c, y, case.r)
        assert kalman.relative(filter.mean, filter.covariance, mean, covariance) < 1e-10
        filter.predict(u)
        mean, covariance = kalman.predict(mean, covariance, f, g, u, case.q)
        assert kalman.relative(filter.mean, filter.covariance, mean, covariance) < 1e-10


@pytest.mark.ci("20,000 runs of 60 samples")
@pytest.mark.oracle
def test_the_covariance_is_that_of_the_errors_of_many_runs():
    """With a gain that is not the Kalman filter's, from a stated covariance to the stationary one."""
    case_plant = Plant(
        lambda x, u, d, p: np.array([x[1], -4.0 * x[0] - 0.1 * x[1] + u[0]]),
        lambda x, u, p: x[:1],
        ("x", "v"), ("u",),
    )  # fmt: skip
    period, q, r, p0 = 0.1, np.diag([1e-4, 1e-2]), 1e-2, np.array([[1.0, 0.3], [0.3, 2.0]])
    filter = OutputInjectionObserver(case_plant, period, q, r, [0, 0], covariance=p0, poles=[-2, -3])
    rest = OutputInjectionObserver(case_plant, period, q, r, [0, 0], poles=[-2, -3]).covariance
    rng, count = np.random.default_rng(0), 20_000
    phi, h, gain = expm(period * case_plant.linearise()[0]), np.eye(1, 2), filter.gain
    errors = rng.multivariate_normal([0, 0], p0, size=count)
    for k in range(60):
        if k in (0, 1, 5, 59):
            sampled = errors.T @ errors / count
            np.testing.assert_allclose(sampled, filter.covariance, atol=0.05 * np.diag(sampled).max())
        errors = errors @ (np.eye(2) - gain @ h).T + np.sqrt(r) * rng.normal(size=(count, 1)) @ gain.T
        filter.correct(0.0)
        errors = errors @ phi.T + rng.multivariate_normal([0, 0], q, size=count)
        filter.predict(0.0)
    np.testing.assert_allclose(filter.covariance, rest, rtol=1e-3)


def test_samples_without_a_measurement_are_bridged_by_the_estimate():
    """0.3 s of predictions from the true state: φ is held over each period, so to order T."""
    plant, start, u = arm(), np.array([0.4, 1.0, 0.5, -1.0]), np.array([3.0])
    end, _ = integrated(plant, start, u, 0.3)
    errors = []
    for period in (0.02, 0.01, 0.005):
        filter = observer(plant, period, start)
        for _ in range(round(0.3 / period)):
            filter.predict(u)
        errors.append(np.abs(filter.mean - end).max())
        filter.correct(output(plant, end, u))
        assert np.abs(filter.mean - end)[0] < errors[-1]
    assert 1.8 < errors[0] / errors[1] < 2.2
    assert 1.8 < errors[1] / errors[2] < 2.2


def test_correcting_twice_moves_along_the_slope_once():
    plant, rng = oscillators(), np.random.default_rng(0)
    filter = observer(plant, 0.1, rng.normal(size=4))
    filter.correct([0.1, 0.2])
    filter.predict([1.0, 2.0])
    filter.correct([0.3, -0.5])
    before, y = filter.mean, np.array([0.5, 0.1])
    filter.correct(y)
    expected = before + filter.gain @ (y - plant.linearise()[3] @ before)
    np.testing.assert_allclose(filter.mean, expected, rtol=1e-13)


def test_of_sensors_that_say_the_same_the_better_one_is_believed():
    def flow(x, u, d, p):
        return np.array([x[1] - x[0] ** 3, u[0] - x[1] - np.sin(x[0])])

    double = Plant(flow, lambda x, u, p: np.array([x[0], 2.0 * x[0]]), ("x", "v"), ("u",))
    single = Plant(flow, lambda x, u, p: x[:1], ("x", "v"), ("u",))
    both = observer(double, measurement_noise=[1e-2, 4e-2])  # as good as one with half the variance
    one = observer(single, measurement_noise=5e-3)
    rng = np.random.default_rng(0)
    for _ in range(20):
        y, u = rng.normal(size=2), rng.normal(size=1)
        both.correct([y[0], 2.0 * y[1]])
        one.correct([y.mean()])
        np.testing.assert_allclose(both.mean, one.mean, atol=1e-11)
        both.predict(u)
        one.predict(u)
    np.testing.assert_allclose(both.covariance, one.covariance, rtol=1e-8)


@pytest.mark.oracle
def test_error_energy_is_the_sum_over_all_samples():
    filter, weight = observer(arm(), 0.01, poles=FOUR), np.diag([1.0, 2.0, 0.0, 0.5])
    x = filter.error_energy(weight)
    np.testing.assert_array_equal(x, x.T)
    error = np.array([0.3, -0.2, 0.1, 1.0])
    energy, e = 0.0, error
    for _ in range(3000):
        energy += 0.01 * e @ weight @ e
        e = filter.error_matrix @ e
    assert error @ x @ error == pytest.approx(energy, rel=1e-10)
    np.testing.assert_allclose(filter.error_energy([1.0, 2.0, 0.0, 0.5]), x)
    with refused_with(InvalidInput, "weight", "error", "semidefinite", -1):
        filter.error_energy(np.diag([1.0, -1.0, 0.0, 0.0]))


def test_it_is_an_estimator_with_a_shell():
    plant = arm()
    filter = fh.OutputInjectionObserver(plant, 1e-3, 1e-8, 1e-6, np.ones(4), 1e-4)
    assert isinstance(filter, Estimator)
    np.testing.assert_array_equal(filter.covariance, 1e-4 * np.eye(4))
    filter.gain[0] = filter.error_matrix[0] = 9.0
    assert np.abs(filter.gain - 9.0).min() > 0.0
    filter.correct(0.4)
    filter.predict(2.0)
    after = filter.mean
    filter.reset()
    np.testing.assert_array_equal(filter.mean, np.ones(4))
    filter.correct(0.4)
    filter.predict(2.0)
    np.testing.assert_array_equal(filter.mean, after)


@pytest.mark.parametrize(
    "changes",
    [
        {"period": 0.0}, {"plant": "arm"}, {"process_noise": -1.0}, {"measurement_noise": 0.0}, {"mean": [0.0]},
        {"covariance": -1.0}, {"poles": [-1.0]}, {"poles": [1.0, -2.0, -3.0, -4.0]}, {"about": [0.0]},
        {"about": [0.0, 0.0, 0.0, np.nan]},
    ],
)  # fmt: skip
def test_bad_settings_are_refused(changes):
    settings = {
        "plant": arm(), "period": 1e-3, "process_noise": 1e-8, "measurement_noise": 1e-6, "mean": np.zeros(4),
    }  # fmt: skip
    with pytest.raises(InvalidInput) as caught:
        OutputInjectionObserver(**{**settings, **changes})
    assert caught.value.what
    assert caught.value.advice


def test_a_two_link_arm_with_positions_only_is_refused():
    two = fh.load_robot("planar-two-link")
    settings = (1e-3, 1e-8, 1e-6, np.zeros(8))
    with pytest.raises(InvalidInput) as caught:
        OutputInjectionObserver(two.plant(["link_position"]), *settings)
    assert " link_velocity, motor_position " in caught.value.what
    assert "link_velocity_shoulder" in caught.value.found
    measured = ["link_position", "link_velocity", "motor_position"]
    filter = OutputInjectionObserver(two.plant(measured), *settings)
    assert filter.error_poles.real.max() < 0.0


def test_what_cannot_be_known_or_is_not_learnt_is_refused():
    rotary = fh.load_robot("quanser-rotflex")
    with pytest.raises(NotDetectable, match="position"):
        observer(rotary.plant(["motor_velocity"]))
    with refused_with(NotDetectable, "poles", "'motor_position'"):
        observer(rotary.plant(["motor_velocity"]), poles=FOUR)
    with refused_with(InvalidInput, "decay", 1):
        observer(rotary.plant(["link_position"]), process_noise=0.0)
