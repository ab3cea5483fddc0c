"""Standing assumptions on the linear part: every mode that does not decay is reached by u and seen in z.

Tested mode by mode (Popov–Belevitch–Hautus) in balanced coordinates, so that the error names the mode.
"""

from __future__ import annotations

import numpy as np

from flexhinf.errors import InvalidInput, NotDetectable, NotStabilisable
from flexhinf.plant.problem import Problem

__all__ = ["check_problem", "check_standing_assumptions", "disturbance_reaches_output"]

_DECAYS = 1e-9  # modes with Re λ above −_DECAYS·‖A‖ count as not decaying
_RANK = 1e-10  # smallest singular value of the pencil, relative to its norm, that counts as rank deficiency
_REACH = 1e-11  # relative size below which a coupling from d to z is rounding


def check_problem(problem: object) -> None:
    """Raise `InvalidInput` unless this is a generalised plant."""
    if not isinstance(problem, Problem):
        raise InvalidInput(
            "This is not a problem that can be solved.",
            f"expected a generalised plant or a PolynomialPlant, got {type(problem).__name__}",
            "robot.problem(), or plant.with_objective(penalty), makes a problem",
        )


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
    lasting = modes[(modes.real >= -_DECAYS * np.linalg.norm(a)) & (modes.imag >= 0)]
    for mode in lasting:
        state = _missed_direction(a.T, b.T, mode)
        if state is not None:
            raise NotStabilisable(
                "A mode that does not decay cannot be reached from the input.",
                f"eigenvalue {_mode_text(mode)} of A, mainly in state {state_names[state]!r}, "
                "has a left eigenvector orthogonal to g2",
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
