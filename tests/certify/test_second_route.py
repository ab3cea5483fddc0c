"""The plain proof of one cell, in rationals and balls, refuses each cell in which a point speaks against it."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx
from tests.certify.definition import in_doubles
from tests.certify.test_checker import LEVEL, V_4, upright

from flexhinf.certify.checker import second_route
from flexhinf.certify.checker.bounds import Proof
from flexhinf.certify.checker.second_route import ConfirmedCell, cell_ended, cell_is_proved

CLAIM = upright(V_4, LEVEL)


def crossing(direction: np.ndarray, residual: bool, wanted: float) -> float:
    """The first radius at which V, or r/ρ², exceeds a value; nan if none does."""
    low, high = 0.5, 14.0
    for _ in range(4):
        radii = np.linspace(low, high, 100)
        at = in_doubles(CLAIM, radii[:, None] * direction @ np.array(CLAIM.coordinates).T, np.zeros((100, 0)))
        above = (at.residual(at.slope()) / radii**2 if residual else at.value()) > wanted
        if not above.any() or above[0]:
            return float("nan")
        low, high = radii[(k := int(np.argmax(above))) - 1], radii[k]
    return float(high)


@cache
def wrong_cells() -> tuple[tuple[ConfirmedCell, bool], ...]:
    """Cells with a point where r > 0, or (True) with one where V < c at the inner end; each only just."""
    rng, found = np.random.default_rng(5), []
    for _ in range(60):
        face, t, h = (int(rng.integers(2)), 1), float(rng.uniform(-0.9, 0.9)), 2.0 ** -int(rng.integers(3, 9))
        worst = np.insert(np.array([t + h * float(rng.choice([-1.0, 1.0]))]), face[0], 1.0)
        radius = crossing(worst, True, 0.0)
        if np.isfinite(radius):
            end = radius * (1 + 1e-6)
            found.append(
                (
                    ConfirmedCell(face, (t,), (h,), end * (1 - 2.0 ** -int(rng.integers(2, 8))), end, 0.0),
                    False,
                )
            )
        radius = crossing(worst, False, CLAIM.level)
        if np.isfinite(radius):
            found.append((ConfirmedCell(face, (t,), (h,), radius * (1 - 1e-5), 2 * radius, 0.0), True))
    return tuple(found)


def accepted() -> tuple[int, int]:
    """How many of the cells with r > 0, and of those with V < c, are accepted."""
    proof, counts = Proof(CLAIM), [0, 0]
    with ctx.workprec(128):
        for cell, ended in wrong_cells():
            counts[ended] += cell_ended(proof, cell) if ended else cell_is_proved(proof, cell, 0)
    return counts[0], counts[1]


def test_no_cell_with_a_point_against_it_is_accepted() -> None:
    kinds = [ended for _, ended in wrong_cells()]
    assert min(kinds.count(False), kinds.count(True)) > 10
    assert accepted() == (0, 0)


_PLACES, _TAYLOR = second_route._places, second_route._taylor


def _at_zero(polynomial: Any) -> Any:
    n = polynomial.context().nvars()
    return polynomial.to_dict().get((0,) * n, 0)


def _constant(polynomial: Any, n: int) -> arb:
    return arb(_at_zero(polynomial))


MUTATIONS: dict[str, tuple[str, Any]] = {
    "the centre says all": ("_upper", _constant),
    "half of the cell": ("_places", lambda *a: [(one + _at_zero(one)) / 2 for one in _PLACES(*a)]),
    "the sine's slope alone": ("_taylor", lambda *a: (_TAYLOR(*a)[0][:1], arb(0))),
    "no sizes": ("_magnitude", lambda polynomial: arb(0)),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_each_part_of_the_plain_proof_is_needed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(second_route, *MUTATIONS[name])
    assert sum(accepted()) > 0
