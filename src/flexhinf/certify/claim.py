"""What a certificate claims: everything that the theorem of docs/certificate.md needs, and nothing else, exactly.

All numbers are doubles, which are rationals. The plant is ẋ = f(x, p) + g1(x, p) d + g2(x, p) u with u = k(x), in
deviations x from the goal, and

    f_i = Σ over terms: coefficient · Π_j p_j^e_j · Π_k x_k^a_k · [φ(o + ℓᵀx) − φ(o)],

where the bracket is 1 for a term without a function. g1 and g2 are sums of such terms without functions. A value that
is no double stands as a parameter with an interval around it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from flexhinf.certify.terms import (
    MOST_CHANNELS,
    MOST_FUNCTIONS,
    MOST_PARAMETERS,
    MOST_STATES,
    ONLY_KNOWN,
    Double,
    Entries,
    Function,
    Matrix,
    Name,
    Observer,
    Parameter,
    Polynomial,
    Signal,
    Start,
    Terms,
    check_line,
    check_names,
    check_parameters,
    check_powers,
    check_slopes,
    require,
)
from flexhinf.validation import distinct, value_text


@dataclass(frozen=True, repr=False)
class Claim:
    """On the component of {V ≤ level} around 0 the dissipation inequality holds; see docs/certificate.md.

    Attributes
    ----------
    about : str
        What was certified, for readers: robot, goal, design. Nothing is derived from it.
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
    sampled_level, attained_gain : float or None
        The level that sampling found, and a gain that some disturbance attained: no part of the theorem.
    provenance : dict of str to str
        Version, command, statistics of the search: no part of the theorem.
    """

    __pydantic_config__ = ONLY_KNOWN

    about: Name
    states: Annotated[tuple[Signal, ...], Field(max_length=MOST_STATES)]
    inputs: Annotated[tuple[Signal, ...], Field(max_length=MOST_CHANNELS)]
    disturbances: Annotated[tuple[Signal, ...], Field(max_length=MOST_CHANNELS)]
    drift: Annotated[tuple[Terms, ...], Field(max_length=MOST_STATES)]
    g1: Entries
    g2: Entries
    penalty: Annotated[tuple[Polynomial, ...], Field(max_length=2 * MOST_STATES)]
    r2: Matrix
    value: Polynomial
    law: Annotated[tuple[Polynomial, ...], Field(max_length=MOST_CHANNELS)]
    gamma: Double
    level: Double
    coordinates: Matrix
    reach: Double
    decay: Double = 0.0
    parameters: Annotated[tuple[Parameter, ...], Field(max_length=MOST_PARAMETERS)] = ()
    functions: Annotated[tuple[Function, ...], Field(max_length=MOST_FUNCTIONS)] = ()
    shift: Annotated[tuple[tuple[Double, Double], ...], Field(max_length=MOST_STATES)] = ()
    starts: Annotated[tuple[Start, ...], Field(max_length=8)] = ()
    feedback: Name = "state"
    observer: Observer | None = None
    sampled_level: Double | None = None
    attained_gain: Double | None = None
    provenance: Annotated[dict[Name, Name], Field(max_length=100)] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n, m, w = len(self.states), len(self.inputs), len(self.disturbances)
        require(n > 0 and m > 0 and w > 0, "states, inputs and disturbances", f"{n}, {m}, {w} of them")
        distinct(
            "The certificate's signal", [s.name for s in (*self.states, *self.inputs, *self.disturbances)]
        )
        require(len(self.value) > 0, "a V that is not zero", "no monomial")
        distinct("The certificate's parameter", [p.name for p in self.parameters])
        check_line("what the certificate is about", self.about)
        for text in (*self.provenance, *self.provenance.values()):
            check_line("the certificate's provenance", text)
        self._check_feedback()
        self._check_numbers()
        self._check_shapes(n, m, w)
        self._check_terms(n)

    def _check_feedback(self) -> None:
        expected = "state" if self.observer is None else "output injection observer"
        require(self.feedback == expected, f"feedback {expected!r}", value_text(self.feedback, 60))
        if self.observer is not None:
            self.observer.check_shapes([s.name for s in self.states])
            require(
                self.observer.energy < self.level,
                f"errors of an energy below the level {self.level!r}",
                repr(self.observer.energy),
            )

    def _check_numbers(self) -> None:
        for name in ("gamma", "level", "reach"):
            require(getattr(self, name) > 0, f"a positive {name}", repr(getattr(self, name)))
        require(self.decay >= 0, "a decay that is not negative", repr(self.decay))
        for low, high in self.shift:
            require(low <= high, "shifts with low ≤ high", f"{low!r}, {high!r}")

    def _check_shapes(self, n: int, m: int, w: int) -> None:
        shapes = {
            "drift": (n, [0], [0]),
            "g1": (n, [w], [len(row) for row in self.g1]),
            "g2": (n, [m], [len(row) for row in self.g2]),
            "coordinates": (n, [n], [len(row) for row in self.coordinates]),
            "r2": (m, [m], [len(row) for row in self.r2]),
            "law": (m, [0], [0]),
            "shift": (n if self.shift else 0, [0], [0]),
        }
        for name, (rows, columns, got) in shapes.items():
            length = len(getattr(self, name))
            fits = length == rows and all(entry in columns for entry in got)
            require(fits, f"{rows} rows of {columns[0] or 'one'} in {name}", f"{length} rows of {got}")
        for start in self.starts:
            require(len(start.path) == n, f"starts with {n} states", f"{len(start.path)}")

    def _check_terms(self, n: int) -> None:
        for name, polynomials in (("value", (self.value,)), ("law", self.law), ("penalty", self.penalty)):
            lowest = 2 if name == "value" else 1
            for polynomial in polynomials:
                check_powers(name, [powers for powers, _ in polynomial], n, lowest)
                distinct(f"A monomial of {name}", [str(powers) for powers, _ in polynomial])
        known = {p.name for p in self.parameters}
        for rows, lowest, most in (((self.drift,), 1, len(self.functions)), (self.g1, 0, 0), (self.g2, 0, 0)):
            for terms in (terms for row in rows for terms in row):
                plain = [term.powers for term in terms if term.function is None]
                check_powers("the plant", plain, n, lowest)
                check_powers("the plant", [term.powers for term in terms if term.function is not None], n, 0)
                check_names(terms, known, most)
        plant = [term for row in (self.drift, *self.g1, *self.g2) for terms in row for term in terms]
        check_parameters(self.parameters, plant)
        check_slopes(self.functions, n)
        for start in self.starts:
            check_slopes(start.functions, 1)
            for terms in start.path:
                check_powers("a start", [term.powers for term in terms if term.function is None], 1, 1)
                check_powers("a start", [term.powers for term in terms if term.function is not None], 1, 0)
                check_names(terms, known, len(start.functions))

    @property
    def degree(self) -> int:
        """Of V."""
        return max(sum(powers) for powers, _ in self.value)

    @property
    def start_level(self) -> float:
        """Level of V that starts may have: what the errors of the estimates may take is kept."""
        return self.level if self.observer is None else self.level - self.observer.energy

    @property
    def step_amplitude(self) -> float:
        """Largest amplitude of the proved paths of starts; 0.0 where none is stated."""
        return max((start.amplitude for start in self.starts), default=0.0)
