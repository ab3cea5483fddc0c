"""Sigma points and their weights, Eq. (10)."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.untrusted import read_only


@dataclass(frozen=True)
class SigmaPoints:
    """The scaled unscented transform of n variables.

    Parameters
    ----------
    n : int
        Number of variables; there are 2n + 1 points.
    alpha, beta, kappa : float
        Table 3. λ = α²(n + κ) − n; the paper's γ = √(n + λ) of Eq. (10) is `spread` here, because γ is also
        the attenuation level.

    Raises
    ------
    InvalidInput
        If the spread is not a positive number.
    """

    n: int
    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        if not (
            self.alpha > 0.0
            and self.n + self.kappa > 0.0
            and math.isfinite(self.beta + self.alpha + self.kappa)
        ):
            raise InvalidInput(
                "These scaling parameters give no sigma points.",
                f"expected finite numbers with alpha > 0 and kappa > {-self.n}, got alpha={self.alpha}, "
                f"beta={self.beta}, kappa={self.kappa}",
                "the paper's alpha=1, beta=2, kappa=0",
            )
        if self.covariance_weights.min() < 0.0:
            warnings.warn(
                f"The central covariance weight is negative ({self.covariance_weights[0]:.4g}): the "
                "estimated covariance may become indefinite. With alpha=1, beta=2, kappa=0 none is negative.",
                stacklevel=4,
            )

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(read_only(state))  # copies share their arrays

    @cached_property
    def spread(self) -> float:
        """√(n + λ)."""
        return self.alpha * math.sqrt(self.n + self.kappa)

    @cached_property
    def mean_weights(self) -> np.ndarray:
        """Wᵐ, (2n + 1,)."""
        total = self.spread**2
        return read_only(np.array([(total - self.n) / total] + [0.5 / total] * (2 * self.n)))

    @cached_property
    def covariance_weights(self) -> np.ndarray:
        """Wᶜ, (2n + 1,)."""
        weights = self.mean_weights.copy()
        weights[0] += 1.0 - self.alpha**2 + self.beta
        return read_only(weights)

    def offsets(self, column: Any) -> tuple[Any, Any]:
        """Deviations of two points from the mean, for a column of a square root of P."""
        offset = self.spread * column
        return offset, -offset

    def pair(self, column: Any, mean: Any) -> tuple[Any, Any]:
        """These two points."""
        offset, other = self.offsets(column)
        return mean + offset, mean + other
