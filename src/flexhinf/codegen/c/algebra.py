"""What every text of C is written with: types of numbers, constants, comments, places."""

from __future__ import annotations

import math
import re
from typing import Literal

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.scalars.symbol import PIVOT_TOLERANCE


class Real:
    """``double`` or ``float``: the end of constants and of the names of ``<math.h>``, bytes, NumPy's type, and the
    distance from 1 to the next number. Nothing is computed in double in a float build. `written`: What its file calls
    it."""

    def __init__(self, name: Literal["double", "float"], written: str = "") -> None:
        self.name: Literal["double", "float"] = name
        self.written = written or name
        self.suffix, self.bytes = ("", 8) if name == "double" else ("f", 4)
        self.kind: type[np.floating] = np.float64 if name == "double" else np.float32
        self.epsilon = float(np.finfo(self.kind).eps)


def _single(value: float) -> np.float32:
    with np.errstate(over="ignore", under="ignore"):
        return np.float32(value)


def constant(value: float, real: Real) -> str:
    """A number as C writes it; read back, it is the nearest one of this type.

    Raises InvalidInput: if it is NaN, or lies beyond the type.
    """
    if math.isinf(value):
        huge = f"HUGE_VAL{real.suffix.upper()}"
        return huge if value > 0.0 else f"-{huge}"
    number = float(value) if real.name == "double" else _single(value)
    if not math.isfinite(number) or (value != 0.0 and number == 0.0):
        raise InvalidInput(
            f"A number does not fit C's type {real.name}.",
            f"expected magnitudes from 1e-45 to 3e38, or 0, got {value:g}",
            "the type double, or other units",
        )
    if real.name == "double":
        text = repr(number)
    elif number == 0.0 or 1e-4 <= abs(number) < 1e7:
        text = np.format_float_positional(number, trim="0")
    else:
        text = np.format_float_scientific(number, trim="-")
    if "." not in text and "e" not in text:
        text += ".0"
    return text + real.suffix


#: Exponents, which stand behind one sign.
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")

#: How characters of units, names and formulas are written in ASCII.
ASCII = str.maketrans(
    {
        "·": " ",
        "Ω": "Ohm",
        "°": "deg",
        "µ": "u",
        "−": "-",
        "±": "+-",
        "×": "x",
        "→": "->",
        "≤": "<=",
        "≥": ">=",
        "ᵀ": "^T",
        "⁻": "^-",
        "ᵢ": "_i",
        "Σ": "sum",
        "√": "sqrt ",
        "∂": "d",
        "½": "1/2",
        "γ": "gamma",
        "θ": "theta",
        "π": "pi",
        "σ": "sigma",
        "Δ": "delta",
        "ν": "nu",
        "…": "...",
        "\u0302": "",
        "λ": "lambda",
        "Λ": "Lambda",
        "ℓ": "l",
        "ξ": "xi",
        "τ": "tau",
        "ω": "omega",
        "ẋ": "dx/dt",
        "⁺": "^+",
        "ₖ": "_k",
    }
)


def comment(text: str) -> str:
    """A text made safe for a comment of one line: printable ASCII that neither ends nor continues it."""
    raised = re.sub("⁻?[⁰¹²³⁴-⁹]+", lambda found: "^" + found[0].translate(RAISED), text)
    plain = "".join(c if " " <= c <= "~" else "?" for c in raised.translate(ASCII))
    return re.sub(r"\*(?=/)|/(?=\*)|\?(?=\?)", r"\g<0> ", plain.replace("\\", "/"))


#: A pivot below so many times what it is made of, times n, counts as zero: 45 units of the last place.
#: As `flexhinf.scalars.cholesky` in double, which says what it means.
PIVOT_ULPS = 45.0


def pivot_tolerance(real: Real) -> float:
    """What a pivot is compared with, as a part of what it is made of, over n."""
    return PIVOT_TOLERANCE if real.name == "double" else PIVOT_ULPS * real.epsilon


#: Multiples of a tolerance of double up to which a constant is one.
MULTIPLES = 64


def tolerance(value: float, real: Real) -> float:
    """A constant of traced code in a type: a tolerance of double, which is far below the digits of float, is as many
    units of the last place there."""
    times = abs(value) / PIVOT_TOLERANCE
    known = 0.5 < times < MULTIPLES + 0.5 and abs(times - round(times)) < 1e-9
    return value / PIVOT_TOLERANCE * pivot_tolerance(real) if known and real.name == "float" else value


def ahead(place: str, count: int) -> str:
    """A place in C so many elements further."""
    return f"{place} + {count}" if count else place


def element(place: str) -> str:
    """The number at a place in C."""
    return f"{place}[0]" if place.isidentifier() else f"*({place})"


#: Where memory of rows begins at a multiple of 16 bytes, as every allocation does there.
SIXTEEN = "(defined(__GNUC__) || defined(__clang__)) && defined(__x86_64__)"

#: Definitions by the word that needs them: places that nothing else reaches, for which C++ has no word of its own;
#: functions that are not put into their callers; and rows of lanes, which vectors of a PC are read from as a whole.
MACROS = {
    "ALIGNED": f"""#if {SIXTEEN}
#define ALIGNED(type, place) ((type)__builtin_assume_aligned((place), 16))
#else
#define ALIGNED(type, place) (place)
#endif
""",
    "RESTRICT": """#ifdef __cplusplus
#define RESTRICT __restrict
#else
#define RESTRICT restrict
#endif
""",
    "NOINLINE": """#if defined(__GNUC__) || defined(__clang__)
#define NOINLINE __attribute__((noinline))
#elif defined(_MSC_VER)
#define NOINLINE __declspec(noinline)
#else
#define NOINLINE
#endif
""",
}
