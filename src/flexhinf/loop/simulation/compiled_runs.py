"""One run on a compiled kernel, with its signals stored; and what runs are given, checked before they start: length,
initial state, size of commands, parameters and seeds of many plants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from flexhinf.codegen import Kernel, Program, compile_program
from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.shared import share
from flexhinf.loop.signals.motions import JerkLimited
from flexhinf.loop.signals.references import Constant, Quintic, Sine, Step
from flexhinf.loop.signals.sampling import check_seed
from flexhinf.loop.simulation.program import Channel, LoopSizes, loop_program
from flexhinf.loop.simulation.trajectory import STARTED, Trajectory
from flexhinf.plant import BlackBox, Plant
from flexhinf.validation import (
    checked_array,
    checked_positive,
    real_array,
    real_number,
    unknown_name,
    value_text,
)

#: Longest run, in samples.
MOST_SAMPLES = 20_000_000

#: A full turn, rad, with its rounding.
FULL_TURN = 2.0 * np.pi * (1.0 + 1e-9)

#: Signals whose values are written by a person.
WRITTEN = (Constant, JerkLimited, Quintic, Sine, Step)


def sample_count(duration: Any, period: float) -> int:
    """Number of samples of a run at 0, period, …, duration; a duration, s, that is not positive, shorter than a period,
    or longer than `MOST_SAMPLES` samples is refused."""
    seconds = checked_positive("The duration of a run", duration, "seconds", "8.0")
    samples = seconds / period + 1.0
    if samples < 1.5:
        raise InvalidInput(
            "The run is shorter than one period.",
            f"expected at least {period:g} s, got {seconds:g} s",
            "a duration in seconds, for example 8.0",
        )
    if samples > MOST_SAMPLES:
        most = f"{MOST_SAMPLES - 1} samples = {(MOST_SAMPLES - 1) * period:g} s"
        raise InvalidInput(
            "The run is too long for its period.",
            f"expected at most {most}, got {seconds:g} s",
            f"duration={1e-3 * seconds:g} if {seconds:g} ms was meant",
        )
    return round(samples)


def starting_state(given: Any, states: Sequence[str], controller: Controller) -> np.ndarray:
    """Initial state (n,) of a plant with these states.

    An array has one value per state of the plant, or per state of the plant that the law was designed for (the others
    are zero, as those that a mapping by name leaves out). None: where the controller starts, where its estimate
    begins; without an estimator, the law's operating point. Unknown names, another number of values, or values that are
    not finite are refused.
    """
    if given is None:
        named = {name: value for name, value in _designed_start(controller).items() if name in states}
    elif isinstance(given, Mapping):
        named = dict(given)
    else:
        values = real_array(given)
        fitting = [names for names in (states, controller.states) if values.shape == (len(names),)]
        if not fitting:
            raise InvalidInput(
                "The initial state does not fit the true plant.",
                f"expected {len(states)} values for {list(states)}, got {value_text(given)}",
                "a mapping by name, for example {'link_position': 0.1}, leaves the others at zero",
            )
        named = {name: float(value) for name, value in zip(fitting[0], values)}
    for name in named:
        if name not in states:
            raise unknown_name(f"There is no state {name!r}.", name, states)
    x = np.array([real_number(named.get(name, 0.0)) for name in states])
    if not np.all(np.isfinite(x)):
        raise InvalidInput("The initial state is not finite.", f"got {value_text(given)}", "finite numbers")
    return x


def _designed_start(controller: Controller) -> dict[str, float]:
    estimator, law = controller.estimator, controller.law
    start = law.operating_point if estimator is None else estimator.initial[0]
    return dict(zip(controller.states, np.asarray(start, dtype=float).tolist()))


def operating_state(states: Sequence[str], controller: Controller) -> np.ndarray:
    """The law's operating point as a state (n,) of a plant with these states, the others zero."""
    point = dict(zip(controller.states, np.asarray(controller.law.operating_point, dtype=float).tolist()))
    return np.array([point.get(name, 0.0) for name in states])


#: A state starts elsewhere from this difference on, and is at rest up to this rate, both relative to 1 and the plant's.
SAME_START = 1e-6


