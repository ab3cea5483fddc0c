"""Programs as compiled C: what their machine code is compared with to the bit."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from flexhinf.codegen import Program
from flexhinf.codegen.c import Real, Translator

#: Products that are rounded once with the sum, or by themselves.
FUSED = {
    False: "#define FMA(a, b, c) ((a) * (b) + (c))",
    True: "#define FMA(a, b, c) fma(a, b, c)\n#define FUSED",
}

#: Of no warning, and of no rounding that is not written.
FLAGS = ("-O1", "-Wall", "-Werror", "-ffp-contract=off", "-shared", "-fPIC")

Arrays = Mapping[str, np.ndarray]


def in_c(
    programs: Mapping[str, Program], folder: Path, fused: bool, lanes: int = 1
) -> Callable[[str, Arrays], int]:
    """``run(name, arrays)`` of programs by name: writes to flat arrays as a kernel does, and gives the code.

    `lanes`: Columns that the C computes side by side. What a program may not read before it is written is NaN.
    """
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("missing: a C compiler")
    translators = {name: Translator(f"c_{name}", Real("double"), lanes) for name in programs}
    texts, rooms = list[str](), dict[str, int]()
    for name, translator in translators.items():
        called = translator.add(programs[name], "run")
        rooms[name] = translator.room
        kinds = ["double *"] * (len(programs[name].buffers) + (translator.room > 0))
        declared = ", ".join(f"{kind}a{k}" for k, kind in enumerate(kinds))
        given = ", ".join(f"a{k}" for k in range(len(kinds)))
        places = {
            part.name: part.offset for b in programs[name].buffers for part in b.parts if part.name.isupper()
        }
        texts += [f"#undef {part}\n#define {part} {place}" for part, place in places.items()]
        texts.append(f"{translator}\nint {name}({declared}) {{ return {called}({given}); }}")
    source = folder / f"programs_{fused}_{lanes}.c"
    head = f"#include <math.h>\n#include <stdbool.h>\n{FUSED[fused]}\n"
    source.write_text(head + "\n".join(texts) + "\n", encoding="utf-8")
    library = source.with_suffix(".so")
    subprocess.run([compiler, *FLAGS, str(source), "-lm", "-o", str(library)], check=True)
    loaded = ctypes.CDLL(str(library))

    def run(name: str, arrays: Arrays) -> int:
        memory = list[np.ndarray]()
        for buffer in programs[name].buffers:
            work = np.full(buffer.size or 0, 0.0 if buffer.cleared else np.nan)
            memory.append(work if buffer.role == "work" else arrays[buffer.name])
        memory += [np.full(rooms[name], np.nan)] * (rooms[name] > 0)
        assert all(array.flags.c_contiguous and array.dtype == float for array in memory)
        return int(getattr(loaded, name)(*(array.ctypes.data_as(ctypes.c_void_p) for array in memory)))

    return run
