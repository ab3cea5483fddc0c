"""Kalman filters of others with the interface of ours: `correct(y)`, `predict((u,))`, `mean`, `covariance`.

FilterPy is used as it is. LowLevelParticleFilters.jl is a library for Julia; its algorithms (version 3.31.1, files
filtering.jl, ukf.jl and sq_kalman.jl) are written down again in NumPy, operation by operation, and called so. Square
roots of P0, Q and R are given to every filter that carries them, so that a singular one is no reason to raise.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from filterpy import kalman
from fuzz.hostile_filters import Case

from benchmarks import peers
from flexhinf.estimation.square_root import root_rows

#: The unscented transform of all filters that have one: α, β, κ.
SCALING = (1.0, 2.0, 0.0)


class Other:
    """A filter of x⁺ = F x + g u, y = C x, with the noises of a case; F (n, n) and g (n,) in floats."""

    def __init__(self, case: Case, f: np.ndarray, g: np.ndarray) -> None:
        self.f, self.g, self.c, self.q, self.r = f, g, case.c, case.q, case.r
        self.mean, self.covariance = np.zeros(len(g)), case.p0.copy()


def _lower(covariance: np.ndarray) -> np.ndarray:
    """L (n, n), lower triangular, with L Lᵀ a covariance, singular ones too."""
    return np.linalg.qr(root_rows(covariance), mode="r").T


# FilterPy ---------------------------------------------------------------------------------------------
class FilterPy(Other):
    """``filterpy.kalman.KalmanFilter``: Joseph's form, as the library has it."""

    def __init__(self, case: Case, f: np.ndarray, g: np.ndarray) -> None:
        super().__init__(case, f, g)
        self.peer: Any = self.made(case)

    def made(self, case: Case) -> Any:
        """FilterPy's object."""
        peer = kalman.KalmanFilter(dim_x=len(self.g), dim_z=len(self.c), dim_u=1)
        peer.x, peer.P = np.zeros((len(self.g), 1)), case.p0.copy()
        peer.F, peer.B, peer.H, peer.Q, peer.R = self.f, self.g[:, None], self.c, self.q, self.r
        return peer

    def correct(self, y: np.ndarray) -> None:
        """Measurement update."""
        self.peer.update(y[:, None])
        self.mean, self.covariance = self.peer.x[:, 0].copy(), self.peer.P

    def predict(self, u: Any) -> None:
        """Time update."""
        self.peer.predict(np.array(u)[:, None])
        self.mean, self.covariance = self.peer.x[:, 0].copy(), self.peer.P


class FilterPySquareRoot(FilterPy):
    """``filterpy.kalman.SquareRootKalmanFilter``."""

    def made(self, case: Case) -> Any:
        """FilterPy's object, with square roots of ours."""
        peer = kalman.SquareRootKalmanFilter(dim_x=len(self.g), dim_z=len(self.c), dim_u=1)
        peer.F, peer.B, peer.H = self.f, self.g[:, None], self.c
        peer._P1_2, peer._Q1_2, peer._R1_2 = (_lower(matrix) for matrix in (case.p0, self.q, self.r))
        return peer


class FilterPyUnscented(FilterPy):
    """``filterpy.kalman.UnscentedKalmanFilter`` with the points of ours."""

    def made(self, case: Case) -> Any:
        """FilterPy's object."""
        points = kalman.MerweScaledSigmaPoints(len(self.g), *SCALING)
        peer = kalman.UnscentedKalmanFilter(
            len(self.g), len(self.c), case.period, lambda x: self.c @ x, self.moved, points
        )
        peer.x, peer.P, peer.Q, peer.R = np.zeros(len(self.g)), case.p0.copy(), self.q, self.r
        return peer

    def moved(self, x: np.ndarray, _: float, u: float = 0.0) -> np.ndarray:
        """F x + g u."""
        return self.f @ x + self.g * u

    def correct(self, y: np.ndarray) -> None:
        """Measurement update, of points drawn again: without that it is no Kalman filter."""
        self.peer.sigmas_f = self.peer.points_fn.sigma_points(self.peer.x, self.peer.P)
        self.peer.update(y)
        self.mean, self.covariance = self.peer.x.copy(), self.peer.P

    def predict(self, u: Any) -> None:
        """Time update."""
        self.peer.predict(u=u[0])
        self.mean, self.covariance = self.peer.x.copy(), self.peer.P


# LowLevelParticleFilters.jl, written down again -----------------------------------------------------------
def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return 0.5 * (matrix + matrix.T)


