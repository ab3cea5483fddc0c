"""One row: a design, and what its loop does. Run as a process of its own."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.hardware.payloads import MOVES, POSES, carried
from flexhinf.designs import Specification
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.search import tuned_setup
from flexhinf.robot.workspace import workspace_of

__all__ = ["measure"]

#: Robots sampled within their tolerances in every row.
SAMPLES = 200


def measure(task: dict[str, Any]) -> dict[str, Any]:
    """Design, and measure what the loop does.

    Parameters
    ----------
    task : dict
        ``robot``, ``elastic``: files; ``options``: of the specification. Rows of the workspace also have ``payload``,
        that of the model, ``masses``, which the true robot carries, kg, and ``judged``: whether the design's own poses
        and moves are looked at.
    """
    if "payload" in task:
        return _workspace(task)
    robot = fh.load_robot(task["robot"], elastic=task["elastic"] or None)
    options = {"rays": 0, "draws": SAMPLES, **task["options"]}
    begin = time.process_time()
    design = fh.design(robot, Specification(pose=robot.home, **options), _said)
    return {"seconds": time.process_time() - begin, **_loop(design.evidence, np.array(robot.effort_limits))}


def _workspace(task: dict[str, Any]) -> dict[str, Any]:
    """One controller for the joint ranges, its requirements, and what it does with the masses."""
    robot = fh.load_robot(task["robot"], payload=task["payload"])
    specification = Specification(**task["options"])
    begin = time.process_time()
    if task["judged"]:
        design = fh.design(robot, specification, _said)
        setup = design.loop.setup
        lines = [
            (line.where, line.what, line.limit_text, line.achieved_text, line.judgement)
            for line in design.requirements
        ]
    else:
        setup, lines = tuned_setup(robot, specification, Task(workspace_of(robot)), _said), []
    row = {"seconds": time.process_time() - begin, "requirements": lines}
    return row | {"poses": POSES, "moves": MOVES, "carried": carried(setup, task["masses"])}


def _said(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


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
    if found.limit_cycle is not None:
        row["hunting"] = [*map(float, found.limit_cycle.amplitudes)]
        row["hunts"] = bool(found.limit_cycle.oscillating)
        row["rest_error"] = float(found.limit_cycle.errors.max())
    return row


def _least_damped(evaluation: Any) -> dict[str, Any]:
    """The oscillation of the running loop that is damped least."""
    ringing = [mode for mode in evaluation.closed_loop_modes if mode.eigenvalue.imag > 0.0]
    least = min(ringing, key=lambda mode: mode.damping, default=None)
    return {
        "damping": 1.0 if least is None else least.damping,
        "damping_joint": "" if least is None else least.joint,
        "damping_hz": 0.0 if least is None else abs(least.eigenvalue) / (2.0 * np.pi),
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
