"""The claim of a certificate: exactly the data that the theorem of docs/theorem.md needs.

All numbers are doubles, which are rationals. The plant is ẋ = f(x, p) + g1(x, p) d + g2(x, p) u with u = k(x), in
deviations x from the goal, and

    f_i = Σ over terms: coefficient · Π_j p_j^e_j · Π_k x_k^a_k · [φ(o + ℓᵀx) − φ(o)],

where the bracket is 1 for a term without a function. g1 and g2 are sums of such terms without functions. A value that
is not a double is a parameter with an interval around the value.

The parts of a certificate: signals, parameters, elementary functions, terms of a vector field, paths of starts.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated

from pydantic import BeforeValidator, ConfigDict, Field, PlainSerializer, Strict

from flexhinf.errors import InvalidInput
from flexhinf.validation import HUGE, LONGEST_NAME, checked_text, distinct, value_text

#: Elementary functions that may stand in a vector field; the checker has a bound on the derivatives of each.
FUNCTIONS = ("sin", "cos", "exp", "tanh", "arctan", "log")

MOST_STATES, MOST_CHANNELS, MOST_PARAMETERS, MOST_FUNCTIONS, MOST_TERMS = 5, 5, 32, 8, 20_000

#: Highest degree of V, and of any other polynomial, that a certificate may have.
HIGHEST_DEGREE = 10

#: Of which controller a theorem is.
LAW_ALONE = (
    "the law alone; the controller as saved acts by it, on an estimate, sampled and late, while no bit of its status "
    "is set and no input is at its limit"
)

_LONGEST_LINE = 1000

#: A unit does not begin with a digit, which would continue the number before it; "1/s" does not either.
_UNIT = re.compile(r"|(?:1/)?(?:[^\W\d_]|[°%(])(?:[^\W_]|[·⋅/^°*().%⁻-]){0,17}")
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

_HEXADECIMAL = re.compile(r"-?0x[01](\.[0-9a-f]{1,13})?p[+-]\d{1,4}")

#: Names that the formulas of the theorem have for something else; and those that no parameter may have beside: the
#: amplitude of a path of starts, and the vectors of states, inputs and disturbances.
_OF_THEOREM, _NO_PARAMETERS = (*FUNCTIONS, "pi", "gamma", "z", "V", "S", "R2"), ("a", "x", "u", "d")


def _double(value: object) -> float:
    """A double from a number, or from its hexadecimal text in a file; finite, and within ±1e30."""
    if isinstance(value, str) and _HEXADECIMAL.fullmatch(value):
        value = float.fromhex(value) if int(value.partition("p")[2]) < 1000 else float("inf")
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
PolynomialTerms = Annotated[tuple[tuple[Powers, Double], ...], Field(max_length=MOST_TERMS)]
MatrixRows = Annotated[
    tuple[Annotated[tuple[Double, ...], Field(max_length=MOST_STATES)], ...], Field(max_length=MOST_STATES)
]


#: A check of a part of a certificate: whether it fits, expected text, received text.
Check = tuple[bool, str, str]


class ClaimPart:
    """Base of the parts of a certificate. An unknown key is refused, as it would be in the file but not in the
    theorem."""

    __pydantic_config__ = ConfigDict(extra="forbid")


@dataclass(frozen=True)
class Signal(ClaimPart):
    """The name and the unit of a state, an input or a disturbance."""

    name: Name
    unit: Name = ""

    def __post_init__(self) -> None:
        check_named("signal", self.name, self.unit)


@dataclass(frozen=True)
class Parameter(ClaimPart):
    """A parameter of the plant, anywhere in [low, high], in `unit`; constant in time."""

    name: Name
    low: Double
    high: Double
    unit: Name = ""

    def __post_init__(self) -> None:
        check_named("parameter", self.name, self.unit)
        ends = f"{self.low!r}, {self.high!r}"
        require((self.low <= self.high, f"low ≤ high for the parameter {self.name}", ends))

    @property
    def middle(self) -> float:
        """Middle of the range, as a double."""
        return 0.5 * (self.low + self.high)


@dataclass(frozen=True)
class Function(ClaimPart):
    """φ(o + s) − φ(o) of s = ℓᵀx, with o = offset + pi_halves · π/2; φ is one of `FUNCTIONS`, `name`.

    Multiples of π/2 stand apart because π is no double, and about 180° a sine is odd only in exact numbers.
    """

    name: Name
    slope: Annotated[tuple[Double, ...], Field(max_length=MOST_STATES)]
    offset: Double = 0.0
    pi_halves: Annotated[int, Strict(), Field(ge=-64, le=64)] = 0

    def __post_init__(self) -> None:
        require(
            (self.name in FUNCTIONS, f"a function among {', '.join(FUNCTIONS)}", value_text(self.name, 60))
        )


@dataclass(frozen=True)
class Term(ClaimPart):
    """coefficient · Π p_j^e_j · Π x_k^a_k · (function of this index, if any); parameters are (name, exponent) pairs."""

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
class Start(ClaimPart):
    """A continuous path of starts x(a), 0 ≤ a ≤ amplitude, from x(0) = 0: each is proved to lie in the region.

    x_i(a) is a sum of terms in the one variable a, with functions of ℓa, plus `table_i` interpolated linearly over
    `amplitudes`. A path inside {V ≤ c} stays in the component of 0.

    `rule` says how the controller starts its integrators, `amplitude` is in the unit of the moved state.
    """

    rule: Name  # a sentence: what the theorem says about x(0)
    amplitude: Double
    path: Annotated[tuple[Terms, ...], Field(max_length=MOST_STATES)]  # one per state, in powers (k,) of a
    functions: Annotated[tuple[Function, ...], Field(max_length=MOST_FUNCTIONS)] = ()  # slopes of length 1
    #: From 0 to `amplitude`, strictly growing; empty without a table.
    amplitudes: Annotated[tuple[Double, ...], Field(max_length=MOST_TERMS)] = ()
    #: Per state the values there; empty for states without one.
    table: Annotated[
        tuple[Annotated[tuple[Double, ...], Field(max_length=MOST_TERMS)], ...], Field(max_length=MOST_STATES)
    ] = ()

    def __post_init__(self) -> None:
        check_line("the start rule of the certificate", self.rule)
        grid, lengths = self.amplitudes, [len(row) for row in self.table]
        moved = any(row[0] for row in self.table if row) or any(
            term.coefficient and not any(term.powers) and term.function is None
            for row in self.path
            for term in row
        )
        require(
            (self.amplitude > 0, "a positive amplitude of the starts", repr(self.amplitude)),
            (
                (not grid or (len(grid) > 1 and grid[0] == 0 and grid[-1] == self.amplitude))
                and all(a < b for a, b in pairwise(grid)),
                f"amplitudes that grow from 0 to {self.amplitude!r}",
                value_text(grid, 100),
            ),
            (
                (not grid or len(lengths) == len(self.path))
                and all(length in (0, len(grid)) for length in lengths),
                f"a table of {len(self.path)} rows with {len(grid)} or no values",
                f"rows of {lengths}",
            ),
            (not moved, "a path of starts from x(0) = 0", "another first state"),
        )


@dataclass(frozen=True)
class Observer(ClaimPart):
    """x̂' = f with its nonlinear part taken from y, + g2 u + L (y − C x̂), of the n_e states that are not `known`."""

    measured: MatrixRows  # C (p, n): y = C x, in deviations
    # Integrators, whose estimates have no errors.
    known: Annotated[tuple[Name, ...], Field(max_length=MOST_STATES)]
    gain: MatrixRows  # L (n_e, p)
    weight: MatrixRows  # M (n_e, n_e)
    storage: MatrixRows  # X (n_e, n_e): ½ eᵀXe pays for ½ eᵀMe ≥ ½ vᵀR2v, v = k(x̂) − k(x)
    gain_error: Double  # γ_e: ½ γ_e² |d|² pays for what disturbances do to e; 0 where they do nothing
    energy: Double  # ε: initial errors e₀ have ½ e₀ᵀXe₀ + ½ γ_e² ∫|d|² ≤ ε

    def __post_init__(self) -> None:
        distinct("A state that is known to the controller", list(self.known))
        require(
            (self.gain_error >= 0, "a γ_e that is not negative", repr(self.gain_error)),
            (self.energy > 0, "a positive energy of the observer's errors", repr(self.energy)),
        )


