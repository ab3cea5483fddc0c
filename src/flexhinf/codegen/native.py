"""A compiled program called through ctypes, which lets other Python threads run meanwhile."""

from __future__ import annotations

import ctypes
from functools import partial

import numpy as np

from flexhinf.codegen.kernel import Kernel, Status
from flexhinf.codegen.machine import Code
from flexhinf.codegen.program import Program

_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)


class NativeKernel(Kernel):
    """Machine code of a program.

    Parameters
    ----------
    program : Program
    lanes : int
    code : Code
        Made from this program for these lanes.
    """

    compiled = True

    def __init__(self, program: Program, lanes: int, code: Code) -> None:
        super().__init__(program, lanes)
        self.code = code
        self.entry = _ENTRY(code.address)

    def _bind(self, arrays: dict[str, np.ndarray], counts: dict[str, int]) -> BoundCode:
        arrays = dict(arrays)
        for buffer in self.program.buffers:
            if buffer.role == "work":
                arrays[buffer.name] = np.zeros((buffer.size or 0) * self.lanes)
        addresses = [arrays[buffer.name].ctypes.data for buffer in self.program.buffers]
        words = [*addresses, *(counts[name] for name in self.program.counts)]
        context = np.array([*words, *[0] * self.lanes, *[-1] * self.lanes], dtype=np.int64)
        bound = BoundCode(self.entry, ctypes.c_void_p(context.ctypes.data))
        bound.keep = (self, arrays, context)
        bound.outcome = context[len(words) :]
        return bound


class BoundCode(partial):
    """The entry with its one argument: calling it runs no Python code at all.

    Attributes
    ----------
    keep : tuple
        The kernel, the arrays and the context, alive as long as this object.
    outcome : (2·lanes,) array of int
        Codes and steps of the last call.
    """

    keep: tuple
    outcome: np.ndarray

    @property
    def status(self) -> Status:
        """Status of the last call."""
        codes, steps = self.outcome.reshape(2, -1)
        if len(codes) == 1:
            return Status(int(codes[0]), int(steps[0]))
        return Status(codes.copy(), steps.copy())
