"""Kernels that run a program for many plants on a GPU, a thread or a warp for each: the bits of a kernel in lanes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from flexhinf.codegen import cuda
from flexhinf.codegen.compiler import check_counts, check_reach, compile_ptx
from flexhinf.codegen.groups import form_of
from flexhinf.codegen.memory import Buffer, misfit
from flexhinf.codegen.program import Program

if TYPE_CHECKING:
    import ctypes

#: Where the runs of an ensemble are made: on this processor, or by the first GPU.
Device = Literal["cpu", "gpu"]

#: Plants that run at once at most, and the share of the free memory that their numbers may take: each thread also has
#: memory of its own, which the driver takes when a kernel begins.
MOST_PLANTS, SHARE = 1 << 19, 0.5


@dataclass(frozen=True, eq=False)
class PlantArrays:
    """Arrays of N runs of a program.

    `start`: (k,), what a buffer begins with in every run. `own`: (N, k), what it begins with in each. `shared`: What
    all runs read. `counts`: Turns of every loop. `sizes`: Elements of a run's part of each buffer that is not shared.
    """

    start: Mapping[str, np.ndarray]
    own: Mapping[str, np.ndarray]
    shared: Mapping[str, np.ndarray]
    counts: Mapping[str, int]
    sizes: Mapping[str, int]

    def taken(self, rows: slice | np.ndarray) -> PlantArrays:
        """The same of some of the runs."""
        return replace(self, own={name: column[rows] for name, column in self.own.items()})


@dataclass(frozen=True, eq=False)
class Ended:
    """How N runs ended: codes and steps (N,) of their `RunStatus`, and elements (k, N) of the buffers by name."""

    codes: np.ndarray
    steps: np.ndarray
    returned: Mapping[str, np.ndarray]


class GpuKernel:
    """A program for the GPU of this process.

    `returned`: Names of buffers of which elements are returned. `fused`, and what is raised: As for `compile_ptx`.
    """

    def __init__(self, program: Program, returned: Sequence[str], fused: bool | None = None) -> None:
        self.program, self.returned = program, tuple(returned)
        self.form = form_of(program)
        self.ptx = compile_ptx(program, self.returned, fused)

    @cached_property
    def _loaded(self) -> ctypes.c_void_p:
        from flexhinf.codegen.threads import KERNEL

        return cuda.card().kernel(self.ptx, KERNEL)

    def run(self, arrays: PlantArrays, count: int, places: Mapping[str, np.ndarray]) -> Ended:
        """Make N runs, as many at once as the memory has room for.

        `count`: N. `places`: Of the elements that are returned, by buffer. Raises InvalidInput: counts or sizes that do
        not fit the program; `CardError`: There is none, or its driver refuses.
        """
        counts = check_counts(self.program, arrays.counts)
        lengths = {name: array.size for name, array in arrays.shared.items()} | dict(arrays.sizes)
        lengths |= {buffer.name: buffer.size for buffer in self.program.buffers if buffer.size is not None}
        check_reach(self.program, lengths, counts)
        begun = {name: column.shape[-1] for name, column in {**arrays.start, **arrays.own}.items()}
        ends = {name: int(np.max(chosen)) + 1 for name, chosen in places.items()}
        for name, size in (*begun.items(), *ends.items()):
            if size > lengths.get(name, size):
                what = f"Numbers of '{name}' of '{self.program.name}' leave their buffer."
                raise misfit(what, f"at most {lengths[name]} of each plant", size)
        card = cuda.card()
        with card.lock:
            card.begin()
            kernel = self._loaded
            room = SHARE * card.free / self._bytes(arrays, places)
            together = int(max(1, min(count, MOST_PLANTS, room)))
            parts = [
                self._part(card, kernel, arrays.taken(slice(first, first + together)), counts, places)
                for first in range(0, count, together)
            ]
        return Ended(
            np.concatenate([part.codes for part in parts]),
            np.concatenate([part.steps for part in parts]),
            {name: np.hstack([part.returned[name] for part in parts]) for name in self.returned},
        )

    def _bytes(self, arrays: PlantArrays, places: Mapping[str, np.ndarray]) -> int:
        """Bytes of a plant, on the card."""
        long = sum(arrays.sizes[buffer.name] for buffer in self._long)
        begun = sum(column.shape[1] for column in arrays.own.values())
        apart = self.form.size if self.form.apart else 0
        return 8 * (2 + long + begun + apart + sum(map(len, places.values())))

    @property
    def _long(self) -> list[Buffer]:
        """Buffers without a size, a part of which each plant has."""
        return [buffer for buffer in self.program.buffers if buffer.size is None and not buffer.shared]

    def _part(
        self,
        card: cuda.Card,
        kernel: ctypes.c_void_p,
        arrays: PlantArrays,
        counts: Mapping[str, int],
        places: Mapping[str, np.ndarray],
    ) -> Ended:
        count = len(next(iter(arrays.own.values())))
        with cuda.CardMemory(card) as memory:
            ends = [memory.empty(8 * count) for _ in range(2)]
            apart = memory.empty(8 * count * self.form.size) if self.form.apart else 0
            table = [*ends, apart, *counts.values()]
            for buffer in self.program.buffers:
                name, entry = buffer.name, [0] * 6
                if buffer.shared:
                    entry[0] = memory.put(arrays.shared[name])
                elif (column := arrays.own.get(name)) is not None:
                    entry[:4] = memory.put(column.T), column.shape[1], count, 1
                elif (start := arrays.start.get(name)) is not None:
                    entry[:4] = memory.put(start), len(start), 1, 0
                if buffer in self._long:
                    entry[4:] = memory.empty(8 * count * arrays.sizes[name]), arrays.sizes[name]
                table += entry
            found = dict[str, int]()
            for name in self.returned:
                chosen = np.asarray(places[name], dtype=np.int64)
                found[name] = memory.empty(8 * count * len(chosen))
                table += found[name], memory.put(chosen), len(chosen)
            arguments = memory.put(np.array(table, dtype=np.uint64)), count
            card.launch(kernel, count, arguments, self.form.group, self.form.shared_bytes)
            codes, steps = (memory.get(address, (count,), np.int64) for address in ends)
            shapes = {name: (len(places[name]), count) for name in self.returned}
            returned = {name: memory.get(address, shapes[name]) for name, address in found.items()}
        return Ended(codes, steps, returned)
