"""The two floating-point types of C as text: constants, and the names of the mathematical functions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flexhinf.errors import InvalidInput


@dataclass(frozen=True)
class Real:
    """``double`` or ``float``.

    Parameters
    ----------
    name : {"double", "float"}
    """

    name: Literal["double", "float"]

    @property
    def suffix(self) -> str:
        """Of constants, and of the functions of ``<math.h>``: nothing is computed in double in a float build."""
        return "" if self.name == "double" else "f"

    @property
    def bytes(self) -> int:
        """Of one number."""
        return 8 if self.name == "double" else 4

    @property
    def epsilon(self) -> float:
        """Distance from 1 to the next number."""
        return float(np.finfo(np.float64 if self.name == "double" else np.float32).eps)


def constant(value: float, real: Real) -> str:
    """A number as C writes it; read back, it is the nearest one of this type.

    Raises
    ------
    InvalidInput
        If it is NaN, or lies beyond the type.
    """
    if math.isinf(value):
        huge = f"HUGE_VAL{real.suffix.upper()}"
        return huge if value > 0.0 else f"-{huge}"
    with np.errstate(over="ignore", under="ignore"):
        number = float(value) if real.name == "double" else np.float32(value)
    if not np.isfinite(number) or (value != 0.0 and number == 0.0):
        raise InvalidInput(
            f"A number does not fit C's type {real.name}.",
            f"expected magnitudes from 1e-45 to 3e38, or 0, got {value:g}",
            "the type double, or other units",
        )
    text = repr(float(number)) if real.name == "double" else np.format_float_scientific(number, trim="-")
    if "." not in text and "e" not in text:
        text += ".0"
    return text + real.suffix
