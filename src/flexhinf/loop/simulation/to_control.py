"""A sampled closed loop as a system of python-control."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.controller.to_control import stepped
from flexhinf.loop.simulation.channel import Channel
from flexhinf.plant import BlackBox, Plant, python_control, rk4_step

if TYPE_CHECKING:
    import control


def loop_to_control(
    plant: Plant | BlackBox, controller: Controller, channel: Channel, steps: int
) -> control.NonlinearIOSystem:
    """Commands ``r_…`` and disturbances in; measurements ``y_…`` and inputs out.

    The state is that of the plant, then the controller's memory (``controller.initial_memory()`` at the start). A
    period is integrated as in `Loop.run`.

    Raises
    ------
    InvalidInput
        If the true plant is a black box, or the loop has a delay or quantised sensors.
    """
    package = python_control()
    if not isinstance(plant, Plant) or channel.delay or any(channel.quanta):
        raise InvalidInput(
            "The loop has no form in python-control.",
            f"expected a Plant without delay and quantisation, got {type(plant).__name__} and {channel}",
            "Loop(plant, controller).to_control()",
        )
    n, commanded = plant.n, len(controller.commanded)
    p = plant.parameters.vector()
    idle = np.zeros(len(plant.inputs))
    states = [plant.states.index(name) for name in controller.states] if controller.estimator is None else []

    def measured(x: Any) -> np.ndarray:
        x = np.asarray(x, dtype=float)
        return x[states] if states else np.ravel(np.asarray(plant.traced_output(x, idle, p), dtype=float))

    def update(t: float, state: Any, v: Any, params: Any) -> np.ndarray:
        u, after = stepped(controller, measured(state[:n]), v[:commanded], state[n:])
        x = np.asarray(state[:n], dtype=float)

        def flow(x: Any, d: Any) -> np.ndarray:
            return np.ravel(np.asarray(plant.traced_flow(x, u, d, p), dtype=float))

        for _ in range(steps):
            x = rk4_step(flow, x, (v[commanded:],) * 3, controller.period / steps)
        return np.concatenate([x, after])

    def output(t: float, state: Any, v: Any, params: Any) -> np.ndarray:
        y = measured(state[:n])
        return np.concatenate([y, stepped(controller, y, v[:commanded], state[n:])[0]])

    return package.nlsys(
        update,
        output,
        inputs=[*(f"r_{name}" for name in controller.commanded), *plant.disturbances],
        outputs=[*(f"y_{name}" for name in controller.measured), *controller.law.input_names],
        states=[*plant.states, *(f"memory[{k}]" for k in range(controller.memory.size))],
        dt=controller.period,
    )
