"""Rows of ``make bench-workspace``: tuned laws, runs that go on after an interruption, and tables."""

from __future__ import annotations

import json
import platform
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.workspace import __main__ as program, rows as the_rows
from benchmarks.workspace.arm import Arm, damped
from benchmarks.workspace.goals import goals, moves, poses
from benchmarks.workspace.laws import FASTEST, LAWS, TUNING_SEED, Choice, DifferenceLaw, Overcoming
from benchmarks.workspace.linear import judged
from benchmarks.workspace.plants import PLANTS
from benchmarks.workspace.robots import ROBOTS, true_arms
from benchmarks.workspace.rows import Bench, tuned
from benchmarks.workspace.size import FLAGS, object_bytes
from benchmarks.workspace.tables import MANY, SHORT, TABLES, best_rival, criterion
from benchmarks.workspace.trip import Condition, trip

import flexhinf as fh
from flexhinf.export.controller_c import code_of

PLANAR, SCARA = "planar-two-link", "scara"


# Tuning -------------------------------------------------------------------------------------------
ALL = {"damping": 0.2, "delay": 1.0, "damped_delay": 2.0, "gain": 2.0}
FINE = {"moves": 2, "arrived": 2, "remaining_worst": 5e-4, "ripple": 1.5}


@pytest.mark.parametrize(
    ("stages", "chosen", "looked_at", "driven"),
    [
        # One keeps all lines: lower bandwidths are not tried. Of those that do, the smaller error decides.
        ([[({}, {}), ({}, {"remaining_worst": 4e-4})], [({}, {})]], 1, 2, [0, 1]),
        # All ripple too much: the lower ones are tried
        ([[({}, {"ripple": 1.51}), ({}, {"ripple": 9.0})], [({}, {})]], 2, 3, [0, 1, 2]),
        # None keeps all: the most lines, of any stage; each line counts as much
        ([[({"damping": 0.19}, {})], [({"damping": 0.19, "gain": 1.9}, {})], [({}, {"arrived": 1})]], 0, 3, [0, 2]),
        ([[({}, {"ripple": None, "arrived": 0})], [({"delay": 0.9}, {})]], 1, 2, [0, 1]),
        # As many lines: the one that arrives most often, then the nearest
        ([[({"delay": 0.9}, {"arrived": 1}), ({"delay": 0.9, "gain": 1.9}, {})]], 1, 2, [0, 1]),
        ([[({}, {"arrived": 0, "remaining_worst": None}), ({}, {"arrived": 1})]], 1, 2, [0, 1]),
        # What cannot keep as many lines is not driven, nor what is unstable
        ([[({"damping": 0.1, "gain": 1.9, "delay": 0.9}, {}), ({}, {})]], 1, 2, [1]),
        ([[({"stable": 1}, {}), ({"damping": 0.0, "gain": 1.0, "delay": 0.0, "damped_delay": 0.0}, {})]], 1, 2, [1]),
        # Unstable all: at the fewest poses
        ([[({"stable": 0}, {}), ({"stable": 1}, {})], [({"stable": 1}, {})]], 1, 3, []),
    ],
)  # fmt: skip
def test_a_rival_gets_the_candidate_that_keeps_most_lines(
    monkeypatch: pytest.MonkeyPatch, stages: Any, chosen: int, looked_at: int, driven: list[int]
) -> None:
    """Candidates whose linear loops and moves are written down."""
    monkeypatch.setattr(the_rows, "TUNED_POSES", 2)
    monkeypatch.setattr(the_rows, "TUNING", 2)
    known = [one for stage in stages for one in stage]
    names = iter(range(len(known)))
    candidates = tuple([{"name": next(names)} for _ in stage] for stage in stages)
    choice = Choice("known", lambda arm, links, name: name, candidates)
    monkeypatch.setattr(
        the_rows, "judged_at", lambda arm, law, *_: {"poses": 2, "stable": 2} | ALL | known[law][0]
    )
    monkeypatch.setattr(the_rows, "trip", lambda plant, fed, *_: SimpleNamespace(moves=fed.law))
    monkeypatch.setattr(the_rows, "summary", lambda law: FINE | known[law][1])
    entry = ROBOTS[PLANAR]
    numbers, tried = tuned(entry, Arm.of(entry.robot()), choice, True)
    assert numbers == {"name": chosen}
    assert len(tried) == looked_at
    assert sorted(one["numbers"]["name"] for one in tried if "arrived" in one) == driven


