"""A physical number with its unit, tolerance and source."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flexhinf.errors import InvalidInput
from flexhinf.untrusted import HUGE, checked_text, is_real, real_array, value_text


class PlantValues(dict[str, Any]):
    """Parameters of a plant by name, and the numbers of the robot that they come from.

    A plant knows of a payload only that a link is heavier; the robot knows it by its own name.

    Parameters
    ----------
    values : mapping
        Numbers and arrays.
    numbers : mapping of str to float
        Every parameter of the robot by name.
    """

    def __init__(self, values: Mapping[str, Any], numbers: Mapping[str, float]) -> None:
        super().__init__(values)
        self.numbers = dict(numbers)


@dataclass(frozen=True)
class Parameter:
    """One row of a table like the paper's Tables 1 and 2.

    Parameters
    ----------
    value : float
        Nominal value, in `unit` (SI).
    tolerance : float
        Half width of the interval of possible values, in per cent of the nominal value.
    unit, source : str
        Where the number comes from, or "assumption".
    range : (lower, upper), optional
        Instead of a tolerance: the interval itself, in `unit`. It need not be symmetric, and the nominal value may be
        zero or at an end: a payload of 0 to 3 kg.

    Raises
    ------
    InvalidInput
        For a value that is not finite, a tolerance outside 0 ≤ tolerance < 100, or a range without the value.
    """

    name: str
    value: float
    tolerance: float = 0.0
    unit: str = ""
    source: str = "assumption"
    range: tuple[float, float] | None = None

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

        if self.range is not None:
            object.__setattr__(self, "range", self._checked_range(self.range))

    def _checked_range(self, given: Any) -> tuple[float, float]:
        """Two numbers with the nominal value between them."""
        ends = real_array(given)
        if ends.shape != (2,) or not -HUGE <= ends[0] <= self.value <= ends[1] <= HUGE:
            raise InvalidInput(
                f"The range of {self.name!r} does not hold its value.",
                f"expected [lower, upper] with lower <= {self.value:g} <= upper, got {value_text(given)}",
                f"a range about the nominal value, in {self.unit or 'SI units'}",
            )
        if self.tolerance:
            raise InvalidInput(
                f"The parameter {self.name!r} has a tolerance and a range.",
                f"expected one of them, got {self.tolerance:g} per cent and {value_text(given)}",
                "one of the two",
            )
        lower, upper = ends.tolist()
        return lower, upper

    def at(self, sign: float) -> float:
        """The value at −1 (lower end), 0 (nominal), 1 (upper end), or linearly between two of these."""
        if self.range is None:
            return self.value + sign * abs(self.value) * self.tolerance / 100.0
        share = abs(sign)
        return (1.0 - share) * self.value + share * self.range[sign > 0.0]  # the ends to the last bit

    @property
    def interval(self) -> tuple[float, float]:
        """Smallest and largest possible value."""
        return self.at(-1.0), self.at(1.0)

    @property
    def spread(self) -> str:
        """The interval as text: "± 12 %", "0 to 3"; empty for an exact number."""
        if self.range is not None:
            return f"{self.range[0]:g} to {self.range[1]:g}"
        return f"± {self.tolerance:g} %" if self.tolerance else ""


def checked_signs(
    uncertain: Sequence[Parameter], signs: Mapping[str, float] | Sequence[float]
) -> Mapping[str, float]:
    """Signs of a corner by name, each within [−1, 1].

    Raises
    ------
    InvalidInput
        For another number of signs than uncertain parameters, or a sign that is too large.
    """
    if not isinstance(signs, Mapping):
        names = [parameter.name for parameter in uncertain]
        if len(signs) != len(names):
            raise InvalidInput(
                "A corner needs one sign per uncertain parameter.",
                f"expected one for each of {names}, got {len(signs)}",
                "a sign, −1, 0 or 1, for each",
            )
        signs = dict(zip(names, signs, strict=True))
    for name, sign in signs.items():
        if not -1.0 <= sign <= 1.0:
            raise InvalidInput(
                f"The sign for {name!r} leaves its tolerance.",
                f"expected −1 to 1, got {sign!r}",
                "−1, 0 or 1",
            )
    return signs
