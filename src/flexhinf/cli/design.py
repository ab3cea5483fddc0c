"""``flexhinf design``: from a robot, or a design file, to a judged controller."""

from __future__ import annotations

from pathlib import Path

import typer

from flexhinf.cli import options as o
from flexhinf.cli.asked import asked_by
from flexhinf.cli.given import words
from flexhinf.cli.progress import Progress
from flexhinf.cli.told import NOT_MET, note
from flexhinf.design.specification import Specification as Default

__all__ = ["design"]

MEASURED = ",".join(Default.measured)


def design(
    context: typer.Context,
    robot: o.Robot,
    out: o.Out = Path("flexhinf-design"),
    elastic: o.Elastic = "",
    pose: o.Pose = "",
    start: o.Start = "",
    via: o.Via = [],  # noqa: B006  typer copies it
    preset: o.Preset = "",
    bandwidth: o.Bandwidth = "",
    damping: o.Damping = Default.damping,
    peak_effort: o.PeakEffort = 0.0,
    peak_voltage: o.PeakVoltage = 0.0,
    peak_torque: o.PeakTorque = 0.0,
    overshoot: o.Overshoot = Default.overshoot,
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
    compare_rigid: o.CompareRigid = Default.compare_rigid,
    mujoco: o.Mujoco = Default.mujoco,
) -> None:
    """From a robot to a judged controller: weights, γ*, law, region, runs, report.

    Beside the page stands design.toml: what was asked for, and what came of it.
    `flexhinf design design.toml` makes the same design again; options win over it.

    Exit code: 0 if the nonlinear loop meets the specification; 1 if it does not
    (the report is written, and says so); 2 for a mistake, or for what cannot be met
    (nothing is written); 130 if interrupted.
    """
    from rich.console import Console

    from flexhinf import design as corridor
    from flexhinf.design.met import all_hold
    from flexhinf.design.terminal import design_tables
    from flexhinf.report import check, write

    told = asked_by(context, robot, elastic)
    asked = told.asked
    folder = check(out)
    with Progress(corridor.stages(asked.robot, asked.specification) + 1) as tell:
        result = corridor.design(asked.robot, asked.specification, tell)
        tell("report")
        files = corridor.design_files(result, words(context), told.warnings)
        files["design.toml"] = corridor.design_text(result, asked.source, asked.elastic, folder)
    write(folder, files)
    for table in design_tables(result):
        Console().print(table)
    for text in corridor.notes(result):
        note(text)
    typer.echo(corridor.verdict(result))
    typer.echo(f"report: {folder / 'index.html'}")
    if not all_hold(result.met):
        raise typer.Exit(NOT_MET)
