"""Program → kernel: machine code where possible, CasADi's evaluator where not, and that said once."""

from __future__ import annotations

import logging
from functools import cache

from flexhinf.codegen.interpreter import interpret
from flexhinf.codegen.kernel import Kernel
from flexhinf.codegen.program import Program
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
    from flexhinf.codegen.emit import ENTRY, emit_module
    from flexhinf.codegen.native import NativeKernel

    host = machine.host()
    module = emit_module(program, lanes, host.fused)
    effort = machine.Effort.for_size(module.operations)
    parts = (
        module.text,
        host.triple,
        host.cpu,
        host.features,
        host.version,
        repr(effort),
        version("flexhinf"),
    )
    image = cached(parts, lambda: machine.assemble(module.text, effort))
    return NativeKernel(program, lanes, machine.Code(image, ENTRY, module.library))


@cache
def _notice(reason: str) -> None:
    _LOGGER.warning("%s; it runs on CasADi's evaluator instead, which is slower.", reason)
