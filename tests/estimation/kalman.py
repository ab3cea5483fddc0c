"""Random linear plants, and the Kalman filter in NumPy: what filters of linear plants are compared with."""

from dataclasses import dataclass

import numpy as np
from tests.builders import linear_plant


@dataclass
class LinearCase:
    """A random linear plant, correlated noise covariances and a first belief; `scale` is a standard deviation."""

    n: int
    m: int
    p: int
    seed: int = 0
    scale: float = 1.0
    period: float = 0.02

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        self.a = rng.normal(size=(self.n, self.n)) - 1.5 * np.eye(self.n)
        self.b = rng.normal(size=(self.n, self.m))
        self.c = rng.normal(size=(self.p, self.n))
        self.q, self.r, self.p0 = (
            self.covariance(rng, size, self.scale) for size in (self.n, self.p, self.n)
        )
        self.mean = self.scale * rng.normal(size=self.n)
        self.rng = rng

    @staticmethod
    def covariance(rng, size, scale):
        root = rng.normal(size=(size, size))
        return scale**2 * (root @ root.T + 0.1 * np.eye(size))

    @property
    def plant(self):
        return linear_plant(self.a, self.b, self.c)

    def arguments(self, **changes):
        values = {
            "plant": self.plant, "period": self.period, "process_noise": self.q, "measurement_noise": self.r,
            "mean": self.mean, "covariance": self.p0,
        }  # fmt: skip
        return {**values, **changes}

    def map(self, stages, sub_steps):
        """The Runge–Kutta map x → F x + G u as matrices: Taylor's exponential to order four or eight, per sub-step."""
        h, eye = self.period / sub_steps, np.eye(self.n)
        one = drive = eye
        for k in range(stages, 0, -1):
            drive = one
            one = eye + h / k * self.a @ one
        f, g, drive = eye, np.zeros_like(self.b), h * drive @ self.b
        for _ in range(sub_steps):
            f, g = one @ f, one @ g + drive
        return f, g


def predict(mean, covariance, f, g, u, q):
    return f @ mean + g @ u, f @ covariance @ f.T + q


def correct(mean, covariance, c, y, r):
    s = c @ covariance @ c.T + r
    gain = np.linalg.solve(s, c @ covariance).T
    rest = np.eye(len(mean)) - gain @ c
    return mean + gain @ (y - c @ mean), rest @ covariance @ rest.T + gain @ r @ gain.T


def relative(mean, covariance, other_mean, other_covariance):
    """Largest difference of two beliefs, in standard deviations and correlations of the second."""
    spread = np.sqrt(np.diag(other_covariance))
    spread = np.where(spread > 0.0, spread, 1.0)
    first = np.abs(mean - other_mean) / np.maximum(spread, np.abs(other_mean))
    return max(first.max(), (np.abs(covariance - other_covariance) / np.outer(spread, spread)).max())
