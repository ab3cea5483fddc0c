"""The closed loop as a program: measure, control, integrate the true plant, and again; and the channel between robot
and controller: quantised sensors and delayed inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, reduce
from typing import Any, NamedTuple, cast

import casadi as ca
import numpy as np

from flexhinf.arrays import Elements, Numbers
from flexhinf.codegen import (
    Buffer,
    Call,
    Copy,
    Guard,
    Kernel,
    Normal,
    Program,
    Repeat,
    Slice,
    When,
    compile_program,
)
from flexhinf.codegen.program import Step
from flexhinf.codegen.shared import share
from flexhinf.errors import refuse_if
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.controller.measured import by_flag
from flexhinf.loop.controller.readings import believable
from flexhinf.loop.simulation.metrics import Instant, Reduction
from flexhinf.plant import BlackBox, Plant, Sensor, SensorTable, chosen, known, rk4_step
from flexhinf.scalars import drop_empty, maximum, trace
from flexhinf.scalars.trace import instructions
from flexhinf.validation import real_array, real_number, value_text

#: Longest delay of a run, samples. The inputs that wait are rows of the run's own record: a delay compiles nothing and
#: costs little, but a longer one is most likely a wrong unit. In a linear loop every input that waits is a state.
LONGEST, LONGEST_LINEAR = 100_000, 200

#: A delay this close to a whole number of samples (in samples) is one.
WHOLE = 1e-6


def check_delay(samples: float, period: float, most: int = LONGEST) -> None:
    """Refuse a delay of more samples than a run (or a linear loop, `LONGEST_LINEAR`) can have; the InvalidInput says
    the unit that was probably meant."""
    late = period * samples
    refuse_if(
        not samples <= most * (1.0 + WHOLE),
        "The input delay is out of proportion to the period.",
        f"expected at most {most} samples = {most * period:g} s, got {late:g} s = {samples:.0f} samples of "
        f"{period:g} s",
        f"delay={1e-3 * late:g} if {late:g} ms was meant; for a longer delay a longer period",
    )


@dataclass(frozen=True)
class Channel:
    """Sensors, and delayed inputs. Of the delay, the estimator knows the controller's latency.

    `quanta` are the steps of the measurements, in their unit, 0 for one that is not quantised; `delay` the samples
    between an input and its effect. Until the first one acts the input before the first sample does. Of each
    measurement `deviations` are those of its noise, `periods` and `late` the samples from one to the next, and those
    until it arrives; what is not measured is NaN. All three are empty without sensors.
    """

    quanta: tuple[float, ...]
    delay: int
    deviations: tuple[float, ...] = ()
    periods: tuple[int, ...] = ()
    late: tuple[int, ...] = ()

    @staticmethod
    def of(quantisation: Any, delay: Any, period: float, measured: tuple[str, ...]) -> Channel:
        """Channel from user's numbers: steps of the measurements (None, one, or (p,)), and the delay, s, a whole number
        of periods, at most `LONGEST`; what does not fit is refused."""
        steps = np.zeros(0) if quantisation is None else real_array(quantisation)
        fits = steps.shape in ((0,), (), (len(measured),))
        refuse_if(
            not fits or not np.all(np.isfinite(steps)) or np.any(steps < 0),
            "The quantisation does not fit the measurements.",
            f"expected one step >= 0 or one for each of {list(measured)}, got {value_text(quantisation)}",
            "quantisation=2 * np.pi / 4096 for an encoder of 12 bits",
        )
        samples = real_number(delay) / period
        refuse_if(
            not (np.isfinite(samples) and samples >= 0.0 and abs(samples - round(samples)) <= WHOLE),
            "The input delay is not a whole number of samples.",
            f"expected a multiple of {period:g} s, got {value_text(delay)} s",
            f"delay={period:g} for one sample",
        )
        check_delay(samples, period)
        quanta = () if quantisation is None else tuple(np.broadcast_to(steps, (len(measured),)).tolist())
        return Channel(quanta if any(quanta) else (), round(samples))

    def with_sensors(self, table: SensorTable) -> Channel:
        """The channel with these sensors' quantisation, noise, periods and delays."""
        quanta, periods, late = (tuple(row.tolist()) for row in (table.quanta, table.periods, table.delays))
        return replace(
            self,
            quanta=quanta if any(quanta) else (),
            deviations=tuple(table.deviations.tolist()),
            periods=periods if max(periods, default=1) > 1 or any(late) else (),
            late=late if any(late) else (),
        )

    def noise(self, stated: Numbers) -> Numbers:
        """The deviations of a run's noise: as stated, or those of the sensors, None without either."""
        return self.deviations if stated is None and any(self.deviations) else stated

    def gaps(self, samples: int) -> np.ndarray:
        """(samples, p), NaN where a measurement is not made, else 0; (samples, 0) where all are."""
        periods = np.array(self.periods, dtype=int)
        return (
            np.where(np.arange(samples)[:, None] % periods != 0, np.nan, 0.0)
            if self.periods
            else np.zeros((samples, 0))
        )

    def arrived(self, y: Any, waiting: Any, gap: Any) -> tuple[Any, Any]:
        """What arrives at a sample (p,) of what is measured then, y (p,), and the next of what waits (Σ late,): NaN
        before the first sample, whose measurements stand for those before."""
        there: list[Any] = []
        kept: list[Any] = []
        first = 0
        for value, late in zip(y, self.late or (0,) * len(y)):
            before = waiting[first : first + late]
            line = [value, *chosen(known(before), before, value)]
            there.append(line[-1])
            kept += line[:-1]
            first += late
        return np.array(there) + gap, np.array(kept)

    def arrived_at_once(self, y: Elements, gap: Elements) -> Elements:
        """The same (p,) where nothing is late."""
        return self.arrived(y, np.zeros(0), gap)[0]

    def quantised(self, y: Any) -> Any:
        """Measurements (p,) rounded to their steps, on any element."""
        rounded = [q * np.floor(v / q + 0.5) if q > 0.0 else v for v, q in zip(y, self.quanta)]
        return np.array(rounded) if self.quanta else y


