"""A certificate: a claim that is saved to a file, read from it, and proved again.

A file has numbers in hexadecimal, so that they are read as they were written. Files are not trusted: size, depth, keys,
types, lengths and magnitudes are checked before a number is used.

A claim in doubles: its polynomials, terms and paths of starts at points, and its linear part. Proves nothing.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cache
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from flexhinf.certify.checker import Verification, verify
from flexhinf.certify.checker.observer import check_observer
from flexhinf.certify.checker.quadratic import definite_corners
from flexhinf.certify.checker.residual import Refusal, residual
from flexhinf.certify.checker.starts import check_start, proved_peaks
from flexhinf.certify.claim import Claim, Function, Polynomial, Start, Term
from flexhinf.errors import InvalidInput
from flexhinf.files import write_file
from flexhinf.notebook import Summarised, number_text
from flexhinf.validation import checked_path, read_text, value_text

_FORMAT, _VERSION = "flexhinf certificate", 1
_LARGEST = 8_000_000  # bytes: degree 8 in five states takes 200 kB


@dataclass(frozen=True, repr=False)
class Certificate(Summarised, Claim):
    """On the component of {V ≤ level} around 0 the dissipation inequality holds; see `Claim` for the attributes."""

    def check(
        self,
        *,
        threads: int = 2,
        sample: int | None = 10,
        by_cells: bool = False,
        tick: Callable[[int], None] = lambda cells: None,
    ) -> Verification:
        """Prove the certificate again from its data alone; see `flexhinf.certify.checker`.

        Parameters
        ----------
        sample : int
            Cells per face that are proved a second time, in rationals and balls; None: every cell, which takes a
            minute of CPU for degree 2 and hours for degree 6.
        by_cells : bool
            Whether cells are looked at even where definite matrices decide, in rationals and without cells.
        tick : callable
            Gets the number of cells that were just looked at.
        """
        return verify(self, threads=threads, sample=sample, by_cells=by_cells, tick=tick)

    @property
    def is_gradient_law(self) -> bool:
        """Whether the law is −R2⁻¹g2ᵀV_xᵀ up to rounding, with a known g2: for the budget of the theorem."""
        return residual(self).gradient_law

    @property
    def stated(self) -> Verification:
        """The parts of the theorem that depend on the law, for a certificate just proved: no checker is run."""
        return Verification(True, gradient_law=self.is_gradient_law, peaks=proved_peaks(self))

    def definite_corners(self) -> int:
        """The number of corners at which r is a negative definite form, where that proves it without cells; else 0."""
        return definite_corners(self, residual(self))

    def with_proved_starts(self) -> Certificate:
        """This certificate without the starts for which ball arithmetic does not show V ≤ level."""
        inside = []
        for start in self.starts:
            with suppress(Refusal):
                check_start(self, start)
                inside.append(start)
        return replace(self, starts=tuple(inside))

    def why_no_observer(self) -> str:
        """The reason for which the stated observer is refused; empty where it is proved, or none is stated."""
        try:
            if self.observer is not None:
                check_observer(self, self.observer, True)
        except Refusal as refusal:
            return str(refusal)
        return ""

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
        content = {"format": _FORMAT, "version": _VERSION} | _adapter().dump_python(self, mode="json")
        return json.dumps(content, ensure_ascii=False, separators=(",", ":")) + "\n"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write certificate.json under a temporary name, then rename it.

        Raises
        ------
        InvalidInput
            The place cannot be written.
        """
        write_file(path, "certificate", lambda name: Path(name).write_text(self.text(), encoding="utf-8"))


def load_certificate(path: str | os.PathLike[str]) -> Certificate:
    """Read what `Certificate.save` wrote; nothing is proved by reading.

    Raises
    ------
    InvalidInput
        Not there, too large, no such file, of a newer version, or with contents that no certificate has.
    """
    path = checked_path("The certificate's file", path)
    text = read_text(path, _LARGEST, "JSON", "certificate")

    def unreadable(expected: str, got: str) -> InvalidInput:
        return InvalidInput(
            f"{path.name}: this is no certificate that can be read.",
            f"expected {expected}; got: {got}",
            "the file that flexhinf certify wrote, unchanged",
        )

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len({key for key, _ in pairs}) < len(pairs):
            raise ValueError("a key that stands twice")
        return dict(pairs)

    def no_constant(text: str) -> Any:
        raise ValueError(f"{text} is no number")

    try:
        content = json.loads(text, object_pairs_hook=once, parse_constant=no_constant)
    except (ValueError, RecursionError) as error:
        raise unreadable("JSON", str(error)) from None
    entries = dict(content) if isinstance(content, dict) else {"format": content}
    kind, version = entries.pop("format", None), entries.pop("version", None)
    unknown = sorted(set(entries) - {entry.name for entry in fields(Certificate)})
    proper = isinstance(content, dict) and kind == _FORMAT
    for readable, expected, got in (
        (proper, f"an object with format = {_FORMAT!r}", value_text(kind, 80)),
        (type(version) is int and version == _VERSION, f"version {_VERSION}", value_text(version, 60)),
        (not unknown, "known entries", value_text(unknown, 100)),
    ):
        if not readable:
            raise unreadable(expected, got)
    try:
        return _adapter().validate_python(entries)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        cause = first.get("ctx", {}).get("error")
        if isinstance(cause, InvalidInput):
            raise unreadable("a certificate", f"{cause.what} {cause.found}") from None
        where = ".".join(map(str, first["loc"]))
        raise unreadable(f"{where}: {first['msg']}", value_text(first.get("input"), 80)) from None


