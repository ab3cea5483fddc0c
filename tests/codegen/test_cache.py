"""A cache file is used when it is exactly right, and never otherwise."""

import functools
import hashlib
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import casadi
import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.codegen import Buffer, Call, Program, Slice, compile_program, compiler as cache, machine
from flexhinf.errors import InvalidInput
from flexhinf.files import part_file

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
    return kernel.run({"x": x}).fine and x[0] == 3.0


def only_file(folder: Path) -> Path:
    (file,) = folder.iterdir()
    return file


def test_the_second_time_nothing_is_compiled(folder, assembled):
    assert works()
    assert works()
    assert len(assembled) == 1
    assert only_file(folder).suffix == ".o"


@pytest.mark.ci("starts a process")
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
def test_a_damaged_file_is_told_and_made_anew(case, folder, assembled, caplog):
    assert works()
    file = only_file(folder)
    right = file.read_bytes()
    assert works()
    assert not caplog.records
    file.write_bytes(DAMAGE[case](right))
    assert works()
    assert len(assembled) == 2
    assert only_file(folder).read_bytes() == right
    (told,) = caplog.messages
    assert re.search(f" {re.escape(str(file))} .*damaged", told)


@pytest.mark.parametrize("other", ["processor", "instructions", "system", "compiler"])
def test_code_of_another_processor_is_not_run(other, folder, assembled, monkeypatch):
    """A folder in a home that machines share: instructions that this one lacks would end the process."""
    here = machine.host()
    changed = {
        "processor": {"cpu": "generic"},
        "instructions": {"features": here.features.rpartition(",")[0]},
        "system": {"triple": here.triple.replace("linux", "linux6").replace("apple", "apple6")},
        "compiler": {"version": "another LLVM"},
    }[other]
    there = replace(here, **changed)
    assert there != here
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(machine, "host", lambda: there)
        elsewhere.setattr(machine, "_target", functools.partial(_target_of, here))
        assert works()
    theirs = only_file(folder)
    monkeypatch.setattr(machine, "Code", _noting(machine.Code, loaded := []))
    assert works()
    assert len(assembled) == 2
    (ours,) = set(folder.iterdir()) - {theirs}
    assert len(loaded) == 1
    assert loaded[0] in ours.read_bytes()
    assert ours.name != theirs.name


def _target_of(host, level):
    """A target as that of `machine`, for this processor whatever is said."""
    target = machine.llvm.Target.from_triple(host.triple)
    options = {"cpu": host.cpu, "features": host.features, "opt": level}
    return target.create_target_machine(**options, reloc="pic", codemodel="small")


def _noting(code, loaded):
    """The class with a note of what is loaded."""

    def made(image, *others):
        loaded.append(image)
        return code(image, *others)

    return made


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


def test_only_files_of_ours_are_ever_removed(folder, monkeypatch):
    monkeypatch.setattr(cache, "_MOST_FILES", 1)
    folder.mkdir()
    theirs = [folder / name for name in ("main.o", "f" * 64 + ".o", "tmpabc.part", "flexhinf-notes.txt")]
    for k, file in enumerate(theirs):
        file.write_bytes(b"\x7fELF of somebody's own build")
        os.utime(file, (k, k))  # older than anything of ours
    for k in range(3):
        cache.cached((str(k),), lambda k=k: bytes([k]))
    assert all(file.exists() for file in theirs)
    assert len(list(folder.iterdir())) <= len(theirs) + 2


def test_what_a_killed_process_began_to_write_is_removed_by_the_next_one(folder):
    script = (
        "import os, sys; from flexhinf.codegen import compiler as cache\n"
        "os.replace = lambda *_: os.kill(os.getpid(), 9)\n"
        "cache.cached(('killed',), lambda: b'code')"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode != 0
    begun = only_file(folder)
    with part_file(folder, "flexhinf-") as writing:
        cache.cached(("next",), lambda: b"code")
        assert not begun.exists()  # nobody writes it any more
        assert os.path.exists(writing)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_a_pipe_in_place_of_the_file_keeps_nobody_waiting(folder):
    key = cache._key(("piped",)).hex()
    folder.mkdir()
    os.mkfifo(folder / f"{key}.o")
    script = "from flexhinf.codegen import compiler as cache\n"
    script += "assert cache.cached(('piped', ), lambda: b'code') == b'code'"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=300)
    assert cache.cached(("piped",), lambda: pytest.fail("not kept")) == b"code"


BAD_CODE = {
    "no line": b"code",
    "no object": b"{}\n",
    "no functions": b"[1]\ncode",
    "no machine code": b"{}\n" + b"x" * 999,
}


@pytest.mark.parametrize("case", [*BAD_CODE, "cut object"])
def test_a_whole_file_with_code_that_cannot_be_loaded_is_replaced(case, folder, assembled):
    assert works()
    file = only_file(folder)
    good = file.read_bytes()
    code = good[len(cache._MAGIC) + 64 :]
    bad = BAD_CODE.get(case, code[: len(code) // 2])
    head = good[: len(cache._MAGIC) + 32]
    file.write_bytes(head + hashlib.sha256(bad).digest() + bad)
    assert works()
    assert len(assembled) == 2
    assert works()
    assert len(assembled) == 2
    assert file.read_bytes()[: len(head)] == head


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
    monkeypatch.setenv("FLEXHINF_CACHE", "~/x")
    assert cache.folder() == tmp_path / "x"
    monkeypatch.delenv("FLEXHINF_CACHE")
    assert cache.folder() == tmp_path / ".cache" / "flexhinf"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # to be ignored, says its specification
    assert cache.folder() == tmp_path / ".cache" / "flexhinf"


@pytest.mark.skipif(sys.platform != "linux", reason="needs a user without a home")
def test_without_a_home_nothing_is_kept(monkeypatch, tmp_path, assembled):
    for name in ("FLEXHINF_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(
        os.path, "expanduser", lambda path: path
    )  # as for a user id without an entry and no HOME
    monkeypatch.chdir(tmp_path)
    assert works()
    assert works()
    assert len(assembled) == 2
    assert not list(tmp_path.iterdir())


# Levels of optimisation -------------------------------------------------------------------------------------
@pytest.mark.parametrize("stated", ["4", "-1", "fast", "", "2.0", "9" * 1000])
def test_a_level_that_is_none_is_refused_and_its_advice_works(stated, folder, monkeypatch):
    monkeypatch.setenv("FLEXHINF_OPTIMISATION", stated)
    with refused_with(InvalidInput, "unset FLEXHINF_OPTIMISATION", f"got {stated[:40]!r}", 0, 1, 2, 3):
        works()
    monkeypatch.delenv("FLEXHINF_OPTIMISATION")
    assert cache.highest_optimisation() == 3
    assert works()


def test_code_of_another_level_is_not_taken_from_the_cache(folder, monkeypatch):
    """Machine code is made at no higher level than the stated one, and each level has a file of its own."""
    levels, assemble = [], machine.assemble

    def recorded(text, level):
        levels.append(level)
        return assemble(text, level)

    monkeypatch.setattr(machine, "assemble", recorded)
    for stated in ("0", "1", "2", "3", "0", "3"):
        monkeypatch.setenv("FLEXHINF_OPTIMISATION", stated)
        assert works()
    assert levels == [0, 1, 2, 3]
    assert len(list(folder.iterdir())) == 4
