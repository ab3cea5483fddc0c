"""The shell around two pure functions: an object with `predict` and `correct` that remembers its belief."""

from __future__ import annotations

import abc
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.plant import Gaussian, Plant, rk4_step, sub_steps
from flexhinf.scalars import cholesky, solve_lower

__all__ = ["RecursiveFilter", "covariance_matrix"]

#: Largest step times fastest mode inside the estimator's model: RK4 is far inside its stability region (2.78).
MODEL_STEP = 0.25


def covariance_matrix(value: Any, size: int, what: str, definite: bool = False) -> np.ndarray:
    """A covariance from a number, a diagonal or a matrix.

    Raises
    ------
    InvalidInput
        If it is not symmetric positive semidefinite (positive definite if `definite`) of this size.
    """
    array = np.asarray(value, dtype=float)
    matrix = (
        array
        if array.ndim == 2
        else np.diag(np.broadcast_to(array, (size,)) if array.size in (1, size) else array)
    )
    if matrix.shape != (size, size):
        raise InvalidInput(
            f"The {what} has the wrong size.",
            f"expected a number, {size} variances or a ({size}, {size}) matrix, got shape {array.shape}",
            "one variance per signal",
        )
    if not np.all(np.isfinite(matrix)) or not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
        raise InvalidInput(
            f"The {what} is not a symmetric matrix of finite numbers.", f"got {matrix.tolist()}", "variances"
        )
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    scale = float(np.abs(matrix).max(initial=0.0))
    if smallest < -1e-12 * scale or (definite and smallest <= 0.0):
        kind = "positive definite" if definite else "positive semidefinite"
        raise InvalidInput(
            f"The {what} is not {kind}.",
            f"expected eigenvalues {'>' if definite else '>='} 0, got a smallest one of {smallest:.3g}",
            "variances (squares of standard deviations), each positive",
        )
    return (matrix + matrix.T) / 2.0


class RecursiveFilter(abc.ABC):
    """An estimator of a plant's state from sampled measurements.

    Between samples the plant is integrated by the classical Runge–Kutta method with u held.

    Parameters
    ----------
    plant : Plant
        The model the estimator believes in.
    period : float
        Sampling period, s.
    process_noise : float, (n,) or (n, n) array
        R^v, the covariance added at each time step.
    measurement_noise : float, (p,) or (p, p) array
        R^n, covariance of a measurement.
    mean, covariance : (n,) and float, (n,) or (n, n) array
        Belief before the first measurement, x(0|−1).

    Raises
    ------
    InvalidInput
        If shapes do not fit the plant, or a covariance is not one.
    """

    def __init__(
        self,
        plant: Plant,
        period: float,
        process_noise: Any,
        measurement_noise: Any,
        mean: Any,
        covariance: Any,
    ) -> None:
        if not (np.isfinite(period) and period > 0.0):
            raise InvalidInput("The sampling period is not positive.", f"got {period!r} s", "1e-3 for 1 kHz")
        self.plant, self.period = plant, float(period)
        self.process_noise = covariance_matrix(process_noise, plant.n, "process noise R^v")
        self.measurement_noise = covariance_matrix(
            measurement_noise, len(plant.outputs), "measurement noise R^n", definite=True
        )
        start = np.array(mean, dtype=float)
        if start.shape != (plant.n,) or not np.all(np.isfinite(start)):
            raise InvalidInput(
                "The initial mean does not fit the plant.",
                f"expected {plant.n} finite values for {list(plant.states)}, got {mean!r}",
                "one value per state of the plant (the integral of the error is not estimated)",
            )
        self.sub_steps = sub_steps(self.period, plant.fastest_mode(start), MODEL_STEP)
        self.initial: Any = Gaussian(start, covariance_matrix(covariance, plant.n, "initial covariance"))
        self._belief: Any = self.initial
        self._u = np.zeros(len(plant.inputs))
        self._parameters = plant.parameters.named(plant.parameters.vector())
        self.log_likelihood = float("nan")

    # What an estimator is -------------------------------------------------------------------------------------
    @abc.abstractmethod
    def time_update(self, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        """x(k|k) → x(k+1|k), pure, on any element."""

    @abc.abstractmethod
    def innovate(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> tuple[Any, Any, Any]:
        """x(k|k−1) → (x(k|k), innovation, its covariance), pure, on any element."""

    @property
    @abc.abstractmethod
    def estimator_key(self) -> str:
        """What distinguishes this estimator's code from another's."""

    def measurement_update(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> Any:
        """x(k|k−1) → x(k|k), pure, on any element."""
        return self.innovate(belief, y, u, p, measurement_noise)[0]

    def transition(self, x: Any, u: Any, p: Any) -> Any:
        """F of Eq. (9): the plant over one period with u held."""
        step = self.period / self.sub_steps
        still = np.zeros(len(self.plant.disturbances))
        for _ in range(self.sub_steps):
            x = rk4_step(lambda s, v: self.plant.flow(s, v, still, p), x, (u, u, u), step)
        return x

    # The shell ------------------------------------------------------------------------------------------------
    @property
    def mean(self) -> np.ndarray:
        """Estimate x̂, (n,)."""
        return np.array(self._belief.mean, dtype=float)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance P, (n, n)."""
        return np.array(self._belief.covariance, dtype=float)

    def predict(self, u: Any) -> None:
        """Time update with the input u (m,) held over the period."""
        self._u = self._vector(u, len(self.plant.inputs), "input")
        self._accept(self.time_update(self._belief, self._u, self._parameters, self.process_noise))

    def correct(self, y: Any) -> None:
        """Measurement update with y (p,); sets `log_likelihood` of this measurement."""
        y = self._vector(y, len(self.plant.outputs), "measurement")
        belief, innovation, spread = self.innovate(
            self._belief, y, self._u, self._parameters, self.measurement_noise
        )
        self._accept(belief)
        factor = cholesky(np.asarray(spread, dtype=float))
        white = solve_lower(factor, np.asarray(innovation, dtype=float))
        constant = len(y) * np.log(2.0 * np.pi)
        self.log_likelihood = float(-0.5 * (white @ white + constant) - np.log(np.diag(factor)).sum())

    def reset(self) -> None:
        """Back to the belief before the first measurement."""
        self._belief = self.initial
        self._u = np.zeros_like(self._u)
        self.log_likelihood = float("nan")

    def _vector(self, value: Any, size: int, what: str) -> np.ndarray:
        array = np.atleast_1d(np.asarray(value, dtype=float))
        if array.shape != (size,) or not np.all(np.isfinite(array)):
            raise InvalidInput(
                f"The {what} given to the estimator does not fit.",
                f"expected {size} finite numbers, got {value!r}",
                "skip `correct` for a sample without a measurement",
            )
        return array

    def _accept(self, belief: Any) -> None:
        if not all(np.all(np.isfinite(np.asarray(part, dtype=float))) for part in belief):
            raise NumericalFailure(
                "The estimate is no longer finite: its covariance is not positive semidefinite, or the model diverged.",
                f"last finite mean {np.array2string(self.mean, precision=4)}",
                "a larger process noise, a shorter period, or a smaller initial covariance",
            )
        self._belief = belief
