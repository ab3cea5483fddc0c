"""Run the missing batches of a campaign in this process, in processes or on a cluster, and merge them; workers only
compute."""

from __future__ import annotations

# The package distributed has no types of what futures hold.
# pyright: reportMissingTypeArgument=false, reportUnknownArgumentType=false, reportUnknownLambdaType=false
# pyright: reportUnknownMemberType=false, reportUnknownParameterType=false, reportUnknownVariableType=false
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from contextvars import copy_context
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Protocol, TypeVar, Unpack

from flexhinf import __version__
from flexhinf.campaign.batches import (
    LARGEST_BATCH,
    Campaign,
    Rows,
    checked_integer,
    run_batch,
    run_batches,
)
from flexhinf.campaign.draws import Draw, DrawFunction
from flexhinf.campaign.journal import Journal, disk_refusals
from flexhinf.campaign.merging import GrowingTable
from flexhinf.campaign.metrics import MetricsLike
from flexhinf.campaign.results import GatheredRows, MergedTable, merged
from flexhinf.codegen import cuda
from flexhinf.codegen.gpu import Device
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.loop.simulation.inputs import RunOptions
from flexhinf.processors import MOST_THREADS, limited_threads, set_threads, single_blas, thread_count
from flexhinf.validation import extra_package, unknown_name, value_text

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Future as DaskFuture

    from flexhinf.loop import Loop

#: An executor runs batches of a campaign and yields each once, in any order.
Executor = Callable[[Campaign, Sequence[int]], Iterator[tuple[int, Rows]]]

#: Submitted batches per thread of the cluster; and how long a scheduler may take to answer, s.
AHEAD, PATIENCE = 2, 10.0

#: How long batches that run at once may take, s: progress is reported, and Ctrl-C noticed, between them.
TOGETHER = 1.0

#: Number of threads that write files, most of whose time is that of the disk; samples that may wait for them, but none
#: after a batch that took so long, s.
WRITERS, WAITING, LONG = 4, LARGEST_BATCH, 0.5

#: Number of worker deaths in a row, without a finished batch, after which the driver gives up.
DEATHS = 5

MOST_WORKERS = 10_000


class Pending(Protocol):
    """A batch that another process runs."""

    def result(self) -> Rows:
        """Its rows, or the error that it raised."""
        ...


Submitted = TypeVar("Submitted", bound=Pending)


def in_cluster(address: str, device: Device = "cpu") -> Executor:
    """An executor on the workers of a scheduler of Dask's, ``tcp://host:8786``.

    If a worker dies, others run its batches. If the scheduler dies, the campaign ends; finished batches are kept, and
    the same call continues. The workers need flexhinf of the driver's version. `device`: Where they
    make their runs; those without a GPU on their processor.
    InvalidInput for an address of another form, or where `distributed` is not installed.
    """
    refuse_if(
        "://" not in str(address),
        "The address of the cluster cannot be read.",
        f"expected tcp://HOST:PORT, got {value_text(address)}",
        "tcp://localhost:8786, which `dask scheduler` prints",
    )
    extra_package(
        "distributed", "cluster", "A campaign on a cluster needs distributed, which is not installed."
    )

    def run(campaign: Campaign, batches: Sequence[int]) -> Iterator[tuple[int, Rows]]:
        import cloudpickle  # type: ignore[import-not-found]
        from distributed import CancelledError, Client, KilledWorker, as_completed  # type: ignore[import-not-found]

        try:
            client: Client = Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InvalidInput(
                "The cluster does not answer.",
                f"expected a scheduler at {address}, got {value_text(str(error))}",
                "`dask scheduler` there, and `dask worker` with its address",
            ) from error
        pending: dict[DaskFuture, int] = {}

        def submit(batch: int) -> DaskFuture:
            future = client.submit(remote_batch, content, batch, __version__, device, pure=False)
            done.add(future)
            return future

        try:
            content, done = cloudpickle.dumps(campaign), as_completed(loop=client.loop)
            yield from _as_done(
                submit,
                lambda: [next(done)],
                batches,
                lambda: AHEAD * max(1, sum(client.nthreads().values())),  # pyright: ignore[reportAttributeAccessIssue]
                pending,
            )
        except (CancelledError, KilledWorker, OSError) as error:
            raise FlexhinfError(
                "The cluster was lost, or its workers die; what is written stays.",
                f"{address}: {type(error).__name__}: {str(error)[:200]}",
                "the same command, once the cluster runs again; smaller batches where memory is what workers lack",
            ) from error
        finally:
            for future in pending:
                future.release()
            client.close(timeout=PATIENCE)

    return run


