"""`certify`: the largest level that the search proves, as a certificate.

The theorem for every robot within its tolerances, not for the nominal one alone.

The law is the nominal one, and so is V, of the deviation from each robot's own equilibrium at the goal. Two things of a
robot are its own: its rates, for which the search takes the whole box of parameters (`flexhinf.certify.box`), and its
equilibrium. Where that moves, to δ from the nominal one, the input in deviations x from it is u = k(x + δ) − k(δ); for
a linear law this is k(x) again, whatever δ is, and where the plant is linear in what moves, its rates are the same too.
So with V of degree two the box needs nothing else at any goal; for a nonlinear law the goal must be one whose
equilibrium stays, such as upright.

A step starts at each robot's own equilibrium at −a, and where the input must not jump, with the integrator at which
this robot's input is the one that held it: both are terms in a and in the robot's parameters.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.certify.box import BoxExcess
from flexhinf.certify.cells import CellBounds, Outcome, Progress, search
from flexhinf.certify.certificate import Certificate
from flexhinf.certify.inequality import Inequality, inequality_of
from flexhinf.certify.observer import check_bandwidth, observed
from flexhinf.certify.reading import flat_names, nearest_double, plant_terms
from flexhinf.certify.sampled_gain import quadratic_part
from flexhinf.certify.starts import largest_values, robot_start, start_inside, starts_of, tabled_start
from flexhinf.certify.terms import MOST_STATES, Polynomial
from flexhinf.certify.theorem import few_bits, law_polynomials, signals, statement_of, with_units
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.hinf.margin import CheckedPenalty
from flexhinf.hinf.sampled import sample_region
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.robot import Robot
from flexhinf.validation import HUGE

_DIRECTIONS = 20_000  # rays that are followed to see how far the region extends
_BELOW = (0.999, 0.995, 0.98, 0.95, 0.9, 0.8)  # shares of the level that failed, tried in turn
_ROOM = 1.1  # reach over the largest radius that was seen
_LARGER = 1.6  # reach over the one that was too small


class NotProved(NumericalFailure):
    """The inequality could not be proved up to a level.

    Attributes
    ----------
    point : ndarray, shape (n,), or None
        Deviation at which it fails, or where the search gave up.
    """

    def __init__(
        self,
        what: str,
        found: str = "",
        advice: str = "",
        *,
        point: np.ndarray | None = None,
        reason: str = "",
    ) -> None:
        super().__init__(what, found, advice)
        self.point, self.reason = point, reason

    @classmethod
    def at(cls, level: float, outcome: Outcome, point: np.ndarray | None) -> NotProved:
        """What a search up to `level` ended with, at a deviation."""
        where = "" if point is None else f" at x = {np.array2string(point, precision=6)}"
        return cls(
            f"The level V <= {level:.8g} is not proved.",
            f"{outcome.reason}{where}, where V = {outcome.value:.8g} and r/|z|^2 = {outcome.residual:.3g}, "
            f"after {outcome.cells} cells",
            "a smaller level, a larger gamma, or a smaller penalty",
            point=point,
            reason=outcome.reason,
        )


@dataclass(frozen=True, eq=False)
class _Extent:
    """How far a region goes: the largest |z_j|, and the largest |ℓ| of each function."""

    reach: float
    forms: np.ndarray


def certify(
    solution: ValueFunction,
    gamma: float | None = None,
    penalty: CheckedPenalty | None = None,
    level: float | None = None,
    *,
    decay: float = 0.0,
    about: str = "",
    observer: float | None = None,
    threads: int = 1,
    progress: Progress | None = None,
) -> Certificate:
    """What `HJISolution.certify` does."""
    check_states(len(solution.P))
    check_decay(decay)
    if observer is not None:
        check_bandwidth(solution, observer)
    statement = statement_of(solution, gamma, penalty, decay=decay, about=about)
    if level is not None:
        proved, outcome = _proved(solution, replace(statement, level=float(level)), threads, progress)
        if not outcome.proved:
            raise NotProved.at(level, outcome, _in_state(statement, outcome))
        return proved if observer is None else observed(solution, proved, observer)
    check = sample_region(solution, gamma, penalty)
    if check is None or not 0 < check.level < np.inf:
        raise InvalidInput(
            "There is no level to prove.",
            "expected a level found by sampled_region, got "
            + ("no definite margin" if check is None else f"{check.level:g} ({check.limit})"),
            "a level, or a weaker pair: checked_margin says where the margin is lost",
        )
    tried = check.level
    for share in _BELOW:
        tried *= share
        proved, outcome = _proved(solution, replace(statement, level=tried), threads, progress)
        if outcome.proved:
            found = replace(proved, sampled_level=check.level)
            return found if observer is None else observed(solution, found, observer)
        if outcome.value == outcome.value:
            tried = min(tried, outcome.value)
    raise NotProved.at(tried, outcome, _in_state(statement, outcome))


def check_decay(decay: float) -> None:
    """Refuse a rate of decay that is negative or not finite."""
    if not 0.0 <= decay < np.inf:
        raise InvalidInput(
            "There is no such rate of decay.",
            f"expected a finite decay >= 0 in 1/s, got {decay}",
            "0.2, or 0 for none",
        )


def check_states(count: int) -> None:
    """Refuse more states than a proof can be made in."""
    if count > MOST_STATES:
        raise InvalidInput(
            "A proof in so many states would not end.",
            f"expected at most {MOST_STATES} states, got {count}: cells grow 10 to 23 times with each",
            "solution.sampled_region(), which looks at points and proves nothing",
        )


def _proved(
    solution: ValueFunction, statement: Certificate, threads: int, progress: Progress | None
) -> tuple[Certificate, Outcome]:
    """The statement with its reach and its starts, and how the search ended."""
    found, outcome = prove(statement, threads=threads, progress=progress)
    if not outcome.proved:
        return found, outcome
    provenance = {"cells": str(outcome.cells), "method": method_of(outcome)}
    complete = replace(found, starts=starts_of(solution, found), provenance=provenance)
    return complete.with_proved_starts(), outcome


def prove(
    statement: Certificate,
    *,
    threads: int = 1,
    progress: Progress | None = None,
    most_cells: int = 100_000_000,
) -> tuple[Certificate, Outcome]:
    """Search for a proof of a statement: first of a definite quadratic form, then by cells.

    Parameters
    ----------
    statement : Certificate
        Its `reach` is replaced, its starts are not looked at.
    threads : int
        The result does not depend on it.
    progress : callable, optional
        Called with the number of cells done and the estimated share of the whole.
    most_cells : int
        0: a definite quadratic form or nothing.

    Returns
    -------
    (Certificate, Outcome)
        The statement with its reach, and how the search ended.
    """
    if progress is not None:
        progress(0, 0.0)  # what limits the time may end it here
    if (wide := wide_statement(statement)) is not None and wide.definite_corners():
        return wide, Outcome(True, "proved", None, statement.level, 0.0, 0)
    if not most_cells:
        return statement, Outcome(False, "no definite quadratic form", None, np.nan, np.nan, 0)
    inequality = inequality_of(statement)
    extent = _extent(inequality, statement.level)
    reach = _few_bits(_ROOM * extent.reach)
    for _ in range(4):
        box = BoxExcess(statement, reach) if any(p.low < p.high for p in statement.parameters) else None
        bounds = CellBounds(inequality, reach, (1.3 * extent.forms + 0.1).tolist(), box)
        outcome = search(bounds, statement.level, threads=threads, progress=progress, most_cells=most_cells)
        if outcome.reason != "not closed":
            break
        reach = _few_bits(_LARGER * reach)
    return replace(statement, reach=reach), outcome


def wide_statement(statement: Certificate) -> Certificate | None:
    """The statement with a cube that holds all of {V ≤ level}, for a V of degree two; None for others."""
    t = np.array(statement.coordinates)
    quadratic = t.T @ quadratic_part(statement.value, len(t)) @ t  # V = ½ zᵀ(…)z
    if statement.degree != 2 or np.linalg.matrix_rank(quadratic) < len(t):
        return None
    inverse = np.linalg.inv(quadratic)
    reach = _ROOM * float(np.sqrt(2.0 * statement.level * inverse.diagonal().max()))
    return replace(statement, reach=_few_bits(reach)) if 0.0 < reach < HUGE else None


def method_of(outcome: Outcome) -> str:
    """How a statement was proved."""
    return "branch and bound along rays" if outcome.cells else "a definite quadratic form"


def _in_state(statement: Certificate, outcome: Outcome) -> np.ndarray | None:
    return None if outcome.point is None else np.array(statement.coordinates) @ outcome.point


def _few_bits(value: float) -> float:
    """The value rounded up to eight bits, so that its products with dyadic fractions are exact."""
    unit = 2.0 ** (np.floor(np.log2(value)) - 7)
    return float(np.ceil(value / unit) * unit)


def _extent(inequality: Inequality, level: float) -> _Extent:
    """Along random rays, how far {V ≤ level} goes; not a bound, only where to look."""
    n = inequality.states
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((_DIRECTIONS, n))
    directions = np.concatenate([directions, np.eye(n), -np.eye(n)])
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    parts = _along(inequality, directions)
    radius = np.zeros(len(directions))
    step = 0.02 * np.sqrt(level / parts[:, 2])
    alive = np.ones(len(directions), dtype=bool)
    value = np.zeros(len(directions))
    for _ in range(2000):
        further = radius + step
        following = sum(part * further**k for k, part in enumerate(parts.T))
        alive &= (following < 1.002 * level) & (following > value)
        if not alive.any():
            break
        radius, value = np.where(alive, further, radius), np.where(alive, following, value)
    forms = np.array([[nearest_double(a) for a in q.form] for q in inequality.quotients]).reshape(-1, n)
    reached = radius + step
    return _Extent(float(reached.max()), np.abs(directions @ forms.T * reached[:, None]).max(axis=0))


def _along(inequality: Inequality, directions: np.ndarray) -> np.ndarray:
    """V_k at directions z, (N, degree + 1)."""
    highest = max(map(sum, inequality.value))
    powers: list[Any] = [np.ones_like(directions)]
    for _ in range(highest):
        powers.append(powers[-1] * directions)
    result = np.zeros((len(directions), highest + 1))
    for key, value in inequality.value.items():
        term = np.full(len(directions), nearest_double(value))
        for i, e in enumerate(key):
            if e:
                term *= powers[e][:, i]
        result[:, sum(key)] += term
    return result


Ranges = Mapping[str, tuple[float, float]]

_POINTS = 400  # of a path at which V is looked at, to see how far it stays inside
_BOX_ROOM = 1.002  # level over the largest V on a path that is to be inside
_INSIDE = 1 - 1e-3  # V on a path stays below this share of the level, so that the check is quick
_FINE = 1.05  # ratio of levels at which the search for the largest one ends
_MOST_LEVELS = 1e6  # the largest level over the one that a step needs
_FARTHEST = 63.0  # |ℓᵀx| of a function: the checker looks as far as 64
_FURTHEST = 3  # how far a path is followed, over the amplitude that its beginning predicts
_MOVED = 1e-12  # rates at the nominal equilibrium above this, relative to the parameters: it moves
_ROUNDING = 1e-14  # terms below this, relative to the largest, are what rounding left of a sum that cancels


def parameter_ranges(robot: Robot, plant: Any, scale: float = 1.0) -> dict[str, tuple[float, float]]:
    """Ranges of a plant's parameters over the robot's tolerances, rounded outwards.

    Parameters
    ----------
    robot : Robot
        Each parameter of its plant is monotone in each of its own, so the ends are those of its corners.
    plant : Plant or GeneralisedPlant
        Of the robot.
    scale : float
        Of all tolerances.
    """
    table = plant.parameters
    names = [parameter.name for parameter in robot.uncertain]
    rows = [
        table.replaced(table.known(robot.corner(dict(zip(names, signs))))).vector()
        for signs in itertools.product((-scale, scale), repeat=len(names))
    ]
    low, high = np.min(rows, axis=0), np.max(rows, axis=0)
    varies = low < high
    low, high = (
        np.where(varies, np.nextafter(low, -np.inf), low),
        np.where(varies, np.nextafter(high, np.inf), high),
    )
    return dict(zip(flat_names(table), zip(low.tolist(), high.tolist())))


def certify_tolerances(
    solution: ValueFunction,
    problem: GeneralisedPlant,
    ranges: Ranges,
    gamma: float,
    *,
    level: float | None = None,
    step: float | None = None,
    scale: float = 1.0,
    p: np.ndarray | None = None,
    about: str = "",
    threads: int = 1,
    progress: Progress | None = None,
    most_cells: int = 100_000_000,
) -> Certificate:
    """Prove that the gain of a law is at most γ for a whole box of parameters, on a level set of V.

    Parameters
    ----------
    solution : HJISolution
        Its law is proved, with `scale` times its V as the storage function.
    problem : GeneralisedPlant
        Whose disturbance, penalty and R2 the gain is of: need not be the one that the law was designed for.
    ranges : mapping of str to (float, float)
        Of the plant's parameters, see `parameter_ranges`; those that are not named are nominal.
    level, step : float
        The level of the storage function, or the largest step without a jump of the input that is to be inside; a
        negative one is from above the goal to it.
    p : ndarray, shape (n, n), optional
        ½ xᵀPx is the storage function instead, see `flexhinf.certify.common_value`.
    most_cells : int
        The search ends there.

    Raises
    ------
    InvalidInput
        A nonlinear law at a goal whose equilibrium moves with the parameters, or a plant that the method cannot take.
    NotProved
        The level could not be proved.
    """
    statement = tolerance_statement(solution, problem, ranges, gamma, scale=scale, p=p, about=about)
    side = 1.0 if step is not None and step < 0.0 else -1.0
    step = (
        None if step is None else math.nextafter(abs(step), math.inf)
    )  # π is no double, and half a turn is inside
    start = robot_start(statement, side)
    if start is None and step is not None:
        start = tabled_start(solution, statement, step, side)
    if level is None:
        if step is None or start is None:
            raise InvalidInput(
                "There is no level to prove.",
                f"expected a level, or a step of a plant with an integrator, got level={level!r}, step={step!r}",
                "level=…, in the units of scale · V",
            )
        level = (
            _BOX_ROOM
            * float(largest_values(statement, start, np.linspace(0.0, step, _POINTS)).max())
            / _INSIDE
        )
    statement = replace(statement, level=float(level))
    found, outcome = prove(statement, threads=threads, progress=progress, most_cells=most_cells)
    if not outcome.proved:
        point = None if outcome.point is None else np.array(found.coordinates) @ outcome.point
        raise NotProved.at(level, outcome, point)
    if step is not None and not outcome.cells:
        found = _largest(found)
    provenance = {"cells": str(outcome.cells), "method": f"{method_of(outcome)}, vertices of the box"}
    starts = () if start is None else start_inside(found, start, step)
    return replace(found, starts=starts, provenance=provenance)


def _largest(found: Certificate) -> Certificate:
    """The same at the largest level at which definite matrices still prove it, within 5 %.

    The quotients' ranges grow with the level, so what fails at one level fails at each larger one.
    """
    t = np.array(found.coordinates)
    inverse = np.linalg.inv(t.T @ quadratic_part(found.value, len(t)) @ t)
    slopes = np.array([f.slope for f in found.functions]).reshape(-1, len(t)) @ t
    square = 2.0 * found.level * np.einsum("ki,ij,kj->k", slopes, inverse, slopes).max(initial=0.0)
    most = _MOST_LEVELS if square == 0.0 else min(_MOST_LEVELS, _FARTHEST**2 / square)
    low, high = found, max(most, 1.0)
    factor, proved = high, 1.0
    while high > _FINE * proved:
        tried = wide_statement(replace(found, level=factor * found.level))
        if tried is not None and tried.definite_corners():
            low, proved = tried, factor
        else:
            high = factor
        if proved == high:
            break
        factor = math.sqrt(proved * high)
    return low


def tolerance_statement(
    solution: ValueFunction,
    problem: GeneralisedPlant,
    ranges: Ranges,
    gamma: float,
    *,
    scale: float = 1.0,
    p: np.ndarray | None = None,
    about: str = "",
) -> Certificate:
    """The certificate to be proved, at level 1; arguments as `certify_tolerances`."""
    terms = plant_terms(problem)
    fixed = [name for name in terms.inside if name in ranges and ranges[name][0] < ranges[name][1]]
    if fixed:
        raise InvalidInput(
            "A parameter stands inside a function of the state.",
            f"expected parameters that multiply terms, got {', '.join(sorted(fixed))}",
            "its nominal value, or sampled_region",
        )
    law = law_polynomials(solution, terms)
    parameters = tuple(
        replace(p, low=ranges[p.name][0], high=ranges[p.name][1]) if p.name in ranges else p
        for p in with_units(problem, terms.parameters)
    )
    value = (
        tuple(
            (tuple(powers), scale * value)
            for degree, part in sorted(solution.value_parts.items())
            for powers, value in zip(solution.exponents(degree).tolist(), part.tolist())
            if value
        )
        if p is None
        else _quadratic(p)
    )
    root = np.linalg.inv(np.linalg.cholesky(scale * solution.P if p is None else p)).T
    statement = Certificate(
        about=about or "a state feedback, for all parameters in the box",
        states=signals(problem, solution.state_names), inputs=signals(problem, solution.input_names),
        disturbances=signals(problem, problem.disturbance_names),
        drift=terms.drift, g1=terms.g1, g2=terms.g2,
        penalty=tuple(row for row in terms.penalty if row),
        r2=tuple(map(tuple, problem.r2.tolist())),
        value=value, law=law, gamma=float(gamma), level=1.0,
        coordinates=tuple(map(tuple, few_bits(root @ _axes(law, problem, root, gamma)).tolist())),
        reach=1.0, parameters=parameters, functions=terms.functions,
    )  # fmt: skip
    _refuse_moved(statement, problem)
    return statement


def _quadratic(p: np.ndarray) -> Polynomial:
    """½ xᵀPx."""
    n = len(p)
    return tuple(
        (tuple(int(k == i) + int(k == j) for k in range(n)), float(p[i, j] / (2.0 if i == j else 1.0)))
        for i in range(n)
        for j in range(i, n)
        if p[i, j]
    )


def _axes(
    law: tuple[Polynomial, ...], problem: GeneralisedPlant, root: np.ndarray, gamma: float
) -> np.ndarray:
    """Rotation (n, n) after which r_2 of the nominal plant is diagonal; P⁻¹ = root rootᵀ."""
    plant, p = problem.expand(1), np.linalg.inv(root @ root.T)
    units = [tuple(row) for row in np.eye(len(p), dtype=int).tolist()]
    gain = np.array([[dict(row).get(unit, 0.0) for unit in units] for row in law])
    a = plant.f_parts[1] + plant.g2_parts[0][:, :, 0] @ gain
    h, b1 = plant.h_parts[1], plant.g1_parts[0][:, :, 0]
    quadratic = p @ a + a.T @ p + h.T @ h + gain.T @ problem.r2 @ gain + p @ b1 @ b1.T @ p / gamma**2
    return np.linalg.eigh(-root.T @ quadratic @ root)[1]


def _refuse_moved(statement: Certificate, problem: GeneralisedPlant) -> None:
    """Refuse an equilibrium at the goal that moves with the parameters, but for a linear law and in states in which
    the plant is linear: those of functions and products must be held at the goal by an integrator."""
    if not _moves(statement, problem):
        return
    linear = all(sum(powers) == 1 for law in statement.law for powers, _ in law)
    bent = {i for f in statement.functions for i, slope in enumerate(f.slope) if slope}
    bent |= {
        i
        for row in statement.drift
        for term in row
        if sum(term.powers) + (term.function is not None) > 1
        for i, power in enumerate(term.powers)
        if power
    }
    bent |= {
        i
        for entry in (*statement.g1, *statement.g2)
        for terms in entry
        for term in terms
        for i, power in enumerate(term.powers)
        if power
    }
    bent |= {
        i
        for row in statement.penalty
        for powers, _ in row
        if sum(powers) > 1
        for i, power in enumerate(powers)
        if power
    }
    held = {
        row[0].powers.index(1)
        for row, inputs in zip(statement.drift, statement.g2)
        if len(row) == 1 and row[0].function is None and sum(row[0].powers) == 1 and not any(inputs)
    }
    if not linear or bent - held:
        raise InvalidInput(
            "The equilibrium at the goal moves with the parameters, and the law is not linear, or the plant is not "
            "linear in what moves.",
            f"expected no moving equilibrium, or a law of degree 1 and integrators that hold {sorted(bent)}, got "
            f"a law of degree {max(sum(powers) for law in statement.law for powers, _ in law)}",
            "degree=2, whose law is linear, or a goal at which no torque is held",
        )


def _moves(statement: Certificate, problem: GeneralisedPlant) -> bool:
    """Whether some parameters give rates at the nominal equilibrium."""
    table = problem.plant.parameters
    flat, nominal = flat_names(table), table.vector()
    point, u = np.asarray(problem.operating_point), np.asarray(problem.operating_input)
    rng, d = np.random.default_rng(0), np.zeros(len(problem.disturbance_names))
    varying = [p for p in statement.parameters if p.low < p.high]
    corners = [{p.name: end} for p in varying for end in (p.low, p.high)]
    corners += [{p.name: (p.low, p.high)[rng.integers(2)] for p in varying} for _ in range(16)]
    for corner in corners:
        there = nominal.copy()
        for name, value in corner.items():
            there[flat.index(name)] = value
        rates = np.asarray(problem.flow(point, u, d, table.named(there)), dtype=float)
        if np.abs(rates).max() > _MOVED * max(1.0, float(np.abs(nominal).max())):
            return True
    return False
