"""The conversion of a problem and its solution to the claim that is to be proved, in exact numbers.

A model's code was traced once (`flexhinf.scalars.trace`). Here its instructions are run on polynomials over the
rationals: every constant is the rational number that its double is, every parameter is a variable, and a function such
as sin of a linear form of the state is a variable too. So nothing is expanded and nothing is rounded. Other operations
are refused by name: functions of other forms, `where`, inputs that do not enter affinely.

A claim is about the nominal plant (`statement_of`) or about a box of its parameters (`tolerance_statement`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from math import pi, prod
from typing import Any, NotRequired, TypedDict, cast

import casadi as ca
import numpy as np
from flint import fmpq, fmpq_mpoly, fmpq_mpoly_ctx

from flexhinf.arrays import Elements, Matrix
from flexhinf.certify.certificate import Certificate, linear_part
from flexhinf.certify.claim import FUNCTIONS, Function, Parameter, PolynomialTerms, Signal, Term, Terms
from flexhinf.codegen.operations import OPERATIONS
from flexhinf.errors import InvalidInput
from flexhinf.hinf.sampled import CheckedPenalty, checked_pair
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.plant.model import ParameterTable
from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.plant.polynomial_plant import PolynomialPlant, Problem
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import product
from flexhinf.scalars import trace
from flexhinf.scalars.trace import NAMES, instructions
from flexhinf.validation import HUGE

#: Operations of CasADi that are functions of a certificate, by the names that they have in NumPy.
ELEMENTARY = {code: row.name for code, row in OPERATIONS.items() if row.name in FUNCTIONS}
#: Those that rational polynomials have.
RATIONAL = {code for code, row in OPERATIONS.items() if row.polynomial}
_HIGHEST_POWER = 10
_MOST_HALVES = 64  # an offset that is the double nearest to k π/2 means k π/2 itself

#: Rational values of φ(o) at multiples of π/2, by the number of multiples.
_AT_ZERO = {"sin": (0, 1, 0, -1), "cos": (1, 0, -1, 0), "exp": (1,), "tanh": (0,), "arctan": (0,)}


#: The checked h: from deviations (1, n) and the designed h (1, s) to (1, s).
PenaltyMap = Callable[[np.ndarray, np.ndarray], np.ndarray]


class PlantFields(TypedDict):
    """Fields of a claim that say what its plant and its penalty are."""

    drift: tuple[Terms, ...]
    g1: tuple[tuple[Terms, ...], ...]
    g2: tuple[tuple[Terms, ...], ...]
    penalty: tuple[PolynomialTerms, ...]
    functions: NotRequired[tuple[Function, ...]]
    parameters: NotRequired[tuple[Parameter, ...]]


#: The smallest and the largest value of parameters, by name.
ParameterRanges = Mapping[str, tuple[float, float]]


def rational(value: float) -> fmpq:
    """A double as the rational number it is."""
    return fmpq(*float(value).as_integer_ratio())


def nearest_double(value: fmpq) -> float:
    """The double nearest to a rational number."""
    return int(value.p) / int(value.q)  # Python rounds the quotient of two integers correctly


def terms_of(polynomial: fmpq_mpoly) -> dict[tuple[int, ...], fmpq]:
    """The coefficients of a polynomial by exponents, as Python's integers."""
    return {tuple(map(int, key)): value for key, value in polynomial.to_dict().items()}


