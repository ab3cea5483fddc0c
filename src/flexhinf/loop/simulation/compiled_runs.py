"""Runs on compiled kernels, alone or side by side in the lanes of vector registers, with the same bits."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from typing import Any

import numpy as np

from flexhinf.codegen import Kernel, Program, compile_program
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.shared import share
from flexhinf.loop.simulation.channel import Channel
from flexhinf.loop.simulation.program import LoopSizes, loop_program
from flexhinf.loop.simulation.trajectory import Trajectory
from flexhinf.plant import Plant

__all__ = ["LANES", "THREADS", "LoopCode", "PreparedRun", "capacity", "run_many"]

#: Runs side by side in one kernel. Eight numbers are one register of AVX-512 and two of AVX2.
LANES = 8

#: Samples of all runs together from which on a kernel of its own is worth compiling: a second, once on a machine.
WORTH = 50_000

#: Runs that are prepared at a time.
WINDOW = 32

#: Runs at a time where they are made alone: compiled code lets the other thread go on.
THREADS = 2


@dataclass(frozen=True, eq=False)
class LoopCode:
    """What of a loop is compiled: no parameter of plant or law, no time and no signal is in it.

    Attributes
    ----------
    key : tuple
        Loops with the same key share their kernels.
    sizes : LoopSizes
    plant, controller, channel
        Of one of these loops.
    """

    key: tuple[object, ...]
    sizes: LoopSizes
    plant: Plant
    controller: Controller
    channel: Channel

    @classmethod
    def of(cls, plant: Plant, controller: Controller, channel: Channel, sub_steps: int) -> LoopCode:
        """Of a loop with so many Runge–Kutta steps per period, or a few more."""
        sizes = LoopSizes(
            x=plant.n, u=len(plant.inputs), y=len(controller.measured), r=len(controller.commanded),
            d=len(plant.disturbances), memory=controller.memory.size, data=controller.data.size,
            estimate=len(controller.states), parameters=plant.parameters.size,
            capacity=capacity(sub_steps),
        )  # fmt: skip
        key = ("loop", plant.code_key, controller.code_key, sizes, channel.quanta)
        return cls(key, sizes, plant, controller, channel)

    def kernel(self, lanes: int = 1, shared: tuple[str, ...] = ()) -> Kernel:
        """The whole run, of so many loops at once; of some buffers all lanes read one copy."""
        return share((*self.key, lanes, shared), lambda: compile_program(self._sharing(shared), lanes))

    @property
    def program(self) -> Program:
        """What runs."""
        build = lambda: loop_program(self.plant, self.controller, self.sizes, self.channel)  # noqa: E731
        return share((*self.key, "program"), build)

    def _sharing(self, names: tuple[str, ...]) -> Program:
        buffers = (replace(buffer, shared=buffer.name in names) for buffer in self.program.buffers)
        return replace(self.program, buffers=tuple(buffers)) if names else self.program

    def undisturbed(self, samples: int) -> np.ndarray:
        """No disturbance, as one array for all runs: pages that are never written take no memory."""
        return _zeros(samples * self.sizes.capacity * 3 * self.sizes.d)


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """A run before it is made.

    Attributes
    ----------
    code : LoopCode
    plant, controller
        Of this run.
    times : (N,) array
        s.
    arrays : mapping of str to array
        What the kernel is given, by buffer; those that the loop does not have are left out.
    recorded : mapping of str to array
        Signals that are known before the run.
    parts : int
        Runge–Kutta steps per period.
    delay : int
        Samples between an input and its effect.
    settings : mapping
        For the trajectory.
    disturbed : bool
        Without a disturbance, runs side by side read one array of zeros, most of what they would read otherwise.
    """

    code: LoopCode
    plant: Plant
    controller: Controller
    times: np.ndarray
    arrays: dict[str, np.ndarray]
    recorded: dict[str, np.ndarray]
    parts: int
    delay: int
    settings: dict[str, Any]
    disturbed: bool

    @property
    def fits(self) -> tuple[object, ...]:
        """Runs for which this is equal can be made side by side."""
        return self.code.key, len(self.times), self.parts, self.delay, self.disturbed

    @property
    def shared(self) -> tuple[str, ...]:
        """Buffers of which runs side by side read one copy."""
        return () if self.disturbed else ("disturbance",)

    @property
    def counts(self) -> dict[str, int]:
        """Turns of the kernel's loops, and elements of the inputs that wait."""
        return {"steps": len(self.times), "parts": self.parts, "late": self.delay * self.code.sizes.u}

    @property
    def _outputs(self) -> dict[str, tuple[str, int]]:
        """Signal and width of each output buffer."""
        sizes = self.code.sizes
        return {
            "states": ("state", sizes.x), "estimates": ("estimate", sizes.estimate),
            "outputs": ("output", sizes.y), "inputs": ("input", sizes.u),
        }  # fmt: skip

    @property
    def inputs(self) -> dict[str, np.ndarray]:
        """Arrays that the kernel reads, by buffer; those that it writes to are new."""
        found = {}
        for buffer in self.code.program.buffers:
            if buffer.name in self.arrays:
                given = self.arrays[buffer.name]
                found[buffer.name] = given.copy() if buffer.role == "state" else given
        return found

    @staticmethod
    def outputs(runs: Sequence[PreparedRun]) -> dict[str, np.ndarray]:
        """Arrays for what is recorded of runs that fit, by buffer and lane; before the inputs those that wait."""
        first = runs[0]
        late = first.counts["late"]
        rows = {name: len(first.times) * width for name, (_, width) in first._outputs.items()}
        arrays = {name: np.zeros((count, len(runs))) for name, count in rows.items() if name != "inputs"}
        arrays["inputs"] = np.zeros((late + rows["inputs"], len(runs)))
        for lane, run in enumerate(runs):
            arrays["inputs"][:late, lane] = np.tile(run.arrays["held"], run.delay)
        return arrays

    def alone(self) -> Trajectory:
        """Make this run."""
        outputs = {name: array.ravel() for name, array in self.outputs([self]).items()}
        status = self.code.kernel().run({**self.inputs, **outputs}, self.counts)
        return self.trajectory(outputs, int(status.code), int(status.step))

    def trajectory(self, outputs: dict[str, np.ndarray], code: int, last: int) -> Trajectory:
        """What the run recorded, up to its end; the inputs stand behind those that waited before."""
        count = len(self.times)
        recorded = {
            signal: outputs[name][outputs[name].size - count * width :].reshape(count, -1)
            for name, (signal, width) in self._outputs.items()
        }
        signals = {**recorded, **self.recorded}
        return Trajectory.until(self.plant, self.controller, self.times, signals, self.settings, code, last)


