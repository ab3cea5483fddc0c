"""The journal: nothing is lost, nothing is counted twice, and each fault is told."""

from __future__ import annotations

import errno
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.campaign.conftest import OPTIONS, Deadly, made_campaign, tolerances
from tests.refusals import refused_with

from flexhinf.campaign import (
    Campaign,
    Journal,
    Shard,
    drive,
    journal as campaign_storage,
    merged,
    merging,
    run_batch,
    run_campaign,
)
from flexhinf.campaign.batches import Rows
from flexhinf.campaign.driver import Report, in_processes, in_this_process
from flexhinf.campaign.journal import MANIFEST, SHARDS, TABLE
from flexhinf.campaign.parquet import arrow_array, numpy_column, read_columns
from flexhinf.campaign.results import CACHED
from flexhinf.codegen import shared
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.files import recorded
from flexhinf.processors import limited_threads

ParquetFile = pytest.importorskip("pyarrow.parquet").ParquetFile
chunked_array = pytest.importorskip("pyarrow").chunked_array

REPOSITORY = Path(__file__).resolve().parents[2]


def table_of(folder: Path) -> bytes:
    return (folder / TABLE).read_bytes()


def shards_of(folder: Path) -> list[Path]:
    return sorted((folder / SHARDS).glob("*.parquet"))


