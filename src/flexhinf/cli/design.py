"""``flexhinf design``, from a robot or a design file to a judged controller; ``flexhinf compare``, to several."""

from __future__ import annotations

import typer

from flexhinf.cli.arguments import reproduce_command, request_of, with_options
from flexhinf.cli.messages import NOT_MET, note, step_progress
from flexhinf.cli.options import ALL, COMPARE_FIELDS, CompareOptions, DesignOptions


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
    from flexhinf.design import design as make_design
    from flexhinf.design import design_text, stages
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
    from flexhinf.design import compare as make_comparison
    from flexhinf.design import comparison_stages, law_names
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
