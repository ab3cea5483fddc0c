"""Kernels: a program over traced functions becomes machine code, for one run or for many in lanes."""

from __future__ import annotations

from flexhinf.codegen.compiler import BoundKernel, Kernel, Status, compile_program
from flexhinf.codegen.compose import DIRECT, Composer, Direct
from flexhinf.codegen.memory import Block, Buffer, Columns, Slice, aligned
from flexhinf.codegen.program import (
    Call,
    Cholesky,
    Copy,
    Guard,
    Map,
    Normal,
    OuterSum,
    Polynomial,
    Program,
    Repeat,
    Sweep,
    When,
)
