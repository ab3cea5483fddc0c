"""Rows of ``make bench-firmware``: what they promise, how they are shown, and one of them measured again."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from benchmarks import firmware_peers, firmware_worst
from benchmarks.firmware import CLOCK, KEPT, RATE, ROWS, cost_of, key, measure, table
from benchmarks.firmware_trajectories import ACCELERATION, VELOCITY, planned
from benchmarks.record import kept_rows

ROOM_IN_FLASH = 32_000  # bytes


def kept(links: int, real: str, machine: str, program: str = "") -> dict[str, float]:
    rows = kept_rows(KEPT)
    assert [key(row) for row in rows] == ROWS
    return rows[ROWS.index((links, real, machine, program))]


def test_one_link_fits_a_microcontroller() -> None:
    row = kept(1, "float", "Cortex-M4F")
    assert row["code"] < ROOM_IN_FLASH
    period = CLOCK / RATE  # cycles
    assert row["cycles"] < period / 6
    assert row["cycles"] + 5 * row["most"] < 0.6 * period  # with five cycles of waiting for each instruction
    assert f"{row['cycles']:,}" in table(kept_rows(KEPT))


def test_the_bound_holds_for_the_longest_steps() -> None:
    rows = kept_rows(firmware_worst.KEPT)
    assert rows
    for row in rows:
        assert row["vector"] < row["rehearsal"] < row["bound"] < 2.0 * row["rehearsal"]
        assert f"{row['bound']:,}" in firmware_worst.table(rows)


def test_what_a_call_costs_is_no_instruction_of_the_caller() -> None:
    text = "fn=step\n0x10 2\ncalls=2 0x40\n0x12 90\n0x14 1\nfn=inner\n0x40 45\nfe=step\n0x14 1\n"
    assert firmware_worst.counts_in(text) == {"0x10": 2, "0x14": 2, "0x40": 45}


@pytest.mark.parametrize(("way", "duration"), [(0.25, 1.0), (2.0, 3.0)])
def test_a_planned_line_is_as_fast_as_its_limits(way: float, duration: float) -> None:
    """The shortest time of a line: with a top speed or without. Half-way it is half-way, and it ends at rest."""
    start, end = np.array([0.3, -0.2]), np.array([0.3 - way, -0.2 + 0.5 * way])
    goal = planned(("a", "b"), start, end)
    points, speeds, gains = (
        np.asarray(part) for part in (goal.positions, goal.velocities, goal.accelerations)
    )
    times = np.asarray(goal.times)
    assert times[-1] == pytest.approx(duration)
    assert np.all(np.diff(times) > 0.0)
    assert points[-1] == pytest.approx(end)
    assert speeds[-1] == pytest.approx(0.0)
    assert points[np.isclose(times, 0.5 * duration)][0] == pytest.approx(0.5 * (start + end))
    assert np.abs(speeds).max() == pytest.approx(min(VELOCITY, 0.5 * ACCELERATION * duration))
    assert np.abs(gains).max() == pytest.approx(ACCELERATION)
    same = np.all(gains[1:] == gains[:-1], axis=1)
    mean = 0.5 * (speeds[1:] + speeds[:-1])[same]
    assert np.diff(points, axis=0)[same] == pytest.approx(np.diff(times)[same, None] * mean)


@pytest.mark.parametrize(
    ("text", "jumps", "cycles"),
    [
        ("vdiv.f32\ts0, s1, s2", False, 14),
        ("vfma.f32\ts0, s1, s2", False, 3),
        ("vadd.f32\ts0, s1, s2", False, 1),
        ("vldr\ts0, [r0]", False, 2),
        ("vldr\td0, [r0]", False, 3),
        ("ldrd\tr0, r1, [r2]", False, 3),
        ("bne.n\t1a2", True, 4),
        ("bne.n\t1a2", False, 1),
        ("push\t{r4, r5, lr}", False, 4),
        ("pop\t{r4, pc}", True, 6),
        ("vpop\t{d8-d10}", False, 7),
        ("vldmia\tr3!, {s0, s1, s2}", False, 4),
        ("vmov\tr0, r1, d7", False, 2),
        ("udiv\tr0, r0, r1", False, 12),
    ],
)
def test_cycles_of_an_instruction(text: str, jumps: bool, cycles: int) -> None:
    assert cost_of(text, jumps) == cycles


@pytest.mark.parametrize(
    ("text", "jumps", "cycles"),
    [
        ("vdiv.f64\td0, d1, d2", False, 30),
        ("vsqrt.f32\ts0, s1", False, 16),
        ("vfma.f64\td0, d1, d2", False, 11),
        ("vfnms.f32\ts0, s1, s2", False, 6),
        ("vmul.f64\td0, d1, d2", False, 7),
        ("vadd.f64\td0, d1, d2", False, 4),
        ("vldr\td0, [r0]", False, 3),
        ("bne.n\t1a2", True, 8),
        ("vldmia\tr3!, {d0, d1}", False, 7),
        ("add\tr0, r1, r2, lsl #3", False, 2),
    ],
)
def test_latency_of_an_instruction_of_the_cortex_m7(text: str, jumps: bool, cycles: int) -> None:
    assert cost_of(text, jumps, "Cortex-M7") == cycles


@pytest.mark.oracle
@pytest.mark.parametrize("row", [row for row in ROWS if row[3]])
def test_peers_give_the_inputs_of_the_python_that_they_are_made_of(row: tuple[int, str, str, str]) -> None:
    """In `double` to rounding; so that what is compared is one controller, or is what is said of it."""
    assert kept(*row)["error"] < (1e-11 if row[1] == "double" else 1e-3)


def test_the_best_stands_first_and_losses_are_named() -> None:
    text = firmware_peers.table(kept_rows(KEPT))
    first = {
        peer: next(line for line in text.splitlines() if peer in line)
        for peer in ("CasADi", "Observer", "ADMM")
    }
    for peer, line in first.items():
        lost = line.partition("loses: ")[2].partition(". ")[0]
        for name, place in firmware_peers.COMPARED.items():
            pairs = [
                (kept(*row[:3], "exported")[place], kept(*row)[place])
                for row in ROWS
                if row[3] == peer and place in kept(*row) and place != "error"
            ]
            assert (name in lost) is any(own > other for own, other in pairs)
    cells = [cell.strip() for line in text.splitlines() if "CasADi" in line for cell in line.split("|")[3:5]]
    for cell in cells:
        sizes = [
            float(part.split()[1]) * (1000 if part.endswith("kB") else 1) for part in cell.split(", ") if part
        ]
        assert sizes == sorted(sizes)


#: What counts the instructions of each machine.
TOOLS = {"x86-64": ("gcc", "valgrind"), "Cortex-M4F": ("arm-none-eabi-gcc", "qemu-system-arm")}


@pytest.mark.nightly(
    "counts every instruction of a run; tests/export/test_cortex_m4.py runs one on that machine in CI"
)
@pytest.mark.parametrize("program", ["", "CasADi", "Observer", "ADMM"])
@pytest.mark.parametrize("machine", TOOLS)
def test_a_row_measured_again(machine: str, program: str) -> None:
    for tool in TOOLS[machine]:
        if shutil.which(tool) is None:
            pytest.skip(f"missing: {tool}")
    check(kept(1, "float", machine, program), measure(1, "float", machine, program))


def check(row: dict[str, float], found: dict[str, float]) -> None:
    for name in ("code", "state", "instructions", *(("cycles",) if "cycles" in row else ())):
        assert found[name] == pytest.approx(row[name], rel=0.1), f"{name}: make bench-firmware"
