"""One run on a compiled kernel, with its signals stored; many plants are run by `flexhinf.loop.Ensemble`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from flexhinf.codegen import Kernel, Program, compile_program
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.shared import share
from flexhinf.loop.simulation.channel import Channel
from flexhinf.loop.simulation.program import LoopSizes, loop_program
from flexhinf.loop.simulation.trajectory import Trajectory
from flexhinf.plant import Plant


@dataclass(frozen=True, eq=False)
class LoopCode:
    """What of a loop is compiled: no parameter of plant or law, no time and no signal is in it.

    Attributes
    ----------
    key : tuple
        Loops with the same key share their kernels.
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

    def kernel(self) -> Kernel:
        """The whole run."""
        return share((*self.key, "run"), lambda: compile_program(self.program))

    @property
    def program(self) -> Program:
        """What runs."""
        build = lambda: loop_program(self.plant, self.controller, self.sizes, self.channel)  # noqa: E731
        return share((*self.key, "program"), build)

    def undisturbed(self, samples: int) -> np.ndarray:
        """No disturbance, as one array for all runs: pages that are never written take no memory."""
        return _zeros(samples * self.sizes.capacity * 3 * self.sizes.d)


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """A run before it is made.

    Attributes
    ----------
    times : (N,) array
        s.
    arrays : mapping of str to array
        What the kernel is given, by buffer; those that the loop does not have are left out.
    recorded : mapping of str to array
        Signals that are known before the run.
    parts : int
        Runge–Kutta steps per period.
    settings : mapping
        For the trajectory.
    """

    code: LoopCode
    times: np.ndarray
    arrays: dict[str, np.ndarray]
    recorded: dict[str, np.ndarray]
    parts: int
    settings: dict[str, Any]

    @classmethod
    def of(
        cls,
        code: LoopCode,
        start: Mapping[str, np.ndarray],
        signals: Mapping[str, np.ndarray],
        disturbance: np.ndarray | None,
        parts: int,
        settings: dict[str, Any],
    ) -> PreparedRun:
        """Of a loop of this code.

        Parameters
        ----------
        start : mapping of str to array
            x, held (the input that acts before the first sample), memory, data, and the parameters of the true plant.
        signals : mapping of str to array
            reference (N, r), noise (N, p).
        disturbance : (N, capacity, 3, d) array or None
            See `flexhinf.loop.signals.sampling.sample_disturbance`.
        """
        samples, period, sizes = len(signals["reference"]), code.controller.period, code.sizes
        arrays = {
            **start, "u": start["held"].copy(), "truth": np.concatenate([[period / parts], start["parameters"]]),
            "noise": signals["noise"].ravel(), "reference": signals["reference"].ravel(),
            "disturbance": code.undisturbed(samples) if disturbance is None else disturbance.ravel(),
        }  # fmt: skip
        acting = np.zeros((samples, sizes.d)) if disturbance is None else disturbance[:, 0, 0].copy()
        recorded = {"reference": signals["reference"], "disturbance": acting}
        return cls(code, np.arange(samples) * period, arrays, recorded, parts, settings)

    @property
    def counts(self) -> dict[str, int]:
        """Turns of the kernel's loops, and elements of the inputs that wait."""
        late = self.code.channel.delay * self.code.sizes.u
        return {"steps": len(self.times), "parts": self.parts, "late": late}

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

    @property
    def outputs(self) -> dict[str, np.ndarray]:
        """New arrays for what is recorded, by buffer; before the inputs stand those that wait."""
        count = len(self.times)
        arrays = {name: np.zeros(count * width) for name, (_, width) in self._outputs.items()}
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
        count, (plant, controller) = len(self.times), (self.code.plant, self.code.controller)
        recorded = {
            signal: outputs[name][outputs[name].size - count * width :].reshape(count, -1)
            for name, (signal, width) in self._outputs.items()
        }
        signals = {**recorded, **self.recorded}
        return Trajectory.until(plant, controller, self.times, signals, self.settings, code, last)


def capacity(sub_steps: int) -> int:
    """Sub-steps that the arrays of a disturbance have room for: a few more, so that few kernels serve many loops."""
    return 1 << (sub_steps - 1).bit_length()


@lru_cache(4)
def _zeros(size: int) -> np.ndarray:
    """Zeros (size,), read-only: one array for all runs, since fresh memory for each takes as long as the run."""
    zeros = np.zeros(size)
    zeros.setflags(write=False)
    return zeros
