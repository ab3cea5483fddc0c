"""A closed loop around a plant that integrates itself: one controller step and one plant step at a time."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.loop.controller import Controller
from flexhinf.loop.sampling import sample_signal

__all__ = ["run_black_box"]


def run_black_box(
    box: Any,
    controller: Controller,
    signals: dict[str, np.ndarray],
    disturbance: Any,
    times: np.ndarray,
    start: Any,
) -> tuple[dict[str, np.ndarray], tuple[int, int]]:
    """Recorded signals, and (code, last step): the interface of the compiled run."""
    channels = tuple(getattr(box, "disturbances", ()))
    d = sample_signal(disturbance, times, channels, "disturbance")
    has_state = hasattr(box, "state") and hasattr(box, "states")
    width = {"output": len(controller.measured), "input": len(controller.law.input_names)}
    width |= {"estimate": len(controller.states)} | ({"state": len(box.states)} if has_state else {})
    recorded = {name: np.full((len(times), size), np.nan) for name, size in width.items()}
    recorded |= {"reference": signals["reference"], "disturbance": d}
    box.reset(None if start is None else np.asarray(start, dtype=float))
    controller.reset()
    for k in range(len(times)):
        if has_state:
            recorded["state"][k] = box.state()
        y = np.atleast_1d(np.asarray(box.output(), dtype=float)) + signals["noise"][k]
        recorded["output"][k] = y
        if not np.all(np.isfinite(y)):
            return recorded, (2, k)
        try:
            recorded["input"][k] = u = controller.step(
                y, signals["reference"][k] if controller.tracked else None
            )
        except NumericalFailure:
            return recorded, (1, k)
        recorded["estimate"][k] = controller.estimate
        box.step(u, d[k], controller.period)
    controller.reset()
    return recorded, (0, len(times) - 1)
