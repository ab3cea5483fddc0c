"""The smallest change of a design that makes a claim hold."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["smallest_change"]

#: Relative width at which the bisection stops.
TOLERANCE = 0.01


def smallest_change(
    holds: Callable[[float], bool], start: float, limit: float, factor: float = 2.0
) -> float | None:
    """Smallest value above `start` for which `holds`, to one per cent; None if there is none up to `limit`.

    The value is first multiplied by `factor` until the claim holds, then bisected between the last two: the smallest
    one if the claim, once it holds, goes on holding.
    """
    low, high = start, start * factor
    while not holds(high):
        low, high = high, high * factor
        if low >= limit:
            return None
    while high - low > TOLERANCE * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
