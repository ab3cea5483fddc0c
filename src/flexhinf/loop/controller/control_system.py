"""A controller as a system of python-control."""

from __future__ import annotations

from typing import Any

from flexhinf.arrays import Vector
from flexhinf.plant import python_control


def control_system(controller: Any) -> Any:
    """As `Controller.to_control`."""
    p = len(controller.measured)

    def after(t: float, memory: Vector, v: Vector, params: object) -> Vector:
        return controller.evaluate(v[:p], v[p:], memory)[1]

    def output(t: float, memory: Vector, v: Vector, params: object) -> Vector:
        return controller.evaluate(v[:p], v[p:], memory)[0]

    return python_control().nlsys(
        after,
        output,
        inputs=[
            *(f"y_{name}" for name in controller.measured),
            *(f"r_{name}" for name in controller.commanded),
        ],
        outputs=list(controller.law.input_names),
        states=[f"memory[{k}]" for k in range(controller.memory.size)],
        dt=controller.period,
    )
