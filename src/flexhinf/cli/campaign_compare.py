"""``flexhinf campaign compare``: two designs on the same robots, with the options of a campaign."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexhinf.cli.arguments import design_file_of, read_source, reproduce_command
from flexhinf.cli.campaign import chosen_executor, design_stages, named_tolerance, run, sample_progress
from flexhinf.cli.messages import note

if TYPE_CHECKING:
    from flexhinf.campaign import MergedTable, Requirement
    from flexhinf.design import DesignCampaign, DesignPair

#: Options of `flexhinf campaign` that a comparison has too.
OPTIONS = (
    "samples", "seed", "distribution", "method", "tolerance", "payload", "initial_error", "disturbance", "duration",
    "require", "workers", "cluster", "shard", "batch", "elastic",
)  # fmt: skip

Design = typer.Argument(help="design.toml, or a robot, as for `flexhinf campaign`.")


def _with_campaign_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command whose last parameter is ``**options`` those `OPTIONS` of `flexhinf campaign`."""
    own, others = (inspect.signature(one, eval_str=True).parameters for one in (command, run))
    kept = [one for one in own.values() if one.kind is not inspect.Parameter.VAR_KEYWORD]
    more = [others[name].replace(kind=inspect.Parameter.KEYWORD_ONLY) for name in OPTIONS]

    @functools.wraps(command, updated=())
    def decorated(**values: Any) -> None:
        command(**values)

    del decorated.__dict__["__wrapped__"]
    decorated.__annotations__ = {}
    decorated.__dict__["__signature__"] = inspect.Signature([*kept, *more])
    return decorated


@_with_campaign_options
def compare_campaigns(
    context: typer.Context,
    first: Annotated[str, Design],
    second: Annotated[str, Design],
    out: Annotated[
        Path, typer.Option(help="Folder of the comparison; the same command goes on there.")
    ] = Path("flexhinf-pair"),
    **options: Any,
) -> None:
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
    from flexhinf.design import open_pair

    part = Shard.read(options["shard"]) if options["shard"] else Shard()
    executor = chosen_executor(options["workers"], options["cluster"])
    sources = (first, second)
    pair = _pair(sources, options)
    checked = [
        Requirement.of(text, list(pair.a.metrics.units)) for text in options["require"] or pair.requirements
    ]
    words = reproduce_command(context)
    with design_stages() as stage:
        opened = open_pair(pair, out, (words, words), stage)
    tables = []
    for name, (campaign, journal) in zip("AB", opened):
        with sample_progress(f"{name} {part.name}".strip()) as progress:
            tables.append(drive(campaign, journal, shard=part, executor=executor, progress=progress))
    done = [table for table in tables if table is not None]
    if len(done) < 2:
        typer.echo(f"shard {options['shard']} is done; others are still to be run.")
        typer.echo("then: the same command without --shard")
        return
    _finish(pair, out, sources, words, done, checked)


def _pair(sources: tuple[str, str], values: dict[str, Any]) -> DesignPair:
    """Both designs with the same options; refused where they are not for the same robots."""
    from flexhinf.design import CampaignOptions, DesignCampaign, DesignPair

    options = CampaignOptions(
        values["samples"], values["seed"], values["batch"], values["distribution"], values["method"],
        tuple(map(named_tolerance, values["tolerance"])), values["payload"] or None, values["initial_error"],
        values["disturbance"], values["duration"] or None,
    )  # fmt: skip

    def asked(source: str) -> DesignCampaign:
        request = read_source(source, values["elastic"], {}).request
        return DesignCampaign(request, options, design_file_of(source))

    return DesignPair(asked(sources[0]), asked(sources[1]))


def _finish(
    pair: DesignPair,
    out: Path,
    names: tuple[str, str],
    words: list[str],
    tables: list[MergedTable],
    requirements: list[Requirement],
) -> None:
    """The reports, and what the comparison says."""
    from rich.console import Console

    from flexhinf.campaign import compare
    from flexhinf.design import PairResult, stored_campaign
    from flexhinf.pages import pair_table, pair_verdict, write_campaign, write_pair

    def judged(table: MergedTable) -> Any:
        folder = table.journal.folder
        return write_campaign(table, requirements, lambda sample: stored_campaign(folder)[0].replay(sample))

    both = judged(tables[0]), judged(tables[1])
    paired = compare(tables[0], tables[1], [one.text() for one in requirements])
    result = PairResult(pair, out.expanduser().absolute(), names, both, paired, tuple(words))
    path = write_pair(result)
    Console().print(pair_table(result))
    for name, source in zip("AB", names):
        typer.echo(f"{name}: {source}")
    if not pair.differences:
        note("the specifications do not differ")
    typer.echo(pair_verdict(result))
    typer.echo(f"report: {path}")
