"""Solve the Hamilton–Jacobi–Isaacs equation, Eq. (8), to any degree about an operating point.

The problem
-----------
For ẋ = f(x) + g1(x) d + g2(x) u, z = (h(x), l(x) u), lᵀl = R2, f(0) = 0, h(0) = 0, a law u = k(x) is wanted with
∫|z|² dt ≤ γ² ∫|d|² dt from x = 0. It is one player's strategy in a zero-sum game whose value V ≥ 0 solves
[vanderschaft1992, isidori1995]

    V_x f + ½ hᵀh + ½ V_x (g1 g1ᵀ/γ² − g2 R2⁻¹ g2ᵀ) V_xᵀ = 0,                                              (8)

with u = −R2⁻¹ g2ᵀ V_xᵀ and worst disturbance d = g1ᵀ V_xᵀ/γ². γ = ∞ leaves the Hamilton–Jacobi–Bellman equation
of optimal regulation. With R2 = L Lᵀ and the columns g_c of (g1/γ, g2 L⁻ᵀ), signs s_c = +1 for d and −1 for u, the
quadratic terms are squares of scalar polynomials (`ScaledProblem`):

    V_x f + q + ½ Σ_c s_c w_c² = 0,    w_c = V_x g_c,    q = ½ hᵀh.

The expansion
-------------
Let V = V_2 + V_3 + …, V_k homogeneous of degree k, and collect (8) by degree [albrekht1961, lukes1969, huang1995].

*Degree 2*, V_2 = ½ xᵀPx, is a Riccati equation with an indefinite quadratic term (`linear_part.py`),

    AᵀP + PA + Q + P M P = 0,    M = B1 B1ᵀ/γ² − B2 R2⁻¹ B2ᵀ,    A_cl = A + M P stable,    P ≥ 0.

*Degree k > 2* is linear in V_k, because V_k meets only what is of lowest degree (`recursion.py`):

    V_k,x A_cl x + r_k = 0,    r_k = q_k + Σ_{i<k} V_i,x f_{k+1−i} + ½ Σ_{a+b=k} s · w_a w_b,

where w_{k−1} lacks V_k,x g(0): that part, with w_1, has become A_cl x. There is exactly one solution, since no sum
λ_{i1} + … + λ_{ik} of eigenvalues of A_cl vanishes. V to degree d takes f and h through d − 1 and g through d − 2, and
gives the law through degree d − 1. Degrees with r_k empty vanish: for odd f and h and even g all the odd ones.

The algorithm
-------------
1. *Scale* the states and V by powers of two that balance the Hamiltonian matrix (`Scaling`).
2. *Riccati*: ordered real Schur form of the Hamiltonian matrix, then Newton steps with the residual formed in
   extended precision. The Schur form alone, good to 1e-10, would cap every higher degree. No P ≥ 0: γ ≤ γ*, and γ* is
   found by bisection on the existence of P (`smallest_gamma`), since it may be lost by P → ∞ and not by an
   eigenvalue on the imaginary axis.
3. *Right-hand sides*: polynomials are stored without repetition, one number per monomial, C(n+k−1, k) where a Kronecker
   vector has n^k (`polynomial/basis.py`). Gradients are gathers by the table "rank of β with j inserted"; products
   are one matrix product and one summation by target, together where they are large (`hinf/products.py`); zero columns
   of f, as in a chain of links, are skipped.
4. *Homological equation* (`hinf/homological.py`). With A_cl T = T Λ and x = T z it is a division by
   −(λ_{i1} + … + λ_{ik}), for large n and k in one pass (`hinf/pairs.py`); the change of variables works on at most
   C(n+k/2−1, k/2)² real numbers at a time. The error grows like cond(T)^k ε. One step of refinement repairs it while
   that is small; beyond, or when the measured residual says so, complex Schur form U with substitution by index sums,
   backward stable even for a defective A_cl.
5. *States in which V is bounded* (`BoundedStates`). Close to γ*, or where P is large for other reasons, the
   recursion runs in states in which P is of ordinary size; in others it would lose all digits there.
6. *Accuracy* (`recursion.py`). The V that is returned is inserted into (8) at random points; at every degree the
   residual relative to the largest of the terms of (8) is reported. The error of each degree is estimated from the
   sensitivities of P, and measured by a second solve where these say that digits may be lost. A degree whose
   coefficients hold to fewer than two digits is not returned.

Cost of degree k: about n C(n+k/2−1, k/2)² multiplications for each of the k steps of a change of variables, and tables
of n C(n+k−2, k−1) integers. Accuracy: 1e-15 to 1e-13 of the largest coefficient of the degree where the problem itself
is well-conditioned; 60-digit arithmetic and a family with known solution are among the tests.

References are keys of docs/references.bib; docs/synthesis.md has examples, times and comparisons.

The cost of a solve, memory and operations, is estimated before it starts: memory within a factor of two from about 100
MB on, which a test measures; so what is begun must fit twice.
"""

