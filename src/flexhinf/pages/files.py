"""The files of a report: page, numbers (in SI units; what has no number is null), controller and every run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import asdict, replace
from functools import cache, partial
from hashlib import sha256
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
import tomlkit

from flexhinf import copies
from flexhinf.analysis import Margins
from flexhinf.design import design_file
from flexhinf.design.advice import Advice
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.pipeline import ComparedLaw, Comparison
from flexhinf.design.pose_evidence import PoseEvidence
from flexhinf.design.requirements import Requirement
from flexhinf.design.responses import ROBOT, Response
from flexhinf.design.result import Design
from flexhinf.design.stored import StoredReport, requirement_numbers
from flexhinf.design.tuning import best_rival, pareto_front
from flexhinf.design.verdict import UNKNOWN, DesignVerdict, result_row
from flexhinf.design.workspace.comparison import WorkspaceComparison
from flexhinf.design.workspace.evidence import WorkspaceEvidence
from flexhinf.errors import InvalidInput
from flexhinf.loop import Trajectory
from flexhinf.pages.comparison import comparison_notes, comparison_page, comparison_tables, is_ranked
from flexhinf.pages.design.frequency import corner_rows
from flexhinf.pages.design.region import BOX_FILE, budget_of, proof_numbers
from flexhinf.pages.design.runs import MARGINS as ALONG, long_run_rows, ring_down_rows
from flexhinf.pages.design.weights import is_used, state_weights, whole_loop_rows
from flexhinf.pages.page import design_page, design_tables, files_section, input_rows, notes, verdict
from flexhinf.pages.saved import saved_files
from flexhinf.pages.terminal import Ending, comparison_ending, design_ending
from flexhinf.pages.workspace import Pictures, workspace_numbers, workspace_page, workspace_pictures
from flexhinf.pages.workspace_comparison import laws_details, laws_ending, laws_numbers, laws_page
from flexhinf.pages.workspace_proof import workspace_proof_numbers
from flexhinf.pages.workspace_summary import every_requirement, workspace_ending, workspace_verdict
from flexhinf.report import Page, finite, to_json, write
from flexhinf.robot import catalogue, load_robot
from flexhinf.robot.saved_file import robot_text

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: Runs are NetCDF files: a fifth of the size of text, with units.
ENDING = "nc"

#: In the folder of a report: what is proved of a controller for a workspace, where that was asked for.
PROOF_FILE = "proof.json"

#: In the folder of a report: the robot's file, where its numbers are not those of the file that it was read from.
ROBOT_FILE = "robot.toml"


def design_files(
    design: Design,
    command: Sequence[str],
    warnings: Sequence[str] = (),
    beside: Sequence[str] = (),
    advice: Advice | None = None,
    early: EarlyParts | None = None,
) -> dict[str, str | bytes]:
    """Files of a report: index.html, design.json, controller, runs of the nominal robot, proof as certificate.json.

    `command` makes the report again (none for one that is written from Python), `warnings` are about the robot's file,
    and `beside` names files that the caller writes into the same folder: the page lists them. `advice` is what was
    tried after a design for a workspace, and `early` has its figures and runs, where there are any.
    """
    parts = _parts_of(design, command, warnings, advice, early)
    with nullcontext(early.runs) if early else saved_files(_run_files(parts.runs)) as runs:
        # while another process writes the runs
        page, numbers = parts.page(), to_json(parts.numbers)
        with saved_files({"controller": design.controller().save}, beside=False) as controller:
            files = {"design.json": numbers, **controller(), **runs(), **parts.proofs}
    page = replace(page, sections=(*page.sections, files_section((*files, *beside))))
    return {"index.html": page.html(), **files}


class EarlyParts(ExitStack):
    """The figures and the runs of a report on a design for a workspace, by functions that wait for them.

    Where there are other processes, these draw and save them from `begin` on.
    """

    pictures: Callable[[], Pictures]
    runs: Callable[[], Mapping[str, bytes]]  # contents of files by name

    def begin(self, evidence: WorkspaceEvidence) -> None:
        """Begin both; when this is left, they are known or given up."""
        self.pictures = self.enter_context(copies.beside(lambda: workspace_pictures(evidence)))
        self.runs = cache(self.enter_context(saved_files(_run_files(_moves_of(evidence)))))


class _Parts(NamedTuple):
    numbers: dict[str, object]  # of design.json
    runs: dict[str, Trajectory]  # by name
    proofs: dict[str, str]  # files by name
    page: Callable[[], Page]  # without the list of files


def _parts_of(
    design: Design,
    command: Sequence[str],
    warnings: Sequence[str],
    advice: Advice | None,
    early: EarlyParts | None,
) -> _Parts:
    evidence = _evidence_of(design)
    if isinstance(evidence, WorkspaceEvidence):
        moves = _moves_of(evidence)
        pictures = early and early.pictures()
        page = partial(workspace_page, evidence, command, warnings, advice=advice, pictures=pictures)
        proved = evidence.proof
        proofs = {} if proved is None else {PROOF_FILE: to_json(workspace_proof_numbers(proved))}
        return _Parts(workspace_numbers(evidence), moves, proofs, page)
    e, proof = evidence.evaluation, evidence.proof
    responses = {
        **_responses(e),
        **{f"ring-down-{k}": run for k, run in enumerate(e.ring_down.responses, 1)},
        **({} if evidence.mujoco is None else {"step-mujoco": evidence.mujoco}),
    }
    proofs = {
        name: certified.certificate.text()
        for name, certified in (("certificate.json", proof), (BOX_FILE, proof.box))
        if certified is not None and certified.certificate is not None
    }
    page = partial(design_page, evidence, command, warnings)
    runs = {name: response.run for name, response in responses.items()}
    return _Parts(design_numbers(evidence), runs, proofs, page)


def _moves_of(evidence: WorkspaceEvidence) -> dict[str, Trajectory]:
    """Moves of the nominal robot by name."""
    return {f"move-{k}": move.response.run for k, move in enumerate(evidence.moves, 1)}


def _run_files(runs: Mapping[str, Trajectory]) -> dict[str, Callable[[Path], object]]:
    return {f"runs/{name}.{ENDING}": run.save for name, run in runs.items()}


def _responses(e: LawEvaluation) -> dict[str, Response]:
    """Runs of the nominal robot by name."""
    return {"step": e.step, "load": e.load_response.response, "move": e.move.response}


def _evidence_of(design: Design) -> PoseEvidence | WorkspaceEvidence:
    """What a design was judged by in this process; refused for one that was read, whose folder has its report."""
    evidence = design.evidence
    if isinstance(evidence, PoseEvidence | WorkspaceEvidence):
        return evidence
    raise InvalidInput(
        "This design was read from a folder, which has its page and its numbers.",
        f"expected a design that was made here, got {evidence.summary()}",
        "design.save(folder), which writes the same report",
    )


def comparison_files(
    comparison: Comparison | WorkspaceComparison,
    command: Sequence[str],
    warnings: Sequence[str] = (),
    beside: Sequence[str] = (),
    verdict: DesignVerdict = UNKNOWN,
) -> dict[str, str | bytes]:
    """Files of a report: index.html, comparison.json, and at a pose every run of the nominal robot, in a folder for
    each law; parameters as for `design_files`, and the verdict on the design."""
    if isinstance(comparison, WorkspaceComparison):
        files = {"comparison.json": to_json(laws_numbers(comparison))}
        return {"index.html": laws_page(comparison, command, warnings, (*files, *beside)).html(), **files}
    saved = {
        f"runs/{row.name}/{name}.{ENDING}": response.run.save
        for row in comparison.compared
        if row.evaluation is not None
        for name, response in _responses(row.evaluation).items()
    }
    numbers = comparison_numbers(comparison, verdict)
    with saved_files(saved) as contents:
        files = {"comparison.json": to_json(numbers), **contents()}
    page = comparison_page(comparison, command, warnings, (*files, *beside), verdict)
    return {"index.html": page.html(), **files}


def write_report(result: Design | Comparison | WorkspaceComparison, folder: str | Path) -> Path:
    """Write the report of a design or a comparison into a folder, which is returned; raises as `report.write`.

    Beside a design stands its design file, where the robot is of the catalogue or of a file that states its numbers.
    """
    if isinstance(result, Comparison | WorkspaceComparison):
        return write(folder, comparison_files(result, ()))
    own, origins = _design_file(result, folder)
    evidence = result.evidence
    read = evidence.files if isinstance(evidence, StoredReport) else None
    files = design_files(result, (), beside=tuple(own)) if read is None else read
    return write(folder, {**files, **own}, origins)


def _design_file(design: Design, folder: str | Path) -> tuple[dict[str, str | bytes], dict[str, str]]:
    """The design file of a design that was made or read in Python, with the robot's file where its numbers were
    changed, and digests of the robot's files; empty for a robot or a penalty that no file states."""
    robot, files, evidence = design.robot, dict[str, str | bytes](), design.evidence
    if robot.file is None:
        return files, {}
    names = {path: name for name, path in catalogue().items()}
    request = design_file.DesignRequest(robot, design.specification, names.get(robot.file, str(robot.file)))
    if isinstance(evidence, StoredReport):
        request = evidence.request
    with suppress(InvalidInput):
        origins = design_file.robot_digests(request.source, request.elastic, folder)
        if load_robot(request.source, request.elastic, payload=request.payload) != robot:
            text = robot_text(robot, Path(folder))
            files[ROBOT_FILE] = text
            origins |= {ROBOT_FILE: sha256(text.encode("utf-8")).hexdigest()}
            request = design_file.DesignRequest(robot, design.specification, str(Path(folder) / ROBOT_FILE))
        return {**files, design_file.DESIGN_FILE: design_text(design, request, folder)}, origins
    return {}, {}