def started(program: str, folder: Path) -> subprocess.Popen[str]:
    """A driver in a process of its own; its input stays open, and it says on its output how far it is."""
    paths = os.pathsep.join([str(REPOSITORY / "src"), str(REPOSITORY)])
    return subprocess.Popen(
        [sys.executable, "-c", program, str(folder)], env={**os.environ, "PYTHONPATH": paths},
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip


def said_by(driver: subprocess.Popen[str]) -> str:
    """Its next line; empty where it has ended."""
    assert driver.stdout is not None
    return driver.stdout.readline().strip()


def test_the_journal_holds_what_memory_has(whole: Path, loop) -> None:
    campaign = made_campaign()
    table = drive(
        campaign, Journal.opened(whole, campaign), executor=lambda *given: pytest.fail("nothing is to run")
    )
    found, memory = table.dataset(), run_campaign(loop, tolerances(), 50, seed=1, **OPTIONS)
    for name in memory:
        kept = memory[name].values
        assert np.array_equal(found[name].values, kept, equal_nan=kept.dtype.kind == "f"), name
        assert found[name].attrs == memory[name].attrs


@pytest.mark.parametrize("executor", ["reversed", "interrupted", "shards"])
def test_order_interruptions_and_shards_leave_the_same_bytes(
    whole: Path, tmp_path: Path, executor: str
) -> None:
    campaign, folder = made_campaign(), tmp_path / "campaign"

    def backwards(campaign, batches):
        return in_this_process(campaign, list(batches)[::-1])

    def interrupted(campaign, batches):
        yield from in_this_process(campaign, list(batches)[:1])
        raise KeyboardInterrupt

    journal = Journal.opened(folder, campaign)
    if executor == "reversed":
        drive(campaign, journal, executor=backwards)
    elif executor == "shards":
        assert [drive(campaign, journal, shard=Shard(k, 3)) is None for k in (3, 1, 2)] == [True, True, False]
    else:
        for _ in range(journal.batches):
            with recorded() as written, pytest.raises(KeyboardInterrupt):
                drive(campaign, Journal.opened(folder, campaign), executor=interrupted)
            assert folder / SHARDS in written(), "what an interrupted command says that it has written"
        drive(campaign, journal)
    assert table_of(folder) == table_of(whole)
    assert [path.name for path in shards_of(folder)] == [path.name for path in shards_of(whole)]


def test_a_table_written_beside_the_runs_has_the_bytes_of_one_merged_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where batches come in another order, and where no memory is left to hold them."""
    monkeypatch.setattr(merging, "GROUP", 20)
    campaign, tables = made_campaign(), set[bytes]()

    def backwards(campaign, batches):
        return in_this_process(campaign, list(batches)[::-1])

    for recent, executor in (
        (1 << 20, in_this_process),
        (1 << 20, backwards),
        (0, in_this_process),
        (0, backwards),
    ):
        monkeypatch.setattr(campaign_storage, "_RECENT", recent)
        journal = Journal.opened(tmp_path / f"{recent} {executor.__name__}", campaign)
        drive(campaign, journal, executor=executor)
        tables.add(table_of(journal.folder))
        merged(Journal.existing(journal.folder), journal.shards()[0])
        tables.add(table_of(journal.folder))
    assert len(tables) == 1
    assert ParquetFile(tmp_path / "0 backwards" / TABLE).num_row_groups == 2


def test_signals_are_kept_with_what_is_missing_of_them() -> None:
    """Of a run that diverged the rest, of one that is not kept all, whatever the bits of a NaN."""
    values = np.arange(24, dtype=np.float32).reshape(6, 4)
    values[1, 2:], values[2], values[4, 1] = np.nan, np.nan, np.inf
    other = values.copy()
    other.view(np.uint32)[np.isnan(other)] = 0xFFC00001
    stored, others = arrow_array(values), arrow_array(other)
    assert stored.equals(others)
    assert stored.null_count == 1
    for span in (slice(None), slice(1, 4), slice(2, 3)):
        column = chunked_array([stored[span]])
        np.testing.assert_array_equal(numpy_column(column), values[span])
    np.testing.assert_array_equal(numpy_column(chunked_array([stored[:3], stored[3:]])), values)


def test_the_manifest_is_on_the_disk_before_the_batches_and_these_before_the_table(
    tmp_path: Path, loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    published, publish = list[str](), campaign_storage.publish_whole

    def slow(name: str, path: Path) -> None:
        time.sleep({MANIFEST: 0.3, TABLE: 0.0}.get(path.name, 0.1))
        publish(name, path)
        published.append(path.name[:5])

    for module in (campaign_storage, merging):
        monkeypatch.setattr(module, "publish_whole", slow)
    memory = run_campaign(loop, tolerances(), 50, seed=1, batch=16, **OPTIONS)
    begun = run_campaign(loop, tolerances(), 50, seed=1, batch=16, folder=tmp_path / "runs", **OPTIONS)
    assert published == [MANIFEST[:5], *["batch"] * 4, TABLE[:5]]
    shards_of(tmp_path / "runs")[1].unlink()
    continued = run_campaign(loop, tolerances(), 50, seed=1, batch=16, folder=tmp_path / "runs", **OPTIONS)
    assert published[6:] == ["batch", TABLE[:5]]
    assert begun.identical(memory)
    assert continued.identical(memory)


def test_damaged_shards_are_found_told_and_run_again(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    shutil.copytree(whole, folder)
    truncated, changed, renamed, _ = shards_of(folder)
    truncated.write_bytes(truncated.read_bytes()[:-100])
    content = bytearray(changed.read_bytes())
    content[len(content) // 2] ^= 1
    changed.write_bytes(content)
    renamed.rename(renamed.with_name(renamed.name.replace("batch-00000002", "batch-00000009")))
    (folder / TABLE).unlink()
    campaign, told = made_campaign(), []
    drive(campaign, Journal.opened(folder, campaign), progress=told.append)
    notes = [report.note for report in told if report.note]
    assert [note for note in notes if truncated.name in note and "damaged" in note]
    assert [note for note in notes if changed.name in note]
    assert [note for note in notes if "batch-00000009" in note]
    assert told[-1].fresh == 48
    assert table_of(folder) == table_of(whole)


def test_any_number_of_threads_writes_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    campaign = made_campaign()
    for threads in (1, 3):
        folder = tmp_path / str(threads)
        with limited_threads(threads):
            drive(campaign, Journal.opened(folder, campaign))
        assert [path.name for path in shards_of(folder)] == [path.name for path in shards_of(whole)]
        assert table_of(folder) == table_of(whole)


def test_a_driver_that_ends_early_leaves_whole_files_and_goes_on(whole: Path, tmp_path: Path) -> None:
    campaign, folder = made_campaign(), tmp_path / "campaign"

    def interrupted(campaign: Campaign, batches: Sequence[int]) -> Iterator[tuple[int, Rows]]:
        yield from in_this_process(campaign, batches[:2])
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive(campaign, Journal.opened(folder, campaign), executor=interrupted)
    assert sorted(path.name for path in (folder / SHARDS).iterdir()) == [
        path.name for path in shards_of(whole)[:2]
    ]
    (folder / SHARDS / ".batch-00000003.abcdefgh.part").write_bytes(b"begun by a driver that was killed")
    told: list[Report] = []
    drive(campaign, Journal.opened(folder, campaign), progress=told.append)
    assert [told[0].done, told[-1].done] == [32, campaign.samples]
    assert sorted(path.name for path in (folder / SHARDS).iterdir()) == [
        path.name for path in shards_of(whole)
    ]
    assert table_of(folder) == table_of(whole)


def test_a_batch_with_two_results_is_refused(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    shutil.copytree(whole, folder)
    campaign = made_campaign()
    journal = Journal.opened(folder, campaign)
    rows = run_batch(campaign, 0)
    rows["peak_input"][3] += 1e-12
    journal.write(0, rows)
    with refused_with(InvalidInput, "Batch 0", "batch-00000000-"):
        journal.shards()


def test_a_full_disk_is_told_and_loses_nothing(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign, folder, room = made_campaign(), tmp_path / "campaign", 2
    journal, publish = Journal.opened(folder, campaign), campaign_storage.publish_whole

    def full(name: str, path: Path) -> None:
        nonlocal room
        if (room := room - 1) < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        publish(name, path)

    monkeypatch.setattr(campaign_storage, "publish_whole", full)
    with pytest.raises(FlexhinfError, match="disk") as error:
        drive(campaign, journal)
    assert "command" in error.value.advice
    assert len(list((folder / SHARDS).iterdir())) == 2
    monkeypatch.undo()
    drive(campaign, journal)
    assert table_of(folder) == table_of(whole)


def test_other_folders_and_other_campaigns_are_refused(whole: Path, tmp_path: Path) -> None:
    changed = made_campaign(seed=2, draw=tolerances("sobol"))
    with pytest.raises(InvalidInput, match="another") as error:
        Journal.opened(whole, changed)
    assert "seed: 1 → 2" in error.value.found
    assert "method: random → sobol" in error.value.found
    (tmp_path / "notes.txt").write_text("mine")
    with refused_with(InvalidInput, "campaign.json", "notes.txt"):
        Journal.opened(tmp_path, changed)
    with refused_with(InvalidInput, "file", "notes.txt"):
        Journal.opened(tmp_path / "notes.txt", changed)
    manifest = tmp_path / "damaged" / MANIFEST
    manifest.parent.mkdir()
    for text in ("{", '{"what": "flexhinf report"}', (whole / MANIFEST).read_text().replace('"50"', '"60"')):
        manifest.write_text(text)
        with pytest.raises(InvalidInput, match="manifest"):
            Journal.opened(manifest.parent, changed)


def test_shards_of_several_folders_are_merged(whole: Path, tmp_path: Path) -> None:
    campaign = made_campaign()
    journals = [Journal.opened(tmp_path / name, campaign) for name in ("one", "two")]
    for k, journal in enumerate(journals):
        assert drive(campaign, journal, shard=Shard(k + 1, 2)) is None
    first, second = journals
    with pytest.raises(InvalidInput, match="complete") as error:
        merged(first, first.shards()[0])
    assert "missing: 1, 3" in error.value.found
    assert first.take(second) == 2
    assert first.take(second) == 0
    merged(first, first.shards()[0])
    assert table_of(first.folder) == table_of(whole)
    other = made_campaign(seed=9)
    with refused_with(InvalidInput, "another", "seed: 1 → 9"):
        first.take(Journal.opened(tmp_path / "other", other))


def test_two_drivers_of_one_folder_are_refused(tmp_path: Path) -> None:
    campaign = made_campaign()
    journal = Journal.opened(tmp_path / "campaign", campaign)
    with journal.driven():
        for part in ("", "1-of-2"):
            with pytest.raises(InvalidInput, match="Another driver"), journal.driven(part):
                pass
    with journal.driven("1-of-2"), journal.driven("2-of-2"):
        for part in ("", "1-of-2"):
            with pytest.raises(InvalidInput, match="Another driver"), journal.driven(part):
                pass


WITH_WORKERS = """
import sys
from flexhinf.campaign import Journal, drive
from flexhinf.campaign.driver import in_processes
from tests.campaign.conftest import made_campaign

def progress(report):
    if report.fresh:
        print("written:1", flush=True)

campaign = made_campaign(samples=100_000)
drive(campaign, Journal.opened(sys.argv[1], campaign), executor=in_processes(1), progress=progress)
"""


@pytest.mark.ci("starts a driver with a worker")
def test_a_driver_killed_by_sigkill_takes_its_workers_with_it(tmp_path: Path) -> None:
    """They hold its standard output open, so that it would never end, and a few hundred megabytes each."""
    driver = started(WITH_WORKERS, tmp_path / "campaign")
    assert said_by(driver) == "written:1"
    driver.kill()
    driver.communicate(timeout=300.0)


DRIVER = """
import sys
import threading
from flexhinf.campaign import Journal, drive
from flexhinf.campaign.driver import in_this_process
from tests.campaign.conftest import made_campaign

def two_and_one_in_flight(campaign, batches):
    yield from in_this_process(campaign, batches[:2])
    (third,) = in_this_process(campaign, batches[2:3])
    written.acquire()
    written.acquire()
    print("written:2", flush=True)
    sys.stdin.read()  # until the driver is killed
    yield third

def write(*batch):
    path = journal_write(*batch)
    written.release()
    return path

campaign, written = made_campaign(), threading.Semaphore(0)
journal = Journal.opened(sys.argv[1], campaign)
journal_write, journal.write = journal.write, write
drive(campaign, journal, executor=two_and_one_in_flight)
"""


@pytest.mark.ci("starts processes")
def test_a_driver_killed_by_sigkill_loses_the_batch_in_flight_only(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    driver = started(DRIVER, folder)
    assert said_by(driver) == "written:2"
    campaign, told = made_campaign(), []
    with pytest.raises(InvalidInput, match="Another driver"):
        drive(campaign, Journal.opened(folder, campaign))
    driver.kill()
    driver.communicate()
    assert driver.returncode == -signal.SIGKILL
    assert len(shards_of(folder)) == 2
    drive(campaign, Journal.opened(folder, campaign), progress=told.append)
    assert told[-1].fresh == 50 - 16 * 2
    assert table_of(folder) == table_of(whole)


@pytest.mark.ci("a campaign with a damaged cache; tests/codegen/test_cache.py damages its files")
def test_a_damaged_kernel_cache_is_told_and_changes_no_bit(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Between two jobs, and while one of them runs: every process after the damage reads the files again."""
    monkeypatch.setenv("FLEXHINF_CACHE", str(tmp_path / "kernels"))
    monkeypatch.setattr(shared, "_kept", type(shared._kept)())
    damaged: list[Path] = []

    def damage(file: Path) -> None:
        code = bytearray(file.read_bytes())
        code[-len(code) // 3] ^= 1
        file.write_bytes(bytes(code))
        damaged.append(file)

    def as_new_processes(campaign: Campaign, batches: Sequence[int]) -> Iterator[tuple[int, Rows]]:
        for batch in batches:
            shared._kept.clear()
            yield batch, run_batch(pickle.loads(pickle.dumps(campaign)), batch)
            for file in (tmp_path / "kernels").glob("*.o"):
                damage(file)

    folder = tmp_path / "campaign"
    for number in (1, 2):
        campaign = made_campaign()
        drive(campaign, Journal.opened(folder, campaign), shard=Shard(number, 2), executor=as_new_processes)
    assert table_of(folder) == table_of(whole)
    told = [text.split()[3] for text in caplog.messages if "(it is damaged)" in text]
    assert len(told) >= 3
    assert set(told) <= set(map(str, damaged))


@pytest.mark.ci("starts four workers")
def test_a_worker_killed_by_sigkill_costs_no_sample(tmp_path: Path) -> None:
    mark, notes = tmp_path / "killed", []
    campaign = made_campaign(metrics={"effort": Deadly(mark)})
    table = drive(
        campaign, Journal.opened(tmp_path / "one", campaign), executor=in_processes(2, notes.append)
    )
    assert mark.exists()
    (note,) = notes
    assert "worker" in note
    assert table is not None
    assert table.columns["sample"].tolist() == list(range(50))
    drive(campaign, Journal.opened(tmp_path / "two", campaign))
    assert table_of(tmp_path / "one") == table_of(tmp_path / "two")


@pytest.mark.ci("mounts a disk")
def test_a_disk_that_is_really_full(whole: Path, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", "size=48k", "tmpfs", str(disk)]
    mounted = subprocess.run(words, capture_output=True, text=True)
    if re.search("denied|not permitted|superuser", mounted.stderr):
        pytest.skip(f"no small disk may be mounted here: {mounted.stderr.strip()}")
    assert mounted.returncode == 0, mounted.stderr
    try:
        campaign = made_campaign()
        journal = Journal.opened(disk / "campaign", campaign)
        with refused_with(FlexhinfError, "disk", "full", str(disk / "campaign")):
            drive(campaign, journal)
        good, bad = journal.shards()
        assert good
        assert not bad
        assert subprocess.run(["mount", "-o", "remount,size=4m", str(disk)]).returncode == 0
        drive(campaign, journal)
        assert table_of(disk / "campaign") == table_of(whole)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_table_is_read_column_by_column(tmp_path):
    campaign = made_campaign()
    table = drive(campaign, Journal.opened(tmp_path / "runs", campaign))
    assert table is not None
    columns, whole = table.columns, read_columns(tmp_path / "runs" / TABLE)
    assert list(columns) == whole.column_names
    for name in columns:
        expected = np.array(whole.column(name).to_pylist(), dtype=columns[name].dtype)
        np.testing.assert_array_equal(columns[name], expected, name)
        assert columns._read.cache_info().currsize <= CACHED
    assert columns["status"].tolist() == ["completed"] * 50
    with pytest.raises(KeyError):
        columns["no such column"]


@pytest.mark.skipif(os.name != "posix", reason="modes of files")
def test_a_published_file_has_the_mode_of_any_other(tmp_path):
    other, hidden = tmp_path / "other", tmp_path / "hidden"
    other.write_text("")
    hidden.write_text("whole")
    hidden.chmod(0o600)
    campaign_storage.publish_whole(str(hidden), tmp_path / "published")
    assert (tmp_path / "published").stat().st_mode == other.stat().st_mode
    assert not hidden.exists()