def start_text(
    plant: Plant | BlackBox, x: np.ndarray, given: bool, controller: Controller, before: np.ndarray
) -> str:
    """Where a run starts, beside where the controller does, and whether the true plant rests there.

    The state x (n,) is that of the run, by the plant's states, which somebody may have `given`; `before` (m,) is the
    input before the first sample.
    """
    own = _designed_start(controller)
    apart = {name: (value, own[name]) for name, value in zip(plant.states, x.tolist()) if name in own}
    name, (value, start) = max(
        apart.items(), key=lambda one: abs(one[1][0] - one[1][1]), default=("", (0.0, 0.0))
    )
    text = STARTED
    if abs(value - start) > SAME_START * max(1.0, abs(start)):
        text = f"{name} = {value:.6g}, the controller starts at {start:.6g}"
    if given or not isinstance(plant, Plant):
        return text
    rates = plant.derivative(x, before)
    worst = int(np.argmax(np.abs(rates)))
    if abs(rates[worst]) <= SAME_START * max(1.0, plant.fastest_mode(x, before)):
        return f"{text}, at rest"
    return f"{text}; the true plant does not rest there: d/dt {plant.states[worst]} = {rates[worst]:.3g}"


#: A command may exceed a limit by this fraction of the range, for rounding.
ROUNDING = 1e-9


def check_ranges(
    commands: np.ndarray,
    times: np.ndarray,
    names: Sequence[str],
    limits: Mapping[str, tuple[float, float]],
    units: Mapping[str, str],
) -> None:
    """Refuse commands (N, k) at times (N,) that leave the range of a state, by the names of the columns; what has no
    limits has no range. The InvalidInput names the state, the first time, the value and the range."""
    for name, column in zip(names, commands.T):
        if name not in limits:
            continue
        low, high = limits[name]
        slack = ROUNDING * (high - low)
        outside = np.flatnonzero((column < low - slack) | (column > high + slack))
        if len(outside):
            unit, first = units.get(name, ""), outside[0]
            raise InvalidInput(
                f"The reference leaves the range of {name!r}.",
                f"expected {low:g} to {high:g} {unit}, got {column[first]:.6g} {unit} at t = {times[first]:g} s",
                "a command within the joint's limits; angles are in rad",
            )


def check_turns(reference: Any, commands: np.ndarray, names: Sequence[str], units: Mapping[str, str]) -> None:
    """Refuse commands (N, k) beyond 2π rad that somebody wrote as a number: these are degrees more often than turns.

    Of the reference, as for `flexhinf.Loop.run`, numbers and the signals of `WRITTEN` are looked at; samples and
    functions are computed, not written. The InvalidInput names the state, the value, and as many degrees in rad.
    """
    parts = list(reference) if isinstance(reference, (list, tuple)) else [reference] * len(names)
    if isinstance(reference, Mapping):
        parts = [reference.get(name) for name in names]
    for name, part, column in zip(names, parts, commands.T):
        written = isinstance(part, WRITTEN) or not callable(part)
        largest = float(column[np.argmax(np.abs(column))])
        if written and units.get(name) == "rad" and abs(largest) > FULL_TURN:
            raise InvalidInput(
                f"The command of {name!r} is more than a full turn.",
                f"expected at most 2π = 6.283 rad, got {largest:.6g} rad",
                f"np.radians({largest:.6g}) = {np.radians(largest):.4g} if degrees were meant; "
                "run(..., multi_turn=True) for several turns",
            )


def checked_parameters(plant: Plant, parameters: Any) -> np.ndarray:
    """Rows (N, P) of an array, or of mappings by name; what does not fit the plant is refused."""
    table = plant.parameters
    if isinstance(parameters, Sequence) and all(isinstance(row, Mapping) for row in parameters):
        return table.vectors(parameters)
    rows = real_array(parameters)
    if rows.ndim != 2 or rows.shape[1] != table.size or not np.all(np.isfinite(rows)):
        raise InvalidInput(
            "The parameters do not fit the plant.",
            f"expected rows of {table.size} finite numbers for {list(table.names)}, got {value_text(parameters)}",
            "plant.parameters.vectors([...]), or mappings by name",
        )
    return rows


def checked_rows(what: str, given: Any, count: int, default: np.ndarray) -> np.ndarray:
    """Rows (N, k) of finite numbers, by default the same for all; others are refused."""
    shape = (count, len(default))
    if given is None:
        return np.broadcast_to(default, shape)
    expected = f"finite numbers of shape {shape}"
    return checked_array(
        f"The {what} do not fit the plants.", given, shape, expected, "one row for each plant"
    )


def checked_seeds(seeds: Any, count: int) -> tuple[int, ...]:
    """N seeds of one or of N integers; others are refused."""
    given = [seeds] * count if np.ndim(seeds) == 0 else list(seeds)
    for seed in given[:1] if np.ndim(seeds) == 0 else given:
        check_seed(seed)
    if len(given) != count:
        raise InvalidInput(
            "The seeds do not fit the plants.",
            f"expected {count} integers, got {len(given)}",
            "one for each plant",
        )
    return tuple(int(seed) for seed in given)


