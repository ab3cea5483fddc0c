"""A certificate: everything that the theorem of docs/certificate.md needs, and nothing else, exactly.

All numbers are doubles, which are rationals; a file has them in hexadecimal, so that they are read as they were
written. The plant is ẋ = f(x, p) + g1(x, p) d + g2(x, p) u with u = k(x), in deviations x from the goal, and

    f_i = Σ over terms: coefficient · Π_j p_j^e_j · Π_k x_k^a_k · [φ(o + ℓᵀx) − φ(o)],

where the bracket is 1 for a term without a function. g1 and g2 are sums of such terms without functions. A value that
is no double stands as a parameter with an interval around it.

Reading trusts nobody: size, depth, keys, types, lengths and magnitudes are checked before a number is used.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from flexhinf.certify.terms import (
    MOST_CHANNELS,
    MOST_FUNCTIONS,
    MOST_PARAMETERS,
    MOST_STATES,
    Double,
    Entries,
    Function,
    Matrix,
    Name,
    Parameter,
    Polynomial,
    Signal,
    Start,
    Terms,
    check_names,
    check_parameters,
    check_powers,
    check_slopes,
    require,
)
from flexhinf.errors import InvalidInput
from flexhinf.files import write_file
from flexhinf.notebook import Summarised, number_text
from flexhinf.untrusted import checked_path, checked_text, distinct, read_text, value_text

__all__ = ["Certificate", "load_certificate"]

_FORMAT, _VERSION = "flexhinf certificate", 1
_LARGEST = 8_000_000  # bytes: degree 8 in five states takes 200 kB


@dataclass(frozen=True, repr=False)
class Certificate(Summarised):
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
    functions : tuple of Function
    shift : tuple of (low, high), n or none
        δ, by which the plant's equilibrium differs from the point about which the law works: u = k(x + δ) − k(δ).
    starts : tuple of Start
    feedback : str
        "state": the law is fed the true state.
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
        checked_text("what the certificate is about", self.about)
        for text in (*self.provenance, *self.provenance.values()):
            checked_text("the certificate's provenance", text)
        require(self.feedback == "state", "feedback 'state'", value_text(self.feedback, 60))
        self._check_numbers()
        self._check_shapes(n, m, w)
        self._check_terms(n)

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

    # Text and file -----------------------------------------------------------------------------
    @property
    def degree(self) -> int:
        """Of V."""
        return max(sum(powers) for powers, _ in self.value)

    @property
    def step_amplitude(self) -> float:
        """Largest amplitude of the proved paths of starts; 0.0 where none is stated."""
        return max((start.amplitude for start in self.starts), default=0.0)

    def summary(self) -> dict[str, str]:
        """For ``repr``: what it claims. `check` proves it again."""
        return {
            "about": self.about,
            "gamma": number_text(self.gamma),
            "level of V": number_text(self.level),
            "degree of V": str(self.degree),
            "step amplitude": number_text(self.step_amplitude),
            "decay": number_text(self.decay, "1/s"),
            "feedback": self.feedback,
        }

    def text(self) -> str:
        """The file's content, JSON."""
        header = {"format": _FORMAT, "version": _VERSION}
        content = header | _adapter().dump_python(self, mode="json")
        return json.dumps(content, ensure_ascii=False, separators=(",", ":")) + "\n"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write certificate.json under a temporary name, then rename it.

        Raises
        ------
        InvalidInput
            The place cannot be written.
        """
        content = self.text()

        def write(name: str) -> None:
            with open(name, "w", encoding="utf-8") as file:
                file.write(content)

        write_file(path, "certificate", write)


def load_certificate(path: str | os.PathLike[str]) -> Certificate:
    """Read what `Certificate.save` wrote; nothing is proved by reading.

    Raises
    ------
    InvalidInput
        Not there, too large, no such file, of a newer version, or with contents that no certificate has.
    """
    path = checked_path("The certificate's file", path)
    text = read_text(path, _LARGEST, "JSON", "certificate")
    try:
        content = json.loads(text, object_pairs_hook=_once, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise _unreadable(path.name, "JSON", str(error)) from None
    if not isinstance(content, dict) or content.pop("format", None) != _FORMAT:
        raise _unreadable(path.name, f"an object with format = {_FORMAT!r}", value_text(content, 80))
    version = content.pop("version", None)
    if version != _VERSION:
        raise _unreadable(path.name, f"version {_VERSION}", value_text(version, 60))
    unknown = sorted(set(content) - {entry.name for entry in fields(Certificate)})
    if unknown:
        raise _unreadable(path.name, "known entries", value_text(unknown, 100))
    try:
        return _adapter().validate_python(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        cause = first.get("ctx", {}).get("error")
        if isinstance(cause, InvalidInput):
            raise _unreadable(path.name, "a certificate", f"{cause.what} {cause.found}") from None
        where = ".".join(str(part) for part in first["loc"])
        got = value_text(first.get("input"), 80)
        raise _unreadable(path.name, f"{where}: {first['msg']}", got) from None


@cache
def _adapter() -> TypeAdapter[Certificate]:
    return TypeAdapter(Certificate)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len({key for key, _ in pairs}) < len(pairs):
        raise ValueError("a key that stands twice")
    return dict(pairs)


def _no_constant(text: str) -> Any:
    raise ValueError(f"{text} is no number")


def _unreadable(name: str, expected: str, got: str) -> InvalidInput:
    return InvalidInput(
        f"{name}: this is no certificate that can be read.",
        f"expected {expected}; got: {got}",
        "the file that flexhinf certify wrote, unchanged",
    )
