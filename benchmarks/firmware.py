"""``make bench-firmware``: what a step of the exported C costs on a PC and on Cortex-M, for docs/firmware_study.md.

    python -m benchmarks.firmware               measures every row, and keeps them in benchmarks/firmware.json
    python -m benchmarks.firmware --only 7w     measures the rows of one design, and keeps them in the place of the old
    python -m benchmarks.firmware --only peers  likewise those of `benchmarks.firmware_peers`, beside the exported C
    python -m benchmarks.firmware --only tests  likewise those of `benchmarks.firmware_tests`: what the shipped tests
                                                notice of changed C, and what they reach; only so, as it takes long
    python -m benchmarks.firmware --only trajectories  likewise those of `benchmarks.firmware_trajectories`: how it
                                                follows trajectories on MuJoCo's robot; only so
    python -m benchmarks.firmware --only worst  likewise those of `benchmarks.firmware_worst`: the longest steps
    python -m benchmarks.firmware --only 7w --counted  leaves times as they are kept, for a machine that is busy
    python -m benchmarks.firmware --table       prints the table of the rows that are kept; --table peers, tests,
                                                trajectories or worst the other ones

Counted, not timed: instructions by callgrind on the PC, and on the Cortex-M4F and Cortex-M7 that QEMU emulates
(``make cortex-m4`` of an exported folder, with the flags and the board of either). Cycles are counted too: QEMU tells
which instructions run, and each costs what Arm's manual of the Cortex-M4 says at the most, with memory that does not
wait. Arm publishes no such table of the Cortex-M7: there each costs its latency in LLVM's scheduling model, as if it
waited for the one before. Also timed: a step on the PC, the least of nine medians of the test vector's, of programs
that run in turns.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import flexhinf as fh
from benchmarks import firmware_peers, firmware_tests, firmware_trajectories, firmware_worst
from benchmarks.firmware_peers import PROGRAMS, Peer, kilobytes
from benchmarks.firmware_tools import PC, run
from benchmarks.record import keep_rows, kept_rows
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.search import tuned_setup
from flexhinf.export import export_c
from flexhinf.export.stack import stack_bytes
from flexhinf.robot.workspace import workspace_of

KEPT = Path(__file__).resolve().with_suffix(".json")

CORTEX_M = "-O2"
LEFT_OUT = ("-DARM_WITHOUT_REST", "-DARM_WITHOUT_CHECK")
LEVELS = ("-Os", "-O1", "-O2", "-O3")

#: With what else a step in `double` is timed on the PC, by every compiler that is there.
COMPILERS = ("gcc", "clang")
TIMED_WITH = (("-O3", "-march=native"), PC[1:], ("-O2", "-mfma"), ("-O2",))

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
    2: "flexhinf design planar-two-link --pose home --degrees 4 --draws 0",
    7: "flexhinf design seven-link --pose home --degrees 2 --draws 0",
    "7w": "flexhinf design seven-link --workspace limits --measured link_position,motor_position",
}

#: What is measured: links, type, machine, and the program where others stand beside the exported one. A Cortex-M4F
#: computes double in software; seven links are refused in float.
ROWS: list[tuple[int | str, str, str, str]] = [
    *((links, "double", "x86-64", "") for links in DESIGNS),
    *((links, "float", "x86-64", "") for links in (1, 2)),
    *((1, real, "Cortex-M4F", "") for real in ("float", "double")),
    *((links, "double", "Cortex-M7", "") for links in (1, 2, 7)),
    *(
        (links, real, machine, program)
        for links in (1, 2)
        for real, machine in (
            ("double", "x86-64"),
            ("float", "x86-64"),
            ("float", "Cortex-M4F"),
            ("double", "Cortex-M7"),
        )
        for program in PROGRAMS
    ),
]

#: What a row has that is timed, and the processor of it.
TIMES = ("microseconds", "times", "processor")

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
        setup = tuned_setup(robot, s, Task(workspace_of(robot, s.workspace)))
        return setup.controller(setup.workspace.home, supervision=setup.supervision)
    with tempfile.TemporaryDirectory() as work:
        words = [sys.executable, "-m", *shlex.split(DESIGNS[links]), "--out", "arm"]
        done = subprocess.run(words, cwd=work, capture_output=True, text=True, check=False)
        assert done.returncode in (0, 1), done.stderr  # 1: a report that misses a requirement
        return fh.load_controller(Path(work) / "arm" / "controller")


@cache
def peer(links: int | str, program: str) -> Peer:
    """A program for the design with limits of its inputs."""
    return PROGRAMS[program](firmware_peers.limited(controller(links)))


def measure(
    links: int | str, real: str, machine: str, program: str = "", clock: bool = True
) -> dict[str, Any]:
    """A row: sizes in bytes, instructions of a step, and on a Cortex-M its cycles; `program`: of `PROGRAMS`, whose
    samples are others. `clock`: Whether steps are timed on the PC too."""
    with tempfile.TemporaryDirectory() as work:
        one = peer(links, program).controller if program else controller(links)
        folder = export_c(one, Path(work) / "c", "arm", real, limits=False)
        if program:
            peer(links, program).write(folder, real)
        if machine == "x86-64":
            measured = on_pc(folder, clock)
        else:
            measured = on_cortex_m(folder, machine, not program)
        if not program and real == "double":
            measured |= other_flags(folder, machine, clock)
    return {"links": links, "real": real, "machine": machine, "program": program} | measured


# A PC ---------------------------------------------------------------------------------------------------
def on_pc(folder: Path, clock: bool) -> dict[str, Any]:
    """By gcc and callgrind; the stack is computed."""
    (folder / "state.c").write_text(STATE, encoding="utf-8")
    instructions = counted(folder, PC)
    run("gcc", "state.c", "-o", "state", folder=folder)
    return {
        "code": int(run("size", "arm.o", folder=folder).splitlines()[1].split()[0]),
        "state": int(run("./state", folder=folder)), "stack": stack(folder, "gcc", PC), "instructions": instructions,
        **({"microseconds": timed(folder, [("gcc", PC[1:])])[0]} if clock else {}),
        "error": error_in(run("./plain", folder=folder)),
        "compiler": run("gcc", "--version", folder=folder).splitlines()[0], "flags": " ".join(PC),
    }  # fmt: skip


def timed(folder: Path, ways: Sequence[tuple[str, Sequence[str]]]) -> list[float]:
    """Microseconds of a step with each compiler and its flags, the least of nine medians; they take turns."""
    (folder / "timed.c").write_text(TIMED, encoding="utf-8")
    wrapped = (PC[0], *LEFT_OUT, "-Wl,--wrap=arm_step", "-Wl,-z,now")
    for k, (compiler, flags) in enumerate(ways):
        sources = ("-DARM_LOOP_ALONE", "arm_test.c", "timed.c", "arm.o", "-lm", "-o", f"timed{k}")
        run(compiler, PC[0], *flags, *LEFT_OUT, "-c", "arm.c", "-o", "arm.o", folder=folder)
        run(compiler, *flags, *wrapped, *sources, folder=folder)
    medians = [
        [float(run(f"./timed{k}", folder=folder).split()[-2]) for k in range(len(ways))] for _ in range(9)
    ]
    return [min(row) for row in zip(*medians, strict=True)]


def counted(folder: Path, flags: Sequence[str]) -> float:
    """Instructions of a step, the mean of the test vector's, of arm.o and a program `plain`, which are made."""
    run("gcc", *flags, *LEFT_OUT, "-S", "arm.c", "-o", "arm.s", folder=folder)
    # of two codes of this move, the assembler takes one that valgrind 3.19 does not know
    text = (folder / "arm.s").read_text(encoding="utf-8")
    (folder / "arm.s").write_text(text.replace("\tvmovq\t%xmm", "\t{load} vmovq\t%xmm"), encoding="utf-8")
    run("gcc", "-c", "arm.s", "-o", "arm.o", folder=folder)
    run("gcc", *flags, "-DARM_LOOP_ALONE", "arm_test.c", "arm.o", "-lm", "-o", "plain", folder=folder)
    counting = ("--tool=callgrind", "--collect-atstart=no", "--toggle-collect=arm_step")
    # valgrind 3.19 loses the sign of a zero in a fused multiply-add: the answers are those of the processor, below
    command = ("valgrind", *counting, "--callgrind-out-file=counts", "./plain")
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr
    total = re.search(r"^summary: (\d+)", (folder / "counts").read_text(encoding="utf-8"), re.MULTILINE)
    said = re.search(r"(\d+) samples", run("./plain", folder=folder))
    assert total is not None
    assert said is not None
    return int(total[1]) / int(said[1])


