"""``flexhinf campaign``: many robots with the controller of one design, or two designs on the same robots.

What was run before is kept. ``--worst-case`` searches the worst robot within the tolerances.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperGroup

from flexhinf.cli.arguments import design_file_of, read_source, reproduce_command, with_options
from flexhinf.cli.messages import NOT_MET, note, progress_bar
from flexhinf.cli.options import (
    BatchOptions,
    CompareCampaignsOptions,
    MergeOptions,
    ReplayOptions,
    RunCampaignOptions,
)
from flexhinf.errors import InvalidInput

if TYPE_CHECKING:
    from flexhinf.campaign import Campaign, FoundPlant, Journal, MergedTable, Requirement, WorstCase
    from flexhinf.campaign.driver import Executor, Report
    from flexhinf.design import CampaignOptions, DesignCampaign, DesignPair

#: Seconds between two lines of progress where standard error is no terminal.
EVERY = 10.0


class _Runs(TyperGroup):
    """A group whose first word is a command or, without one, the design that is run."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] not in ("--help", "-h"):
            args = ["run", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_Runs,
    help="Run a design on thousands of robots within their tolerances, and go on after every interruption.",
)


@app.command("run", epilog="Example: flexhinf campaign design.toml --samples 10000 --out campaign")
@with_options(RunCampaignOptions)
def run(context: typer.Context, o: RunCampaignOptions) -> None:
    """Run a design's step or move on many robots within their tolerances, each with its own noise.

    The folder is a journal: Ctrl-C, SIGKILL and a full disk lose at most the
    batch in flight, and the same command goes on. Sample i is the same for any
    batches, workers, shards and interruptions. At the end stand samples.parquet,
    one row for each robot, and index.html.

    Exit code: 0 if every sample is a success, and the worst robot found; 1 if not; 2 for a mistake; 130 if
    interrupted.
    """
    from flexhinf.campaign import Requirement, Shard, drive
    from flexhinf.design import DesignCampaign, open_campaign
    from flexhinf.design.campaign_gain import searches_gain

    part = Shard.read(o.shard) if o.shard else Shard()
    request = read_source(o.design, o.elastic, {}).request
    asked = DesignCampaign(request, _campaign_options(o), design_file_of(o.design))
    executor = chosen_executor(o.workers, o.cluster)
    checked = [Requirement.of(text, list(asked.metrics.units)) for text in o.require or asked.requirements]
    gain = o.worst_case and searches_gain(asked)
    wanted = WorstSearch.of(o.worst_case, o.metric, o.starts, list(asked.metrics.units), checked, gain)
    with design_stages() as stage:
        campaign, journal = open_campaign(asked, o.out, _words(context), stage)
    try:
        with sample_progress(part.name) as progress:
            table = drive(campaign, journal, shard=part, executor=executor, progress=progress)
    except KeyboardInterrupt:
        done = sum(map(journal.size, journal.shards()[0]))
        note(f"{done} of {journal.samples} samples are in {o.out}; the same command goes on from there.")
        raise
    if table is None:
        left = journal.batches - len(journal.shards()[0])
        typer.echo(
            f"shard {o.shard} is done; {left} of {journal.batches} batches are still to be run elsewhere."
        )
        typer.echo(f"then:  flexhinf campaign merge {o.out}")
        if wanted is not None:
            note("the worst case is searched when all shards are there, by the same command without --shard")
        return
    if wanted is not None:
        search(campaign, asked, table, wanted)
    _finish(table, checked)


def chosen_executor(workers: int, cluster: str) -> Executor | None:
    """What runs the batches; None: this process."""
    from flexhinf.campaign import in_cluster, in_processes

    if workers and cluster:
        raise InvalidInput(
            "Batches run in processes here or on a cluster.", "got --workers and --cluster", "one of both"
        )
    if cluster:
        return in_cluster(cluster)
    return in_processes(workers, note) if workers else None


@app.command("merge")
@with_options(MergeOptions)
def merge(context: typer.Context, o: MergeOptions) -> None:
    """Write the table and the report of a campaign whose shards are done.

    Shards of other folders are copied into the first one. Every file is
    checked, byte for byte; what is missing or damaged is named.
    """
    from flexhinf.campaign import merged

    journal = _journal(o.folder)
    checked = _requirements(journal, o.require)
    with journal.driven():
        for other in o.others:
            typer.echo(f"{journal.take(_journal(other))} batches from {other}")
        good, bad = journal.shards()
        for path, wrong in bad:
            note(f"{path.name} is {wrong}; the campaign's command runs it again")
        table = merged(journal, good)
    _finish(table, checked)


