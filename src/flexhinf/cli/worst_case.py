"""``--worst-case`` of ``flexhinf campaign``: what is searched, its progress, what is said of it, and its replay."""

from __future__ import annotations

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
    from flexhinf.design import DesignCampaign

#: What --metric calls the worst disturbance: √(∫|z|²/∫|d|²).
GAIN = "gain"

Stages = Callable[[], AbstractContextManager[Callable[[str], None]]]


@dataclass(frozen=True)
class WorstSearch:
    """What is asked for.

    Attributes
    ----------
    metrics : tuple of (str, bool)
        Each metric, and whether small values are the bad ones.
    gain : bool
        Whether the worst disturbance is searched for too.
    """

    metrics: tuple[tuple[str, bool], ...]
    starts: int
    gain: bool

    @staticmethod
    def of(
        wanted: bool,
        metrics: Sequence[str],
        starts: int,
        known: Sequence[str],
        requirements: Sequence[Requirement],
        gain: bool,
    ) -> WorstSearch | None:
        """None where nothing is asked for; `gain`: the disturbance is searched for where no metric is named.

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
        chosen = [known_metric(one, [*known, GAIN]) for one in metrics]
        chosen = chosen or [*(one.metric for one in requirements), *([GAIN] if gain else [])]
        least = {one.metric for one in requirements if not one.at_most}
        names = dict.fromkeys(name for name in chosen if name != GAIN)
        return WorstSearch(tuple((name, name in least) for name in names), starts, GAIN in chosen)


def search(
    campaign: Campaign, asked: DesignCampaign, table: MergedTable, wanted: WorstSearch, stages: Stages
) -> None:
    """The worst plant for each metric, and the worst disturbance; what is in the folder is not searched again."""
    from flexhinf.campaign import search_worst
    from flexhinf.design.campaign_gain import search_gain
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
        if wanted.gain:
            search_gain(asked, table.journal, stage)


def say_worst(table: MergedTable, requirements: Sequence[Requirement]) -> bool:
    """A line for each metric that was searched, with the command that runs it again; whether all keep their limits."""
    from flexhinf.campaign import stored_worsts
    from flexhinf.design.campaign_gain import stored_gains
    from flexhinf.design.report import gain_text, missed_by, replay_command, worst_text

    missed = False
    for case in stored_worsts(table.journal):
        typer.echo(worst_text(case))
        typer.echo(f"replay: {replay_command(table.journal.folder, f'--worst-case {case.metric}')}")
        missed |= bool(missed_by(case, requirements))
    found = stored_gains(table.journal)
    for row in found.rows:
        typer.echo(gain_text(row, table.journal.about.get("nominal", {})))
    if found.unproved:
        note(f"no γ is proved of this law: {found.unproved}")
    if found.rows:
        typer.echo(f"replay: {replay_command(table.journal.folder, f'--worst-case {GAIN}')}")
    return not missed


def replay_worst(folder: Path, metric: str, out: Path | None) -> Any:
    """The table of the worst plant of a metric, run again, alone; all its signals into a file."""
    from flexhinf.campaign import stored_worst
    from flexhinf.design import stored_campaign
    from flexhinf.design.report import worst_table

    if metric == GAIN:
        if out is not None:
            raise InvalidInput(
                "The worst disturbances are several runs.",
                "got --out",
                "disturbance.json in the campaign's folder",
            )
        return _replay_gain(folder)
    campaign, journal = stored_campaign(folder)
    case = stored_worst(journal, metric)
    if out is not None:
        case.run(campaign).save(out)
    again = case.again(campaign)
    if again != case.found:
        note("the numbers differ in their last bits: another kind of processor, or other versions, searched")
    return worst_table(case, again)


def _replay_gain(folder: Path) -> Any:
    """The worst disturbances, run again."""
    from flexhinf.design import stored_campaign
    from flexhinf.design.campaign_folder import stored_request
    from flexhinf.design.campaign_gain import GainSearch, stored_gains
    from flexhinf.design.report import gain_replay_table

    _, journal = stored_campaign(folder)
    rows = stored_gains(journal).rows
    if not rows:
        raise InvalidInput(
            "The worst disturbance was not searched in this campaign.",
            f"expected worst-case/disturbance.json, whole, in {folder}",
            f"the campaign's command with --worst-case --metric {GAIN}",
        )
    made = GainSearch.of(stored_request(journal), float(journal.settings["duration"]), lambda text: None)
    return gain_replay_table(rows, [made.again(row) for row in rows])
