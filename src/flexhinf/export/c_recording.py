"""What the exported C itself answers to a recording, compiled and run on this machine.

Float rounds otherwise than the simulation, which is in double. How much is lost is measured by comparing both; what a
build must answer, to the last bit, is what the C answers here: without fused multiply-adds and with them. Functions of
the C library differ from system to system: how far that moves each answer is measured with functions that are off.
"""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.export.c_library import library_calls, mathematics
from flexhinf.export.compiled import build
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.file_list import File, rendered
from flexhinf.export.programs import c_compiler, unusable
from flexhinf.export.recording import Recording, memory_hash
from flexhinf.validation import value_text

#: By how many units of the last place functions of C libraries differ, at most.
LIBRARY_ULPS = 4


@dataclass(frozen=True)
class CAnswers:
    """Recordings of the C, without and with fused multiply-adds, and both with a library that is off, if it calls one.

    `pose`: How far a pose at rest, and what else the rehearsal compares with numbers from elsewhere, is off, relative
    to 1 and each number.
    """

    runs: tuple[Recording, Recording]
    moved: tuple[Recording, ...]
    pose: float


def why_not_answered() -> str:
    """Why no program of this machine's C compiler answers; "" where one can."""
    compiler = c_compiler()
    if compiler is None:
        return "no C compiler was found"
    if reason := unusable(compiler, (), runs=True):
        return f"{shlex.join(compiler)} makes no program that runs on this machine ({reason})"
    return ""


def answered(
    code: ControllerCode,
    run: Recording,
    stimulus: Callable[[ControllerCode], Mapping[str, object]],
    rehearsal: Callable[[ControllerCode], Mapping[str, object]],
) -> CAnswers:
    """What the C answers to a recording.

    `stimulus`, `rehearsal`: What the templates need of what is given, and of the rehearsal. Raises InvalidInput: the
    compiler fails, changes results by flags of its own, or makes programs that end early.
    """
    files: list[File[ControllerCode]] = [
        File("record.c", "record.c", stimulus),
        File("rehearsal.c", "contract.c", rehearsal),
    ]
    texts = {**code.files, **rendered(files, code, code.name, code.real, **code.values)}
    texts["rehearsal.c"] = f"#define main rehearse\n{texts['rehearsal.c']}"
    builds = (f"-D{code.upper('PLAIN')}",), ("-D__FP_FAST_FMA=1", "-D__FP_FAST_FMAF=1")
    found = [_run(code, texts, flags, run) for flags in builds]
    calls = [name for name, _ in library_calls(mathematics(code.source), code.real)]
    off = {**texts, f"{code.name}.c": _with_library_off(code, calls)} if calls else None
    moved = [] if off is None else [_run(code, off, flags, run) for flags in builds]
    (plain, pose), (fused, other) = found
    return CAnswers((plain, fused), tuple(one for one, _ in moved), max(pose, other))


def _with_library_off(code: ControllerCode, calls: Sequence[str]) -> str:
    """The source with functions of the library that give another number, some units of the last place away."""
    kind, away = code.real.name, 1.0 + LIBRARY_ULPS * code.real.epsilon
    macros = "\n".join(f"#define {name}(...) off({name}(__VA_ARGS__))" for name in calls)
    lines = f"static {kind} off({kind} x) {{ return x * ({kind}){away!r}; }}\n{macros}\n"
    last = code.source.rindex("#include <")
    end = code.source.index("\n", last) + 1
    return code.source[:end] + lines + code.source[end:]


def _run(
    code: ControllerCode, texts: dict[str, str], flags: Sequence[str], run: Recording
) -> tuple[Recording, float]:
    """The recording of one build, and how far the rehearsal is off."""
    with TemporaryDirectory() as work:
        built = build(texts, Path(work), ("-O1", "-w", *flags))
        done = subprocess.run(
            [built], cwd=work, capture_output=True, text=True, check=False, errors="replace"
        )
        answers = Path(work) / "answers"
        rows = np.fromfile(answers) if answers.exists() else np.zeros(0)
    p, m, n, k = (code.sizes[name] for name in ("y", "u", "estimate", "memory"))
    width = 4 + 2 * p + m + n + k
    refuse_if(
        done.returncode != 0 or len(rows) != width * len(run.y),
        "The test vector does not run to its end on this machine.",
        f"expected the answers to {len(run.y)} rows, got the exit code {done.returncode} and "
        f"{value_text((done.stdout + done.stderr).strip())}",
        "another compiler in CC, without flags that change results",
    )
    facts, seen, u, estimate, memory = np.split(rows.reshape(-1, width), np.cumsum([4, 2 * p, m, n]), axis=1)
    codes = {row.value: name for name, row in code.codes.items()}
    own = replace(
        run,
        u=u,
        estimate=estimate,
        codes=[codes[int(number)] for number in facts[:, 0]],
        status=facts[:, 1].astype(int).tolist(),
        path_rate=facts[:, 2].tolist(),
        doubtful=facts[:, 3].astype(int).tolist(),
        unseen=seen[:, ::2].astype(int),
        rejected=seen[:, 1::2].astype(int),
        hashes=[memory_hash(row) for row in memory],
        memory_rows=memory,
    )
    away = re.search(r"farthest (\S+)", done.stdout)
    return own, float(away[1]) if away else 0.0
