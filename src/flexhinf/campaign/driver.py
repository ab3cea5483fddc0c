"""The driver of a campaign: runs the batches that are missing, here or in processes of its own, and merges them.

Batches of a campaign on a cluster of Dask's: the journal stays with the driver, workers only compute.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf import __version__
from flexhinf.campaign.batches import BATCH, TRACED, Campaign, Rows, run_batch
from flexhinf.campaign.journal import Journal, disk_refusals, labelled
from flexhinf.campaign.results import MergedTable, merged
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.validation import value_text

#: Batches on the way for each thread of the cluster; and how long a scheduler may take to answer, s.
AHEAD, PATIENCE = 2, 10.0


def in_cluster(address: str) -> Executor:
    """An executor on the workers of a scheduler of Dask's, ``tcp://host:8786``.

    A worker that dies costs time: its batches go to the others. A scheduler that dies ends the campaign with what is
    written; the same call goes on. The workers need flexhinf of the driver's version.

    Raises
    ------
    InvalidInput
        For an address of another form, or where `distributed` is not installed.
    """
    if not isinstance(address, str) or "://" not in address:
        raise InvalidInput(
            "The address of the cluster cannot be read.",
            f"expected tcp://HOST:PORT, got {value_text(address)}",
            "tcp://localhost:8786, which `dask scheduler` prints",
        )
    try:
        import distributed  # type: ignore[import-not-found]  # noqa: F401
    except ImportError as error:
        raise InvalidInput(
            "A campaign on a cluster needs distributed, which is not installed.",
            "expected the extra 'cluster'",
            "pip install 'flexhinf[cluster]'",
        ) from error

    def run(campaign: Campaign, batches: Sequence[int]) -> Iterator[tuple[int, Rows]]:
        with _connected(address) as client:
            yield from _run_on_worker(client, address, campaign, batches)

    return run


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    from distributed import Client  # type: ignore[import-not-found]

    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InvalidInput(
            "The cluster does not answer.",
            f"expected a scheduler at {address}, got {value_text(str(error))}",
            "`dask scheduler` there, and `dask worker` with its address",
        ) from error
    try:
        yield client
    finally:
        client.close(timeout=PATIENCE)


def _run_on_worker(
    client: Any, address: str, campaign: Campaign, batches: Sequence[int]
) -> Iterator[tuple[int, Rows]]:
    """Batches as they are done, a few for each thread on the way."""
    import cloudpickle  # type: ignore[import-not-found]
    from distributed import CancelledError, KilledWorker, as_completed  # type: ignore[import-not-found]

    sent, rest, begun, done = cloudpickle.dumps(campaign), iter(batches), {}, as_completed(loop=client.loop)
    try:
        while True:
            room = AHEAD * max(1, sum(client.nthreads().values())) - len(begun)
            for batch in next_batches(rest, room):
                future = client.submit(remote_batch, sent, batch, __version__, pure=False)
                begun[future] = batch
                done.add(future)
            if not begun:
                return
            future = next(done)
            rows = future.result()
            yield begun.pop(future), rows
    except (CancelledError, KilledWorker, OSError) as error:
        raise FlexhinfError(
            "The cluster was lost, or its workers die; what is written stays.",
            f"{address}: {type(error).__name__}: {str(error)[:200]}",
            "the same command, once the cluster runs again; smaller batches where memory is what workers lack",
        ) from error
    finally:
        for future in begun:
            future.release()


def remote_batch(sent: bytes, batch: int, version: str) -> Rows:
    """On a worker: the rows of a batch of a pickled campaign."""
    if version != __version__:
        raise InvalidInput(
            "The workers run another version of flexhinf.",
            f"expected {version}, got {__version__}",
            "the driver's version on every worker",
        )
    return run_batch(_worker_campaign(sent), batch)


@lru_cache(2)
def _worker_campaign(sent: bytes) -> Campaign:
    return pickle.loads(sent)


if TYPE_CHECKING:
    import xarray as xr

    from flexhinf.loop import Loop

#: Runs batches of a campaign and gives them in any order, each once.
Executor = Callable[[Campaign, Sequence[int]], Iterator[tuple[int, Rows]]]

#: How often in a row worker processes may die without a batch that is done.
DEATHS = 5


@dataclass(frozen=True)
class Shard:
    """Every n-th batch, for one of n jobs.

    Parameters
    ----------
    number, of : int
        1 … of.
    """

    number: int = 1
    of: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise InvalidInput(
                "There is no such shard.", f"expected 1/n to n/n, got {self.number}/{self.of}", "--shard 1/8"
            )

    @staticmethod
    def read(text: str) -> Shard:
        """Read ``3/8``.

        Raises
        ------
        InvalidInput
            For another text.
        """
        number, slash, of = text.partition("/")
        if not slash or not number.strip().isdecimal() or not of.strip().isdecimal():
            raise InvalidInput(
                "The shard cannot be read.",
                f"expected i/n, got {value_text(text)}",
                "--shard 1/8 … --shard 8/8",
            )
        return Shard(int(number), int(of))

    @property
    def name(self) -> str:
        """For its lock; empty for the whole."""
        return "" if self.of == 1 else f"{self.number}-of-{self.of}"

    def has(self, batch: int) -> bool:
        """Whether a batch is its."""
        return batch % self.of == self.number - 1


@dataclass(frozen=True)
class Report:
    """What a driver tells on its way.

    Attributes
    ----------
    done, total : int
        Samples of its shard.
    fresh : int
        Samples that this driver has run.
    note : str
        What must not be missed.
    """

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
    """Run the batches of a shard that are missing, and merge the table where all of them are there.

    Parameters
    ----------
    journal : Journal
        Of this campaign.
    shard : Shard, optional
        The whole by default.
    executor : callable, optional
        What runs the batches; by default this process.

    Returns
    -------
    MergedTable or None
        None where other shards are still to be run.

    Raises
    ------
    InvalidInput
        If another driver is at work, or a sample is refused.
    FlexhinfError
        If the disk is full, workers die, or a batch is not run.
    """
    shard = Shard() if shard is None else shard
    with journal.driven(shard.name):
        good, bad = journal.shards()
        own = [batch for batch in range(journal.batches) if shard.has(batch)]
        todo = [batch for batch in own if batch not in good]
        total = sum(map(journal.size, own))
        done = total - sum(map(journal.size, todo))
        fresh = 0
        for path, wrong in bad:
            with disk_refusals(journal.folder):
                path.unlink(missing_ok=True)
            progress(
                Report(done, total, fresh, f"{path.name} is {wrong}; it is removed and its samples run again")
            )
        progress(Report(done, total, fresh))
        with closing(_run(executor or in_this_process, campaign, todo)) as running:
            for batch, rows in running:
                good[batch] = journal.write(batch, rows)
                fresh += len(rows)
                progress(Report(done + fresh, total, fresh))
        if shard.of > 1:
            good = journal.shards()[0]
        return None if len(good) < journal.batches else merged(journal, good)


def in_this_process(campaign: Campaign, batches: Sequence[int]) -> Iterator[tuple[int, Rows]]:
    """One batch after the other."""
    for batch in batches:
        yield batch, run_batch(campaign, batch)


def in_processes(workers: int, note: Callable[[str], None] = lambda text: None) -> Executor:
    """An executor of so many worker processes: one that is killed costs time and no sample.

    Parameters
    ----------
    note : callable, optional
        Called where a worker died.

    Raises
    ------
    InvalidInput
        For a number below 1.
    """
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InvalidInput(
            "The number of workers is not usable.",
            f"expected an integer >= 1, got {value_text(workers)}",
            "2",
        )

    def run(campaign: Campaign, batches: Sequence[int]) -> Iterator[tuple[int, Rows]]:
        rest, deaths = list(batches), 0
        while rest:
            try:
                for batch, rows in _pooled(campaign, rest, workers):
                    rest.remove(batch)
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


def _pooled(campaign: Campaign, batches: Sequence[int], workers: int) -> Iterator[tuple[int, Rows]]:
    """Batches as they are done, at most two for each worker on the way."""
    context = multiprocessing.get_context("spawn")  # compiled code and threads do not survive a fork
    pool = ProcessPoolExecutor(workers, context, initializer=_begin_worker, initargs=(campaign,))
    rest, begun = iter(batches), dict[Future[Rows], int]()
    try:
        while True:
            for batch in next_batches(rest, 2 * workers - len(begun)):
                begun[pool.submit(_work, batch)] = batch
            if not begun:
                return
            for future in wait(begun, return_when=FIRST_COMPLETED).done:
                rows = future.result()
                yield begun.pop(future), rows
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def next_batches(batches: Iterator[int], count: int) -> list[int]:
    """So many of the batches that are left, and none for a count below 1; the iterator loses no others."""
    return list(islice(batches, max(count, 0)))


def _run(
    executor: Executor, campaign: Campaign, batches: Sequence[int]
) -> Generator[tuple[int, Rows], None, None]:
    """What an executor makes of these batches, all of them.

    Raises
    ------
    FlexhinfError
        If it ends before, or gives a batch that was not asked for, or one again.
    """
    left = set(batches)
    for batch, rows in executor(campaign, batches) if batches else ():
        if batch not in left or len(rows) != len(campaign.indices(batch)):
            raise _lost(f"got batch {batch} with {len(rows)} samples, which was not asked for")
        left.remove(batch)
        yield batch, rows
    if left:
        raise _lost(f"expected {len(batches)} batches, got {len(batches) - len(left)}")


def _lost(found: str) -> FlexhinfError:
    return FlexhinfError(
        "Batches of the campaign were not run; what is written stays.",
        found,
        "the same command, which runs what is missing; without --cluster and --workers if it happens again",
    )


_campaign: Campaign | None = None  # of a worker process


def _begin_worker(campaign: Campaign) -> None:
    """In a worker: Ctrl-C is the driver's, and a driver that was killed takes its workers with it."""
    global _campaign
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_driver, daemon=True).start()
    _campaign = campaign