def _as_done(
    submit: Callable[[int], Submitted],
    first_done: Callable[[], Iterable[Submitted]],
    batches: Sequence[int],
    most: Callable[[], int],
    pending: dict[Submitted, int],
) -> Iterator[tuple[int, Rows]]:
    """Keep `most()` batches submitted, and yield each when it is done; `pending` holds those submitted and not done."""
    remaining = iter(batches)
    while True:
        pending.update((submit(batch), batch) for batch in islice(remaining, max(most() - len(pending), 0)))
        if not pending:
            return
        for future in first_done():
            rows = future.result()  # a batch that raises here stays in `pending`
            yield pending.pop(future), rows


def remote_batch(sent: bytes, batch: int, version: str, device: Device = "cpu") -> Rows:
    """Run a batch of a pickled campaign in another process, and return its rows; without a GPU on its processor."""
    refuse_if(
        version != __version__,
        "The workers run another version of flexhinf.",
        f"expected {version}, got {__version__}",
        "the driver's version on every worker",
    )
    return run_batch(_worker_campaign(sent), batch, device_here(device))


def device_here(device: Device) -> Device:
    """The device, or the processor of a machine without it."""
    return "gpu" if device == "gpu" and cuda.is_there() else "cpu"


_worker_campaign = lru_cache(2)(pickle.loads)  # keeps compiled code from batch to batch


@dataclass
class Shard:
    """Every n-th batch, for one of n jobs: `number` is 1 … `of`. `name` is part of its lock file's name, "" without
    shards."""

    number: int = 1
    of: int = 1

    def __post_init__(self) -> None:
        refuse_if(
            not 1 <= self.number <= self.of,
            "There is no such shard.",
            f"expected 1/n to n/n, got {self.number}/{self.of}",
            "--shard 1/8",
        )
        self.name = "" if self.of == 1 else f"{self.number}-of-{self.of}"

    @staticmethod
    def read(text: str) -> Shard:
        """Read ``3/8``; InvalidInput for another text."""
        number, _, of = (part.strip() for part in text.partition("/"))
        refuse_if(
            not (number.isdecimal() and of.isdecimal()),
            "The shard cannot be read.",
            f"expected i/n, got {value_text(text)}",
            "--shard 1/8 … --shard 8/8",
        )
        return Shard(int(number), int(of))


@dataclass(frozen=True)
class Report:
    """Progress of a driver: samples of its shard that are done and in all, those that it ran itself, and a warning."""

    done: int
    total: int
    fresh: int
    note: str = ""


def drive(
    campaign: Campaign,
    journal: Journal,
    *,
    shard: Shard | None = None,
    executor: Executor | None = None,
    progress: Callable[[Report], None] = lambda report: None,
) -> MergedTable | None:
    """Run the missing batches of a shard (default: all) with an executor (default: this process), and merge the table.

    Returns None while other shards are not done. InvalidInput if another driver is at work or a sample is refused;
    FlexhinfError if the disk is full, workers die, or a batch is not run.
    """
    shard = shard or Shard()
    with journal.driven(shard.name):
        good, bad = journal.shards()
        own = range(shard.number - 1, journal.batches, shard.of)
        missing = [batch for batch in own if batch not in good]
        total, fresh = sum(map(journal.size, own)), 0
        done = total - sum(map(journal.size, missing))
        for path, wrong in bad:
            with disk_refusals(journal.folder):
                aside = journal.set_aside(path)
            again = f"{path.name} is {wrong}; it is now called {aside.name}, and its samples run again"
            progress(Report(done, total, fresh, again))
        progress(Report(done, total, fresh))
        journal.clear()
        with closing(GrowingTable(journal, good)) as table:
            go_on = table.go_on if shard.of == 1 else _nothing
            with (
                closing(_run(executor or in_this_process, campaign, missing)) as results,
                closing(_written(journal, results, go_on)) as files,
            ):
                for batch, path in files:
                    good[batch] = path
                    go_on()
                    fresh += journal.size(batch)
                    progress(Report(done + fresh, total, fresh))
            if shard.of > 1:
                good = journal.shards()[0]
            return None if len(good) < journal.batches else merged(journal, good, table)