def details(design: Design) -> tuple[list[Terminal], list[str], str]:
    """Every table, note and sentence of a design for a terminal."""
    evidence = _evidence_of(design)
    if isinstance(evidence, WorkspaceEvidence):
        return [every_requirement(evidence).terminal()], [], workspace_verdict(evidence)
    return design_tables(evidence), notes(evidence), verdict(evidence)


def ending(design: Design, advice: Advice | None = None) -> Ending:
    """What a terminal says of a design at the end, with what was tried after one for a workspace."""
    evidence = _evidence_of(design)
    if isinstance(evidence, WorkspaceEvidence):
        return workspace_ending(evidence, advice)
    return design_ending(evidence)


def design_text(design: Design, request: design_file.DesignRequest, folder: str | Path = ".") -> str:
    """Text of the design file of a design: the request, and the result.

    `request`: where the robot came from, and its payload.
    `folder`: of the file; its paths are relative to it.

    InvalidInput if the penalty is code.
    """
    document = design_file.request_document(
        design.specification,
        request.source,
        request.elastic,
        folder,
        request.payload,
        design.robot.links.slides,
    )
    document.add(tomlkit.nl())
    document.add(tomlkit.comment("What came of it. This part is not read: changing it changes nothing."))
    table = {**_result_of(design), "specification": [result_row(line) for line in design.requirements]}
    document.add("result", design_file.toml_table({k: v for k, v in table.items() if v is not None}))
    return tomlkit.dumps(document)


