"""The linear part of a problem: A, g1, g2 R2^(−½), ∂h/∂x at the operating point, and its conditions.

*Standing assumptions.* Every mode that does not decay must be reached by u and seen in z. That is tested mode by mode
(Popov–Belevitch–Hautus) in balanced coordinates, so that the error names the mode.

*Scaling.* Units by powers of two, so that nothing is rounded: arms mix 1e4 N·m/rad with radians. With x = D ξ and
V = s² W the Hamiltonian matrix of the Riccati equation is balanced, and so are the coefficients of every higher degree.

*The quadratic part of Eq. (8)*, a Riccati equation with an indefinite quadratic term (`flexhinf.hinf.hji`): the stable
invariant subspace of the Hamiltonian matrix (ordered real Schur form) gives P to about 1e-10, which would cap every
higher degree; Newton steps, one Lyapunov equation each, bring it to rounding.

*The smallest feasible attenuation level* γ* of Eq. (5), by bisection.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.errors import NotDetectable, NotStabilisable, NumericalFailure, refuse_if
from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.plant.polynomial_plant import PolynomialPlant, Problem
from flexhinf.polynomial.algebra import add_part, monomials, product

_AXIS = 1e-13  # eigenvalues this close to the imaginary axis, relative to the norm times n, lie on it
_ISOTROPY = 1e-6  # asymmetry of U1ᵀU2 beyond which the subspace mixes a mode with its mirror image
_NEGATIVE = 1e-9  # most negative eigenvalue of P, relative to the largest, that still counts as zero
_LARGEST_NORM = 1e40  # bound on the norm of P, relative to the norm of the Hamiltonian matrix
_NEWTON_STEPS = 6
_ROUNDING = 4 * float(np.finfo(np.longdouble).eps)  # relative residual that no step improves


@dataclass(frozen=True)
class RiccatiSolution:
    """A stabilising solution P ≥ 0.

    `p`: (n, n), in extended precision (where the machine has it) once it is polished. `closed_loop`: (n, n), A + M P,
    both the law and the worst disturbance applied. `residual`: Norm of the left-hand side relative to the largest of
    its terms. `form`: Real Schur form of the closed loop before the last Newton step: close enough for a sensitivity.
    """

    p: np.ndarray
    closed_loop: np.ndarray
    residual: float
    form: tuple[np.ndarray, np.ndarray] | None = None


def solve_riccati(a: np.ndarray, m: np.ndarray, q: np.ndarray) -> RiccatiSolution | None:
    """Stabilising P ≥ 0 to about 1e-10, or None where there is none; `polish` makes it exact.

    `a`, `m`, `q`: (n, n), in balanced coordinates. `m` is symmetric and indefinite, `q` symmetric positive
    semidefinite.

    Feasibility is lost in two ways as γ falls: eigenvalues of the Hamiltonian matrix reach the imaginary
    axis, or the stable subspace loses its graph form (P grows without bound and comes back negative). Both
    are looked at.
    """
    from scipy.linalg import schur

    n = len(a)
    hamiltonian = np.block([[a, m], [-q, -a.T]]).astype(float)
    size = float(np.linalg.norm(hamiltonian))
    if not np.isfinite(size):
        return None
    try:
        ordered: tuple[Any, ...] = schur(hamiltonian, sort="lhp", check_finite=False)
        triangular, vectors, stable = ordered
        upper, lower = vectors[:n, :n], vectors[n:, :n]
        cross = upper.T @ lower
        mixed = np.linalg.norm(cross - cross.T) > _ISOTROPY * max(float(np.linalg.norm(cross)), 1e-10)
        # on the axis, as far as eigenvalues can be told: 2×2 blocks have Re λ on their diagonal
        if stable != n or np.abs(np.diag(triangular)).min() <= _AXIS * n * size or mixed:
            return None
        p = np.linalg.solve(upper.T, lower.T).T
    # An eigenvalue crossed the axis while the form was being ordered, or P is infinite.
    except np.linalg.LinAlgError:
        return None
    p = (p + p.T) / 2
    eigenvalues = np.linalg.eigvalsh(p) if np.isfinite(p).all() else np.array([-np.inf])
    lost = eigenvalues[0] < -_NEGATIVE * abs(eigenvalues[-1]) or eigenvalues[-1] > _LARGEST_NORM * size
    return None if lost else RiccatiSolution(p, (a + m @ p).astype(float), np.nan)


def polish(a: np.ndarray, m: np.ndarray, q: np.ndarray, p: np.ndarray) -> RiccatiSolution | None:
    """Newton steps while the residual falls; the best iterate is kept. None where it does not stabilise.

    P M P cancels where P is large, so P, residual and closed loop are formed in extended precision (where the
    machine has it); the steps themselves need no more than double.

    `a`, `m`, `q`: (n, n), as for `solve_riccati`. `p`: (n, n), A first approximation.
    """
    a, m, q, p = (matrix.astype(np.longdouble) for matrix in (a, m, q, p))
    p, form = (p + p.T) / 2, None  # no step would take an antisymmetric part away
    left, scale = _riccati_residual(a, m, q, p)
    for _ in range(_NEWTON_STEPS):
        form = _schur((a + m @ p).astype(float))
        step = _lyapunov_step(form, left.astype(float))
        if step is None:
            break
        candidate = p + step
        next_left, next_scale = _riccati_residual(a, m, q, candidate)
        if not _size(next_left) < _size(left):
            break
        gained = _size(next_left) < 0.25 * _size(left)
        p, left, scale = candidate, next_left, next_scale
        if not gained or _size(left) <= _ROUNDING * scale:
            break
    closed_loop = (a + m @ p).astype(float)
    stable = not np.linalg.eigvals(closed_loop).real.max() >= 0
    return RiccatiSolution(p, closed_loop, _size(left) / scale, form) if stable else None


def sensitivity(riccati: RiccatiSolution, change: np.ndarray) -> np.ndarray:
    """ΔP for a small change ΔM of M: A_clᵀ ΔP + ΔP A_cl = −P ΔM P, shape (n, n).

    `change`: (n, n), ΔM, symmetric.
    """
    p = riccati.p.astype(float)
    step = _lyapunov_step(riccati.form or _schur(riccati.closed_loop), p @ change.astype(float) @ p)
    return np.full(p.shape, np.inf) if step is None else step


def _size(matrix: np.ndarray) -> float:
    return float(np.sqrt((matrix * matrix).sum()))


def _schur(closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from scipy.linalg import schur

    triangular, vectors, *_ = schur(closed, check_finite=False)
    return triangular, vectors


def _lyapunov_step(form: tuple[np.ndarray, np.ndarray], left: np.ndarray) -> np.ndarray | None:
    """Δ with closedᵀ Δ + Δ closed = −left; None where the equation is singular to working precision."""
    from scipy.linalg.lapack import get_lapack_funcs

    triangular, vectors = form
    (trsyl,) = get_lapack_funcs(("trsyl",), (triangular,))
    rotated, scale, info = trsyl(triangular, triangular, -vectors.T @ left @ vectors, trana="T")
    if info != 0 or scale == 0:
        return None
    step = vectors @ (rotated / scale) @ vectors.T
    return (step + step.T) / 2


def _riccati_residual(a: np.ndarray, m: np.ndarray, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, float]:
    linear, quadratic = p @ a, p @ m @ p
    left = linear + linear.T + q + (quadratic + quadratic.T) / 2
    return left, max(_size(term) for term in (linear, q, quadratic)) or 1.0


#: Monomial coefficients by degree.
PartsByDegree = dict[int, np.ndarray]


@dataclass(frozen=True)
class Scaling:
    """x = `state` * ξ (elementwise) and V = `value`² W.

    `state`: (n,), powers of two. `value`: A power of two: g1 and g2 are multiplied by it, h divided by it.
    """

    state: np.ndarray
    value: float


@dataclass(frozen=True)
class ScaledProblem:
    """V_x f + q + ½ Σ_c s_c (V_x g_c)² = 0, one column g_c per player's channel.

    The columns are g1/γ with sign +1 and g2 L⁻ᵀ with sign −1, where R2 = L Lᵀ; q = ½ hᵀh. So both quadratic
    terms of Eq. (8) are sums of squares of *scalar* polynomials V_x g_c, as many as there are channels.

    `n`, `degree`: States, and degree of V. `f`, `g`, `q`: Monomial coefficients, shapes (n, count), (n, channels,
    count), (count,). `signs`: (channels,).
    """

    n: int
    degree: int
    f: PartsByDegree
    g: PartsByDegree
    q: PartsByDegree
    signs: np.ndarray

    @classmethod
    def of(cls, plant: PolynomialPlant, gamma: float, degree: int, scaling: Scaling) -> ScaledProblem:
        """Scale x = D ξ, V = s² W, and join the channels of both players."""
        n, md, m, _ = plant.size
        d, s = scaling.state, scaling.value
        highest = max((*plant.f_parts, *plant.g1_parts, *plant.g2_parts, *plant.h_parts))
        powers = monomials(d[None, :], range(highest + 1))
        disturbed = np.isfinite(gamma)
        lower = np.linalg.cholesky(plant.r2)
        f = {k: part * powers[k] / d[:, None] for k, part in plant.f_parts.items()}
        g: PartsByDegree = {}
        for k in sorted({*plant.g1_parts, *plant.g2_parts}):
            width = powers[k].shape[1]
            first = plant.g1_parts.get(k, np.zeros((n, md, width))) / gamma
            second = plant.g2_parts.get(k, np.zeros((n, m, width)))
            second = np.linalg.solve(lower, np.moveaxis(second, 1, 0).reshape(m, -1))
            second = np.moveaxis(second.reshape(m, n, width), 0, 1)
            channels = np.concatenate([first, second], axis=1) if disturbed else second
            g[k] = channels * powers[k] * (s / d)[:, None, None]
        signs = np.r_[np.ones(md if disturbed else 0), -np.ones(m)]
        h = {k: part * powers[k] / s for k, part in plant.h_parts.items()}
        q: PartsByDegree = {}  # ½ hᵀh through `degree`
        for a, left in h.items():
            for b, right in h.items():
                if b <= a and a + b <= degree:
                    add_part(q, a + b, (0.5 if a == b else 1.0) * product(left.T, right, n, a, b))
        return cls(n, degree, f, g, {k: part for k, part in q.items() if part.any()}, signs)


_DECAYS = 4.0 * float(np.finfo(float).eps)  # times n: what rounding may add to Re λ, relative to ‖A‖
_RANK = 1e-10  # smallest singular value of the pencil, relative to its norm, that counts as rank deficiency
_LARGEST = 1e70  # of a coefficient: products of its squares are finite
_REACH = 1e-11  # relative size below which a coupling from d to z is rounding


def check_problem(problem: object) -> None:
    """Raise `InvalidInput` unless this is a generalised plant."""
    # the protocol last: it takes long to ask
    refuse_if(
        not isinstance(problem, GeneralisedPlant | PolynomialPlant) and not isinstance(problem, Problem),
        "This is not a problem that can be solved.",
        f"expected a generalised plant or a PolynomialPlant, got {type(problem).__name__}",
        "robot.problem(), or plant.with_objective(penalty), makes a problem",
    )


@dataclass(frozen=True)
class LinearPart:
    """ẋ = A x + B1 d + B2 v, z = (C x, v): the input is in units of its own penalty, v = lu.

    `a`, `b1`, `b2`, `c`: (n, n), (n, md), (n, m), (s, n).
    """

    a: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    c: np.ndarray
    state_names: tuple[str, ...]

    @classmethod
    def of(cls, plant: PolynomialPlant) -> LinearPart:
        """Degree-1 part of the expansion.

        Raises InvalidInput: A number so large that products of squares are not finite.
        """
        b2 = np.linalg.solve(np.linalg.cholesky(plant.r2), plant.g2_parts[0][:, :, 0].T).T
        linear = cls(plant.f_parts[1], plant.g1_parts[0][:, :, 0], b2, plant.h_parts[1], plant.state_names)
        for name, matrix in (
            ("f", linear.a),
            ("g1", linear.b1),
            ("g2 R2^(-1/2)", linear.b2),
            ("h", linear.c),
        ):
            largest = float(np.abs(matrix).max(initial=0.0))
            refuse_if(
                not largest <= _LARGEST,
                f"The linear part of {name} is out of proportion.",
                f"expected numbers up to {_LARGEST:g}, got {largest:.3g}",
                "other units",
            )
        return linear

    def scaled(self, gamma: float) -> tuple[Scaling, LinearPart]:
        """The linear part balanced for this level, where g1 counts with its weight 1/γ.

        The Hamiltonian matrix [[A, BBᵀ], [CᵀC, Aᵀ]] is balanced. The diagonal similarity is kept symplectic up to one
        factor: diag(D⁻¹, D) on state and costate, and the factor evens out the two off-diagonal blocks.
        """
        from scipy.linalg import matrix_balance

        n, b = len(self.a), np.hstack([self.b1 / gamma, self.b2])
        b_square, c_square, size = np.abs(b @ b.T), np.abs(self.c.T @ self.c), np.abs(self.a)
        hamiltonian = np.block([[size, b_square], [c_square, size.T]])
        np.fill_diagonal(hamiltonian, 0.0)
        with np.errstate(invalid="ignore"):  # SciPy reads the factors as a permutation too
            _, (factors, _) = matrix_balance(hamiltonian, permute=False, separate=True)
        exponents = np.log2(factors)
        d = np.exp2(-np.round((exponents[n:] - exponents[:n]) / 2))
        b_norm = np.linalg.norm(b_square / np.outer(d, d))
        c_norm = np.linalg.norm(c_square * np.outer(d, d))
        ratio = c_norm / b_norm if b_norm > 0 and c_norm > 0 else 1.0
        s = float(np.exp2(np.round(np.log2(ratio) / 4)))
        a, c = self.a * (d / d[:, None]), self.c * (d / s)
        b1, b2 = (b * (s / d)[:, None] for b in (self.b1, self.b2))
        return Scaling(d, s), LinearPart(a, b1, b2, c, self.state_names)

    def check(self) -> None:
        """Refuse a problem unless (A, g2) is stabilisable and (h, A) detectable.

        Raises NotStabilisable, NotDetectable: with the mode and the state it lives in.
        """
        _, balanced = self.scaled(np.inf)
        a = balanced.a
        modes = np.linalg.eigvals(a)
        for mode in modes[(modes.real >= -_DECAYS * len(a) * np.linalg.norm(a)) & (modes.imag >= 0)]:
            text = f"{mode.real:.4g}" if mode.imag == 0 else f"{mode.real:.4g} ± {abs(mode.imag):.4g}i"
            if (state := _missed_direction(a.T, balanced.b2.T, mode)) is not None:
                raise NotStabilisable(
                    "A mode that does not decay cannot be reached from the input.",
                    f"eigenvalue {text} 1/s of A, mainly in state {self.state_names[state]!r}, "
                    "has a left eigenvector orthogonal to g2, to ten digits",
                    "an input that acts on it, or leave that state out of the problem",
                )
            if (state := _missed_direction(a, balanced.c, mode)) is not None:
                raise NotDetectable(
                    "A mode that does not decay cannot be seen in the penalty.",
                    f"eigenvalue {text} 1/s of A, mainly in state {self.state_names[state]!r}, is not in h(x)",
                    f"a weight on {self.state_names[state]!r}",
                )

    def solved(self, gamma: float) -> tuple[Scaling, LinearPart, RiccatiSolution] | None:
        """`scaled`, and the stabilising P ≥ 0 of this level to about 1e-10; None where there is none.

        There is none either where g1/γ is out of proportion to the other matrices.
        """
        if not float(np.abs(self.b1).max(initial=0.0)) <= _LARGEST * gamma:
            return None
        scaling, part = self.scaled(gamma)
        b1, b2 = part.b1 / gamma, part.b2
        riccati = solve_riccati(part.a, b1 @ b1.T - b2 @ b2.T, part.c.T @ part.c)
        return None if riccati is None else (scaling, part, riccati)

    def riccati_terms(self, gamma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, M = B1 B1ᵀ/γ² − B2 B2ᵀ and Q = CᵀC in extended precision (where the machine has it)."""
        a, b1, b2, c = (matrix.astype(np.longdouble) for matrix in (self.a, self.b1, self.b2, self.c))
        b1 = b1 / np.longdouble(gamma)
        return a, b1 @ b1.T - b2 @ b2.T, c.T @ c

    def in_states(self, to_x: np.ndarray, to_y: np.ndarray) -> LinearPart:
        """The linear part in the states y of x = `to_x` y, y = `to_y` x."""
        return replace(self, a=to_y @ self.a @ to_x, b1=to_y @ self.b1, b2=to_y @ self.b2, c=self.c @ to_x)


