"""A controller as a shared library: compiled once, loaded in milliseconds without LLVM and without CasADi."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from flexhinf import __version__
from flexhinf.errors import InvalidInput
from flexhinf.export.controller_c import ControllerCode, code_of, fill, template
from flexhinf.export.processor import MARK, compiler_flags, named_instructions
from flexhinf.files import write_file
from flexhinf.loop import Controller
from flexhinf.untrusted import checked_path


def compile_controller(
    controller: Controller, path: str | os.PathLike[str], processor: str = "portable"
) -> Path:
    """Compile a controller into one shared library for this platform, see `flexhinf.load_compiled`.

    Parameters
    ----------
    path : path
        Of the file; replaced if it is there. It is machine code: load only what you trust.
    processor : {"portable", "any", "native"}
        On which it runs: PCs since about 2015, also older ones (ten times slower), or those that have all that this one
        has. The bits are the same. The file says what it needs, and is refused where that is missing.

    Raises
    ------
    InvalidInput
        As `export_c`; for another choice of processors; or there is no C compiler (``CC``, cc, gcc, clang), or it
        fails.
    """
    target, flags = checked_path("The library", path), compiler_flags(processor)
    code = code_of(controller, "controller", "double")
    sources = {"controller.h": code.header, "controller.c": code.source, "entry.c": _entry(code)}
    try:
        image = shared_library(sources, ("-O3", *flags))
    except InvalidInput:  # some compilers have no such names
        image = shared_library(sources, ("-O3",))
    write_file(target, "library", lambda part: Path(part).write_bytes(image))
    return target


def _entry(code: ControllerCode) -> str:
    c = code.controller
    about: dict[str, Any] = {
        "what": "flexhinf controller", "version": __version__, "period": c.period, "measured": c.measured,
        "commanded": c.commanded, "inputs": c.law.input_names, "states": c.states, "units": code.units,
        "reference": c.operating_reference.tolist(), "codes": {str(v): name for name, (v, _) in code.codes.items()},
        "starts_anywhere": code.starts_anywhere, "digest": code.digest,
    }  # fmt: skip
    text = json.dumps(json.dumps(about))  # twice: a string of C is one of JSON in ASCII
    return fill(
        template("library.c"), code.name, code.real, MARK=MARK.strip().decode() + r"\n",
        INSTRUCTIONS=named_instructions(), DESCRIPTION=text.replace("??", '?""?'),
    )  # fmt: skip


def shared_library(sources: dict[str, str], flags: tuple[str, ...] = ("-O2",)) -> bytes:
    """What this machine's C compiler makes of some files; raises as `build`."""
    with TemporaryDirectory() as work:
        return build(sources, Path(work), (*flags, "-shared", "-fPIC", "-fvisibility=hidden")).read_bytes()


def cortex_m4_bytes(code: ControllerCode) -> int | None:
    """Code and constants on a Cortex-M4F, with what is used of the C library; None without arm-none-eabi-gcc.

    As `make cortex-m4` of an exported folder says it.
    """
    compiler, size = shutil.which("arm-none-eabi-gcc"), shutil.which("arm-none-eabi-size")
    if compiler is None or size is None:
        return None
    core = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-ffunction-sections")
    used = (f"-Wl,--entry={code.name}_step", f"-Wl,--undefined={code.name}_init", "-Wl,--gc-sections")
    with TemporaryDirectory() as work:
        for file, text in ((f"{code.name}.h", code.header), (f"{code.name}.c", code.source)):
            (Path(work) / file).write_text(text, encoding="utf-8")
        words = [
            compiler,
            "-std=c99",
            "-O2",
            *core,
            f"{code.name}.c",
            "-nostartfiles",
            *used,
            "-lm",
            "-o",
            "alone",
        ]
        if subprocess.run(words, cwd=work, capture_output=True, check=False).returncode:
            return None
        table = subprocess.run([size, "alone"], cwd=work, capture_output=True, text=True, check=True).stdout
    text, data = table.splitlines()[1].split()[:2]
    return int(text) + int(data)


def build(sources: dict[str, str], folder: Path, flags: tuple[str, ...]) -> Path:
    """Compile and link files of C in a folder that is there; the path of what comes of it.

    Raises
    ------
    InvalidInput
        If there is none (``CC``, cc, gcc, clang), or it fails.
    """
    names = (os.environ.get("CC", "cc"), "cc", "gcc", "clang")
    compiler = next(filter(None, map(shutil.which, names)), None)
    if compiler is None:
        raise InvalidInput(
            "There is no C compiler.",
            "expected the one that CC names, cc, gcc or clang, found none",
            "install one; or `flexhinf export c`, which needs none",
        )
    for file, text in sources.items():
        (folder / file).write_text(text, encoding="utf-8")
    files = [file for file in sources if file.endswith(".c")]
    words = [compiler, "-std=c99", *flags, *files, "-lm", "-o", "built"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InvalidInput(
            "The C compiler does not compile the controller.",
            f"{' '.join(words)}: {done.stderr.strip()[:400]}",
            "another compiler in CC",
        )
    return folder / "built"
