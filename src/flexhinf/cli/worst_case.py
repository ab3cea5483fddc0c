"""``--worst-case`` of ``flexhinf campaign``: what is searched, its progress, what is said of it, and its replay."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from flexhinf.cli.messages import note
from flexhinf.errors import InvalidInput

if TYPE_CHECKING:
    from flexhinf.campaign import Campaign, MergedTable, Requirement

__all__ = ["WorstSearch", "replay_worst", "say_worst", "search"]

Stages = Callable[[], AbstractContextManager[Callable[[str], None]]]


@dataclass(frozen=True)
class WorstSearch:
    """What is asked for.

    Attributes
    ----------
    metrics : tuple of (str, bool)
        Each metric, and whether small values are the bad ones.
    starts : int
    """

    metrics: tuple[tuple[str, bool], ...]
    starts: int

    @staticmethod
    def of(
        wanted: bool,
        metrics: Sequence[str],
        starts: int,
        known: Sequence[str],
        requirements: Sequence[Requirement],
    ) -> WorstSearch | None:
        """None where nothing is asked for.

        Raises
        ------
        InvalidInput
            For an unknown metric, options of a search that is not asked for, or nothing to search.
        """
        from flexhinf.campaign import check_starts, known_metric

        if not wanted:
            if metrics:
                raise InvalidInput(
                    "A metric is searched only where the worst case is asked for.",
                    f"got --metric {metrics[0]} without --worst-case",
                    "--worst-case beside it",
                )
            return None
        check_starts(starts)
        names = tuple(
            dict.fromkeys(
                [known_metric(one, known) for one in metrics] or [one.metric for one in requirements]
            )
        )
        least = {one.metric for one in requirements if not one.at_most}
        return WorstSearch(tuple((name, name in least) for name in names), starts)


def search(campaign: Campaign, table: MergedTable, wanted: WorstSearch, stages: Stages) -> None:
    """The worst plant for each metric; what is in the folder already is not searched again."""
    from flexhinf.campaign import search_worst
    from flexhinf.design.report import metric_text

    nominal = table.journal.about.get("nominal", {})
    with stages() as stage:
        for metric, least in wanted.metrics:

            def progress(runs: int, best: float, metric: str = metric) -> None:
                stage(f"worst {metric_text(metric)}: {best:.4g} after {runs} runs")

            search_worst(
                campaign, table.journal, metric, table.columns,
                least=least, starts=wanted.starts, nominal=nominal, progress=progress,
            )  # fmt: skip


def say_worst(table: MergedTable, requirements: Sequence[Requirement]) -> bool:
    """A line for each metric that was searched, with the command that runs it again; whether all keep their limits."""
    from flexhinf.campaign import stored_worsts
    from flexhinf.design.report import missed_by, worst_text

    missed = False
    for case in stored_worsts(table.journal):
        typer.echo(worst_text(case))
        folder = shlex.quote(str(table.journal.folder))
        typer.echo(f"replay: flexhinf campaign replay {folder} --worst-case {case.metric}")
        missed |= bool(missed_by(case, requirements))
    return not missed


def replay_worst(folder: Path, metric: str, out: Path | None) -> Any:
    """The table of the worst plant of a metric, run again, alone; all its signals into a file."""
    from flexhinf.campaign import stored_worst
    from flexhinf.design import stored_campaign
    from flexhinf.design.report import worst_table

    campaign, journal = stored_campaign(folder)
    case = stored_worst(journal, metric)
    if out is not None:
        case.run(campaign).save(out)
    again = case.again(campaign)
    if again != case.found:
        note("the numbers differ in their last bits: another kind of processor, or other versions, searched")
    return worst_table(case, again)
