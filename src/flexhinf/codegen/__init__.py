"""Kernels: a program over traced functions becomes machine code, for one run or for many in lanes.

::

    NumPy ─► scalars.trace ─► compose ─► Program ─┬─► emit, by dataflow ───────────────────────► LLVM ─► machine code
                                                  ├─► the same, one lane, by threads ──────────► PTX ─► gpu, by cuda
                                                  └─► stages, straight ─► Program ─► c, by dataflow ─► C99
    loops over tables of places: the solver's, the checker's ─► loops ─────────────────► LLVM ─► machine code

`program` has the steps, `compose` makes them of NumPy code. `dataflow` has the operations of one traced function in
single-assignment form with products fused into sums; `emit` and `c` read each function of a program so, and another
target may, see CONTRIBUTING. What an operation is, in NumPy, LLVM and C, and in certificates, is said by `operations`
alone; of its rows `loops` uses those of arithmetic.

Lines of LLVM are written by `emit.writer`. `emit.module` writes programs by it, `emit.function` what is traced,
`emit.algebra`, `emit.group` and `emit.reflections` their linear algebra, `emit.sines` sine and cosine, `noise` random
numbers, and `loops` its functions. What occurs once in one of these, such as a conversion, is a line of its own there.

For C, a controller takes one of two ways, by what it is. One that is a single trace has no steps yet: `stages` divides
its operations into calls, where `recorder` kept the stages of the model. One that is composed has too many: `straight`
traces neighbours among them again, as one. Both give a `Program`, in which a person finds functions of one length:
`cut` says it for both, for `c.function`, which writes what is traced, and for `c.statements`, which writes the calls.
"""

from __future__ import annotations

from flexhinf.codegen.compiler import (
    BoundKernel as BoundKernel,
    Kernel as Kernel,
    RunStatus as RunStatus,
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
    BufferPart as BufferPart,
    Columns as Columns,
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
