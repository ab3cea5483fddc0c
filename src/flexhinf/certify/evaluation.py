"""A claim in doubles: its polynomials, terms and paths of starts at points, and its linear part. Proves nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import prod

import numpy as np

from flexhinf.certify.claim import Claim, Function, Polynomial, Start, Term


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
        factors = (column**power for column, power in zip(x.T, powers) if power)
        result += prod(factors, start=np.full(len(x), coefficient))
    return result


def linear_part(rows: Sequence[Polynomial], n: int) -> np.ndarray:
    """The linear part (rows, n) of polynomials."""
    matrix = np.zeros((len(rows), n))
    for k, row in enumerate(rows):
        for powers, coefficient in row:
            if sum(powers) == 1:
                matrix[k, powers.index(1)] += coefficient
    return matrix


def quadratic_part(value: Polynomial, n: int) -> np.ndarray:
    """P of V_2 = ½ xᵀPx."""
    p = np.zeros((n, n))
    for powers, coefficient in value:
        if sum(powers) == 2:
            i, j = (k for k, power in enumerate(powers) for _ in range(power))
            p[i, j] += coefficient
            p[j, i] += coefficient
    return p


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
    for column, terms in zip(states.T, start.path):
        for term in terms:
            factor = 1.0 if term.function is None else brackets[term.function]
            column += term_weight(term, parameters) * amplitudes ** term.powers[0] * factor
    for column, row in zip(states.T, start.table):
        column += np.interp(amplitudes, start.amplitudes, row) if row else 0.0
    return states


def path_start(claim: Claim, start: Start, amplitude: float) -> np.ndarray:
    """The start (n,) of one amplitude, every parameter in the middle of its range."""
    return path_states(start, claim.middle, np.array([amplitude]))[0]
