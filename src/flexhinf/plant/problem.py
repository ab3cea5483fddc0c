"""What synthesis needs to know of a plant with an objective."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from flexhinf.plant.polynomial_plant import PolynomialPlant


@runtime_checkable
class Problem(Protocol):
    """A generalised plant, Eq. (3), in deviations from an operating point.

    ẋ = f(x) + g1(x) d + g2(x) u,   z = (h(x), l(x) u),   lᵀl = R2,   f(0) = 0, h(0) = 0::

            d ──►┌───────┐──► z
                 │ plant │
            u ──►└───────┘──► x
             ▲                │
             └──── law ◄──────┘

    Attributes
    ----------
    state_names : sequence of str, length n
    operating_point : ndarray, shape (n,)
    r2 : ndarray, shape (m, m)
    """

    @property
    def state_names(self) -> tuple[str, ...]:
        """One name per state."""
        ...

    @property
    def operating_point(self) -> np.ndarray:
        """The point deviations are measured from, shape (n,)."""
        ...

    @property
    def r2(self) -> np.ndarray:
        """Weight of the input, shape (m, m)."""
        ...

    def expand(self, degree: int) -> PolynomialPlant:
        """Taylor expansion: f and h through `degree`, g1 and g2 through `degree` − 1."""
        ...

    def fields(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Exact f (N, n), g1 (N, n, md), g2 (N, n, m) and h (N, s) at deviations `x` (N, n)."""
        ...
