"""`certify` returns a certificate with the largest level that the search proves, for the nominal plant or a box of
parameters.

With an output-injection observer it also computes the gain L, and M, X, γ_e that bound the cost of the estimation
errors, in doubles with a margin, so that the strict inequalities hold in rationals; the checker decides.

A step starts at each robot's own equilibrium at −a. If the input must not jump, the integrator starts where the law's
input equals the robot's holding input. Both are terms in a and in the robot's parameters.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

import math
from dataclasses import replace
from typing import cast

import numpy as np
from flint import fmpq

from flexhinf.arrays import Matrix
from flexhinf.certify.box import ParameterRanges, tolerance_statement
from flexhinf.certify.cells import CellBounds, Progress, SearchOutcome, search
from flexhinf.certify.certificate import Certificate, linear_system, polynomial_at, quadratic_part
from flexhinf.certify.claim import MOST_STATES, Observer
from flexhinf.certify.inequality import ExactAlgebra, Inequality, Rational
from flexhinf.certify.problem_to_claim import matrix_rows, nearest_double, statement_of, terms_of
from flexhinf.certify.starts import (
    PATH_POINTS,
    PATH_SHARE,
    largest_values,
    robot_start,
    start_inside,
    starts_of,
    tabled_start,
)
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.hinf.linear_part import solve_riccati
from flexhinf.hinf.sampled import CheckedPenalty, sample_region
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.processors import single_blas
from flexhinf.validation import HUGE

_DIRECTIONS = 20_000  # number of rays that estimate the extent of the region
_BELOW = (0.999, 0.995, 0.98, 0.95, 0.9, 0.8)  # shares of the level that failed, tried in turn
# Factors of the reach over the largest radius seen, and over one that was too small.
_ROOM, _LARGER = 1.1, 1.6
_BOX_ROOM = 1.002  # level over the largest V on a path that is to be inside
#: Of the largest level over the one that a step needs: how large it may be, and the ratio at which its search ends.
_MOST_LEVELS, _FINE = 1e6, 1.05

_FARTHEST = 63.0  # |ℓᵀx| of a function: the checker looks as far as 64
_MARGIN = 1e-2  # of M over the slopes of the law, and of the Lyapunov inequality
_PASSES = 20  # of hull, M and X, which follow from each other


#: Before cells are looked at.
_NOT_CLOSED = SearchOutcome(False, "not closed", None, np.nan, np.nan, 0)


class NotProved(NumericalFailure):
    """The inequality could not be proved up to a level.

    Attributes
    ----------
    point : ndarray, shape (n,), or None
        Deviation at which it fails, or where the search gave up.
    """

    def __init__(self, statement: Certificate, outcome: SearchOutcome) -> None:
        self.point, self.reason, where = None, outcome.reason, ""
        if outcome.point is not None:
            self.point = np.array(statement.coordinates) @ outcome.point
            where = f" at x = {np.array2string(self.point, precision=6)}"
        super().__init__(
            f"The level V <= {statement.level:.8g} is not proved.",
            f"{outcome.reason}{where}, where V = {outcome.value:.8g} and r/|z|^2 = {outcome.residual:.3g}, "
            f"after {outcome.cells} cells",
            "a smaller level, a larger gamma, or a smaller penalty",
        )


@single_blas()
def certify(
    solution: ValueFunction,
    gamma: float | None = None,
    penalty: CheckedPenalty | None = None,
    level: float | None = None,
    *,
    decay: float = 0.0,
    about: str = "",
    observer: float | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Certificate:
    """See `HJISolution.certify`."""
    if len(solution.P) > MOST_STATES:
        raise InvalidInput(
            "A proof in so many states would not end.",
            f"expected at most {MOST_STATES} states, got {len(solution.P)}: cells grow 10 to 23 times with each",
            "solution.sampled_region(), which looks at points and proves nothing",
        )
    check_decay(decay)
    if observer is not None:
        check_bandwidth(solution, observer)
    statement = statement_of(solution, gamma, penalty, decay=decay, about=about)
    claim, outcome = statement, _NOT_CLOSED
    tried, shares, sampled = level, (1.0,), None
    if tried is None:
        check = sample_region(solution, gamma, penalty)
        if check is None or not 0 < check.level < np.inf:
            raise InvalidInput(
                "There is no level to prove.",
                "expected a level found by sampled_region, got "
                + ("no definite margin" if check is None else f"{check.level:g} ({check.limit})"),
                "a level, or a weaker pair: checked_margin says where the margin is lost",
            )
        tried, shares, sampled = check.level, _BELOW, check.level
    for share in shares:
        tried *= share
        claim, outcome = prove(replace(statement, level=float(tried)), threads=threads, progress=progress)
        if outcome.proved:
            claim = replace(
                claim,
                starts=starts_of(solution, claim),
                sampled_level=sampled,
                provenance=_provenance(outcome),
            ).with_proved_starts()
            return claim if observer is None else with_observer(solution, claim, observer)
        if level is None and outcome.value == outcome.value:
            tried = min(tried, outcome.value)
    raise NotProved(replace(claim, level=float(tried)), outcome)


def check_decay(decay: float) -> None:
    """Refuse a rate of decay that is negative or not finite."""
    if not 0.0 <= decay < np.inf:
        raise InvalidInput(
            "There is no such rate of decay.",
            f"expected a finite decay >= 0 in 1/s, got {decay}",
            "0.2, or 0 for none",
        )


def prove(
    statement: Certificate,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    most_cells: int = 100_000_000,
) -> tuple[Certificate, SearchOutcome]:
    """Search for a proof of a statement: first by a definite quadratic form, then by cells.

    The statement's `reach` is replaced; its starts are ignored. The result does not depend on `threads`. `progress` is
    called with the number of cells done and the estimated fraction of the whole. With `most_cells` = 0 only a definite
    quadratic form is tried. Returns the statement with its reach, and the outcome of the search.
    """
    if progress is not None:
        progress(0, 0.0)  # a time limit may end the search here
    if (wide := wide_statement(statement)) is not None and wide.definite_corners():
        return wide, SearchOutcome(True, "proved", None, statement.level, 0.0, 0)
    if not most_cells:
        return statement, SearchOutcome(False, "no definite quadratic form", None, np.nan, np.nan, 0)
    inequality = Inequality(statement)
    farthest, forms = _extent(inequality, statement.level)
    reach, extent = _rounded_up(_ROOM * farthest), (1.3 * forms + 0.1).tolist()
    outcome = _NOT_CLOSED
    for _ in range(4):
        bounds = CellBounds(inequality, reach, extent)
        outcome = search(bounds, statement.level, threads=threads, progress=progress, most_cells=most_cells)
        if outcome.reason != "not closed":
            break
        reach = _rounded_up(_LARGER * reach)
    return replace(statement, reach=reach), outcome


def wide_statement(statement: Certificate) -> Certificate | None:
    """The statement with a reach that holds all of {V ≤ level}; None where V is not of degree two and definite."""
    t = np.array(statement.coordinates)
    quadratic = t.T @ quadratic_part(statement.value, len(t)) @ t  # V = ½ zᵀ(…)z
    if statement.degree != 2 or np.linalg.matrix_rank(quadratic) < len(t):
        return None
    reach = _ROOM * float(np.sqrt(2.0 * statement.level * np.linalg.inv(quadratic).diagonal().max()))
    return replace(statement, reach=_rounded_up(reach)) if 0.0 < reach < HUGE else None


def _provenance(outcome: SearchOutcome, more: str = "") -> dict[str, str]:
    return {
        "cells": str(outcome.cells),
        "method": ("branch and bound along rays" if outcome.cells else "a definite quadratic form") + more,
    }


def _rounded_up(value: float) -> float:
    """The value rounded up to eight bits, so that its products with dyadic fractions are exact."""
    unit = 2.0 ** (np.floor(np.log2(value)) - 7)
    return float(np.ceil(value / unit) * unit)


def _extent(inequality: Inequality, level: float) -> tuple[float, np.ndarray]:
    """Estimates along random rays, not bounds: the largest |z_j| of {V ≤ level}, and the largest |ℓ| of each
    function."""
    n = inequality.n
    directions = np.random.default_rng(0).standard_normal((_DIRECTIONS, n))
    directions = np.concatenate([directions, np.eye(n), -np.eye(n)])
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    terms = [(key, nearest_double(value)) for key, value in inequality.value.items()]
    parts = [
        polynomial_at([term for term in terms if sum(term[0]) == k], directions)
        for k in range(max(map(sum, inequality.value)) + 1)
    ]
    radius, value, alive = *np.zeros((2, len(directions))), np.ones(len(directions), dtype=bool)
    step = 0.02 * np.sqrt(level / parts[2])
    for _ in range(2000):
        further = radius + step
        following = sum(part * further**k for k, part in enumerate(parts))
        alive &= (following < 1.002 * level) & (following > value)
        if not alive.any():
            break
        radius, value = np.where(alive, further, radius), np.where(alive, following, value)
    reached = radius + step
    return float(reached.max()), np.abs(
        directions @ inequality.forms(inequality.functions).T * reached[:, None]
    ).max(axis=0)


def certify_tolerances(
    solution: ValueFunction,
    problem: GeneralisedPlant,
    ranges: ParameterRanges,
    gamma: float,
    *,
    level: float | None = None,
    step: float | None = None,
    scale: float = 1.0,
    p: np.ndarray | None = None,
    about: str = "",
    threads: int | None = None,
    progress: Progress | None = None,
    most_cells: int = 100_000_000,
) -> Certificate:
    """Prove that the gain of a law is at most γ for a whole box of parameters, on a level set of V.

    Parameters
    ----------
    solution : HJISolution
        Its law is proved, with `scale` times its V as the storage function, or ½ xᵀPx with `p` (n, n).
    problem : GeneralisedPlant
        Has the disturbance, penalty and R2 of the gain; need not be the one that the law was designed for.
    ranges : mapping of str to (float, float)
        ParameterRanges of the plant's parameters, see `parameter_ranges`; those that are not named are nominal.
    level, step : float
        The level of the storage function, or the largest step without a jump of the input that is to be inside; a
        negative one is from above the goal to it.

    Raises
    ------
    InvalidInput
        A nonlinear law at a goal whose equilibrium moves with the parameters, or a plant that the method cannot take.
    NotProved
        The level could not be proved.
    """
    statement = tolerance_statement(solution, problem, ranges, gamma, scale=scale, p=p, about=about)
    side = 1.0 if step is not None and step < 0.0 else -1.0
    if step is not None:
        step = math.nextafter(abs(step), math.inf)  # π is no double; half a turn must be inside
    start = robot_start(statement, side) or (
        None if step is None else tabled_start(solution, statement, step, side)
    )
    if level is None:
        if step is None or start is None:
            raise InvalidInput(
                "There is no level to prove.",
                f"expected a level, or a step of a plant with an integrator, got level={level!r}, step={step!r}",
                "level=…, in the units of scale · V",
            )
        values = largest_values(statement, start, np.linspace(0.0, step, PATH_POINTS))
        level = _BOX_ROOM * float(values.max()) / PATH_SHARE
    claim, outcome = prove(
        replace(statement, level=float(level)), threads=threads, progress=progress, most_cells=most_cells
    )
    if not outcome.proved:
        raise NotProved(claim, outcome)
    if step is not None and not outcome.cells:
        claim = _largest(claim)
    return replace(
        claim,
        starts=() if start is None else start_inside(claim, start, step),
        provenance=_provenance(outcome, ", vertices of the box"),
    )


def _largest(claim: Certificate) -> Certificate:
    """The certificate with the largest level at which definite matrices still prove it, within 5 %.

    The quotients' ranges grow with the level, so what fails at one level fails at each larger one.
    """
    t = np.array(claim.coordinates)
    inverse = np.linalg.inv(t.T @ quadratic_part(claim.value, len(t)) @ t)
    slopes = np.array([f.slope for f in claim.functions]).reshape(-1, len(t)) @ t
    square = 2.0 * claim.level * float(np.einsum("ki,ij,kj->k", slopes, inverse, slopes).max(initial=0.0))
    most = _MOST_LEVELS if square == 0.0 else min(_MOST_LEVELS, _FARTHEST**2 / square)
    low, proved, high = claim, 1.0, max(most, 1.0)
    factor = high
    while high > _FINE * proved:
        tried = wide_statement(replace(claim, level=factor * claim.level))
        if tried is not None and tried.definite_corners():
            low, proved = tried, factor
        else:
            high = factor
        factor = math.sqrt(proved * high)
    return low


# Output feedback ------------------------------------------------------------------------------------
def with_observer(
    solution: ValueFunction, certificate: Certificate, bandwidth: float, *, share: float = 0.1
) -> Certificate:
    """The certificate with an observer of the plant's states, and the starts that remain inside.

    The sensors are those of the plant of `solution`; its integrals are the controller's own. Every error decays faster
    than exp(−bandwidth · t), 1/s: L is the stationary Kalman gain for A + bandwidth. `share` is ε over the level,
    between 0 and 1, both left out.

    Raises
    ------
    InvalidInput
        As `check_bandwidth`.
    NumericalFailure
        No M and X for this law and these errors.
    """
    from scipy.linalg import solve_continuous_are

    problem = check_bandwidth(solution, bandwidth)
    size = problem.plant.n
    seen = problem.plant.linearise(problem.operating_point[:size])[3]
    sensors = np.hstack([seen, np.zeros((len(seen), len(solution.P) - size))])
    a, b1, _ = linear_system(certificate, certificate.middle, np.zeros(len(certificate.functions)))
    linear, transform = a[:size, :size], np.array(certificate.coordinates)
    spread = (transform @ transform.T)[:size, :size]
    price = np.diag(np.diag(seen @ spread @ seen.T)) / bandwidth
    shifted = (linear + bandwidth * np.eye(size)).T
    covariance = cast("Matrix", solve_continuous_are(shifted, seen.T, bandwidth * spread, price))
    gain = covariance @ seen.T @ np.linalg.inv(price)
    energy = share * certificate.level
    weight, storage, gain_error = _error_energy(certificate, linear - gain @ seen, b1[:size], energy)
    measured, *matrices = map(matrix_rows, (sensors, gain, weight, storage))
    claimed = replace(
        certificate,
        feedback="output injection observer",
        observer=Observer(
            measured, solution.state_names[size:], *matrices, gain_error=gain_error, energy=energy
        ),
    )
    if reason := claimed.why_no_observer():
        raise _no_error_energy(reason)
    return replace(claimed, starts=starts_of(solution, claimed)).with_proved_starts()


def check_bandwidth(solution: ValueFunction, bandwidth: float) -> GeneralisedPlant:
    """Return the problem whose sensors the observer uses; refuse one without, and a bandwidth that is not positive."""
    problem = solution.problem
    if isinstance(problem, GeneralisedPlant) and 0 < bandwidth < np.inf:
        return problem
    raise InvalidInput(
        "There is no such observer.",
        f"expected the problem of a plant with sensors and a bandwidth > 0, got {type(problem).__name__}, "
        f"{bandwidth!r}",
        "a robot's problem, and 10.0, in 1/s",
    )


def _error_energy(
    certificate: Certificate, closed: np.ndarray, noise: np.ndarray, energy: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """M, X and γ_e of the observer's inequalities. The hull depends on X and M on the hull, so they are iterated."""
    size = len(closed)
    algebra = ExactAlgebra(certificate)
    slopes = [
        [terms_of(algebra.moved(law.derivative(j))) for j in range(size)]
        for law in map(algebra.in_x, certificate.law)
    ]
    backwards = np.linalg.inv(np.array(certificate.coordinates))[:, :size]
    widths, scale = np.zeros(len(backwards)), 1 / np.linalg.norm(backwards, axis=0)
    squares = np.outer(scale, scale)
    for _ in range(_PASSES):
        weight = _weight(certificate, slopes, certificate.reach + 1.05 * widths)
        lyapunov = closed * scale / scale[:, None], noise / scale[:, None], weight * squares * (1 + _MARGIN)
        if (solution := _storage(*lyapunov)) is None:
            break
        storage, gain_error = solution[0] / squares, solution[1]
        within = np.einsum("ij,ji->i", backwards, np.linalg.solve(storage, backwards.T))
        before, widths = widths, np.sqrt(2 * energy * within)
        if np.all(widths <= 1.04 * before):
            return weight, storage, gain_error
    raise _no_error_energy(f"the law's slopes where the estimates are did not settle in {_PASSES} passes")


