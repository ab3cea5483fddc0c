"""Rows of ``make bench-firmware``: what they promise, how they are shown, and one of them measured again."""

from __future__ import annotations

import json
import shutil

import pytest
from benchmarks.firmware import CLOCK, KEPT, RATE, ROWS, cost_of, measure, table

ROOM_IN_FLASH = 32_000  # bytes


def kept(links: int, real: str, machine: str) -> dict[str, float]:
    rows = json.loads(KEPT.read_text(encoding="utf-8"))
    assert [(row["links"], row["real"], row["machine"]) for row in rows] == [(*row,) for row in ROWS]
    return rows[ROWS.index((links, real, machine))]


def test_one_link_fits_a_microcontroller() -> None:
    row = kept(1, "float", "Cortex-M4F")
    assert row["code"] < ROOM_IN_FLASH
    period = CLOCK / RATE  # cycles
    assert row["cycles"] < period / 6
    assert row["cycles"] + 5 * row["most"] < 0.6 * period  # with five cycles of waiting for each instruction
    assert f"{row['cycles']:,}" in table()


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("machine", "tools"),
    [("x86-64", ("gcc", "valgrind")), ("Cortex-M4F", ("arm-none-eabi-gcc", "qemu-system-arm"))],
)
def test_a_row_measured_again(machine: str, tools: tuple[str, ...]) -> None:
    for tool in tools:
        if shutil.which(tool) is None:
            pytest.skip(f"no {tool}")
    row, found = kept(1, "float", machine), measure(1, "float", machine)
    for name in ("code", "state", "instructions", *(("cycles",) if "cycles" in row else ())):
        assert found[name] == pytest.approx(row[name], rel=0.1), f"{name}: make bench-firmware"
