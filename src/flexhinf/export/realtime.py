"""A controller in real time: its samples on the wall clock, round a plant that integrates itself.

A sample sleeps until shortly before it is due and then watches the clock. Meanwhile there is no garbage collection, and
where the system permits it the process has a real-time priority and a core of its own. `Timing` has the times.
"""

# Not checked strictly: a caller may pass another type than stated.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

import copy
import ctypes
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from flexhinf.arrays import Numbers
from flexhinf.errors import refuse_if
from flexhinf.export.compiled import CompiledController
from flexhinf.export.controller_c import code_of
from flexhinf.loop import Controller, Loop, Stop, Trajectory
from flexhinf.loop.signals.references import SignalLike
from flexhinf.loop.simulation.closed_loop import AT_ONCE, Pacing
from flexhinf.loop.simulation.inputs import sample_count
from flexhinf.validation import value_text

#: Percentiles by which jitter is told; the last one is the largest value.
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "p99.99": 99.99, "max": 100.0}


class MissedSpan(NamedTuple):
    """Missed deadlines one after the other.

    Attributes
    ----------
    begin : float
        Time of the first sample, s.
    worst : float
        By how much the latest input of them came after its deadline, s.
    """

    begin: float
    samples: int
    worst: float


@dataclass(eq=False)
class Timing:
    """Times of every sample, s, on the monotonic clock of the system.

    Sample k is due at its time in the run; `woken`, `ready` and `over` count from that moment. Samples are not left
    out: after a delay they are made one after the other until the schedule is met again, as late as they then are. A
    run that is not in real time is due when it gets there: its lateness is zero.

    Attributes
    ----------
    real_time : bool
        Whether the samples waited for the clock.
    time : (N,)
        Of the run.
    woken : (N,)
        Lateness: when the sample began.
    computed : (N,)
        How long the controller's step took.
    ready : (N,)
        When the input was there.
    over : (N,)
        When the simulated robot had made its step and everything was recorded.
    elapsed : float
        From the beginning of the first sample to the end of the last one.
    missed, overrun : (N,)
        Whether the input was not there before the next sample was due, and whether the sample ended after that, the
        simulation of the robot included.
    slowness : float
        Elapsed time over the time of the run: 1 in real time.
    """

    period: float
    real_time: bool
    time: np.ndarray
    woken: np.ndarray
    computed: np.ndarray
    ready: np.ndarray
    over: np.ndarray
    elapsed: float

    def __post_init__(self) -> None:
        self.missed, self.overrun = self.ready > self.period, self.over > self.period
        self.slowness = self.elapsed / (self.period * max(1, len(self.time)))

    def missed_spans(self) -> list[MissedSpan]:
        """Where the missed deadlines lay, those with the latest input first."""
        edges = np.flatnonzero(np.diff(self.missed.astype(int), prepend=0, append=0)).reshape(-1, 2)
        spans = [
            MissedSpan(float(self.time[a]), int(b - a), float(self.ready[a:b].max() - self.period))
            for a, b in edges
        ]
        return sorted(spans, key=lambda span: -span.worst)


