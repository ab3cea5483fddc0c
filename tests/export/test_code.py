"""What exported C must be: clean under every warning, without memory of its own, safe whatever it is fed, small."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from tests.builders import arm_controller
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.export import export_c
from flexhinf.export.controller_c import code_of

# The flags of what is tested stand here; unoptimised are recordings and stacks of five exports: 4 s less.
pytestmark = [pytest.mark.usefixtures("unoptimised"), pytest.mark.ci("exports the code of all tests here")]

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror")

#: A sample of what templates need of their frameworks.
ARDUINO = "unsigned long micros();\nvoid setup();\nvoid loop();\n"

#: Steps with random bytes for numbers, and now and then in place of all that is remembered; every answer must be finite
#: and within ±48. Where the mark is overwritten too, the step says so until there is an init again.
FUZZ = """
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include "arm.h"
static uint64_t seed = 88172645463325252u;
static uint64_t next(void) { seed ^= seed << 13; seed ^= seed >> 7; seed ^= seed << 17; return seed; }
static arm_real any(arm_real usual)
{
    arm_real value = usual;
    const uint64_t kind = next() % 100u;
    if (kind < 4u) { const uint64_t bits = next(); memcpy(&value, &bits, sizeof value); }
    else if (kind < 5u) { value = (arm_real)NAN; }
    else if (kind < 8u) { value = usual * (arm_real)ldexp(1.0, (int)(next() % 60u)); }
    return value;
}
int main(void)
{
    static arm_state state;
    const long steps = STEPS;
    long codes[9] = {0};
    int missing = 5;
    arm_init(&state);
    for (long k = 0; k < steps; ++k) {
        arm_input input = {0};
        arm_output output = {0};
        for (int i = 0; i < ARM_MEASUREMENTS; ++i) input.y[i] = any((arm_real)(0.1 * sin(1e-3 * (double)k)));
        for (int i = 0; i < ARM_COMMANDS; ++i) input.r[i] = any((arm_real)0.1);
        missing = missing > 0 ? missing - 1 : (next() % 500u == 0u ? (int)(next() % 30u) : 0);
        input.measured = missing == 0;
        input.age = any((arm_real)0);
        if (next() % 100000u == 0u) memset(&state, (int)(next() % 256u), offsetof(arm_state, mark));
        if (next() % 50000u == 0u) memset(&state, (int)(next() % 256u), sizeof state);
        const int code = arm_step(&state, &arm_defaults, &input, &output);
        codes[code] += 1;
        if (code == ARM_NOT_INITIALISED && next() % 10u == 0u) arm_init(&state);
        for (int i = 0; i < ARM_INPUTS; ++i) {
            const double u = (double)output.u[i];
            if (!isfinite(u) || fabs(u) > 48.0) { printf("step %ld: %g\\n", k, u); return 1; }
        }
        for (int i = 0; i < ARM_STATES; ++i) if (!isfinite(output.estimate[i])) { printf("estimate\\n"); return 1; }
    }
    for (int i = 0; i < 9; ++i) printf("%ld ", codes[i]);
    return codes[0] < steps / 2;
}
"""


@pytest.fixture(scope="module")
def exported(controller: fh.Controller, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("c")
    return {real: export_c(controller, folder / real, "arm", real) for real in ("double", "float")}


def run(*words: object, folder: Path, **options: Any) -> str:
    done = subprocess.run(
        list(map(str, words)), cwd=folder, capture_output=True, text=True, check=False, **options
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def tool(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"missing: {name}")
    return found


CI = pytest.mark.ci("compiles or checks the whole source once more")
NIGHTLY = pytest.mark.nightly("the other standards, types and arms")

#: Compilers, and what they are told; warnings are errors.
WARNINGS = (
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Wshadow",
    "-Wcast-qual",
    "-Wundef",
)
CORTEX = "-mthumb -mfloat-abi=hard -O2"
COMPILERS = {
    **{f"{name} {standard}": f"{name} -std={standard} -Wstrict-prototypes -O1"
       for name in ("gcc", "clang") for standard in ("c99", "c11", "c17")},
    "g++": "gcc -x c++ -std=c++17", "clang++": "clang -x c++ -std=c++17",
    "gcc 32 bit": "gcc -std=c99 -m32 -msse2 -mfpmath=sse",
    "cortex-m4": f"arm-none-eabi-gcc -std=c99 -mcpu=cortex-m4 -mfpu=fpv4-sp-d16 {CORTEX}",
    "cortex-m7": f"arm-none-eabi-gcc -std=c99 -mcpu=cortex-m7 -mfpu=fpv5-d16 {CORTEX}",
}  # fmt: skip

#: What the source needs of <math.h>, for a compiler of another system whose headers are not here.
MATH = """
double fabs(double), sqrt(double), sin(double), cos(double), copysign(double, double);
float fabsf(float), sqrtf(float), frexpf(float, int *), copysignf(float, float);
#define NAN __builtin_nanf("")
#define HUGE_VAL __builtin_huge_val()
#define HUGE_VALF __builtin_huge_valf()
#define isfinite(x) __builtin_isfinite(x)
#define isnan(x) __builtin_isnan(x)
"""


#: In CI each with one type, and what many use with both.
WARNED = [
    pytest.param(kind, real, marks=CI if (row + column) % 2 == 0 or kind.endswith("c99") else NIGHTLY)
    for row, kind in enumerate(COMPILERS)
    for column, real in enumerate(("double", "float"))
]


@pytest.mark.parametrize(("kind", "real"), WARNED)
def test_no_compiler_warns(
    kind: str, real: str, exported: dict[str, Path], needs_compiler: Callable[..., None]
) -> None:
    name, *flags = COMPILERS[kind].split()
    tool(name)
    if "-m32" in flags:
        needs_compiler(name, *(flag for flag in flags if flag.startswith("-m")))
    run(name, *flags, *WARNINGS, "-c", "arm.c", "-o", "out.o", folder=exported[real])
    if kind in ("gcc c99", "clang c99"):
        for file in ("arm_test.c", "main.c"):
            run(name, *flags, *WARNINGS, "-c", file, "-o", "out.o", folder=exported[real])


@CI
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_compiler_of_windows_does_not_warn(real: str, exported: dict[str, Path], tmp_path: Path) -> None:
    """As far as clang stands for it."""
    (tmp_path / "math.h").write_text(MATH)
    words = "--driver-mode=cl", "/W4", "/WX", "/TC", "/c", "arm.c", f"/Fo{tmp_path / 'arm.obj'}"
    assert run(tool("clang"), *words, "-imsvc", tmp_path, folder=exported[real]) == ""


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast", "-ffinite-math-only"])
def test_what_would_remove_the_checks_is_refused(compiler: str, flag: str, exported: dict[str, Path]) -> None:
    command = [tool(compiler), flag, "-c", "arm.c", "-o", "out.o"]
    done = subprocess.run(command, cwd=exported["double"], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert unnamed(done.stderr, "#error", "finite") == []


@pytest.mark.ci("compiles for each")
@pytest.mark.oracle
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("flags", [(), ("-march=native",)])
def test_the_test_vector_has_the_bits_of_every_standard_and_processor(
    flags: tuple[str, ...], compiler: str, exported: dict[str, Path], needs_compiler: Callable[..., None]
) -> None:
    """By its default, gcc fuses products and sums on its own where the processor can."""
    needs_compiler(compiler, *flags)
    folder = exported["double"]
    run(tool(compiler), "-O2", *flags, "arm.c", "arm_test.c", "-lm", "-o", "test", folder=folder)
    assert re.search(r"relative error 0\b(?!\.)", run("./test", folder=folder))


def test_what_is_applied_is_within_limits_that_were_changed(
    exported: dict[str, Path], compiler: str, tmp_path: Path
) -> None:
    """Also where the safe input of the design is beyond them, and nothing good was computed yet."""
    (tmp_path / "limits.c").write_text("""
