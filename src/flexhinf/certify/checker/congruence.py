"""Whether a symmetric polynomial matrix M(u, v) is positive definite for all −1 ≤ u, v ≤ 1.

A polynomial matrix X is sought with XᵀMX near the unit matrix, in doubles: where ‖XᵀMX − 1‖ < 1, M is positive
definite, whatever X is. X is a Taylor polynomial of the inverse of a triangular factor of M. It follows directions in
which M is large as they turn with u and v into those in which M is small; no fixed coordinates do.
"""

# Not checked strictly: parts of NumPy have no types.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from flint import arb_mat

from flexhinf.certify.checker.taylor_matrix import CONSTANT, Powers, TaylorMatrix, frobenius

#: Parts of M that bend, by which its first coordinates are ordered.
SQUARES: tuple[Powers, Powers] = (2, 0), (0, 2)


def near_unit(matrix: TaylorMatrix) -> bool:
    """Whether a symmetric matrix differs from the unit matrix by less than 1 at all u and v: it is then positive."""
    unit = TaylorMatrix.of(np.eye(matrix.constant.nrows(), dtype=int).tolist())
    return bool(frobenius((matrix - unit).range.entries()) < 1)


def towards_unit(matrix: TaylorMatrix, degree: int, by_size: bool) -> TaylorMatrix | None:
    """X of a degree with XᵀMX near the unit matrix; None where M is not positive in the middle.

    The coordinates of the triangular factor are in the order of M's eigenvalues in the middle, the largest first, or of
    how much M bends: a share u of another coordinate in one bends it by u².
    """
    middle = {powers: middles(part) for powers, part in matrix.terms.items() if sum(powers) <= degree}
    values, vectors = np.linalg.eigh(middle[CONSTANT])
    if not values[0] > 0.0:
        return None
    turn = (vectors / np.sqrt(values))[:, ::-1]
    bent = [turn.T @ middle[powers] @ turn for powers in SQUARES if powers in middle]
    if bent and not by_size:
        turn = turn @ np.linalg.eigh(sum(bent[1:], bent[0]))[1]
    own = {powers: turn.T @ part @ turn for powers, part in middle.items()}
    both, unit = any(l for _, l in own), np.eye(len(values))
    factor, inverse = {CONSTANT: unit}, {CONSTANT: unit}
    for k, l in _ascending(degree, both):
        left = own.get((k, l), 0.0 * unit).copy()
        for (i, j), part in factor.items():
            if (i, j) != CONSTANT and (k - i, l - j) in factor and (k - i, l - j) != CONSTANT:
                left -= part.T @ factor[k - i, l - j]
        factor[k, l] = np.triu(left) - 0.5 * np.diag(np.diag(left))
        inverse[k, l] = -sum(
            (part @ inverse[k - i, l - j] for (i, j), part in factor.items() if (k - i, l - j) in inverse),
            0.0 * unit,
        )
    return TaylorMatrix({powers: arb_mat((turn @ part).tolist()) for powers, part in inverse.items()})


def middles(matrix: arb_mat) -> np.ndarray:
    """The middles of the balls of a symmetric matrix."""
    middle = np.array([[float(entry.mid()) for entry in row] for row in matrix.tolist()])
    return 0.5 * (middle + middle.T)


def _ascending(degree: int, both: bool) -> Iterator[Powers]:
    """Powers of u, and of v, by what they are together, from 1 to a degree."""
    for total in range(1, degree + 1):
        for l in range(total + 1) if both else [0]:
            yield total - l, l
