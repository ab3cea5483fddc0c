"""The door for commands. No mathematics here: options come in, rooms do the work, errors go out in three parts.

Nothing is imported before `main` is called, so that Ctrl-C is answered from then on.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

__all__ = ["main"]

#: What ends a command in order: Ctrl-C; `kill`, `docker stop`, a time limit; a terminal that is closed.
_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]

#: Seconds between two looks whether an interruption was lost on its way.
_LOOK_AGAIN = 1.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code. A user's mistake is printed in three parts, without a traceback.

    Ctrl-C, SIGTERM and SIGHUP end a command in order: what it had begun to write is cleared away, and the exit code is
    that of the shells, 128 and the number of the signal.
    """
    received: list[int] = []
    with _ended_in_order(received):
        try:
            from flexhinf.cli.commands import run

            code = run(arguments)
        except KeyboardInterrupt:  # before the command began, or again while it cleared away
            sys.stderr.write("error: Interrupted.\n")
            code = 128 + signal.SIGINT
        except Exception:
            if not received:
                raise
            sys.stderr.write("error: Interrupted.\n")  # what became of an interruption inside of a library
            code = 128 + signal.SIGINT
    return 128 + received[0] if received and code == 128 + signal.SIGINT else code


@contextmanager
def _ended_in_order(received: list[int]) -> Iterator[None]:
    """Raise KeyboardInterrupt at these signals; `received` tells which ones came.

    Only Ctrl-C is taken twice. Signals that are ignored, as under ``nohup``, or that somebody else handles are left as
    they are.
    """

    def end(number: int, frame: object) -> None:
        received.append(number)
        for other in handled:
            if other != signal.SIGINT:
                signal.signal(other, signal.SIG_IGN)
        if watched:
            signal.setitimer(signal.ITIMER_REAL, _LOOK_AGAIN, _LOOK_AGAIN)
        raise KeyboardInterrupt

    own = threading.current_thread() is threading.main_thread()
    usual = (signal.SIG_DFL, signal.default_int_handler)
    handled = {one: signal.getsignal(one) for one in _ENDING if own and signal.getsignal(one) in usual}
    watched = own and hasattr(signal, "setitimer") and signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
    if watched:
        signal.signal(signal.SIGALRM, _interrupt_again)
    for number in handled:
        signal.signal(number, end)
    unraisable, sys.unraisablehook = sys.unraisablehook, _quiet
    try:
        yield
    finally:
        sys.unraisablehook = unraisable
        if watched:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
        for number, handler in handled.items():
            signal.signal(number, handler)


def _interrupt_again(number: int, frame: object) -> None:
    """Raise KeyboardInterrupt again where none is on its way: CasADi loses those that come while it converts types."""
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return
        error = error.__context__
    raise KeyboardInterrupt


def _quiet(lost: Any) -> None:
    """Say nothing of an interruption that is lost in a callback of the interpreter: it is raised again."""
    if not issubclass(lost.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