def plant_fields(
    problem: Problem | None, penalty: PenaltyMap | None = None, ranges: ParameterRanges | None = None
) -> PlantFields:
    """The fields of a claim that contain f, g1, g2 and h of a problem, in exact terms.

    `penalty` is the checked h: from deviations (1, n) and the designed h (1, s) to (1, s). Default: the designed one.
    Parameters that are not among the `ranges` have their nominal values.

    Raises
    ------
    InvalidInput
        By name for a model that has no such form, or with a range for a parameter inside a function of the state.
    """
    if isinstance(problem, PolynomialPlant):
        return _of_polynomials(problem, penalty)
    if not isinstance(problem, GeneralisedPlant):
        raise InvalidInput(
            "The exact plant is not known, so nothing can be proved about it.",
            f"expected the problem of a Plant, or a PolynomialPlant, got {type(problem).__name__}",
            "load_solution(path, problem=…) for a solution from a file",
        )
    problem.check_unchanged()
    table = problem.plant.parameters
    n, m, k = map(len, (problem.state_names, problem.input_names, problem.disturbance_names))

    def flow_at(x: Elements, u: Elements, d: Elements, p: Elements) -> Elements:
        return problem.flow(x, u, d, table.named(p))

    def output_at(x: Elements, p: Elements) -> Elements:
        return _checked(penalty, x, problem.penalty_output(x, table.named(p)))

    flow, output = trace(flow_at, n, m, k, table.size), trace(output_at, n, table.size)
    reader = _TraceReader(
        n, m + k, flat_names(table), table.vector(), flow.n_instructions() + output.n_instructions()
    )
    moved = [a + rational(b) for a, b in zip(reader.states, problem.operating_point)]
    driven = [a + rational(b) for a, b in zip(reader.inputs, problem.operating_input)]
    rates = reader.run(flow, [moved, driven, reader.inputs[m:], reader.parameters])
    h = reader.run(
        output, [reader.states, [reader.context.constant(rational(value)) for value in table.vector()]]
    )
    split = [(row[0], tuple(row[1 : 1 + m]), tuple(row[1 + m :])) for row in map(reader.rows, rates)]
    box = {name: (a, a) for name, a in zip(reader.names, reader.values.tolist())} | dict(ranges or {})
    if fixed := sorted(name for name in reader.inside if box[name][0] < box[name][1]):
        raise InvalidInput(
            "A parameter stands inside a function of the state.",
            f"expected parameters that multiply terms, got {', '.join(fixed)}",
            "its nominal value, or sampled_region",
        )
    drift, g2, g1 = zip(*split, strict=True)
    seen = [reader.names[i] for i in sorted(reader.seen)]
    return {
        "drift": drift,
        "g2": g2,
        "g1": g1,
        "penalty": tuple(map(reader.polynomial, h)),
        "functions": tuple(reader.functions),
        "parameters": tuple(Parameter(name, *box[name], _unit(problem, name)) for name in seen),
    }


def flat_names(table: ParameterTable) -> list[str]:
    """A name for every entry of the parameter vector."""
    return [
        f"{name}_{i + 1}" if value.ndim else name
        for name, value in table.values.items()
        for i in range(value.size)
    ]


def _checked(penalty: PenaltyMap | None, x: Elements, h: Elements) -> Elements:
    return np.asarray(h if penalty is None else penalty(np.asarray(x)[None], np.asarray(h)[None])[0])


def _of_polynomials(plant: PolynomialPlant, penalty: PenaltyMap | None) -> PlantFields:
    n, disturbances, inputs, outputs = plant.size

    def row(parts: dict[int, np.ndarray], *place: int) -> Terms:
        return tuple(
            Term(value, tuple(exponents))
            for degree, part in sorted(parts.items())
            for exponents, value in zip(basis.exponents(n, degree).tolist(), part[place].tolist())
            if value
        )

    output = trace(partial(_checked, penalty), n, outputs)
    reader = _TraceReader(n, 0, (), np.zeros(0), output.n_instructions())
    others, h = (0,) * (len(reader.context.names()) - n), [row(plant.h_parts, i) for i in range(outputs)]
    designed = [
        reader.context.from_dict({(*t.powers, *others): rational(t.coefficient) for t in terms})
        for terms in h
    ]
    return {
        "drift": tuple(row({k: part for k, part in plant.f_parts.items() if k}, i) for i in range(n)),
        "g1": tuple(tuple(row(plant.g1_parts, i, j) for j in range(disturbances)) for i in range(n)),
        "g2": tuple(tuple(row(plant.g2_parts, i, j) for j in range(inputs)) for i in range(n)),
        "penalty": tuple(map(reader.polynomial, reader.run(output, [reader.states, designed]))),
    }


