"""What a controller remembers between steps and the numbers its step is made of: flat vectors with a layout.

What a running controller remembers, so that no sample can leave it stuck; and its step as a program.

A step is a transaction: memory and estimate change where the step's numbers are all finite, and not otherwise. That
alone does not help against a wild measurement whose numbers are finite: a cubic law makes 1e18 V of 1e6 rad, and the
estimate leaves the finite numbers only some samples later. Two earlier memories are therefore kept, one every `SPACING`
good samples, measured or predicted alike. A step that fails leaves the memory as it was; where the next one fails too,
the memory itself is taken to be bad and an earlier one takes its place, `SPACING` to 2·`SPACING` good samples old, with
its command; where that fails as well, the one of the start. The start had no command yet, so the last one holds there;
where the start is gone back to again before a memory was kept, the command was what made it fail, and is that of the
start too. Where the start was told (`Controller.reset`), it may be bad itself: then that of the design takes its place.

Before the first good measurement nothing is known of the robot: a sample without one changes nothing, and the output is
the input before the first sample (`Controller.input_before`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np

from flexhinf.codegen import Buffer, Copy, Guard, Program, Slice
from flexhinf.codegen.program import Step
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.loop.controller.options import Limits, Mode
from flexhinf.loop.controller.schedule import inverse_slope
from flexhinf.loop.controller.step import LawCode
from flexhinf.plant import Estimator
from flexhinf.validation import real_array, value_text

Shape = tuple[int, ...]


@dataclass(frozen=True)
class Layout:
    """Shapes by name; a list of shapes for a part that is a tuple of arrays.

    Parameters
    ----------
    parts : mapping of str to shape or list of shapes
        In the order of the vector.
    """

    parts: Mapping[str, Shape | list[Shape]]

    @cached_property
    def size(self) -> int:
        """Length of the vector."""
        return sum(int(np.prod(shape, dtype=int)) for part in self.parts.values() for shape in _shapes(part))

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where each part lies in the vector."""
        places, start = {}, 0
        for name, part in self.parts.items():
            size = sum(int(np.prod(shape, dtype=int)) for shape in _shapes(part))
            places[name] = slice(start, start + size)
            start += size
        return places

    def named(self, vector: Any) -> SimpleNamespace:
        """The parts of a vector (size,) by name."""
        start, named = 0, {}
        for name, part in self.parts.items():
            arrays = []
            for shape in _shapes(part):
                length = int(np.prod(shape, dtype=int))
                arrays.append(vector[start : start + length].reshape(shape))
                start += length
            named[name] = tuple(arrays) if isinstance(part, list) else arrays[0]
        return SimpleNamespace(**named)

    def pairs(self, values: Mapping[str, Any]) -> list[tuple[Any, slice]]:
        """Every array of named parts, and its place in the vector."""
        pairs, start = [], 0
        for name, part in self.parts.items():
            arrays = values[name] if isinstance(part, list) else [values[name]]
            for shape, array in zip(_shapes(part), arrays, strict=True):
                size = int(np.prod(shape, dtype=int))
                pairs.append((array, slice(start, start + size)))
                start += size
        return pairs

    def flat(self, values: Mapping[str, Any]) -> np.ndarray:
        """The vector (size,) of named parts; a plain number fills its part.

        Raises
        ------
        InvalidInput
            If an array has another shape than its part.
        """
        flat = []
        for name, part in self.parts.items():
            arrays = values[name] if isinstance(part, list) else [values[name]]
            for shape, array in zip(_shapes(part), arrays, strict=True):
                if np.shape(array) not in ((), shape):
                    raise InvalidInput(
                        f"The array {name!r} has the wrong shape.",
                        f"expected {shape}, got {np.shape(array)}",
                        "one element for each place",
                    )
                flat.append(np.broadcast_to(np.asarray(array), shape).ravel())
        return np.concatenate(flat)


def _shapes(part: Any) -> list[Shape]:
    return part if isinstance(part, list) else [part]


def memory_layout(
    estimator: Estimator | None, mode: Mode, inputs: int, tracked: int, commanded: int
) -> Layout:
    """What is remembered from one step to the next."""
    k = tracked
    parts: dict[str, Any] = {}
    if estimator is not None:
        parts["belief"] = [np.shape(part) for part in estimator.initial]
    parts |= {"u": (inputs,), "integral": (k,), "position": (k,), "reference": (commanded,), "started": (1,)}
    if mode.takes_over:
        parts["bias"] = (inputs,)
    if mode.laws > 1:
        parts["active"] = (mode.laws,)
    if mode.limits_command:
        parts["command"] = (k,)
    return Layout(parts)


