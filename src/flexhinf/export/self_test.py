"""What an exported controller is tested with on its own processor: a recorded run, and a rehearsal of its contract.

The test vector is a recording of the controller: measurements, commands, inputs and estimates. The C code must give the
same. The rehearsal provokes every value that a step returns, and looks for what the README says of it.
"""

from __future__ import annotations

import math
import re
import shlex
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.export.compiled import build, compiler_flags
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.file_list import File, rendered
from flexhinf.export.programs import accepts, c_compiler, required_compiler, unusable
from flexhinf.export.recording import MISSING, Recording, history_of, memory_hash
from flexhinf.loop import Status
from flexhinf.validation import value_text

#: Largest error of the test vector relative to an input's largest value: in double of the C library's functions, where
#: they are called; in float of covariances and gains of 24 bits: 1e-6 to 2 % were seen, so it is measured where a C
#: compiler is at hand, and a controller beyond this is refused.
TOLERANCE = {"double": 1e-9, "float": 5e-2}

#: Largest error in float while positions are moved.
MOST_MOVED = 0.2

#: What a test vector in float allows: this many times what was measured, as other processors round otherwise.
SPARE, MIN_TOLERANCE = 5.0, 1e-5


#: Every how many samples the estimate is compared.
EVERY = 10


@dataclass(frozen=True)
class Accuracy:
    """Largest errors that a test vector allows in each of its parts, relative to each signal's largest value there, and
    a text for the README. `said`: whether codes and bits of the status were those of the recording, where rounding does
    not decide about them."""

    inputs: tuple[float, ...]
    estimates: tuple[float, ...]
    text: str
    said: bool = True


def accuracy(code: ControllerCode, run: Recording) -> Accuracy:
    """In double what the C library's functions may differ by; in float what is measured with this machine's compiler.

    Raises InvalidInput: that compiler fails, or inputs lose more than a test vector may allow, which is less while no
    position is moved. What is lost while the controller is provoked is no measure of it.
    """
    most, plainly, parts = TOLERANCE[code.real.name], (f"-D{code.upper('PLAIN')}",), len(run.parts)
    if code.real.name == "double":
        same = f"nothing, if {code.name}_fused is 1 in a simulation with fused multiply-adds, and else in one without"
        called = f"{same}, but for the C library's functions: the test vector allows {most:.0e}"
        called, most = (called, most) if code.translator.calls_library else (same, 0.0)
        return Accuracy((most,) * parts, (most,) * parts, called)
    vector = "the test vector allows"
    if reason := _why_not_measured():
        text = f"not measured: {reason}; {vector} {100 * most:g} %"
        any_error = {"": most, "moved": SPARE * MOST_MOVED, "provoked": math.inf}
        return Accuracy(tuple(any_error[part] for part in run.parts), (math.inf,) * parts, text, said=False)
    fused, plain = (_measured_errors(code, run, flags) for flags in (_portable(), plainly))
    worst, estimates = (np.maximum(*each) for each in zip(fused[:2], plain[:2], strict=True))
    has_moved = "moved" in run.parts
    moved_most = worst[list(run.parts).index("moved")] if has_moved else 0.0
    refuse_if(
        worst[0] > most or moved_most > MOST_MOVED,
        "The controller loses too much in float.",
        f"expected inputs within {100 * most:g} % of their largest value over the test vector, "
        f"got {100 * worst[0]:.2g} %{MOVED.format(100 * moved_most) * has_moved}",
        "--real double; or larger noise levels of the estimator, which condition its covariances better",
    )
    allowed = np.maximum(MIN_TOLERANCE, SPARE * worst)
    allowed[0] = min(most, allowed[0])
    moved = f" ({vector} {100 * SPARE * moved_most:.2g} %)"
    return Accuracy(
        tuple(allowed),
        tuple(np.maximum(MIN_TOLERANCE, SPARE * estimates)),
        f"{100 * fused[0][0]:.2g} % of the input's largest value over the test vector, {100 * plain[0][0]:.2g} % "
        f"without fused multiply-adds, measured at the export; {vector} {100 * allowed[0]:.2g} %"
        + (MOVED.format(100 * moved_most) + moved)
        * has_moved,
        said=fused[2] == plain[2] == 0,
    )


