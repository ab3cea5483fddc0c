"""Claims that a process of its own judges, while this one judges the others and draws.

Growth rates and trials of filters take half of the reproduction's time. Importing this file costs nothing, so that the
process begins before this one loads the rest. If it dies, this process judges its claims too.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flexhinf.paper.settings import PaperSettings
    from flexhinf.report import Claim


@contextmanager
def judged_apart(settings: PaperSettings) -> Iterator[Callable[[], Claim | None] | None]:
    """Begin to judge `reproduction.LONG_CLAIMS` in another process; gives a function that waits for the next of them
    and returns None once the process has died. At the end of the block the process is ended.

    It gives None where this process may run on one processor only. The process imports the main module again, as every
    process of Python's multiprocessing does.
    """
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if count < 2:
        yield None
        return
    context = multiprocessing.get_context("spawn")  # compiled code and threads do not survive a fork
    receiving, sending = context.Pipe(duplex=False)
    worker = context.Process(target=_judge_for_another, args=(settings, sending), daemon=True)
    with _without_ctrl_c():
        worker.start()
    sending.close()

    def judged() -> Claim | None:
        try:
            return receiving.recv()
        except (EOFError, OSError):
            return None

    try:
        yield judged
    finally:
        worker.kill()
        worker.join()
        receiving.close()


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Ctrl-C does not reach a process that begins in this block, where the system has signals; this one gets it after
    the block."""
    mask = getattr(signal, "pthread_sigmask", None)
    before = mask(signal.SIG_BLOCK, {signal.SIGINT}) if mask else ()
    try:
        yield
    finally:
        if mask:
            mask(signal.SIG_SETMASK, before)


def _judge_for_another(settings: PaperSettings, sending: Any) -> None:
    from flexhinf.campaign.driver import begin_worker
    from flexhinf.paper.loop_setup import PaperSetup, judge
    from flexhinf.paper.reproduction import LONG_CLAIMS

    begin_worker()
    with suppress(Exception):  # it is raised again where the claim is judged instead
        setup = PaperSetup(settings)
        for claim in LONG_CLAIMS:
            sending.send(judge(setup, claim))
