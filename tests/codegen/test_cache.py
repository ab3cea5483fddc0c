"""A cache file is used when it is exactly right, and never otherwise."""

import os
import subprocess
import sys
from pathlib import Path

import casadi
import numpy as np
import pytest

from flexhinf.codegen import Buffer, Call, Program, Slice, cache, compile_program, machine

X = casadi.SX.sym("x")
STEP = Call(casadi.Function("f", [X], [3 * casadi.exp(X)]), (Slice("x"),), (Slice("x"),))
PROGRAM = Program("cached", (Buffer("x", 1, "state"),), (STEP,))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("FLEXHINF_CACHE", str(tmp_path / "kernels"))
    return tmp_path / "kernels"


@pytest.fixture
def assembled(monkeypatch):
    """Counts how often LLVM is asked."""
    calls = []
    assemble = machine.assemble
    monkeypatch.setattr(machine, "assemble", lambda *arguments: calls.append(1) or assemble(*arguments))
    return calls


def works() -> bool:
    x = np.zeros(1)
    kernel = compile_program(PROGRAM)
    return kernel.compiled and kernel.run({"x": x}).fine and x[0] == 3.0


def only_file(folder: Path) -> Path:
    (file,) = folder.iterdir()
    return file


def test_the_second_time_nothing_is_compiled(folder, assembled):
    assert works()
    assert works()
    assert len(assembled) == 1
    assert only_file(folder).suffix == ".o"


def test_another_process_finds_it(folder, assembled):
    assert works()
    script = "import sys; sys.path.insert(0, sys.argv[1]); import test_cache as t; assert t.works()"
    script += "; assert len(list(t.cache.folder().iterdir())) == 1"
    subprocess.run([sys.executable, "-c", script, str(Path(__file__).parent)], check=True)


def test_lanes_and_programs_have_files_of_their_own(folder):
    compile_program(PROGRAM)
    compile_program(PROGRAM, 4)
    assert len(list(folder.iterdir())) == 2


DAMAGE = {
    "empty": lambda content: b"",
    "cut": lambda content: content[:-1],
    "longer": lambda content: content + b"\0",
    "one bit of the code": lambda content: content[:-100] + bytes([content[-100] ^ 1]) + content[-99:],
    "another magic": lambda content: b"F" + content[1:],
    "another key": lambda content: content[:30] + bytes([content[30] ^ 1]) + content[31:],
    "no code": lambda content: content[:87],
    "text": lambda content: b"hello",
}


@pytest.mark.parametrize("case", DAMAGE)
def test_a_damaged_file_is_made_anew(case, folder, assembled):
    assert works()
    file = only_file(folder)
    right = file.read_bytes()
    file.write_bytes(DAMAGE[case](right))
    assert works()
    assert len(assembled) == 2
    assert only_file(folder).read_bytes() == right


def test_a_file_of_another_program_is_not_taken(folder, assembled):
    other = Call(casadi.Function("f", [X], [4 * X]), (Slice("x"),), (Slice("x"),))
    compile_program(Program("cached", PROGRAM.buffers, (other,)))
    foreign = only_file(folder).read_bytes()
    assert works()
    (mine,) = (file for file in folder.iterdir() if file.read_bytes() != foreign)
    mine.write_bytes(foreign)
    assert works()
    assert len(assembled) == 3


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="the system does not know of users")
def test_a_file_of_another_user_is_not_taken(folder, assembled, monkeypatch):
    assert works()
    monkeypatch.setattr(os, "getuid", lambda: os.geteuid() + 1)
    assert works()
    assert len(assembled) == 2


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="the system does not know of users")
def test_a_file_that_others_may_write_is_not_taken(folder, assembled):
    assert works()
    only_file(folder).chmod(0o666)
    assert works()
    assert len(assembled) == 2


def test_a_folder_in_place_of_the_file_does_no_harm(folder, assembled):
    assert works()
    file = only_file(folder)
    file.unlink()
    file.mkdir()
    assert works()
    assert [entry.name for entry in folder.iterdir()] == [file.name]


def test_a_folder_that_cannot_be_made_only_costs_time(tmp_path, monkeypatch, assembled):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("FLEXHINF_CACHE", str(blocked / "kernels"))
    assert works()
    assert works()
    assert len(assembled) == 2


def test_the_oldest_files_go_first(folder, monkeypatch):
    monkeypatch.setattr(cache, "_MOST_FILES", 3)
    for k in range(5):
        cache.cached((str(k),), lambda k=k: b"code" + bytes([k]))
        for file in folder.iterdir():
            os.utime(file, (file.stat().st_atime, file.stat().st_mtime - 10))
    assert len(list(folder.iterdir())) == 3
    assert cache.cached(("4",), lambda: b"new") == b"code\x04"
    assert cache.cached(("0",), lambda: b"new") == b"new"


def test_parts_are_not_run_together(folder):
    cache.cached(("a", "bc"), lambda: b"1")
    assert cache.cached(("ab", "c"), lambda: b"2") == b"2"


@pytest.mark.skipif(sys.platform != "linux", reason="the folders of other systems differ")
def test_where_the_folder_is(monkeypatch, tmp_path):
    monkeypatch.setenv("FLEXHINF_CACHE", "/a/b")
    assert cache.folder() == Path("/a/b")
    monkeypatch.delenv("FLEXHINF_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/x")
    assert cache.folder() == Path("/x/flexhinf")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache.folder() == tmp_path / ".cache" / "flexhinf"
