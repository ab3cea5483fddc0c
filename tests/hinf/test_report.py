"""What a solution prints about itself."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from flexhinf.hinf import linear_law, smallest_gamma, solve_hji
from flexhinf.plant.polynomial_plant import PolynomialPlant


@pytest.fixture
def lines(arm):
    return solve_hji(arm, 2 * smallest_gamma(arm), 4).report().splitlines()


def test_one_row_for_each_degree_with_method_residual_and_time(lines):
    head = next(i for i, line in enumerate(lines) if "relative residual" in line)
    riccati, parity, cubic, total = (line.split() for line in lines[head + 1 : head + 5])
    assert riccati[:3] == ["2", "15", "Riccati"]
    assert float(riccati[3]) < 1e-13
    assert parity == ["3", "35", "zero", "by", "parity", "–", "–", "–"]
    assert cubic[:4] == ["4", "70", "eigenbasis,", "refined"]
    assert float(cubic[4]) < 1e-13
    assert 1e-16 < float(cubic[5]) < 1e-11
    assert cubic[-1] in ("ms", "s")
    assert total[:2] == ["total", "120"]
    assert {len(line) for line in lines[head : head + 5]} == {len(lines[head])}


def test_equation_sizes_and_level_are_named(lines, arm):
    assert lines[0].startswith("Hamilton–Jacobi–Isaacs ")
    assert re.findall(r" (\d+) ([a-z])", lines[0]) == [("5", "s"), ("1", "d"), ("1", "i"), ("2", "p")]
    assert lines[1].startswith("gamma = 246.03363")
    assert "= 2 gamma*, gamma* = 123.0168" in lines[1]
    bellman = linear_law(arm, math.inf).report()
    assert bellman.startswith("Hamilton–Jacobi–Bellman")
    assert re.search(r"\bno .*disturbance", bellman)
    assert "nan" not in bellman


def test_conditioning_and_memory_are_told(lines):
    assert any("cond(T) = 23.1" in line and "cond(T)^4 eps" in line for line in lines)
    assert any("kB" in line and "estimated" in line for line in lines)


def test_defective_loop_is_said_to_be_so():
    plant = PolynomialPlant(
        {(1, 0): [-1.0, 0.0], (0, 1): [1.0, -1.0]}, [[1.0], [0.0]], [[0.0], [1.0]],
        {(1, 0): [0.0], (2, 0): [1.0]}, 1.0,
    )  # fmt: skip
    report = solve_hji(plant, math.inf, 4).report()
    assert "Schur" in report
    assert "cond(T)" in report


def test_the_error_of_the_eigenbasis_grows_with_the_power_of_its_condition(arm):
    report = replace(solve_hji(arm, math.inf, 5), condition=1e3).report()
    assert f"cond(T)^5 eps = {1e15 * np.finfo(float).eps:.1e}" in report
