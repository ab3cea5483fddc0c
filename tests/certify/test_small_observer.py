"""An observer of two states by hand: each matrix that its proof needs, and the gains up to which it is one."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from flint import fmpq_mat
from tests.refusals import refused_with, unnamed

from flexhinf.certify import Certificate, Function, Parameter, Signal, Term
from flexhinf.certify.certificate import theorem_text
from flexhinf.certify.checker import Verification, statements as checked
from flexhinf.certify.checker.residual import Refusal
from flexhinf.certify.claim import Observer
from flexhinf.errors import InvalidInput

pytestmark = pytest.mark.oracle

A = np.array([[-0.5, 1.25], [0.75, -1.5]])
G = np.array([[0.5, 0.0], [0.25, -1.0]])
GAIN = np.array([[2.0], [1.0]])
SENSOR = np.array([[1.0, 0.0]])
G2 = np.array([[0.0, 0.5], [1.0, 0.75], [0.0, 0.0]])
R2 = np.array([[2.0, 0.5], [0.5, 1.0]])
W = np.array([[3.0, 0.5, 0.25], [0.5, 2.0, -0.25], [0.25, -0.25, 1.0]])  # V = ½ xᵀWx + 0.05 x2⁴
T = ((1.0, 0.25, 0.0), (0.0, 0.5, -0.5), (0.0, 0.0, 2.0))


def term(value: float, *powers: int, **more: Any) -> Term:
    return Term(float(value), powers, **more)


def plant(**changes: Any) -> Certificate:
    """x1 is measured, x3 is its integral, and known; a sine of x1 stands in the rate of x2."""
    quarter = (("half", 2),)
    drift = (
        (term(A[0, 0], 1, 0, 0), term(4 * A[0, 1], 0, 1, 0, parameters=quarter), term(-0.2, 1, 0, 1)),
        (term(A[1, 0], 1, 0, 0), term(A[1, 1], 0, 1, 0), term(0.7, 0, 0, 0, function=0), term(0.1, 0, 0, 1)),
        (term(1.0, 1, 0, 0), term(0.5, 0, 0, 1)),
    )
    g1 = tuple(tuple((term(4 * v, 0, 0, 0, parameters=quarter),) if v else () for v in row) for row in G)
    g2 = tuple(tuple((term(v, 0, 0, 0),) if v else () for v in row) for row in G2)
    value = {(1, 1, 0): W[0, 1], (1, 0, 1): W[0, 2], (0, 1, 1): W[1, 2], (0, 4, 0): 0.05}
    value |= {tuple(2 * int(i == j) for j in range(3)): W[i, i] / 2 for i in range(3)}
    onto = -np.linalg.inv(R2) @ G2.T
    law = []
    for row in onto:
        linear = row @ W
        law.append((*((tuple(int(i == j) for j in range(3)), float(linear[i])) for i in range(3)),
                    ((0, 3, 0), float(row[1] * 0.2))))  # fmt: skip
    fields: dict[str, Any] = {
        "about": "two estimated states", "states": (Signal("x"), Signal("v"), Signal("i")),
        "inputs": (Signal("a"), Signal("b")), "disturbances": (Signal("d"), Signal("e")), "drift": drift,
        "g1": (*g1, ((), ())), "g2": g2, "penalty": (), "r2": tuple(map(tuple, R2.tolist())),
        "value": tuple((powers, float(v)) for powers, v in value.items()),
        "law": tuple(law), "gamma": 2.0, "level": 1.0, "coordinates": T,
        "reach": 0.75, "functions": (Function("sin", (1.0, 0.0, 0.0)),), "feedback": "output injection observer",
        "parameters": (Parameter("half", 0.5, 0.5), Parameter("load", 1.0, 2.0)), "observer": observer(),
    }  # fmt: skip
    return Certificate(**{**fields, **changes})


def observer(**changes: Any) -> Observer:
    fields: dict[str, Any] = {
        "measured": ((1.0, 0.0, 0.0),), "known": ("i",), "gain": tuple(map(tuple, GAIN.tolist())),
        "weight": ((60.0, 0.0), (0.0, 60.0)), "storage": ((40.0, 1.0), (1.0, 60.0)), "gain_error": 100.0,
        "energy": 0.125,
    }  # fmt: skip
    return Observer(**{**fields, **changes})


def numbers(matrix: fmpq_mat) -> np.ndarray:
    rows, columns = matrix.nrows(), matrix.ncols()
    return np.array(
        [[float(matrix[i, j].p) / float(matrix[i, j].q) for j in range(columns)] for i in range(rows)]
    )


def reason(claim: Certificate, gradient_law: bool = True) -> str:
    try:
        checked.check_observer(claim, claim.observer, gradient_law)  # type: ignore[arg-type]
    except Refusal as refusal:
        return str(refusal)
    return ""


# The matrices -------------------------------------------------------------------------------------------------------
def test_the_error_s_drift_and_disturbance_are_the_plant_s() -> None:
    claim = plant()
    sensors = checked.matrix_of(observer().measured)
    np.testing.assert_array_equal(numbers(checked._error_drift(claim, [0, 1], sensors)), A)
    noise = [[checked._constant(claim, entry, "disturbance") for entry in claim.g1[i]] for i in (0, 1)]
    np.testing.assert_array_equal(numbers(checked.fmpq_mat(noise)), G)


def test_what_is_linear_in_the_states_adds_up_and_the_rest_has_to_be_known() -> None:
    claim, sensors = plant(), checked.matrix_of(observer().measured)

    def drift(i: int, *terms: Term) -> Certificate:
        rows = list(claim.drift)
        rows[i] = (*rows[i], *terms)
        return replace(claim, drift=tuple(rows))

    more = checked._error_drift(drift(0, term(0.25, 0, 1, 0)), [0, 1], sensors)
    np.testing.assert_array_equal(numbers(more), A + np.array([[0.0, 0.25], [0.0, 0.0]]))
    for harmless in (term(1.0, 2, 0, 0), term(1.0, 1, 0, 3), term(1.0, 1, 0, 0, function=0)):
        same = checked._error_drift(drift(1, harmless), [0, 1], sensors)
        np.testing.assert_array_equal(numbers(same), A)
    for hidden in (
        term(1.0, 0, 2, 0),
        term(1.0, 1, 1, 0),
        term(1.0, 0, 1, 0, function=0),
        term(1.0, 0, 1, 1),
    ):
        with refused_with(Refusal, "rate", "x", "nonlinear"):
            checked._error_drift(drift(0, hidden), [0, 1], sensors)
    unseen = replace(claim, functions=(Function("sin", (1.0, 0.5, 0.0)),))
    with refused_with(Refusal, "rate", "v", "nonlinear"):
        checked._error_drift(unseen, [0, 1], sensors)
    with refused_with(Refusal, "i", "computed"):
        checked._error_drift(drift(2, term(1.0, 0, 1, 0)), [0, 1], sensors)
    both = checked.matrix_of(((1.0, 1.0, 0.0),))  # then a function of x alone is not known
    with pytest.raises(Refusal):
        checked._error_drift(claim, [0, 1], both)


def test_slopes_of_the_law_are_those_of_the_gradient() -> None:
    """∂k̂/∂x_j at x = T z."""
    claim = plant()
    slopes = checked._law_slopes(claim, [0, 1])
    rng = np.random.default_rng(0)
    for z in rng.integers(-8, 9, (5, 3)) / 8.0:
        x = np.array(T) @ z
        hessian = W.copy()
        hessian[1, 1] += 0.6 * x[1] ** 2
        expected = (-np.linalg.inv(R2) @ G2.T @ hessian)[:, :2]
        found = np.zeros((2, 2))
        for i, j in product(range(2), repeat=2):
            for powers, value in slopes[i][j].to_dict().items():
                found[i, j] += (
                    float(value.p) / float(value.q) * np.prod(z ** np.array([int(e) for e in powers]))
                )
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_hull_is_the_reach_and_the_largest_error() -> None:
    claim, stated = plant(), observer()
    found = [
        float(v.p) / float(v.q)
        for v in checked._hull(claim, stated, [0, 1], checked.matrix_of(stated.storage))
    ]
    backwards = np.linalg.inv(np.array(T))[:, :2]
    within = np.linalg.inv(np.array(stated.storage))
    sizes = np.sqrt(2 * stated.energy * np.einsum("ij,jk,ik->i", backwards, within, backwards))
    assert np.array(found) == pytest.approx(0.75 + sizes, rel=3e-9)
    assert (np.array(found) >= 0.75 + sizes * (1 + 1e-12)).all()


# The two inequalities -------------------------------------------------------------------------------------------------
def rate(stated: Observer, gain_error: float) -> np.ndarray:
    closed = A - GAIN @ SENSOR
    x = np.array(stated.storage)
    return closed.T @ x + x @ closed + np.array(stated.weight) + x @ G @ G.T @ x / gain_error**2


def test_the_gain_of_errors_is_told_to_within_a_millionth() -> None:
    stated = observer()
    low, high = 1.0, 1000.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if np.linalg.eigvalsh(rate(stated, middle)).max() < 0 else (middle, high)
    assert 1.0 < low < 1000.0
    assert reason(plant(observer=observer(gain_error=low * (1 + 1e-6)))) == ""
    assert "gamma_e^2" in reason(plant(observer=observer(gain_error=low * (1 - 1e-6))))
    assert "no gain" in reason(plant(observer=observer(gain_error=0.0)))
    quiet = plant(g1=(((), ()), ((), ()), ((term(1.0, 0, 0, 0),), ())), observer=observer(gain_error=0.0))
    assert reason(quiet) == ""  # what drives the known state alone moves no error


def largest_slopes(energy: float) -> float:
    """The largest eigenvalue of JᵀR2J over the hull's box of slopes, found by corners."""
    claim, stated = plant(), observer(energy=energy)
    hull = [
        float(v.p) / float(v.q)
        for v in checked._hull(claim, stated, [0, 1], checked.matrix_of(stated.storage))
    ]
    bend = 0.6 * (0.5 * hull[1] + 0.5 * hull[2]) ** 2  # of V's second derivative in x2
    onto = -np.linalg.inv(R2) @ G2.T
    middle = (onto @ W)[:, :2]
    worst = 0.0
    for signs in product((-1, 1), repeat=2):
        j = middle.copy()
        j[:, 1] += np.array(signs) * np.abs(onto[:, 1]) * bend
        worst = max(worst, float(np.linalg.eigvalsh(j.T @ R2 @ j).max()))
    return worst