def checked_sensors(
    sensors: Sequence[Sensor] | Sensor, quantisation: Numbers, plant: Plant | BlackBox, controller: Controller
) -> SensorTable:
    """The sensors of a loop; refused beside a quantisation, and where the controller needs every measurement."""
    groups = plant.groups if controller.estimator is None else controller.estimator.plant.groups
    table = SensorTable.of(
        sensors, controller.measured, lambda name: tuple(groups.get(name, (name,))), controller.period
    )
    refuse_if(
        quantisation is not None,
        "The quantisation is stated twice.",
        f"expected quantisation=None with sensors=(...), got {value_text(quantisation)}",
        "fh.Sensor(name, quantisation=…)",
    )
    refuse_if(
        controller.estimator is None and (table.delays.any() or (table.periods > 1).any()),
        "A controller without an estimator needs every state at every sample.",
        f"expected sensors without period and delay, got {table.periods.tolist()} and {table.delays.tolist()} samples",
        "an estimator",
    )
    return table


#: Nothing in between.
DIRECT = Channel((), 0)

#: How a run ends whose numbers are no longer finite: those of the controller, or of the true plant.
CONTROL_FAILED, PLANT_FAILED = 1, 2


def rk4_function(plant: Plant) -> ca.Function:
    """(x, u, d at start, middle and end, (step, p)) → x one sub-step later, after the plant's `arrest`; of a map, x⁺
    with d as at the start."""
    nd, named = len(plant.disturbances), plant.parameters.named

    def advance(x: Any, u: Any, d: Any, truth: Any) -> Any:
        stages = [d[k * nd : (k + 1) * nd] for k in range(3)]
        if plant.sampled:
            return plant.evaluate_flow(x, u, stages[0], truth[1:])
        after = rk4_step(lambda s, v: plant.evaluate_flow(s, u, v, truth[1:]), x, stages, truth[0])
        return after if plant.arrest is None else plant.arrest(after, truth[0], named(truth[1:]))

    return trace(advance, plant.n, len(plant.inputs), 3 * nd, 1 + plant.parameters.size, name="advance")


