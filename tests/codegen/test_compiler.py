"""What cannot be compiled is refused in words."""

import subprocess
import sys

import casadi
import numpy as np
import pytest

from flexhinf.codegen import Buffer, Call, Program, Slice, compile_program, machine
from flexhinf.codegen.program import Unsupported

X = casadi.SX.sym("x")


def single(expression: casadi.SX) -> Program:
    step = Call(casadi.Function("f", [X], [expression]), (Slice("x"),), (Slice("y"),))
    return Program("single", (Buffer("x", 1, "in"), Buffer("y", 1, "out")), (step,))


def value(kernel, x: float) -> float:
    y = np.zeros((1, kernel.lanes))
    kernel.run({"x": np.full((1, kernel.lanes), x), "y": y})
    assert (y == y[0, 0]).all()
    return y[0, 0]


@pytest.mark.parametrize("lanes", [1, 2])
def test_an_operation_without_machine_code_is_refused_by_name(lanes):
    with pytest.raises(Unsupported) as refused:
        compile_program(single(casadi.erfinv(X)), lanes)
    assert "OP_ERFINV" in refused.value.found


def test_a_c_library_without_the_function(monkeypatch):
    monkeypatch.setattr(machine, "_LIBRARIES", dict.fromkeys(["linux", "win32", "darwin"], ()))
    machine._address.cache_clear()
    with pytest.raises(Unsupported) as refused:
        compile_program(single(casadi.tan(X)))
    assert "'tan'" in refused.value.found


def test_without_llvmlite(monkeypatch):
    monkeypatch.setitem(sys.modules, "flexhinf.codegen.machine", None)
    monkeypatch.delattr("flexhinf.codegen.machine")
    with pytest.raises(Unsupported, match="llvmlite"):
        compile_program(single(X + 1))


def test_what_llvm_refuses(monkeypatch):
    monkeypatch.setattr(machine, "assemble", lambda text, level: machine.llvm.parse_assembly("nonsense"))
    with pytest.raises(Unsupported, match="llvmlite"):
        compile_program(single(X + 12345.678))


def test_lanes_that_are_none_are_refused():
    from flexhinf.errors import InvalidInput

    with pytest.raises(InvalidInput):
        compile_program(single(X), lanes=0)


def test_large_programs_are_optimised_less():
    assert machine.level(100_000) < machine.level(1000)


@pytest.mark.ci("compiles 36,000 operations")
def test_a_large_program_compiles_and_agrees():
    value_, expected = X, 0.7
    for k in range(12_000):
        value_ = casadi.sqrt(value_ * (1 + k % 7) + 1.0)
        expected = np.sqrt(expected * (1 + k % 7) + 1.0)
    kernel = compile_program(single(value_))
    np.testing.assert_allclose(value(kernel, 0.7), expected, rtol=1e-14)


def test_importing_the_room_loads_neither_casadi_nor_llvmlite():
    script = "import sys, flexhinf.codegen; sys.exit('llvmlite' in sys.modules or 'casadi' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


@pytest.mark.parametrize(
    ("triple", "features", "fused"),
    [
        ("x86_64-unknown-linux-gnu", "+avx2,+fma", True),
        ("x86_64-unknown-linux-gnu", "+avx2,-fma,+fma4", False),
        ("aarch64-apple-darwin", "", True),
    ],
)
def test_which_processors_fuse(triple, features, fused):
    assert machine.Host(triple, "cpu", features, "").fused is fused
