"""Limits of the input, and of what a user may give for a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput

__all__ = ["Limits", "positive"]


def positive(value: Any, what: str, example: str) -> float:
    """A positive finite number of seconds."""
    try:
        seconds = float(value)
    except (TypeError, ValueError):
        seconds = np.nan
    if not (np.isfinite(seconds) and seconds > 0.0):
        raise InvalidInput(f"The {what} is not positive.", f"expected seconds > 0, got {value!r}", example)
    return seconds


@dataclass(frozen=True, eq=False)
class Limits:
    """Lower and upper limits of the input, (m,) each, infinite where there is none."""

    lower: np.ndarray
    upper: np.ndarray

    @staticmethod
    def of(saturation: Any, inputs: int) -> Limits:
        """From None, a number (±), an array with one number (±) per input, or a tuple (lower, upper) of them.

        Raises
        ------
        InvalidInput
            If shapes do not fit, or lower < upper does not hold.
        """
        if saturation is None:
            return Limits(np.full(inputs, -np.inf), np.full(inputs, np.inf))
        pair = isinstance(saturation, tuple) and len(saturation) == 2
        lower, upper = (_edge(part, inputs) for part in (saturation if pair else (saturation, saturation)))
        lower = lower if pair else -upper
        if not np.all(lower < upper):
            raise InvalidInput(
                "The saturation leaves no room for the input.",
                f"expected lower < upper, got lower={lower.tolist()}, upper={upper.tolist()}",
                "saturation=48.0 for ±48, or saturation=(lower, upper)",
            )
        return Limits(lower, upper)


def _edge(value: Any, inputs: int) -> np.ndarray:
    try:
        return np.array(np.broadcast_to(np.asarray(value, dtype=float), (inputs,)))
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            "The saturation does not fit the inputs.",
            f"expected one number or {inputs}, got {value!r}",
            "saturation=48.0 for ±48, or saturation=(lower, upper)",
        ) from error
