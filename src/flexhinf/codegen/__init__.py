"""Kernels: a program over traced functions becomes machine code, for one run or for many in lanes."""

from __future__ import annotations

from flexhinf.codegen.compiler import compile_program
from flexhinf.codegen.interpreter import interpret
from flexhinf.codegen.kernel import BoundKernel, Kernel, Status
from flexhinf.codegen.program import (
    Buffer,
    Call,
    Columns,
    Copy,
    Guard,
    Map,
    Program,
    Repeat,
    Slice,
    WeightedSum,
)

__all__ = [
    "BoundKernel",
    "Buffer",
    "Call",
    "Columns",
    "Copy",
    "Guard",
    "Kernel",
    "Map",
    "Program",
    "Repeat",
    "Slice",
    "Status",
    "WeightedSum",
    "compile_program",
    "interpret",
]