# Not checked strictly: what a caller passes may be of another type than stated.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

import math
import os
import sys
from bisect import bisect_right
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from numbers import Integral, Real
from pathlib import Path
from time import perf_counter

import numpy as np

from flexhinf.errors import InfeasibleGamma, InvalidInput, NumericalFailure, refuse_if
from flexhinf.hinf.homological import rotates_in_machine_code
from flexhinf.hinf.linear_part import (
    LinearPart,
    PartsByDegree,
    RiccatiSolution,
    ScaledProblem,
    Scaling,
    check_problem,
    linear_smallest_gamma,
    polish,
    sensitivity,
)
from flexhinf.hinf.products import table_memory
from flexhinf.hinf.recursion import (
    BoundedStates,
    DegreeRecord,
    checked_records,
    degree_errors,
    equation_residuals,
    moved,
    solve_degrees,
)
from flexhinf.hinf.solution import HIGHEST, HJISolution
from flexhinf.plant.polynomial_plant import PolynomialPlant, Problem
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import monomials
from flexhinf.polynomial.basis import count
from flexhinf.processors import own_groups
from flexhinf.validation import real_number, value_text

_RATE = 4e8  # estimated operations a second, within a factor of three from a second on: 2e8 (5 states) to 1.3e9 (127)
_LONG = _RATE  # estimated operations below which no progress bar appears
_DAY, _WAIT = 86_400.0, 600.0  # s: what takes longer is refused; what a refusal advises takes no longer
_UNCHECKED = 1 << 22  # bytes: what needs less is not compared with the memory that is available
_MOST = 1 << 1000  # beyond which estimates are cut off: they would leave the floats
_CGROUPS, _OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def estimate_memory(size: tuple[int, int, int, int], degree: int, expanded: bool = False) -> int:
    """Bytes needed at the peak by `solve_hji`, tables included.

    `size`: States, disturbances, inputs, penalised outputs. `degree`: Degree of V. `expanded`: With the Taylor
    expansion of the plant's code in states, inputs and disturbances together, whose index tuples stay.

    The largest arrays are the half-transformed tensors of a change of variables, count(n, k−s) × count(n, s)
    (two, or the one of s = 2 where it runs in machine code), the insertion tables, and the gradients of
    the lower degrees.
    """
    n, md, m, _ = size
    highest = count(n, degree)
    tables = sum(4 * n * count(n, k - 1) + (2 * k + 8) * count(n, k) for k in range(1, degree + 1))
    pairs = 4 * degree * highest if highest > 5_000 else 0
    lower = sum(8 * (n + md + m) * count(n, k - 1) for k in range(2, degree))
    halves = [count(n, degree - s) * count(n, s) for s in range(degree + 1)]
    transform = 8 * max(a + b for a, b in pairwise(halves)) if degree > 2 else 0
    if rotates_in_machine_code(n, degree):
        levels = count(n + 1, degree - 3)  # tuples of all degrees below: what a thread has for eight columns
        transform = 8 * count(n, degree - 2) * (count(n, 2) + 8) + 2 * 8 * 8 * min(n, 12) * levels
    values = 8 * 10 * highest
    products = 24 * min(300_000, highest * degree) + table_memory(n, degree)
    plant = 2 * 8 * n * sum(count(n, k) for k in range(1, degree))  # f, and f scaled, full to degree − 1
    solve = plant + tables + pairs + lower + transform + values + products
    if not expanded:
        return solve
    monomials = [count(n + md + m, k) for k in range(degree)]
    tuples = sum(2 * k * number for k, number in enumerate(monomials))
    return max(tuples + 52 * sum(monomials), tuples + 16 * sum(monomials) + solve)


