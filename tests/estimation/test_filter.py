import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import multivariate_normal
from tests.estimation.kalman import LinearCase
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.codegen import DIRECT
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.estimation.covariances import covariance_matrix
from flexhinf.plant import Estimator, Plant, eight_stages, rk4_stages
from flexhinf.robot import paper_arm

KINDS = [UnscentedKalmanFilter, ExtendedKalmanFilter]


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
def test_log_likelihood(kind):
    case = LinearCase(4, 1, 3)
    estimator = kind(**case.arguments())
    assert np.isnan(estimator.log_likelihood)
    for _ in range(5):
        y, mean, covariance = case.rng.normal(size=3), estimator.mean, estimator.covariance
        estimator.correct(y)
        density = multivariate_normal(case.c @ mean, case.c @ covariance @ case.c.T + case.r)
        assert estimator.log_likelihood == pytest.approx(density.logpdf(y), rel=1e-11)
        estimator.predict([0.0])


@pytest.mark.parametrize("kind", KINDS)
def test_reset_goes_back_to_the_start(kind):
    case = LinearCase(3, 1, 2)
    estimator = kind(**case.arguments())
    first = []
    for _ in range(2):
        estimator.correct([0.1, 0.2])
        estimator.predict([1.0])
        first.append((estimator.mean, estimator.covariance))
        estimator.reset()
        np.testing.assert_array_equal(estimator.mean, case.mean)
        assert np.isnan(estimator.log_likelihood)
    np.testing.assert_array_equal(first[0][0], first[1][0])
    np.testing.assert_array_equal(first[0][1], first[1][1])


@pytest.mark.parametrize("kind", KINDS)
def test_it_satisfies_the_protocol_and_hands_out_copies(kind):
    case = LinearCase(2, 1, 1)
    estimator = kind(**case.arguments())
    assert isinstance(estimator, Estimator)
    estimator.mean[0] = 1e9
    estimator.covariance[0, 0] = 1e9
    case.mean[0] = 1e9
    assert np.abs(estimator.mean).max() < 1e3
    assert np.abs(estimator.covariance).max() < 1e3


@pytest.mark.oracle
def test_fast_modes_get_sub_steps():
    case = LinearCase(2, 1, 1, period=0.1)
    case.a = np.array([[-1.0, 30.0], [-30.0, -1.0]])
    ukf = UnscentedKalmanFilter(**case.arguments())
    assert (ukf.stages, ukf.sub_steps) == (8, 3)
    p = ukf.plant.parameters.named(ukf.plant.parameters.vector())
    moved = ukf.transition(np.array([1.0, 0.0]), np.zeros(1), p)
    np.testing.assert_allclose(moved, expm(0.1 * case.a)[:, 0], atol=2e-5)


def test_covariances_as_numbers_diagonals_and_matrices():
    np.testing.assert_array_equal(covariance_matrix(2.0, 2, "noise"), 2.0 * np.eye(2))
    np.testing.assert_array_equal(covariance_matrix([1.0, 3.0], 2, "noise"), np.diag([1.0, 3.0]))
    matrix = np.array([[2.0, 1.0], [1.0 + 1e-13, 2.0]])
    symmetric = covariance_matrix(matrix, 2, "noise")
    np.testing.assert_array_equal(symmetric, symmetric.T)
    np.testing.assert_array_equal(covariance_matrix(0.0, 3, "noise"), np.zeros((3, 3)))
    covariance_matrix(np.outer([1e-6, 1e6], [1e-6, 1e6]), 2, "noise")  # singular, of mixed scales


@pytest.mark.parametrize(
    "value",
    [
        -1.0, [1.0, -1e-30], [1.0, 2.0, 3.0], np.eye(3), np.nan, [np.inf, 1.0], "small", None,
        [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.4, 1.0]], [[1e6, 0.0], [0.0, -1e-12]], [[0.0, 1.0], [1.0, 1.0]],
        np.ones((1, 2, 2)),
    ],
)  # fmt: skip
def test_what_is_no_covariance_is_refused(value):
    with pytest.raises(InvalidInput):
        covariance_matrix(value, 2, "noise")


@pytest.mark.parametrize("value", [0.0, [1.0, 0.0], np.ones((2, 2)), [1e-30, 0.0]])
def test_what_is_not_definite_is_refused_where_it_is_inverted(value):
    with refused_with(InvalidInput, "noise", "definite", "> 0"):
        covariance_matrix(value, 2, "noise", definite=True)


def test_small_variances_are_definite():
    covariance_matrix([1e-30, 1.0], 2, "noise", definite=True)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "changes",
    [
        {"period": 0.0}, {"period": -1e-3}, {"period": np.nan}, {"plant": "arm"},
        {"process_noise": -1.0}, {"process_noise": [1.0, 2.0]}, {"measurement_noise": -1.0},
        {"measurement_noise": [1.0, 1.0]}, {"mean": [0.0]}, {"mean": np.zeros(5)}, {"mean": [0, 0, 0, np.nan]},
        {"mean": "rest"}, {"covariance": -1.0}, {"covariance": np.eye(5)},
    ],
)  # fmt: skip
def test_bad_settings_are_refused(kind, changes):
    settings = {
        "plant": paper_arm().plant(), "period": 1e-3, "process_noise": 1e-8, "measurement_noise": 1e-6,
        "mean": np.zeros(4), "covariance": 1e-4,
    }  # fmt: skip
    with pytest.raises(InvalidInput) as caught:
        kind(**{**settings, **changes})
    assert caught.value.what
    assert caught.value.advice


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("value", [np.inf, [1.0, 2.0], "x", 1j, [[1.0]], [np.nan, 1.0]])
def test_bad_measurements_and_inputs_are_refused_and_change_nothing(kind, value):
    estimator = kind(paper_arm().plant(), 1e-3, 1e-8, 1e-6, np.zeros(4), 1e-4)
    with pytest.raises(InvalidInput):
        estimator.correct(value)
    with pytest.raises(InvalidInput):
        estimator.predict(value)
    np.testing.assert_array_equal(estimator.mean, np.zeros(4))


