"""A true plant that integrates itself: one controller step and one plant step at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.signals.sampling import by_name, sample_signal
from flexhinf.loop.simulation.compiled_runs import starting_state
from flexhinf.loop.simulation.program import CONTROL_FAILED, PLANT_FAILED, Channel
from flexhinf.plant import BlackBox

#: How a run ends that was stopped before its last sample.
STOPPED = -1


class Stepped(Protocol):
    """What is stepped: a `Controller`, or what has the same signals."""

    def step(self, y: Any, reference: Any) -> np.ndarray:
        """Input (m,) for a measurement (p,) and a command (k,)."""
        ...

    @property
    def estimate(self) -> np.ndarray:
        """Of the last step, (n,)."""
        ...


@dataclass(frozen=True)
class Pacing:
    """When the samples of a run are made.

    Attributes
    ----------
    begin : callable
        Returns when sample k is due; False ends the run before it.
    end : callable
        Called when sample k is over, the plant's own step included.
    """

    begin: Callable[[int], bool]
    end: Callable[[int], None]


#: One sample after the other, as fast as possible.
AT_ONCE = Pacing(lambda k: True, lambda k: None)


def run_black_box(
    box: BlackBox,
    controller: Controller,
    channel: Channel,
    signals: dict[str, np.ndarray],
    disturbance: Any,
    times: np.ndarray,
    start: Any,
    initial_input: Any,
    stepped: Stepped | None = None,
    pacing: Pacing = AT_ONCE,
) -> tuple[dict[str, np.ndarray], tuple[int, int]]:
    """Recorded signals, and (code, last step): what the compiled run returns too.

    `stepped`, if given, is stepped as it is in the controller's place. A run that `pacing` ends has the code `STOPPED`.

    Raises
    ------
    InvalidInput
        If the initial state, the disturbance or the output do not fit.
    """
    if stepped is None:
        stepped = controller.fresh()
        stepped.reset(input=initial_input)
    channels = tuple(box.disturbances)
    d = sample_signal(by_name(disturbance, box), times, channels, "disturbance")
    before = controller.input_before(initial_input)
    has_state = bool(box.states)
    width = {"output": len(controller.measured), "input": len(controller.law.input_names)}
    width |= {"estimate": len(controller.states)} | ({"state": len(box.states)} if has_state else {})
    recorded = {name: np.full((len(times), size), np.nan) for name, size in width.items()}
    recorded |= {"reference": signals["reference"], "disturbance": d}
    told = start is not None or set(controller.states) <= set(box.states)
    box.reset(starting_state(start, _states(box, controller), controller) if told else None)
    for k in range(len(times)):
        if not pacing.begin(k):
            return recorded, (STOPPED, k - 1)
        if has_state:
            recorded["state"][k] = box.state()
        y = channel.quantised(_measured(box, controller) + signals["noise"][k])
        recorded["output"][k] = y
        if not np.all(np.isfinite(y)):
            return recorded, (PLANT_FAILED, k)
        try:
            u = stepped.step(y, signals["reference"][k] if controller.commanded else None)
        except NumericalFailure:
            return recorded, (CONTROL_FAILED, k)
        recorded["input"][k], recorded["estimate"][k] = u, stepped.estimate
        late = k - channel.delay
        box.step(recorded["input"][late] if late >= 0 else before, d[k], controller.period)
        pacing.end(k)
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