def check_cost(size: tuple[int, int, int, int], degree: int, expanded: bool = False) -> int:
    """Memory in bytes, as `estimate_memory`; refuses what would not fit twice in the memory that is available, and
    what would take more than about a day.

    Raises InvalidInput: with the estimate, what is available, and the highest degree that fits and takes less than
    about ten minutes.
    """

    def needed(degree: int) -> int:
        return min(estimate_memory(size, degree, expanded), _MOST)

    def cost(degree: int) -> float:  # of the memory that is available and of the time that is advised
        return max(2 * needed(degree) / available, total_work(size[0], degree) / (_WAIT * _RATE))

    what = f"Degree {degree} in {size[0]} {'state' if size[0] == 1 else 'states'}"
    memory, seconds = needed(degree), total_work(size[0], degree) / _RATE
    available = _UNCHECKED if 2 * memory <= _UNCHECKED else available_memory()
    if 2 * memory <= available and seconds <= _DAY:
        return memory
    fits = max(2, bisect_right(range(degree), 1.0, key=lambda k: cost(k) if k > 2 else 0.0) - 1)
    advice = (
        f"degree {fits} is the highest that fits and takes less than about ten minutes, with about "
        f"{needed(fits) / 1e9:.3g} GB"
    )
    if 2 * memory > available:
        raise InvalidInput(
            f"{what} does not fit in memory.",
            f"about {memory / 1e9:.3g} GB are needed, {available / 1e9:.3g} GB are available, of which half is "
            "kept for what the estimate may miss",
            advice,
        )
    raise InvalidInput(
        f"{what} takes too long.",
        f"expected less than about a day, got about {seconds / _DAY:.2g} days",
        advice,
    )


def available_memory() -> int:
    """Bytes of memory available to this process without swapping, as far as the system reports it."""
    return max(1, min((*_free_here(), *_free_of_groups()), default=1 << 62))


def _free_here() -> Iterator[int]:
    """Bytes of the machine, those of them that are free, and what is left below the limit of the process."""
    with suppress(AttributeError, ValueError, OSError):
        yield os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with suppress(OSError), open("/proc/meminfo", encoding="ascii") as table:
        yield from (1024 * int(line.split()[1]) for line in table if line.startswith("MemAvailable:"))
    with suppress(ImportError, OSError, ValueError):
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]  # of addresses, as `ulimit -v` sets it
        taken = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        if limit != resource.RLIM_INFINITY:
            yield limit - taken


def _free_of_groups() -> Iterator[int]:
    """Free bytes below the limit of each control group of the process, of version 2 or 1.

    Pages of files that are kept for later count as free: the system takes them back.
    """
    names = {
        2: ("memory.max", "memory.current", "inactive_file"),
        1: ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    }
    for group in {*own_groups("memory", _CGROUPS, _OWN_GROUPS)}:
        limit, used, cached = names[2 if (group / names[2][0]).exists() else 1]
        with suppress(OSError, ValueError):
            most = int((group / limit).read_text())  # "max" is no limit
            stated = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
            yield most - int((group / used).read_text()) + int(stated.get(cached, 0))


def work(n: int, k: int) -> float:
    """Operations of one change of variables at degree `k`, which dominates that degree."""
    return float(min(_MOST, sum(count(n, k - s - 1) * n * count(n, s + 1) for s in range(k))))


def total_work(n: int, degree: int) -> float:
    """Operations of all degrees up to `degree`, as `work`."""
    return sum(work(n, k) for k in range(3, degree + 1))


@contextmanager
def degree_progress(n: int, degree: int) -> Generator[Callable[[int], None]]:
    """Yield a callable that reports each finished degree. The bar appears on a terminal only, on standard error."""
    total = total_work(n, degree)
    if total < _LONG or not sys.stderr.isatty():
        yield lambda degree_done: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(f"V to degree {degree}, {n} states", total=total)
        yield lambda degree_done: bar.update(
            task, advance=work(n, degree_done), description=f"degree {degree_done} of {degree} done"
        )


_SMALL = 5_000  # coefficients of the highest degree up to which bounded states cost little: f is full in them
#: Eigenvalue of P in balanced states from which V is found in bounded ones: small, large problems.
_LARGE_P = 64.0, 1e3
_LARGE_GROWTH = 2.0  # ‖dP/d log γ‖/‖P‖ from which it is: γ below about 1.2 γ*
_DOUBTFUL_GROWTH = 100.0  # the same, from which the error is measured: γ below about 1.005 γ*
_DOUBTFUL_P = 1e4  # eigenvalue of P in balanced states from which it is