def stack(folder: Path, compiler: str, flags: Sequence[str]) -> int:
    """Bytes along the deepest calls of a step, computed."""
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in ("arm.h", "arm.c")}
    return stack_bytes(texts, "arm_step", compiler, tuple(flags))


def error_in(text: str) -> float:
    """The largest error that a test vector says, of the largest value."""
    found = re.search(r"largest relative error (\S+)", text)
    assert found is not None
    return float(found[1])


def other_flags(folder: Path, machine: str, clock: bool) -> dict[str, Any]:
    """Smallest and largest stack of the levels of optimisation; on the PC also instructions without and with fused
    multiply-adds, likewise with vectors of one length, and times."""
    compiler, base = (
        ("gcc", PC[2:]) if machine == "x86-64" else ("arm-none-eabi-gcc", BOARDS[machine][1].split())
    )
    stacks = [stack(folder, compiler, (level, *base)) for level in LEVELS]
    found: dict[str, Any] = {"stacks": [min(stacks), max(stacks)]}
    if machine == "x86-64":
        for name, avx in (("fusing", ()), ("vectors", ("-mavx2",))):
            found[name] = [counted(folder, ("-std=c99", "-O2", *avx, *fma)) for fma in ((), ("-mfma",))]
    if machine == "x86-64" and clock:
        ways = [(name, flags) for flags in TIMED_WITH for name in COMPILERS if shutil.which(name)]
        times = timed(folder, ways)
        found["times"] = [[name, " ".join(flags), time] for (name, flags), time in zip(ways, times)]
        found["processor"] = processor()
    return found