def measure_function(plant: Plant, controller: Controller, channel: Channel = DIRECT) -> ca.Function:
    """(x, u, noise, (step, p)) → the controller's measurement: outputs, or the states of its plant."""
    places = [plant.index(name) for name in controller.states] if controller.estimator is None else None

    def measure(x: Any, u: Any, noise: Any, truth: Any) -> Any:
        y = x[places] if places is not None else plant.evaluate_output(x, u, truth[1:])
        return channel.quantised(y + noise)

    sizes = (plant.n, len(plant.inputs), len(controller.measured), 1 + plant.parameters.size)
    return trace(measure, *sizes, name="measure")


class EnsembleOptions(NamedTuple):
    """What a program of many runs contains."""

    noisy: bool  # measurement noise
    disturbed: bool
    delayed: bool  # inputs
    #: recorded at every sample: "state", "output", "estimate" or "input"; column
    kept: tuple[tuple[str, int], ...]
    own_law: bool = False  # numbers of the controller of each run


class _Buffers(dict[str, Buffer]):
    """Buffers of a program by name, collected while it is written; those without elements are left out."""

    def whole(
        self, name: str, size: int, role: Any, shared: bool = False, strides: tuple[int, ...] = ()
    ) -> tuple[Slice, ...]:
        if size:
            self[name] = Buffer(name, None if strides else size, role, shared=shared)
        return (Slice(name, size=size, strides=strides),) if size else ()

    def row(self, name: str, size: int, role: Any, shared: bool = False) -> tuple[Slice, ...]:  # of a sample
        return self.whole(name, size, role, shared, (size,))


def capacity(sub_steps: int) -> int:
    """Sub-steps that the arrays of a disturbance have room for: a few more, so that few kernels serve many loops."""
    return 1 << (sub_steps - 1).bit_length()


@dataclass(frozen=True, eq=False)
class LoopCode:
    """The compiled part of a loop: no parameter of plant or law, no time and no signal is in it. Loops with the same
    key share their kernels; plant, controller and channel are those of one of them."""

    plant: Plant
    controller: Controller
    channel: Channel
    sub_steps: int  # Runge–Kutta steps per period, for which there is room

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Lengths of the signals x, u, y, r, d and of other buffers, and the `capacity`."""
        plant, controller = self.plant, self.controller
        return {
            "x": plant.n,
            "u": len(plant.inputs),
            "y": len(controller.measured),
            "r": len(controller.commanded),
            "d": len(plant.disturbances),
            "memory": controller.memory.size,
            "data": controller.data.size,
            "estimate": len(controller.estimated),
            "parameters": plant.parameters.size,
            "capacity": capacity(self.sub_steps),
        }

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Key of the compiled code."""
        return (
            "loop",
            self.plant.code_key,
            self.controller.code_key,
            self.controller.fused,
            *self.sizes.values(),
            (self.channel.quanta, self.channel.late, bool(self.channel.periods), self.channel.delay > 0),
        )

    @cached_property
    def waits(self) -> bool:
        """Whether samples at the start may have no measurement: an output of the plant has numbers that are not finite
        in its code."""
        constants = (value for *_, value in instructions(self.plant.traced_output))
        checks = self.controller.mode.checks_measurements
        return self.controller.gaps and (checks or not all(map(np.isfinite, constants)))

    @cached_property
    def program(self) -> Program:
        """The program of a whole run."""
        return share((*self.key, "program"), lambda: loop_program(self))

    @cached_property
    def _kernel(self) -> Kernel:
        return share((*self.key, "run"), lambda: compile_program(self.program, fused=self.controller.fused))

    def kernel(self) -> Kernel:
        """The compiled program of a whole run."""
        return self._kernel


