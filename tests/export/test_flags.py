"""Whatever the flags of the compiler: the simulation's bits come out, or the compiler or `init` refuses.

gcc defines a macro for most flags that change results; clang for few. Every row is compiled, alone; where it compiles
and `arm_init` returns `ARM_OK`, a recorded loop must come out bit for bit: with the fused multiply-adds of the
processors that the flags name, or without.
"""

from __future__ import annotations

import re
import subprocess
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.builders import arm_controller

import flexhinf as fh
from flexhinf.codegen.c import Real
from flexhinf.codegen.machine import host
from flexhinf.export import export_plant_fmu
from flexhinf.export.controller_c import code_of
from flexhinf.export.recording import record, with_both_roundings
from flexhinf.export.rendering import arithmetic

#: Writes whether multiply-adds are fused; reads y and r as doubles, writes u; 77 where `arm_init` refuses.
PROGRAM = """
#include <stdio.h>
#include "arm.h"
int main(void)
{
    static arm_state state;
    static double given[ARM_MEASUREMENTS + ARM_COMMANDS + 1];
    const int begun = arm_init(&state);
    const double fused = arm_fused;
    fwrite(&fused, sizeof fused, 1, stdout);
    while (fread(given, sizeof given, 1, stdin) == 1) {
        arm_input input = {0};
        arm_output output = {0};
        double u[ARM_INPUTS];
        int code;
        for (int i = 0; i < ARM_MEASUREMENTS; ++i) input.y[i] = (arm_real)given[i];
        for (int i = 0; i < ARM_COMMANDS; ++i) input.r[i] = (arm_real)given[ARM_MEASUREMENTS + i];
        input.measured = given[ARM_MEASUREMENTS + ARM_COMMANDS] != 0.0;
        code = arm_step(&state, &arm_defaults, &input, &output);
        if (begun != ARM_OK && (begun != ARM_BAD_ARITHMETIC || code != begun)) return 1;
        if (begun != ARM_OK && output.u[0] != 0) return 2;
        for (int i = 0; i < ARM_INPUTS; ++i) u[i] = (double)output.u[i];
        fwrite(u, sizeof u, 1, stdout);
    }
    return begun == ARM_OK ? 0 : 77;
}
"""

#: Flags that change results or might, and what must become of them: the same bits, or a refusal by the compiler or by
#: `arm_init`; None for either. Flags behind ``|`` are those of the linker alone.
FLAGS = {
    "-O0": "same",
    "-O1": "same",
    "-O2": "same",
    "-O3": "same",
    "-O3 -march=native": "same",
    "-O0 -mfma -fno-builtin": "same",
    "-O2 -mfma": "same",
    "-O3 -mfma -DARM_PLAIN": "same",
    "-O3 -mfma -DARM_WITHOUT_PRAGMA -ffp-contract=off -fno-tree-slp-vectorize": "same",
    "-O3 -mfma -std=gnu11 -DARM_WITHOUT_PRAGMA": None,
    "-O2 -mfma -ffp-contract=fast": None,
    "-Ofast": "refused",
    "-O2 -ffast-math": "refused",
    "-O2 -ffinite-math-only": "refused",
    "-O2 -funsafe-math-optimizations": "refused",
    "-O2 -fassociative-math -fno-signed-zeros -fno-trapping-math": "refused",
    "-O2 -fassociative-math": None,
    "-O2 -freciprocal-math": "refused",
    "-O2 -fno-signed-zeros": "refused",
    "-O2 -fno-trapping-math": "same",
    "-O2 -frounding-math": "same",
    "-O2 -fno-builtin": "same",
    "-O2 -m32": "refused",
    "-O2 -m32 -ffloat-store": "refused",
    "-O2 -m32 -msse2 -mfpmath=sse": "same",
    "-O2 -m32 -msse2 -mfpmath=sse -mfma": "same",
    "-O2 | -ffast-math": None,  # code of the linker's may set numbers below the normal ones to 0
}
OF_GCC = {
    "-O2 -fsingle-precision-constant": "refused",
    "-O2 -fexcess-precision=standard": "same",
    "-O2 -mfpmath=387": "refused",
    "-O2 -std=gnu11 -ffp-contract=fast -mfma -DARM_PLAIN": "same",
    "-O2 -std=gnu11 -march=sapphirerapids -mno-avx512f": "same",  # its FLT_EVAL_METHOD is 16
}
OF_CLANG = {
    "-O2 -fno-honor-nans": "refused",
    "-O2 -fno-honor-infinities": None,
    "-O2 -fapprox-func": "same",
    "-O2 -ffp-model=fast": "refused",
    "-O2 -ffp-model=strict": None,
    "-O2 -fdenormal-fp-math=preserve-sign": None,
}
CI = pytest.mark.ci("compiles a controller for every row of flags")
NIGHTLY = pytest.mark.nightly("flags of both compilers with the other type of numbers")
#: In CI each compiler has all flags, in turn with one type and the other: so has each type all flags.
ROWS = [
    pytest.param(compiler, flags, real, marks=CI if flags in own or (row + column) % 2 == 0 else NIGHTLY)
    for column, (compiler, own, real) in enumerate(
        [("gcc", OF_GCC, "double"), ("gcc", OF_GCC, "float"), ("clang", OF_CLANG, "float"),
         ("clang", OF_CLANG, "double")]
    )
    for row, flags in enumerate({**FLAGS, **own})
]  # fmt: skip