def _result_of(design: Design) -> dict[str, object]:
    evidence = design.evidence
    if isinstance(evidence, StoredReport):
        return dict(evidence.result)
    evidence = _evidence_of(design)
    if isinstance(evidence, WorkspaceEvidence):
        return {"verdict": workspace_verdict(evidence), "met": design.met}
    return _result(evidence)


# Numbers ------------------------------------------------------------------------------------------------
def _result(design: PoseEvidence) -> dict[str, object]:
    problem, evaluation = design.design_problem, design.evaluation
    samples, margins = evaluation.step_samples, evaluation.margins
    weights = (
        None if callable(problem.penalty.states) else design_file.plain("penalty", problem.penalty.states)
    )
    if isinstance(weights, list):  # by name
        entries = cast("list[object]", weights)
        rows = bool(entries) and isinstance(entries[0], list)
        weights = {"rows": entries} if rows else dict(zip(design.problem.state_names, entries))
    return {
        "verdict": verdict(design),
        **_picked(design, "met preset=design_problem.preset goal start gamma_star gamma"),
        "degrees": [choice.degree for choice in design.choices],
        **_picked(design, "degree=chosen.degree bandwidth=evaluation.margins.bandwidth"),
        "damping": margins.damping if np.isfinite(margins.damping) else None,
        "draws": 0 if samples is None else len(samples),
        **_picked(
            design, "rays=synthesis.rays duration=scenario.step_duration weights_from=design_problem.source"
        ),
        "R2": np.asarray(problem.penalty.effort, dtype=float),
        "R2_from": problem.effort_source,
        "weights": weights,
        "robust": None if problem.robustness is None else asdict(problem.robustness),
        "estimator_noise": _picked(
            design.setup.process_noise, "all_states link_velocities motor_velocities from=source"
        ),
        "margins": _picked(margins, "delay_margin=delay_margin_s peak_sensitivity gain_margin"),
    }


