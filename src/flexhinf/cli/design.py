"""``flexhinf design``, to a judged controller; ``flexhinf compare``, to several; ``flexhinf paper``, every claim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import typer

from flexhinf.cli.arguments import reproduce_command, request_of, with_options
from flexhinf.cli.messages import NOT_MET, note, step_progress
from flexhinf.cli.options import ALL, COMPARE_FIELDS, CompareOptions, DesignOptions, PaperOptions
from flexhinf.design.options import option_name


@with_options(DesignOptions, ALL)
def design(context: typer.Context, o: DesignOptions) -> None:
    """From a robot to a judged controller: weights, γ*, law, region, runs, report.

    The folder also holds design.toml: the specification and its result.
    `flexhinf design design.toml` makes the same design again; options win
    over it.

    Exit code: 0 if the nonlinear loop meets the specification; 1 if it does not
    (the report is written, and says so); 2 for a mistake, or for what cannot
    be met (nothing is written); 130 if interrupted.
    """
    from rich.console import Console

    from flexhinf import pages
    from flexhinf.design import design as make_design, design_text, stages
    from flexhinf.report import check, write

    request = request_of(context, o, o.robot, o.elastic)
    folder = check(o.out)
    with step_progress(stages(request.robot, request.specification) + 1) as progress:
        result = make_design(request.robot, request.specification, progress)
        progress("report")
        files = pages.design_files(result, reproduce_command(context), request.warnings, ("design.toml",))
        files["design.toml"] = design_text(result, request, folder)
    write(folder, files)
    for table in pages.design_tables(result):
        Console().print(table)
    for text in pages.notes(result):
        note(text)
    typer.echo(pages.verdict(result))
    typer.echo(f"report: {folder / 'index.html'}")
    if not result.met:
        raise typer.Exit(NOT_MET)


@with_options(CompareOptions, COMPARE_FIELDS)
def compare(context: typer.Context, o: CompareOptions) -> None:
    """Which law is best for this robot: the nonlinear H∞ law, or one that you would use instead?

    Laws by name on the same plants, with the same commands, disturbances and
    seeds, each with its own sensors and tuned over all its parameters for one
    criterion that is stated first: one table, one figure, one page. The
    headline names the best rival.

    Exit code: 0 when the report is written, whoever wins; 2 for a mistake
    (nothing is written); 130 if interrupted.
    """
    from rich.console import Console

    from flexhinf import pages
    from flexhinf.design import compare as make_comparison, comparison_stages, law_names
    from flexhinf.report import check, write

    request = request_of(context, o, o.robot, o.elastic)
    chosen = tuple(name.strip() for name in o.laws.split(",") if name.strip()) or None
    folder = check(o.out)
    count = comparison_stages(request.robot, request.specification, law_names(chosen))
    with step_progress(count + 1) as progress:
        result = make_comparison(
            request.robot, request.specification, chosen, o.tune, progress, o.same_sensors
        )
        progress("report")
        files = pages.comparison_files(result, reproduce_command(context), request.warnings)
    write(folder, files)
    console = Console()
    typer.echo(f"Criterion: {result.criterion.text}")
    for table in pages.comparison_tables(result, console.width):
        console.print(table)
    for text in pages.comparison_notes(result):
        note(text)
    typer.echo(pages.comparison_verdict(result))
    typer.echo(f"report: {folder / 'index.html'}")


@with_options(PaperOptions)
def paper(context: typer.Context, o: PaperOptions) -> None:
    """Reproduce every figure and judge every claim of Elsa & Akbari (2014)."""
    from flexhinf.paper import STAGES, PaperSettings, reproduce
    from flexhinf.report import check, write

    settings = PaperSettings(**{name: value for name, value in asdict(o).items() if name != "out"})
    check(o.out)
    if o.degree % 2:
        note(
            f"the paper's arm is odd, so V has no terms of degree {o.degree}: it is degree {o.degree - 1} again."
        )
    words = ["flexhinf", "paper"]  # every setting, as defaults change
    for name, value in asdict(settings).items():
        words += [option_name(name), str(value)]
    words += [] if o.out == PaperOptions().out else ["--out", o.out.name]
    with step_progress(STAGES) as progress:
        result = reproduce(settings, words, progress)
    folder = write(o.out, result.files)
    _print_claims(result.claims, result.questions, result.metrics)
    typer.echo(f"report: {folder / 'index.html'}")


def _print_claims(claims: Sequence[Any], questions: Sequence[Any], metrics: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from flexhinf.report import by_verdict, summary

    colours = {"holds": "green", "fails": "red", "ties": "yellow", "not judged": "bright_black"}
    title = (
        f"γ* of the paper's problem = {metrics['gamma_star']:.4f}, γ of its law here = {metrics['gamma']:.4f}"
    )
    console = Console()
    for heading, group in ((title, claims), ("Our own question", questions)):
        table = Table(title=heading, title_justify="left", show_lines=True)
        table.add_column("claim, and by what it is judged")
        table.add_column("verdict", no_wrap=True)
        for claim in by_verdict(group):
            text = f"{escape(claim.text)}\n[dim]{escape(claim.criterion)}[/]"
            table.add_row(text, f"[{colours[claim.verdict]}]{claim.verdict}[/]")
        console.print(table)
        if group is claims:
            console.print(f"{summary(claims)} No printed curve was compared with a computed one.")
