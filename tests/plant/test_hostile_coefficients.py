"""Coefficients that no plant has: refused by a clear error, before anything is allocated for them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import flexhinf as fh

GOOD: dict[str, Any] = {
    "f": {(1, 0): [-1, 0], (0, 1): [0, -1]},
    "g1": [[0], [1]],
    "g2": [[1], [0]],
    "h": {(1, 0): [1, 0], (0, 1): [0, 1]},
    "r2": 1.0,
}


@pytest.mark.parametrize(
    "wrong",
    [
        {"g2": np.zeros((2, 0)), "r2": np.zeros((0, 0))},
        {"f": {(): []}, "g1": np.zeros((0, 1)), "g2": np.zeros((0, 1)), "h": {(): []}},
        {"r2": [[1 + 1j]]},
        {"r2": "a"},
        {"r2": 10**400},
        {"f": {(1, 0): [-(10**400), 0]}},
        {"f": {(1, 0): [-1, 1j]}},
        {"g1": [[0], [np.ma.masked]]},
        {"g1": np.ma.array([[0.0], [1.0]], mask=[[False], [True]])},
        {"f": {**GOOD["f"], (201, 0): [1, 0]}},
        {"f": {**GOOD["f"], (10**30, 0): [1, 0]}},
        {"operating_point": [1j, 0]},
        {"operating_point": "ab"},
        {"state_names": [1, 2]},
    ],
    ids=str,
)
def test_is_refused(wrong):
    with pytest.raises(fh.InvalidInput) as caught:
        fh.PolynomialPlant(**{**GOOD, **wrong})
    assert caught.value.found
    assert caught.value.advice


@pytest.mark.parametrize("exponent", [99, 150, 200])
def test_high_exponents_are_kept(exponent):
    """Binomials beyond 64 bits stand in no table that they need."""
    plant = fh.PolynomialPlant(**{**GOOD, "f": {**GOOD["f"], (exponent - 1, 1): [3, 0]}})
    x = np.array([[1.01, 0.5]])
    assert plant.fields(x)[0][0, 0] == pytest.approx(-1.01 + 3 * 1.01 ** (exponent - 1) * 0.5)
    assert fh.solve_hji(plant, math.inf, 4).degree == 4


@pytest.mark.parametrize("name", ["f", "g1", "g2", "h"])
def test_numbers_whose_squares_overflow_are_refused_by_the_synthesis(name):
    huge = {"f": {(1, 0): [-1e300, 0], (0, 1): [0, -1]}, "h": {(1, 0): [1e300, 0], (0, 1): [0, 1]}}
    plant = fh.PolynomialPlant(**{**GOOD, name: huge.get(name, [[1e300], [0]])})
    for synthesis in (fh.smallest_gamma, lambda problem: fh.solve_hji(problem, 2.0, 4)):
        with pytest.raises(fh.InvalidInput, match=rf" {name} .*proportion[\s\S]* 1e\+300"):
            synthesis(plant)


def test_levels_out_of_all_proportion():
    plant = fh.PolynomialPlant(**GOOD)
    with pytest.raises(fh.InfeasibleGamma):
        fh.solve_hji(plant, 1e-300, 4)
    with pytest.raises(fh.InvalidInput, match="gamma"):
        fh.solve_hji(plant, 10**5000, 4)
    assert pytest.approx(fh.solve_hji(plant, math.inf, 4).P) == fh.solve_hji(plant, 1e300, 4).P


def test_kronecker_coefficients_that_are_no_matrices():
    good = {"f": [[[-1.0]]], "g1": [[[1.0]]], "g2": [[[1.0]]], "h": [[[1.0]]], "r2": 1.0}
    assert fh.PolynomialPlant.from_kronecker(**good).size == (1, 1, 1, 1)
    for name, wrong in (
        ("f", [3]),
        ("f", [[[-1.0]], 3.0]),
        ("f", [[[1j]]]),
        ("g1", ["x"]),
        ("h", [[[10**400]]]),
    ):
        with pytest.raises(fh.InvalidInput):
            fh.PolynomialPlant.from_kronecker(**{**good, name: wrong})
