"""Plants that several tests of the synthesis share."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flexhinf.plant.polynomial_plant import PolynomialPlant


def _key(n: int, **powers: int) -> tuple[int, ...]:
    return tuple(powers.get(f"x{i + 1}", 0) for i in range(n))


def _arm(order: int) -> PolynomialPlant:
    """Sec. 6 with the sine expanded through `order`."""
    f = {
        _key(5, x1=1): [0, -9.8 - 100, 0, 100, 1],
        _key(5, x2=1): [1, 0, 0, 0, 0],
        _key(5, x3=1): [0, 100, 0, -100, 0],
        _key(5, x4=1): [0, 0, 1, -1, 0],
    }
    for k in range(3, order + 1, 2):
        f[_key(5, x1=k)] = [0, -9.8 * (-1) ** ((k - 1) // 2) / math.factorial(k), 0, 0, 0]
    h = {_key(5, x1=1): [60, 0], _key(5, x5=1): [0, 300]}
    return PolynomialPlant(f, [[0], [0], [0], [0], [-1.0]], [[0], [0], [0], [0.9], [0]], h, [[10.0]])


class PaperArm:
    """The same with the sine itself."""

    state_names = ("x1", "x2", "x3", "x4", "x5")
    operating_point = np.zeros(5)
    r2 = np.array([[10.0]])

    def expand(self, degree: int) -> PolynomialPlant:
        return _arm(degree)

    def fields(self, x):
        x1, x2, x3, x4, _ = x.T
        f = np.stack([x2, -9.8 * np.sin(x1) - 100 * (x1 - x3), x4, 100 * (x1 - x3) - x4, x1], axis=1)
        g1 = np.broadcast_to(np.array([[0], [0], [0], [0], [-1.0]]), (len(x), 5, 1))
        g2 = np.broadcast_to(np.array([[0], [0], [0], [0.9], [0]]), (len(x), 5, 1))
        return f, g1, g2, np.stack([60 * x1, 300 * x[:, 4]], axis=1)


@pytest.fixture(scope="session")
def arm() -> PaperArm:
    """The paper's arm with exact fields."""
    return PaperArm()


def _random_plant(rng: np.random.Generator, n: int, m: int = 2, degree: int = 3) -> PolynomialPlant:
    """Dense random f, g1(x), g2(x), h(x) with every degree present."""

    def coefficients(*shape: int, top: int, size: float):
        keys = [k for k in np.ndindex(*(top + 1,) * n) if sum(k) <= top]
        return {k: size * rng.standard_normal(shape) for k in keys}

    f = {k: v for k, v in coefficients(n, top=degree, size=0.2).items() if sum(k)}
    linear = rng.standard_normal((n, n)) / np.sqrt(n) - 0.5 * np.eye(n)
    for j in range(n):
        f[tuple(int(i == j) for i in range(n))] = linear[:, j]
    h = {k: v for k, v in coefficients(n + 1, top=degree, size=0.2).items() if sum(k)}
    for j in range(n):
        h[tuple(int(i == j) for i in range(n))] = np.eye(n + 1, n)[:, j]
    factor = rng.standard_normal((m, m))
    g1, g2 = (coefficients(n, columns, top=degree - 1, size=0.3) for columns in (m + 1, m))
    return PolynomialPlant(f, g1, g2, h, factor @ factor.T + np.eye(m))


@pytest.fixture
def random_plant():
    """Maker of dense random plants: (rng, n, m, degree)."""
    return _random_plant
