"""Polynomial plants: construction, evaluation, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.plant.polynomial_plant import PolynomialPlant, Problem

F = {(1, 0): [0.0, -1.0], (0, 1): [1.0, 0.0], (3, 0): [0.0, 0.1], (1, 2): [0.5, 0.0]}
G1 = [[0.0], [1.0]]
G2 = {(0, 0): [[1.0, 0], [0, 1]], (2, 0): [[0.0, 0], [0.5, 0]]}
H = {(1, 0): [1.0, 0, 0], (0, 2): [0, 0, 2.0]}
R2 = [[2.0, 0.5], [0.5, 1.0]]


def _plant(**changed) -> PolynomialPlant:
    given = {"f": F, "g1": G1, "g2": G2, "h": H, "r2": R2} | changed
    return PolynomialPlant(**given)


def test_fields_are_the_polynomials():
    plant = _plant()
    x = np.random.default_rng(0).standard_normal((6, 2))
    a, b = x.T
    f, g1, g2, h = plant.fields(x)
    assert f == pytest.approx(np.stack([b + 0.5 * a * b**2, -a + 0.1 * a**3], axis=1), rel=1e-13)
    assert g1.shape == (6, 2, 1)
    assert g2[:, 1, 0] == pytest.approx(0.5 * a**2, rel=1e-13)
    assert h == pytest.approx(np.stack([a, 0 * a, 2 * b**2], axis=1), rel=1e-13)
    assert plant.size == (2, 1, 2, 3)
    assert isinstance(plant, Problem)


def test_expansion_truncates():
    plant = _plant().expand(2)
    assert set(plant.f_parts) == {1}
    assert set(plant.g2_parts) == {0}
    assert set(plant.h_parts) == {1, 2}
    assert set(_plant().expand(3).f_parts) == {1, 3}


def test_parts_and_mappings_agree():
    plant = _plant(state_names=("angle", "rate"), operating_point=[1.0, 0])
    twin = PolynomialPlant.from_parts(
        2,
        plant.f_parts,
        plant.g1_parts,
        plant.g2_parts,
        plant.h_parts,
        R2,
        state_names=("angle", "rate"),
        operating_point=[1.0, 0],
    )
    x = np.array([[0.3, -0.2]])
    for ours, theirs in zip(plant.fields(x), twin.fields(x), strict=True):
        assert np.array_equal(ours, theirs)
    assert twin.state_names == plant.state_names
    assert np.array_equal(twin.operating_point, plant.operating_point)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"f": {**F, (0, 0): [0.0, 0.25]}}, r"equilibrium.*f = 0.* 0\.25 .*x2"),
        ({"h": {**H, (0, 0): [1.0, 0, 0]}}, r"penalty.*h = 0.* 1 .*z1"),
        ({"f": {**F, (0, 3): [0.0, np.nan]}}, r"\bf .*finite.*degree 3"),
        ({"f": {**F, (0, 3, 0): [0.0, 1.0]}}, r"\bf .*exponent.*\(0, 3, 0\)"),
        ({"f": {**F, (0, -1): [0.0, 1.0]}}, r"\bf .*exponent.*\(0, -1\)"),
        ({"f": {**F, (0, 3): [0.0, 1.0, 2.0]}}, r"\bf .*shapes.*\(2,\).*\(3,\).*\(0, 3\)"),
        ({"f": {**F, (0, 3): "ab"}}, r"\bf .*numbers.*'ab'"),
        ({"f": {1: [0.0, 1.0]}}, r"\bf .*exponent.*got 1"),
        ({"f": {("a", 0): [0.0, 1.0]}}, r"\bf .*exponent.*\('a', 0\)"),
        ({"g1": [[0.0], [1.0, 2.0]]}, r"g1 .*numbers.*\[\[0\.0\], \[1\.0, 2\.0\]\]"),
        ({"g2": "x"}, r"g2 .*numbers.*'x'"),
        ({"f": {}}, r"\bf .*mapping"),
        ({"g1": [0.0, 1.0]}, r"g1 .*matrix.*\(2,\)"),
        ({"g1": np.ones((3, 1))}, r"g1 .*\(2, 'any', 1\).*\(3, 1, 1\)"),
        ({"g2": np.ones((2, 3))}, r"g2 .*\(2, 2, 1\).*\(2, 3, 1\)"),
        ({"r2": [[1.0, 2.0], [2.0, 1.0]]}, r"R2.*definite.*\[-1\.0, 3\.0\]"),
        ({"r2": [[1.0, 0.5], [0.0, 1.0]]}, r"R2.*symmetric.*asymmetry 0\.5"),
        ({"r2": [[np.nan]]}, r"R2 .*square.*\[\[nan\]\]"),
        ({"state_names": ("one",)}, r"state.* 2 names, got 1: one"),
        ({"operating_point": [1.0]}, r"operating.* 2 finite.*\[1\.0\]"),
    ],
)
def test_refusals_name_what_is_wrong(changed, words):
    with pytest.raises(InvalidInput, match=f"(?s){words}"):
        _plant(**changed)


def test_rounding_at_rest_is_dropped():
    plant = _plant(f={**F, (0, 0): [1e-16, -1e-15]})
    assert 0 not in plant.f_parts


@pytest.mark.parametrize(
    "names",
    [
        {"state_names": ("a", "a")},
        {"state_names": ("a", "b"), "input_names": ("v", "a")},
        {"state_names": 5},
        {"state_names": "ab"},
    ],
    ids=repr,
)
def test_names_that_do_not_tell_signals_apart_are_refused(names):
    with pytest.raises(InvalidInput):
        _plant(**names)