def _nothing() -> None:
    """For a table to which other drivers add batches."""


def _written(
    journal: Journal, results: Iterable[tuple[int, Rows]], held: Callable[[], None]
) -> Generator[tuple[int, Path], None, None]:
    """Write batches while the next ones run; each with its file, once that is on the disk, in any order. `held` is that
    of `Journal.write`.

    Where this ends early, what was taken is written, unless the disk refuses. After a batch for which it waited `LONG`
    nothing is left to write, so that little is lost, and progress is told, where batches take long.
    """
    pool, finished, waiting = ThreadPoolExecutor(WRITERS), SimpleQueue[Future[tuple[int, Path]]](), 0

    def write(batch: int, rows: Rows) -> tuple[int, Path]:
        return batch, journal.write(batch, rows, held)

    def next_written() -> tuple[int, Path]:
        nonlocal waiting
        try:
            batch, path = finished.get().result()
        except FlexhinfError:
            pool.shutdown(cancel_futures=True)
            raise
        waiting -= journal.size(batch)
        return batch, path

    try:
        begun = time.perf_counter()
        for batch, rows in results:
            # what is written here is that of the context in which this runs, see `files.recorded`
            pool.submit(copy_context().run, write, batch, rows).add_done_callback(finished.put)
            waiting += journal.size(batch)
            most = 0 if time.perf_counter() - begun > LONG else WAITING
            while waiting > most or (waiting and not finished.empty()):
                yield next_written()
            begun = time.perf_counter()
        while waiting:
            yield next_written()
    finally:
        pool.shutdown()


def on_device(device: Device) -> Executor:
    """The executor of this process, on its GPU if that is the device; FlexhinfError without one."""
    if device == "cpu":
        return in_this_process
    cuda.card()
    return partial(in_this_process, device=device)


def in_this_process(
    campaign: Campaign, batches: Sequence[int], device: Device = "cpu"
) -> Generator[tuple[int, Rows], None, None]:
    """Run the batches in this process: as many at once as take about `TOGETHER`, by the time that the last ones took.

    With several threads, the next ones are drawn and the rows of the last ones made while some run, unless a user's
    code does that. No row depends on what runs beside it.
    """
    remaining, count = list(batches), 1
    begun: deque[tuple[list[int], Callable[[], list[Rows]]]] = deque()
    beside = ThreadPoolExecutor(2) if thread_count() > 1 and campaign.is_library_code else None
    turn = _Turn()
    turn.over.set()

    def begin(most: int) -> None:
        nonlocal remaining, turn
        while remaining and len(begun) < most:
            some, remaining, turn = remaining[:count], remaining[count:], _Turn(turn)
            work = partial(_run_in_turn, campaign, some, turn, device)
            begun.append((some, work if beside is None else beside.submit(work).result))

    try:
        since = time.perf_counter()
        while remaining or begun:
            begin(1 if beside is None else 2)
            some, result = begun.popleft()
            rows = result()
            taken, since = max(time.perf_counter() - since, 1e-6), time.perf_counter()
            most = LARGEST_BATCH // campaign.batch
            count = max(1, min(2 * count, round(len(some) * TOGETHER / taken), most))
            begin(0 if beside is None else 2)  # whoever takes the rows may be slow
            yield from zip(some, rows)
    finally:
        turn.stop()
        if beside is not None:
            beside.shutdown()


