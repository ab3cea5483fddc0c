"""A true plant that integrates itself: one controller step and one plant step at a time."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.signals.sampling import by_name, sample_signal
from flexhinf.loop.simulation.channel import Channel
from flexhinf.loop.simulation.program import CONTROL_FAILED, PLANT_FAILED
from flexhinf.loop.simulation.run_arguments import starting_state
from flexhinf.plant import BlackBox

__all__ = ["run_black_box"]


def run_black_box(
    box: BlackBox,
    controller: Controller,
    channel: Channel,
    signals: dict[str, np.ndarray],
    disturbance: Any,
    times: np.ndarray,
    start: Any,
    initial_input: Any,
) -> tuple[dict[str, np.ndarray], tuple[int, int]]:
    """Recorded signals, and (code, last step): what the compiled run returns too.

    Raises
    ------
    InvalidInput
        If the initial state, the disturbance or the output do not fit.
    """
    controller = controller.fresh()
    controller.reset(input=initial_input)
    channels = tuple(box.disturbances)
    d = sample_signal(by_name(disturbance, box), times, channels, "disturbance")
    before = controller.input_before(initial_input)
    has_state = bool(box.states)
    width = {"output": len(controller.measured), "input": len(controller.law.input_names)}
    width |= {"estimate": len(controller.states)} | ({"state": len(box.states)} if has_state else {})
    recorded = {name: np.full((len(times), size), np.nan) for name, size in width.items()}
    recorded |= {"reference": signals["reference"], "disturbance": d}
    box.reset(None if start is None else starting_state(start, _states(box, controller), controller))
    for k in range(len(times)):
        if has_state:
            recorded["state"][k] = box.state()
        y = channel.quantised(_measured(box, controller) + signals["noise"][k])
        recorded["output"][k] = y
        if not np.all(np.isfinite(y)):
            return recorded, (PLANT_FAILED, k)
        try:
            u = controller.step(y, signals["reference"][k] if controller.commanded else None)
        except NumericalFailure:
            return recorded, (CONTROL_FAILED, k)
        recorded["input"][k], recorded["estimate"][k] = u, controller.estimate
        late = k - channel.delay
        box.step(recorded["input"][late] if late >= 0 else before, d[k], controller.period)
    return recorded, (0, len(times) - 1)


def _states(box: Any, controller: Controller) -> tuple[str, ...]:
    return tuple(box.states) or controller.states


def _measured(box: Any, controller: Controller) -> np.ndarray:
    y = np.atleast_1d(np.asarray(box.output(), dtype=float))
    if y.shape != (len(controller.measured),):
        raise InvalidInput(
            "The black box does not measure what the controller needs.",
            f"expected {len(controller.measured)} numbers {list(controller.measured)}, got shape {y.shape}",
            "output() in the order of the estimator's outputs",
        )
    return y
