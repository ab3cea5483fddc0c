"""The journal of a campaign: a folder with a manifest and one Parquet file for each finished batch.

The files are the only record of finished batches. Each is written under a temporary name, forced to the disk, and
renamed to a name with the batch and the SHA-256 of its bytes. A damaged file is detected and its batch runs again. A
batch that is written twice gets the same name twice.

Files of a campaign's folder are not trusted: a reader checks that a campaign can have written a file before it uses a
number. The manifest contains the settings that rows depend on, the columns and information for reports, under one
digest. Its columns define how rows are written, checked, read and merged.
"""

# pyarrow has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownLambdaType=false
# pyright: reportUnknownMemberType=false, reportUnknownParameterType=false, reportUnknownVariableType=false
# pyright: reportArgumentType=false

from __future__ import annotations

import errno
import hashlib
import math
import os
import re
import shlex
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, TypeVar

import numpy as np

from flexhinf.campaign.batches import LARGEST_BATCH, OWN, TRACED, Campaign, Rows, TableColumn
from flexhinf.campaign.draws import Tolerances, sample_seeds
from flexhinf.campaign.manifest import (
    KIND,
    MOST_BYTES,
    UNREADABLE,
    CampaignFacts,
    Manifest,
    check_own_folder,
    differing,
    listed,
    read_manifest,
    read_sealed,
    sealed,
)
from flexhinf.campaign.metrics import COMPLETED, DIVERGED, NOT_RUN, UNSTABLE
from flexhinf.campaign.parquet import (
    arrow_array,
    batch_format,
    numpy_column,
    read_columns,
    row_schema,
)
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.files import clear_parts, locked, make_durable, note_written, part_file
from flexhinf.processors import in_threads, once_beside
from flexhinf.validation import (
    NotReadable,
    access_to,
    checked_path,
    extra_package,
    owner_of,
    read_bytes,
    value_text,
)

if TYPE_CHECKING:
    from concurrent.futures import Future

    from pyarrow import Schema, Table

Stored = TypeVar("Stored")

#: A sample's row without kept signals, by column; empty where its batch is not done.
Row: TypeAlias = dict[str, int | float | str]


def write_whole(path: Path, content: bytes | memoryview, prefix: str | None = None) -> None:
    """Write a file under a temporary name, force it to the disk, and rename it.

    `prefix`: Of that name, where `clear_parts` has removed what was left over.
    """
    own = f".{path.name}." if prefix is None else prefix
    with part_file(path.parent, own, cleared=prefix is not None) as name:
        Path(name).write_bytes(content)
        publish_whole(name, path)


