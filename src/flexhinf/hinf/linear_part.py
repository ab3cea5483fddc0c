"""The linear part of a problem: A, g1, g2 R2^(−½), ∂h/∂x at the operating point, and what it must fulfil.

Every mode that does not decay must be reached by u and seen in z. That is tested mode by mode
(Popov–Belevitch–Hautus) in balanced coordinates, so that the error names the mode.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexhinf.errors import InvalidInput, NotDetectable, NotStabilisable
from flexhinf.hinf.riccati import RiccatiSolution, solve_riccati
from flexhinf.hinf.scaled_problem import Scaling, balance
from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.plant.problem import Problem

_DECAYS = 4.0 * float(np.finfo(float).eps)  # times n: what rounding may add to Re λ, relative to ‖A‖
_RANK = 1e-10  # smallest singular value of the pencil, relative to its norm, that counts as rank deficiency
_LARGEST = 1e70  # of a coefficient: products of its squares are finite
_REACH = 1e-11  # relative size below which a coupling from d to z is rounding


def check_problem(problem: object) -> None:
    """Raise `InvalidInput` unless this is a generalised plant."""
    usual = isinstance(problem, GeneralisedPlant | PolynomialPlant)  # a protocol takes long to ask
    if not usual and not isinstance(problem, Problem):
        raise InvalidInput(
            "This is not a problem that can be solved.",
            f"expected a generalised plant or a PolynomialPlant, got {type(problem).__name__}",
            "robot.problem(), or plant.with_objective(penalty), makes a problem",
        )


@dataclass(frozen=True)
class LinearPart:
    """ẋ = A x + B1 d + B2 v, z = (C x, v): the input is in units of its own penalty, v = lu.

    Attributes
    ----------
    a, b1, b2, c : ndarray, shapes (n, n), (n, md), (n, m), (s, n)
    """

    a: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    c: np.ndarray
    state_names: tuple[str, ...]

    @classmethod
    def of(cls, plant: PolynomialPlant) -> LinearPart:
        """Degree-1 part of the expansion.

        Raises
        ------
        InvalidInput
            A number so large that products of squares are not finite.
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
            if not largest <= _LARGEST:
                raise InvalidInput(
                    f"The linear part of {name} is out of proportion.",
                    f"expected numbers up to {_LARGEST:g}, got {largest:.3g}",
                    "other units",
                )
        return linear

    def bounds(self, gamma: float) -> bool:
        """Whether g1/γ is in proportion, as the other matrices are."""
        return float(np.abs(self.b1).max(initial=0.0)) <= _LARGEST * gamma

    def scaled(self, gamma: float) -> tuple[Scaling, LinearPart]:
        """Balanced for this level: g1 counts with its weight 1/γ."""
        scaling = balance(self.a, np.hstack([self.b1 / gamma, self.b2]), self.c)
        a, b, c = scaling.linear(self.a, np.hstack([self.b1, self.b2]), self.c)
        md = self.b1.shape[1]
        return scaling, LinearPart(a, b[:, :md], b[:, md:], c, self.state_names)

    def check(self) -> None:
        """Stabilisable from the input, detectable in the penalty; see `check_standing_assumptions`."""
        _, balanced = self.scaled(np.inf)
        check_standing_assumptions(balanced.a, balanced.b2, balanced.c, self.state_names)

    def riccati(self, gamma: float) -> RiccatiSolution | None:
        """Stabilising P ≥ 0 at this level to about 1e-10, or None. Expects balanced coordinates."""
        b1, b2 = self.b1 / gamma, self.b2
        return solve_riccati(self.a, b1 @ b1.T - b2 @ b2.T, self.c.T @ self.c)

    def riccati_terms(self, gamma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, M = B1 B1ᵀ/γ² − B2 B2ᵀ and Q = CᵀC in extended precision (where the machine has it)."""
        a, b1, b2, c = (matrix.astype(np.longdouble) for matrix in (self.a, self.b1, self.b2, self.c))
        b1 = b1 / np.longdouble(gamma)
        return a, b1 @ b1.T - b2 @ b2.T, c.T @ c

    def in_states(self, to_x: np.ndarray, to_y: np.ndarray) -> LinearPart:
        """The same in the states y of x = `to_x` y, y = `to_y` x."""
        return replace(self, a=to_y @ self.a @ to_x, b1=to_y @ self.b1, b2=to_y @ self.b2, c=self.c @ to_x)


def check_standing_assumptions(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, state_names: tuple[str, ...]
) -> None:
    """(A, g2) stabilisable and (h, A) detectable.

    Parameters
    ----------
    a, b, c : ndarray, shapes (n, n), (n, m), (s, n)
        Balanced A, g2 and ∂h/∂x.

    Raises
    ------
    NotStabilisable, NotDetectable
        With the mode and the state it lives in.
    """
    modes = np.linalg.eigvals(a)
    lasting = modes[(modes.real >= -_DECAYS * len(a) * np.linalg.norm(a)) & (modes.imag >= 0)]
    for mode in lasting:
        state = _missed_direction(a.T, b.T, mode)
        if state is not None:
            raise NotStabilisable(
                "A mode that does not decay cannot be reached from the input.",
                f"eigenvalue {_mode_text(mode)} of A, mainly in state {state_names[state]!r}, "
                "has a left eigenvector orthogonal to g2, to ten digits",
                "an input that acts on it, or leave that state out of the problem",
            )
        state = _missed_direction(a, c, mode)
        if state is not None:
            raise NotDetectable(
                "A mode that does not decay cannot be seen in the penalty.",
                f"eigenvalue {_mode_text(mode)} of A, mainly in state {state_names[state]!r}, is not in h(x)",
                f"a weight on {state_names[state]!r}",
            )


def _missed_direction(a: np.ndarray, c: np.ndarray, mode: complex) -> int | None:
    """Largest component of a vector v with A v = λ v and C v = 0, or None if there is none."""
    pencil = np.vstack([a - mode * np.eye(len(a)), c])
    _, values, directions = np.linalg.svd(pencil)
    if values[-1] > _RANK * max(float(np.linalg.norm(a)), float(np.linalg.norm(c))):
        return None
    return int(np.argmax(np.abs(directions[-1])))


def _mode_text(mode: complex) -> str:
    return f"{mode.real:.4g}" if mode.imag == 0 else f"{mode.real:.4g} ± {abs(mode.imag):.4g}i"


def disturbance_reaches_output(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> bool:
    """Whether d influences C x at all: the subspace reached from b, built vector by vector, against C."""
    seen = _REACH * float(np.linalg.norm(c))
    reached = np.zeros((len(a), 0))
    block = b
    while True:
        block = block - reached @ (reached.T @ block)
        block = block - reached @ (reached.T @ block)
        left, sizes, _ = np.linalg.svd(block, full_matrices=False)
        fresh = left[:, sizes > _REACH * (np.linalg.norm(b) if reached.shape[1] == 0 else np.linalg.norm(a))]
        if fresh.shape[1] == 0:
            return False
        if np.linalg.norm(c @ fresh) > seen:
            return True
        reached = np.hstack([reached, fresh])
        block = a @ fresh
