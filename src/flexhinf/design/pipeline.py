"""The pipelines from a robot and a specification to a design and to a comparison of laws, one call per step:
computation, judgement (not met, not proved, risky), results."""

# Not checked strictly: what a caller passes may be of another type than stated.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.analysis import modes
from flexhinf.design import certification, checks, judgement, plans, responses, tuning
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.laws import DESIGN, LawFactory, LawKind, law_kind, law_names
from flexhinf.design.loop_setup import DEVIATIONS, LoopSetup, with_derived
from flexhinf.design.own_sensors import with_own_sensors
from flexhinf.design.pose_evidence import PoseEvidence
from flexhinf.design.pose_loop import LoopAtPose
from flexhinf.design.problem import presets
from flexhinf.design.problem.weights import TargetBehaviour
from flexhinf.design.requirements import REQUIREMENTS, Reported, Requirement, loop_margins
from flexhinf.design.result import Design, DesignedLoop, judged_by
from flexhinf.design.rigid import RigidComparison, compare_rigid
from flexhinf.design.specification import Specification, is_for_workspace, with_workspace
from flexhinf.design.status import status_of
from flexhinf.design.synthesis import by_step, steps
from flexhinf.design.workspace import comparison as over
from flexhinf.design.workspace.design import TOLERATED, Meanwhile, design_workspace, workspace_stages
from flexhinf.design.workspace.evidence import LoopOverWorkspace
from flexhinf.design.workspace.law_file import stated_workspace
from flexhinf.design.workspace.preset import selected_law
from flexhinf.errors import InvalidInput
from flexhinf.processors import single_blas
from flexhinf.robot import Robot, mujoco
from flexhinf.validation import checked_kind, value_text

Progress = Callable[[str], None]


def silent(text: str) -> None:
    """Tell nobody how far a design is."""


#: Largest number of states for which the rigid law has the design's degree; with more it has degree 2.
RIGID_STATES = 15

#: The runs that are judged.
STEP, MUJOCO = "the step, nominal robot", "the step on MuJoCo's plant"


@dataclass(frozen=True, eq=False)
class ComparedLaw:
    """One row of a comparison."""

    kind: LawKind
    # The law, its parameters and its evaluation; None for a law that could not be made
    tuned: tuning.TunedLaw | None = None
    # Requirements of the specification on margins, step, corners and sampled robots, judged as by `design`
    requirements: tuple[Requirement, ...] = ()
    failure: str = ""  # Why there is no evaluation

    @property
    def name(self) -> str:
        """Of the law."""
        return self.kind.name

    @property
    def evaluation(self) -> LawEvaluation | None:
        """Evaluation of the law; None for a law that could not be made."""
        return None if self.tuned is None else self.tuned.evaluation

    @property
    def metrics(self) -> Mapping[str, float | None]:
        """Metrics of the law, see `LawEvaluation.metrics`; empty without an evaluation."""
        return {} if self.evaluation is None else self.evaluation.metrics


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Reported):
    """Several laws, each tuned for the same criterion and evaluated in the scenario of `flexhinf.design`.

    Examples
    --------
    >>> import flexhinf as fh
    >>> spec = fh.Specification(pose="10deg", start="0", degrees="2", draws=0, rays=0, estimator="none")
    >>> paper = fh.load_robot("paper")
    >>> comparison = fh.compare(paper, spec, ["pd"], "none", candidates=(0, 0))  # doctest: +SKIP
    >>> comparison.row("pd").evaluation.step.run.status  # doctest: +SKIP
    'completed'
    """

    robot: Robot
    specification: Specification
    synthesis: steps.Synthesis  # Of the design's own law
    criterion: tuning.Criterion  # What every law is tuned for, and the limits of the specification
    rows: tuple[ComparedLaw, ...]  # The design as it is first, then nonlinear H∞ tuned as the others are
    scenario: responses.Scenario

    def summary(self) -> dict[str, str]:
        """Robot, laws by the criterion (less is better), those that miss a limit, and those that could not be made."""
        tuned = sorted((row.tuned for row in self.rows if row.tuned is not None), key=lambda law: law.cost)
        parts = {
            "laws by the criterion": [f"{law.name} {law.cost:.3g}" for law in tuned if not law.missed],
            "not ranked": [f"{law.name} {law.cost:.3g}" for law in tuned if law.missed],
            "not compared": [row.name for row in self.rows if row.failure],
        }
        return {"robot": self.robot.name} | {what: ", ".join(laws) for what, laws in parts.items() if laws}

    @property
    def own(self) -> ComparedLaw:
        """The design as it is, whose metrics are the reference of the criterion."""
        return self.rows[0]

    @property
    def tuned_design(self) -> ComparedLaw:
        """Nonlinear H∞ tuned for the criterion; the design as it is where there is no such law."""
        return next((row for row in self.rows[1:2] if row.evaluation is not None), self.own)

    @property
    def compared(self) -> tuple[ComparedLaw, ...]:
        """Rows with an evaluation."""
        return tuple(row for row in self.rows if row.evaluation is not None)

    def row(self, name: str) -> ComparedLaw:
        """The row of a law, by name."""
        return next(row for row in self.rows if row.name == name)

    def units(self) -> dict[str, str]:
        """Units of inputs, positions and torques, for joints that turn, slide or both."""
        slides = tuple(bool(slide) for slide in self.robot.links.slides)
        kinds = {"position": ("rad", "m"), "torque": ("N·m", "N")}
        problem = self.synthesis.problem
        return {"input": problem.plant.unit(problem.input_names[0])} | {
            name: " or ".join(unit for unit, there in zip(pair, (not all(slides), any(slides))) if there)
            for name, pair in kinds.items()
        }


