"""Rows as Parquet and as xarray, the same bytes for the same rows; files that are whole, or not there."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.campaign.batches import Column
from flexhinf.campaign.draws import sample_seeds
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.files import part_file

if TYPE_CHECKING:
    import pyarrow as pa
    import xarray as xr

#: Bytes of a file beyond its rows, and of one text, at most.
_SPARE, _LONGEST_TEXT = 1_000_000, 16_384

#: Columns of a file that are held in memory at once: what one figure or table compares.
HELD = 6

FORMAT: dict[str, Any] = {
    "compression": "zstd",
    "write_statistics": True,
    "use_dictionary": ["status", "failure"],
}


def check_installed() -> None:
    """Refuse to keep a campaign on disk without pyarrow.

    Raises
    ------
    InvalidInput
        With how to install it.
    """
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise InvalidInput(
            "A campaign on disk is kept in Parquet files, and pyarrow is not installed.",
            f"expected pyarrow, got: {error}",
            "pip install 'flexhinf[campaign]'",
        ) from error


def schema_of(columns: Sequence[Column], instants: int, **about: str) -> pa.Schema:
    """What a file of these columns has; a kept signal is a list of `instants` numbers of 32 bits."""
    import pyarrow as pa

    own = {"sample": pa.int64(), "seed": pa.uint64(), "status": pa.string(), "failure": pa.string()}
    lists = pa.list_(pa.float32(), instants)
    fields = []
    for column in columns:
        kind = lists if column.kind == "trace" else own.get(column.name, pa.float64())
        fields.append(pa.field(column.name, kind, metadata={"kind": column.kind, "unit": column.unit}))
    return pa.schema(fields, about)


def parquet_bytes(rows: Mapping[str, np.ndarray], schema: pa.Schema) -> bytes:
    """Columns as the bytes of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = [_arrow(rows[name]) for name in schema.names]
    stream = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), stream, **FORMAT)
    return stream.getvalue().to_pybytes()


def read_columns(path: Any, names: Sequence[str] | None = None) -> pa.Table:
    """Columns of a file, all by default.

    Raises
    ------
    InvalidInput
        If it cannot be read.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            return file.read(columns=None if names is None else list(names))
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        if isinstance(error, MemoryError):
            raise
        raise InvalidInput(
            "A file of the campaign cannot be read.",
            f"{path}: {str(error)[:200]}",
            "delete it, and the campaign's command again, which makes it again",
        ) from error


def _arrow(values: np.ndarray) -> pa.Array:
    import pyarrow as pa

    if values.ndim == 2:
        flat = pa.array(values.ravel(), mask=np.isnan(values).ravel())
        return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    if values.dtype == object:
        return pa.array(values.tolist(), pa.string())
    if values.dtype == float:
        return pa.array(values, mask=np.isnan(values))
    return pa.array(values)


def wrong_rows(path: Path, schema: pa.Schema, samples: range, seed: int) -> str:
    """What is wrong with a file of the rows of these samples; empty where nothing is.

    Its columns, its metadata, the numbers of its samples and their seeds are those of the schema and of the campaign's
    seed, and it unpacks to no more than such rows take.

    Raises
    ------
    MemoryError
        It does not fit into the memory that is free.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            found, rows = file.schema_arrow, file.metadata.num_rows
            if any((found.metadata or {}).get(key) != value for key, value in schema.metadata.items()):
                return "of another campaign, or another part of it"
            if not found.equals(schema):
                return "of other columns"
            if rows != len(samples):
                return f"{rows} rows instead of {len(samples)}"
            groups = range(file.metadata.num_row_groups)
            unpacked = sum(file.metadata.row_group(k).total_byte_size for k in groups)
            if unpacked > _SPARE + rows * sum(_width(field.type) for field in schema):
                return f"a file that unpacks to {unpacked} bytes"
            own = file.read(columns=["sample", "seed"])
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        if isinstance(error, MemoryError):
            raise
        return f"no file of rows ({' '.join(str(error).split())[:100]})"
    numbers, seeds = (numpy_column(own.column(name)) for name in ("sample", "seed"))
    first, last = samples[0], samples[-1]
    if not np.array_equal(numbers, np.array(samples)):
        return f"not the samples {first} to {last}"
    if not np.array_equal(seeds, sample_seeds(seed, samples)):
        return f"not the samples {first} to {last} of the seed {seed}"
    return ""


