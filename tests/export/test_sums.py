"""Sums of outer products in C against machine code, for sizes that vectors do not divide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.in_c import in_c

from flexhinf.codegen import Buffer, OuterSum, Program, Slice, compile_program


def summed(count: int, rows: int, columns: int, symmetric: bool, added: bool) -> Program:
    """y = Σ_k w_k l_kᵀ r_k, or of itself and y."""
    left, target = Slice("l", 0, count * rows), Slice("y", 0, rows * columns)
    right = left if symmetric else Slice("r", 0, count * columns)
    plus = target if added else None
    step = OuterSum(left, right, target, count, Slice("w", 0, count), plus, symmetric)
    sizes = {"l": count * rows, "r": count * columns, "w": count}
    buffers = [Buffer(name, size, "in") for name, size in sizes.items()]
    return Program("sums", (*buffers, Buffer("y", rows * columns, "state")), (step,))


@pytest.mark.quick_cases(4)
@pytest.mark.oracle
@pytest.mark.parametrize("size", [(3, 2, 5), (8, 3, 8), (13, 11, 11), (57, 7, 28), (57, 28, 28)])
@pytest.mark.parametrize("added", [False, True])
@pytest.mark.parametrize("fused", [False, True])
def test_a_sum_in_c_is_that_in_machine_code(
    size: tuple[int, int, int], added: bool, fused: bool, tmp_path: Path
) -> None:
    kinds = {False, size[1] == size[2]}
    programs = {f"symmetric_{symmetric}": summed(*size, symmetric, added) for symmetric in kinds}
    run = in_c(programs, tmp_path, fused)
    for (name, program), symmetric in zip(programs.items(), kinds, strict=True):
        rng = np.random.default_rng(0)
        given = {buffer.name: rng.normal(size=buffer.size or 0) for buffer in program.buffers}
        if symmetric:
            given["y"] = np.add.outer(given["y"][: size[1]], given["y"][: size[1]]).ravel()
        ours, theirs = ({key: array.copy() for key, array in given.items()} for _ in range(2))
        compile_program(program, fused=fused).run({key: array[:, None] for key, array in theirs.items()})
        assert run(name, ours) == 0
        np.testing.assert_array_equal(ours["y"], theirs["y"])