@dataclass(frozen=True, eq=False)
class LoopCode:
    """What of a loop is compiled: no parameter of plant or law, no time and no signal is in it. Loops with the same key
    share their kernels; plant, controller and channel are those of one of them."""

    key: tuple[object, ...]
    sizes: LoopSizes
    plant: Plant
    controller: Controller
    channel: Channel

    @classmethod
    def of(cls, plant: Plant, controller: Controller, channel: Channel, sub_steps: int) -> LoopCode:
        """Of a loop with so many Runge–Kutta steps per period, or a few more."""
        sizes = LoopSizes(
            plant.n, len(plant.inputs), len(controller.measured), len(controller.commanded), len(plant.disturbances),
            controller.memory.size, controller.data.size, len(controller.states), plant.parameters.size,
            capacity(sub_steps),
        )  # fmt: skip
        key = ("loop", plant.code_key, controller.code_key, sizes, channel.quanta)
        return cls(key, sizes, plant, controller, channel)

    def kernel(self) -> Kernel:
        """The whole run."""
        return share((*self.key, "run"), lambda: compile_program(self.program))

    @property
    def program(self) -> Program:
        """What runs."""
        build = lambda: loop_program(self.plant, self.controller, self.sizes, self.channel)  # noqa: E731
        return share((*self.key, "program"), build)


#: Signal and its size in `LoopSizes`, by the buffer that it is recorded in.
RECORDED = {
    "states": ("state", "x"), "estimates": ("estimate", "estimate"), "outputs": ("output", "y"),
    "inputs": ("input", "u"),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """A run before it is made.

    `times` (N,) are in s; `arrays` are what the kernel is given, by buffer (those that the loop does not have are left
    out), `recorded` signals that are known before the run, `parts` Runge–Kutta steps per period, `settings` for the
    trajectory.
    """

    code: LoopCode
    times: np.ndarray
    arrays: dict[str, np.ndarray]
    recorded: dict[str, np.ndarray]
    parts: int
    settings: dict[str, Any]

    @property
    def counts(self) -> dict[str, int]:
        """Turns of the kernel's loops, and elements of the inputs that wait."""
        late = self.code.channel.delay * self.code.sizes.u
        return {"steps": len(self.times), "parts": self.parts, "late": late}

    @property
    def inputs(self) -> dict[str, np.ndarray]:
        """Arrays that the kernel reads, by buffer; those that it writes to are new."""
        used = [buffer for buffer in self.code.program.buffers if buffer.name in self.arrays]
        return {
            buffer.name: self.arrays[buffer.name].copy()
            if buffer.role == "state"
            else self.arrays[buffer.name]
            for buffer in used
        }

    @property
    def outputs(self) -> dict[str, np.ndarray]:
        """New arrays for what is recorded, by buffer; before the inputs stand those that wait."""
        samples, sizes = len(self.times), self.code.sizes
        arrays = {name: np.zeros(samples * getattr(sizes, size)) for name, (_, size) in RECORDED.items()}
        waiting = np.tile(self.arrays["held"], self.code.channel.delay)
        return {**arrays, "inputs": np.concatenate([waiting, arrays["inputs"]])}

    def alone(self) -> Trajectory:
        """Make this run."""
        return self.outcome()[0]

    def outcome(self) -> tuple[Trajectory, int, int]:
        """Make this run; its trajectory, and the code and the last sample of its `Status`."""
        outputs = self.outputs
        status = self.code.kernel().run({**self.inputs, **outputs}, self.counts)
        code, last = int(status.code), int(status.step)
        return self.trajectory(outputs, code, last), code, last

    def trajectory(self, outputs: Mapping[str, np.ndarray], code: int, last: int) -> Trajectory:
        """What the run recorded, up to its end; the inputs stand behind those that waited before."""
        samples, signals = len(self.times), {}
        for name, (signal, size) in RECORDED.items():
            whole = outputs[name]
            signals[signal] = whole[whole.size - samples * getattr(self.code.sizes, size) :].reshape(
                samples, -1
            )
        signals |= self.recorded
        plant, controller = self.code.plant, self.code.controller
        return Trajectory.until(plant, controller, self.times, signals, self.settings, code, last)


def capacity(sub_steps: int) -> int:
    """Sub-steps that the arrays of a disturbance have room for: a few more, so that few kernels serve many loops."""
    return 1 << (sub_steps - 1).bit_length()


@lru_cache(4)
def zeros(size: int) -> np.ndarray:
    """Zeros (size,), read-only: one array for all runs, since fresh memory for each takes as long as the run."""
    found = np.zeros(size)
    found.setflags(write=False)
    return found
