"""The peer: the same closed loop with filterpy's UKF and NumPy, written as its users write it."""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

__all__ = ["FilterpyLoop"]


class FilterpyLoop:
    """Plant by RK4, UKF with the paper's α, β, κ, polynomial law; the order of steps is that of our controller.

    Parameters
    ----------
    period : float
    exponents, coefficients : arrays, (Nmon, 5), (Nmon,)
        The law as monomials.
    """

    def __init__(
        self, period: float, q: float, r: float, exponents: np.ndarray, coefficients: np.ndarray
    ) -> None:
        self.period, self.exponents, self.coefficients = period, exponents, coefficients
        points = MerweScaledSigmaPoints(4, alpha=1.0, beta=2.0, kappa=0.0)
        self.ukf = UnscentedKalmanFilter(4, 1, period, hx=lambda x: x[:1], fx=self.advance, points=points)
        self.ukf.Q, self.ukf.R = q * np.eye(4), np.array([[r]])
        self.reset()

    def reset(self) -> None:
        """Start again at rest."""
        self.ukf.x, self.ukf.P = np.zeros(4), 1e-4 * np.eye(4)
        self.ukf.sigmas_f = self.ukf.points_fn.sigma_points(self.ukf.x, self.ukf.P)
        self.integral, self.previous, self.started = 0.0, 0.0, False

    @staticmethod
    def flow(x: np.ndarray, u: float) -> np.ndarray:
        """The paper's arm, Sec. 6."""
        q, dq, theta, dtheta = x
        return np.array(
            [dq, -9.8 * np.sin(q) - 100.0 * (q - theta), dtheta, 100.0 * (q - theta) - dtheta + 0.9 * u]
        )

    def advance(self, x: np.ndarray, dt: float, u: float = 0.0) -> np.ndarray:
        """One Runge–Kutta step."""
        k1 = self.flow(x, u)
        k2 = self.flow(x + dt / 2 * k1, u)
        k3 = self.flow(x + dt / 2 * k2, u)
        k4 = self.flow(x + dt * k3, u)
        return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def step(self, y: float, reference: float) -> float:
        """Correct, integrate the error, evaluate the law, predict."""
        self.ukf.update(np.array([y]))
        if self.started:
            self.integral += self.period * (0.5 * (self.previous + y) - reference)
        self.previous, self.started = y, True
        state = np.append(self.ukf.x, self.integral)
        u = float(self.coefficients @ np.prod(state**self.exponents, axis=1))
        self.ukf.predict(u=u)
        return u

    def run(self, noise: np.ndarray, reference: float) -> np.ndarray:
        """Inputs (N,) of a closed loop of N steps."""
        self.reset()
        x, inputs = np.zeros(4), np.empty(len(noise))
        for k, v in enumerate(noise):
            inputs[k] = u = self.step(x[0] + v, reference)
            x = self.advance(x, self.period, u)
        return inputs

    def settings(self) -> dict[str, Any]:
        """What it is, for the record."""
        import filterpy

        return {"filterpy": filterpy.__version__, "numpy": np.__version__}