def data_layout(code: LawCode, estimator: Estimator | None, mode: Mode, tracked: int) -> Layout:
    """Numbers the step is made of: changing them compiles nothing; those of several laws in rows."""
    n, m, k = len(code.law.state_names), len(code.law.input_names), tracked
    several = (mode.laws,) if mode.laws > 1 else ()
    parts: dict[str, Any] = {"period": (1,), "law": (mode.laws * code.data.size,)}
    parts |= {"operating_point": (*several, n), "operating_input": (*several, m)}
    parts |= {"lower": (m,), "upper": (m,), "integral_gain": (*several, m, k)}
    if estimator is not None:
        size, p = estimator.plant.n, len(estimator.plant.outputs)
        parts |= {"parameters": (estimator.plant.parameters.size,)}
        parts |= {"process_noise": (size, size), "measurement_noise": (p, p)}
    if mode.takes_over:
        parts |= {"inverse_slope": (*several, k, m), "decay": (1,)}
    if mode.laws > 1:
        parts["closer"] = (1,)
    if mode.limits_input_rate:
        parts["input_rate"] = (m,)
    if mode.limits_command:
        parts |= {"command_lower": (k,), "command_upper": (k,), "command_rate": (k,)}
    if mode.has_dead_zone:
        parts["integral_dead_zone"] = (k,)
    if mode.bounds_windup:
        parts |= {"windup_line": (*several, m, k), "windup_spread": (*several, m, k), "windup_limit": (m,)}
    return Layout(parts)


def data_values(
    codes: list[LawCode],
    estimator: Estimator | None,
    mode: Mode,
    tracked: int,
    limits: Limits,
    command: Limits,
) -> dict[str, Any]:
    """The numbers of laws, limits and estimator by name."""

    def rows(parts: list[Any]) -> Any:
        return np.stack(parts) if mode.laws > 1 else parts[0]

    gains = [code.slope[:, len(code.law.state_names) - tracked :] for code in codes]
    values: dict[str, Any] = {
        "law": np.concatenate([code.data for code in codes]),
        "operating_point": rows([code.law.operating_point for code in codes]),
        "operating_input": rows([code.law.operating_input for code in codes]),
        "lower": limits.lower, "upper": limits.upper, "input_rate": limits.rate,
        "command_lower": command.lower, "command_upper": command.upper, "command_rate": command.rate,
        "integral_gain": rows(gains),
    }  # fmt: skip
    if mode.takes_over:
        values["inverse_slope"] = rows([inverse_slope(gain) for gain in gains])
    if estimator is not None:
        values["parameters"] = estimator.plant.parameters.vector()
        values["process_noise"] = estimator.process_noise
        values["measurement_noise"] = estimator.measurement_noise
    return values


def filler(buffer: np.ndarray) -> Callable[[Any], None]:
    """How to copy a value of exactly this size: on the real-time path, so a plain number goes straight in."""
    memory: Any = memoryview(buffer)  # type: ignore[arg-type]
    shape, array_type = buffer.shape, np.ndarray

    def fill_one(value: Any) -> None:
        if type(value) is array_type:
            memory[0] = value.item()
        elif isinstance(value, float):
            memory[0] = value
        else:
            memory[0] = real_array(value, strict=True).item()

    def fill(value: Any) -> None:
        if type(value) is array_type and value.shape == shape and value.dtype == buffer.dtype:
            buffer[:] = value
            return
        array = real_array(value, strict=True)
        if array.shape != shape:
            raise ValueError(array.shape)
        buffer[:] = array

    return fill_one if buffer.size == 1 else fill


#: How a compiled step ends where a number is not finite.
BAD_MEASUREMENT, BAD_REFERENCE, BAD_RESULT = 1, 2, 3

#: Samples between two earlier memories: longer than a wild estimate takes to leave the finite numbers (some five
#: samples with a cubic law), short against what the estimator needs to catch up.
SPACING = 32

#: What is finite before the step, and after it.
ROLES = {"y": "in", "r": "in", "data": "in", "memory": "state", "u": "out", "estimate": "out"}