def loop_program(
    code: LoopCode, options: EnsembleOptions | None = None, reductions: Sequence[Reduction] = ()
) -> Program:
    """The program of a run; `steps` samples, `parts` sub-steps each, room for `capacity` of them. Of one run, `parts`
    does not count the first sub-step, which is computed together with the controller's step.

    One run, without options, takes its noise as data and records all signals. Of many runs noise is made and numbers
    are reduced on the way, and nothing is recorded but what is kept: command, disturbance and, without `own_law`,
    data of the law are the same for all lanes; each lane has its own plant, state, noise, and factors of the
    disturbance.

    The record of the inputs begins with those that act before the first of the run does, `late` elements of them: what
    acts at a sample is the row that was written a delay ago, so that any delay is data.
    """
    plant, controller, sizes = code.plant, code.controller, code.sizes
    many, b = options is not None, _Buffers()
    delayed = code.channel.delay > 0 if options is None else options.delayed
    x, held = b.whole("x", sizes["x"], "state"), b.whole("held", sizes["u"], "state")
    u = b.whole("u", sizes["u"], "work" if many else "state")
    shared_law = options is not None and not options.own_law
    memory, data = (
        b.whole("memory", sizes["memory"], "state"),
        b.whole("data", sizes["data"], "in", shared_law),
    )
    truth = b.whole("truth", 1 + sizes["parameters"], "in")
    command = b.row("reference", sizes["r"], "in", many)
    ahead = controller.mode.command_lead * sizes["r"]
    ahead_rows = [replace(row, offset=ahead) for row in command]  # the command where this sample's input acts
    if options is None:
        y, noise = b.row("outputs", sizes["y"], "out"), b.row("noise", sizes["y"], "in")
        estimate = b.row("estimates", sizes["estimate"], "out")
    else:
        y, noise = b.whole("y", sizes["y"], "work"), b.whole("noise", sizes["y"], "work")
        estimate = b.whole("estimate", sizes["estimate"], "work")
    step = b.whole("step", int(many), "state")
    step_places: dict[str, Slice | None] = {
        "y": y[0],
        "r": ahead_rows[0] if ahead_rows else None,
        "memory": memory[0],
        "data": data[0],
        "u": u[0],
        "estimate": estimate[0],
    }
    control, scratch = (
        _waiting_steps(b, step_places, controller) if code.waits else controller.steps(step_places)
    )
    body: list[Step] = []
    if options is None:
        body.append(Copy(x[0], b.row("states", sizes["x"], "out")[0]))
    elif options.noisy:
        key, normal = b.whole("key", 3, "in"), b.whole("normal", sizes["y"], "work")
        body.append(Normal(step[0], key[0], normal[0]))
        deviation = b.whole("deviation", sizes["y"], "in", many)
        body.append(Call(_product_function(sizes["y"], 1), (*normal, *deviation), noise))
    measure = drop_empty(measure_function(plant, controller, code.channel))
    body.append(Call(measure, (*x, *held, *noise, *truth), y))
    if code.channel.periods:
        count = sum(code.channel.late)
        waiting = b.whole("waiting", count, "state")
        arrived = drop_empty(
            trace(
                code.channel.arrived if count else code.channel.arrived_at_once,
                *((sizes["y"], count, sizes["y"]) if count else (sizes["y"], sizes["y"])),
                name="arrived",
            )
        )
        body.append(Call(arrived, (*y, *waiting, *b.row("gaps", sizes["y"], "in", many)), (*y, *waiting)))
    body += control
    record = b.row("inputs", sizes["u"] if delayed or not many else 0, "state")
    acting = record if delayed else u
    advance, size, parts = drop_empty(rk4_function(plant)), 3 * sizes["d"], list[Step]()
    stage: tuple[Slice, ...] = ()
    if size and (options is None or options.disturbed):
        stage = (Slice("disturbance", size=size, strides=(size * sizes["capacity"], size)),)
        b["disturbance"] = Buffer("disturbance", None, "in", shared=many)
    if options is None:  # the first sub-step does not wait for the controller's prediction, nor that for it
        first = tuple(replace(piece, strides=piece.strides[:1]) for piece in stage)
        body.append(Call(advance, (*x, *acting, *first, *truth), x))
        if not controller.composed:
            body = [replace(step, joins=True) if isinstance(step, Call) else step for step in body]
        stage = tuple(replace(piece, offset=size) for piece in stage)
    elif options.kept:
        places = options.kept

        def keep(x: Any, y: Any, estimate: Any, u: Any) -> Any:
            signals = {"state": x, "output": y, "estimate": estimate, "input": u}
            return np.array([signals[kind][column] for kind, column in places])

        kept = drop_empty(trace(keep, sizes["x"], sizes["y"], sizes["estimate"], sizes["u"], name="keep"))
        body.append(Call(kept, (*x, *y, *estimate, *u), b.row("kept", len(places), "out")))
    if record:
        body.append(Copy(u[0], replace(record[0], shift="late")))
    body += [Guard(u[0], CONTROL_FAILED), Guard(memory[0], CONTROL_FAILED)]
    if many:
        reduction_memory = b.whole("reduction_memory", _memory_size(reductions), "state")
        observed = (*step, *reduction_memory, *x, *estimate, *y, *u, *command)
        facts = b.whole("facts", 1 + 3 * sizes["r"], "in", many)
        body.append(
            Call(
                drop_empty(_reduce_function(sizes, reductions)),
                (*observed, *facts),
                (*reduction_memory, *step),
            )
        )
    body.append(Copy(acting[0], held[0]))
    if many:
        own = b.whole("acting", size, "work")
        if stage:
            load = b.whole("load", sizes["d"], "in")
            parts.append(Call(_product_function(sizes["d"], 3), (*stage, *load), own))
        stage = own
    parts.append(Call(advance, (*x, *held, *stage, *truth), x))
    body += [Repeat("parts", tuple(parts)), Guard(x[0], PLANT_FAILED)]
    counts = ("steps", "parts", "late") if record else ("steps", "parts")
    name = "ensemble" if many else "closed_loop"
    return Program(name, (*b.values(), *scratch), (Repeat("steps", tuple(body)),), counts)


