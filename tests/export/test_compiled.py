"""A controller from a shared library steps as the one in Python, alone, and starts at once."""

from __future__ import annotations

import copy
import ctypes
import pickle
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.codegen.machine import host
from flexhinf.errors import ControllerInUse, InvalidInput, WrongPeriod
from flexhinf.export import compiled as processor
from flexhinf.export.compiled import MARK
from flexhinf.export.recording import record, with_both_roundings

pytestmark = pytest.mark.ci("compiles a library, which its tests share")


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


def test_a_wrong_period_holds_the_last_input(controller: fh.Controller, library: Path) -> None:
    """At 1.5 ms in place of 1 ms from the eighth step on, as the mean of 32 is 0.5 (1 − (31/32)^n) > 0.1 periods; at
    the right period, or where the time is not known, every step is good. Times that are none, late steps and spells of
    another rate: Python refuses the same steps, and its inputs have the same bits."""
    rng = np.random.default_rng(3)
    rates = np.repeat(rng.choice([0.5, 0.9, 1.0, 1.05, 1.3, 3.0], 30), 40) * rng.uniform(0.98, 1.02, 1200)
    mixed = np.where(rng.random(1200) < 0.01, rng.choice([np.nan, -1e-3, np.inf, 0.0], 1200), 1e-3 * rates)
    for times, first in (
        ([1.5e-3] * 60, 8), ([0.5e-3] * 60, 8), ([1e-3] * 60, None), ([0.0] * 60, None), ([1.05e-3] * 60, None),
        (mixed, -1),
    ):  # fmt: skip
        one, codes = fh.load_compiled(library), []
        ours, u = controller.fresh(fused=one.fused), one.step(None)
        for k, elapsed in enumerate(times):
            y, before = 0.01 * np.sin(0.1 * k), u
            u = one.step(y, 0.0, elapsed)
            codes.append(one.code)
            try:
                np.testing.assert_array_equal(ours.step(y, 0.0, elapsed), u)
                assert one.code == "OK"
            except WrongPeriod:
                assert one.code == "BAD_PERIOD"
                np.testing.assert_array_equal(u, before)
        wrong = [k + 1 for k, code in enumerate(codes) if code == "BAD_PERIOD"]
        assert first == -1 or (wrong[0] if wrong else None) == first
        assert first != -1 or 100 < len(wrong) < 1000
    with refused_with(InvalidInput, "seconds", "elapsed=1e-3"):
        ours.step(0.0, 0.0, "1 ms")  # type: ignore[arg-type]
    ours.reset()
    ours.step(0.0, 0.0, elapsed=1e-3)


