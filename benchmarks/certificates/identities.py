"""Polynomial identities with sums of squares, as semidefinite programs, and the exact check of what a solver returns.

An identity states p₀ + Σ_i y_i p_i = Σ_k w_k m_kᵀQ_k m_k with given polynomials p and w (w_0 = 1), vectors of monomials
m_k, free numbers y and Q_k ⪰ 0. All polynomials are exact; the solver sees doubles.

The check [peyrl2008]: y and the Q_k, k > 0, are taken as the rationals that their doubles are; what is
left of the identity goes into the entries of Q_0 that can take it, so that it holds exactly; then Q_k ≻ 0 is shown by
Cholesky's method in balls of 128 bits.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from flint import arb, ctx, fmpq, fmpq_mpoly
from scipy.spatial import ConvexHull

from benchmarks import peers
from flexhinf.certify.problem_to_claim import nearest_double, rational, terms_of

__all__ = ["Identity", "Program", "Solver", "Square", "monomials", "newton_basis", "proved"]

#: The environment of cvxpy and Clarabel, which are in no lock of ours: `make peers`.

Exponents = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Square:
    """w mᵀQm with Q ⪰ 0."""

    weight: fmpq_mpoly
    basis: list[Exponents]


@dataclass(frozen=True, eq=False)
class Identity:
    """constant + Σ y_i slopes_i = Σ squares; the first square has the weight one and takes the rounding."""

    constant: fmpq_mpoly
    squares: list[Square]
    slopes: dict[str, fmpq_mpoly] = field(default_factory=dict)

    def parts(self) -> list[Square]:
        """The squares, each once for monomials of even and once for those of odd degree where all else is even."""
        polynomials = [self.constant, *self.slopes.values(), *(square.weight for square in self.squares)]
        if any(sum(key) % 2 for polynomial in polynomials for key in terms_of(polynomial)):
            return self.squares
        split = [
            Square(square.weight, [key for key in square.basis if sum(key) % 2 == parity])
            for square in self.squares
            for parity in (1, 0)
        ]
        return [square for square in split if square.basis]


@dataclass(frozen=True, eq=False)
class Program:
    """Identities that share free numbers; the sum of `objective` times these is made small."""

    identities: list[Identity]
    objective: dict[str, float] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Of the free numbers."""
        return list(dict.fromkeys(name for one in self.identities for name in one.slopes))

    def text(self) -> str:
        """For the solver, one line of JSON."""
        names = {name: i for i, name in enumerate(self.names)}
        rows: dict[tuple[int, Exponents], int] = {}
        linear, right, sizes, quadratic = ([], [], []), {}, [], []

        def row(place: int, key: Exponents) -> int:
            return rows.setdefault((place, key), len(rows))

        for place, identity in enumerate(self.identities):
            for key, value in terms_of(identity.constant).items():
                right[row(place, key)] = -nearest_double(value)
            for name, slope in identity.slopes.items():
                for key, value in terms_of(slope).items():
                    for part, entry in zip(linear, (row(place, key), names[name], nearest_double(value))):
                        part.append(entry)
            for square in identity.parts():
                entries: tuple[list[Any], ...] = ([], [], [], [])
                weight = [(key, nearest_double(value)) for key, value in terms_of(square.weight).items()]
                for i, first in enumerate(square.basis):
                    for j, second in enumerate(square.basis[: i + 1]):
                        for key, value in weight:
                            power = tuple(map(sum, zip(first, second, key)))
                            found = (row(place, power), j, i, -value * (1 + (i != j)))
                            for part, entry in zip(entries, found):
                                part.append(entry)
                sizes.append(len(square.basis))
                quadratic.append(entries)
        program = {
            "free": len(names), "sizes": sizes, "linear": linear, "quadratic": quadratic,
            "objective": [self.objective.get(name, 0.0) for name in names],
            "right": [right.get(i, 0.0) for i in range(len(rows))],
        }  # fmt: skip
        return json.dumps(program)


@dataclass(frozen=True, eq=False)
class Answer:
    """What the solver found: `y` by name and a matrix for each part of each identity, or None where it found none."""

    status: str
    seconds: float
    megabytes: float
    y: dict[str, float] | None
    matrices: list[np.ndarray] | None


