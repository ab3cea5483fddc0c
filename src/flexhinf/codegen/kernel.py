"""What a program becomes: something to run on arrays, compiled or interpreted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flexhinf.codegen.arguments import check_arrays, check_counts, check_reach, length
from flexhinf.codegen.program import Program
from flexhinf.errors import InvalidInput


@dataclass(frozen=True, eq=False)
class Status:
    """How a run ended.

    Attributes
    ----------
    code : int, or (lanes,) array of int
        0, or the code of the first `Guard` that failed; one per lane when the kernel has several.
    step : int, or (lanes,) array of int
        Index of the outermost loop at that moment (0 outside of loops); -1 where the code is 0.
    """

    code: int | np.ndarray
    step: int | np.ndarray

    @property
    def fine(self) -> bool:
        """No guard failed, in any lane."""
        return not np.any(self.code)


class BoundKernel(Protocol):
    """A kernel with its arrays: the real-time path, nothing left to check."""

    def __call__(self) -> int:
        """Run; the largest code over the lanes, 0 when all is well."""
        ...

    @property
    def status(self) -> Status:
        """Status of the last call."""
        ...


class Kernel(ABC):
    """A program ready to run on one or more lanes.

    Attributes
    ----------
    lanes : int
        W; with W > 1 every buffer that is not shared has the lane as its last (fastest) axis.
    compiled : bool
        Machine code, or CasADi's evaluator.

    Notes
    -----
    With one lane a run stops at the guard that fails. With several, the lane that failed is marked and its
    numbers mean nothing from there on, while the others go on undisturbed; the run stops when all have
    failed.
    """

    compiled: bool

    def __init__(self, program: Program, lanes: int) -> None:
        if isinstance(lanes, bool) or not isinstance(lanes, int) or lanes < 1:
            raise InvalidInput(
                f"Program '{program.name}' cannot run on these lanes.",
                f"expected an integer ≥ 1, got {lanes!r}",
                "1 for a single run, 8 for many",
            )
        self.program = program
        self.lanes = lanes

    def run(self, arrays: Mapping[str, np.ndarray], counts: Mapping[str, int] | None = None) -> Status:
        """Check the arrays, run once, and say how it ended.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            One C-contiguous float64 array per buffer that is not "work"; "out" and "state" are written in
            place.
        counts : mapping of str to int
            Turns of every loop of the program.

        Returns
        -------
        Status

        Raises
        ------
        InvalidInput
            Arrays or counts that do not fit the program.
        """
        bound = self.bind(arrays, counts)
        bound()
        return bound.status

    def bind(
        self, arrays: Mapping[str, np.ndarray], counts: Mapping[str, int] | None = None, short: bool = False
    ) -> BoundKernel:
        """Check the arrays once; return a callable without arguments that runs on them and returns the code.

        Parameters
        ----------
        arrays, counts
            As for `run`.
        short : bool
            A call takes microseconds: other Python threads wait for it, where otherwise they go on meanwhile. Giving
            up the interpreter's lock costs 50 ns, and up to its switching interval (5 ms) to get it back.

        The callable keeps the arrays alive and reads whatever they hold when it is called. One bound kernel
        is for one thread at a time; bind again for another.

        Raises
        ------
        InvalidInput
            Arrays or counts that do not fit the program.
        """
        checked = check_arrays(self.program, arrays, self.lanes)
        turns = check_counts(self.program, counts or {})
        lengths = {
            buffer.name: buffer.size or 0
            if buffer.role == "work"
            else length(buffer, checked[buffer.name], self.lanes)
            for buffer in self.program.buffers
        }
        check_reach(self.program, lengths, turns)
        return self._bind(checked, turns, short)

    @abstractmethod
    def _bind(self, arrays: dict[str, np.ndarray], counts: dict[str, int], short: bool) -> BoundKernel:
        """Bind checked arrays and counts."""
