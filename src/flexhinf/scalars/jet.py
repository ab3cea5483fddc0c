"""A truncated multivariate polynomial that lives inside NumPy object arrays.

Model code run on jets gives its Taylor coefficients about a point, exactly, with no finite differences. An operation
that is not listed here raises. Functions that are not smooth are refused by name (`flexhinf.scalars.symbol`, and every
comparison).

A truncated power series in one variable, usually time, whose coefficients are any elements.

Model code run on series of a motion gives the exact time derivatives of what it computes: the coefficients of
q(t + s) in s are q, q̇, q̈/2, … Unlike a `Jet`, whose coefficients are numbers, a series of symbols can be traced.
"""

# Not checked strictly: names of this room; what users pass is checked.
# pyright: reportPrivateUsage=false, reportUnnecessaryIsInstance=false

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from numbers import Real
from typing import Any, Never, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Element, Elements
from flexhinf.errors import InvalidInput
from flexhinf.polynomial import truncated
from flexhinf.polynomial.truncated import Support, add, compose, multiply, size, space


def _termwise(
    of: Callable[[Sequence[Element], Sequence[Element]], tuple[Element, ...]],
    of_constant: Callable[[Element, Element], Element] | None = None,
) -> Callable[[Series, Any], Series]:
    """An operator of the coefficients with those of the other; `of_constant`: of each coefficient with a constant."""

    def method(self: Series, other: Any) -> Series:
        right = self._beside(other)
        if right is None:
            return NotImplemented
        if of_constant is not None and not isinstance(other, Series):
            return Series(tuple(of_constant(c, other) for c in self.coefficients))
        return Series(of(self.coefficients, right))

    return method


class Series:
    """c₀ + c₁ s + … + c_k s^k, all higher powers dropped; made by `series`.

    Parameters
    ----------
    coefficients : tuple
        Elements: numbers, symbols or truncated polynomials.
    """

    __slots__ = ("coefficients",)
    __hash__ = None  # pyright: ignore[reportAssignmentType]  # elements may be symbols, which are no keys

    def __init__(self, coefficients: tuple[Element, ...]) -> None:
        self.coefficients = coefficients

    def _beside(self, other: Series | Element | Sequence[Element]) -> tuple[Element, ...] | None:
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
        return (cast(Element, other), *(0.0 for _ in self.coefficients[1:]))

    def __neg__(self) -> Series:
        return Series(tuple(-c for c in self.coefficients))

    __add__ = __radd__ = _termwise(lambda a, b: tuple(x + y for x, y in zip(a, b)))
    __sub__ = _termwise(lambda a, b: tuple(x - y for x, y in zip(a, b)))
    __rsub__ = _termwise(lambda a, b: tuple(y - x for x, y in zip(a, b)))
    __rtruediv__ = _termwise(lambda a, b: _quotient(b, a))

    __mul__ = __rmul__ = _termwise(
        lambda a, b: tuple(_convolved(a, b, k) for k in range(len(a))), lambda a, b: a * b
    )
    __truediv__ = _termwise(lambda a, b: _quotient(a, b), lambda a, b: a / b)

    # NumPy's ufuncs on object arrays call the method of the same name.
    def sin(self) -> Series:
        """Sine."""
        return Series(_sine_cosine(self.coefficients)[0])

    def cos(self) -> Series:
        """Cosine."""
        return Series(_sine_cosine(self.coefficients)[1])

    def __repr__(self) -> str:
        return f"Series({', '.join(map(repr, self.coefficients))})"


def series(*derivatives: Sequence[Element] | Elements) -> Elements:
    """Object array of `Series` from a signal and its derivatives.

    `derivatives`: (n,) each, value, first derivative, second derivative, …; the j-th coefficient is the j-th of them
    over j!.
    """
    array = np.empty(len(derivatives[0]), dtype=object)
    for i, row in enumerate(zip(*derivatives, strict=True)):
        array[i] = Series(tuple(c if j < 2 else c / math.factorial(j) for j, c in enumerate(row)))
    return array


def derivative(array: Elements, order: int) -> Elements:
    """The derivative of an order, (n,), of an array of `Series`; of other elements, which are constant, zero."""
    factor = math.factorial(order)
    terms = [e.coefficients[order] if isinstance(e, Series) else 0.0 if order else e for e in array]
    return np.array(terms if factor == 1 else [factor * term for term in terms])


def _convolved(a: Sequence[Element], b: Sequence[Element], k: int) -> Element:
    total: Element = 0.0
    for i in range(max(0, k - len(b) + 1), min(k + 1, len(a))):
        total = total + a[i] * b[k - i]
    return total


def _quotient(a: Sequence[Element], b: Sequence[Element]) -> tuple[Element, ...]:
    inverse = 1.0 / b[0]
    c: list[Element] = []
    for k, term in enumerate(a):
        c.append((term - _convolved(c, b, k)) * inverse)
    return tuple(c)


