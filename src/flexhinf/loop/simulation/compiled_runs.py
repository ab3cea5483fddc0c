"""Runs on compiled kernels, alone or side by side in the lanes of vector registers, with the same bits."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any

import numpy as np

from flexhinf.codegen import Kernel, compile_program
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.shared import share
from flexhinf.loop.simulation.channel import Channel
from flexhinf.loop.simulation.program import LoopSizes, loop_program
from flexhinf.loop.simulation.trajectory import Trajectory
from flexhinf.plant import Plant

__all__ = ["LANES", "LoopCode", "PreparedRun", "run_many"]

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
            capacity=1 << (sub_steps - 1).bit_length(),
        )  # fmt: skip
        key = ("loop", plant.code_key, controller.code_key, sizes, channel.quanta)
        return cls(key, sizes, plant, controller, channel)

    def kernel(self, lanes: int = 1) -> Kernel:
        """The whole run, of so many loops at once."""
        return share((*self.key, lanes), lambda: compile_program(self._program, lanes))

    @property
    def _program(self) -> Any:
        build = lambda: loop_program(self.plant, self.controller, self.sizes, self.channel)  # noqa: E731
        return share((*self.key, "program"), build)

    def roomy(self, d: np.ndarray, samples: int, parts: int) -> np.ndarray:
        """Disturbances with room for `capacity` sub-steps a sample: a power of two, so that plants of a campaign
        whose fastest modes differ a little run on one kernel."""
        if parts == self.sizes.capacity:
            return d.ravel()
        room = np.zeros((samples, self.sizes.capacity, d.size // (samples * parts)))
        room[:, :parts] = d.reshape(samples, parts, -1)
        return room.ravel()

    def undisturbed(self, samples: int) -> np.ndarray:
        """The same of no disturbance, as one array for all runs."""
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

    @property
    def fits(self) -> tuple[object, ...]:
        """Runs for which this is equal can be made side by side."""
        return self.code.key, len(self.times), self.parts, self.delay

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
        for buffer in self.code.kernel().program.buffers:
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

    Runs of the same code, length and sub-steps are made side by side in `LANES` lanes, where there are enough of them.
    The runs may be prepared on the way: `WINDOW` of them are asked for at a time.
    """
    rest, worth, common = iter(runs), set(), {}
    with ThreadPoolExecutor(THREADS) as pool:
        while window := list(islice(rest, WINDOW)):
            waiting: dict[tuple[object, ...], deque[int]] = {}
            for k, run in enumerate(window):
                waiting.setdefault(run.fits, deque()).append(k)
            worth |= {fits for fits, which in waiting.items() if _worth_lanes(window[which[0]], len(which))}
            made: dict[int, Trajectory] = {}
            for k, run in enumerate(window):
                if k not in made:  # with the next ones that fit to it
                    lanes, alike = run.fits in worth, waiting[run.fits]
                    batch = [alike.popleft() for _ in range(min(LANES if lanes else THREADS, len(alike)))]
                    chosen = [window[place] for place in batch]
                    found = _side_by_side(chosen, common) if lanes else pool.map(PreparedRun.alone, chosen)
                    made.update(zip(batch, found, strict=True))
                yield made.pop(k)


def _worth_lanes(run: PreparedRun, count: int) -> bool:
    return count >= LANES and count * len(run.times) >= WORTH


def _side_by_side(runs: Sequence[PreparedRun], common: dict[int, Any]) -> Iterator[Trajectory]:
    """Up to `LANES` runs at once; lanes without a run repeat the last one. What all runs have in common is kept."""
    filled = (*runs, *[runs[-1]] * (LANES - len(runs)))
    each = [run.inputs for run in filled]
    inputs = {name: _stacked([one[name] for one in each], common) for name in each[0]}
    outputs = PreparedRun.outputs(filled)
    status = runs[0].code.kernel(LANES).run({**inputs, **outputs}, runs[0].counts)
    codes, steps = np.broadcast_to(status.code, LANES), np.broadcast_to(status.step, LANES)
    rows = {name: np.ascontiguousarray(array.T) for name, array in outputs.items()}
    for lane, run in enumerate(runs):
        own = {name: array[lane] for name, array in rows.items()}
        yield run.trajectory(own, int(codes[lane]), int(steps[lane]))


def _stacked(arrays: Sequence[np.ndarray], common: dict[int, Any]) -> np.ndarray:
    """One lane for each array, (size, lanes); where all are one object, made once and kept with it by its id."""
    first = arrays[0]
    if any(array is not first for array in arrays):
        return np.stack(arrays, axis=-1)
    if id(first) not in common:
        common[id(first)] = first, np.repeat(first[:, None], len(arrays), axis=1)
    return common[id(first)][1]


@lru_cache(4)
def _zeros(size: int) -> np.ndarray:
    """Zeros (size,), read-only: one array for all runs, since fresh memory for each takes as long as the run."""
    zeros = np.zeros(size)
    zeros.setflags(write=False)
    return zeros