@app.command("replay", epilog="Example: flexhinf campaign replay campaign --sample 123")
@with_options(ReplayOptions)
def replay(context: typer.Context, o: ReplayOptions) -> None:
    """Run one sample of a campaign again, or the worst robot, alone, and say whether the metrics are the same bits."""
    from flexhinf.campaign import replayed
    from flexhinf.design import stored_campaign
    from flexhinf.pages import replay_table

    if (o.sample is None) == (not o.worst_case):
        raise InvalidInput(
            "One run is replayed at a time.",
            f"expected --sample or --worst-case, got {'neither' if o.sample is None else 'both'}",
            "--sample 0",
        )
    if o.sample is None:
        return _print(replay_worst(o.folder, o.worst_case, o.out))
    campaign, journal = stored_campaign(o.folder)
    found = replayed(campaign, journal, o.sample)
    if o.out is not None:
        found.run.save(o.out)
    _print(replay_table(found))
    if not found.same:
        note(
            "the numbers differ in their last bits: another kind of processor, or other versions, made the table"
        )


def _print(table: Any) -> None:
    from rich.console import Console

    Console().print(table)


def _journal(folder: Path) -> Journal:
    from flexhinf.campaign import Journal

    journal = Journal.read(folder)
    if journal is None:
        raise InvalidInput(
            "There is no campaign.", f"expected its folder, got {folder}", "the --out of its command"
        )
    return journal


def _campaign_options(o: BatchOptions) -> CampaignOptions:
    from flexhinf.design import CampaignOptions

    values: dict[str, Any] = {field.name: getattr(o, field.name) for field in fields(CampaignOptions)}
    values["tolerances"] = tuple(map(named_tolerance, o.tolerance))
    return CampaignOptions(**values)


def _words(context: typer.Context) -> list[str]:
    return [word for k, word in enumerate(reproduce_command(context)) if (k, word) != (2, "run")]


def named_tolerance(text: str) -> tuple[str, str]:
    """Read ``stiffness=15%``: the parameter, and its spread as it stands; refused without a name."""
    name, equals, value = text.partition("=")
    if not equals:
        raise InvalidInput(
            "The tolerance names no parameter.", f"expected NAME=x, got {text!r}", "--tolerance stiffness=15%"
        )
    return name.strip(), value.strip()


def _requirements(journal: Journal, given: list[str]) -> list[Any]:
    from flexhinf.campaign import Requirement

    metrics = [column.name for column in journal.columns if column.judged]
    return [Requirement.of(text, metrics) for text in given or journal.about.get("requirements", [])]


def _finish(table: MergedTable, requirements: list[Any]) -> None:
    from flexhinf.design import stored_campaign
    from flexhinf.pages import campaign_verdict, replay_command, write_campaign

    def run(sample: int) -> Any:
        return stored_campaign(table.journal.folder)[0].replay(sample)

    def plant_run(case: WorstCase, plant: FoundPlant) -> Any:
        return case.run(stored_campaign(table.journal.folder)[0], plant)

    judged = write_campaign(table, requirements, run, plant_run)
    typer.echo(campaign_verdict(judged))
    kept = say_worst(table, requirements)
    typer.echo(f"table:  {table.journal.folder / 'samples.parquet'}")
    typer.echo(f"report: {table.journal.folder / 'index.html'}")
    if judged.worst_of_all is not None:
        typer.echo(f"replay: {replay_command(table.journal.folder, f'--sample {judged.worst_of_all}')}")
    if judged.failures or not kept:
        raise typer.Exit(NOT_MET)


# Two designs --------------------------------------------------------------------------------------------------
@app.command("compare", epilog="Example: flexhinf campaign compare linear.toml cubic.toml --samples 2000")
@with_options(CompareCampaignsOptions)
def compare(context: typer.Context, o: CompareCampaignsOptions) -> None:
    """Run two designs on the same robots, and compare them pair by pair.

    Both get the same numbers, noise, initial errors and disturbances; robot,
    sensors, motors and step must be the same, and weights, preset, degree, γ and
    estimator may differ. The folders a and b are campaigns with journals of
    their own: the same command goes on after every interruption. index.html says
    which design fails where the other does not, and by how much they differ.

    Exit code: 0 when the report is written, whichever is better; 2 for a
    mistake; 130 if interrupted.
    """
    from flexhinf.campaign import Requirement, Shard, drive
    from flexhinf.design import DesignCampaign, DesignPair, open_pair

    part = Shard.read(o.shard) if o.shard else Shard()
    executor = chosen_executor(o.workers, o.cluster)
    options = _campaign_options(o)

    def asked(source: str) -> DesignCampaign:
        return DesignCampaign(read_source(source, o.elastic, {}).request, options, design_file_of(source))

    pair = DesignPair(asked(o.first), asked(o.second))
    checked = [Requirement.of(text, list(pair.a.metrics.units)) for text in o.require or pair.requirements]
    words = reproduce_command(context)
    with design_stages() as stage:
        opened = open_pair(pair, o.out, (words, words), stage)
    tables = []
    for name, (campaign, journal) in zip("AB", opened):
        with sample_progress(f"{name} {part.name}".strip()) as progress:
            tables.append(drive(campaign, journal, shard=part, executor=executor, progress=progress))
    done = [table for table in tables if table is not None]
    if len(done) < 2:
        typer.echo(f"shard {o.shard} is done; others are still to be run.")
        typer.echo("then: the same command without --shard")
        return
    _finish_pair(pair, o, words, done, checked)


