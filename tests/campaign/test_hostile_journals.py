"""Folders of campaigns that somebody changed, mixed up or made by hand: each is refused in words, in little memory."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import random
import shlex
import shutil
import subprocess
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.campaign.conftest import made_campaign, tolerances
from tests.refusals import refused_with, unnamed

from flexhinf.campaign import Campaign, Journal, drive, journal, manifest, merged
from flexhinf.campaign.draws import campaign_digest
from flexhinf.campaign.journal import MANIFEST, SHARDS, TABLE
from flexhinf.campaign.manifest import read_sealed, sealed
from flexhinf.campaign.results import Replayed
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.validation import read_bytes

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    shutil.copytree(whole, tmp_path / "campaign")
    return tmp_path / "campaign"


def part(folder: Path, batch: int) -> Path:
    (found,) = (folder / SHARDS).glob(f"batch-{batch:08d}-*.parquet")
    return found


def put(folder: Path, batch: int, content: bytes) -> Path:
    """A file of this content under the name that its batch and its bytes have."""
    part(folder, batch).unlink()
    digest = hashlib.sha256(content).hexdigest()[:16]
    path = folder / SHARDS / f"batch-{batch:08d}-{digest}.parquet"
    path.write_bytes(content)
    return path


def table_bytes(table: Any) -> bytes:
    stream = pa.BufferOutputStream()
    pq.write_table(table, stream)
    return stream.getvalue().to_pybytes()


def opened(folder: Path) -> Journal:
    journal = Journal.read(folder)
    assert journal is not None
    return journal


def check_found_and_run_again(whole: Path, folder: Path, batches: set[int], words: str) -> None:
    """Every way in finds the bad parts; the command runs them again, to the same table."""
    journal = opened(folder)
    good, bad = journal.shards()
    assert set(range(4)) - set(good) == batches
    assert [wrong for _, wrong in bad if words in wrong], bad
    with refused_with(InvalidInput, "4 batches", len(good), "missing:"):
        merged(journal, good)
    assert journal.row(16 * min(batches)) == {}
    campaign = made_campaign()
    other = Journal.opened(folder.parent / "other", campaign)
    with pytest.raises(InvalidInput, match=r"(?s)shard.*batch-0000000\d-"):
        other.take(journal)
    drive(campaign, journal)
    assert (folder / TABLE).read_bytes() == (whole / TABLE).read_bytes()


# Parts ----------------------------------------------------------------------------------------------------
@pytest.mark.costs("makes the campaign of all tests here")
def test_swapped_parts_are_found(whole: Path, folder: Path) -> None:
    first, second = (part(folder, k).read_bytes() for k in (0, 1))
    put(folder, 0, second)
    put(folder, 1, first)
    check_found_and_run_again(whole, folder, {0, 1}, "another part")


def test_a_part_of_the_same_campaign_with_another_seed_is_found(
    whole: Path, folder: Path, tmp_path: Path
) -> None:
    other = made_campaign(seed=7)
    drive(other, Journal.opened(tmp_path / "seven", other))
    put(folder, 1, part(tmp_path / "seven", 1).read_bytes())
    check_found_and_run_again(whole, folder, {1}, "another campaign")


def relabelled(table: Any, like: Any) -> Any:
    return table.replace_schema_metadata(like.schema.metadata)


def changed(table: Any, name: str, values: list[Any]) -> Any:
    place = table.column_names.index(name)
    return table.set_column(place, table.schema.field(name), pa.array(values, table.schema.field(name).type))


ROWS: dict[str, tuple[Callable[[Any, Any], Any], str]] = {
    "rows of another batch": (lambda own, other: relabelled(other, own), "not the samples 16 to 31"),
    "a row less": (lambda own, other: own.slice(0, 15), "15 rows instead of 16"),
    "a row twice": (lambda own, other: pa.concat_tables([own, own.slice(3, 1)]), "17 rows instead of 16"),
    "none": (lambda own, other: own.slice(0, 0), "0 rows instead of 16"),
    "in another order": (lambda own, other: own.take(pa.array(range(15, -1, -1))), "not the samples"),
    "a column less": (lambda own, other: own.drop_columns(["peak_input"]), "of other columns"),
    "a column more": (lambda own, other: own.append_column("own", own.column("mass")), "of other columns"),
    "two columns swapped": (
        lambda own, other: relabelled(
            own.rename_columns({"mass": "stiffness", "stiffness": "mass"}).combine_chunks(), own
        ), "of other columns",
    ),
    "another kind of number": (
        lambda own, other: own.set_column(
            own.column_names.index("mass"), "mass", own.column("mass").cast(pa.float32())
        ), "of other columns",
    ),
    "another seed": (
        lambda own, other: own.set_column(
            own.column_names.index("seed"), own.schema.field("seed"), other.column("seed")
        ), "of the seed 1",
    ),
    "a status that there is not": (
        lambda own, other: changed(own, "status", ["wonderful"] * 16), "of a status that no run has: 'wonderful'",
    ),
    "no status": (lambda own, other: changed(own, "status", [None] * 16), "of a status that no run has: None"),
    "no failure": (lambda own, other: changed(own, "failure", [None] * 16), "without the column failure"),
    "a failure of a run": (
        lambda own, other: changed(own, "failure", ["late", *[""] * 15]), "of runs with a failure",
    ),
    "runs that diverged never": (
        lambda own, other: changed(own, "status", ["diverged"] * 16), "an instant of divergence",
    ),
    "metrics of runs that diverged": (
        lambda own, other: changed(changed(own, "status", ["diverged"] * 16), "diverged_at_s", [0.1] * 16),
        "of runs without an end that have the metric",
    ),
    "a mass of 50 kg": (
        lambda own, other: changed(own, "mass", [50.0] * 16), "not what is drawn: mass of sample 16 is 50",
    ),
    "a mass inside of its interval": (
        lambda own, other: changed(own, "mass", [*own.column("mass").to_pylist()[:15], 1.0]),
        "not what is drawn: mass of sample 31 is 1,",
    ),
    "no mass": (lambda own, other: changed(own, "mass", [None] * 16), "mass of sample 16 is nan"),
    "an infinite mass": (lambda own, other: changed(own, "mass", [float("inf")] * 16), "mass of sample 16 is inf"),
    "a text of 5 MB": (
        lambda own, other: own.set_column(
            own.column_names.index("failure"), own.schema.field("failure"),
            pa.array([*[""] * 15, 5_000_000 * "a"]),
        ), "unpacks to",
    ),
}  # fmt: skip


@pytest.mark.quick_cases(7)
@pytest.mark.parametrize("name", ROWS)
def test_other_rows_under_the_right_name_are_found(whole: Path, folder: Path, name: str) -> None:
    change, words = ROWS[name]
    own, other = (pq.read_table(part(folder, k)) for k in (1, 2))
    put(folder, 1, table_bytes(change(own, other)))
    check_found_and_run_again(whole, folder, {1}, words)


@pytest.mark.parametrize(
    "content", [b"", b"PAR1", b"no table", b"PAR1" + b"\xff" * 100 + b"PAR1"], ids=["empty", "mark", "text", "end"]
)  # fmt: skip
def test_a_foreign_file_under_the_right_name_is_found(whole: Path, folder: Path, content: bytes) -> None:
    put(folder, 1, content)
    check_found_and_run_again(whole, folder, {1}, "no file of rows")


def test_a_foreign_table_under_the_right_name_is_found(whole: Path, folder: Path) -> None:
    put(folder, 1, table_bytes(pa.table({"sample": range(16)})))
    check_found_and_run_again(whole, folder, {1}, "of another campaign")


@pytest.mark.parametrize("batch", [1, 7])
def test_a_folder_with_the_name_of_a_part_is_told(folder: Path, batch: int) -> None:
    """Of a part that is missing and of one that there is not; a full disk is not what is wrong."""
    path = folder / SHARDS / f"batch-{batch:08d}-0123456789abcdef.parquet"
    path.mkdir()
    campaign = made_campaign()
    for way in (lambda: opened(folder).shards(), lambda: drive(campaign, Journal.opened(folder, campaign))):
        with refused_with(InvalidInput, "folder", str(path)) as error:
            way()
        assert str(path) in error.value.found
        assert "delete" in error.value.advice


@pytest.mark.quick_cases(5)
@pytest.mark.parametrize("method", ["random", "latin-hypercube", "sobol"])
@pytest.mark.parametrize("distribution", ["uniform", "normal", "truncated-normal", "corners"])
def test_every_draw_that_settings_state_is_drawn_again(
    tmp_path: Path, method: str, distribution: str
) -> None:
    campaign = made_campaign(samples=8, batch=4, draw=tolerances(method, distribution))
    journal = Journal.opened(tmp_path / "campaign", campaign)
    drive(campaign, journal)
    assert journal.shards()[1] == []
    own = pq.read_table(part(journal.folder, 1))
    numbers = own.column("stiffness").to_pylist()
    put(journal.folder, 1, table_bytes(changed(own, "stiffness", [*numbers[:3], numbers[3] * (1 + 1e-6)])))
    assert "sample 7" in journal.shards()[1][0][1]


def test_rows_that_a_function_draws_are_taken_as_they_are(tmp_path: Path) -> None:
    """The manifest holds no code; what rows say of a function's numbers cannot be told."""
    campaign = made_campaign(samples=8, batch=4, draw=lambda rng: {"mass": float(rng.uniform(0.8, 1.2))})
    journal = Journal.opened(tmp_path / "campaign", campaign)
    drive(campaign, journal)
    own = pq.read_table(part(journal.folder, 1))
    put(journal.folder, 1, table_bytes(changed(own, "mass", [50.0] * 4)))
    assert journal.shards()[1] == []


