"""What an exported controller is tested with on its own processor: a recorded run, and a rehearsal of its contract.

The test vector is a recording of the controller: measurements, commands, inputs and estimates. The C code must give the
same. The rehearsal provokes every value that a step returns, and looks for what the README says of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.export.c_library import ARGUMENTS, library_calls, library_hash, mathematics
from flexhinf.export.c_recording import CAnswers, answered, why_not_answered
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.file_list import File
from flexhinf.export.recording import MISSING, Recording, history_of, memory_hash, with_both_roundings
from flexhinf.export.rehearsal import contract_values

#: Largest error of the test vector relative to an input's largest value: in double of the C library's functions, where
#: they are called; in float of covariances and gains of 24 bits: 1e-6 to 2 % were seen, so it is measured where a C
#: compiler is at hand, and a controller beyond this is refused.
TOLERANCE = {"double": 1e-9, "float": 5e-2}

#: Largest error in float while positions are moved.
MOST_MOVED = 0.2

#: What a test vector allows in float: this many times what was measured, as other processors and libraries round
#: otherwise; at least so many units of the last place.
SPARE, MIN_ULPS = 5.0, 16.0

#: Largest error at rest, and of a start, relative to 1 and the number; in float where it is not measured.
POSE_TOLERANCE = {"double": 1e-12, "float": 2e-3}

#: Largest difference of a path rate in float where nothing is recorded in C.
MOST_RATE = 0.05

#: Every how many samples the estimate is compared.
EVERY = 10


@dataclass(frozen=True)
class Accuracy:
    """Largest errors that a test vector allows in each of its parts, relative to each signal's largest value there, and
    a text for the README. `memory`: Of what is remembered, in the mean of its numbers. `rate`: Of the path rate.
    `start`: Of the memory at the start of the provocation. `pose`: As `POSE_TOLERANCE`. `exact`: Whether status and
    counts are those of each row."""

    inputs: tuple[float, ...]
    estimates: tuple[float, ...]
    text: str
    memory: tuple[float, ...] = ()
    rate: float = 0.0
    start: float = 1e-9
    pose: float = POSE_TOLERANCE["double"]
    exact: bool = True


@dataclass(frozen=True)
class Tested:
    """A controller with a recorded run for both roundings, or one for each, and what a test vector allows."""

    code: ControllerCode
    runs: Sequence[Recording]
    allowed: Accuracy


def tested(code: ControllerCode, run: Recording) -> Tested:
    """What a controller is tested with, of a recording of it: in double that recording, with both roundings; in float
    what the C answers on this machine, or where no compiler is, that recording.

    Raises InvalidInput: the compiler fails, or inputs lose more in float than `TOLERANCE`, and than `MOST_MOVED` while
    positions are moved. What is lost while the controller is provoked is no measure of it.
    """
    if code.real.name == "double":
        return Tested(code, with_both_roundings(code.controller, run), _in_double(code, len(run.parts)))
    if reason := why_not_answered():
        return Tested(code, (run,), _not_measured(run, reason))
    found = answered(
        code,
        run,
        lambda code: stimulus(code, run),
        lambda code: contract_values(code, run, POSE_TOLERANCE["float"]),
    )
    return Tested(code, _sure(found), _measured(code, run, found))


def _in_double(code: ControllerCode, parts: int) -> Accuracy:
    """Of inputs what the C library's functions may differ by."""
    most = TOLERANCE["double"] if code.translator.calls_library else 0.0
    called = f"nothing, if {code.name}_fused is 1 in a simulation with fused multiply-adds, and else in one without"
    called += f", but for the C library's functions: the test vector allows {most:.0e}" * (most > 0.0)
    return Accuracy((most,) * parts, (most,) * parts, called, (most,) * parts)


def _not_measured(run: Recording, reason: str) -> Accuracy:
    most = TOLERANCE["float"]
    text = f"not measured: {reason}; the test vector allows {100 * most:g} %"
    inputs = {"": most, "moved": SPARE * MOST_MOVED, "provoked": math.inf}
    estimates = (math.inf,) * len(run.parts)
    return Accuracy(
        tuple(inputs[part] for part in run.parts),
        estimates,
        text,
        rate=MOST_RATE,
        pose=POSE_TOLERANCE["float"],
        exact=False,
    )


def _measured(code: ControllerCode, run: Recording, found: CAnswers) -> Accuracy:
    """Nothing of the answers of the C, or what its library moves them by; refused where it is far from the
    recording."""
    plain, fused = (_errors(one, run)[0] for one in found.runs)
    most, parts = TOLERANCE["float"], list(run.parts)
    worst = np.maximum(plain, fused)
    moved = worst[parts.index("moved")] if "moved" in parts else 0.0
    said = MOVED.format(100.0 * moved) * ("moved" in parts)
    refuse_if(
        not (worst[0] <= most and moved <= MOST_MOVED),
        "The controller loses too much in float.",
        f"expected inputs within {100 * most:g} % of their largest value over the test vector, "
        f"got {100 * worst[0]:.2g} %{said}",
        "--real double; or larger noise levels of the estimator, which condition its covariances better",
    )
    least = MIN_ULPS * code.real.epsilon
    away = [_errors(*pair) for pair in zip(found.moved, found.runs)]
    inputs, estimates, memory = (
        tuple(np.maximum(least, SPARE * np.max(each, axis=0)).tolist()) if away else (0.0,) * len(parts)
        for each in zip(*(row[:3] for row in away or [((), (), ())]))
    )
    allows = f"the test vector has the numbers of this C, and allows {100 * max(inputs):.2g} % of them"
    return Accuracy(
        inputs,
        estimates,
        f"{100 * fused[0]:.2g} % of the input's largest value over the test vector, {100 * plain[0]:.2g} % without "
        f"fused multiply-adds, measured at the export{said}; "
        f"{allows if away else 'the test vector has the bits of this C'}",
        memory,
        rate=max((row[3] for row in away), default=0.0) * SPARE,
        start=least,
        pose=min(POSE_TOLERANCE["float"], max(least, SPARE * found.pose)),
    )


