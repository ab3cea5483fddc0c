"""What a filter says of answers that cannot be trusted, online and from recorded samples."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from fuzz.hostile_filters import filter_of, kept
from scipy.stats import chi2
from tests.builders import FORMS, KALMAN
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.estimation.diagnosis import innovation_limit
from flexhinf.estimation.square_root import reciprocal_condition
from flexhinf.scalars import cholesky, householder

# Filters that are compiled and step a few hundred times: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


def twin(noise, **options):
    """Two states of which the outputs see nearly the same."""
    plant = fh.Plant(
        lambda x, u, d, q: np.array([u[0], -x[1]]), lambda x, u, q: np.array([x[0] + x[1], x[0] + q.c * x[1]]),
        ("a", "b"), ("u",), outputs=("y1", "y2"), parameters={"c": 1.0 + 1e-13},
    )  # fmt: skip
    return fh.ExtendedKalmanFilter(plant, 0.1, 0.0, noise, [0.0, 0.0], 1.0, form="square_root", **options)


@pytest.mark.oracle
def test_the_reciprocal_condition_is_that_of_the_smallest_pivot():
    """[1 1; 1 1 + 1e-6] has the pivots √2 and about 1e-6/√2."""
    slope, noise = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-6]]), 1e-20 * np.eye(2)
    with mpmath.workdps(50):
        factor = mpmath.qr(mpmath.matrix(slope.T.tolist()), mode="skinny")[1]
        pivot, size = abs(factor[1, 1]), 2.0 + 1e-6
        deviations = [float(abs(x)) for x in mpmath.lu_solve(factor.T, mpmath.matrix([1.0, 2.0]))]
    gains = householder(np.vstack([slope.T, cholesky(noise).T]), 2)[:2]
    condition = reciprocal_condition(gains, np.array([1.0, 2.0]), np.eye(2), slope, noise)
    assert condition == pytest.approx(float(pivot / size) / max(deviations), rel=1e-6)


def test_digits_that_are_lost_are_recorded_and_an_ordinary_filter_says_nothing():
    hostile, ordinary = twin(1e-24), twin(1e-2)
    for one in (hostile, ordinary):
        one.correct([1.0, 2.0])
        one.predict([0.0])
        one.correct([1.0, 1.1])
    assert hostile.diagnosis[0] == fh.Diagnosis("digits", 0, hostile.diagnosis[0].cure, 2)
    assert "noise" in hostile.diagnosis[0].cure
    assert ordinary.diagnosis == ()
    hostile.reset()
    assert hostile.diagnosis == ()


def test_recorded_samples_name_the_inputs_that_decide():
    y, u = np.array([[1.0, 2.0], [1.0, 1.1], [0.9, 1.0]]), np.zeros((3, 1))
    hostile, ordinary = twin(1e-24), twin(1e-2)
    kinds = {entry.kind for entry in fh.diagnose(hostile, y, u)}
    assert {"digits", "parameters", "measurements"} <= kinds
    assert fh.diagnose(ordinary, y) == fh.diagnose(ordinary, y, u) == ()
    assert hostile.diagnosis == ()  # nothing of it is changed
    assert fh.diagnose(hostile) == ()


@pytest.mark.ci("moves every input of recorded samples twenty times")
@pytest.mark.oracle
@pytest.mark.parametrize(("name", "flagged"), [("47", True), ("28", False)])
def test_a_kept_filter_is_flagged_where_its_inputs_do_not_determine_it(name, flagged):
    case = next(case for case in kept() if case.name == name)
    assert case.determined is not flagged
    assert bool(fh.diagnose(filter_of(case), case.y, case.u[:, None])) is flagged


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([1.0, 2.0], None), ("measurements", "(N, 2)", "(2,)")),
        ((np.zeros((3, 2)), np.zeros((3, 2))), ("inputs", "(N, 1)", "(3, 2)")),
        ((np.zeros((3, 2)), np.zeros((2, 1))), ("lengths", "3 inputs", "2")),
    ],
)
def test_samples_that_do_not_fit_are_refused(arguments, words):
    with refused_with(InvalidInput, *words):
        fh.diagnose(twin(1.0), *arguments)
    with refused_with(InvalidInput, "filter", "diagnose(ukf, y, u)"):
        fh.diagnose(3.0)


# Innovations beyond all noise ----------------------------------------------------------------------
def walk(kind, form, **options):
    plant = fh.Plant(lambda x, u, d, p: x, lambda x, u, p: x + 0.1 * np.sin(x), ("a",), (), sampled=True)
    return kind(plant, 1.0, 1e-4, 1e-2, [0.0], 1e-2, form=form, **options)


@pytest.mark.oracle
@pytest.mark.parametrize("size", [1, 2, 7, 40])
def test_no_noise_gets_near_the_limit_of_innovations(size):
    """exp(−5000) bounds the probability; SciPy knows its logarithm where it is no float."""
    log_probability = chi2.logsf(innovation_limit(size), size)
    assert log_probability <= -5000.0 or log_probability == -np.inf
    assert innovation_limit(size) < 10_000 + 250 * size


@pytest.mark.ci("compiles each filter")
@pytest.mark.quick_cases(1)
@KALMAN
@FORMS
def test_innovations_that_no_noise_explains_are_one_entry_from_sample_to_sample(kind, form):
    slow, compiled = walk(kind, form), walk(kind, form)
    slow._only_numpy = True
    noises = 0.1 * np.random.default_rng(4).normal(size=300)
    expected = []
    for k, noise in enumerate(noises):
        y = noise + (1e3 if 150 <= k < 153 else 1e4 if k == 250 else 0.0)
        spread = slow.innovate(slow._belief, np.array([y]), slow._u, slow._parameters, slow.measurement_noise)
        if spread[1][0] ** 2 / spread[2][0, 0] > innovation_limit(1):
            expected.append(k)
        for one in (slow, compiled):
            one.correct([y])
            one.predict()
    np.testing.assert_allclose(compiled.mean, slow.mean, rtol=1e-9)
    assert compiled.diagnosis == slow.diagnosis
    entries = [entry for entry in slow.diagnosis if entry.kind == "innovations"]
    assert [k for entry in entries for k in range(entry.step, entry.step + entry.count)] == expected
    assert {150, 250} <= set(expected)
    assert len(entries) < len(expected)
    assert "gate" in entries[0].cure
    gated = walk(kind, form, gate=0.9999)
    for k, noise in enumerate(noises):
        gated.correct([noise + (1e4 if k == 250 else 0.0)])
        gated.predict()
    assert (gated.diagnosis, gated.repairs["rejected"] >= 1) == ((), True)


@pytest.mark.ci("300 samples")
def test_an_outlier_makes_no_hundred_entries_of_lost_digits():
    filter = walk(fh.ExtendedKalmanFilter, "square_root")
    for k in range(300):
        filter.correct([1e15 if k == 5 else 0.0])
        filter.predict()
    assert len(filter.diagnosis) < 10
    assert filter.diagnosis[0].step == 5


@pytest.mark.parametrize("form", ["square_root", "covariance"])
def test_a_model_that_is_nan_at_a_sigma_point_is_not_finite(form):
    tank = fh.Plant(
        lambda x, u, d, p: np.array([x[0] - 0.1 * np.sqrt(x[0])]), lambda x, u, p: x, ("level",), (),
        outputs=("y",), sampled=True,
    )  # fmt: skip
    ukf = fh.UnscentedKalmanFilter(tank, 1.0, [0.0], [1.0], mean=[0.2], covariance=[0.5], form=form)
    with pytest.warns(UserWarning, match="not finite"):
        ukf.predict()
    assert [entry.kind for entry in ukf.diagnosis] == ["not finite"]
    np.testing.assert_array_equal(ukf.mean, [0.2])
