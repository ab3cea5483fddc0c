"""What a design of one pose was judged by: its law, its runs, what is proved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from flexhinf.analysis import modes
from flexhinf.designs import certification, checks, responses
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.judged import Judged
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.motions import Jump
from flexhinf.designs.pose_loop import LoopAtPose
from flexhinf.designs.problem import presets
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.specification import Specification
from flexhinf.designs.status import StatusEntries, in_brackets
from flexhinf.designs.synthesis import by_step, steps
from flexhinf.designs.workspace.rivals import Gains
from flexhinf.hinf import HJISolution
from flexhinf.notebook import Summarised
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PoseEvidence(Judged, Summarised):
    """A synthesised law for a robot and a specification, and its evaluation in the loop."""

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
    # The long run at rest with dry friction; None for a robot that states none
    limit_cycle: checks.LimitCycleCheck | None
    # The runs with payloads at the ends of their ranges; none for a robot without such a range
    payloads: tuple[checks.PayloadEvaluation, ...] = ()
    law_modes: tuple[modes.Mode, ...]  # Of the law alone: continuous, with the true state fed back
    requirements: tuple[Requirement, ...]
    status: StatusEntries

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
    def loop(self) -> LoopAtPose:
        """What the law does at its pose."""
        length = self.scenario.step_duration
        return LoopAtPose(self.robot, self.specification, self.setup, length, lambda: self.evaluation)

    @property
    def scenario(self) -> responses.Scenario:
        """The runs."""
        return self.evaluation.runs

    @property
    def moves(self) -> tuple[responses.Move, ...]:
        """The motion of the nominal robot that is asked for: the stated move, or the step."""
        e = self.evaluation
        jump = responses.Move.along(self.setup.command or Jump(self.goal), e.step, self.setup.limits)
        return (jump if self.setup.stated_move is None else e.move,)

    @property
    def sampled(self) -> tuple[responses.Move, ...]:
        """None: of sampled robots numbers alone are kept."""
        return ()

    @property
    def bandwidth(self) -> float | None:
        """For which the weights were searched, the largest of all joints, rad/s; None of weights without one."""
        target = self.design_problem.target
        return None if target is None else float(np.max(target.bandwidth))

    @property
    def numbers(self) -> Gains:
        """Of which the law is made: γ over γ*, and the degree of V."""
        return {"gamma_ratio": (self.gamma / self.gamma_star,), "degree": (float(self.chosen.degree),)}

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
