"""Covariances whose last digits are missing, and measurements without noise: an answer, and a word about it."""

from __future__ import annotations

import copy
import pickle
import warnings

import mpmath
import numpy as np
import pytest
from tests.builders import pairs, still
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.estimation import linear_model, stationary_gain
from flexhinf.estimation.covariances import clipped_covariance

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

KINDS = [fh.UnscentedKalmanFilter, fh.ExtendedKalmanFilter]
FORMS = ["square_root", "covariance"]
EPS = np.finfo(float).eps


def linear_plant(f, c, bent=0.0):
    """x⁺ = F x + e u, with e the last unit vector; with `bent`, outputs are no lines (to rounding they are)."""
    n, p = len(f), len(c)
    return fh.Plant(
        lambda x, u, d, q: [
            sum(f[i, j] * x[j] for j in range(n)) + (u[0] if i == n - 1 else 0.0) for i in range(n)
        ],
        lambda x, u, q: [sum(c[i, j] * x[j] for j in range(n)) + bent * x[0] * x[0] for i in range(p)],
        tuple(f"x{i}" for i in range(n)), ("u",), outputs=tuple(f"y{i}" for i in range(p)), sampled=True,
    )  # fmt: skip


def reference(f, c, q, r, p0, ys, left_out=()):
    """Means and covariances of the Kalman filter in 60 digits after each correction, without elements `left_out`."""
    with mpmath.workdps(60):
        used = [i for i in range(len(c)) if i not in left_out]
        f, q, p = (mpmath.matrix(np.asarray(a, float).tolist()) for a in (f, q, p0))
        c, r = (
            mpmath.matrix(np.asarray(c)[used].tolist()),
            mpmath.matrix(np.asarray(r)[np.ix_(used, used)].tolist()),
        )
        m, found = mpmath.zeros(f.rows, 1), []
        for y in ys:
            gain = p * c.T * (c * p * c.T + r) ** -1
            m = m + gain * (mpmath.matrix([float(y[i]) for i in used]) - c * m)
            rest = mpmath.eye(f.rows) - gain * c
            p = rest * p * rest.T + gain * r * gain.T
            found.append((np.array(m.tolist(), float).ravel(), np.array(p.tolist(), float)))
            m, p = f * m, f * p * f.T + q
        return found


def rounded(kind, seed, n=6, rank=3):
    """A covariance of low rank as it is printed with ten digits, computed in float32, or propagated in floats."""
    rng = np.random.default_rng(seed)
    v = rng.normal(size=(n, rank))
    if kind == "printed":
        return np.array([[float(f"{x:.10g}") for x in row] for row in v @ v.T])
    if kind == "float32":
        return (v.astype(np.float32) @ v.astype(np.float32).T).astype(float)
    scale = 10.0 ** rng.uniform(-4, 4, n)
    return np.array([[float(f"{x:.10g}") for x in row] for row in v @ v.T * np.outer(scale, scale)])


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["printed", "float32", "scaled"])
def test_the_nearest_semidefinite_matrix_is_taken_and_said(kind):
    """Nearest in the Frobenius norm: by mpmath's eigenvectors of the correlations."""
    for seed in range(8):
        given = rounded(kind, seed)
        matrix, entry = clipped_covariance(given, 6, "initial covariance")
        unit = np.sqrt(np.diag(given))
        with mpmath.workdps(40):
            symmetric = (given + given.T) / 2 / np.outer(unit, unit)
            values, vectors = mpmath.eigsy(mpmath.matrix(symmetric.tolist()))
            clipped = vectors * mpmath.diag([max(value, 0) for value in values]) * vectors.T
            smallest, expected = float(values[0]), np.array(clipped.tolist(), float)
        np.testing.assert_allclose(matrix / np.outer(unit, unit), expected, rtol=0, atol=1e-14)
        assert np.array_equal(matrix, matrix.T)
        assert (entry is not None) == (smallest < -12 * EPS)
        if entry is not None:
            assert (entry.kind, entry.step) == ("clipped", 0)
            assert f"rank {sum(value > 12 * EPS for value in values)} of 6" in entry.cure
        again, silent = clipped_covariance(matrix, 6, "initial covariance")
        assert silent is None
        assert np.array_equal(again, matrix)


