"""Which degree a design uses: the lowest one whose step no higher one makes clearly cheaper.

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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexhinf.design.degrees import DegreeChoice
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.modes import closed_loop
from flexhinf.design.monte_carlo import sampled_runs
from flexhinf.design.requirements import sample_requirements, step_requirements
from flexhinf.design.responses import Response
from flexhinf.design.scenario import run_length, sample_robots
from flexhinf.plant import GeneralisedPlant

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
    """The degree that is used, and all of them by rising degree, with what their steps cost.

    Parameters
    ----------
    setup : LoopSetup
        The loop of the design, whatever its law.
    problem : GeneralisedPlant
        The nominal problem about the goal, whose penalty is the cost.
    """
    lowest, *higher = sorted(choices, key=lambda choice: choice.degree)
    if (
        not higher or setup.specification.via
    ):  # with laws at several poses the robot is never far from the nearest one
        return lowest, (lowest, *higher)
    first = _Trial.of(setup, problem, lowest)
    higher = [replace(choice, acting=first.acting(choice)) for choice in higher]
    if all(choice.acting < ACTING for choice in higher):
        return first.choice, (first.choice, *higher)
    used, judged = first, [first.choice]
    for choice in higher:
        trial = _Trial.of(setup, problem, choice, first.length)
        if trial.choice.cost < (1.0 - GAIN) * used.choice.cost:
            trial = replace(
                trial, choice=replace(trial.choice, missed=tuple(sorted(trial.missed - used.missed)))
            )
            used = used if trial.choice.missed else trial
        judged.append(trial.choice)
    return used.choice, tuple(judged)


def step_cost(
    problem: GeneralisedPlant, response: Response, at: tuple[np.ndarray, np.ndarray] | None = None
) -> float:
    """∫|z|² dt of a run, z of deviations from an equilibrium, without what weights the integrals of the error.

    Each law chooses its own integrals at the start of a step, such that the input does not jump. They are no part of
    what the robot does, and count as zero.

    Parameters
    ----------
    problem : GeneralisedPlant
        Its penalty and R2.
    at : (x, u), optional
        State (as the run has it) and input of the equilibrium; the problem's by default.

    Returns
    -------
    float
        Infinite where the run diverged.
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
    """The step of one degree."""

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
        setup = replace(setup, law=choice.solution, law_at_goal=None)
        length = setup.specification.duration if length is None else length
        if length is None:
            rates = np.linalg.eigvals(closed_loop(problem, choice.solution.gain)).real
            length = run_length(float(-rates.max())) + setup.command_time
        step = setup.step(length)
        return _Trial(replace(choice, cost=step_cost(problem, step)), setup, problem, step, length)

    def acting(self, other: DegreeChoice) -> float:
        """How much the law of another degree would change the input along this step, over the largest input of this
        law there; both are deviations from the goal's, weighted by R2."""
        moved, r2 = self._deviations, self.problem.r2
        if self.step.diverged_at is not None:
            return float("inf")
        own = self.choice.solution.inputs(moved)
        with np.errstate(all="ignore"):
            more = other.solution.inputs(moved) - own
        sizes = [float(np.einsum("ki,ij,kj->k", u, r2, u).max()) for u in (more, own)]
        return float(np.sqrt(sizes[0] / sizes[1])) if sizes[1] > 0.0 else 0.0

    @cached_property
    def _deviations(self) -> np.ndarray:
        """From the goal's equilibrium, with the integrals of the error, (N, n)."""
        run, law, setup = self.step.run, self.choice.solution, self.setup
        period, few = (
            setup.specification.period,
            slice(None, None, max(1, len(self.step.run.time) // INSTANTS)),
        )
        wanted = (
            setup.goal if setup.command is None else np.reshape(setup.command(run.time), (len(run.time), -1))
        )
        grown = period * np.cumsum(self.step.positions - wanted, axis=0)
        columns = [run.names["state"].index(name) for name in self.problem.plant.states]
        moved = run.signals["state"][:, columns] - law.operating_point[: len(columns)]
        return np.hstack([moved, setup.departure(law)[len(columns) :] + grown])[few]

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
