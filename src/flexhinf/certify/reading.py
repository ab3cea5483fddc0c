"""The fields of a problem as exact polynomials in the state and in elementary functions of one linear form each.

The model's code was traced once (`flexhinf.scalars.trace`). Here its instructions are run on exact elements: every
double is the rational number it is, sums and products are those of polynomials over the rationals, and a function such
as sin becomes an `Atom`, a function of one linear form of the state. So f, g1, g2 and h are exact; nothing is expanded.

What has no such form is refused by name: a function of two linear forms, `where`, `sign`, and inputs that do not enter
affinely.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import casadi as ca
import flint
import numpy as np
from flint import arb, arb_series, fmpq, fmpq_mpoly, fmpq_mpoly_ctx

from flexhinf.errors import InvalidInput
from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.plant.problem import Problem
from flexhinf.polynomial import basis
from flexhinf.scalars import trace

__all__ = ["Atom", "ExactFields", "exact_fields", "rational", "terms_of"]

Series = Callable[[arb_series], arb_series]

#: Elementary functions on power series over intervals, by CasADi's operation: each bounds its own derivatives.
FUNCTIONS: dict[int, tuple[str, Series]] = {
    ca.OP_SIN: ("sin", lambda s: s.sin()),
    ca.OP_COS: ("cos", lambda s: s.cos()),
    ca.OP_TAN: ("tan", lambda s: s.tan()),
    ca.OP_EXP: ("exp", lambda s: s.exp()),
    ca.OP_EXPM1: ("expm1", lambda s: s.exp() - 1),
    ca.OP_LOG: ("log", lambda s: s.log()),
    ca.OP_LOG1P: ("log1p", lambda s: (s + 1).log()),
    ca.OP_SQRT: ("sqrt", lambda s: s.sqrt()),
    ca.OP_ATAN: ("arctan", lambda s: s.atan()),
    ca.OP_ASIN: ("arcsin", lambda s: s.asin()),
    ca.OP_ACOS: ("arccos", lambda s: s.acos()),
    ca.OP_SINH: ("sinh", lambda s: (s.exp() - (-s).exp()) / 2),
    ca.OP_COSH: ("cosh", lambda s: (s.exp() + (-s).exp()) / 2),
    ca.OP_TANH: ("tanh", lambda s: 1 - 2 / ((2 * s).exp() + 1)),
    ca.OP_ERF: ("erf", lambda s: s.erf()),
}
SUMS = {ca.OP_ADD: lambda a, b: a + b, ca.OP_SUB: lambda a, b: a - b, ca.OP_MUL: lambda a, b: a * b}
_HIGHEST_POWER = 16


@dataclass(frozen=True, eq=False)
class Atom:
    """A function of one linear form: x ↦ function(direction · x).

    Attributes
    ----------
    direction : tuple of fmpq
        The linear form, its first coefficient that is not zero being 1.
    function : callable
        From a power series of the linear form to that of the function, over intervals.
    text : str
        Name, for messages and the certificate.
    """

    direction: tuple[fmpq, ...]
    function: Series
    text: str

    def at_zero(self, precision: int = 300) -> fmpq:
        """The value at 0, as a rational number that is right to about `precision` bits."""
        with flint.ctx.workprec(precision + 20):
            return rational_of(self.function(arb_series([0, 1], prec=1))[0])


@dataclass(frozen=True, eq=False)
class ExactFields:
    """ẋ = f + g1 d + g2 u and h, in deviations from the operating point.

    Attributes
    ----------
    context : fmpq_mpoly_ctx
        Of polynomials in the n states, unused variables, and the atoms from place `first_atom` on.
    states, first_atom : int
    atoms : tuple of Atom
    f, h : list of fmpq_mpoly
    g1, g2 : list of list of fmpq_mpoly
        One row per state, one column per channel.
    r2 : list of list of fmpq
    offset : float
        Largest rate at the operating point before it was subtracted: rounding of the operating point.
    """

    context: fmpq_mpoly_ctx
    states: int
    first_atom: int
    atoms: tuple[Atom, ...]
    f: list[fmpq_mpoly]
    g1: list[list[fmpq_mpoly]]
    g2: list[list[fmpq_mpoly]]
    h: list[fmpq_mpoly]
    r2: list[list[fmpq]]
    offset: float


def rational(value: float) -> fmpq:
    """A double as the rational number it is."""
    numerator, denominator = Fraction(float(value)).as_integer_ratio()
    return fmpq(numerator, denominator)


def terms_of(polynomial: fmpq_mpoly) -> dict[tuple[int, ...], fmpq]:
    """The coefficients of a polynomial by exponents, as Python's integers."""
    return {tuple(map(int, key)): value for key, value in polynomial.to_dict().items()}


