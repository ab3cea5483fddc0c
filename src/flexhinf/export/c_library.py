"""Whether another C library gives the same numbers: its functions on many arguments, as one hash."""

from __future__ import annotations

import ctypes
import ctypes.util
import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from flexhinf.codegen.c import Real
from flexhinf.codegen.operations import OPERATIONS
from flexhinf.export.recording import memory_hash


@dataclass(frozen=True)
class Arguments:
    """So many from the first one on, in steps of so many to 1; the second operand is that of `turn` times the place.

    Two libraries that differ in one result of ten thousand agree in all of these with a probability of 0.002.
    """

    count: int = 65536
    first: float = -32.0
    steps: float = 1024.0
    turn: int = 40503


ARGUMENTS = Arguments()


#: What our own C calls of the mathematical library beside operations.
BESIDE = frozenset({"frexp", "isfinite", "isnan"})


def mathematics(source: str) -> list[str]:
    """Functions and macros of the mathematical library that a source calls: those of operations, and of our own C."""
    known = BESIDE.union(*(re.findall(r"(\w+)\{f\}", row.c) for row in OPERATIONS.values()))
    called = set[str](re.findall(r"\b([a-z]\w*)\(", source))
    return sorted(name for name in called if {name, name.removesuffix("f")} & known)


def library_calls(functions: Sequence[str], real: Real) -> list[tuple[str, int]]:
    """Those of some functions of <math.h> whose results differ from library to library, and their operands."""
    known = {row.library + real.suffix: row.operands for row in OPERATIONS.values() if row.library}
    return [(name, known[name]) for name in functions if name in known]


def library_hash(calls: Sequence[tuple[str, int]], real: Real) -> int | None:
    """What this process's C library gives, as `same_library` of ``test.c`` computes it; None where it lacks a
    function."""
    found = [_hash(name, operands, real.name) for name, operands in calls]
    return None if None in found else memory_hash(np.array(found, dtype=float))


@cache
def _hash(name: str, operands: int, real: str) -> int | None:
    """The hash of one function, as far as a double holds it; no number counts as 0."""
    kind = ctypes.c_float if real == "float" else ctypes.c_double
    library = "ucrtbase" if sys.platform == "win32" else ctypes.util.find_library("m")
    function = getattr(ctypes.CDLL(library), name, None)
    if function is None:
        return None
    function.restype, function.argtypes = kind, [kind] * operands
    places = np.arange(ARGUMENTS.count)
    first = ARGUMENTS.first + places / ARGUMENTS.steps
    columns = [first, first[places * ARGUMENTS.turn % ARGUMENTS.count]][:operands]
    results = [float(function(*row)) for row in zip(*(column.tolist() for column in columns))]
    return memory_hash(np.array([0.0 if math.isnan(x) else x for x in results])) >> 32
