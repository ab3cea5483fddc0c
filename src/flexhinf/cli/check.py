"""``flexhinf check FILE``: what is wrong with a robot's description, or with a log, before anything is computed."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import typer

from flexhinf import pages, report
from flexhinf.cli.arguments import refuse_stated, reproduce_command, stated_fields, with_options
from flexhinf.cli.check_log import check_log, concluded
from flexhinf.cli.messages import options, step_progress
from flexhinf.errors import refuse_if
from flexhinf.validation import checked_path, value_text

#: How names of robots' descriptions end.
ROBOTS = (".toml", ".urdf", ".xml", ".mjcf")

#: Options that a robot's description is checked with.
OF_ROBOTS = {"log", "elastic", "out", "period"}


@with_options(lambda: (options.CheckOptions, options.CHECK_FIELDS))
def check(context: typer.Context, o: options.CheckOptions) -> None:
    """Check a robot's description or a log: what is wrong or doubtful, and what to try.

    A robot file, URDF or MJCF (seconds, no design): inertias that no body has,
    masses, limits, what the weight asks of each motor over its range, twist of the
    springs, vibrations against the period, and what a design needs besides.

    A log with --robot: sensors that never change or stop for a while, turns and
    counters that begin anew, lost values, gaps, times of arrival, columns in
    another unit, of a motor before its gear or of the other sign, and signals that
    are late. Estimate and identify print the same list.

    Exit code: 0 if nothing is more than a note; 1 for doubts; 2 for a fault, or a
    mistake; 130 if interrupted.
    """
    code = check_robot(context, o) if _is_robot(o.log) else check_log(context, o)
    if code:
        raise typer.Exit(code)


def _is_robot(path: Path) -> bool:
    """Whether a file is a robot's, by its name or as it begins: xacro and SDF are XML too, and no log is."""
    from flexhinf.robot import catalogue
    from flexhinf.robot.robot_file import format_readers

    if path.suffix.lower() in ROBOTS or str(path) in catalogue() or format_readers(path):
        return True
    try:
        with path.open("rb") as file:
            return file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")
    except (OSError, ValueError):  # no file, or no name of one
        return False


def check_robot(context: typer.Context, o: options.CheckOptions) -> int:
    """Check a robot's description: prints, writes the report if one is stated; the exit code."""
    from flexhinf.designs.design_file import is_design_file
    from flexhinf.designs.specification import Specification
    from flexhinf.robot import catalogue
    from flexhinf.robot.examination import examine_robot

    others = {field.name for field in fields(o)} | {*options.CHECK_FIELDS}
    refuse_stated(context, dict.fromkeys(others - OF_ROBOTS, "a log"))
    folder = None if o.out is None else report.check(o.out)
    path = catalogue().get(str(o.log)) or checked_path("The robot file", o.log)
    refuse_if(
        is_design_file(path),
        f"{path.name} is a design, and no robot.",
        f"expected a robot file, a URDF, an MJCF file or a log, got {value_text(str(o.log))}",
        "the robot's file, which it names",
    )
    stated = stated_fields(context)
    period = Specification(**stated).period if "period" in stated else None
    with step_progress(1) as progress:
        progress(f"examine {path.name}")
        result = examine_robot(path, o.elastic or None, period)
    return concluded(pages.checked_robot(result, reproduce_command(context)), result.findings, folder)
