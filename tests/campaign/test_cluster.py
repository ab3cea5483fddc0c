"""Campaigns on a cluster of several processes: the same bits, and a killed worker costs no sample."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from tests.campaign.conftest import Deadly, made_campaign

from flexhinf.campaign import Journal, drive, in_cluster
from flexhinf.campaign.driver import Report
from flexhinf.campaign.journal import TABLE
from flexhinf.errors import FlexhinfError, InvalidInput

pytest.importorskip("pyarrow")


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def test_an_address_is_read_before_any_work() -> None:
    with pytest.raises(InvalidInput, match="address of the cluster"):
        in_cluster("localhost")


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_cluster_has_the_same_bytes_and_a_killed_worker_costs_no_sample(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
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
    with pytest.raises(InvalidInput, match="does not answer"):
        drive(
            made_campaign(9),
            Journal.opened(tmp_path / "none", made_campaign(9)),
            executor=in_cluster("tcp://127.0.0.1:1"),
        )


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_lost_scheduler_costs_nothing_that_is_written(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    word, campaign, root = [sys.executable, "-m"], made_campaign(800), Path(__file__).resolve().parents[2]
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root / "src"), str(root)])}
    address = f"tcp://127.0.0.1:{free_port()}"
    port = address.rpartition(":")[2]
    scheduler = subprocess.Popen(
        [*word, "distributed.cli.dask_scheduler", "--port", port, "--no-dashboard"], env=paths
    )
    worker = subprocess.Popen(
        [*word, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"], env=paths
    )

    def progress(report: Report) -> None:
        if report.fresh >= 160:
            scheduler.kill()

    journal = Journal.opened(tmp_path / "far", campaign)
    try:
        with pytest.raises(FlexhinfError, match="cluster was lost"):
            drive(campaign, journal, executor=in_cluster(address), progress=progress)
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.wait()
    good, bad = journal.shards()
    assert 10 <= len(good) < 50
    assert not bad
    drive(campaign, journal)
    near = Journal.opened(tmp_path / "near", campaign)
    drive(campaign, near)
    assert (journal.folder / TABLE).read_bytes() == (near.folder / TABLE).read_bytes()
