"""The pipelines from a robot and a specification to a design, and to a comparison of laws: one call per step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from flexhinf.analysis import modes
from flexhinf.design import (
    certification,
    checks,
    plans,
    requirements as required,
    responses,
    result,
    rigid,
    tuning,
)
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.laws import DESIGN, LawFactory, LawKind, law_kind, law_names
from flexhinf.design.problem import presets
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis import by_step, steps
from flexhinf.robot import Robot, mujoco

Progress = Callable[[str], None]

#: The rigid law has the design's degree with up to so many states, and degree 2 with more: solving takes minutes.
RIGID_STATES = 15


def design(robot: Robot, specification: Specification, progress: Progress | None = None) -> result.Design:
    """Design a controller for a robot, and judge the loop in which it runs; nothing is written.

    Parameters
    ----------
    robot : Robot
        From `load_robot`.
    specification : Specification
        What the loop must do; a field that is not stated is chosen by the rule that its help states.
    progress : callable, optional
        Called with what comes next, about `stages` times in all.

    Returns
    -------
    Design
        Law, estimator, runs and requirements; `Design.save` writes the report, `Design.controller` is what runs.

    Raises
    ------
    InvalidInput, InfeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        With what to change.

    Examples
    --------
    >>> import flexhinf as fh
    >>> quick = dict(degrees="2", draws=0, rays=0, proof_seconds=0, compare_rigid=False)
    >>> arm = fh.design(fh.load_robot("paper"), fh.Specification(pose="10deg", start="0", estimator="none", **quick))
    >>> arm.gamma > arm.gamma_star
    True
    >>> arm.controller().period
    0.001
    """
    s, progress = specification, progress or (lambda text: None)
    if s.mujoco:
        mujoco.check_expressed(s.extras)
    progress("equilibrium, and weights")
    synthesis = steps.synthesise(robot, s, progress)
    setup, rest = checks.end_limit_cycle(synthesis.setup(robot, s))
    progress("margins of the running loop")
    linear = LawEvaluation(DESIGN, setup)
    law_modes = _law_modes(linear, synthesis)
    progress("compile the closed loop, and run the step")
    scenario, step = _scenario(
        linear, synthesis, step_duration(linear, synthesis, law_modes), responses.SAMPLES
    )
    evaluation = linear.in_scenario(scenario, step)
    evaluation.compute("margins")  # before a second thread: filters of warnings are the whole process's
    with ThreadPoolExecutor(1) as beside:  # runs are compiled code, which lets the other thread go on
        runs = beside.submit(_runs, evaluation, synthesis)
        progress("corners of the tolerances, while load, move and sampled robots are run")
        evaluation.compute("corners", "frequency_response")
        progress("the worst disturbance, and the dissipation budget of the step")
        worth = certification.attenuation(setup, synthesis, scenario.step_duration)
        on_mujoco = None
        if s.mujoco:
            progress("the step on MuJoCo's plant")
            on_mujoco = setup.step(scenario.step_duration, plant=setup.mujoco_plant(setup.goal))
        progress("load, move and sampled robots")
        same_on_rigid = runs.result()
    progress("payloads at the ends of their ranges")
    payloads = checks.evaluate_payloads(setup, scenario)
    lines = tuple(_requirements(evaluation, synthesis, on_mujoco, rest, payloads))
    start = float("nan")  # V where the step starts, with the integrals that the controller chooses
    if synthesis.sampled or synthesis.proved is not None:
        start = float((synthesis.proved or synthesis.solution).value(setup.departure(synthesis.solution)))
    inside = start <= synthesis.chosen.level if synthesis.sampled else None
    progress("proof of the region")
    proof = certification.with_tolerances(
        robot, s, synthesis, certification.prove_design(robot, s, synthesis, start, worth)
    )
    return result.Design(
        robot=robot, specification=s, synthesis=synthesis, evaluation=evaluation, attenuation=worth, inside=inside,
        proof=proof, mujoco=on_mujoco, rigid=same_on_rigid, rest=rest, payloads=payloads, law_modes=law_modes,
        requirements=lines, status=result.status_of(lines, evaluation, synthesis.chosen, worth, inside, proof),
    )  # fmt: skip


def _runs(evaluation: LawEvaluation, synthesis: steps.Synthesis) -> rigid.RigidComparison | None:
    evaluation.compute("load_response", "ring_down", "move", "step_samples")
    if not evaluation.setup.specification.compare_rigid:
        return None
    few = len(synthesis.problem.state_names) <= RIGID_STATES
    return rigid.compare_rigid(evaluation, synthesis.problem, synthesis.chosen.degree if few else 2)


def _law_modes(evaluation: LawEvaluation, synthesis: steps.Synthesis) -> tuple:
    loop = modes.closed_loop(synthesis.problem, synthesis.solution.gain)
    return modes.modes_of(loop, evaluation.setup.joints, *evaluation.energy)


def step_duration(linear: LawEvaluation, synthesis: steps.Synthesis, law_modes: tuple = ()) -> float:
    """Duration of the step, s: as stated, or by the slowest mode of the law, after the command."""
    stated = linear.setup.specification.duration
    if stated is not None:
        return stated
    slowest = min(-mode.eigenvalue.real for mode in law_modes or _law_modes(linear, synthesis))
    return responses.run_length(slowest) + linear.setup.command_time


def _scenario(
    linear: LawEvaluation,
    synthesis: steps.Synthesis,
    duration: float,
    samples: Sequence[tuple[int, int]],
) -> tuple[responses.Scenario, responses.Response]:
    """The runs that all laws are compared in, and the design's own step; its peak without noise sets the load."""
    setup, s, robot = linear.setup, linear.setup.specification, linear.setup.robot
    step, scales = setup.step(duration), modes.JointScales.of(setup.model, setup.goal_equilibrium)
    sub_steps, load, stated = step.run.settings["sub_steps"], s.load, plans.stated_move(robot, s)
    if load is None:
        quiet = setup.without_noise.step(duration, sub_steps=sub_steps)
        loads = responses.default_load(scales.per_input, np.abs(quiet.inputs).max(axis=0))
    else:
        loads = np.full(len(setup.goal), load)
    held = [setup.equilibrium(at)[1] for at in (setup.start, setup.goal)]
    plan = stated or plans.plan_move(
        robot, s, setup.start, setup.goal, _followed(linear, synthesis), float(scales.vibration.min()), held
    )
    count = responses.sample_count(robot, len(synthesis.problem.state_names), s, samples)
    robots, rest = responses.sample_robots(robot, count, s.seed), duration if stated else None
    return responses.Scenario(duration, loads, 2.0 * duration, plan, robots, sub_steps, rest), step


