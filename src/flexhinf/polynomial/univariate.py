"""Taylor coefficients of the elementary functions of one variable, about a point, to any degree.

Each function returns the coefficients c₀ … c_degree of φ(x₀ + t) = Σ cₖ tᵏ, shape (degree + 1,), by
closed form or by the recurrence of the function's differential equation. Where φ is not analytic, or not
real, it raises `InvalidInput`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, wraps

import numpy as np

from flexhinf.errors import InvalidInput

Series = Callable[[float, int], np.ndarray]


@lru_cache(64)
def _factorials(degree: int) -> np.ndarray:
    return np.array([float(math.factorial(k)) for k in range(degree + 1)])


def _require(condition: bool, name: str, point: float, domain: str) -> None:
    if condition:
        return
    raise InvalidInput(
        f"The function {name} has no real Taylor series at the point of the expansion.",
        f"expected an argument {domain} there, got {point:.17g}",
        "another point of expansion, or a form of the model that is smooth at this one",
    )


def _finite(series: Series) -> Series:
    """Refuse a point that is not finite, or where the function leaves the finite numbers."""

    @wraps(series)
    def checked(x: float, degree: int) -> np.ndarray:
        _require(math.isfinite(x), series.__name__, x, "that is finite")
        try:
            return series(x, degree)
        except OverflowError:
            _require(False, series.__name__, x, "whose result is finite")
            raise

    return checked


def _cycle(values: tuple[float, ...], degree: int) -> np.ndarray:
    """Coefficients of a function whose derivatives at the point repeat."""
    return np.array([values[k % len(values)] for k in range(degree + 1)]) / _factorials(degree)


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


def _riccati(first: float, slope: float, sign: float, degree: int) -> np.ndarray:
    """Coefficients of the solution of y' = 1 + sign y² (the tangents), from value and slope at the point."""
    y = np.zeros(degree + 1)
    y[0] = first
    if degree:
        y[1] = slope
    for k in range(1, degree):
        y[k + 1] = sign * (y[: k + 1] @ y[k::-1]) / (k + 1)
    return y


def sin(x: float, degree: int) -> np.ndarray:
    """Sine."""
    s, c = math.sin(x), math.cos(x)
    return _cycle((s, c, -s, -c), degree)


def cos(x: float, degree: int) -> np.ndarray:
    """Cosine."""
    s, c = math.sin(x), math.cos(x)
    return _cycle((c, -s, -c, s), degree)


def tan(x: float, degree: int) -> np.ndarray:
    """Tangent, y' = 1 + y²."""
    return _riccati(math.tan(x), 1.0 + math.tan(x) ** 2, 1.0, degree)


def sinh(x: float, degree: int) -> np.ndarray:
    """Hyperbolic sine."""
    return _cycle((math.sinh(x), math.cosh(x)), degree)


def cosh(x: float, degree: int) -> np.ndarray:
    """Hyperbolic cosine."""
    return _cycle((math.cosh(x), math.sinh(x)), degree)


def tanh(x: float, degree: int) -> np.ndarray:
    """Hyperbolic tangent, y' = 1 − y²; the slope is formed as 1 / cosh², which does not cancel."""
    slope = (2.0 / (math.exp(x) + math.exp(-x))) ** 2 if abs(x) < 300.0 else 0.0
    return _riccati(math.tanh(x), slope, -1.0, degree)


def arcsin(x: float, degree: int) -> np.ndarray:
    """Inverse sine, derivative (1 − x²)^(−1/2); |x| < 1."""
    _require(abs(x) < 1.0, "arcsin", x, "inside (-1, 1)")
    return _integrated(
        math.asin(x), _power_of_quadratic((1 - x) * (1 + x), -2 * x, -1.0, -0.5, degree), degree
    )


def arccos(x: float, degree: int) -> np.ndarray:
    """Inverse cosine; |x| < 1."""
    _require(abs(x) < 1.0, "arccos", x, "inside (-1, 1)")
    result = -arcsin(x, degree)
    result[0] = math.acos(x)
    return result