def _missed_direction(a: np.ndarray, c: np.ndarray, mode: complex) -> int | None:
    """Largest component of a vector v with A v = λ v and C v = 0, or None if there is none."""
    _, values, directions = np.linalg.svd(np.vstack([a - mode * np.eye(len(a)), c]))
    full = values[-1] > _RANK * max(float(np.linalg.norm(a)), float(np.linalg.norm(c)))
    return None if full else int(np.argmax(np.abs(directions[-1])))


def _staircase(
    a: np.ndarray, b: np.ndarray, tolerance: float
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Orthonormal directions that b reaches, then b through A, and so on, each with its size and the norm of b or A.

    What is below `tolerance` of that norm is not reached.
    """
    reached, block, norm = np.zeros((len(a), 0)), b, float(np.linalg.norm(b))
    while reached.shape[1] < len(a):
        for _ in range(2):
            block = block - reached @ (reached.T @ block)
        left, sizes, _ = np.linalg.svd(block, full_matrices=False)
        fresh = sizes > tolerance * norm
        if not fresh.any():
            return
        yield left[:, fresh], sizes[fresh], norm
        reached, block = np.hstack([reached, left[:, fresh]]), a @ left[:, fresh]
        norm = float(np.linalg.norm(a))


def disturbance_reaches_output(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> bool:
    """Whether d influences C x at all: the subspace reached from b, built vector by vector, against C."""
    seen = _REACH * float(np.linalg.norm(c))
    return any(np.linalg.norm(c @ fresh) > seen for fresh, _, _ in _staircase(a, b, _REACH))


_RELATIVE = 1e-10  # width of the last interval; the figure promised is 1e-8
_LARGE_P = 1e3  # eigenvalue of P at γ = ∞, balanced, from which other states are sought
_SMALLEST_P = 1e-20  # eigenvalue of P, relative to the largest, up to which a state is stretched
_REACHED = 1e-13  # step of the staircase form, relative to the norm of A, below which a state is not reached
_PASSES = 3
_FACTOR = 4.0
_WIDEST = 60  # factors of four tried on either side of the first guess


def smallest_gamma(problem: Problem) -> float:
    """Smallest γ for which the Riccati equation of Eq. (8) has a stabilising solution P ≥ 0.

    Parameters
    ----------
    problem : Problem
        A generalised plant or a `PolynomialPlant`.

    Returns
    -------
    float
        γ*, 0.0 when the disturbance cannot reach z. To a relative 1e-8 where coefficients differ by up to eight orders
        of magnitude, as 40-digit arithmetic says; a mode that the input reaches only to ε relative to others, and
        that slow or unstable, costs about 1e-15/ε more: 1e-6 at ε = 1e-9. So do two such modes that are ε apart and
        share one input; below about ε = 1e-10 these count as not reached.

    Raises
    ------
    InvalidInput
        Not a problem.
    NotStabilisable, NotDetectable
        The state and the mode are named.
    NumericalFailure
        The problem is so ill-conditioned that rounding hides the solutions, which exist for every γ large enough.

    Notes
    -----
    At γ* either the Hamiltonian matrix has eigenvalues on the imaginary axis, or P has grown without bound
    while they stay off it. So existence itself is bisected, in coordinates balanced anew for every level.

    Examples
    --------
    >>> import flexhinf as fh
    >>> plant = fh.PolynomialPlant({(1,): [1.0]}, [[1.0]], [[1.0]], {(1,): [1.0]}, 1.0)
    >>> round(fh.smallest_gamma(plant), 6)  # ẋ = x + d + u, z = (x, u)
    1.0
    """
    check_problem(problem)
    return linear_smallest_gamma(LinearPart.of(problem.expand(1)))


def linear_smallest_gamma(linear: LinearPart, relative: float = _RELATIVE) -> float:
    """`smallest_gamma` of a linear part, to a relative width (coarser where many are tried)."""
    linear.check()
    stated, linear = linear, _in_value_states(linear)
    if not is_feasible(linear, float("inf")):
        raise NumericalFailure(
            "The smallest attenuation level cannot be computed: the problem is too ill-conditioned.",
            "expected a stabilising solution of the Riccati equation without disturbance (gamma = inf), which exists: "
            "every lasting mode is reached and seen; rounding hides it",
            "an input that reaches each mode that does not decay more directly; weights and inputs of comparable size",
        )
    _, balanced = stated.scaled(float("inf"))
    if not disturbance_reaches_output(balanced.a, balanced.b1, balanced.c):
        return 0.0
    low, high = _bracket(linear)
    while high - low > relative * high:
        middle = (low + high) / 2
        if not low < middle < high:
            break
        low, high = (low, middle) if is_feasible(linear, middle) else (middle, high)
    return high


def is_feasible(linear: LinearPart, gamma: float) -> bool:
    """Whether the Riccati equation of this level has a stabilising solution P ≥ 0."""
    return linear.solved(gamma) is not None


def _in_value_states(linear: LinearPart) -> LinearPart:
    """The linear part in states in which P of γ = ∞ is about the identity, where it is far from that when balanced.

    A mode almost out of reach of the input has a P of one over the square of that reach: balancing, which looks at the
    sizes of numbers, cannot see it, and the Hamiltonian matrix loses as many digits. P is rough at first, so that its
    states are sought up to `_PASSES` times.
    """
    if not is_feasible(linear, float("inf")):
        linear = _in_reached_states(linear)
    for _ in range(_PASSES):
        if (parts := linear.solved(float("inf"))) is None:
            break
        _, balanced, riccati = parts
        eigenvalues, directions = np.linalg.eigh(riccati.p)
        largest = float(eigenvalues[-1])
        if largest <= _LARGE_P:
            break
        linear = _scaled_states(
            balanced, directions, 1.0 / np.sqrt(np.maximum(np.abs(eigenvalues), _SMALLEST_P * largest))
        )
    return linear


def _in_reached_states(linear: LinearPart) -> LinearPart:
    """The linear part in orthogonal states by how v reaches them (the staircase form of A and g2), each step as large.

    Two modes ε apart are reached by one input as their sum, and their difference through an entry of size ε. In the
    modes' own states P is about 1/ε², lost to rounding below ε = 1e-8; here ε is an entry by itself, which scaling
    takes away, known to 1e-16/ε.
    """
    _, balanced = linear.scaled(float("inf"))
    directions, scale, reach = np.zeros((len(balanced.a), 0)), np.zeros(0), np.ones(1)
    for fresh, sizes, norm in _staircase(balanced.a, balanced.b2, _REACHED):
        reach = reach.min() * sizes / norm
        directions, scale = np.hstack([directions, fresh]), np.append(scale, reach)
    complement = np.linalg.svd(directions)[0][:, directions.shape[1] :]
    scale = np.append(scale, np.ones(complement.shape[1]))
    return _scaled_states(balanced, np.hstack([directions, complement]), scale)


def _scaled_states(linear: LinearPart, directions: np.ndarray, sizes: np.ndarray) -> LinearPart:
    """Linear part in y of x = `directions` diag(`sizes`) y, sizes rounded to powers of two; directions orthogonal."""
    scale = np.exp2(np.round(np.log2(sizes)))
    return linear.in_states(directions * scale, directions.T / scale[:, None])


def _bracket(linear: LinearPart) -> tuple[float, float]:
    """An infeasible and a feasible level, a factor of four apart."""
    level, feasible = 1.0, is_feasible(linear, 1.0)
    for _ in range(_WIDEST):
        other = level / _FACTOR if feasible else level * _FACTOR
        if is_feasible(linear, other) is not feasible:
            return (other, level) if feasible else (level, other)
        level = other
    if feasible:
        return 0.0, level
    raise NumericalFailure(
        "The smallest attenuation level cannot be computed: it is too large, or the problem too ill-conditioned.",
        f"found no stabilising solution up to gamma = {level:.3g}, although there is one without disturbance",
        "d reaches z through a mode almost out of reach of the input: look at weights, units, inputs",
    )
