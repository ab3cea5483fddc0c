"""Vectors of many rows with their derivatives by some common variables: the chain rule, written once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

__all__ = ["Dual", "stacked", "variables"]


@dataclass(frozen=True)
class Dual:
    """Values and derivatives.

    Attributes
    ----------
    value : (N, k) array
    by : (N, k, w) array
        Derivatives by w variables.
    """

    value: np.ndarray
    by: np.ndarray

    def __add__(self, other: Dual) -> Dual:
        return Dual(self.value + other.value, self.by + other.by)

    def __sub__(self, other: Dual) -> Dual:
        return Dual(self.value - other.value, self.by - other.by)

    def __getitem__(self, part: slice) -> Dual:
        """Some of the entries."""
        return Dual(self.value[:, part], self.by[:, part])

    def times(self, factor: np.ndarray) -> Dual:
        """Each row by a number, (N,)."""
        return Dual(factor[:, None] * self.value, factor[:, None, None] * self.by)

    def moved(self, matrix: np.ndarray) -> Dual:
        """By a constant matrix (j, k)."""
        return Dual(self.value @ matrix.T, matrix @ self.by)

    def plus(self, constant: np.ndarray) -> Dual:
        """With a constant (k,) or (N, k) added."""
        return Dual(self.value + constant, self.by)

    def through(self, function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Dual:
        """f of it, for an f that gives values (N, j) and slopes (N, j, k)."""
        value, slope = function(self.value)
        return Dual(value, slope @ self.by)


def variables(*values: np.ndarray) -> tuple[Dual, ...]:
    """The variables themselves: arrays (N, k) that follow each other."""
    width = sum(value.shape[1] for value in values)
    unit, start, found = np.eye(width), 0, []
    for value in values:
        stop = start + value.shape[1]
        found.append(Dual(value, np.broadcast_to(unit[start:stop], (len(value), stop - start, width))))
        start = stop
    return tuple(found)


def stacked(*parts: Dual) -> Dual:
    """Behind each other."""
    return Dual(np.hstack([p.value for p in parts]), np.concatenate([p.by for p in parts], axis=1))
