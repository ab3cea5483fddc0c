"""Numbers that deviate, and rules of how far results of operations do: Δ(ab) = a Δb + Δa (b + Δb), … [reps2003].

Which operation has which rule is said in `flexhinf.codegen.operations`.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from flexhinf.scalars.trace import built


@dataclass
class Deviated:
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
        """How far it moves."""
        return ca.SX(0.0) if self.moves is None else self.moves

    @property
    def moved(self) -> ca.SX:
        """The number of x + d."""
        self.doubled = True
        return self.value if self.moves is None else self.value + self.moves


def terms_of(a: Deviated, b: Deviated) -> tuple[ca.SX, ca.SX]:
    """Two terms of the difference of a product, with as few numbers of x + d as can be."""
    if a.doubled and not b.doubled:
        a, b = b, a
    return a.value * b.difference, a.difference * b.moved


def product(a: Deviated, b: Deviated) -> ca.SX:
    """Of a product."""
    if b.moves is None:
        return a.difference * b.value
    if a.moves is None:
        return a.value * b.difference
    first, second = terms_of(a, b)
    return first + second


def total(a: Deviated, b: Deviated) -> ca.SX:
    """Of a sum: the terms of a product are added one after the other, as each is fused into its sum."""
    if b.terms is not None:
        first, second = b.terms
        return (a.difference + first) + second
    if a.terms is not None:
        first, second = a.terms
        return (first + b.difference) + second
    return built(ca.OP_ADD, [a.difference, b.difference])


def less(a: Deviated, b: Deviated) -> ca.SX:
    """Of a difference, likewise."""
    if b.terms is not None:
        first, second = b.terms
        return (a.difference - first) - second
    if a.terms is not None:
        first, second = a.terms
        return (first - b.difference) + second
    return built(ca.OP_SUB, [a.difference, b.difference])


def quotient(a: Deviated, b: Deviated) -> ca.SX:
    """Of a quotient."""
    if b.moves is None:
        return a.difference / b.value
    return (a.difference - a.value / b.value * b.difference) / b.moved


def square(a: Deviated) -> ca.SX:
    """Of a square."""
    return a.difference * (a.value + a.moved)


def inverse(a: Deviated) -> ca.SX:
    """Of a reciprocal."""
    return -a.difference / (a.value * a.moved)


def exponential(a: Deviated) -> ca.SX:
    """Of the exponential."""
    return ca.exp(a.value) * ca.expm1(a.difference)


def tanh(a: Deviated) -> ca.SX:
    """Of the hyperbolic tangent."""
    return ca.tanh(a.difference) * (1.0 - ca.tanh(a.value) * ca.tanh(a.moved))


def arctan(a: Deviated) -> ca.SX:
    """Of the inverse tangent."""
    return ca.atan2(a.difference, 1.0 + a.value * a.moved)


def _turned(a: Deviated) -> tuple[ca.SX, ca.SX]:
    """sin Δ and 1 − cos Δ."""
    half = ca.sin(0.5 * a.difference)
    return 2.0 * half * ca.cos(0.5 * a.difference), 2.0 * half * half


def sine(a: Deviated) -> ca.SX:
    """Of a sine, by half angles."""
    sine, lost = _turned(a)
    return ca.cos(a.value) * sine - ca.sin(a.value) * lost


def cosine(a: Deviated) -> ca.SX:
    """Of a cosine, by half angles."""
    sine, lost = _turned(a)
    return -ca.sin(a.value) * sine - ca.cos(a.value) * lost


def root(a: Deviated) -> ca.SX:
    """Of a square root."""
    total = ca.sqrt(a.moved) + ca.sqrt(a.value)
    return ca.if_else(total == 0.0, 0.0, a.difference / total)  # of a negative number NaN, as its root


def angle(y: Deviated, x: Deviated) -> ca.SX:
    """Of arctan2, the angle between the two directions: it does not jump where arctan2 does."""
    return ca.atan2(x.value * y.difference - y.value * x.difference, x.value * x.moved + y.value * y.moved)


def chosen(flag: Deviated, a: Deviated) -> ca.SX:
    """Of a where the flag is not zero, else 0."""
    kept = ca.if_else(flag.value, a.difference, a.moved)
    return ca.if_else(flag.moved, kept, ca.if_else(flag.value, -a.value, 0.0))