@pytest.mark.ci("drives every candidate of a tuning")
def test_the_rule_on_a_small_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each candidate's six lines by hand: loops at the same poses, and the same moves."""
    monkeypatch.setattr(the_rows, "TUNED_POSES", 3)
    monkeypatch.setattr(the_rows, "TUNING", 3)  # the first may be enough
    monkeypatch.setattr(the_rows, "FIRST", 1)
    entry, arm = ROBOTS[PLANAR], Arm.of(ROBOTS[PLANAR].robot())
    shares, fastest = (0.1, 0.7, 1.5, 4.0), 1e3  # unstable, without integral too soft, and two that arrive
    candidates = [{"share": share, "fastest": fastest} for share in shares]
    numbers, tried = tuned(entry, arm, Choice("PD", DifferenceLaw, (candidates,)), True)
    way = moves(arm, goals(arm, true_arms(entry, "payload")[0], 3, TUNING_SEED)[0])
    found = []
    for share in shares:
        law = DifferenceLaw(arm, True, share, fastest)
        loops = [judged(arm, q, law.linear(q), True) for q in poses(arm, 3, TUNING_SEED)]
        fed = Overcoming(law, arm)
        run = trip(PLANTS["mujoco"], fed, [damped(arm)], way, Condition("by hand")).moves
        held = all(loop.stable for loop in loops)
        least = [min(getattr(loop, name) for loop in loops) for name in ALL]
        lines = [held and value >= bound for value, bound in zip(least, ALL.values())]
        lines += [all(one.arrives for one in run), max(one.ripple for one in run) <= 1.5] if held else []
        far = max(one.remaining for one in run)
        found.append((sum(lines), sum(one.arrives for one in run) if held else 0, -far, share))
    assert numbers["share"] == max(found)[-1]
    driven = {one["numbers"]["share"]: one["lines"] for one in tried if one.get("moves") == 3}
    assert driven == {one[-1]: one[0] for one in found if one[-1] in driven}
    assert all(one < max(found) for one in found if one[-1] not in driven)
    assert len(driven) == 2


def test_shares_with_the_same_bandwidths_are_one_candidate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Own vibrations are at 18 and 43 rad/s: with at most 30, and 15, these shares differ no more."""
    monkeypatch.setattr(the_rows, "judged_at", lambda *_: {"poses": 2, "stable": 0} | ALL)
    entry = ROBOTS[PLANAR]
    shares = [{"share": share, "fastest": fastest} for fastest in (120.0, 15.0) for share in (0.1, 2.5, 4.0)]
    _, tried = tuned(
        entry, Arm.of(entry.robot()), Choice("PD", DifferenceLaw, (shares[:3], shares[3:])), True
    )
    assert [one["numbers"] for one in tried] == [*shares[:3], shares[4]]


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


@pytest.mark.ci("makes rows three times")
def test_a_run_that_goes_on_is_the_run_that_was_not_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(the_rows, "TUNING", 1)
    shares = [{"share": share, "fastest": 120.0} for share in (1.5, 2.5)]
    monkeypatch.setitem(LAWS, "pd", replace(LAWS["pd"], candidates=(shares,)))
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


@pytest.mark.ci("makes rows in several processes")
def test_rows_that_several_processes_make_are_those_of_one(
    tmp_path: Path, repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As it is called: what the processes run has to be where they can import it."""
    asked = ["--robots", PLANAR, "--laws", "pd", "flatness", "--plants", "mujoco", "--conditions", "nominal"]
    asked += ["--goals", "1", "--poses", "2", "--rows"]
    for name in ("one", "two"):
        for law, share in (("pd", 2.5), ("flatness", 1.5)):  # tuned already
            record = {"numbers": {"share": share, "fastest": 120.0}, "poses": 2}
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
    assert cells[-4:] == ["0.99 %", "not measured", "not measured", "1.5 %"]


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


def missed_lines(folder: Path, robot: str, law: str, loops: dict[str, Any], nominal: dict[str, Any]) -> Any:
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
    assert len(missed_lines(tmp_path, PLANAR, "pd", loops, nominal)) == missed
    assert len(criterion(tmp_path, PLANAR, "pd") or {}) == 11  # two of its bare steps
    assert criterion(tmp_path, SCARA, "pd") is None


def test_bare_steps_count_on_arms_of_several_joints(tmp_path: Path) -> None:
    for robot, count in ((PLANAR, 11), (SCARA, 11), ("paper", 9)):
        missed_lines(tmp_path, robot, "pd", {}, {})
        before = criterion(tmp_path, robot, "pd") or {}
        bad = GOOD | {"wrong_way": 5.01, "excursion": 25.1}
        the_rows.written(tmp_path, f"{robot}.pd.mujoco.steps", bad)
        after = criterion(tmp_path, robot, "pd") or {}
        assert len(after) == count
        assert sum(met for met, _ in before.values()) == count
        assert sum(met for met, _ in after.values()) == 9


