"""What design.json and comparison.json hold: the numbers of a report in SI units; what has no number is null."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.analysis import FrequencyResponse, Margins
from flexhinf.design.estimators import noise_variances
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.modes import Mode
from flexhinf.design.report.formatting import finite
from flexhinf.design.report.page import notes, verdict
from flexhinf.design.report.sections.corners import corner_rows
from flexhinf.design.report.sections.region import budget_rows
from flexhinf.design.report.sections.requirements import input_rows
from flexhinf.design.report.sections.weights import state_weights
from flexhinf.design.requirements import Requirement
from flexhinf.design.result import ComparedLaw, Comparison, Design
from flexhinf.design.tuning import TradeOff, best_rival, trade_offs

__all__ = ["comparison_numbers", "design_numbers"]


def design_numbers(design: Design) -> dict[str, Any]:
    """Of one design."""
    e, status = design.evaluation, design.status
    found = {
        "version": 1,
        "robot": design.robot.name,
        "joints": list(design.robot.joint_names),
        "verdict": verdict(design),
        "met": design.met,
        "status": {"not_met": status.not_met, "not_proved": status.not_proved, "risky": status.risky},
        "specification": [_requirement(line) for line in design.requirements],
        "notes": notes(design),
        "gamma_star": design.gamma_star,
        "gamma": design.gamma,
        "degree": design.chosen.degree,
        "states": list(design.problem.state_names),
        "operating_point": design.problem.operating_point,
        "operating_input": design.problem.operating_input,
        "inputs": {row.what: row.value for row in input_rows(design)},
        "weights": _weights(design),
        "estimator_noise": _estimator_noise(design),
        "open_modes": [_mode(m) for m in e.open_modes],
        "closed_modes": [_mode(m) for m in design.law_modes],
        "estimator_modes": [_mode(m) for m in e.estimator_modes],
        "margins": _margins(e.margins),
        "state_margins": _margins(e.state_margins),
        "frequency_response": _frequency_response(e.frequency_response),
        "noise_at_the_inputs": e.input_noises,
        "corners": None if e.corners is None else _corners(e),
        "attained": _attained(design),
        "budget": budget_rows(design),
        "degrees": [
            {"degree": c.degree, "level": c.level, "step": c.step_amplitude, "limit": c.limit}
            for c in design.choices
        ],
        "starts_inside": design.inside,
        **_runs(design),
        "noise_variances": noise_variances(design.problem.plant, design.specification.measurement_noise),
        "initial_variance": _initial_variance(design),
    }
    return finite(found)


def comparison_numbers(comparison: Comparison) -> dict[str, Any]:
    """Of one comparison; figures by the keys of `LawEvaluation.metrics`."""
    own, criterion, problem = (
        comparison.own.evaluation,
        comparison.criterion,
        comparison.synthesis.design_problem,
    )
    assert own is not None
    runs = own.scenario
    assert runs is not None
    tuned = [row.tuned for row in comparison.compared if row.tuned is not None]
    rival = best_rival(tuned)
    found = {
        "version": 2,
        "robot": comparison.robot.name,
        "joints": list(comparison.robot.joint_names),
        "unit": comparison.units()["input"],
        "tune": {
            "mode": criterion.mode,
            "criterion": criterion.text,
            "limits": [
                {"figure": x.figure, "value": x.value, "at_least": x.least, "from": x.origin}
                for x in criterion.limits
            ],
        },
        "best_rival": None if rival is None else rival.name,
        "design": {
            "preset": problem.preset,
            "gamma_star": problem.gamma_star,
            "gamma": problem.gamma,
            "degree": comparison.synthesis.chosen.degree,
        },
        "start": own.setup.start,
        "goal": own.setup.goal,
        "duration_s": runs.step_duration,
        "load": runs.load,
        "move_s": float(runs.plan.duration),
        "drawn": len(runs.robots),
        "seed": comparison.specification.seed,
        "laws": [_law(row) for row in comparison.rows],
        "trade_off": [_trade_off(one) for one in trade_offs(tuned, criterion)],
    }
    return finite(found)


# Parts ---------------------------------------------------------------------------------------------------
def _requirement(line: Requirement) -> dict[str, Any]:
    return {
        "what": line.what,
        "asked": line.limit,
        "found": line.found,
        "unit": line.unit,
        "at_most": line.at_most,
        "where": line.where,
        "criterion": line.criterion,
        "stated_by": line.stated_by,
        "joint": line.joint,
        "asked_for": line.stated_by != "default",
        "met": line.met,
    }


def _mode(m: Mode) -> dict[str, Any]:
    return {
        "name": m.name,
        "joint": m.joint,
        "frequency_Hz": m.frequency,
        "damping": m.damping,
        "real": m.eigenvalue.real,
        "imaginary": m.eigenvalue.imag,
    }


def _weights(design: Design) -> dict[str, Any]:
    problem = design.design_problem
    search, target, r = problem.search, problem.target, problem.robustness
    return {
        "preset": problem.preset,
        "source": problem.source,
        "states": {w.signal: w.value for w in state_weights(design.problem, design.robot.joint_names)},
        "effort": design.problem.r2,
        "wanted": None if target is None else {"bandwidth": target.bandwidth, "damping": target.damping},
        "tries": [
            {
                "damping_weight": c.damping_weight,
                "target_frequency": c.target_frequency,
                "bandwidth": c.behaviour.bandwidth,
                "damping": c.behaviour.damping,
                "nominal_damping": c.behaviour.nominal_damping,
                "gamma_star": c.design.gamma_star,
                "used": search is not None and c is search.chosen,
            }
            for c in (() if search is None else search.candidates)
        ],
        "robust": None if r is None else {**vars(r), "share": r.fraction},
    }


def _estimator_noise(design: Design) -> dict[str, Any] | None:
    """R^v in use, and what the search tried; None without an estimator."""
    if design.specification.estimator == "none":
        return None
    noise, search = design.setup.process_noise, design.noise_search
    return {
        "all_states": noise.all_states,
        "link_velocities": noise.link_velocities,
        "motor_velocities": noise.motor_velocities,
        "source": noise.source,
        "unreachable_limits": [] if search is None else list(search.unreachable),
        "tried": [
            {
                "motor_velocities": one.levels.motor_velocities,
                "link_velocities": one.levels.link_velocities,
                "peak_sensitivity": one.peak_sensitivity,
                "gain_margin": one.gain_margin,
                "damping": one.damping,
                "compliance": one.compliance,
                "input_noise": one.input_noise,
                "unstable_corners": one.unstable,
                "used": one is search.chosen,
            }
            for one in search.candidates
        ]
        if search is not None
        else [],
    }


def _margins(m: Margins) -> dict[str, Any]:
    pairs = m.gain_margins
    return {
        "stable": m.stable,
        "delay_margin_s": m.delay_margin_s,
        "delay_frequency": m.delay_frequency,
        "peak_sensitivity": m.peak_sensitivity,
        "sensitivity_frequency": m.sensitivity_frequency,
        "peak_complementary": m.peak_complementary,
        "complementary_frequency": m.complementary_frequency,
        "disk_margin": m.disk_margin,
        "disk_frequency": m.disk_frequency,
        "noise_to_input": m.noise_to_input,
        "peak_noise_to_input": m.peak_noise_to_input,
        "bandwidth": m.bandwidth,
        "damping": m.damping,
        "damping_frequency": m.damping_frequency,
        "gain_margins": pairs[0] if len(pairs) == 1 else pairs,
    }


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


def _corners(e: LawEvaluation) -> list[dict[str, Any]]:
    return [row._asdict() for row in corner_rows(e)]


def _attained(design: Design) -> dict[str, Any] | None:
    found = design.attenuation.attained
    if found is None:
        return None
    return {"gain": found.gain, "energy": found.energy, "largest_value": found.largest_value}


def _runs(design: Design) -> dict[str, Any]:
    e = design.evaluation
    load, move = e.load_response, e.move
    return {
        "step": {
            "start": design.start,
            "goal": design.goal,
            "duration_s": design.scenario.step_duration,
            "diverged_at_s": e.step.diverged_at,
            "joints": e.step.metrics,
        },
        "mujoco": None if design.mujoco is None else design.mujoco.metrics,
        "draws": _samples(e),
        "load": {"at_s": load.at, "diverged_at_s": load.response.diverged_at, "joints": load.metrics},
        "move": {
            "duration_s": move.plan.duration,
            "diverged_at_s": move.response.diverged_at,
            "joints": move.metrics,
        },
        "rigid": [
            {
                "side": loop.side,
                "stable": loop.stable,
                "modes": [_mode(m) for m in loop.modes],
                "diverged_at_s": loop.response.diverged_at,
                "joints": loop.response.metrics,
            }
            for loop in (design.rigid.loops if design.rigid else ())
        ],
    }


def _samples(e: LawEvaluation) -> dict[str, Any] | None:
    samples = e.step_samples
    if samples is None or not len(samples):
        return None
    return {
        "count": len(samples),
        "diverged": samples.diverged,
        "unsettled": samples.unsettled,
        "overshoot_percent": samples.overshoot,
        "settling_time_s": samples.settling,
        "peak_input": samples.peak,
        "worst": samples.worst,
        "worst_values": {name: np.asarray(value) for name, value in samples.values[samples.worst].items()},
        "slowest": samples.slowest,
        "slowest_values": {
            name: np.asarray(value) for name, value in samples.values[samples.slowest].items()
        },
    }


def _initial_variance(design: Design) -> list[float] | None:
    """Diagonal of P0, one entry for each state of the estimator; None without one."""
    estimator = design.setup.estimator(design.start)
    return None if estimator is None else np.diag(estimator.initial.covariance).tolist()


def _law(row: ComparedLaw) -> dict[str, Any]:
    e, tuned = row.evaluation, row.tuned
    figures = row.metrics
    return {
        "name": row.name,
        "what": row.kind.description,
        "compared": e is not None,
        "failure": row.failure or ("" if e is None else e.linear_failure),
        "tuned": None
        if tuned is None
        else {
            "parameters": dict(tuned.parameters),
            "cost": tuned.cost,
            "met": tuned.feasible,
            "reason": tuned.reason,
            "candidates": tuned.candidates,
            "sensors": list(tuned.sensors),
        },
        "figures": dict(figures),
        "infinite": [key for key, value in figures.items() if value is not None and np.isinf(value)],
        "needs": [] if e is None else list(e.needed_states),
        "specification": [_requirement(line) for line in row.requirements],
        "corners": None if e is None or e.corners is None else e.corners.count,
        "joints": None if e is None else _joints(e, figures),
    }


def _joints(
    e: LawEvaluation, figures: Mapping[str, float | None]
) -> dict[str, Sequence[Mapping[str, Any]] | None]:
    """Figures of each joint."""
    bumpless = figures.get("step_peak_input") is not None
    return {
        "step": e.step.metrics if bumpless else None,
        "jump": e.jump.metrics,
        "load": e.load_response.metrics,
        "move": e.move.metrics,
    }


def _trade_off(one: TradeOff) -> dict[str, Any]:
    return {
        "name": one.name,
        "feasible": one.feasible,
        "peak_input": one.point.peak_input,
        "load_deviation": one.point.load_deviation,
        "curve": [[figures.peak_input, figures.load_deviation] for figures in one.curve],
    }
