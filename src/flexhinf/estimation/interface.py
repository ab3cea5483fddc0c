"""A filter as its diagnosis and its machine code see it."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.plant import Parameters, Plant
from flexhinf.plant.protocols import Belief
from flexhinf.scalars.run import Run

#: What a belief carries beside its mean, see `RecursiveFilter`.
Form = Literal["square_root", "covariance"]


class Filter(Protocol):
    """What `flexhinf.estimation.diagnosis` and `flexhinf.estimation.compiled` use of a `RecursiveFilter`, which imports
    both of them."""

    plant: Plant
    process_noise: np.ndarray
    measurement_noise: np.ndarray
    sample_periods: np.ndarray
    gate: float | None
    initial: Belief
    _belief: Belief
    _parameters: Parameters
    _start: np.ndarray

    @property
    def form(self) -> Form:
        """What a belief carries beside its mean."""
        ...

    @property
    def estimator_key(self) -> str:
        """What distinguishes the code of two filters of one class."""
        ...

    @property
    def says_digits(self) -> bool:
        """Whether digits that a correction loses are an entry of the diagnosis."""
        ...

    @property
    def mean(self) -> np.ndarray:
        """Estimate x̂, (n,)."""
        ...

    @property
    def covariance(self) -> np.ndarray:
        """Covariance P, (n, n)."""
        ...

    def reset(self) -> None:
        """Back to the belief before the first measurement."""
        ...

    def predict(self, u: ArrayLike | None = None) -> None:
        """Time update with the input u (m,)."""
        ...

    def correct(self, y: ArrayLike | None) -> None:
        """Measurement update with y (p,)."""
        ...

    def initial_at(self, mean: ArrayLike) -> Belief:
        """The initial belief with another mean (n,)."""
        ...

    def time_stages(
        self, run: Run, belief: Belief, u: Elements, p: Elements, process_noise: Elements
    ) -> Belief:
        """x(k|k) → x(k+1|k) on a run."""
        ...

    def innovation_stages(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, measurement_noise: Elements
    ) -> tuple[Belief, Elements, Elements]:
        """x(k|k−1) → (x(k|k), innovation, its covariance) on a run."""
        ...

    def _input(self, u: ArrayLike | None) -> np.ndarray: ...

    def _measurement(self, y: ArrayLike | None) -> np.ndarray: ...
