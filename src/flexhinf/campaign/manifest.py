"""The manifest of a campaign: what its rows depend on, their columns, and what reports need, under one digest.

Files of a campaign's folder come from anywhere: whoever reads one refuses what no campaign writes, before any number
in it is believed.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flexhinf.campaign.batches import INSTANTS, OWN, PART, Campaign, check_counts
from flexhinf.campaign.draws import campaign_digest
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.validation import read_bytes, value_text

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
    """The entries of a file of at most so many bytes that `sealed` made.

    Raises
    ------
    OSError
        There is none that can be read.
    ValueError, RecursionError
        It is another one, or was changed.
    """
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
    """The manifest in a file.

    Raises
    ------
    OSError
        There is none that can be read.
    ValueError, RecursionError
        It is no manifest, one of another version, one that was changed, or says what none can say.
    """
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
    """Raise for entries that no campaign has."""
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