def _followed(linear: LawEvaluation, synthesis: steps.Synthesis) -> np.ndarray:
    """Finite bandwidth (n,), rad/s, by which the move is planned: that of the law fed the true state."""
    own, target = np.asarray(linear.state_margins.bandwidth, dtype=float), synthesis.design_problem.target
    fallback = np.full(len(own), 1.0) if target is None else target.bandwidth
    return np.where(np.isfinite(own) & (own > 0.0), own, fallback)


def _requirements(
    evaluation: LawEvaluation,
    synthesis: steps.Synthesis,
    on_mujoco: responses.Response | None,
    rest: checks.LimitCycleCheck | None,
    payloads: tuple[checks.PayloadEvaluation, ...],
) -> list[required.Requirement]:
    """The specification line by line: the running loop first, then runs, then tolerances."""
    s, limits, target = (
        evaluation.setup.specification,
        evaluation.setup.limits,
        synthesis.design_problem.target,
    )
    damping = None if target is None else presets.required_damping(s, target)
    linear, step, robots = _law_requirements(evaluation)
    if target is not None and damping is not None:
        joints, worst = evaluation.setup.joints, evaluation.least_damped_joint
        linear += required.behaviour_requirements(
            s, target.bandwidth, damping, evaluation.margins, joints, worst
        )
        linear.append(evaluation.ring_down.requirement(s, damping))
    along = None if s.move is None else synthesis.along
    return [
        *linear,
        *step,
        *([] if on_mujoco is None else required.step_requirements(s, limits, on_mujoco, ON_MUJOCO)),
        *required.move_requirements(s, limits, evaluation.move),
        *(() if along is None else checks.along_requirements(s, along)),
        *(() if rest is None else [rest.requirement(limits.position_units)]),
        *(line for payload in payloads for line in checks.payload_requirements(s, limits, payload, damping)),
        *robots,
    ]


def _law_requirements(
    evaluation: LawEvaluation,
) -> tuple[list[required.Requirement], list[required.Requirement], list[required.Requirement]]:
    """Requirements on a law by `design` and `compare`: margins, the nominal step, corners and sampled robots."""
    setup, linear, samples = evaluation.setup, not evaluation.linear_failure, evaluation.step_samples
    s, limits, corners = setup.specification, setup.limits, evaluation.corners if linear else None
    unlimited = evaluation.unlimited_step if limits.limits_peak else None
    return (
        required.margin_requirements(s, evaluation.margins, setup.joints) if linear else [],
        required.step_requirements(s, limits, evaluation.step, "the step, nominal robot", unlimited),
        [
            *([] if corners is None else [required.corner_requirement(corners)]),
            *([] if samples is None else required.sample_requirements(s, limits, samples)),
        ],
    )


#: Where requirements are judged with MuJoCo.
ON_MUJOCO = "the step on MuJoCo's plant"

#: What the preset `robust` adds: channels, the weights of the whole loop, and their noise levels.
ROBUST_STAGES = 3

#: What the preset `proved` has instead of degrees and their regions: about its candidates, and a proof.
PROVED_STAGES = 6 + 1