def rational_of(ball: arb) -> fmpq:
    """The midpoint of a narrow ball."""
    mantissa, exponent = ball.mid().man_exp()
    mantissa, exponent = int(mantissa), int(exponent)
    return fmpq(mantissa << exponent, 1) if exponent >= 0 else fmpq(mantissa, 1 << -exponent)


def exact_fields(problem: Problem, penalty: Any = None) -> ExactFields:
    """The exact fields of a problem.

    Parameters
    ----------
    problem : GeneralisedPlant or PolynomialPlant
    penalty : callable or ndarray, optional
        The checked h: from deviations (1, n) and the designed h (1, s) to (1, s). Default: the designed one.

    Raises
    ------
    InvalidInput
        A model that has no such form, by name.
    """
    if isinstance(problem, GeneralisedPlant):
        return _of_model(problem, penalty)
    if isinstance(problem, PolynomialPlant):
        return _of_polynomials(problem, penalty)
    raise InvalidInput(
        "The exact plant is not known, so nothing can be proved about it.",
        f"expected a problem of a Plant, or a PolynomialPlant, got {type(problem).__name__}",
        "load_solution(path, problem=…) for a solution from a file",
    )


# A model's code -----------------------------------------------------------------------------------
def _of_model(problem: GeneralisedPlant, penalty: Any) -> ExactFields:
    problem.check_unchanged()
    table = problem.plant.parameters
    n, m, k = len(problem.state_names), len(problem.input_names), len(problem.disturbance_names)
    flow = trace(lambda x, u, d, p: problem.flow(x, u, d, table.named(p)), n, m, k, table.size)
    output = trace(
        lambda x, p: _checked(penalty, x, problem.penalty_output(x, table.named(p))), n, table.size
    )
    reader = _Reader(n, m + k, flow.n_instructions() + output.n_instructions())
    x = reader.variables[:n]
    moved = [a + rational(b) for a, b in zip(x, problem.operating_point)]
    inputs = [a + rational(b) for a, b in zip(reader.variables[n : n + m], problem.operating_input)]
    p = [reader.constant(value) for value in table.vector()]
    rates = reader.run(flow, [moved, inputs, reader.variables[n + m : n + m + k], p])
    h = reader.run(output, [x, p])
    return reader.fields(rates, h, m, _matrix(problem.r2))


def _checked(penalty: Any, x: Any, h: Any) -> Any:
    if penalty is None:
        return np.asarray(h)
    return np.asarray(penalty(np.asarray(x)[None], np.asarray(h)[None]))[0]


def _of_polynomials(plant: PolynomialPlant, penalty: Any) -> ExactFields:
    n, disturbances, inputs, outputs = plant.size
    designed = outputs
    output = trace(lambda x, h: _checked(penalty, x, h), n, designed)
    reader = _Reader(n, 0, output.n_instructions())

    def polynomial(parts: dict[int, np.ndarray], *place: int) -> fmpq_mpoly:
        terms: dict[tuple[int, ...], fmpq] = {}
        for degree, part in parts.items():
            for exponents, value in zip(basis.exponents(n, degree).tolist(), part[place].tolist()):
                if value:
                    terms[(*exponents, *([0] * reader.room))] = rational(value)
        return reader.context.from_dict(terms)

    h = [polynomial(plant.h_parts, i) for i in range(outputs)]
    h = reader.run(output, [reader.variables[:n], h])
    f = [polynomial(plant.f_parts, i) for i in range(n)]
    g1 = [[polynomial(plant.g1_parts, i, j) for j in range(disturbances)] for i in range(n)]
    g2 = [[polynomial(plant.g2_parts, i, j) for j in range(inputs)] for i in range(n)]
    f, offset = reader.without_constant(f)
    h, _ = reader.without_constant(h)
    context = reader.context
    return ExactFields(context, n, n, tuple(reader.atoms), f, g1, g2, h, _matrix(plant.r2), offset)