def _no_error_energy(reason: str) -> NumericalFailure:
    return NumericalFailure(
        "No energy of the errors was found for this observer.", reason, "another bandwidth, or degree 2"
    )


def _weight(certificate: Certificate, slopes: list[list[Rational]], widest: np.ndarray) -> np.ndarray:
    """M ≻ JᵀR2 J for all J within their bounds on |z_i| ≤ `widest_i`."""
    transform, r2 = np.array(certificate.coordinates), np.array(certificate.r2)
    size = len(slopes[0])
    at_origin, radius = np.zeros((2, len(slopes), size))  # J at 0, and how far it goes from there
    for row, entries in enumerate(slopes):
        for column, terms in enumerate(entries):
            sizes = {powers: abs(nearest_double(value)) for powers, value in terms.items() if any(powers)}
            at_origin[row, column] = nearest_double(terms.get((0,) * len(widest), fmpq(0)))
            radius[row, column] = sum(size * np.prod(widest ** np.array(e)) for e, size in sizes.items())
    scale, base = np.sqrt(np.diag(transform @ transform.T)[:size]), at_origin.T @ r2 @ at_origin
    most, reached = float(scale @ np.abs(base) @ scale), radius @ scale
    spread = np.sqrt(np.outer(reached, reached) * np.abs(r2)).sum() ** 2
    ratio = np.sqrt(spread / most) if most else 1.0
    weight = (1 + ratio) * base
    if spread:
        weight += (1 + 1 / ratio) * np.diag((np.abs(r2) @ reached) @ (radius / scale))
    weight = weight * (1 + _MARGIN) + _MARGIN * np.diag(most / scale**2) / size
    return (weight + weight.T) / 2


def _storage(closed: np.ndarray, noise: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float] | None:
    """X of AᵀX + XA + M + XGGᵀX/γ_e² = 0 with γ_e a little over the smallest; without G, γ_e = 0."""
    from scipy.linalg import solve_continuous_lyapunov

    solved = cast("Matrix", solve_continuous_lyapunov(closed.T, -weight))
    plain = (solved + solved.T) / 2
    if not noise.any():
        return plain, 0.0
    pushed = noise @ noise.T
    low, high = 0.0, np.sqrt(np.abs(np.linalg.eigvals(plain @ noise @ noise.T)).max()) or 1.0
    while solve_riccati(closed, pushed / high**2, weight) is None:
        low, high = high, 2 * high
        if high > 1e12:
            return None
    for _ in range(60):
        middle = (low + high) / 2
        solution = solve_riccati(closed, pushed / middle**2, weight)
        low, high = (middle, high) if solution is None else (low, middle)
        if high < low * 1.01:
            break
    gain_error = 1.5 * high  # over the smallest one
    solution = solve_riccati(closed, pushed / gain_error**2, weight)
    return None if solution is None else (solution.p, float(gain_error))