def processor() -> str:
    """The name of the processor of this PC."""
    text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    found = re.search(r"^model name\s*: (.*)$", text, re.MULTILINE)
    return found[1].strip() if found else "a processor without a name"


# A Cortex-M ---------------------------------------------------------------------------------------------
def on_cortex_m(folder: Path, machine: str, rehearses: bool) -> dict[str, Any]:
    """By ``make cortex-m4`` of the exported folder, then on a Cortex-M4F by a trace of some steps for the cycles.

    `rehearses`: Whether its rehearsal runs too; other programs have none."""
    board, flags = BOARDS[machine]
    qemu = f"{' '.join(emulated(board))} -icount shift=10 -semihosting-config enable=on,target=native"
    words = (
        f"CFLAGS={CORTEX_M} -DARM_LOOP_ALONE",
        f"CORTEX_M4={flags} -ffunction-sections -fdata-sections",
        f"QEMU={qemu}",
    )
    text = run("make", *words, "cortex-m4", folder=folder)
    sizes = re.search(r"^\s*(\d+)\s+(\d+)\s.*arm_alone.elf", text, re.MULTILINE)
    assert sizes is not None
    mean, most, stack = costs_in(text)
    steps = max(2, min(20, 1_000_000 // mean))
    counted, cycles = traced(folder, machine, steps)
    assert 0.8 * mean < counted / steps < 1.05 * most, (
        "timer and trace do not count the same"
    )  # these are the first
    symbols = run("arm-none-eabi-nm", "--print-size", "arm_m4.elf", folder=folder)
    state = re.search(r"^\w+ (\w+) b state$", symbols, re.MULTILINE)
    assert state is not None
    rehearsed = costs_in(run("make", *words, "cortex-m4-contract", folder=folder))[1] if rehearses else 0
    return {
        "code": int(sizes[1]) + int(sizes[2]), "state": int(state[1], 16), "stack": stack, "instructions": mean,
        "most": most, **({"rehearsed": rehearsed} if rehearsed else {}),
        "cycles": round(most * cycles / counted), "error": error_in(text),
        "compiler": run("arm-none-eabi-gcc", "--version", folder=folder).splitlines()[0],
        "flags": f"{CORTEX_M} -std=c99 {flags}",
        "emulator": run("qemu-system-arm", "--version", folder=folder).splitlines()[0],
    }  # fmt: skip


def costs_in(text: str) -> list[int]:
    """Instructions of a step, the mean and the most, and bytes of stack, as the emulated board prints them."""
    found = re.search(r"(\d+) instructions in a step, at most (\d+); (\d+) bytes of stack", text)
    assert found is not None
    return [int(number) for number in found.groups()]


def traced(folder: Path, machine: str, steps: int) -> tuple[int, int]:
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
    for place in places(folder, BOARDS[machine][0], watched):
        if last is not None:
            cycles += cost_of(code[last][1], place != last + code[last][0], machine)
        begun += place == step
        if begun > steps:
            break
        inside = code[place][2] != caller and begun > 0
        last = place if inside else None
        counted += inside
    return counted, cycles


def places(folder: Path, board: str, watched: str) -> Iterator[int]:
    """Addresses of the instructions that QEMU runs there, one after the other."""
    pipe = folder / "trace"
    os.mkfifo(pipe)
    command = [
        *emulated(board), "-semihosting-config", "enable=on,target=native", *single_steps(),
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


#: Cycles of an instruction, by the beginning of its mnemonic; the first that fits counts. Of the Cortex-M4F: Arm
#: Cortex-M4 Processor Technical Reference Manual, tables of the processor's and the floating-point unit's instructions.
#: Of the Cortex-M7: latencies of LLVM's scheduling model, ``ARMScheduleM7.td``, from the operands to the result; loads
#: are those with late data, stores and shifts those whose operands are read early.
CYCLES = {
    "Cortex-M4F": (
        ("vdiv", 14), ("vsqrt", 14), ("vfma", 3), ("vfms", 3), ("vfnm", 3), ("vmla", 3), ("vmls", 3), ("vnmla", 3),
        ("vnmls", 3), ("vldr", 2), ("vstr", 2), ("sdiv", 12), ("udiv", 12), ("mla", 2), ("mls", 2), ("tbb", 2),
        ("tbh", 2), ("ldrd", 3), ("strd", 3), ("ldr", 2), ("str", 2), ("", 1),
    ),
    "Cortex-M7": (
        ("vdiv.f64", 30), ("vsqrt.f64", 30), ("vdiv", 16), ("vsqrt", 16),
        *((f"v{name}.f64", 11) for name in ("fma", "fms", "fnma", "fnms", "mla", "mls", "nmla", "nmls")),
        *((f"v{name}", 6) for name in ("fma", "fms", "fnma", "fnms", "mla", "mls", "nmla", "nmls")),
        ("vmul.f64", 7), ("vnmul.f64", 7), ("vldr", 3), ("vstr", 3), ("v", 4), ("sdiv", 7), ("udiv", 7),
        ("ldrd", 4), ("strd", 4), ("ldr", 3), ("str", 3), ("", 2),
    ),
}  # fmt: skip

#: Cycles that refill the pipeline where the next instruction is another one: one to three, and six of the Cortex-M7
#: where it did not foresee the jump.
REFILL = {"Cortex-M4F": 3, "Cortex-M7": 6}


@cache
def cost_of(text: str, jumps: bool, machine: str = "Cortex-M4F") -> int:
    """Cycles at the most: loads are not pipelined, and every jump refills the whole pipeline."""
    mnemonic = text.split()[0]
    refill = REFILL[machine] if jumps else 0
    if re.match(r"(ldm|stm|push|pop|vldm|vstm|vpush|vpop)", mnemonic):
        return 1 + 2 * (machine == "Cortex-M7") + transferred(text) + refill
    wide = re.match(r"v(ldr|str)|vmov", mnemonic) is not None and re.search(r"\bd\d", text) is not None
    cycles = next(count for start, count in CYCLES[machine] if mnemonic.startswith(start))
    return cycles + (wide and machine == "Cortex-M4F") + refill


def transferred(text: str) -> int:
    """Words of a list of registers, ``{r4, r5, pc}`` or ``{d8-d10}``."""
    words = 0
    for part in text.split("{")[1].split("}")[0].split(","):
        ends = [int(number) for number in re.findall(r"\d+", part)]
        count = ends[1] - ends[0] + 1 if "-" in part else 1
        words += count * (2 if part.strip().startswith("d") else 1)
    return words


# The tables ---------------------------------------------------------------------------------------------
def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows of the exported C, with what compiled and counted them, and what other flags change."""
    rows = [row for row in rows if not row["program"]]
    lines = [
        "| links, law | type | machine | code and constants | state | stack "
        "| instructions a step: test vector, rehearsal | µs a step "
        "| cycles of the test vector, at most | of 1 ms at 168 MHz |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [named(row["links"]), row["real"], row["machine"]]
        cells += [kilobytes(row["code"]), kilobytes(row["state"])]
        cells += [kilobytes(row["stack"]), f"{row['instructions']:,.0f}"]
        cells.append(f"{row['microseconds']:.1f}" if "microseconds" in row else "")
        if "most" in row:
            cells[-2] += f" (at most {row['most']:,}, {row['rehearsed']:,})"
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
    return "\n".join([*lines, "", *designs, *made, *notes(rows)])


def named(links: int | str) -> str:
    """A design by its links and the kind of its law."""
    words = DESIGNS[links]
    law = "modal" if "workspace" in words else "linear" if "--degrees 2" in words else "cubic"
    return f"{str(links)[0]}, {law}"


def notes(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What other flags change: the stack, and instructions without fused multiply-adds."""
    own = [row for row in rows if row["real"] == "double"]
    stacks = {
        machine: ", ".join(
            f"{kilobytes(row['stacks'][0])} to {kilobytes(row['stacks'][1])} ({named(row['links'])})"
            for row in own
            if row["machine"] == machine
        )
        for machine in ("x86-64", "Cortex-M7")
    }
    small = next(row for row in rows if (row["real"], row["machine"]) == ("float", "Cortex-M4F"))
    cycles, most, period = small["cycles"], small["most"], CLOCK / RATE
    worst = [row["rehearsed"] / row["most"] for row in rows if "most" in row]
    fusing = [(row["links"], *row["fusing"]) for row in own if "fusing" in row]
    pairs = ", ".join(f"{plain:,.0f} for {fused:,.0f} ({named(links)})" for links, plain, fused in fusing)
    ratios = ", ".join(f"{plain / fused:.1f}" for _, plain, fused in fusing)
    equal = [row["vectors"][0] / row["vectors"][1] for row in own if "vectors" in row]
    lengths = (
        " With vectors of one length (`gcc -O2 -mavx2` against `-O2 -mavx2 -mfma`) it is "
        f"{', '.join(f'{ratio:.2f}' for ratio in equal)} times."
    )
    return [
        f"- The stack in `double` from `{LEVELS[0]}` to `{LEVELS[-1]}`, computed on x86-64: {stacks['x86-64']}. On a "
        f"Cortex-M7 {stacks['Cortex-M7']}.",
        "- Without fused multiply-adds (`gcc -O2`) a step in `double` takes more instructions on x86-64 than with "
        f"(`gcc -O2 -mfma`): {pairs}. That is {ratios} times as many.{lengths * bool(equal)}",
        *(duration(row) for row in own if row["links"] == 7 and "times" in row),
        f"- In `float` on the Cortex-M4F ({named(small['links'])}) an instruction takes {cycles / most:.1f} cycles on "
        f"average. A step of the test vector takes at most {100 * cycles / period:.0f} % of 1 ms at 168 MHz, and "
        f"with five cycles of waiting for every instruction {100 * (cycles + 5 * most) / period:.0f} %.",
        f"- The longest steps are those of the rehearsal: {min(worst):.1f} to {max(worst):.1f} times as many "
        "instructions as the longest one of the test vector, and at the same cost of each so many times its cycles. "
        "Leave room for them, not for those of the test vector.",
    ]


def duration(row: Mapping[str, Any]) -> str:
    """How long a step takes, by flags and compilers."""
    times: dict[str, list[str]] = {}
    for compiler, flags, time in row["times"]:
        times.setdefault(flags, []).append(f"{time:.0f} ({compiler})")
    each = "; ".join(f"with `{flags}` {', '.join(found)}" for flags, found in times.items())
    return f"- A step in `double` ({named(row['links'])}) takes, in µs on {row['processor']}: {each}."


def key(row: Mapping[str, Any]) -> tuple[int | str, str, str, str]:
    """Which of `ROWS` it is."""
    return row["links"], row["real"], row["machine"], row["program"]


def main() -> int:
    """Measure and keep, or print a table."""
    tables = {
        "exported": lambda: table(kept_rows(KEPT)),
        "peers": lambda: firmware_peers.table(kept_rows(KEPT)),
        "tests": lambda: firmware_tests.table(kept_rows(firmware_tests.KEPT)),
        "trajectories": lambda: firmware_trajectories.table(kept_rows(firmware_trajectories.KEPT)),
        "worst": lambda: firmware_worst.table(kept_rows(firmware_worst.KEPT)),
    }
    parser = argparse.ArgumentParser(prog="python -m benchmarks.firmware", description=__doc__)
    parser.add_argument(
        "--table", nargs="?", const="exported", choices=tables, help="print rows that are kept"
    )
    parser.add_argument(
        "--only",
        choices=[*map(str, DESIGNS), "peers", "tests", "trajectories", "worst"],
        help="the rows of one design, of peers, of tests, of trajectories or of the longest steps",
    )
    parser.add_argument("--counted", action="store_true", help="leave times as they are kept")
    wanted = parser.parse_args()
    if wanted.only == "tests":
        firmware_tests.keep(controller)
        wanted.table = "tests"
    if wanted.only == "trajectories":
        firmware_trajectories.keep()
        wanted.table = "trajectories"
    if wanted.only == "worst":
        firmware_worst.keep(controller)
        wanted.table = "worst"
    if wanted.table is None:
        known = {key(row): row for row in kept_rows(KEPT)}
        for row in ROWS:  # kept one by one
            if wanted.only in (None, "peers" if row[3] else str(row[0])):
                before = known.get(row, {})
                times = {name: before[name] for name in TIMES if name in before and wanted.counted}
                known[row] = measure(*row, clock=not times) | times
                print(json.dumps(known[row]), flush=True)
                rows = [known[row] for row in ROWS if row in known]
                keep_rows(KEPT, rows)
    print(tables[wanted.table or "exported"]())
    return 0


if __name__ == "__main__":
    sys.exit(main())
