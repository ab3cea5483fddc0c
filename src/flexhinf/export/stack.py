"""The stack of a step, computed: what the compiler says of every function, added up along the deepest calls."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from flexhinf.codegen.compiler import cached, highest_optimisation
from flexhinf.errors import NumericalFailure
from flexhinf.export.programs import run, unusable

#: Compilers of the GNU family, for which machine, and flags of it; a double is one of the M7's own.
MACHINES = {
    "double": (
        (
            "arm-none-eabi-gcc",
            "Cortex-M7",
            ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16"),
        ),
        ("gcc", "this PC", ()),
    ),
    "float": (
        (
            "arm-none-eabi-gcc",
            "Cortex-M4F",
            ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"),
        ),
        ("gcc", "this PC", ()),
    ),
}

#: Flags of gcc, of version 10 or later, by which it tells the stack of each function beside the code.
CALL_GRAPH = ("-fcallgraph-info=su", "-S")

#: How the room of a call is told, and who calls whom.
NODE = re.compile(r'node: { title: "([^"]+)" label: "[^"]*\\n(\d+) bytes \((static|dynamic,bounded)\)')
EDGE = re.compile(r'edge: { sourcename: "([^"]+)" targetname: "([^"]+)"')

#: What the number leaves out.
BESIDE = "without functions of the C library"


def stack_text(files: Mapping[str, str], name: str, real: str) -> str:
    """The stack of ``NAME_step`` by machine, with what computed it, for a README; why where nothing can.

    `files`: Texts of the exported header and source by name. `real`: "double" or "float". Raises InvalidInput: a
    compiler that can fails.
    """
    level, sizes, reasons = f"-O{min(2, highest_optimisation())}", list[str](), list[str]()
    for compiler, machine, flags in MACHINES[real]:
        if reason := why_not(compiler, (level, *flags)):
            reasons.append(reason)
        else:
            size = _kept_bytes(files, f"{name}_step", compiler, (level, *flags))
            sizes.append(f"{size} bytes on {machine} ({compiler} {level})")
    if not sizes:
        return f"not computed: {'; '.join(reasons)}"
    return f"{', '.join(sizes)}; computed from -fcallgraph-info=su along the deepest calls, {BESIDE}"


def why_not(compiler: str, flags: tuple[str, ...]) -> str:
    """Why a compiler tells no stack with these flags; "" where it does."""
    if shutil.which(compiler) is None:
        return f"{compiler} was not found"
    return unusable([compiler], [*flags, *CALL_GRAPH])


def _kept_bytes(files: Mapping[str, str], function: str, compiler: str, flags: tuple[str, ...]) -> int:
    """`stack_bytes`, from the cache of compiled code where this source was seen before: it is most of an export."""
    source = (text for item in sorted(files.items()) for text in item)

    def size() -> bytes:
        return str(stack_bytes(files, function, compiler, flags)).encode()

    place = str(shutil.which(compiler))
    return int(cached(("stack", place, _version(place), function, *flags, *source), size))


@cache
def _version(place: str) -> str:
    """What the compiler at a place says of itself."""
    return run([place, "--version"], Path(), "A compiler does not tell its version.", "install it again")


def stack_bytes(files: Mapping[str, str], function: str, compiler: str, flags: tuple[str, ...]) -> int:
    """Bytes of stack of a function and all that it calls, but for other libraries.

    Raises InvalidInput: the compiler fails, see `why_not`. NumericalFailure: a function calls itself, or needs room
    that the compiler does not bound.
    """
    with TemporaryDirectory() as work:
        for name, text in files.items():
            (Path(work) / name).write_text(text, encoding="utf-8")
        source = next(name for name in files if name.endswith(".c"))
        command = [compiler, "-std=c99", *flags, *CALL_GRAPH, source, "-o", "code.s"]
        run(command, Path(work), "The C compiler does not compile the controller.", "another version of it")
        return deepest((Path(work) / "code.ci").read_text(encoding="utf-8"), function)


def deepest(graph: str, function: str) -> int:
    """Bytes of the deepest calls of a function, from the text of a call graph of gcc; raises as `stack_bytes`."""
    own = {title: int(size) for title, size, _ in NODE.findall(graph)}
    if "bytes (dynamic)" in graph:
        raise _unbounded("a function's stack has no bound")
    calls: dict[str, set[str]] = {}
    for caller, called in EDGE.findall(graph):
        calls.setdefault(caller, set()).add(called)

    @cache
    def below(title: str) -> int:
        return own.get(title, 0) + max(map(below, calls.get(title, ())), default=0)

    start = next(title for title in own if title.rpartition(":")[2] == function)
    if any(title in set(_reached(title, calls)) for title in own):
        raise _unbounded("a function calls itself")
    return below(start)


def _reached(title: str, calls: Mapping[str, set[str]]) -> Iterator[str]:
    """All functions that one calls, itself only if it does."""
    seen: set[str] = set()
    waiting = list(calls.get(title, ()))
    while waiting:
        called = waiting.pop()
        if called not in seen:
            seen.add(called)
            waiting += calls.get(called, ())
            yield called


def _unbounded(what: str) -> NumericalFailure:
    return NumericalFailure(
        "The stack of the exported C has no bound.", what, "report it: no exported C does so"
    )
