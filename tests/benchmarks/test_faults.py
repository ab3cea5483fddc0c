"""``make faults``: what its faults do to signals, the rule that judges a run, and the quick matrix of four arms."""

from __future__ import annotations

import csv
import json
import re
import secrets
import shutil
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.faults import __main__ as command, arms as the_arms
from benchmarks.faults.arms import ARMS, Program, program_of
from benchmarks.faults.kinds import FAULTS, HARMLESS, TRIPS, Facts, drawn, fitting
from benchmarks.faults.runs import ALL, Campaign, Planned, one, smallest_of
from benchmarks.faults.tables import KEPT, TABLES, failures, kept, summary, trips
from benchmarks.faults.verdict import VERDICTS, judged
from tests import store


class Programs(dict[str, Program]):
    """Programs by the name of their arm, made when they are asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __missing__(self, name: str) -> Program:
        self[name] = program_of(ARMS[name], self.folder)
        return self[name]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where programs are made, once in a run of tests."""
    shared = store.folder()
    return tmp_path_factory.mktemp("faults") if shared is None else shared / "faults"


@pytest.fixture(scope="module")
def programs(compiler: str, folder: Path) -> Mapping[str, Program]:
    return Programs(folder)


@pytest.fixture(scope="module")
def compiler() -> str:
    if shutil.which("gcc") is None:
        pytest.skip("missing: gcc")
    return "gcc"