def _matrix(values: np.ndarray) -> list[list[fmpq]]:
    return [[rational(value) for value in row] for row in values.tolist()]


class _Reader:
    """Runs traced code on polynomials in states, inputs and atoms.

    Parameters
    ----------
    states, inputs : int
        Numbers of variables; the inputs are u, then d.
    most_atoms : int
        Bound on the number of functions met.
    """

    def __init__(self, states: int, inputs: int, most_atoms: int) -> None:
        self.states, self.inputs = states, inputs
        self.room = inputs + most_atoms
        names = [f"x{i}" for i in range(states)] + [f"v{i}" for i in range(self.room)]
        self.context = fmpq_mpoly_ctx.get(names)
        self.variables = list(self.context.gens())
        self.atoms: list[Atom] = []
        self._known: dict[tuple[int, str], fmpq_mpoly] = {}

    def constant(self, value: float) -> fmpq_mpoly:
        """A number as a polynomial."""
        return self.context.constant(rational(value))

    def run(self, function: Any, arguments: Sequence[Sequence[fmpq_mpoly]]) -> list[fmpq_mpoly]:
        """The single result of a traced function."""
        work: dict[int, fmpq_mpoly] = {}
        result = [self.context.constant(0)] * function.size1_out(0)
        for k in range(function.n_instructions()):
            code = function.instruction_id(k)
            read, written = function.instruction_input(k), function.instruction_output(k)
            if code == ca.OP_CONST:
                work[written[0]] = self.constant(function.instruction_constant(k))
            elif code == ca.OP_INPUT:
                work[written[0]] = arguments[read[0]][read[1]]
            elif code == ca.OP_OUTPUT:
                result[written[1]] = work[read[0]]
            else:
                work[written[0]] = self.operation(code, [work[place] for place in read])
        return result

    def operation(self, code: int, operands: list[fmpq_mpoly]) -> fmpq_mpoly:
        """One instruction."""
        first, second = operands[0], operands[-1]
        if code in SUMS:
            return SUMS[code](first, second)
        simple = {ca.OP_NEG: -1, ca.OP_TWICE: 2, ca.OP_ASSIGN: 1}
        if code in simple:
            return first * simple[code]
        if code == ca.OP_SQ:
            return first * first
        if code == ca.OP_INV:
            return self.divided(self.context.constant(1), first)
        if code == ca.OP_DIV:
            return self.divided(first, second)
        if code in (ca.OP_POW, ca.OP_CONSTPOW):
            return self.power(first, second)
        if code in FUNCTIONS:
            return self.applied(*FUNCTIONS[code], first)
        name = next((name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == code), "?")
        raise _refused(f"the operation {name.removeprefix('OP_').lower()}")

    def divided(self, above: fmpq_mpoly, below: fmpq_mpoly) -> fmpq_mpoly:
        """A quotient: exact by a number, an atom by a linear form."""
        if below.is_constant():
            return above / below.leading_coefficient()
        return above * self.applied("1/", lambda s: 1 / s, below)

    def power(self, base: fmpq_mpoly, exponent: fmpq_mpoly) -> fmpq_mpoly:
        """A power with a constant exponent."""
        if not exponent.is_constant():
            raise _refused("a power whose exponent is no constant")
        value = exponent.leading_coefficient() if exponent else fmpq(0)
        if value.q == 1 and 0 <= value <= _HIGHEST_POWER:
            return base ** int(value.p)
        return self.applied(f"power {value}", lambda s: (s.log() * arb(value)).exp(), base)

    def applied(self, name: str, function: Series, argument: fmpq_mpoly) -> fmpq_mpoly:
        """An elementary function of an expression: an atom."""
        direction, inner, text = self.univariate(name, argument)
        key = (id(function) if name == "1/" else 0, f"{name}({text})")
        if key[1] not in self._known:
            atom = Atom(direction, lambda s: function(inner(s)), key[1])
            self._known[key[1]] = self.variables[self.states + self.inputs + len(self.atoms)]
            self.atoms.append(atom)
        return self._known[key[1]]

    def univariate(self, name: str, argument: fmpq_mpoly) -> tuple[tuple[fmpq, ...], Series, str]:
        """The one linear form that an expression depends on, and the expression as a function of it."""
        terms = terms_of(argument)
        directions = set()
        linear = [fmpq(0)] * self.states
        affine = True
        for exponents, value in terms.items():
            states, rest = exponents[: self.states], exponents[self.states :]
            if any(rest[: self.inputs]):
                raise _refused(f"{name} of an input or a disturbance")
            directions |= {self.atoms[j].direction for j, e in enumerate(rest[self.inputs :]) if e}
            if sum(states) == 1 and not any(rest):
                linear[states.index(1)] = value
            elif sum(states):
                affine = False
        if affine and any(linear):
            directions.add(_normalised(linear)[0])
        elif not affine:
            used = {i for exponents in terms for i, e in enumerate(exponents[: self.states]) if e}
            directions |= {tuple(fmpq(int(j == i)) for j in range(self.states)) for i in used}
        if len(directions) != 1:
            raise _refused(f"{name} of more than one linear form of the state")
        (direction,) = directions
        lead = next((i for i, value in enumerate(direction) if value), 0)
        # Where the states enter affinely, ℓ = direction·x and the linear part is factor·ℓ; else ℓ is one state.
        factor = linear[lead]
        pieces = []
        for exponents, value in terms.items():
            power = sum(exponents[: self.states])
            if power == 1 and affine:
                continue
            chosen = [(self.atoms[j], e) for j, e in enumerate(exponents[self.states + self.inputs :]) if e]
            pieces.append((value, power, chosen))
        if affine and factor:
            pieces.append((factor, 1, []))

        def inner(s: arb_series) -> arb_series:
            return _evaluate(pieces, s)

        return direction, inner, str(argument)

    def fields(self, rates: list[fmpq_mpoly], h: list[fmpq_mpoly], m: int, r2: Any) -> ExactFields:
        """f, g1 and g2 out of the rates, which must be affine in the inputs."""
        n, k = self.states, self.inputs
        split: list[list[dict]] = [[{} for _ in range(k + 1)] for _ in rates]
        for i, rate in enumerate(rates):
            for exponents, value in terms_of(rate).items():
                inputs = exponents[n : n + k]
                if sum(inputs) > 1:
                    raise _refused("an input or a disturbance that does not enter affinely")
                place = 1 + inputs.index(1) if any(inputs) else 0
                split[i][place][exponents[:n] + (0,) * k + exponents[n + k :]] = value
        parts = [[self.context.from_dict(part) for part in row] for row in split]
        f, offset = self.without_constant([row[0] for row in parts])
        h, _ = self.without_constant(h)
        g2, g1 = [row[1 : 1 + m] for row in parts], [row[1 + m :] for row in parts]
        return ExactFields(self.context, n, n + k, tuple(self.atoms), f, g1, g2, h, r2, offset)

    def without_constant(self, fields: list[fmpq_mpoly]) -> tuple[list[fmpq_mpoly], float]:
        """The fields minus their values at the operating point, and the largest of those values."""
        values = [atom.at_zero() for atom in self.atoms]
        point = {i: fmpq(0) for i in range(self.states)}
        point |= {self.states + self.inputs + j: value for j, value in enumerate(values)}
        at_zero = []
        for field in fields:
            found = field.subs(point)
            at_zero.append(found.leading_coefficient() if found else fmpq(0))
        return [a - b for a, b in zip(fields, at_zero)], max(
            (abs(float(int(v.p) / int(v.q))) for v in at_zero), default=0.0
        )


def _evaluate(pieces: Sequence[tuple[fmpq, int, list[tuple[Atom, int]]]], s: arb_series) -> arb_series:
    total: Any = arb_series([0], prec=s.prec)
    for value, power, chosen in pieces:
        term: Any = arb_series([arb(value)], prec=s.prec)
        for _ in range(power):
            term = term * s
        for atom, times in chosen:
            inner = atom.function(s)
            for _ in range(times):
                term = term * inner
        total = total + term
    return total


def _normalised(linear: Sequence[fmpq]) -> tuple[tuple[fmpq, ...], fmpq]:
    factor = next(value for value in linear if value)
    return tuple(value / factor for value in linear), factor


def _refused(what: str) -> InvalidInput:
    return InvalidInput(
        "The method cannot prove anything about this plant.",
        f"expected polynomials and elementary functions of one linear form of the state each, got {what}",
        "sampled_region, or the Taylor expansion of the problem as the plant: problem.expand(degree)",
    )
