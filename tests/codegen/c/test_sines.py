"""Sine and cosine in float: against those of double, for angles of every size."""

from __future__ import annotations

import ctypes
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import casadi
import numpy as np
import pytest

from flexhinf.codegen import Buffer, Call, Program, Slice
from flexhinf.codegen.c import Real, Translator

X = casadi.SX.sym("x")
TURN = casadi.Function("turn", [X], [casadi.vertcat(casadi.sin(X), casadi.cos(X))])
ENTRY = """
void run(const float *x, float *y, int count)
{
    for (int k = 0; k < count; ++k) {
        turns_run(x + k, y + 2 * k);
    }
}
"""
#: With fused multiply-adds, and without.
FUSED = {
    True: "#define FMA(a, b, c) __builtin_fmaf((a), (b), (c))",
    False: "#define FMA(a, b, c) ((a) * (b) + (c))",
}


@pytest.fixture(params=[True, False], ids=["fused", "plain"])
def turn(
    request: pytest.FixtureRequest, needs_compiler: Callable[..., None], tmp_path: Path
) -> Callable[[np.ndarray], np.ndarray]:
    """(count,) → sine and cosine as compiled C gives them, (2, count)."""
    needs_compiler("gcc")
    buffers = (Buffer("x", 1, "in"), Buffer("y", 2, "out"))
    program = Program("turn", buffers, (Call(TURN, (Slice("x", 0, 1),), (Slice("y", 0, 2),)),))
    translator = Translator("turns", Real("float"))
    translator.add(program, "run")
    text = str(translator)
    assert (
        re.search(r"\b(sin|cos)f?\(", text) is None
    )  # nothing goes to the library, whose time nobody bounds
    source, library = tmp_path / "turn.c", tmp_path / "turn.so"
    head = f"#include <math.h>\n#include <stdint.h>\ntypedef float real;\n{FUSED[request.param]}\n"
    source.write_text(head + text + ENTRY, encoding="utf-8")
    flags = ["-std=c99", "-O1", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, str(source), "-lm", "-o", str(library)], check=True)
    run = ctypes.CDLL(str(library)).run

    def of(x: np.ndarray) -> np.ndarray:
        angles, both = np.ascontiguousarray(x, dtype=np.float32), np.empty((len(x), 2), dtype=np.float32)
        run(angles.ctypes.data_as(ctypes.c_void_p), both.ctypes.data_as(ctypes.c_void_p), len(x))
        return both.T

    return of


def angles() -> np.ndarray:
    """Of every size, both signs, and the floats next to multiples of π/2."""
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 0x7F800000, 200_000, dtype=np.uint32).view(np.float32)
    usual = rng.uniform(-10.0, 10.0, 100_000).astype(np.float32)
    quarters = (np.arange(1, 100_000) * (np.pi / 2)).astype(np.float32)
    edges = np.array([0.0, 1e-45, 1e-38, 1e4, np.nextafter(np.float32(1e4), np.float32(2e4)), 3.4028235e38])
    return np.concatenate([bits, -bits, usual, quarters, edges.astype(np.float32)])


@pytest.mark.oracle
def test_a_sine_in_float_is_that_of_double(turn: Callable[[np.ndarray], np.ndarray]) -> None:
    x = angles()
    for found, of in zip(turn(x), (np.sin, np.cos)):
        exact = of(x.astype(float))
        unit = np.spacing(np.abs(exact).astype(np.float32)).astype(float)
        assert (np.abs(found - exact) <= 3.0 * unit).all()
        assert (np.abs(found) <= 1.0).all()


def test_a_sine_of_what_is_not_finite_is_nan(turn: Callable[[np.ndarray], np.ndarray]) -> None:
    with np.errstate(invalid="ignore"):
        assert np.isnan(turn(np.array([np.inf, -np.inf, np.nan]))).all()


def test_sine_is_odd_and_cosine_even(turn: Callable[[np.ndarray], np.ndarray]) -> None:
    x = angles()
    (sine, cosine), (other, same) = turn(x), turn(-x)
    assert (sine == -other).all()
    assert (cosine == same).all()