class Solver:
    """cvxpy and Clarabel in a process of their own; its CPU seconds are summed."""

    def __init__(self) -> None:
        command = [str(peers.PYTHON), str(Path(__file__).parent / "peer.py")]
        single = os.environ | {"OMP_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=single
        )
        self.versions, self.seconds, self.megabytes = self._read(), 0.0, 0.0

    @staticmethod
    def missing() -> str:
        """Why there is no solver; empty where there is one."""
        return peers.missing("cvxpy", "clarabel")

    def _read(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit("the solver ended; its own message is above")
        return json.loads(line)

    def solve(self, program: Program) -> Answer:
        """The program's answer."""
        assert self.process.stdin is not None
        self.process.stdin.write(program.text() + "\n")
        self.process.stdin.flush()
        found = self._read()
        self.seconds += found["seconds"]
        self.megabytes = max(self.megabytes, found["megabytes"])
        good = found["status"] in ("optimal", "optimal_inaccurate") and "y" in found
        return Answer(
            found["status"],
            found["seconds"],
            found["megabytes"],
            dict(zip(program.names, found["y"])) if good else None,
            [np.array(matrix) for matrix in found["matrices"]] if good else None,
        )

    def __enter__(self) -> Solver:
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait()
        self.process.stdout.close()


def monomials(variables: int, lowest: int, highest: int) -> list[Exponents]:
    """Of these degrees, shortest first."""
    found: list[Exponents] = [(0,) * variables]
    every = {found[0]}
    for _ in range(highest):
        found = sorted(
            {tuple(e + (i == j) for j, e in enumerate(key)) for key in found for i in range(variables)}
        )
        every |= set(found)
    return sorted((key for key in every if sum(key) >= lowest), key=lambda key: (sum(key), key))


def newton_basis(polynomials: Iterable[fmpq_mpoly], more: Iterable[Exponents] = ()) -> list[Exponents]:
    """Monomials whose squares lie in the convex hull of the exponents, without those that can have no weight."""
    support = {key for polynomial in polynomials for key in terms_of(polynomial)} | set(more)
    points = np.array(sorted(support))
    used = np.flatnonzero(points.any(axis=0))
    hull = _half_spaces(points[:, used])
    highest = int(points.sum(axis=1).max()) // 2
    candidates = np.array(monomials(len(used), int(points.sum(axis=1).min() + 1) // 2, highest))
    inside = (2 * candidates @ hull[:, :-1].T + hull[:, -1] <= 1e-6).all(axis=1)
    basis = []
    for key in candidates[inside]:
        whole = np.zeros(points.shape[1], dtype=int)
        whole[used] = key
        basis.append(tuple(map(int, whole)))
    while True:
        cross = {tuple(map(sum, zip(a, b))) for i, a in enumerate(basis) for b in basis[:i]}
        kept = [key for key in basis if (square := tuple(2 * e for e in key)) in support or square in cross]
        if len(kept) == len(basis):
            return basis
        basis = kept


def _half_spaces(points: np.ndarray) -> np.ndarray:
    """Rows a, b with aᵀp + b ≤ 0 that give the convex hull, also of points that lie in a plane."""
    centre = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - centre)
    rank = int((sizes > 1e-9 * max(sizes[0], 1.0)).sum())
    along = axes[:rank]
    flat = np.vstack([axes[rank:], -axes[rank:]])
    inner = (points - centre) @ along.T
    if rank > 1:
        rows = ConvexHull(inner).equations
    else:
        rows = np.array([[1.0, -inner.max()], [-1.0, inner.min()]]) if rank else np.zeros((0, 1))
    normal = np.vstack([rows[:, :-1] @ along, flat])
    offset = np.concatenate([rows[:, -1], np.zeros(len(flat))]) - normal @ centre
    return np.column_stack([normal, offset])


def proved(program: Program, answer: Answer) -> str:
    """Empty if the identities hold exactly with definite matrices near those of the answer; else what fails."""
    if answer.y is None or answer.matrices is None:
        return answer.status
    matrices = iter(answer.matrices)
    for identity in program.identities:
        parts = identity.parts()
        own = [next(matrices) for _ in parts]
        reason = _identity_holds(identity, parts, own, answer.y)
        if reason:
            return reason
    return ""


def _identity_holds(
    identity: Identity, parts: list[Square], own: list[np.ndarray], y: dict[str, float]
) -> str:
    ring = identity.constant.context()
    left = identity.constant
    for name, slope in identity.slopes.items():
        left = left + slope * rational(float(y[name]))
    exact = []
    for square, matrix in zip(parts, own):
        size = len(square.basis)
        lifted = (matrix + matrix.T) / 2 + 1e-12 * np.trace(matrix) / size * np.eye(size)
        entries = [[rational(float(lifted[max(i, j), min(i, j)])) for j in range(size)] for i in range(size)]
        exact.append(entries)
        terms: dict[Exponents, fmpq] = {}
        for i, first in enumerate(square.basis):
            for j, second in enumerate(square.basis):
                key = tuple(map(sum, zip(first, second)))
                terms[key] = terms.get(key, fmpq(0)) + entries[i][j]
        left = left - ring.from_dict(terms) * square.weight
    weight = identity.squares[0].weight
    assert weight == ring.constant(1), "the first square takes the rounding"
    free = [k for k, square in enumerate(parts) if square.weight == weight]
    places: dict[Exponents, list[tuple[int, int, int]]] = {}
    for k in free:
        for i, first in enumerate(parts[k].basis):
            for j, second in enumerate(parts[k].basis):
                places.setdefault(tuple(map(sum, zip(first, second))), []).append((k, i, j))
    for key, value in terms_of(left).items():
        if key not in places:
            return f"nothing takes the rounding of the monomial {key}"
        for k, i, j in places[key]:
            exact[k][i][j] += value / len(places[key])
    for square, entries in zip(parts, exact):
        if not _definite(entries):
            return f"a matrix of {len(square.basis)} rows is not shown to be definite"
    return ""


def _definite(entries: list[list[fmpq]]) -> bool:
    """Cholesky's method in balls."""
    before, ctx.prec = ctx.prec, 128
    try:
        size = len(entries)
        scale = [1 / max(float(nearest_double(entries[i][i])), 1e-300) ** 0.5 for i in range(size)]
        rows: list[list[arb]] = []
        for i in range(size):
            row: list[arb] = []
            for j in range(i + 1):
                total = arb(entries[i][j]) * arb(scale[i]) * arb(scale[j])
                for a, b in zip(row, rows[j] if j < i else row):
                    total -= a * b
                if i == j:
                    if not total > 0:
                        return False
                    row.append(total.sqrt())
                else:
                    row.append(total / rows[j][j])
            rows.append(row)
        return True
    finally:
        ctx.prec = before
