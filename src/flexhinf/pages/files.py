"""The files of a report: page, numbers (in SI units; what has no number is null), controller and every run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from flexhinf.analysis import FrequencyResponse, Margins
from flexhinf.design.estimators import noise_variances
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.joint_limits import ROBOT
from flexhinf.design.payload import PayloadEvaluation
from flexhinf.design.problem.modes import Mode
from flexhinf.design.requirements import Requirement
from flexhinf.design.responses import Response
from flexhinf.design.result import ComparedLaw, Comparison, Design
from flexhinf.design.tuning import best_rival, trade_offs
from flexhinf.errors import InvalidInput
from flexhinf.pages.comparison import comparison_page
from flexhinf.pages.design.frequency import corner_rows
from flexhinf.pages.design.region import budget_rows
from flexhinf.pages.design.requirements import input_rows
from flexhinf.pages.design.runs import along_rows, long_run_rows, ring_down_rows
from flexhinf.pages.design.weights import is_used, state_weights, whole_loop_rows
from flexhinf.pages.drawing import finite
from flexhinf.pages.page import design_page, notes, verdict
from flexhinf.pages.proof import BOX_FILE, proof_numbers
from flexhinf.report import to_json, write

#: Runs are NetCDF files: a fifth of the size of text, with units.
ENDING = "nc"


def design_files(
    design: Design, command: Sequence[str], warnings: Sequence[str] = (), beside: Sequence[str] = ()
) -> dict[str, str | bytes]:
    """index.html, design.json, the controller, every run of the nominal robot, and a proof as certificate.json.

    Parameters
    ----------
    command : sequence of str
        That makes the report again; empty for a report that is written from Python.
    warnings : sequence of str
        Of the robot's file.
    beside : sequence of str
        Names of files that the caller writes into the same folder: the page lists them.
    """
    runs = _responses(design.evaluation)
    runs |= {f"ring-down-{k + 1}": one for k, one in enumerate(design.evaluation.ring_down.responses)}
    if design.mujoco is not None:
        runs["step-mujoco"] = design.mujoco
    saved = {"controller": design.controller().save}
    saved |= {f"runs/{name}.{ENDING}": response.run.save for name, response in runs.items()}
    files: dict[str, str | bytes] = {"design.json": to_json(design_numbers(design)), **_saved(saved)}
    if design.proof.certificate is not None:
        files["certificate.json"] = design.proof.certificate.text()
    if design.proof.box is not None and design.proof.box.certificate is not None:
        files[BOX_FILE] = design.proof.box.certificate.text()
    return {"index.html": design_page(design, command, warnings, (*files, *beside)).html(), **files}


def comparison_files(
    comparison: Comparison, command: Sequence[str], warnings: Sequence[str] = (), beside: Sequence[str] = ()
) -> dict[str, str | bytes]:
    """index.html, comparison.json, and every run of the nominal robot, in a folder for each law; parameters as for
    `design_files`."""
    saved = {
        f"runs/{row.name}/{name}.{ENDING}": response.run.save
        for row in comparison.compared
        if row.evaluation is not None
        for name, response in _responses(row.evaluation).items()
    }
    files = {"comparison.json": to_json(comparison_numbers(comparison)), **_saved(saved)}
    return {"index.html": comparison_page(comparison, command, warnings, (*files, *beside)).html(), **files}


def write_design(design: Design, folder: str | Path) -> Path:
    """Write the report of a design into a folder, which is returned; raises as `flexhinf.report.write`."""
    return write(folder, design_files(design, ()))


def write_comparison(comparison: Comparison, folder: str | Path) -> Path:
    """Write the report of a comparison into a folder, which is returned; raises as `flexhinf.report.write`."""
    return write(folder, comparison_files(comparison, ()))


def _responses(e: LawEvaluation) -> dict[str, Response]:
    return {"step": e.step, "load": e.load_response.response, "move": e.move.response}


def _saved(files: Mapping[str, Callable[[Path], object]]) -> dict[str, str | bytes]:
    """What each function writes; what cannot be written, as the controller of a law that is code, is left out."""
    found: dict[str, str | bytes] = {}
    with TemporaryDirectory() as folder:
        for name, save in files.items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                save(path)
            except InvalidInput:
                continue
            found[name] = path.read_bytes()
    return found


def design_numbers(design: Design) -> dict[str, Any]:
    """Of one design."""
    e, status, attained, rest = design.evaluation, design.status, design.attenuation.attained, design.rest
    s, estimator, along, ring_down = (
        design.specification,
        design.setup.estimator(design.start),
        design.synthesis.along,
        e.ring_down,
    )
    modes = {"open": e.open_modes, "closed": design.law_modes, "estimator": e.estimator_modes}
    inputs = input_rows(design)
    found = {
        "version": 1,
        "robot": design.robot.name,
        "joints": list(design.robot.joint_names),
        "verdict": verdict(design),
        "met": design.met,
        "status": _picked(status, "not_met", "not_proved", "risky"),
        "specification": [_requirement(line) for line in design.requirements],
        "notes": notes(design),
        **_picked(design, "gamma_star", "gamma"),
        "degree": design.chosen.degree,
        "states": list(design.problem.state_names),
        **_picked(design.problem, "operating_point", "operating_input"),
        "inputs": {row["what"]: row["value"] for row in inputs},
        "input_joints": {row["what"]: row["joint"] for row in inputs},
        "weights": _weights(design),
        "estimator_noise": None if s.estimator == "none" else _estimator_noise(design),
        **{f"{name}_modes": [_mode(m) for m in each] for name, each in modes.items()},
        "margins": _margins(e.margins),
        "state_margins": _margins(e.state_margins),
        "frequency_response": _frequency_response(e.frequency_response),
        "noise_at_the_inputs": e.input_noises,
        "corners": None if e.corners is None else corner_rows(e),
        "attained": attained and _picked(attained, "gain", "energy", "largest_value"),
        "budget": budget_rows(design),
        "degrees": [
            _picked(c, "degree", "level", "limit", "acting", "cost", "missed", step="step_amplitude")
            for c in design.choices
        ],
        "starts_inside": design.inside,
        "proof": proof_numbers(design),
        "step": {
            **_picked(design, "start", "goal"),
            "duration_s": design.scenario.step_duration,
            **_run(e.step),
        },
        "mujoco": None if design.mujoco is None else design.mujoco.metrics,
        "draws": _samples(e),
        "ring_down": {
            **_picked(ring_down, "damping", "diverged"),
            "fit_error": ring_down.ring_down and ring_down.ring_down.error,
            "joints": ring_down_rows(ring_down),
        },
        "load": {"at_s": e.load_response.at, **_run(e.load_response.response, e.load_response.metrics)},
        "move": {"duration_s": e.move.plan.duration, **_run(e.move.response, e.move.metrics)},
        "payload": [_payload(one) for one in design.payloads],
        "rest": rest
        and {
            **_picked(rest, "extras", "limit", "dead_zone", hunts="oscillates"),
            "amplitudes_without_dead_zone": None if rest.without is None else rest.without.amplitudes,
            "duration_s": float(rest.response.run.time[-1]),
            "diverged_at_s": rest.response.diverged_at,
            "joints": long_run_rows(rest),
        },
        "along_move": None if along is None else along_rows(along),
        "rigid": [
            {
                **_picked(loop, "side", "stable"),
                "modes": [_mode(m) for m in loop.modes],
                **_run(loop.response),
            }
            for loop in (design.rigid.loops if design.rigid else ())
        ],
        "noise_variances": noise_variances(design.problem.plant, s.measurement_noise),
        "initial_variance": None if estimator is None else np.diag(estimator.initial.covariance),
    }
    return finite(found)


def comparison_numbers(comparison: Comparison) -> dict[str, Any]:
    """Of one comparison; figures by the keys of `LawEvaluation.metrics`."""
    own, criterion = comparison.own.evaluation, comparison.criterion
    problem, chosen = comparison.synthesis.design_problem, comparison.synthesis.chosen
    assert own is not None
    runs = own.scenario
    assert runs is not None
    tuned = [row.tuned for row in comparison.compared if row.tuned is not None]
    rival = best_rival(tuned)
    found = {
        "version": 4,
        "robot": comparison.robot.name,
        "joints": list(comparison.robot.joint_names),
        "unit": comparison.units()["input"],
        "tune": {
            "mode": criterion.mode,
            "criterion": criterion.text,
            "limits": [
                {"figure": x.metric, "value": x.value, "at_least": x.least, "from": x.origin}
                for x in criterion.limits
            ],
        },
        "best_rival": None if rival is None else rival.name,
        "design": {**_picked(problem, "preset", "gamma_star", "gamma"), "degree": chosen.degree},
        "start": own.setup.start,
        "goal": own.setup.goal,
        "duration_s": runs.step_duration,
        "load": runs.load,
        "move_s": float(runs.plan.duration),
        "drawn": len(runs.robots),
        "seed": comparison.specification.seed,
        "laws": [_law(row) for row in comparison.rows],
        "trade_off": [
            {
                "name": one.name,
                **_picked(one.point, "peak_input", "load_deviation"),
                "curve": [[point.peak_input, point.load_deviation] for point in one.curve],
            }
            for one in trade_offs(tuned, criterion)
        ],
    }
    return finite(found)


# Parts ---------------------------------------------------------------------------------------------------
def _picked(value: Any, *names: str, **renamed: str) -> dict[str, Any]:
    """Attributes by their own names; a keyword is the key of an attribute that is called otherwise."""
    return {key: getattr(value, name) for key, name in {**{name: name for name in names}, **renamed}.items()}


def _requirement(line: Requirement) -> dict[str, Any]:
    names = (
        "what", "found", "unit", "at_most", "where", "criterion", "stated_by", "joint", "met", "within_tolerance"
    )  # fmt: skip
    stated = line.stated_by not in ("default", ROBOT)
    return {**_picked(line, *names, asked="limit", at_s="at"), "asked_for": stated}


def _mode(m: Mode) -> dict[str, Any]:
    parts = {"real": m.eigenvalue.real, "imaginary": m.eigenvalue.imag}
    return {**_picked(m, "name", "joint", "damping", frequency_Hz="frequency"), **parts}


def _weights(design: Design) -> dict[str, Any]:
    problem, whole = design.design_problem, design.synthesis.robust
    search, target, r = problem.search, problem.target, problem.robustness
    keys = ("better", "count", "corner", "frequency", "damping", "links", "motors", "fraction")
    return {
        **_picked(problem, "preset", "source"),
        "states": {w.signal: w.value for w in state_weights(design.problem, design.robot.joint_names)},
        "effort": design.problem.r2,
        "wanted": target and _picked(target, "bandwidth", "damping"),
        "tries": [
            {
                **_picked(c, "damping_weights", "target_frequency"),
                **_picked(c.behaviour, "bandwidth", "damping", "nominal_damping"),
                "gamma_star": c.design.gamma_star,
                "used": search is not None and c is search.chosen,
            }
            for c in (search.candidates if search else ())
        ],
        "robust": r and {**vars(r), "share": r.fraction},
        "whole_loop": whole
        and {
            **_picked(whole, *keys),
            "figures": [{"what": w, "damped": d, "robust": r} for w, _, d, r in whole_loop_rows(whole)],
        },
    }


def _estimator_noise(design: Design) -> dict[str, Any]:
    """Rᵛ in use; the trade-off of the search, and the levels in use where they are none of it."""
    search, tried = design.noise_search, []
    metrics = ("peak_sensitivity", "gain_margin", "damping", "compliance", "input_noise", "noises", "missed")
    if search is not None:
        others = [one for one in search.trade_off if not is_used(search, one)]
        tried = [
            {
                **_picked(one.levels, "motor_velocities", "link_velocities"),
                **_picked(one, *metrics, unstable_corners="unstable"),
                "used": is_used(search, one),
            }
            for one in sorted([*others, search.chosen], key=lambda one: one.input_noise)
        ]
    levels = _picked(
        design.setup.process_noise, "all_states", "link_velocities", "motor_velocities", "source"
    )
    return {**levels, "count": 0 if search is None else search.count, "tried": tried}


def _margins(m: Margins) -> dict[str, Any]:
    names = (
        "stable", "delay_margin_s", "delay_frequency", "peak_sensitivity", "sensitivity_frequency",
        "peak_complementary", "complementary_frequency", "disk_margin", "disk_frequency", "noise_to_input",
        "peak_noise_to_input", "bandwidth", "damping", "damping_frequency",
    )  # fmt: skip
    pairs = m.gain_margins
    return {**_picked(m, *names), "gain_margins": pairs[0] if len(pairs) == 1 else pairs}


def _frequency_response(f: FrequencyResponse) -> dict[str, Any]:
    """Magnitudes of the diagonals, largest singular values of S and T, and the poles."""
    return {
        "frequencies": f.frequencies,
        "command": np.abs(np.diagonal(f.command, axis1=1, axis2=2)).T,
        "sensitivity": np.linalg.norm(f.sensitivity, 2, axis=(1, 2)),
        "complementary": np.linalg.norm(f.complementary, 2, axis=(1, 2)),
        "poles_real": np.real(f.poles),
        "poles_imaginary": np.imag(f.poles),
    }


def _payload(one: PayloadEvaluation) -> dict[str, Any]:
    """With masses in the true robot that the model does not know."""
    return {
        "masses_kg": dict(one.masses),
        "step": _run(one.step),
        "gripped": one.load_step and _run(one.load_step.response, one.load_step.metrics),
        "margins": _margins(one.margins),
        "weighed_kg": one.weighed and one.weighed.masses,
        "hidden_by_friction_kg": one.weighed and one.weighed.hidden,
    }


def _run(response: Response, metrics: Sequence[Mapping[str, Any]] | None = None) -> dict[str, Any]:
    return {"diverged_at_s": response.diverged_at, "joints": response.metrics if metrics is None else metrics}


def _samples(e: LawEvaluation) -> dict[str, Any] | None:
    samples = e.step_samples
    if samples is None or not len(samples):
        return None
    return {
        "count": len(samples),
        **_picked(samples, "diverged", "unsettled", "worst", "slowest"),
        **_picked(samples, overshoot_percent="overshoot", settling_time_s="settling", peak_input="peak"),
        "worst_values": dict(samples.values[samples.worst]),
        "slowest_values": dict(samples.values[samples.slowest]),
    }


def _law(row: ComparedLaw) -> dict[str, Any]:
    e, tuned, metrics = row.evaluation, row.tuned, row.metrics
    return {
        "name": row.name,
        "what": row.kind.description,
        "compared": e is not None,
        "failure": row.failure or ("" if e is None else e.linear_failure),
        "tuned": tuned
        and {
            **_picked(tuned, "cost", "candidates"),
            "parameters": dict(tuned.parameters),
            "sensors": list(tuned.sensors),
        },
        "figures": dict(metrics),
        "figure_joints": {} if e is None else {key: worst.joint for key, worst in e.worst.items()},
        "infinite": [key for key, value in metrics.items() if value is not None and np.isinf(value)],
        "needs": [] if e is None else list(e.needed_states),
        "specification": [_requirement(line) for line in row.requirements],
        "corners": None if e is None or e.corners is None else e.corners.count,
        "joints": e and {"step": e.step.metrics, "load": e.load_response.metrics, "move": e.move.metrics},
    }