def test_it_needs_neither_casadi_nor_llvm(library: Path) -> None:
    """Which is why it starts at once."""
    text = f"""
import sys
import flexhinf as fh
arm = fh.load_compiled({str(library)!r})
u = arm.step([0.1], [0.2])
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


def test_what_is_remembered_is_not_given_to_another_controller(
    library: Path, controller: fh.Controller, compiler: str, tmp_path: Path
) -> None:
    """The file of a pickled controller was replaced meanwhile: as many numbers may mean something else."""
    path = tmp_path / "arm.so"
    path.write_bytes(library.read_bytes())
    kept = pickle.dumps(fh.load_compiled(path))
    fh.compile_controller(fh.Controller(controller.law, controller.estimator, 1e-3, 24.0), path)
    with refused_with(InvalidInput, "controller", "load_compiled", str(path)):
        pickle.loads(kept)


@pytest.mark.ci("compiles two libraries")
def test_a_path_that_is_written_anew_is_loaded_anew(
    library: Path, controller: fh.Controller, compiler: str, tmp_path: Path
) -> None:
    """The loader knows libraries by path: it gave the machine code of before under the names of now."""
    path, weak = tmp_path / "arm.so", fh.Controller(controller.law, controller.estimator, 1e-3, 0.5)
    path.write_bytes(library.read_bytes())
    before = fh.load_compiled(path)
    # another size of everything
    feedback = fh.load_compiled(fh.compile_controller(fh.Controller(controller.law, None, 1e-3), path))
    assert feedback._state.size < before._state.size
    assert feedback._library.flexhinf_state_size() <= 8 * feedback._state.size
    assert feedback._library is not before._library
    now = fh.load_compiled(fh.compile_controller(weak, path))
    kept = pickle.dumps(now)
    now = [now, pickle.loads(kept), copy.copy(now)]
    fresh = controller.fresh()
    for _ in range(20):
        expected = weak.step(0.6, 0.9)
        for one in now:
            np.testing.assert_allclose(one.step(0.6, 0.9), expected, rtol=1e-9)
        np.testing.assert_allclose(before.step(0.6, 0.9), fresh.step(0.6, 0.9), rtol=1e-9)
    assert list(tmp_path.iterdir()) == [path]  # the private copies are gone


def test_one_library_is_in_memory_once(library: Path, tmp_path: Path) -> None:
    (tmp_path / "other.so").write_bytes(library.read_bytes())
    assert fh.load_compiled(library)._library is fh.load_compiled(tmp_path / "other.so")._library


def test_where_no_temporary_file_may_be_run_the_copy_lies_beside_the_library(
    library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, path, tried = ctypes.CDLL, tmp_path / "arm.so", []
    path.write_bytes(library.read_bytes() + b"another content")

    def refuses(name: str) -> ctypes.CDLL:
        tried.append(Path(name).parent.parent)
        if tmp_path not in Path(name).parents:
            raise OSError("failed to map segment from shared object")
        return real(name)

    monkeypatch.setattr(ctypes, "CDLL", refuses)
    assert fh.load_compiled(path).step(0.1).shape == (1,)
    assert tried == [Path(tempfile.gettempdir()), tmp_path]
    assert list(tmp_path.iterdir()) == [path]


def patched(library: Path, to: Path, old: bytes, new: bytes) -> Path:
    """The library with other bytes at one place."""
    image = library.read_bytes()
    assert len(old) == len(new)
    assert image.count(old) == 1
    to.write_bytes(image.replace(old, new))
    return to


def test_a_library_for_another_processor_is_refused_before_it_is_loaded(
    library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needed = library.read_bytes().partition(MARK)[2].partition(b"\n")[0].split()
    if not needed:
        pytest.skip("this platform has only one kind of processor")

    def loaded(path: str) -> None:
        raise AssertionError("it was loaded")

    monkeypatch.setattr(ctypes, "CDLL", loaded)
    other = patched(
        library,
        tmp_path / "other.so",
        MARK + b" " + b" ".join(needed),
        MARK + b" " + b" ".join(needed)[:-3] + b"xyz",
    )
    with refused_with(InvalidInput, "xyz", "other.so", "--processor portable"):
        fh.load_compiled(other)
    monkeypatch.setattr(processor, "instructions", lambda: frozenset({"sse3"}))
    with refused_with(InvalidInput, library.name, "--processor portable"):
        fh.load_compiled(library)


@pytest.mark.ci("compiles three libraries")
@pytest.mark.parametrize("choice", ["portable", "any", "native"])
def test_the_manifest_says_what_the_code_needs(
    choice: str, controller: fh.Controller, compiler: str, tmp_path: Path
) -> None:
    path = fh.compile_controller(controller, tmp_path / "arm.so", processor=choice)
    needed = path.read_bytes().partition(MARK)[2].partition(b"\n")[0].decode().split()
    assert set(needed) <= processor.instructions()
    arm = fh.load_compiled(path)
    assert arm.fused == (host().fused and (choice != "any" or platform.machine() not in processor.X86))
    run = with_both_roundings(controller, record(controller, 60))[arm.fused]
    for k, code in enumerate(run.codes):
        u = arm.step(None if code == "PREDICTED" else run.y[k], run.r[k])
        np.testing.assert_array_equal(u, run.u[k])
    if platform.machine() not in processor.X86:
        return
    assert choice == "native" or not any(name.startswith("avx512") for name in needed)
    assert choice != "any" or needed == []
    if shutil.which("objdump"):
        text = subprocess.run(["objdump", "-d", path], capture_output=True, text=True, check=True).stdout
        assert ("zmm" in text) <= ("avx512f" in needed)
        assert ("%ymm" in text) <= ("avx" in needed)
        assert "vfmadd" not in text or "fma" in needed
        assert choice != "portable" or "vfmadd" in text or not host().fused


def test_there_is_no_other_choice_of_processors(controller: fh.Controller, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="'avx512'"):
        fh.compile_controller(controller, tmp_path / "arm.so", processor="avx512")


def test_flags_that_change_results_are_told_at_the_start(
    controller: fh.Controller,
    needs_compiler: Callable[..., None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """CC may name a compiler that has such flags of its own."""
    needs_compiler("gcc", "-fassociative-math")
    other = tmp_path / "other-cc"
    other.write_text('#!/bin/sh\nexec gcc "$@" -fassociative-math\n')
    other.chmod(0o755)
    monkeypatch.setenv("CC", str(other))
    path = fh.compile_controller(controller, tmp_path / "arm.so")
    with pytest.raises(InvalidInput, match="comput"):
        fh.load_compiled(path)


def test_what_does_not_fit(library: Path, tmp_path: Path) -> None:
    arm = fh.load_compiled(library)
    for y in ([0.1, 0.2], "x", [1j]):
        with pytest.raises(InvalidInput, match="measurement"):
            arm.step(y)
    with pytest.raises(InvalidInput, match="command"):
        arm.step([0.1], [0.1, 0.2])
    with pytest.raises(InvalidInput, match="state"):
        arm.reset([0.0])
    (tmp_path / "text.so").write_text("no library")
    for path in (tmp_path / "text.so", tmp_path / "missing.so"):
        with pytest.raises(InvalidInput, match=path.name):
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


@pytest.mark.parametrize(
    ("highest", "given", "found"),
    [
        ("0", "-O3", "-O0"),
        ("2", "-O3", "-O2"),
        ("3", "-O2", "-O2"),
        ("", "-O3", "-O3"),
        ("0", "-Ofast", "-Ofast"),
    ],
)
def test_a_level_of_c_is_at_most_the_stated_one(
    highest: str, given: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a compiler sees it that writes down its arguments."""
    told = tmp_path / "cc"
    told.write_text('#!/bin/sh\necho "$@" > built\n')
    told.chmod(0o755)
    monkeypatch.setenv("CC", str(told))
    if highest:
        monkeypatch.setenv("FLEXHINF_OPTIMISATION", highest)
    words = processor.build({"one.c": "int one;"}, tmp_path, (given, "-shared")).read_text().split()
    assert [word for word in words if word.startswith("-O")] == [found]
    assert "-shared" in words
