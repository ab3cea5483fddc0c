"""``make bench-firmware``: what a step of the exported C costs on a PC and on Cortex-M, for docs/deployment.md.

    python -m benchmarks.firmware            measures every row, and keeps them in benchmarks/firmware.json
    python -m benchmarks.firmware --only 7w  measures the rows of one design, and keeps them in the place of the old
    python -m benchmarks.firmware --table    prints the table of the rows that are kept

Counted, not timed: instructions by callgrind on the PC, and on the Cortex-M4F and Cortex-M7 that QEMU emulates
(``make cortex-m4`` of an exported folder, with the flags and the board of either). Cycles of the Cortex-M4F are counted
too: QEMU tells which instructions run, and each costs what Arm's manual says at the most, with memory that does not
wait. Arm publishes no such table of the Cortex-M7. Also timed: a step on the PC, the median of the test vector's.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import flexhinf as fh
from flexhinf.design.workspace.search import tuned_setup
from flexhinf.export import export_c
from flexhinf.export.stack import stack_bytes
from flexhinf.robot.workspace import workspace_of

KEPT = Path(__file__).resolve().with_suffix(".json")

PC = ("-std=c99", "-O3", "-march=x86-64-v3")
CORTEX_M = "-O2"

#: Board of QEMU and flags by processor.
BOARDS = {
    "Cortex-M4F": ("mps2-an386", "-mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16"),
    "Cortex-M7": ("mps2-an500", "-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16"),
}

#: Clock and rate that a microcontroller is judged by, Hz.
CLOCK, RATE = 168e6, 1e3

#: The command whose controller is exported, by the number of links; 7w is for the workspace. The page names it.
DESIGNS: dict[int | str, str] = {
    1: "flexhinf design paper --pose 90deg --start 0 --preset damped --degrees 4 --draws 0",
    2: "flexhinf design planar-two-link --degrees 4 --draws 0",
    7: "flexhinf design seven-link --degrees 2 --draws 0",
    "7w": "flexhinf design seven-link --workspace limits --measured link_position,motor_position",
}

#: What is measured: links, type, machine. A Cortex-M4F computes double in software; seven links are refused in float.
ROWS = [
    *((links, "double", "x86-64") for links in DESIGNS),
    *((links, "float", "x86-64") for links in (1, 2)),
    *((1, real, "Cortex-M4F") for real in ("float", "double")),
    *((links, "double", "Cortex-M7") for links in (1, 2, 7)),
]

#: Times every step, and says the median.
TIMED = """
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "arm.h"
enum { MOST = 4096 };
static double times[MOST];
static int count;
int __real_arm_step(arm_state *, const arm_param *, const arm_input *, arm_output *);
int __wrap_arm_step(arm_state *state, const arm_param *param, const arm_input *input, arm_output *output)
{
    struct timespec a, b;
    int code;
    clock_gettime(CLOCK_MONOTONIC, &a);
    code = __real_arm_step(state, param, input, output);
    clock_gettime(CLOCK_MONOTONIC, &b);
    if (count < MOST) times[count++] = 1e6 * (double)(b.tv_sec - a.tv_sec) + 1e-3 * (double)(b.tv_nsec - a.tv_nsec);
    return code;
}
static int order(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}
__attribute__((destructor)) static void report(void)
{
    qsort(times, (size_t)count, sizeof *times, order);
    printf("median %g us\\n", times[count / 2]);
}
"""

#: Says how large a state is.
STATE = """
#include <stdio.h>
#include "arm.h"
int main(void) { printf("%lu", (unsigned long)sizeof(arm_state)); return 0; }
"""


@cache
def controller(links: int | str) -> fh.Controller:
    """The controller that the design's command leaves in its report; for the workspace, where the judgement takes most
    of the time and does not change it, without the report."""
    if links == "7w":
        s = fh.Specification(workspace="limits", measured=("link_position", "motor_position"))
        robot = fh.load_robot("seven-link")
        setup = tuned_setup(robot, s, workspace_of(robot, s.workspace))
        return setup.controller(setup.workspace.home, supervision=setup.supervision)
    with tempfile.TemporaryDirectory() as work:
        words = [sys.executable, "-m", *shlex.split(DESIGNS[links]), "--out", "arm"]
        done = subprocess.run(words, cwd=work, capture_output=True, text=True, check=False)
        assert done.returncode in (0, 1), done.stderr  # 1: a report that misses a requirement
        return fh.load_controller(Path(work) / "arm" / "controller")


def run(*words: object, folder: Path) -> str:
    """What a command prints; it must end well."""
    done = subprocess.run([*map(str, words)], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(map(str, words))}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def measure(links: int | str, real: str, machine: str) -> dict[str, Any]:
    """A row: sizes in bytes, instructions of a step, and on a Cortex-M4F its cycles."""
    with tempfile.TemporaryDirectory() as work:
        folder = export_c(controller(links), Path(work) / "c", "arm", real, limits=False)
        measured = on_pc(folder) if machine == "x86-64" else on_cortex_m(folder, machine)
    return {"links": links, "real": real, "machine": machine} | measured


# A PC ---------------------------------------------------------------------------------------------------
def on_pc(folder: Path) -> dict[str, Any]:
    """By gcc and callgrind; the stack is computed."""
    (folder / "state.c").write_text(STATE, encoding="utf-8")
    run("gcc", *PC, "-DARM_WITHOUT_REST", "-DARM_WITHOUT_CHECK", "-c", "arm.c", "-o", "arm.o", folder=folder)
    run("gcc", *PC, "arm_test.c", "arm.o", "-lm", "-o", "plain", folder=folder)
    flags = ("-Wl,--wrap=arm_step", "-Wl,-z,now")
    (folder / "timed.c").write_text(TIMED, encoding="utf-8")
    run("gcc", *PC, *flags, "arm_test.c", "timed.c", "arm.o", "-lm", "-o", "timed", folder=folder)
    times = [float(run("./timed", folder=folder).split()[-2]) for _ in range(9)]
    run("gcc", "state.c", "-o", "state", folder=folder)
    stack = stack_bytes(
        {name: (folder / name).read_text(encoding="utf-8") for name in ("arm.h", "arm.c")},
        "arm_step",
        "gcc",
        PC,
    )
    counting = ("--tool=callgrind", "--collect-atstart=no", "--toggle-collect=arm_step")
    run("valgrind", *counting, "--callgrind-out-file=counts", "./plain", folder=folder)
    total = re.search(r"^summary: (\d+)", (folder / "counts").read_text(encoding="utf-8"), re.MULTILINE)
    said = re.search(r"(\d+) samples", run("./plain", folder=folder))
    assert total is not None
    assert said is not None
    samples, state = int(said[1]), int(run("./state", folder=folder))
    return {
        "code": int(run("size", "arm.o", folder=folder).splitlines()[1].split()[0]),
        "state": state, "stack": stack, "instructions": int(total[1]) / samples, "microseconds": min(times),
        "compiler": run("gcc", "--version", folder=folder).splitlines()[0], "flags": " ".join(PC),
    }  # fmt: skip


# A Cortex-M ---------------------------------------------------------------------------------------------
def on_cortex_m(folder: Path, machine: str) -> dict[str, Any]:
    """By ``make cortex-m4`` of the exported folder, then on a Cortex-M4F by a trace of some steps for the cycles."""
    board, flags = BOARDS[machine]
    qemu = f"{' '.join(emulated(board))} -icount shift=10 -semihosting-config enable=on,target=native"
    words = (f"CFLAGS={CORTEX_M}", f"CORTEX_M4={flags} -ffunction-sections -fdata-sections", f"QEMU={qemu}")
    text = run("make", *words, "cortex-m4", folder=folder)
    sizes = re.search(r"^\s*(\d+)\s+(\d+)\s.*arm_alone.elf", text, re.MULTILINE)
    cost = re.search(r"(\d+) instructions in a step, at most (\d+); (\d+) bytes of stack", text)
    assert sizes is not None
    assert cost is not None
    mean, most, stack = map(int, cost.groups())
    bound = {}
    if machine == "Cortex-M4F":  # Arm publishes cycles of its instructions, and none of the Cortex-M7's
        steps = max(2, min(20, 1_000_000 // mean))
        counted, cycles = traced(folder, steps)
        assert abs(counted / steps - mean) < 0.05 * mean, "timer and trace do not count the same"
        bound = {"cycles": round(most * cycles / counted)}
    symbols = run("arm-none-eabi-nm", "--print-size", "arm_m4.elf", folder=folder)
    state = re.search(r"^\w+ (\w+) b state$", symbols, re.MULTILINE)
    assert state is not None
    return {
        "code": int(sizes[1]) + int(sizes[2]), "state": int(state[1], 16), "stack": stack, "instructions": mean,
        "most": most, **bound,
        "compiler": run("arm-none-eabi-gcc", "--version", folder=folder).splitlines()[0],
        "flags": f"{CORTEX_M} -std=c99 {flags}",
        "emulator": run("qemu-system-arm", "--version", folder=folder).splitlines()[0],
    }  # fmt: skip


def traced(folder: Path, steps: int) -> tuple[int, int]:
    """Instructions and cycles of the first steps of the test vector."""
    code = instructions_of(folder)
    lines = map(str.split, run("arm-none-eabi-nm", "arm_m4.elf", folder=folder).splitlines())
    symbols = {name: int(address, 16) & ~1 for address, _, name in lines}
    step, caller, counting = (symbols[name] for name in ("arm_step", "main", "__wrap_arm_step"))
    after = min(function for _, _, function in code.values() if function > counting)
    watched = (
        f"0x0..{counting - 1:#x},{after:#x}..{max(code):#x}"  # not what paints the stack around every step
    )
    counted = cycles = begun = 0
    last: int | None = None  # the instruction before, inside a step
    for place in places(folder, watched):
        if last is not None:
            cycles += cost_of(code[last][1], jumps=place != last + code[last][0])
        begun += place == step
        if begun > steps:
            break
        inside = code[place][2] != caller and begun > 0
        last = place if inside else None
        counted += inside
    return counted, cycles


def places(folder: Path, watched: str) -> Iterator[int]:
    """Addresses of the instructions that QEMU runs there, one after the other."""
    pipe = folder / "trace"
    os.mkfifo(pipe)
    command = [
        *emulated("mps2-an386"), "-semihosting-config", "enable=on,target=native", *single_steps(),
        "-d", "exec,nochain", "-dfilter", watched,
        "-D", str(pipe), "-kernel", "arm_m4.elf",
    ]  # fmt: skip
    with (
        subprocess.Popen(
            command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as emulator,
        pipe.open(encoding="ascii", errors="replace") as lines,
    ):
        try:
            for line in lines:
                if line.startswith("Trace"):
                    yield int(line.split("[", 1)[1].split("/")[1], 16)
        finally:
            emulator.kill()


def emulated(board: str) -> tuple[str, ...]:
    """QEMU with a board and nothing else."""
    off = ("-display", "none", "-monitor", "none", "-serial", "none")
    return ("qemu-system-arm", "-machine", board, *off)


def single_steps() -> tuple[str, ...]:
    """QEMU's option for one instruction in each block: it has another name since version 8.1."""
    found = re.search(
        r"version (\d+)\.(\d+)", subprocess.check_output(["qemu-system-arm", "--version"], text=True)
    )
    old = found is not None and (int(found[1]), int(found[2])) < (8, 1)
    return ("-singlestep",) if old else ("-accel", "tcg,one-insn-per-tb=on")