class _Turn:
    """One of several that follow each other: entered when the one `before` is `over`; refused where that failed, or
    this one is to `stop`."""

    def __init__(self, before: _Turn | None = None) -> None:
        self.before, self.over, self.ended = before, threading.Event(), False

    def __enter__(self) -> None:
        if (before := self.before) is not None:
            before.over.wait()
            self.ended |= before.ended
        self.before = None
        if self.ended:
            raise CancelledError

    def __exit__(self, *error: object) -> None:
        self.over.set()

    def stop(self) -> None:
        """Refuse this turn and those before it which have not begun."""
        self.ended, before = True, self.before
        if before is not None:
            before.stop()


def _run_in_turn(campaign: Campaign, batches: Sequence[int], turn: _Turn, device: Device) -> list[Rows]:
    try:
        return run_batches(campaign, batches, turn, device)
    except BaseException:
        turn.ended = True
        raise
    finally:
        turn.over.set()  # also where there was nothing to run


def in_processes(
    workers: int, note: Callable[[str], None] = lambda text: None, device: Device = "cpu"
) -> Executor:
    """An executor of worker processes, which share the threads of this one (`thread_count`). If one is killed, its
    batches run again, and `note` is called with a message. `device`: Where their runs are made.

    InvalidInput for a number below 1; FlexhinfError where a GPU is wanted and there is none.
    """
    checked_integer("workers", workers, 1, MOST_WORKERS, "2")
    if device == "gpu":
        cuda.card()

    def run(campaign: Campaign, batches: Sequence[int]) -> Iterator[tuple[int, Rows]]:
        remaining, deaths = list(batches), 0
        while remaining:
            try:
                for batch, rows in _pooled(campaign, remaining, workers, device):
                    remaining.remove(batch)
                    deaths = 0
                    yield batch, rows
            except BrokenProcessPool as error:
                deaths += 1
                if deaths >= DEATHS:
                    raise FlexhinfError(
                        "Workers die before they are done with a batch.",
                        f"expected {workers} processes to live, got {deaths} deaths in a row without a result",
                        "fewer workers or smaller batches, where memory is what they lack",
                    ) from error
                note("a worker died; its batches are run again")

    return run


def _pooled(
    campaign: Campaign, batches: Sequence[int], workers: int, device: Device = "cpu"
) -> Iterator[tuple[int, Rows]]:
    context = multiprocessing.get_context("spawn")  # compiled code and threads do not survive a fork
    threads = max(1, thread_count() // workers)
    pool = ProcessPoolExecutor(workers, context, initializer=begin_worker, initargs=(threads,))
    content, pending = pickle.dumps(campaign), dict[Future[Rows], int]()
    try:
        yield from _as_done(
            lambda batch: pool.submit(remote_batch, content, batch, __version__, device),
            lambda: wait(pending, return_when=FIRST_COMPLETED).done,
            batches,
            lambda: 2 * workers,
            pending,
        )
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _run(
    executor: Executor, campaign: Campaign, batches: Sequence[int]
) -> Generator[tuple[int, Rows], None, None]:
    left, strange = set(batches), ""
    for batch, rows in executor(campaign, batches) if batches else ():
        if batch not in left or len(rows["sample"]) != len(campaign.indices(batch)):
            strange = f"; and batch {batch} with {len(rows['sample'])} samples, which was not requested"
            break
        left.remove(batch)
        yield batch, rows
    if left or strange:
        raise FlexhinfError(
            "Batches of the campaign were not run; what is written stays.",
            f"expected {len(batches)} batches, got {len(batches) - len(left)}{strange}",
            "the same command, which runs what is missing; without --cluster and --workers if it happens again",
        )


def begin_worker(threads: int) -> None:
    """Set up a worker with its share of the threads: it ignores Ctrl-C, which the driver handles, and ends when the
    driver was killed.

    Workers keep the pipe open on which they wait for work: without the thread they would wait for ever.
    """

    def end_with_the_driver() -> None:
        driver = multiprocessing.parent_process()
        if driver is not None:
            driver.join()
            os._exit(1)

    set_threads(threads)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end_with_the_driver, daemon=True).start()