@pytest.mark.parametrize("energy", [0.125, 0.5])
def test_m_bounds_the_slopes_to_within_a_millionth(energy: float) -> None:
    stated, worst = observer(energy=energy), largest_slopes(energy)
    storage = checked.matrix_of(stated.storage)
    for share, holds in ((1 + 1e-6, True), (1 - 1e-6, False)):
        weight = checked.matrix_of(((share * worst, 0.0), (0.0, share * worst)))
        if holds:
            checked._check_slopes(plant(), stated, [0, 1], weight, storage)
        else:
            with refused_with(Refusal, "M", "slopes"):
                checked._check_slopes(plant(), stated, [0, 1], weight, storage)


def test_slopes_without_a_constant_lie_about_0() -> None:
    """V = ½x1² + 0.05 x2⁴ with the second input alone on x2: ∂k/∂x2 = −0.6 x2² for R2 = 1."""
    stated = observer()
    g2 = (((), ()), ((), (term(1.0, 0, 0, 0),)), ((), ()))
    claim = plant(value=(((2, 0, 0), 0.5), ((0, 4, 0), 0.05)), g2=g2, r2=((1.0, 0.0), (0.0, 1.0)))
    storage = checked.matrix_of(stated.storage)
    hull = [float(v.p) / float(v.q) for v in checked._hull(claim, stated, [0, 1], storage)]
    worst = (0.6 * (0.5 * hull[1] + 0.5 * hull[2]) ** 2) ** 2
    for share, holds in ((1 + 1e-6, True), (1 - 1e-6, False)):
        weight = checked.matrix_of(((1e-9, 0.0), (0.0, share * worst)))
        if holds:
            checked._check_slopes(claim, stated, [0, 1], weight, storage)
        else:
            with refused_with(Refusal, "M", "slopes"):
                checked._check_slopes(claim, stated, [0, 1], weight, storage)


