"""`predict` and `correct` as machine code: the same belief, counts, errors and entries as NumPy's."""

import copy
import pickle

import numpy as np
import pytest
from tests.builders import FORMS, KALMAN, bearing
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.codegen.program import Unsupported
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter, compiled, shell

# Filters that are compiled and step some ten times: 1 s instead of 3 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    monkeypatch.setattr(shell, "NUMPY_CALLS", 0)


def arguments(plant=None):
    return plant or bearing(), 0.1, 1e-4, [1e-3, 2e-3], [0.2, 0.1], [0.01, 0.04]


def by_numpy(filter):
    """The same filter, which is never compiled."""
    vars(filter)["_only_numpy"] = True
    return filter


SAMPLES = [
    ([0.05, 0.02], [0.3]), ([np.nan, 0.01], [0.1]), ([0.02, 0.03], [0.0]), (None, [0.2]), ([0.9, 0.1], [0.2]),
    ([0.1, np.nan], [-0.4]), (np.array([0.08, 0.05]), np.array([0.3])), ([np.nan, np.nan], 0.1),
]  # fmt: skip


def assert_alike(first, second):
    np.testing.assert_allclose(first.mean, second.mean, rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(first.covariance, second.covariance, rtol=1e-9, atol=1e-16)
    assert first.log_likelihood == pytest.approx(second.log_likelihood, rel=1e-9, nan_ok=True)
    np.testing.assert_array_equal(first.rejected, second.rejected)
    assert (first.repairs, first.diagnosis, first._step) == (second.repairs, second.diagnosis, second._step)


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@KALMAN
@FORMS
@pytest.mark.parametrize("more", [{}, {"gate": 0.99}, {"bounds": {"angle": (-0.1, 0.4)}}])
def test_what_it_computes_is_what_numpy_does(kind, form, more):
    filter, other = kind(*arguments(), form=form, **more), by_numpy(kind(*arguments(), form=form, **more))
    for y, u in SAMPLES * 3:
        filter.correct(y)
        other.correct(y)
        assert_alike(filter, other)
        filter.predict(u)
        other.predict(u)
        assert_alike(filter, other)
    assert filter._compiled is not None
    assert (filter.repairs["skipped"], filter.repairs["missing"]) == (6, 6)
    assert bool(more.get("gate")) == bool(filter.rejected.any())


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("setting", [{}, {"alpha": 0.9, "kappa": 1.0}])
def test_angles(setting):
    plant = fh.Plant(
        lambda x, u, d, q: np.array([x[0] + u[0] + x[1], 0.9 * x[1]]), lambda x, u, q: x[:1], ("angle", "drift"),
        ("turn",), outputs=("angle",), sampled=True, angles=("angle",),
    )  # fmt: skip
    given = (plant, 1.0, 1e-4, 1e-2, [3.0, 0.0], [0.01, 0.01])
    filter, other = (
        UnscentedKalmanFilter(*given, **setting),
        by_numpy(UnscentedKalmanFilter(*given, **setting)),
    )
    for k in range(12):
        for each in (filter, other):
            each.correct((3.0 + 0.4 * k + np.pi) % (2.0 * np.pi) - np.pi)
            each.predict(0.4)
        assert_alike(filter, other)
    assert filter._compiled is not None


@pytest.mark.oracle
def test_propagated_points():
    filter, other = (UnscentedKalmanFilter(*arguments(), redraw=False) for _ in range(2))
    by_numpy(other)
    for y, u in SAMPLES:
        for each in (filter, other):
            each.correct(y)
            each.predict(u)
        assert_alike(filter, other)
        np.testing.assert_allclose(filter._belief.points, other._belief.points, rtol=1e-10)
    assert filter._compiled is not None


def test_numpy_makes_the_first_calls(monkeypatch):
    monkeypatch.setattr(shell, "NUMPY_CALLS", 3)
    filter = ExtendedKalmanFilter(*arguments())
    for _ in range(3):
        filter.predict([0.1])
        assert filter._compiled is None
    filter.correct([0.1, 0.2])
    assert filter._compiled is not None
    assert filter._step == 3


@pytest.mark.quick_cases(2)
@KALMAN
@FORMS
def test_a_refusal_changes_nothing(kind, form):
    filter = kind(*arguments(), form=form)
    filter.correct([0.05, 0.02])
    filter.predict([0.3])
    before = filter.mean, filter.covariance, filter.log_likelihood
    for value in ([np.nan], [1.0, 2.0], "text", None, np.array([np.inf])):
        with refused_with(InvalidInput, "torque"):
            filter.predict(value)
    for value in ([0.1, np.inf], [1.0], 0.1, np.zeros((2, 1)), "text"):
        with refused_with(InvalidInput, "bearing"):
            filter.correct(value)
    for one, other in zip(before, (filter.mean, filter.covariance, filter.log_likelihood)):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(filter._u, [0.3])
    filter.correct([0.05, 0.02])
    assert filter._compiled is not None


@pytest.mark.quick_cases(2)
@KALMAN
@FORMS
def test_an_estimate_that_is_not_finite_is_left_out_and_said(kind, form):
    plant = fh.Plant(lambda x, u, d, q: np.exp(x) * u[0], lambda x, u, q: x, ("x",), ("u",))
    filter = kind(plant, 0.1, 1e-4, 1e-3, [0.0], 1e-4, form=form)
    filter.predict([0.0])
    before = filter.mean
    with pytest.warns(UserWarning, match="Sample 1"):
        filter.predict([1e300])
    assert [(entry.kind, entry.step) for entry in filter.diagnosis] == [("not finite", 1)]
    np.testing.assert_array_equal(filter.mean, before)
    filter.predict([0.1])
    assert filter._compiled is not None
    assert np.isfinite(filter.mean).all()


def test_lost_digits_are_said():
    plant = fh.Plant(
        lambda x, u, d, q: 0.0 * x, lambda x, u, q: np.array([x[0] + x[1], x[0] + x[1] + 1e-9 * x[0]]),
        ("a", "b"), ("u",), outputs=("one", "other"),
    )  # fmt: skip
    given = (plant, 0.1, 0.0, 1e-24, [0.0, 0.0], 1.0)
    filter, other = (ExtendedKalmanFilter(*given, form="square_root") for _ in range(2))
    by_numpy(other)
    for k in range(4):
        for each in (filter, other):
            each.correct([0.1 + 1e-3 * k, 0.1])
            each.predict(0.0)
        np.testing.assert_array_equal(filter.repairs, other.repairs)
        assert filter.diagnosis == other.diagnosis
    assert {entry.kind for entry in filter.diagnosis} == {"digits", "innovations"}


@KALMAN
def test_what_is_set_later_counts(kind):
    filter, other = kind(*arguments()), by_numpy(kind(*arguments()))
    for each in (filter, other):
        each.predict([0.1])
        each.process_noise = 1e-2 * np.eye(2)
        each.predict([0.1])
        each._belief = each.initial._replace(mean=np.array([0.5, 0.0]))
        each.correct([0.1, 0.2])
    assert_alike(filter, other)
    filter.reset()
    np.testing.assert_array_equal(filter.mean, [0.2, 0.1])
    assert filter.repairs == dict.fromkeys(filter.repairs, 0)
    filter.predict([0.1])
    assert filter._compiled is not None


@pytest.mark.quick_cases(1)
@KALMAN
@FORMS
def test_copies_and_pickles_continue_apart(kind, form):
    robot = fh.paper_arm()
    filter = kind(robot.plant(), 1e-3, 1e-6, 1e-6, np.zeros(4), 1e-4, form=form)
    filter.correct(0.01)
    filter.predict(0.3)
    others = copy.copy(filter), copy.deepcopy(filter), pickle.loads(pickle.dumps(filter))
    before = filter.mean, filter.covariance
    for other in others:
        np.testing.assert_array_equal(other.mean, before[0])
        other.correct(0.02)
        other.predict(-0.3)
    np.testing.assert_array_equal(filter.mean, before[0])
    filter.correct(0.02)
    filter.predict(-0.3)
    for other in others:
        np.testing.assert_array_equal(other.mean, filter.mean)
        np.testing.assert_array_equal(other.covariance, filter.covariance)
        assert other.log_likelihood == filter.log_likelihood


def test_without_a_compiler_and_with_text_of_its_own_a_filter_stays_with_numpy(monkeypatch):
    class Still(UnscentedKalmanFilter):
        def time_update(self, belief, u, p, process_noise):
            return belief

    def unsupported(program):
        raise Unsupported("no code", "erf")

    filter = Still(*arguments())
    filter.predict([1.0])
    np.testing.assert_array_equal(filter.mean, [0.2, 0.1])
    monkeypatch.setattr(compiled, "compile_program", unsupported)
    plant = fh.Plant(lambda x, u, d, q: -x + u, lambda x, u, q: x, ("x",), ("u",))
    other = ExtendedKalmanFilter(plant, 0.1, 1e-4, 1e-3, [1.0], 0.01)
    other.predict([0.0])
    assert other.mean == pytest.approx(np.exp(-0.1), rel=1e-6)
    assert filter._compiled is other._compiled is None
