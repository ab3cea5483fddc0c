"""Polynomials on the faces of cubes, z_f = ±ρ and the other z_j = ρ t_j, as tables for the kernel of `cells.py`.

On a face P = Σ_k ρᵏ P_k(t). A coefficient belongs to a degree k and a monomial tᵝ, |β| ≤ k. Monomials stand in groups
by |β|, those with even exponents only first; the degrees of one monomial stand together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from flexhinf.certify.inequality import Rational
from flexhinf.certify.problem_to_claim import nearest_double


@dataclass(frozen=True)
class Group:
    """The monomials of one |β| of a polynomial.

    Attributes
    ----------
    first, count, even : int
        Number of the first monomial, how many, and how many have even exponents only.
    degrees : tuple of int
        Those degrees k ≥ |β| that the polynomial has.
    offset : int
        Place of the first coefficient; coefficient (monomial, degree) stands at offset + monomial · degrees + degree.
    """

    size: int
    first: int
    count: int
    even: int
    degrees: tuple[int, ...]
    offset: int


@cache
def monomials_of(directions: int, highest: int) -> tuple[tuple[int, ...], ...]:
    """Exponents of the monomials in t through degree `highest`."""
    every: list[tuple[int, ...]] = [()]
    for _ in range(directions):
        every = [(*head, e) for head in every for e in range(highest + 1 - sum(head))]
    return tuple(sorted(every, key=lambda beta: (sum(beta), any(e % 2 for e in beta), beta)))


class Layout:
    """Where the coefficients of a polynomial with these degrees stand.

    Parameters
    ----------
    directions : int
        Number of the t_j, n − 1.
    degrees : sequence of int
        Degrees k of the polynomial in z, ascending.
    """

    def __init__(self, directions: int, degrees: Sequence[int]) -> None:
        self.directions, self.degrees = directions, tuple(degrees)
        self.monomials = monomials_of(directions, max(self.degrees))
        sizes = np.array([sum(beta) for beta in self.monomials])
        even = np.array([not any(e % 2 for e in beta) for beta in self.monomials])
        self.groups: list[Group] = []
        self.place: dict[tuple[int, tuple[int, ...]], int] = {}
        offset = 0
        for size in range(max(self.degrees) + 1):
            chosen = np.flatnonzero(sizes == size)
            if not len(chosen):
                continue
            kept = tuple(k for k in self.degrees if k >= size)
            first, count = int(chosen[0]), len(chosen)
            self.groups.append(Group(size, first, count, int(even[chosen].sum()), kept, offset))
            for b in chosen:
                for i, k in enumerate(kept):
                    self.place[k, self.monomials[b]] = offset + (int(b) - first) * len(kept) + i
            offset += count * len(kept)
        self.count = offset


def shift_lines(layout: Layout) -> list[tuple[int, int, np.ndarray]]:
    """Lines of coefficients along which t_j is shifted, by degree, variable and length.

    Returns
    -------
    list of (variable, length, places (lines, length + 1))
    """
    result = []
    for k in layout.degrees:
        for j in range(layout.directions):
            by_length: dict[int, list[list[int]]] = {}
            for others in monomials_of(layout.directions - 1, k):
                length = k - sum(others)
                betas = [(*others[:j], p, *others[j:]) for p in range(length + 1)]
                if length > 0:
                    by_length.setdefault(length, []).append([layout.place[k, beta] for beta in betas])
            result += [(j, length, np.array(lines)) for length, lines in sorted(by_length.items())]
    return result


def face_table(terms: Rational, layout: Layout, faces: Sequence[tuple[int, int]]) -> np.ndarray:
    """Coefficients (faces, count) of a polynomial on faces (variable, sign), rounded to doubles."""
    table = np.zeros((len(faces), layout.count))
    values = {key: nearest_double(value) for key, value in terms.items() if sum(key) in layout.degrees}
    for row, (variable, sign) in zip(table, faces):
        for key, value in values.items():
            beta = key[:variable] + key[variable + 1 :]
            row[layout.place[sum(key), beta]] = value if sign > 0 or key[variable] % 2 == 0 else -value
    return table


def monomial_links(monomials: Sequence[tuple[int, ...]], directions: int) -> np.ndarray:
    """For each monomial another one times one variable that it is; then which variables it has, as doubles."""
    place = {beta: b for b, beta in enumerate(monomials)}
    links = np.zeros((len(monomials), 2), dtype=np.int64)
    for b, beta in enumerate(monomials[1:], 1):
        j = next(j for j, e in enumerate(beta) if e)
        links[b] = place[(*beta[:j], beta[j] - 1, *beta[j + 1 :])], j
    masks = (np.array(monomials).reshape(len(monomials), directions) > 0).astype(float)
    return np.concatenate([links.ravel(), masks.ravel().view(np.int64)])


def degrees_of(terms: Rational) -> tuple[int, ...]:
    """The degrees of a polynomial's terms, ascending."""
    return tuple(sorted({sum(key) for key in terms}))


