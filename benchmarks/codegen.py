"""``make bench-codegen``: what code generation gives, and how long its own text is, for docs/architecture.md.

    python -m benchmarks.codegen                 measures every program, and keeps the rows in benchmarks/codegen.json
    python -m benchmarks.codegen --keep FOLDER   keeps controllers and exported C there too; controllers that are there
                                                 already are taken, so that two checkouts are compared by `diff -r`
    python -m benchmarks.codegen --only 7w       measures one, and keeps its row in the place of the old
    python -m benchmarks.codegen --table         prints the tables of the rows that are kept

Counted, not timed: instructions of the object code, those of a step by callgrind, the stack along the deepest calls,
and what MISRA C:2012 finds that is not listed with a reason. Times are of the processor, in this process and in gcc.
What stands under "before" in the file is not measured again: the text at its commit, before templates in jinja2 and one
front end, and the first rows that were kept.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import flexhinf as fh
from benchmarks import firmware
from flexhinf.export import export_c

KEPT = Path(__file__).resolve().with_suffix(".json")
PACKAGE = Path(fh.__file__).resolve().parent

#: Rooms whose text is counted, and the files of each.
ROOMS = {
    "codegen": ("codegen/**/*.py",),
    "loops of the solver": tuple(f"hinf/{name}.py" for name in ("contraction", "pairs", "products")),
    "kernel of the checker": ("certify/kernel.py",),
    "export": ("export/**/*.py",),
}
TEMPLATES = ("export/templates", "codegen/c/templates")


def main() -> int:
    """Measure and keep, or print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.codegen", description=__doc__)
    parser.add_argument("--keep", type=Path, help="a folder for controllers and their C")
    parser.add_argument("--only", choices=[*map(str, firmware.DESIGNS)], help="the row of one controller")
    parser.add_argument("--table", action="store_true", help="print rows that are kept")
    wanted = parser.parse_args()
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {"programs": []}
    if not wanted.table:
        rows = {row["links"]: row for row in kept["programs"]}
        with tempfile.TemporaryDirectory() as work:
            for links in firmware.DESIGNS:  # kept one by one
                if wanted.only in (None, str(links)):
                    rows[links] = measured(links, wanted.keep or Path(work))
                    known = [rows[links] for links in firmware.DESIGNS if links in rows]
                    kept |= {"programs": known, "text": lengths()}
                    KEPT.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    print(table(kept))
    return 0


def measured(links: int | str, folder: Path) -> dict[str, Any]:
    """A row: a controller's C in double, and its machine code."""
    saved, target = folder / f"{links}.controller", folder / f"{links}"
    if not saved.exists():
        folder.mkdir(parents=True, exist_ok=True)
        firmware.controller(links).save(saved)
    kernel, controller = machine_code(saved), fh.load_controller(saved)
    writing = seconds(lambda: export_c(controller, target, "arm", "double", force=True, limits=False))
    source = (target / "arm.c").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as work:
        copy = export_c(controller, Path(work) / "c", "arm", "double", limits=False)
        each = firmware.counted(copy, firmware.PC)
        gcc = ("gcc", "-std=c99", "-O2", *firmware.LEFT_OUT, "-c", "arm.c", "-o", "arm.o")
        compiling = seconds(lambda: firmware.run(*gcc, folder=copy))
        objects = firmware.run("objdump", "-d", "--no-show-raw-insn", "arm.o", folder=copy)
        broken = firmware.run("make", "-s", "misra", folder=copy).splitlines()
        return {
            "links": links,
            "lines": len(source.splitlines()),
            "functions": len(re.findall(r"^(?:static )?\w+ \w+\([^;]*$", source, re.MULTILINE)),
            "instructions": len(re.findall(r"^\s+[0-9a-f]+:\s", objects, re.MULTILINE)),
            "step": each,
            "stack": firmware.stack(copy, "gcc", firmware.PC),
            "misra": sum("misra-c2012" in line for line in broken),
            "writing": writing,
            "gcc": compiling,
            "kernel": kernel,
        }


def machine_code(saved: Path) -> float:
    """Seconds to trace a step and to compile it, with nothing in the cache."""
    code = (
        "import sys, time, numpy, flexhinf\n"
        "controller = flexhinf.load_controller(sys.argv[1])\n"
        "begin = time.process_time()\n"
        "controller.step(numpy.zeros(len(controller.measured)))\n"
        "print(time.process_time() - begin)"
    )
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "FLEXHINF_CACHE": cache}
        words = [sys.executable, "-c", code, str(saved)]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout)


def seconds(work: Callable[[], object]) -> float:
    """Of the processor, in this process and in those that it starts."""

    def now() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.process_time() + children.ru_utime + children.ru_stime

    begin = now()
    work()
    return now() - begin


def statements(source: str) -> Iterator[ast.stmt]:
    """Those of a file but its docstrings."""
    for node in ast.walk(ast.parse(source)):
        docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.stmt) and not docstring:
            yield node


def lengths() -> dict[str, int]:
    """Statements of each room of `ROOMS`, and lines of templates."""
    files = {
        room: {file for pattern in patterns for file in PACKAGE.glob(pattern)}
        for room, patterns in ROOMS.items()
    }
    counts = {
        f"statements of {room}": sum(sum(1 for _ in statements(file.read_text("utf-8"))) for file in own)
        for room, own in files.items()
    }
    templates = (file for folder in TEMPLATES for file in (PACKAGE / folder).rglob("*") if file.is_file())
    lines = sum(len(file.read_text("utf-8").splitlines()) for file in templates)
    return counts | {"lines of templates": lines}


def table(kept: Mapping[str, Any]) -> str:
    """Both tables: of the programs, and of the text."""
    before = kept.get("before", {"programs": {}, "text": {}})
    rows = [
        "| controller | C: lines, functions | instructions | of a step (× before) | stack (before) | MISRA "
        "| seconds: writing, gcc, kernel |",
        "|---|---|---:|---:|---:|---:|---|",
    ]
    for row in kept["programs"]:
        times = ", ".join(f"{row[name]:.1f}" for name in ("writing", "gcc", "kernel"))
        step, stack = f"{row['step']:,.0f}", f"{row['stack']:,}"
        if old := before["programs"].get(str(row["links"])):
            step, stack = f"{step} (× {row['step'] / old['step']:.2f})", f"{stack} ({old['stack']:,})"
        rows.append(
            f"| {firmware.named(row['links'])} | {row['lines']:,}, {row['functions']} | {row['instructions']:,} "
            f"| {step} | {stack} | {row['misra']} | {times} |"
        )
    text = ["| text | before | now |", "|---|---:|---:|"]
    for what, number in kept["text"].items():
        old = before["text"].get(what)
        text.append(f"| {what} | {'' if old is None else f'{old:,}'} | {number:,} |")
    return "\n".join([*rows, "", *text])


if __name__ == "__main__":
    sys.exit(main())
