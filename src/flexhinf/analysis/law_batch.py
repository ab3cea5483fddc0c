"""A law and its slope at many points.

The integrals with which a law holds a goal that is not its operating point.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis.batch import Rows
from flexhinf.errors import NumericalFailure
from flexhinf.plant import Law
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import gradient, monomials
from flexhinf.scalars import trace


class LawRows:
    """k(x) and ∂k/∂x at deviations (N, n): a polynomial's from its table, another law's by tangents."""

    def __init__(self, law: Law) -> None:
        self.law = law

    @cached_property
    def _polynomial(self) -> tuple[dict[int, np.ndarray], dict[int, np.ndarray]] | None:
        """By degree: coefficients (m, Nmon), and those of all derivatives (m, n, Nmon of one degree less)."""
        table = self.law.law_table
        if table is None:
            return None
        n, parts, slopes, start = table.n, {}, {}, 0
        for k in table.degrees:
            parts[k] = table.coefficients[:, start : start + basis.count(n, k)]
            start += basis.count(n, k)
            if k:
                entries = parts[k] / basis.multiplicity(n, k)
                slopes[k - 1] = np.array([gradient(row, n, k).T for row in entries])
        return parts, slopes

    @cached_property
    def _rows(self) -> Rows:
        law = self.law
        n, size = len(law.state_names), np.size(law.law_data)
        key = ("law", type(law), law.law_key, n, size)
        return Rows(key, lambda: trace(law.evaluate_law, n, size, name="law"))

    @property
    def placed(self) -> bool:
        """Whether the law depends on the reference that it acts about, see `flexhinf.plant.Law`."""
        return self.law.depends_on_reference

    @cached_property
    def _rows_about(self) -> Rows:
        law = self.law
        n, m, size = len(law.state_names), len(law.input_names), np.size(law.law_data)
        states = len(law.plant_states)

        def about(moving: Any, held: Any) -> Any:
            return law.evaluate_about(moving[:n], moving[n : n + states], moving[n + states :], held)

        key = ("law about", type(law), law.law_key, tuple(law.state_names), m, size)
        return Rows(key, lambda: trace(about, n + states + m, size, name="law_about"))

    def about(self, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of a placed law: values (N, m) and slopes (N, m, w) at rows (N, w) of deviation, reference and its input."""
        return self._rows_about(moving, np.ravel(self.law.law_data))

    def __call__(self, deviation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (N, m) and slopes (N, m, n) at deviations (N, n)."""
        if self._polynomial is None:
            return self._rows(deviation, np.ravel(self.law.law_data))
        parts, slopes = self._polynomial
        (count, n), m = deviation.shape, len(self.law.input_names)
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # Newton may stray; what is not finite is judged there
            powers = monomials(deviation, {*parts, *slopes})
            value, slope = np.zeros((count, m)), np.zeros((count, m * n))
            for k, part in parts.items():
                value += powers[k] @ part.T
            for k, part in slopes.items():
                slope += powers[k] @ part.reshape(m * n, -1).T
        return value, slope.reshape(count, m, n)


#: Where the integral of one joint is looked for, rad·s.
INTEGRALS = np.linspace(-30.0, 30.0, 601)

#: Steps from the operating point to the goal, Newton steps in each, and the size of the last one.
STEPS, ITERATIONS, LAST_STEP = 40, 12, 1e-9


def equilibrium_integrals(law: LawRows, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """e (k,) with u* + k(x − x*, e) = u, for a law with one integral per input.

    With one joint a cubic law may have several such integrals: the one nearest to zero is taken, of all up to
    30 rad·s. With several joints they are followed from zero at the operating point.

    Parameters
    ----------
    x, u : (n,) and (m,) arrays
        Rest of the law's plant at the goal, integrals left out.

    Raises
    ------
    NumericalFailure
        If there are none.
    """
    point, rest = np.asarray(law.law.operating_point), np.asarray(law.law.operating_input)
    n, k = len(x), len(point) - len(x)
    away, wanted = x - point[:n], u - rest
    if not k or (np.array_equal(away, np.zeros(n)) and np.array_equal(wanted, np.zeros(len(u)))):
        return point[n:].copy()
    found = _scanned(law, away, wanted, point[n:]) if k == len(u) == 1 else _followed(law, away, wanted, k)
    if found is None:
        raise NumericalFailure(
            "The law does not hold the robot at the goal.",
            f"no integrals give the input {np.array2string(u, precision=6)} at {np.array2string(x, precision=6)}",
            "another degree, or a law made for this goal",
        )
    return point[n:] + found


def _scanned(law: LawRows, away: np.ndarray, wanted: np.ndarray, offset: np.ndarray) -> np.ndarray | None:
    integrals = INTEGRALS - offset
    points = np.column_stack([np.tile(away, (len(integrals), 1)), integrals])
    excess = np.sign(law(points)[0][:, 0] - wanted[0])
    crossings = np.flatnonzero(excess[1:] != excess[:-1])
    if not len(crossings):
        return None
    return integrals[[crossings[np.argmin(np.abs(INTEGRALS[crossings]))]]]


def _followed(law: LawRows, away: np.ndarray, wanted: np.ndarray, k: int) -> np.ndarray | None:
    integrals = np.zeros(k)
    for share in np.linspace(0.0, 1.0, STEPS + 1)[1:]:
        for _ in range(ITERATIONS):
            value, slope = law(np.concatenate([share * away, integrals])[None, :])
            gap, by_integrals = share * wanted - value[0], slope[0][:, len(away) :]
            if not (np.all(np.isfinite(gap)) and np.all(np.isfinite(by_integrals))):
                return None
            move = np.linalg.lstsq(by_integrals, gap, rcond=None)[0]
            integrals = integrals + move
            if np.abs(move).max() <= LAST_STEP * max(1.0, np.abs(integrals).max()):
                break
        else:
            return None
    return integrals