def checked_specification(robot: Robot, specification: Specification | None) -> Specification:
    """The specification, by default its defaults; refuses what is no robot, such as its file, or no specification."""
    checked_kind("This is no robot.", robot, Robot, "a flexhinf.Robot", "flexhinf.load_robot('arm.toml')")
    specification = Specification() if specification is None else specification
    if not isinstance(specification, Specification):
        found = f"expected a flexhinf.Specification, got {value_text(specification)}"
        raise InvalidInput("This is no specification.", found, "flexhinf.Specification(pose='90deg')")
    return with_workspace(robot, with_own_sensors(robot, specification))


def design(
    robot: Robot, specification: Specification | None = None, progress: Progress | None = None
) -> Design:
    """Design a controller for a robot, and judge the loop in which it runs; nothing is written.

    The controller is for a workspace, by default all poses within the joint ranges: one law for all of them, judged at
    random poses and in moves between random goals. With a field that only a design of one pose reads
    (`Specification.pose_fields_stated`), such as ``pose``, ``bandwidth`` or ``degrees``, it is for that pose alone: a
    nonlinear H∞ law about the goal, by default the robot's home, judged in the step to it.

    Parameters
    ----------
    robot : Robot
        From `load_robot`.
    specification : Specification, optional
        What the loop must do; a field that is not stated is chosen by the rule that its help states.
    progress : callable, optional
        Called with what comes next, about `stages` times in all.

    Returns
    -------
    Design
        Law, estimator, runs and requirements: ``met`` says whether the requirements are met, ``save(folder)`` writes
        the report, ``controller(at)`` is what runs, and ``evidence`` holds every number of the report.

    Raises
    ------
    SpecificationError
        For a workspace and a field of one pose in one specification.
    InvalidInput, InfeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        With what to change.

    Examples
    --------
    >>> import flexhinf as fh
    >>> quick = dict(degrees="2", draws=0, rays=0, proof_seconds=0, compare_rigid=False)
    >>> arm = fh.design(fh.load_robot("paper"), fh.Specification(pose="10deg", start="0", estimator="none", **quick))
    >>> arm.evidence.gamma > arm.evidence.gamma_star
    True
    >>> arm.controller().period
    0.001
    """
    return design_with(robot, specification, progress)


@single_blas()
def design_with(
    robot: Robot,
    specification: Specification | None,
    progress: Progress | None,
    meanwhile: Meanwhile = lambda: lambda evidence: None,
) -> Design:
    """As `design`; of a design for a workspace `meanwhile` begins what is done while is computed what it tolerates."""
    s, progress = checked_specification(robot, specification), progress or silent
    if is_for_workspace(s):
        return judged_by(design_workspace(robot, s, progress, meanwhile=meanwhile))
    return judged_by(pose_evidence(robot, s, progress))