class _TraceReader:
    """Runs traced code on polynomials in states, inputs (u, then d), parameters, their inverses, and functions.

    `values` are the nominal values of the `parameters`, `most` bounds the number of functions.
    """

    def __init__(
        self, states: int, inputs: int, parameters: Sequence[str], values: np.ndarray, most: int
    ) -> None:
        sizes = states, inputs, len(parameters), len(parameters), most
        names = [f"{letter}{i}" for letter, size in zip("xupqs", sizes) for i in range(size)]
        self.context, self.edges = fmpq_mpoly_ctx.get(names), np.cumsum([0, *sizes]).tolist()
        self.states, self.inputs, self.parameters, _, self._room = [
            list(self.context.gens()[a:b]) for a, b in pairwise(self.edges)
        ]
        self.names, self.values = tuple(parameters), values
        self.functions, self.seen = list[Function](), set[int]()
        self.inside = set[str]()  # functions of the state

    # Running code ------------------------------------------------------------------------------
    def run(self, function: ca.Function, arguments: Sequence[Sequence[fmpq_mpoly]]) -> list[fmpq_mpoly]:
        work: dict[int, fmpq_mpoly] = {}
        result = [self.context.constant(0)] * function.size1_out(0)
        for code, read, written, constant in instructions(function):
            if code == ca.OP_CONST:
                work[written[0]] = self.context.constant(rational(constant))
            elif code == ca.OP_INPUT:
                work[written[0]] = arguments[read[0]][read[1]]
            elif code == ca.OP_OUTPUT:
                result[written[1]] = work[read[0]]
            else:
                work[written[0]] = self._operation(code, [work[place] for place in read])
        return result

    def _operation(self, code: int, operands: list[fmpq_mpoly]) -> fmpq_mpoly:
        first, second = operands[0], operands[-1]
        if code in RATIONAL:
            return cast(fmpq_mpoly, OPERATIONS[code].numpy(*operands))
        if code in ELEMENTARY:
            return self._applied(ELEMENTARY[code], first)
        if code in (ca.OP_INV, ca.OP_DIV):
            terms, (start, middle, end) = list(terms_of(second).items()), self.edges[2:5]
            require(
                len(terms) == 1 and not any(terms[0][0][:start] + terms[0][0][end:]),
                "a quotient by something else than a product of parameters",
            )
            ((e, value),) = terms
            return (first if code == ca.OP_DIV else 1) * self.context.from_dict(
                {(*e[:start], *e[middle:end], *e[start:middle], *e[end:]): 1 / value}
            )
        power = code in (ca.OP_POW, ca.OP_CONSTPOW) and second.is_constant()
        value = second.leading_coefficient() if power and second else fmpq(0)
        require(
            power and value.q == 1 and 0 <= value <= _HIGHEST_POWER,
            f"the operation {NAMES.get(code, '?').removeprefix('OP_').lower()}",
        )
        return first ** int(value.p)

    def _applied(self, name: str, argument: fmpq_mpoly) -> fmpq_mpoly:
        """The variable that stands for a function of a linear form of the state; parameters inside are nominal."""
        sums = dict[int | None, fmpq]()
        for exponents, value in terms_of(argument).items():
            states, others = exponents[: self.edges[1]], exponents[self.edges[1] : self.edges[2]]
            require(
                sum(states) <= 1 and not any(others + exponents[self.edges[4] :]),
                f"{name} of something else than a linear form of the state",
            )
            for i, power in self._powers(exponents):
                self.inside.add(self.names[i])
                value *= rational(self.values[i]) ** power
            place = states.index(1) if any(states) else None
            sums[place] = sums.get(place, fmpq(0)) + value
        offset = sums.pop(None, fmpq(0))
        require(bool(sums), f"{name} of a constant: make that a parameter of the plant")
        slope = tuple(_exact_double(sums.get(i, fmpq(0)), name) for i in range(len(self.states)))
        value = _exact_double(offset, name)
        halves = round(value / (pi / 2))
        quarter = name in ("sin", "cos") and 0 < abs(halves) <= _MOST_HALVES and value == halves * pi / 2
        function = Function(name, slope, 0.0 if quarter else value, halves if quarter else 0)
        if function not in self.functions:
            self.functions.append(function)
        return self._room[self.functions.index(function)]

    # Terms -------------------------------------------------------------------------------------
    def rows(self, rate: fmpq_mpoly) -> list[Terms]:
        """The terms of a rate: of the drift without its constant, which the operating input balances, and of the
        factor of each input."""
        n, end = self.edges[1], self.edges[2]
        factors: list[dict[tuple[tuple[int, ...], tuple[tuple[str, int], ...], int | None], fmpq]] = [
            {} for _ in range(end - n + 1)
        ]
        for exponents, value in terms_of(rate).items():
            states, inputs, functions = exponents[:n], exponents[n:end], exponents[self.edges[4] :]
            require(sum(inputs) <= 1, "an input or a disturbance that does not enter affinely")
            require(
                sum(functions) <= 1 and not (any(functions) and any(inputs)),
                "a product of functions, or a function in g1 or g2",
            )
            row = factors[1 + inputs.index(1) if any(inputs) else 0]
            powers = self._powers(exponents)
            self.seen |= {i for i, _ in powers}
            pairs = tuple((self.names[i], power) for i, power in powers)
            index = functions.index(1) if any(functions) else None
            if index is not None and any(states):
                function = self.functions[index]
                require(
                    function.offset == 0.0 and function.name in _AT_ZERO,
                    f"a state times {function.name} of a state, away from where that is rational",
                )
                quarters = _AT_ZERO[function.name]
                row[states, pairs, None] = row.get((states, pairs, None), fmpq(0)) + value * fmpq(
                    quarters[function.pi_halves % len(quarters)]
                )
            if index is not None or any(states) or any(inputs):
                row[states, pairs, index] = row.get((states, pairs, index), fmpq(0)) + value
        return [
            tuple(Term(_exact_double(value, "the model"), *key) for key, value in row.items() if value)
            for row in factors
        ]

    def _powers(self, exponents: tuple[int, ...]) -> list[tuple[int, int]]:
        start, middle, end = self.edges[2:5]
        return [
            (i, above - below)
            for i, (above, below) in enumerate(zip(exponents[start:middle], exponents[middle:end]))
            if above != below
        ]

    def polynomial(self, part: fmpq_mpoly) -> PolynomialTerms:
        """A penalised output, with coefficients rounded to doubles: these are claimed and checked."""
        terms, n = terms_of(part), self.edges[1]
        require(
            not any(any(exponents[n:]) for exponents in terms), "a penalty that is no polynomial of the state"
        )
        return tuple((key[:n], nearest_double(value)) for key, value in terms.items() if any(key))


