"""``flexhinf campaign``: many robots with the controller of one design, or two designs on the same robots.

What was run before is kept. ``--worst-case`` searches the worst robot within the tolerances.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import typer

from flexhinf import campaign as campaigns, pages
from flexhinf.cli.arguments import Command, Group, read_source, refuse_stated, reproduce_command, with_options
from flexhinf.cli.messages import NOT_MET, note, options, progress_bar, show, step_progress
from flexhinf.designs.campaign_options import CampaignOptions
from flexhinf.errors import refuse_if

if TYPE_CHECKING:
    from flexhinf.campaign.driver import Executor, Report
    from flexhinf.campaign.results import MergedTable
    from flexhinf.designs import DesignCampaign

#: Seconds between two lines of progress where standard error is no terminal.
EVERY = 10.0

#: What --metric calls the worst disturbance: √(∫|z|²/∫|d|²).
GAIN = "gain"


class _Runs(Group):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] not in ("--help", "-h"):
            args = ["run", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_Runs,
    help="Test a design on thousands of robots within their tolerances.",
)


@app.command(
    "run", cls=Command, epilog="Example: flexhinf campaign design.toml --samples 10000 --out campaign"
)
@with_options(lambda: (options.RunCampaignOptions, ()))
def run(context: typer.Context, o: options.RunCampaignOptions) -> int:
    """Run a design's step or move on many robots within their tolerances, each with its own noise.

    The folder is a journal. Ctrl-C, SIGKILL and a full disk lose at most the
    batch that runs, and the same command continues. Sample i is the same for any
    batches, workers, shards and interruptions. At the end the folder has
    samples.parquet, with one row for each robot, and index.html.

    Exit code: 0 if every sample is a success, and the worst robot found;
    1 if not; 2 for a mistake; 130 if interrupted.
    """
    from flexhinf.designs.campaign_folder import open_campaign, search_gain, searches_gain

    refuse_stated(context, {} if o.worst_case else dict.fromkeys(("metric", "starts"), "--worst-case"))
    refuse_stated(context, {"starts": "a --metric beside gain"} if {*o.metric} == {GAIN} else {})
    design, shard, executor = _request(o, o.design), campaigns.Shard.read(o.shard or "1/1"), _executor(o)
    known = list(design.metrics.units)
    checked = [campaigns.MetricLimit.of(text, known) for text in o.require or design.requirements]
    metrics = _searched(o, checked, known, o.worst_case and searches_gain(design))
    with step_progress() as stage:
        command = [word for k, word in enumerate(reproduce_command(context)) if (k, word) != (2, "run")]
        campaign, journal = open_campaign(design, o.out, command, stage)
    campaign.check_device(o.device, here=not o.cluster)
    for metric in [name for name in metrics if name != GAIN]:
        campaigns.check_searchable(campaign, metric)
    try:
        with sample_progress(shard.name) as progress:
            table = campaigns.drive(campaign, journal, shard=shard, executor=executor, progress=progress)
    except KeyboardInterrupt:
        done = sum(map(journal.size, journal.shards()[0]))
        note(f"{done} of {journal.samples} samples are in {o.out}; the same command goes on from there.")
        raise
    if table is None:
        left = journal.batches - len(journal.shards()[0])
        typer.echo(
            f"shard {o.shard} is done; {left} of {journal.batches} batches are still to be run elsewhere.\n"
            f"then:  flexhinf campaign merge {o.out}"
        )
        if o.worst_case:
            note("the worst case is searched when all shards are there, by the same command without --shard")
        return 0
    for metric, smaller_is_worse in metrics.items():
        with step_progress() as stage:
            if metric == GAIN:
                search_gain(design, journal, stage)
                continue
            text = f"worst {pages.metric_text(metric)}"
            campaigns.worst_case(
                campaign,
                metric,
                table.columns,
                least=smaller_is_worse,
                starts=o.starts,
                journal=journal,
                nominal=table.journal.about.get("nominal", {}),
                progress=lambda runs, best, stage=stage, text=text: stage(
                    f"{text}: {best:.4g} after {runs} runs"
                ),
                device=campaigns.device_here(o.device) if o.cluster else o.device,
            )
    return _finish(table, checked)


def _request(o: options.BatchOptions, source: str) -> DesignCampaign[Any]:
    from flexhinf.designs import campaign_of

    values: dict[str, Any] = {field.name: getattr(o, field.name) for field in fields(CampaignOptions)}
    nameless = [text for text in o.tolerance if "=" not in text]
    refuse_if(
        nameless,
        "The tolerance names no parameter.",
        f"expected NAME=x, got {', '.join(nameless[:1])!r}",
        "--tolerance stiffness=15%",
    )
    values["tolerances"] = tuple(
        (name.strip(), value.strip()) for name, value in (text.split("=", 1) for text in o.tolerance)
    )
    return campaign_of(read_source(source, o.elastic, {}), CampaignOptions(**values))


def _executor(o: options.BatchOptions) -> Executor | None:
    refuse_if(
        o.workers and o.cluster,
        "Batches run in processes here or on a cluster.",
        "got --workers and --cluster",
        "one of both",
    )
    if o.cluster:
        return campaigns.in_cluster(o.cluster, o.device)
    return campaigns.in_processes(o.workers, note, o.device) if o.workers else campaigns.on_device(o.device)


def _searched(
    o: options.RunCampaignOptions,
    requirements: Sequence[campaigns.MetricLimit],
    known: Sequence[str],
    gain: bool,
) -> dict[str, bool]:
    """Metrics whose worst case is searched, and whether their small values are the bad ones; `GAIN` comes last."""
    if not o.worst_case:
        return {}
    campaigns.check_starts(o.starts)
    chosen = [campaigns.known_metric(name, [*known, campaigns.DAMPING, GAIN]) for name in o.metric]
    chosen = chosen or [*(rule.metric for rule in requirements), *([GAIN] if gain else [])]
    lower_limits = {rule.metric for rule in requirements if not rule.at_most}
    return {
        name: name in lower_limits for name in sorted(dict.fromkeys(chosen), key=lambda name: name == GAIN)
    }


@app.command("merge", cls=Command)
@with_options(lambda: (options.MergeOptions, ()))
def merge(context: typer.Context, o: options.MergeOptions) -> int:
    """Write the table and the report of a campaign whose shards are done.

    Shards of other folders are copied into the first one. Every file is
    checked, byte for byte; what is missing or damaged is named.
    """
    journals = [campaigns.Journal.existing(folder) for folder in (o.folder, *o.others)]
    journal = journals[0]
    checked = [
        campaigns.MetricLimit.of(text, journal.metrics)
        for text in (o.require or journal.about.get("requirements", []))
    ]
    with journal.driven():
        for other, folder in zip(journals[1:], o.others):
            typer.echo(f"{journal.take(other)} batches from {folder}")
        good, bad = journal.shards()
        for path, wrong in bad:
            note(f"{path.name} is {wrong}; the campaign's command runs it again")
        table = campaigns.merged(journal, good)
    return _finish(table, checked)


@app.command("replay", cls=Command, epilog="Example: flexhinf campaign replay campaign --sample 123")
@with_options(lambda: (options.ReplayOptions, ()))
def replay(context: typer.Context, o: options.ReplayOptions) -> None:
    """Run one sample of a campaign again, or the worst robot, alone, and say whether the metrics are the same bits."""
    from flexhinf.designs.campaign_folder import GainSearch, stored_campaign, stored_gains, stored_request

    refuse_if(
        (o.sample is None) == (not o.worst_case),
        "One run is replayed at a time.",
        f"expected --sample or --worst-case, got {'neither' if o.sample is None else 'both'}",
        "--sample 0",
    )
    refuse_if(
        o.worst_case == GAIN and o.out is not None,
        "The worst disturbances are several runs.",
        "got --out",
        "disturbance.json in the campaign's folder",
    )
    campaign, journal = stored_campaign(o.folder)
    if o.worst_case == GAIN:
        rows = stored_gains(journal).rows
        refuse_if(
            not rows,
            "The worst disturbance was not searched in this campaign.",
            f"expected worst-case/disturbance.json, whole, in {o.folder}",
            f"the campaign's command with --worst-case --metric {GAIN}",
        )
        search = GainSearch(stored_request(journal), float(journal.settings["duration"]))
        show([pages.gain_replay_table(rows, [search.again(row) for row in rows])])
        typer.echo(pages.wrapped(pages.journal_design(journal)))
        return
    if o.sample is not None:
        replayed = campaigns.Replayed(campaign, journal, o.sample)
        run, table, same, origin = replayed.run, pages.replay_table(replayed), replayed.same, "made the table"
    else:
        case = campaigns.stored_worst(journal, o.worst_case)
        again = case.again(campaign)
        run = None if o.out is None else case.run(campaign)
        table, same, origin = pages.worst_table(case, again), again == case.found, "searched"
    if o.out is not None and run is not None:
        run.save(o.out)
    show([table])
    typer.echo(pages.wrapped(pages.journal_design(journal)))
    if not same:
        note(f"the numbers differ in their last bits: another kind of processor, or other versions, {origin}")


def _finish(table: campaigns.MergedTable, requirements: list[campaigns.MetricLimit]) -> int:
    from flexhinf.designs.campaign_folder import stored_campaign, stored_gains

    journal, folder = table.journal, table.journal.folder

    judged = pages.write_campaign(
        table, requirements, lambda case, plant: case.run(stored_campaign(folder)[0], plant)
    )
    cases, gains = campaigns.stored_worsts(journal), stored_gains(journal)
    missed = [case for case in cases if pages.missed_by(case, requirements)]
    if gains.unproved:
        note(f"no γ is proved of this law: {gains.unproved}")
    nominal, worst = journal.about.get("nominal", {}), judged.worst_of_all
    again = {
        **({} if worst is None else {"worst sample": f"--sample {worst}"}),
        **{f"worst {pages.metric_text(case.metric)}": f"--worst-case {case.metric}" for case in cases[:1]},
        **({"worst disturbance": f"--worst-case {GAIN}"} if gains.rows else {}),
    }
    texts = [
        pages.campaign_verdict(judged),
        *filter(None, [pages.campaign_design(judged)]),
        *(
            pages.worst_text(judged, case)
            for case in [*missed, *(case for case in cases if case not in missed)]
        ),
        *(pages.gain_text(row, nominal) for row in gains.rows),
    ]
    _say(texts, len(again) + 2)
    typer.echo(f"table:  {folder / 'samples.parquet'}\nreport: {folder / 'index.html'}")
    for what in again.values():
        typer.echo(f"replay: {pages.replay_command(folder, what)}")
    return NOT_MET if judged.failures or missed else 0


def _say(texts: Sequence[str], after: int) -> None:
    """Paragraphs, as many as leave a screen room for the lines `after` them; the page has all."""
    room = pages.SCREEN + 2 - after
    for k, text in enumerate(map(pages.wrapped, texts)):
        room -= len(text.splitlines())
        if k and room < (k + 1 < len(texts)):
            typer.echo("More is on the page.")
            return
        typer.echo(text)


@app.command(
    "compare", cls=Command, epilog="Example: flexhinf campaign compare linear.toml cubic.toml --samples 2000"
)
@with_options(lambda: (options.CompareCampaignsOptions, ()))
def compare(context: typer.Context, o: options.CompareCampaignsOptions) -> None:
    """Run two designs on the same robots, and compare them pair by pair.

    Both get the same robots, noise, initial errors and disturbances. Robot,
    sensors, motors and step must be the same. Weights, preset, degree, γ and
    estimator may differ. The folders a and b are campaigns with journals of
    their own, so the same command continues after an interruption. index.html
    says which design fails where the other does not, and how they differ.

    Exit code: 0 when the report is written, whichever is better; 2 for a
    mistake; 130 if interrupted.
    """
    from flexhinf.designs import DesignPair, open_pair

    shard, executor = campaigns.Shard.read(o.shard or "1/1"), _executor(o)
    names, command = (o.first, o.second), reproduce_command(context)
    pair = DesignPair(_request(o, o.first), _request(o, o.second), o.out, names, tuple(command))
    known = list(pair.a.metrics.units)
    checked = [campaigns.MetricLimit.of(text, known) for text in o.require or pair.a.requirements]
    with step_progress() as stage:
        opened = open_pair(pair, stage)
    for campaign, _ in opened:
        campaign.check_device(o.device, here=not o.cluster)
    tables: list[MergedTable] = []
    for name, (campaign, journal) in zip("AB", opened):
        with sample_progress(f"{name} {shard.name}".strip()) as progress:
            table = campaigns.drive(campaign, journal, shard=shard, executor=executor, progress=progress)
        tables += [] if table is None else [table]
    if len(tables) < 2:
        typer.echo(
            f"shard {o.shard} is done; others are still to be run.\nthen: the same command without --shard"
        )
        return

    pair.judged = pages.write_campaign(tables[0], checked), pages.write_campaign(tables[1], checked)
    pair.paired = campaigns.compare(tables[0], tables[1], [rule.text() for rule in checked])
    path = pages.write_pair(pair)
    show([pages.pair_table(pair, pair.paired.metrics).terminal()])
    for name, source in zip("AB", names):
        typer.echo(f"{name}: {source}")
    if not pair.differences:
        note("the specifications do not differ")
    typer.echo(pages.pair_verdict(pair))
    for text in pages.pair_designs(pair):
        typer.echo(pages.wrapped(text))
    typer.echo(f"report: {path}")


@contextmanager
def sample_progress(part: str) -> Generator[Callable[[Report], None], None, None]:
    """Progress bar with samples, rate and time left; a line every `EVERY` seconds where there is no terminal."""
    bar = progress_bar("Bar", "MofNComplete")
    task = bar.add_task("")
    begun = printed = time.monotonic()

    def progress(report: Report) -> None:
        nonlocal printed
        if report.note:
            note(report.note)
        text, seconds = "", time.monotonic() - begun
        if report.fresh and seconds > 0.0:
            rate = report.fresh / seconds  # of this driver
            left = (report.total - report.done) / rate
            remaining = f"{left:.0f} s" if left < 120.0 else f"{left / 60.0:.0f} min"
            text = f"{rate:.3g} samples/s, {remaining if left < 7200.0 else f'{left / 3600.0:.1f} h'} left"
        bar.update(task, total=report.total, completed=report.done, description=text)
        if bar.disable and report.fresh and time.monotonic() - printed >= EVERY:
            printed = time.monotonic()
            sys.stderr.write(
                f"{part + ': ' if part else ''}{report.done} of {report.total} samples, {text}\n"
            )

    with bar:
        yield progress
