"""Both cores, where an array is large enough for it to pay."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from typing import Any

__all__ = ["run_all", "thread_count"]


def thread_count() -> int:
    """Threads to use: OMP_NUM_THREADS if it is set, else the processors this process may run on."""
    wanted = os.environ.get("OMP_NUM_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_all(task: Callable[..., None], arguments: Iterable[tuple[Any, ...]], large: bool) -> None:
    """Call `task` on each tuple of arguments, side by side if `large`; the calls must be independent.

    NumPy releases the interpreter while it gathers and multiplies, so plain threads are enough.
    """
    threads = thread_count() if large else 1
    if threads == 1:
        for argument in arguments:
            task(*argument)
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(lambda argument: task(*argument), arguments):
            pass