def test_parts_with_changed_bits_or_cut_off_are_found(folder: Path) -> None:
    """Under their old names by the digest; under the names of their new bytes by what stands in them, or told in words.

    A bit of a metric that was changed together with the file's name is a result of its own: two of one batch are
    refused where both are there, and this one cannot be told from a run.
    """
    draw, path = random.Random(5), part(folder, 1)
    content = path.read_bytes()
    journal = opened(folder)
    for trial in range(24):
        changed = bytearray(content)
        if trial % 3:
            changed[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
        else:
            changed = changed[: draw.randrange(len(content))]
        path.write_bytes(changed)
        assert journal.shards()[1][0][1].startswith("damaged")
        renamed = put(folder, 1, bytes(changed))
        good, bad = journal.shards()
        assert len(good) + len(bad) == 4
        if not bad:
            with suppress(InvalidInput):  # nothing else
                merged(journal, good)
        renamed.unlink()
        path.write_bytes(content)


# The manifest ---------------------------------------------------------------------------------------------
def changed_settings(stated: dict[str, Any], **changes: Any) -> dict[str, Any]:
    settings = stated["settings"] | changes
    return {"settings": settings, "digest": campaign_digest(settings, stated["columns"], stated["time_s"])}


def changed_columns(stated: dict[str, Any], columns: Any) -> dict[str, Any]:
    return {"columns": columns, "digest": campaign_digest(stated["settings"], columns, stated["time_s"])}


MANIFESTS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "version 99": lambda s: {"version": 99},
    "version 1": lambda s: {"version": 1},
    "version true": lambda s: {"version": True},
    "another file": lambda s: {"what": "flexhinf report"},
    "about": lambda s: {"about": 3},
    "title": lambda s: {"about": {"title": 3}},
    "requirements": lambda s: {"about": {"requirements": "peak_input<=3"}},
    "requirement": lambda s: {"about": {"requirements": [3]}},
    "nominal": lambda s: {"about": {"nominal": [1.0]}},
    "nominal text": lambda s: {"about": {"nominal": {"mass": "heavy"}}},
    "huge nominal": lambda s: {"about": {"nominal": {"mass": 10**400}}},
    "options": lambda s: {"about": {"options": "all"}},
    "command": lambda s: {"command": [1, 2]},
    "no command": lambda s: {"command": None},
    "samples": lambda s: changed_settings(s, samples=1e14),
    "samples as text": lambda s: changed_settings(s, samples="1e14"),
    "many samples": lambda s: changed_settings(s, samples="100000000000000"),
    "no samples": lambda s: changed_settings(s, samples="0"),
    "batch": lambda s: changed_settings(s, batch="-4"),
    "huge batch": lambda s: changed_settings(s, batch="9" * 30),
    "seed": lambda s: changed_settings(s, seed="one"),
    "duration": lambda s: changed_settings(s, duration="nan"),
    "setting": lambda s: changed_settings(s, method=["random"]),
    "settings": lambda s: {"settings": ["samples"]},
    "no settings": lambda s: {"settings": {}},
    "no columns": lambda s: changed_columns(s, []),
    "columns": lambda s: {"columns": 7},
    "missing column": lambda s: changed_columns(s, s["columns"][1:]),
    "column twice": lambda s: changed_columns(s, [*s["columns"], s["columns"][-1]]),
    "column of two": lambda s: changed_columns(s, [*s["columns"], ["a", "metric"]]),
    "kind": lambda s: changed_columns(s, [*s["columns"], ["a", "colour", ""]]),
    "other column": lambda s: {"columns": [*s["columns"], ["a", "metric", ""]]},
    "time": lambda s: {"time_s": "now"},
    "no time": lambda s: {"time_s": []},
    "infinite time": lambda s: {"time_s": [0.0, float("inf")]},
    "another time": lambda s: {"time_s": [2.0 * t for t in s["time_s"]]},
    "digest": lambda s: {"digest": "0" * 64},
}


