"""Program → kernel: machine code where possible, CasADi's evaluator where not, and that said once."""

from __future__ import annotations

import json
import logging
from functools import cache

from flexhinf.codegen.interpreter import interpret
from flexhinf.codegen.kernel import Kernel
from flexhinf.codegen.program import ENTRY, Program
from flexhinf.codegen.unsupported import Unsupported

_LOGGER = logging.getLogger("flexhinf.codegen")


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

    def make() -> bytes:
        """The C functions that are needed, on a line, and the object code."""
        from flexhinf.codegen.emit import emit_module

        module = emit_module(program, lanes, host.fused)
        effort = machine.Effort.for_size(module.operations)
        return json.dumps(module.library).encode() + b"\n" + machine.assemble(module.text, effort)

    made_by = (host.triple, host.cpu, host.features, host.version, emitter_digest(), version("flexhinf"))
    library, _, image = cached((fingerprint(program), str(lanes), *made_by), make).partition(b"\n")
    return NativeKernel(program, lanes, machine.Code(image, ENTRY, json.loads(library)))


@cache
def _notice(reason: str) -> None:
    _LOGGER.warning("%s; it runs on CasADi's evaluator instead, which is slower.", reason)
