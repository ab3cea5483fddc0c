"""``flexhinf design``: from a robot, or a design file, to a judged controller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from flexhinf.cli.arguments import Elastic, Out, Robot, reproduce_command, request_of, with_specification
from flexhinf.cli.messages import NOT_MET, note
from flexhinf.cli.progress import Progress

__all__ = ["EXAMPLES", "design"]

EXAMPLES = (
    "flexhinf design paper --goal 90deg",
    "flexhinf design planar-two-link --goal 35deg,20deg --measured motor_position --bandwidth 3 --damping 0.3",
    "flexhinf design paper --preset robust --peak-voltage 24 --delay 2ms --out robust",
    "flexhinf design flexhinf-design/design.toml --seed 1",
)


@with_specification()
def design(
    context: typer.Context,
    robot: Robot,
    out: Out = Path("flexhinf-design"),
    elastic: Elastic = "",
    **options: Any,
) -> None:
    """From a robot to a judged controller: weights, γ*, law, region, runs, report.

    The folder also holds design.toml: the specification and its result.
    `flexhinf design design.toml` makes the same design again; options win over it.

    Exit code: 0 if the nonlinear loop meets the specification; 1 if it does not
    (the report is written, and says so); 2 for a mistake, or for what cannot be met
    (nothing is written); 130 if interrupted.
    """
    from rich.console import Console

    from flexhinf.design import design as make_design
    from flexhinf.design import design_text, report, stages
    from flexhinf.report import check, write

    read = request_of(context, robot, elastic)
    request = read.request
    folder = check(out)
    with Progress(stages(request.robot, request.specification) + 1) as progress:
        result = make_design(request.robot, request.specification, progress)
        progress("report")
        files = report.design_files(result, reproduce_command(context), read.warnings, ("design.toml",))
        files["design.toml"] = design_text(result, request.source, request.elastic, folder)
    write(folder, files)
    for table in report.design_tables(result):
        Console().print(table)
    for text in report.notes(result):
        note(text)
    typer.echo(report.verdict(result))
    typer.echo(f"report: {folder / 'index.html'}")
    if not result.met:
        raise typer.Exit(NOT_MET)