def solve_hji(problem: Problem, gamma: float, degree: int) -> HJISolution:
    """Value function and law of the problem to the given degree.

    Parameters
    ----------
    problem : Problem
        A generalised plant or a `PolynomialPlant`; g1, g2 and h may depend on the state.
    gamma : float
        Attenuation level, above γ*; `math.inf` gives the Hamilton–Jacobi–Bellman equation.
    degree : int
        Degree of V, 2 to 200. The law has degree − 1.

    Returns
    -------
    HJISolution

    Raises
    ------
    InvalidInput
        γ not positive, degree not an integer from 2 to 200, not a problem, more memory than there is, or more than
        about a day.
    NotStabilisable, NotDetectable
        The state and the mode are named.
    InfeasibleGamma
        γ ≤ γ*, which is in the message and in `.gamma_star`.
    NumericalFailure
        The coefficients left the finite numbers, or some degree holds to fewer than two digits.

    Notes
    -----
    This module's docstring is the derivation, `HJISolution.report` the account of what was done. A progress bar
    appears on a terminal when the solve will take longer than about a second.

    Examples
    --------
    The scalar plant ẋ = x − x³ + d + u, z = (x, u), whose V_x = (f + √(f² + s x²))/s, s = 1 − 1/γ², is known:

    >>> import flexhinf as fh
    >>> plant = fh.PolynomialPlant({(1,): [1.0], (3,): [-1.0]}, [[1.0]], [[1.0]], {(1,): [1.0]}, 1.0)
    >>> solution = fh.solve_hji(plant, gamma=2.0, degree=4)
    >>> s = 1 - 1 / 2**2
    >>> bool(abs(2 * solution.coefficients(2)[(2,)] - (1 + (1 + s) ** 0.5) / s) < 1e-13)
    True
    """
    level = real_number(gamma) if isinstance(gamma, Real) and not isinstance(gamma, bool) else math.nan
    refuse_if(
        not level > 0,
        "The attenuation level gamma is not a positive number.",
        f"expected gamma > 0 (math.inf for no disturbance), got {value_text(gamma)}",
        "a multiple of smallest_gamma(problem), for example 2; where that is 0 the disturbance does not reach z "
        "(is it used in flow?), and any gamma > 0 will do",
    )
    refuse_if(
        not isinstance(degree, Integral) or isinstance(degree, bool) or not 2 <= degree <= HIGHEST,
        f"The degree of V is not an integer from 2 to {HIGHEST}.",
        f"expected 2, 3, 4, …, got {value_text(degree)}",
        "4 gives a cubic law; 2 gives the linear one",
    )
    check_problem(problem)
    try:
        return _solution(problem, level, int(degree))
    except MemoryError as error:
        raise InvalidInput(
            f"Degree {degree} in {len(problem.state_names)} states does not fit in memory.",
            f"the memory ran out on the way, after the estimate: {str(error)[:200] or 'no more is given'}",
            f"degree {max(2, degree - 2)}, or more memory",
        ) from error


def _solution(problem: Problem, gamma: float, degree: int) -> HJISolution:
    expanded = not isinstance(problem, PolynomialPlant)
    if expanded:  # the expansion itself may already not fit
        size = len(problem.state_names), len(getattr(problem, "disturbance_names", ())), len(problem.r2), 0
        check_cost(size, degree, expanded)
    plant = problem.expand(degree - 1)
    memory = check_cost(plant.size, degree, expanded)
    linear = LinearPart.of(plant)
    linear.check()
    with degree_progress(len(plant.state_names), degree) as advance:
        solved = _solve(plant, linear, gamma, degree, advance)
    if solved is None:
        gamma_star = linear_smallest_gamma(linear)
        if math.isfinite(gamma) and gamma <= gamma_star * (1 + 1e-8):
            raise InfeasibleGamma(gamma, gamma_star)
        raise NumericalFailure(
            "The Riccati equation was not solved.",
            f"gamma = {gamma:.10g} is above gamma* = {gamma_star:.10g}, but no stabilising solution was found",
            "a gamma further above gamma*, or better scaled weights",
        )
    scaling, scaled, value, records, condition, growth, largest = solved
    if not all(np.isfinite(part).all() for part in value.values()):
        raise NumericalFailure(
            "The solution left the finite numbers.",
            f"expected finite coefficients through degree {degree}, got infinite ones at gamma = {gamma:.6g}",
            "a gamma further above gamma*, or a lower degree",
        )
    doubtful = growth > _DOUBTFUL_GROWTH or largest > _DOUBTFUL_P
    other = _nearby(plant, gamma, degree, scaling, value) if doubtful else None
    errors = degree_errors(value, growth, largest, other)
    records = checked_records(records, equation_residuals(scaled, value), errors, gamma, growth)
    # monomial coefficients in the plant's own units, from tensor entries in scaled ones, and P
    n, powers = len(plant.state_names), monomials(1.0 / scaling.state[None, :], value)
    parts = {
        k: (entries * basis.multiplicity(n, k) * powers[k][0] * scaling.value**2).astype(float)
        for k, entries in value.items()
    }
    half = np.zeros((n, n))
    half[np.triu_indices(n)] = parts[2]
    return HJISolution(gamma, degree, half + half.T, plant, problem, parts, records, condition, memory)


