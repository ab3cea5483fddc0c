"""The files of a campaign as they are read: its manifest under one digest, and whether a file has the right rows.

Files of a campaign's folder come from anywhere: whoever reads one refuses what no campaign writes, before any number
in it is believed. The manifest has what the rows depend on, their columns, and information for reports.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.campaign.batches import INSTANTS, OWN, PART, Campaign, check_counts
from flexhinf.campaign.draws import campaign_digest, sample_seeds
from flexhinf.campaign.metrics import COMPLETED, DIVERGED, NOT_RUN, UNSTABLE
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.validation import read_bytes, value_text

if TYPE_CHECKING:
    import pyarrow as pa

#: Of the files: 2 binds columns, instants and everything else that a manifest says, and the batch of each part.
VERSION = 2

#: What reading a file raises that is not what was written; FlexhinfError where a number is out of range.
UNREADABLE = (
    OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError, FlexhinfError,
)  # fmt: skip

_WHAT, _SEAL = "flexhinf campaign", "sha256"

#: Bytes of the largest file, of text, that is read.
MOST_BYTES = 10_000_000

_KINDS = ("own", "parameter", "metric", PART, "trace")


def sealed(content: Mapping[str, Any]) -> bytes:
    """A JSON file of an object, with the SHA-256 of all its entries beside them."""
    plain = json.loads(json.dumps(content))
    return (json.dumps({**plain, _SEAL: _digest(plain)}, indent=1) + "\n").encode()


def read_sealed(path: Path, most: int = MOST_BYTES) -> dict[str, Any]:
    """The entries of a file of at most so many bytes that `sealed` made."""
    stated = json.loads(read_bytes(path, most))
    if not isinstance(stated, dict):
        raise ValueError("it is no object of JSON")
    digest = stated.pop(_SEAL, None)
    if digest != _digest(stated):
        raise ValueError("its entries are not those of its digest")
    return stated


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def made_manifest(campaign: Campaign, command: Sequence[str], about: Mapping[str, Any]) -> dict[str, Any]:
    """What `read_manifest` gives back."""
    return {
        "what": _WHAT, "version": VERSION, "digest": campaign.digest, "command": list(command),
        "settings": campaign.settings, "about": dict(about),
        "columns": [[column.name, column.kind, column.unit] for column in campaign.columns],
        "time_s": campaign.time.tolist(),
    }  # fmt: skip


def read_manifest(path: Path) -> dict[str, Any]:
    """The manifest in a file."""
    try:
        stated = read_sealed(path)
    except ValueError:
        _check_kind(json.loads(read_bytes(path, MOST_BYTES)))  # a file of another version says so
        raise
    _check_kind(stated)
    try:
        _check_entries(stated)
    except (KeyError, TypeError, OverflowError) as error:
        raise ValueError(f"an entry is missing, or is of another kind: {error}") from None
    except InvalidInput as error:
        raise ValueError(error.found) from None
    return stated


def _check_kind(stated: Any) -> None:
    if not isinstance(stated, dict) or stated.get("what") != _WHAT:
        raise ValueError("it is not a campaign's")
    if type(stated.get("version")) is not int or stated["version"] != VERSION:
        raise ValueError(f"expected version {VERSION}, got {value_text(stated.get('version'), 60)}")


def _check_entries(stated: Mapping[str, Any]) -> None:
    settings, columns, time = stated["settings"], stated["columns"], stated["time_s"]
    _check("settings", isinstance(settings, dict) and _texts(settings.values()))
    check_counts(*(int(settings[name]) for name in ("samples", "seed", "batch")))
    _check("duration", math.isfinite(float(settings["duration"])))
    _check("columns", isinstance(columns, list) and all(len(one) == 3 and _texts(one) for one in columns))
    names = [name for name, _, _ in columns]
    kinds = {kind for _, kind, _ in columns}
    _check("columns", set(OWN) <= set(names) and len(set(names)) == len(names) and kinds <= set(_KINDS))
    _check("time_s", isinstance(time, list) and 0 < len(time) <= INSTANTS and all(map(_is_number, time)))
    _check("digest", stated["digest"] == campaign_digest(settings, columns, time))
    about = stated["about"]
    _check("command", isinstance(stated["command"], list) and _texts(stated["command"]))
    _check("about", isinstance(about, dict) and isinstance(about.get("title", ""), str))
    _check("requirements", isinstance(asked := about.get("requirements", []), list) and _texts(asked))
    nominal = about.get("nominal", {})
    _check("nominal numbers", isinstance(nominal, dict) and all(map(_is_number, nominal.values())))
    _check("options", isinstance(about.get("options", {}), dict))


def _check(what: str, fine: bool) -> None:
    if not fine:
        raise ValueError(f"its {what} are none that a campaign has")


def _texts(values: Any) -> bool:
    return all(isinstance(one, str) for one in values)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


#: Bytes of a file beyond its rows, and of one text, at most.
_SPARE, _LONGEST_TEXT = 1_000_000, 16_384

#: Relative distance of numbers that are drawn twice: kinds of processors differ in the last bits of a normal one.
_SAME = 1e-9


def wrong_rows(
    path: Path, schema: pa.Schema, samples: range, seed: int, draw: Callable[[], Mapping[str, np.ndarray]]
) -> str:
    """What is wrong with a file of the rows of these samples; empty where nothing is.

    Its columns, its metadata, the numbers of its samples and their seeds are those of the schema and of the
    campaign's seed, and it unpacks to no more than such rows take. Every run ended in a way that there is, what
    else its row holds fits that, and the numbers that `draw` gives are those of the rows.

    `draw`: gives what is drawn for these samples, (N,) by column; empty where that is not known.
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
            lists = [one.type.list_size for one in schema if pa.types.is_fixed_size_list(one.type)]
            texts = sum(pa.types.is_string(one.type) for one in schema)
            others = len(schema) - len(lists) - texts
            # most bytes of one row, twice what it takes; texts are sentences of an error
            if unpacked > _SPARE + rows * (12 * sum(lists) + _LONGEST_TEXT * texts + 24 * others):
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
    status, failure, at = (values[name] for name in ("status", "failure", "diverged_at_s"))
    strange = [one for one in set(status) if one not in (COMPLETED, UNSTABLE, DIVERGED, NOT_RUN)]
    if strange:
        return f"of a status that no run has: {value_text(strange[0])}"
    if None in set(failure):
        return "without the column failure in each row"
    if not np.array_equal(failure != "", status == NOT_RUN):  # only what was not run has a reason
        return "of runs with a failure, or without one, that does not fit their status"
    if not np.array_equal(~np.isnan(at), status == DIVERGED):
        return "of runs with an instant of divergence, or without one, that does not fit their status"
    for name in unread.column_names:
        if not np.isnan(numpy_column(unread.column(name))[lost]).all():
            return f"of runs without an end that have the metric {name}"
    for name, numbers in drawn.items():
        near = np.abs(values[name] - numbers) <= _SAME * np.abs(numbers)
        if not near.all():
            at = int(np.argmin(near))
            return f"not what is drawn: {name} of sample {samples[at]} is {values[name][at]:g}, not {numbers[at]:g}"
    return ""


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
