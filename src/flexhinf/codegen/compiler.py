"""Program → kernel: machine code where possible, CasADi's evaluator where not, and that said once."""

from __future__ import annotations

import ctypes
import hashlib
import json
import logging
import os
import sys
import threading
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.codegen.interpreter import interpret
from flexhinf.codegen.kernel import Kernel, Status
from flexhinf.codegen.memory import aligned
from flexhinf.codegen.program import ENTRY, Program, Unsupported
from flexhinf.codegen.steps import Call, Map, Repeat, Step, Sweep, When

if TYPE_CHECKING:
    from flexhinf.codegen.machine import Code

_LOGGER = logging.getLogger("flexhinf.codegen")

#: Held while something is compiled or loaded, and while this process is forked: LLVM has global state, which a child
#: that was forked in the middle of it would find locked for ever.
_LOCK = threading.RLock()


def _before_fork() -> None:
    _LOCK.acquire()
    if lock := _lock_of_llvm():
        lock.acquire()


def _after_fork() -> None:
    if lock := _lock_of_llvm():
        lock.release()
    _LOCK.release()


def _lock_of_llvm() -> Any:
    """llvmlite's own lock, which every call of it takes, the release of old code too; None before it is loaded."""
    module = sys.modules.get("llvmlite.binding.ffi")
    return getattr(getattr(getattr(module, "lib", None), "_lock", None), "_lock", None)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_after_fork)


def compile_program(program: Program, lanes: int = 1) -> Kernel:
    """Compile a program for this processor.

    Parameters
    ----------
    lanes : int
        W ≥ 1 runs at once, in the lanes of vector registers; 8 suits most processors.

    Returns
    -------
    Kernel
        ``kernel.compiled`` tells whether it is machine code. An operation without machine code, or a machine
        on which LLVM does not work, gives an interpreted kernel, and a notice through `logging`, once per
        reason.

    Raises
    ------
    InvalidInput
        Lanes that are not a positive integer.

    Notes
    -----
    The bits of a result depend neither on W nor on the optimisation: products are fused into sums by our own
    rule, no operation may be reordered, and sin and cos are the same sequence of operations for any W.
    """
    fallback = interpret(program, lanes)
    try:
        with _LOCK:
            return _compile(program, lanes)
    except Unsupported as reason:
        _notice(f"{reason.what} {reason.found}")
    except (ImportError, OSError, RuntimeError) as reason:
        _notice(f"llvmlite does not work here ({reason})")
    return fallback


def _compile(program: Program, lanes: int) -> Kernel:
    from importlib.metadata import version

    from flexhinf.codegen import machine
    from flexhinf.codegen.cache import cached
    from flexhinf.codegen.compiler import NativeKernel, emitter_digest, fingerprint

    host = machine.host()

    def load(code: bytes) -> NativeKernel:
        library, _, image = code.partition(b"\n")
        return NativeKernel(program, lanes, machine.Code(image, ENTRY, json.loads(library)))

    def make() -> bytes:
        """The C functions that are needed, on a line, and the object code."""
        from flexhinf.codegen.emit import emit_module

        module = emit_module(program, lanes, host.fused)
        level = machine.level(module.operations)
        return json.dumps(module.library).encode() + b"\n" + machine.assemble(module.text, level)

    made_by = (host.triple, host.cpu, host.features, host.version, emitter_digest(), version("flexhinf"))
    return cached((fingerprint(program), str(lanes), *made_by), make, load)


@cache
def _notice(reason: str) -> None:
    _LOGGER.warning("%s; it runs on CasADi's evaluator instead, which is slower.", reason)


#: The entry called without and with the interpreter's lock.
_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)
_SHORT_ENTRY = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)


class NativeKernel(Kernel):
    """Machine code of a program.

    Parameters
    ----------
    code : Code
        Made from this program for these lanes.
    """

    compiled = True

    def __init__(self, program: Program, lanes: int, code: Code) -> None:
        super().__init__(program, lanes)
        self.code = code
        self.entry, self.short_entry = _ENTRY(code.address), _SHORT_ENTRY(code.address)

    def _bind(self, arrays: dict[str, np.ndarray], counts: dict[str, int], short: bool) -> BoundCode:
        arrays = dict(arrays)
        for buffer in self.program.buffers:
            if buffer.role == "work":
                arrays[buffer.name] = aligned((buffer.size or 0) * self.lanes)
        addresses = [arrays[buffer.name].ctypes.data for buffer in self.program.buffers]
        words = [*addresses, *(counts[name] for name in self.program.counts)]
        context = np.array([*words, *[0] * self.lanes, *[-1] * self.lanes], dtype=np.int64)
        bound = BoundCode(self.short_entry if short else self.entry, ctypes.c_void_p(context.ctypes.data))
        bound.keep = (self, arrays, context)
        bound.outcome = context[len(words) :]
        return bound


class BoundCode(partial):
    """The entry with its one argument: calling it runs no Python code at all.

    Attributes
    ----------
    keep : tuple
        The kernel, the arrays and the context, alive as long as this object.
    outcome : (2·lanes,) array of int
        Codes and steps of the last call.
    """

    keep: tuple
    outcome: np.ndarray

    @property
    def status(self) -> Status:
        """Status of the last call."""
        codes, steps = self.outcome.reshape(2, -1)
        if len(codes) == 1:
            return Status(int(codes[0]), int(steps[0]))
        return Status(codes.copy(), steps.copy())


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
        if isinstance(step, Sweep):
            return f"Sweep({step.inputs!r}, {step.outputs!r}, {step.size}: {'; '.join(map(line, step.body))})"
        if not isinstance(step, Call | Map):
            return repr(step)
        key = step.function.__hash__()
        if key not in functions:
            functions[key] = step.function.serialize()
        number = list(functions).index(key)
        return f"{type(step).__name__}({number}, {step.inputs!r}, {step.outputs!r})"

    steps = [line(step) for step in program.body]
    lines = [repr(program.buffers), repr(program.counts), *steps]
    lines += [f"{len(text)} {text}" for text in functions.values()]
    return "\n".join(lines)


@cache
def emitter_digest() -> str:
    """SHA-256 of the sources that turn a program into LLVM text; empty where there are none to read."""
    digest = hashlib.sha256()
    here = Path(__file__).parent
    for path in (here / "noise.py", *sorted((here / "emit").glob("*.py"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()
