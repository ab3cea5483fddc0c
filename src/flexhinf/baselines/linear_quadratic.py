"""LQR of a problem's linear part: the problem's own weights, and no disturbance thought of (γ = ∞)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.baselines.equilibrium_law import LinearFeedback, equilibrium_of
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.plant import GeneralisedPlant
from flexhinf.untrusted import read_only, real_array


def lqr_gain(problem: GeneralisedPlant, effort: float = 1.0) -> np.ndarray:
    """K (m, n) of u = K x that minimises ½∫ hᵀh + uᵀ R2 u for the problem's linear part.

    K = −R2⁻¹ Bᵀ P with AᵀP + PA + HᵀH − P B R2⁻¹ Bᵀ P = 0 [anderson1990].

    Parameters
    ----------
    effort : float
        Factor of R2, the one tuning parameter of an LQR: the larger, the less effort.

    Raises
    ------
    InvalidInput
        If the factor is not positive.
    NumericalFailure
        If there is no stabilising solution: a mode that the input does not move or the penalty does not see.
    """
    from scipy.linalg import solve_continuous_are

    if not (np.isfinite(effort) and effort > 0.0):
        raise InvalidInput(
            "The factor of the effort is not positive.",
            f"expected a number > 0, got {effort!r}",
            "effort=1.0",
        )
    linear = problem.expand(1)
    a, b, h = linear.f_parts[1], linear.g2_parts[0][:, :, 0], linear.h_parts[1]
    r2 = effort * problem.r2
    try:
        p = solve_continuous_are(a, b, h.T @ h, r2)
        gain = -np.linalg.solve(r2, b.T @ p)
        slowest = float(np.linalg.eigvals(a + b @ gain).real.max())
    except np.linalg.LinAlgError as error:
        raise _unsolved(problem, str(error)) from error
    if not slowest < 0.0:
        raise _unsolved(problem, f"closed loop with a mode at {slowest:.3g} 1/s")
    return read_only(gain)


def _unsolved(problem: GeneralisedPlant, got: str) -> NumericalFailure:
    return NumericalFailure(
        "The problem has no LQR.",
        f"expected a stabilising solution of the Riccati equation for {list(problem.state_names)}, got: {got}",
        "a weight on every integral and on one position of each joint",
    )


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LinearQuadratic(LinearFeedback):
    """u = u* + K (x − x*).

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`.
    gains : (m, n) array
        K, integrals included.
    """

    gains: Any

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(
            self, "gains", checked_gain(self.gains, len(self.input_names), len(self.state_names))
        )

    @property
    def gain(self) -> np.ndarray:
        """K, (m, n)."""
        return self.gains


def lqr(problem: GeneralisedPlant, effort: float = 1.0) -> LinearQuadratic:
    """The LQR of a problem, of any plant; see `lqr_gain`."""
    return LinearQuadratic(
        plant=problem.plant,
        equilibrium=equilibrium_of(problem),
        integrate=problem.integrate,
        gains=lqr_gain(problem, effort),
    )


def checked_gain(value: Any, inputs: int, states: int) -> np.ndarray:
    """A finite gain (m, n).

    Raises
    ------
    InvalidInput
        For anything else.
    """
    gain = real_array(value)
    if gain.shape != (inputs, states) or not np.all(np.isfinite(gain)):
        raise InvalidInput(
            "The gain does not fit the law's states and inputs.",
            f"expected finite numbers of shape ({inputs}, {states}), got shape {gain.shape}",
            "one row per input and one column per state, integrals included",
        )
    return gain
