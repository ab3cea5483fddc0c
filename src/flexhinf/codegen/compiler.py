"""Program → kernel: machine code where possible, CasADi's evaluator where not, and that said once."""

from __future__ import annotations

import json
import logging
import os
import sys
import threading
from functools import cache
from typing import Any

from flexhinf.codegen.interpreter import interpret
from flexhinf.codegen.kernel import Kernel
from flexhinf.codegen.program import ENTRY, Program
from flexhinf.codegen.unsupported import Unsupported

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
    program : Program
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
    from flexhinf.codegen.fingerprint import emitter_digest, fingerprint
    from flexhinf.codegen.native import NativeKernel

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