def percentiles(values: np.ndarray) -> dict[str, float]:
    """`PERCENTILES` of values (N,): each is a value that occurred, the smallest one that so many are not above.

    Of fewer than 10,000 values the 99.99th percentile is the largest one.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    places = [max(0, int(np.ceil(share / 100.0 * len(ordered) - 1e-9)) - 1) for share in PERCENTILES.values()]
    return {name: float(ordered[place]) for name, place in zip(PERCENTILES, places, strict=True)}


#: From the last sleep to the moment when a sample is due the clock is watched, ns: a sleep ends that much late at most
#: on a system that is not busy.
WATCHED_NS = 150_000

#: The first sample is due so long after the loop is ready, ns.
LEAD_NS = 2_000_000

#: Samples of a run before real time begins: all code is loaded and compiled by then.
REHEARSED = 4

#: Priorities of SCHED_FIFO.
PRIORITIES = (1, 99)

#: Linux: how late the kernel may wake a sleeping thread, by `prctl`.
_SET_TIMER_SLACK, _SLACK_NS = 29, 1


@dataclass(frozen=True, eq=False)
class RealTimeRun:
    """Result of a run in real time.

    Attributes
    ----------
    trajectory : Trajectory
        As of `Loop.run`; up to where it was stopped.
    timing : Timing
        Of the same samples.
    codes : (N,) array of int
        How each step ended; 0 is "OK".
    status : (N,) array of int
        Bits of `Controller.status` after each step.
    began : int
        When the first sample was due, ns since 1970.
    input_range : ((m,), (m,))
        Lower and upper limits of the inputs, infinite where there are none.
    stops : (N,) array of int
        Bits of `flexhinf.loop.Stop` after each step: why the drives may not act.
    powered : (N,) array of bool
        Whether they had power then; without it the run ends.
    stopped : int or None
        The signal that ended the run before its time; 0 where `watch` did; None for another end.
    scheduling : tuple of str
        What the system permitted, in sentences.
    """

    trajectory: Trajectory
    timing: Timing
    codes: np.ndarray
    status: np.ndarray
    stops: np.ndarray
    powered: np.ndarray
    code_names: dict[int, str]
    began: int
    input_range: tuple[np.ndarray, np.ndarray]
    stopped: int | None
    scheduling: tuple[str, ...]

    @property
    def stop(self) -> Stop:
        """Why a protective stop began; no reason where none did."""
        return Stop(int(self.stops[-1]) if len(self.stops) else 0)

    @property
    def stop_text(self) -> str:
        """When a protective stop began and why, when the power went, and what to look at; "" without one."""
        if not self.stop:
            return ""
        time = self.trajectory.time
        began, off = (float(time[np.argmax(which)]) for which in (self.stops > 0, ~self.powered))
        power = "they still have power" if self.powered.all() else f"they have no power from {off:g} s on"
        return (
            f"A protective stop began at {began:g} s: {self.stop}. Expected drives that may act to the end, got "
            f"{', '.join(str(bit.name) for bit in Stop if bit in self.stop)}, and {power}. Look at: {self.stop.look}."
        )


def run_realtime(
    loop: Loop,
    reference: SignalLike = None,
    disturbance: SignalLike = None,
    noise: Numbers = None,
    duration: float = 8.0,
    initial_state: Numbers = None,
    seed: int = 0,
    initial_input: Numbers = None,
    *,
    multi_turn: bool = False,
    initial_estimate: Numbers = None,
    library: CompiledController | None = None,
    real_time: bool = True,
    priority: int | None = None,
    core: int | None = None,
    watch: Callable[[], bool] | None = None,
    watch_every: float = 1.0 / 30.0,
) -> RealTimeRun:
    """Run a loop at the period of its controller on the wall clock.

    The signals are those of `Loop.run`, but that `Controller.may_act` is asked after each step and `Controller.output`
    acts: where the drives lose their power, the run ends, see `RealTimeRun.stop_text`. Ctrl-C (or SIGTERM, SIGHUP) in
    the main thread ends it after the sample that is being made, and what was recorded is returned; a second Ctrl-C
    interrupts.

    Parameters
    ----------
    loop : Loop
        Its true plant integrates itself, such as `flexhinf.robot.MuJoCoPlant`.
    reference, disturbance, noise, duration, initial_state, seed, initial_input, multi_turn
        As for `Loop.run`.
    initial_estimate : (n,) array, optional
        At which the controller's estimate starts, see `Controller.reset`.
    library : CompiledController, optional
        Steps instead of the loop's controller, of which it was compiled.
    real_time : bool
        Whether samples wait for the clock; otherwise they follow each other as fast as possible.
    priority, core : int, optional
        Of SCHED_FIFO, 1 to 99, and of the processor that the loop is kept on, where the system permits it.
    watch : callable, optional
        Called after a sample every `watch_every` seconds of the run, for a view; False ends the run.

    Raises InvalidInput: as `Loop.run`; for a plant that does not integrate itself, a library of another controller, or
    a priority or a core that there is not.

    >>> import flexhinf as fh
    >>> class Still(fh.BlackBox):  # an arm that does not move
    ...     reset, step, output = (lambda *_: None,) * 2 + (lambda self: [0.0] * 4,)
    >>> controller = fh.Controller(fh.linear_law(fh.paper_arm().problem(), gamma=200.0), None, 1e-3)
    >>> run = fh.run_realtime(fh.Loop(Still(), controller), duration=0.05)
    """
    for what, number, (low, high), advice in (
        ("real-time priority", priority, PRIORITIES, "80: above everything but the kernel's own threads"),
        ("processor core", core, (0, (os.cpu_count() or 1) - 1), "0"),
    ):
        refuse_if(
            number is not None and (not isinstance(number, int) or not low <= number <= high),
            f"There is no such {what}.", f"expected {low} to {high}, got {value_text(number)}", advice,
        )  # fmt: skip
    first = loop.controller.input_before(initial_input, initial_estimate)
    paced = partial(
        loop.run_paced, reference=reference, disturbance=disturbance, noise=noise, initial_state=initial_state,
        seed=seed, initial_input=first, multi_turn=multi_turn,
    )  # fmt: skip
    samples = sample_count(duration, period := loop.controller.period)
    clock = _Clock(loop, library, {"state": initial_estimate, "input": first}, samples, real_time)
    paced(AT_ONCE, clock, duration=period * min(samples - 1, REHEARSED))
    clock.reset()
    with undisturbed(priority, core) as scheduling, stopping() as clock.request:
        watch_samples = max(1, round(watch_every / period))

        def end(k: int) -> None:
            if watch is not None and k % watch_samples == 0 and not watch():
                clock.request.append(0)
            clock.end(k)

        run = paced(Pacing(clock.begin, end), clock, duration=duration)
    run = replace(run, settings={**run.settings, "real_time": real_time, "stepped": clock.name})
    count = len(run.time)
    return RealTimeRun(
        run, clock.timing(run.time), clock.codes[:count], clock.status[:count], clock.stops[:count],
        clock.powered[:count], clock.code_names, clock.began,
        (loop.controller.limits.lower, loop.controller.limits.upper),
        clock.stopped if count < samples and not run.message else None, scheduling,
    )  # fmt: skip


def check_library(library: CompiledController, controller: Controller) -> None:
    """Refuse a library of another controller: by its signals and its period, then by all that its inputs depend on."""
    own = {
        "period": controller.period, "measured": controller.measured, "commanded": controller.commanded,
        "inputs": tuple(controller.law.input_names), "states": controller.estimated,
    }  # fmt: skip
    for name, value in own.items():
        stated = getattr(library, name)
        refuse_if(
            stated != value,
            f"The library is not one of this controller: its {name} {'is' if name == 'period' else 'are'} others.",
            f"expected {value_text(value)}, got {value_text(stated)} in {library.path.name}",
            "flexhinf compile with the same design (a move in error coordinates has a controller of its own)",
        )
    expected = code_of(controller, "controller", "double").digest
    refuse_if(
        library.digest != expected,
        "The library is one of another controller: its numbers or its program are others.",
        f"expected the controller {expected[:12]}, got {library.digest[:12]} in {library.path.name}; signals and "
        "period are the same",
        "flexhinf compile with the same design, by this version",
    )


class _Clock:
    """Paces the samples, steps a controller with its own memory or a compiled library, and records all times."""

    def __init__(
        self, loop: Loop, library: CompiledController | None, start: dict[str, Numbers], samples: int, real_time: bool,
    ) -> None:  # fmt: skip
        self._period, self._start, self._real_time = loop.controller.period, start, real_time
        self.code_names, self.name = {0: "OK"}, "Controller.step"
        self._stepped: Controller | CompiledController = loop.controller.fresh()
        if library is not None:
            check_library(library, loop.controller)
            self._stepped = copy.copy(library)
            self.code_names |= library.code_numbers
            self.name = f"compiled library {library.path.name}"
        self._numbers = {name: number for number, name in self.code_names.items()}
        self._k, self._first = 0, 0
        # filled, so that no page of memory is missing when it is first written
        self._due, self._woken, self._computed, self._ready, self._over = np.full((5, samples), 0)
        self.codes, self.status, self.stops = np.full((3, samples), 0)
        self.powered = np.full(samples, True)
        self.request: list[int] = []
        self.began, self.stopped = 0, None
        self.reset()

    def reset(self) -> None:
        self._stepped.reset(**self._start)
        self._may_act = True

    estimate: np.ndarray = property(attrgetter("_stepped.estimate"))  # pyright: ignore[reportAssignmentType]
    path_rate: float = property(attrgetter("_stepped.path_rate"))  # pyright: ignore[reportAssignmentType]
    counts: Any = property(attrgetter("_stepped.counts"))

    def begin(self, k: int) -> bool:
        """Return when sample k is due; False where the run is to end."""
        if self.request:
            self.stopped = self.request[0]
        if self.request or not self._may_act:
            return False
        self._k, now = k, time.perf_counter_ns
        if k == 0:
            self._first = now() + LEAD_NS * self._real_time
            self.began = time.time_ns() + LEAD_NS * self._real_time
        due = self._first + round(1e9 * k * self._period) if self._real_time else now()
        self._due[k], self._woken[k] = due, wait_until(due) if self._real_time else due
        return True

    def step(self, y: Numbers, reference: Numbers) -> np.ndarray:
        start = time.perf_counter_ns()
        self._stepped.step(y, reference)
        self._may_act = self._stepped.may_act()
        u = self._stepped.output
        end, k = time.perf_counter_ns(), self._k
        self._computed[k], self._ready[k] = end - start, end
        if isinstance(self._stepped, CompiledController):
            self.codes[k] = self._numbers[self._stepped.code]
        self.status[k], self.stops[k] = int(self._stepped.status), int(self._stepped.stop)
        self.powered[k] = self._may_act
        return u

    def end(self, k: int) -> None:
        self._over[k] = time.perf_counter_ns()

    def timing(self, times: np.ndarray) -> Timing:
        n, due = len(times), self._due[: len(times)]
        ready = np.maximum(self._ready[:n], self._woken[:n])  # a step that failed has no end
        over = np.maximum(self._over[:n], ready)
        woken, ready, ended = (1e-9 * (row - due) for row in (self._woken[:n], ready, over))
        elapsed = 1e-9 * float(over[-1] - self._woken[0]) if n else 0.0
        return Timing(
            self._period, self._real_time, times, woken, 1e-9 * self._computed[:n], ready, ended, elapsed
        )


def wait_until(due: int) -> int:
    """Return as soon as `time.perf_counter_ns` is at least `due`, with its value then."""
    now = time.perf_counter_ns
    remaining = due - now() - WATCHED_NS
    if remaining > 0:
        time.sleep(1e-9 * remaining)
    while (at := now()) < due:
        pass
    return at


# The system -----------------------------------------------------------------------------------------
@contextmanager
def stopping() -> Generator[list[int]]:
    """A list that receives the number of a signal to stop; a second Ctrl-C interrupts as usual."""
    request: list[int] = []

    def stop(number: int, frame: object) -> None:
        if request and number == signal.SIGINT:
            raise KeyboardInterrupt
        request.append(number)

    names = ("SIGINT", "SIGTERM", "SIGHUP") if threading.current_thread() is threading.main_thread() else ()
    ending = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {n: handler for n in ending if (handler := signal.getsignal(n)) not in (signal.SIG_IGN, None)}
    for number in before:
        signal.signal(number, stop)
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def undisturbed(priority: int | None, core: int | None) -> Generator[tuple[str, ...]]:
    """No garbage collection, exact sleeps, and the priority and the core that the system permits; then as before.

    Yields sentences about what was permitted and what was not.
    """
    texts, undo = list[str](), ExitStack()
    if priority is not None:
        try:
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            undo.callback(os.sched_setscheduler, 0, *before)
            texts.append(f"The loop ran under SCHED_FIFO with priority {priority}.")
        except (AttributeError, OSError) as error:
            reason = getattr(error, "strerror", None) or "this system has none"
            texts.append(
                f"Real-time priority {priority} was not permitted ({reason}); the loop ran with the usual scheduling."
            )
    if core is not None:
        try:
            usual = os.sched_getaffinity(0)
            os.sched_setaffinity(0, {core})
            undo.callback(os.sched_setaffinity, 0, usual)
            texts.append(f"The loop was kept on core {core}.")
        except (AttributeError, OSError) as error:
            reason = getattr(error, "strerror", None) or "this system cannot"
            texts.append(f"The loop could not be kept on core {core} ({reason}).")
    if sys.platform == "linux":  # this thread's sleeps end when they are over, and not up to 50 µs later
        ctypes.CDLL(None).prctl(_SET_TIMER_SLACK, _SLACK_NS, 0, 0, 0)
    if gc.isenabled():
        undo.callback(gc.enable)
    gc.collect()
    gc.freeze()
    gc.disable()
    undo.callback(gc.unfreeze)
    with undo:
        yield tuple(texts)
