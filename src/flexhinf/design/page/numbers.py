"""What ``design.json`` holds: the numbers of a report; what is not finite is None."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.analysis import Margins
from flexhinf.design.estimator import noise_variances
from flexhinf.design.met import Met
from flexhinf.design.modes import Mode
from flexhinf.design.page.asked import cost_rows
from flexhinf.design.page.corners import sweep_rows
from flexhinf.design.page.drawn import worst_draw
from flexhinf.design.page.guarantee import budget_rows
from flexhinf.design.page.notes import noise_volts, notes
from flexhinf.design.page.weights_of import state_weights
from flexhinf.design.page.words import verdict
from flexhinf.design.result import Design

__all__ = ["finite", "numbers_of"]


def numbers_of(design: Design) -> dict[str, Any]:
    """Of one design."""
    x, u = design.problem.operating_point, design.problem.operating_input
    found = {
        "version": 1,
        "robot": design.robot.name,
        "joints": list(design.robot.joint_names),
        "verdict": verdict(design),
        "met": all(line.holds for line in design.met),
        "specification": [_line(line) for line in design.met],
        "notes": notes(design),
        "gamma_star": design.gamma_star,
        "gamma": design.solution.gamma,
        "degree": design.chosen.degree,
        "states": list(design.problem.state_names),
        "operating_point": [float(value) for value in x],
        "operating_input": [float(value) for value in u],
        "inputs": {cost.what: cost.value for cost in cost_rows(design)},
        "weights": _weights(design),
        "open_modes": [_mode(m) for m in design.open_modes],
        "closed_modes": [_mode(m) for m in design.closed_modes],
        "estimator_modes": [_mode(m) for m in design.estimator_modes],
        "margins": _margins(design.margins),
        "state_margins": _margins(design.state_margins),
        "noise_at_the_inputs": noise_volts(design),
        "corners": None if design.tolerances is None else [row._asdict() for row in sweep_rows(design)],
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


def _initial_variance(design: Design) -> list[float] | None:
    """Diagonal of P0, one per state of the estimator; None without one."""
    estimator = design.bench.estimator(design.start)
    return None if estimator is None else np.diag(estimator.initial.covariance).tolist()


def finite(value: Any) -> Any:
    """The same with plain lists and numbers, None for what is not finite."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def _line(line: Met) -> dict[str, Any]:
    return {
        "what": line.what,
        "asked": line.asked,
        "found": line.found,
        "unit": line.unit,
        "at_most": line.at_most,
        "where": line.where,
        "asked_for": line.asked_for,
        "met": line.holds,
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
    game = design.game
    tries = () if game.found is None else game.found.tries
    return {
        "preset": game.preset,
        "source": game.source,
        "states": {weight.signal: weight.value for weight in state_weights(design)},
        "effort": design.problem.r2,
        "wanted": None
        if game.wanted is None
        else {"bandwidth": game.wanted.bandwidth, "damping": game.wanted.damping},
        "tries": [
            {
                "dial": t.knob,
                "pace": t.pace,
                "bandwidth": t.behaviour.bandwidth,
                "damping": t.behaviour.damping,
                "nominal_damping": t.behaviour.nominal_damping,
                "gamma_star": t.design.gamma_star,
                "used": game.found is not None and t is game.found.chosen,
            }
            for t in tries
        ],
        "robust": None if game.robustness is None else vars(game.robustness),
    }


def _margins(m: Margins) -> dict[str, Any]:
    return {
        "stable": m.stable,
        "delay_margin_s": m.delay_margin_s,
        "delay_frequency": m.delay_frequency,
        "peak_sensitivity": m.peak_sensitivity,
        "sensitivity_frequency": m.sensitivity_frequency,
        "noise_to_input": m.noise_to_input,
        "peak_noise_to_input": m.peak_noise_to_input,
        "bandwidth": m.bandwidth,
        "gain_margins": m.gain_margins,
    }


def _attained(design: Design) -> dict[str, Any] | None:
    found = design.guarantee.attained
    if found is None:
        return None
    return {"gain": found.gain, "energy": found.energy, "largest_value": found.largest_value}


def _runs(design: Design) -> dict[str, Any]:
    load, move = design.disturbed, design.move
    return {
        "step": {
            "start": design.start,
            "goal": design.goal,
            "duration_s": design.duration,
            "diverged_at_s": design.response.diverged,
            "joints": design.response.metrics,
        },
        "mujoco": None if design.mujoco is None else design.mujoco.metrics,
        "draws": _draws(design),
        "load": {"at_s": load.at, "diverged_at_s": load.response.diverged, "joints": load.metrics},
        "move": {
            "duration_s": move.plan.duration,
            "diverged_at_s": move.response.diverged,
            "joints": move.metrics,
        },
        "rigid": _rigid(design),
    }


def _draws(design: Design) -> dict[str, Any] | None:
    draws = design.draws
    if draws is None or not len(draws):
        return None
    return {
        "count": len(draws),
        "diverged": draws.diverged,
        "unsettled": draws.unsettled,
        "overshoot_percent": draws.overshoot,
        "settling_time_s": draws.settling,
        "peak_input": draws.peak,
        "worst": worst_draw(draws),
        "worst_values": {name: np.asarray(value) for name, value in draws.values[worst_draw(draws)].items()},
    }


def _rigid(design: Design) -> Sequence[dict[str, Any]]:
    return [
        {
            "side": loop.side,
            "stable": loop.stable,
            "modes": [_mode(m) for m in loop.modes],
            "diverged_at_s": loop.response.diverged,
            "joints": loop.response.metrics,
        }
        for loop in (design.rigid.loops if design.rigid else ())
    ]