#: What is added of errors while measured positions are moved.
MOVED = "; {:.2g} % while positions are moved from outside"


def _errors(one: Recording, other: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Largest errors of inputs, estimates and memory in each part, relative as `Accuracy` has them, infinite where a
    result is not finite; and the largest one of the path rate."""

    def largest(away: np.ndarray, sizes: Sequence[np.ndarray]) -> np.ndarray:
        found = np.array([np.abs(away[part] / size).max() for part, size in zip(other.parts.values(), sizes)])
        return np.where(np.isfinite(found), found, math.inf)

    inputs, estimates = _sizes(other)
    with np.errstate(over="ignore", invalid="ignore"):
        sums = (one.memory_rows - other.memory_rows) @ _shares(other) / other.memory_rows.shape[1]
        return (
            largest(one.u - other.u, inputs),
            largest(one.estimate - other.estimate, estimates),
            largest(sums, [np.ones(())] * len(other.parts)),
            float(np.abs(np.subtract(one.path_rate, other.path_rate)).max()),
        )


def _sizes(run: Recording) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Largest values of inputs (m,) and estimates (n,) in each part, by which errors are divided."""
    inputs, estimates = list[np.ndarray](), list[np.ndarray]()
    for part in run.parts.values():
        largest = np.abs(run.estimate[part]).max(axis=0)
        inputs.append(np.maximum(np.abs(run.u[part]).max(axis=0), 1e-30))
        estimates.append(np.maximum(largest, 1e-3 * largest.max()))
    return inputs, estimates


def _sure(found: CAnswers) -> tuple[Recording, ...]:
    """The recordings of the C, with -1 for each status that a library may change."""
    runs = list(found.runs)
    for k, (one, off) in enumerate(zip(found.runs, found.moved)):
        runs[k] = replace(one, status=agreed(np.array(one.status), np.array(off.status)).tolist())
    return tuple(runs)


def agreed(one: np.ndarray, *others: np.ndarray) -> np.ndarray:
    """Whole numbers, or -1 where others differ."""
    for other in others:
        one = np.where(one == other, one, -1)
    return one


#: The test vector as C; stored inputs are exact, as in Python.
VECTOR: File[Tested] = File(
    "@{name}_test.c", "test.c", lambda it: vector_values(it.code, it.runs, it.allowed)
)


def stimulus(code: ControllerCode, run: Recording) -> dict[str, object]:
    """What the template of what is given needs."""
    return {
        "codes": run.codes,
        "y": run.y,
        "r": run.r,
        "measured": [int(kind != MISSING) for kind in run.kinds],
        "repeats": run.repeats,
        "provocation": run.provocation,
        "begun": run.begun,
        **_replaced(run, code.controller.initial_memory()),
    }


def vector_values(code: ControllerCode, runs: Sequence[Recording], allowed: Accuracy) -> dict[str, object]:
    """What the test vector consists of."""
    run, exact = runs[-1], allowed.exact
    calls = library_calls(mathematics(code.source), code.real)
    library = library_hash(calls, code.real) if exact and calls else None
    sizes, sizes_of_estimates = _sizes(run)
    initial = code.controller.initial_memory()
    tables = [f"0x{memory_hash(np.asarray(part, code.real.kind)):016x}u" for part in (code.defaults, initial)]
    numbers = [np.array([code.codes[kind].value for kind in one.codes]) for one in runs]
    return {
        **stimulus(code, run),
        "tables": tables,
        "codes": agreed(*numbers).tolist(),
        "unseen": agreed(*(_unseen(one) for one in runs)),
        "rejected": agreed(*(one.rejected for one in runs)),
        "runs": [
            {
                "u": one.u,
                "estimates": one.estimate[::EVERY],
                "status": one.status if exact else [-1] * len(one.status),
                "path_rate": one.path_rate,
                "doubtful": one.doubtful,
                "hashes": [f"0x{number >> 32:08x}u" for number in one.hashes],
                "sums": one.memory_rows @ _shares(run),
            }
            for one in runs
        ],
        "exact": exact,
        "hashes": exact,
        "library": None if library is None else f"0x{library:016x}u",
        "library_calls": calls,
        "arguments": ARGUMENTS,
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
    }


#: How many memories are looked at for the one that others are changes of.
BASES = 60

#: A share that no sum of a few comes near to a whole number of.
GOLDEN = 0.618034


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
    if run.unseen is not None:
        return run.unseen
    counts, found = np.zeros(run.y.shape[1], dtype=int), list[np.ndarray]()
    for k, (y, kind, times) in enumerate(zip(run.y, run.kinds, run.repeats, strict=True)):
        counts = counts * (k != run.begun)
        counts = np.where(np.isfinite(y) & (kind != MISSING), 0, counts + times)
        found.append(counts)
    return np.array(found)
