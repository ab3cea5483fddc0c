"""What is taken for a covariance, and what is made of one whose last digits are missing."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.errors import InvalidInput
from flexhinf.estimation.diagnosis import CURES, EPS, Diagnosis
from flexhinf.scalars import cholesky
from flexhinf.validation import real_array, value_text

#: Eigenvalues of correlations closer to zero than this are zero: what rounding makes of a singular matrix.
SEMIDEFINITE = 1e-13

#: Eigenvalues of correlations below zero, and asymmetries, that seven printed digits or a computation in float32
#: explain; what is further off is a mistake.
ROUNDED = 1e-6


def covariance_matrix(value: ArrayLike | None, size: int, what: str, definite: bool = False) -> np.ndarray:
    """A covariance from a number, a diagonal or a matrix.

    Raises InvalidInput: if it is not symmetric positive semidefinite (positive definite if `definite`) of this size.
    """
    matrix, unit, _ = _scaled(value, size, what, 1e-9)
    smallest = float(np.linalg.eigvalsh(unit)[0])
    semidefinite = smallest >= -SEMIDEFINITE and _has_factor(matrix)
    if not semidefinite or (definite and smallest <= SEMIDEFINITE):
        _refuse(what, "positive definite" if definite else "positive semidefinite", smallest, matrix)
    return matrix


def clipped_covariance(value: ArrayLike | None, size: int, what: str) -> tuple[np.ndarray, Diagnosis | None]:
    """A covariance likewise; one whose digits are rounded becomes the nearest positive semidefinite matrix, and an
    entry that says so.

    Nearest is meant of the correlations, in the Frobenius norm: their negative eigenvalues become zero. One that has
    none beyond the rounding of floats stays as it is.

    Raises InvalidInput: where an eigenvalue of the correlations is below −1e-6, or the matrix is further than 1e-6 from
    a symmetric one: those are mistakes.
    """
    matrix, unit, asymmetry = _scaled(value, size, what, ROUNDED)
    deviations = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    values, vectors = np.linalg.eigh(unit)
    # A covariance with a signal whose variance is zero has no size that rounding could be compared with.
    comparable = not np.any(unit[deviations == 0.0])
    if np.any(np.diag(matrix) < 0.0) or values[0] < -(ROUNDED if comparable else SEMIDEFINITE):
        _refuse(what, "positive semidefinite", float(values[0]), matrix)
    tiny = 2.0 * size * EPS
    if values[0] >= -tiny and asymmetry <= tiny and _has_factor(matrix):
        return matrix, None
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    nearest = (nearest + nearest.T) / 2.0
    clipped = matrix
    for _ in range(100):  # what rounding leaves below zero
        left = float(np.linalg.eigvalsh(nearest)[0])
        clipped = np.tril(nearest * deviations[:, None] * deviations)
        clipped += np.tril(clipped, -1).T
        if left >= -tiny / 2.0 and _has_factor(clipped):
            break
        nearest = nearest + max(-left, tiny / 8.0) * np.eye(size)
    change = max(float(np.abs(nearest - unit).max()), asymmetry)
    about = (
        f"the {what} is taken for the nearest positive semidefinite matrix, of rank "
        f"{np.count_nonzero(values > tiny)} of {size}, at most {change:.2g} of its variances away: {CURES['clipped']}"
    )
    return clipped, Diagnosis("clipped", 0, about)


def is_singular(covariance: np.ndarray) -> bool:
    """Whether a covariance has correlations that are singular to rounding, or a variance that is zero."""
    return bool(np.linalg.eigvalsh(_correlations(covariance))[0] <= SEMIDEFINITE)


def _scaled(
    value: ArrayLike | None, size: int, what: str, tolerance: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """A symmetric matrix, its correlations, and how far it was from symmetric in parts of its variances."""
    array = real_array(value)
    if array.shape not in ((), (1,), (size,), (size, size)):
        raise InvalidInput(
            f"The {what} has the wrong size.",
            f"expected a number, {size} variances or a ({size}, {size}) matrix, got shape {array.shape}",
            "one variance per signal",
        )
    matrix = array if array.shape == (size, size) else np.diag(np.broadcast_to(array, (size,)))
    finite = bool(np.all(np.isfinite(matrix)))
    skew = np.abs(matrix - matrix.T) if finite else np.zeros_like(matrix)
    asymmetry = _weighted(skew, matrix)
    # Where a variance is zero, nothing else may be there.
    known = np.diag(matrix) != 0.0
    if not finite or np.any(asymmetry > tolerance) or np.any(skew[~np.outer(known, known)]):
        raise InvalidInput(
            f"The {what} is not a symmetric matrix of finite numbers.",
            f"expected a number, {size} variances or a ({size}, {size}) matrix, got {value_text(value)}",
            "variances: squares of standard deviations",
        )
    matrix = np.where(matrix == matrix.T, matrix, matrix / 2.0 + matrix.T / 2.0)  # their sum may be no float
    return matrix, _correlations(matrix), float(np.max(asymmetry, initial=0.0))


def _correlations(matrix: np.ndarray) -> np.ndarray:
    """A matrix in units of its deviations, so that signals of different scales are judged alike."""
    return _weighted(matrix, matrix)


def _weighted(array: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.abs(np.diag(matrix)))
    weight = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 1.0)
    return array * weight[:, None] * weight  # one after the other: the product of two weights may be no float


def _has_factor(matrix: np.ndarray) -> bool:
    with np.errstate(all="ignore"):
        return bool(np.all(np.isfinite(cholesky(matrix))))


def _refuse(what: str, kind: str, smallest: float, matrix: np.ndarray) -> None:
    raise InvalidInput(
        f"The {what} is not {kind}.",
        f"expected eigenvalues {'>' if kind == 'positive definite' else '>='} 0, got {smallest:.3g} for the smallest "
        f"one of the correlations in {matrix.tolist()}",
        "variances (squares of standard deviations), each positive",
    )
