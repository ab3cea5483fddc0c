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
from flexhinf.export.controller_c import ControllerCode, fill
from flexhinf.export.package import code_of
from flexhinf.files import write_file
from flexhinf.loop import Controller
from flexhinf.untrusted import checked_path

__all__ = ["compile_controller", "shared_library"]

#: What a loader calls, beside init, start and step.
ENTRY = """#include "@NAME@.h"
#include <stddef.h>
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
EXPORT const char *flexhinf_description(void) { return @DESCRIPTION@; }
EXPORT size_t flexhinf_state_size(void) { return sizeof(@NAME@_state); }
EXPORT void flexhinf_start(void *state, const double *estimate, const double *input)
{
    @NAME@_start(state, &@NAME@_defaults, estimate, input);
}
EXPORT int flexhinf_step(void *state, const double *y, const double *r, int measured, double *u, double *estimate)
{
    @NAME@_input input = {0};
    @NAME@_output output;
    int code;
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        input.y[i] = y[i];
    }
    for (int i = 0; i < @BIG@_COMMANDS; ++i) {
        input.r[i] = r[i];
    }
    input.measured = measured;
    code = @NAME@_step(state, &@NAME@_defaults, &input, &output);
    for (int i = 0; i < @BIG@_INPUTS; ++i) {
        u[i] = output.u[i];
    }
    for (int i = 0; i < @BIG@_STATES; ++i) {
        estimate[i] = output.estimate[i];
    }
    return code;
}
"""


def compile_controller(controller: Controller, path: str | os.PathLike[str]) -> Path:
    """Compile a controller into one shared library for this machine, see `flexhinf.load_compiled`.

    Parameters
    ----------
    controller : Controller
    path : path
        Of the file; replaced if it is there. It is machine code: load only what you trust.

    Raises
    ------
    InvalidInput
        As `export_c`; or there is no C compiler (``CC``, cc, gcc, clang), or it fails.
    """
    target = checked_path("The library", path)
    code = code_of(controller, "controller", "double")
    sources = {"controller.h": code.header, "controller.c": code.source, "entry.c": _entry(code)}
    try:
        image = shared_library(sources, ("-O3", "-march=native"))
    except InvalidInput:  # some compilers do not know this machine by that name
        image = shared_library(sources, ("-O3",))
    write_file(target, "library", lambda part: Path(part).write_bytes(image))
    return target


def _entry(code: ControllerCode) -> str:
    c = code.controller
    about: dict[str, Any] = {
        "what": "flexhinf controller", "version": __version__, "period": c.period, "measured": c.measured,
        "commanded": c.commanded, "inputs": c.law.input_names, "states": c.states, "units": code.units,
        "reference": c.operating_reference.tolist(), "codes": {str(v): name for name, (v, _) in code.codes.items()},
        "starts_anywhere": code.starts_anywhere,
    }  # fmt: skip
    text = json.dumps(json.dumps(about))  # twice: a string of C is one of JSON in ASCII
    return fill(ENTRY, code.name, code.real, DESCRIPTION=text.replace("??", '?""?'))


def shared_library(sources: dict[str, str], flags: tuple[str, ...] = ("-O2",)) -> bytes:
    """What this machine's C compiler makes of some files.

    Raises
    ------
    InvalidInput
        If there is none, or it fails.
    """
    names = (os.environ.get("CC", "cc"), "cc", "gcc", "clang")
    compiler = next(filter(None, map(shutil.which, names)), None)
    if compiler is None:
        raise InvalidInput(
            "There is no C compiler.",
            "expected the one that CC names, cc, gcc or clang, found none",
            "install one; or `flexhinf export c`, which needs none",
        )
    with TemporaryDirectory() as work:
        for file, text in sources.items():
            (Path(work) / file).write_text(text, encoding="utf-8")
        files = [file for file in sources if file.endswith(".c")]
        words = [
            compiler,
            "-std=c99",
            *flags,
            "-shared",
            "-fPIC",
            "-fvisibility=hidden",
            *files,
            "-lm",
            "-o",
            "library",
        ]
        done = subprocess.run(words, cwd=work, capture_output=True, text=True, check=False)
        if done.returncode:
            raise InvalidInput(
                "The C compiler does not compile the controller.",
                f"{' '.join(words)}: {done.stderr.strip()[:400]}",
                "another compiler in CC",
            )
        return (Path(work) / "library").read_bytes()