def traced(
    program: Program, fault: str, seed: int, place: Path, **more: Any
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A run that nothing stops, and its samples by column."""
    row = one(program, Planned(program.arm.name, fault, seed), place, **{"never": 1, **more})
    with place.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return row, {name: np.array([float(each[name]) for each in rows]) for name in rows[0]}


# What faults do -------------------------------------------------------------------------------------
#: Of readings y, what they would be x, both from the fault on, the time since then, the size and the period: whether
#: the readings are as the fault says, but for noise of 0.1 mrad.
Readings = Callable[[np.ndarray, np.ndarray, np.ndarray, float], bool]


def near(a: np.ndarray, b: np.ndarray | float) -> bool:
    """Within six standard deviations of the noise."""
    return bool(np.abs(a - b).max() < 6e-4)


SENSED: Mapping[str, Readings] = {
    "jump": lambda y, x, t, m: near(y, x + m),
    "mirrored": lambda y, x, t, m: near(y, -x),
    "backward": lambda y, x, t, m: near(0.5 * (y + x), x[0]),  # where it turns has noise too
    "stuck": lambda y, x, t, m: bool(np.ptp(y) == 0.0) and near(y[:1], x[:1]),
    "zero": lambda y, x, t, m: not y.any(),
    "scaled up": lambda y, x, t, m: near(y / m, x),
    "scaled down": lambda y, x, t, m: near(y, m * x),
    "loses counts": lambda y, x, t, m: near(y, x[0] + m * (x - x[0])),
    "drifts": lambda y, x, t, m: near(y, x + m * t),
    "late": lambda y, x, t, m: near(y[round(m) :], x[: -round(m)]),
    "silent": lambda y, x, t, m: bool(np.isnan(y).all()),
    "dropouts": lambda y, x, t, m: abs(np.isnan(y).mean() - m) < 0.05 and near(y[~np.isnan(y)], x[~np.isnan(y)]),
    "noise": lambda y, x, t, m: np.std(y - x) == pytest.approx(m, rel=0.1),
    "glitches": lambda y, x, t, m: 0.01 < np.mean(np.abs(y - x) > 0.5 * abs(m)) < 0.03,
    "coarse": lambda y, x, t, m: near(y / m, np.round(y / m)) and bool(np.abs(y - x).max() < 0.51 * m + 6e-4),
}  # fmt: skip


@pytest.mark.ci("exports a controller and compiles it")
@pytest.mark.parametrize("kind", SENSED)
def test_readings_are_what_a_fault_makes_of_them(
    kind: str, programs: Mapping[str, Program], tmp_path: Path
) -> None:
    """Of the sensors that are meant from the fault on, of no other, and not before."""
    program = programs["two"]
    for side, sensors in (("link", [0]), ("motor", [1]), ("both", [0, 1])):
        row, seen = traced(program, f"{kind}, {side}", 5, tmp_path / "run.csv")
        n, on = 2, seen["fault"] > 0.5
        for group in range(2):
            for joint in range(n):
                y, x = seen[f"y_{n * group + joint}"], seen[f"{('q', 'theta')[group]}_{joint}"]
                assert near(y[~on], x[~on])
                if group in sensors and joint == row["joint"]:
                    assert SENSED[kind](y[on], x[on], seen["t"][on] - row["at"], row["magnitude"]), side
                else:
                    assert near(y[on], x[on])


@pytest.mark.ci("exports a controller and compiles it")
def test_frames_repeat_are_swapped_or_are_missing(programs: Mapping[str, Program], tmp_path: Path) -> None:
    """All readings at once."""
    program, place = programs["two"], tmp_path / "run.csv"
    row, seen = traced(program, "frozen", 4, place)
    on = (seen["t"] >= row["at"]) & (seen["t"] < row["at"] + row["x"] - 1.5e-3)
    assert all(np.ptp(seen[f"y_{i}"][on]) == 0.0 for i in range(4))
    assert all(np.array_equal(seen[f"old_{i}"] > 0.5, seen["old_0"] > 0.5) for i in range(4))
    assert seen["old_0"].sum() == pytest.approx(row["x"] * 1e3, abs=1.0)
    row, seen = traced(program, "swapped, both", 4, place)
    on = seen["fault"] > 0.5
    for k, name in enumerate(("q_1", "q_0", "theta_1", "theta_0")):
        assert near(seen[f"y_{k}"][on], seen[name][on])
    row, seen = traced(program, "unmeasured for ever", 4, place)
    assert np.array_equal(seen["measured"] < 0.5, seen["fault"] > 0.5)
    row, seen = traced(program, "wrapped, motor", 4, place)
    moved = seen[f"y_{2 + row['joint']}"] - seen[f"theta_{row['joint']}"]
    assert near(
        np.abs(moved[seen["fault"] > 0.5]), 2.0 * np.pi / 100.0
    )  # a turn of the encoder before the gear


@pytest.mark.ci("exports a controller and compiles it")
def test_drives_and_the_clock_do_what_a_fault_says(programs: Mapping[str, Program], tmp_path: Path) -> None:
    """What acts is what the controller gave a sample before, but for the fault."""
    program, place = programs["two"], tmp_path / "run.csv"

    def inputs(seen: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        given, acts = (np.array([seen[f"{name}_{j}"] for j in range(2)]) for name in ("u", "applied"))
        return given[:, :-1], acts[:, 1:], seen["fault"][1:] > 0.5

    row, seen = traced(program, "swapped drives", 2, place)
    given, acts, on = inputs(seen)
    assert np.array_equal(acts[:, on], given[::-1, on])
    assert np.array_equal(acts[:, ~on], given[:, ~on])
    row, seen = traced(program, "held drives", 2, place)
    given, acts, on = inputs(seen)
    assert np.all(np.ptp(acts[:, on], axis=1) == 0.0)
    row, seen = traced(program, "late drives", 2, place)
    given, acts, on = inputs(seen)
    late, first = round(row["magnitude"]), int(np.argmax(on))
    assert np.array_equal(acts[:, first + late : 2000], given[:, first : 2000 - late])
    row, seen = traced(program, "slow clock", 2, place)
    steps, on = np.diff(seen["t"]), seen["fault"][:-1] > 0.5
    assert steps[on] == pytest.approx(1e-3 * row["magnitude"], rel=1e-3)
    assert steps[~on] == pytest.approx(1e-3, rel=1e-2)
    row, seen = traced(program, "dead drives", 2, place)
    assert abs(seen["q_0"][-1]) < 0.6  # it fell, and hangs


@pytest.mark.ci("exports a controller and compiles it")
def test_a_rule_that_cuts_the_power_at_once_is_an_ideal_stop(programs: Mapping[str, Program]) -> None:
    """Its twin goes as far, whatever moves; and finer steps of the integrator change little."""
    for seed in range(8):
        planned = Planned("two", "unmeasured for ever", seed)
        row = one(programs["two"], planned)
        assert row["noticed"] == 1
        assert row["when"] < 0.013
        assert row["furthest"] == pytest.approx(row["ideal"], rel=1e-3, abs=1e-5)
        fine = one(programs["two"], planned, refined=4)
        assert fine["furthest"] == pytest.approx(row["furthest"], rel=0.02, abs=1e-3)


#: A rule that knows when a fault has come: it notices, and leaves the power on for some seconds.
KNOWING = """
static int may_start(bench *b) { (void)b; return 1; }
static void decide_before(bench *b) { (void)b; }
static decision decide(bench *b, int code)
{
    static double since;
    (void)code;
    if (!b->on) { since = b->t; }
    return (decision){b->t - since < LEAVES, b->on ? 9u : 0u, CATEGORY};
}
"""


@pytest.mark.ci("exports a controller and compiles it")
@pytest.mark.parametrize(
    ("leaves", "category", "verdicts"), [(9.0, 2, {"far", "moving"}), (0.0015, 1, {"kept"})]
)
def test_a_rule_is_judged_by_what_the_arm_does(
    leaves: float,
    category: int,
    verdicts: set[str],
    tmp_path: Path,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One that notices at once that all readings are frozen and goes on with them; and one that cuts the power soon."""
    for name in (*the_arms.PARTS, "plant.h", "bench.h"):
        shutil.copy(the_arms.HERE / name, tmp_path)
    rule = KNOWING.replace("LEAVES", repr(leaves)).replace("CATEGORY", str(category))
    (tmp_path / "decide.h").write_text(f'#include "bench.h"\n{rule}', encoding="utf-8")
    monkeypatch.setattr(the_arms, "HERE", tmp_path)
    program = program_of(ARMS["two"], folder)
    rows = [one(program, Planned("two", "frozen for ever", seed)) for seed in range(6)]
    for row in rows:
        assert (row["noticed"], row["stop"], row["category"]) == (1, 9, category)
        assert row["when"] < 2e-3
        assert row["power"] == int(leaves > 1.0)
    assert {judged(row) for row in rows if row["speed"] > 0.2} <= verdicts


# Judgement ------------------------------------------------------------------------------------------
#: A run that is kept, and what makes it another verdict.
GOOD = {
    "noticed": 1, "early": 0, "when": 0.02, "wrong": 0.02, "wrong_at_notice": 0.02, "furthest": 0.1, "ideal": 0.1,
    "step": 2e-3, "power": 0, "moving": 0.0, "speed": 1.0, "end": 0.3, "hidden": "", "slow": "",
}  # fmt: skip
SILENT = {**GOOD, "noticed": 0, "end": 0.01}


@pytest.mark.parametrize(
    ("verdict", "row"),
    [
        ("kept", GOOD),
        ("kept", {**GOOD, "when": 2.0}),  # slow, before 0.1 rad
        ("kept", {**GOOD, "wrong_at_notice": 0.5}),  # far, within 50 ms
        ("kept", {**GOOD, "furthest": 0.1129}),  # a tenth, a sample and 1 mrad
        ("far", {**GOOD, "furthest": 0.1131}),
        ("moving", {**GOOD, "power": 1, "moving": 0.06}),
        ("kept", {**GOOD, "power": 1, "moving": 0.04}),
        ("early", {**GOOD, "early": 1}),
        ("harmless", SILENT),
        ("stands", {**SILENT, "end": 0.2}),
        ("late", {**GOOD, "when": 0.06, "wrong_at_notice": 0.11, "hidden": "", "slow": ""}),
        ("slow", {**GOOD, "when": 0.06, "wrong_at_notice": 0.11, "slow": "an arm that stands"}),
        ("hidden", {**GOOD, "when": 0.06, "wrong_at_notice": 0.11, "hidden": "nothing measures the links"}),
        ("borne", {**SILENT, "wrong": 0.06}),
        ("trembles", {**SILENT, "wrong": 0.06, "moving": 0.06}),
        ("unnoticed", {**SILENT, "moving": 0.31}),
        ("unnoticed", {**SILENT, "wrong": 0.11}),
        ("hidden", {**SILENT, "wrong": 0.11, "hidden": "nothing measures the links"}),
        ("away", {**SILENT, "wrong": 0.31}),
        ("away", {**SILENT, "wrong": 0.11, "speed": 1.6}),
    ],
)
def test_the_rule_says_what_a_run_is(verdict: str, row: Mapping[str, Any]) -> None:
    """Each verdict, on both sides of its limit."""
    assert judged(row) == verdict
    assert verdict in VERDICTS


def test_there_are_sixty_kinds_and_sides_for_each_kind_of_arm() -> None:
    """Names are told apart, sizes lie within what is stated, and a seed repeats a run."""
    voltage = Facts(2, True, True, "voltage", (0.0, 1.0), 1e-3, True)
    alone = Facts(6, False, True, "torque", (0.5, 1.0), 1e-3, True)
    assert len(fitting(voltage)) > 90
    assert len(fitting(alone)) >= 58
    assert set(FAULTS) & set(HARMLESS) == set()
    for facts in (voltage, alone):
        for fault in fitting(facts):
            smallest = {fault.name: 0.5 * (fault.low + fault.high)} if fault.sized else {}
            sizes = [drawn(fault, facts, smallest, seed)["x"] for seed in range(20)]
            assert all(smallest.get(fault.name, fault.low) <= x <= fault.high for x in sizes), fault.name
            assert drawn(fault, facts, {}, 7) == drawn(fault, facts, {}, 7)
            joints = {drawn(fault, facts, {}, seed)["joint"] for seed in range(40)}
            assert joints == ({-1} if fault.side == "all" else set(range(facts.joints)))
            others = [drawn(fault, facts, {}, seed) for seed in range(40)]
            assert all(other["other"] != other["joint"] for other in others)


# The matrix -----------------------------------------------------------------------------------------
@pytest.mark.ci("exports four controllers and runs them 400 times")
def test_the_quick_matrix(
    programs: Mapping[str, Program], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Silence is noticed, moves and most harmless events stop nothing, and rows are kept, repeated and gone on with."""
    campaign = Campaign({name: programs[name] for name in ARMS}, 74, 1, 50, tmp_path)
    campaign.make()
    rows = campaign.rows()
    assert len(rows) == len(campaign.planned()) > 350
    counts = Counter(judged(row) for row in rows if row["fault"] in FAULTS)
    assert counts["kept"] > 250
    assert counts["harmless"] > 20  # sizes are log-uniform from the smallest on
    braked = {name for name, program in programs.items() if program.facts.brakes}
    bad = [row for row in failures(rows) if judged(row) != "far" or row["arm"] in braked]  # others fall
    assert not [(row["arm"], row["fault"], row["seed"], judged(row)) for row in bad]
    assert {row["fault"] for row in trips(rows)} <= {*TRIPS}
    made = list[int]()
    (first, *_) = tmp_path.iterdir()
    lines = first.read_text(encoding="utf-8").splitlines()
    first.write_text("".join(f"{line}\n" for line in lines[:-5]), encoding="utf-8")
    campaign.make(made.append)
    assert sum(made) == len(rows)
    assert made[0] == len(rows) - 5
    assert campaign.rows() == rows
    command.tell(rows, {"arms": summary(rows)}, command.PROGRAM)
    printed = capsys.readouterr().out
    again = re.search(r"^(\w+): python -m benchmarks\.faults --repeat (.*)$", printed, re.MULTILINE)
    assert again is not None
    found = re.fullmatch(r"(\w+) '?([^']*?)'? (\d+)", again[2])
    assert found is not None
    row = one(programs[found[1]], Planned(found[1], found[2], int(found[3])))
    assert (judged(row) if found[2] in FAULTS else "stopped") == again[1]
    assert row in rows


@pytest.mark.nightly("3,700 runs and 4,000 moves, by a seed that is drawn")
def test_the_whole_matrix(programs: Mapping[str, Program], tmp_path: Path) -> None:
    """No arm runs away and no move is stopped; few faults are late or further than an ideal stop."""
    seed = secrets.randbits(31)
    campaign = Campaign({name: programs[name] for name in ARMS}, seed, 10, 1000, tmp_path)
    campaign.make()
    rows = campaign.rows()
    bad = failures(rows)
    assert not [row for row in bad if judged(row) == "away"], f"--seed {seed}"
    assert not [row for row in trips(rows) if row["fault"] not in TRIPS], f"--seed {seed}"
    assert len(bad) <= 0.02 * len(rows), f"--seed {seed}"


@pytest.mark.ci("exports a controller and compiles it")
def test_the_smallest_size_moves_the_arm(
    programs: Mapping[str, Program], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By 0.05 rad, and three quarters of it do not."""
    name = "jump, link"
    monkeypatch.setattr(
        "benchmarks.faults.runs.fitting", lambda facts: [FAULTS[name], FAULTS["silent, link"]]
    )
    found = smallest_of(programs["one"])
    assert [*found] == [name]
    facts = programs["one"].facts

    def worst(x: float) -> float:
        lines = [drawn(FAULTS[name], facts, {}, seed, x) | {"never": 1} for seed in (1, 2, 3)]
        return max(row["wrong"] for row in programs["one"].lines(lines))

    assert worst(found[name]) > 0.05 > worst(0.75 * found[name])


def test_tables_show_the_results_that_are_kept() -> None:
    """Each fault that an arm may have, with its runs; every end that occurs."""
    results = kept()
    assert set(results["arms"]) == set(ARMS)
    text = TABLES["faults"](results)
    for faults in results["arms"].values():
        for name, found in faults.items():
            assert name in ALL
            assert sum(found.get(verdict, 0) for verdict in (*VERDICTS, "tripped")) == found["runs"]
    assert all(f"| {name} |" in text for name in FAULTS)
    total = sum(
        found["runs"]
        for faults in results["arms"].values()
        for name, found in faults.items()
        if name in FAULTS
    )
    assert f"{total} runs" in text
    groups = TABLES["groups"](results)
    numbers = [
        int(line.split("|")[3])
        for line in groups.splitlines()
        if line.startswith("| ") and "runs" not in line
    ]
    assert sum(numbers) == total
    assert all(f"| {name} |" in TABLES["harmless"](results) for name in HARMLESS)
    assert results["command"] in TABLES["arms"](results)
    assert json.loads(KEPT.read_text(encoding="utf-8")) == results


@pytest.mark.nightly(
    "designs and exports by the commands of the docs; the quick tests take the same law without them"
)
@pytest.mark.parametrize("name", ["one", "two", "servo"])
def test_the_controllers_are_those_that_commands_export(name: str, folder: Path, tmp_path: Path) -> None:
    """Line by line, but for what a header says of the design; and an arm of the caller's own runs."""
    arm = ARMS[name]
    done = store.command([*arm.command, "--out", "design"], tmp_path)
    assert done.code == 0, done.errors
    own = replace(arm, design=tmp_path / "design")
    exports = program_of(arm, folder).export, program_of(own, tmp_path).export
    first, second = ((place / "arm.c").read_text(encoding="utf-8").split("#include")[1:] for place in exports)
    digest = re.compile(r"_digest\[\] = .*")
    assert [digest.sub("", part) for part in first] == [digest.sub("", part) for part in second]
    words = f"--file {arm.file} --design {own.design} --build {tmp_path} --quick --seed 1"
    assert command.main(words.split()) in (0, 1)