@pytest.fixture(scope="module")
def exported(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[dict[str, Path], np.ndarray, list[np.ndarray]]:
    """Folders by type; samples (N, p + k + 1); and the inputs of the controller in Python, without and with fused
    multiply-adds."""
    controller = arm_controller()
    run, place = record(controller), tmp_path_factory.mktemp("flags")
    folders = {real: place / real for real in ("double", "float")}
    for real, folder in folders.items():
        folder.mkdir()
        for name, text in {**code_of(controller, "arm", real).files, "replay.c": PROGRAM}.items():
            (folder / name).write_text(text)
    measured = np.array([code != "PREDICTED" for code in run.codes], dtype=float)
    inputs = [one.u for one in with_both_roundings(controller, run)]
    return folders, np.column_stack([run.y, run.r, measured]), inputs


def replayed(
    folder: Path, samples: np.ndarray, compiler: str, flags: str, to: Path
) -> tuple[bool, np.ndarray] | None:
    """Whether the compiled program fuses, and its answers; None where it, or its compiler, refuses."""
    compiled, _, linked = flags.partition("|")
    standard = [] if "-std=" in flags else ["-std=c99"]
    objects = [str(to / "arm.o"), str(to / "replay.o")]
    for file, target in zip(("arm.c", "replay.c"), objects, strict=True):
        words = [compiler, *standard, *compiled.split(), "-c", file, "-o", target]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            assert file == "arm.c", done.stderr
            assert re.search(r"arm (must see|computes what|rounds to)|arm_type_of_constants", done.stderr), (
                done.stderr
            )
            return None
    words = [compiler, *compiled.split(), *linked.split(), *objects, "-lm", "-o", str(to / "replay")]
    subprocess.run(words, cwd=folder, check=True, capture_output=True)
    done = subprocess.run([to / "replay"], input=samples.tobytes(), capture_output=True, check=False)
    assert done.returncode in (0, 77), done.returncode
    if done.returncode:
        return None
    fused, *inputs = np.frombuffer(done.stdout)
    return bool(fused), np.reshape(inputs, (len(samples), -1))


@pytest.fixture(scope="module")
def in_float(
    exported: tuple[dict[str, Path], np.ndarray, list[np.ndarray]], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[bool], np.ndarray]:
    """Inputs of the code in float by plain flags of gcc, with fused multiply-adds or without."""

    @cache
    def plain(fused: bool) -> np.ndarray:
        folders, samples, _ = exported
        to = tmp_path_factory.mktemp("float")
        found = replayed(folders["float"], samples, "gcc", "-O1 -mfma" if fused else "-O1", to)
        assert found is not None
        return found[1]

    return plain


@pytest.mark.oracle
@pytest.mark.parametrize(("compiler", "flags", "real"), ROWS)
def test_flags_change_no_bit_or_are_refused(
    compiler: str,
    flags: str,
    real: str,
    exported: tuple[dict[str, Path], np.ndarray, list[np.ndarray]],
    in_float: Callable[[bool], np.ndarray],
    needs_compiler: Callable[..., None],
    tmp_path: Path,
) -> None:
    needs_compiler(compiler, *flags.replace("|", "").split())
    fusing = any(word in flags for word in ("-mfma", "sapphire", "native")) and "PLAIN" not in flags
    if not host().fused and fusing and "native" not in flags:
        pytest.skip("this processor has no fused multiply-add")
    folders, samples, expected = exported
    outcome = {**FLAGS, **OF_GCC, **OF_CLANG}[flags]
    found = replayed(folders[real], samples, compiler, flags, tmp_path)
    if outcome is not None and (real == "double" or "single-precision" not in flags):
        assert (found is None) == (outcome == "refused")
    if found is None:
        return
    fused, inputs = found
    assert fused == (fusing and host().fused)
    if real == "float":  # its numbers are others than those in Python, and the same whatever the flags
        np.testing.assert_array_equal(inputs, in_float(fused))
    else:
        np.testing.assert_array_equal(inputs, expected[fused])


@pytest.mark.ci("shares the export of the rows of flags")
def test_without_flags_nothing_is_refused(
    exported: tuple[dict[str, Path], np.ndarray, list[np.ndarray]], compiler: str, tmp_path: Path
) -> None:
    folders, samples, expected = exported
    found = replayed(folders["double"], samples, compiler, "-O1", tmp_path)
    assert found is not None
    np.testing.assert_array_equal(found[1], expected[found[0]])


#: Instantiates an FMU: 0 where it is made, 77 where it refuses.
INSTANTIATE = """
#include <stdlib.h>
#include "NAME_fmi2.h"
#include "NAME_model.h"
int main(void)
{
    const fmi2CallbackFunctions call = {0, calloc, free, 0, 0};
    return fmi2Instantiate("one", fmi2CoSimulation, MODEL_GUID, "", &call, 0, 0) != 0 ? 0 : 77;
}
"""


@pytest.mark.ci("builds FMUs")
@pytest.mark.parametrize("kind", ["controller", "plant"])
def test_an_fmu_refuses_such_flags_too(
    kind: str, compiler: str, needs_compiler: Callable[..., None], tmp_path: Path
) -> None:
    """gcc says nothing of this flag alone, and reorders sums."""
    flags = ("-O2", "-fassociative-math")
    needs_compiler("gcc", *flags)
    if kind == "controller":
        path = fh.export_fmu(arm_controller(kind=None), tmp_path / "one.fmu", "one")
    else:
        path = export_plant_fmu(fh.paper_arm().plant(), tmp_path / "one.fmu", "one")
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    sources = tmp_path / "sources"
    (sources / "main.c").write_text(INSTANTIATE.replace("NAME", "one"))
    files = sorted(file.name for file in sources.glob("*.c"))
    for given, code in ((("-O2",), 0), (flags, 77)):
        words = ["gcc", "-std=c99", "-Wno-unused-function", *given, *files, "-lm", "-o", "one"]
        done = subprocess.run(words, cwd=sources, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert subprocess.run(["./one"], cwd=sources, check=False).returncode == code


#: Starts under settings of the processor; 0 where each of them is refused, and the usual one is not.
SETTINGS = """
#include <fenv.h>
#include "arm.h"
#ifdef __SSE2__
#include <xmmintrin.h>
#endif
int main(void)
{
    static arm_state state;
    const int directed[] = {FE_UPWARD, FE_DOWNWARD, FE_TOWARDZERO};
    for (int k = 0; k < 3; ++k) {
        if (fesetround(directed[k]) == 0 && arm_init(&state) != ARM_BAD_ARITHMETIC) return 1 + k;
    }
    fesetround(FE_TONEAREST);
#ifdef __SSE2__
    for (unsigned int bit = 0x40; bit <= 0x8000; bit *= 0x200) { /* numbers below the normal ones as 0: read, written */
        const unsigned int usual = _mm_getcsr();
        _mm_setcsr(usual | bit);
        if (arm_start(&state, &arm_defaults, 0, 0) != ARM_BAD_ARITHMETIC) return 4;
        _mm_setcsr(usual);
    }
#endif
    return arm_init(&state) == ARM_OK ? 0 : 5;
}
"""


@pytest.mark.ci("shares the export of the rows of flags")
@pytest.mark.parametrize("real", ["double", "float"])
def test_a_processor_that_is_set_otherwise_is_noticed(
    real: str, exported: tuple[dict[str, Path], np.ndarray, list[np.ndarray]], compiler: str, tmp_path: Path
) -> None:
    """As a program that is linked with -ffast-math sets it, for every library in it."""
    (tmp_path / "settings.c").write_text(SETTINGS)
    folder = exported[0][real]
    words = [
        compiler,
        "-std=c99",
        "-O1",
        f"-I{folder}",
        "settings.c",
        folder / "arm.c",
        "-lm",
        "-o",
        "settings",
    ]
    subprocess.run(words, cwd=tmp_path, check=True)
    assert subprocess.run(["./settings"], cwd=tmp_path, check=False).returncode == 0


#: Neighbouring results of which one adds to a product and the other subtracts: GCC 12 makes vectors of both, and of
#: these fused operations (vfmaddsub), whatever -ffp-contract says.
NEIGHBOURS = """
void f(const double *restrict a, const double *restrict b, const double *restrict c, double *restrict out)
{
    const double p = a[0] * b[0];
    const double q = a[1] * b[1];
    out[0] = p - c[0];
    out[1] = q + c[1];
}
"""


@pytest.mark.parametrize(
    "own", [(), ("-DARM_WITHOUT_PRAGMA", "-ffp-contract=off", "-fno-tree-slp-vectorize")]
)
def test_neighbouring_products_are_not_fused(
    own: tuple[str, ...], tmp_path: Path, compiler: str, needs_compiler: Callable[..., None]
) -> None:
    needs_compiler(compiler, "-mfma", *own)
    guards = arithmetic("arm", Real("double"))
    source, flags = tmp_path / "f.c", ("-std=c99", "-O3", "-mfma", *own, "-S", "-o", "-")
    source.write_text("#include <math.h>\n" + guards + NEIGHBOURS)
    made = subprocess.run([compiler, *flags, str(source)], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    assert "vmulpd" in made.stdout or "vmulsd" in made.stdout
    assert "addsub" not in made.stdout
    assert "vfm" not in made.stdout.partition("\nf:")[2]
