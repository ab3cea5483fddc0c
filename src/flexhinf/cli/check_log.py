"""``flexhinf check LOG``: what is wrong with a log, before any filter sees it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

import flexhinf as fh
from flexhinf import pages, report
from flexhinf.cli.arguments import read_source, reproduce_command, stated_fields
from flexhinf.cli.logs import in_degrees, read_stated, stated_columns, stated_late, stated_robot
from flexhinf.cli.messages import options, show, step_progress
from flexhinf.errors import InvalidInput
from flexhinf.findings import Finding, worst

if TYPE_CHECKING:
    from flexhinf.robot import Robot

#: Exit code of the worst finding.
CODES = {"note": 0, "doubt": 1, "fault": 2}


def check_log(context: typer.Context, o: options.CheckOptions) -> int:
    """Check a log as options state it: prints, writes the report if one is stated; the exit code."""
    fields, columns = stated_fields(context), stated_columns(o.column)
    request = read_source(stated_robot(o), o.elastic, fields, o.payload)
    folder = None if o.out is None else report.check(o.out)
    robot, s = request.robot, request.specification
    known = s.known_latency if request.file is not None else 0
    latency, log = known if o.latency is None else o.latency, None
    with step_progress(2) as progress:
        progress(f"read {o.log.name}")
        try:
            measured = s.measured if "measured" in fields else _logged(o, robot, columns) or s.measured
            plant = robot.plant(measured)
            log = read_stated(o, plant, columns, latency)
        except InvalidInput as error:
            if not o.log.is_file():
                raise
            findings = (fh.LogFinding.of(error),)
        else:
            progress("examine")
            findings = fh.examine(log, robot, o.model, stated_late(o, plant, latency))
        command = reproduce_command(context)
        page = pages.checked_log(
            o.log.name, robot, log, findings, command, request.warnings, in_degrees(request)
        )
    return concluded(page, findings, folder)


def concluded(page: report.Page, findings: Sequence[Finding], folder: Path | None) -> int:
    """Write the report of a check into a folder, if there is one, and print what was found; the exit code."""
    if folder is not None:
        report.write(folder, pages.report_files(page, "check.json"))
    ending = pages.check_ending(page, findings)
    show(ending.tables)
    typer.echo(ending.text + ("" if folder is None else f"\nreport: {folder / 'index.html'}"))
    return CODES[worst(findings)]


def _logged(o: options.CheckOptions, robot: Robot, columns: dict[str, str]) -> tuple[str, ...]:
    """The signals of a robot that a log has columns for, by their names or as they are stated."""
    from flexhinf.identification.log_reader import signals_in
    from flexhinf.plant.instruments import SENSORS
    from flexhinf.robot.signals import signal_names

    every = [name for kind in SENSORS for name in signal_names(kind, robot.joint_names, robot.rigid)]
    present = signals_in(o.log, robot.plant(every))
    stated = [name for name in every for key in columns if name == key or name.startswith(f"{key}_")]
    return tuple(name for name in every if name in stated or name in present)
