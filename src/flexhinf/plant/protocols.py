"""What a closed loop asks of a law and of an estimator. Rooms that know only this can be exchanged freely."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from flexhinf.plant.plant import Plant

__all__ = ["Estimator", "Gaussian", "Law"]


class Gaussian(NamedTuple):
    """A belief about the state: mean (n,) and covariance (n, n), of numbers or of any element."""

    mean: Any
    covariance: Any


@runtime_checkable
class Law(Protocol):
    """A state feedback u = u* + k(x − x*), readable on any element.

    The states are those of the plant followed by one integral ``NAME_integral`` per tracked state.

    A law of many monomials may also have a method ``law_polynomial()``: the
    `flexhinf.polynomial.law.PolynomialLaw` of which its `law_data` are the coefficients. Kernels then evaluate
    that in loops; without it, `evaluate_law` is traced.

    A law that depends on where it acts, not only on the deviation, may also have
    ``evaluate_about(x, state, input, data)``: k(x), (m,), for a deviation x (n,), integrals last, from a reference
    state (n without integrals,) and its input (m,), of any element. Then u = input + k, k = 0 for x = 0, and
    `evaluate_law` is the same about (x*, u*). A moving reference needs it; without it, k is taken to be a function of
    the deviation alone.
    """

    @property
    def state_names(self) -> tuple[str, ...]:
        """States of the plant, then integrals."""
        ...

    @property
    def input_names(self) -> tuple[str, ...]:
        """One name per input."""
        ...

    @property
    def operating_point(self) -> np.ndarray:
        """x*, (n,), integrals included."""
        ...

    @property
    def operating_input(self) -> np.ndarray:
        """u*, (m,)."""
        ...

    @property
    def law_data(self) -> np.ndarray:
        """Numbers the law is made of, flat: data of a kernel, so a new γ recompiles nothing."""
        ...

    @property
    def law_key(self) -> str:
        """What distinguishes the code of two laws (not their data)."""
        ...

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """k(x), shape (m,), for a deviation x (n,) of numbers or of any element."""
        ...


@runtime_checkable
class Estimator(Protocol):
    """A recursive estimator as two pure functions of frozen values.

    An estimator of many states may also have ``time_stages(run, belief, u, p, process_noise)`` and
    ``measurement_stages(run, belief, y, u, p, measurement_noise)``, the same updates written against a run
    (`flexhinf.codegen.Direct`, `Composer`) and with the parameters as a vector, and ``operations``, roughly what one
    trace of both would have. Kernels are then composed of pieces in loops; without them, an update is one trace.

    Attributes
    ----------
    plant : Plant
        The model it believes in.
    period : float
        Between two samples, s.
    process_noise, measurement_noise : ndarray, (n, n) and (p, p)
        R^v and R^n.
    initial : Gaussian
        x(0|−1), or a named tuple that begins as one.
    """

    plant: Plant
    period: float
    process_noise: np.ndarray
    measurement_noise: np.ndarray
    initial: Gaussian

    @property
    def estimator_key(self) -> str:
        """What distinguishes the code of two estimators (not their data)."""
        ...

    def initial_at(self, mean: np.ndarray) -> Gaussian:
        """The initial belief with another mean (n,)."""
        ...

    def time_update(self, belief: Gaussian, u: Any, p: Any, process_noise: Any) -> Gaussian:
        """x(k|k) → x(k+1|k)."""
        ...

    def measurement_update(
        self, belief: Gaussian, y: Any, u: Any, p: Any, measurement_noise: Any
    ) -> Gaussian:
        """x(k|k−1) → x(k|k)."""
        ...