#include <math.h>
#include <stdio.h>
#include "arm.h"
int main(void)
{
    static arm_state state;
    arm_param param = arm_defaults;
    arm_input input = {.y = {NAN}, .measured = 1};
    arm_output output;
    param.value[ARM_P_LOWER] = 5;
    param.value[ARM_P_UPPER] = 10;
    arm_init(&state);
    const int code = arm_step(&state, &param, &input, &output);
    printf("%d %g", code, (double)output.u[0]);
    return 0;
}
""")
    source = exported["double"] / "arm.c"
    run(
        compiler, "-std=c99", f"-I{source.parent}", "limits.c", source, "-lm", "-o", "limits", folder=tmp_path
    )
    assert run("./limits", folder=tmp_path) == "7 5"


@pytest.mark.parametrize("place", [1, 2])
def test_a_fragment_of_the_documentation_compiles(
    place: int, controller: fh.Controller, compiler: str, repository: Path, tmp_path: Path
) -> None:
    page = (repository / "docs/deployment.md").read_text(encoding="utf-8")
    fragment = page.split("```c\n")[place].split("```")[0]
    declared = "extern double encoder(void), command(void), seconds_since_sample(void);\n"
    declared += "extern void drive(double), brake(int);\n"
    for name, text in code_of(controller, "my_arm", "double").files.items():
        (tmp_path / name).write_text(text)
    text = f'#include "my_arm.h"\n{declared}int main(void)\n{{\n{fragment}}}\n'
    (tmp_path / "use.c").write_text(text)
    run(compiler, "-std=c99", "-Wall", "-Wextra", "-Wno-unused-variable", "-Wno-unused-but-set-variable", "-Werror",
        "-c", "use.c", folder=tmp_path)  # fmt: skip


#: Checked by cppcheck in CI.
IN_CI = {("one link, double", "__FMA__ -D__GNUC__"), ("one link, float", "ARM_PLAIN")}


@pytest.fixture(scope="module")
def checked(exported: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Folders of exports; the larger one is made where it is asked for."""
    one = {f"one link, {real}": exported[real] for real in ("double", "float")}

    @cache
    def two_links() -> Path:
        two = arm_controller("planar-two-link", degree=4, r=1e-6, p0=1e-8, limit=200.0)
        return export_c(two, tmp_path_factory.mktemp("two") / "c", "arm")

    return lambda which: one.get(which) or two_links()