def publish_whole(name: str, path: Path) -> None:
    """Force a file to the disk, rename it, and force the new name to the disk."""
    make_durable(name)
    os.replace(name, path)
    if hasattr(os, "O_DIRECTORY"):
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextmanager
def disk_refusals(folder: Path) -> Generator[None]:
    """Turn errors of the disk within this block into errors in three parts."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        denied = error.errno in (errno.EACCES, errno.EPERM, errno.EROFS)
        raise FlexhinfError(
            "The disk of the campaign is full." if full else "The campaign's folder cannot be written.",
            f"{folder}: {error.strerror or error}; every batch that was written before is whole and stays",
            f"cp -r {shlex.quote(str(folder))} COPY, and the same command with COPY in its place; or as "
            f"{owner_of(folder)}, who owns it"
            if denied
            else f"{'more room, and the' if full else 'the'} same command: it goes on where it stopped",
        ) from error


#: Largest size, bytes, of a shard that is read; of a shard beyond its rows; and of one text.
_MOST_SHARD, _SPARE, _LONGEST_TEXT = 4 << 30, 1_000_000, 16_384

MANIFEST, SHARDS, TABLE, LOCK = "campaign.json", "shards", "samples.parquet", ".campaign-lock"

_SHARD = re.compile(r"batch-(\d{8})-([0-9a-f]{16})\.parquet\Z")
_PREFIX, _PREFIXES = ".batch-{:08d}.", r"\.batch-\d{8}\."

#: Largest number of threads that read files; bytes of rows that were just written, and need not be read for the table.
READERS, _RECENT = 8, 64_000_000

#: Relative tolerance for numbers that are drawn again: processors differ in the last bits of normal numbers.
_SAME = 1e-9

#: Largest number of changed settings, or of batches, that an error lists.
LISTED = 8


@dataclass(eq=False)
class Journal:
    """The folder of one campaign with the entries of its manifest.

    `samples`, `batches`: their numbers. `metrics`: names of the columns with a metric, of a run or of a part.
    """

    folder: Path
    settings: Mapping[str, str]  # Everything that the rows depend on, as text by name
    digest: str  # Digest of the settings and of the columns
    columns: tuple[TableColumn, ...]  # Of the shards
    time: np.ndarray  # (T,). Instants at which signals are kept, s
    command: Sequence[str] = ()  # Command that made the campaign, for the reports
    about: CampaignFacts = field(default_factory=CampaignFacts)  # Further information from when it was made

    @staticmethod
    def read(folder: str | os.PathLike[str], beside: Sequence[str] = ()) -> Journal | None:
        """Read the journal in a folder; None if there is none yet, and no files except those named in `beside`.

        InvalidInput if the folder is a file, holds something else, or its manifest is damaged.
        """
        place = checked_path("The campaign's folder", folder).expanduser().absolute()
        try:
            with access_to(place / MANIFEST, place):
                stated = read_manifest(place / MANIFEST)
        except (FileNotFoundError, NotADirectoryError):
            check_own_folder(place, "campaign", (MANIFEST, SHARDS, *beside))
            return None
        except NotReadable:
            raise
        except UNREADABLE as error:
            raise InvalidInput(
                "The manifest of the campaign cannot be read.",
                f"{place / MANIFEST}: {type(error).__name__}: {str(error)[:400]}",
                "a copy of it, or another folder",
            ) from error
        return Journal(
            place, stated["settings"], stated["digest"], tuple(TableColumn(*column) for column in stated["columns"]),
            np.array(stated["time_s"], dtype=float), stated["command"], stated["about"],
        )  # fmt: skip

    @staticmethod
    def existing(folder: str | os.PathLike[str]) -> Journal:
        """Read the journal in a folder; InvalidInput as `read`, and where there is none, whatever else is there."""
        place = checked_path("The campaign's folder", folder).expanduser().absolute()
        journal = Journal.read(folder, [path.name for path in place.iterdir()] if place.is_dir() else [])
        if journal is None:
            raise InvalidInput(
                "There is no campaign.",
                f"expected a folder with campaign.json, as flexhinf campaign writes it, got {folder}",
                f"flexhinf campaign run {shlex.quote(str(folder))}, and then the folder of its --out"
                if (place / "design.toml").is_file()
                else "the folder of its --out",
            )
        return journal

    @staticmethod
    def opened(
        folder: str | os.PathLike[str],
        campaign: Campaign,
        command: Sequence[str] = (),
        about: CampaignFacts | None = None,
    ) -> Journal:
        """Open the journal of a campaign in a folder: a new one, or the one there to continue.

        `command`: the command that runs the campaign, for the reports.
        `about`: further information for reports and replays; it is not compared. With it, the folder may already
        contain other files of the caller.

        InvalidInput as `read`, or if the folder is that of another campaign.
        """
        journal = Journal.begun(folder, campaign, command, about)
        journal.wait_for_manifest()
        return journal

    @staticmethod
    def begun(
        folder: str | os.PathLike[str],
        campaign: Campaign,
        command: Sequence[str] = (),
        about: CampaignFacts | None = None,
    ) -> Journal:
        """As `opened`, but the manifest of a new one may still be on its way to the disk: `write` waits for it."""
        place = Path(folder).expanduser().absolute()
        beside = [] if about is None or not place.is_dir() else [path.name for path in place.iterdir()]
        journal = Journal.read(folder, [name for name in beside if name != MANIFEST])
        if journal is None:
            manifest: Manifest = {
                "digest": campaign.digest,
                "command": list(command),
                "settings": campaign.settings,
                "about": about or {},
                "columns": [[c.name, c.kind, c.unit] for c in campaign.columns],
                "time_s": campaign.time.tolist(),
            }
            extra_package(
                "pyarrow.parquet", "campaign", "Campaigns on disk need pyarrow, which is not installed."
            )
            own = campaign.settings, campaign.digest, campaign.columns, campaign.time
            journal = Journal(place, *own, command, about or {})
            with disk_refusals(place):
                (place / SHARDS).mkdir(parents=True, exist_ok=True)
            content = sealed({**KIND, **manifest})
            journal._manifest = once_beside(lambda: write_whole(place / MANIFEST, content))
            return journal
        journal.refuse_campaign(campaign)
        return journal

    def wait_for_manifest(self) -> None:
        """Return when the manifest is on the disk; FlexhinfError if the disk is full or refuses."""
        if self._manifest is not None:
            with disk_refusals(self.folder):
                self._manifest.result()

    def refuse_campaign(self, other: Campaign | Journal) -> None:
        """Refuse a campaign other than this one; the message names the differences."""
        self.refuse_other(other.settings)
        own, others = ({column.name for column in side.columns} for side in (self, other))
        strange = sorted(own ^ others)[:LISTED]
        refuse_if(
            self.digest != other.digest,
            "The folder is that of a campaign with other columns.",
            f"{self.folder}: {', '.join(strange) or 'other kinds, units or instants'}",
            "another folder",
        )

    def refuse_other(self, settings: Mapping[str, str], partly: bool = False) -> None:
        """Refuse a campaign with other settings, and name those that differ; `partly`: compare only `settings`."""
        pairs = differing(self.settings, settings, settings if partly else (*settings, *self.settings))
        differences = [f"{name}: {own} → {other}" for name, own, other in pairs]
        refuse_if(
            differences,
            "The folder is that of another campaign; it cannot be taken up again with other settings.",
            f"{self.folder}; there → now: {listed(differences, LISTED)}",
            "another folder for these settings, or the settings of this folder again",
        )

    def __post_init__(self) -> None:
        self.samples, self._batch = int(self.settings["samples"]), int(self.settings["batch"])
        self.batches = -(-self.samples // self._batch)
        self.metrics = [column.name for column in self.columns if column.judged]
        self._recent: dict[int, Table] = {}
        self._manifest: Future[None] | None = None  # its writing, if it was not there

    def size(self, batch: int) -> int:
        """Samples of a batch."""
        return min(self._batch, self.samples - batch * self._batch)

    @contextmanager
    def driven(self, part: str = "") -> Generator[None]:
        """Lock the part, or the whole campaign, against other drivers for the block; InvalidInput if one is at work.

        The lock ends with its process, in any case. Drivers of different parts may work at the same time.
        """
        lock = self.folder / (f"{LOCK}-{part}" if part else LOCK)
        others = [p for p in self.folder.glob(f"{LOCK}*") if p != lock and (not part or p.name == LOCK)]

        def busy(path: Path) -> bool:
            with locked(path) as state:
                return state == "busy"

        with disk_refusals(self.folder), locked(lock) as state:
            refuse_if(
                state == "busy" or any(map(busy, others)),
                "Another driver is at work on this campaign.",
                f"{self.folder}: its lock is held",
                "wait for it, or end it; parts of one campaign run side by side with --shard 1/4, --shard 2/4, …",
            )
            yield

    def clear(self) -> None:
        """Remove what killed drivers had begun to write; FlexhinfError if the disk refuses."""
        with disk_refusals(self.folder):
            clear_parts(self.folder / SHARDS, _PREFIXES)

    def write(self, batch: int, rows: Rows, held: Callable[[], None] = lambda: None) -> Path:
        """Write the rows of a batch, whole or not at all; FlexhinfError if the disk is full or refuses. Several threads
        may write batches at a time.

        `held`: Called before, when the rows are held for the table.
        """
        from pyarrow import BufferOutputStream, Table, parquet

        schema, stream = self._schema_of(batch), BufferOutputStream()
        table = Table.from_arrays([arrow_array(rows[name]) for name in schema.names], schema=schema)
        if len(self._recent) * table.nbytes < _RECENT:
            traced = batch * self._batch < TRACED
            self._recent[batch] = table if traced else table.select(self.table_schema.names)
            held()
        parquet.write_table(table, stream, **batch_format(schema))
        content = memoryview(stream.getvalue())
        digest = hashlib.sha256(content).hexdigest()[:16]
        path = self.folder / SHARDS / f"batch-{batch:08d}-{digest}.parquet"
        self.wait_for_manifest()
        with disk_refusals(self.folder):
            write_whole(path, content, _PREFIX.format(batch))
        note_written(path.parent, path.parent)
        return path

    def in_memory(self, batch: int) -> bool:
        """Whether the rows of a batch are in memory, as those of one just written are while there is room."""
        return batch in self._recent

    def rows(self, batch: int, shard: Path | None, names: Sequence[str]) -> Table:
        """Columns of a batch as an Arrow table, from memory or from its valid shard."""
        table = self._recent.get(batch)
        if table is not None:
            return table.select(list(names))
        assert shard is not None
        return read_columns(shard, names)

    def let_go(self, batch: int) -> None:
        """Keep no rows of a batch in memory for the table, unless it has signals of runs."""
        if batch * self._batch >= TRACED:
            self._recent.pop(batch, None)

    def shards(self) -> tuple[dict[int, Path], list[tuple[Path, str]]]:
        """Valid shards by batch, and invalid ones with the reason.

        It checks the SHA-256 of every file; then the campaign's digest, the batch, the columns, indices and seeds of
        the samples, the status of the runs, and the varied numbers if the manifest defines the draw. It does not detect
        a metric that was changed together with the file's name. InvalidInput if a batch exists twice with different
        rows, or a folder has the name of a shard.
        """
        good: dict[int, Path] = {}
        bad: list[tuple[Path, str]] = []
        for path, batch, wrong in self._checked(self._parts()):
            if wrong:
                bad.append((path, wrong))
                continue
            other = good.setdefault(batch, path)
            refuse_if(
                other is not path,
                f"Batch {batch} was written twice with different rows.",
                f"expected one of {other.name} and {path.name}: their last bits differ where kinds of processors do",
                "delete one of the two",
            )
        return good, bad

    def _parts(self) -> list[Path]:
        """What has the name of a batch's file; refuses a folder among them, and one that cannot be listed."""
        place = self.folder / SHARDS
        with access_to(place, self.folder):
            parts = (
                sorted(path for path in place.iterdir() if path.match("batch-*.parquet"))
                if place.exists()
                else []
            )
            folders = [path for path in parts if path.is_dir() and not path.is_symlink()]
        refuse_if(
            folders,
            "A folder stands where a file of the campaign belongs.",
            f"expected a file of rows, got the folder {', '.join(map(str, folders[:1]))}",
            "move or delete that folder, and the same command again",
        )
        return parts

    def set_aside(self, path: Path) -> Path:
        """Give a file among the shards a free name that is none of a shard; returns it."""
        names = (path.with_name(f"{path.name}.aside{k or ''}") for k in count())
        return path.rename(next(name for name in names if not os.path.lexists(name)))

    def _checked(self, paths: Sequence[Path]) -> Iterator[tuple[Path, int, str]]:
        """Files with the name of a batch's, their batches (-1: none) and defects; see `_wrong`.

        Those of many batches are checked together: their numbers are drawn at once, and threads read them.
        """
        together = max(1, LARGEST_BATCH // self._batch)
        for first in range(0, len(paths), together):
            some = paths[first : first + together]
            named = (_SHARD.match(path.name) for path in some)
            batches = [int(match[1]) if match else -1 for match in named]
            expected = self._numbers_of({batch for batch in batches if 0 <= batch < self.batches})
            yield from zip(some, batches, in_threads(partial(self._wrong, expected=expected), some, READERS))

    def _numbers_of(self, batches: Collection[int]) -> dict[int, Rows] | ValueError | KeyError:
        """Varied numbers of the samples of batches, drawn at once; none of a user's function, whose code is not in the
        manifest. The error of settings that state no draw."""
        ordered, names = sorted(batches), [c.name for c in self.columns if c.kind == "parameter"]
        indices = [range(batch * self._batch, batch * self._batch + self.size(batch)) for batch in ordered]
        try:
            draw = Tolerances.stated(self.settings, names)
            if draw is None or not ordered:
                return {batch: {} for batch in ordered}
            numbers = draw.numbers([*chain(*indices)], self.samples, int(self.settings["seed"]))
        except (ValueError, KeyError) as error:
            return error
        ends = np.cumsum([0, *map(len, indices)]).tolist()
        return {
            batch: {name: column[start:end] for name, column in numbers.items()}
            for batch, start, end in zip(ordered, ends, ends[1:])
        }

    def _wrong(self, path: Path, expected: dict[int, Rows] | ValueError | KeyError) -> str:
        """The defect of a file with the name of a batch's, whose numbers were drawn; empty for a valid file.

        NotReadable for a file that cannot be read just now, and MemoryError: nothing is known of its rows.

        In a valid file, columns, metadata, indices and seeds are those of the campaign, and the size is plausible when
        unpacked. The status of every run is known, and failure, time of divergence and metrics agree with it. If the
        draw is known, the varied numbers are those of the draw.
        """
        from pyarrow import ArrowException, BufferReader, parquet, types

        match = _SHARD.match(path.name)
        if match is None:
            return "no name of a shard"
        batch, digest = int(match[1]), match[2]
        if not 0 <= batch < self.batches:
            return f"of no batch: there are {self.batches}"
        first = batch * self._batch
        samples, seed = range(first, first + self.size(batch)), int(self.settings["seed"])
        span = f"not the samples {samples[0]} to {samples[-1]}"
        schema = self._schema_of(batch)
        with access_to(path, self.folder):
            usable = path.is_file() and path.stat().st_size <= _MOST_SHARD
            content = read_bytes(path, _MOST_SHARD) if usable else b""
        if hashlib.sha256(content).hexdigest()[:16] != digest:
            return "damaged: its bytes are not those of its digest"
        try:
            with parquet.ParquetFile(BufferReader(content)) as file:
                stored, rows = file.schema_arrow, file.metadata.num_rows
                unpacked = sum(
                    file.metadata.row_group(k).total_byte_size for k in range(file.metadata.num_row_groups)
                )
                signals = [
                    entry.type.byte_width for entry in schema if types.is_fixed_size_binary(entry.type)
                ]
                texts = sum(types.is_string(entry.type) for entry in schema)
                # largest size of one row: twice its need; texts are sentences of an error
                size = 2 * sum(signals) + _LONGEST_TEXT * texts + 24 * (len(schema) - len(signals) - texts)
                if wrong := _first(
                    {
                        "of another campaign, or another part of it": not schema.metadata.items()
                        <= (stored.metadata or {}).items(),
                        "of other columns": not stored.equals(schema),
                        f"{rows} rows instead of {len(samples)}": rows != len(samples),
                        f"a file that unpacks to {unpacked} bytes": unpacked > _SPARE + rows * size,
                    }
                ):
                    return wrong
                if not isinstance(expected, dict):
                    raise expected
                numbers = expected[batch]
                own = file.read(columns=list(dict.fromkeys((*OWN, *numbers))))
                values = {name: numpy_column(own.column(name)) for name in own.column_names}
                lost = ~np.isin(values["status"].astype(str), (COMPLETED, UNSTABLE))
                unread = file.read(columns=self.metrics if lost.any() else [])
        except MemoryError:
            raise
        except (OSError, ValueError, KeyError, ArrowException) as error:
            return f"no file of rows ({' '.join(str(error).split())[:100]})"
        status, failure = values["status"], values["failure"]
        strange = [text for text in set(status) if text not in (COMPLETED, UNSTABLE, DIVERGED, NOT_RUN)]
        misfit = "that does not fit their status"
        if wrong := _first({
            span: not np.array_equal(values["sample"], np.array(samples)),
            f"{span} of the seed {seed}": not np.array_equal(values["seed"], sample_seeds(seed, samples)),
            f"of a status that no run has: {value_text(strange[0] if strange else '')}": bool(strange),
            "without the column failure in each row": None in set(failure),
            # only a sample that was not run has a reason
            f"of runs with a failure, or without one, {misfit}":
                not np.array_equal(failure != "", status == NOT_RUN),
            f"of runs with an instant of divergence, or without one, {misfit}":
                not np.array_equal(~np.isnan(values["diverged_at_s"]), status == DIVERGED),
            **{f"of runs without an end that have the metric {name}":
                not np.isnan(numpy_column(unread.column(name))[lost]).all() for name in unread.column_names},
        }):  # fmt: skip
            return wrong
        for name, column in numbers.items():
            near = np.abs(values[name] - column) <= _SAME * np.abs(column)
            if not near.all():
                k = int(np.argmin(near))
                return f"not what is drawn: {name} of sample {samples[k]} is {values[name][k]:g}, not {column[k]:g}"
        return ""

    def _schema_of(self, batch: int) -> Schema:
        """Arrow schema of a batch."""
        return self._schema.with_metadata({"campaign": self.digest, "batch": str(batch)})

    @cached_property
    def _schema(self) -> Schema:
        return row_schema(self.columns, len(self.time))

    @cached_property
    def table_schema(self) -> Schema:
        """The Arrow schema of the whole table, which has no kept signals."""
        columns = [column for column in self.columns if column.kind != "trace"]
        return row_schema(columns, 0).with_metadata({"campaign": self.digest})

    def row(self, sample: int) -> Row:
        """The row of a sample, without kept signals; empty where its batch is not done."""
        batch, place = divmod(sample, self._batch)
        names = sorted((self.folder / SHARDS).glob(f"batch-{batch:08d}-*.parquet"))
        for path, _, wrong in self._checked(names):
            if not wrong:
                table = read_columns(path, self.table_schema.names)
                columns = zip(table.column_names, table.columns)
                return {name: numpy_column(column)[[place]].tolist()[0] for name, column in columns}
        return {}

    def store(self, name: Path, content: Mapping[str, object]) -> None:
        """Write a sealed JSON file beside the rows, whole or not at all; infinite numbers and NaN become text.

        InvalidInput if another driver is at work; FlexhinfError if the disk is full.
        """

        def plain(value: object) -> object:
            match value:
                case float() if not math.isfinite(value):
                    return str(value)
                case Mapping():
                    return {name: plain(entry) for name, entry in value.items()}
                case list() | tuple():
                    return [plain(entry) for entry in value]
                case _:
                    return value

        path = self.folder / name
        with self.driven(), disk_refusals(self.folder):
            path.parent.mkdir(exist_ok=True)
            write_whole(path, sealed({key: plain(value) for key, value in content.items()}))

    def stored(self, name: Path, kind: type[Stored], most: int = MOST_BYTES) -> Stored:
        """Read a dataclass from a file of `store`, with a limit of its size; raises one of `UNREADABLE` for another
        file, and NotReadable."""
        from pydantic import TypeAdapter

        with access_to(self.folder / name, self.folder):
            return TypeAdapter(kind).validate_python(read_sealed(self.folder / name, most))

    def take(self, other: Journal) -> int:
        """Copy missing shards from another folder of the same campaign; returns their number.

        InvalidInput if it is another campaign, or a shard there is damaged.
        """
        self.refuse_campaign(other)
        here, (there, bad) = self.shards()[0], other.shards()
        refuse_if(
            bad,
            "A shard is damaged.",
            ", ".join(f"{path}: {wrong}" for path, wrong in bad[:1]),
            "the campaign's command again, which runs it again",
        )
        fresh = {batch: path for batch, path in there.items() if batch not in here}
        self.clear()
        with disk_refusals(self.folder):
            for batch, path in fresh.items():
                write_whole(self.folder / SHARDS / path.name, path.read_bytes(), _PREFIX.format(batch))
        return len(fresh)


def _first(problems: Mapping[str, bool]) -> str:
    return next((text for text, there in problems.items() if there), "")