def instructions_of(folder: Path) -> dict[int, tuple[int, str, int]]:
    """Size, text and function of each instruction of the program, by address."""
    found, function = {}, 0
    for line in run("arm-none-eabi-objdump", "--disassemble", "arm_m4.elf", folder=folder).splitlines():
        if head := re.match(r"([0-9a-f]{8}) <.*>:$", line):
            function = int(head[1], 16)
        elif row := re.match(r"\s*([0-9a-f]+):\t([0-9a-f ]+)\t(.*)", line):
            found[int(row[1], 16)] = (len(row[2].replace(" ", "")) // 2, row[3], function)
    return found


#: Cycles of an instruction, by the beginning of its mnemonic; others need one. (Arm Cortex-M4 Processor Technical
#: Reference Manual, tables of the processor's and the floating-point unit's instructions.) The first that fits counts.
CYCLES = (
    ("vdiv", 14), ("vsqrt", 14), ("vfma", 3), ("vfms", 3), ("vfnm", 3), ("vmla", 3), ("vmls", 3), ("vnmla", 3),
    ("vnmls", 3), ("vldr", 2), ("vstr", 2), ("sdiv", 12), ("udiv", 12), ("mla", 2), ("mls", 2), ("tbb", 2), ("tbh", 2),
    ("ldrd", 3), ("strd", 3), ("ldr", 2), ("str", 2),
)  # fmt: skip

#: Cycles that refill the pipeline where the next instruction is another one: one to three.
REFILL = 3


def cost_of(text: str, jumps: bool) -> int:
    """Cycles at the most: loads are not pipelined, and every jump refills the whole pipeline."""
    mnemonic = text.split()[0]
    refill = REFILL if jumps else 0
    if re.match(r"(ldm|stm|push|pop|vldm|vstm|vpush|vpop)", mnemonic):
        return 1 + transferred(text) + refill
    wide = re.match(r"v(ldr|str)|vmov", mnemonic) is not None and re.search(r"\bd\d", text) is not None
    cycles = next((count for start, count in CYCLES if mnemonic.startswith(start)), 1)
    return cycles + wide + refill


def transferred(text: str) -> int:
    """Words of a list of registers, ``{r4, r5, pc}`` or ``{d8-d10}``."""
    words = 0
    for part in text.split("{")[1].split("}")[0].split(","):
        ends = [int(number) for number in re.findall(r"\d+", part)]
        count = ends[1] - ends[0] + 1 if "-" in part else 1
        words += count * (2 if part.strip().startswith("d") else 1)
    return words


# The table ----------------------------------------------------------------------------------------------
def table(kept: Path = KEPT) -> str:
    """The rows, with what compiled and counted them."""
    rows = json.loads(kept.read_text(encoding="utf-8"))
    lines = [
        "| links, law | type | machine | code and constants | state | stack | instructions a step | µs a step "
        "| cycles, at most | of 1 ms at 168 MHz |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        words = DESIGNS[row["links"]]
        law = "modal" if "workspace" in words else "linear" if "--degrees 2" in words else "cubic"
        cells = [
            f"{str(row['links'])[0]}, {law}",
            row["real"],
            row["machine"],
            kilobytes(row["code"]),
            kilobytes(row["state"]),
        ]
        cells += [kilobytes(row["stack"]), f"{row['instructions']:,.0f}"]
        cells.append(f"{row['microseconds']:.1f}" if "microseconds" in row else "")
        if "most" in row:
            cells[-2] += f" (at most {row['most']:,})"
        if "cycles" in row:
            cells += [f"{row['cycles']:,}", f"{100 * row['cycles'] * RATE / CLOCK:,.0f} %"]
        lines.append("| " + " | ".join([*cells, "", ""][:10]) + " |")
    tools = dict.fromkeys(
        (row["machine"], row["compiler"], row["flags"], row.get("emulator", "callgrind")) for row in rows
    )
    made = [
        f"- {machine}: {compiler}, `{flags}`; counted by {counter}."
        for machine, compiler, flags, counter in tools
    ]
    designs = [
        f"- {str(links)[0]} link{'s' * (links != 1)}{', modal' * (links == '7w')}: `{words}`"
        for links, words in DESIGNS.items()
    ]
    return "\n".join([*lines, "", *designs, *made])


def kilobytes(size: int) -> str:
    """A size for a reader."""
    return f"{size} B" if size < 1000 else f"{size / 1000:.1f} kB"


def main() -> int:
    """Measure and keep, or print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.firmware", description=__doc__)
    parser.add_argument("--table", action="store_true", help="print the rows that are kept")
    parser.add_argument("--only", choices=[*map(str, DESIGNS)], help="the rows of one design")
    wanted = parser.parse_args()
    if not wanted.table:
        known = json.loads(KEPT.read_text(encoding="utf-8")) if wanted.only else []
        rows = [row for row in known if str(row["links"]) != wanted.only]
        for row in ROWS:
            if wanted.only not in (None, str(row[0])):
                continue
            rows.append(measure(*row))
            print(json.dumps(rows[-1]), flush=True)
        rows.sort(key=lambda row: ROWS.index((row["links"], row["real"], row["machine"])))
        KEPT.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(table())
    return 0


if __name__ == "__main__":
    sys.exit(main())