def run_many(runs: Iterable[PreparedRun]) -> Iterator[Trajectory]:
    """Make many runs, in their order: what `PreparedRun.alone` gives for each, bit by bit, in less time.

    Runs of the same code, length and sub-steps are made side by side in `LANES` lanes, where there are enough of them,
    on `THREADS` threads. The runs may be prepared on the way: `WINDOW` of them are asked for at a time.
    """
    rest, worth = iter(runs), set()
    with ThreadPoolExecutor(THREADS) as pool:
        while window := list(islice(rest, WINDOW)):
            yield from _in_order(window, _batches(window, worth), pool)


def _batches(window: Sequence[PreparedRun], worth: set[tuple[object, ...]]) -> list[list[int]]:
    """Places of the runs that are made together; kinds of runs that lanes are worth are kept for later windows."""
    alike: dict[tuple[object, ...], list[int]] = {}
    for place, run in enumerate(window):
        alike.setdefault(run.fits, []).append(place)
    found = []
    for fits, places in alike.items():
        if len(places) >= LANES and len(places) * len(window[places[0]].times) >= WORTH:
            worth.add(fits)
        width = LANES if fits in worth else 1
        found += [places[k : k + width] for k in range(0, len(places), width)]
    return sorted(found)


def _in_order(
    window: Sequence[PreparedRun], batches: Sequence[Sequence[int]], pool: ThreadPoolExecutor
) -> Iterator[Trajectory]:
    """The runs of a window, while at most `THREADS` batches are being made: a run takes megabytes."""
    rest, begun = iter(batches), deque()
    made: dict[int, Trajectory] = {}

    def begin() -> None:
        for batch in islice(rest, THREADS - len(begun)):
            begun.append((batch, pool.submit(_together, [window[place] for place in batch])))

    for place in range(len(window)):
        while place not in made:
            begin()
            batch, runs = begun.popleft()
            made.update(zip(batch, runs.result(), strict=True))
            begin()
        yield made.pop(place)


def _together(runs: Sequence[PreparedRun]) -> list[Trajectory]:
    return [runs[0].alone()] if len(runs) == 1 else _side_by_side(runs)


def _side_by_side(runs: Sequence[PreparedRun]) -> list[Trajectory]:
    """Up to `LANES` runs at once; lanes without a run repeat the last one."""
    first = runs[0]
    filled = (*runs, *[runs[-1]] * (LANES - len(runs)))
    each = [run.inputs for run in filled]
    inputs = {
        name: each[0][name] if name in first.shared else np.stack([one[name] for one in each], axis=-1)
        for name in each[0]
    }
    outputs = PreparedRun.outputs(filled)
    status = first.code.kernel(LANES, first.shared).run({**inputs, **outputs}, first.counts)
    codes, steps = np.broadcast_to(status.code, LANES), np.broadcast_to(status.step, LANES)
    rows = {name: np.ascontiguousarray(outputs.pop(name).T) for name in list(outputs)}
    return [
        run.trajectory(
            {name: array[lane] for name, array in rows.items()}, int(codes[lane]), int(steps[lane])
        )
        for lane, run in enumerate(runs)
    ]


def capacity(sub_steps: int) -> int:
    """Sub-steps that the arrays of a disturbance have room for: a few more, so that few kernels serve many loops."""
    return 1 << (sub_steps - 1).bit_length()


@lru_cache(4)
def _zeros(size: int) -> np.ndarray:
    """Zeros (size,), read-only: one array for all runs, since fresh memory for each takes as long as the run."""
    zeros = np.zeros(size)
    zeros.setflags(write=False)
    return zeros
