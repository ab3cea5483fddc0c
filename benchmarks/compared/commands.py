"""The product's commands, run in processes of their own: what each costs, and where it is stopped."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

__all__ = ["Spent", "Stopped", "killed", "ran"]

#: Exit codes of a command that has done its work: all is met, and something is missed.
DONE = (0, 1)


@dataclass(frozen=True)
class Spent:
    """What commands took: processor seconds of all together, and the largest resident memory of any, MB."""

    cpu_s: float = 0.0
    memory_mb: float = 0.0

    def __add__(self, other: Spent) -> Spent:
        return Spent(self.cpu_s + other.cpu_s, max(self.memory_mb, other.memory_mb))


class Stopped(Exception):
    """A command that was not done within its processor seconds."""

    def __init__(self, spent: Spent) -> None:
        super().__init__(f"stopped after {spent.cpu_s:.0f} CPU s")
        self.spent = spent


def ran(words: Sequence[str], limit: float) -> Spent:
    """Run a command to its end; `Stopped` where it needs more than `limit` processor seconds."""
    return _ended(_begun(words, limit), words)


def killed(words: Sequence[str], limit: float, due: Callable[[], bool]) -> Spent:
    """Run a command until something is due, and end it by SIGKILL."""
    process = _begun(words, limit)
    while not due():
        if process.poll() is not None:
            raise RuntimeError(
                f"flexhinf {' '.join(words)} ended ({process.returncode}) before it was killed"
            )
        time.sleep(0.1)
    process.kill()
    return _ended(process, words, (-signal.SIGKILL,))


def _begun(words: Sequence[str], limit: float) -> subprocess.Popen[bytes]:
    seconds = max(1, int(limit))
    limited = partial(resource.setrlimit, resource.RLIMIT_CPU, (seconds, seconds + 5))
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    return subprocess.Popen(
        [sys.executable, "-m", "flexhinf", *words], env={**threads, **os.environ}, preexec_fn=limited
    )


def _ended(process: subprocess.Popen[bytes], words: Sequence[str], expected: Sequence[int] = DONE) -> Spent:
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    spent = Spent(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0)
    if process.returncode == -signal.SIGXCPU:
        raise Stopped(spent)
    if process.returncode not in expected:
        raise RuntimeError(f"flexhinf {' '.join(words)} ended with {process.returncode}")
    return spent
