"""A controller as a sampled system of python-control."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.plant import python_control

if TYPE_CHECKING:
    import control

    from flexhinf.loop.controller.running import Running


def controller_to_control(controller: Running) -> control.NonlinearIOSystem:
    """Measurements ``y_…`` and commands ``r_…`` in, inputs out; states are the numbers of its memory.

    ``controller.initial_memory()`` is where it starts; u of a sample depends on y of the same one.
    """
    package = python_control()
    measured = len(controller.measured)

    def update(t: float, memory: Any, v: Any, params: Any) -> np.ndarray:
        return stepped(controller, v[:measured], v[measured:], memory)[1]

    def output(t: float, memory: Any, v: Any, params: Any) -> np.ndarray:
        return stepped(controller, v[:measured], v[measured:], memory)[0]

    return package.nlsys(
        update,
        output,
        inputs=[
            *(f"y_{name}" for name in controller.measured),
            *(f"r_{name}" for name in controller.commanded),
        ],
        outputs=list(controller.law.input_names),
        states=[f"memory[{k}]" for k in range(controller.memory.size)],
        dt=controller.period,
    )


def stepped(controller: Running, y: Any, r: Any, memory: Any) -> tuple[np.ndarray, np.ndarray]:
    """Input (m,) and next memory of one sample."""
    u, _, after = controller.traced(y, r, memory, controller.data_vector)
    return np.ravel(np.asarray(u, dtype=float)), np.ravel(np.asarray(after, dtype=float))