@pytest.mark.parametrize("n", [2, 3, 4, 8])
def test_a_singular_covariance_of_floats_stays_as_it_is_and_nothing_is_said(n):
    """Products of factors of fewer columns than rows, on scales of their own: indefinite by their rounding alone."""
    rng = np.random.default_rng(n)
    for _ in range(100):
        factor = rng.normal(size=(n, rng.integers(1, n))) * 10.0 ** rng.uniform(-3, 3, (n, 1))
        given = factor @ factor.T
        matrix, entry = clipped_covariance(given, n, "initial covariance")
        assert entry is None
        assert np.array_equal(matrix, given)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_clipped_is_counted_and_stays_said(kind, form):
    plant = linear_plant(np.eye(6), np.eye(6)[:2])
    given = rounded("printed", 0)
    filter = kind(plant, 0.01, given, given[:2, :2], np.zeros(6), given, form=form)
    exact = kind(plant, 0.01, 1e-3, 1e-2, np.zeros(6), given @ given, form=form)
    assert filter.repairs["covariance"] == len(filter.diagnosis) == 2
    assert ["process noise" in filter.diagnosis[0].cure, "initial cov" in filter.diagnosis[1].cure] == [
        True
    ] * 2
    assert "rank" in filter.summary()["covariances"]
    assert "covariances" not in exact.summary() or exact.repairs["covariance"] == 1
    for k in range(150):  # NumPy's calls and compiled ones
        filter.correct([0.1, 0.01 * k])
        filter.predict([0.0])
    assert np.isfinite(filter.mean).all()
    assert filter.repairs["covariance"] == 2
    again = pickle.loads(pickle.dumps(filter))
    assert again.diagnosis == filter.diagnosis
    assert np.array_equal(again.mean, filter.mean)
    filter.reset()
    assert (filter.repairs["covariance"], len(filter.diagnosis)) == (2, 2)
    assert np.linalg.eigvalsh(copy.copy(filter).covariance)[0] >= -1e-14


@pytest.mark.parametrize(
    ("given", "count"),
    [
        ([[1.0, 1.0 + 1e-15], [1.0 + 1e-15, 1.0]], 1),
        ([[1.0, 0.5 + 4e-10], [0.5, 1.0]], 1),
        ([[1.0, 1.0 + 9e-14], [1.0 + 9e-14, 1.0]], 1),
        ([[1.0, 1.0 + 1e-10], [1.0 + 1e-10, 1.0]], 1),
        ([[1.0, 1.0], [1.0, 1.0]], 0),
        ([[1.0, np.nextafter(0.5, 1)], [0.5, 1.0]], 0),
        ([[0.0, 0.0], [0.0, 1e-310]], 0),
        ([1e300, 1e-300], 0),
        (0.0, 0),
    ],
)
def test_nothing_is_changed_in_silence(given, count):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        filter = fh.ExtendedKalmanFilter(
            linear_plant(np.eye(2), np.eye(2)), 1.0, given, 1.0, [0.0, 0.0], given
        )
    assert filter.repairs["covariance"] == len(filter.diagnosis) == 2 * count


@pytest.mark.parametrize(
    "given",
    [
        [[1.0, 1.0 + 2e-6], [1.0 + 2e-6, 1.0]],
        [[1.0, 0.5 + 4e-6], [0.5, 1.0]],
        [1.0, -1e-10],
        [[1.0, 1e-6], [1e-6, 0.0]],
        [[1.0, np.nan], [np.nan, 1.0]],
    ],
)
def test_mistakes_are_refused(given):
    arguments = {"process_noise": 0.0, "measurement_noise": 1.0, "covariance": 1.0}
    for name in arguments:
        with refused_with(InvalidInput, "covariance" if name == "covariance" else "noise"):
            fh.UnscentedKalmanFilter(
                linear_plant(np.eye(2), np.eye(2)), 1.0, mean=[0.0, 0.0], **{**arguments, name: given}
            )


