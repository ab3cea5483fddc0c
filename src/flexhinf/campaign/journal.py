"""The journal of a campaign: a folder with a manifest and one Parquet file for each batch that is done.

The files are the truth; there is no other record of what was run. Each is written under another name, forced to the
disk, and renamed to one that holds the batch and the SHA-256 of its bytes: a file is whole, or it is found out and run
again. A batch that is written twice gets the same name twice.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.campaign.batches import Campaign, Column
from flexhinf.campaign.samples import Rows
from flexhinf.campaign.storage import (
    FORMAT,
    check_installed,
    disk_refusals,
    numpy_column,
    parquet_bytes,
    publish_whole,
    read_columns,
    write_whole,
)
from flexhinf.errors import InvalidInput
from flexhinf.files import locked, note_written, part_file
from flexhinf.untrusted import checked_path, read_bytes

__all__ = ["MANIFEST", "TABLE", "Journal"]

MANIFEST, SHARDS, TABLE, LOCK = "campaign.json", "shards", "samples.parquet", ".campaign-lock"

_WHAT = "flexhinf campaign"
_SHARD = re.compile(r"batch-(\d{8})-([0-9a-f]{16})\.parquet\Z")
_PREFIX = ".batch-{:08d}."

#: Bytes of the largest manifest and shard that are read.
_MOST_MANIFEST, _MOST_SHARD = 10_000_000, 4 << 30

#: Rows of a group in the table, at least.
_GROUP = 65_536

#: Changes of the settings that a refusal lists.
_LISTED = 8


@dataclass(frozen=True, eq=False)
class Journal:
    """The folder of one campaign.

    Attributes
    ----------
    folder : Path
    manifest : mapping
        What its file says.
    """

    folder: Path
    manifest: Mapping[str, Any]

    # Opening -----------------------------------------------------------------------------------------------
    @staticmethod
    def read(folder: str | os.PathLike[str], beside: Sequence[str] = ()) -> Journal | None:
        """The journal in a folder; None where there is none yet.

        Parameters
        ----------
        folder : path
        beside : sequence of str
            Names that may stand there before the manifest does.

        Raises
        ------
        InvalidInput
            If the folder is a file, holds something else, or its manifest is damaged.
        """
        place = checked_path("The campaign's folder", folder).expanduser().absolute()
        if place.exists() and not place.is_dir():
            raise InvalidInput(
                "A campaign needs a folder, and there is a file.", f"got {place}", "another name"
            )
        try:
            manifest = json.loads(read_bytes(place / MANIFEST, _MOST_MANIFEST))
            if not isinstance(manifest, dict) or manifest.get("what") != _WHAT:
                raise ValueError("it is not a campaign's")
            Journal._checked(manifest)
            return Journal(place, manifest)
        except FileNotFoundError:
            found = [] if not place.is_dir() else [p.name for p in place.iterdir() if p.name[:1] != "."]
            strangers = [name for name in found if name not in (SHARDS, *beside)]
            if strangers:
                raise InvalidInput(
                    "The folder holds something that is not a campaign, and is left alone.",
                    f"expected no folder, an empty one, or one with {MANIFEST}; got {sorted(strangers)[:3]} in {place}",
                    "another folder",
                ) from None
            return None
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise InvalidInput(
                "The manifest of the campaign cannot be read.",
                f"{place / MANIFEST}: {str(error)[:200]}",
                "a copy of it, or another folder",
            ) from error

    @staticmethod
    def _checked(manifest: Mapping[str, Any]) -> None:
        """Raise ValueError for a manifest that was changed."""
        if manifest["digest"] != _digest_of(manifest["settings"]):
            raise ValueError("its settings are not those of its digest")
        for name in ("samples", "batch"):
            if int(manifest["settings"][name]) < 1:
                raise ValueError(f"{name} is not positive")
        _ = [Column(*column) for column in manifest["columns"]], np.array(manifest["time_s"], dtype=float)

    @staticmethod
    def opened(
        folder: str | os.PathLike[str],
        campaign: Campaign,
        command: Sequence[str] = (),
        about: Mapping[str, Any] | None = None,
    ) -> Journal:
        """The journal of this campaign in a folder: made, or taken up again.

        Parameters
        ----------
        folder : path
        campaign : Campaign
        command : sequence of str
            That made it, for the reports.
        about : mapping, optional
            What else reports and replays need; it is not compared. Where it is given, other files of the caller's may
            be there already.

        Raises
        ------
        InvalidInput
            As `read`; or the folder is that of another campaign: the message says what differs.
        """
        place = Path(folder).expanduser().absolute()
        beside = [] if about is None or not place.is_dir() else [path.name for path in place.iterdir()]
        journal = Journal.read(folder, [name for name in beside if name != MANIFEST])
        if journal is None:
            journal = Journal._made(place, campaign, command, about or {})
        journal.refuse_other(campaign.settings)
        return journal

    @staticmethod
    def _made(place: Path, campaign: Campaign, command: Sequence[str], about: Mapping[str, Any]) -> Journal:
        manifest = {
            "what": _WHAT, "version": 1, "digest": campaign.digest, "command": list(command),
            "settings": campaign.settings, "about": dict(about),
            "columns": [[column.name, column.kind, column.unit] for column in campaign.columns],
            "time_s": (campaign.instants * campaign.loop.controller.period).tolist(),
        }  # fmt: skip
        check_installed()
        with disk_refusals(place):
            (place / SHARDS).mkdir(parents=True, exist_ok=True)
            write_whole(place / MANIFEST, json.dumps(manifest, indent=1).encode())
        return Journal(place, manifest)

    def refuse_other(self, settings: Mapping[str, str], partly: bool = False) -> None:
        """Refuse a campaign with other settings, and say which they are; `partly`: these alone are compared."""
        here = self.settings
        names = dict.fromkeys(settings if partly else (*settings, *here))
        other = [name for name in names if settings.get(name) != here.get(name)]
        if other:
            parts = [
                f"{n}: {here.get(n, 'not stated')} → {settings.get(n, 'not stated')}" for n in other[:_LISTED]
            ]
            more = [f"{len(other) - _LISTED} more"] if len(other) > _LISTED else []
            raise InvalidInput(
                "The folder is that of another campaign; it cannot be taken up again with other settings.",
                f"{self.folder}; there → now: " + "; ".join([*parts, *more]),
                "another folder for these settings, or the settings of this folder again",
            )

    # What it says ------------------------------------------------------------------------------------------
    @property
    def settings(self) -> dict[str, str]:
        """Of the campaign."""
        return dict(self.manifest["settings"])

    @property
    def about(self) -> dict[str, Any]:
        """What else was stated when it was made."""
        return dict(self.manifest.get("about", {}))

    @property
    def samples(self) -> int:
        """Of the campaign."""
        return int(self.settings["samples"])

    @property
    def batches(self) -> int:
        """Of the campaign."""
        return -(-self.samples // int(self.settings["batch"]))

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Of the shards."""
        return tuple(Column(*column) for column in self.manifest["columns"])

    @property
    def time(self) -> np.ndarray:
        """Instants (T,) at which signals are kept, s."""
        return np.array(self.manifest["time_s"], dtype=float)

    def size(self, batch: int) -> int:
        """Samples of a batch."""
        batch_size = int(self.settings["batch"])
        return min(batch_size, self.samples - batch * batch_size)

    # Locks -------------------------------------------------------------------------------------------------
    @contextmanager
    def driven(self, part: str = "") -> Iterator[None]:
        """Keep other drivers of the same part, or of the whole, out for the block.

        The lock ends with its process, however that ends. Drivers of different parts work side by side.

        Raises
        ------
        InvalidInput
            If another one is at work.
        """
        lock = self.folder / (f"{LOCK}-{part}" if part else LOCK)
        others = [p for p in self.folder.glob(f"{LOCK}*") if p != lock and (not part or p.name == LOCK)]
        with disk_refusals(self.folder), locked(lock) as state:
            if state == "busy" or any(_held(other) for other in others):
                raise InvalidInput(
                    "Another driver is at work on this campaign.",
                    f"{self.folder}: its lock is held",
                    "wait for it, or end it; parts of one campaign run side by side with --shard 1/4, --shard 2/4, …",
                )
            yield

    # Shards ------------------------------------------------------------------------------------------------
    def write(self, batch: int, rows: Rows) -> Path:
        """Write the rows of a batch: whole, or not at all.

        Raises
        ------
        FlexhinfError
            If the disk is full, or refuses for another reason; what was written before stays.
        """
        content = parquet_bytes(self.columns, rows.columns, self.manifest["digest"])
        name = f"batch-{batch:08d}-{hashlib.sha256(content).hexdigest()[:16]}.parquet"
        path = self.folder / SHARDS / name
        with disk_refusals(self.folder):
            write_whole(path, content, _PREFIX.format(batch))
        note_written(path.parent, path.parent)
        return path

    def shards(self) -> tuple[dict[int, Path], list[tuple[Path, str]]]:
        """The shards that are whole, by batch, and those that are not with what is wrong.

        Every byte is looked at: SHA-256, the digest of the campaign, and the number of rows.

        Raises
        ------
        InvalidInput
            If a batch is there twice with different rows.
        """
        good: dict[int, Path] = {}
        bad: list[tuple[Path, str]] = []
        for path in sorted((self.folder / SHARDS).glob("batch-*.parquet")):
            match = _SHARD.match(path.name)
            wrong = "no name of a shard" if match is None else self._wrong(path, int(match[1]), match[2])
            if match is None or wrong:
                bad.append((path, wrong))
            elif (batch := int(match[1])) in good:
                raise InvalidInput(
                    f"Batch {batch} was written twice with different rows.",
                    f"expected one of {good[batch].name} and {path.name}: their last bits differ where kinds of "
                    "processors do",
                    "delete one of the two",
                )
            else:
                good[batch] = path
        return good, bad

    def _wrong(self, path: Path, batch: int, digest: str) -> str:
        """What is wrong with a shard; empty where nothing is."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            content = read_bytes(path, _MOST_SHARD)
        except OSError as error:
            return str(error)
        if hashlib.sha256(content).hexdigest()[:16] != digest:
            return f"damaged: {len(content)} bytes that are not those of its digest"
        found = pq.read_metadata(pa.BufferReader(content))
        if (found.metadata or {}).get(b"campaign") != self.manifest["digest"].encode():
            return "of another campaign"
        if not 0 <= batch < self.batches or found.num_rows != self.size(batch):
            return f"{found.num_rows} rows for batch {batch}"
        return ""

    def row(self, sample: int) -> dict[str, Any]:
        """The row of a sample, without kept signals; empty where its batch is not done."""

        batch, place = divmod(sample, int(self.settings["batch"]))
        for path in (self.folder / SHARDS).glob(f"batch-{batch:08d}-*.parquet"):
            match = _SHARD.match(path.name)
            if match and not self._wrong(path, batch, match[2]):
                kept = [column.name for column in self.columns if column.kind != "trace"]
                table = read_columns(path, kept)
                row = {name: numpy_column(table.column(name))[place] for name in kept}
                return {
                    name: value.item() if hasattr(value, "item") else value for name, value in row.items()
                }
        return {}

    def missing(self, good: Iterable[int]) -> list[int]:
        """The batches that are still to be run."""
        done = set(good)
        return [batch for batch in range(self.batches) if batch not in done]

    # The whole ---------------------------------------------------------------------------------------------
    def take(self, other: Journal) -> int:
        """Copy the shards of another folder of the same campaign that are missing here; returns how many.

        Raises
        ------
        InvalidInput
            If it is another campaign, or a shard there is damaged.
        """
        self.refuse_other(other.settings)
        here, (there, bad) = self.shards()[0], other.shards()
        if bad:
            raise InvalidInput(
                "A shard is damaged.",
                f"{bad[0][0]}: {bad[0][1]}",
                "the campaign's command again, which runs it again",
            )
        fresh = {batch: path for batch, path in there.items() if batch not in here}
        with disk_refusals(self.folder):
            for batch, path in fresh.items():
                write_whole(self.folder / SHARDS / path.name, path.read_bytes(), _PREFIX.format(batch))
        return len(fresh)

    def merge(self, good: Mapping[int, Path]) -> Path:
        """Write the table of all samples, batch after batch: the same bytes for the same shards.

        Parameters
        ----------
        good : mapping of int to Path
            Every batch's shard.

        Raises
        ------
        InvalidInput
            If one is missing.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        if missing := self.missing(good):
            raise InvalidInput(
                "The campaign is not complete.",
                f"expected {self.batches} batches, got {len(good)}; missing: "
                f"{', '.join(map(str, missing[:10]))}{' …' if len(missing) > 10 else ''}",
                "the campaign's command again, or the folders of the other shards",
            )
        kept = [column.name for column in self.columns if column.kind != "trace"]
        path = self.folder / TABLE
        with disk_refusals(self.folder), part_file(self.folder, f".{TABLE}.") as name:
            with pq.ParquetWriter(name, read_columns(good[0], kept).schema, **FORMAT) as writer:
                group: list[pa.Table] = []
                for batch in range(self.batches):
                    group.append(read_columns(good[batch], kept))
                    if sum(map(len, group)) >= _GROUP or batch == self.batches - 1:
                        writer.write_table(pa.concat_tables(group).combine_chunks())
                        group = []
            publish_whole(name, path)
        return path


def _held(path: Path) -> bool:
    """Whether another process holds a lock file."""
    with locked(path) as state:
        return state == "busy"


def _digest_of(settings: Mapping[str, str]) -> str:
    return hashlib.sha256(json.dumps(dict(settings), sort_keys=True).encode()).hexdigest()
