"""What a filter says of answers that cannot be trusted, online and from recorded samples."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from fuzz.hostile_filters import filter_of, kept
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.estimation.diagnosis import lost_digits


def twin(noise, **options):
    """Two states of which the outputs see nearly the same."""
    plant = fh.Plant(
        lambda x, u, d, q: np.array([u[0], -x[1]]), lambda x, u, q: np.array([x[0] + x[1], x[0] + q.c * x[1]]),
        ("a", "b"), ("u",), outputs=("y1", "y2"), parameters={"c": 1.0 + 1e-13},
    )  # fmt: skip
    return fh.ExtendedKalmanFilter(plant, 0.1, 0.0, noise, [0.0, 0.0], 1.0, form="square_root", **options)


@pytest.mark.oracle
def test_lost_digits_are_those_of_the_smallest_pivot():
    """[1 1; 1 1 + 1e-6] has the pivots √2 and about 1e-6/√2."""
    slope, noise = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-6]]), 1e-20 * np.eye(2)
    with mpmath.workdps(50):
        factor = mpmath.qr(mpmath.matrix(slope.T.tolist()), mode="skinny")[1]
        pivot, size = abs(factor[1, 1]), 2.0 + 1e-6
        deviations = [float(abs(x)) for x in mpmath.lu_solve(factor.T, mpmath.matrix([1.0, 2.0]))]
    share = 2.0**-52 / float(pivot / size) * max(deviations)
    assert lost_digits(np.eye(2), slope, noise, np.array([1.0, 2.0])) == pytest.approx(share, rel=1e-6)


def test_digits_that_are_lost_are_recorded_and_an_ordinary_filter_says_nothing():
    hostile, ordinary = twin(1e-24), twin(1e-2)
    for one in (hostile, ordinary):
        one.correct([1.0, 2.0])
        one.predict([0.0])
        one.correct([1.0, 1.1])
    assert hostile.diagnosis[0] == fh.Diagnosis("digits", 0, hostile.diagnosis[0].cure)
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