def _sine_cosine(a: Sequence[Element]) -> tuple[tuple[Element, ...], tuple[Element, ...]]:
    """From (sin a)' = a' cos a and (cos a)' = −a' sin a, power by power."""
    first = cast(Any, a[0])  # NumPy calls the element's own method
    sine: list[Element] = [np.sin(first)]
    cosine: list[Element] = [np.cos(first)]
    rate = [j * c for j, c in enumerate(a)][1:]
    for k in range(1, len(a)):
        up, down = _convolved(rate, cosine, k - 1), _convolved(rate, sine, k - 1)
        sine.append(up / k)
        cosine.append(-down / k)
    return tuple(sine), tuple(cosine)


def _number(value: object) -> float | None:
    if type(value) is float:
        return value
    return float(cast(float, value)) if isinstance(value, (Real, np.bool_)) else None


def _operator(
    of_jets: Callable[[Jet, Jet], Jet], of_number: Callable[[Jet, float], Jet]
) -> Callable[[Jet, Any], Jet]:
    def method(self: Jet, other: Any) -> Jet:
        if isinstance(other, Jet):
            if self.support.space is not other.support.space:
                raise InvalidInput(
                    "Two truncated polynomials of different kinds cannot be combined.",
                    f"expected the same variables and degree, got {self!r} and {other!r}",
                    "the elements of one call of jets(point, degree)",
                )
            return of_jets(self, other)
        number = _number(other)
        return NotImplemented if number is None else of_number(self, number)

    return method


def _elementary(name: str) -> Callable[[Jet], Jet]:
    series = truncated.FUNCTIONS[name]

    def method(self: Jet) -> Jet:
        return self._compose(series)

    return method


SMOOTH = "a smooth model for the synthesis (tanh instead of sign); piecewise ones in the true plant only"
ARRAYS = "np.sin instead of math.sin; np.array([...]) of the elements instead of filling a float array"


def _refused(name: str, advice: str = SMOOTH) -> Callable[..., Never]:
    def method(self: Jet, *others: object) -> Never:
        raise InvalidInput(
            f"A truncated polynomial is not a number: `{name}` is not defined on it.",
            f"expected arithmetic and smooth functions, got {name} on {self!r}",
            advice,
        )

    return method


