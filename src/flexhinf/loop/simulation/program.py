"""The closed loop as a program: measure, control, integrate the true plant, and again.

What lies between a robot and its controller: the grain of its sensors, and the delay of its inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from flexhinf.codegen import Buffer, Call, Copy, Guard, Normal, Program, Repeat, Slice
from flexhinf.codegen.program import Step
from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.simulation.metrics import Instant, Reduction, update_all
from flexhinf.plant import Plant, rk4_step
from flexhinf.scalars import drop_empty, trace
from flexhinf.validation import real_array, real_number, value_text

#: Longest delay of a run, samples. The inputs that wait are rows of the run's own record: a delay compiles nothing and
#: costs little, but a longer one is most likely a wrong unit. In a linear loop every input that waits is a state.
LONGEST, LONGEST_LINEAR = 100_000, 200

#: A delay this close to a whole number of samples (in samples) is one.
WHOLE = 1e-6


def check_delay(samples: float, period: float, most: int = LONGEST) -> None:
    """Refuse a delay of more samples than a run (or a linear loop, `LONGEST_LINEAR`) can have.

    Parameters
    ----------
    samples : float
        Length of the delay.
    period : float
        s.

    Raises
    ------
    InvalidInput
        With the unit that was probably meant.
    """
    if samples <= most * (1.0 + WHOLE):
        return
    late = period * samples
    raise InvalidInput(
        "The input delay is out of proportion to the period.",
        f"expected at most {most} samples = {most * period:g} s, got {late:g} s = {samples:.0f} samples of "
        f"{period:g} s",
        f"delay={1e-3 * late:g} if {late:g} ms was meant; for a longer delay a longer period",
    )


@dataclass(frozen=True)
class Channel:
    """Quantised measurements and delayed inputs; neither is known to the estimator.

    Attributes
    ----------
    quanta : tuple of float
        Step of each measurement, in its unit; 0 for one that is not quantised.
    delay : int
        Samples between an input and its effect. Until the first one acts the input before the first sample does.
    """

    quanta: tuple[float, ...]
    delay: int

    @staticmethod
    def of(quantisation: Any, delay: Any, period: float, measured: tuple[str, ...]) -> Channel:
        """From user's numbers.

        Parameters
        ----------
        quantisation : None, float, or (p,) array
            Step of the measurements.
        delay : float
            s; a whole number of periods, at most `LONGEST`.
        period : float
            s.

        Raises
        ------
        InvalidInput
            If they do not fit.
        """
        steps = np.zeros(0) if quantisation is None else real_array(quantisation)
        late = real_number(delay)
        if (
            steps.shape not in ((0,), (), (len(measured),))
            or not np.all(np.isfinite(steps))
            or np.any(steps < 0)
        ):
            raise InvalidInput(
                "The quantisation does not fit the measurements.",
                f"expected one step >= 0 or one for each of {list(measured)}, got {value_text(quantisation)}",
                "quantisation=2 * np.pi / 4096 for an encoder of 12 bits",
            )
        samples = late / period
        if not (np.isfinite(samples) and samples >= 0.0 and abs(samples - round(samples)) <= WHOLE):
            raise InvalidInput(
                "The input delay is not a whole number of samples.",
                f"expected a multiple of {period:g} s, got {value_text(delay)} s",
                f"delay={period:g} for one sample",
            )
        check_delay(samples, period)
        quanta = () if quantisation is None else tuple(np.broadcast_to(steps, (len(measured),)).tolist())
        return Channel(quanta if any(quanta) else (), round(samples))

    def quantised(self, y: Any) -> Any:
        """Measurements (p,) rounded to their steps, on any element."""
        if not self.quanta:
            return y
        rounded = [q * np.floor(value / q + 0.5) if q > 0.0 else value for value, q in zip(y, self.quanta)]
        return np.array(rounded)

    def settings(self) -> dict[str, Any]:
        """For the record of a run."""
        return {"quantisation": list(self.quanta) or "none", "input_delay_samples": self.delay}


#: Nothing in between.
DIRECT = Channel((), 0)


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

    x, u, truth = _whole("x", sizes.x), _whole("u", sizes.u), _whole("truth", 1 + sizes.parameters)
    memory, data = _whole("memory", sizes.memory), _whole("data", sizes.data)
    y, stage = _row("outputs", sizes.y), _stage(sizes)
    command, estimate = _row("reference", sizes.r), _row("estimates", sizes.estimate)
    control, scratch = controller.steps(
        {
            "y": y[0], "r": command[0] if command else None, "memory": memory[0], "data": data[0],
            "u": u[0], "estimate": estimate[0],
        }
    )  # fmt: skip
    held, acting = _whole("held", sizes.u), _row("inputs", sizes.u)
    body = (
        Copy(x[0], _row("states", sizes.x)[0]),
        Call(
            drop_empty(measure_function(plant, controller, channel)),
            (*x, *held, *_row("noise", sizes.y), *truth),
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


def _whole(name: str, size: int) -> tuple[Slice, ...]:
    return (Slice(name, size=size),) if size else ()


def _row(name: str, size: int) -> tuple[Slice, ...]:
    """The row of a sample."""
    return (Slice(name, size=size, strides=(size,)),) if size else ()


def _stage(sizes: LoopSizes) -> tuple[Slice, ...]:
    """The disturbances at the start, the middle and the end of a sub-step."""
    size = 3 * sizes.d
    return (Slice("disturbance", size=size, strides=(size * sizes.capacity, size)),) if size else ()


@dataclass(frozen=True)
class EnsembleOptions:
    """What a program of many runs has in it.

    Attributes
    ----------
    noisy, disturbed, delayed : bool
        Whether there are measurement noise, a disturbance, and a delay of the inputs.
    kept : tuple of (str, int)
        Signals that are recorded at every sample: "state", "output", "estimate" or "input", and the column.
    """

    noisy: bool
    disturbed: bool
    delayed: bool
    kept: tuple[tuple[str, int], ...]


def ensemble_program(
    plant: Plant,
    controller: Controller,
    sizes: LoopSizes,
    channel: Channel,
    reductions: Sequence[Reduction],
    options: EnsembleOptions,
) -> Program:
    """As `loop_program`, with noise that is made and numbers that are reduced on the way; nothing else is recorded.

    The command, the data of the law and the disturbance are the same for all lanes; each lane has its own plant, state,
    noise, and factors of the disturbance.
    """
    x, u, truth = _whole("x", sizes.x), _whole("u", sizes.u), _whole("truth", 1 + sizes.parameters)
    memory, data, y = _whole("memory", sizes.memory), _whole("data", sizes.data), _whole("y", sizes.y)
    held, step, noise = _whole("held", sizes.u), _whole("step", 1), _whole("noise", sizes.y)
    command, estimate = _row("reference", sizes.r), _whole("estimate", sizes.estimate)
    acting_disturbance = _whole("acting", 3 * sizes.d)
    control, scratch = controller.steps(
        {
            "y": y[0], "r": command[0] if command else None, "memory": memory[0], "data": data[0],
            "u": u[0], "estimate": estimate[0],
        }
    )  # fmt: skip
    remembered = _whole("remembered", sum(len(reduction.start) for reduction in reductions))
    reduce = drop_empty(_reduce_function(sizes, reductions))
    advance = Call(drop_empty(rk4_function(plant)), (*x, *held, *acting_disturbance, *truth), x)
    acting = _row("inputs", sizes.u)
    body: list[Step] = []
    if options.noisy:
        drawn = Slice("normal", size=sizes.y)
        body.append(Normal(step[0], Slice("key", size=3), drawn))
        body.append(Call(_product_function(sizes.y, 1), (drawn, Slice("deviation", size=sizes.y)), noise))
    body.append(
        Call(drop_empty(measure_function(plant, controller, channel)), (*x, *held, *noise, *truth), y)
    )
    body += control
    if options.kept:
        observed = (*x, *y, *estimate, u[0])
        body.append(Call(_kept_function(sizes, options.kept), observed, _row("kept", len(options.kept))))
    body += [Guard(u[0], CONTROL_FAILED), Guard(memory[0], CONTROL_FAILED)]
    observed = (*step, *remembered, *x, *estimate, *y, *u, *command)
    body.append(Call(reduce, (*observed, Slice("facts", size=1 + 3 * sizes.r)), (*remembered, *step)))
    if options.delayed:
        body += [Copy(u[0], replace(acting[0], shift="late")), Copy(acting[0], held[0])]
    else:
        body.append(Copy(u[0], held[0]))
    if options.disturbed:
        scaled = Call(
            _product_function(sizes.d, 3), (*_stage(sizes), Slice("load", size=sizes.d)), acting_disturbance
        )
        body.append(Repeat("parts", (scaled, advance)))
    else:
        body.append(Repeat("parts", (advance,)))
    body.append(Guard(x[0], PLANT_FAILED))
    return Program(
        "ensemble",
        (*_ensemble_buffers(sizes, len(remembered) and remembered[0].size, options), *scratch),
        (Repeat("steps", tuple(body)),),
        ("steps", "parts", "late") if options.delayed else ("steps", "parts"),
    )


def _ensemble_buffers(sizes: LoopSizes, remembered: int, options: EnsembleOptions) -> list[Buffer]:
    buffers = [
        Buffer("x", sizes.x, "state"),
        Buffer("held", sizes.u, "state"),
        Buffer("memory", sizes.memory, "state"),
        Buffer("step", 1, "state"),
        Buffer("data", sizes.data, "in", shared=True),
        Buffer("facts", 1 + 3 * sizes.r, "in", shared=True),
        Buffer("truth", 1 + sizes.parameters, "in"),
        Buffer("u", sizes.u, "work"),
        Buffer("y", sizes.y, "work"),
        Buffer("noise", sizes.y, "work"),
        Buffer("estimate", sizes.estimate, "work"),
    ]
    buffers += [Buffer("remembered", remembered, "state")] if remembered else []
    buffers += [Buffer("reference", None, "in", shared=True)] if sizes.r else []
    buffers += [Buffer("acting", 3 * sizes.d, "work")] if sizes.d else []
    if options.noisy:
        buffers += [Buffer("key", 3, "in"), Buffer("normal", sizes.y, "work")]
        buffers += [Buffer("deviation", sizes.y, "in", shared=True)]
    if options.disturbed:
        buffers += [Buffer("disturbance", None, "in", shared=True), Buffer("load", sizes.d, "in")]
    buffers += [Buffer("inputs", None, "state")] if options.delayed else []
    buffers += [Buffer("kept", None, "out")] if options.kept else []
    return buffers


def reduction_program(sizes: LoopSizes, reductions: Sequence[Reduction]) -> Program:
    """The reductions of `ensemble_program` alone, of the recorded signals of one run."""
    signals = {
        "state": sizes.x,
        "estimate": sizes.estimate,
        "output": sizes.y,
        "input": sizes.u,
        "reference": sizes.r,
    }
    rows = [piece for name, size in signals.items() for piece in _row(name, size)]
    own = {"step": 1, "remembered": sum(len(reduction.start) for reduction in reductions)}
    step, remembered, facts = (
        *(Slice(name, size=size) for name, size in own.items()),
        Slice("facts", size=1 + 3 * sizes.r),
    )
    reduce = Call(
        drop_empty(_reduce_function(sizes, reductions)), (step, remembered, *rows, facts), (remembered, step)
    )
    buffers = [Buffer(name, None, "in") for name, size in signals.items() if size]
    buffers += [
        Buffer("facts", 1 + 3 * sizes.r, "in"),
        *(Buffer(name, size, "state") for name, size in own.items()),
    ]
    return Program("reductions", tuple(buffers), (Repeat("steps", (reduce,)),), ("steps",))


def _product_function(size: int, times: int) -> ca.Function:
    """(times rows of numbers, factors) → the rows times the factors, rounded before anything is added to them."""
    return trace(lambda rows, factors: rows * np.tile(factors, times), size * times, size, name="product")


def _kept_function(sizes: LoopSizes, kept: Sequence[tuple[str, int]]) -> ca.Function:
    """(x, y, estimate, u) → what is kept of a sample."""

    def keep(x: Any, y: Any, estimate: Any, u: Any) -> Any:
        signals = {"state": x, "output": y, "estimate": estimate, "input": u}
        return np.array([signals[kind][column] for kind, column in kept])

    return drop_empty(trace(keep, sizes.x, sizes.y, sizes.estimate, sizes.u, name="keep"))


def _reduce_function(sizes: LoopSizes, reductions: Sequence[Reduction]) -> ca.Function:
    """(step, remembered, x, estimate, y, u, command, facts) → remembered, if anything is, and the next step."""
    r = sizes.r

    def reduce(step: Any, kept: Any, x: Any, estimate: Any, y: Any, u: Any, command: Any, facts: Any) -> Any:
        rows = (facts[1 + k * r : 1 + (k + 1) * r] for k in range(3))
        now = Instant(step[0], x, estimate, y, u, command, facts[0], *rows)
        return (update_all(reductions, kept, now), step + 1.0) if reductions else step + 1.0

    remembered = sum(len(reduction.start) for reduction in reductions)
    widths = (1, remembered, sizes.x, sizes.estimate, sizes.y, sizes.u, r, 1 + 3 * r)
    return trace(reduce, *widths, name="reduce")