@cache
def _adapter() -> TypeAdapter[Certificate]:
    return TypeAdapter(Certificate)


def bracket(function: Function, s: np.ndarray) -> np.ndarray:
    """φ(o + s) − φ(o)."""
    phi, o = getattr(np, function.name), function.offset + function.pi_halves * np.pi / 2
    return phi(o + s) - phi(o)


def term_weight(term: Term, parameters: Mapping[str, float]) -> float:
    """The coefficient of a term for values of the parameters."""
    return float(term.coefficient * np.prod([parameters[name] ** power for name, power in term.parameters]))


def polynomial_at(polynomial: Iterable[tuple[tuple[int, ...], float]], x: np.ndarray) -> np.ndarray:
    """A polynomial at points (N, n), one monomial after the other: nothing is larger than a column of x."""
    result = np.zeros(len(x))
    for powers, coefficient in polynomial:
        result += prod(
            (column**power for column, power in zip(x.T, powers) if power), start=np.full(len(x), coefficient)
        )
    return result


def linear_part(rows: Sequence[Polynomial], n: int) -> np.ndarray:
    """The linear part (rows, n) of polynomials."""
    units = [tuple(unit) for unit in np.eye(n, dtype=int).tolist()]
    return np.array([[dict(row).get(unit, 0.0) for unit in units] for row in rows], dtype=float).reshape(
        -1, n
    )


def quadratic_part(value: Polynomial, n: int) -> np.ndarray:
    """P of V_2 = ½ xᵀPx."""
    coefficients, unit = dict(value), np.eye(n, dtype=int)
    p = np.array([[coefficients.get(tuple((a + b).tolist()), 0.0) for b in unit] for a in unit])
    return p * (1.0 + unit)


def linear_system(
    claim: Claim, parameters: Mapping[str, float], slopes: Sequence[float] | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (n, n), B1 (n, w) and B2 (n, m) for values of the parameters, each function φ(o + ℓ) − φ(o) as slope · ℓ."""
    n = len(claim.states)
    a, b1, b2 = (np.zeros((n, k)) for k in (n, len(claim.disturbances), len(claim.inputs)))
    for i in range(n):
        for term in claim.drift[i]:
            weight = term_weight(term, parameters)
            if term.function is None and sum(term.powers) == 1:
                a[i, term.powers.index(1)] += weight
            elif term.function is not None and not any(term.powers):
                a[i] += weight * slopes[term.function] * np.array(claim.functions[term.function].slope)
        for matrix, entries in ((b1, claim.g1[i]), (b2, claim.g2[i])):
            for j, terms in enumerate(entries):
                matrix[i, j] += sum(term_weight(term, parameters) for term in terms if not any(term.powers))
    return a, b1, b2


def path_states(start: Start, parameters: Mapping[str, float], amplitudes: np.ndarray) -> np.ndarray:
    """The states (N, n) of a path at amplitudes (N,) for values of the parameters, with its table."""
    brackets = [bracket(function, function.slope[0] * amplitudes) for function in start.functions]
    states = np.zeros((len(amplitudes), len(start.path)))
    for column, term in ((column, term) for column, terms in zip(states.T, start.path) for term in terms):
        factor = 1.0 if term.function is None else brackets[term.function]
        column += term_weight(term, parameters) * amplitudes ** term.powers[0] * factor
    for column, row in zip(states.T, start.table):
        column += np.interp(amplitudes, start.amplitudes, row) if row else 0.0
    return states


def path_start(claim: Claim, start: Start, amplitude: float) -> np.ndarray:
    """The start (n,) of one amplitude, every parameter in the middle of its range."""
    return path_states(start, claim.middle, np.array([amplitude]))[0]
