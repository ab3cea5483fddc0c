"""What the page shows of a design, in three stages: the nominal step, the band of sampled robots, the linear law and
loop.

Every number comes from the function that `flexhinf design` takes it from, so a saved design gives the same ones there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexhinf.analysis import FrequencyResponse
from flexhinf.designs import about_pose, checks, responses
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.judge import margin_requirements, oscillation_requirements, sample_requirements
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.monte_carlo import MonteCarlo, sampled_runs
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.responses import Response
from flexhinf.designs.specification import Specification
from flexhinf.designs.synthesis.steps import Synthesis, synthesise
from flexhinf.hinf import HJISolution, solve_hji
from flexhinf.loop import Controller
from flexhinf.robot import Robot

#: Largest number of samples of all robots of a band together: a quarter of a minute of the paper's arm on one core. A
#: band that would have more has fewer robots than the specification states.
MOST_SAMPLES = 20_000_000


@dataclass(frozen=True, eq=False)
class Nominal:
    """The law and its step on the nominal robot."""

    synthesis: Synthesis
    setup: LoopSetup
    limit_cycle: checks.LimitCycleCheck | None
    duration: float  # of the step, s
    step: Response
    seconds: float  # wall time of this stage, s

    @property
    def robot(self) -> Robot:
        """The nominal robot with its tolerances."""
        return self.setup.robot

    @cached_property
    def evaluation(self) -> LawEvaluation:
        """The law in its linear loop."""
        return LawEvaluation(self.setup)

    @cached_property
    def deviations(self) -> Mapping[str, float]:
        """Standard deviation of the estimate of each state, by name; empty with the true state fed back.

        That of the filter at rest at the goal, with which every run begins: P of its stationary Riccati equation,
        corrected by a measurement, P − P Cᵀ (C P Cᵀ + R^n)⁻¹ C P.
        """
        estimator = self.setup.estimator(self.setup.goal)
        covariance: np.ndarray | None = getattr(estimator, "covariance", None)
        if covariance is None:
            return {}
        c = self.setup.model.linearise(*self.setup.goal_equilibrium)[3]
        innovation = c @ covariance @ c.T + np.diag(self.setup.noise_variances)
        corrected = covariance - covariance @ c.T @ np.linalg.solve(innovation, c @ covariance)
        names = self.setup.model.states
        return dict(zip(names, np.sqrt(np.maximum(np.diag(corrected), 0.0)).tolist()))

    @cached_property
    def requirements(self) -> list[Requirement]:
        """Requirements on the step, as `flexhinf design` judges them."""
        return about_pose.step_requirements(
            self.setup,
            self.step,
            about_pose.STEP,
            lambda length: self.setup.step(length, sub_steps=_sub_steps(self.step)),
            remaining=self.limit_cycle and self.limit_cycle.remaining,
        )

    def controller(self) -> Controller:
        """A new controller as it is deployed, as `Design.controller`."""
        return self.setup.controller(self.setup.start, supervised=True)


@dataclass(frozen=True, eq=False)
class Band:
    """The step of robots within their tolerances."""

    nominal: Nominal
    samples: MonteCarlo | None  # None for a robot without tolerances, or without sampled robots
    stated: int  # robots that the specification states; more than there are where they would take too long
    seconds: float

    @property
    def requirements(self) -> list[Requirement]:
        """Requirements on the worst of the sampled robots; none without any."""
        setup = self.nominal.setup
        if self.samples is None:
            return []
        return sample_requirements(setup.specification, setup.limits, self.samples)

    def run(self, k: int) -> Response:
        """The step of robot k with all signals: bit by bit the run of the band."""
        assert self.samples is not None
        values = self.samples.values[k]
        return self.nominal.setup.step(
            self.nominal.duration, values=values, seed=1 + k, sub_steps=_sub_steps(self.nominal.step)
        )

    def nearest(self, joint: int, at: float, position: float) -> int:
        """The robot whose link of a joint is nearest to a position, rad or m, at a time, s."""
        assert self.samples is not None
        instant = int(np.argmin(np.abs(self.samples.time - at)))
        distance = np.abs(self.samples.positions[:, instant, joint] - position)
        return int(np.argmin(np.where(np.isnan(distance), np.inf, distance)))


@dataclass(frozen=True, eq=False)
class LinearParts:
    """The step with the linear law, and the linear loop at the goal: margins, frequency response and modes."""

    nominal: Nominal
    step: Response | None  # with the law of degree 2; None where the law has degree 2, or there are several
    failure: str  # why the loop has no equilibrium; empty where it has one
    response: FrequencyResponse | None
    seconds: float

    @property
    def requirements(self) -> list[Requirement]:
        """Requirements on the margins and on the damping of the running loop."""
        if self.failure:
            return []
        setup, margins = self.nominal.setup, self.nominal.evaluation.margins
        s = setup.specification
        return [*margin_requirements(s, margins, setup.joints), *oscillation_requirements(s, margins)]


PreviewStage = Nominal | Band | LinearParts


def stages(
    robot: Robot, s: Specification, check: Callable[..., None] = lambda *_: None
) -> Iterator[Nominal | Band | LinearParts]:
    """The parts of a preview, each when it is ready; `check` is called between steps of the work, and may raise.

    Raises as `flexhinf.design`, for a specification that cannot be met or used.
    """
    begun = time.perf_counter()
    # regions and proofs are made by `flexhinf design`; the law does not depend on them
    nominal = _nominal(robot, replace(s, rays=0), check, begun)
    yield nominal
    begun = time.perf_counter()
    yield _band(nominal, begun)
    yield _linear(nominal, check)


def _nominal(robot: Robot, s: Specification, check: Callable[..., None], begun: float) -> Nominal:
    synthesis = synthesise(robot, s, check)
    check()
    setup, limit_cycle = checks.end_limit_cycle(synthesis.setup(robot, s))
    duration = about_pose.step_duration(LawEvaluation(setup), synthesis)
    step = setup.step(duration)
    return Nominal(synthesis, setup, limit_cycle, duration, step, time.perf_counter() - begun)


def _band(nominal: Nominal, begun: float) -> Band:
    setup, s = nominal.setup, nominal.setup.specification
    stated = responses.sample_count(setup.robot, len(nominal.synthesis.problem.state_names), s.draws)
    count = min(stated, max(1, int(MOST_SAMPLES * s.period / nominal.duration)))
    samples = None
    if count:
        robots = responses.sample_robots(setup.true.robot, count, s.seed)
        samples = sampled_runs(setup, robots, nominal.duration, _sub_steps(nominal.step))
    return Band(nominal, samples, stated, time.perf_counter() - begun)


def _linear(nominal: Nominal, check: Callable[..., None]) -> LinearParts:
    begun, evaluation = time.perf_counter(), nominal.evaluation
    setup, synthesis, step, response = nominal.setup, nominal.synthesis, None, None
    if isinstance(setup.law, HJISolution) and synthesis.chosen.degree > 2:
        problem = synthesis.design_problem
        law = solve_hji(problem.problem, problem.gamma, 2)
        step = replace(setup, law=law).step(nominal.duration, sub_steps=_sub_steps(nominal.step))
        check()
    failure = evaluation.linear_failure
    if not failure:
        check()
        response = evaluation.frequency_response
        evaluation.compute_modes()
    return LinearParts(nominal, step, failure, response, time.perf_counter() - begun)


def _sub_steps(step: Response) -> int:
    return int(step.run.settings["sub_steps"])
