"""Page, numbers and texts of a design that was judged about one pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from operator import attrgetter
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from flexhinf.analysis import Margins
from flexhinf.designs import design_file
from flexhinf.designs.advice import Advice
from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.responses import Response
from flexhinf.loop import Trajectory
from flexhinf.pages.design.frequency import corner_rows
from flexhinf.pages.design.overview import lead
from flexhinf.pages.design.region import BOX_FILE, budget_of, proof_numbers
from flexhinf.pages.design.runs import MARGINS as ALONG, long_run_rows, ring_down_rows
from flexhinf.pages.design.weights import is_used, state_weights, whole_loop_rows
from flexhinf.pages.page import design_page, design_tables, input_rows, notes, verdict
from flexhinf.pages.parts import PARTS, Loop, Run
from flexhinf.pages.terminal import Ending, design_ending
from flexhinf.report import Figure, Page

if TYPE_CHECKING:
    from rich.table import Table as Terminal

    from flexhinf.pages.workspace import Pictures


@PARTS.register(PoseEvidence)
class PoseParts:
    """`DesignParts` of a law about one pose."""

    read = None

    def __init__(self, evidence: PoseEvidence) -> None:
        self._evidence = evidence

    @property
    def runs(self) -> dict[str, Trajectory]:
        """Step, load, move, impulses, and the step on another simulator's plant."""
        return {name: response.run for name, response in _responses(self._evidence).items()}

    def files(self) -> dict[str, str | bytes]:
        """Certificates of what is proved."""
        proof = self._evidence.proof
        return {
            name: certified.certificate.text()
            for name, certified in (("certificate.json", proof), (BOX_FILE, proof.box))
            if certified is not None and certified.certificate is not None
        }

    def page(
        self,
        command: Sequence[str],
        warnings: Sequence[str],
        advice: Advice | None,
        pictures: Callable[[], Pictures] | None,
    ) -> Page:
        """All sections of the law and its runs."""
        return design_page(self._evidence, command, warnings)

    def figures(self) -> Sequence[Figure]:
        """The motion of the arm, and its step."""
        return lead(self._evidence)

    def verdict(self) -> str:
        """The status and what the loop does."""
        return verdict(self._evidence)

    def notes(self) -> list[str]:
        """Those of all sections."""
        return notes(self._evidence)

    def tables(self) -> list[Terminal]:
        """Those of all sections."""
        return design_tables(self._evidence)

    def ending(self, advice: Advice | None) -> Ending:
        """What is met, the worst numbers, and what is proved."""
        return design_ending(self._evidence)

    def result(self) -> dict[str, object]:
        """The numbers of the law."""
        return _result(self._evidence)

    def loops(self) -> list[dict[str, Any]]:
        """The loop at the goal, and those at rest along the move."""
        design, along = self._evidence, self._evidence.synthesis.along
        m = design.evaluation.margins
        rows = [Loop(design.goal, "nominal", m.stable, m.damping, _margins(m))]
        for time, pose, law, one in zip(along.times, along.poses, along.laws, along.margins) if along else ():
            numbers = {"time_s": float(time), "law": law, **_picked(one, " ".join(ALONG))}
            rows.append(Loop(pose, "nominal", one.stable, one.damping, numbers))
        return [row._asdict() for row in rows]

    def run_rows(self) -> list[dict[str, Any]]:
        """The runs that are kept, with the numbers of each joint."""
        e, rows = self._evidence.evaluation, list[dict[str, Any]]()
        joints = {
            "step": _joined(e.step.metrics, e.step_motion),
            "load": e.load_response.metrics,
            "move": _joined(e.move.metrics, e.move.motion),
        }
        for name, response in _responses(self._evidence).items():
            robot = "nominal, on MuJoCo's plant" if name == "step-mujoco" else "nominal"
            rows.append(Run.of(name, robot, response, joints.get(name, response.metrics))._asdict())
        return rows

    def facts(self) -> dict[str, Any]:
        """Level, degree, weights, noise, modes, corners, region and proof."""
        return _facts(self._evidence)


def _responses(design: PoseEvidence) -> dict[str, Response]:
    e = design.evaluation
    return {
        "step": e.step,
        "load": e.load_response.response,
        "move": e.move.response,
        **{f"ring-down-{k}": run for k, run in enumerate(e.ring_down.responses, 1)},
        **({} if design.mujoco is None else {"step-mujoco": design.mujoco}),
    }


def _joined(*tables: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows of several tables of the same joints, each with the numbers of all."""
    return [{name: value for row in rows for name, value in row.items()} for rows in zip(*tables)]


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


def _facts(design: PoseEvidence) -> dict[str, Any]:
    """What a nonlinear H∞ law knows of itself, and of its runs beyond the numbers of their joints."""
    e, s, attained, limit_cycle = (
        design.evaluation,
        design.specification,
        design.attenuation.attained,
        design.limit_cycle,
    )
    estimator, ring_down = design.setup.estimator(design.start), e.ring_down
    modes = {"open": e.open_modes, "closed": design.law_modes, "estimator": e.estimator_modes}
    response, inputs, samples = e.frequency_response, input_rows(design), e.step_samples
    return {
        "status": _picked(design.status, "not_met not_proved risky"),
        **_picked(design, "gamma_star gamma degree=chosen.degree states=problem.state_names"),
        **_picked(design.problem, "operating_point operating_input"),
        "inputs": {row["what"]: row["value"] for row in inputs},
        "input_joints": {row["what"]: row["joint"] for row in inputs},
        "weights": _weights(design),
        "estimator_noise": None if s.estimator == "none" else _estimator_noise(design),
        **{f"{name}_modes": [_picked(mode, MODE) for mode in each] for name, each in modes.items()},
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
        "load_at_s": e.load_response.at,
        "degrees": [
            _picked(choice, "degree level limit acting cost missed step=step_amplitude")
            for choice in design.choices
        ],
        "starts_inside": design.inside,
        "proof": proof_numbers(design),
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
        "noise_variances": design.setup.noise_variances,
        "initial_variance": None if estimator is None else np.diag(estimator.initial.covariance),
    }


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
