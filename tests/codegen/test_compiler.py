"""What cannot be compiled still runs, and says so once."""

import subprocess
import sys

import casadi
import numpy as np
import pytest

from flexhinf.codegen import Buffer, Call, Program, Slice, compile_program, compiler, machine

X = casadi.SX.sym("x")


def single(expression: casadi.SX) -> Program:
    step = Call(casadi.Function("f", [X], [expression]), (Slice("x"),), (Slice("y"),))
    return Program("single", (Buffer("x", 1, "in"), Buffer("y", 1, "out")), (step,))


def value(kernel, x: float) -> float:
    y = np.zeros((1, kernel.lanes))
    kernel.run({"x": np.full((1, kernel.lanes), x), "y": y})
    assert (y == y[0, 0]).all()
    return y[0, 0]


@pytest.fixture
def notices(caplog):
    compiler._notice.cache_clear()
    yield lambda: [record.getMessage() for record in caplog.records]
    compiler._notice.cache_clear()


@pytest.mark.parametrize("lanes", [1, 2])
def test_an_operation_without_machine_code_is_interpreted(lanes, notices):
    for _ in range(3):
        kernel = compile_program(single(casadi.erfinv(X)), lanes)
        assert not kernel.compiled
        np.testing.assert_allclose(value(kernel, 0.5), 0.4769362762044699, rtol=1e-9)
    (notice,) = notices()
    assert "OP_ERFINV" in notice


def test_a_c_library_without_the_function(monkeypatch, notices):
    monkeypatch.setattr(machine, "_libraries", lambda: ())
    machine._address.cache_clear()
    assert value(compile_program(single(casadi.tan(X))), 0.0) == 0.0
    assert ["'tan' was not found" in notice for notice in notices()] == [True]


def test_without_llvmlite(monkeypatch, notices):
    monkeypatch.setitem(sys.modules, "flexhinf.codegen.machine", None)
    monkeypatch.delattr("flexhinf.codegen.machine")
    kernel = compile_program(single(X + 1))
    assert not kernel.compiled
    assert value(kernel, 1.0) == 2.0
    assert ["llvmlite does not work here" in notice for notice in notices()] == [True]


def test_what_llvm_refuses_is_interpreted(monkeypatch, notices):
    monkeypatch.setattr(machine, "assemble", lambda text, level: machine.llvm.parse_assembly("nonsense"))
    kernel = compile_program(single(X + 12345.678))
    assert not kernel.compiled
    assert len(notices()) == 1


def test_an_error_of_the_caller_is_no_reason_to_interpret():
    from flexhinf.errors import InvalidInput

    with pytest.raises(InvalidInput):
        compile_program(single(X), lanes=0)


def test_large_programs_are_optimised_less():
    assert machine.level(100_000) < machine.level(1000)


def test_a_large_program_compiles_and_agrees():
    value_, expected = X, 0.7
    for k in range(12_000):
        value_ = casadi.sqrt(value_ * (1 + k % 7) + 1.0)
        expected = np.sqrt(expected * (1 + k % 7) + 1.0)
    kernel = compile_program(single(value_))
    assert kernel.compiled
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
