"""A second process that judges claims, the longest first, while this one draws and judges the others from the shortest
on, until they meet.

Importing this file costs nothing, so that the process begins before this one loads the rest. If it dies, this process
judges its claims too.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, NamedTuple

from flexhinf.processors import thread_count

if TYPE_CHECKING:
    from ctypes import Array, c_int
    from multiprocessing.connection import Connection

    from flexhinf.paper.settings import PaperSettings
    from flexhinf.report import JudgedClaim


class Apart(NamedTuple):
    """The other process: how many claims it has begun from the first of `claims.BY_LENGTH` on, and this one from
    the last on, in memory that both share; and a function that waits for the next claim that the other has judged, None
    once it has ended.

    Each process says what it begins before it begins it. If both begin the same claim at once, both judge it, with the
    same result.
    """

    begun: Array[c_int]
    judged: Callable[[], JudgedClaim | None]


@contextmanager
def judged_apart(settings: PaperSettings) -> Generator[Apart | None]:
    """Begin to judge claims in another process, which is ended with the block.

    It gives None where this process has one thread only (`thread_count`). The process imports the main module again, as
    every process of Python's multiprocessing does.
    """
    if thread_count() < 2:
        yield None
        return
    context = multiprocessing.get_context("spawn")  # compiled code and threads do not survive a fork
    receiving, sending = context.Pipe(duplex=False)
    begun = context.RawArray("i", 2)
    arguments = settings, begun, sending, thread_count() // 2
    worker = context.Process(target=_judge_for_another, args=arguments, daemon=True)
    with _without_ctrl_c():
        worker.start()
    sending.close()

    def judged() -> JudgedClaim | None:
        try:
            return receiving.recv()
        except (EOFError, OSError):
            return None

    try:
        yield Apart(begun, judged)
    finally:
        worker.kill()
        worker.join()
        receiving.close()


@contextmanager
def _without_ctrl_c() -> Generator[None]:
    """Ctrl-C does not reach a process that begins in this block, where the system has signals; this one gets it after
    the block."""
    mask = getattr(signal, "pthread_sigmask", None)
    before = mask(signal.SIG_BLOCK, {signal.SIGINT}) if mask else ()
    try:
        yield
    finally:
        if mask:
            mask(signal.SIG_SETMASK, before)


def _judge_for_another(
    settings: PaperSettings, begun: Array[c_int], sending: Connection, threads: int
) -> None:
    from flexhinf.campaign.driver import begin_worker
    from flexhinf.paper.claims import BY_LENGTH
    from flexhinf.paper.loop_setup import PaperSetup, judge

    begin_worker(threads)
    with suppress(Exception):  # it is raised again where the claim is judged instead
        setup = PaperSetup(settings)
        for k, claim in enumerate(BY_LENGTH):
            if k + begun[1] >= len(BY_LENGTH):
                break
            begun[0] = k + 1
            sending.send(judge(setup, claim))