def _waiting_steps(
    b: _Buffers, places: dict[str, Slice | None], controller: Controller
) -> tuple[tuple[Step, ...], tuple[Buffer, ...]]:
    """As `Controller.steps`, once something was measured, as `Controller.step` does: until then the memory stays, the
    input is that before the first sample, and there is no estimate."""
    memory, kept = cast("Slice", places["memory"]), controller.memory
    names = {"u": "next_u", "estimate": "next_estimate", "after": "next_memory"}
    sizes = [len(controller.law.input_names), len(controller.estimated), kept.size]
    (u,), (estimate,), (after,) = (
        b.whole(name, size, "work") for name, size in zip(names.values(), sizes, strict=True)
    )
    steps, scratch = controller.steps({**places, "u": u, "estimate": estimate, "after": after})
    (flag,), started = b.whole("measured", 1, "work"), kept.places["started"].start

    def measured(y: Any, memory: Any, *box: Any) -> Any:
        there = believable(y, *box) if box else known(y)
        return np.array([maximum(memory[started], reduce(maximum, there))])

    limits = (
        [controller.data.places[name] for name in ("measurement_lower", "measurement_upper")]
        if controller.mode.checks_measurements
        else []
    )
    data, p = cast("Slice", places["data"]), len(controller.measured)
    box = [replace(data, offset=data.offset + place.start, size=p) for place in limits]

    def chosen_step(flag: Any, u: Any, estimate: Any, after: Any, memory: Any) -> tuple[Any, ...]:
        before = memory[kept.places["u"]], np.full(len(estimate), np.nan), memory
        return tuple(by_flag(new, old, flag) for new, old in zip((u, estimate, after), before, strict=True))

    seen = trace(measured, p, kept.size, *(p for _ in box), name="measured")
    taken = trace(chosen_step, 1, *sizes, kept.size, name="chosen_step")
    read, written = (flag, u, estimate, after, memory), [places["u"], places["estimate"], memory]
    return (
        Call(seen, (cast("Slice", places["y"]), memory, *box), (flag,)),
        When(flag, steps),
        Call(taken, read, tuple(place for place in written if place is not None)),
    ), scratch


