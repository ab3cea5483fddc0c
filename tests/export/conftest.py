"""Exported controllers, compiled and called from here."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller

import flexhinf as fh
from flexhinf.export import export_c
from flexhinf.export.compiled import compiler_flags, limited
from flexhinf.export.controller_c import code_of
from flexhinf.export.package import FILES, RECORDED, Export, files_of, write_files
from flexhinf.export.self_test import Accuracy

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror")

#: Calls the step sample by sample, on arrays.
SHIM = """
#include "arm.h"
void replay(int samples, const arm_real *y, const arm_real *r, const int *measured, arm_real *u, arm_real *x,
            int *codes)
{
    static arm_state state;
    arm_init(&state);
    for (int k = 0; k < samples; ++k) {
        arm_input input = {0};
        arm_output output = {0};
        for (int i = 0; i < ARM_MEASUREMENTS; ++i) input.y[i] = y[k * ARM_MEASUREMENTS + i];
        for (int i = 0; i < ARM_COMMANDS; ++i) input.r[i] = r[k * ARM_COMMANDS + i];
        input.measured = measured[k];
        codes[k] = arm_step(&state, &arm_defaults, &input, &output);
        for (int i = 0; i < ARM_INPUTS; ++i) u[k * ARM_INPUTS + i] = output.u[i];
        for (int i = 0; i < ARM_STATES; ++i) x[k * ARM_STATES + i] = output.estimate[i];
    }
}
"""


@dataclass(frozen=True)
class Compiled:
    """An exported controller in a shared library."""

    library: ctypes.CDLL
    folder: Path
    kind: np.dtype

    def replay(
        self, y: np.ndarray, r: np.ndarray, measured: np.ndarray, inputs: int, states: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Inputs, estimates and codes of these samples."""
        y, r = (np.ascontiguousarray(array, dtype=self.kind) for array in (y, r))
        measured = np.ascontiguousarray(measured, dtype=np.intc)
        u, x = (np.zeros((len(y), size), dtype=self.kind) for size in (inputs, states))
        codes = np.zeros(len(y), dtype=np.intc)
        pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in (y, r, measured, u, x, codes))
        self.library.replay(len(y), *pointers)
        return u, x, codes


@pytest.fixture(scope="session")
def controller() -> fh.Controller:
    """The paper's arm with a cubic law and the unscented filter."""
    return arm_controller(degree=4)


@pytest.fixture(scope="session")
def compiler() -> str:
    """A C compiler; without one there is nothing to compare."""
    found = shutil.which("gcc") or shutil.which("cc")
    if found is None:
        pytest.skip("missing: a C compiler")
    return found


#: Of a controller, its type and its robot: where it is exported.
Exporter = Callable[..., Path]


def _shared(
    write: Callable[[Path, fh.Controller, str, fh.Robot | None], Any], places: Any, name: str
) -> Exporter:
    """Exports as "arm" into a folder of its own, by `write`; what was exported before is copied."""
    made: dict[tuple[int, str, int], tuple[Path, Any, Any]] = {}

    def export(controller: fh.Controller, real: str = "double", robot: fh.Robot | None = None) -> Path:
        key, folder = (id(controller), real, id(robot)), places.mktemp(name) / "c"
        if key not in made:
            pattern = places.mktemp("pattern") / "c"
            write(pattern, controller, real, robot)
            made[key] = pattern, controller, robot  # which keep their numbers
        return Path(shutil.copytree(made[key][0], folder))

    return export


@pytest.fixture(scope="session")
def export_of(tmp_path_factory: pytest.TempPathFactory) -> Exporter:
    """Exports a controller as "arm" into a folder of its own; what was exported before is copied."""
    return _shared(
        lambda place, c, real, robot: export_c(c, place, "arm", real, robot=robot),
        tmp_path_factory,
        "exported",
    )


@pytest.fixture(scope="session")
def sources_of(tmp_path_factory: pytest.TempPathFactory) -> Exporter:
    """As `export_of`, without the files that need a recording, which takes longer than all others."""
    files = [file for file in FILES if file.template not in RECORDED]

    def write(place: Path, controller: fh.Controller, real: str, robot: fh.Robot | None) -> None:
        export = Export(code_of(controller, "arm", real, robot), (), Accuracy((), (), ""), {})
        write_files(place, files_of(export, files))

    return _shared(write, tmp_path_factory, "sources")


@pytest.fixture(scope="session")
def build(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Compiled]:
    """Write a controller as "arm" and compile it without a warning, with the arithmetic of this processor.

    `whole`: With all files of an export, whose test vector takes longer than the code.
    """

    def made(controller: fh.Controller, real: str = "double", whole: bool = False) -> Compiled:
        folder = tmp_path_factory.mktemp("exported")
        if whole:
            folder = export_c(controller, folder / "c", "arm", real, limits=False)
        files = {} if whole else code_of(controller, "arm", real).files
        for name, text in {**files, "shim.c": SHIM}.items():
            (folder / name).write_text(text)
        words = [*STRICT, *compiler_flags("portable"), limited("-O1"), "-shared", "-fPIC"]
        subprocess.run([compiler, *words, "arm.c", "shim.c", "-lm", "-o", "arm.so"], cwd=folder, check=True)
        kind = np.dtype(np.float64 if real == "double" else np.float32)
        return Compiled(ctypes.CDLL(str(folder / "arm.so")), folder, kind)

    return made
