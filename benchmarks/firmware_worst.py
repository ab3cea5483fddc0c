"""The longest steps of the exported C on a PC, and a bound of all that could meet in one, for firmware_study.md.

``python -m benchmarks.firmware --only worst`` measures the rows and keeps them in benchmarks/firmware_worst.json.
callgrind counts every instruction of every step of the test vector and of the rehearsal. The *bound* takes each
instruction as often as it ran in the step that ran it most, and adds them up. Loops end at constants, so no step that
takes only branches that were seen takes more; a branch that nothing reached is not in it.
"""

from __future__ import annotations

import bisect
import json
import re
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import flexhinf as fh
from benchmarks.firmware_tools import PC, run
from benchmarks.record import keep_rows, kept_rows
from flexhinf.export import export_c

KEPT = Path(__file__).resolve().with_suffix(".json")

#: Limit of the inputs, V.
LIMIT = 48.0

#: What is exported: links and type.
ROWS = ((1, "double"), (1, "float"), (2, "double"), (2, "float"))

#: Calls in what callgrind writes, whose lines have costs of the functions that are called; and an instruction.
CALLED = re.compile(r"^calls=.*\n.*\n", re.MULTILINE)
COUNT = re.compile(r"^(0x[0-9a-f]+) (\d+)$", re.MULTILINE)


def measured(controller: fh.Controller, links: int, real: str) -> dict[str, Any]:
    """Instructions of the longest step of the test vector and of the rehearsal, and the bound."""
    with tempfile.TemporaryDirectory() as work:
        folder = export_c(controller.fresh(saturation=LIMIT), Path(work) / "c", "arm", real)
        run("gcc", *PC, "-S", "arm.c", "-o", "arm.s", folder=folder)
        # of two codes of this move, the assembler takes one that valgrind 3.19 does not know
        text = (folder / "arm.s").read_text(encoding="utf-8")
        (folder / "arm.s").write_text(text.replace("\tvmovq\t%xmm", "\t{load} vmovq\t%xmm"), encoding="utf-8")
        run("gcc", "-c", "arm.s", "-o", "arm.o", folder=folder)
        most, longest = dict[tuple[str, int], int](), dict[str, int]()
        for name in ("test", "contract"):
            # without a loader, whose first calls would count too
            run("gcc", *PC, "-static", f"arm_{name}.c", "arm.o", "-lm", "-o", name, folder=folder)
            longest[name], own = 0, dict[str, int]()
            for counts in steps(folder, name):
                longest[name] = max(longest[name], sum(counts.values()))
                own.update((place, count) for place, count in counts.items() if count > own.get(place, 0))
            for place, count in in_functions(folder, name, own):
                most[place] = max(most.get(place, 0), count)
    return {"links": links, "real": real, "vector": longest["test"], "rehearsal": longest["contract"],
            "bound": sum(most.values())}  # fmt: skip


def steps(folder: Path, name: str) -> Iterator[dict[str, int]]:
    """How often each instruction ran, by its address, in every step of a program."""
    out = folder / f"counts_{name}"
    out.mkdir()
    options = (
        "--tool=callgrind", "--collect-atstart=no", "--toggle-collect=arm_step", "--dump-after=arm_step",
        "--dump-instr=yes", "--dump-line=no", "--compress-pos=no", "--compress-strings=no",
        f"--callgrind-out-file={out / 'step'}",
    )  # fmt: skip
    # valgrind 3.19 loses the sign of a zero in a fused multiply-add, so a test may fail there; it goes on
    done = subprocess.run(
        ["valgrind", *options, f"./{name}"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode in (0, 1), done.stderr
    assert any(out.iterdir()), done.stderr
    for file in out.iterdir():
        yield counts_in(file.read_text(encoding="utf-8"))
        file.unlink()


def counts_in(text: str) -> dict[str, int]:
    """How often each instruction ran, by its address, of one file of callgrind."""
    counts = dict[str, int]()
    for place, count in COUNT.findall(CALLED.sub("", text)):
        counts[place] = counts.get(place, 0) + int(count)
    return counts


def in_functions(folder: Path, name: str, counts: Mapping[str, int]) -> Iterator[tuple[tuple[str, int], int]]:
    """The counts by function and place in it: both programs have the same step, at other addresses."""
    found = (line.split() for line in run("nm", name, folder=folder).splitlines())
    starts = sorted(
        (int(words[0], 16), words[2]) for words in found if words[1] in "tTiWw" and len(words) == 3
    )
    addresses = [start for start, _ in starts]
    for place, count in counts.items():
        start, function = starts[bisect.bisect_right(addresses, int(place, 16)) - 1]
        yield (function, int(place, 16) - start), count


def keep(one_pose: Callable[[int], fh.Controller]) -> None:
    """Measure all and keep them. `one_pose`: The controller of a design, by the number of links."""
    known = {(row["links"], row["real"]): row for row in kept_rows(KEPT)}
    for links, real in ROWS:
        known[links, real] = measured(one_pose(links), links, real)
        print(json.dumps(known[links, real]), flush=True)
        keep_rows(KEPT, [known[row] for row in ROWS if row in known])


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows, with the bound against the longest step."""
    lines = ["| links, type | test vector | rehearsal | bound |", "|---|---|---|---|"]
    for row in rows:
        ratio = row["bound"] / max(row["vector"], row["rehearsal"])
        lines.append(
            f"| {row['links']}, {row['real']} | {row['vector']:,} | {row['rehearsal']:,} "
            f"| {row['bound']:,} ({ratio:.2f} times) |"
        )
    return "\n".join(lines)
