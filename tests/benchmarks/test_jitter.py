"""The benchmark of jitter: it counts what it says, and the steps of controller and library allocate nothing."""

from __future__ import annotations

import gc
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.tiers import ci_and_night

import flexhinf as fh


@pytest.fixture
def module(repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    monkeypatch.syspath_prepend(str(repository))
    monkeypatch.setenv("PYTHONPATH", f"{repository / 'src'}:{repository}")
    monkeypatch.chdir(tmp_path)
    import benchmarks.jitter

    yield benchmarks.jitter
    for name in [name for name in sys.modules if name.partition(".")[0] == "benchmarks"]:
        del sys.modules[name]


@pytest.mark.ci("designs two links and compiles their library")
def test_a_step_leaves_nothing_and_collects_nothing(module: Any, tmp_path: Path) -> None:
    """Two links: an earlier memory, kept every 32 samples, has more bytes than a step may have at once."""
    stream = module.Stream("planar-two-link", 2)
    assert 8 * stream.controller.memory.size > 600
    kinds = ["controller"]
    if shutil.which("gcc") or shutil.which("cc"):
        fh.compile_controller(stream.controller, tmp_path / "arm.so")
        kinds.append("library")
    for kind in kinds:
        found = module.counted(stream, stream.stepped(kind, tmp_path / "arm.so"), 300)
        assert found["collections"] == 0, kind
        assert found["blocks_left"] <= 2, kind
        assert found["bytes_at_once"] < 600, kind
        assert found["bytes_grown"] < 200, kind


@pytest.mark.ci("compiles a controller, and counts what a run allocates")
def test_what_allocates_is_counted(module: Any) -> None:
    """The counts are not zero where they must not be: rows that stay, rings of lists that only the collector ends."""
    stream, kept = module.Stream("paper", 2), []

    def step(y: Any, r: Any) -> None:
        ring: list[Any] = []
        ring.append(ring)
        kept.append(np.zeros(10))

    threshold = gc.get_threshold()
    gc.set_threshold(100, 5, 5)
    try:
        found = module.counted(stream, step, 1000)
    finally:
        gc.set_threshold(*threshold)
    assert found["collections"] > 5
    assert found["blocks_left"] > 500
    assert found["bytes_grown"] > 10_000


@pytest.mark.ci("steps in real time")
def test_percentiles_of_a_few_steps(module: Any) -> None:
    stream = module.Stream("paper", 2)
    figures = module.timed(stream, stream.stepped("controller", Path()), 20, None, None)
    assert 0.0 < figures["step_us"]["p50"] <= figures["step_us"]["max"]
    assert 0.0 <= figures["lateness_us"]["p50"] <= figures["lateness_us"]["max"]
    assert gc.isenabled()


@pytest.mark.parametrize(
    "robot", ci_and_night("designs, and compiles a library", ["planar-two-link"], ["seven-link"])
)
@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("gcc"), reason="missing: gcc, or Linux")
def test_a_step_calls_malloc_never(robot: str, module: Any, capsys: pytest.CaptureFixture[str]) -> None:
    module.main(["--robot", robot, "--degree", "2", "--steps", "100", "--counted-steps", "500"])
    rows = json.loads(Path(".benchmarks/jitter.json").read_text())["rows"]
    assert [row["step"] for row in rows] == ["controller", "library"]
    for row in rows:
        assert row["counted"]["malloc_calls"] == 0
        assert row["counted"]["collections"] == 0
    assert "realloc 0" in capsys.readouterr().out
