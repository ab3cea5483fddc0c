"""Memory of a controller between steps, which recovers from every bad sample; and its step as a program.

A step is a transaction: memory and estimate change where the step's numbers are all finite, and not otherwise. That
alone does not help against a wild measurement whose numbers are finite: a cubic law makes 1e18 V of 1e6 rad, and the
estimate leaves the finite numbers only some samples later. Two earlier memories are therefore kept, one every `SPACING`
good samples, measured or predicted alike. A step that fails leaves the memory as it was; where the next one fails too,
the memory itself is taken to be bad and an earlier one takes its place, `SPACING` to 2·`SPACING` good samples old, with
its command; where that fails as well, the one of the start. The start had no command yet, so the last one holds there;
where the start itself is restored again before a memory was kept, the command caused the failure and is reset too. A
start set by the user (`Controller.reset`) may be bad itself: then that of the design takes its place.

Before the first good measurement nothing is known of the robot: a sample without one changes nothing, and the output is
the input before the first sample (`Controller.input_before`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType, SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.codegen import Buffer, BufferPart, Copy, Guard, Program, Slice
from flexhinf.codegen.program import Step
from flexhinf.errors import InvalidInput, NumericalFailure, WrongPeriod
from flexhinf.loop.controller.protection import Pausing
from flexhinf.loop.controller.readings import Readings
from flexhinf.loop.controller.starting import Resting
from flexhinf.loop.controller.stop import StopState
from flexhinf.validation import real_array, value_text

Shape = tuple[int, ...]


class VectorLayout:
    """Layout of a flat vector of `size` numbers: shapes of its named parts, in their order, and their `places` in it.

    It is that of arrays by name, a list for a tuple of arrays.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.parts: dict[str, Shape | list[Shape]] = {
            name: [np.shape(array) for array in cast("list[Any]", value)]
            if isinstance(value, list)
            else np.shape(value)
            for name, value in values.items()
        }
        parts = [(n, shape) for n, p in self.parts.items() for shape in (p if isinstance(p, list) else [p])]
        ends = [0, *itertools.accumulate(math.prod(shape) for _, shape in parts)]
        self._arrays = [(*part, slice(*pair)) for part, pair in zip(parts, itertools.pairwise(ends))]
        self.size, self.places = ends[-1], dict[str, slice]()
        for name, _, place in self._arrays:
            self.places[name] = slice(self.places.get(name, place).start, place.stop)

    def named(self, vector: Any) -> SimpleNamespace:
        """The parts of a vector (size,) by name."""
        named: dict[str, Any] = {}
        for name, shape, place in self._arrays:
            array = vector[place.start : place.stop].reshape(shape)
            named[name] = (*named.get(name, ()), array) if isinstance(self.parts[name], list) else array
        return SimpleNamespace(**named)

    def pairs(self, values: Mapping[str, Any]) -> list[tuple[Any, slice]]:
        """Every array of named parts, and its place in the vector."""
        parts = (
            values[name] if isinstance(part, list) else [values[name]] for name, part in self.parts.items()
        )
        arrays = itertools.chain.from_iterable(parts)
        return [(array, place) for array, (_, _, place) in zip(arrays, self._arrays, strict=True)]

    def flat(self, values: Mapping[str, Any]) -> np.ndarray:
        """The vector (size,) of named parts; a plain number fills its part, and another shape is an InvalidInput."""
        pairs = zip(self._arrays, self.pairs(values))
        return np.concatenate([shaped(name, array, shape).ravel() for (name, shape, _), (array, _) in pairs])


def shaped(name: str, array: Any, shape: Shape) -> np.ndarray:
    """An array of this shape, of one or of a plain number; another is refused."""
    if np.shape(array) == shape:
        return np.asarray(array)
    if np.ndim(array):
        raise InvalidInput(
            f"The array {name!r} has the wrong shape.",
            f"expected {shape}, got {np.shape(array)}",
            "one element for each place",
        )
    return np.broadcast_to(np.asarray(array), shape)


def filler(buffer: np.ndarray) -> Callable[[Any], None]:
    """Copier of a value of exactly this size; a plain number goes straight in, as this runs in real time."""
    memory: Any = memoryview(buffer)  # type: ignore[arg-type]
    shape, array_type = buffer.shape, np.ndarray

    def fill_scalar(value: Any) -> None:
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

    return fill_scalar if buffer.size == 1 else fill


