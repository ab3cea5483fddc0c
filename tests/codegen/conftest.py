"""Kernels of single functions."""

import casadi
import numpy as np
import pytest

from flexhinf.codegen import Buffer, Call, Program, Repeat, Slice, compile_program


@pytest.fixture(scope="session")
def pointwise():
    """``pointwise(function, *columns, lanes, fused)``: a function of scalars on every point, compiled."""

    def evaluate(
        function: casadi.Function, *columns: np.ndarray, lanes: int = 1, fused: bool | None = None
    ) -> np.ndarray:
        points = len(columns[0])
        names = [f"in{k}" for k in range(len(columns))]
        buffers = [*(Buffer(name, None, "in") for name in names), Buffer("out", None, "out")]
        call = Call(function, tuple(Slice(name, 0, 1, (1,)) for name in names), (Slice("out", 0, 1, (1,)),))
        program = Program("pointwise", tuple(buffers), (Repeat("points", (call,)),), ("points",))
        kernel = compile_program(program, lanes, fused)
        turns = -(-points // lanes)
        arrays = {
            name: np.resize(np.asarray(column, dtype=float), (turns, lanes))
            for name, column in zip(names, columns, strict=True)
        }
        arrays["out"] = np.zeros((turns, lanes))
        assert kernel.run(arrays, {"points": turns}).fine
        return arrays["out"].reshape(-1)[:points]

    return evaluate
