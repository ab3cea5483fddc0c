"""Whether a file of rows is that of these samples: its columns, what was drawn, and how runs ended."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.campaign.batches import PART
from flexhinf.campaign.draws import sample_seeds
from flexhinf.campaign.metrics import COMPLETED, DIVERGED, NOT_RUN, UNSTABLE
from flexhinf.validation import value_text

if TYPE_CHECKING:
    import pyarrow as pa

#: Bytes of a file beyond its rows, and of one text, at most.
_SPARE, _LONGEST_TEXT = 1_000_000, 16_384

#: Relative distance of numbers that are drawn twice: kinds of processors differ in the last bits of a normal one.
_SAME = 1e-9


def wrong_rows(
    path: Path, schema: pa.Schema, samples: range, seed: int, draw: Callable[[], Mapping[str, np.ndarray]]
) -> str:
    """What is wrong with a file of the rows of these samples; empty where nothing is.

    Its columns, its metadata, the numbers of its samples and their seeds are those of the schema and of the campaign's
    seed, and it unpacks to no more than such rows take. Every run ended in a way that there is, what else its row
    holds fits that, and the numbers that `draw` gives are those of the rows.

    Parameters
    ----------
    draw : callable
        Gives what is drawn for these samples, (N,) by column; empty where that is not known.

    Raises
    ------
    MemoryError
        It does not fit into the memory that is free.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {field.name: field.metadata[b"kind"].decode() for field in schema}
    judged = [name for name, kind in kinds.items() if kind in ("metric", PART)]
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
            drawn = draw()
            kept = [name for name, kind in kinds.items() if kind == "own" or name in drawn]
            own = file.read(columns=kept)
            values = {name: numpy_column(own.column(name)) for name in kept}
            lost = ~np.isin(values["status"].astype(str), (COMPLETED, UNSTABLE))
            unread = file.read(columns=judged if lost.any() else [])
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        if isinstance(error, MemoryError):
            raise
        return f"no file of rows ({' '.join(str(error).split())[:100]})"
    first, last = samples[0], samples[-1]
    if not np.array_equal(values["sample"], np.array(samples)):
        return f"not the samples {first} to {last}"
    if not np.array_equal(values["seed"], sample_seeds(seed, samples)):
        return f"not the samples {first} to {last} of the seed {seed}"
    if wrong := _wrong_ends(values):
        return wrong
    for name in unread.column_names:
        if not np.isnan(numpy_column(unread.column(name))[lost]).all():
            return f"of runs without an end that have the metric {name}"
    for name, numbers in drawn.items():
        near = np.abs(values[name] - numbers) <= _SAME * np.abs(numbers)
        if not near.all():
            at = int(np.argmin(near))
            return f"not what is drawn: {name} of sample {samples[at]} is {values[name][at]:g}, not {numbers[at]:g}"
    return ""


def _wrong_ends(values: Mapping[str, np.ndarray]) -> str:
    """What is wrong with how runs ended; empty where nothing is.

    Only a run that diverged has an instant of it, and only one that was not run has a reason.
    """
    status, failure, at = (values[name] for name in ("status", "failure", "diverged_at_s"))
    strange = [one for one in set(status) if one not in (COMPLETED, UNSTABLE, DIVERGED, NOT_RUN)]
    if strange:
        return f"of a status that no run has: {value_text(strange[0])}"
    if None in set(failure):
        return "without the column failure in each row"
    if not np.array_equal(failure != "", status == NOT_RUN):
        return "of runs with a failure, or without one, that does not fit their status"
    if not np.array_equal(~np.isnan(at), status == DIVERGED):
        return "of runs with an instant of divergence, or without one, that does not fit their status"
    return ""


def _width(kind: pa.DataType) -> int:
    """Most bytes of one entry, twice what it takes; texts are sentences of an error."""
    import pyarrow as pa

    if pa.types.is_fixed_size_list(kind):
        return 12 * kind.list_size
    return _LONGEST_TEXT if pa.types.is_string(kind) else 24


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