#: Samples whose noise is made side by side, in the lanes of vector registers.
BLOCK = 8


@cache
def noise_kernel(channels: int) -> Kernel:
    """Measurement noise (blocks, channels, `BLOCK`): of each channel, as many samples side by side."""
    b = _Buffers()
    step, key = b.whole("step", 1, "state"), b.whole("key", 3, "in", shared=True)
    deviation = b.whole("deviation", channels, "in", shared=True)
    noise = b.row("noise", channels, "out")
    body = (
        Normal(step[0], key[0], noise[0]),
        Call(_product_function(channels, 1), (*noise, *deviation), noise),
        Call(trace(_later, 1, name="later"), step, step),
    )
    program = Program("noise", tuple(b.values()), (Repeat("blocks", body),), ("blocks",))
    return compile_program(program, BLOCK)


def reduction_program(sizes: Mapping[str, int], reductions: Sequence[Reduction]) -> Program:
    """The reductions of a program of many runs alone, of the recorded signals of one run."""
    b = _Buffers()
    step, memory = b.whole("step", 1, "state"), b.whole("reduction_memory", _memory_size(reductions), "state")
    signals = {"state": "x", "estimate": "estimate", "output": "y", "input": "u", "reference": "r"}
    rows = [piece for name, size in signals.items() for piece in b.row(name, sizes[size], "in")]
    facts = b.whole("facts", 1 + 3 * sizes["r"], "in")
    function = drop_empty(_reduce_function(sizes, reductions))
    reduce = Call(function, (*step, *memory, *rows, *facts), (*memory, *step))
    return Program("reductions", tuple(b.values()), (Repeat("steps", (reduce,)),), ("steps",))


def _memory_size(reductions: Sequence[Reduction]) -> int:
    return sum(len(reduction.start) for reduction in reductions)


def _later(step: Any) -> Any:
    return step + float(BLOCK)


def _product_function(size: int, times: int) -> ca.Function:
    def product(rows: Any, factors: Any) -> Any:  # rounded before anything is added to the products
        return rows * np.tile(factors, times)

    return trace(product, size * times, size, name="product")


def _reduce_function(sizes: Mapping[str, int], reductions: Sequence[Reduction]) -> ca.Function:
    """(step, memory of the reductions, x, estimate, y, u, command, facts) → the next memory and step."""
    r = sizes["r"]

    def reduce(step: Any, kept: Any, x: Any, estimate: Any, y: Any, u: Any, command: Any, facts: Any) -> Any:
        rows = (facts[1 + k * r : 1 + (k + 1) * r] for k in range(3))
        now = Instant(step[0], x, estimate, y, u, command, facts[0], *rows)
        if not reductions:
            return step + 1.0
        memories = zip(reductions, np.split(kept, np.cumsum([len(rule.start) for rule in reductions])[:-1]))
        return np.concatenate([rule.updated(part, now) for rule, part in memories]), step + 1.0

    widths = (sizes[name] for name in ("x", "estimate", "y", "u"))
    return trace(reduce, 1, _memory_size(reductions), *widths, r, 1 + 3 * r, name="reduce")