def _picked(value: object, keys: str) -> dict[str, object]:
    """Collect attributes of an object by the names in `keys`; ``key=path`` for another key or a nested attribute."""
    return {
        key: attrgetter(path or key)(value) for key, _, path in (word.partition("=") for word in keys.split())
    }


#: What the files have of an object, for `_picked`.
MODE = "name joint damping frequency_Hz=frequency real=eigenvalue.real imaginary=eigenvalue.imag"
MARGINS = """stable delay_margin_s delay_frequency peak_sensitivity sensitivity_frequency peak_complementary
    complementary_frequency disk_margin disk_frequency noise_to_input peak_noise_to_input bandwidth damping
    damping_frequency"""
NOISE = """motor_velocities=levels.motor_velocities link_velocities=levels.link_velocities peak_sensitivity gain_margin
    damping compliance input_noise noises missed unstable_corners=unstable"""
SAMPLES = (
    "diverged unsettled worst slowest overshoot_percent=overshoot settling_time_s=settling peak_input=peak"
)
BUDGET = """part=name added spent=budget.total start=budget.start level=budget.level left=budget.left
    kept=budget.kept"""
RUN = "diverged_at_s=diverged_at joints=metrics"
LOADED_RUN = "diverged_at_s=response.diverged_at joints=metrics"