def check_named(what: str, name: str, unit: str) -> None:
    """Raise for a name that is no identifier or a unit that is prose: both stand in the formulas of the theorem, which
    a name such as ``2*mass`` or ``0`` would make another one."""
    if not (_IDENTIFIER.fullmatch(name) and len(name) <= 2 * LONGEST_NAME):
        raise InvalidInput(
            f"A {what} of the certificate has no usable name.",
            f"expected at most {2 * LONGEST_NAME} letters without accents, digits and underscores, no digit first, got "
            f"{value_text(name, 60)}",
            "a name such as 'link_position'",
        )
    expected = f"a unit of at most 20 letters, digits and marks such as · / ^ ² ° for the {what} {name}"
    require((_UNIT.fullmatch(unit) is not None, expected, value_text(unit, 60)))


def check_names(**names: Sequence[str]) -> None:
    """Refuse a name that stands twice among all that the theorem prints, or that the theorem itself has for something
    else; names by what they are of: state, input, disturbance, parameter."""
    distinct("The certificate's name", [name for part in names.values() for name in part])
    for what, part in names.items():
        taken = {*_OF_THEOREM, *(_NO_PARAMETERS if what == "parameter" else ())}
        for name in part:
            if name in taken:
                raise InvalidInput(
                    f"A {what} of the certificate has the name of something else in its theorem.",
                    f"expected none of {', '.join(sorted(taken))}, got {value_text(name, 60)}",
                    f"another name, such as '{what}_{name}'",
                )


