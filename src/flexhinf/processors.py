"""How many threads to use: of the processors that this process may run on, or as many as were requested.

BLAS has one of its own, see `single_blas`.
"""

# threadpoolctl has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownMemberType=false

from __future__ import annotations

import math
import os
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future

Item = TypeVar("Item")
Result = TypeVar("Result")

#: Largest number of threads that can be requested.
MOST_THREADS = 1024

#: Where the system tells of control groups, and of those of this process.
GROUPS, OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")

_requested: list[int] = []

#: How a user states threads of BLAS.
_BLAS_THREADS = "OPENBLAS_NUM_THREADS"


def thread_count() -> int:
    """Threads to use, at least 1: as many as `limited_threads` says, else ``OMP_NUM_THREADS``, else `available`.

    No number that is computed depends on it.
    """
    if _requested:
        return _requested[-1]
    stated = (
        os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    )  # of nested levels, the outer one
    return int(stated) if stated.isdecimal() and stated.isascii() and int(stated) > 0 else available()


def available() -> int:
    """Processors that this process may run on: its affinity, and no more than the share of its groups (cgroup)."""
    own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min([own, *map(_share, own_groups("cpu", GROUPS, OWN_GROUPS))]))


def own_groups(controller: str, root: Path, own: Path) -> list[Path]:
    """Folders of the control groups of this process with their parents, of version 2 of the interface and of version 1,
    where it has a folder for each controller; in a container those that it sees."""
    paths = {"": "/", controller: "/"}
    with suppress(OSError, ValueError):
        for line in own.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            paths |= {name: path for name in controllers.split(",") if name in paths}
    return [
        root / name / str(folder).lstrip("/")
        for name, path in paths.items()
        for folder in (PurePosixPath(path), *PurePosixPath(path).parents)
    ]


def _share(group: Path) -> int:
    """Processors whose time a group may use, rounded up; very many where it is not limited."""
    try:
        if (group / "cpu.max").exists():
            quota, period = (group / "cpu.max").read_text().split()
        else:
            quota, period = ((group / f"cpu.cfs_{name}_us").read_text() for name in ("quota", "period"))
        share = float(quota) / float(period)
    except (OSError, ValueError, ZeroDivisionError):  # not limited ("max"), or no such system
        return sys.maxsize
    return math.ceil(share) if share > 0.0 else sys.maxsize


def set_threads(count: int) -> None:
    """Make this number the one of `thread_count`, in all of the process."""
    _requested.append(count)


@contextmanager
def limited_threads(count: int | None) -> Generator[None]:
    """Meanwhile `thread_count` is this number, in all of the process; None changes nothing."""
    if count is None:
        yield
        return
    _requested.append(count)
    try:
        yield
    finally:
        _requested.remove(count)


@contextmanager
def single_blas() -> Generator[None]:
    """Meanwhile BLAS has one thread, in all of the process and in those that it starts.

    Matrices of a design are small: with two threads of BLAS it takes five times as much CPU time, and longer. What the
    user states by ``OPENBLAS_NUM_THREADS`` stays. Before NumPy is loaded the variable alone is set, so that its threads
    never begin.
    """
    if _BLAS_THREADS in os.environ:  # by the user, or by a call around this one
        yield
        return
    os.environ[_BLAS_THREADS] = "1"
    try:
        with _limited_blas() if "numpy" in sys.modules else nullcontext():
            yield
    finally:
        os.environ.pop(_BLAS_THREADS, None)


def _limited_blas() -> AbstractContextManager[object]:
    from threadpoolctl import threadpool_limits

    import_module("scipy.linalg")  # has a BLAS of its own, which is limited only once it is loaded
    return threadpool_limits(1, "blas")


def in_threads(function: Callable[[Item], Result], items: Iterable[Item], most: int) -> Iterator[Result]:
    """What a function gives for each item, in their order, by at most so many threads: for one that waits for the disk,
    or works outside of the interpreter. Few items are begun before they are needed, and none after an error."""
    from concurrent.futures import Future, ThreadPoolExecutor

    threads, begun = min(most, thread_count()), deque[Future[Result]]()
    if threads <= 1:
        yield from map(function, items)
        return
    pool = ThreadPoolExecutor(threads)
    try:
        for item in items:
            begun.append(pool.submit(function, item))
            if len(begun) > 2 * threads:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def once_beside(work: Callable[[], Result]) -> Future[Result]:
    """What a thread of its own does, for work that waits for the disk."""
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(1)
    try:
        return pool.submit(work)
    finally:
        pool.shutdown(wait=False)