def _solve(
    plant: PolynomialPlant,
    linear: LinearPart,
    gamma: float,
    degree: int,
    advance: Callable[[int], None],
    stretch: np.ndarray | None = None,
) -> tuple[Scaling, ScaledProblem, PartsByDegree, tuple[DegreeRecord, ...], float, float, float] | None:
    """One pass of the algorithm; None where no P was found.

    Returns the scaling, the problem in scaled states and V there (tensor entries), the records, the condition number of
    the closed loop's eigenvectors in the states the recursion ran in, and of P in scaled states the growth
    ‖dP/d log γ‖/‖P‖ and the largest eigenvalue.
    """
    begin = perf_counter()
    if (parts := linear.solved(gamma)) is None:
        return None
    scaling, balanced, riccati = parts
    eigenvalues, directions = np.linalg.eigh(riccati.p)
    largest, riccati = float(eigenvalues[-1]), polish(*balanced.riccati_terms(gamma), riccati.p) or riccati
    growth = _growth(balanced, riccati, gamma)
    limit = _LARGE_P[basis.count(len(eigenvalues), degree) > _SMALL]
    states = None
    if stretch is not None or riccati.form is None or largest > limit or growth > _LARGE_GROWTH:
        states = BoundedStates.of(eigenvalues, directions, stretch)
        balanced = balanced.in_states(states.to_x, states.to_y)
        riccati = polish(*balanced.riccati_terms(gamma), states.to_x.T @ riccati.p @ states.to_x)
        if riccati is None:
            return None
        growth = _growth(balanced, riccati, gamma, states)
    seconds = perf_counter() - begin
    problem = ScaledProblem.of(plant, gamma, degree, scaling)
    inner = problem if states is None or degree == 2 else states.problem(problem)
    value, records, condition = solve_degrees(inner, riccati, seconds, advance)
    value = value if states is None else states.value(value)
    return scaling, problem, value, records, condition, growth, largest


def _growth(
    balanced: LinearPart, riccati: RiccatiSolution, gamma: float, states: BoundedStates | None = None
) -> float:
    b1 = balanced.b1.astype(float) / gamma
    change, p = sensitivity(riccati, -2 * b1 @ b1.T), riccati.p.astype(float)
    if states is not None:
        back = states.to_y.astype(float)
        change, p = back.T @ change @ back, back.T @ p @ back
    size = float(np.linalg.norm(p))
    return float(np.linalg.norm(change)) / size if size > 0 else 0.0


def _nearby(
    plant: PolynomialPlant, gamma: float, degree: int, scaling: Scaling, value: PartsByDegree
) -> PartsByDegree:
    """V, in the same scaled states, of the problem with every number moved in its last bit."""
    rng = np.random.default_rng(0)
    stretch = rng.uniform(0.7, 1.4, len(plant.state_names))
    plant, gamma = moved(plant, rng), float(np.nextafter(gamma, np.inf))
    solved = _solve(plant, LinearPart.of(plant), gamma, degree, lambda done: None, stretch)
    if solved is None:
        return {k: np.full(part.shape, np.inf) for k, part in value.items()}
    own, _, other, *_ = solved
    d, s = scaling.state / own.state, own.value / scaling.value
    powers = monomials(d[None, :], other)
    return {k: part * powers[k][0] * s**2 for k, part in other.items()}


def linear_law(problem: Problem, gamma: float) -> HJISolution:
    """The linear H∞ law: `solve_hji` at degree 2.

    Examples
    --------
    >>> import flexhinf as fh
    >>> problem = fh.paper_arm().problem()
    >>> fh.linear_law(problem, gamma=2 * fh.smallest_gamma(problem)).gain.shape
    (1, 5)
    """
    return solve_hji(problem, gamma, 2)