def check_line(what: str, text: str) -> None:
    """Raise unless a text is one short line: the theorem is printed line by line, and no text may imitate another
    part."""
    checked_text(what, text)
    require(
        ("\n" not in text and len(text) <= _LONGEST_LINE, f"one short line as {what}", value_text(text, 60))
    )


def require(*checks: Check) -> None:
    """Raise `InvalidInput` where a certificate does not fit together."""
    for condition, expected, got in checks:
        if not condition:
            raise InvalidInput(
                "The certificate does not fit together.", f"expected {expected}, got {got}", "all its parts"
            )


def rows_fit(name: str, matrix: Sequence[Sequence[object]], rows: int, columns: int) -> Check:
    """Whether a matrix has this shape."""
    lengths = [len(row) for row in matrix]
    return lengths == [columns] * rows, f"{rows} rows of {columns} in {name}", f"rows of {lengths}"


def powers_fit(name: str, powers: tuple[int, ...], n: int, lowest: int) -> Check:
    """Whether there are n exponents with a sum from `lowest` to `HIGHEST_DEGREE`."""
    return (
        len(powers) == n and lowest <= sum(powers) <= HIGHEST_DEGREE,
        f"{n} exponents of sum {lowest} to {HIGHEST_DEGREE} in {name}",
        f"{powers}",
    )


def check_terms(
    name: str, rows: Iterable[Terms], n: int, lowest: int, known: set[str], functions: tuple[Function, ...]
) -> None:
    """Refuse terms with other exponents, with parameters that are not stated or stand twice, and functions that are not
    there; a term without a function has at least degree `lowest`."""
    for term in (term for row in rows for term in row):
        names = [parameter for parameter, _ in term.parameters]
        unknown = [parameter for parameter in names if parameter not in known]
        require(
            powers_fit(name, term.powers, n, lowest if term.function is None else 0),
            (not unknown, "parameters that are stated", value_text(unknown, 80)),
            (
                term.function is None or term.function < len(functions),
                f"functions below {len(functions)}",
                f"{term.function}",
            ),
        )
        distinct("A term's parameter", names)
    require(*((len(f.slope) == n, f"slopes of length {n}", f"{len(f.slope)}") for f in functions))


