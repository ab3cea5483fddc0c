"""Evidence of a nonlinear H∞ law about one pose: its synthesis, its runs, what is proved."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from flexhinf.analysis import modes
from flexhinf.designs import certification, checks, judge, plans, responses
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.loop_setup import DEVIATIONS, LoopSetup, with_derived
from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.pose_loop import LoopAtPose
from flexhinf.designs.problem import presets
from flexhinf.designs.problem.weights import TargetBehaviour
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.specification import Specification
from flexhinf.designs.status import status_of
from flexhinf.designs.synthesis import steps
from flexhinf.robot import Robot, mujoco

#: The runs that are judged.
STEP, MUJOCO = "the step, nominal robot", "the step on MuJoCo's plant"


def pose_evidence(robot: Robot, s: Specification, progress: Callable[[str], None]) -> PoseEvidence:
    """A law about one pose, and what it was judged by."""
    if s.mujoco:
        mujoco.check_expressed(s.extras)
    progress("equilibrium, and weights")
    synthesis = steps.synthesise(robot, s, progress)
    setup, limit_cycle = checks.end_limit_cycle(synthesis.setup(robot, s))
    progress("margins of the running loop")
    linear = LawEvaluation(setup)
    law_modes = _law_modes(linear, synthesis)
    progress("compile the closed loop, and run the step")
    target = synthesis.design_problem.target
    evaluation = in_scenario(linear, step_duration(linear, synthesis), target)
    duration = evaluation.runs.step_duration
    # before a second thread starts: warning filters belong to the whole process
    evaluation.compute_margins()

    def runs() -> None:
        evaluation.make_runs()
        evaluation.sample_robots()

    with ThreadPoolExecutor(1) as beside:  # runs are compiled code, which releases the other thread
        future = beside.submit(runs)
        progress("corners of the tolerances, while load, move and sampled robots are run")
        evaluation.compute_corners()
        progress("the worst disturbance, and the dissipation budget of the step")
        worth = certification.attenuation(setup, synthesis, duration)
        on_mujoco = None
        if s.mujoco:
            progress("the step on MuJoCo's plant")
            on_mujoco = setup.step(duration, plant=setup.mujoco_plant(setup.goal))
        progress("load, move and sampled robots")
        future.result()
    progress("payloads at the ends of their ranges")
    payloads = checks.evaluate_payloads(setup, evaluation.runs)
    lines = _requirements(s, evaluation, synthesis, on_mujoco, limit_cycle, payloads)
    start = float("nan")  # V at the start of the step, for the initial integrals of the controller
    if synthesis.sampled or synthesis.proved is not None:
        start = float((synthesis.proved or synthesis.solution).value(setup.departure(synthesis.solution)))
    inside = start <= synthesis.chosen.level if synthesis.sampled else None
    progress("proof of the region")
    proof = certification.with_tolerances(
        robot, s, synthesis, certification.prove_design(robot, s, synthesis, start, worth)
    )
    return PoseEvidence(
        robot=robot,
        specification=s,
        synthesis=synthesis,
        evaluation=evaluation,
        attenuation=worth,
        inside=inside,
        proof=proof,
        mujoco=on_mujoco,
        limit_cycle=limit_cycle,
        payloads=payloads,
        law_modes=law_modes,
        requirements=lines,
        status=status_of(lines, evaluation, synthesis.chosen, worth, inside, proof),
    )


def _law_modes(evaluation: LawEvaluation, synthesis: steps.Synthesis) -> tuple[modes.Mode, ...]:
    loop = modes.closed_loop(synthesis.problem, synthesis.solution.gain)
    return modes.modes_of(loop, evaluation.setup.joints, *evaluation.energy)


def diverged_requirements(evaluation: LawEvaluation, impulses: bool) -> list[Requirement]:
    """The requirement that no run diverges, for those after the step that do; `impulses`: whether no other requirement
    is on their damping."""
    gone = {
        "impulses on the links at the goal": impulses and evaluation.ring_down.ring_down is None,
        "constant torques on the links": not evaluation.load_response.metrics,
    }
    return [REQUIREMENTS["diverged"].judge(None, 0.0, 1, where) for where, lost in gone.items() if lost]


def step_duration(linear: LawEvaluation, synthesis: steps.Synthesis) -> float:
    """Duration of the step, s: as stated, or by the slowest mode of the law, after the command."""
    stated = linear.setup.specification.duration
    if stated is not None:
        return stated
    slowest = min(-mode.eigenvalue.real for mode in _law_modes(linear, synthesis))
    return responses.run_length(slowest) + linear.setup.command_time


def in_scenario(linear: LawEvaluation, duration: float, target: TargetBehaviour | None) -> LawEvaluation:
    """The evaluation with its scenario, whose step has this duration, s, and with that step; its peak input
    without noise sets the load. Linear metrics computed before are kept.

    `target`: the behaviour that the weights were searched for.
    """
    setup, s, robot = linear.setup, linear.setup.specification, linear.setup.robot
    step, scales = setup.step(duration), modes.JointScales.of(setup.model, setup.goal_equilibrium)
    sub_steps, load, stated = step.run.settings["sub_steps"], s.load, setup.stated_move
    if load is None:
        quiet = setup.without_noise.step(duration, sub_steps=sub_steps)
        loads = responses.default_load(scales.per_input, quiet.peak_inputs)
    else:
        loads = np.full(len(setup.goal), load)
    holding_inputs = [setup.equilibrium(at)[1] for at in (setup.start, setup.goal)]
    plan = stated or plans.plan_move(
        robot,
        s,
        setup.start,
        setup.goal,
        followed_bandwidth(linear, target),
        float(scales.vibration.min()),
        holding_inputs,
    )
    count = responses.sample_count(robot, len(setup.linear_law.state_names), s.draws)
    robots, dwell = responses.sample_robots(setup.true.robot, count, s.seed), duration if stated else None
    runs = responses.Scenario(duration, loads, 2.0 * duration, plan, robots, sub_steps, dwell)
    return with_derived(linear, scenario=runs, known_step=step)


def followed_bandwidth(linear: LawEvaluation, target: TargetBehaviour | None) -> np.ndarray:
    """Finite bandwidth (n,), rad/s, for which the move is planned: that of the law with the true state fed back."""
    own = np.asarray(linear.state_margins.bandwidth, dtype=float)
    usable = np.isfinite(own) & (own > 0.0)
    return np.where(usable, own, 1.0) if target is None else target.where_not(usable, own)


def _requirements(
    stated: Specification,
    evaluation: LawEvaluation,
    synthesis: steps.Synthesis,
    on_mujoco: responses.Response | None,
    limit_cycle: checks.LimitCycleCheck | None,
    payloads: tuple[checks.PayloadEvaluation, ...],
) -> tuple[Requirement, ...]:
    """All requirements: first on the running loop, then on the runs, then on the tolerances."""
    setup, target = evaluation.setup, synthesis.design_problem.target
    s, limits = setup.specification, setup.limits
    damping = None if target is None else presets.required_damping(stated.damping, target)
    resolution = setup.position_resolution(DEVIATIONS)
    lines, step, robots = law_requirements(evaluation, damping, limit_cycle)
    if target is not None and damping is not None:
        lines.insert(
            0, judge.bandwidth_requirement(stated, target.bandwidth, evaluation.margins, setup.joints)
        )
        lines.append(evaluation.ring_down.requirement(s, damping))
    lines += step
    lines += diverged_requirements(evaluation, damping is None)
    if on_mujoco is not None:
        lines += step_requirements(
            setup,
            on_mujoco,
            MUJOCO,
            lambda length: setup.step(length, plant=setup.mujoco_plant(setup.goal)),
        )
    runs = evaluation.runs
    errors = None if s.move is None else checks.errors_after_move(setup, runs.plan, runs.dwell)
    lines += judge.move_requirements(s, limits, evaluation.move, resolution, errors)
    if s.move is not None and synthesis.along is not None:
        lines += checks.along_requirements(s, synthesis.along)
    if limit_cycle is not None:
        lines.append(limit_cycle.requirement(limits.position_units))
    for payload in payloads:
        lines += checks.payload_requirements(s, limits, payload, damping, resolution)
    return (*lines, *robots)


def step_requirements(
    setup: LoopSetup,
    run: responses.Response,
    where: str,
    again: Callable[[float], responses.Response],
    unlimited: responses.Response | None = None,
    remaining: tuple[np.ndarray, str] | None = None,
) -> list[Requirement]:
    """Requirements on the step, of which `again` makes a run of a length, s; `unlimited` and `remaining` as for
    `step_requirements` and `motion_requirements`."""
    s, limits, resolution = setup.specification, setup.limits, setup.position_resolution(DEVIATIONS)

    def lines_of(run: responses.Response) -> list[Requirement]:
        rows = responses.motion_metrics(limits, run, setup.command)
        return [
            *judge.step_requirements(s, limits, run, where, unlimited),
            *judge.motion_requirements(s, limits, [rows], resolution, where, remaining),
        ]

    return checks.judged_when_settled(lines_of, run, where, again, setup.command_time)


def law_requirements(
    evaluation: LawEvaluation, damping: float | None = None, limit_cycle: checks.LimitCycleCheck | None = None
) -> tuple[list[Requirement], ...]:
    """Requirements on a law: on margins, the nominal step, corners and sampled robots.

    `damping`: required damping ratio; None for the least one. `limit_cycle`: the run in which the remaining error is
    judged; None for the step.
    """
    setup, linear, samples = evaluation.setup, not evaluation.linear_failure, evaluation.step_samples
    s, limits, corners = setup.specification, setup.limits, evaluation.corners if linear else None
    margins = []
    if linear:
        own, worst = evaluation.margins, evaluation.least_damped
        ringing = [judge.of_several(setup.joints, mode.joint if mode else "") for mode in worst]
        margins = [
            *judge.margin_requirements(s, own, setup.joints),
            *judge.oscillation_requirements(s, own, damping, ringing),
            *judge.loop_requirements(s, lambda: [evaluation.loop.linear()]),
        ]
    step = step_requirements(
        setup,
        evaluation.step,
        STEP,
        lambda length: setup.step(length, sub_steps=evaluation.runs.sub_steps),
        evaluation.unlimited_step if limits.limits_peak else None,
        limit_cycle and limit_cycle.remaining,
    )
    robots = [] if corners is None else [judge.corner_requirement(corners)]
    robots += [] if samples is None else judge.sample_requirements(s, limits, samples)
    return margins, step, robots


def loop_at_pose(robot: Robot, s: Specification, progress: Callable[[str], None]) -> LoopAtPose:
    """The loop of a law that is not judged."""
    synthesis = steps.synthesise(robot, s, progress)
    setup, _ = checks.end_limit_cycle(synthesis.setup(robot, s))
    linear = LawEvaluation(setup)
    length, target = step_duration(linear, synthesis), synthesis.design_problem.target
    return LoopAtPose(robot, s, setup, length, lambda: in_scenario(linear, length, target))