def sums_on_faces(table: np.ndarray, layout: Layout) -> np.ndarray:
    """Sums of absolute coefficients (faces, highest degree + 1)."""
    sums = np.zeros((len(table), layout.degrees[-1] + 1))
    for group in layout.groups:
        part = table[:, group.offset : group.offset + group.count * len(group.degrees)]
        sums[:, list(group.degrees)] += np.abs(part).reshape(len(table), group.count, -1).sum(1)
    return sums * (1 + 1e-12)


def sums_by_degree(terms: Rational, highest: int) -> np.ndarray:
    """Sums of absolute coefficients by degree, (highest + 1,)."""
    sums = np.zeros(highest + 1)
    for key, value in terms.items():
        sums[sum(key)] += abs(nearest_double(value))
    return sums * (1 + 1e-12)


LANES = 8
LOW = 3  # monomials through this degree are kept as polynomials in ρ; the others only bounded

#: What the kernel's argument points to, in this order: 64-bit words.
POINTERS = (
    "first", "last", "faces", "inputs", "outputs", "work", "level", "value_table", "quotient_table", "table",
    "segments", "lines", "signs",
)  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """Sizes that the text depends on.

    Attributes
    ----------
    value : Layout
        Of V.
    quotients : tuple of Layout
        Of the factors Q_j.
    whole : Layout
        Of r, all quotients multiplied out.
    terms : tuple of tuple of int
        For every quotient and power of ℓ, the degrees of Q_j ℓᵐ.
    """

    states: int
    value: Layout
    quotients: tuple[Layout, ...]
    whole: Layout
    terms: tuple[tuple[int, ...], ...]

    @property
    def directions(self) -> int:
        """Number of the t_j."""
        return self.states - 1

    @property
    def longest(self) -> Layout:
        """The layout with the most monomials."""
        return max((self.whole, self.value), key=lambda layout: layout.degrees[-1])

    @property
    def table_size(self) -> int:
        """Doubles of r's table for one face."""
        return sum(
            group.count * sum(1 + sum(k in degrees for degrees in self.terms) for k in group.degrees)
            for group in self.whole.groups
        )

    @property
    def input_rows(self) -> dict[str, int]:
        """First row of each input of a group of cells, and their number."""
        d, j = self.directions, len(self.quotients)
        names = ["t"] * d + ["h"] * d + ["inner", "outer", "middle", "half"]
        names += ["value_rounding", "growth_rounding", "rounding"] + ["error"] * j + ["s"] * len(self.terms)
        rows = {name: names.index(name) for name in dict.fromkeys(names)}
        return rows | {"count": len(names)}

    @property
    def output_rows(self) -> dict[str, int]:
        """Row of each result."""
        names = (
            "least_value", "growth", "upper", "upper_inside", "centre", "allowance", "value", "value_range",
            "growth_at_centre", "score",
        )  # fmt: skip
        return {name: i for i, name in enumerate(names)} | {"count": len(names) - 1 + self.states}

    def work_places(self) -> dict[str, int]:
        """Places in the work buffer, in vectors."""
        highest = self.longest.degrees[-1]
        monomials = len(self.longest.monomials)
        low = sum(group.count for group in self.whole.groups if group.size <= LOW)
        sizes = {
            "value": self.value.count, "quotient": max((q.count for q in self.quotients), default=0),
            "whole": self.whole.count, "scale": monomials, "weight": monomials,
            "low": low * (highest + 1), "low_value": low * (highest + 1), "powers": 6 * (highest + 3),
            "slopes": self.states,
        }  # fmt: skip
        places, total = {}, 0
        for name, size in sizes.items():
            places[name] = total
            total += size
        return places | {"count": total}


def aligned(count: int) -> np.ndarray:
    """Zeros that start at a multiple of 64 bytes."""
    raw = np.zeros(count + 8)
    offset = (-raw.ctypes.data % 64) // 8
    return raw[offset : offset + count]
