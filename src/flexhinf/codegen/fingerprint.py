"""What a program's machine code depends on, as text: cheaper to write than the code it stands for."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from flexhinf.codegen.program import Program
from flexhinf.codegen.steps import Call, Map, Repeat, Step, When

__all__ = ["emitter_digest", "fingerprint"]


def fingerprint(program: Program) -> str:
    """Buffers, counts, steps, and every traced function in CasADi's own serial form.

    Two programs with the same fingerprint are the same to the last constant: a function's serial form holds its
    instructions, not what they were written as.
    """
    functions: dict[int, str] = {}

    def line(step: Step) -> str:
        if isinstance(step, Repeat):
            return f"Repeat({step.count!r}: {'; '.join(map(line, step.body))})"
        if isinstance(step, When):
            return f"When({step.flag!r}: {'; '.join(map(line, step.body))})"
        if not isinstance(step, Call | Map):
            return repr(step)
        key = step.function.__hash__()
        if key not in functions:
            functions[key] = step.function.serialize()
        times = step.times if isinstance(step, Map) else None
        number = list(functions).index(key)
        return f"{type(step).__name__}({number}, {step.inputs!r}, {step.outputs!r}, {times})"

    steps = [line(step) for step in program.body]
    lines = [repr(program.buffers), repr(program.counts), *steps]
    lines += [f"{len(text)} {text}" for text in functions.values()]
    return "\n".join(lines)


@cache
def emitter_digest() -> str:
    """SHA-256 of the sources that turn a program into LLVM text; empty where there are none to read."""
    digest = hashlib.sha256()
    for path in sorted((Path(__file__).parent / "emit").glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
