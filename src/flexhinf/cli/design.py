"""``flexhinf design``, to a judged controller; ``flexhinf compare``, to several; ``flexhinf paper``, every claim."""

from __future__ import annotations

from dataclasses import asdict

import typer

from flexhinf import pages, report
from flexhinf.cli.arguments import reproduce_command, request_of, with_options
from flexhinf.cli.messages import NOT_MET, note, show, step_progress
from flexhinf.cli.options import ALL, COMPARE_FIELDS, CompareOptions, DesignOptions, PaperOptions
from flexhinf.design.options import option_name

#: Of verdicts.
COLOURS = {"holds": "green", "fails": "red", "ties": "yellow", "not judged": "bright_black"}


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
    from flexhinf.design import design as make_design, design_text, stages

    request = request_of(context, o, o.robot, o.elastic)
    folder = report.check(o.out)
    with step_progress(stages(request.robot, request.specification) + 1) as progress:
        result = make_design(request.robot, request.specification, progress)
        progress("report")
        files = pages.design_files(result, reproduce_command(context), request.warnings, ("design.toml",))
        files["design.toml"] = design_text(result, request, folder)
    report.write(folder, files)
    show(pages.design_tables(result), pages.notes(result))
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

    from flexhinf.design import compare as make_comparison, law_names, stages

    request = request_of(context, o, o.robot, o.elastic)
    chosen = tuple(name.strip() for name in o.laws.split(",") if name.strip()) or None
    folder = report.check(o.out)
    count = stages(request.robot, request.specification, law_names(chosen))
    with step_progress(count + 1) as progress:
        result = make_comparison(
            request.robot, request.specification, chosen, o.tune, progress, o.same_sensors
        )
        progress("report")
        files = pages.comparison_files(result, reproduce_command(context), request.warnings)
    report.write(folder, files)
    typer.echo(f"Criterion: {result.criterion.text}")
    show(pages.comparison_tables(result, Console().width), pages.comparison_notes(result))
    typer.echo(pages.comparison_verdict(result))
    typer.echo(f"report: {folder / 'index.html'}")


@with_options(PaperOptions)
def paper(context: typer.Context, o: PaperOptions) -> None:
    """Reproduce every figure and judge every claim of Elsa & Akbari (2014)."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from flexhinf.paper import STAGES, PaperSettings, reproduce

    settings = PaperSettings(**{name: value for name, value in asdict(o).items() if name != "out"})
    report.check(o.out)
    if o.degree % 2:
        note(
            f"the paper's arm is odd, so V has no terms of degree {o.degree}: it is degree {o.degree - 1} again."
        )
    command = ["flexhinf", "paper"]  # every setting, as defaults change
    for name, value in asdict(settings).items():
        command += [option_name(name), str(value)]
    command += [] if o.out == PaperOptions().out else ["--out", o.out.name]
    with step_progress(STAGES) as progress:
        result = reproduce(settings, command, progress)
    folder = report.write(o.out, result.files)
    title = (
        f"γ* of the paper's problem = {result.metrics['gamma_star']:.4f}, "
        f"γ of its law here = {result.metrics['gamma']:.4f}"
    )
    console = Console()
    for heading, claims in ((title, result.claims), ("Our own question", result.questions)):
        table = Table(title=heading, title_justify="left", show_lines=True)
        table.add_column("claim, and by what it is judged")
        table.add_column("verdict", no_wrap=True)
        for claim in report.by_verdict(claims):
            text = f"{escape(claim.text)}\n[dim]{escape(claim.criterion)}[/]"
            table.add_row(text, f"[{COLOURS[claim.verdict]}]{claim.verdict}[/]")
        console.print(table)
        if claims is result.claims:
            console.print(f"{report.summary(claims)} No printed curve was compared with a computed one.")
    typer.echo(f"report: {folder / 'index.html'}")