def loop_of(robot: Robot, s: Specification, progress: Progress = silent) -> DesignedLoop:
    """The loop of a design that is not judged."""
    if is_for_workspace(s):
        return LoopOverWorkspace(selected_law(robot, s, stated_workspace(robot, s.workspace), progress).setup)
    synthesis = steps.synthesise(robot, s, progress)
    setup, _ = checks.end_limit_cycle(synthesis.setup(robot, s))
    linear = LawEvaluation(DESIGN, setup)
    length, target = step_duration(linear, synthesis), synthesis.design_problem.target
    return LoopAtPose(robot, s, setup, length, lambda: in_scenario(linear, length, target, responses.SAMPLES))


def pose_evidence(robot: Robot, s: Specification, progress: Progress) -> PoseEvidence:
    """A law about one pose, and what it was judged by."""
    if s.mujoco:
        mujoco.check_expressed(s.extras)
    progress("equilibrium, and weights")
    synthesis = steps.synthesise(robot, s, progress)
    setup, limit_cycle = checks.end_limit_cycle(synthesis.setup(robot, s))
    progress("margins of the running loop")
    linear = LawEvaluation(DESIGN, setup)
    law_modes = _law_modes(linear, synthesis)
    progress("compile the closed loop, and run the step")
    target = synthesis.design_problem.target
    evaluation = in_scenario(linear, step_duration(linear, synthesis), target, responses.SAMPLES)
    duration = evaluation.runs.step_duration
    # before a second thread starts: warning filters belong to the whole process
    evaluation.compute_margins()

    def runs() -> RigidComparison | None:
        evaluation.make_runs()
        evaluation.sample_robots()
        if not s.compare_rigid:
            return None
        degree = synthesis.chosen.degree if len(synthesis.problem.state_names) <= RIGID_STATES else 2
        return compare_rigid(evaluation, synthesis.problem, degree)

    with ThreadPoolExecutor(1) as beside:  # runs are compiled code, which releases the other thread
        on_rigid = beside.submit(runs)
        progress("corners of the tolerances, while load, move and sampled robots are run")
        evaluation.compute_corners()
        progress("the worst disturbance, and the dissipation budget of the step")
        worth = certification.attenuation(setup, synthesis, duration)
        on_mujoco = None
        if s.mujoco:
            progress("the step on MuJoCo's plant")
            on_mujoco = setup.step(duration, plant=setup.mujoco_plant(setup.goal))
        progress("load, move and sampled robots")
        same_on_rigid = on_rigid.result()
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
        rigid=same_on_rigid,
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