def test_matrices_have_to_be_symmetric_and_definite_and_the_law_the_gradient_s() -> None:
    assert reason(plant()) == ""
    assert "budget" in reason(plant(), gradient_law=False)
    skewed = ((60.0, 1e-9), (0.0, 60.0))
    assert "symmetric" in reason(plant(observer=observer(weight=skewed)))
    assert "symmetric" in reason(plant(observer=observer(storage=((40.0, 1.0), (1.5, 60.0)))))
    assert unnamed(reason(plant(observer=observer(storage=((1.0, 2.0), (2.0, 1.0))))), "X", "definite") == []
    assert unnamed(reason(plant(observer=observer(weight=((1.0, 0.0), (0.0, 1.0))))), "M", "slopes") == []


def test_only_parameters_of_the_drift_and_of_the_disturbances_have_to_be_known() -> None:
    claim = plant()
    load = (term(1.0, 0, 0, 0, parameters=(("load", 1),)),)
    uncertain = replace(claim, g1=((load, claim.g1[0][1]), *claim.g1[1:]))
    assert "parameters" in reason(uncertain)
    uncertain = replace(
        claim, drift=((*claim.drift[0], term(1.0, 2, 0, 0, parameters=(("load", 1),))), *claim.drift[1:])
    )
    assert "parameters" in reason(uncertain)
    moving = replace(claim, g1=((claim.g1[0][0], (term(1.0, 1, 0, 0),)), *claim.g1[1:]))
    assert "disturbance matrix" in reason(moving)
    moving = replace(claim, g2=((claim.g2[0][0], (term(1.0, 1, 0, 0),)), *claim.g2[1:]))
    assert "input matrix" in reason(moving)