@dataclass(frozen=True, repr=False)
class Claim(ClaimPart):
    """On the component of {V ≤ level} around 0 the dissipation inequality holds; see docs/theorem.md.

    Attributes
    ----------
    about : str
        The certified robot, goal and design, for readers; nothing is derived from this text.
    states, inputs, disturbances : tuple of Signal
        n ≤ 5 states, deviations from the goal.
    drift : tuple of Terms, (n,)
        f, without the input.
    g1, g2 : n rows of Terms for each disturbance and input
    penalty : tuple of Polynomial, (s,)
        h(x): z = (h, R2^½ u).
    r2 : matrix, (m, m)
        Symmetric, positive definite.
    value : Polynomial
        V, from degree 2 on.
    law : tuple of Polynomial, (m,)
        k(x), what the controller computes.
    gamma, decay, level : float
        γ, α ≥ 0 in V̇ ≤ −αV + ½γ²|d|² − ½|z|², and c.
    coordinates : matrix, (n, n)
        T of x = T z, in whose cubes the cells are cut; any invertible matrix is sound.
    reach : float
        The region lies in max|z_i| ≤ reach.
    parameters : tuple of Parameter
        The box for which the theorem holds.
    shift : tuple of (low, high), n or none
        δ, by which the plant's equilibrium differs from the point about which the law works: u = k(x + δ) − k(δ).
    feedback : str
        "state": the law is fed the true state; "output injection observer": also what `observer` estimates.
    observer : Observer or None
        With it, starts are claimed to lie in {V ≤ level − its energy}.
    controller : str
        Of which controller the theorem is: `LAW_ALONE`.
    sampled_level, attained_gain : float or None
        The level that sampling found, and a gain that some disturbance attained: no part of the theorem.
    provenance : dict of str to str
        Version, command, statistics of the search: no part of the theorem.
    """

    about: Name
    states: Annotated[tuple[Signal, ...], Field(max_length=MOST_STATES)]
    inputs: Annotated[tuple[Signal, ...], Field(max_length=MOST_CHANNELS)]
    disturbances: Annotated[tuple[Signal, ...], Field(max_length=MOST_CHANNELS)]
    drift: Annotated[tuple[Terms, ...], Field(max_length=MOST_STATES)]
    g1: Entries
    g2: Entries
    penalty: Annotated[tuple[PolynomialTerms, ...], Field(max_length=2 * MOST_STATES)]
    r2: MatrixRows
    value: PolynomialTerms
    law: Annotated[tuple[PolynomialTerms, ...], Field(max_length=MOST_CHANNELS)]
    gamma: Double
    level: Double
    coordinates: MatrixRows
    reach: Double
    decay: Double = 0.0
    parameters: Annotated[tuple[Parameter, ...], Field(max_length=MOST_PARAMETERS)] = ()
    functions: Annotated[tuple[Function, ...], Field(max_length=MOST_FUNCTIONS)] = ()
    shift: Annotated[tuple[tuple[Double, Double], ...], Field(max_length=MOST_STATES)] = ()
    starts: Annotated[tuple[Start, ...], Field(max_length=8)] = ()
    feedback: Name = "state"
    observer: Observer | None = None
    controller: Name = LAW_ALONE
    sampled_level: Double | None = None
    attained_gain: Double | None = None
    provenance: Annotated[dict[Name, Name], Field(max_length=100)] = field(default_factory=dict[str, str])

    def __post_init__(self) -> None:
        n, m, w = map(len, (self.states, self.inputs, self.disturbances))
        check_line("what the certificate is about", self.about)
        for text in (*self.provenance, *self.provenance.values()):
            check_line("the certificate's provenance", text)
        require(
            (n > 0 and m > 0 and w > 0, "states, inputs and disturbances", f"{n}, {m}, {w} of them"),
            (len(self.value) > 0, "a V that is not zero", "no monomial"),
            (self.gamma > 0, "a positive gamma", repr(self.gamma)),
            (self.level > 0, "a positive level", repr(self.level)),
            (self.reach > 0, "a positive reach", repr(self.reach)),
            (self.decay >= 0, "a decay that is not negative", repr(self.decay)),
            *((low <= high, "shifts with low ≤ high", f"{low!r}, {high!r}") for low, high in self.shift),
            (len(self.drift) == n, f"{n} rows of drift", f"{len(self.drift)}"),
            (len(self.law) == m, f"{m} rows of law", f"{len(self.law)}"),
            (len(self.shift) in (0, n), f"{n} rows of shift", f"{len(self.shift)}"),
            rows_fit("g1", self.g1, n, w),
            rows_fit("g2", self.g2, n, m),
            rows_fit("coordinates", self.coordinates, n, n),
            rows_fit("r2", self.r2, m, m),
        )
        check_names(
            state=[s.name for s in self.states],
            input=[s.name for s in self.inputs],
            disturbance=[s.name for s in self.disturbances],
            parameter=[p.name for p in self.parameters],
        )
        self._check_feedback()
        self._check_terms(n)

    def _check_feedback(self) -> None:
        expected = "state" if self.observer is None else "output injection observer"
        require(
            (self.feedback == expected, f"feedback {expected!r}", value_text(self.feedback, 60)),
            (self.controller == LAW_ALONE, f"controller {LAW_ALONE!r}", value_text(self.controller, 60)),
        )
        if (observer := self.observer) is None:
            return
        names = [s.name for s in self.states]
        unknown = [name for name in observer.known if name not in names]
        e, p = len(names) - len(observer.known), len(observer.measured)
        require(
            (not unknown, "known states among the states", value_text(unknown, 80)),
            (e > 0 and p > 0, "an observer that measures and estimates something", f"{p} and {e}"),
            rows_fit("the observer's measured", observer.measured, p, len(names)),
            rows_fit("the observer's gain", observer.gain, e, p),
            rows_fit("the observer's weight", observer.weight, e, e),
            rows_fit("the observer's storage", observer.storage, e, e),
            (
                observer.energy < self.level,
                f"errors of an energy below the level {self.level!r}",
                repr(observer.energy),
            ),
        )

    def _check_terms(self, n: int) -> None:
        slopes = ((name, 1, row) for name in ("law", "penalty") for row in getattr(self, name))
        for name, lowest, polynomial in (("value", 2, self.value), *slopes):
            require(*(powers_fit(name, powers, n, lowest) for powers, _ in polynomial))
            distinct(f"A monomial of {name}", [str(powers) for powers, _ in polynomial])
        known, channels = {p.name for p in self.parameters}, [*self.g1, *self.g2]
        check_terms("the plant", self.drift, n, 1, known, self.functions)
        check_terms("the plant", (terms for rows in channels for terms in rows), n, 0, known, ())
        for start in self.starts:
            require((len(start.path) == n, f"starts with {n} states", f"{len(start.path)}"))
            check_terms("a start", start.path, 1, 1, known, start.functions)
        pairs = {
            pair for rows in (self.drift, *channels) for terms in rows for t in terms for pair in t.parameters
        }
        for p in self.parameters:
            used = {exponent for name, exponent in pairs if name == p.name and exponent}
            require(
                (len(used) <= 1, f"one exponent of {p.name}, so that r is affine in it", f"{sorted(used)}"),
                (
                    used <= {1} or p.low > 0 or p.high < 0,
                    f"{p.name} ≠ 0 under its exponent",
                    f"{sorted(used)}",
                ),
            )

    @property
    def degree(self) -> int:
        """Degree of V."""
        return max(sum(powers) for powers, _ in self.value)

    @property
    def middle(self) -> dict[str, float]:
        """The middle of each parameter's range, by name."""
        return {parameter.name: parameter.middle for parameter in self.parameters}

    @property
    def start_level(self) -> float:
        """The level of V that starts must not exceed; with an observer, its errors take the rest."""
        return self.level if self.observer is None else self.level - self.observer.energy

    @property
    def step_amplitude(self) -> float:
        """Largest amplitude of the proved paths of starts; 0.0 where none is stated."""
        return max((start.amplitude for start in self.starts), default=0.0)
