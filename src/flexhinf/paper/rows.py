"""A CasADi function compiled to run over many rows of its arguments at once."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from flexhinf.codegen import Buffer, Call, Kernel, Program, Repeat, Slice, compile_program

__all__ = ["compile_rows"]


def compile_rows(function: ca.Function, common: Sequence[str] = ()) -> Kernel:
    """A kernel with one buffer per argument and result by name, and the count "rows".

    Parameters
    ----------
    function : casadi.Function
        With dense columns.
    common : sequence of str
        Arguments that all rows share: a vector (k,) instead of rows (N, k).
    """
    inputs = {function.name_in(k): function.size1_in(k) for k in range(function.n_in())}
    outputs = {function.name_out(k): function.size1_out(k) for k in range(function.n_out())}
    slices = {
        name: Slice(name, size=size, strides=(0 if name in common else size,))
        for name, size in (inputs | outputs).items()
    }
    buffers = [Buffer(name, size if name in common else None, "in") for name, size in inputs.items()]
    buffers += [Buffer(name, None, "out") for name in outputs]
    call = Call(function, tuple(slices[n] for n in inputs), tuple(slices[n] for n in outputs))
    return compile_program(Program(function.name(), tuple(buffers), (Repeat("rows", (call,)),), ("rows",)))