def _finish_pair(
    pair: DesignPair,
    o: CompareCampaignsOptions,
    words: list[str],
    tables: list[MergedTable],
    requirements: list[Requirement],
) -> None:
    from rich.console import Console

    from flexhinf.campaign import compare
    from flexhinf.design import PairResult, stored_campaign
    from flexhinf.pages import pair_table, pair_verdict, write_campaign, write_pair

    def judged(table: MergedTable) -> Any:
        folder = table.journal.folder
        return write_campaign(table, requirements, lambda sample: stored_campaign(folder)[0].replay(sample))

    names = o.first, o.second
    both = judged(tables[0]), judged(tables[1])
    paired = compare(tables[0], tables[1], [one.text() for one in requirements])
    result = PairResult(pair, o.out.expanduser().absolute(), names, both, paired, tuple(words))
    path = write_pair(result)
    Console().print(pair_table(result))
    for name, source in zip("AB", names):
        typer.echo(f"{name}: {source}")
    if not pair.differences:
        note("the specifications do not differ")
    typer.echo(pair_verdict(result))
    typer.echo(f"report: {path}")


# Progress -----------------------------------------------------------------------------------------------------
@contextmanager
def design_stages() -> Iterator[Callable[[str], None]]:
    """A line for what comes next while the controller is designed; silent where it is no terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda text: None
        return
    with console.status("design") as status:
        yield lambda text: status.update(text.replace("[", r"\["))


@contextmanager
def sample_progress(part: str) -> Iterator[Callable[[Report], None]]:
    """Samples, rate and time left: a bar, or a line every `EVERY` seconds where standard error is no terminal."""
    from rich.console import Console

    terminal = Console(stderr=True).is_terminal
    bar = progress_bar("Bar", "MofNComplete", disable=not terminal)
    task = bar.add_task("")
    begun, told = time.monotonic(), time.monotonic()

    def progress(report: Report) -> None:
        nonlocal told
        if report.note:
            note(report.note)
        text = _rate(report, time.monotonic() - begun)
        bar.update(task, total=report.total, completed=report.done, description=text)
        if not terminal and report.fresh and time.monotonic() - told >= EVERY:
            told = time.monotonic()
            sys.stderr.write(
                f"{part + ': ' if part else ''}{report.done} of {report.total} samples, {text}\n"
            )

    with bar:
        yield progress


def _rate(report: Report, seconds: float) -> str:
    if not report.fresh or seconds <= 0.0:
        return ""
    rate = report.fresh / seconds
    left = (report.total - report.done) / rate
    shown = f"{left:.0f} s" if left < 120.0 else f"{left / 60.0:.0f} min"
    shown = shown if left < 7200.0 else f"{left / 3600.0:.1f} h"
    return f"{rate:.3g} samples/s, {shown} left"


#: What --metric calls the worst disturbance: √(∫|z|²/∫|d|²).
GAIN = "gain"


@dataclass(frozen=True)
class WorstSearch:
    """What is asked for."""

    metrics: tuple[tuple[str, bool], ...]  # Each metric, and whether small values are the bad ones
    starts: int
    gain: bool  # Whether the worst disturbance is searched for too

    @staticmethod
    def of(
        wanted: bool,
        metrics: Sequence[str],
        starts: int,
        known: Sequence[str],
        requirements: Sequence[Requirement],
        gain: bool,
    ) -> WorstSearch | None:
        """None where nothing is asked for; `gain`: the disturbance is searched for where no metric is named."""
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


def search(campaign: Campaign, asked: DesignCampaign, table: MergedTable, wanted: WorstSearch) -> None:
    """The worst plant for each metric, and the worst disturbance; what is in the folder is not searched again."""
    from flexhinf.campaign import search_worst
    from flexhinf.design.campaign_gain import search_gain
    from flexhinf.pages import metric_text

    nominal = table.journal.about.get("nominal", {})
    with design_stages() as stage:
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
    from flexhinf.pages import gain_text, missed_by, replay_command, worst_text

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
    from flexhinf.pages import worst_table

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
    from flexhinf.design import stored_campaign
    from flexhinf.design.campaign_folder import stored_request
    from flexhinf.design.campaign_gain import GainSearch, stored_gains
    from flexhinf.pages import gain_replay_table

    _, journal = stored_campaign(folder)
    rows = stored_gains(journal).rows
    if not rows:
        raise InvalidInput(
            "The worst disturbance was not searched in this campaign.",
            f"expected worst-case/disturbance.json, whole, in {folder}",
            f"the campaign's command with --worst-case --metric {GAIN}",
        )
    made = GainSearch(stored_request(journal), float(journal.settings["duration"]))
    return gain_replay_table(rows, [made.again(row) for row in rows])
