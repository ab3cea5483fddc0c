"""What a sampled loop does near its rest: the multipliers of one period, for many true plants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Modes"]


@dataclass(frozen=True)
class Modes:
    """Multipliers of one period, for N true plants.

    Attributes
    ----------
    period : float
        s.
    rest : (N, n + s) array
        State of the loop at rest (true plant, then the memory of `SampledController`); NaN where there is none.
    multipliers : (N, K) complex array
        Eigenvalues of one period; infinite where the loop has no rest.
    """

    period: float
    rest: np.ndarray
    multipliers: np.ndarray

    @property
    def radius(self) -> np.ndarray:
        """Largest |multiplier|, (N,)."""
        return np.abs(self.multipliers).max(axis=1)

    @property
    def stable(self) -> np.ndarray:
        """Which loops are stable, (N,)."""
        return self.radius < 1.0

    @property
    def rate(self) -> np.ndarray:
        """log(radius) / period, (N,) in 1/s: positive for a loop that grows, infinite for one without rest."""
        return np.log(self.radius) / self.period

    def slowest(self, count: int) -> np.ndarray:
        """The `count` slowest exponents log(multiplier) / period, (N, count) in 1/s."""
        order = np.argsort(-np.abs(self.multipliers), axis=1, kind="stable")[:, :count]
        chosen = np.take_along_axis(self.multipliers, order, axis=1)
        with np.errstate(invalid="ignore"):
            return np.log(chosen) / self.period
