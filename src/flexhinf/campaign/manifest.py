"""The manifest of a campaign, and what else stands in its folder as JSON: sealed with a digest of its entries."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias, TypedDict, TypeGuard, cast

from flexhinf.campaign.batches import INSTANTS, OWN, PART, check_counts
from flexhinf.campaign.draws import campaign_digest
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
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


#: What a file of JSON holds.
Json: TypeAlias = bool | float | str | Sequence["Json"] | Mapping[str, "Json"] | None


class CampaignFacts(TypedDict, total=False):
    """What a campaign says of itself beside its settings, for reports and replays."""

    title: str
    requirements: list[str]
    nominal: dict[str, float]  # numbers of the nominal plant
    options: dict[str, Json]  # of the campaign of a design
    design: dict[str, Json] | None  # its verdict


class Manifest(TypedDict):
    """Entries of a campaign's manifest, beside those of its kind."""

    digest: str
    command: list[str]
    settings: dict[str, str]
    about: CampaignFacts
    columns: list[list[str]]  # name, kind and unit of each
    time_s: list[float]


def sealed(content: Mapping[str, object]) -> bytes:
    """Content of a JSON file: an object, with the SHA-256 of all its entries beside them."""
    plain = json.loads(json.dumps(content))
    return (json.dumps({**plain, _SEAL: _digest(plain)}, indent=1) + "\n").encode()


def read_sealed(
    path: Path, most: int = MOST_BYTES, kind: Mapping[str, Json] | None = None
) -> dict[str, Json]:
    """Read a file of at most `most` bytes that `sealed` made; a file of another `kind` is refused first."""
    stated: Json = json.loads(read_bytes(path, most))
    if not isinstance(stated, dict):
        raise ValueError("it is no object of JSON")
    for name, value in (kind or {}).items():
        if type(stated.get(name)) is not type(value) or stated[name] != value:
            raise ValueError(f"expected {name} {value}, got {value_text(stated.get(name), 60)}")
    if stated.pop(_SEAL, None) != _digest(stated):
        raise ValueError("its entries are not those of its digest")
    return stated


def _digest(content: Mapping[str, Json]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_manifest(path: Path) -> Manifest:
    """Read a manifest; ValueError for entries that no campaign has, and what else `UNREADABLE` names."""
    stated = read_sealed(path, kind=KIND)
    settings, columns, time, about = (stated[name] for name in ("settings", "columns", "time_s", "about"))
    if not isinstance(about, dict):
        raise ValueError("its about is none that a campaign has")
    nominal = about.get("nominal", {})
    fine = {
        "settings": _is_table(settings) and math.isfinite(float(settings["duration"])),
        "columns": _is_columns(columns),
        "time_s": _is_list(time) and 0 < len(time) <= INSTANTS and all(map(_is_number, time)),
        "command": _are_texts(stated["command"]),
        "title": isinstance(about.get("title", ""), str),
        "requirements": _are_texts(about.get("requirements", [])),
        "nominal numbers": isinstance(nominal, dict) and all(map(_is_number, nominal.values())),
        "options": isinstance(about.get("options", {}), dict),
    }
    if wrong := [name for name, good in fine.items() if not good]:
        raise ValueError(f"its {', '.join(wrong)} are none that a campaign has")
    manifest = cast("Manifest", stated)  # what was just checked
    numbers = manifest["settings"], manifest["columns"], manifest["time_s"]
    if manifest["digest"] != campaign_digest(*numbers):
        raise ValueError("its digest is none that a campaign has")
    check_counts(*(int(manifest["settings"][name]) for name in ("samples", "seed", "batch")))
    return manifest


def _is_number(value: Json) -> bool:
    return type(value) in (int, float) and math.isfinite(cast("float", value))


def _is_list(values: Json) -> TypeGuard[list[Json]]:
    return isinstance(values, list)


def _are_texts(values: Json) -> TypeGuard[list[str]]:
    return _is_list(values) and all(isinstance(text, str) for text in values)


def _is_table(values: Json) -> TypeGuard[dict[str, str]]:
    return isinstance(values, dict) and all(isinstance(text, str) for text in values.values())


def _is_columns(values: Json) -> bool:
    if not (_is_list(values) and all(map(_are_texts, values))):
        return False
    names, kinds, _ = zip(*cast("list[list[str]]", values), strict=True)
    known = {"own", "parameter", "metric", PART, "trace"}
    return set(OWN) <= set(names) and len(set(names)) == len(names) and set(kinds) <= known


def differing(
    a: Mapping[str, str], b: Mapping[str, str], names: Iterable[str], missing: str = "not stated"
) -> list[tuple[str, str, str]]:
    """Settings of these names that differ: name, value in `a`, value in `b`."""
    pairs = [(name, a.get(name, missing), b.get(name, missing)) for name in dict.fromkeys(names)]
    return [pair for pair in pairs if pair[1] != pair[2]]


def listed(texts: Sequence[str], most: int = 6) -> str:
    """The first `most` texts in one line, and how many more there are."""
    return "; ".join([*texts[:most], *([f"{len(texts) - most} more"] if len(texts) > most else [])])


def check_own_folder(place: Path, what: str, names: Sequence[str]) -> None:
    """Refuse a path that is a file or below a file, or a folder that contains other names than these and hidden
    ones."""
    nearest = next(path for path in (place, *place.parents) if path.exists())
    refuse_if(
        not nearest.is_dir(),
        f"A {what} needs a folder, and there is a file.",
        f"got {nearest}",
        "another name",
    )
    there = [path.name for path in place.iterdir()] if place.is_dir() else []
    if strangers := sorted(name for name in there if name[:1] != "." and name not in names):
        raise InvalidInput(
            f"The folder holds something that is not a {what}, and is left alone.",
            f"expected no folder, an empty one, or one with {', '.join(names)}; got {strangers[:3]} in {place}",
            "another folder",
        ) from None
