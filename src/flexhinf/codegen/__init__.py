"""Kernels: a program over traced functions becomes machine code, for one run or for many in lanes.

::

    NumPy code ─► trace ─► Program ─► dataflow ─► emit ─► LLVM ─► machine code
                             │          │   operations: what each is in NumPy, LLVM and C
                             │          │
                             └► stages, straight ─► c ─► C99

`program` has the steps, `dataflow` the operations of a traced function in single-assignment form with products fused
into sums, `operations` the one table of what they are. For C, `stages` and `straight` divide a step into functions that
a person reads.
"""

from __future__ import annotations

from flexhinf.codegen.compiler import (
    BoundKernel as BoundKernel,
    Kernel as Kernel,
    Status as Status,
    compile_program as compile_program,
)
from flexhinf.codegen.compose import (
    DIRECT as DIRECT,
    Composer as Composer,
    Direct as Direct,
    gives as gives,
)
from flexhinf.codegen.memory import (
    Block as Block,
    Buffer as Buffer,
    Columns as Columns,
    Part as Part,
    Slice as Slice,
    aligned as aligned,
)
from flexhinf.codegen.program import (
    Call as Call,
    Cholesky as Cholesky,
    Copy as Copy,
    Guard as Guard,
    Householder as Householder,
    Map as Map,
    Normal as Normal,
    OuterSum as OuterSum,
    Polynomial as Polynomial,
    Program as Program,
    Repeat as Repeat,
    Residual as Residual,
    Stages as Stages,
    Sweep as Sweep,
    When as When,
)
from flexhinf.codegen.recorder import Recorder as Recorder