def design_numbers(design: PoseEvidence) -> dict[str, object]:
    """Numbers of design.json."""
    e, s, attained, limit_cycle = (
        design.evaluation,
        design.specification,
        design.attenuation.attained,
        design.limit_cycle,
    )
    estimator, along, ring_down = design.setup.estimator(design.start), design.synthesis.along, e.ring_down
    modes = {"open": e.open_modes, "closed": design.law_modes, "estimator": e.estimator_modes}
    response, inputs, samples = e.frequency_response, input_rows(design), e.step_samples
    numbers = {
        "version": 1,
        **_picked(design, "robot=robot.name joints=robot.joint_names"),
        "verdict": verdict(design),
        "met": design.met,
        "status": _picked(design.status, "not_met not_proved risky"),
        "specification": _requirements(design.requirements),
        "notes": notes(design),
        **_picked(design, "gamma_star gamma degree=chosen.degree states=problem.state_names"),
        **_picked(design.problem, "operating_point operating_input"),
        "inputs": {row["what"]: row["value"] for row in inputs},
        "input_joints": {row["what"]: row["joint"] for row in inputs},
        "weights": _weights(design),
        "estimator_noise": None if s.estimator == "none" else _estimator_noise(design),
        **{f"{name}_modes": [_picked(mode, MODE) for mode in each] for name, each in modes.items()},
        "margins": _margins(e.margins),
        "state_margins": _margins(e.state_margins),
        "frequency_response": {
            "frequencies": response.frequencies,
            "command": np.abs(np.diagonal(response.command, axis1=1, axis2=2)).T,
            "sensitivity": np.linalg.norm(response.sensitivity, 2, axis=(1, 2)),
            "complementary": np.linalg.norm(response.complementary, 2, axis=(1, 2)),
            "poles_real": np.real(response.linear.closed_loop.poles),
            "poles_imaginary": np.imag(response.linear.closed_loop.poles),
        },
        "noise_at_the_inputs": e.input_noises,
        "corners": None if e.corners is None else corner_rows(e),
        "attained": attained and _picked(attained, "gain energy largest_value"),
        "budget": [_picked(term, BUDGET) for term in budget_of(design)],
        "degrees": [
            _picked(choice, "degree level limit acting cost missed step=step_amplitude")
            for choice in design.choices
        ],
        "starts_inside": design.inside,
        "proof": proof_numbers(design),
        "step": {
            **_picked(design, "start goal duration_s=scenario.step_duration"),
            **_picked(e.step, RUN),
            "motion": e.step_motion,
        },
        "mujoco": None if design.mujoco is None else design.mujoco.metrics,
        "draws": None
        if samples is None or not len(samples)
        else {
            "count": len(samples),
            **_picked(samples, SAMPLES),
            "worst_values": dict(samples.values[samples.worst]),
            "slowest_values": dict(samples.values[samples.slowest]),
        },
        "ring_down": {
            "damping": ring_down.damping,
            "diverged": ring_down.ring_down is None,
            "fit_error": ring_down.ring_down and ring_down.ring_down.error,
            "joints": ring_down_rows(ring_down),
        },
        "load": _picked(e.load_response, f"at_s=at {LOADED_RUN}"),
        "move": {**_picked(e.move, f"duration_s=plan.duration {LOADED_RUN}"), "motion": e.move.motion},
        "payload": [
            {
                "masses_kg": dict(payload.masses),
                "step": _picked(payload.step, RUN),
                "gripped": payload.load_step and _picked(payload.load_step, LOADED_RUN),
                "margins": _margins(payload.margins),
                "weighed_kg": payload.weighed and payload.weighed.masses,
                "hidden_by_friction_kg": payload.weighed and payload.weighed.hidden,
            }
            for payload in design.payloads
        ],
        "rest": limit_cycle
        and {
            **_picked(limit_cycle, "extras limit dead_zone"),
            "hunts": bool(limit_cycle.oscillating),
            "amplitudes_without_dead_zone": None
            if limit_cycle.without is None
            else limit_cycle.without.amplitudes,
            "duration_s": float(limit_cycle.response.run.time[-1]),
            "diverged_at_s": limit_cycle.response.diverged_at,
            "joints": long_run_rows(limit_cycle),
        },
        "along_move": along
        and [
            {"time_s": float(time), "pose": pose, "law": law, **_picked(margins, f"stable {' '.join(ALONG)}")}
            for time, pose, law, margins in zip(along.times, along.poses, along.laws, along.margins)
        ],
        "rigid": [
            {
                **_picked(loop, "side stable"),
                "modes": [_picked(mode, MODE) for mode in loop.modes],
                **_picked(loop.response, RUN),
            }
            for loop in (design.rigid.loops if design.rigid else ())
        ],
        "noise_variances": design.setup.noise_variances,
        "initial_variance": None if estimator is None else np.diag(estimator.initial.covariance),
    }
    return finite(numbers)


def _requirements(lines: Iterable[Requirement]) -> list[dict[str, object]]:
    keys = "what found unit at_most where met within_tolerance asked=limit at_s=at"
    return [
        {**_picked(x, keys), **requirement_numbers(x), "asked_for": x.stated_by not in ("default", ROBOT)}
        for x in lines
    ]


def _margins(m: Margins) -> dict[str, object]:
    pairs = m.gain_margins
    return {**_picked(m, MARGINS), "gain_margins": pairs[0] if len(pairs) == 1 else pairs}


def _weights(design: PoseEvidence) -> dict[str, object]:
    problem, whole = design.design_problem, design.synthesis.robust
    search, target, r = problem.search, problem.target, problem.robustness
    tried = """damping_weights target_frequency bandwidth=behaviour.bandwidth damping=behaviour.damping
        nominal_damping=behaviour.nominal_damping gamma_star"""
    return {
        **_picked(problem, "preset source"),
        "states": {
            name: weight for name, weight, _ in state_weights(design.problem, design.robot.joint_names)
        },
        "effort": design.problem.r2,
        "wanted": target and _picked(target, "bandwidth damping"),
        "tries": [
            {**_picked(c, tried), "used": search is not None and c is search.chosen}
            for c in (search.candidates if search else ())
        ],
        "robust": r and {**vars(r), "share": r.fraction},
        "whole_loop": (
            whole
            and {
                **_picked(whole, "better count corner frequency damping links motors fraction"),
                "figures": [{"what": w, "damped": d, "robust": r} for w, _, d, r in whole_loop_rows(whole)],
            }
        ),
    }