def _end_with_the_driver() -> None:
    """Workers wait for work on a pipe that they hold open themselves: without this they would wait for ever."""
    driver = multiprocessing.parent_process()
    if driver is not None:
        driver.join()
        os._exit(1)


def _work(batch: int) -> Rows:
    assert _campaign is not None
    return run_batch(_campaign, batch)


# The way in from Python -------------------------------------------------------------------------------------------
def run_campaign(
    loop: Loop,
    draw: Any,
    samples: int,
    *,
    seed: int = 0,
    metrics: Any = None,
    signals: Sequence[str] | None = None,
    folder: str | os.PathLike[str] | None = None,
    workers: int = 0,
    batch: int = BATCH,
    progress: Callable[[Report], None] = lambda report: None,
    **options: Any,
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
        Of a journal: an interrupted campaign goes on with the same call.
    workers : int
        Processes; 0: this one.
    batch : int
        Samples of a file of the journal.
    **options
        Of `Loop.run`, for all samples: reference, disturbance, noise, duration, initial_state, initial_input,
        multi_turn.

    Returns
    -------
    xarray.Dataset
        Dimension ``sample``: parameters, ``seed`` (of `Loop.run`, for the noise), ``status`` ("completed", "diverged",
        "not run"), ``diverged_at_s``, metrics (NaN for a run that did not come to its end; infinite for a time that is
        never reached). Dimensions ``kept`` and ``time``: signals of the first runs, as ``trace.<state>``.

    Raises
    ------
    InvalidInput
        Before any work for what does not fit; or for a folder of another campaign.
    """
    unknown = [name for name in options if name not in _OPTIONS]
    if unknown:
        raise InvalidInput(
            f"A campaign has no option {unknown[0]!r}.",
            f"expected names out of {list(_OPTIONS)}",
            "one of these",
        )
    campaign = Campaign(loop, draw, samples, seed, options, metrics, signals, batch)
    executor = in_processes(workers) if workers else in_this_process
    if folder is not None:
        table = drive(campaign, Journal.opened(Path(folder), campaign), executor=executor, progress=progress)
        assert table is not None
        return table.dataset()
    found: dict[int, Rows] = {}
    for index, rows in _run(executor, campaign, range(campaign.batches)):
        found[index] = rows
        done = sum(map(len, found.values()))
        progress(Report(done, samples, done))
    parts = [found[index].columns for index in range(campaign.batches)]
    rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    kept = {name: rows[name][:TRACED] for name in campaign.named("trace")}
    return labelled({**rows, **kept}, campaign.columns, campaign.time, campaign.settings)


_OPTIONS = (
    "reference", "disturbance", "noise", "duration", "initial_state", "initial_input", "multi_turn",
)  # fmt: skip