@pytest.mark.parametrize("name", MANIFESTS)
@pytest.mark.parametrize("seal", ["its own digest", "the old digest"])
def test_a_manifest_that_no_campaign_writes_is_refused(folder: Path, name: str, seal: str) -> None:
    """Also one that was sealed again with its digest."""
    stated = read_sealed(folder / MANIFEST)
    old = json.loads((folder / MANIFEST).read_bytes())["sha256"]
    changed = stated | MANIFESTS[name](stated)
    content = sealed(changed) if seal == "its own digest" else json.dumps(changed | {"sha256": old}).encode()
    (folder / MANIFEST).write_bytes(content)
    tracemalloc.start()
    try:
        with refused_with(InvalidInput, "manifest", "campaign.json"):
            Journal.read(folder)
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "name", ["what", "version", "digest", "command", "settings", "about", "columns", "time_s"]
)
def test_a_manifest_with_an_entry_less_is_refused(folder: Path, name: str) -> None:
    stated = read_sealed(folder / MANIFEST)
    del stated[name]
    (folder / MANIFEST).write_bytes(sealed(stated))
    with refused_with(InvalidInput, "manifest", "campaign.json"):
        Journal.read(folder)


def test_the_version_of_another_manifest_is_told(folder: Path) -> None:
    stated = read_sealed(folder / MANIFEST)
    for other in (sealed(stated | {"version": 99}), json.dumps(stated | {"version": 99}).encode()):
        (folder / MANIFEST).write_bytes(other)
        with pytest.raises(InvalidInput) as error:
            Journal.read(folder)
        assert "version 2, got 99" in error.value.found


