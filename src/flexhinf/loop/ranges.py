"""Commands within the ranges of what they command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flexhinf.errors import InvalidInput

__all__ = ["check_ranges"]

#: A command may pass a limit by this share of the range: rounding.
ROUNDING = 1e-9


def check_ranges(
    commands: np.ndarray,
    times: np.ndarray,
    names: Sequence[str],
    limits: Mapping[str, tuple[float, float]],
    units: Mapping[str, str],
) -> None:
    """Refuse commands (N, k) that leave the range of a state.

    Parameters
    ----------
    commands : ndarray, (N, k)
    times : ndarray, (N,)
        s.
    names : sequence of str
        Of the columns.
    limits : mapping of str to (float, float)
        By name; what is not named has none.
    units : mapping of str to str
        For the message.

    Raises
    ------
    InvalidInput
        Naming the state, the first time, the value and the range.
    """
    for name, column in zip(names, commands.T):
        if name not in limits:
            continue
        low, high = limits[name]
        slack = ROUNDING * (high - low)
        outside = np.flatnonzero((column < low - slack) | (column > high + slack))
        if len(outside):
            unit, first = units.get(name, ""), outside[0]
            raise InvalidInput(
                f"The reference leaves the range of {name!r}.",
                f"expected {low:g} to {high:g} {unit}, got {column[first]:.6g} {unit} at t = {times[first]:g} s",
                "a command within the joint's limits; angles are in rad",
            )
