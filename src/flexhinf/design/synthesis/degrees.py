"""The degree of V: several are solved; a design uses the lowest one whose step no higher one makes clearly cheaper.

All degrees of a problem have the same linear part, and so the same bandwidth, margins and noise at the motors. They
differ in a step that is so long that the plant is another one at its start. So the step of the design itself decides,
as it is deployed:

1. It is run with the lowest degree. If the higher terms of the law would hardly change the input along it, the lowest
   degree is used.
2. Otherwise it is run with each degree. A higher one takes the place of a lower one if its step costs less, and keeps
   the limits of the specification that the lower one keeps, also on a few robots within their tolerances.

The study behind it is `benchmarks/degrees.py`; docs/degrees.md shows what it found.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.problem.modes import closed_loop
from flexhinf.design.requirements import sample_requirements, sampled_runs, step_requirements
from flexhinf.design.responses import Response, run_length, sample_robots
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.plant import GeneralisedPlant

#: Up to so many states, so many rays; no region is sampled beyond.
RAYS = ((10, 500), (20, 200))


@dataclass(frozen=True)
class DegreeChoice:
    """A degree of V with its solution, its sampled region and the cost of its step; nan and inf as each field says.

    The region is the largest level set {V ≤ level} on which nothing against the dissipation inequality was found.
    """

    degree: int  # of V; the law has one less
    solution: HJISolution
    residual: float  # largest relative residual of Eq. (8) in any degree, as measured
    solve_seconds: float  # wall time, s
    check_seconds: float = 0.0  # wall time, s
    level: float = math.nan  # of the region; nan where there is none, or none was looked for
    step_amplitude: float = math.nan  # largest step that starts in the region, unit of the states
    limit: str = "not sampled"  # what bounds the level set, or why there is none
    looked: bool = False  # whether the region was sampled
    acting: float = math.nan  # change of the input along the step of the lowest degree, see `_Trial.acting`
    cost: float = math.nan  # ∫|z|² of the step; inf if it diverges, nan if it was not run
    missed: tuple[
        str, ...
    ] = ()  # requirements that the costlier step of a lower degree meets, and this one misses


def tried_degrees(states: int, stated: Sequence[int] | None) -> tuple[int, ...]:
    """Degrees of V that are solved: as stated, or fewer for more states."""
    return tuple(stated) if stated is not None else ((2, 4, 6) if states <= 10 else (2, 4))


def rays_of(states: int, stated: int | None) -> int:
    """Rays in which a region is sampled: as stated, or fewer for more states."""
    return next((count for most, count in RAYS if states <= most), 0) if stated is None else stated


def synthesis_stages(states: int, degrees: Sequence[int] | None, rays: int | None) -> int:
    """How many steps of work the degrees are, for a progress bar: solutions, the choice, and sampled regions."""
    count = len(tried_degrees(states, degrees))
    regions = (count if degrees is not None else 1) if rays_of(states, rays) else 0
    return count + (count > 1) + regions


# Solutions and regions -----------------------------------------------------------------------------------
def solve_degrees(
    problem: GeneralisedPlant,
    degrees: Sequence[int],
    gamma: float,
    progress: Callable[[str], None] = lambda text: None,
) -> Iterator[DegreeChoice]:
    """Solve the problem about the goal to each degree; no region is sampled. Raises as `solve_hji`."""
    for degree in degrees:
        progress(f"degree {degree}: solve")
        start = time.perf_counter()
        solution = solve_hji(problem, gamma=gamma, degree=degree)
        seconds = time.perf_counter() - start
        residual = max((record.residual for record in solution.records), default=math.nan)
        yield DegreeChoice(degree, solution, residual, seconds)


def with_region(
    choice: DegreeChoice, gamma: float, penalty: object = None, rays: int = 500, seed: int = 0
) -> DegreeChoice:
    """The same with the region of this inequality sampled, see `HJISolution.sampled_region`."""
    start, solution = time.perf_counter(), choice.solution
    check = solution.sampled_region(gamma=gamma, penalty=penalty, rays=rays, seed=seed)  # type: ignore[arg-type]
    if check is None:
        reason = solution.checked_margin(gamma, penalty).reason()  # type: ignore[arg-type]
        choice = replace(choice, limit=f"no region: {reason}")
    else:
        choice = replace(choice, level=check.level, step_amplitude=check.step_amplitude(), limit=check.limit)
    return replace(choice, check_seconds=time.perf_counter() - start, looked=True)


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
    """Solve to each degree and sample the region where the solution holds; without rays no region is sampled.

    Parameters
    ----------
    gamma_ratio, checked_gamma_ratio : float
        γ/γ* of the design, and of the inequality that is checked.
    gamma_star : float, optional
        Of the ratios, by default the problem's own; of a robust problem that for all robots within the tolerances.

    Raises `InfeasibleGamma` or `InvalidInput` as `solve_hji` and `HJISolution.sampled_region`.
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


#: Higher terms of a law act where they change the input along the lowest degree's step by at least this fraction of its
#: largest value there. Below, no step of the study became cheaper by more than 3 %.
ACTING = 0.5

#: A higher degree has to make the step cheaper by more than this fraction. Wherever one does in the study, the step
#: settles earlier by 18 to 44 %; with 3 % there are steps among them that settle later.
GAIN = 0.05

#: Robots within their tolerances with which a higher degree must keep the limits that the lower one keeps.
SAMPLES = 12

