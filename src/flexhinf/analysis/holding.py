"""The integrals with which a law holds a goal that is not its operating point."""

from __future__ import annotations

import numpy as np

from flexhinf.analysis.law_rows import LawRows
from flexhinf.errors import NumericalFailure

__all__ = ["holding_integrals"]

#: Where the integral of one joint is looked for, rad·s.
INTEGRALS = np.linspace(-30.0, 30.0, 601)

#: Steps from the operating point to the goal, Newton steps in each, and the size of the last one.
STEPS, ITERATIONS, LAST_STEP = 40, 12, 1e-9


def holding_integrals(law: LawRows, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """e (k,) with u* + k(x − x*, e) = u, for a law with one integral per input.

    With one joint a cubic law may have several such integrals: the one nearest to zero is taken, of all up to
    30 rad·s. With several joints they are followed from zero at the operating point.

    Parameters
    ----------
    law : LawRows
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
