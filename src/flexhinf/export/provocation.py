"""Samples that provoke what a controller watches: a start elsewhere, numbers that are not the design's, hard commands.

A recorded loop stays near its operating point, where many terms of a model are zero and no bit of a status is set. Here
every number of the model, the law and the limits is another one, and nothing closes the loop: measurements swing as an
arm that rings, commands leave the workspace, or rest far from where the robot is. The C must give the same as Python.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.arrays import Number
from flexhinf.errors import NumericalFailure
from flexhinf.export.controller_c import MISSING_LIMIT, ControllerCode
from flexhinf.export.covariances import correlated, nearly_singular
from flexhinf.export.recording import (
    FAILED,
    Provocation,
    Recording,
    history_of,
    samples_without,
)
from flexhinf.loop import Controller

#: By how much numbers are moved, relative to them, and what takes the place of a zero of the model.
MOVED, OF_ZERO = 0.01, 1e-3

#: Of the limits of inputs, what is left; and by how much numbers that others are compared with differ.
NARROWER, APART = 0.6, 0.15

#: Parts of the step's numbers that are moved; of the others, many are exact for the structure that they have.
MOVED_PARTS = (
    "law",
    "operating_point",
    "operating_input",
    "parameters",
    "integral_relief",
    "windup_line",
    "windup_spread",
    "dry_friction",
    "integral_gain",
    "inverse_slope",
    "balance_state",
    "balance_input",
)

#: Parts in which zeros are moved too.
OTHERWISE_ZERO = ("parameters", "law", "operating_point", "operating_input")

NARROWED_PARTS = ("lower", "upper", "input_rate", "command_rate", "workspace", "following")

#: What a design may leave unwatched, by an infinite number, and the numbers in its place: the largest following error
#: and the smallest swing, rad or m, and how many swings are a limit cycle.
WATCHED_FROM, SWINGS_FROM, SWINGS_MOST = 0.02, 0.005, 5.0

#: Integrals that push an input beyond any wind-up, in their unit.
WOUND_UP = 1e6

#: Numbers of a memory up to which each is changed alone, with one row each; and memories in which many are changed.
MOST_CHANGED, MIXED = 64, 48

#: Share of the numbers that such a memory keeps, of flags that are turned, and of rows whose command rests.
KEPT, TURNED_FLAGS, STANDING = 0.4, 0.25, 0.5

#: Of its counts that are near to their limits.
COUNTED = 0.7

#: How far from those of the script its commands and measurements are, and some hard commands; decimals of its numbers.
COMMANDED, SEEN, HARD, DECIMALS = 0.1, 0.02, 3.0, 3

#: Parts of the step's numbers that are variances, without which pivots of more covariances are zero.
NOISE_PARTS = ("process_noise", "measurement_noise")

#: Parts of a memory that count.
COUNTS = ("doubt", "rejected", "seen")

#: By what estimated positions are turned, rad or m: sine and cosine in every quarter of a turn, near its ends too.
TURNED = (0.7, -0.7, 1.5, 2.3, 3.1, -2.2, 9.1e5)

#: How far the start is from where the estimator begins, in the unit of each state, and commands from measurements.
ELSEWHERE, AWAY = 0.02, 0.2

#: How near to the largest following error a robot stays that keeps an input at its limit: half on either side.
NEAR = 0.45

#: How far from what is measured at rest a measurement is plausible, and how far from the last one, rad or m.
BELIEVED = 4.0 * AWAY

#: How far each number of a command is from that of rest, where it is a motion: no motion is zero, and no two are equal.
ASTRAY = 1e-3

#: How much more velocities are, so that dry friction and speeds are seen; how far joints may be brought back in
#: either direction, as a share of what commands swing by.
FAST, RANGE = 300.0, 0.4

#: What measurements swing by at every row, and where something judges them.
NOISE, QUIET = 2e-4, 1e-6

#: How far from a limit an input counts as at it, as a share of the room between both limits.
EDGE = 0.02

#: By how much covariances are changed, relative to the largest; where an end is put that an input is pushed to.
KICK, AT_END = 1e-3, 0.8

#: Memories that are tried, the rows that each is followed by, and the seed of their numbers.
KINDS, EACH, SEED = 6, 4, 1

#: Kinds of them in which a covariance stays one.
SEMIDEFINITE = (1, 2, 3)

#: Size of the numbers in a column of a root that is treated as zero, although no number of it is; how many of its
#: standard deviations a measurement is from an estimate whose root has a single number.
TINY, SURPRISED = 1e-150, 4.0

#: Numbers of a memory from which on only the first kinds are tried, and no singular covariances.
LARGE = 200

#: Rows of each act, and the samples of a swing to and fro: short enough to be one, long enough for the law to answer.
ROWS, RING = 12, 7


@dataclass(frozen=True)
class ProvokedRun:
    """A memory to go on from, with measurements `y` (K, p) and commands `r` (K, k), and from then on another noise."""

    memory: np.ndarray
    y: np.ndarray
    r: np.ndarray
    noise: np.ndarray | None = None


def provoked(code: ControllerCode, run: Recording) -> Recording:
    """The recording with samples that provoke its controller behind it; as it is where all of them end in numbers that
    are not finite."""
    for one in provocations(code, run.y[0]):
        with suppress(NumericalFailure):
            return run.followed_by(one, code.controller)
    return run


def provocations(code: ControllerCode, first: np.ndarray) -> Iterator[Provocation]:
    """Ways to provoke a controller, the hardest first: the next is for one that ends in no finite numbers.

    `first` (p,): What is measured at rest. All that is given is a number of the code's type.
    """

    def held(array: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore"):  # refused where it is written as a constant
            return np.asarray(array).astype(code.real.kind).astype(float)

    for size, zeros in ((1.0, True), (1.0, False), (0.1, False), (0.01, False)):
        numbers = held(_other_numbers(code.controller, code.defaults, zeros, first, size))
        y, r, repeats, lasting = _script(code.controller, numbers, first, size)
        state = (
            None if not code.starts_anywhere or code.belief is None else held(_elsewhere(code.belief, size))
        )
        one = Provocation(
            held(y), held(r), repeats, numbers, state, held(_pushed(code.controller, numbers)), {}
        )
        with suppress(NumericalFailure):
            numbers = held(_saturated(code.controller, numbers, one.answered(code.controller).u, lasting))
            pushed = held(_pushed(code.controller, numbers))
            exact = code.real.bytes == 8
            yield _with_memories(replace(one, numbers=numbers, input=pushed), code.controller, held, exact)


def _with_memories(
    one: Provocation, controller: Controller, held: Callable[[np.ndarray], np.ndarray], exact: bool
) -> Provocation:
    """With rows in which the controller goes on from other memories; `exact`: whether rounding of the C is that of
    Python. Then some may end in no finite number, and the last ones are without noise."""

    def trials(memories: Iterator[np.ndarray], rows: int) -> list[ProvokedRun]:
        return [ProvokedRun(memory, one.y[:rows], one.r[:rows]) for memory in memories]

    other = trials(_memories(controller, exact), EACH)
    if not exact:
        return _tried(one, controller, held, other, False)
    with suppress(NumericalFailure):
        met = one.begun(controller)
        one.feed_to(met)
        memory = history_of(met).memory.copy()
        other += trials(_singular_memories(controller), 1)
        if memory.size <= MOST_CHANGED:
            other += trials(_changed_memories(controller, memory), 1)
        other += _mixed(one, controller, held, memory)
    one = _tried(one, controller, held, other, True)
    noise = [place for name, part in controller.data.places.items() if name in NOISE_PARTS
             for place in range(part.start, part.stop) if one.numbers[place] != 0.0]  # fmt: skip
    if not noise:
        return one
    one = replace(one, noise=tuple(noise))
    first, *others = trials(_memories(controller, True), 2)
    still = [replace(first, noise=np.zeros(len(noise))), *others]
    return _tried(one, controller, held, [*_singular_noises(one, controller), *still], True)


def _tried(
    one: Provocation,
    controller: Controller,
    held: Callable[[np.ndarray], np.ndarray],
    other: Sequence[ProvokedRun],
    exact: bool,
) -> Provocation:
    """With those memories behind that end alike with both roundings, each for all rows or for one. One of a single row
    is given with a measurement and without."""
    places, judged = controller.data.places, controller.mode.checks_measurements
    ends = [held(one.numbers[places[name]]) for name in ("lower", "upper")]

    def unseen(run: Recording, repeats: Sequence[int], before: int) -> list[int]:
        return samples_without(run.kinds, run.codes, repeats, judged, before)

    def longer(trial: ProvokedRun, memory: np.ndarray, count: int, measured: bool) -> Provocation:
        memories = {**one.memories, len(one.y): memory}
        y, r = np.vstack([one.y, trial.y[:count]]), np.vstack([one.r, trial.r[:count]])
        without = one.unmeasured if measured else (*one.unmeasured, len(one.y))
        noises = one.noises if trial.noise is None else {**one.noises, len(one.y): trial.noise}
        if controller.gaps and count == EACH:
            if y.shape[1] > 1:
                y[-2][len(memories) % y.shape[1]] = np.nan  # one sensor gave nothing
            without = (*one.unmeasured, len(one.y) + (len(memories) % 2))
        repeats = [*one.repeats, *[1] * count]
        return replace(one, y=y, r=r, repeats=repeats, memories=memories, unmeasured=without, noises=noises)

    # Controllers that have had all rows so far, one of each rounding; and samples without a measurement since one with.
    going: list[Controller] = [
        one.begun(controller.fresh(fused)) for fused in ((False, True) if exact else (None,))
    ]
    fed, *_ = [one.feed_to(each) for each in going]
    missing = unseen(fed, one.repeats, 0)[-1]
    for trial in other:
        memory, count = held(trial.memory), len(trial.y)
        last = controller.memory.named(memory).u
        last[...] = np.clip(last, *ends)  # an input that these limits let pass, from which it changes slowly
        again = ((1, True),) * (count > 1)
        without = ((1, False),) * (count > 1 or trial.noise is None)
        for rows, measured in ((count, True), *again, *without):
            if (rows == 1 and not exact) or (not measured and not controller.gaps):
                continue
            more, ended = longer(trial, memory, rows, measured), False
            before = [deepcopy(history_of(each)) for each in going]
            stepped = going if trial.noise is None else [one.with_noise(each, trial.noise) for each in going]
            with suppress(NumericalFailure):
                runs = [more.feed_to(each, len(one.y)) for each in stepped]
                codes, ended = runs[0].codes, True
                alike = all(run.codes == codes for run in runs) and (exact or FAILED not in codes)
                counts = unseen(runs[0], more.repeats[len(one.y) :], missing)
                if alike and max(counts) <= MISSING_LIMIT:  # else the watchdog of the C stops it
                    one, missing, before, going = more, counts[-1], [], stepped
                    trial = replace(trial, noise=None)
            for each, copied in zip(going, before):
                history_of(each).go_on_from(copied)
            if ended and rows > 1:
                break
    return one


def _memories(controller: Controller, exact: bool) -> Iterator[np.ndarray]:
    """Memories whose covariances, or roots of them, have other structures: nothing is zero, rows of other sizes, rows
    that vanish, all zero, and signs that change; then of a small memory columns that vanish, more sizes, and columns of
    a root that nearly vanish. Where rounding of the C is not `exact`, covariances stay semidefinite: in float it
    decides which others are refused."""
    first = controller.initial_memory()
    rng = np.random.default_rng(SEED)
    for kind in range(KINDS if first.size > LARGE else 3 * KINDS):
        memory = np.array(first)
        belief = () if controller.estimator is None else controller.memory.named(memory).belief
        arrays: list[np.ndarray] = [np.asarray(part) for part in belief]
        parts = [part for part in arrays if part.ndim == 2 and part.any()]
        if not exact and kind not in SEMIDEFINITE and any(np.array_equal(part, part.T) for part in parts):
            continue
        for part in parts:
            n = len(part)
            if kind in (0, 4, 5) or kind >= 2 * KINDS:
                part += KICK * np.abs(part).max() * rng.standard_normal(part.shape)
            if kind in (1, 4, 5) or kind >= KINDS:
                sizes = 10.0 ** rng.uniform(-2.0, 2.0, n)
                part *= np.sqrt(np.outer(sizes, sizes)) if np.array_equal(part, part.T) else sizes[:, None]
            if kind == 2:
                part[n // 2], part[:, part.shape[1] // 2] = 0.0, 0.0
            if kind == 3:
                part[:] = 0.0
            if KINDS <= kind < 2 * KINDS:
                part[:, kind % part.shape[1]] = 0.0
            if kind == 5:
                part *= np.where(np.arange(n) % 2, -1.0, 1.0)[:, None]
        if parts:
            yield memory
    root = _places(controller, "root") if exact and first.size <= LARGE else []
    rows = math.isqrt(len(root))
    lone = [slice(k, k + 1) for k in range(rows)]
    for columns in (*lone, *(slice(k, rows) for k in range(rows - 1)), *(slice(k) for k in range(2, rows))):
        table = np.abs(first[root]).max() * rng.standard_normal((rows, rows))
        if columns in lone:
            table[columns] = 0.0  # what is taken for zero would add something here
        table[:, columns] *= TINY / np.abs(first[root]).max()
        memory = np.array(first)
        memory[root] = table.ravel()
        yield memory


def _changed_memories(controller: Controller, memory: np.ndarray) -> Iterator[np.ndarray]:
    """A memory with one number after the other changed: none, its opposite, a little more, and much more; but for
    counts, of which C tells none that cannot be."""
    counts = {place for name in COUNTS for place in _places(controller, name)}
    for place in (place for place in range(memory.size) if place not in counts):
        number = memory[place]
        for other in (0.0, -number, number + OF_ZERO, 10.0 * number + 1.0):
            if other != number:
                changed = np.array(memory)
                changed[place] = other
                yield changed


def _mixed(
    one: Provocation, controller: Controller, held: Callable[[np.ndarray], np.ndarray], memory: np.ndarray
) -> Iterator[ProvokedRun]:
    """Memories with many numbers changed, so that no two are equal and every choice is made in some of them, each with
    another row; but for counts, and tables and covariances of the estimator."""
    rng, places = np.random.default_rng(SEED), controller.memory.places
    fixed = np.zeros(memory.size, dtype=bool)
    fixed[[place for name in COUNTS for place in _places(controller, name)]] = True
    sensors, seen = len(controller.measured), places.get("seen", slice(0, 0))
    fixed[seen.start : min(seen.start + 2 * sensors, seen.stop)] = False  # these count nothing that is told
    ages = slice(seen.start, min(seen.start + sensors, seen.stop))
    for part in controller.memory.named(fixed).belief if "belief" in places else ():
        part[...] |= part.ndim == 2
    positions = np.array(["position" in name for name in controller.measured], dtype=float)
    watch, commands = places.get("watch", slice(0)), len(one.r[0])
    limits = _limits_of_counts(controller, one.numbers, watch.stop - (watch.start or 0))
    for _ in range(MIXED):
        changed = memory + rng.choice([OF_ZERO, 0.1, 1.0], memory.size) * rng.standard_normal(memory.size)
        changed *= np.where(
            rng.uniform(size=memory.size) < 0.5, 1.0, 1.0 + 0.1 * rng.standard_normal(memory.size)
        )
        flags = (memory == 0.0) | (memory == 1.0)
        turned = rng.uniform(size=memory.size)
        changed = np.where(
            flags & (turned < 0.6), np.where(turned < TURNED_FLAGS, 1.0 - memory, memory), changed
        )
        changed[ages] = rng.integers(0, 4, ages.stop - ages.start)
        near = limits - rng.integers(-1, 3, limits.size)
        counted = np.isfinite(near) & (rng.uniform(size=near.size) < COUNTED)
        changed[watch] = np.where(counted, near, changed[watch])
        changed = np.where(fixed | (rng.uniform(size=memory.size) < KEPT), memory, _short(changed))
        row, other = rng.integers(len(one.y), size=2)
        y = held(_short(one.y[row] + SEEN * positions * rng.standard_normal(len(positions))))
        scaled = 1.0 + COMMANDED * rng.standard_normal(commands)
        added = rng.choice([0.0, COMMANDED, HARD], commands) * rng.standard_normal(commands)
        r = held(_short(one.r[other] * scaled + added))
        if "reference" in places and rng.uniform() < STANDING:
            changed[places["reference"]] = r[: places["reference"].stop - places["reference"].start]
        yield ProvokedRun(changed, y[None], r[None])


def _limits_of_counts(controller: Controller, numbers: np.ndarray, size: int) -> np.ndarray:
    """What each number of the watch (size,) is compared with, infinite where it counts nothing: swings, samples since
    the last one, and samples at a limit."""
    if not size:
        return np.zeros(0)
    named = controller.data.named(numbers)
    limits = np.full((5, size // 5), np.inf)
    limits[2] = named.swings[2]
    limits[3], limits[4] = np.floor(named.watching[0]), np.floor(named.watching[1])
    return limits.ravel()


def _short(numbers: np.ndarray) -> np.ndarray:
    """Numbers of few digits, as each of them stands in the text of a test, where no zero has a sign."""
    return np.round(numbers, DECIMALS) + 0.0


def _places(controller: Controller, name: str) -> list[int]:
    """Of a part of the memory, or of what the estimator keeps."""
    every, estimator = np.arange(controller.initial_memory().size), controller.estimator
    if estimator is not None and name in estimator.initial._fields:
        return controller.memory.named(every).belief[estimator.initial._fields.index(name)].ravel().tolist()
    return every[controller.memory.places.get(name, slice(0))].tolist()


def _singular_memories(controller: Controller) -> Iterator[np.ndarray]:
    """Memories whose integrals are wound up, those that turn the arm, and of a small memory those with a root of one
    number and a surprising measurement, and those in which one pivot of a covariance is zero to rounding, which the
    tolerance of its factor decides."""
    first = controller.initial_memory()
    place = controller.memory.places.get("integral")
    if place is not None and place.stop > place.start:
        for side in (-1.0, 1.0):
            memory = np.array(first)
            memory[place] += side * WOUND_UP
            yield memory
    belief = list[np.ndarray]()
    if controller.estimator is not None:
        belief += controller.memory.named(np.array(first)).belief
    positions = np.array(["position" in name for name in controller.estimated], dtype=float)
    for turned in TURNED if len(belief) and np.shape(belief[0]) == positions.shape else ():
        memory = np.array(first)
        controller.memory.named(memory).belief[0][:] += turned * positions
        yield memory
    for place in (root := _places(controller, "root") if len(positions) and first.size <= LARGE else []):
        memory = np.array(first)
        memory[root], memory[place] = 0.0, np.abs(first[root]).max()
        controller.memory.named(memory).belief[0][:] += SURPRISED * memory[place] * positions
        yield memory
    for number, part in enumerate(belief if first.size <= LARGE else ()):
        square = part.ndim == 2 and part.shape[0] == part.shape[1]
        if square and part.any() and np.array_equal(part, part.T):
            for covariance in nearly_singular(np.sqrt(np.diag(part)), SEED):
                memory = np.array(first)
                controller.memory.named(memory).belief[number][:] = covariance
                yield memory


def _singular_noises(one: Provocation, controller: Controller) -> Iterator[ProvokedRun]:
    """Likewise of each covariance of the noise, of a small memory."""
    memory = next(_memories(controller, True), None)
    if memory is None or memory.size > LARGE:
        return
    noise = np.array(one.noise)
    for name in NOISE_PARTS:
        part = controller.data.places.get(name, slice(0, 0))
        inside = (part.start <= noise) & (noise < part.stop)
        if inside.sum() != part.stop - part.start:
            continue  # some are zero, and stay so
        n = math.isqrt(int(inside.sum()))
        for covariance in nearly_singular(np.sqrt(one.numbers[part][:: n + 1]), SEED):
            numbers = one.numbers[noise]
            numbers[inside] = covariance.ravel()
            yield ProvokedRun(memory, one.y[:1], one.r[:1], numbers)


def _other_numbers(
    controller: Controller, numbers: np.ndarray, zeros: bool, first: np.ndarray, size: float
) -> np.ndarray:
    """The numbers of the step, moved; limits of inputs, the box and rates are narrower, those of measurements so wide
    that what swings is within them."""
    moved, places = np.array(numbers, dtype=float), controller.data.places
    for name in MOVED_PARTS:
        if name in places:
            part = moved[places[name]]
            by = part * (1.0 + MOVED * np.cos(1.0 + np.arange(part.size)))
            moved[places[name]] = np.where(
                (part == 0.0) & (zeros and name in OTHERWISE_ZERO),
                OF_ZERO * (1.0 + 0.3 * np.cos(np.arange(part.size))),  # no two are equal
                by,
            )
    for name in NOISE_PARTS if zeros else ():
        if name in places:
            moved[places[name]] = correlated(moved[places[name]], OF_ZERO)
    if "following" in places:
        part = moved[places["following"]]
        moved[places["following"]] = np.where(np.isposinf(part), WATCHED_FROM, part)
    if "swings" in places:
        edge, smallest, most = moved[places["swings"]].reshape(3, -1)
        room = moved[places["upper"]] - moved[places["lower"]]
        edge = edge + np.resize(np.where(np.isfinite(room), EDGE * room, 0.0), edge.size) * (
            1.0 + np.arange(edge.size)
        )
        smallest = np.where(np.isposinf(smallest), SWINGS_FROM, smallest)
        most = np.where(np.isposinf(most), SWINGS_MOST, most) + np.arange(most.size)  # it tells which
        moved[places["swings"]] = np.concatenate([edge, smallest, most])
    for name in NARROWED_PARTS:
        if name in places:
            part = moved[places[name]]
            part *= NARROWER * (1.0 - APART * (np.arange(part.size) % 3))  # infinite ones stay
    if "governor" in places:
        table = moved[places["governor"]].reshape(-1, len(controller.tracked))
        table *= 1.0 + APART * np.cos(1.0 + np.arange(table.size).reshape(table.shape))
        at = controller.operating_reference[_tracked(controller)]
        table[3] = np.maximum(table[3], at - RANGE * size * AWAY)
        table[4] = np.minimum(table[4], at + RANGE * size * AWAY)
        moved[places["governor"]] = table.ravel()
    if "measurement_rate" in places:
        moved[places["measurement_lower"]] = first - BELIEVED * size
        moved[places["measurement_upper"]] = first + BELIEVED * size
        moved[places["measurement_rate"]] = (
            (1.0 + 0.25 * (np.arange(len(first)) % 2)) * BELIEVED * size / controller.period
        )
    if "rcond_limit" in places:
        moved[places["rcond_limit"]] = 0.5  # of flags that are 0 or 1, it tells which
    return moved


def _elsewhere(belief: np.ndarray, size: float) -> np.ndarray:
    return belief + size * ELSEWHERE * np.cos(np.arange(belief.size))


def _pushed(controller: Controller, numbers: np.ndarray) -> np.ndarray:
    """An input (m,) to start from, within the limits of these numbers."""
    u, places = np.asarray(controller.input_before(), dtype=float), controller.data.places
    lower, upper = numbers[places["lower"]], numbers[places["upper"]]
    room = np.where(np.isfinite(upper), upper - u, 1.0)
    return np.clip(u + 0.1 * room, lower, upper)


def _saturated(controller: Controller, numbers: np.ndarray, u: np.ndarray, lasting: slice) -> np.ndarray:
    """The numbers, with narrower limits where inputs (K, m) are pushed to one side, so that they stay there."""
    changed, places = np.array(numbers), controller.data.places
    if lasting.stop <= lasting.start:
        return changed
    lower, upper = changed[places["lower"]], changed[places["upper"]]
    before, pushed = u[: lasting.start].mean(axis=0), u[lasting][ROWS // 3 :]
    least, most = pushed.min(axis=0), pushed.max(axis=0)
    both = np.isfinite(lower) & np.isfinite(upper)
    up, down = both & (least > before), both & (most < before)
    changed[places["upper"]] = np.where(up, np.minimum(upper, before + AT_END * (least - before)), upper)
    changed[places["lower"]] = np.where(down, np.maximum(lower, before + AT_END * (most - before)), lower)
    return changed


def _script(
    controller: Controller, numbers: np.ndarray, first: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray, list[int], slice]:
    """Measurements (K, p), commands (K, k), how often each is given, and in which rows an input is pushed for long."""
    c, watch = controller, controller.supervision
    command = np.array(c.operating_reference, dtype=float)
    positions = np.array(["position" in name for name in c.measured], dtype=float)
    places = _tracked(c)
    astray = ASTRAY * np.where(["velocity" in name for name in c.commanded], FAST, 1.0)
    judged = getattr(c.estimator, "gate", None) is not None
    swing, noise = (0.0, QUIET) if judged else (size * AWAY, size * NOISE)
    y, r, repeats, pushed = list[np.ndarray](), list[np.ndarray](), list[int](), slice(0, 0)

    def act(away: float, commanded: Number, times: int, rows: int = ROWS, rings: bool = False) -> None:
        for k in range(rows):
            side = -away if rings and k % 2 else away
            y.append(first + side * positions + noise * np.cos(k + np.arange(first.size)))
            row = command.copy()
            moves = 0 if rings else k  # a command that rests, for a limit cycle
            row += (
                size * astray * np.cos(1.0 + np.arange(row.size) + moves * (astray > ASTRAY)) * c.mode.moving
            )
            row[places] += commanded
            r.append(row)
            repeats.append(times)

    act(0.0, 0.0, 1)
    act(0.0, 0.2 * size * AWAY, 1)
    for k in range(len(first) if c.gaps and len(first) > 1 else 0):
        act(0.0, 0.0, 1, 2)
        y[-1][k] = np.nan  # one sensor gave nothing
    sensors = list(np.eye(len(first))) if c.mode.checks_measurements else []
    several = int(len(sensors) > 1)
    together = [np.ones(len(first))] * several
    pushes = [(which, 0.0, (1.1, -1.1, 0.9, -0.9, 0.0, 0.0, 0.55, -0.55)) for which in [*sensors, *together]]
    pushes += [
        (sensors[k], 1.1 * (-1) ** k, (0.9, -0.9, 0.55, -0.55, -1.1)) for k in range(len(sensors) * several)
    ]
    for which, others, beyonds in pushes:  # one after the other, all, and one that alone may be in its range
        for beyond in beyonds:
            act(0.0, 0.0, 1, 1)  # out of its range; and within it, from the other side too fast
            y[-1] += np.where(which > 0.0, beyond, others) * BELIEVED * size
        act(0.0, 0.0, 1, 2)
    if watch is not None and places:
        near = size * NEAR * float(np.min(np.minimum(c.data.named(numbers).following, 2.0 * AWAY)))
        lasting = math.ceil(2.0 * watch.saturation_time / c.period / ROWS)
        act(min(near, swing), 0.0, RING, 4 * ROWS, rings=True)  # a limit cycle
        pushed = slice(len(y), len(y) + ROWS)
        act(-min(near, swing), near, lasting)  # at a limit
        act(0.0, 0.0, 3)
        act(0.0, _outside(c, places), 1)
        act(0.0, 0.0, 3)
        box = np.reshape(c.data.named(numbers).workspace, (2, -1)) - command[places]
        for k in range(
            len(places) if np.isfinite(box).all() else 0
        ):  # one after the other, within each end and beyond
            for end, beyond in ((end, beyond) for end in box for beyond in (-0.5, 0.5)):
                act(0.0, (end + beyond * ELSEWHERE * np.sign(end)) * (np.arange(len(places)) == k), 1, 2)
        act(0.0, 0.0, 3)
        act(-swing, size * AWAY, lasting)  # far from the command too
        act(0.0, 0.0, 5)
    return np.array(y), np.array(r), repeats, pushed


def _tracked(controller: Controller) -> list[int]:
    """Places of the tracked positions in a command."""
    c = controller
    return [c.states.index(name) for name in c.tracked] if c.mode.moving else list(range(len(c.commanded)))


def _outside(controller: Controller, places: list[int]) -> np.ndarray:
    """A step of the commanded positions that leaves the workspace."""
    watch = controller.supervision
    if watch is None or watch.workspace is None:
        return np.full(len(places), AWAY)
    upper = np.broadcast_to(np.asarray(watch.workspace[1], dtype=float), len(places))
    return upper - controller.operating_reference[places] + ELSEWHERE