#: Instants of a run at which its cost is summed.
INSTANTS = 2000


def choose_degree(
    setup: LoopSetup, problem: GeneralisedPlant, choices: Sequence[DegreeChoice]
) -> tuple[DegreeChoice, tuple[DegreeChoice, ...]]:
    """The degree that is used, and all of them by rising degree, with the costs of their steps.

    `setup` is the loop of the design, whatever its law; the penalty of `problem`, the nominal one, is the cost.
    """
    lowest, *higher = sorted(choices, key=lambda choice: choice.degree)
    if not higher or setup.specification.via:  # with several laws the robot is never far from a law's pose
        return lowest, (lowest, *higher)
    first = used = _Trial.of(setup, problem, lowest)
    higher = [replace(choice, acting=acting) for choice, acting in zip(higher, first.acting(higher))]
    if all(choice.acting < ACTING for choice in higher):
        return first.choice, (first.choice, *higher)
    judged = [first.choice]
    for choice in higher:
        trial = _Trial.of(setup, problem, choice, first.length)
        if trial.choice.cost < (1.0 - GAIN) * used.choice.cost:
            missed = tuple(sorted(trial.missed - used.missed))
            trial = replace(trial, choice=replace(trial.choice, missed=missed))
            used = used if missed else trial
        judged.append(trial.choice)
    return used.choice, tuple(judged)


def step_cost(
    problem: GeneralisedPlant, response: Response, at: tuple[np.ndarray, np.ndarray] | None = None
) -> float:
    """∫|z|² dt of a run, without what weights the integrals of the error; infinite where the run diverged.

    Each law chooses its own integrals at the start of a step, such that the input does not jump, so they count as zero.
    z is of deviations from the equilibrium `at`: state (as the run has it) and input, by default the problem's.
    """
    if response.diverged_at is not None:
        return float("inf")
    run, (end, held) = response.run, (problem.operating_point, problem.operating_input) if at is None else at
    few = slice(None, None, max(1, len(run.time) // INSTANTS))
    x, names = run.signals["state"][few], problem.plant.states
    moved = np.zeros((len(x), len(problem.state_names)))
    for column, name in enumerate(names):
        place = run.names["state"].index(name)
        moved[:, column] = x[:, place] - end[column if at is None else place]
    u, h = response.inputs[few] - held, problem.fields(moved)[3]
    square = np.einsum("ki,ki->k", h, h) + np.einsum("ki,ij,kj->k", u, problem.r2, u)
    return float(np.trapezoid(square, run.time[few]))


@dataclass(frozen=True, eq=False)
class _Trial:
    choice: DegreeChoice
    setup: LoopSetup
    problem: GeneralisedPlant
    step: Response
    length: float

    @staticmethod
    def of(
        setup: LoopSetup, problem: GeneralisedPlant, choice: DegreeChoice, length: float | None = None
    ) -> _Trial:
        """The step run with a degree, for `length` seconds; by default as stated, or by the slowest mode."""
        setup = replace(setup, law=choice.solution)
        length = setup.specification.duration if length is None else length
        if length is None:
            rates = np.linalg.eigvals(closed_loop(problem, choice.solution.gain)).real
            length = run_length(float(-rates.max())) + setup.command_time
        step = setup.step(length)
        return _Trial(replace(choice, cost=step_cost(problem, step)), setup, problem, step, length)

    def acting(self, others: Sequence[DegreeChoice]) -> list[float]:
        """How much the laws of other degrees would change the input along this step, over the largest input of this
        law there; both are deviations from the goal's, weighted by R2."""
        if self.step.diverged_at is not None:
            return [float("inf")] * len(others)
        run, law, setup, r2 = self.step.run, self.choice.solution, self.setup, self.problem.r2
        wanted = setup.goal
        if setup.command is not None:
            wanted = np.reshape(setup.command(run.time), (len(run.time), -1))
        grown = setup.specification.period * np.cumsum(self.step.positions - wanted, axis=0)
        columns = [run.names["state"].index(name) for name in self.problem.plant.states]
        moved = run.signals["state"][:, columns] - law.operating_point[: len(columns)]
        moved = np.hstack([moved, setup.departure(law)[len(columns) :] + grown])
        moved = moved[:: max(1, len(run.time) // INSTANTS)]
        own, ratios = law.inputs(moved), []
        for other in others:
            with np.errstate(all="ignore"):
                more = other.solution.inputs(moved) - own
            sizes = [float(np.einsum("ki,ij,kj->k", u, r2, u).max()) for u in (more, own)]
            ratios.append(float(np.sqrt(sizes[0] / sizes[1])) if sizes[1] > 0.0 else 0.0)
        return ratios

    @cached_property
    def missed(self) -> frozenset[str]:
        """Requirements of the step that are not met: by the nominal robot, or by a few within their tolerances."""
        s, limits, setup = self.setup.specification, self.setup.limits, self.setup
        if limits.saturated is not None and limits.limits_peak:
            setup = replace(setup, specification=replace(s, saturation=np.inf))
        step = self.step if setup is self.setup else setup.step(self.length)
        lines = step_requirements(s, limits, step, "the step")
        if setup.robot.uncertain and s.draws != 0:
            robots = sample_robots(setup.robot, SAMPLES, s.seed)
            taken = step.run.settings["sub_steps"]
            lines += sample_requirements(s, limits, sampled_runs(setup, robots, self.length, taken))
        return frozenset(line.what for line in lines if not line.met)
