"""``flexhinf compare``: laws by name on the same loop, plants, disturbances and seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flexhinf.cli import options as o
from flexhinf.cli.asked import asked_by
from flexhinf.cli.given import words
from flexhinf.cli.progress import Progress
from flexhinf.cli.told import note
from flexhinf.cli.values import names
from flexhinf.design.specification import Specification as Default

__all__ = ["compare"]

MEASURED = ",".join(Default.measured)

_COMPARISON = "What is compared"

Laws = Annotated[
    str,
    typer.Option(
        rich_help_panel=_COMPARISON,
        help="nl-hinf (the design's own), nl-hinf-2 … nl-hinf-12 (degree of V), hinf, nlqr, lqr, lqr-gravity, lqg, pd, "
        "pid, torque, torque-i, flatness, flatness-i; between commas. Default: all without a degree or -i.",
    ),
]
Tune = Annotated[
    str,
    typer.Option(
        rich_help_panel=_COMPARISON,
        help="What the laws are tuned to: peak (of the input in the step as each law is commanded: the limit asked "
        "for, the saturation, or that of nl-hinf), bandwidth (of the linearised loop: asked for, or that of nl-hinf), "
        "or none.",
    ),
]


def compare(
    context: typer.Context,
    robot: o.Robot,
    out: o.Out = Path("flexhinf-compare"),
    elastic: o.Elastic = "",
    laws: Laws = "",
    tune: Tune = "peak",
    pose: o.Pose = "",
    start: o.Start = "",
    via: o.Via = [],  # noqa: B006  typer copies it
    preset: o.Preset = "",
    bandwidth: o.Bandwidth = "",
    damping: o.Damping = Default.damping,
    peak_effort: o.PeakEffort = 0.0,
    peak_voltage: o.PeakVoltage = 0.0,
    peak_torque: o.PeakTorque = 0.0,
    penalty: o.Penalty = "",
    effort: o.Effort = 0.0,
    gamma_ratio: o.GammaRatio = Default.gamma_ratio,
    checked_gamma_ratio: o.CheckedGammaRatio = Default.checked_gamma_ratio,
    checked_penalty: o.CheckedPenalty = "",
    degrees: o.Degrees = "",
    disturbances: o.Disturbances = "",
    command: o.Command = Default.command,
    measured: o.Measured = MEASURED,
    estimator: o.Estimator = Default.estimator,
    period: o.Period = Default.period,
    process_noise: o.ProcessNoise = Default.process_noise,
    torque_noise: o.TorqueNoise = Default.torque_noise,
    measurement_noise: o.MeasurementNoise = Default.measurement_noise,
    saturation: o.Saturation = 0.0,
    extras: o.Extras = "",
    delay: o.Delay = Default.delay,
    quantisation: o.Quantisation = Default.quantisation,
    load: o.Load = Default.load,
    draws: o.Draws = -1,
    rays: o.Rays = -1,
    duration: o.Duration = 0.0,
    seed: o.Seed = Default.seed,
) -> None:
    """Is the nonlinear H∞ law better than the PD you have, by how much, at what cost?

    Laws by name in the same loop, on the same plants, disturbances and seeds, each tuned
    to the limit you ask for, or to what the design's own law costs: one table, one figure,
    one page.

    Exit code: 0 when the report is written, whoever wins; 2 for a mistake (nothing is
    written); 130 if interrupted.
    """
    from rich.console import Console

    from flexhinf.design import compare as room
    from flexhinf.report import check, write

    told = asked_by(context, robot, elastic)
    asked, chosen = told.asked, names(laws) or None
    folder = check(out)
    count = room.comparison_stages(asked.robot, asked.specification, room.law_names(chosen))
    with Progress(count + 1) as tell:
        result = room.compare(asked.robot, asked.specification, chosen, tune, tell)
        tell("report")
        files = room.comparison_files(result, words(context), told.warnings)
    write(folder, files)
    console = Console()
    for table in room.comparison_tables(result, console.width):
        console.print(table)
    for text in room.notes(result):
        note(text)
    typer.echo(room.verdict(result))
    typer.echo(f"report: {folder / 'index.html'}")