def _estimator_noise(design: PoseEvidence) -> dict[str, object]:
    search, tried = design.synthesis.noise_search, []
    if search is not None:
        tried = sorted(
            [*(candidate for candidate in search.trade_off if not is_used(search, candidate)), search.chosen],
            key=lambda candidate: candidate.input_noise,
        )
    return {
        **_picked(design.setup.process_noise, "all_states link_velocities motor_velocities source"),
        "count": 0 if search is None else search.count,
        "tried": [{**_picked(c, NOISE), "used": search is not None and is_used(search, c)} for c in tried],
    }


def compared_details(comparison: Comparison | WorkspaceComparison) -> tuple[list[Terminal], list[str], str]:
    """Tables, notes and the rule of a comparison, for a terminal."""
    if isinstance(comparison, WorkspaceComparison):
        return laws_details(comparison)
    from rich.console import Console

    text = f"Criterion: {comparison.criterion.text}"
    return comparison_tables(comparison, Console().width), comparison_notes(comparison), text


def compared_ending(comparison: Comparison | WorkspaceComparison, verdict: DesignVerdict = UNKNOWN) -> Ending:
    """What a terminal says at the end of a comparison."""
    return (
        laws_ending(comparison)
        if isinstance(comparison, WorkspaceComparison)
        else comparison_ending(comparison, verdict)
    )


def comparison_numbers(comparison: Comparison, verdict: DesignVerdict = UNKNOWN) -> dict[str, object]:
    """Numbers of comparison.json; metrics by the keys of `LawEvaluation.metrics`."""
    criterion, runs = comparison.criterion, comparison.scenario
    tuned = [row.tuned for row in comparison.compared if row.tuned is not None]
    rival = best_rival(tuned)
    numbers = {
        "version": 5,
        "ranked": is_ranked(comparison),
        **_picked(comparison, "robot=robot.name joints=robot.joint_names"),
        "unit": comparison.units()["input"],
        "tune": {
            **_picked(criterion, "mode criterion=text"),
            "limits": [
                _picked(limit, "figure=metric value at_least from=origin") for limit in criterion.limits
            ],
        },
        "best_rival": None if rival is None else rival.name,
        "design": {
            **_picked(comparison.synthesis.design_problem, "preset gamma_star gamma"),
            "degree": comparison.synthesis.chosen.degree,
            "verdict": verdict.numbers,
        },
        **_picked(comparison.synthesis, "start goal"),
        **_picked(runs, "duration_s=step_duration load move_s=plan.duration"),
        "drawn": len(runs.robots),
        "seed": comparison.specification.seed,
        "laws": [_law(row) for row in comparison.rows],
        "trade_off": [
            {
                **_picked(law, "name peak_input=metrics.peak_input load_deviation=metrics.load_deviation"),
                "curve": [
                    [point.peak_input, point.load_deviation]
                    for point in pareto_front((*law.tried, law.metrics), criterion)
                ],
            }
            for law in tuned
        ],
    }
    return finite(numbers)


def _law(row: ComparedLaw) -> dict[str, object]:
    e, metrics = row.evaluation, row.metrics
    return {
        **_picked(row, "name what=kind.description"),
        "compared": e is not None,
        "failure": row.failure or ("" if e is None else e.linear_failure),
        "tuned": row.tuned and _picked(row.tuned, "cost candidates parameters sensors missed"),
        "figures": dict(metrics),
        "figure_joints": {} if e is None else {key: worst.joint for key, worst in e.worst.items()},
        "infinite": [key for key, value in metrics.items() if value is not None and np.isinf(value)],
        "needs": [] if e is None else list(e.needed_states),
        "specification": _requirements(row.requirements),
        "corners": None if e is None or e.corners is None else e.corners.count,
        "joints": e and _picked(e, "step=step.metrics load=load_response.metrics move=move.metrics"),
    }