CHECKED = [
    pytest.param(which, arithmetic, marks=CI if (which, arithmetic) in IN_CI else NIGHTLY)
    for which in ("one link, double", "one link, float", "two links, double")
    for arithmetic in ("ARM_PLAIN", "__FMA__ -D__GNUC__")
]


@pytest.mark.parametrize(("which", "arithmetic"), CHECKED)
def test_cppcheck_finds_nothing(which: str, arithmetic: str, checked: Callable[[str], Path]) -> None:
    checks = ("--enable=warning,style,performance,portability", "--std=c99", "--error-exitcode=1", "--quiet")
    assert run(tool("cppcheck"), *checks, *f"-D{arithmetic}".split(), "arm.c", folder=checked(which)) == ""


def test_the_deviations_are_a_list_that_cppcheck_reads(exported: dict[str, Path]) -> None:
    lines = (exported["float"] / "misra.txt").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if line and not re.match(r"# .|misra-c2012-\d+\.\d+$", line)] == []


@pytest.mark.ci("cppcheck with its add-on")
def test_no_rule_of_misra_is_broken_in_small_code(tmp_path: Path) -> None:
    """Of a law without an estimator; it breaks only what is listed."""
    tool("cppcheck")
    small = arm_controller(kind=None)
    assert run("make", "-s", "misra", folder=export_c(small, tmp_path / "c", "arm")) == ""


