"""Rows of ``make bench-workspace``: tuned laws, runs that go on after an interruption, and tables."""

from __future__ import annotations

import json
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.workspace import __main__ as program, rows as the_rows
from benchmarks.workspace.arm import Arm
from benchmarks.workspace.laws import FASTEST, LAWS, DifferenceLaw
from benchmarks.workspace.robots import ROBOTS
from benchmarks.workspace.rows import Bench, tuned
from benchmarks.workspace.size import FLAGS, object_bytes
from benchmarks.workspace.tables import MANY, SHORT, TABLES, best_rival, criterion

import flexhinf as fh

PLANAR, SCARA = "planar-two-link", "scara"


# Tuning -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("margins", "fastest", "allowed"),
    [
        ({120.0: [(None, None), (1.2, 2.5)]}, 120.0, [1]),  # one keeps both
        ({120.0: [(1.2, 1.5), (0.5, 1.5)], 15.0: [(1.2, 2.5), (0.1, 1.1)]}, 15.0, [0]),
        (
            {120.0: [(1.2, 1.5), (0.5, 1.5)], 60.0: [(3.0, 1.9), (1.2, 1.5)]},
            120.0,
            [0, 1],
        ),  # no further with 60
        ({120.0: [(None, None), (0.5, 1.5)], 30.0: [(1.2, 1.5), (0.5, 1.1)]}, 30.0, [0, 1]),
        ({}, 120.0, [0, 1]),  # unstable with all
    ],
)
def test_lower_bandwidths_are_tried_where_margins_ask_for_them(
    monkeypatch: pytest.MonkeyPatch, margins: dict[float, Any], fastest: float, allowed: list[int]
) -> None:
    """Of the shares that come as far with the largest bandwidth that is taken, those that arrive decide."""
    shares = (0.5, 1.0)
    monkeypatch.setattr(the_rows, "SHARES", shares)
    monkeypatch.setattr(the_rows, "TUNING", 1)
    entry = ROBOTS[PLANAR]
    arm, made = Arm.of(entry.robot()), list[tuple[float, float]]()

    class Known(DifferenceLaw):
        def __init__(self, arm: Arm, links: bool, share: float, fastest: float) -> None:
            super().__init__(arm, links, share, fastest)
            made.append((share, fastest))

    def known(_arm: Arm, _law: Any, *_: Any) -> dict[str, Any]:
        share, largest = made[-1]
        delay, gain = margins.get(largest, [(None, None)] * 2)[shares.index(share)]
        return {"damped_delay": delay, "gain": gain}

    monkeypatch.setattr(the_rows, "judged_at", known)
    chosen, tried = tuned(entry, arm, type(LAWS["pd"])("known", Known), True)
    assert chosen["fastest"] == fastest
    assert [k for k, one in enumerate(tried) if "arrived" in one] == allowed
    assert shares.index(chosen["share"]) in allowed


def test_bandwidths_fall() -> None:
    assert list(FASTEST) == sorted(set(FASTEST), reverse=True)


# Runs ---------------------------------------------------------------------------------------------
def columns(folder: Path) -> dict[str, dict[str, Any]]:
    """All rows but their CPU times."""
    return {
        file.name: {
            key: value
            for key, value in json.loads(file.read_text(encoding="utf-8")).items()
            if "cpu" not in key
        }
        for file in sorted(folder.glob("*.json"))
    }


def test_a_run_that_goes_on_is_the_run_that_was_not_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(the_rows, "TUNING", 1)
    monkeypatch.setattr(the_rows, "SHARES", (1.5, 2.5))
    monkeypatch.setattr(the_rows, "TUNED_POSES", 2)
    asked = [
        "--robots", PLANAR, "--laws", "pd", "--plants", "mujoco", "--conditions", "nominal", "push", "steps",
        "--goals", "2", "--poses", "3",
    ]  # fmt: skip
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert program.main([*asked, "--rows", str(whole)]) == 0
    real, made = the_rows.written, []

    def once(folder: Path, name: str, row: dict[str, Any]) -> None:
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(name)
        real(folder, name, row)

    monkeypatch.setattr(the_rows, "written", once)
    assert program.main([*asked, "--rows", str(parts)]) == 130
    assert len(columns(parts)) == 2
    monkeypatch.setattr(the_rows, "written", real)
    assert program.main([*asked, "--rows", str(parts)]) == 0
    assert columns(parts) == columns(whole)
    assert len(columns(whole)) == 4
    before = {file: file.stat().st_mtime_ns for file in whole.iterdir()}
    assert program.main([*asked, "--rows", str(whole)]) == 0  # nothing is made again
    assert {file: file.stat().st_mtime_ns for file in whole.iterdir()} == before
    capsys.readouterr()
    row = columns(whole)[f"{PLANAR}.pd.mujoco.nominal.json"]
    for name in ("moves", "others", "loops"):
        text = TABLES[name](whole)
        assert len(text.splitlines()) == 3
    assert f"{row['arrived']} of 2" in TABLES["moves"](whole)