def measurement_filler(buffer: np.ndarray, gaps: bool) -> Callable[[Any], bool]:
    """As `filler`, and whether there is something in the value: False where no number is finite, if there may be
    `gaps`."""
    fill = filler(buffer)

    def fill_with_gaps(value: Any) -> bool:
        if value is None:
            buffer[:] = np.nan
            return False
        fill(value)
        numbers = buffer.tolist()
        total = sum(numbers)
        if total - total == 0.0:  # all are finite
            return True
        return any(number - number == 0.0 for number in numbers)

    def fill_whole(value: Any) -> bool:
        fill(value)
        return True

    return fill_with_gaps if gaps else fill_whole


#: How a compiled step ends where a number is not finite.
BAD_MEASUREMENT, BAD_REFERENCE, BAD_RESULT = 1, 2, 3

#: Samples between two earlier memories: longer than a wild estimate takes to leave the finite numbers (some five
#: samples with a cubic law), short against what the estimator needs to catch up.
SPACING = 32

#: Of how many steps the mean of their period is taken, and by which part of a period it may be off.
PERIODS_MEANT, SLIPPED = 32, 0.1

#: Periods between two steps from which on readings may have moved further, and from which on the robot may be
#: elsewhere.
PAUSES = (1.5, 3.0)

#: What is finite before the step, and after it.
ROLES = {"y": "in", "r": "in", "data": "in", "memory": "state", "u": "out", "estimate": "out"}


class RunCounts(NamedTuple):
    """Counts of a run, numbers or (N,) of many: samples at which the estimate was in doubt; the first one, from 1 on,
    at which a protective stop would have begun, 0 for none; and the bits of `flexhinf.stops.Stop` there."""

    doubtful: Any
    stop_sample: Any
    stop_bits: Any

    @staticmethod
    def in_memory(places: Mapping[str, slice], memory: np.ndarray) -> RunCounts:
        """Those of a memory (s,), or of memories (s, N) after other runs."""
        none = np.zeros(memory.shape[1:])
        doubtful = memory[places["doubt"]][1] if "doubt" in places else none
        return RunCounts(
            doubtful, *(memory[places["stop_record"]][1:] if "stop_record" in places else (none, none))
        )

    @staticmethod
    def places(places: Mapping[str, slice]) -> list[tuple[int, int]]:
        """Of each count that there is, its place here, and in a memory."""
        doubts = [(0, places["doubt"].start + 1)] if "doubt" in places else []
        stops = [(k, places["stop_record"].start + k) for k in (1, 2) if "stop_record" in places]
        return doubts + stops


#: Of a run without a controller that counts.
NO_COUNTS = RunCounts(0, 0, 0)

#: No place of a memory.
NOWHERE = slice(0)


def braking_place(places: Mapping[str, slice]) -> slice:
    """Where a memory says how far a brake is, and the path rate: behind whether the command is held."""
    stop = places.get("stop", NOWHERE)
    return slice(stop.start + 1, stop.stop) if stop.stop else NOWHERE