@pytest.mark.parametrize(
    "text", ["", "3", "[]", "null", "{}", "[" * 100_000, '{"a": ' * 10_000, '{"version": 1e999}', "9" * 6000, "\xff"]
)  # fmt: skip
def test_a_manifest_that_is_none_is_refused(folder: Path, text: str) -> None:
    (folder / MANIFEST).write_text(text, encoding="latin-1")
    with refused_with(InvalidInput, "manifest", "campaign.json"):
        Journal.read(folder)


def test_changed_characters_of_a_manifest_are_refused(folder: Path) -> None:
    content, draw = (folder / MANIFEST).read_bytes(), random.Random(3)
    same = json.loads(content)
    for _ in range(200):
        changed = bytearray(content)
        changed[draw.randrange(len(content))] = draw.randrange(32, 127)
        (folder / MANIFEST).write_bytes(changed)
        try:
            Journal.read(folder)
        except InvalidInput:
            continue
        assert json.loads(bytes(changed)) == same, "only blanks may differ"


def test_many_batches_that_are_missing_take_no_memory(folder: Path) -> None:
    stated = read_sealed(folder / MANIFEST)
    shutil.rmtree(folder / SHARDS)
    (folder / MANIFEST).write_bytes(
        sealed(stated | changed_settings(stated, samples=str(1 << 29), batch="1"))
    )
    journal = opened(folder)
    tracemalloc.start()
    try:
        with refused_with(InvalidInput, f"{1 << 29} batches", 0, "missing:"):
            merged(journal, journal.shards()[0])
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


def test_a_campaign_with_the_same_settings_and_other_columns_is_refused(folder: Path, tmp_path: Path) -> None:
    stated = read_sealed(folder / MANIFEST)
    columns = [["mass", "parameter", "g"] if one[0] == "mass" else one for one in stated["columns"]]
    (folder / MANIFEST).write_bytes(sealed(stated | changed_columns(stated, columns)))
    campaign = made_campaign()
    with pytest.raises(InvalidInput, match="columns"):
        Journal.opened(folder, campaign)
    here = Journal.opened(tmp_path / "here", campaign)
    with pytest.raises(InvalidInput, match="columns"):
        here.take(opened(folder))