@single_blas()
def run_campaign(
    loop: Loop,
    draw: Draw | DrawFunction,
    samples: int,
    *,
    seed: int = 0,
    metrics: MetricsLike = None,
    signals: Sequence[str] | None = None,
    folder: str | os.PathLike[str] | None = None,
    workers: int = 0,
    threads: int | None = None,
    batch: int | None = None,
    device: Device = "cpu",
    progress: Callable[[Report], None] = lambda report: None,
    **options: Unpack[RunOptions],
) -> xr.Dataset:
    """Run a loop with many true plants, its controller as it is.

    Parameters
    ----------
    loop : Loop
        With the nominal true plant.
    draw : callable or flexhinf.campaign.Draw
        Generator → parameters of the true plant by name, as `Robot.draw` is one; or → `Sample`, with an initial state,
        a disturbance and more for each sample; or `Tolerances` of numbers in intervals.
    seed : int
        Sample i depends on it and on i alone, not on batches, workers or the others.
    metrics : optional
        Names of `Trajectory.metrics` (the worst of all tracked states), functions of a `Trajectory` by name, or both in
        a list; all of the first by default.
    signals : sequence of str, optional
        States that are kept at some instants; the tracked ones by default.
    folder : path, optional
        Folder of a journal: the same call continues an interrupted campaign.
    workers : int
        Processes; 0: this one.
    threads : int, optional
        Of all processes together; by default as many as the process may use processors. No number depends on them.
    batch : int, optional
        Samples per batch, which is one file of the journal; 256 by default, up to 4,096 of short runs.
    device : {"cpu", "gpu"}
        Where runs are made that lanes could make; others are made on the processor. No number depends on it.
    **options
        Of `Loop.run`, for all samples: reference, disturbance, noise, duration, initial_state, initial_input,
        multi_turn.

    Returns
    -------
    xarray.Dataset
        Dimension ``sample``: parameters, ``seed`` (of `Loop.run`, for the noise; as text), ``status`` ("completed",
        "unstable", "diverged", "not run"), ``diverged_at_s``, metrics (NaN for a run that did not come to its end;
        infinite for a time that is never reached). Dimensions ``kept`` and ``time``: signals of the first runs, as
        ``trace.<state>``.

    Raises
    ------
    InvalidInput
        Before any work for what does not fit; or for a folder of another campaign.
    FlexhinfError
        Where a GPU is wanted and there is none, or the model calls the C library, such as tanh.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> arm = fh.paper_arm()
    >>> loop = fh.Loop(arm.plant(), fh.Controller(fh.linear_law(arm.problem(), gamma=np.inf), None, 1e-2))
    >>> data = fh.run_campaign(loop, arm.draw, 20, reference=0.3, duration=4.0)
    >>> data.sizes["sample"], bool((data.status == "completed").all())
    (20, True)
    """
    known = tuple(RunOptions.__annotations__)
    if unknown := [name for name in options if name not in known]:
        raise unknown_name(f"A campaign has no option {unknown[0]!r}.", unknown[0], known)
    if threads is not None:
        checked_integer("threads", threads, 1, MOST_THREADS, "4")
    campaign = Campaign(loop, draw, samples, seed, options, metrics, signals, batch)
    campaign.check_device(device)
    executor = in_processes(workers, device=device) if workers else on_device(device)
    with limited_threads(threads):
        if folder is None:
            return run_in_memory(campaign, executor, progress)
        journal, gathered = Journal.begun(Path(folder), campaign), GatheredRows(campaign)
        table = drive(
            campaign,
            journal,
            executor=lambda own, batches: gathered.of(executor(own, batches)),
            progress=progress,
        )
        assert table is not None
        return table.dataset() if gathered.dataset is None else gathered.dataset


def run_in_memory(
    campaign: Campaign,
    executor: Executor = in_this_process,
    progress: Callable[[Report], None] = lambda report: None,
) -> xr.Dataset:
    """All samples of a campaign, without a journal; the result of `run_campaign`."""
    gathered, done = GatheredRows(campaign), 0
    for _, rows in gathered.of(_run(executor, campaign, range(campaign.batches))):
        done += len(rows["sample"])
        progress(Report(done, campaign.samples, done))
    assert gathered.dataset is not None
    return gathered.dataset
