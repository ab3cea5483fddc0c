"""A physical number with its unit, tolerance and source."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flexhinf.errors import InvalidInput
from flexhinf.untrusted import HUGE, checked_text, is_real, real_array, value_text

__all__ = ["Parameter"]


@dataclass(frozen=True)
class Parameter:
    """One row of a table like the paper's Tables 1 and 2.

    Parameters
    ----------
    name : str
    value : float
        Nominal value, in `unit` (SI).
    tolerance : float
        Half width of the interval of possible values, in per cent of the nominal value.
    unit, source : str
        Where the number comes from, or "assumption".

    Raises
    ------
    InvalidInput
        For a value that is not finite, or a tolerance outside 0 ≤ tolerance < 100.
    """

    name: str
    value: float
    tolerance: float = 0.0
    unit: str = ""
    source: str = "assumption"

    def __post_init__(self) -> None:
        checked_text("the name of a parameter", self.name)
        checked_text(f"the unit of {self.name!r}", self.unit)
        checked_text(f"the source of {self.name!r}", self.source)
        if not (is_real(self.value) and math.isfinite(real_array(self.value))):
            raise InvalidInput(
                f"The parameter {self.name!r} is not finite.",
                f"expected a finite number, got {value_text(self.value)}",
                "correct the value",
            )
        if abs(self.value) > HUGE:
            raise InvalidInput(
                f"The parameter {self.name!r} is out of all proportion.",
                f"expected a magnitude of at most {HUGE:g} {self.unit}".rstrip() + f", got {self.value:g}",
                "its value in SI units",
            )
        if not (is_real(self.tolerance) and 0.0 <= self.tolerance < 100.0):
            raise InvalidInput(
                f"The tolerance of {self.name!r} is not a percentage.",
                f"expected 0 to below 100 per cent, got {value_text(self.tolerance)}",
                "12 for ±12 %",
            )

    def at(self, sign: float) -> float:
        """The value at −1 (lower end), 0 (nominal), 1 (upper end) or between."""
        return self.value + sign * abs(self.value) * self.tolerance / 100.0

    @property
    def interval(self) -> tuple[float, float]:
        """Smallest and largest possible value."""
        return self.at(-1.0), self.at(1.0)