#: What is added of errors while measured positions are moved.
MOVED = "; {:.2g} % while positions are moved from outside"


def _why_not_measured() -> str:
    """Why this machine's C compiler cannot tell what float loses; "" where it can."""
    compiler = c_compiler()
    if compiler is None:
        return "no C compiler was found"
    if reason := unusable(compiler, (), runs=True):
        return f"{shlex.join(compiler)} makes no program that runs on this machine ({reason})"
    return ""


def _portable() -> tuple[str, ...]:
    """Flags for the processors that exported libraries are for, of a compiler that knows them."""
    flags = compiler_flags("portable")
    return flags if accepts(required_compiler(), flags) else ()


def _measured_errors(
    code: ControllerCode, run: Recording, flags: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, int]:
    """Largest errors of inputs and estimates in each part of the test vector, built for this machine, infinite where a
    result is not finite; and how many codes and bits are others.

    Raises InvalidInput: the compiler fails, changes results by flags of its own, or makes a program that ends early.
    """
    any_error = (math.inf,) * len(run.parts)
    tested = Tested(code, (run,), Accuracy(any_error, any_error, ""))
    texts = {**code.files, **rendered([VECTOR], tested, code.name, code.real, **code.values)}
    with TemporaryDirectory() as work:
        built = build(texts, Path(work), ("-O1", *flags))
        done = subprocess.run([built], capture_output=True, text=True, check=False)
    found = re.findall(r"largest relative error (\S+) .* of estimates (\S+)", done.stdout)
    wrong = re.findall(r"wrong codes (\d+)", done.stdout)
    refuse_if(
        len(found) != len(run.parts) or not wrong,
        "The test vector does not run to its end on this machine.",
        f"expected an error of each of {len(run.parts)} parts, got the exit code {done.returncode} and "
        f"{value_text((done.stdout + done.stderr).strip())}",
        "another compiler in CC, without flags that change results; --real double measures nothing",
    )
    errors = np.array(found, dtype=float).T
    inputs, estimates = np.where(np.isfinite(errors), errors, math.inf)
    return inputs, estimates, int(wrong[0])


@dataclass(frozen=True)
class Tested:
    """A controller with a recorded run for both roundings, or one for each, and what a test vector allows."""

    code: ControllerCode
    runs: Sequence[Recording]
    allowed: Accuracy


#: The test vector as C; stored inputs are exact, as in Python.
VECTOR: File[Tested] = File(
    "@{name}_test.c", "test.c", lambda it: vector_values(it.code, it.runs, it.allowed)
)


def vector_values(code: ControllerCode, runs: Sequence[Recording], allowed: Accuracy) -> dict[str, object]:
    """What the test vector consists of."""
    run = runs[-1]
    sizes, sizes_of_estimates = list[np.ndarray](), list[np.ndarray]()
    for part in run.parts.values():
        largest = np.abs(run.estimate[part]).max(axis=0)
        sizes.append(np.maximum(np.abs(run.u[part]).max(axis=0), 1e-30))
        sizes_of_estimates.append(np.maximum(largest, 1e-3 * largest.max()))
    exact = code.real.bytes == 8
    initial = code.controller.initial_memory()
    tables = [f"0x{memory_hash(np.asarray(part, code.real.kind)):016x}u" for part in (code.defaults, initial)]
    return {
        "tables": tables,
        "y": run.y,
        "r": run.r,
        "measured": [int(kind != MISSING) for kind in run.kinds],
        "codes": [code.codes[kind].value for kind in run.codes],
        "repeats": run.repeats,
        "provocation": run.provocation,
        **_replaced(run, initial),
        "unseen": _unseen(run),
        "rejected": run.rejected,
        "runs": [
            {
                "u": one.u,
                "estimates": one.estimate[::EVERY],
                "status": one.status if exact else sure_bits(one, allowed.said),
                "path_rate": one.path_rate,
                "doubtful": one.doubtful,
                "hashes": [f"0x{number:016x}u" for number in one.hashes],
                "sums": one.memory_rows @ _shares(run),
            }
            for one in runs
        ],
        "exact": exact,
        "hashes": exact and allowed.inputs[0] == 0.0,
        "adds": exact and (allowed.inputs[0] > 0.0 or run.provocation is not None),
        "shares_at_start": None
        if run.provocation is None
        else _shares(run) @ history_of(run.provocation.begun(code.controller)).memory,
        "sums": exact and allowed.inputs[0] > 0.0,
        "shares": _shares(run),
        "part_of_row": [
            k for k, part in enumerate(run.parts.values()) for _ in range(part.stop - part.start)
        ],
        "names_of_parts": [f", {name}" if name else "" for name in run.parts],
        "sizes": sizes,
        "sizes_of_estimates": sizes_of_estimates,
        "allowed": allowed,
        "every": EVERY,
        "begun": run.begun,
    }


