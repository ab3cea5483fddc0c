"""The closed loop as a program: measure, control, integrate the true plant, and again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from flexhinf.codegen import Buffer, Call, Copy, Guard, Program, Repeat, Slice
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.simulation.channel import DIRECT, Channel
from flexhinf.plant import Plant, rk4_step
from flexhinf.scalars import drop_empty, trace

__all__ = ["CONTROL_FAILED", "PLANT_FAILED", "LoopSizes", "loop_program", "measure_function", "rk4_function"]

CONTROL_FAILED, PLANT_FAILED = 1, 2


@dataclass(frozen=True)
class LoopSizes:
    """Lengths of the buffers of a loop."""

    x: int
    u: int
    y: int
    r: int
    d: int
    memory: int
    data: int
    estimate: int
    parameters: int
    capacity: int


def rk4_function(plant: Plant) -> ca.Function:
    """(x, u, d at start, middle and end, (step, p)) → x one sub-step later, after the plant's `arrest`."""
    nd, named = len(plant.disturbances), plant.parameters.named

    def advance(x: Any, u: Any, d: Any, truth: Any) -> Any:
        stages = [d[k * nd : (k + 1) * nd] for k in range(3)]
        after = rk4_step(lambda s, v: plant.evaluate_flow(s, u, v, truth[1:]), x, stages, truth[0])
        return after if plant.arrest is None else plant.arrest(after, truth[0], named(truth[1:]))

    return trace(advance, plant.n, len(plant.inputs), 3 * nd, 1 + plant.parameters.size, name="advance")


def measure_function(plant: Plant, controller: Controller, channel: Channel = DIRECT) -> ca.Function:
    """(x, u, noise, (step, p)) → what the controller is given: outputs, or the states of its plant."""
    places = [plant.index(name) for name in controller.states] if controller.estimator is None else None

    def measure(x: Any, u: Any, noise: Any, truth: Any) -> Any:
        if places is not None:
            return channel.quantised(x[places] + noise)
        return channel.quantised(plant.evaluate_output(x, u, truth[1:]) + noise)

    return trace(
        measure,
        plant.n,
        len(plant.inputs),
        len(controller.measured),
        1 + plant.parameters.size,
        name="measure",
    )


def loop_program(plant: Plant, controller: Controller, sizes: LoopSizes, channel: Channel) -> Program:
    """The program of one run; `steps` samples, `parts` sub-steps each, room for `capacity` of them.

    The record of the inputs begins with those that act before the first of the run does, `late` elements of them: what
    acts at a sample is the row that was written a delay ago, so that any delay is data.
    """

    def whole(name: str, size: int) -> tuple[Slice, ...]:
        return (Slice(name, size=size),) if size else ()

    def row(name: str, size: int, extra: tuple[int, ...] = ()) -> tuple[Slice, ...]:
        stride = size if not extra else size * sizes.capacity
        return (Slice(name, size=size, strides=(stride, *extra)),) if size else ()

    x, u, truth = whole("x", sizes.x), whole("u", sizes.u), whole("truth", 1 + sizes.parameters)
    memory, data = whole("memory", sizes.memory), whole("data", sizes.data)
    y = row("outputs", sizes.y)
    stage = row("disturbance", 3 * sizes.d, (3 * sizes.d,)) if sizes.d else ()
    command, estimate = row("reference", sizes.r), row("estimates", sizes.estimate)
    control, scratch = controller.steps(
        {
            "y": y[0], "r": command[0] if command else None, "memory": memory[0], "data": data[0],
            "u": u[0], "estimate": estimate[0],
        }
    )  # fmt: skip
    held, acting = whole("held", sizes.u), row("inputs", sizes.u)
    body = (
        Copy(x[0], row("states", sizes.x)[0]),
        Call(
            drop_empty(measure_function(plant, controller, channel)),
            (*x, *held, *row("noise", sizes.y), *truth),
            y,
        ),
        *control,
        Copy(u[0], replace(acting[0], shift="late")),
        Guard(u[0], CONTROL_FAILED),
        Guard(memory[0], CONTROL_FAILED),
        Copy(acting[0], held[0]),
        Repeat("parts", (Call(drop_empty(rk4_function(plant)), (*x, *held, *stage, *truth), x),)),
        Guard(x[0], PLANT_FAILED),
    )
    buffers = [
        Buffer("x", sizes.x, "state"),
        Buffer("u", sizes.u, "state"),
        Buffer("held", sizes.u, "state"),
        Buffer("memory", sizes.memory, "state"),
        Buffer("data", sizes.data, "in"),
        Buffer("truth", 1 + sizes.parameters, "in"),
        Buffer("noise", None, "in"),
        Buffer("states", None, "out"),
        Buffer("outputs", None, "out"),
        Buffer("inputs", None, "state"),
        Buffer("estimates", None, "out"),
    ]
    buffers += [Buffer("reference", None, "in")] if sizes.r else []
    buffers += [Buffer("disturbance", None, "in")] if sizes.d else []
    return Program("closed_loop", (*buffers, *scratch), (Repeat("steps", body),), ("steps", "parts", "late"))
