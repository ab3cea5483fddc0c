"""The command line. No mathematics here: it reads options, calls the packages, prints errors in three parts.

::

    words of a shell ─► commands ─► arguments ─┬─► design, campaign, logs and others ─► a report in a folder
                        options ───────────────┘   └─► messages ─► text on the screen, exit code

Enter at `main`. Nothing is imported before it is called, so that Ctrl-C is answered from then on.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from typing import Any, NoReturn

__all__ = ["console", "main"]

#: What ends a command in order: Ctrl-C; `kill`, `docker stop`, a time limit; a terminal that is closed.
_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]

#: Seconds between two looks whether an interruption was lost on its way.
_LOOK_AGAIN = 1.0

#: Seconds that a command may take to end after a signal: a compiler may be busy for longer, on the main thread or on
#: one that this waits for, and `docker stop` waits for ten.
_PATIENCE = 5.0

#: Objects that are made between two searches for cycles of them, about.
_BETWEEN_COLLECTIONS = 10_000

#: Exit code where nobody reads the output any more, as under ``| head -1``: that of the shells for SIGPIPE.
_NO_READER = 128 + 13


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code. A user's mistake is printed in three parts, without a traceback.

    Ctrl-C, SIGTERM and SIGHUP end a command in order: what it had begun to write is cleared away, and the exit code is
    that of the shells, 128 and the number of the signal; 141 where nobody reads the output any more. A command that is
    in the middle of compiled code is ended after `_PATIENCE`, as SIGKILL would: files are whole all the same.
    """
    received: list[int] = []
    # Few objects are in cycles: looking for these as often as by default takes a tenth of the time of imports.
    thresholds = gc.get_threshold()
    gc.set_threshold(_BETWEEN_COLLECTIONS, *thresholds[1:])
    # Drawings go into files, and Matplotlib fails on a backend that it does not know.
    backend = os.environ.pop("MPLBACKEND", None)
    with _ended_in_order(received), _every_character():
        try:
            from flexhinf.processors import single_blas

            with single_blas():  # before NumPy is loaded
                from flexhinf.cli.commands import run

                code = run(arguments)
            for stream in _streams():
                stream.flush()
        except (SystemExit, BrokenPipeError) as error:
            # rich and typer make the first of a pipe without a reader
            if isinstance(error, SystemExit) and not isinstance(error.__context__, BrokenPipeError):
                raise
            code = _NO_READER
        except (KeyboardInterrupt, Exception) as error:
            # before the command began, again while it cleared away, or as a library passed the interruption on
            if received or isinstance(error, KeyboardInterrupt):
                sys.stderr.write("error: Interrupted.\n")
                code = 128 + signal.SIGINT
            elif isinstance(error, (OSError, MemoryError, ImportError)):
                # what the system did not give before the command began, or to its own output
                code = 2
                with suppress(OSError):
                    sys.stderr.write(
                        "error: The system refuses what this command needs.\n"
                        "  found: expected memory, libraries and output, got "
                        f"{type(error).__name__}: {str(error)[:400]}\n"
                        "  try:   more memory (ulimit -v), the installation again, another place for the output\n"
                    )
            else:
                raise
        finally:
            gc.set_threshold(*thresholds)
            if backend is not None:
                os.environ["MPLBACKEND"] = backend
    return 128 + received[0] if received and code == 128 + signal.SIGINT else code


def console() -> NoReturn:
    """`main` as a process of its own, which an interrupted command ends also where a thread is still busy in compiled
    code: the interpreter would wait for that thread."""
    code = main()
    if code > 128:
        end = threading.Timer(_PATIENCE, os._exit, [code])
        end.daemon = True
        end.start()
    sys.exit(code)


def _streams() -> list[Any]:
    return [stream for stream in (sys.stdout, sys.stderr) if stream is not None and not stream.closed]


@contextmanager
def _every_character() -> Generator[None, None, None]:
    """Write characters that the terminal's or pipe's encoding lacks (≤ in Latin-1, ° in ASCII) as Python escapes them.

    What cannot be written is let go of: at its end the interpreter would try, and fail, once more.
    """
    changed = [(stream, stream.errors) for stream in _streams() if hasattr(stream, "reconfigure")]
    for stream, _ in changed:
        stream.reconfigure(errors="backslashreplace")
    try:
        yield
    finally:
        for stream, errors in changed:
            if not stream.closed:
                try:
                    stream.flush()
                except OSError:  # send to nowhere what stands in its buffer
                    with suppress(OSError, ValueError), open(os.devnull, "wb") as nowhere:
                        os.dup2(nowhere.fileno(), stream.fileno())
                with suppress(OSError):
                    stream.reconfigure(errors=errors)


@contextmanager
def _ended_in_order(received: list[int]) -> Generator[None, None, None]:
    """Raise KeyboardInterrupt at these signals; `received` tells which ones came.

    Only Ctrl-C is taken twice. Signals that are ignored, as under ``nohup``, or that somebody else handles are left as
    they are.
    """

    def end(number: int, frame: object) -> None:
        received.append(number)
        for other in handled.keys() - {signal.SIGINT}:
            signal.signal(other, signal.SIG_IGN)
        if watched:
            signal.setitimer(signal.ITIMER_REAL, _LOOK_AGAIN, _LOOK_AGAIN)
        raise KeyboardInterrupt

    own = threading.current_thread() is threading.main_thread()
    usual = (signal.SIG_DFL, signal.default_int_handler)
    handled = {n: signal.getsignal(n) for n in _ENDING if own and signal.getsignal(n) in usual}
    watched = own and hasattr(signal, "setitimer") and signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
    if watched:
        signal.signal(signal.SIGALRM, _interrupt_again)
    for number in handled:
        signal.signal(number, end)
    unraisable, sys.unraisablehook = sys.unraisablehook, _quiet
    try:
        with _ended_in_any_case(end) if watched else nullcontext():
            yield
    finally:
        sys.unraisablehook = unraisable
        if watched:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
        for number, handler in handled.items():
            signal.signal(number, handler)


@contextmanager
def _ended_in_any_case(handler: Callable[[int, Any], object]) -> Generator[None, None, None]:
    """End the process where a signal of this handler has not ended the block, which waits for a compiled function. The
    system tells another thread of every signal by a pipe."""
    over = threading.Event()
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)

    def watch() -> None:
        while numbers := os.read(reader, 16):
            for number in numbers:
                if signal.getsignal(number) is handler and not over.wait(_PATIENCE):
                    with suppress(OSError):
                        os.write(
                            2,
                            b"error: Interrupted in the middle of a computation.\n",
                        )
                    os._exit(128 + number)

    thread = threading.Thread(target=watch, name="signals", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        os.close(writer)
        thread.join()
        os.close(reader)


def _interrupt_again(number: int, frame: object) -> None:
    """Raise KeyboardInterrupt again where none is on its way: CasADi loses those that come while it converts types."""
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return
        error = error.__context__
    raise KeyboardInterrupt


def _quiet(lost: Any) -> None:
    """Print nothing about an interruption that is lost in a callback of the interpreter: it is raised again."""
    if not issubclass(lost.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
