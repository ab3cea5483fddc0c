import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st

import flexhinf as fh
from flexhinf.codegen import DIRECT
from flexhinf.errors import InvalidInput
from flexhinf.estimation import SigmaPoints
from flexhinf.scalars import cholesky


@pytest.mark.paper
def test_table_3_with_four_states():
    sigma = SigmaPoints(4, 1.0, 2.0, 0.0)
    assert sigma.spread == 2.0
    np.testing.assert_allclose(sigma.mean_weights, [0.0] + [1 / 8] * 8, atol=1e-16)
    np.testing.assert_allclose(sigma.covariance_weights, [2.0] + [1 / 8] * 8)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("n", "alpha", "beta", "kappa"), [(2, 0.7, 2.0, 1.0), (5, 1.0, 2.0, 0.0), (3, 1.0, 0.0, -0.5)]
)
def test_weights_are_those_of_equation_10(n, alpha, beta, kappa):
    lam = alpha**2 * (n + kappa) - n
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sigma = SigmaPoints(n, alpha, beta, kappa)
    assert sigma.spread == pytest.approx(np.sqrt(n + lam), rel=1e-15)
    assert sigma.mean_weights[0] == pytest.approx(lam / (n + lam), abs=1e-15)
    assert sigma.covariance_weights[0] == pytest.approx(lam / (n + lam) + 1 - alpha**2 + beta, abs=1e-14)
    np.testing.assert_allclose(sigma.mean_weights[1:], 1 / (2 * (n + lam)), rtol=1e-14)
    np.testing.assert_array_equal(sigma.mean_weights[1:], sigma.covariance_weights[1:])


@pytest.mark.property
@given(st.integers(1, 6), st.floats(0.5, 2.0), st.floats(0.0, 3.0), st.integers(0, 10**6))
def test_points_have_the_mean_and_covariance_they_are_drawn_for(n, alpha, kappa, seed):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sigma = SigmaPoints(n, alpha, 2.0, kappa)
    root = np.random.default_rng(seed).normal(size=(n, n))
    covariance = root @ root.T
    offsets = np.column_stack((np.zeros(n), *DIRECT.columns(sigma.offsets, cholesky(covariance))))
    pairs = np.column_stack(DIRECT.columns(sigma.pair, cholesky(covariance), np.ones(n)))
    np.testing.assert_array_equal(pairs, 1.0 + offsets[:, 1:])
    assert offsets.shape == (n, 2 * n + 1)
    assert sigma.mean_weights.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(offsets @ sigma.mean_weights, 0.0, atol=1e-12)
    spread = offsets * sigma.covariance_weights @ offsets.T
    np.testing.assert_allclose(spread, covariance, atol=1e-11 * max(1.0, np.abs(covariance).max()))


def test_a_negative_weight_is_said():
    with pytest.warns(UserWarning, match="negative"):
        SigmaPoints(4, 0.1, 2.0, 0.0)


@pytest.mark.parametrize(
    ("alpha", "beta", "kappa"),
    [
        (0.0, 2.0, 0.0),
        (-1.0, 2.0, 0.0),
        (1.0, 2.0, -4.0),
        (np.nan, 2.0, 0.0),
        (1.0, np.inf, 0.0),
        (1.0, 2.0, np.nan),
    ],
)
def test_scalings_without_points_are_refused(alpha, beta, kappa):
    with pytest.raises(InvalidInput):
        SigmaPoints(4, alpha, beta, kappa)


def test_a_central_weight_that_is_zero_but_for_rounding_is_zero():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert all(SigmaPoints(n, 1.0, 0.0, 0.0).covariance_weights[0] == 0.0 for n in range(1, 60))
    with pytest.warns(UserWarning, match="negative"):
        assert SigmaPoints(3, 1.0, -1e-12, 0.0).covariance_weights[0] == pytest.approx(-1e-12, rel=1e-3)


@pytest.mark.ci("filters and smooths a log")
def test_the_cubature_filter_of_three_states_has_rows_and_a_smoother():
    states = ("a", "b", "c")
    plant = fh.Plant(lambda x, u, d, p: np.sin(x), lambda x, u, p: x[:1] ** 2, states, (), sampled=True)
    given = {"alpha": 1.0, "beta": 0.0, "kappa": 0.0}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cubature = fh.UnscentedKalmanFilter(plant, 0.1, 1e-3, 1e-2, [1.0, 2.0, 3.0], 0.1, **given)
    assert cubature.form == "square_root"
    outputs = np.linspace(1.0, 0.5, 12)
    with_rows = fh.filter_log(cubature, (0.1 * np.arange(12), None, outputs), smooth=True)
    assert np.isfinite(with_rows["smoothed"].values).all()
    # The rule of third degree by hand: 2n points at √n times the columns of a root, all weights 1/2n.
    cubature.predict()
    offsets = np.sqrt(3.0 * 0.1) * np.hstack([np.eye(3), -np.eye(3)])
    moved = np.sin(np.array([[1.0], [2.0], [3.0]]) + offsets)
    np.testing.assert_allclose(cubature.mean, moved.mean(axis=1), rtol=1e-14)
    about = moved - moved.mean(axis=1)[:, None]
    np.testing.assert_allclose(cubature.covariance, about @ about.T / 6 + 1e-3 * np.eye(3), atol=1e-15)
