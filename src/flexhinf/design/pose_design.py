"""A design of one pose: a law about it, its runs, and what is proved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from flexhinf.analysis import LinearLoop, Margins, modes
from flexhinf.arrays import Numbers
from flexhinf.certify import Certificate
from flexhinf.design import certification, checks, responses
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.problem import presets
from flexhinf.design.requirements import Requirement
from flexhinf.design.result import Design
from flexhinf.design.rigid import RigidComparison
from flexhinf.design.specification import Specification
from flexhinf.design.status import Status, in_brackets
from flexhinf.design.synthesis import by_step, steps
from flexhinf.errors import refuse_if
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller, Trajectory
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot
from flexhinf.validation import value_text


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PoseDesign(Design):
    """A synthesised law for a robot and a specification, its evaluation in the loop, and the judgement of both.

    Examples
    --------
    >>> import flexhinf as fh
    >>> quick = dict(degrees="2", draws=0, rays=0, proof_seconds=0, compare_rigid=False)
    >>> wanted = fh.Specification(pose="10deg", start="0", estimator="none", **quick)
    >>> found = fh.design(fh.load_robot("paper"), wanted)
    >>> found.margins().stable, bool(found.poles().real.max() < 0.0)
    (True, True)
    >>> step, figure = found.step(), found.bode()
    """

    robot: Robot
    specification: Specification
    synthesis: steps.Synthesis  # Weights, problem, solutions of several degrees, and the law
    evaluation: LawEvaluation  # The law in its loop
    # The worst disturbance found, and the dissipation budget of the step
    attenuation: certification.Attenuation
    # Whether the step starts inside the sampled region of the solution; None if no region was sampled
    inside: bool | None
    proof: certification.DesignProof  # Proof of the law that is used, and of the step
    mujoco: responses.Response | None  # The step on MuJoCo's plant, if requested
    rigid: RigidComparison | None  # The rigid design on the same robot, fed the true state
    # The long run at rest with dry friction; None for a robot that states none
    limit_cycle: checks.LimitCycleCheck | None
    # The runs with payloads at the ends of their ranges; none for a robot without such a range
    payloads: tuple[checks.PayloadEvaluation, ...] = ()
    law_modes: tuple[modes.Mode, ...]  # Of the law alone: continuous, with the true state fed back
    requirements: tuple[Requirement, ...]
    status: Status

    @property
    def step_proof(self) -> certification.StepProof:
        """Whether the requested step is proved."""
        return certification.step_proof(self.proof, self.chosen, self.inside)

    def summary(self) -> dict[str, str]:
        """Robot, whether the requirements are met, degree and level, and the step in numbers."""
        step = self.evaluation.step
        unit = self.setup.model.unit(self.setup.model.inputs[0])
        of = partial(in_brackets, self.setup.joints)
        settling = f"{step.settling.value:.3g} s" if np.isfinite(step.settling.value) else "not settled"
        return {
            "robot": self.robot.name,
            "requirements": self.judgement,
            "degree of V": str(self.chosen.degree),
            "γ": f"{self.gamma:.4g}",
            "settling": f"{settling}{of(step.settling.joint)}",
            "peak input": f"{step.peak_input:.3g} {unit}{of(step.peak.joint)}",
        }

    @property
    def setup(self) -> LoopSetup:
        """The loop of all runs."""
        return self.evaluation.setup

    @property
    def scenario(self) -> responses.Scenario:
        """The runs."""
        return self.evaluation.runs

    @property
    def goal(self) -> np.ndarray:
        """Link positions (n,), rad or m."""
        return self.synthesis.goal

    @property
    def start(self) -> np.ndarray:
        """Link positions (n,), rad or m."""
        return self.synthesis.start

    @property
    def design_problem(self) -> presets.DesignProblem:
        """With its sources."""
        return self.synthesis.design_problem

    @property
    def problem(self) -> GeneralisedPlant:
        """The nominal problem about the goal."""
        return self.synthesis.problem

    @property
    def choices(self) -> tuple[by_step.DegreeChoice, ...]:
        """Every solved degree."""
        return self.synthesis.choices

    @property
    def chosen(self) -> by_step.DegreeChoice:
        """The degree that is used."""
        return self.synthesis.chosen

    @property
    def solution(self) -> HJISolution:
        """The solution that is used, at the goal."""
        return self.synthesis.chosen.solution

    @property
    def gamma_star(self) -> float:
        """Smallest; of robust with channels."""
        return self.synthesis.design_problem.gamma_star

    @property
    def gamma(self) -> float:
        """Level of the solution."""
        return self.synthesis.chosen.solution.gamma

    def linear(self, at: Numbers = None) -> LinearLoop:
        """The running loop at the goal, linearised; an InvalidInput for another pose."""
        self._refuse_elsewhere("A design of one pose has one linear loop, at its goal.", at, self.goal)
        return self.evaluation.loop.linear()

    def _refuse_elsewhere(self, what: str, at: Any, known: np.ndarray) -> None:
        refuse_if(
            at is not None and not np.array_equal(np.atleast_1d(at), known),
            what,
            f"expected no pose, or {np.round(known, 6).tolist()}, got {value_text(at, 80)}",
            "Specification(workspace='limits') for a design of all poses",
        )

    def margins(self, at: Numbers = None) -> Margins:
        """Margins of the running loop at the goal, computed once."""
        return super().margins(at) if at is not None else self.evaluation.margins

    def step(self) -> Trajectory:
        """The run of the step from start to goal that is judged."""
        return self.evaluation.step.run

    def move(self, goal: Numbers = None, start: Numbers = None) -> Trajectory:
        """The run of the planned move with feedforward that is judged, from `start` to `goal`; an InvalidInput for
        others."""
        for pose, known in ((goal, self.goal), (start, self.start)):
            self._refuse_elsewhere(
                "A design of one pose has one move, from its start to its goal.", pose, known
            )
        return self.evaluation.move.response.run

    def certificate(self) -> Certificate:
        """The region that is proved for the law, with its gain: of the true state fed back, without a limit of time.

        Raises `InvalidInput` for several joints, and where nothing is proved.
        """
        laws = certification.certify_design(
            self.robot, self.specification, lambda text: None, lambda cells, share: None
        )
        found = certification.proved(laws, None, laws[0].box is not None).certificate
        assert found is not None
        return found

    def controller(self, at: np.ndarray | None = None) -> Controller:
        """A new controller as it is deployed and judged: it takes over without a jump of the input, and follows
        positions; of a design for a move, or for a shaped step with feedforward, states and inputs (`Moving`).

        `at`: (n,), Pose at which it takes over; by default the start of move or step.
        """
        start = self.start if self.setup.specification.move is None else self.evaluation.runs.plan(0.0)
        pose = np.atleast_1d(start if at is None else at).astype(float).ravel()
        return self.setup.controller(pose, moving=self.setup.moves, supervised=True)
