"""Every command that uses several threads writes the same numbers with one and with two of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.builders import arm_controller, report_numbers
from tests.cli.conftest import DESIGN
from tests.logs import arm_log, write_log

import flexhinf as fh
from flexhinf import report
from flexhinf.cli import main

pytest.importorskip("pyarrow")

pytestmark = pytest.mark.usefixtures("unoptimised")

#: A design whose region is proved in thousands of cells.
CERTIFIED = """
[design]
robot = "paper"
pose = [3.141592653589793]
penalty = [75, 27, 90, 27, 330]
effort = 10
checked_penalty = [60, 0, 0, 0, 300]
gamma_ratio = 1.5
checked_gamma_ratio = 1.6
degrees = [2]
"""


def certified(folder: Path) -> None:
    (folder / "design.toml").write_text(CERTIFIED, encoding="utf-8")


def judged_designs(folder: Path) -> None:
    for name, q in (("a", 1e-8), ("b", 1e-6)):
        arm_controller(kind=fh.ExtendedKalmanFilter, q=q, r=1e-8, p0=1e-6, start="bumpless").save(
            folder / "law"
        )
        files = {"design.toml": DESIGN, "design.json": report_numbers()}
        report.write(folder / name, {**files, "controller": (folder / "law").read_bytes()})


def log(folder: Path) -> None:
    arm, names = fh.load_robot("paper"), ("motor_voltage", "link_position", "motor_position")
    write_log(folder / "log.csv", names, *arm_log(arm, count=600))
    arm.with_values({"stiffness": 70.0, "friction": 0.2}).save(folder / "wrong.toml")


def nothing(folder: Path) -> None:
    """The command needs no file."""


RUNS = ["--samples", "40", "--batch", "16"]
COMMANDS: dict[str, tuple[Callable[[Path], None], list[str]]] = {
    "campaign": (
        judged_designs,
        ["campaign", "a/design.toml", *RUNS, "--worst-case", "--metric", "peak_speed", "--starts", "2"],
    ),
    "campaign compare": (judged_designs, ["campaign", "compare", "a/design.toml", "b/design.toml", *RUNS]),
    "compare": (
        nothing,
        ["compare", "vertical-rig", "--pose", "0.8", "--start", "0.3", "--degrees", "2", "--estimator", "ekf",
         "--draws", "2", "--duration", "4", "--laws", "pd"],
    ),
    "certify": (certified, ["certify", "design.toml", "--degree", "2"]),
    "identify": (
        log,
        ["identify", "log.csv", "--robot", "wrong.toml", "--measured", "link_position,motor_position",
         "--parameters", "stiffness,friction,mass"],
    ),
    "paper": (nothing, ["paper", "--estimator", "none", "--period", "0.02"]),
}  # fmt: skip


@pytest.mark.ci("runs a command twice")
@pytest.mark.parametrize("command", COMMANDS)
def test_any_number_of_threads_writes_the_same_numbers(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepare, words = COMMANDS[command]
    found: list[dict[str, bytes]] = []
    for threads in ("1", "2"):
        folder = tmp_path / threads
        folder.mkdir()
        monkeypatch.chdir(folder)
        prepare(folder)
        assert main([*words, "--out", "out", "--threads", threads]) in (0, 1)
        files = {path.relative_to(folder): path for path in (folder / "out").rglob("*") if path.is_file()}
        found.append({str(name): untimed(folder, path) for name, path in files.items()})
    assert found[0].keys() == found[1].keys()
    assert not [name for name in found[0] if found[0][name] != found[1][name]]


def untimed(folder: Path, path: Path) -> bytes:
    """What a file says, without the folder, the times that it took, and digests of files with such times."""
    if path.name == "flexhinf-report.json":
        return b""
    text = path.read_bytes().replace(str(folder).encode(), b"FOLDER")
    return re.sub(rb'(data-label="CPU"[^>]*>)[^<]*| +[0-9.]+ ms\n', rb"\1", text)
