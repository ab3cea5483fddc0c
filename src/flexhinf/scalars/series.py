"""A truncated power series in one variable, usually time, whose coefficients are any elements.

Model code run on series of a motion gives the exact time derivatives of what it computes: the coefficients of
q(t + s) in s are q, q̇, q̈/2, … Unlike a `Jet`, whose coefficients are numbers, a series of symbols can be traced.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput


class Series:
    """c₀ + c₁ s + … + c_k s^k, all higher powers dropped; made by `series`.

    Parameters
    ----------
    coefficients : tuple
        Elements: numbers, symbols or truncated polynomials.
    """

    __slots__ = ("coefficients",)
    __hash__ = None  # type: ignore[assignment]  # elements may be symbols, which are no keys

    def __init__(self, coefficients: tuple[Any, ...]) -> None:
        self.coefficients = coefficients

    def _beside(self, other: Any) -> tuple[Any, ...] | None:
        """The other's coefficients; None for arrays and lists (NumPy then broadcasts)."""
        if isinstance(other, Series):
            if len(other.coefficients) != len(self.coefficients):
                raise InvalidInput(
                    "Two series of different lengths cannot be combined.",
                    f"expected {len(self.coefficients)} coefficients, got {len(other.coefficients)}",
                    "as many derivatives for each signal",
                )
            return other.coefficients
        if isinstance(other, (np.ndarray, list, tuple)):
            return None
        return (other, *(0.0 for _ in self.coefficients[1:]))

    def __add__(self, other: Any) -> Any:
        right = self._beside(other)
        return NotImplemented if right is None else Series(_sum(self.coefficients, right))

    __radd__ = __add__

    def __neg__(self) -> Series:
        return Series(tuple(-c for c in self.coefficients))

    def __sub__(self, other: Any) -> Any:
        right = self._beside(other)
        return NotImplemented if right is None else Series(_difference(self.coefficients, right))

    def __rsub__(self, other: Any) -> Any:
        left = self._beside(other)
        return NotImplemented if left is None else Series(_difference(left, self.coefficients))

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Series):
            return Series(_product(self.coefficients, self._beside(other) or ()))
        if self._beside(other) is None:
            return NotImplemented
        return Series(tuple(c * other for c in self.coefficients))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        if isinstance(other, Series):
            return Series(_quotient(self.coefficients, self._beside(other) or ()))
        if self._beside(other) is None:
            return NotImplemented
        return Series(tuple(c / other for c in self.coefficients))

    def __rtruediv__(self, other: Any) -> Any:
        left = self._beside(other)
        return NotImplemented if left is None else Series(_quotient(left, self.coefficients))

    # NumPy's ufuncs on object arrays call the method of the same name.
    def sin(self) -> Series:
        """Sine."""
        return Series(_sine_cosine(self.coefficients)[0])

    def cos(self) -> Series:
        """Cosine."""
        return Series(_sine_cosine(self.coefficients)[1])

    def __repr__(self) -> str:
        return f"Series({', '.join(map(repr, self.coefficients))})"


def series(*derivatives: Sequence[Any]) -> np.ndarray:
    """Object array of `Series` from a signal and its derivatives.

    Parameters
    ----------
    derivatives : (n,) each
        Value, first derivative, second derivative, …; the j-th coefficient is the j-th of them over j!.
    """
    array = np.empty(len(derivatives[0]), dtype=object)
    for i, row in enumerate(zip(*derivatives, strict=True)):
        array[i] = Series(tuple(_over(c, math.factorial(j)) for j, c in enumerate(row)))
    return array


def derivative(array: Any, order: int) -> np.ndarray:
    """The derivative of an order, (n,), of an array of `Series`; of other elements, which are constant, zero."""
    found = [_derivative(entry, order) for entry in array]
    return np.array(found)


def _derivative(entry: Any, order: int) -> Any:
    if not isinstance(entry, Series):
        return 0.0 if order else entry
    factor = math.factorial(order)
    return entry.coefficients[order] if factor == 1 else factor * entry.coefficients[order]


def _over(element: Any, factor: int) -> Any:
    return element if factor == 1 else element / factor


def _sum(a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(x + y for x, y in zip(a, b))


def _difference(a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(x - y for x, y in zip(a, b))


def _convolved(a: Sequence[Any], b: Sequence[Any], k: int) -> Any:
    """Σ a_i b_{k−i} over what both have."""
    total: Any = 0.0
    for i in range(max(0, k - len(b) + 1), min(k + 1, len(a))):
        total = total + a[i] * b[k - i]
    return total


def _product(a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(_convolved(a, b, k) for k in range(len(a)))


def _quotient(a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, ...]:
    """c with c b = a, power by power."""
    inverse = 1.0 / b[0]
    c: list[Any] = []
    for k in range(len(a)):
        c.append((a[k] - _convolved(c, b, k)) * inverse)
    return tuple(c)


def _sine_cosine(a: Sequence[Any]) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """From (sin a)' = a' cos a and (cos a)' = −a' sin a, power by power."""
    sine, cosine = [np.sin(a[0])], [np.cos(a[0])]
    rate = [j * c for j, c in enumerate(a)][1:]
    for k in range(1, len(a)):
        up, down = _convolved(rate, cosine, k - 1), _convolved(rate, sine, k - 1)
        sine.append(up / k)
        cosine.append(-down / k)
    return tuple(sine), tuple(cosine)