def test_the_table_shows_what_each_rival_was_tuned_to(tmp_path: Path) -> None:
    pairs = "filter 0.06 %, 1 %"
    share, torques = {"share": 4.0, "fastest": 60.0}, [0.0006, 0.01]
    shown = {
        "pd": (share, "4 (60 rad/s)"),
        "torque": (share | {"lighter": 1.0, "turning": 0.42}, "4 (60 rad/s); its rate"),
        "flatness": (
            share | {"left": True, "torques": torques},
            f"4 (60 rad/s); three poles and the vibration; {pairs}",
        ),
        "lqg": (
            {"w": 40.0, "velocity": 5.0, "torques": torques},
            f"40 rad/s, velocities 5; {pairs}",
        ),
    }
    for law, (numbers, _) in shown.items():
        the_rows.written(tmp_path, f"{PLANAR}.{law}", LOOPS | {"numbers": numbers, "design_cpu": 1.0})
    lines = [line.split("|")[3].strip() for line in TABLES["loops"](tmp_path).splitlines()[2:]]
    assert lines == [text for _, text in shown.values()]


def test_the_best_rival_keeps_most_lines_and_then_arrives_most_often(tmp_path: Path) -> None:
    missed_lines(tmp_path, PLANAR, "pd", {"damping": 0.1}, {})
    missed_lines(tmp_path, PLANAR, "pd-integral", {}, {"arrived": 2})
    missed_lines(tmp_path, PLANAR, "flatness", {"damping": 0.1}, {"remaining_worst": 1e-4})
    missed_lines(tmp_path, PLANAR, "workspace", {}, {})
    assert best_rival(tmp_path, PLANAR) == "flatness"
    assert best_rival(tmp_path, SCARA) is None
    rows = [line for line in TABLES["criterion"](tmp_path).splitlines() if line.startswith(f"| {PLANAR}")]
    assert "10 of 11" in rows[0]
    assert "damping (0.10)" in rows[0]
    assert "11 of 11" in rows[1]


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
        missed_lines(tmp_path, PLANAR, law, loops, nominal)
    lines = TABLES["better"](tmp_path).splitlines()[2:]
    assert [line.split("|")[2].strip() for line in lines] == ["PD", "torque feedback"]
    assert "gain margin (3.00, 2.50)" in lines[0]
    assert "ripple (0.3 %, 1 %)" in lines[1]
    assert set(SHORT) == {law for law, choice in LAWS.items() if choice.tuned}


@pytest.mark.ci("compiles the code of a controller twice")
@pytest.mark.skipif(
    shutil.which("gcc") is None or platform.machine() != "x86_64", reason="missing: gcc, on x86-64"
)
def test_the_size_of_a_law_is_that_of_its_exported_code(tmp_path: Path) -> None:
    """The sections that a processor needs, as objdump lists them."""
    robot = fh.paper_arm()
    problem = robot.problem()
    law = fh.linear_law(problem, gamma=2.0 * fh.smallest_gamma(problem))
    filter = fh.ExtendedKalmanFilter(robot.plant(), 1e-3, 1e-6, 1e-6, np.zeros(4), 1e-4)
    controller = fh.Controller(law, filter, 1e-3)
    for file, text in code_of(controller, "law", "double").files.items():
        (tmp_path / file).write_text(text)
    subprocess.run(["gcc", *FLAGS, "-c", "law.c"], cwd=tmp_path, check=True)
    words = ["objdump", "-h", "law.o"]
    listed = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    rows = re.findall(r"^ *\d+ (\S+) +([0-9a-f]{8}).*\n +(.*)$", listed, re.MULTILINE)
    wanted = sum(int(size, 16) for _, size, flags in rows if "ALLOC" in flags and "CONTENTS" in flags)
    assert object_bytes(controller) == wanted > 1000
    assert object_bytes(None) is None


def test_a_row_of_other_goals_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path, goals=2, poses=3)
    kept = {"goals": 1, "moves": 1}
    the_rows.written(tmp_path, f"{PLANAR}.pd.mujoco.nominal", kept)
    assert not Bench(tmp_path, goals=1, poses=3).has(PLANAR, "pd", "mujoco", "nominal")  # without feedforward
    kept["fed_forward"] = True
    the_rows.written(tmp_path, f"{PLANAR}.pd.mujoco.nominal", kept)
    assert not bench.has(PLANAR, "pd", "mujoco", "nominal")
    assert Bench(tmp_path, goals=1, poses=3).row(PLANAR, "pd", "mujoco", "nominal") == kept
    assert bench.law(PLANAR, "torque", links=False) is None