def _width(kind: pa.DataType) -> int:
    """Most bytes of one entry, twice what it takes; texts are sentences of an error."""
    import pyarrow as pa

    if pa.types.is_fixed_size_list(kind):
        return 12 * kind.list_size
    return _LONGEST_TEXT if pa.types.is_string(kind) else 24


class StoredColumns(Mapping[str, np.ndarray]):
    """Columns (N,) of a file by name, each read when it is asked for; the last `HELD` ones stay in memory."""

    def __init__(self, path: Any) -> None:
        import pyarrow.parquet as pq

        self.path, self.names = path, tuple(pq.read_schema(path).names)
        self._held: dict[str, np.ndarray] = {}

    def __getitem__(self, name: str) -> np.ndarray:
        """A column; do not write into it."""
        if name not in self.names:
            raise KeyError(name)
        found = self._held.pop(name, None)
        if found is None:
            found = numpy_column(read_columns(self.path, [name]).column(name))
        self._held[name] = found  # the last one is the youngest
        while len(self._held) > HELD:
            del self._held[next(iter(self._held))]
        return found

    def __iter__(self) -> Iterator[str]:
        """Names."""
        return iter(self.names)

    def __len__(self) -> int:
        """How many there are."""
        return len(self.names)


def numpy_column(column: Any) -> np.ndarray:
    """A column (N,), or (N, T) of lists; NaN for what is missing."""
    import pyarrow as pa

    whole = column.combine_chunks()
    if pa.types.is_fixed_size_list(whole.type):
        return whole.values.to_numpy(zero_copy_only=False).reshape(-1, whole.type.list_size)
    if pa.types.is_string(whole.type):
        coded = whole.dictionary_encode()  # a table has few texts: one object for each
        texts = np.array([*coded.dictionary.to_pylist(), None], dtype=object)
        return texts[coded.indices.fill_null(len(texts) - 1).to_numpy(zero_copy_only=False)]
    return np.array(whole.to_numpy(zero_copy_only=False))


def labelled(
    rows: Mapping[str, np.ndarray], columns: Sequence[Column], time: np.ndarray, settings: Mapping[str, str]
) -> xr.Dataset:
    """Rows as an xarray Dataset of dimension ``sample``, kept signals with ``kept`` runs and ``time`` (s) instead."""
    import xarray as xr

    variables, coordinates = {}, {"sample": rows["sample"]}
    for column in columns:
        values = rows[column.name]
        attributes = {"units": column.unit, "kind": column.kind}
        if column.kind == "trace":
            variables[column.name] = (("kept", "time"), values, attributes)
            coordinates |= {"time": ("time", time, {"units": "s"}), "kept": np.arange(len(values))}
        elif column.name != "sample":
            variables[column.name] = ("sample", values, attributes)
    return xr.Dataset(variables, coordinates, dict(settings))


# Files ----------------------------------------------------------------------------------------------------
def write_whole(path: Path, content: bytes, prefix: str | None = None) -> None:
    """Write a file under another name, force it to the disk, and rename it."""
    with part_file(path.parent, f".{path.name}." if prefix is None else prefix) as name:
        with open(name, "wb") as file:
            file.write(content)
        publish_whole(name, path)


def publish_whole(name: str, path: Path) -> None:
    """Force a file to the disk, and rename it, and force that as well."""
    with open(name, "rb") as file:
        os.fsync(file.fileno())
    mask = os.umask(0)
    os.umask(mask)
    os.chmod(name, 0o666 & ~mask)
    os.replace(name, path)
    if hasattr(os, "O_DIRECTORY"):
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextmanager
def disk_refusals(folder: Path) -> Iterator[None]:
    """Refusals of the disk in three parts."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        raise FlexhinfError(
            "The disk of the campaign is full." if full else "The campaign's folder cannot be written.",
            f"{folder}: {error.strerror or error}; every batch that was written before is whole and stays",
            "more room, and the same command: it goes on where it stopped",
        ) from error