class StateHistory:
    """The memory of the last good sample, earlier ones, and how many good samples there were since one was kept.

    It is complete, so that a copy continues with the same bits, and `begin` clears everything. The exported C has the
    same numbers in its state. It starts from the memory (s,) of the design; the last command lies at `command` in it.

    `memory` (s,), `reference` (max(1, k),), the command and zeros, and `estimate` (n,), NaN before the first sample,
    are those of the last good sample: always the same arrays, which the compiled step writes. `waiting`: there was no
    good measurement yet. `holding`: the last command holds after the last going back, and not that of the earlier
    memory. `braking`: where the memory says how far a brake is, as fractions; a brake under way outlasts going back.
    `slip`: the mean by which the time between steps is off, in periods. `code`: how the last step ended, as exported C
    says it. `stop`: what a protective stop remembers, None before it was asked. `unseen`: for how many samples each
    sensor was missing, counted where no protection does. `resting`: what is remembered before a start.
    """

    def __init__(self, memory: np.ndarray, command: slice, states: int, braking: slice = NOWHERE) -> None:
        self.command, self.braking = command, braking
        self.memory, self.reference = np.array(memory), np.zeros(max(1, command.stop - command.start))
        self.estimate = np.full(states, np.nan)
        self.designed, self.start, self.older, self.newer = np.tile(memory, (4, 1))
        self.begin(memory)

    def begin(self, memory: np.ndarray) -> None:
        """Start again from a memory (s,)."""
        for place in (self.memory, self.start, self.older, self.newer):
            place[:] = memory
        self.estimate[:] = np.nan
        self.samples, self.waiting, self.slip, self.code = 0, True, 0.0, "WAITING"
        self.stop: StopState | None = None
        self.unseen: tuple[int, ...] = ()
        self.resting = Resting()
        self.failed = self.holding = self.begun_again = False
        self.hold_command()

    def go_on_from(self, other: StateHistory) -> None:
        """Have what another one has, in the arrays that the compiled step writes."""
        for name, value in vars(other).items():
            if isinstance(value, np.ndarray):
                getattr(self, name)[:] = value
            else:
                setattr(self, name, value)

    def hold_command(self) -> None:
        """Make the command of the last good sample the one that holds."""
        self.reference[: self.command.stop - self.command.start] = self.memory[self.command]

    def check_period(self, elapsed: float, period: float) -> None:
        """Note the time between two steps, s; 0 where it is not known, which forgets what was known before.

        A step whose time is negative, no number, or over three periods counts as two periods too long. Raises
        WrongPeriod where the mean over some `PERIODS_MEANT` steps is off by more than `SLIPPED` of a period: nothing is
        computed then. It is the rule of the exported C, with its bits.
        """
        if elapsed == 0.0:
            self.slip = 0.0
            return
        try:
            periods = elapsed / period
        except TypeError as error:
            raise InvalidInput(
                "The time since the step before is no number.",
                f"expected seconds, got {value_text(elapsed)}",
                "elapsed=1e-3; or 0 where it is not known",
            ) from error
        off = periods - 1.0 if 0.0 <= periods <= 3.0 else 2.0
        self.slip += (off - self.slip) / PERIODS_MEANT
        if abs(self.slip) > SLIPPED:
            self.code = "BAD_PERIOD"
            raise WrongPeriod(elapsed, period, self.slip)

    def look(
        self, places: Mapping[str, slice], fresh: ArrayLike | None, periods: float, protected: Pausing
    ) -> None:
        """Note what the caller says of the readings: which were measured since the last step (p,), 1, or 0 where that
        is not known, and after how many periods they come. After a pause they may have moved further; after a long one
        the robot may be elsewhere, offsets are taken anew, and signs wait for the readings to settle. It is the rule of
        the exported C."""
        readings = self.memory[places["readings"]].reshape(len(Readings._fields), -1)
        now = Readings(*readings)
        now.fresh[:] = 0.0 if fresh is None else np.maximum(fresh, 0.0)
        if not PAUSES[0] < periods < math.inf:
            return
        now.since[now.since > 0.0] += periods - 1.0
        if periods <= PAUSES[1]:
            return
        self.memory[places.get("offset_known", NOWHERE)] = 0.0
        self.memory[places.get("motion", NOWHERE)].reshape(4, -1)[2] = -protected.settles
        self.memory[places.get("opposed", NOWHERE)].reshape(2, -1)[1] = -protected.settles
        self.memory[places.get("away", NOWHERE)].reshape(3, -1)[1] = -protected.free
        self.memory[places.get("pauses", NOWHERE)] += float(periods > protected.longest)

    def count_unseen(self, y: np.ndarray) -> None:
        """Count for how many samples each element of the measurements (p,) was missing."""
        before = self.unseen or (0,) * len(y)
        self.unseen = tuple(0 if math.isfinite(number) else n + 1 for number, n in zip(y.tolist(), before))

    def good(self, measured: bool) -> None:
        """Note a good sample, and keep every `SPACING`th memory as an earlier one; the oldest is forgotten. Nothing is
        allocated: this is a part of the step in real time."""
        self.failed, self.waiting = False, self.waiting and not measured
        self.code = "OK" if measured else "PREDICTED"
        self.samples += 1
        if self.samples == SPACING:
            self.older, self.newer = self.newer, self.older
            self.newer[:] = self.memory
            self.samples, self.begun_again = 0, False

    def fail(self, code: int) -> bool:
        """Note that a step ended with a code, whose command then does not hold. Where its result was bad, for the
        second time since the last good sample, go back to an earlier memory (True)."""
        self.hold_command()
        self.code = {BAD_MEASUREMENT: "BAD_MEASUREMENT", BAD_REFERENCE: "BAD_COMMAND"}.get(code, "BAD_RESULT")
        if code != BAD_RESULT or not self.failed:
            self.failed = self.failed or code == BAD_RESULT
            return False
        self.code = "WENT_BACK"
        start = np.array_equal(self.older, self.start)
        if start and self.begun_again:  # the start that was told is bad itself
            self.start[:] = self.older[:] = self.designed
        self.holding, self.begun_again = start and not self.begun_again, start
        brake = self.memory[self.braking].copy()
        self.memory[:] = self.older
        self.memory[self.braking] = np.where(
            (brake >= 0.0) & (brake <= 1.0), brake, self.memory[self.braking]
        )
        self.older[:] = self.newer[:] = self.start
        if self.holding:
            self.memory[self.command] = self.reference[: self.command.stop - self.command.start]
        else:
            self.hold_command()
        return True


