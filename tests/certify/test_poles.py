"""Where a function has a pole there is no bound: every enclosure of certify says so, and none drops the nan."""

from __future__ import annotations

import itertools
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from flint import arb, arb_series, ctx, fmpq
from tests.certify.test_checker import V_4, upright

from flexhinf.certify.checker import bounds as quotient_file, second_route
from flexhinf.certify.checker.bounds import ORDER, Proof, Quotient
from flexhinf.certify.checker.residual import quotient_range
from flexhinf.certify.checker.second_route import ConfirmedCell, cell_is_proved
from flexhinf.certify.claim import Function
from flexhinf.certify.inequality import QuotientTable

quadratic = import_module("flexhinf.certify.checker.residual")

LOG = Function("log", (1.0,), 1.0)  # log(1 + s): its pole is at s = −1
SERIES = quotient_file.series_of


def _with_poles(name: str, argument: arb_series) -> arb_series:
    """tan and 1/x as a function that a later file may add; the latter is nan where its argument may be 0."""
    if name == "tan":
        return argument.tan()
    if name == "one over":
        undefined = arb_series([arb("nan")] * argument.prec, prec=argument.prec)
        return undefined if argument[0].contains(0) else 1 / argument
    return SERIES(name, argument)


def _function(name: str, offset: float) -> Function:
    made = Function("sin", (1.0,), offset)
    object.__setattr__(made, "name", name)
    return made


POLES = {
    "log": (LOG, -1.0),
    "tan": (_function("tan", 1.0), float(np.pi / 2 - 1.0)),
    "1/x": (_function("one over", -0.5), 0.5),
}


@pytest.fixture(autouse=True)
def poles(monkeypatch: pytest.MonkeyPatch) -> Any:
    for place in (second_route, quotient_file):
        monkeypatch.setattr(place, "series_of", _with_poles)
    monkeypatch.setattr(quadratic, "series_of", _with_poles)
    with ctx.workprec(128):
        yield


@pytest.mark.parametrize("name", POLES)
def test_the_second_route_has_no_bound_across_a_pole(name: str) -> None:
    function, pole = POLES[name]
    centres = [0.0, 1e-8, 0.5 * pole, 0.999 * pole, pole, 1.001 * pole, 2.0 * pole, -0.3 * pole]
    for center, radius in itertools.product(centres, (1e-6, 0.01, 0.6, 3.0)):
        _, rest = second_route._taylor(function, fmpq(*center.as_integer_ratio()), arb(radius))
        reached = min(0.0, center - radius) <= pole <= max(0.0, center + radius)
        if reached:
            assert not rest.is_finite(), (center, radius)
        elif abs(pole - center) > 2.0 * radius and abs(pole - center) > 0.2:
            assert rest.is_finite(), (center, radius)


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("name", POLES)
@pytest.mark.parametrize("multiplier", [0.0, 1e6])
def test_no_cell_with_a_pole_is_held(name: str, multiplier: float) -> None:
    """With V ≤ c far away (multiplier · (c − V) ≪ 0) everything but the remainder speaks for the cell."""
    function, pole = POLES[name]
    claim = upright(V_4, 1e-6)
    proof = Proof(claim)
    object.__setattr__(claim, "functions", (function,))
    column = np.abs(np.array(claim.coordinates)[0])
    for face, sign, t in itertools.product((0, 1), (1, -1), (-0.5, 0.0, 0.7)):
        z = np.insert(np.array([t]), face, float(sign))
        along = float(np.array(claim.coordinates)[0] @ z)
        if abs(along) < 0.1 * column.max() or along * pole < 0:
            continue
        at = pole / along  # radius at which s is the pole
        for begin, end in ((0.0, 1.2 * at), (0.9 * at, 1.1 * at), (1.5 * at, 2.0 * at)):
            cell = ConfirmedCell((face, sign), (t,), (2.0**-6,), begin, end, multiplier)
            assert not cell_is_proved(proof, cell, 0), cell


def test_tables_and_ranges_end_at_a_pole() -> None:
    low = np.linspace(-1.5, -0.7, 81)
    high = low + 0.05
    for rest in (QuotientTable(LOG, 2.0, 4).enclose(low, high)[1], Quotient(LOG, 2.0).at(low, high)[1]):
        assert np.isinf(rest[low <= -1.0]).all()
        assert not np.isnan(rest).any()
    for function, pole in POLES.values():
        assert quotient_range(function, fmpq(*float(pole).as_integer_ratio()) ** 2) is None
        assert quotient_range(function, fmpq(*float(pole / 2).as_integer_ratio()) ** 2) is not None


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "tanh", "arctan", "log"])
def test_what_is_not_defined_is_nan_in_every_coefficient(name: str) -> None:
    """A series that is nan at its constant alone would lose its derivative."""
    for argument in (arb("nan"), arb(0, float("inf")), arb(0, 1e300), arb(500, 499), arb(-3, 10)):
        series = SERIES(name, arb_series([argument, 1], prec=ORDER + 3))
        found = [series[k] for k in range(ORDER + 3)]
        finite = [one.is_finite() for one in found]
        assert all(finite) or not any(finite), (argument, found)
    assert not SERIES("tanh", arb_series([arb(500, 499), 1], prec=3))[2].is_finite()