class Jet:
    """One scalar truncated polynomial in the deviations from a point, made by `jets`.

    Parameters
    ----------
    support : Support
        Its monomials (the others are zero), which also know the number of variables and the degree.
    values : ndarray, shape (N,)
        Their coefficients; never changed afterwards.
    """

    __slots__ = ("support", "values")
    __hash__ = None  # pyright: ignore[reportAssignmentType]  # == is refused, so a Jet cannot be a key

    def __init__(self, support: Support, values: np.ndarray) -> None:
        self.support = support
        self.values = values

    @property
    def n(self) -> int:
        """Number of variables."""
        return self.support.space.n

    @property
    def degree(self) -> int:
        """Degree after which everything is dropped."""
        return self.support.space.degree

    @property
    def constant(self) -> float:
        """The value at the point."""
        return float(self.values[0]) if self.support.has_constant else 0.0

    @property
    def coefficients(self) -> np.ndarray:
        """Dense monomial coefficients (C(n+degree, degree),), degree after degree, in basis order."""
        dense = np.zeros(self.support.space.size)
        dense[self.support.monomials] = self.values
        return dense

    # arithmetic

    def _shifted(self, amount: float) -> Jet:
        if self.support.has_constant:
            values = self.values.copy()
            values[0] += amount
            return Jet(self.support, values)
        if amount == 0.0:
            return self
        return Jet(*add(self.support, self.values, self.support.space.constant, np.array([amount])))

    def _scaled(self, factor: float) -> Jet:
        return (
            Jet(self.support, self.values * factor)
            if factor != 0.0
            else Jet(self.support.space.zero, np.zeros(0))
        )

    def _divided(self, divisor: float) -> Jet:
        if divisor == 0.0:
            raise InvalidInput(
                "A truncated polynomial was divided by zero.",
                f"expected a number different from zero, got {self!r} / {divisor}",
                "parameters that are not zero",
            )
        return Jet(self.support, self.values / divisor)

    def __neg__(self) -> Jet:
        return Jet(self.support, -self.values)

    def __pos__(self) -> Jet:
        return self

    def _power(self, exponent: float) -> Jet:
        if exponent == 2.0:
            return self * self
        if exponent == 3.0:
            return self * self * self
        return self._compose(lambda x, degree: truncated.power(x, exponent, degree))

    __add__ = __radd__ = _operator(lambda a, b: Jet(*add(a.support, a.values, b.support, b.values)), _shifted)
    __sub__ = _operator(
        lambda a, b: Jet(*add(a.support, a.values, b.support, -b.values)), lambda a, x: a._shifted(-x)
    )
    __rsub__ = _operator(lambda a, b: b - a, lambda a, x: (-a)._shifted(x))
    __mul__ = __rmul__ = _operator(
        lambda a, b: Jet(*multiply(a.support, a.values, b.support, b.values)), _scaled
    )
    __truediv__ = _operator(lambda a, b: a * b._power(-1.0), _divided)
    __rtruediv__ = _operator(lambda a, b: b / a, lambda a, x: a._power(-1.0)._scaled(x))
    __pow__ = _operator(
        lambda a, b: a._power(b.constant) if b.support is b.support.space.constant else (a.log() * b).exp(),
        _power,
    )
    __rpow__ = _operator(
        lambda a, b: b**a, lambda a, x: (a * float(truncated.FUNCTIONS["log"](x, 0)[0])).exp()
    )

    # functions; NumPy's ufuncs on object arrays call the method of the same name

    def _compose(self, series: truncated.SeriesCoefficients) -> Jet:
        support, values = self.support, self.values
        outer = series(self.constant, support.space.degree)
        if support.has_constant:
            support, values = support.space.support(support.monomials[1:]), values[1:]
        return Jet(*compose(outer.tolist(), support, values))

    sin, cos, tan = _elementary("sin"), _elementary("cos"), _elementary("tan")
    arcsin, arccos, arctan = _elementary("arcsin"), _elementary("arccos"), _elementary("arctan")
    sinh, cosh, tanh = _elementary("sinh"), _elementary("cosh"), _elementary("tanh")
    arcsinh, arccosh, arctanh = _elementary("arcsinh"), _elementary("arccosh"), _elementary("arctanh")
    exp, log, sqrt = _elementary("exp"), _elementary("log"), _elementary("sqrt")
    expm1, log1p, log10 = _elementary("expm1"), _elementary("log1p"), _elementary("log10")

    def arctan2(self, other: Jet | float) -> Jet:
        """Angle of the point (other, self), off the origin and off the half-line where the angle jumps."""
        x = other if isinstance(other, Jet) else _number(other)
        if x is None:
            return NotImplemented
        x0, y0 = (x.constant if isinstance(x, Jet) else x), self.constant
        if y0 == 0.0 and x0 <= 0.0:
            raise InvalidInput(
                "The function arctan2 has no Taylor series at the point of the expansion.",
                f"expected a point off the half-line y = 0, x <= 0, got (y, x) = ({y0:g}, {x0:g})",
                "another point of expansion, or the angle measured from another axis",
            )
        # rotated by the angle of the point itself, so that the quotient is small and its divisor positive
        return ((self * x0 - x * y0) / (x * x0 + self * y0)).arctan() + math.atan2(y0, x0)

    def hypot(self, other: Jet | float) -> Jet:
        """√(self² + other²), off the origin."""
        known = isinstance(other, Jet) or _number(other) is not None
        return (self * self + other * other).sqrt() if known else NotImplemented

    def conjugate(self) -> Jet:
        """The jet itself: its coefficients are real."""
        return self

    # what a polynomial cannot answer

    __bool__, __float__, __int__ = _refused("bool"), _refused("float", ARRAYS), _refused("int", ARRAYS)
    __lt__, __le__, __gt__, __ge__ = _refused("<"), _refused("<="), _refused(">"), _refused(">=")
    __eq__, __ne__ = _refused("=="), _refused("!=")
    __abs__, __floor__, __ceil__ = _refused("abs"), _refused("floor"), _refused("ceil")

    def __repr__(self) -> str:
        return f"Jet({self.n} variables, degree {self.degree}, value {self.constant:.6g})"


#: Functions that came by `expand`.
_EXPANDED = set[str]()


def expand(name: str, code: int, operands: int, refusal: str = "") -> None:
    """Let NumPy's function of a name, of one operand or two, expand from now on, by CasADi's derivatives.

    What a jet has of its own stays. `refusal`: Refuse it by name instead, with this advice.
    """
    if name in _EXPANDED or not hasattr(Jet, name):
        _EXPANDED.add(name)
        setattr(Jet, name, _refused(name, refusal) if refusal else by_casadi(name, code, operands))


