"""A controller from a shared library steps as the one in Python, alone, and starts at once."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.errors import ControllerInUse, InvalidInput
from flexhinf.export.recording import record


@pytest.fixture(scope="module")
def library(controller: fh.Controller, compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fh.compile_controller(controller, tmp_path_factory.mktemp("so") / "arm.so")


@pytest.mark.oracle
def test_it_steps_as_in_python(controller: fh.Controller, library: Path) -> None:
    run, compiled = record(controller), fh.load_compiled(library)
    assert compiled.measured == controller.measured
    assert compiled.period == controller.period
    assert compiled.units["motor_voltage"] == "V"
    for k, code in enumerate(run.codes):
        u = compiled.step(None if code == "PREDICTED" else run.y[k], run.r[k])
        assert compiled.code == code
        np.testing.assert_allclose(u, run.u[k], rtol=0, atol=1e-9 * np.abs(run.u).max())
        np.testing.assert_allclose(compiled.estimate, run.estimate[k], rtol=0, atol=1e-7)


def test_it_needs_neither_casadi_nor_llvm_and_starts_at_once(library: Path) -> None:
    text = f"""
import sys, time
import numpy
start = time.process_time()
import flexhinf as fh
arm = fh.load_compiled({str(library)!r})
u = arm.step([0.1], [0.2])
assert time.process_time() - start < 0.3, time.process_time() - start
assert not {{"casadi", "llvmlite", "scipy"}} & set(sys.modules), sorted(sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_copies_and_pickles_go_on_alone(library: Path) -> None:
    one = fh.load_compiled(library)
    for _ in range(3):
        one.step([0.1], [0.2])
    others = [copy.copy(one), copy.deepcopy(one), pickle.loads(pickle.dumps(one))]
    expected = one.step([0.11])
    for other in others:
        np.testing.assert_array_equal(other.step([0.11]), expected)
    one.reset([0.1, 0.0, 0.1, 0.0], [3.0])
    again = fh.load_compiled(library)
    again.reset(state=[0.1, 0.0, 0.1, 0.0], input=3.0)
    np.testing.assert_array_equal(one.step(0.1), again.step(0.1))
    assert "arm.so" in repr(one)


def test_a_compiler_that_does_not_know_the_machine(
    controller: fh.Controller, compiler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = tmp_path / "plain-cc"
    plain.write_text(f'#!/bin/sh\ncase "$*" in *-march=*) exit 1;; esac\nexec {compiler} "$@"\n')
    plain.chmod(0o755)
    monkeypatch.setenv("CC", str(plain))
    assert fh.load_compiled(fh.compile_controller(controller, tmp_path / "arm.so")).step([0.1]).shape == (1,)


def test_what_does_not_fit(library: Path, tmp_path: Path) -> None:
    arm = fh.load_compiled(library)
    for y in ([0.1, 0.2], "x", [1j]):
        with pytest.raises(InvalidInput, match="measurement does not fit"):
            arm.step(y)
    with pytest.raises(InvalidInput, match="command does not fit"):
        arm.step([0.1], [0.1, 0.2])
    with pytest.raises(InvalidInput, match="state does not fit"):
        arm.reset([0.0])
    (tmp_path / "text.so").write_text("no library")
    for path in (tmp_path / "text.so", tmp_path / "missing.so"):
        with pytest.raises(InvalidInput, match="cannot be loaded"):
            fh.load_compiled(path)
    arm._busy = True
    found: list[BaseException] = []

    def other() -> None:
        try:
            arm.step([0.1])
        except ControllerInUse as error:
            found.append(error)

    thread = threading.Thread(target=other)
    thread.start()
    thread.join()
    assert len(found) == 1