def test_a_replay_of_a_damaged_part_says_that_the_table_has_no_row(folder: Path) -> None:
    put(folder, 1, part(folder, 2).read_bytes())
    found = Replayed(made_campaign(), opened(folder), 20)
    assert found.recorded == {}
    assert Replayed(made_campaign(), opened(folder), 40).same


def test_a_campaign_from_python_has_a_duration_for_its_page(loop) -> None:
    campaign = Campaign(loop, tolerances(), 2, options={"reference": 0.1})
    assert campaign.settings["duration"] == "8.0"
    assert np.isclose(campaign.time[-1], 8.0)


@pytest.mark.parametrize("below", [".", "deeper", "deeper/still"])
def test_a_file_and_what_would_lie_below_it_are_refused(below: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a campaign")
    with refused_with(InvalidInput, "folder", str(tmp_path / "file")):
        Journal.read(tmp_path / "file" / below)


@pytest.mark.parametrize(
    "error", [PermissionError(13, "denied"), OSError(116, "Stale file handle"), MemoryError()]
)
def test_what_cannot_be_read_just_now_refuses_and_stays(
    folder: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """A colleague's files, a file server, too little memory: nothing is known of the rows, so nothing is done."""

    def unreadable(path: Path, most: int) -> bytes:
        raise error

    before = {path: path.read_bytes() for path in (folder / SHARDS).iterdir()}
    campaign = made_campaign()
    found = Journal.opened(folder, campaign)
    monkeypatch.setattr(journal, "read_bytes", unreadable)
    with pytest.raises(InvalidInput if isinstance(error, OSError) else MemoryError):
        drive(campaign, found)
    monkeypatch.undo()
    assert {path: path.read_bytes() for path in (folder / SHARDS).iterdir()} == before


@pytest.mark.skipif(os.name != "posix", reason="modes of files")
@pytest.mark.parametrize("closed", ["shards/*.parquet", "campaign.json"])
def test_what_to_do_about_a_closed_file_names_its_owner_and_works(
    folder: Path, monkeypatch: pytest.MonkeyPatch, closed: str
) -> None:
    """As a user who may not do everything: the tests may run as one who may."""

    def read(path: Path, most: int) -> bytes:
        if not path.stat().st_mode & 0o400:
            raise PermissionError(errno.EACCES, "Permission denied")
        return read_bytes(path, most)

    campaign = made_campaign()
    for path in folder.glob(closed):
        path.chmod(0)
    for module in (journal, manifest):
        monkeypatch.setattr(module, "read_bytes", read)
    with pytest.raises(InvalidInput) as refused:
        drive(campaign, Journal.opened(folder, campaign))
    command, _, rest = refused.value.advice.partition(", which ")
    assert unnamed(rest, "you ") == []
    subprocess.run(shlex.split(command), check=True)
    assert drive(campaign, Journal.opened(folder, campaign)) is not None


def test_a_folder_of_another_user_goes_on_in_a_copy(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def closed(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    campaign, copy = made_campaign(), folder.with_name("copy of it")
    part(folder, 1).unlink()
    monkeypatch.setattr(journal, "publish_whole", closed)
    with pytest.raises(FlexhinfError) as refused:
        drive(campaign, Journal.opened(folder, campaign))
    monkeypatch.undo()
    command = refused.value.advice.partition(", and ")[0].replace("COPY", shlex.quote(str(copy)))
    subprocess.run(shlex.split(command), check=True)
    assert drive(campaign, Journal.opened(copy, campaign)) is not None


def test_wrong_files_are_set_aside_and_none_is_deleted(whole: Path, folder: Path) -> None:
    campaign, said = made_campaign(), []
    damaged, stranger = part(folder, 1), folder / SHARDS / "batch-of-mine.parquet"
    damaged.write_bytes(b"damaged")
    stranger.write_bytes(b"mine")
    for _ in range(2):
        drive(campaign, Journal.opened(folder, campaign), progress=said.append)
        damaged = part(folder, 1)
        kept = damaged.read_bytes()
        damaged.write_bytes(b"damaged")
    damaged.write_bytes(kept)
    names = sorted(path.name for path in (folder / SHARDS).iterdir() if "aside" in path.name)
    assert names == sorted([f"{stranger.name}.aside", f"{damaged.name}.aside", f"{damaged.name}.aside1"])
    assert (folder / SHARDS / f"{stranger.name}.aside").read_bytes() == b"mine"
    assert any(f"{stranger.name}.aside" in str(report) for report in said)
    assert (folder / TABLE).read_bytes() == (whole / TABLE).read_bytes()
