"""What a word on the command line means: names, numbers, angles, frequencies, weights."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from flexhinf.errors import InvalidInput

__all__ = ["angles", "bandwidths", "names", "numbers", "unless", "weights"]


def names(text: str) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def numbers(
    what: str, text: str, kind: Callable[[str], Any] = float, example: str = "60,0,0,0,300"
) -> tuple[Any, ...]:
    """Numbers between commas.

    Raises
    ------
    InvalidInput
        If one of them is none.
    """
    try:
        return tuple(kind(part) for part in text.split(","))
    except ValueError:
        raise InvalidInput(
            f"The {what} cannot be read.", f"expected numbers between commas, got {text!r}", example
        ) from None


def weights(what: str, text: str) -> dict[str, Any] | tuple[Any, ...] | None:
    """Weights by name, or numbers, between commas; None for nothing."""
    if "=" not in text:
        return numbers(what, text) if text else None
    named = {}
    for part in text.split(","):
        name, _, value = part.partition("=")
        named[name.strip()] = numbers(what, value)[0]
    return named


def angles(what: str, text: str) -> tuple[float, ...]:
    """Angles between commas, in rad, or in degrees with the suffix deg."""

    def angle(part: str) -> float:
        part = part.strip()
        return math.radians(float(part.removesuffix("deg"))) if part.endswith("deg") else float(part)

    return numbers(what, text, angle, "0.3,-0.5 in rad, or 30deg,-20deg")


def bandwidths(text: str) -> float | tuple[float, ...] | None:
    """One bandwidth, or one per joint, rad/s: plain, or with the suffix rad/s or Hz; None for nothing."""

    def bandwidth(part: str) -> float:
        part = part.strip()
        if part.lower().endswith("hz"):
            return 2.0 * math.pi * float(part[:-2])
        return float(part.removesuffix("rad/s"))

    if not text:
        return None
    found = numbers("bandwidth", text, bandwidth, "--bandwidth 4 in rad/s, one per joint 4,6, or 0.6Hz")
    return found[0] if len(found) == 1 else found


def unless(nothing: Any, value: Any) -> Any:
    """None for the value that stands for nothing asked."""
    return None if value == nothing else value
