"""Rows of a campaign as columns of Parquet files."""

# pyarrow has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownParameterType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.validation import NotReadable, access_to

if TYPE_CHECKING:
    from pyarrow import Array, ChunkedArray, Schema, Table

    from flexhinf.campaign.batches import TableColumn

#: How the table is written, and a batch, of which nobody asks for statistics: the same rows have the same bytes. Random
#: numbers hardly get smaller: zstd would take 6 % less room, and twice as long to write and to read.
TABLE_FORMAT: dict[str, str | bool | list[str]] = {
    "compression": "lz4",
    "write_statistics": True,
    "use_dictionary": ["status", "failure"],
}
BATCH_FORMAT = TABLE_FORMAT | {"write_statistics": False, "use_dictionary": False}


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
    """Arrow schema of rows with these columns; kept signals are lists of so many numbers."""
    import pyarrow as pa

    own = {"sample": pa.int64(), "seed": pa.uint64(), "status": pa.string(), "failure": pa.string()}
    own |= {c.name: pa.list_(pa.float32(), instants) for c in columns if c.kind == "trace"}
    return pa.schema(
        pa.field(c.name, own.get(c.name, pa.float64()), metadata={"kind": c.kind, "unit": c.unit})
        for c in columns
    )


def arrow_array(values: np.ndarray) -> Array:
    """A column (N,), or (N, T) as lists, of Arrow; nothing stands where it is NaN."""
    import pyarrow as pa

    if values.ndim == 2:
        unknown, count = np.isnan(values), values.shape[1]
        if not unknown.any():
            return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), count)
        if unknown.all():
            return pa.nulls(len(values), pa.list_(pa.from_numpy_dtype(values.dtype), count))
        flat = pa.array(values.ravel(), mask=unknown.ravel())
        return pa.FixedSizeListArray.from_arrays(flat, count, mask=pa.array(unknown.all(axis=1)))
    if values.dtype == object:
        return pa.array(values.tolist(), pa.string())
    return pa.array(values, from_pandas=True)


def numpy_column(column: ChunkedArray) -> np.ndarray:
    """A column (N,), or (N, T) of lists; NaN for what is missing."""
    import pyarrow as pa

    whole = column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()
    if pa.types.is_fixed_size_list(whole.type):
        values = whole.values.slice(whole.offset * whole.type.list_size, len(whole) * whole.type.list_size)
        return values.to_numpy(zero_copy_only=False).reshape(-1, whole.type.list_size)
    if pa.types.is_string(whole.type):
        coded = whole.dictionary_encode()  # a table has few different texts; equal ones share one object
        texts = np.array([*coded.dictionary.to_pylist(), None], dtype=object)
        return texts[coded.indices.fill_null(len(texts) - 1).to_numpy(zero_copy_only=False)]
    return np.array(whole.to_numpy(zero_copy_only=False))
