"""NIS, NEES and whiteness of innovations: by loops written here, and by filters that are right and wrong on purpose."""

from __future__ import annotations

import os
import subprocess
import sys

import mpmath
import numpy as np
import pytest
from tests.builders import FORMS
from tests.logs import PERIOD, Q, R, noisy_filter, noisy_log
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.identification.consistency import (
    consistency,
    squared_error,
    squared_errors,
    whiteness,
)


@pytest.mark.oracle
@FORMS
def test_nees_is_that_of_a_filter_written_here(form: str) -> None:
    from scipy.linalg import expm

    log = noisy_log(count=200)
    step, x, p = expm(PERIOD * np.array([[0.0, 1.0], [-40.0, -0.3]])), np.array([0.1, 0.0]), 1e-8 * np.eye(2)
    expected = []
    for y, truth in zip(log.outputs[:, 0], log.truth):
        gain = p[:, 0] / (p[0, 0] + R)
        x, p = x + gain * (y - x[0]), p - np.outer(gain, p[0])
        expected.append((truth - x) @ np.linalg.inv(p) @ (truth - x))
        x, p = step @ x, step @ p @ step.T + Q
    data = fh.filter_log(noisy_filter(form=form), log)
    np.testing.assert_allclose(data.nees.values, expected, rtol=1e-5, atol=1e-6)
    assert (data.known.values == 2).all()


@pytest.mark.oracle
def test_partly_known_and_singular_covariances() -> None:
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(30, 3, 3)) * [1e-6, 1.0, 1e6]
    spreads, errors = np.swapaxes(roots, 1, 2) @ roots, rng.normal(size=(30, 3)) * [1e-6, 1.0, 1e6]
    errors[5, 1], errors[6] = np.nan, np.nan
    errors[7:9, [0, 2]] = np.nan
    spreads[10] = np.diag([0.0, 1.0, 1e12])
    spreads[11] = np.outer([1e-6, 1.0, 1e6], [1e-6, 1.0, 1e6])
    squared, counts = squared_errors(errors, spreads)
    for k, (error, spread) in enumerate(zip(errors, spreads)):
        some = np.isfinite(error)
        assert counts[k] == some.sum()
        if k in (6, 10, 11):
            assert np.isnan(squared[k])
            continue
        with mpmath.workdps(60):
            part = mpmath.matrix(error[some].tolist())
            solved = mpmath.lu_solve(mpmath.matrix(spread[np.ix_(some, some)].tolist()), part)
            assert squared[k] == pytest.approx(float((part.T * solved)[0]), rel=1e-7)


@pytest.mark.ci("filters 100 logs")
@pytest.mark.oracle
def test_the_interval_is_that_of_the_chi_squared_distribution() -> None:
    """Its ends by the incomplete gamma function of mpmath, and by as many consistent filters."""
    error = squared_error(np.full(50, 1.2), np.full(50, 2))
    assert error is not None
    assert (error.samples, error.degrees, error.mean) == (50, 100, pytest.approx(0.6))
    for end, share in zip(error.interval, (0.025, 0.975)):
        assert float(mpmath.gammainc(50, 0, 50.0 * end, regularized=True)) == pytest.approx(share, rel=1e-9)
    tables = [fh.filter_log(noisy_filter(), noisy_log(seed, 150)) for seed in range(100)]
    ends = [(nis.mean, *nis.interval) for nis in (consistency(table).nis for table in tables)]
    assert sum(low <= mean <= high for mean, low, high in ends) >= 89
    across = squared_error(np.array([table.nees.values[100] for table in tables]), np.full(100, 2))
    assert across is not None
    assert across.judgement == "as expected"
    assert across.interval[0] < across.mean < across.interval[1]


@pytest.mark.oracle
def test_whiteness_by_its_definition() -> None:
    rng = np.random.default_rng(2)
    values = rng.normal(size=400)
    values[1:] += 0.3 * values[:-1]
    values[::17] = np.nan
    test = whiteness(values, lags=15)
    assert test is not None
    known = values[~np.isnan(values)]
    n, centred = len(known), known - known.mean()
    full = np.correlate(centred, centred, "full")[n - 1 :] / np.sum(centred**2)
    np.testing.assert_allclose(test.correlations, full[1:16], rtol=1e-12, atol=1e-14)
    statistic = n * (n + 2) * sum(full[k] ** 2 / (n - k) for k in range(1, 16))
    assert test.statistic == pytest.approx(statistic, rel=1e-12)
    exact = 1 - mpmath.gammainc(mpmath.mpf(15) / 2, 0, statistic / 2, regularized=True)
    assert test.p_value == pytest.approx(float(exact), rel=1e-6)
    assert not test.white
    assert whiteness(np.ones(100)) is None
    assert whiteness(rng.normal(size=9)) is None


def test_white_noise_is_white_as_often_as_stated() -> None:
    rng = np.random.default_rng(3)
    certain = sum(whiteness(rng.normal(size=300)).p_value > 0.05 for _ in range(400))
    assert 0.92 * 400 < certain < 0.98 * 400
    long = rng.normal(size=200_000)
    long[1:] += 0.02 * long[:-1]
    test = whiteness(long)
    assert test.p_value < 1e-6
    assert test.white, "a correlation of 0.02 is certain, and of no consequence"


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize(
    ("q", "r", "judgement", "first"),
    [(1.0, 1.0, "as expected", 0.0), (1 / 25, 1 / 25, "larger", 0.0), (25.0, 25.0, "smaller", 0.0),
     (1e-3, 1.0, "larger", 1.0), (1e4, 1.0, "smaller", -1.0)],
)  # fmt: skip
def test_wrong_noises_show_as_they_should(q: float, r: float, judgement: str, first: float) -> None:
    """Both noises 25 times too small: innovations five times as large as expected, and white. Too small a Q: they
    follow each other; too large a Q: they alternate."""
    result = consistency(fh.filter_log(noisy_filter(q, r), noisy_log(4)))
    output = result.outputs[0]
    assert (output.name, output.unit, output.samples) == ("position", "m", 2000)
    assert result.nis.judgement == judgement
    assert output.factor == pytest.approx(result.nis.factor, rel=1e-9)
    assert output.whiteness is not None
    if first == 0.0:
        assert result.nis.factor == pytest.approx(1.0 / np.sqrt(q), rel=0.05)
        assert output.whiteness.white
        if q == 1.0:
            assert output.inside == pytest.approx(0.95, abs=0.02)
            assert abs(output.bias) < 0.1
    else:
        assert not output.whiteness.white
        assert np.sign(output.whiteness.correlations[0]) == first


@pytest.mark.parametrize("value", [None, "text", 3.0, {}, {"innovation": 1.0}])
def test_what_is_no_table_of_innovations_is_refused(value):
    with refused_with(InvalidInput, "filter_log", repr(value)):
        fh.consistency(value)


_PROGRAM = """
import numpy as np
from flexhinf.identification.consistency import whiteness
found = whiteness(np.random.default_rng(0).normal(size=20_000))
print(found.correlations.tolist(), found.statistic)
"""


@pytest.mark.ci("two processes")
def test_threads_of_blas_change_no_bit_of_a_long_log():
    found = [
        subprocess.run(
            [sys.executable, "-c", _PROGRAM], env={**os.environ, "OPENBLAS_NUM_THREADS": threads},
            capture_output=True, check=True,
        ).stdout
        for threads in ("1", "2")
    ]  # fmt: skip
    assert found[0] == found[1]
