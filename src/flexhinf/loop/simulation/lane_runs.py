"""Many runs of one kernel, in its lanes and on several threads: each thread has arrays of its own and nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from flexhinf.codegen import Kernel, aligned


@dataclass(frozen=True, eq=False)
class Recorded:
    """What N runs leave behind.

    Attributes
    ----------
    codes, steps : (N,) array of int
        See `flexhinf.codegen.Status`.
    remembered : (k, N) array
    kept : (N, T, j) array
        Signals at some samples; NaN after the last one of a run that failed.
    """

    codes: np.ndarray
    steps: np.ndarray
    remembered: np.ndarray
    kept: np.ndarray

    @classmethod
    def of(cls, count: int, remembered: np.ndarray, instants: int, signals: int) -> Recorded:
        """Room for so many runs."""
        codes, steps = (np.zeros(count, dtype=int) for _ in range(2))
        return cls(codes, steps, np.zeros((len(remembered), count)), np.zeros((count, instants, signals)))


@dataclass(frozen=True, eq=False)
class Task:
    """Runs that are made with the same kernel and the same counts.

    Attributes
    ----------
    shared : mapping of str to array
        What all runs read, by buffer.
    start : mapping of str to array
        What a run starts with, by buffer, one column; unless it is among its own.
    own : mapping of str to array
        What each run has of its own, by buffer: N rows.
    samples, parts, delay : int
        Of a run: its length, sub-steps of a sample, samples of delay.
    instants : (T,) array of int
        Samples at which signals are kept.
    """

    kernel: Kernel
    shared: Mapping[str, np.ndarray]
    start: Mapping[str, np.ndarray]
    own: Mapping[str, np.ndarray]
    samples: int
    parts: int
    delay: int
    instants: np.ndarray

    def run(self, rows: np.ndarray, found: Recorded, threads: int) -> None:
        """Make the runs of some rows and fill theirs."""
        lanes = self.kernel.lanes
        batches = [rows[k : k + lanes] for k in range(0, len(rows), lanes)]
        rest, count = iter(batches), max(1, min(threads, len(batches)))
        with ThreadPoolExecutor(count) as pool:
            for work in [pool.submit(self._work, rest, found) for _ in range(count)]:
                work.result()

    def _work(self, rest: Iterator[np.ndarray], found: Recorded) -> None:
        """Batches that no other thread has taken, on arrays of this thread."""
        start = {name: column for name, column in self.start.items() if name not in self.own}
        sizes = {name: len(column) for name, column in start.items()}
        sizes |= {name: rows.shape[1] for name, rows in self.own.items()}
        inputs, counts, own = sizes["held"], {"steps": self.samples, "parts": self.parts}, dict(self.own)
        if self.delay:
            sizes["inputs"], counts["late"] = (self.samples + self.delay) * inputs, self.delay * inputs
            if "held" in own:
                own["inputs"] = np.tile(own["held"], (1, self.delay))
            else:
                start["inputs"] = np.tile(start["held"], self.delay)
        sizes["kept"] = self.samples * found.kept.shape[2]
        lanes = self.kernel.lanes
        arrays = {name: aligned(size * lanes).reshape(size, lanes) for name, size in sizes.items() if size}
        run = self.kernel.bind({**self.shared, **arrays}, counts)
        for rows in rest:  # an iterator of a list, from which each thread takes the next
            filled = np.append(
                rows, np.repeat(rows[-1:], self.kernel.lanes - len(rows))
            )  # idle lanes repeat one
            for name in arrays.keys() & start.keys():
                arrays[name][: len(start[name])] = start[name][:, None]
            for name in arrays.keys() & own.keys():
                arrays[name][: own[name].shape[1]] = own[name][filled].T
            run()
            status = run.status
            ends = np.array([status.code, status.step]).reshape(2, -1)
            self._record(rows, ends, arrays, found)

    def _record(
        self, rows: np.ndarray, ends: np.ndarray, arrays: Mapping[str, np.ndarray], found: Recorded
    ) -> None:
        count, signals = len(rows), found.kept.shape[2]
        found.codes[rows], found.steps[rows] = ends[:, :count]
        if "remembered" in arrays:
            found.remembered[:, rows] = arrays["remembered"][:, :count]
        if signals:
            kept = arrays["kept"].reshape(self.samples, signals, -1)[self.instants]
            found.kept[rows] = kept[..., :count].transpose(2, 0, 1)
            for row in rows[found.codes[rows] != 0]:
                found.kept[row, self.instants > found.steps[row]] = np.nan
