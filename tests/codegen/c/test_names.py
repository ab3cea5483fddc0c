"""Names in C: none is allotted twice, whatever functions, arguments, results and values are called in Python."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import casadi
import numpy as np
import pytest
from tests.in_c import FUSED

from flexhinf.codegen import Buffer, Call, Program, Slice
from flexhinf.codegen.c import KEYWORDS, Real, Translator
from flexhinf.codegen.c.identifiers import LIBRARY, LOCAL, identifier
from flexhinf.codegen.naming import Names, distinct
from flexhinf.codegen.program import TracedStage
from flexhinf.codegen.stages import staged_call

STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror", "-ffp-contract=off")

SIZE = 24


def test_a_scope_gives_each_name_once_and_hides_none_of_those_around() -> None:
    file = Names({"sum", "sum_2"})
    inside = file.within({"x"})
    assert [inside.allot(name) for name in ("sum", "x", "x", "x_2", "y")] == [
        "sum_3",
        "x_2",
        "x_3",
        "x_2_2",
        "y",
    ]
    assert [inside.numbered("v"), inside.allot("v1"), inside.numbered("v")] == ["v1", "v1_2", "v2"]
    assert [file.allot("y"), file.within().allot("y")] == ["y", "y_2"]
    assert distinct(["a", "a_2", "a", "a_2", "a_2_2"]) == ["a", "a_2", "a_3", "a_2_2", "a_2_2_2"]


@pytest.mark.parametrize(
    "text", [*sorted(KEYWORDS | LIBRARY | LOCAL)[::7], "", "2x", "FMA", "A", "é", "a-b", "_x_"]
)
def test_any_text_becomes_a_word_that_c_and_we_leave_free(text: str) -> None:
    word = identifier(text)
    assert word.isidentifier()
    assert word.isascii()
    assert not word.startswith("_")
    assert word not in KEYWORDS | LIBRARY | LOCAL
    assert word != text or not text.isupper()


def chain() -> tuple[Program, casadi.Function]:
    """A function of many lines in two stages of one name, that of its result, whose values are called like the arrays
    that its parts pass on: `gain_2` is an array, and an element of the result."""
    x = casadi.SX.sym("x", SIZE)
    values, stages, ends = [x[k] for k in range(SIZE)], list[TracedStage](), list[list[casadi.SX]]()
    for stage in range(8):
        values = [
            casadi.sin(values[k]) * values[(7 * k + stage) % SIZE] + values[(k + 1) % SIZE]
            for k in range(SIZE)
        ]
        labels = tuple(f"gain_{(k + stage) % SIZE}" for k in range(SIZE))
        stages.append(TracedStage("gain", "Gains", labels=labels))
        ends.append(values)
    pieces = [Slice("gain", 0, SIZE)], [Slice("result", 0, SIZE)]
    call = staged_call("gain", [x], [values], stages, ends, pieces, ("gain", "gain"))
    buffers = Buffer("gain", SIZE, "in"), Buffer("result", SIZE, "out")
    return Program("steps", buffers, (call,)), casadi.Function("gain", [x], [casadi.vertcat(*values)])


def hostile() -> tuple[Program, casadi.Function]:
    """A function called like one of ours, whose arguments have names of C, of ours, and of values."""
    names = ("new", "real", "count", "A", "v1", "c1", "fabs", "v1", "v1_2", "of_model", "i", "FMA")
    symbols = [casadi.SX.sym(f"s{k}", 2) for k in range(len(names))]
    total = symbols[0]
    for k, one in enumerate(symbols):
        total = casadi.if_else(one[0] > 0.1 * k, total * casadi.sin(one) + one, total - casadi.fabs(one))
    function = casadi.Function("sin", symbols, [total])
    pieces = tuple(Slice("given", 2 * k, 2) for k in range(len(names)))
    body = Call(function, pieces, (Slice("result", 0, 2),), "", (*names, "sin"))
    return Program(
        "steps", (Buffer("given", 2 * len(names), "in"), Buffer("result", 2, "out")), (body,)
    ), function


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("language", ["c", "c++"])
@pytest.mark.parametrize("made", [chain, hostile])
def test_functions_whose_names_meet_compile_and_compute_the_same(
    made: object, language: str, real: str, tmp_path: Path
) -> None:
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("missing: gcc")
    program, function = made()  # type: ignore[operator]
    kind = Real(real)  # type: ignore[arg-type]
    translator = Translator(
        "arm", Real(kind.name, "real"), taken=["real", "FMA", "arm_gain", "arm_gain_gain"]
    )
    called, names = translator.add(program, "steps"), [buffer.name for buffer in program.buffers]
    typed = f"typedef {real} real;\nstatic real arm_gain, arm_gain_gain;\n"
    begin = 'extern "C" ' if language == "c++" else ""
    run = f"{begin}int run(const real *a, real *b);\nint run(const real *a, real *b)\n" + (
        f"{{\n    (void)arm_gain;\n    (void)arm_gain_gain;\n    return {called}(a, b);\n}}\n"
    )
    head = f"#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n{FUSED[False]}\n"
    source = tmp_path / "steps.c"
    source.write_text(f"{head}{typed}{translator}{run}")
    standard = "-std=c99" if language == "c" else "-std=c++17"
    words = [compiler, "-x", language, standard, *STRICT, "-O0", "-shared", "-fPIC", str(source), "-lm", "-o"]
    done = subprocess.run([*words, str(tmp_path / "steps.so")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    given = np.linspace(-0.9, 1.1, program.buffer(names[0]).size or 0).astype(kind.kind)
    result = np.zeros(program.buffer("result").size or 0, kind.kind)
    pointers = (ctypes.c_void_p(array.ctypes.data) for array in (given, result))
    assert ctypes.CDLL(str(tmp_path / "steps.so")).run(*pointers) == 0
    arguments = np.split(given.astype(float), function.n_in())
    expected = np.ravel(np.asarray(function(*arguments)))
    assert np.abs(result - expected).max() <= 100.0 * kind.epsilon * np.abs(expected).max()
