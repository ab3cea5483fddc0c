"""Recorded runs of a controller: what was measured and commanded, and what it answered, sample by sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.loop import Controller, Loop, Samples, Status
from flexhinf.loop.controller.memory import StateHistory
from flexhinf.loop.controller.options import equilibrium_line
from flexhinf.validation import read_only

#: How a sample ends, by the name of the code that a step in C returns for it.
MEASURED, MISSING, NOT_FINITE, FAILED = "OK", "PREDICTED", "BAD_MEASUREMENT", "BAD_RESULT"

#: A sample of whose measurement the first element is no number.
GAP = "gap"

#: Size of the commands' swing about the operating point, in the unit of the tracked states, and its periods, samples.
SWING, PERIODS = 0.05, (97, 61)

#: How much further than to the limit of an input positions are moved, and the furthest, in the unit of the measurement.
BEYOND, FARTHEST = 1.5, 10.0

#: Largest standard deviation of the noise in a recorded loop, in the unit of the measurement: the swing is to be seen.
LOUDEST = 0.1 * SWING

#: No memory is replaced.
NONE: Mapping[int, np.ndarray] = MappingProxyType({})

#: Fields of a recording that are lists, a number or a text for each row.
LISTS = ("kinds", "codes", "status", "path_rate", "doubtful", "hashes")


@dataclass(frozen=True, eq=False)
class Provocation:
    """What is given to a controller: `y` (K, p) and `r` (K, k), each for so many samples as `repeats` says.

    `numbers`: Those of the step in place of the design's. `state`, `input`: Where it starts; None as it does by itself.
    `unmeasured`: Rows without a measurement. `memories`: What its memory is replaced by before some rows, by the number
    of the row; such a row may end in no finite number. `noises`: What the numbers at the places `noise` are from some
    rows on, likewise by number, in order.
    """

    y: np.ndarray
    r: np.ndarray
    repeats: list[int]
    numbers: np.ndarray
    state: np.ndarray | None
    input: np.ndarray | None
    memories: dict[int, np.ndarray]
    unmeasured: tuple[int, ...] = ()
    noise: tuple[int, ...] = ()
    noises: Mapping[int, np.ndarray] = field(default_factory=dict[int, np.ndarray])

    def begun(self, controller: Controller) -> Controller:
        """A fresh controller with these numbers, started there."""
        fresh = controller.fresh()
        fresh.data_vector = read_only(np.array(self.numbers))
        fresh.reset(self.state, self.input)
        return fresh

    def with_noise(self, going: Controller, noise: np.ndarray) -> Controller:
        """One that goes on from what a controller remembers, with these numbers at the places `noise`."""
        fresh, numbers = going.fresh(), np.array(self.numbers)
        numbers[list(self.noise)] = noise
        fresh.data_vector = read_only(numbers)
        history_of(fresh).go_on_from(history_of(going))
        return fresh

    def answered(self, controller: Controller) -> Recording:
        """What a controller does."""
        going, ends = self.begun(controller), [*self.noises, None]
        run = self.feed_to(going, 0, ends[0])
        for (row, noise), end in zip(self.noises.items(), ends[1:], strict=True):
            going = self.with_noise(going, noise)
            run = run.behind(self.feed_to(going, row, end, held=run.u[-1]))
        return run

    def feed_to(
        self, begun: Controller, first: int = 0, end: int | None = None, held: np.ndarray | None = None
    ) -> Recording:
        """What a controller does in rows from the first one to before the end, that has had the rows before; `held` is
        its last output there."""
        part = slice(first, len(self.y) if end is None else end)
        kinds = [MISSING if k in self.unmeasured else MEASURED for k in range(part.start, part.stop)]
        memories = {k - first: memory for k, memory in self.memories.items()}
        return feed(begun, self.y[part], self.r[part], kinds, self.repeats[part], memories, held)


@dataclass(frozen=True, eq=False)
class Recording:
    """Recorded samples of a controller, in order.

    `y`, `r`: (K, p), (K, max(1, k)) arrays, measurements and commands. `u`, `estimate`: (K, m), (K, n) arrays, outputs
    of the controller, held where the sample was refused. `kinds`: How each sample was given, see `replay`. `codes`:
    "OK", "PREDICTED" or "BAD_MEASUREMENT", one for each sample. `status`, `path_rate`, `rejected` (K, p), `doubtful`:
    Those of the controller after each sample. `hashes`: `memory_hash` of what it
    remembers then.
    `unseen` (K, p): Samples since each measurement was there, where the C tells them.
    `moved`: The first sample at which measured positions are moved from outside; None without any. `provocation`: What
    is given in the rows from `begun` on; each row before is one sample.
    """

    y: np.ndarray
    r: np.ndarray
    u: np.ndarray
    estimate: np.ndarray
    kinds: list[str]
    codes: list[str]
    status: list[int]
    path_rate: list[float]
    rejected: np.ndarray
    doubtful: list[int]
    hashes: list[int]
    memory_rows: np.ndarray
    moved: int | None = None
    provocation: Provocation | None = None
    unseen: np.ndarray | None = None

    @property
    def begun(self) -> int:
        """The first row of the provocation; how many rows there are without one."""
        return len(self.y) - (0 if self.provocation is None else len(self.provocation.y))

    @property
    def repeats(self) -> list[int]:
        """How often each row is given."""
        return [1] * self.begun + ([] if self.provocation is None else self.provocation.repeats)

    @property
    def parts(self) -> dict[str, slice]:
        """Rows of one kind: of the loop, where positions are moved from outside, and of the provocation."""
        moved = self.begun if self.moved is None else self.moved
        found = {
            "": slice(0, moved),
            "moved": slice(moved, self.begun),
            "provoked": slice(self.begun, len(self.y)),
        }
        return {name: part for name, part in found.items() if part.stop > part.start}

    def followed_by(self, one: Provocation, controller: Controller) -> Recording:
        """This, and behind it what a controller does when it is provoked."""
        other = one.answered(controller)
        return replace(self.behind(other), provocation=one)

    def behind(self, other: Recording) -> Recording:
        """This, and the other behind it."""
        arrays: dict[str, np.ndarray] = {
            one.name: np.concatenate([getattr(self, one.name), getattr(other, one.name)])
            for one in fields(self)
            if isinstance(getattr(self, one.name), np.ndarray)
        }
        lists = {name: getattr(self, name) + getattr(other, name) for name in LISTS}
        return replace(self, **arrays, **lists)


def record(
    controller: Controller,
    samples: int = 200,
    interrupted: bool = True,
    exact: type[np.floating] = np.float64,
) -> Recording:
    """Run a closed loop of the controller and the plant that its estimator believes in, with noise.

    The noise is that of the estimator's model: without it, measurements equal predictions, and a wrong gain would not
    be seen. The plant starts where the estimator believes it: started elsewhere, inputs may stay at their limits, and
    any code would answer that. The commands swing about the operating point within the limits of the states, a moving
    reference along its equilibria; without an estimator there is no plant, and the states swing too. In the last
    quarter the measured positions leave the loop and come back, as far as an input needs to come to its limit where it
    follows in proportion and limits of measurements let it; not where an input has no limit, or a gate judges
    measurements.

    `controller`: Only read. `interrupted`: Replay what was measured with samples left out and samples that are not
    finite. `exact`: Of numbers that hold the measurements and commands as they are.
    """
    time = np.arange(samples)[:, None]
    operating_reference = controller.operating_reference
    j = np.arange(len(controller.tracked if controller.mode.moving else operating_reference))
    swing = (
        SWING
        * _room(controller, len(j))
        * (np.sin(2.0 * np.pi * time / np.take(PERIODS, j % 2) + j) - np.sin(j))
    )
    if controller.mode.moving:
        swing = swing @ _standstills(controller).T
    r = operating_reference + swing
    if controller.estimator is None:
        point = np.asarray(controller.law.operating_point)[: len(controller.states)]
        y = point + 0.01 * np.sin(2.0 * np.pi * time / (40 + 7 * np.arange(len(point))))
    else:
        estimator, times = controller.estimator, controller.period * np.arange(samples)
        run = Loop(estimator.plant, controller).run(
            {name: Samples(times, column) for name, column in zip(controller.commanded, r.T, strict=True)},
            noise=np.minimum(np.sqrt(np.diag(np.atleast_2d(estimator.measurement_noise))), LOUDEST),
            duration=controller.period * (samples - 1),
            initial_state=np.asarray(estimator.initial[0], dtype=float),
        )
        y = run.signals["output"][:samples]
    kinds = np.full(samples, MEASURED, dtype=object)
    if interrupted:
        kinds[samples // 3 : samples // 3 + 3] = GAP
        if controller.estimator is not None:
            kinds[samples // 2 : samples // 2 + 5] = MISSING
    r, kinds = r.astype(exact).astype(float), list(kinds)
    run = replay(controller, y.astype(exact).astype(float), r, kinds)
    first = samples - samples // 4
    y = _moved(controller, run, first)
    return (
        run
        if y is None
        else replace(replay(controller, y.astype(exact).astype(float), r, kinds), moved=first)
    )


def memory_hash(memory: np.ndarray) -> int:
    """FNV-1a of the bits of numbers in double, eight bytes at a time: a test compares all of a memory by one number."""
    found = 0xCBF29CE484222325
    for bits in np.ascontiguousarray(memory, dtype=np.float64).view(np.uint64).tolist():
        found = ((found ^ bits) * 0x100000001B3) % 2**64
    return found


def history_of(controller: Controller) -> StateHistory:
    """What a controller remembers, which only a test reads and replaces."""
    return controller._history  # pyright: ignore[reportPrivateUsage]


def _moved(controller: Controller, run: Recording, first: int) -> np.ndarray | None:
    """Measurements (K, p) of a run in which the positions are moved away and back from this sample on, as far as inputs
    need to reach a limit if they follow in proportion, and half as far and fast as limits of measurements let them;
    None where nothing is moved: a gate judges them, none is a position, or an input has no limit."""
    estimator, (lower, upper) = controller.estimator, (controller.limits.lower, controller.limits.upper)
    judged = getattr(estimator, "gate", None) is not None
    moved = [estimator is not None and "position" in name for name in controller.measured]
    if judged or not any(moved) or not np.isfinite([lower, upper]).all():
        return None
    shape, last = np.zeros((len(run.y), 1)), len(run.y) - first
    shape[first:, 0] = np.sin(np.pi * np.arange(last) / last) ** 2

    def by(distance: float) -> np.ndarray:
        return run.y + distance * shape * moved

    tried = min(SWING, _farthest(controller, run, last))
    answered = replay(controller, by(tried), run.r[:, : len(controller.commanded)], run.kinds).u - run.u
    room = np.where(answered > 0.0, upper - run.u, run.u - lower)
    needed = (room / np.maximum(np.abs(answered), 1e-12))[first:].min()
    return by(min(tried * max(1.0, BEYOND * needed), FARTHEST, _farthest(controller, run, last)))


def _farthest(controller: Controller, run: Recording, last: int) -> float:
    """Half of what limits of measurements let positions move by within so many samples, away and back."""
    if controller.measurement_limits is None:
        return np.inf
    _, upper, rate = controller.measurement_limits
    moved = np.array(["position" in name for name in controller.measured])
    fast, room = rate * controller.period * last / np.pi, upper - np.nanmax(run.y, axis=0)
    return float(0.5 * np.minimum(fast, np.maximum(room, 0.0))[moved].min())


def _room(controller: Controller, count: int) -> np.ndarray:
    """Share (k,) of the swing for which each tracked state has room in its limits, about the operating point."""
    if controller.estimator is None:
        return np.ones(count)
    plant, share = controller.estimator.plant, list[float]()
    for name in controller.tracked:
        low, high = plant.limits.get(name, (-np.inf, np.inf))
        at = controller.law.operating_point[controller.states.index(name)]
        share.append(float(np.clip(min(at - low, high - at) / (2.0 * SWING), 0.0, 1.0)))
    return np.array(share)


def _standstills(controller: Controller) -> np.ndarray:
    """Slope (n + m, k) of a moving reference along its tracked positions, at rest; zero where no model tells it."""
    n, places = len(controller.states), [controller.states.index(name) for name in controller.tracked]
    slope: tuple[np.ndarray, np.ndarray] | None = None
    if controller.estimator is not None and places:
        r = controller.operating_reference
        model, states = controller.estimator.plant, controller.estimated_states
        moved, pushed = equilibrium_line(
            model, states.whole(r[:n]), r[n:], [model.index(name) for name in controller.tracked]
        )
        slope = None if moved is None else (states.own(moved), pushed)
    return np.zeros((len(controller.commanded), len(places))) if slope is None else np.vstack(slope)


def with_both_roundings(controller: Controller, run: Recording) -> tuple[Recording, Recording]:
    """A recording of the controller, as it is without and with fused multiply-adds."""
    from flexhinf.codegen import machine

    once = machine.host().fused if controller.fused is None else controller.fused
    unlike, loop = controller.fresh(not once), slice(0, run.begun)
    other = replay(unlike, run.y[loop], run.r[loop, : len(controller.commanded)], run.kinds[loop])
    other = replace(other, moved=run.moved)
    if run.provocation is not None:
        other = other.followed_by(run.provocation, unlike)
    return (other, run) if once else (run, other)


def replay(
    controller: Controller, y: np.ndarray, r: np.ndarray, kinds: list[str], repeats: Sequence[int] = ()
) -> Recording:
    """Feed samples to a fresh controller.

    `controller`: Only read. `repeats`: How often each is given, once by default; recorded is what came last.
    `y`, `r`: (K, p), (K, k) arrays. `kinds`: "OK"; "PREDICTED" for a sample without a
    measurement; `GAP` for one without the first element, which is refused if there is no estimator.
    """
    return feed(controller.fresh(), y, r, kinds, repeats)


def feed(
    fresh: Controller,
    y: np.ndarray,
    r: np.ndarray,
    kinds: list[str],
    repeats: Sequence[int] = (),
    memories: Mapping[int, np.ndarray] = NONE,
    held: np.ndarray | None = None,
) -> Recording:
    """As `replay`, to this controller itself, with other memories before some rows, which may end in nothing finite;
    then the output is the last one, `held` before the first row."""
    y, repeats = np.array(y, dtype=float), repeats or [1] * len(y)
    held = np.asarray(fresh.input_before() if held is None else held, dtype=float)
    inputs, estimates, codes, memory_rows = (
        list[np.ndarray](),
        list[np.ndarray](),
        list[str](),
        list[np.ndarray](),
    )
    said: list[tuple[int, float, np.ndarray, int]] = []
    for k, kind in enumerate(kinds):
        code = kind
        if k in memories:
            history_of(fresh).memory[:], history_of(fresh).failed = memories[k], False
        if kind == GAP:
            y[k, 0] = np.nan
            code = NOT_FINITE if not fresh.gaps else MEASURED if np.isfinite(y[k]).any() else MISSING
        sample = None if kind == MISSING else y[k], r[k] if r.shape[1] else None
        again = np.ones(y.shape[1]) if fresh.mode.checks_measurements and repeats[k] > 1 else None
        try:
            for _ in range(repeats[k] - 1):
                held = fresh.step(*sample, fresh=again)
            before = fresh.rejected
            held = fresh.step(*sample, fresh=again)
            if fresh.mode.checks_measurements and code == MEASURED:
                believed = np.isfinite(y[k]) & (fresh.rejected == before)
                believed &= not fresh.status & Status.REPEATED_FRAME
                code = MEASURED if believed.any() else MISSING
        except NumericalFailure:
            if code != NOT_FINITE:
                if k not in memories:
                    raise
                code = FAILED
        codes.append(code)
        inputs.append(held)
        estimates.append(np.nan_to_num(fresh.estimate))
        said.append((int(fresh.status), fresh.path_rate, np.array(fresh.rejected), fresh.doubtful_samples))
        memory_rows.append(history_of(fresh).memory.copy())
    r = r if r.shape[1] else np.zeros((len(y), 1))
    status, rates, rejected, doubtful = map(list, zip(*said, strict=True))
    return Recording(
        y,
        r,
        np.array(inputs),
        np.array(estimates),
        list(kinds),
        codes,
        status,
        rates,
        np.array(rejected),
        doubtful,
        [memory_hash(memory) for memory in memory_rows],
        np.array(memory_rows),
    )


def samples_without(
    kinds: Sequence[str], codes: Sequence[str], repeats: Sequence[int], judged: bool, before: int
) -> list[int]:
    """After each row, how many samples in a row the watchdog of the C counts without a measurement, at most, behind so
    many. A row that ends in no finite number has its measurement as it was given; where measurements are `judged`, it
    may have been refused."""
    counts = [before]
    for kind, code, times in zip(kinds, codes, repeats, strict=True):
        seen = code == MEASURED or (code == FAILED and kind == MEASURED and not judged)
        counts.append(0 if seen else counts[-1] + times)
    return counts[1:]