def in_scenario(
    linear: LawEvaluation, duration: float, target: TargetBehaviour | None, samples: Sequence[tuple[int, int]]
) -> LawEvaluation:
    """The evaluation with the scenario of all laws, whose step has this duration, s, and with that step; its peak input
    without noise sets the load. Linear metrics computed before are kept.

    `target`: the behaviour that the weights were searched for. `samples`: see `responses.sample_count`.
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
        _followed(linear, target),
        float(scales.vibration.min()),
        holding_inputs,
    )
    count = responses.sample_count(robot, len(setup.linear_law.state_names), s.draws, samples)
    robots, dwell = responses.sample_robots(setup.true.robot, count, s.seed), duration if stated else None
    runs = responses.Scenario(duration, loads, 2.0 * duration, plan, robots, sub_steps, dwell)
    return with_derived(linear, scenario=runs, known_step=step)


def _followed(linear: LawEvaluation, target: TargetBehaviour | None) -> np.ndarray:
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
    lines, step, robots = _law_requirements(evaluation, damping, limit_cycle)
    if target is not None and damping is not None:
        lines.insert(
            0, loop_margins.bandwidth_requirement(stated, target.bandwidth, evaluation.margins, setup.joints)
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
    lines += judgement.move_requirements(s, limits, evaluation.move, resolution, errors)
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

    def judge(run: responses.Response) -> list[Requirement]:
        rows = responses.motion_metrics(limits, run, setup.command)
        return [
            *judgement.step_requirements(s, limits, run, where, unlimited),
            *judgement.motion_requirements(s, limits, rows, resolution, where, remaining),
        ]

    return checks.judged_when_settled(judge, run, where, again, setup.command_time)


def _law_requirements(
    evaluation: LawEvaluation, damping: float | None = None, limit_cycle: checks.LimitCycleCheck | None = None
) -> tuple[list[Requirement], ...]:
    """Requirements on a law in `design` and `compare`: on margins, the nominal step, corners and sampled robots.

    `damping`: required damping ratio; None for the least one. `limit_cycle`: the run in which the remaining error is
    judged; None for the step.
    """
    setup, linear, samples = evaluation.setup, not evaluation.linear_failure, evaluation.step_samples
    s, limits, corners = setup.specification, setup.limits, evaluation.corners if linear else None
    margins = []
    if linear:
        own, worst = evaluation.margins, evaluation.least_damped
        ringing = [loop_margins.of_several(setup.joints, mode.joint if mode else "") for mode in worst]
        margins = [
            *loop_margins.margin_requirements(s, own, setup.joints),
            *loop_margins.oscillation_requirements(s, own, damping, ringing),
            *loop_margins.loop_requirements(s, lambda: [evaluation.loop.linear()]),
        ]
    step = step_requirements(
        setup,
        evaluation.step,
        STEP,
        lambda length: setup.step(length, sub_steps=evaluation.runs.sub_steps),
        evaluation.unlimited_step if limits.limits_peak else None,
        limit_cycle and limit_cycle.remaining,
    )
    robots = [] if corners is None else [loop_margins.corner_requirement(corners)]
    robots += [] if samples is None else judgement.sample_requirements(s, limits, samples)
    return margins, step, robots


def stages(
    robot: Robot, specification: Specification, laws: Sequence[str] | None = None
) -> list[tuple[str, float]]:
    """The work steps of a design, or of a comparison of `laws` (empty: the usual ones), about as they come: how their
    names begin or end, and what part of the work each is, relative to the others."""
    if is_for_workspace(specification):
        own = workspace_stages(robot, specification)
        return [*own, (TOLERATED, 2.5)] if laws is None else over.compare_stages(own, laws, robot.drive)
    s, states = specification, by_step.STATES * len(robot.joint_names)
    preset, limits = presets.preset_of(robot, s), responses.joint_limits(robot, s)
    limited = preset in ("damped", "robust") and (limits.limits_peak or limits.limits_speed)
    solved = len(by_step.tried_degrees(states, s.degrees))
    rays = by_step.rays_of(states, s.rays) if laws is None else 0
    found = [("equilibrium, and weights", 3.0)]
    if laws is None and preset == "robust":
        found += [("channels of the tolerances", 10.0), ("loops tried", 0.5), ("noise levels", 0.5)]
    if limited:
        found.append(("the peak input of the step", 1.0))
    found.append(("tried", 0.5))
    if preset == "proved":  # about six candidates and a proof instead of degrees and their regions
        found += [("prove", 2.0)] * 7
    else:
        regions = (rays > 0) * (1 if s.degrees is None else solved)
        found += [("solve", 0.5)] * solved + [("the step with each", 2.0)] * (solved > 1)
        found += [("sample the region", 1.0)] * regions
    found += [("the law at", 0.5)] * len(s.via)
    if laws is not None:
        sampled = bool(responses.sample_count(robot, states, s.draws))
        runs = [("step, load and move", 1.0), *([("robots within their tolerances", 1.0)] * sampled)]
        tuned = (("tune", 8.0), ("tune from the others", 3.0), ("tune from the best", 3.0))
        rounds = [each for each in tuned for _ in law_names(laws, robot.drive)]
        return [*found, ("what all laws share", 2.0), *rounds, *(runs * len(law_names(laws, robot.drive)))]
    found += [("margins of the running loop", 1.0), ("compile the closed loop", 2.0), ("corners", 3.0)]
    found.append(("the worst disturbance", 1.0 if certification.searches_disturbance(states, rays) else 0.2))
    found += [("the step on MuJoCo's plant", 1.0)] * s.mujoco
    return [*found, ("load, move and sampled robots", 1.0), ("payloads", 0.3), ("proof of the region", 1.0)]


@single_blas()
def compare(
    robot: Robot,
    specification: Specification,
    laws: Sequence[str] | None = None,
    tune: str = "peak",
    progress: Progress | None = None,
    same_sensors: bool = False,
    candidates: Sequence[int | str] | None = None,
    gains: Mapping[str, Mapping[str, ArrayLike]] | None = None,
) -> Comparison | over.WorkspaceComparison:
    """Compare laws on one robot, each tuned by one rule and judged in the same runs; nothing is written.

    A specification is for a workspace or for one pose, as for `design`. Over a workspace all laws are judged by the
    requirements of a design; at a pose each is tuned for one criterion.

    Parameters
    ----------
    robot, specification : Robot and Specification
        Of the design that the others are compared with, and of the loop.
    laws : sequence of str, optional
        Names, see `flexhinf.design.laws`; always among them are the design's own law as it is (``design``) and, at a
        pose, the nonlinear H∞ law tuned for the criterion as the others are (``nl-hinf``).
    tune : {"peak", "bandwidth", "none"}
        At a pose, which limit of the specification holds beside the margins and the noise at the motors: of the peak
        input, the stated bandwidth as the largest, or none.
    progress : callable, optional
        Called with what comes next, about `stages` times in all.
    same_sensors : bool
        Every law measures what the design measures, instead of what its proponents would choose.
    candidates : (int, int), optional
        At a pose, candidates per parameter, in the first round and in each of the two later ones; by default 16 and 10,
        for models of more than 15 states 3 and 2. With (0, 0) a law tries its starting values alone.
    gains : mapping of str to numbers, optional
        Over a workspace, numbers of laws that are then not tuned: ``{"pid": {"bandwidth": [20.0, 30.0]}}``.

    Returns
    -------
    WorkspaceComparison or Comparison
        The laws with their runs; `save` writes the report.

    Raises
    ------
    InvalidInput
        For laws, gains or a search that are not known, do not fit or are of the other kind; and as `design`.

    Examples
    --------
    >>> import flexhinf as fh
    >>> spec = fh.Specification(pose="10deg", start="0", degrees="2", draws=0, rays=0, estimator="none")
    >>> paper = fh.load_robot("paper")
    >>> comparison = fh.compare(paper, spec, ["pd"], "none", candidates=(0, 0))  # doctest: +SKIP
    >>> [row.name for row in comparison.rows]  # doctest: +SKIP
    ['design', 'nl-hinf', 'pd']
    """
    s, progress = checked_specification(robot, specification), progress or silent
    over.check_kind(is_for_workspace(s), tune != "peak", candidates is not None, gains is not None)
    if is_for_workspace(s):
        return over.compare_over_workspace(robot, s, laws, progress, same_sensors, gains)
    kinds = [law_kind(name) for name in law_names(laws, robot.drive)]
    counts = tuning.checked_candidates(candidates)
    tuning.check_mode(tune, "tune='peak'", s.bandwidth is not None)
    progress("equilibrium, and weights")
    synthesis = steps.synthesise(robot, replace(s, rays=0), progress)  # no region is compared
    setup, _ = checks.end_limit_cycle(synthesis.setup(robot, s))
    progress("what all laws share: load, move, criterion")
    linear = LawEvaluation(DESIGN, setup, other_noise=False)
    target = synthesis.design_problem.target
    own = in_scenario(linear, step_duration(linear, synthesis), target, responses.COMPARED_SAMPLES)
    unit = synthesis.problem.plant.unit(synthesis.problem.input_names[0])
    limits, resolution = tuning.stated_limits(s, setup.limits, unit), setup.position_resolution()
    criterion = tuning.criterion_for(
        tune, tuning.reference_metrics(own), own.runs.step_duration, limits, resolution
    )
    # initial value of searches over bandwidths
    bandwidth = float(np.exp(np.mean(np.log(_followed(linear, target)))))
    tuner = tuning.Tuner(LawFactory(synthesis, bandwidth), own, criterion, same_sensors, counts)
    tuned = tuner.tune_all(kinds, laws or (), progress)
    rows = tuple(_row(kind, tuned[kind.name], progress) for kind in kinds)
    return Comparison(robot, s, synthesis, criterion, rows, own.runs)


def _row(kind: LawKind, tuned: tuning.TunedLaw | str, progress: Progress) -> ComparedLaw:
    if isinstance(tuned, str):
        progress(f"{kind.name}: not compared")
        return ComparedLaw(kind, failure=tuned)
    progress(f"{kind.name}: step, load and move")
    evaluation, runs = tuned.evaluation, tuned.evaluation.scenario
    evaluation.compute_worst()
    if runs and runs.robots:
        progress(f"{kind.name}: {len(runs.robots)} robots within their tolerances")
    evaluation.compute_metrics()
    margins, step, robots = _law_requirements(evaluation)
    return ComparedLaw(kind, tuned, (*margins, *step, *robots))