def test_too_many_slopes_are_refused_and_not_looked_at_in_part(monkeypatch: pytest.MonkeyPatch) -> None:
    stated = observer()
    monkeypatch.setattr(checked, "_MOST_CORNERS", 1)
    with refused_with(Refusal, "many", "slopes"):
        checked._check_slopes(
            plant(), stated, [0, 1], *(checked.matrix_of(m) for m in (stated.weight, stated.storage))
        )
    monkeypatch.setattr(checked, "_MOST_CORNERS", 2)
    assert reason(plant()) == ""


# Its words ----------------------------------------------------------------------------------------------------------
def test_the_theorem_has_the_gain_of_both_and_the_largest_error_of_each_state() -> None:
    """γ = 3 and γ_e = 4 make (γ² + γ_e²)^½ = 5."""
    claim = plant(
        gamma=3.0, observer=observer(gain_error=4.0, storage=((50.0, 0.0), (0.0, 12.5)), energy=0.25)
    )
    text = theorem_text(claim, Verification(True, gradient_law=True))
    assert "1/2 (5)^2 (energy of d)" in text
    assert "with gamma_e = 4," in text
    assert " x 0.0999999, v 0.199999" in text
    assert "of x, v, from y = (x) " in text
    decaying = theorem_text(replace(claim, decay=0.5), Verification(True, gradient_law=True))
    not_proved = [part.partition("Not proved")[2] for part in (text, decaying)]
    assert claim.decay == 0
    assert [unnamed(part, "decay rate") for part in not_proved] == [[], ["decay rate"]]


@pytest.mark.parametrize("name", ["measured", "gain", "weight", "storage"])
def test_matrices_of_other_shapes_are_refused_by_name(name: str) -> None:
    given = getattr(observer(), name)
    for wrong in ((*given, given[0]), tuple((*row, 0.0) for row in given)):
        with pytest.raises(InvalidInput):
            plant(observer=observer(**{name: wrong}))
