"""Taylor coefficients of the elementary functions of one variable, about a point, to any degree.

Each function returns the coefficients c₀ … c_degree of φ(x₀ + t) = Σ cₖ tᵏ, shape (degree + 1,), by
closed form or by the recurrence of the function's differential equation. Where φ is not analytic, or not
real, it raises `InvalidInput`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np

from flexhinf.errors import InvalidInput

Series = Callable[[float, int], np.ndarray]

#: Where a function is real and analytic, if not everywhere: between two numbers.
DOMAINS = {
    "arcsin": (-1.0, 1.0, "inside (-1, 1)"), "arccos": (-1.0, 1.0, "inside (-1, 1)"),
    "arctanh": (-1.0, 1.0, "inside (-1, 1)"), "arccosh": (1.0, math.inf, "> 1"), "log": (0.0, math.inf, "> 0"),
    "log1p": (-1.0, math.inf, "> -1"), "log10": (0.0, math.inf, "> 0"), "sqrt": (0.0, math.inf, "> 0"),
}  # fmt: skip

#: Functions whose derivatives repeat: even ones are the first function, odd ones the second, with these signs.
CYCLES = {
    "sin": (math.sin, math.cos, (1, 1, -1, -1)),
    "cos": (math.cos, math.sin, (1, -1, -1, 1)),
    "sinh": (math.sinh, math.cosh, (1, 1, 1, 1)),
    "cosh": (math.cosh, math.sinh, (1, 1, 1, 1)),
    "exp": (math.exp, math.exp, (1, 1, 1, 1)),
    "expm1": (math.exp, math.exp, (1, 1, 1, 1)),
}

#: Inverse functions, φ' = ± qᵖ with a quadratic q = a + b x²: their value, a, b, p and the sign.
INVERSES = {
    "arcsin": (math.asin, 1, -1, -0.5, 1),
    "arccos": (math.acos, 1, -1, -0.5, -1),
    "arctan": (math.atan, 1, 1, -1.0, 1),
    "arcsinh": (math.asinh, 1, 1, -0.5, 1),
    "arccosh": (math.acosh, -1, 1, -0.5, 1),
    "arctanh": (math.atanh, 1, -1, -1.0, 1),
}


@lru_cache(64)
def _factorials(degree: int) -> np.ndarray:
    return np.array([float(math.factorial(k)) for k in range(degree + 1)])


def _require(condition: bool, name: str, point: float, domain: str) -> None:
    if not condition:
        raise InvalidInput(
            f"The function {name} has no real Taylor series at the point of the expansion.",
            f"expected an argument {domain} there, got {point:.17g}",
            "another point of expansion, or a form of the model that is smooth at this one",
        )


def _integrated(first: float, derivative: np.ndarray, degree: int) -> np.ndarray:
    """Coefficients of the function with the given value and the given coefficients of its derivative."""
    result = np.empty(degree + 1)
    result[0] = first
    result[1:] = derivative[:degree] / np.arange(1, degree + 1)
    return result


def _power_of_quadratic(q0: float, q1: float, q2: float, exponent: float, degree: int) -> np.ndarray:
    """Coefficients of y = qᵖ for q = q₀ + q₁ t + q₂ t², q₀ > 0.

    From q y' = p q' y: k q₀ yₖ = (p − k + 1) q₁ yₖ₋₁ + (2p − k + 2) q₂ yₖ₋₂.
    """
    y = np.zeros(degree + 1)
    y[0] = q0**exponent
    for k in range(1, degree + 1):
        y[k] = (exponent - k + 1) * q1 * y[k - 1]
        if k > 1:
            y[k] += (2 * exponent - k + 2) * q2 * y[k - 2]
        y[k] /= k * q0
    return y


def _tangent(name: str, x: float, degree: int) -> np.ndarray:
    """tan and tanh, y' = 1 ± y²; the slope of tanh is formed as 1 / cosh², which does not cancel."""
    if name == "tan":
        first, slope, sign = math.tan(x), 1.0 + math.tan(x) ** 2, 1.0
    else:
        slope = (2.0 / (math.exp(x) + math.exp(-x))) ** 2 if abs(x) < 300.0 else 0.0
        first, sign = math.tanh(x), -1.0
    y = np.array([first, slope, *[0.0] * (degree - 1)])[: degree + 1]
    for k in range(1, degree):
        y[k + 1] = sign * (y[: k + 1] @ y[k::-1]) / (k + 1)
    return y


def _coefficients(name: str, x: float, degree: int) -> np.ndarray:
    if name in CYCLES:
        even, odd, signs = CYCLES[name]
        values = even(x), odd(x)
        result = np.array([signs[k % 4] * values[k % 2] for k in range(degree + 1)]) / _factorials(degree)
        if name == "expm1":
            result[0] = math.expm1(x)
        return result
    if name in INVERSES:
        value, a, b, exponent, sign = INVERSES[name]
        if a == b:
            q0 = 1 + x * x
        else:
            q0 = (1 - x) * (1 + x) if a > 0 else (x - 1) * (x + 1)
        derivative = _power_of_quadratic(q0, 2 * b * x, float(b), exponent, degree)
        return _integrated(value(x), sign * derivative, degree)
    if name in ("tan", "tanh"):
        return _tangent(name, x, degree)
    if name == "sqrt":
        return power(x, 0.5, degree)
    if name == "log1p":
        return _integrated(math.log1p(x), power(1.0 + x, -1, degree), degree)
    natural = _integrated(math.log(x), power(x, -1, degree), degree)
    return natural / math.log(10.0) if name == "log10" else natural


def _series(name: str, x: float, degree: int) -> np.ndarray:
    """A function by its name; refuses a point outside of its domain, or where it leaves the finite numbers."""
    _require(math.isfinite(x), name, x, "that is finite")
    low, high, domain = DOMAINS.get(name, (-math.inf, math.inf, ""))
    _require(low < x < high, name, x, domain)
    try:
        return _coefficients(name, x, degree)
    except OverflowError:
        _require(False, name, x, "whose result is finite")
        raise


def power(x: float, exponent: float, degree: int) -> np.ndarray:
    """x^exponent: any x for a whole exponent ≥ 0, x ≠ 0 for a negative one, x > 0 for a fraction."""
    name, exponent = "1/x" if exponent == -1 else f"x**{exponent:g}", float(exponent)
    _require(math.isfinite(x) and math.isfinite(exponent), name, x, "that is finite, and so the exponent,")
    try:
        if exponent.is_integer() and exponent >= 0:
            top = int(exponent)
            terms = [math.comb(top, k) * x ** (top - k) if k <= top else 0.0 for k in range(degree + 1)]
            return np.array(terms)
        whole = exponent.is_integer()
        _require(x != 0.0 if whole else x > 0.0, name, x, "different from zero" if whole else "> 0")
        result = np.empty(degree + 1)
        result[0] = math.sqrt(x) if exponent == 0.5 else x**exponent
        for k in range(1, degree + 1):
            result[k] = result[k - 1] * (exponent - k + 1) / (k * x)
        return result
    except OverflowError:
        _require(False, name, x, "whose result is finite")
        raise


#: The functions of one variable, by NumPy's name.
FUNCTIONS: dict[str, Series] = {
    name: partial(_series, name)
    for name in (*CYCLES, *INVERSES, "tan", "tanh", "log", "log1p", "log10", "sqrt")
}
