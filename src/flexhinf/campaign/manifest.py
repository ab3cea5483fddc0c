"""The manifest of a campaign, and what else stands in its folder as JSON: sealed with a digest of its entries."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from flexhinf.campaign.batches import INSTANTS, OWN, PART, check_counts
from flexhinf.campaign.draws import campaign_digest
from flexhinf.errors import FlexhinfError
from flexhinf.validation import read_bytes, value_text

#: Errors of a damaged file; FlexhinfError for a number out of range. NotReadable, which says nothing of it, is another.
UNREADABLE = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    OverflowError,
    RecursionError,
    FlexhinfError,
)

#: Format and version of a manifest, and the entry with the digest of all others. Since version 2 the digests cover the
#: whole manifest and the batch of each part.
KIND, _SEAL = {"what": "flexhinf campaign", "version": 2}, "sha256"

#: Largest size of a text file that is read, bytes.
MOST_BYTES = 10_000_000


def sealed(content: Mapping[str, Any]) -> bytes:
    """Content of a JSON file: an object, with the SHA-256 of all its entries beside them."""
    plain = json.loads(json.dumps(content))
    return (json.dumps({**plain, _SEAL: _digest(plain)}, indent=1) + "\n").encode()


def read_sealed(path: Path, most: int = MOST_BYTES, kind: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Read a file of at most `most` bytes that `sealed` made; a file of another `kind` is refused first."""
    stated = json.loads(read_bytes(path, most))
    if not isinstance(stated, dict):
        raise ValueError("it is no object of JSON")
    for name, value in (kind or {}).items():
        if type(stated.get(name)) is not type(value) or stated[name] != value:
            raise ValueError(f"expected {name} {value}, got {value_text(stated.get(name), 60)}")
    if stated.pop(_SEAL, None) != _digest(stated):
        raise ValueError("its entries are not those of its digest")
    return stated


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def check_manifest(stated: Mapping[str, Any]) -> None:
    """ValueError for entries that no campaign has."""
    settings, columns, time, about = (stated[name] for name in ("settings", "columns", "time_s", "about"))

    def texts(values: Any, kind: type = list) -> bool:
        several = values.values() if isinstance(values, dict) else values
        return isinstance(values, kind) and all(isinstance(text, str) for text in several)

    def numbers(values: Iterable[Any]) -> bool:
        return all(type(value) in (int, float) and math.isfinite(value) for value in values)

    names, kinds, _ = zip(*columns, strict=True)
    nominal = about.get("nominal", {})
    fine = {
        "settings": texts(settings, dict) and math.isfinite(float(settings["duration"])),
        "columns": isinstance(columns, list)
        and all(map(texts, columns))
        and set(OWN) <= set(names)
        and len(set(names)) == len(names)
        and set(kinds) <= {"own", "parameter", "metric", PART, "trace"},
        "time_s": isinstance(time, list) and 0 < len(time) <= INSTANTS and numbers(time),
        "command": texts(stated["command"]),
        "title": isinstance(about.get("title", ""), str),
        "requirements": texts(about.get("requirements", [])),
        "nominal numbers": isinstance(nominal, dict) and numbers(nominal.values()),
        "options": isinstance(about.get("options", {}), dict),
        "digest": stated["digest"] == campaign_digest(settings, columns, time),
    }
    if wrong := [name for name, good in fine.items() if not good]:
        raise ValueError(f"its {', '.join(wrong)} are none that a campaign has")
    check_counts(*(int(settings[name]) for name in ("samples", "seed", "batch")))