def _exact_double(value: fmpq, where: str) -> float:
    number = nearest_double(value)
    require(
        rational(number) == value, f"a number of {where} that is no double: make it a parameter of the plant"
    )
    return number


def require(condition: bool, what: str) -> None:
    """Refuse a plant to which the method does not apply."""
    if not condition:
        raise InvalidInput(
            "The method cannot prove anything about this plant.",
            f"expected polynomials of the state, and functions ({', '.join(FUNCTIONS)}) of linear forms, got {what}",
            "sampled_region, or the Taylor expansion as the plant: solve_hji(problem.expand(degree), …)",
        )


_BITS = 20  # of the entries of T
_LEFT_OVER = 1e-13  # of the largest coefficient of a row of h: what is smaller is rounding


def statement_of(
    solution: ValueFunction,
    gamma: float | None,
    penalty: CheckedPenalty | None,
    *,
    decay: float = 0.0,
    level: float = 1.0,
    reach: float = 1.0,
    about: str = "",
) -> Certificate:
    """The certificate to be proved of the nominal plant; arguments as `HJISolution.certify`."""
    pair = checked_pair(solution, gamma, penalty)
    fields = plant_fields(solution.problem, pair.output)
    law, h = law_polynomials(solution, fields), linear_part(fields["penalty"], len(solution.P))
    root = np.linalg.cholesky(np.linalg.inv(solution.P))
    return claim_of(
        solution,
        solution.problem,
        {**fields, "penalty": tuple(map(_without_rounding, fields["penalty"]))},
        about=about or "a state feedback",
        r2=matrix_rows(solution.expansion.r2),
        value=value_polynomial(solution),
        law=law,
        gamma=min(pair.gamma, HUGE),  # of the Hamilton–Jacobi–Bellman equation no gain is claimed
        decay=decay,
        level=level,
        coordinates=matrix_rows(coordinates(solution.expansion, h, law, solution.P, root, pair.gamma, decay)),
        reach=reach,
    )


def claim_of(
    solution: ValueFunction, problem: Problem | None, fields: PlantFields, **others: Any
) -> Certificate:
    """The certificate of a solution, with `plant_fields` and the `others`."""
    disturbances = (
        problem.disturbance_names
        if isinstance(problem, GeneralisedPlant)
        else [f"d{j + 1}" for j in range(solution.expansion.size[1])]
    )
    return Certificate(
        states=_signals(problem, solution.state_names),
        inputs=_signals(problem, solution.input_names),
        disturbances=_signals(problem, disturbances),
        **fields | {"penalty": tuple(row for row in fields["penalty"] if row)},
        **others,
    )


