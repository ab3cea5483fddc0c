"""The degree of V: several are solved, the region of each is sampled, and time and residuals are measured."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from flexhinf.design.specification import Specification
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.plant import GeneralisedPlant

__all__ = ["DegreeChoice", "rays_of", "shrinking", "tried_degrees", "try_degrees"]

#: Up to so many states, so many rays; no region is sampled beyond.
RAYS = ((10, 500), (20, 200))


@dataclass(frozen=True)
class DegreeChoice:
    """What a degree gives.

    Attributes
    ----------
    degree : int
        Of V; the law has one less.
    solution : HJISolution
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
    problem : GeneralisedPlant
        About the goal pose: a step to the goal starts at a deviation from it.
    degrees : sequence of int
    gamma_ratio, checked_gamma_ratio : float
        γ/γ* of the design, and of the inequality that is checked. The checked one must be weaker, see
        `HJISolution.sampled_region`.
    checked_penalty : optional
        Penalty of the inequality that is checked; 0.9 times the designed one by default.
    rays, seed : int
        Of the sampled check; without rays no region is sampled.
    progress : callable
        Called with what comes next, twice per degree.
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
    for degree in degrees:
        progress(f"degree {degree}: solve")
        start = time.perf_counter()
        solution = solve_hji(problem, gamma=gamma_ratio * gamma_star, degree=degree)
        solved = time.perf_counter()
        residual = max((record.residual for record in solution.records), default=float("nan"))
        if not rays:
            nothing = float("nan")
            yield DegreeChoice(
                degree, solution, nothing, nothing, "not sampled", residual, solved - start, 0.0, False
            )
            continue
        progress(f"degree {degree}: sample the region")
        check = solution.sampled_region(
            gamma=checked_gamma_ratio * gamma_star,
            penalty=checked_penalty,  # type: ignore[arg-type]
            rays=rays,
            seed=seed,
        )
        if check is None:
            margin = solution.checked_margin(checked_gamma_ratio * gamma_star, checked_penalty)  # type: ignore[arg-type]
            level = amplitude = float("nan")
            limit = f"no region: {margin.reason()}"
        else:
            level, amplitude, limit = check.level, check.step_amplitude(), check.limit
        yield DegreeChoice(
            degree, solution, level, amplitude, limit, residual, solved - start, time.perf_counter() - solved
        )


def shrinking(choices: Sequence[DegreeChoice]) -> list[tuple[int, int]]:
    """Pairs (lower, higher) of neighbouring degrees where the higher one allows a smaller step."""
    ordered = sorted(choices, key=lambda choice: choice.degree)
    return [(a.degree, b.degree) for a, b in pairwise(ordered) if b.step_amplitude < a.step_amplitude]


def tried_degrees(states: int, s: Specification) -> tuple[int, ...]:
    """Degrees of V that are solved: as stated, or fewer for more states."""
    return tuple(s.degrees) if s.degrees is not None else ((2, 4, 6) if states <= 10 else (2, 4))


def rays_of(states: int, s: Specification) -> int:
    """Rays in which a region is sampled: as stated, or fewer for more states."""
    return next((count for most, count in RAYS if states <= most), 0) if s.rays is None else s.rays
