"""The float export on the Cortex-M4F that QEMU emulates: the test vector, room in flash, instructions and stack; called
by a timer interrupt, and as a task of FreeRTOS with a stand-in for its kernel."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

import flexhinf as fh
from flexhinf.export import export_c

pytestmark = pytest.mark.ci("a processor that QEMU emulates")

#: Cycles of a period of 1 ms at 168 MHz, and cycles an instruction: 1 for most, 2 for a load, 3 for a fused
#: multiply-add, 14 for a division (Cortex-M4 technical reference manual); the mean is below 2 (docs/deployment.md).
CYCLES, PER_INSTRUCTION = 168_000, 2

#: Bytes of the program in flash and instructions of a step, as measured with GCC 12.
FLASH, INSTRUCTIONS = 12_800, 12_250


@pytest.fixture(scope="module")
def folder(controller: fh.Controller, tmp_path_factory: pytest.TempPathFactory) -> Path:
    for tool in ("make", "arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(tool) is None:
            pytest.skip(f"missing: {tool}")
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
    assert mean <= most
    assert most * PER_INSTRUCTION < CYCLES
    assert 0 < stack < 2_000
    assert (int(sizes[1]), mean) == (
        pytest.approx(FLASH, rel=0.1),
        pytest.approx(INSTRUCTIONS, rel=0.1),
    ), "if meant: make bench-firmware, and the numbers above"


def test_the_command_of_safety_measures_the_worst_case(folder: Path) -> None:
    """Of the test vector, then of the rehearsal, which goes the longer ways."""
    command = re.search(r"`(make [^`]*worst\.txt)`", (folder / "safety.md").read_text(encoding="utf-8"))
    assert command is not None
    subprocess.run(["sh", "-c", command[1]], cwd=folder, check=True, capture_output=True, timeout=240)
    most = [int(n) for n in re.findall(r"at most (\d+)", (folder / "worst.txt").read_text(encoding="utf-8"))]
    assert len(most) == 2
    assert 1_000 < most[0] < most[1]


def test_an_answer_that_differs_fails_there_too(folder: Path) -> None:
    vector = folder / "arm_test.c"
    text = vector.read_text()
    vector.write_text(
        text.replace(
            "static const int expected_code[ROWS] = {\n    0,",
            "static const int expected_code[ROWS] = {\n    3,",
        )
    )
    try:
        done = emulated(folder)
    finally:
        vector.write_text(text)
    assert done.returncode != 0
    assert "codes 1: FAILED" in done.stdout


#: Stubs of FreeRTOS with the signatures of its functions, and a stand-in for its kernel.
FREERTOS = Path(__file__).parent / "freertos"

BOARD = (
    "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-ffunction-sections",
    "--specs=rdimon.specs", "-nostartfiles", "-T", "cortex_m4/board.ld", "-Wl,--gc-sections",
)  # fmt: skip
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
EMULATOR = ("qemu-system-arm", "-machine", "mps2-an386", "-icount", "shift=0,sleep=off", "-display", "none",
            "-monitor", "none", "-serial", "none", "-semihosting-config", "enable=on,target=native",
            "-kernel")  # fmt: skip


@pytest.mark.parametrize("wrong", [False, True])
def test_a_timer_interrupt_calls_it_once_per_period(wrong: bool, folder: Path) -> None:
    vector = folder / "arm_test.c"
    text = vector.read_text()
    mark = "static const int expected_code[ROWS] = {\n    0,"
    assert mark in text
    vector.write_text(text.replace(mark, mark.replace("0,", "3,")) if wrong else text)
    try:
        command = ["make", "CFLAGS=-O2 -Werror", "cortex-m4-periodic"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)
    finally:
        vector.write_text(text)
    assert (done.returncode != 0, "passed" in done.stdout) == (wrong, not wrong), done.stdout + done.stderr


def test_a_task_of_freertos_gives_the_same(folder: Path) -> None:
    """The kernel is a stand-in of one task: FreeRTOS itself is not part of this repository."""
    sources = (
        "arm.c",
        "templates/arm_freertos.c",
        "cortex_m4/recorded.c",
        "cortex_m4/board.c",
        FREERTOS / "kernel.c",
    )
    compiler = ("arm-none-eabi-gcc", "-O2", *STRICT, *BOARD, "-I.", f"-I{FREERTOS}", "-DARM_ENABLED=1")
    subprocess.run([*compiler, *sources, "-lm", "-o", "freertos.elf"], cwd=folder, check=True)
    done = subprocess.run(
        [*EMULATOR, "freertos.elf"], cwd=folder, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "200 samples" in done.stdout
    # 1 ms is no whole number of ticks of 300 Hz
    words = [*compiler, "-DconfigTICK_RATE_HZ=300", "-c", "templates/arm_freertos.c", "-o", "refused.o"]
    assert subprocess.run(words, cwd=folder, capture_output=True, check=False).returncode != 0
