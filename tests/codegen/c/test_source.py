"""C from the text of Python: compiled, it computes what Python does with the same text, and what it has no form of is
refused."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.codegen.c import source_sample
from tests.export.test_code import STRICT
from tests.refusals import refused_with

from flexhinf.codegen.c import Real
from flexhinf.codegen.c.source import Source, structure
from flexhinf.codegen.program import Unsupported

FIXED = source_sample.Fixed()
SIZES = tuple(FIXED.sizes.items())
RECORDS = ("Inner", "Memory")


def text_of(real: str) -> str:
    source = Source([source_sample], "sample", Real(real, real), FIXED, {"WIDTH": "3", "width": "WIDTH"})
    functions = source.functions("run", "chosen")
    records = "\n".join(source.record(name) for name in RECORDS)
    head = "#include <math.h>\n#include <stddef.h>\nenum { WIDTH = 3, SAMPLE_NO = 0, SAMPLE_YES = 7 };\n"
    constants = "\n".join(source.constants.values())
    declared = "double sample_run(sample_memory *, double[2], const double[3], int);\nint sample_chosen(double, int);\n"
    return f"{head}{records}\n{constants}\n{declared.replace('double', real)}\n{functions}\n"


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    if (compiler := shutil.which("gcc") or shutil.which("cc")) is None:
        pytest.skip("missing: gcc")
    folder = tmp_path_factory.mktemp("source")
    (folder / "sample.c").write_text(text_of("double"))
    words = [
        compiler,
        *STRICT,
        "-ffp-contract=off",
        "-O1",
        "-fPIC",
        "-shared",
        "sample.c",
        "-lm",
        "-o",
        "sample.so",
    ]
    subprocess.run(words, cwd=folder, check=True)
    found = ctypes.CDLL(str(folder / "sample.so"))
    found.sample_run.restype = ctypes.c_double
    return found


def fill(memory: Any, given: Any, numbers: np.ndarray) -> None:
    for k, one in enumerate(given):
        one.values[:], one.count = numbers[k].tolist(), k + 5
    for one in (memory.inner, *memory.several):
        one.values[:], one.count = numbers[2].tolist(), 2
    memory.far = 39_000


numbers = st.floats(-9.0, 9.0) | st.sampled_from([0.0, 1.0, -1.0])


@pytest.mark.oracle
@pytest.mark.costs("compiles a file once")
@given(st.lists(numbers, min_size=14, max_size=14), st.integers(1, 4))
def test_c_computes_what_python_does(library: ctypes.CDLL, drawn: list[float], count: int) -> None:
    """To the last bit: results, what is changed of records and arrays, and how branches went."""
    parts, pair, row = np.reshape(drawn[:9], (3, 3)), drawn[9:11], drawn[11:]
    memory, given = source_sample.Memory(FIXED), [source_sample.Inner(FIXED) for _ in range(4)]
    kind = structure(source_sample.Memory, SIZES, np.float64)
    inner = structure(source_sample.Inner, SIZES, np.float64)
    places, other = (inner * 4)(), kind()
    for one, records in ((memory, given), (other, places)):
        fill(one, records, parts[[0, 1, 2, 0]])
    memory.given, other.given = given, ctypes.cast(places, ctypes.c_void_p)
    own_pair, c_pair, c_row = list(pair), (ctypes.c_double * 2)(*pair), (ctypes.c_double * 3)(*row)
    expected = source_sample.run(FIXED, memory, own_pair, list(row), count)
    assert library.sample_run(ctypes.byref(other), c_pair, c_row, count) == expected
    assert list(c_pair) == own_pair
    assert (other.last, other.far, other.several[1].count) == (
        memory.last,
        memory.far,
        memory.several[1].count,
    )
    assert [list(one.values) for one in (other.inner, *other.several)] == [
        one.values for one in (memory.inner, *memory.several)
    ]
    assert np.array_equal(np.array(other.matrix), memory.matrix)
    for x, k in ((pair[0], count), (1.0, 2), (-0.5, 1)):
        assert library.sample_chosen(ctypes.c_double(x), k) == source_sample.chosen(FIXED, x, k)


def test_what_is_decided_before_is_not_written() -> None:
    """Nor is what is not called; comments and sentences are."""
    text = text_of("float")
    assert "-5" not in text
    assert "sample_chosen(float x, int k)" in text
    assert "/* of two */" in text
    for sentence in (source_sample.run.__doc__, source_sample.Memory.__doc__):
        assert f"/* {str(sentence).removesuffix('.')}" in text
    assert "/* by value" in text
    assert "0.25f" in text


def module_of(text: str, folder: Path) -> Iterator[ModuleType]:
    """A module of a text, as a file has it."""
    (folder / "refused_sample.py").write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        sys.modules.pop("refused_sample", None)
        import refused_sample  # pyright: ignore[reportMissingImports]

        yield refused_sample


@pytest.mark.parametrize(
    "line",
    [
        "with x: pass", "x = [1.0, 2.0]", "x = {1: 2}", "for i in [1]: x = 1.0", "x = x ** 2", "x = sum(x)", "del x",
        "x: float = 1.0", "x = lambda: 1.0", "return", "x = 'text'", "x = math.sin(x)", "x = own.table", "double = 1.0",
        "for i in range(0, 4, 2): x = 1.0", "x, y = 1.0, x", "x = 3 / 2", "x = x // 2.0", "x = x % 2.0",
        "x = max(x, y=x)",
    ],
)  # fmt: skip
def test_what_c_has_no_form_of_is_refused_with_its_line(line: str, tmp_path: Path) -> None:
    text = f"import math\ndef one(own: object, x: float) -> float:\n    {line}\n    return x\n"
    for module in module_of(text, tmp_path):
        with refused_with(Unsupported, "line 3"):
            own = type("Own", (), {"table": np.zeros((2, 2))})()
            Source([module], "sample", Real("double"), own, {}).functions("one")
