"""Numbers and units as people write them, drawn usual or hostile, and what they mean by decimal fractions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from typing import Any

import numpy as np

__all__ = ["HOSTILE", "UNITS", "USUAL", "RandomText", "meaning"]

USUAL = ("0", "0.3", "-0.2", "1e-3", ".5", "+0.7", "2", "0.05", "1.5", "12")
HOSTILE = (
    "", " ", "-0.0", "1e400", "-1e400", "1e-300", "5e-324", "1e31", "1e308", "nan", "inf", "-inf", "infinity",
    "9" * 400, "9" * 5000, "1_0", "0x10", "1e", "e5", "1,5", "1;5", "true", "True", "None", "٣", "½", "1 2", "--1",
    "1\x00", "$1$", "=1", "1e-31", "-1", "1000", "90",
)  # fmt: skip
#: SI unit of each unit, and what one is in it; degrees and revolutions are turned by π afterwards.
UNITS: dict[str, tuple[str, str]] = {
    "": ("", "1"), "rad": ("rad", "1"), "deg": ("rad", "deg"), "°": ("rad", "deg"), "mrad": ("rad", "0.001"),
    "m": ("m", "1"), "mm": ("m", "0.001"), "rad/s": ("rad/s", "1"), "deg/s": ("rad/s", "deg"), "°/s": ("rad/s", "deg"),
    "rpm": ("rad/s", "rpm"), "m/s": ("m/s", "1"), "mm/s": ("m/s", "0.001"), "Nm": ("N·m", "1"), "N": ("N", "1"),
}  # fmt: skip
FOREIGN = ("cm", "in", "grad", "s", "kg", "%", "rad rad", "mm²", "\x1b", "deg°", "µm", "N/m")


class RandomText:
    """Texts of numbers, drawn so that about one in `rare` is hostile, with what they mean."""

    def __init__(self, rng: np.random.Generator, rare: float = 0.04) -> None:
        self.rng, self.rare = rng, rare

    def one(self, choices: Sequence[Any]) -> Any:
        """One of the choices."""
        return choices[self.rng.integers(len(choices))]

    def hostile(self) -> bool:
        """Whether something hostile is to be drawn now."""
        return bool(self.rng.random() < self.rare)

    def number(self) -> str:
        """A number, or what looks like one."""
        return self.one(HOSTILE) if self.hostile() else self.one(USUAL)

    def unit(self, kinds: Sequence[str]) -> str:
        """A unit of one of the kinds, or another one."""
        if self.hostile():
            return self.one((*FOREIGN, *UNITS))
        return self.one([unit for unit, (si, _) in UNITS.items() if si in ("", *kinds)])


def meaning(number: str, unit: str = "") -> float | None:
    """The number in SI units by decimal fractions; None where this is no number, or none of the units."""
    try:
        decimal = Decimal(number.strip())
    except InvalidOperation:
        return None
    if "_" in number or unit not in UNITS:
        return None
    try:
        value = float(decimal)
    except (OverflowError, ValueError):
        return None
    if math.isinf(value) and "inf" not in number.lower():
        return None
    turned = {"deg": math.pi / 180.0, "rpm": math.pi / 30.0}
    scale = UNITS[unit][1]
    return value * turned[scale] if scale in turned else value * float(Decimal(scale))