def test_a_plain_number_will_do_for_one_signal():
    estimator = UnscentedKalmanFilter(paper_arm().plant(), 1e-3, 1e-8, 1e-6, np.zeros(4), 1e-4)
    estimator.correct(0.1)
    estimator.predict(2.0)
    assert 0.0 < estimator.mean[0] < 0.1


# Steps of the model between samples ------------------------------------------------------------------
@pytest.mark.parametrize(
    ("sharp", "period", "steps"),
    [(False, 0.02, (4, 2)), (False, 0.04, (8, 1)), (False, 0.2, (8, 4)), (True, 0.2, (4, 20))],
)
def test_eight_stages_where_they_evaluate_less_and_the_flow_is_smooth(sharp, period, steps):
    def flow(x, u, d, p):
        rubbing = np.tanh(x[1]) if sharp else 0.0 * x[1]
        return np.array([x[1], u[0] - p.stiffness * x[0] - 0.1 * np.sin(x[0]) - 0.1 * rubbing])

    plant = Plant(flow, lambda x, u, p: x[:1], ("q", "v"), ("force",), parameters={"stiffness": 600.0})
    ukf = UnscentedKalmanFilter(plant, period, 1e-6, 1e-6, [0.0, 0.0], 1e-6)
    assert (ukf.stages, ukf.sub_steps) == steps


def one_period(plant, x, u, method, count, period=1e-3):
    """States (n, N) after a period, in so many steps."""
    given = (u, np.zeros(len(plant.disturbances)), plant.parameters.vector())
    held = [np.tile(vector[:, None], x.shape[1]) for vector in given]
    for _ in range(count):
        x = method(DIRECT, lambda x: np.asarray(plant.traced_flow(x, *held)), x, period / count)
    return x


@pytest.mark.oracle
@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_one_step_of_eight_stages_is_as_right_as_five_classical_ones(speed):
    """Of seven links with ringing springs, in any pose; the joints stand, or turn at 1 rad/s."""
    robot, rng = fh.load_robot("seven-link"), np.random.default_rng(3)
    plant = robot.plant()
    x, u = robot.operating_point()[:2]
    turned, moving, twisted = rng.normal(size=(3, 7, 12)) * np.array([1.0, speed, 1e-3])[:, None, None]
    states = x[:, None] + np.vstack([turned, moving, turned + twisted, moving])
    exact = one_period(plant, states, u, rk4_stages, 60)
    eight, five, three = (
        np.sqrt(np.mean((one_period(plant, states, u, *steps) - exact).reshape(4, -1) ** 2, axis=1))
        for steps in ((eight_stages, 1), (rk4_stages, 5), (rk4_stages, 3))
    )
    print(eight, five, three)
    # Positions and velocities, of links and of motors: the links' velocities alike, the rest better.
    assert np.all(eight < np.array([0.3, 1.15, 0.3, 1.0]) * five), (eight, five)
    assert np.all(eight < 0.2 * three)


@pytest.mark.ci("1,200 steps of drawn covariances in Python")
@pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter])
def test_what_is_accepted_as_a_covariance_can_be_used(kind):
    """Singular P0 and R^v of any rank, scaled over decades: the filter runs."""
    for n in (2, 6):
        case = LinearCase(n, 1, 1, seed=n)
        ukf = kind(**case.arguments(mean=np.zeros(n), form="covariance"))
        for _ in range(100):
            units = 10.0 ** case.rng.uniform(-4, 4, n)
            roots = [
                case.rng.normal(size=(n, rank)) * units[:, None] for rank in (n - 1, case.rng.integers(0, n))
            ]
            start, noise = (covariance_matrix(root @ root.T, n, "covariance") for root in roots)
            belief = ukf.initial._replace(covariance=start)
            vector = ukf.plant.parameters.vector()
            for _ in range(3):
                belief = ukf.time_update_on(DIRECT, belief, np.zeros(1), vector, 1e-6 * noise)
                belief = ukf.innovation_stages(DIRECT, belief, np.zeros(1), np.zeros(1), vector, case.r)[0]
                assert np.all(np.isfinite(belief.covariance))


def test_a_covariance_without_a_factor_is_refused():
    """A correlation above one by more than printed digits explain; by less it is clipped, see `test_repairs`."""
    case = LinearCase(2, 1, 1)
    with refused_with(InvalidInput, "covariance", "semidefinite"):
        ExtendedKalmanFilter(**case.arguments(covariance=[[1.0, 1.0 + 2e-6], [1.0 + 2e-6, 1.0]]))


@pytest.mark.parametrize("value", ["text", None, 1j, [1.0, "a"]])
@pytest.mark.parametrize("name", ["process_noise", "measurement_noise", "covariance"])
def test_covariances_that_are_no_numbers_say_what_is_expected(name, value):
    plant = fh.Plant(lambda x, u, d, p: x, lambda x, u, p: x, ("a", "b"), (), sampled=True)
    given = {
        "process_noise": 1.0,
        "measurement_noise": 1.0,
        "mean": [0.0, 0.0],
        "covariance": 1.0,
        name: value,
    }
    with refused_with(InvalidInput, "expected a number", "(2, 2)", repr(value)):
        fh.ExtendedKalmanFilter(plant, 0.1, **given)
