"""Differences f(x + d) − f(x) of a traced function, without a subtraction of two numbers that are nearly alike.

Every operation has a rule for the difference of its result: Δ(ab) = a Δb + Δa (b + Δb), Δ sin a by half angles, and so
on [reps2003]. A deviation of 1e-12 from a state of 1e3 then keeps its digits. Where a function has a corner, and where
an operation has no rule here, both values are computed and subtracted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import count

import casadi as ca

from flexhinf.scalars.trace import built, walk


@dataclass
class _Deviated:
    """A number, and its difference; None where it does not move.

    `terms`: Of a product, two that add up to the difference, where nothing but one sum uses it. `doubled`: whether the
    number of x + d is used somewhere.
    """

    value: ca.SX
    moves: ca.SX | None = None
    terms: tuple[ca.SX, ca.SX] | None = None
    doubled: bool = False

    @property
    def difference(self) -> ca.SX:
        return ca.SX(0.0) if self.moves is None else self.moves

    @property
    def moved(self) -> ca.SX:
        """The number of x + d."""
        self.doubled = True
        return self.value if self.moves is None else self.value + self.moves


def _terms(a: _Deviated, b: _Deviated) -> tuple[ca.SX, ca.SX]:
    """Two terms of the difference of a product, with as few numbers of x + d as can be."""
    if a.doubled and not b.doubled:
        a, b = b, a
    return a.value * b.difference, a.difference * b.moved


def _product(a: _Deviated, b: _Deviated) -> ca.SX:
    if b.moves is None:
        return a.difference * b.value
    if a.moves is None:
        return a.value * b.difference
    first, second = _terms(a, b)
    return first + second


def _sum(code: int, a: _Deviated, b: _Deviated) -> ca.SX:
    """Of a sum or a difference: the terms of a product are added one after the other, as each is fused into its sum."""
    minus = code == ca.OP_SUB
    if b.terms is not None:
        first, second = b.terms
        return (a.difference - first) - second if minus else (a.difference + first) + second
    if a.terms is not None:
        first, second = a.terms
        return (first - b.difference if minus else first + b.difference) + second
    return built(code, [a.difference, b.difference])


def _quotient(a: _Deviated, b: _Deviated) -> ca.SX:
    if b.moves is None:
        return a.difference / b.value
    return (a.difference - a.value / b.value * b.difference) / b.moved


def _square(a: _Deviated) -> ca.SX:
    return a.difference * (a.value + a.moved)


def _inverse(a: _Deviated) -> ca.SX:
    return -a.difference / (a.value * a.moved)


def _exponential(a: _Deviated) -> ca.SX:
    return ca.exp(a.value) * ca.expm1(a.difference)


def _tanh(a: _Deviated) -> ca.SX:
    return ca.tanh(a.difference) * (1.0 - ca.tanh(a.value) * ca.tanh(a.moved))


def _arctan(a: _Deviated) -> ca.SX:
    return ca.atan2(a.difference, 1.0 + a.value * a.moved)


def _turned(a: _Deviated) -> tuple[ca.SX, ca.SX]:
    """sin Δ and 1 − cos Δ."""
    half = ca.sin(0.5 * a.difference)
    return 2.0 * half * ca.cos(0.5 * a.difference), 2.0 * half * half


def _sine(a: _Deviated) -> ca.SX:
    sine, lost = _turned(a)
    return ca.cos(a.value) * sine - ca.sin(a.value) * lost


def _cosine(a: _Deviated) -> ca.SX:
    sine, lost = _turned(a)
    return -ca.sin(a.value) * sine - ca.cos(a.value) * lost


def _root(a: _Deviated) -> ca.SX:
    total = ca.sqrt(a.moved) + ca.sqrt(a.value)
    return ca.if_else(total == 0.0, 0.0, a.difference / total)  # of a negative number NaN, as its root


def _angle(y: _Deviated, x: _Deviated) -> ca.SX:
    """Of arctan2, the angle between the two directions: it does not jump where arctan2 does."""
    return ca.atan2(x.value * y.difference - y.value * x.difference, x.value * x.moved + y.value * y.moved)


def _chosen(flag: _Deviated, a: _Deviated) -> ca.SX:
    """Of a where the flag is not zero, else 0."""
    kept = ca.if_else(flag.value, a.difference, a.moved)
    return ca.if_else(flag.moved, kept, ca.if_else(flag.value, -a.value, 0.0))


def _linear(code: int, a: _Deviated) -> ca.SX:
    return built(code, [a.difference])


#: Differences by operation; that of a sum takes the terms of products apart.
RULES: dict[int, Callable[..., ca.SX]] = {
    **{code: partial(_linear, code) for code in (ca.OP_ASSIGN, ca.OP_NEG, ca.OP_TWICE)},
    ca.OP_ADD: partial(_sum, ca.OP_ADD),
    ca.OP_SUB: partial(_sum, ca.OP_SUB),
    ca.OP_MUL: _product,
    ca.OP_DIV: _quotient,
    ca.OP_SQ: _square,
    ca.OP_INV: _inverse,
    ca.OP_SIN: _sine,
    ca.OP_COS: _cosine,
    ca.OP_SQRT: _root,
    ca.OP_EXP: _exponential,
    ca.OP_TANH: _tanh,
    ca.OP_ATAN: _arctan,
    ca.OP_ATAN2: _angle,
    ca.OP_IF_ELSE_ZERO: _chosen,
}


def difference(function: ca.Function) -> ca.Function:
    """f(x + d) − f(x) of (x, d, *others), for a traced function f of (x, *others) with one result."""
    arguments = [ca.SX.sym(function.name_in(k), function.size1_in(k)) for k in range(function.n_in())]
    deviation = ca.SX.sym("deviation", function.size1_in(0))
    result = ca.SX.zeros(function.size1_out(0))

    def leaf(which: int, element: int) -> _Deviated:
        return _Deviated(arguments[which][element], None if which else deviation[element])

    uses, order = _uses(function), count()

    def operation(code: int, operands: list[_Deviated]) -> _Deviated:
        once = uses[next(order)] == 1
        value = built(code, [operand.value for operand in operands])
        if all(operand.moves is None for operand in operands):
            return _Deviated(value)
        if code == ca.OP_MUL and once and all(operand.moves is not None for operand in operands):
            terms = _terms(*operands)
            return _Deviated(value, terms[0] + terms[1], terms)
        if code in RULES:
            return _Deviated(value, RULES[code](*operands))
        return _Deviated(value, built(code, [operand.moved for operand in operands]) - value)

    for _, element, pair in walk(function, leaf, lambda constant: _Deviated(ca.SX(constant)), operation):
        result[element] = pair.difference
    inputs = [arguments[0], deviation, *arguments[1:]]
    return ca.Function(f"{function.name()}_difference", inputs, [ca.densify(result)], {"cse": True})


def _uses(function: ca.Function) -> Counter[int]:
    """How often the result of each operation is used."""
    uses, order = Counter[int](), count()

    def operation(code: int, operands: list[int]) -> int:
        uses.update(operands)
        return next(order)

    for _, _, value in walk(function, lambda which, element: -1, lambda constant: -1, operation):
        uses[value] += 1
    return uses
