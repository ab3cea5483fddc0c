"""The homological equation V_x(x) A x + r(x) = 0 for homogeneous V and r of degree k, A stable.

In eigenvector coordinates, x = T z, the equation is a division by λ_{i1} + … + λ_{ik}. Its error grows like
cond(T)^k; one step of refinement repairs that while cond(T)^k ε ≪ 1, and nothing does past it. In complex
Schur coordinates the equation is triangular and solved by substitution (`substitute`): backward stable
for any A, defective ones included, at a few times the cost. The residual of what is returned is always
measured.

In the triangular equation V_z(z) T z = r(z), z_j ∂V/∂z_i with j > i moves an index i of a tuple up to j, so the sum
of the indices orders the equations: all tuples of one sum depend only on those of smaller sums and are solved together.

Linear change of variables in a homogeneous polynomial, in compressed symmetric storage.

One index of the symmetric tensor is transformed at a time. In between, the tensor is symmetric in the k−s old
indices and symmetric in the s new ones: a matrix of count(n, k−s) rows and count(n, s) columns. A step opens
one old index by the insertion table, contracts it with the matrix and keeps the results whose new index comes
first in the sorted tuple: dense matrix products on arrays that never exceed count(n, k/2)² numbers. Large real tensors
are transformed in machine code, which keeps the tensor of two new indices only (`flexhinf.hinf.contraction`).

Coordinates in which a linear flow is diagonal or triangular: a real matrix times complex pairs.

Eigenvectors of a real matrix come in conjugate pairs v = p ± iq. Going to the real columns p, q first and
mixing each pair afterwards keeps the expensive, dense part of the change of variables in real arithmetic.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportPrivateUsage=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from flexhinf.codegen.loops import LANES
from flexhinf.hinf.contraction import Rotation
from flexhinf.hinf.pairs import divide_by_sums
from flexhinf.hinf.products import derivative
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import run_all, tile_products

_SMALL = 20_000  # opened tensors up to this size go through one product and one selection
_TILE_BYTES = 2_000_000
_TILES = 32  # of one product of a vector's numbers, in one call
_LARGE = 2_000_000  # opened tensors from this size on are worth a second thread
_WORTH = (
    10_000_000  # multiplications from which machine code, and a second thread in it, are worth their start
)


class SolverWorkspace:
    """Two buffers that the steps write to in turn, kept from one change of variables to the next.

    Memory that is fresh from the system costs several times the arithmetic done on it.
    """

    def __init__(self) -> None:
        self._buffers = [np.empty(0), np.empty(0)]

    def take(self, turn: int, rows: int, columns: int, dtype: np.dtype) -> np.ndarray:
        """An array whose content is arbitrary; it lives until the next call with the same parity of `turn`."""
        size = rows * columns * dtype.itemsize // 8
        if self._buffers[turn % 2].size < size:
            self._buffers[turn % 2] = np.empty(0)  # give back before asking for more
            self._buffers[turn % 2] = np.empty(size)
        return self._buffers[turn % 2][:size].view(dtype).reshape(rows, columns)

    def aligned(self, size: int) -> np.ndarray:
        """Doubles, of which the first one begins a line of the cache; as `take` with turn 0."""
        numbers = self.take(0, 1, size + LANES, np.dtype(float))[0]
        return numbers[-numbers.ctypes.data // numbers.itemsize % LANES :][:size]


def change_variables(
    entries: np.ndarray, n: int, k: int, matrix: np.ndarray, workspace: SolverWorkspace | None = None
) -> np.ndarray:
    """Tensor entries (count(n, k),) of p(M z) as a polynomial in z, of those of p, homogeneous of degree `k`.

    Entries and M (n, n) are real or complex. A workspace is used again by later calls, one at a time.
    """
    dtype = np.result_type(entries, matrix)
    if np.issubdtype(dtype, np.float64) and rotates_in_machine_code(n, k):
        rotation = Rotation(n, k, np.asarray(matrix, float))
        return rotation.apply(
            np.asarray(entries, float), (workspace or SolverWorkspace()).aligned(rotation.size)
        )
    tensor, matrix = np.ascontiguousarray(entries, dtype).reshape(-1, 1), np.ascontiguousarray(matrix, dtype)
    for s in range(k):
        opening, width = basis.insertion(n, k - s), tensor.shape[1]
        if opening.size * width <= _SMALL and n * n * width <= tile_products(dtype):
            tensor = (matrix.T @ tensor[opening]).reshape(len(opening), -1)[:, _sorted_pairs(n, s)]
        else:
            shape = len(opening), basis.count(n, s + 1)
            result = workspace.take(s, *shape, dtype) if workspace else np.empty(shape, dtype)
            _contract_one_index(tensor, opening, n, s, matrix, result)
            tensor = result
    return tensor.reshape(-1).copy() if workspace else tensor.reshape(-1)


def rotates_in_machine_code(n: int, k: int) -> bool:
    """Whether a change of real variables is large enough to be worth machine code."""
    return _operations(n, k) > _WORTH and k > 2 and basis.count(n, k - 2) >= LANES


@lru_cache(256)
def _operations(n: int, k: int) -> int:
    return sum(basis.count(n, k - s - 1) * n * basis.count(n, s + 1) for s in range(k))


@lru_cache(64)
def _sorted_pairs(n: int, s: int) -> np.ndarray:
    """Positions, in an (n, count(n, s)) array, of the pairs (j, tail) with j ≤ the first index of tail."""
    start, width = basis.offsets(n, s), basis.count(n, s)
    return np.concatenate([j * width + np.arange(start[j], width) for j in range(n)])


def _contract_one_index(
    tensor: np.ndarray, opening: np.ndarray, n: int, s: int, matrix: np.ndarray, result: np.ndarray
) -> None:
    """One step by NumPy, in tiles."""
    width, most = basis.count(n, s), max(1, tile_products(result.dtype) // n**2)
    columns = min(width, most)
    rows = max(1, _TILE_BYTES // (n * columns * tensor.itemsize)) if s else _TILES * most
    start, first = basis.offsets(n, s), basis.offsets(n, s + 1)

    def tile(top: int, left: int) -> None:
        opened, kept = tensor[:, left : left + columns][opening[top : top + rows]], result[top : top + rows]
        if s == 0:
            whole = len(opened) // most * most
            np.matmul(opened[:whole].reshape(-1, most, n), matrix, out=kept[:whole].reshape(-1, most, n))
            np.matmul(opened[whole:, :, 0], matrix, out=kept[whole:])
            return
        right = left + opened.shape[2]
        contracted = np.matmul(matrix.T, opened)
        for j in range(n):
            tail, place = max(start[j], left), first[j] - start[j]
            if tail < right:
                kept[:, place + tail : place + right] = contracted[:, j, tail - left :]

    run_all(
        tile,
        ((top, left) for top in range(0, len(opening), rows) for left in range(0, width, columns)),
        large=opening.size * width > _LARGE,
    )


_NEGLIGIBLE = 5_000  # coefficients up to which one complex change of variables is cheaper than real and pairs
_PAIR = np.array([[1, 1], [1j, -1j]]) / np.sqrt(2)


@dataclass(frozen=True)
class Coordinates:
    """x = M G z with real M, and G unitary in 2×2 blocks (`rotations`, by their first variable).

    `flow` is the matrix in these coordinates, (M G)⁻¹ A (M G): diagonal or upper triangular, complex; `real` and
    `inverse` are M and M⁻¹.
    """

    flow: np.ndarray
    real: np.ndarray
    inverse: np.ndarray
    rotations: dict[int, np.ndarray]
    workspace: SolverWorkspace = field(default_factory=SolverWorkspace, repr=False)

    @cached_property
    def condition(self) -> float:
        """cond(M G) in the 2-norm; infinite if there is no inverse."""
        return (
            float(np.linalg.norm(self.real, 2) * np.linalg.norm(self.inverse, 2))
            if np.isfinite(self.inverse).all()
            else np.inf
        )

    def enter(self, entries: np.ndarray, k: int) -> np.ndarray:
        """Tensor entries in z of a polynomial given in x."""
        n = len(self.real)
        if len(entries) <= _NEGLIGIBLE:
            return change_variables(entries, n, k, self._mixed[0])
        return rotate_pairs(change_variables(entries, n, k, self.real, self.workspace), n, k, self.rotations)

    def leave(self, entries: np.ndarray, k: int) -> np.ndarray:
        """Tensor entries in x of a polynomial given in z, real in x."""
        n = len(self.real)
        if len(entries) <= _NEGLIGIBLE:
            return np.real(change_variables(entries, n, k, self._mixed[1]))
        back = {first: np.ascontiguousarray(block.conj().T) for first, block in self.rotations.items()}
        return change_variables(
            np.real(rotate_pairs(entries, n, k, back)), n, k, self.inverse, self.workspace
        )

    @cached_property
    def _mixed(self) -> tuple[np.ndarray, np.ndarray]:
        """M G and its inverse."""
        pairs = self._pairs()
        return self.real @ pairs, pairs.conj().T @ self.inverse

    def _pairs(self) -> np.ndarray:
        """G."""
        pairs = np.eye(len(self.real), dtype=complex)
        for first, block in self.rotations.items():
            pairs[first : first + 2, first : first + 2] = block
        return pairs


def rotate_pairs(entries: np.ndarray, n: int, k: int, rotations: Mapping[int, np.ndarray]) -> np.ndarray:
    """Tensor entries (count(n, k),), complex, of p(G z), where G is the identity but for 2×2 blocks on the diagonal.

    A block at i acts on variables i and i+1.
    """
    result = entries.astype(complex)
    for first, rotation in rotations.items():
        for m in range(1, k + 1):
            _rotate(result, _pair_tuples(n, k, first, m), _power(rotation.tobytes(), m))
    return result


def _rotate(entries: np.ndarray, group: np.ndarray, rotation: np.ndarray) -> None:
    """The entries at each row of `group` times a matrix, in place; no entry is in two rows."""
    rows = max(1, tile_products(entries.dtype) // rotation.size)

    def some(top: int) -> None:
        places = group[top : top + rows]
        entries[places] = entries[places] @ rotation

    run_all(some, ((top,) for top in range(0, len(group), rows)), large=group.size > _LARGE // 16)


@lru_cache(4096)
def _pair_tuples(n: int, k: int, first: int, m: int) -> np.ndarray:
    """Ranks of the tuples that hold the pair's variables exactly m times, int32 (tuples of the other indices, m + 1).

    Column b: the second variable b times, the first m − b times.
    """
    others = basis.indices(n, k - m)
    untouched = np.flatnonzero(~((others == first) | (others == first + 1)).any(axis=1)).astype(np.int32)
    ranks = np.repeat(untouched[:, None], m + 1, axis=1)
    for step in range(m):
        ranks = basis.insertion(n, k - m + step + 1)[ranks, first + (step < np.arange(m + 1))]
    return ranks


@lru_cache(512)
def _power(rotation: bytes, m: int) -> np.ndarray:
    """What a 2×2 matrix does to the m+1 tensor entries of degree m in two variables; shape (old, new)."""
    matrix = np.frombuffer(rotation, complex).reshape(2, 2)
    return np.stack([change_variables(unit, 2, m, matrix) for unit in np.eye(m + 1)])


@lru_cache(64)
def _powers(k: int) -> list[list[np.ndarray]]:
    """Of a pair of conjugate eigenvectors and of the way back: `_power` from m = 0 to k."""
    there_and_back = _PAIR, np.ascontiguousarray(_PAIR.conj().T)
    return [
        [np.ones((1, 1), complex), *(_power(way.tobytes(), m) for m in range(1, k + 1))]
        for way in there_and_back
    ]


HOPELESS = 1e-1  # cond(T)^k ε beyond which the eigenvector route is not tried
_EASY = 2_000  # coefficients up to which a refinement step costs nothing to speak of
_REFINE, _ACCEPT = 1e-14, 3e-14  # residuals above which a large solution is refined, and the basis given up


@dataclass(frozen=True)
class HomologicalSolution:
    """Solution of one degree: tensor entries (count(n, k),) of V_k.

    The method is "eigenbasis", "eigenbasis, refined" or "Schur"; the residual ‖V_x A x + r‖ / (‖A‖ ‖V‖ + ‖r‖) has norms
    of the tensor entries.
    """

    entries: np.ndarray
    method: str
    residual: float


@dataclass(frozen=True)
class HomologicalEquation:
    """The equation for one matrix A, shape (n, n), eigenvalues in the open left half plane."""

    matrix: np.ndarray

    @cached_property
    def eigenbasis(self) -> Coordinates:
        """Coordinates along the eigenvectors of A, conjugate pairs first."""
        eigenvalues, vectors = np.linalg.eig(self.matrix)
        pairs, lone = np.flatnonzero(np.imag(eigenvalues) > 0), np.flatnonzero(np.imag(eigenvalues) == 0)
        joined = np.stack([np.real(vectors[:, pairs]), np.imag(vectors[:, pairs])], axis=2) * np.sqrt(2)
        real = np.hstack([joined.reshape(len(vectors), -1), np.real(vectors[:, lone])])
        values = np.stack([eigenvalues[pairs], eigenvalues[pairs].conj()], axis=1).ravel()
        try:
            inverse = np.linalg.inv(real)
        except np.linalg.LinAlgError:
            inverse = np.full_like(real, np.inf)
        return Coordinates(
            flow=np.diag(np.concatenate([values, eigenvalues[lone]])),
            real=real,
            inverse=inverse,
            rotations={2 * i: _PAIR for i in range(len(pairs))},
        )

    @cached_property
    def schur_basis(self) -> Coordinates:
        """Coordinates of the real Schur form of A, its 2×2 blocks made triangular by complex rotations."""
        from scipy.linalg import schur

        triangular, orthogonal = schur(self.matrix, output="real")[:2]
        rotations = {}  # unitary, the first column an eigenvector of the block
        for i in np.flatnonzero(np.diag(triangular, -1)).tolist():
            _, vectors = np.linalg.eig(triangular[i : i + 2, i : i + 2].astype(complex))
            a, b = vectors[:, 0]
            rotations[i] = np.array([[a, -np.conj(b)], [b, np.conj(a)]])
        pairs = Coordinates(triangular, orthogonal, orthogonal.T, rotations)._pairs()
        return Coordinates(np.triu(pairs.conj().T @ triangular @ pairs), orthogonal, orthogonal.T, rotations)

    def solve(self, known: np.ndarray, k: int) -> HomologicalSolution:
        """V of degree `k`, from the tensor entries (count(n, k),) of r."""
        if self.eigenbasis.condition**k * np.finfo(float).eps < HOPELESS:
            methods = "eigenbasis", "eigenbasis, refined"
            solution = self._refined(self._division(k), known, k, methods, _REFINE)
            if solution.residual <= _ACCEPT:
                return solution
        return self._refined(self._substitution(k), known, k, ("Schur", "Schur"), np.inf)

    def _division(self, k: int) -> Callable[[np.ndarray], np.ndarray]:
        """Known part → V of degree `k`, by division in the eigenbasis."""
        n, coordinates = len(self.matrix), self.eigenbasis
        if not rotates_in_machine_code(n, k):
            pivots = -diagonal_sums(coordinates.flow, k)
            return lambda known: coordinates.leave(coordinates.enter(known, k) / pivots, k)

        def divide(known: np.ndarray) -> np.ndarray:
            entries = change_variables(known, n, k, coordinates.real, coordinates.workspace)
            divide_by_sums(entries, np.diag(coordinates.flow), _powers(k), k)
            return change_variables(entries, n, k, coordinates.inverse, coordinates.workspace)

        return divide

    def _substitution(self, k: int) -> Callable[[np.ndarray], np.ndarray]:
        """The same by substitution in the Schur basis."""
        coordinates = self.schur_basis
        return lambda known: coordinates.leave(
            substitute(coordinates.flow, -coordinates.enter(known, k), k), k
        )

    def residual(self, entries: np.ndarray, known: np.ndarray, k: int) -> np.ndarray:
        """Tensor entries of V_x A x + r."""
        n = len(self.matrix)
        result = derivative(entries, self.matrix, n, k)
        result /= basis.multiplicity(n, k)
        result += known
        return result

    @cached_property
    def _size(self) -> float:
        return float(np.linalg.norm(self.matrix, 2))

    def _relative(self, residual: np.ndarray, entries: np.ndarray, known: np.ndarray) -> float:
        scale = self._size * np.linalg.norm(entries) + np.linalg.norm(known)
        return float(np.linalg.norm(residual) / scale) if scale > 0 else 0.0

    def _refined(
        self,
        solve: Callable[[np.ndarray], np.ndarray],
        known: np.ndarray,
        k: int,
        methods: tuple[str, str],
        enough: float,
    ) -> HomologicalSolution:
        """The better one of a solution and the same refined once; a large one with a residual of `enough` as it is."""
        entries = solve(known)
        residual = self.residual(entries, known, k)
        relative = self._relative(residual, entries, known)
        first = HomologicalSolution(entries, methods[0], relative)
        if (relative <= enough and len(known) > _EASY) or not np.isfinite(relative):
            return first
        entries = entries + solve(residual)
        after = self._relative(self.residual(entries, known, k), entries, known)
        return HomologicalSolution(entries, methods[1], after) if after < relative else first


_CHUNK = 100_000


def substitute(triangular: np.ndarray, known: np.ndarray, k: int) -> np.ndarray:
    """Tensor entries (count(n, k),) of V with V_z T z = r, T (n, n) upper triangular, from those of r.

    No sum of k diagonal entries vanishes. In tensor entries, k times the symmetrised equation reads
        Σ_m ( T[i_m, i_m] v[i] + Σ_{j < i_m} v[i with i_m replaced by j] T[j, i_m] ) = r[i].
    """
    n, above = len(triangular), np.ascontiguousarray(np.triu(triangular, 1).T)
    tuples, table, removal = basis.indices(n, k), basis.insertion(n, k), basis.removal(n, k)
    (order, cuts), pivots = _levels(n, k), diagonal_sums(triangular, k)
    solution = np.zeros(len(tuples), np.result_type(triangular, known))
    for low, high in pairwise(cuts):
        for begin in range(low, high, _CHUNK):
            level = order[begin : min(begin + _CHUNK, high)]
            moved = known[level].astype(solution.dtype)
            for position in range(k):
                moved -= np.einsum(
                    "aj,aj->a", solution[table[removal[level, position]]], above[tuples[level, position]]
                )
            solution[level] = moved / pivots[level]
    return solution


def diagonal_sums(matrix: np.ndarray, k: int) -> np.ndarray:
    """Sum of the `k` diagonal entries each tuple points at, shape (count(n, k),)."""
    diagonal, tuples = np.diag(matrix), basis.indices(len(matrix), k)
    return sum((diagonal[position] for position in tuples.T), np.zeros(len(tuples), matrix.dtype))


@lru_cache(32)
def _levels(n: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    sums = basis.indices(n, k).sum(axis=1, dtype=np.int32)
    order = np.argsort(sums, kind="stable").astype(np.int32)
    return order, np.searchsorted(sums[order], np.arange(k * (n - 1) + 2))
