"""Steps of dense algebra: sums of outer products, polynomials, Cholesky factors."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flexhinf.codegen.memory import Slice, is_integer, overlap
from flexhinf.errors import InvalidInput
from flexhinf.polynomial import basis


@dataclass(frozen=True)
class OuterSum:
    """Σ_k weights[k] · left[k, :]ᵀ right[k, :] + plus, of matrices in C order.

    The sum runs in eight parts, k modulo 8, which are added in pairs at the end: the same order for any number
    of lanes.

    Parameters
    ----------
    left, right : Slice
        (N, r) and (N, c).
    target : Slice
        (r, c), not in the memory of left, right and weights.
    count : int
        N.
    weights : Slice or None
        (N,); ones by default.
    plus : Slice or None
        (r, c); zero by default.
    symmetric : bool
        Left and right are the same: half of the sums are computed, and the result is exactly symmetric if
        `plus` is.

    Raises
    ------
    InvalidInput
        Sizes that do not fit, or a target that overlaps what is read.
    """

    left: Slice
    right: Slice
    target: Slice
    count: int
    weights: Slice | None = None
    plus: Slice | None = None
    symmetric: bool = False

    def __post_init__(self) -> None:
        count = self.count if is_integer(self.count) and self.count > 0 else 0
        rows, columns = self.shape if count else (0, 0)
        fits = rows * columns == self.target.size and rows * count == self.left.size
        fits = fits and columns * count == self.right.size
        fits = fits and (self.weights is None or self.weights.size == count)
        fits = fits and (self.plus is None or self.plus.size == self.target.size)
        fits = fits and (not self.symmetric or self.left == self.right)
        read = [piece for piece in (self.left, self.right, self.weights) if piece is not None]
        if not fits or any(overlap(piece, self.target) for piece in read):
            raise InvalidInput(
                "A sum of outer products joins slices that do not fit.",
                f"expected N·r, N·c, r·c and N elements apart from the target, got {self}",
                "one row of left and right per weight; left equal to right if symmetric",
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(r, c)."""
        return self.left.size // self.count, self.right.size // self.count


@dataclass(frozen=True)
class Polynomial:
    """Polynomials of several variables in nested form, all of the same monomials.

    Σ_i x_i (c_i + Σ_j≥i x_j (c_ij + Σ_k≥j x_k c_ijk)) and so on: every sum begins with its coefficient, and grows in
    the order of its variables by one fused multiply-add each; the same bits for any number of lanes. Rows are read in
    their order within each degree.

    Parameters
    ----------
    point : Slice
        x, (n,).
    table : Slice
        (Nmon, columns): a row for each monomial in the order of `flexhinf.polynomial.basis`, degree after degree; its
        first numbers are coefficients of the values, the others are padding.
    target : Slice
        The values, not in the memory of point and table.
    degrees : tuple of int
        Ascending.

    Raises
    ------
    InvalidInput
        Sizes that do not fit, degrees that do not ascend, or a target that overlaps what is read.
    """

    point: Slice
    table: Slice
    target: Slice
    degrees: tuple[int, ...]

    def __post_init__(self) -> None:
        degrees = self.degrees
        known = bool(degrees) and all(is_integer(k) and k >= 0 for k in degrees)
        fits = known and list(degrees) == sorted(set(degrees)) and not self.table.size % self.rows
        fits = fits and self.columns >= self.target.size
        if not fits or any(overlap(piece, self.target) for piece in (self.point, self.table)):
            raise InvalidInput(
                "Polynomials join slices that do not fit.",
                f"expected ascending degrees, a row for each monomial, a column for each value, got {self}",
                "the rows of flexhinf.polynomial.basis, and a target apart from what is read",
            )

    @property
    def rows(self) -> int:
        """Monomials."""
        return sum(basis.count(self.point.size, k) for k in self.degrees)

    @property
    def columns(self) -> int:
        """Numbers of a row."""
        return self.table.size // self.rows


@dataclass(frozen=True)
class Cholesky:
    """The Cholesky factor of a symmetric positive semidefinite matrix, as `flexhinf.scalars.cholesky`.

    Parameters
    ----------
    source : Slice
        (n, n), symmetric.
    target : Slice
        Lᵀ in C order, that is L column by column; apart from the source.

    Raises
    ------
    InvalidInput
        Slices that are not square and of one size, or overlap.
    """

    source: Slice
    target: Slice

    def __post_init__(self) -> None:
        square = self.order**2 == self.source.size == self.target.size
        if not square or overlap(self.source, self.target):
            raise InvalidInput(
                "A Cholesky factor does not fit its matrix.",
                f"expected two slices of n² elements apart from each other, got {self.source} and {self.target}",
                "square matrices",
            )

    @property
    def order(self) -> int:
        """n."""
        return math.isqrt(self.source.size)