def arctan(x: float, degree: int) -> np.ndarray:
    """Inverse tangent, derivative (1 + x²)^(−1)."""
    return _integrated(math.atan(x), _power_of_quadratic(1 + x * x, 2 * x, 1.0, -1.0, degree), degree)


def arcsinh(x: float, degree: int) -> np.ndarray:
    """Inverse hyperbolic sine, derivative (1 + x²)^(−1/2)."""
    return _integrated(math.asinh(x), _power_of_quadratic(1 + x * x, 2 * x, 1.0, -0.5, degree), degree)


def arccosh(x: float, degree: int) -> np.ndarray:
    """Inverse hyperbolic cosine, derivative (x² − 1)^(−1/2); x > 1."""
    _require(x > 1.0, "arccosh", x, "> 1")
    return _integrated(
        math.acosh(x), _power_of_quadratic((x - 1) * (x + 1), 2 * x, 1.0, -0.5, degree), degree
    )


def arctanh(x: float, degree: int) -> np.ndarray:
    """Inverse hyperbolic tangent, derivative (1 − x²)^(−1); |x| < 1."""
    _require(abs(x) < 1.0, "arctanh", x, "inside (-1, 1)")
    return _integrated(
        math.atanh(x), _power_of_quadratic((1 - x) * (1 + x), -2 * x, -1.0, -1.0, degree), degree
    )


def exp(x: float, degree: int) -> np.ndarray:
    """Exponential."""
    return math.exp(x) / _factorials(degree)


def expm1(x: float, degree: int) -> np.ndarray:
    """exp(x) − 1."""
    result = exp(x, degree)
    result[0] = math.expm1(x)
    return result


def log(x: float, degree: int) -> np.ndarray:
    """Natural logarithm; x > 0."""
    _require(x > 0.0, "log", x, "> 0")
    return _integrated(math.log(x), power(x, -1, degree), degree)


def log1p(x: float, degree: int) -> np.ndarray:
    """log(1 + x); x > −1."""
    _require(x > -1.0, "log1p", x, "> -1")
    return _integrated(math.log1p(x), power(1.0 + x, -1, degree), degree)


def log10(x: float, degree: int) -> np.ndarray:
    """Decimal logarithm; x > 0."""
    _require(x > 0.0, "log10", x, "> 0")
    return log(x, degree) / math.log(10.0)


def sqrt(x: float, degree: int) -> np.ndarray:
    """Square root; x > 0."""
    _require(x > 0.0, "sqrt", x, "> 0")
    return power(x, 0.5, degree)


def power(x: float, exponent: float, degree: int) -> np.ndarray:
    """x^exponent: any x for a whole exponent ≥ 0, x ≠ 0 for a negative one, x > 0 for a fraction."""
    name = "1/x" if exponent == -1 else f"x**{exponent:g}"
    _require(math.isfinite(x) and math.isfinite(exponent), name, x, "that is finite, and so the exponent,")
    try:
        return _power(x, float(exponent), degree, name)
    except OverflowError:
        _require(False, name, x, "whose result is finite")
        raise


def _power(x: float, exponent: float, degree: int, name: str) -> np.ndarray:
    if exponent.is_integer() and exponent >= 0:
        top = int(exponent)
        return np.array([math.comb(top, k) * x ** (top - k) if k <= top else 0.0 for k in range(degree + 1)])
    if exponent.is_integer():
        _require(x != 0.0, name, x, "different from zero")
    else:
        _require(x > 0.0, name, x, "> 0")
    result = np.empty(degree + 1)
    result[0] = math.sqrt(x) if exponent == 0.5 else x**exponent
    for k in range(1, degree + 1):
        result[k] = result[k - 1] * (exponent - k + 1) / (k * x)
    return result


#: The functions of one variable, by NumPy's name.
FUNCTIONS: dict[str, Series] = {
    f.__name__: _finite(f)
    for f in (
        sin, cos, tan, sinh, cosh, tanh, arcsin, arccos, arctan, arcsinh, arccosh, arctanh,
        exp, expm1, log, log1p, log10, sqrt,
    )
}  # fmt: skip
