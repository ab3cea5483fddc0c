"""Independent work shared out among copies of this process.

A copy (fork) has all that was computed before it, compiled code too: it begins at once, with the same bits. Each takes
what comes next from one queue, as this process does. What no copy sends back, since it failed or was killed, is
computed here, so that results and errors are those of one process.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from typing import Any, Generic, NoReturn, ParamSpec, TypeVar

from flexhinf.processors import set_threads, thread_count

Item = TypeVar("Item")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

#: Entries of the queue at most: two bytes each, which a pipe takes at once.
_ENTRIES = 2000

#: Size of a pipe of results, bytes: the most that a user may have by default.
_PIPE = 1 << 20

#: How long this process waits for a copy after its own last item, s, and as a multiple of its own longest one.
_PATIENCE, _LONGER = 20.0, 20.0

_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]

_copies_seconds = [0.0]

#: Copies that live: the threads that receive what they send, and the pipes from which these read.
_living: dict[int, tuple[threading.Thread, int]] = {}

#: Results of each function of `cached_by_all`, by its arguments; how many are kept.
_caches: list[tuple[dict[object, Any], int]] = []

#: In a copy: results that these have got since its last item, with the places of their caches.
_cached_here: list[tuple[int, object, Any]] | None = None

#: What `beside` has not begun yet, since no processor was free; the oldest first.
_waiting: list[_Beside[Any]] = []


def cpu_seconds() -> float:
    """CPU time of this process and of its copies that ended, s."""
    return time.process_time() + _copies_seconds[0]


def shared_out(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    begun: Callable[[], None] = lambda: None,
    compiles: bool = True,
) -> list[Result]:
    """What a function gives for each item, in their order, by as many processes as `thread_count` says.

    `compiles`: The first item is done before there are copies, which then have what it compiled. `begun` is called here
    before each item that this process does; what it raises ends all. Results of copies are pickled. One process does
    all where the system does not copy processes safely (other than Linux, or outside of the main thread).
    """
    results: dict[int, Result] = {}

    def compute(k: int) -> None:
        begun()
        results[k] = function(items[k])

    if items and compiles:
        compute(0)
    if min(thread_count(), len(items) - len(results)) > 1 and _can_copy():
        _with_copies(function, items, begun, results)
    for k in range(len(items)):
        if k not in results:
            compute(k)
    return [results[k] for k in range(len(items))]


@contextmanager
def beside(function: Callable[[], Result]) -> Generator[Callable[[], Result]]:
    """A function that gives the result of another one, which a copy computes while this process goes on.

    It begins when a processor is free, which is asked here, before each item of `shared_out`, which meanwhile has one
    process less, and with each result. Where there is no copy, the result is computed when it is asked for.
    """
    own = _Beside(function)
    try:
        if thread_count() > 1 and _can_copy():
            _waiting.append(own)
            _begin_waiting()
        yield own.result
    finally:
        own.end()


def cached_by_all(most: int) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """A decorator that keeps the newest results of a function of hashable arguments: what a copy computes is sent with
    its results, so that this process and later copies have it too."""

    def decorated(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        place, cache = len(_caches), dict[object, Any]()
        _caches.append((cache, most))

        @wraps(function)
        def cached(*args: Arguments.args, **options: Arguments.kwargs) -> Result:
            key = args, *options.items()
            if (result := cache.get(key)) is None:
                result = function(*args, **options)
                _keep(place, key, result)
            return result

        return cached

    return decorated


def _keep(place: int, key: object, result: Any) -> None:
    cache, most = _caches[place]
    cache[key] = result
    if _cached_here is not None:
        _cached_here.append((place, key, result))
    with suppress(RuntimeError):  # a thread that receives results adds one at this moment
        while len(cache) > most:
            cache.pop(next(iter(cache)), None)


class _Beside(Generic[Result]):
    """What `beside` computes: waiting, then by a copy or here."""

    def __init__(self, function: Callable[[], Result]) -> None:
        self._function, self._results, self._process = function, dict[int, Result](), 0

    def begin(self) -> None:
        """Begin a copy for it; where there is none, it is computed when it is asked for."""
        queue = _queue(1)
        try:
            self._process = _begin_copy(lambda _: self._function(), [None], [range(1)], queue, self._results)
        finally:
            os.close(queue)

    def result(self) -> Result:
        """The result; until a copy has sent it, this process does what waits for a processor."""
        if self in _waiting:
            _waiting.remove(self)
        if self._process in _living:
            thread, _ = _living[self._process]
            while thread.is_alive() and _waiting:
                other = _waiting.pop(0)
                with suppress(Exception):  # raised again when it is asked for
                    other.result()
            thread.join()
        if 0 not in self._results:
            self._results[0] = self._function()
        _begin_waiting()
        return self._results[0]

    def end(self) -> None:
        """End the copy, if there is one."""
        if self in _waiting:
            _waiting.remove(self)
        if self._process in _living:
            _end(self._process)


def _can_copy() -> bool:
    return sys.platform == "linux" and threading.current_thread() is threading.main_thread()


def _free() -> int:
    """Threads that neither this process nor a copy has."""
    return thread_count() - 1 - sum(thread.is_alive() for thread, _ in _living.values())


def _begin_waiting() -> None:
    while _waiting and _free() > 0:
        _waiting.pop(0).begin()


def _queue(entries: int) -> int:
    """The end to read of a pipe that holds so many numbers, from 0 on, and then ends."""
    queue, entrance = os.pipe()
    os.write(entrance, b"".join(k.to_bytes(2, "little") for k in range(entries)))
    os.close(entrance)
    return queue


def _begin_copy(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    blocks: Sequence[range],
    queue: int,
    results: dict[int, Result],
) -> int:
    """Begin a copy that does items of a queue, whose results are added as they come; 0 where there is no memory for
    it, or a process too many."""
    out, into = os.pipe()
    _enlarge(into)
    try:
        process = _copied()
    except OSError:
        os.close(out)
        os.close(into)
        return 0
    if not process:
        _be_a_copy(function, items, blocks, queue, into, [out, *(each for _, each in _living.values())])
    os.close(into)
    _living[process] = threading.Thread(target=_receive, args=(out, results), daemon=True), out
    _living[process][0].start()
    return process


def _enlarge(pipe: int) -> None:
    """Let a pipe take more at once, where the system allows it: a copy waits less for this process to read."""
    if sys.platform == "linux":
        import fcntl

        with suppress(OSError):
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE)


def _with_copies(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    begun: Callable[[], None],
    results: dict[int, Result],
) -> None:
    """Add results of the items that have none; those are left out of which a process failed, and those after them."""
    step = -(-len(items) // _ENTRIES)
    blocks = [range(k, min(k + step, len(items))) for k in range(len(results), len(items), step)]
    queue, own = _queue(len(blocks)), list[int]()

    def join(left: int) -> None:
        """Begin what waits, then copies for so many blocks: as many as there are threads that nothing else has, or has
        any more. Where one is refused, there are no others."""
        _begin_waiting()
        while 0 not in own and _free() > 0 and len(own) < min(thread_count() - 1, left):
            own.append(_begin_copy(function, items, blocks, queue, results))

    try:
        join(len(blocks) - 1)
        longest = _do_own(function, items, blocks, queue, begun, results, join)
        end = time.monotonic() + max(_PATIENCE, _LONGER * longest)
        for process in filter(None, own):
            _living[process][0].join(max(0.0, end - time.monotonic()))
    finally:
        os.close(queue)
        for process in filter(None, own):
            _end(process)


def _do_own(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    blocks: Sequence[range],
    queue: int,
    begun: Callable[[], None],
    results: dict[int, Result],
    join: Callable[[int], None],
) -> float:
    """Do items of the queue here until it is empty, or one fails; returns the longest time of one, s."""
    longest, failed = 0.0, False
    for entry in _taken(queue):
        for k in blocks[entry]:
            if failed:  # the queue is emptied
                continue
            join(len(blocks) - 1 - entry)
            begun()
            start = time.monotonic()
            try:
                results[k] = function(items[k])
            except Exception:  # raised again by whoever does the first item that failed
                failed = True
            longest = max(longest, time.monotonic() - start)
    return longest


def _taken(queue: int) -> Iterator[int]:
    while entry := os.read(queue, 2):
        yield int.from_bytes(entry, "little")


def _copied() -> int:
    """Fork; Ctrl-C and the like do not reach the copy before it ignores them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    process = -1
    try:
        with warnings.catch_warnings():
            # threads of the parent, such as one that draws a bar, do not matter here
            warnings.simplefilter("ignore", DeprecationWarning)
            process = os.fork()
        if not process:
            signal.set_wakeup_fd(-1)
            for number in _SIGNALS:
                signal.signal(number, signal.SIG_IGN if number == signal.SIGINT else signal.SIG_DFL)
        return process
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _be_a_copy(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    blocks: Sequence[range],
    queue: int,
    into: int,
    others: Sequence[int],
) -> NoReturn:
    """Do items of the queue and send their results, then end at once: nothing of the parent's is flushed or closed."""
    global _cached_here
    try:
        gc.freeze()  # what the parent left is not finalised here
        set_threads(1)
        for other in others:  # if the parent is killed, nobody reads any more
            os.close(other)
        with open(into, "wb") as out:
            for entry in _taken(queue):
                for k in blocks[entry]:
                    _cached_here = list[tuple[int, object, Any]]()
                    pickle.dump((k, function(items[k]), _cached_here), out, pickle.HIGHEST_PROTOCOL)
                out.flush()
    except BaseException:  # the parent does what is missing, and raises what it raises
        os._exit(1)
    finally:
        os._exit(0)


def _receive(out: int, results: dict[int, Result]) -> None:
    # an exception is the end, or that of a copy that was killed
    with open(out, "rb", closefd=False) as file, suppress(Exception):
        while True:
            k, result, found = pickle.load(file)
            for each in found:
                _keep(*each)
            results[k] = result


def _end(process: int) -> None:
    """End a copy if it lives, which its open pipe says, and count its CPU time."""
    thread, out = _living[process]
    with suppress(ProcessLookupError, ChildProcessError):
        if thread.is_alive():
            os.kill(process, signal.SIGKILL)
        usage = os.wait4(process, 0)[2]
        _copies_seconds[0] += usage.ru_utime + usage.ru_stime
    thread.join()
    os.close(out)
    del _living[process]
