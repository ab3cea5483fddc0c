"""The parts of a certificate: signals, parameters, elementary functions, terms of a vector field, paths of starts."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, Field, PlainSerializer, Strict

from flexhinf.errors import InvalidInput
from flexhinf.validation import HUGE, LONGEST_NAME, checked_name, checked_text, distinct, value_text

#: Elementary functions that may stand in a vector field; the checker has a bound on the derivatives of each.
FUNCTIONS = ("sin", "cos", "exp", "tanh", "arctan", "log")

MOST_STATES, MOST_CHANNELS, MOST_PARAMETERS, MOST_FUNCTIONS, MOST_TERMS = 5, 5, 32, 8, 20_000

#: Highest degree of V, and of any other polynomial, that a certificate may have.
HIGHEST_DEGREE = 10

#: A key that no entry has is refused: what it says would stand in the file, and not in the theorem.
ONLY_KNOWN = ConfigDict(extra="forbid")

_LONGEST_LINE = 1000

_UNIT = re.compile(r"(?:[^\W_]|[·⋅/^°*().%⁻-]){0,20}")
_HEXADECIMAL = re.compile(r"-?0x[01](\.[0-9a-f]{1,13})?p[+-]\d{1,4}")


def _double(value: Any) -> Any:
    """A double from a number, or from its hexadecimal text in a file; finite, and within ±1e30."""
    if isinstance(value, str) and _HEXADECIMAL.fullmatch(value):
        exponent = int(value.partition("p")[2])
        value = float.fromhex(value) if exponent < 1000 else float("inf")
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= HUGE:
        raise ValueError(
            f"a finite number within ±{HUGE:g}, in a file as hexadecimal text such as '0x1.8p+1'"
        )
    return float(value)


Double = Annotated[
    float,
    BeforeValidator(_double),
    PlainSerializer(lambda value: float(value).hex(), return_type=str, when_used="json"),
]
Powers = Annotated[
    tuple[Annotated[int, Strict(), Field(ge=0, le=HIGHEST_DEGREE)], ...], Field(max_length=MOST_STATES)
]
Name = Annotated[str, Strict()]

#: A polynomial in the states: its monomials' exponents and coefficients, each monomial once.
Polynomial = Annotated[tuple[tuple[Powers, Double], ...], Field(max_length=MOST_TERMS)]
Matrix = Annotated[
    tuple[Annotated[tuple[Double, ...], Field(max_length=MOST_STATES)], ...], Field(max_length=MOST_STATES)
]


@dataclass(frozen=True)
class Signal:
    """The name and the unit of a state, an input or a disturbance."""

    __pydantic_config__ = ONLY_KNOWN

    name: Name
    unit: Name = ""

    def __post_init__(self) -> None:
        check_named("signal", self.name, self.unit)


@dataclass(frozen=True)
class Parameter:
    """A parameter of the plant, anywhere in [low, high], in `unit`; constant in time."""

    __pydantic_config__ = ONLY_KNOWN

    name: Name
    low: Double
    high: Double
    unit: Name = ""

    def __post_init__(self) -> None:
        check_named("parameter", self.name, self.unit)
        require(
            self.low <= self.high, f"low ≤ high for the parameter {self.name}", f"{self.low!r}, {self.high!r}"
        )

    @property
    def middle(self) -> float:
        """Of the range, as a double."""
        return 0.5 * (self.low + self.high)


@dataclass(frozen=True)
class Function:
    """φ(o + s) − φ(o) of s = ℓᵀx, with o = offset + pi_halves · π/2; φ is one of `FUNCTIONS`, `name`.

    Multiples of π/2 stand apart because π is no double, and about 180° a sine is odd only in exact numbers.
    """

    __pydantic_config__ = ONLY_KNOWN

    name: Name
    slope: Annotated[tuple[Double, ...], Field(max_length=MOST_STATES)]
    offset: Double = 0.0
    pi_halves: Annotated[int, Strict(), Field(ge=-64, le=64)] = 0

    def __post_init__(self) -> None:
        require(self.name in FUNCTIONS, f"a function among {', '.join(FUNCTIONS)}", value_text(self.name, 60))


@dataclass(frozen=True)
class Term:
    """coefficient · Π p_j^e_j · Π x_k^a_k · (function of this index, if any); parameters are (name, exponent) pairs."""

    __pydantic_config__ = ONLY_KNOWN

    coefficient: Double
    powers: Powers
    parameters: Annotated[
        tuple[tuple[Name, Annotated[int, Strict(), Field(ge=-4, le=4)]], ...],
        Field(max_length=MOST_PARAMETERS),
    ] = ()
    function: Annotated[int, Strict(), Field(ge=0)] | None = None


Terms = Annotated[tuple[Term, ...], Field(max_length=MOST_TERMS)]
Entries = Annotated[
    tuple[Annotated[tuple[Terms, ...], Field(max_length=MOST_CHANNELS)], ...], Field(max_length=MOST_STATES)
]


@dataclass(frozen=True)
class Start:
    """A continuous path of starts x(a), 0 ≤ a ≤ amplitude, from x(0) = 0: each is proved to lie in the region.

    x_i(a) is a sum of terms in the one variable a, with functions of ℓa, plus `table_i` interpolated linearly over
    `amplitudes`. A path inside {V ≤ c} stays in the component of 0.

    Attributes
    ----------
    rule : str
        How the controller starts its integrators, as a sentence: what the theorem says about x(0).
    amplitude : float
        In the unit of the moved state.
    path : tuple of Terms, one per state
        In powers (k,) of a.
    functions : tuple of Function
        Of one variable: slopes of length 1.
    amplitudes : tuple of float
        From 0 to `amplitude`, strictly growing; empty without a table.
    table : tuple of tuple of float
        Per state the values there; empty for states without one.
    """

    __pydantic_config__ = ONLY_KNOWN

    rule: Name
    amplitude: Double
    path: Annotated[tuple[Terms, ...], Field(max_length=MOST_STATES)]
    functions: Annotated[tuple[Function, ...], Field(max_length=MOST_FUNCTIONS)] = ()
    amplitudes: Annotated[tuple[Double, ...], Field(max_length=MOST_TERMS)] = ()
    table: Annotated[
        tuple[Annotated[tuple[Double, ...], Field(max_length=MOST_TERMS)], ...], Field(max_length=MOST_STATES)
    ] = ()

    def __post_init__(self) -> None:
        check_line("the start rule of the certificate", self.rule)
        require(self.amplitude > 0, "a positive amplitude of the starts", repr(self.amplitude))
        grid = self.amplitudes
        rising = all(a < b for a, b in pairwise(grid))
        spans = not grid or (len(grid) > 1 and grid[0] == 0 and grid[-1] == self.amplitude)
        require(rising and spans, f"amplitudes that grow from 0 to {self.amplitude!r}", value_text(grid, 100))
        lengths = [len(row) for row in self.table]
        require(
            (not grid or len(lengths) == len(self.path))
            and all(length in (0, len(grid)) for length in lengths),
            f"a table of {len(self.path)} rows with {len(grid)} or no values",
            f"rows of {lengths}",
        )
        from_zero = not any(row[0] for row in self.table if row) and not any(
            term.coefficient and not any(term.powers) and term.function is None
            for row in self.path
            for term in row
        )
        require(from_zero, "a path of starts from x(0) = 0", "another first state")


@dataclass(frozen=True)
class Observer:
    """x̂' = f with its nonlinear part taken from y, + g2 u + L (y − C x̂), of the n_e states that are not `known`.

    Attributes
    ----------
    measured : matrix, (p, n)
        C: y = C x, in deviations.
    known : tuple of str
        States that the controller computes itself (its integrators): their estimates have no errors.
    gain : matrix, (n_e, p)
        L.
    weight, storage : matrices, (n_e, n_e)
        M and X: ½ eᵀXe pays for ½ eᵀMe ≥ ½ vᵀR2v, v = k(x̂) − k(x).
    gain_error : float
        γ_e: ½ γ_e² |d|² pays for what disturbances do to e; 0 where they do nothing.
    energy : float
        ε: initial errors e₀ have ½ e₀ᵀXe₀ + ½ γ_e² ∫|d|² ≤ ε.
    """

    __pydantic_config__ = ONLY_KNOWN

    measured: Matrix
    known: Annotated[tuple[Name, ...], Field(max_length=MOST_STATES)]
    gain: Matrix
    weight: Matrix
    storage: Matrix
    gain_error: Double
    energy: Double

    def __post_init__(self) -> None:
        distinct("A state that is known to the controller", list(self.known))
        require(self.gain_error >= 0, "a γ_e that is not negative", repr(self.gain_error))
        require(self.energy > 0, "a positive energy of the observer's errors", repr(self.energy))

    def check_shapes(self, states: list[str]) -> None:
        """Refuse matrices that do not fit these states."""
        unknown = [name for name in self.known if name not in states]
        require(not unknown, "known states among the states", value_text(unknown, 80))
        n, e, p = len(states), len(states) - len(self.known), len(self.measured)
        require(e > 0 and p > 0, "an observer that measures and estimates something", f"{p} and {e}")
        shapes = {"measured": (p, n), "gain": (e, p), "weight": (e, e), "storage": (e, e)}
        for name, (rows, columns) in shapes.items():
            matrix = getattr(self, name)
            fits = len(matrix) == rows and all(len(row) == columns for row in matrix)
            require(fits, f"{rows} rows of {columns} in the observer's {name}", f"{len(matrix)} rows")


def check_named(what: str, name: str, unit: str) -> None:
    """Refuse a name of several words and a unit that is a text: both stand among what is proved, as part of it."""
    checked_name(f"a {what} of the certificate", name, without=",=", longest=2 * LONGEST_NAME)
    require(
        _UNIT.fullmatch(unit) is not None,
        f"a unit of at most 20 letters, digits and marks such as · / ^ ² ° for the {what} {name}",
        value_text(unit, 60),
    )


def check_line(what: str, text: str) -> None:
    """Refuse a text that is no single short line: the theorem is printed line by line, and none of them may look like
    another part of it."""
    checked_text(what, text)
    require(
        "\n" not in text and len(text) <= _LONGEST_LINE, f"one short line as {what}", value_text(text, 60)
    )


def require(holds: bool, expected: str, got: str) -> None:
    """Refuse a certificate for which this does not hold, as an `InvalidInput`."""
    if not holds:
        raise InvalidInput(
            "The certificate does not fit together.", f"expected {expected}, got {got}", "all its parts"
        )


def check_powers(name: str, powers: list[tuple[int, ...]], n: int, lowest: int) -> None:
    """Refuse exponents of another length than n, or of a sum outside `lowest` to `HIGHEST_DEGREE`."""
    for exponents in powers:
        fits = len(exponents) == n and lowest <= sum(exponents) <= HIGHEST_DEGREE
        require(fits, f"{n} exponents of sum {lowest} to {HIGHEST_DEGREE} in {name}", f"{exponents}")


def check_names(terms: tuple[Term, ...], known: set[str], functions: int) -> None:
    """Refuse parameters that are not stated, or stand twice in a term, and functions that are not there."""
    for term in terms:
        names = [name for name, _ in term.parameters]
        unknown = [name for name in names if name not in known]
        require(not unknown, "parameters that are stated", value_text(unknown, 80))
        distinct("A term's parameter", names)
        fits = term.function is None or term.function < functions
        require(fits, f"functions below {functions}", f"{term.function}")


def check_slopes(functions: tuple[Function, ...], n: int) -> None:
    """Refuse functions of another number of variables than n."""
    for function in functions:
        require(len(function.slope) == n, f"slopes of length {n}", f"{len(function.slope)}")


def check_parameters(parameters: tuple[Parameter, ...], terms: list[Term]) -> None:
    """Refuse what is not affine in a power of each parameter, and a box in which that power is not monotone."""
    exponents: dict[str, set[int]] = {}
    for name, exponent in (pair for term in terms for pair in term.parameters):
        exponents.setdefault(name, set()).add(exponent)
    for parameter in parameters:
        found = exponents.get(parameter.name, set()) - {0}
        require(
            len(found) <= 1,
            f"one exponent of {parameter.name}, so that r is affine in it",
            f"{sorted(found)}",
        )
        keeps_sign = parameter.low > 0 or parameter.high < 0
        require(found <= {1} or keeps_sign, f"{parameter.name} ≠ 0 under its exponent", f"{sorted(found)}")
