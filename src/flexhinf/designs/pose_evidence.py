"""Evidence of a nonlinear H∞ law about one pose: its synthesis, its runs, what is proved."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np

from flexhinf.analysis import modes
from flexhinf.designs import certification, checks, judge, responses
from flexhinf.designs.about_pose import AboutPose, in_scenario, law_modes, step_duration
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.judge_loops import bandwidth_requirement
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.monte_carlo import MonteCarlo
from flexhinf.designs.pose_loop import LoopAtPose
from flexhinf.designs.problem import presets
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.specification import Specification
from flexhinf.designs.status import StatusEntries, in_brackets, status_of
from flexhinf.designs.synthesis import by_step, steps
from flexhinf.designs.workspace.design import judged_design
from flexhinf.designs.workspace.evidence import WorkspaceEvidence
from flexhinf.designs.workspace.rivals import Gains
from flexhinf.designs.workspace.samples import corner_moves
from flexhinf.hinf import HJISolution
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot, mujoco

#: The run that is judged beside those of every law.
MUJOCO = "the step on MuJoCo's plant"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PoseEvidence(WorkspaceEvidence):
    """A synthesised law for a robot and a specification, and its evaluation in the loop."""

    advisable: ClassVar[bool] = False

    setup: AboutPose
    synthesis: steps.Synthesis  # Weights, problem, solutions of several degrees, and the law
    # The worst disturbance found, and the dissipation budget of the step
    attenuation: certification.Attenuation
    # Whether the step starts inside the sampled region of the solution; None if no region was sampled
    inside: bool | None
    certified: certification.DesignProof  # Proof of the law that is used, and of the step
    mujoco: responses.Response | None  # The step on MuJoCo's plant, if requested
    # The runs with payloads at the ends of their ranges; none for a robot without such a range
    payloads: tuple[checks.PayloadEvaluation, ...] = ()
    law_modes: tuple[modes.Mode, ...]  # Of the law alone: continuous, with the true state fed back
    status: StatusEntries

    @property
    def step_proof(self) -> certification.StepProof:
        """Whether the requested step is proved."""
        return certification.step_proof(self.certified, self.chosen, self.inside)

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
    def evaluation(self) -> LawEvaluation:
        """The law in its loop."""
        return self.setup.evaluation

    @property
    def about(self) -> LoopSetup:
        """The loop of all runs."""
        return self.setup.about

    @property
    def limit_cycle(self) -> checks.LimitCycleCheck | None:
        """The long run at rest with dry friction; None for a robot that states none."""
        return self.setup.limit_cycle

    @cached_property
    def samples(self) -> MonteCarlo | None:
        """Numbers of the robots at corners of their tolerances; None without any."""
        ends = np.array([self.start, self.goal])
        values = [robot for _, robot, _ in corner_moves(self.setup, 0, [ends])]
        runs = [move.response for move in self.sampled]
        return MonteCarlo.of(values, runs[: len(values)]) if runs else None

    @property
    def loop(self) -> LoopAtPose:
        """What the law does at its pose."""
        length = self.scenario.step_duration
        return LoopAtPose(self.robot, self.specification, self.about, length, lambda: self.evaluation)

    @property
    def scenario(self) -> responses.Scenario:
        """The runs."""
        return self.evaluation.runs

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


def pose_evidence(robot: Robot, s: Specification, progress: Callable[[str], None]) -> PoseEvidence:
    """A law about one pose, and what it was judged by."""
    if s.mujoco:
        mujoco.check_expressed(s.extras)
    progress("equilibrium, and weights")
    synthesis = steps.synthesise(robot, s, progress)
    about, limit_cycle = checks.end_limit_cycle(synthesis.setup(robot, s))
    progress("margins of the running loop")
    linear = LawEvaluation(about)
    known_modes = law_modes(linear, synthesis)
    progress("compile the closed loop, and run the step")
    evaluation = in_scenario(linear, step_duration(linear, synthesis), synthesis.design_problem.target)
    duration = evaluation.runs.step_duration
    # before a second thread starts: warning filters belong to the whole process
    evaluation.compute_margins()
    with ThreadPoolExecutor(1) as beside:  # runs are compiled code, which releases the other thread
        runs = beside.submit(evaluation.make_runs)
        progress("corners of the tolerances, while load and move are run")
        evaluation.compute_corners()
        progress("the worst disturbance, and the dissipation budget of the step")
        worth = certification.attenuation(about, synthesis, duration)
        on_mujoco = None
        if s.mujoco:
            progress("the step on MuJoCo's plant")
            on_mujoco = about.step(duration, plant=about.mujoco_plant(about.goal))
        progress("load and move")
        runs.result()
    setup = AboutPose.of(robot, s, evaluation, synthesis, limit_cycle)
    judged = judged_design(setup, progress, undamped=False)
    progress("payloads at the ends of their ranges")
    payloads = checks.evaluate_payloads(about, evaluation.runs)
    lines = (*judged.requirements, *own_requirements(setup, synthesis, on_mujoco, payloads))
    start = float("nan")  # V at the start of the step, for the initial integrals of the controller
    if synthesis.sampled or synthesis.proved is not None:
        start = float((synthesis.proved or synthesis.solution).value(about.departure(synthesis.solution)))
    inside = start <= synthesis.chosen.level if synthesis.sampled else None
    progress("proof of the region")
    proof = certification.with_tolerances(
        robot, s, synthesis, certification.prove_design(robot, s, synthesis, start, worth)
    )
    known: dict[str, Any] = {each.name: getattr(judged, each.name) for each in fields(judged)}
    known["requirements"] = lines
    return PoseEvidence(
        **known,
        synthesis=synthesis,
        attenuation=worth,
        inside=inside,
        certified=proof,
        mujoco=on_mujoco,
        payloads=payloads,
        law_modes=known_modes,
        status=status_of(lines, evaluation, synthesis.chosen, worth, inside, proof),
    )


def own_requirements(
    setup: AboutPose,
    synthesis: steps.Synthesis,
    on_mujoco: responses.Response | None,
    payloads: tuple[checks.PayloadEvaluation, ...],
) -> list[Requirement]:
    """What is required of a law about a pose beside what is of every law: bandwidth, impulses, loads, the step beside a
    stated move or the move that is planned, payloads."""
    s, about, evaluation, limits = setup.specification, setup.about, setup.evaluation, setup.limits
    damping, resolution, target = setup.damping, setup.resolution, synthesis.design_problem.target
    lines = diverged_requirements(evaluation, damping is None)
    if target is not None and damping is not None:
        lines += [
            bandwidth_requirement(s, target.bandwidth, evaluation.margins, setup.joints),
            evaluation.ring_down.requirement(s, damping),
        ]
    if s.move is None:
        lines += judge.move_requirements(s, limits, evaluation.move, resolution)
    if s.move is not None and synthesis.along is not None:
        lines += checks.along_requirements(s, synthesis.along)
    if on_mujoco is not None:
        rows = responses.motion_metrics(limits, on_mujoco, about.command)
        lines += judge.step_requirements(s, limits, on_mujoco, MUJOCO)
        lines += judge.motion_requirements(s, limits, [rows], resolution, MUJOCO)
    for payload in payloads:
        lines += checks.payload_requirements(s, limits, payload, damping, resolution)
    return lines


def diverged_requirements(evaluation: LawEvaluation, impulses: bool) -> list[Requirement]:
    """The requirement that no run diverges, for those after the step that do; `impulses`: whether no other requirement
    is on their damping."""
    gone = {
        "impulses on the links at the goal": impulses and evaluation.ring_down.ring_down is None,
        "constant torques on the links": not evaluation.load_response.metrics,
    }
    return [REQUIREMENTS["diverged"].judge(None, 0.0, 1, where) for where, lost in gone.items() if lost]


def loop_at_pose(robot: Robot, s: Specification, progress: Callable[[str], None]) -> LoopAtPose:
    """The loop of a law that is not judged."""
    synthesis = steps.synthesise(robot, s, progress)
    setup, _ = checks.end_limit_cycle(synthesis.setup(robot, s))
    linear = LawEvaluation(setup)
    length, target = step_duration(linear, synthesis), synthesis.design_problem.target
    return LoopAtPose(robot, s, setup, length, lambda: in_scenario(linear, length, target))