def value_polynomial(solution: ValueFunction, scale: float = 1.0) -> PolynomialTerms:
    """scale · V."""
    return tuple(
        (tuple(powers), scale * value)
        for degree, part in sorted(solution.value_parts.items())
        for powers, value in zip(solution.exponents(degree).tolist(), part.tolist())
        if value
    )


def matrix_rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    """A matrix as tuples of rows, the form that a claim has."""
    return tuple(map(tuple, matrix.tolist()))


def _without_rounding(row: PolynomialTerms) -> PolynomialTerms:
    largest = max((abs(value) for _, value in row), default=0.0)
    return tuple((powers, value) for powers, value in row if abs(value) > _LEFT_OVER * largest)


def _signals(problem: Problem | None, names: Iterable[str]) -> tuple[Signal, ...]:
    """Signals of a problem with their units; a command has that of its output."""
    return tuple(
        Signal(name, _unit(problem, name) or _unit(problem, name.removesuffix("_command"))) for name in names
    )


def _unit(problem: Problem | None, name: str) -> str:
    return problem.plant.unit(name).replace(" ", "·") if isinstance(problem, GeneralisedPlant) else ""


def law_polynomials(solution: ValueFunction, fields: PlantFields) -> tuple[PolynomialTerms, ...]:
    """The law −R2⁻¹ g2ᵀ V_xᵀ in doubles: the controller's own numbers if g2 is constant, else the product, rounded."""
    n, _, m, _ = solution.expansion.size
    rows: list[dict[tuple[int, ...], float]] = [{} for _ in range(m)]
    if all(not any(term.powers) for entries in fields["g2"] for row in entries for term in row):
        matrix = solution.expansion.g2_parts[0]
        for i, slope in solution.slope_parts.items():
            columns = np.array([product(slope, matrix[:, j], n, i - 1, 0) for j in range(m)])
            for row, part in zip(rows, -np.linalg.solve(solution.expansion.r2, columns)):
                powers = map(tuple, basis.exponents(n, i - 1).tolist())
                row |= {key: value for key, value in zip(powers, part.tolist()) if value}
        return tuple(tuple(row.items()) for row in rows)
    numbers = {p.name: (p.low + p.high) / 2 for p in fields.get("parameters", ())}
    price = solution.input_price
    for k, slope in solution.slope_parts.items():
        for powers, along in zip(basis.exponents(n, k - 1).tolist(), slope.tolist()):
            for value, entries in zip(along, fields["g2"]):
                for weights, term in ((price[:, j], term) for j, row in enumerate(entries) for term in row):
                    key = tuple(a + b for a, b in zip(powers, term.powers))
                    factor = prod(
                        [numbers[name] ** power for name, power in term.parameters],
                        start=value * term.coefficient,
                    )
                    for target, weight in zip(rows, weights.tolist() if value else ()):
                        target[key] = target.get(key, 0.0) - weight * factor
    return tuple(tuple((key, value) for key, value in row.items() if value) for row in rows)


def coordinates(
    plant: PolynomialPlant,
    h: np.ndarray,
    law: Sequence[PolynomialTerms],
    p: np.ndarray,
    root: np.ndarray,
    gamma: float,
    decay: float = 0.0,
) -> np.ndarray:
    """T with V_2 = ½|z|² and r_2 diagonal, both up to the 20 bits that T is rounded to; root rootᵀ = P⁻¹."""
    gain, b1 = linear_part(law, len(p)), plant.g1_parts[0][:, :, 0]
    a = plant.f_parts[1] + plant.g2_parts[0][:, :, 0] @ gain
    quadratic = (
        p @ a + a.T @ p + h.T @ h + gain.T @ plant.r2 @ gain + p @ b1 @ b1.T @ p / gamma**2 + decay * p
    )
    return few_bits(root @ np.linalg.eigh(-root.T @ quadratic @ root)[1])


def few_bits(matrix: np.ndarray) -> np.ndarray:
    """Each column rounded to `_BITS` bits of its largest entry: any invertible T is sound, a short one is quick."""
    scale: Matrix = np.exp2(_BITS - 2 - np.ceil(np.log2(np.abs(matrix).max(axis=0, keepdims=True))))
    rounded: Matrix = np.round(matrix * scale)
    return rounded / scale
