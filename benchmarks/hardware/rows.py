"""One row: a design, and what its loop does. Run as a process of its own, also by an older version of flexhinf."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from flexhinf.design import Specification, design

__all__ = ["measure"]

#: Robots sampled within their tolerances in every row.
SAMPLES = 200


def measure(task: dict[str, Any]) -> dict[str, Any]:
    """Design, and measure what the loop does.

    Parameters
    ----------
    task : dict
        ``robot``, ``elastic``: files; ``options``: of the specification; ``limits``: of the motors, N·m; of rows with a
        payload also ``payload``, that of the model, and ``masses``, which the true robot carries, kg. With ``linear``
        there are only weights and noise levels, and the figures of the linear loop: minutes less.
    """
    carried_by_model = {"payload": task["payload"]} if task.get("payload") else {}
    robot = fh.load_robot(task["robot"], elastic=task["elastic"] or None, **carried_by_model)
    if task.get("linear"):
        return _linear(robot, Specification(**task["options"]), np.array(task["limits"]))
    given = {"rays": 0, "compare_rigid": False, "draws": SAMPLES, **task["options"]}
    begin = time.process_time()
    found = design(robot, Specification(**given), lambda text: print(text, file=sys.stderr, flush=True))
    seconds = time.process_time() - begin
    row = {"seconds": seconds, **_loop(found, np.array(task["limits"]))}
    if task.get("masses"):
        from benchmarks.hardware.payloads import carried

        row["carried"] = [carried(found, mass) for mass in task["masses"]]
    return row


def _loop(found: Any, limits: np.ndarray) -> dict[str, Any]:
    """Figures of the running loop, in the names of the table."""
    e = found.evaluation
    samples, lines = e.step_samples, found.requirements
    damping = [line for line in lines if line.what.startswith("damping")]
    used = np.abs(e.step.inputs) / limits
    row = _least_damped(e) | {
        "required_damping": damping[0].limit if damping else None,
        "said_damping": damping[0].found if damping else None,
        "bandwidth": float(np.min(e.margins.bandwidth)),
        "overshoot": float(samples.overshoot.max()),
        "unsettled": int(samples.unsettled),
        "samples": len(samples),
        "noise": np.asarray(e.input_noises).tolist(),
        "noise_share": float((e.input_noises / limits).max()),
        "peak_share": float(used.max()),
        "missed": list(dict.fromkeys(line.what for line in lines if not line.met)),
        "unstable_corners": None if e.corners is None else int(e.corners.unstable),
    }
    if getattr(samples, "inputs", None) is not None:
        row["sampled_peak_share"] = float((samples.inputs / limits).max())
    if getattr(found, "limit_cycle", None) is not None:
        row["hunting"] = [*map(float, found.limit_cycle.amplitudes)]
        row["hunts"] = bool(found.limit_cycle.oscillating)
        row["rest_error"] = float(found.limit_cycle.errors.max())
    return row | _reach(found.synthesis.noise_search, found.setup)


def _least_damped(evaluation: Any) -> dict[str, Any]:
    """The oscillation of the running loop that is damped least."""
    ringing = [mode for mode in evaluation.closed_loop_modes if mode.eigenvalue.imag > 0.0]
    least = min(ringing, key=lambda mode: mode.damping, default=None)
    return {
        "damping": 1.0 if least is None else least.damping,
        "damping_joint": "" if least is None else least.joint,
        "damping_hz": 0.0 if least is None else abs(least.eigenvalue) / (2.0 * np.pi),
    }


def _linear(robot: Any, s: Specification, limits: np.ndarray) -> dict[str, Any]:
    """Weights for the default behaviour, before limits of effort lower it, and the noise levels for them."""
    from flexhinf.design.evaluation import LawEvaluation
    from flexhinf.design.loop_setup import LoopSetup
    from flexhinf.design.problem.presets import choose, required_damping
    from flexhinf.design.responses import default_start
    from flexhinf.design.synthesis.noise import search_noise

    goal = np.array(robot.home)
    start = default_start(robot, goal)
    problem = choose(robot, goal, start, s)
    setup = LoopSetup(robot, s, fh.solve_hji(problem.problem, problem.gamma, 2), goal, start)
    search = search_noise(setup, required_damping(s.damping, problem.target))
    if search is None:
        return {"refused": "No noise levels make the running loop stable."}
    setup = replace(setup, estimator_noise=search.chosen.levels)
    row = _least_damped(LawEvaluation("design", setup))
    noises = {"noise_share": float((search.chosen.noises / limits).max())}
    return row | noises | _reach(search, setup)


def _reach(search: Any, setup: Any) -> dict[str, Any]:
    """What any noise level of the estimator reaches, and how much of a vibration the motors show: version of today."""
    if search is None or not hasattr(search.chosen, "missed"):
        return {}
    from flexhinf.analysis.modes import JointScales

    scales = JointScales.of(setup.model, setup.goal_equilibrium)
    part = scales.link_inertia / (scales.link_inertia + scales.motor_inertia)
    worst = int(np.argmin(part))
    best = max(search.trade_off, key=lambda one: one.damping)
    limits = setup.limits.effort
    return {
        "tried": search.count,
        "best_damping": best.damping,
        "best_noise_share": float((best.noises / limits).max()),
        "unreachable": list(search.unreachable),
        "hidden_joint": setup.joints[worst],
        "shown_part": float(part[worst]),
        "zero_hz": float(np.sqrt(scales.stiffness[worst] / scales.link_inertia[worst]) / (2.0 * np.pi)),
        "vibration_hz": float(scales.vibration[worst] / (2.0 * np.pi)),
    }


def main() -> int:
    """The task is read from one file, its row written to another: python -m benchmarks.hardware.rows TASK ROW."""
    task, place = (Path(name) for name in sys.argv[1:])
    try:
        row = measure(json.loads(task.read_text(encoding="utf-8")))
    except fh.FlexhinfError as error:
        row = {"refused": " ".join(str(error).split())}
    place.write_text(json.dumps(_finite(row), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return 0


def _finite(value: Any) -> Any:
    """The same for JSON: None for a number that is not finite."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


if __name__ == "__main__":
    sys.exit(main())