#: How many memories are looked at for the one that others are changes of.
BASES = 60

#: A share that no sum of a few comes near to a whole number of.
GOLDEN = 0.618034

#: Rows on either side of a change of the status in which rounding of float may decide when it comes.
NEAR_CHANGE = 2

#: The bit of an estimate in doubt, which is another one in float.
DOUBT = int(Status.DOUBTFUL_ESTIMATE)


def sure_bits(run: Recording, said: bool) -> list[int]:
    """The status after each row, without the bit of doubt; −1 where rounding may decide, and everywhere where this
    machine's `said` others."""
    bits = np.array(run.status) & ~DOUBT
    changes = np.flatnonzero(np.diff(bits))
    for k in changes:
        bits[max(0, k + 1 - NEAR_CHANGE) : k + 1 + NEAR_CHANGE] = -1
    return bits.tolist() if said else [-1] * len(bits)


def _replaced(run: Recording, initial: np.ndarray) -> dict[str, object]:
    """Rows before which the memory is replaced, with the one of `bases` and the first of `changes` to it: all that
    differ, as places and numbers."""
    provocation = run.provocation
    memories = {} if provocation is None else provocation.memories
    every = np.array([initial, *memories.values()])
    differs = np.array([np.count_nonzero(every != one, axis=1) for one in every[:: 1 + len(every) // BASES]])
    other = np.minimum(differs[0], differs).sum(axis=1).argmin()  # with which the fewest numbers are stored
    bases = every[:: 1 + len(every) // BASES][[0, other]]
    rows, places, numbers = list[tuple[int, int, int]](), list[int](), list[float]()
    for row, memory in memories.items():
        base = int(np.argmin([np.count_nonzero(memory != base) for base in bases]))
        rows.append((run.begun + row, base, len(places)))
        changed = np.flatnonzero(memory != bases[base])
        places += changed.tolist()
        numbers += memory[changed].tolist()
    return {"replaced": rows, "bases": bases, "changed": [*places, 0], "changed_to": [*numbers, 0.0]}


def _shares(run: Recording) -> np.ndarray:
    """Factors (s,) with which all that is remembered is added up, others for each number, over its largest value."""
    largest = np.abs(np.where(np.isfinite(run.memory_rows), run.memory_rows, 0.0)).max(axis=0)
    turns = 0.5 + np.remainder(GOLDEN * np.arange(run.memory_rows.shape[1], dtype=float), 1.0)
    return turns / np.where(largest > 0.0, largest, 1.0)


def _unseen(run: Recording) -> np.ndarray:
    """Samples (K, p) since each measurement was last there."""
    counts, found = np.zeros(run.y.shape[1], dtype=int), list[np.ndarray]()
    for k, (y, kind, times) in enumerate(zip(run.y, run.kinds, run.repeats, strict=True)):
        counts = counts * (k != run.begun)
        counts = np.where(np.isfinite(y) & (kind != MISSING), 0, counts + times)
        found.append(counts)
    return np.array(found)
