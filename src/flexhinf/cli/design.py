"""``flexhinf design``, from a robot or a design file to a judged controller; ``flexhinf compare``, to several."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from flexhinf.cli.arguments import (
    Elastic,
    Out,
    Payload,
    PoseXyz,
    Robot,
    Tool,
    reproduce_command,
    request_of,
    with_specification,
)
from flexhinf.cli.messages import NOT_MET, Progress, note


@with_specification()
def design(
    context: typer.Context,
    robot: Robot,
    out: Out = Path("flexhinf-design"),
    elastic: Elastic = "",
    payload: Payload = "",
    pose_xyz: PoseXyz = "",
    tool: Tool = "",
    **options: Any,
) -> None:
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

    read = request_of(context, robot, elastic, payload, pose_xyz, tool)
    request = read.request
    folder = check(out)
    with Progress(stages(request.robot, request.specification) + 1) as progress:
        result = make_design(request.robot, request.specification, progress)
        progress("report")
        files = pages.design_files(result, reproduce_command(context), read.warnings, ("design.toml",))
        files["design.toml"] = design_text(result, request.source, request.elastic, folder, request.payload)
    write(folder, files)
    for table in pages.design_tables(result):
        Console().print(table)
    for text in pages.notes(result):
        note(text)
    typer.echo(pages.verdict(result))
    typer.echo(f"report: {folder / 'index.html'}")
    if not result.met:
        raise typer.Exit(NOT_MET)


COMPARISON = "What is compared"

Laws = Annotated[
    str,
    typer.Option(
        rich_help_panel=COMPARISON,
        help="nl-hinf, nl-hinf-2 … nl-hinf-12 (degree of V), hinf, nlqr, lqr, lqr-gravity, lqg, pd, pd-gravity, "
        "pid, torque, torque-i, flatness, flatness-i; between commas. Default: all without a degree.",
    ),
]
Tune = Annotated[
    str,
    typer.Option(
        rich_help_panel=COMPARISON,
        help="What the laws share when they are tuned: peak (largest input of the step as deployed: at most the "
        "limit asked for or the saturation, or that of the design where it is larger), bandwidth (of the linear loop: "
        "at most the one asked for, or that of the design), or none. Every law keeps the limits of the margins as "
        "well, and lets no more measurement noise through to the motor than the design.",
    ),
]
SameSensors = Annotated[
    bool,
    typer.Option(
        "--same-sensors",
        rich_help_panel=COMPARISON,
        help="Every law measures what the design measures; without this option each law has the sensors that its "
        "proponents would choose, such as an encoder on the motor for a PD.",
    ),
]


#: These fields change nothing of a comparison, and have no option here.
@with_specification("overshoot", "tracking_error", "compare_rigid", "mujoco")
def compare(
    context: typer.Context,
    robot: Robot,
    out: Out = Path("flexhinf-compare"),
    elastic: Elastic = "",
    payload: Payload = "",
    pose_xyz: PoseXyz = "",
    tool: Tool = "",
    laws: Laws = "",
    tune: Tune = "peak",
    same_sensors: SameSensors = False,
    **options: Any,
) -> None:
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

    read = request_of(context, robot, elastic, payload, pose_xyz, tool)
    request = read.request
    chosen = tuple(name.strip() for name in laws.split(",") if name.strip()) or None
    folder = check(out)
    count = comparison_stages(request.robot, request.specification, law_names(chosen))
    with Progress(count + 1) as progress:
        result = make_comparison(request.robot, request.specification, chosen, tune, progress, same_sensors)
        progress("report")
        files = pages.comparison_files(result, reproduce_command(context), read.warnings)
    write(folder, files)
    console = Console()
    typer.echo(f"Criterion: {result.criterion.text}")
    for table in pages.comparison_tables(result, console.width):
        console.print(table)
    for text in pages.comparison_notes(result):
        note(text)
    typer.echo(pages.comparison_verdict(result))
    typer.echo(f"report: {folder / 'index.html'}")