def _divided(left: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """left S⁻¹; raises where S has no Cholesky factor, as Julia's `issuccess` tells, NaN included."""
    if np.isnan(spread).any():
        raise np.linalg.LinAlgError("NaN")
    factor = np.linalg.cholesky(spread)
    return np.linalg.solve(factor.T, np.linalg.solve(factor, left.T)).T


class JuliaKalman(Other):
    """KalmanFilter: P = (I − K C) P, made symmetric."""

    def correct(self, y: np.ndarray) -> None:
        """`correct!`; raises where S has no Cholesky factor."""
        spread = _symmetric(self.c @ self.covariance @ self.c.T) + self.r
        gain = _divided(self.covariance @ self.c.T, spread)
        self.mean = self.mean + gain @ (y - self.c @ self.mean)
        self.covariance = _symmetric((np.eye(len(self.g)) - gain @ self.c) @ self.covariance)

    def predict(self, u: Any) -> None:
        """`predict!`."""
        self.mean = self.f @ self.mean + self.g * u[0]
        self.covariance = _symmetric(self.f @ self.covariance @ self.f.T) + self.q


class JuliaUnscented(Other):
    """UnscentedKalmanFilter with its default weights (TrivialParams): P = P − K S Kᵀ, made symmetric."""

    def points(self) -> np.ndarray:
        """`sigmapoints!`, (2n + 1, n); NaN where P has no Cholesky factor."""
        n = len(self.g)
        try:
            offsets = np.linalg.cholesky(n * self.covariance).T
        except np.linalg.LinAlgError:
            return np.full((2 * n + 1, n), np.nan)
        return np.vstack([self.mean, self.mean + offsets, self.mean - offsets])

    def correct(self, y: np.ndarray) -> None:
        """`correct!`; raises where S has no Cholesky factor."""
        points = self.points()
        outputs, weight = points @ self.c.T, 1.0 / (len(points) - 1)
        expected = outputs.mean(axis=0)
        apart = outputs - expected
        spread = _symmetric(weight * apart.T @ apart) + self.r
        gain = _divided(weight * (points - self.mean).T @ apart, spread)
        self.mean = self.mean + gain @ (y - expected)
        self.covariance = _symmetric(self.covariance - gain @ spread @ gain.T)

    def predict(self, u: Any) -> None:
        """`predict!`."""
        points = self.points() @ self.f.T + self.g * u[0]
        self.mean = points.mean(axis=0)
        apart = points - self.mean
        self.covariance = _symmetric(apart.T @ apart / (len(points) - 1)) + self.q


class JuliaSquareRoot(Other):
    """SqKalmanFilter, QR decompositions alone [tracy2022]; `root`: U with P = Uᵀ U."""

    def __init__(self, case: Case, f: np.ndarray, g: np.ndarray) -> None:
        super().__init__(case, f, g)
        self.root, self.root_q, self.root_r = (_lower(matrix).T for matrix in (case.p0, self.q, self.r))

    def correct(self, y: np.ndarray) -> None:
        """`correct!`."""
        root, c = self.root, self.c
        s = np.linalg.qr(np.vstack([root @ c.T, self.root_r]), mode="r")
        gain = np.linalg.solve(s, np.linalg.solve(s.T, (root.T @ (root @ c.T)).T)).T
        self.mean = self.mean + gain @ (y - c @ self.mean)
        left = np.vstack([root @ (np.eye(len(self.g)) - gain @ c).T, self.root_r @ gain.T])
        self.keep(np.linalg.qr(left, mode="r"))

    def predict(self, u: Any) -> None:
        """`predict!`."""
        self.mean = self.f @ self.mean + self.g * u[0]
        self.keep(np.linalg.qr(np.vstack([self.root @ self.f.T, self.root_q]), mode="r"))

    def keep(self, root: np.ndarray) -> None:
        """Take over a root."""
        self.root, self.covariance = root, root.T @ root


#: Methods by what a table calls them.
OTHERS: dict[str, type[Other]] = {
    "FilterPy, KalmanFilter": FilterPy,
    "FilterPy, SquareRootKalmanFilter": FilterPySquareRoot,
    "FilterPy, UnscentedKalmanFilter": FilterPyUnscented,
    "LowLevelParticleFilters.jl in NumPy, KalmanFilter": JuliaKalman,
    "LowLevelParticleFilters.jl in NumPy, SqKalmanFilter": JuliaSquareRoot,
    "LowLevelParticleFilters.jl in NumPy, UnscentedKalmanFilter": JuliaUnscented,
}


# Dynamax, in an environment of its own ----------------------------------------------------------------------
class Dynamax:
    """Dynamax in another process: means and variances of a case, by the name of a method; see ``peer.py``."""

    def __init__(self) -> None:
        command = [str(peers.PYTHON), str(Path(__file__).parent / "peer.py")]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.version = self._answer()

    def close(self) -> None:
        """End the process."""
        self.process.communicate()

    def _answer(self) -> Any:
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())

    def estimates(self, case: Case, f: np.ndarray, g: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Means and variances (N, n) after each sample's correction, by method."""
        arrays = {
            "f": f,
            "g": g,
            "c": case.c,
            "q": case.q,
            "r": case.r,
            "p0": case.p0,
            "u": case.u,
            "y": case.y,
        }
        assert self.process.stdin is not None
        print(json.dumps({k: a.tolist() for k, a in arrays.items()}), file=self.process.stdin, flush=True)
        return {name: (np.array(m), np.array(v)) for name, (m, v) in self._answer().items()}

    @staticmethod
    def there() -> bool:
        """Whether it is installed."""
        return not peers.missing("dynamax")
