"""A run with all its arrays, ready for the kernel of its loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from flexhinf.loop.controller.memory import Told
from flexhinf.loop.simulation.inputs import check_seed, white_noise
from flexhinf.loop.simulation.program import LoopCode
from flexhinf.loop.simulation.trajectory import Trajectory
from flexhinf.validation import read_only

#: Signal and its size in `LoopCode.sizes`, by the buffer that it is recorded in.
RECORDED = {
    "states": ("state", "x"),
    "estimates": ("estimate", "estimate"),
    "outputs": ("output", "y"),
    "inputs": ("input", "u"),
}


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """A run with all its arrays, ready for the kernel.

    `times` (N,) are in s; `arrays` are the inputs of the kernel, by buffer (those that the loop does not have are left
    out), `recorded` signals that are known before the run, `settings` for the trajectory; `deviation` (p,) is that of
    the noise, None without it.
    """

    code: LoopCode
    times: np.ndarray
    arrays: dict[str, np.ndarray]
    recorded: dict[str, np.ndarray]
    settings: dict[str, Any]
    deviation: np.ndarray | None

    def with_seed(self, seed: int) -> PreparedRun:
        """The same run with the noise of another seed."""
        check_seed(seed)
        arrays = dict(self.arrays)
        if self.deviation is not None:
            arrays["noise"] = white_noise(self.deviation, seed, len(self.times)).ravel()
        return replace(self, arrays=arrays, settings=self.settings | {"seed": seed})

    def buffers(self) -> tuple[dict[str, np.ndarray], dict[str, int]]:
        """Arrays of the kernel by buffer, of which those that it writes are new, and the turns of its loops."""
        code, own, samples = self.code, self.arrays, len(self.times)
        arrays = {
            buffer.name: own[buffer.name].copy() if buffer.role == "state" else own[buffer.name]
            for buffer in code.program.buffers
            if buffer.name in own
        } | {name: np.empty(samples * code.sizes[size]) for name, (_, size) in RECORDED.items()}
        if waiting := code.channel.delay:  # before the inputs
            arrays["inputs"] = np.concatenate([np.tile(own["held"], waiting), arrays["inputs"]])
        # The first sub-step is not in the loop of the others.
        return arrays, {"steps": samples, "parts": code.sub_steps - 1, "late": waiting * code.sizes["u"]}

    def run(self, kernel: Any = None) -> tuple[Trajectory, int, int]:
        """Make this run, on the loop's kernel or one that does the same: its trajectory, up to its end, and the code
        and the last sample of its `RunStatus`."""
        code, (arrays, counts) = self.code, self.buffers()
        status = (code.kernel() if kernel is None else kernel).run(arrays, counts)
        arrays["inputs"] = arrays["inputs"][counts["late"] :]
        rows = {signal: arrays[name].reshape(len(self.times), -1) for name, (signal, _) in RECORDED.items()}
        signals, end = rows | self.recorded, (int(status.code), int(status.step))
        told = Told.in_memory(code.controller.memory.places, arrays["memory"])
        run = Trajectory.until(code.plant, code.controller, self.times, signals, self.settings, *end, told)
        return run, *end


@lru_cache(4)
def zeros(size: int) -> np.ndarray:
    """Zeros (size,), read-only: one array for all runs, since fresh memory for each takes as long as the run."""
    return read_only(np.zeros(size))
