"""The float export on the Cortex-M4F that QEMU emulates: the test vector, room in flash, instructions and stack."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

import flexhinf as fh
from flexhinf.export import export_c

pytestmark = pytest.mark.slow

#: Cycles of a period of 1 ms at 168 MHz, and cycles an instruction: 1 for most, 2 for a load, 3 for a fused
#: multiply-add, 14 for a division (Cortex-M4 technical reference manual); the mean is below 2 (docs/deployment.md).
CYCLES, PER_INSTRUCTION = 168_000, 2


@pytest.fixture(scope="module")
def folder(controller: fh.Controller, tmp_path_factory: pytest.TempPathFactory) -> Path:
    for tool in ("make", "arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(tool) is None:
            pytest.skip(f"no {tool}")
    return export_c(controller, tmp_path_factory.mktemp("m4") / "c", "arm", "float")


def emulated(folder: Path) -> subprocess.CompletedProcess[str]:
    command = ["make", "CFLAGS=-O2 -Werror", "cortex-m4"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)


def test_one_link_runs_at_1_kHz_in_32_kB_of_flash(folder: Path) -> None:
    done = emulated(folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "codes 0: passed" in done.stdout
    sizes = re.search(r"^\s*(\d+)\s+(\d+)\s+(\d+)\s+\d+\s+\w+\s+arm_alone.elf", done.stdout, re.MULTILINE)
    assert sizes is not None
    assert int(sizes[1]) + int(sizes[2]) < 32_000
    cost = re.search(r"(\d+) instructions.* (\d+); (\d+) bytes of stack", done.stdout)
    assert cost is not None
    mean, most, stack = map(int, cost.groups())
    assert 1_000 < mean <= most
    assert most * PER_INSTRUCTION < CYCLES
    assert 0 < stack < 2_000


def test_an_answer_that_differs_fails_there_too(folder: Path) -> None:
    vector = folder / "arm_test.c"
    text = vector.read_text()
    vector.write_text(
        text.replace(
            "static const int expected_code[SAMPLES] = {\n    0,",
            "static const int expected_code[SAMPLES] = {\n    3,",
        )
    )
    try:
        done = emulated(folder)
    finally:
        vector.write_text(text)
    assert done.returncode != 0
    assert "codes 1: FAILED" in done.stdout