def step_program(
    sizes: Mapping[str, int],
    commanded: bool,
    gaps: bool,
    steps: Callable[[dict[str, Slice | None]], tuple[tuple[Step, ...], tuple[Buffer, ...]]],
    parts: Mapping[str, tuple[BufferPart, ...]] = MappingProxyType({}),
) -> Program:
    """One step as a transaction: `memory` and `estimate` are written where everything is finite.

    `sizes` are those of y, r, data, memory, u and estimate. `commanded` says whether a command is read, `gaps` whether
    elements of y may be missing, `steps` are those of `Controller.steps`, and `parts` of buffers have names.
    """
    roles: dict[str, Any] = ROLES
    buffers = [
        *(Buffer(name, sizes[name], role, parts=parts.get(name, ())) for name, role in roles.items()),
        Buffer("after", sizes["memory"], "work", cleared=False, parts=parts.get("after", ())),
        Buffer("estimated", sizes["estimate"], "work", cleared=False),
    ]
    whole = {buffer.name: Slice(buffer.name, size=buffer.size or 0) for buffer in buffers}
    places: dict[str, Slice | None] = {**whole, "estimate": whole["estimated"]}
    body, scratch = steps(places if commanded else {**places, "r": None})
    read = [] if gaps else [Guard(whole["y"], BAD_MEASUREMENT)]
    results = [Guard(whole[name], BAD_RESULT) for name in ("estimated", "after")]  # u is a part of the memory
    copies = Copy(whole["after"], whole["memory"]), Copy(whole["estimated"], whole["estimate"])
    every = (*read, Guard(whole["r"], BAD_REFERENCE), *body, *results, *copies)
    return Program("controller_step", (*buffers, *scratch), every, ())


def nothing_to_predict_with() -> InvalidInput:
    """The error of a sample without a measurement where there is no estimator."""
    return InvalidInput(
        "There is nothing to predict with: this controller feeds back the true state.",
        "expected the state, got None",
        "hold the last input for this sample, or a controller with an estimator",
    )


def step_failure(code: int, back: bool, y: Any, reference: Any) -> NumericalFailure:
    """The error of a compiled step that ended with a code; y and the command are its arguments, and `back` says whether
    an earlier memory has replaced its own."""
    arguments = f"y={value_text(y)}, reference={value_text(reference)}"
    lost = "The controller's estimate or input is no longer finite"
    kept = f"what it remembered {SPACING} to {2 * SPACING} good samples ago, or at its start"
    look = "then look at the measurement's unit, saturation= and the noise covariances"
    what, advice = {
        (BAD_MEASUREMENT, back): (
            "The measurement is not a finite number; nothing was updated.",
            "NaN for an element that is missing and step(None) for a sample without any, with an estimator; or hold "
            "the last input",
        ),
        (BAD_REFERENCE, back): (
            "The command is not a finite number; nothing was updated.",
            "another command",
        ),
        (BAD_RESULT, False): (
            f"{lost}; nothing was updated.",
            f"step(None) to predict over this sample; if it goes on, reset(); {look}",
        ),
        (BAD_RESULT, True): (
            f"{lost}, again; the controller went back to {kept}.",
            f"go on with the next measurement, or reset(state); {look}",
        ),
    }[code, back]
    return NumericalFailure(what, f"{'after' if code == BAD_RESULT else 'got'} {arguments}", advice)
