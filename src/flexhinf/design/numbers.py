"""What ``design.json`` holds: the numbers of a report."""

from __future__ import annotations

import math
from typing import Any

from flexhinf.design.estimator import INITIAL_VARIANCE, noise_variances
from flexhinf.design.modes import Mode
from flexhinf.design.result import Design

__all__ = ["numbers_of"]


def numbers_of(design: Design) -> dict[str, Any]:
    """Of one design; what is not finite is None."""
    x, u = design.problem.operating_point, design.problem.operating_input

    def mode(m: Mode) -> dict[str, Any]:
        return {
            "name": m.name,
            "joint": m.joint,
            "frequency_Hz": m.frequency,
            "damping": m.damping,
            "real": m.eigenvalue.real,
            "imaginary": m.eigenvalue.imag,
        }

    def plain(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    rigid = [] if design.rigid is None else list(design.rigid.loops)
    return {
        "version": 1,
        "robot": design.robot.name,
        "joints": list(design.robot.joint_names),
        "gamma_star": design.gamma_star,
        "gamma": design.solution.gamma,
        "degree": design.chosen.degree,
        "states": list(design.problem.state_names),
        "operating_point": [float(value) for value in x],
        "operating_input": [float(value) for value in u],
        "open_modes": [mode(m) for m in design.open_modes],
        "closed_modes": [mode(m) for m in design.closed_modes],
        "estimator_modes": [mode(m) for m in design.estimator_modes],
        "degrees": [
            {"degree": c.degree, "level": plain(c.level), "step": plain(c.step_amplitude), "limit": c.limit}
            for c in design.choices
        ],
        "step": {
            "start": design.start.tolist(),
            "goal": design.goal.tolist(),
            "duration_s": design.duration,
            "diverged_at_s": design.response.diverged,
            "joints": design.response.metrics,
        },
        "mujoco": None if design.mujoco is None else design.mujoco.metrics,
        "rigid": [
            {
                "side": loop.side,
                "stable": loop.stable,
                "modes": [mode(m) for m in loop.modes],
                "diverged_at_s": loop.response.diverged,
                "joints": loop.response.metrics,
            }
            for loop in rigid
        ],
        "noise_variances": noise_variances(
            design.problem.plant, design.specification.measurement_noise
        ).tolist(),
        "initial_variance": INITIAL_VARIANCE,
    }
