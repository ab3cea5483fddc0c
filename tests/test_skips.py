"""Tests are skipped for what is missing alone: what is there and fails is a failure."""

from __future__ import annotations

from pathlib import Path

import pytest
from benchmarks import peers
from tests.conftest import what_is_missing
from tests.refusals import unnamed


def written(place: Path, text: str) -> str:
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text, encoding="utf-8")
    place.chmod(0o755)
    return str(place)


#: Compilers by what they say, and whether something is missing then.
COMPILERS = {
    "gcc: error: unrecognized command-line option '-mfoo'": True,
    "clang: error: unknown argument: '-mfoo'": True,
    "clang: error: unsupported option '-mfoo' for target": True,
    "/usr/bin/ld: cannot find -lasan: No such file or directory": True,
    "probe.c:1:10: fatal error: bits/libc-header-start.h: No such file or directory": True,
    "internal compiler error: Segmentation fault": False,
    "as: out of memory allocating 4072 bytes": False,
}


@pytest.mark.parametrize(("said", "missing"), COMPILERS.items())
def test_a_compiler_that_fails_is_no_reason_to_skip(said: str, missing: bool, tmp_path: Path) -> None:
    compiler = written(tmp_path / "cc", f'#!/bin/sh\necho "{said}" >&2\nexit 1\n')
    if missing:
        assert unnamed(what_is_missing(compiler, ("-mfoo",)), "missing", "-mfoo", said.split(": ")[-1]) == []
        return
    with pytest.raises(AssertionError, match=said.partition(":")[0]):
        what_is_missing(compiler, ("-mfoo",))


@pytest.mark.parametrize(
    ("ends", "missing"), [("exit 3", False), ("kill -ILL $$", True), ("kill -SEGV $$", False)]
)
def test_a_program_that_fails_is_no_reason_to_skip(ends: str, missing: bool, tmp_path: Path) -> None:
    """As one with a sanitizer that stops; of instructions that a processor lacks it is."""
    built = f"printf '#!/bin/sh\\n{ends}\\n' > probe\nchmod +x probe\n"
    compiler = written(tmp_path / "cc", f"#!/bin/sh\n{built}")
    if missing:
        assert what_is_missing(compiler, ()).startswith("missing")
        return
    with pytest.raises(AssertionError, match="probe"):
        what_is_missing(compiler, ())
    assert what_is_missing("no-such-cc", ()) == "missing: no-such-cc"


def test_a_package_to_compare_with_that_fails_is_not_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    python = tmp_path / "bin" / "python"
    monkeypatch.setattr(peers, "PYTHON", python)
    assert unnamed(peers.missing("jax", "numba"), "jax", "numba", "make peers") == []
    written(python, '#!/bin/sh\ncase "$*" in *find_spec*) echo jax;; esac\n')
    assert unnamed(peers.missing("jax", "numba"), "jax", "numba") == ["numba"]
    written(
        python, '#!/bin/sh\ncase "$*" in *find_spec*) ;; *) echo "libcudart: damaged" >&2; exit 1;; esac\n'
    )
    with pytest.raises(SystemExit, match="libcudart: damaged"):
        peers.missing("jax")
    written(python, "#!/bin/sh\n")
    assert peers.missing("jax") == ""