@pytest.mark.nightly("all rules on three exports with estimators, and that each deviation is needed")
def test_no_rule_of_misra_is_broken_but_those_that_are_listed_with_a_reason(
    checked: Callable[[str], Path],
) -> None:
    """And each of these is."""
    tool("cppcheck")
    found = set()
    for folder in map(checked, ("one link, double", "one link, float", "two links, double")):
        assert run("make", "-s", "misra", folder=folder) == ""
        options = "--addon=misra", "--enable=style", "--std=c99", "--quiet", "-DARM_PLAIN"
        found |= set(re.findall(r"misra-c2012-[0-9.]+", run("cppcheck", *options, "arm.c", folder=folder)))
    listed = (folder / "misra.txt").read_text(encoding="utf-8").splitlines()
    assert found == {line for line in listed if line.startswith("misra")}


@pytest.mark.ci("compiles and links for each level")
@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("flags", ["-O2", "-O0 -fno-builtin", "-O0 -fno-builtin -mfma"])
@pytest.mark.parametrize("real", ["double", "float"])
def test_it_has_no_memory_of_its_own_and_needs_the_mathematical_library_alone(
    real: str, flags: str, exported: dict[str, Path], compiler: str, needs_compiler: Callable[..., None]
) -> None:
    """Of which no function stands for a fused multiply-add, whatever the flags."""
    needs_compiler(compiler, *flags.split())
    run(compiler, "-std=c99", *flags.split(), "-c", "arm.c", "-o", "arm.o", folder=exported[real])
    lines = [line.split() for line in run(tool("nm"), "arm.o", folder=exported[real]).splitlines()]
    kinds = {line[-2] for line in lines}
    assert not kinds & set("dDbBC"), "static memory that can change"
    public = {line[-1] for line in lines if line[-2].isupper() and line[-2] != "U"}
    names = (
        "init",
        "start",
        "step",
        "defaults",
        "version",
        "digest",
        "fused",
        "check",
        "rest",
        "at_rest",
        "may_act",
    )
    assert public == {f"arm_{name}" for name in names}
    needed = {line[-1] for line in lines if line[-2] == "U"} - {
        "memset",
        "memcpy",
        "memmove",
        "__stack_chk_fail",
    }
    # a compiler may join the sine and the cosine of one angle
    known = {"sqrt", "fabs", "copysign", *(("sin", "cos", "sincos") if real == "double" else ("frexp",))}
    assert {name.removesuffix("f") for name in needed} <= known, needed
    text = (exported[real] / "arm.c").read_text()
    assert re.findall(r"#include\s+(\S+)", text) == [
        '"arm.h"',
        "<math.h>",
        "<stdbool.h>",
        "<stddef.h>",
        "<stdint.h>",
    ]


def test_a_float_build_computes_nothing_in_double(exported: dict[str, Path]) -> None:
    text = (exported["float"] / "arm.c").read_text()
    assert "double" not in text
    code = re.sub(r'/\*.*?\*/|"[^"\n]*"', "", text, flags=re.DOTALL)
    numbers = re.findall(r"(?<![\w.])\d+(?:\.\d*)?(?:e[-+]?\d+)?f?", code)
    assert [text for text in numbers if ("." in text or "e" in text) and not text.endswith("f")] == []


#: A board whose sensors give nothing from its 120th sample to the 135th, for main.c; and 140 periods of a sketch on it.
BOARD = """#include <stdio.h>
#include <stdlib.h>
#include "arm.h"
static int sample, last = -1;
void wait_for_sample(void) { sample += 1; if (sample > 140) exit(0); }
int drives_enabled(void) { return 1; }
int read_sensors(arm_real *y) { y[0] = 0; return sample < 120 || sample >= 135; }
void read_command(arm_real *r, arm_real path_rate) { (void)r; (void)path_rate; }
void drive_motors(const arm_real *u) { (void)u; last = sample; }
arm_real seconds_since_sample(void) { return 0; }
void report(int code) { (void)code; }
void refused(int why) { (void)why; }
void restart_watchdog(void) {}
void brake(int code) { printf("brake %d, last driven %d\\n", code, last); }
"""
SKETCHED = """#include <cstdio>
static int sample, last = -1;
unsigned long micros() { return 1000ul * (unsigned long)sample; }
#include "sketch.cpp"
int main() { setup(); for (sample = 0; sample < 140; ++sample) loop(); }
"""


