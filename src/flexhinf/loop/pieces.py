"""A motion from rest to rest in pieces of constant snap, and its moving average."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

__all__ = ["Pieces", "moved"]

#: Powers of a piece: position, velocity, acceleration, jerk, snap.
POWERS = 5


class Pieces(NamedTuple):
    """Polynomials of degree four, one after the other.

    Attributes
    ----------
    times : ndarray, (K,)
        Where each begins, s; the last one is held for ever, before the first one its value.
    states : ndarray, (K, 5)
        Position and four derivatives at the beginning of each; the snap is constant.
    """

    times: np.ndarray
    states: np.ndarray

    def __call__(self, t: np.ndarray, order: int) -> np.ndarray:
        """The derivative of an order at times (N,), from the right where it jumps."""
        if order >= POWERS:
            return np.zeros(np.shape(t))
        index = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, None)
        since = np.maximum(t - self.times[index], 0.0)
        value = np.zeros(np.shape(t))
        for k in reversed(range(order, POWERS)):
            value = value * since + self.states[index, k] / math.factorial(k - order)
        return np.where(t < self.times[0], self.states[0, 0] if order == 0 else 0.0, value)


def moved(start: float, goal: float, lengths: np.ndarray, jerks: np.ndarray, average: float) -> Pieces:
    """The motion from rest at `start` with phases of constant jerk, averaged over the last `average` seconds.

    The jerk of a moving average rises by (j(t) − j(t − T))/T, which is constant between the corners of both.

    Parameters
    ----------
    start, goal : float
        What rounding leaves of the way to the goal is made up for by a scale.
    lengths, jerks : ndarray, (K,)
        Of the phases, s.
    average : float
        T, s; none for zero.
    """
    corners = np.concatenate([[0.0], np.cumsum(lengths)])

    def jerk(t: float) -> float:
        phase = int(np.searchsorted(corners, t, side="right")) - 1
        return float(jerks[phase]) if 0 <= phase < len(jerks) else 0.0

    times = np.unique(np.concatenate([corners, corners + average]))
    states = np.zeros((len(times), POWERS))
    for k, (begin, end) in enumerate(pairwise(times)):
        middle, h = 0.5 * (begin + end), end - begin
        if average:
            states[k, 4] = (jerk(middle) - jerk(middle - average)) / average
        else:
            states[k, 3] = jerk(middle)
        for order in range(4):
            terms = [
                states[k, m] * h ** (m - order) / math.factorial(m - order) for m in range(order, POWERS)
            ]
            states[k + 1, order] = sum(terms)
    way = states[-1, 0]
    states[-1] = 0.0
    states *= (goal - start) / way if way else 0.0
    states[:, 0] += start
    states[-1, 0] = goal
    return Pieces(times, states)
