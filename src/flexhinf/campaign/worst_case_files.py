"""What searches for the worst plant found, kept in the folder of their campaign: one file for each metric."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from flexhinf.campaign.batches import MOST_SAMPLES, Campaign, checked_integer
from flexhinf.campaign.journal import Journal
from flexhinf.campaign.manifest import UNREADABLE, read_sealed, sealed
from flexhinf.campaign.metrics import known_metric
from flexhinf.campaign.storage import disk_refusals, write_whole
from flexhinf.campaign.worst_case import STARTS, FoundPlant, WorstCase, search_settings, worst_case
from flexhinf.errors import InvalidInput

#: Folder of the files, inside a campaign's.
FOLDER = "worst-case"

_COUNTS = ("sample", "starts", "together", "runs", "outside")


def search_worst(
    campaign: Campaign,
    journal: Journal,
    metric: str,
    rows: Mapping[str, Any],
    *,
    least: bool = False,
    starts: int = STARTS,
    seed: int | None = None,
    nominal: Mapping[str, float] | None = None,
    progress: Callable[[int, float], None] = lambda runs, best: None,
) -> WorstCase:
    """`worst_case`, kept in the campaign's folder: taken from there where it was searched with the same options.

    The file is written whole when the search is done, so an interrupted search leaves nothing behind.

    Raises
    ------
    InvalidInput
        As `worst_case`; or another driver is at work.
    FlexhinfError
        If the disk is full.
    """
    seed = campaign.seed if seed is None else seed
    wanted = search_settings(campaign, metric, least, starts, seed)
    try:
        if (there := stored_worst(journal, metric)).settings == wanted:
            return there
    except InvalidInput:
        pass  # none, or damaged: it is searched
    found = worst_case(
        campaign, metric, rows, least=least, starts=starts, seed=seed, nominal=nominal, progress=progress
    )
    path = _path(journal, metric)
    with journal.driven(), disk_refusals(journal.folder):
        path.parent.mkdir(exist_ok=True)
        write_whole(path, sealed(_plain(asdict(found))))
    return found


def stored_worst(journal: Journal, metric: str) -> WorstCase:
    """What was found for a metric, from the campaign's folder.

    Raises
    ------
    InvalidInput
        If nothing was searched, or the file is damaged or of another campaign.
    """
    path = _path(journal, metric)
    try:
        found = _read(read_sealed(path))
        if found.settings["campaign"] != journal.manifest["digest"] or found.metric != metric:
            raise ValueError("it is of another campaign")
        return found
    except FileNotFoundError:
        known = [case.metric for case in stored_worsts(journal)]
        raise InvalidInput(
            f"The worst case of {metric!r} was not searched in this campaign.",
            f"expected one of {', '.join(known) or 'none'}",
            "the campaign's command with --worst-case --metric " + metric,
        ) from None
    except UNREADABLE as error:
        raise InvalidInput(
            f"The worst case of {metric!r} cannot be read.",
            f"{path}: {str(error)[:200]}",
            "the campaign's command with --worst-case, which searches again",
        ) from error


def stored_worsts(journal: Journal) -> list[WorstCase]:
    """Everything that was found and can be read, in the order of the metrics."""
    found = []
    for column in journal.columns:
        if column.judged and _path(journal, column.name).exists():
            try:
                found.append(stored_worst(journal, column.name))
            except InvalidInput:
                continue  # the command that searches says so and repairs it
    return found


def _path(journal: Journal, metric: str) -> Path:
    known_metric(metric, [column.name for column in journal.columns if column.judged])
    return journal.folder / FOLDER / f"{metric}.json"


def _plain(value: Any) -> Any:
    """Every digit of every number; those that JSON does not have as text."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, (list, tuple)) else value


def _read(stated: Mapping[str, Any]) -> WorstCase:
    """The inverse of `_plain`; one of `UNREADABLE` where it is not one."""
    given: dict[str, Any] = {one.name: stated[one.name] for one in fields(WorstCase)}

    def plant(one: Mapping[str, Any]) -> FoundPlant:
        return FoundPlant(
            {k: float(v) for k, v in one["numbers"].items()}, float(one["value"]), str(one["status"])
        )

    counts: dict[str, Any] = {
        name: checked_integer(name, given[name], 0, MOST_SAMPLES, "0") for name in _COUNTS
    }
    texts: dict[str, Any] = {name: str(given[name]) for name in ("metric", "unit")}
    return WorstCase(**given | counts | texts | {
        "sampled": plant(given["sampled"]), "found": plant(given["found"]), "nominal": plant(given["nominal"]),
        "alone": {name: float(value) for name, value in given["alone"].items()},
        "intervals": {name: (float(a), float(b)) for name, (a, b) in given["intervals"].items()},
        "units": {name: str(unit) for name, unit in given["units"].items()}, "settings": dict(given["settings"]),
    })  # fmt: skip
