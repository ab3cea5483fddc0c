"""Claims that a process of its own judges, while this one judges the others and draws.

Its growth rates and trials of filters take half of the reproduction's time. If it dies, this process judges them too.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import Any

from flexhinf.campaign.driver import begin_worker
from flexhinf.paper.loop_setup import PaperSetup, StatedClaim, judge
from flexhinf.paper.settings import PaperSettings
from flexhinf.report import Claim


@contextmanager
def judged_apart(
    settings: PaperSettings, claims: Collection[StatedClaim]
) -> Iterator[Callable[[], Claim | None]]:
    """Begin to judge these claims in another process; gives a function that waits for the next one, in their order, and
    returns None once the process has died. At the end of the block the process is ended."""
    context = multiprocessing.get_context("spawn")  # compiled code and threads do not survive a fork
    receiving, sending = context.Pipe(duplex=False)
    arguments = (settings, [claim.id for claim in claims], sending)
    worker = context.Process(target=_judge_for_another, args=arguments, daemon=True)
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
    """A process that begins in this block is not reached by Ctrl-C, where the system has signals; this one is, after
    it."""
    mask = getattr(signal, "pthread_sigmask", None)
    before = mask(signal.SIG_BLOCK, {signal.SIGINT}) if mask else ()
    try:
        yield
    finally:
        if mask:
            mask(signal.SIG_SETMASK, before)


def _judge_for_another(settings: PaperSettings, names: Collection[str], sending: Any) -> None:
    from flexhinf.paper.reproduction import CLAIMS

    begin_worker()
    setup = PaperSetup(settings)
    for claim in CLAIMS:
        if claim.id in names:
            sending.send(judge(setup, claim))