def stages(robot: Robot, specification: Specification, laws: Sequence[str] | None = None) -> int:
    """About how many steps of work a design has, or a comparison of so many laws, for a progress bar."""
    s, states = specification, 5 * len(robot.joint_names)
    preset, limits = presets.preset_of(robot, s), responses.joint_limits(robot, s)
    limited = preset in ("damped", "robust") and (limits.limits_peak or limits.limits_speed)
    solved, rays = len(by_step.tried_degrees(states, s.degrees)), by_step.rays_of(states, s.rays)
    degrees = solved + (solved > 1) + (rays > 0) * (1 if s.degrees is None else solved)
    synthesis = (PROVED_STAGES if preset == "proved" else degrees) + len(s.via) + limited
    if laws is not None:
        return 3 + synthesis + (5 if responses.sample_count(robot, states, s) else 4) * len(laws)
    disturbance = certification.searches_disturbance(states, rays)
    return 8 + synthesis + s.mujoco + ROBUST_STAGES * (preset == "robust") + disturbance


def compare(
    robot: Robot,
    specification: Specification,
    laws: Sequence[str] | None = None,
    tune: str = "peak",
    progress: Progress | None = None,
    same_sensors: bool = False,
) -> result.Comparison:
    """Compare laws on one robot, each tuned for the same criterion and evaluated in the same runs; nothing is written.

    Parameters
    ----------
    robot : Robot
        From `load_robot`.
    specification : Specification
        Of the design that the others are compared with, and of the loop.
    laws : sequence of str, optional
        Names, see `flexhinf.design.laws`; always among them are the design's own law as it is (``design``), the
        reference of the criterion, and the nonlinear H∞ law tuned for the criterion as the others are (``nl-hinf``).
    tune : {"peak", "bandwidth", "none"}
        What the laws share with the design: a limit beside those of the specification.
    progress : callable, optional
        Called with what comes next, about `stages` times in all.
    same_sensors : bool
        Every law measures what the design measures, instead of what its proponents would choose.

    Returns
    -------
    Comparison
        The laws with their runs and costs; `Comparison.save` writes the report.

    Raises
    ------
    InvalidInput
        For a name or a way to tune that is not known, nothing to move, a design whose own loop diverges, or a law that
        was asked for and does not fit the robot.
    FlexhinfError
        As `design`.

    Examples
    --------
    >>> import flexhinf as fh
    >>> spec = fh.Specification(pose="10deg", start="0", degrees="2", draws=0, rays=0, estimator="none")
    >>> comparison = fh.compare(fh.load_robot("paper"), spec, laws=("pd",), tune="none")
    >>> [row.name for row in comparison.rows]
    ['design', 'nl-hinf', 'pd']
    """
    s, kinds = specification, [law_kind(name) for name in law_names(laws)]
    progress = progress or (lambda text: None)
    tuning.check_mode(tune, "tune='peak'")
    progress("equilibrium, and weights")
    synthesis = steps.synthesise(robot, s, progress)
    setup, _ = checks.end_limit_cycle(synthesis.setup(robot, s))
    progress("what all laws share: load, move, criterion")
    linear = LawEvaluation(DESIGN, setup, other_noise=False)
    scenario, step = _scenario(
        linear, synthesis, step_duration(linear, synthesis), responses.COMPARED_SAMPLES
    )
    own = linear.in_scenario(scenario, step)
    unit = synthesis.problem.plant.unit(synthesis.problem.input_names[0])
    limits, resolution = tuning.stated_limits(setup, unit), setup.position_resolution()
    criterion = tuning.criterion_for(
        tune, tuning.reference_metrics(own), scenario.step_duration, limits, unit, resolution
    )
    # where searches over bandwidths begin
    bandwidth = float(np.exp(np.mean(np.log(_followed(linear, synthesis)))))
    tuner = tuning.Tuner(LawFactory(synthesis, bandwidth), own, criterion, same_sensors)
    tuned = tuner.tune_all(kinds, laws or (), progress)
    rows = tuple(_row(kind, tuned[kind.name], progress) for kind in kinds)
    return result.Comparison(robot, s, synthesis, criterion, rows, scenario)


def _row(kind: LawKind, tuned: tuning.TunedLaw | str, progress: Progress) -> result.ComparedLaw:
    failure = tuned if isinstance(tuned, str) else tuned.failure
    if isinstance(tuned, str) or failure:
        progress(f"{kind.name}: not compared")
        return result.ComparedLaw(kind, failure=failure)
    progress(f"{kind.name}: step, load and move")
    evaluation, runs = tuned.evaluation, tuned.evaluation.scenario
    evaluation.compute("worst")
    if runs and runs.robots:
        progress(f"{kind.name}: {len(runs.robots)} robots within their tolerances")
    evaluation.compute("metrics")
    margins, step, robots = _law_requirements(evaluation)
    return result.ComparedLaw(kind, tuned, (*margins, *step, *robots))