@pytest.mark.costs("compiles an unscented filter, and what stands around it")
def test_templates_begin_with_one_export_alone_and_latch(exported: dict[str, Path], tmp_path: Path) -> None:
    """The sketch drove on after every code, and no template but that of ROS 2 looked at the digest."""
    compiler, folder = tool("g++"), exported["double"]
    sketch = ARDUINO + (folder / "templates/arm.ino").read_text()
    for before, after in (
        ("    }\n    return true;", "    }\n    return sample < 120 || sample >= 135;"),
        ("(void)u;", "(void)u; last = sample;"),
        ("(void)stop; // takes", 'std::printf("brake %d, last driven %d\\n", stop, last); //'),
    ):
        assert sketch.count(before) == 1
        sketch = sketch.replace(before, after)
    texts = {
        "sketch.cpp": sketch,
        "run.cpp": SKETCHED,
        "board.c": BOARD,
        "main.c": (folder / "main.c").read_text(),
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    flags = ("-Wall", "-Wextra", "-Werror", "-O0", f"-I{tmp_path}")
    run("gcc", "-std=c99", "-O0", "-c", folder / "arm.c", "-o", "arm.o", folder=tmp_path)
    header = (folder / "arm.h").read_text()
    for changed, told in (
        (False, ["brake 10, last driven 130"] * 2),
        (True, ["brake 2, last driven -1"] * 2),
    ):
        (tmp_path / "arm.h").write_text(
            re.sub('(?<=_DIGEST ").*(?=")', "another", header) if changed else header
        )
        run(compiler, "-std=c++17", *flags, "run.cpp", "arm.o", "-lm", "-o", "sketch", folder=tmp_path)
        run("gcc", "-std=c99", *flags, "main.c", "board.c", "arm.o", "-lm", "-o", "firmware", folder=tmp_path)
        said = [
            subprocess.run([tmp_path / program], capture_output=True, text=True, check=False).stdout.strip()
            for program in ("sketch", "firmware")
        ]
        assert said == told


@pytest.mark.ci("a hundred thousand samples")
@pytest.mark.parametrize(
    ("real", "steps"),
    [("double", 100_000), pytest.param("double", 2_000_000, marks=pytest.mark.nightly("twenty times the samples")),
     pytest.param("float", 500_000, marks=pytest.mark.ci("500,000 samples"))],
)  # fmt: skip
def test_no_sample_makes_the_output_unsafe(
    real: str, steps: int, exported: dict[str, Path], compiler: str, tmp_path: Path
) -> None:
    (tmp_path / "fuzz.c").write_text(FUZZ.replace("STEPS", str(steps)))
    flags = ("-std=c99", "-O2", f"-I{exported[real]}")
    run(compiler, *flags, "fuzz.c", exported[real] / "arm.c", "-lm", "-o", "fuzz", folder=tmp_path)
    codes = [int(word) for word in run("./fuzz", folder=tmp_path).split()]
    assert sum(codes) == steps
    assert codes.pop(1) == 0, "there is an estimator: no measurement is bad"
    assert all(codes), f"every other code is returned: {codes}"


@pytest.mark.parametrize("real", [pytest.param("double", marks=NIGHTLY), pytest.param("float", marks=CI)])
def test_the_sanitizers_find_nothing(
    real: str, exported: dict[str, Path], compiler: str, tmp_path: Path, needs_compiler: Callable[..., None]
) -> None:
    flags = ("-std=c99", "-O1", "-g", "-fsanitize=undefined,address", "-fno-sanitize-recover=all")
    needs_compiler(compiler, *flags)
    (tmp_path / "fuzz.c").write_text(FUZZ.replace("STEPS", "200000"))
    for source in (tmp_path / "fuzz.c", exported[real] / "arm_test.c"):
        words = (
            compiler,
            *flags,
            f"-I{exported[real]}",
            source,
            exported[real] / "arm.c",
            "-lm",
            "-o",
            "checked",
        )
        run(*words, folder=tmp_path)
        run("./checked", folder=tmp_path)
