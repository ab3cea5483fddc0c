"""C to WebAssembly by clang and wasm-ld, without a C library: the page imports the few functions that are left."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

from flexhinf.errors import refuse_if
from flexhinf.export.c_library import mathematics
from flexhinf.export.programs import run

#: Of clang: every product and sum as it is written, so that the numbers do not depend on the browser.
FLAGS = ("--target=wasm32", "-std=c99", "-O3", "-ffp-contract=off", "-nostdlib", "-fvisibility=hidden")
LINKED = ("-Wl,--no-entry", "-Wl,--allow-undefined", "-Wl,--strip-all", "-Wl,-z,stack-size=1048576")


def check_compiler() -> str:
    """The path of clang. Raises InvalidInput where clang or wasm-ld is missing, or cannot make WebAssembly."""
    found = {name: shutil.which(name) for name in ("clang", "wasm-ld")}
    missing = [name for name, path in found.items() if path is None]
    refuse_if(
        missing,
        "The page needs a compiler for WebAssembly.",
        f"expected clang and wasm-ld on the PATH, found no {' and no '.join(missing)}",
        "install both: apt install clang lld (Debian, Ubuntu), dnf install clang lld (Fedora), brew install llvm lld "
        "(macOS)",
    )
    return str(found["clang"])


def webassembly(sources: Mapping[str, str]) -> bytes:
    """The module of some C files, by name. Raises InvalidInput where they cannot be compiled, or the page lacks a
    function that they call."""
    clang = check_compiler()
    header = (files("flexhinf.export.web") / "math.h").read_text(encoding="utf-8")
    known = set[str](re.findall(r"\w+", header))
    lacking = [name for name in mathematics("\n".join(sources.values())) if name not in known]
    refuse_if(
        lacking,
        "The page lacks a function of the C library that the model calls.",
        f"expected those that JavaScript has, got {', '.join(lacking)}",
        "a model without it; flexhinf export c and flexhinf export fmu take it",
    )
    with TemporaryDirectory() as work:
        folder = Path(work)
        for name, text in {**sources, "math.h": header}.items():
            (folder / name).write_text(text, encoding="utf-8")
        names = [name for name in sources if name.endswith(".c")]
        command = [clang, *FLAGS, "-isystem", ".", *LINKED, *names, "-o", "module.wasm"]
        run(
            command,
            folder,
            "The code of the page cannot be compiled to WebAssembly.",
            "clang and lld of the same version, 11 or later; flexhinf export c shows the controller's C",
        )
        return (folder / "module.wasm").read_bytes()
