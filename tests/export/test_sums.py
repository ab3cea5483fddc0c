"""Sums of outer products in C against machine code, for sizes that vectors do not divide."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np
import pytest

from flexhinf.codegen import Buffer, OuterSum, Program, Slice, compile_program
from flexhinf.codegen.c import Translator
from flexhinf.export.fmu import DOUBLE

#: Of C with fused multiply-adds, and without.
HEADS = {
    True: "#include <math.h>\n#define FMA(a, b, c) fma(a, b, c)\n",
    False: "#define FMA(a, b, c) ((a) * (b) + (c))\n",
}
ENTRY = """
int run(const double *l, const double *r, const double *w, double *y)
{
    return sums_run(l, r, w, y);
}
"""


def summed(count: int, rows: int, columns: int, symmetric: bool, added: bool) -> Program:
    """y = Σ_k w_k l_kᵀ r_k, or of itself and y."""
    left, target = Slice("l", 0, count * rows), Slice("y", 0, rows * columns)
    right = left if symmetric else Slice("r", 0, count * columns)
    plus = target if added else None
    step = OuterSum(left, right, target, count, Slice("w", 0, count), plus, symmetric)
    sizes = {"l": count * rows, "r": count * columns, "w": count}
    buffers = [Buffer(name, size, "in") for name, size in sizes.items()]
    return Program("sums", (*buffers, Buffer("y", rows * columns, "state")), (step,))


@pytest.mark.quick_cases(10)
@pytest.mark.oracle
@pytest.mark.parametrize("size", [(3, 2, 5), (8, 3, 8), (13, 11, 11), (57, 7, 28), (57, 28, 28)])
@pytest.mark.parametrize("added", [False, True])
@pytest.mark.parametrize("fused", [False, True])
def test_a_sum_in_c_is_that_in_machine_code(
    size: tuple[int, int, int], added: bool, fused: bool, compiler: str, tmp_path: Path
) -> None:
    for symmetric in {False, size[1] == size[2]}:
        program = summed(*size, symmetric, added)
        translator = Translator("sums", DOUBLE)
        translator.add(program, "run")
        source, library = tmp_path / f"sums{symmetric}.c", tmp_path / f"sums{symmetric}.so"
        source.write_text(HEADS[fused] + str(translator) + ENTRY, encoding="utf-8")
        subprocess.run(
            [compiler, "-O0", "-shared", "-fPIC", str(source), "-lm", "-o", str(library)], check=True
        )
        rng = np.random.default_rng(0)
        given = {buffer.name: rng.normal(size=buffer.size or 0) for buffer in program.buffers}
        if symmetric:
            given["y"] = np.add.outer(given["y"][: size[1]], given["y"][: size[1]]).ravel()
        ours, theirs = ({name: array.copy() for name, array in given.items()} for _ in range(2))
        compile_program(program, fused=fused).run({name: array[:, None] for name, array in theirs.items()})
        assert (
            ctypes.CDLL(str(library)).run(*(array.ctypes.data_as(ctypes.c_void_p) for array in ours.values()))
            == 0
        )
        np.testing.assert_array_equal(ours["y"], theirs["y"])
