"""Whatever is read takes memory for its bytes, not for the largest file there might be; a full memory is no damage."""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from tests.campaign.conftest import made_campaign, made_loop
from tests.certify.a_cubic import CUBIC

import flexhinf as fh
from flexhinf import files, report
from flexhinf.campaign import Journal, drive
from flexhinf.codegen import compiler as cache
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.files import read_arrays, write_arrays
from flexhinf.validation import file_digest, read_bytes

pytest.importorskip("pyarrow")

REPOSITORY = Path(__file__).resolve().parents[1]

LITTLE_MEMORY = """
import resource, sys, tracemalloc
from pathlib import Path

import flexhinf as fh
from flexhinf.campaign import Journal
from flexhinf.certify import load_certificate
from flexhinf.codegen import compiler as cache
from flexhinf.robot.waypoints import waypoints
from flexhinf.report import unchanged
from flexhinf.validation import read_xml

folder = Path(sys.argv[1])


def everything():
    fh.load_controller(folder / "controller")
    fh.load_solution(folder / "solution")
    journal = Journal.read(folder / "campaign")
    assert len(journal.shards()[0]) == 4 and journal.row(3)["status"] == "completed"
    fh.load_robot("paper")
    read_xml(folder / "robot.urdf")
    waypoints(str(folder / "move.csv"))
    load_certificate(folder / "certificate.json")
    if (folder / "library.so").exists():
        fh.load_compiled(folder / "library.so")
    assert unchanged(folder / "report", ["page.html"])
    assert cache.cached(("key",), lambda: 1 / 0) == b"code"


everything()  # the libraries are not what is measured
tracemalloc.start()
everything()
peak = tracemalloc.get_traced_memory()[1]
tracemalloc.stop()
assert peak < 30e6, peak
pages = int(Path("/proc/self/statm").read_text().split()[0])
limit = pages * resource.getpagesize() + 300_000_000
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
everything()
print("read")
"""


@pytest.mark.ci(
    "solves, runs a campaign and compiles, and reads everything thrice in an interpreter of its own"
)
@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="needs /proc to tell the memory of a process"
)
def test_everything_is_read_with_300_mb_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FLEXHINF_CACHE", str(tmp_path / "kernels"))
    cache.cached(("key",), lambda: b"code")
    controller = made_loop().controller
    controller.save(tmp_path / "controller")
    fh.solve_hji(fh.paper_arm().problem(), 200.0, 3).save(tmp_path / "solution")
    campaign = made_campaign()
    drive(campaign, Journal.opened(tmp_path / "campaign", campaign))
    (tmp_path / "robot.urdf").write_text("<robot><link name='base'/></robot>")
    (tmp_path / "move.csv").write_text("time,shoulder\n0,0\n1,0.5\n")
    CUBIC.save(tmp_path / "certificate.json")
    report.write(tmp_path / "report", {"page.html": "whole"})
    if any(map(shutil.which, ("cc", "gcc", "clang"))):
        fh.compile_controller(controller, tmp_path / "library.so")
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY / "src"), str(REPOSITORY)])}
    words = [sys.executable, "-c", LITTLE_MEMORY, str(tmp_path)]
    done = subprocess.run(words, env=paths, capture_output=True, text=True, check=False)
    assert done.stdout == "read\n", done.stderr


def npy(array: np.ndarray, promised: tuple[int, ...] | None = None) -> bytes:
    """The file of an array in an archive, its head promising another shape."""
    file = io.BytesIO()
    shape = array.shape if promised is None else promised
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return file.getvalue() + array.tobytes()


def test_an_archive_that_promises_more_than_it_has_is_damaged(tmp_path: Path) -> None:
    """A head of a hundred bytes may promise a terabyte."""
    for promised in ((10**12,), (10**7, 10**7), (10**30,), (-1,)):
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("a.npy", npy(np.arange(3.0), promised))
        (tmp_path / "a").write_bytes(file.getvalue())
        tracemalloc.start()
        with pytest.raises(InvalidInput) as error:
            read_arrays(tmp_path / "a")
        assert tracemalloc.get_traced_memory()[1] < 1e6
        tracemalloc.stop()
        assert "damaged" in error.value.found


def test_arrays_come_back_with_their_kinds_and_orders_and_can_be_written(tmp_path: Path) -> None:
    given = {
        "plain": np.arange(6.0).reshape(2, 3), "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "none": np.zeros((0, 3)), "one": np.array("text γ"), "integers": np.array([1, -2]),
    }  # fmt: skip
    write_arrays(tmp_path / "a", "test", given)
    found, whole = read_arrays(tmp_path / "a")
    assert whole
    assert list(found) == list(given)
    for name, array in given.items():
        assert found[name].dtype == array.dtype
        assert found[name].flags.f_contiguous == array.flags.f_contiguous
        np.testing.assert_array_equal(found[name], array)
        assert found[name].flags.writeable


@pytest.mark.parametrize("load", [fh.load_controller, fh.load_solution], ids=["controller", "solution"])
def test_a_full_memory_is_not_called_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, load) -> None:
    made_loop().controller.save(tmp_path / "file")

    def full(content: bytes) -> np.ndarray:
        raise MemoryError

    monkeypatch.setattr(files, "array_of", full)
    with pytest.raises(MemoryError) as error:
        load(tmp_path / "file")
    assert not isinstance(error.value, FlexhinfError)


def test_bytes_are_read_up_to_a_number_and_digests_of_all(tmp_path: Path) -> None:
    content = bytes(range(256)) * 1000
    (tmp_path / "a").write_bytes(content)
    tracemalloc.start()
    for most in (0, 1, 65_536, 255_999, 256_000, 256_001, 16 << 30, -1):
        assert read_bytes(tmp_path / "a", most) == (content if most < 0 else content[:most])
    assert file_digest(tmp_path / "a") == hashlib.sha256(content).hexdigest()
    assert tracemalloc.get_traced_memory()[1] < 2e6
    tracemalloc.stop()
    (tmp_path / "b").touch()
    assert read_bytes(tmp_path / "b", -1) == b""
    for reader in (lambda path: read_bytes(path, 3), file_digest):
        with pytest.raises(OSError, match="not a file"):
            reader(Path("/dev/null"))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs files that the kernel makes up")
def test_a_file_that_says_it_is_empty_is_read(tmp_path: Path) -> None:
    assert read_bytes(Path("/proc/self/status"), -1).startswith(b"Name:")
    assert len(read_bytes(Path("/proc/self/status"), 7)) == 7
