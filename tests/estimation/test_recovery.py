"""No measurement leaves an estimator stuck: covariances stay semidefinite, and what is refused changes nothing."""

import warnings

import numpy as np
import pytest

from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.plant import Plant

KINDS = [ExtendedKalmanFilter, UnscentedKalmanFilter]


def integrator(order=2):
    """A chain of integrators of which the first state is measured."""
    names = tuple("xyz"[:order])
    return Plant(lambda x, u, d, p: np.array([*x[1:], u[0]]), lambda x, u, p: x[:1], names, ("u",))


def peer_run(order, period, r, p0, samples):
    """filterpy's extended filter (Joseph's form) on the same model without process noise."""
    from filterpy.kalman import ExtendedKalmanFilter as Peer

    peer = Peer(dim_x=order, dim_z=1, dim_u=1)
    peer.x, peer.P, peer.R, peer.Q = (
        np.zeros((order, 1)),
        p0 * np.eye(order),
        r * np.eye(1),
        0.0 * np.eye(order),
    )
    peer.F = sum(
        np.linalg.matrix_power(period * np.eye(order, k=1), k) / float(max(1, k)) for k in range(order)
    )
    for y in samples:
        peer.update(np.array([[y]]), lambda _: np.eye(order)[:1], lambda x: x[:1])
        peer.predict()
    return peer


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("order", "r", "p0"), [(2, 1e-12, 1e4), (3, 1e-12, 1e4), (2, 1e-9, 1e6)])
def test_a_sensor_much_better_than_the_start_is_survived_as_by_filterpy(kind, order, r, p0):
    """R^v = 0, R^n = 1e-12 and P0 = 1e4: what the measurement leaves of P is a difference of numbers 16 digits larger.

    The mean is the peer's. Of the variances only the size is: a pivot of 1e-14 of its diagonal counts as zero, which is
    what remains of the second state here. Nothing short of a filter that carries a root of P keeps more.
    """
    period, rng = 0.1, np.random.default_rng(0)
    samples = 0.3 + 1e-6 * rng.normal(size=60)
    filter = kind(integrator(order), period, 0.0, r, np.zeros(order), p0)
    for y in samples:
        filter.correct(y)
        filter.predict(0.0)
    peer = peer_run(order, period, r, p0, samples)
    assert np.linalg.eigvalsh(filter.covariance).min() >= -1e-15 * np.abs(filter.covariance).max()
    np.testing.assert_allclose(filter.mean, peer.x[:, 0], atol=1e-4 if order == 3 else 1e-6)
    ratio = np.diag(filter.covariance) / np.diag(peer.P)
    assert 0.2 < ratio.min() <= ratio.max() < 1.1


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("kind", KINDS)
def test_a_corrected_covariance_can_be_factored_whatever_the_scales(kind):
    """P0, R^v and R^n over many decades, correlated: after each correction a prediction must be possible."""
    rng = np.random.default_rng(1)
    plant = Plant(
        lambda x, u, d, p: np.array([x[1], -np.sin(x[0]) - 30.0 * (x[0] - x[2]), x[3], 20.0 * (x[0] - x[2]) + u[0]]),
        lambda x, u, p: x[:1], tuple("abcd"), ("torque",),
    )  # fmt: skip
    for _ in range(12):
        root = rng.normal(size=(4, 4)) * 10.0 ** rng.uniform(-2, 2, size=4)
        p0 = 10.0 ** rng.uniform(0, 8) * root @ root.T
        filter = kind(
            plant, 1e-2, 10.0 ** rng.uniform(-14, -4), 10.0 ** rng.uniform(-12, -6), np.zeros(4), p0
        )
        for _ in range(5):
            filter.correct(1e-3 * rng.normal())
            filter.predict(0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_refused_leaves_a_filter_that_goes_on(kind):
    filter, clean = (kind(integrator(), 0.1, 1e-6, 1e-6, [0.1, 0.0], 1e-2) for _ in range(2))
    filter._belief = far = filter._belief._replace(mean=np.array([-1.7e308, 0.0]))
    with pytest.warns(UserWarning, match="not finite"):
        filter.correct(1.7e308)
    assert [entry.kind for entry in filter.diagnosis] == ["not finite"]
    assert np.isnan(filter.log_likelihood)
    assert filter._belief is far
    filter.predict(0.0)
    assert np.isfinite(filter.mean).all()
    filter.reset()
    for one in (filter, clean):
        one.predict(0.0)
        one.correct(0.11)
    np.testing.assert_array_equal(filter.mean, clean.mean)


def test_a_correction_that_leaves_no_covariance_is_refused():
    """With a negative central weight the sum of squares has a negative one: then the prediction stands."""
    plant = Plant(lambda x, u, d, p: u - x, lambda x, u, p: x**2, ("x",), ("u",))
    with pytest.warns(UserWarning, match=r"central.*weight.*negative \(-1\)"):
        filter = UnscentedKalmanFilter(plant, 0.1, 1e-6, 1e-6, [0.0], 1.0, alpha=1.0, beta=0.0, kappa=-0.5)
    before = filter.mean, filter.covariance
    with warnings.catch_warnings(record=True, action="always") as said:
        for y in (0.0, 0.5, 2.0):
            entries = filter.diagnosis
            filter.correct(y)
            if filter.diagnosis != entries:
                np.testing.assert_array_equal(filter.mean, before[0])
                np.testing.assert_array_equal(filter.covariance, before[1])
            filter.predict(0.0)
            before = filter.mean, filter.covariance
            assert np.linalg.eigvalsh(filter.covariance).min() > 0.0
    assert filter.diagnosis
    assert len(said) == len({entry.kind for entry in filter.diagnosis})
