"""Campaigns on a cluster of several processes: the same bits, and a killed worker costs no sample."""

from __future__ import annotations

import errno
import itertools
import os
import re
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest
from tests.campaign.conftest import OPTIONS, Deadly, made_campaign, tolerances
from tests.refusals import refused_with

from flexhinf.campaign import (
    Journal,
    Shard,
    drive,
    driver as campaign_driver,
    in_cluster,
    journal as campaign_storage,
    run_campaign,
)
from flexhinf.campaign.driver import Report, in_this_process
from flexhinf.campaign.journal import TABLE
from flexhinf.errors import FlexhinfError, InvalidInput

pytest.importorskip("pyarrow")


def test_an_address_is_read_before_any_work() -> None:
    with refused_with(InvalidInput, "address", "tcp://HOST:PORT", "'localhost'"):
        in_cluster("localhost")


@pytest.mark.parametrize("rooms", [[2, 1, 1], [3, 0, -1, 2], [1], [7], [50]])
def test_what_hands_out_batches_loses_none(rooms: list[int]) -> None:
    pending: dict[Future, int] = {}
    room = itertools.cycle(rooms)

    def submit(batch: int) -> Future:
        done: Future = Future()
        done.set_result(batch)
        return done

    given = campaign_driver._as_done(
        submit, lambda: list(pending)[:1], range(20), lambda: len(pending) + next(room), pending
    )
    assert [batch for batch, _ in given] == list(range(20))


def test_processes_get_every_batch_at_the_first_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fifty batches for one worker, two of them on the way; threads stand for processes."""

    class Pool(ThreadPoolExecutor):
        def __init__(self, workers, context, initializer, initargs):
            super().__init__(workers)

    monkeypatch.setattr(campaign_driver, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(campaign_driver, "remote_batch", lambda content, batch, *given: batch)
    found = [batch for batch, _ in campaign_driver._pooled(made_campaign(50, 1), range(50), 1)]
    assert sorted(found) == list(range(50))


@pytest.mark.filterwarnings("default")
def test_a_cluster_of_one_thread_runs_every_batch(tmp_path: Path) -> None:
    """Many more batches than are on the way: twenty for one worker with one thread."""
    distributed = pytest.importorskip("distributed", reason="missing: distributed")
    campaign, told = made_campaign(40, 2), []
    with distributed.LocalCluster(
        1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        far = drive(
            campaign, Journal.opened(tmp_path / "far", campaign), executor=in_cluster(cluster.scheduler_address),
            progress=told.append,
        )  # fmt: skip
    assert far is not None
    assert far.columns["sample"].tolist() == list(range(40))
    assert told[-1] == Report(40, 40, 40)


def losing(campaign, batches):
    """An executor that ends before it is done."""
    yield from in_this_process(campaign, batches[:-1])


def doubling(campaign, batches):
    """An executor that gives the first batch again instead of the second one."""
    for batch, rows in in_this_process(campaign, batches):
        yield min(batch, batches[0]), rows


@pytest.mark.parametrize("executor", [losing, doubling])
@pytest.mark.parametrize("shard", [None, Shard(2, 2)])
def test_an_executor_that_loses_a_batch_is_an_error(tmp_path: Path, executor, shard: Shard | None) -> None:
    campaign = made_campaign()
    journal = Journal.opened(tmp_path / "campaign", campaign)
    with refused_with(FlexhinfError, "batches") as caught:
        drive(campaign, journal, shard=shard, executor=executor)
    assert re.search(r"got (batch )?\d", caught.value.found)
    drive(campaign, journal)
    assert sorted(journal.shards()[0]) == [0, 1, 2, 3]


def test_a_full_disk_ends_what_runs_the_batches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the error is told: workers and the cluster's batches do not go on for nothing."""
    ended: list[bool] = []

    def executor(campaign, batches):
        try:
            yield from in_this_process(campaign, batches)
        finally:
            ended.append(True)

    def full(name: str, path: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    campaign = made_campaign()
    journal = Journal.opened(tmp_path / "campaign", campaign)
    monkeypatch.setattr(campaign_storage, "publish_whole", full)
    with pytest.raises(FlexhinfError, match="disk") as error:
        drive(campaign, journal, executor=executor)
    assert ended == [True]
    assert error.value.__traceback__ is not None  # which holds the frames, and would keep a generator alive


def test_a_campaign_in_memory_is_whole_or_an_error(loop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign_driver, "in_this_process", losing)
    with refused_with(FlexhinfError, "3 batches", 2):
        run_campaign(loop, tolerances(), 5, batch=2, **OPTIONS)


@pytest.mark.ci("starts two clusters of two processes")
@pytest.mark.filterwarnings("default")
def test_a_cluster_has_the_same_bytes_and_a_killed_worker_costs_no_sample(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="missing: distributed")
    for name, changes in (("plain", {}), ("killed", {"metrics": {"effort": Deadly(tmp_path / "mark")}})):
        campaign = made_campaign(**changes)
        with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster:
            executor = in_cluster(cluster.scheduler_address)
            far = drive(campaign, Journal.opened(tmp_path / f"far-{name}", campaign), executor=executor)
        assert far is not None
        near = drive(campaign, Journal.opened(tmp_path / f"near-{name}", campaign))
        assert near is not None
        tables = [(table.journal.folder / TABLE).read_bytes() for table in (far, near)]
        assert tables[0] == tables[1]
    assert (tmp_path / "mark").exists()
    with pytest.raises(InvalidInput, match="answer"):
        drive(
            made_campaign(9),
            Journal.opened(tmp_path / "none", made_campaign(9)),
            executor=in_cluster("tcp://127.0.0.1:1"),
        )


@pytest.mark.ci("starts a scheduler and a worker")
@pytest.mark.filterwarnings("default")
def test_a_lost_scheduler_costs_nothing_that_is_written(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="missing: distributed")
    word, campaign, root = [sys.executable, "-m"], made_campaign(800), Path(__file__).resolve().parents[2]
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root / "src"), str(root)])}
    scheduler = subprocess.Popen(
        [*word, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"],
        env=paths, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert scheduler.stderr is not None
    said = (re.search(r"Scheduler at:\s+(tcp://\S+)", line) for line in scheduler.stderr)
    address = next(found[1] for found in said if found)  # it listens there
    worker = subprocess.Popen(
        [*word, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"], env=paths
    )

    def progress(report: Report) -> None:
        if report.fresh >= 160:
            scheduler.kill()

    journal = Journal.opened(tmp_path / "far", campaign)
    try:
        with refused_with(FlexhinfError, "cluster", address):
            drive(campaign, journal, executor=in_cluster(address), progress=progress)
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.wait()
        scheduler.stderr.close()
    good, bad = journal.shards()
    assert 10 <= len(good) < 50
    assert not bad
    drive(campaign, journal)
    near = Journal.opened(tmp_path / "near", campaign)
    drive(campaign, near)
    assert (journal.folder / TABLE).read_bytes() == (near.folder / TABLE).read_bytes()
