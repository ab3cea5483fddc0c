"""Eigenvalues and eigenvectors of a symmetric matrix on any element, by a fixed number of operations; damping of poles.

Jacobi's method: a rotation in the plane of two rows makes their common entry zero, and a sweep rotates in every plane
once [golub2013]. Sweeps converge quadratically, from clustered eigenvalues too. The planes of a round share no row, so
a round is n/2 rotations; then the rows change their seats as players of a round-robin tournament do [brent1985]. So all
rounds are the same code, which a program runs in a loop.
"""

from __future__ import annotations

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.scalars.run import Run
from flexhinf.scalars.symbol import absolute, where

#: Smaller damping ratios are rounding of the eigenvalues and count as 0: the error bound ε‖A‖κ/|λ| of the solver
#: (κ: condition of the eigenvalue) is at most 8e-10 over the vibrations of all robots that come with flexhinf.
UNDAMPED = 1e-9


def damping_ratio(poles: np.ndarray) -> np.ndarray:
    """−Re s/|s| of poles s (K,), 1/s; 0 at s = 0, and where the ratio is smaller than the eigenvalues' rounding."""
    sizes = np.abs(poles)
    ratios = np.divide(-np.real(poles), sizes, out=np.zeros(np.shape(sizes)), where=sizes != 0.0)
    return np.where(np.abs(ratios) < UNDAMPED, 0.0, ratios)


def eigensystem(matrix: Elements, run: Run) -> tuple[Elements, Elements]:
    """V (n, n) and λ (n,), in no order, with matrix = V diag(λ) Vᵀ and VᵀV = 1.

    Up to n = 8, measured with clusters and with eigenvalues from 1 to 1e4 (tests/scalars/test_spectral.py): VᵀV to
    1e-14; relative to the largest eigenvalue, λ to 1e-14 and V diag(λ) Vᵀ to 1e-9.

    `matrix`: symmetric (n, n), of any element; of numbers also (N, n, n). `run`: how pieces are called, see
    `flexhinf.codegen.compose`.
    """
    n = matrix.shape[-1]
    sweeps = n - 1 if n < 3 else 3 + (n + 1) // 2
    rounds = sweeps * (n - 1 + n % 2)
    turned, vectors = run.call(_with_identity, matrix)

    def jacobi_round(*pair: Elements) -> tuple[Elements, Elements]:
        return run.call(_round, *pair)

    turned, vectors = run.repeat(rounds, jacobi_round, turned, vectors)
    return vectors, run.call(_diagonal, turned)


def _with_identity(matrix: Elements) -> tuple[Elements, Elements]:
    return matrix, np.broadcast_to(np.eye(matrix.shape[-1]), matrix.shape)


def _diagonal(matrix: Elements) -> Elements:
    return np.stack([matrix[..., i, i][()] for i in range(matrix.shape[-1])], axis=-1)


def _round(matrix: Elements, vectors: Elements) -> tuple[Elements, Elements]:
    """Rotations of the pairs of neighbouring seats, and the next seats; of an odd number the first seat rests."""
    n = matrix.shape[-1]
    rows = [[matrix[..., i, j][()] for j in range(n)] for i in range(n)]
    columns = [[vectors[..., i, j][()] for i in range(n)] for j in range(n)]
    for p in range(n % 2, n, 2):
        _rotate(rows, columns, p, p + 1)
    # Seats 2i and 2i + 1 face each other; of an odd number seat 0, which never moves, is empty.
    last = n - 1 + n % 2
    before = [0, *(1 if s == 2 else s - 2 if s % 2 == 0 else s + 2 for s in range(1, last)), max(last - 1, 1)]
    seats = [s - n % 2 for s in before[n % 2 :]]
    return (
        _array([[rows[i][j] for j in seats] for i in seats]),
        _array([[columns[j][i] for j in seats] for i in range(n)]),
    )


def _array(rows: list[list[Elements]]) -> Elements:
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _rotate(rows: list[list[Elements]], columns: list[list[Elements]], p: int, q: int) -> None:
    """The rotation by at most 45° that makes entry (p, q) zero, in place."""
    apart, twice = rows[q][q] - rows[p][p], 2.0 * rows[p][q]
    length = absolute(apart) + np.sqrt(apart * apart + twice * twice)
    tangent = where(apart < 0.0, -twice, twice) / where(length == 0.0, 1.0, length)
    cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
    sine, moved = tangent * cosine, 0.5 * tangent * twice
    rows[p][p], rows[q][q], rows[p][q] = rows[p][p] - moved, rows[q][q] + moved, 0.0 * moved
    rows[q][p] = rows[p][q]
    for k in range(len(rows)):
        if k not in (p, q):
            a, b = rows[p][k], rows[q][k]
            rows[p][k] = rows[k][p] = cosine * a - sine * b
            rows[q][k] = rows[k][q] = sine * a + cosine * b
    pairs = [(cosine * a - sine * b, sine * a + cosine * b) for a, b in zip(columns[p], columns[q])]
    columns[p], columns[q] = (list(column) for column in zip(*pairs))