F = np.array([[1.0, 0.01, 0.0], [0.0, 1.0, 0.01], [0.0, 0.0, 0.98]])
Q = np.diag([1e-6, 1e-5, 1e-4])
EXACT = {
    "R = 0": (np.eye(3)[:1], [[0.0]], ()),
    "R = 0, two": (np.eye(3)[:2], np.zeros((2, 2)), ()),
    "rank one": (np.eye(3)[:2], np.full((2, 2), 1e-4), ()),
    "one exact": (np.array([[1.0, 0, 0], [1.0, 0, 0]]), np.diag([0.0, 1e-4]), ()),
    "twice": (np.array([[1.0, 0, 0], [0.0, 1.0, 0], [1.0, 0, 0]]), np.diag([0.0, 1e-2, 0.0]), (2,)),
    "a sum": (np.array([[1.0, 0, 0], [0, 0.3, 0], [1.0, 0.3, 0]]), np.zeros((3, 3)), (2,)),
}


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(("case", "kind", "form", "bent"), pairs(list(EXACT), KINDS, FORMS, [0.0, 1e-30]))
def test_exact_measurements_are_those_of_the_kalman_filter(case, kind, form, bent):
    """An element that the others tell exactly is left out, said, and has no part in the likelihood."""
    c, r, left_out = EXACT[case]
    r = np.array(r)
    filter = kind(linear_plant(F, c, bent), 1.0, Q, r, np.zeros(3), 1.0, form=form)
    rng, used = np.random.default_rng(1), [i for i in range(len(c)) if i not in left_out]
    plain = kind(linear_plant(F, c[used]), 1.0, Q, r[np.ix_(used, used)], np.zeros(3), 1.0, form="covariance")
    ys = np.cumsum(rng.normal(size=(130, 3)), axis=0) @ c.T * 1e-2
    for y, (mean, covariance) in zip(ys, reference(F, c, Q, r, np.eye(3), ys, left_out), strict=True):
        for one, seen in ((filter, y), (plain, y[used])):
            one.correct(seen)
        deviations = np.sqrt(np.diag(np.maximum(covariance, 0.0)))
        np.testing.assert_allclose(filter.mean, mean, rtol=1e-9, atol=1e-9)
        assert np.abs(filter.covariance - covariance).max() < 1e-9 * max(1e-6, deviations.max() ** 2)
        assert filter.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-6)
        for one in (filter, plain):
            one.predict([0.0])
    kinds = [entry.kind for entry in filter.diagnosis]
    assert set(kinds) <= {"digits"}
    if left_out or form == "square_root":
        assert sum(entry.count for entry in filter.diagnosis) == (130 if left_out else 0)


@pytest.mark.ci("120 samples of each filter")
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("gate", [None, 0.9999])
def test_where_nothing_is_uncertain_nothing_moves(kind, form, gate):
    """P0 = Q = R = 0: the innovation has no variance at all."""
    filter = kind(
        linear_plant(F, np.eye(3)[:2]), 1.0, 0.0, 0.0, [0.1, 0.2, 0.3], 0.0, form=form,
        **({"gate": gate} if gate else {}),
    )  # fmt: skip
    for _ in range(120):
        filter.correct([0.5, np.nan])
        filter.predict([0.0])
    assert np.isfinite(filter.mean).all()
    assert np.abs(filter.covariance).max() < 1e-28
    np.testing.assert_allclose(filter.mean, np.linalg.matrix_power(F, 120) @ [0.1, 0.2, 0.3], rtol=1e-12)


@pytest.mark.ci("compiles a controller of each form")
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_controller_takes_it_says_it_and_is_saved(kind, form, tmp_path):
    c = np.array([[1.0, 0, 0], [0, 0.3, 0], [1.0, 0.3, 0]])
    start = rounded("printed", 3, 3, 2)
    filter = kind(linear_plant(F, c), 1.0, Q, 0.0, np.zeros(3), start, form=form)
    assert filter.repairs["covariance"] == 1
    controller = fh.Controller(still(filter.plant), filter, 1.0, latency=0)
    controller.save(tmp_path / "c.npz")
    loaded = fh.load_controller(tmp_path / "c.npz")
    pieces, again = controller.in_pieces(), pickle.loads(pickle.dumps(controller))
    filter.reset()
    for k in range(5):
        y = [0.1 * k, 0.2, 0.1 * k + 0.2]
        for one in (controller, pieces, again, loaded):
            one.step(y)
        filter.correct(y)
        assert np.array_equal(controller.estimate, again.estimate)
        assert np.array_equal(controller.estimate, loaded.estimate)
        for one in (pieces, filter):
            np.testing.assert_allclose(
                controller.estimate, getattr(one, "estimate", filter.mean), rtol=1e-9, atol=1e-9
            )
        filter.predict([0.0])
    assert controller.doubtful_samples == pieces.doubtful_samples == 5


def test_noise_of_a_constant_gain_and_of_an_observer_is_positive():
    filter = fh.ExtendedKalmanFilter(linear_plant(F, np.eye(3)[:1]), 1.0, Q, 0.0, np.zeros(3), 1.0)
    with refused_with(NumericalFailure, "noise", "variance"):
        stationary_gain(linear_model(filter, np.zeros(3), np.zeros(1)), Q, filter.measurement_noise)


def test_a_divergent_mean_is_said_without_numpy_s_warnings():
    filter = fh.UnscentedKalmanFilter(
        linear_plant(F, np.eye(3)[:1]), 1.0, 1e-6, 1e-4, np.zeros(3), 1.0, form="covariance"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        warnings.simplefilter("ignore", UserWarning)
        for _ in range(30):
            filter.correct([1e300])
            filter.predict([0.0])
    assert np.isfinite(filter.mean).all()