def test_rows_that_several_processes_make_are_those_of_one(
    tmp_path: Path, repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As it is called: what the processes run has to be where they can import it."""
    asked = ["--robots", PLANAR, "--laws", "pd", "flatness", "--plants", "mujoco", "--conditions", "nominal"]
    asked += ["--goals", "1", "--poses", "2", "--rows"]
    for name in ("one", "two"):
        for law, share in (("pd", 2.5), ("flatness", 1.5)):  # tuned already
            record = {"share": share, "fastest": 120.0, "poses": 2}
            the_rows.written(tmp_path / name, f"{PLANAR}.{law}", record)
    assert program.main([*asked, str(tmp_path / "one")]) == 0
    command = [sys.executable, "-m", "benchmarks.workspace", *asked, str(tmp_path / "two"), "--jobs", "2"]
    subprocess.run(command, cwd=repository, check=True, capture_output=True, timeout=300)
    assert columns(tmp_path / "one") == columns(tmp_path / "two")
    assert len(columns(tmp_path / "two")) == 4
    capsys.readouterr()


def test_tables_say_what_is_missing_and_when_joints_are_back(tmp_path: Path) -> None:
    row = {"moves": 3, "lost": 0, "peak": 0.1, "back": 0.25, "remaining_worst": 0.002}
    the_rows.written(tmp_path, f"{PLANAR}.pd.mujoco.push", row)
    the_rows.written(tmp_path, f"{SCARA}.pd.mujoco.push", row | {"back": None})
    planar, scara = TABLES["others"](tmp_path).splitlines()[2:]
    assert "3: 100 mrad, 250 ms, 2 mrad" in planar
    assert "not in 750 ms" in scara
    assert planar.count("not measured") == 4
    shared = {"poses": 2, "stable": 2, "damping": 0.1, "fast": 0.1, "delay": 1, "damped_delay": 1, "gain": 2}
    for law, bytes_ in (("pd", None), ("one-pose", 12345)):
        record = shared | {"design_cpu": 1.0, "object_bytes": bytes_}
        the_rows.written(tmp_path, f"{PLANAR}.{law}", record)
        step = {"step_cpu": 1e-5 if law == "pd" else 2e-5}
        the_rows.written(tmp_path, f"{PLANAR}.{law}.mujoco.nominal", step)
    pd, own = TABLES["loops"](tmp_path).splitlines()[2:]
    assert pd.endswith("| 10 µs (1) | – |")
    assert own.endswith("| 20 µs (2) | 12,345 |")


def test_rows_of_more_goals_have_a_table_of_their_own(tmp_path: Path) -> None:
    row = GOOD | {"moves": 200, "arrived": 199}
    the_rows.written(tmp_path / MANY, f"{PLANAR}.workspace.mujoco.nominal", row)
    the_rows.written(tmp_path, f"{SCARA}.workspace.mujoco.nominal", GOOD)
    (line,) = TABLES["many"](tmp_path).splitlines()[2:]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[:2] == [PLANAR, "199 of 200, 0.2 mrad"]
    assert cells[-2:] == ["0.99 %", "1.5 %"]


GOOD: dict[str, Any] = {
    "moves": 3, "arrived": 3, "lost": 0, "left_out": 0, "remaining_median": 1e-4, "remaining_worst": 2e-4,
    "wrong_way": 0.99, "excursion": 24.9, "path": 1e-3, "ripple": 1.49, "saturation": 0.0, "step_cpu": 1e-5,
}  # fmt: skip
LOOPS: dict[str, Any] = {
    "poses": 2,
    "stable": 2,
    "damping": 0.2,
    "fast": 0.1,
    "delay": 1.0,
    "damped_delay": 2.0,
    "gain": 2.0,
}


def judged(folder: Path, robot: str, law: str, loops: dict[str, Any], nominal: dict[str, Any]) -> Any:
    """Lines of the criterion that a law misses whose other numbers are at their bounds."""
    the_rows.written(folder, f"{robot}.{law}", LOOPS | loops)
    for condition in ("nominal", "payload", "sampled", "steps"):
        row = GOOD | (nominal if condition == "nominal" else {})
        the_rows.written(folder, f"{robot}.{law}.mujoco.{condition}", row)
    return [name for name, (met, _) in (criterion(folder, robot, law) or {}).items() if not met]


@pytest.mark.parametrize(
    ("loops", "nominal", "missed"),
    [
        ({}, {}, 0),
        ({"damping": 0.199}, {}, 1),
        ({"delay": 0.99, "damped_delay": 1.99, "gain": 1.99}, {}, 3),
        ({"stable": 1, "delay": None, "damped_delay": None, "gain": None}, {}, 4),
        ({}, {"arrived": 2, "wrong_way": 1.01, "ripple": 1.51}, 3),
        ({}, {"arrived": 2, "lost": 1, "wrong_way": None, "ripple": None}, 3),
    ],
)
def test_each_line_of_the_criterion_counts(
    tmp_path: Path, loops: dict[str, Any], nominal: dict[str, Any], missed: int
) -> None:
    assert len(judged(tmp_path, SCARA, "pd", loops, nominal)) == missed
    assert len(criterion(tmp_path, SCARA, "pd") or {}) == 11  # two of its bare steps
    assert criterion(tmp_path, PLANAR, "pd") is None


def test_the_best_rival_keeps_most_lines_and_then_arrives_most_often(tmp_path: Path) -> None:
    judged(tmp_path, PLANAR, "pd", {"damping": 0.1}, {})
    judged(tmp_path, PLANAR, "pd-integral", {}, {"arrived": 2})
    judged(tmp_path, PLANAR, "flatness", {"damping": 0.1}, {"remaining_worst": 1e-4})
    judged(tmp_path, PLANAR, "workspace", {}, {})
    assert best_rival(tmp_path, PLANAR) == "flatness"
    assert best_rival(tmp_path, SCARA) is None
    rows = [line for line in TABLES["criterion"](tmp_path).splitlines() if line.startswith(f"| {PLANAR}")]
    assert "8 of 9" in rows[0]
    assert "damping (0.10)" in rows[0]
    assert "9 of 9" in rows[1]


def test_a_rival_that_is_better_is_named_with_both_numbers(tmp_path: Path) -> None:
    for law, loops, nominal in (
        ("workspace", {"gain": 2.5}, {"ripple": 1.0, "remaining_median": None}),
        ("pd", {"gain": 3.0}, {"ripple": 0.4}),
        (
            "torque",
            {"gain": 4.0, "stable": 1},
            {"ripple": 0.3, "remaining_median": 2e-4},
        ),  # unstable at a pose
        ("flatness", {"gain": 2.51}, {"ripple": 0.9, "path": 0.999e-3}),  # written alike: 1 mrad
    ):
        judged(tmp_path, PLANAR, law, loops, nominal)
    lines = TABLES["better"](tmp_path).splitlines()[2:]
    assert [line.split("|")[2].strip() for line in lines] == ["PD", "torque feedback"]
    assert "gain margin (3.00, 2.50)" in lines[0]
    assert "ripple (0.3 %, 1 %)" in lines[1]
    assert set(SHORT) == {law for law, choice in LAWS.items() if choice.tuned}


@pytest.mark.skipif(
    shutil.which("gcc") is None or platform.machine() != "x86_64", reason="needs gcc on x86-64"
)
def test_the_size_of_a_law_is_that_of_its_exported_code(tmp_path: Path) -> None:
    """The sections that a processor needs, as objdump lists them."""
    robot = fh.paper_arm()
    problem = robot.problem()
    law = fh.linear_law(problem, gamma=2.0 * fh.smallest_gamma(problem))
    filter = fh.ExtendedKalmanFilter(robot.plant(), 1e-3, 1e-6, 1e-6, np.zeros(4), 1e-4)
    controller = fh.Controller(law, filter, 1e-3)
    folder = fh.export_c(controller, tmp_path / "c", "law")
    subprocess.run(["gcc", *FLAGS, "-c", "law.c"], cwd=folder, check=True)
    words = ["objdump", "-h", "law.o"]
    listed = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True).stdout
    rows = re.findall(r"^ *\d+ (\S+) +([0-9a-f]{8}).*\n +(.*)$", listed, re.MULTILINE)
    wanted = sum(int(size, 16) for _, size, flags in rows if "ALLOC" in flags and "CONTENTS" in flags)
    assert object_bytes(controller) == wanted > 1000
    assert object_bytes(None) is None


def test_a_row_of_other_goals_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path, goals=2, poses=3)
    kept = {"goals": 1, "moves": 1}
    the_rows.written(tmp_path, f"{PLANAR}.pd.mujoco.nominal", kept)
    assert not bench.has(PLANAR, "pd", "mujoco", "nominal")
    assert Bench(tmp_path, goals=1, poses=3).row(PLANAR, "pd", "mujoco", "nominal") == kept
    assert bench.law(PLANAR, "torque", links=False) is None
