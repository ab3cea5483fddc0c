"""A certificate: a claim that is saved to a file, read from it, and proved again.

Numbers in a file are hexadecimal, so that reading returns the bits that were written. Files are not trusted: size,
depth, keys,
types, lengths and magnitudes are checked before a number is used.

This file also evaluates a claim in doubles: polynomials, terms and paths of starts at points, and the linear part. That
proves nothing.

And it writes the theorem of a certificate in plain English: what is proved, all hypotheses, and what is not proved.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from functools import cache
from itertools import zip_longest
from math import prod, sqrt
from pathlib import Path
from typing import cast

import numpy as np
from pydantic import TypeAdapter, ValidationError

from flexhinf.certify.checker import Verification, verify
from flexhinf.certify.checker.residual import ExactResidual, Refusal, look_at_corners
from flexhinf.certify.checker.statements import check_observer, check_start, proved_peaks
from flexhinf.certify.claim import Claim, Function, Observer, PolynomialTerms, Signal, Start, Term, Terms
from flexhinf.errors import InvalidInput
from flexhinf.files import write_file
from flexhinf.notebook import Summarised
from flexhinf.numerals import number, number_text
from flexhinf.processors import thread_count
from flexhinf.validation import checked_path, read_text, value_text

_FORMAT, _VERSION = "flexhinf certificate", 2
_LARGEST = 8_000_000  # bytes: degree 8 in five states takes 200 kB


@dataclass(frozen=True, repr=False)
class Certificate(Summarised, Claim):
    """On the component of {V ≤ level} around 0 the dissipation inequality holds; see `Claim` for the attributes.

    Examples
    --------
    >>> import flexhinf as fh
    >>> plant = fh.PolynomialPlant({(1,): [1.0], (3,): [-1.0]}, [[1.0]], [[1.0]], {(1,): [1.0]}, 1.0)
    >>> certificate = fh.solve_hji(plant, gamma=1.5, degree=4).certify(gamma=2.0)
    >>> certificate.check().proved
    True
    """

    def check(
        self,
        *,
        threads: int | None = None,
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
            Whether to check cells even if definite matrices decide, which needs no cells.
        tick : callable
            Called with the number of cells that were just checked.
        """
        threads = thread_count() if threads is None else threads
        return verify(self, threads=threads, sample=sample, by_cells=by_cells, tick=tick)

    @property
    def is_gradient_law(self) -> bool:
        """Whether the law is −R2⁻¹g2ᵀV_xᵀ up to rounding, with a known g2: for the budget of the theorem."""
        return ExactResidual(self).gradient_law

    @property
    def stated(self) -> Verification:
        """The parts of the theorem that depend on the law, for a certificate just proved: no checker is run."""
        return Verification(True, gradient_law=self.is_gradient_law, peaks=proved_peaks(self))

    def definite_corners(self) -> int:
        """Number of corners at which r is a negative definite form, if that proves the claim without cells; else 0."""
        count, failed = look_at_corners(self, ExactResidual(self))
        return 0 if failed else count

    def with_proved_starts(self) -> Certificate:
        """This certificate without the starts for which ball arithmetic does not show V ≤ level."""
        inside = list[Start]()
        for start in self.starts:
            with suppress(Refusal):
                check_start(self, start)
                inside.append(start)
        return replace(self, starts=tuple(inside))

    def why_no_observer(self) -> str:
        """The reason why the stated observer is not proved; empty if it is proved, or none is stated."""
        try:
            if self.observer is not None:
                check_observer(self, self.observer, True)
        except Refusal as refusal:
            return str(refusal)
        return ""

    def summary(self) -> dict[str, str]:
        """The claim, for ``repr``; `check` proves it again."""
        return {
            "about": self.about,
            "gamma": number_text(self.gamma),
            "level of V": number_text(self.level),
            "degree of V": str(self.degree),
            "step amplitude": number_text(self.step_amplitude, self.states[0].unit),
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

    Examples
    --------
    >>> import flexhinf as fh
    >>> plant = fh.PolynomialPlant({(1,): [1.0], (3,): [-1.0]}, [[1.0]], [[1.0]], {(1,): [1.0]}, 1.0)
    >>> import tempfile
    >>> certificate = fh.solve_hji(plant, gamma=1.5, degree=4).certify(gamma=2.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     certificate.save(f"{folder}/certificate.json")
    ...     same = fh.load_certificate(f"{folder}/certificate.json")
    >>> same.level == certificate.level
    True
    """
    path = checked_path("The certificate's file", path)
    text = read_text(path, _LARGEST, "JSON", "certificate")

    def unreadable(expected: str, got: str) -> InvalidInput:
        return InvalidInput(
            f"{path.name}: this is no certificate that can be read.",
            f"expected {expected}; got: {got}",
            "the file that flexhinf certify wrote, unchanged",
        )

    def once(pairs: list[tuple[str, object]]) -> dict[str, object]:
        if len({key for key, _ in pairs}) < len(pairs):
            raise ValueError("a key that stands twice")
        return dict(pairs)

    try:
        content = cast("object", json.loads(text, object_pairs_hook=once))
    except (ValueError, RecursionError) as error:
        raise unreadable("JSON", str(error)) from None
    entries = cast("dict[str, object]", content) if isinstance(content, dict) else {"format": content}
    kind, version = entries.pop("format", None), entries.pop("version", None)
    unknown = sorted(set(entries) - {entry.name for entry in fields(Certificate)})
    for readable, expected, got in (
        (kind == _FORMAT, f"an object with format = {_FORMAT!r}", value_text(kind, 80)),
        (type(version) is int and 1 <= version <= _VERSION, f"version {_VERSION}", value_text(version, 60)),
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
        expected = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
        raise unreadable(expected, value_text(first.get("input"), 80)) from None


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
    monomials = (
        prod((column**power for column, power in zip(x.T, powers) if power), start=np.full(len(x), value))
        for powers, value in polynomial
    )
    return sum(monomials, np.zeros(len(x)))


def linear_part(rows: Sequence[PolynomialTerms], n: int) -> np.ndarray:
    """The linear part (rows, n) of polynomials."""
    units = [tuple(unit) for unit in np.eye(n, dtype=int).tolist()]
    return np.array([[dict(row).get(unit, 0.0) for unit in units] for row in rows], dtype=float).reshape(
        -1, n
    )


def quadratic_part(value: PolynomialTerms, n: int) -> np.ndarray:
    """P of V_2 = ½ xᵀPx."""
    coefficients, unit = dict(value), np.eye(n, dtype=int)
    p = np.array([[coefficients.get(tuple((a + b).tolist()), 0.0) for b in unit] for a in unit])
    return p * (1.0 + unit)


def linear_system(
    claim: Claim, parameters: Mapping[str, float], slopes: Sequence[float] | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (n, n), B1 (n, w) and B2 (n, m) for values of the parameters, each function φ(o + ℓ) − φ(o) as slope · ℓ."""
    b1, b2 = (
        np.array(
            [
                [sum((term_weight(t, parameters) for t in terms if not any(t.powers)), 0.0) for terms in row]
                for row in entries
            ]
        )
        for entries in (claim.g1, claim.g2)
    )
    a = np.zeros((len(claim.states),) * 2)
    for row, terms in zip(a, claim.drift):
        for term in terms:
            weight = term_weight(term, parameters)
            if term.function is None and sum(term.powers) == 1:
                row[term.powers.index(1)] += weight
            elif term.function is not None and not any(term.powers):
                row += weight * slopes[term.function] * np.array(claim.functions[term.function].slope)
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


#: Line of every theorem about latency.
NO_LATENCY = "The proof covers no latency: in it the input acts at the instant of its measurement."

#: Heading of the entries of a file that nothing checks.
AUTHOR = "In the author's words, not checked"

_MAX_TERMS, _MAX_MONOMIALS = 12, 60  # terms of a sum; monomials of V and the law on a terminal
_DIGITS = 6


def persistent_bound(claim: Claim) -> float:
    """√(2αc)/γ: the region is invariant for |d(t)| up to this at all times; 0.0 without a proved decay."""
    return sqrt(2.0 * claim.decay * claim.level) / claim.gamma


def theorem_text(claim: Claim, verification: Verification, whole: bool = False) -> str:
    """The theorem of a claim, valid if `verification.proved`. `whole`: with V and the law in full, however long."""
    return "\n\n".join(
        f"{heading}: {texts[0]}" if heading == "Region S" else "\n  ".join([heading, *texts])
        for heading, texts in theorem_parts(claim, verification, whole)
    )


def theorem_parts(
    claim: Claim, verification: Verification, whole: bool = True
) -> list[tuple[str, list[str]]]:
    """The theorem as pairs of a heading and its lines, with the marks that stand before them in `theorem_text`."""
    statements, paths = _statements(claim, verification), list[str]()
    fed = f" (1. to {len(statements) - 1}.) or estimates ({len(statements)}.)" if claim.observer else ""
    for i, start in enumerate(claim.starts, 1):
        states = (
            _joined([_sum(terms, ["a"], start.functions)] * bool(terms) + ["a table of a"] * bool(table))
            for terms, table in zip_longest(start.path, start.table)
        )
        up_to = _down(start.amplitude)
        paths.append(
            f"Starts on path {i}, steps of up to {up_to}: x = ({', '.join(states)}) for 0 <= a <= {up_to}."
        )
    return [
        ("Hypotheses", [*_hypotheses(claim, fed, whole), *_observer(claim), *paths]),
        (
            "Region S",
            [
                f"the part of {{V <= {claim.level!r}}} that is connected to the goal; V has degree {claim.degree}."
            ],
        ),
        (
            "Proved" if verification.proved else "Claimed, and NOT proved: see the end",
            [f"{i}. {name}: {text}" for i, (name, text) in enumerate(statements, 1)],
        ),
        (
            "Not proved",
            [
                (
                    "- Other estimators than the stated one, noise of the measurement, sampling and hold, delay, "
                    "saturation, quantisation"
                    if claim.observer
                    else "- An estimator instead of the true state, "
                    "sampling and hold, delay, saturation, quantisation and noise"
                )
                + (", beyond what the budget of 4. covers." if verification.gradient_law else "."),
                f"- {NO_LATENCY}",
                "- Starts outside S, and starts of the integrators by another rule than the stated ones. That x is at "
                "rest there, and where the integrators start, is as the file says: only that these x lie in S is "
                "proved."
                if claim.starts
                else "- Which steps start in S: the certificate states no starts.",
                "- Dynamics that the plant does not have: friction of another form, coil current, flexible modes, "
                "backlash.",
                "- Parameters outside the stated box, or varying in time."
                if any(p.low < p.high for p in claim.parameters)
                else "- Other values of the parameters than the stated ones.",
                *["- Disturbances that last for ever: no decay rate is claimed."] * (not claim.decay),
            ],
        ),
        (
            AUTHOR,
            [
                f"- What it is about: {claim.about}",
                *(f"- Path {i} of starts: {start.rule}" for i, start in enumerate(claim.starts, 1)),
                "- All names and units.",
            ],
        ),
    ]


def _hypotheses(claim: Claim, fed: str, whole: bool) -> list[str]:
    """Plant, parameters, channels and feedback; R2, the law and V with every digit, so that what is stated can be
    refuted without the file."""
    names = [s.name for s in claim.states]
    uncertain = [p for p in claim.parameters if p.low < p.high]
    fixed = [f"{p.name} = {p.low:.10g} {p.unit}".rstrip() for p in claim.parameters if p.low == p.high]
    rates = list[str]()
    for name, drift, g1, g2 in zip(names, claim.drift, claim.g1, claim.g2):
        rate = [_sum(drift, names, claim.functions)] if drift else []
        rate += [
            _sum(terms, names, (), signal.name)
            for signal, terms in zip((*claim.disturbances, *claim.inputs), (*g1, *g2), strict=True)
            if terms
        ]
        rates.append(f"  d/dt {name} = {_joined(rate)}")
    box = (f"{p.name} in [{p.low:.10g}, {p.high:.10g}] {p.unit}".rstrip() for p in uncertain)
    degree = max((sum(powers) for law in claim.law for powers, _ in law), default=0)
    return [
        f"Plant: {len(names)} states ({', '.join(map(_named, claim.states))}), deviations from the "
        f"{'equilibrium at the goal (of each robot its own, where it moves with the parameters)' * bool(uncertain)}"
        f"{'goal' * (not uncertain)}, with "
        f"{', '.join(sorted({f.name for f in claim.functions})) or 'no elementary function'}"
        f"{' exactly as it is, not expanded' if claim.functions else ''}; V, the law and all numbers are the file's:",
        *rates,
        *["Parameters: the numbers of the plant as stored, no tolerance."] * (not claim.parameters),
        *[f"Parameters, the whole box and not only its corners: {', '.join(box)}."] * bool(uncertain),
        *[f"Parameters, nominal: {', '.join(fixed)}."] * bool(fixed),
        f"Disturbance channels: {', '.join(map(_named, claim.disturbances))}.",
        f"Feedback: the law, a polynomial of degree {degree} for {', '.join(map(_named, claim.inputs))}, is fed the "
        f"true state{fed}, in continuous time. Controller: {claim.controller}.",
        f"  R2 = [{'; '.join(' '.join(map(repr, row)) for row in claim.r2)}]",
        *(
            f"  {name} = {_row(polynomial, claim.states, len(polynomial))}"
            if whole or len(polynomial) <= _MAX_MONOMIALS
            else f"  {name}: {len(polynomial)} monomials, in the file and on the page"
            for name, polynomial in (*zip((s.name for s in claim.inputs), claim.law), ("V", claim.value))
        ),
    ]


def _statements(claim: Claim, verification: Verification) -> list[tuple[str, str]]:
    """The claimed statements, under their names in docs/theorem.md; the first four have the same numbers there."""
    z = ", ".join([*map(_row, claim.penalty, [claim.states] * len(claim.penalty)), "R2^(1/2) u"])
    level, unit = _down(claim.level), common_unit(claim.disturbances)
    lasting = f"{_down(persistent_bound(claim))} {unit}".rstrip()
    inputs = ", ".join(
        f"|{s.name} - its value at the goal| <= {_up(peak)} {s.unit}".rstrip()
        for s, peak in zip(claim.inputs, verification.peaks)
    )
    within = f", with V <= {_up(claim.start_level)}" if claim.observer else ""
    statements = [
        (
            True,
            "Region",
            "S is compact and star-shaped, and V grows along every ray in it. On S, dV/dt <= "
            f"{f'-{_down(claim.decay)} V + ' if claim.decay else ''}1/2 gamma^2 |d|^2 - 1/2 |z|^2 with gamma = "
            f"{claim.gamma!r} and z = ({z}).",
        ),
        (
            True,
            "Gain",
            f"from x(0) in S, as long as V(x(0)) + 1/2 gamma^2 (energy of d) <= {level}, the state stays "
            "in S and (energy of z) <= gamma^2 (energy of d) + 2 V(x(0)).",
        ),
        (
            True,
            "Convergence",
            "without disturbances every trajectory from S stays in S and converges to the goal, "
            "exponentially fast.",
        ),
        (
            verification.gradient_law,
            "Budget",
            "for u = -R2^-1 g2'V_x' + v (without v the law, but for its rounding) "
            "with any v, from x(0) in S, as long as V(x(0)) + 1/2 gamma^2 (energy of d) + 1/2 (integral of v'R2 v) <= "
            f"{level}, the state stays in S and (energy of z) <= gamma^2 (energy of d) + (integral of v'R2 v) + "
            "2 V(x(0)), z with the u that is applied.",
        ),
        (
            claim.decay,
            "Disturbances that last",
            f"S is invariant for disturbances with |d(t)| <= {lasting} at all times, of any duration.",
        ),
        (claim.starts, "Starts", f"all starts named above lie in S{within}."),
        (
            verification.peaks,
            "Largest input",
            f"without disturbances, from all starts named above, {inputs}.",
        ),
        (claim.observer, "Output feedback", _with_estimates(claim, claim.observer) if claim.observer else ""),
    ]
    return [(name, text) for stated, name, text in statements if stated]


def _observer(claim: Claim) -> list[str]:
    if claim.observer is None:
        return []
    known = claim.observer.known
    estimated = ", ".join(s.name for s in claim.states if s.name not in known)
    sensors = (
        tuple((tuple(int(i == j) for j in range(len(row))), v) for i, v in enumerate(row) if v)
        for row in claim.observer.measured
    )
    measured = ", ".join(_row(row, claim.states) for row in sensors)
    gains = "; ".join(" ".join(f"{v:.6g}" for v in row) for row in claim.observer.gain)
    computed = (
        f" The controller computes {', '.join(known)} itself, from the same: what disturbs a rate of "
        "these (a command) is in what it computes, and moves no error."
        if known
        else ""
    )
    return [
        f"Observer (output injection) of {estimated}, from y = ({measured}) without noise: it takes all that is "
        f"nonlinear from y, so the errors obey e' = (A - LC) e + g1 d exactly; L = [{gains}].{computed}"
    ]


def _with_estimates(claim: Claim, observer: Observer) -> str:
    axes = ", ".join(
        f"{s.name} {_down(sqrt(2 * observer.energy / row[i]) * (1 - 1e-9))} {s.unit}".rstrip()
        for i, (s, row) in enumerate(
            zip((s for s in claim.states if s.name not in observer.known), observer.storage, strict=True)
        )
        if row[i] > 0  # where it is not, nothing is proved
    )
    gain = sqrt(claim.gamma**2 + observer.gain_error**2)
    return (
        "the law fed with the observer's estimates whose errors begin at e0: while 1/2 e0'X e0 + "
        f"1/2 gamma_e^2 (energy of d) <= {_down(observer.energy)} with gamma_e = {_up(observer.gain_error)}, and "
        f"V(x(0)) + 1/2 e0'X e0 + 1/2 ({_up(gain)})^2 (energy of d) <= {_down(claim.level)}, the state stays in S, and "
        f"(energy of z) <= ({_up(gain)})^2 (energy of d) + 2 V(x(0)) + e0'X e0. Without disturbances state and errors "
        "converge exponentially fast. So all starts named above, the integrators started as for the true state, are "
        "covered together with every e0 in the ellipsoid "
        f"1/2 e0'X e0 <= {_down(observer.energy)}: an error in one state alone of up to {axes}."
    )


def verification_text(verification: Verification) -> str:
    """The result of the checker in a few lines."""
    if not verification.proved:
        return f"NOT PROVED: {verification.reason}"
    if verification.corners:
        return (
            "PROVED again from the certificate's data alone, in exact rationals and without cells: r is a quadratic "
            "form for each value of the parameters and of the functions' quotients, negative definite at all "
            f"{verification.corners:,} corners of their box.\n{verification.starts:,} intervals of starts in balls. "
            f"{verification.cpu_s:.1f} s of CPU."
        )
    return (
        f"PROVED again from the certificate's data alone: {verification.cells:,} cells on {verification.faces} faces, "
        f"{verification.accepted:,} accepted, {verification.with_level:,} of them by V ≤ c; rounding is allowed "
        f"{number(verification.rounding, 2)} in r/ρ².\n"
        + (
            "Every one of them, and every cell at which the level set ended "
            f"({verification.resampled:,} in all), was"
            if verification.every_cell
            else f"{verification.resampled:,} cells, drawn at random, were"
        )
        + " proved a second time in rationals and balls; "
        f"{verification.starts:,} intervals of starts in balls. {verification.cpu_s:.0f} s of CPU."
    )


def _down(value: float, rounding: str = ROUND_FLOOR) -> str:
    """A number with at most six digits, rounded down so that the statement holds."""
    few = len(Decimal(repr(value)).as_tuple().digits) <= _DIGITS
    return f"{value if few else Context(_DIGITS, rounding).create_decimal(Decimal(value)):.{_DIGITS}g}"


def _up(value: float) -> str:
    return _down(value, ROUND_CEILING)


def _sum(terms: Terms, names: list[str], functions: tuple[Function, ...], driven_by: str = "") -> str:
    """Terms in full, up to a dozen, as numerator/denominator, parameters before states before the function; each times
    the signal by which it is driven, if any."""
    texts = list[str]()
    for term in terms[:_MAX_TERMS]:
        below = [_power(name, -e) for name, e in term.parameters if e < 0]
        above = [
            *(_power(name, e) for name, e in term.parameters if e > 0),
            *(_power(name, e) for name, e in zip(names, term.powers, strict=True) if e),
            *([] if term.function is None else [_bracket(functions[term.function], names)]),
            *[driven_by] * bool(driven_by),
        ]
        number = f"{abs(term.coefficient):.10g}"
        text = "*".join(above if above and number == "1" else [number, *above])
        under = f"/({'*'.join(below)})" if len(below) > 1 else "".join(f"/{factor}" for factor in below)
        texts.append("-" * (term.coefficient < 0) + text + under)
    return _joined(texts + [f"{len(terms) - _MAX_TERMS} more"] * (len(terms) > _MAX_TERMS))


def _joined(texts: list[str]) -> str:
    return " + ".join(texts).replace("+ -", "- ") or "0"


def _power(name: str, exponent: int) -> str:
    return name if exponent == 1 else f"{name}^{exponent}"


def _bracket(function: Function, names: list[str]) -> str:
    """φ(o + ℓᵀx) − φ(o)."""
    terms = [
        f"{'-' if value < 0 else ''}{'' if abs(value) == 1.0 else f'{abs(value):.10g}*'}{name}"
        for value, name in zip(function.slope, names, strict=True)
        if value
    ]
    o = [f"{function.offset:.10g}"] * bool(function.offset)
    if halves := function.pi_halves:  # a whole number of π/2
        whole, half = halves if halves % 2 else halves // 2, "/2" if halves % 2 else ""
        o = [{1: "pi", -1: "-pi"}.get(whole, f"{whole}*pi") + half, *o]
    return f"[{function.name}({_joined([*o, _joined(terms)])}) - {function.name}({_joined(o)})]"


def common_unit(signals: tuple[Signal, ...]) -> str:
    """The unit of all signals; empty where they differ."""
    return signals[0].unit if len({signal.unit for signal in signals}) == 1 else ""


def _named(signal: Signal) -> str:
    return f"{signal.name} [{signal.unit}]" if signal.unit else signal.name


def _row(polynomial: PolynomialTerms, states: tuple[Signal, ...], most: int = _MAX_TERMS) -> str:
    """A polynomial as text, with every digit; with more than `most` terms, their number."""
    text = ""
    for powers, value in polynomial[:most]:
        factors = [s.name + (f"^{e}" if e > 1 else "") for s, e in zip(states, powers, strict=True) if e]
        text += (" - " if value < 0 else " + ") if text else "-" * (value < 0)
        text += " ".join([f"{abs(value)!r}"] * (abs(value) != 1.0 or not factors) + factors)
    more = len(polynomial) - most
    return text + (f" + {more} more {'terms' if more > 1 else 'term'}" if more > 0 else "") if text else "0"
