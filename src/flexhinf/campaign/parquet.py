"""Rows of a campaign as columns of Parquet files."""

# pyarrow has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownParameterType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.validation import NotReadable, access_to

if TYPE_CHECKING:
    from pyarrow import Array, ChunkedArray, Schema, Table

    from flexhinf.campaign.batches import TableColumn

#: Numbers of a kept signal.
SIGNAL = np.dtype("<f4")

#: How the table is written: the same rows have the same bytes. Random numbers hardly get smaller: zstd would take 6 %
#: less room, and twice as long to write and to read. A kept signal is one value of bytes: a list of numbers would take
#: twice as long to write, and five times as long to read.
TABLE_FORMAT: Mapping[str, object] = {
    "compression": "lz4",
    "write_statistics": True,
    "use_dictionary": ["status", "failure"],
}


def batch_format(schema: Schema) -> Mapping[str, object]:
    """How a batch is written, of which nobody asks for statistics; signals with noise get no smaller."""
    from pyarrow import types

    signals = {entry.name for entry in schema if types.is_fixed_size_binary(entry.type)}
    packed = {name: "none" if name in signals else "lz4" for name in schema.names}
    return {**TABLE_FORMAT, "write_statistics": False, "use_dictionary": False, "compression": packed}


def read_columns(path: Path, names: Sequence[str] | None = None) -> Table:
    """Columns of a file as an Arrow table, all by default; InvalidInput if it cannot be read."""
    from pyarrow import ArrowException, parquet

    try:
        with access_to(path), parquet.ParquetFile(path) as file:
            # Arrow's own threads cost more than they save: a batch is small
            return file.read(columns=None if names is None else list(names), use_threads=False)
    except (MemoryError, NotReadable):  # an exception of Arrow is one of MemoryError too
        raise
    except (OSError, ValueError, KeyError, ArrowException) as error:
        raise InvalidInput(
            "A file of the campaign cannot be read.",
            f"{path}: {str(error)[:200]}",
            "the campaign's command again, which checks each file and runs the samples of a damaged one again",
        ) from error


def row_schema(columns: Sequence[TableColumn], instants: int) -> Schema:
    """Arrow schema of rows with these columns; kept signals are the bytes of so many numbers of 32 bits."""
    import pyarrow as pa

    own = {"sample": pa.int64(), "seed": pa.uint64(), "status": pa.string(), "failure": pa.string()}
    own |= {c.name: pa.binary(SIGNAL.itemsize * instants) for c in columns if c.kind == "trace"}
    return pa.schema(
        pa.field(c.name, own.get(c.name, pa.float64()), metadata={"kind": c.kind, "unit": c.unit})
        for c in columns
    )


def arrow_array(values: np.ndarray) -> Array:
    """A column (N,), or (N, T) as bytes, of Arrow; nothing stands where it is NaN, or all of a row is."""
    import pyarrow as pa

    if values.ndim == 2:
        unknown, there = np.isnan(values), None
        if unknown.any():
            values = np.where(unknown, SIGNAL.type(np.nan), values)  # processors differ in the bits of a NaN
            there = pa.array(~unknown.all(axis=1)).buffers()[1]
        content = pa.py_buffer(np.ascontiguousarray(values, SIGNAL))
        return pa.Array.from_buffers(
            pa.binary(SIGNAL.itemsize * values.shape[1]), len(values), [there, content]
        )
    if values.dtype == object:
        return pa.array(values.tolist(), pa.string())
    return pa.array(values, from_pandas=True)


def numpy_column(column: ChunkedArray) -> np.ndarray:
    """A column (N,), or (N, T) of bytes; NaN for what is missing."""
    import pyarrow as pa

    whole = column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()
    if pa.types.is_fixed_size_binary(whole.type):
        width, values = whole.type.byte_width // SIGNAL.itemsize, whole.buffers()[1]
        if whole.null_count == len(whole):
            return np.full((len(whole), width), np.nan, SIGNAL)
        rows = np.frombuffer(values, SIGNAL).reshape(-1, width)[whole.offset : whole.offset + len(whole)]
        there = whole.is_valid().to_numpy(zero_copy_only=False)
        return np.where(there[:, None], rows, SIGNAL.type(np.nan)) if whole.null_count else rows
    if pa.types.is_string(whole.type):
        coded = whole.dictionary_encode()  # a table has few different texts; equal ones share one object
        texts = np.array([*coded.dictionary.to_pylist(), None], dtype=object)
        return texts[coded.indices.fill_null(len(texts) - 1).to_numpy(zero_copy_only=False)]
    return np.array(whole.to_numpy(zero_copy_only=False))