def by_casadi(name: str, code: int, operands: int) -> Callable[..., Jet]:
    """Σ ∂ʲφ hʲ / j! over the orders j of one operand or two, of the deviations h."""

    def method(self: Jet, *others: Jet | float) -> Jet:
        if len(others) != operands - 1 or any(type(o) is not Jet and _number(o) is None for o in others):
            return NotImplemented
        values = [x.constant if isinstance(x, Jet) else float(x) for x in (self, *others)]
        orders, derivatives = _derivatives(code, operands, self.degree)
        coefficients = np.ravel(np.asarray(derivatives(*values)))
        if not np.isfinite(coefficients).all():
            raise InvalidInput(
                f"The function {name} has no Taylor series at the point of the expansion.",
                f"expected finite derivatives up to order {self.degree} there, got {values}",
                "another point of expansion, or a form of the model that is smooth at this one",
            )
        total = self._scaled(0.0)
        for order, coefficient in zip(orders, coefficients.tolist()):
            term = self._scaled(0.0)._shifted(coefficient)
            for x, value, power in zip((self, *others), values, order):
                for _ in range(power):
                    term = term * (x - value)
            total = total + term
        return total

    return method


@cache
def _derivatives(code: int, operands: int, degree: int) -> tuple[list[tuple[int, ...]], ca.Function]:
    """Orders of derivatives of an operation up to a degree, and a function with each of them over the factorials."""
    symbols = [ca.SX.sym(f"x{k}") for k in range(operands)]
    built = ca.SX.unary(code, *symbols) if operands == 1 else ca.SX.binary(code, *symbols)
    found = {(0,) * operands: built}
    for order in (o for o in np.ndindex(*[degree + 1] * operands) if 0 < sum(o) <= degree):
        k = next(k for k, power in enumerate(order) if power)
        before = (*order[:k], order[k] - 1, *order[k + 1 :])
        found[order] = ca.gradient(found[before], symbols[k]) / order[k]
    return list(found), ca.Function("derivatives", symbols, [ca.densify(ca.vertcat(*found.values()))])


def jets(point: ArrayLike, degree: int) -> Elements:
    """The coordinates about a point: pointᵢ + xᵢ, to run model code on.

    `point`: (n,), finite. `degree`: Total degree that is kept, ≥ 0. Returns an array of `Jet`, (n,).
    Raises InvalidInput: for a point that is not a finite vector, or a degree that is not a whole number ≥ 0.
    """
    point = np.asarray(point, dtype=float)
    if point.ndim != 1 or not len(point) or not np.isfinite(point).all():
        raise InvalidInput(
            "The point of the expansion cannot be used.",
            f"expected a vector of finite numbers, got {np.array2string(point, threshold=10)}",
            "one coordinate per variable",
        )
    if not isinstance(degree, (int, np.integer)) or isinstance(degree, bool) or degree < 0:
        raise InvalidInput(
            "The degree of the expansion cannot be used.",
            f"expected a whole number >= 0, got {degree!r}",
            "for example 3",
        )
    home = space(len(point), int(degree))
    result = np.empty(len(point), dtype=object)
    for i, value in enumerate(point.tolist()):
        parts = [(0, value)] * (value != 0.0) + [(1 + i, 1.0)] * (degree > 0)
        result[i] = Jet(
            home.support(np.array([number for number, _ in parts], dtype=np.intp)),
            np.array([v for _, v in parts], dtype=float),
        )
    return result


def terms(array: ArrayLike | Elements, n: int, degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The terms that an array of jets and numbers has (a number is a constant polynomial).

    `array`: of jets or numbers, any shape. `n`, `degree`: Variables and degree of the jets. Returns `rows, monomials`,
    (N,): Flat place of the element, and number of the monomial in its dense coefficient vector. Returns `values` (N,).
    Raises InvalidInput: for an element that is neither, or a jet with other variables or another degree.
    """
    array = np.asarray(array, dtype=object)
    home = space(n, degree)
    parts = [(np.zeros(0, np.intp), np.zeros(0))]
    for element in array.ravel():
        number = None if isinstance(element, Jet) else _number(element)
        if number is not None:
            parts.append((home.constant.monomials, np.array([number])))
        elif isinstance(element, Jet) and element.support.space is home:
            parts.append((element.support.monomials, element.values))
        else:
            raise InvalidInput(
                "An element is not a polynomial of the asked kind.",
                f"expected numbers and jets in {n} variables of degree {degree}, got {element!r}",
                "the results of code that ran on jets(point, degree)",
            )
    rows = np.repeat(np.arange(array.size), [len(values) for _, values in parts[1:]])
    monomials, values = map(np.concatenate, zip(*parts))
    return rows, monomials, values


def coefficients(array: ArrayLike | Elements, n: int, degree: int) -> np.ndarray:
    """Dense monomial coefficients of an array of jets and numbers (a number is a constant polynomial).

    `array`: of jets or numbers, shape (...). `n`, `degree`: Variables and degree of the jets. Returns (..., C(n+degree,
    degree)). Raises InvalidInput: for an element that is neither, or a jet with other variables or another degree.
    """
    array = np.asarray(array, dtype=object)
    rows, monomials, values = terms(array, n, degree)
    result = np.zeros((array.size, size(n, degree)))
    result[rows, monomials] = values
    return result.reshape(*array.shape, size(n, degree))
