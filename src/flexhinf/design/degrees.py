"""The degree of V: several are solved, regions are sampled, and time and residuals are measured.

Which one a design uses is decided in `flexhinf.design.degree_rule`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from flexhinf.design.specification import Specification
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.plant import GeneralisedPlant

#: Up to so many states, so many rays; no region is sampled beyond.
RAYS = ((10, 500), (20, 200))


@dataclass(frozen=True)
class DegreeChoice:
    """What a degree gives.

    Attributes
    ----------
    degree : int
        Of V; the law has one less.
    level : float
        Largest level set {V ≤ level} on which nothing against the dissipation inequality was found (sampled); nan where
        there is no region, or none was looked for.
    step_amplitude : float
        Largest step between equilibria whose start lies in it, in the unit of the tracked states; nan likewise.
    limit : str
        What bounds the level set, or why there is none.
    residual : float
        Largest relative residual of Eq. (8) in any degree, as measured.
    solve_seconds, check_seconds : float
        Wall time.
    looked : bool
        Whether the region was sampled; level and step are nan otherwise.
    acting : float
        How much this law would change the input along the step of the lowest degree, over its largest value there (both
        deviations from the goal's); nan where that was not asked, see `flexhinf.design.degree_rule`.
    cost : float
        ∫|z|² of the step without the integrals; infinite if it diverges, nan if it was not run.
    missed : tuple of str
        Requirements of the step that a lower degree keeps and this one does not; only of a cheaper step.
    """

    degree: int
    solution: HJISolution
    level: float
    step_amplitude: float
    limit: str
    residual: float
    solve_seconds: float
    check_seconds: float
    looked: bool = True
    acting: float = float("nan")
    cost: float = float("nan")
    missed: tuple[str, ...] = ()


def tried_degrees(states: int, s: Specification) -> tuple[int, ...]:
    """Degrees of V that are solved: as stated, or fewer for more states."""
    return tuple(s.degrees) if s.degrees is not None else ((2, 4, 6) if states <= 10 else (2, 4))


def rays_of(states: int, s: Specification) -> int:
    """Rays in which a region is sampled: as stated, or fewer for more states."""
    return next((count for most, count in RAYS if states <= most), 0) if s.rays is None else s.rays


def synthesis_stages(states: int, s: Specification) -> int:
    """How many steps of work the degrees are, for a progress bar: solutions, the choice, and sampled regions."""
    count = len(tried_degrees(states, s))
    regions = (count if s.degrees is not None else 1) if rays_of(states, s) else 0
    return count + (count > 1) + regions


# Solutions and regions -----------------------------------------------------------------------------------
def solve_degrees(
    problem: GeneralisedPlant,
    degrees: Sequence[int],
    gamma: float,
    progress: Callable[[str], None] = lambda text: None,
) -> Iterator[DegreeChoice]:
    """Solve to each degree; no region is sampled.

    Parameters
    ----------
    problem : GeneralisedPlant
        About the goal pose: a step to the goal starts at a deviation from it.
    progress : callable
        Called with what comes next, once per degree.

    Raises
    ------
    InfeasibleGamma, InvalidInput
        As `solve_hji`.
    """
    nothing = float("nan")
    for degree in degrees:
        progress(f"degree {degree}: solve")
        start = time.perf_counter()
        solution = solve_hji(problem, gamma=gamma, degree=degree)
        seconds = time.perf_counter() - start
        residual = max((record.residual for record in solution.records), default=nothing)
        yield DegreeChoice(
            degree, solution, nothing, nothing, "not sampled", residual, seconds, 0.0, looked=False
        )


def with_region(
    choice: DegreeChoice, gamma: float, penalty: object = None, rays: int = 500, seed: int = 0
) -> DegreeChoice:
    """The same with its region sampled.

    Parameters
    ----------
    gamma : float
        Of the inequality that is checked; it must be weaker than the designed one, see `HJISolution.sampled_region`.
    penalty : optional
        Of the inequality that is checked; 0.9 times the designed one by default.

    Raises
    ------
    InvalidInput
        As `HJISolution.sampled_region`.
    """
    start, solution = time.perf_counter(), choice.solution
    check = solution.sampled_region(gamma=gamma, penalty=penalty, rays=rays, seed=seed)  # type: ignore[arg-type]
    if check is None:
        margin = solution.checked_margin(gamma, penalty)  # type: ignore[arg-type]
        level = amplitude = float("nan")
        limit = f"no region: {margin.reason()}"
    else:
        level, amplitude, limit = check.level, check.step_amplitude(), check.limit
    return replace(
        choice, level=level, step_amplitude=amplitude, limit=limit, check_seconds=time.perf_counter() - start,
        looked=True,
    )  # fmt: skip


def try_degrees(
    problem: GeneralisedPlant,
    degrees: Sequence[int],
    gamma_ratio: float = 1.5,
    checked_gamma_ratio: float = 1.6,
    checked_penalty: object = None,
    rays: int = 500,
    seed: int = 0,
    progress: Callable[[str], None] = lambda text: None,
    gamma_star: float | None = None,
) -> Iterator[DegreeChoice]:
    """Solve to each degree and sample the region where the solution holds.

    Parameters
    ----------
    problem, degrees, progress
        As of `solve_degrees`.
    gamma_ratio, checked_gamma_ratio : float
        γ/γ* of the design, and of the inequality that is checked.
    checked_penalty, rays, seed
        As of `with_region`; without rays no region is sampled.
    gamma_star : float, optional
        Of which the ratios are, where it is not the problem's own: that of a robust problem, for all robots within the
        tolerances.

    Yields
    ------
    DegreeChoice

    Raises
    ------
    InfeasibleGamma, InvalidInput
        As `solve_hji` and `HJISolution.sampled_region`.
    """
    gamma_star = smallest_gamma(problem) if gamma_star is None else gamma_star
    for choice in solve_degrees(problem, degrees, gamma_ratio * gamma_star, progress):
        if rays:
            progress(f"degree {choice.degree}: sample the region")
            choice = with_region(choice, checked_gamma_ratio * gamma_star, checked_penalty, rays, seed)
        yield choice


def shrinking(choices: Sequence[DegreeChoice]) -> list[tuple[int, int]]:
    """Pairs (lower, higher) of neighbouring degrees where the higher one allows a smaller step."""
    ordered = sorted(choices, key=lambda choice: choice.degree)
    return [(a.degree, b.degree) for a, b in pairwise(ordered) if b.step_amplitude < a.step_amplitude]