class Remembered:
    """The memory of the last good sample, earlier ones, and how many good samples there were since one was kept.

    All of it is here, so that a copy goes on with the same bits, and `begin` leaves nothing of before. The exported C
    has the same numbers in its state.

    Parameters
    ----------
    memory : (s,) array
        At the start of the design; copied.
    commanded, states : int
        Numbers of a command and of an estimate.

    Attributes
    ----------
    memory : (s,) array
        Of the last good sample; always the same array, which the compiled step writes.
    reference : (max(1, k),) array
        The command of the last good sample, and zeros; likewise.
    estimate : (n,) array
        Likewise; NaN before the first sample.
    waiting : bool
        Whether there was no good measurement yet.
    holding : bool
        Whether the last command holds after the last going back, and not that of the earlier memory.
    """

    def __init__(self, memory: np.ndarray, commanded: int, states: int) -> None:
        self.memory, self.reference = np.array(memory), np.zeros(max(1, commanded))
        self.estimate = np.full(states, np.nan)
        self.designed, self.start, self.older, self.newer = np.tile(memory, (4, 1))
        self.begin(memory)

    def begin(self, memory: np.ndarray) -> None:
        """Start again from a memory (s,)."""
        for place in (self.memory, self.start, self.older, self.newer):
            place[:] = memory
        self.estimate[:] = np.nan
        self.samples = 0
        self.waiting = True
        self.failed = self.holding = self.begun_again = False

    def good(self, measured: bool) -> None:
        """Note a good sample, and keep every `SPACING`th memory as an earlier one; the oldest is forgotten. Nothing is
        allocated: this is a part of the step in real time."""
        self.failed = False
        if measured:
            self.waiting = False
        self.samples += 1
        if self.samples == SPACING:
            self.older, self.newer = self.newer, self.older
            self.newer[:] = self.memory
            self.samples, self.begun_again = 0, False

    def fail(self) -> bool:
        """Note that a step has failed; where one did since the last good sample, go back to an earlier memory, and say
        so."""
        if not self.failed:
            self.failed = True
            return False
        start = np.array_equal(self.older, self.start)
        if start and self.begun_again:  # the start that was told is bad itself
            self.start[:] = self.older[:] = self.designed
        self.holding = start and not self.begun_again
        self.begun_again = start
        self.memory[:] = self.older
        self.older[:] = self.newer[:] = self.start
        return True

    def state(self) -> dict[str, Any]:
        """Everything that is remembered, for `restore`; arrays are copies."""
        return {
            name: np.copy(part) if isinstance(part, np.ndarray) else part for name, part in vars(self).items()
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Remember what another one of this size did; the arrays that the compiled step writes stay."""
        for name, part in state.items():
            if isinstance(part, np.ndarray):
                getattr(self, name)[:] = part
            else:
                setattr(self, name, part)


def step_program(
    sizes: Mapping[str, int],
    commanded: bool,
    steps: Callable[[dict[str, Slice | None]], tuple[tuple[Step, ...], tuple[Buffer, ...]]],
) -> Program:
    """One step as a transaction: `memory` and `estimate` are written where everything is finite.

    Parameters
    ----------
    sizes : mapping of str to int
        Numbers in each of y, r, data, memory, u and estimate; without y, the step has no measurement.
    commanded : bool
        Whether a command is read.
    steps : callable
        As `Controller.steps`.
    """
    roles: dict[str, Any] = {name: role for name, role in ROLES.items() if name in sizes}
    buffers = [Buffer(name, sizes[name], role) for name, role in roles.items()]
    buffers += [
        Buffer("after", sizes["memory"], "work", cleared=False),
        Buffer("estimated", sizes["estimate"], "work", cleared=False),
    ]
    whole = {buffer.name: Slice(buffer.name, size=buffer.size or 0) for buffer in buffers}
    places: dict[str, Slice | None] = {"y": None, **whole, "estimate": whole["estimated"]}
    body, scratch = steps(places if commanded else {**places, "r": None})
    read = [Guard(whole["y"], BAD_MEASUREMENT)] if "y" in sizes else []
    whole_body = (
        *read,
        Guard(whole["r"], BAD_REFERENCE),
        *body,
        Guard(whole["u"], BAD_RESULT),
        Guard(whole["estimated"], BAD_RESULT),
        Guard(whole["after"], BAD_RESULT),
        Copy(whole["after"], whole["memory"]),
        Copy(whole["estimated"], whole["estimate"]),
    )
    return Program("controller_step", (*buffers, *scratch), whole_body, ())


def step_failure(code: int, back: bool, y: Any, reference: Any) -> NumericalFailure:
    """The error of a compiled step that ended with a code; y and the command are those it was given.

    Parameters
    ----------
    back : bool
        Whether an earlier memory has taken the place of the one it ran on.
    """
    if code != BAD_RESULT:
        advice = "another command"
        if code == BAD_MEASUREMENT:
            advice = "step(None) to predict over a sample without a measurement, or hold the last input"
        return NumericalFailure(
            f"The {'measurement' if code == BAD_MEASUREMENT else 'command'} is not a finite number; "
            "nothing was updated.",
            f"got y={value_text(y)}, reference={value_text(reference)}",
            advice,
        )
    if back:
        return NumericalFailure(
            "The controller's estimate or input is no longer finite, again; the controller went back to what it "
            f"remembered {SPACING} to {2 * SPACING} good samples ago, or at its start.",
            f"after y={value_text(y)}, reference={value_text(reference)}",
            "go on with the next measurement, or reset(state); then look at the measurement's unit, saturation= and "
            "the noise covariances",
        )
    return NumericalFailure(
        "The controller's estimate or input is no longer finite; nothing was updated.",
        f"after y={value_text(y)}, reference={value_text(reference)}",
        "step(None) to predict over this sample; if it goes on, reset(), and look at the measurement's unit, "
        "saturation= and the noise covariances",
    )
