"""``flexhinf run``: the controller of a design drives a robot in real time."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from typing import TYPE_CHECKING

import typer

from flexhinf.cli.arguments import request_of, with_options
from flexhinf.cli.export import controller_of, file_of
from flexhinf.cli.messages import NOT_MET, note, step_progress
from flexhinf.cli.options import RUN_FIELDS, RunOptions
from flexhinf.errors import InvalidInput

if TYPE_CHECKING:
    from flexhinf.design.deployed_run import DeployedRun


@with_options(RunOptions, RUN_FIELDS)
def run_design(context: typer.Context, o: RunOptions) -> None:
    """The controller of a design drives the robot in MuJoCo, in real time.

    By default it makes the step of the design, or its move: what no option states
    is as in the design file. Options change the run and the robot that is driven,
    never the controller. Ctrl-C ends the run: what was recorded until then is
    written whole.

    Exit code: 0 if every deadline and every requirement was met; 1 if not;
    2 for a mistake; 130 if interrupted.
    """
    file_of(o.source)
    if not o.mujoco:
        raise InvalidInput(
            "It is not said which robot is driven.", "expected --mujoco, the robot in MuJoCo, got none", "--mujoco"
        )  # fmt: skip
    from rich.console import Console

    from flexhinf.export import check_log, load_compiled, write_log
    from flexhinf.pages import check_film, run_met, run_notes, run_tables, run_verdict, write_film
    from flexhinf.robot.mujoco import MuJoCoView, check_display

    logs, films = [check_log(path) for path in o.log], [check_film(path) for path in o.record]
    if o.view:
        check_display()
    compiled = None if o.library is None else load_compiled(o.library)
    prepared = _prepared(context, o)
    with MuJoCoView(prepared.robot, prepared.box) if o.view else nullcontext() as viewer:
        watch = None if viewer is None else viewer.show
        run = prepared.make(
            library=compiled, real_time=o.realtime, priority=o.priority, core=o.core, watch=watch
        )
    try:
        for path in logs:
            write_log(run, path)
    finally:  # a full disk takes the log, and not what the run has shown
        for table in run_tables(prepared, run):
            Console().print(table)
        for text in run_notes(run):
            note(text)
        typer.echo(run_verdict(prepared, run))
    for path in logs:
        typer.echo(f"log: {path}")
    with step_progress(len(films)) if films else nullcontext() as progress:
        for path in films:
            if progress is not None:
                progress(f"draw {path.name}")
            write_film(prepared, run, path)
    for path in films:
        typer.echo(f"film: {path}")
    if run.stopped:
        raise typer.Exit(128 + run.stopped)
    if run.stopped is None and not run_met(prepared, run):
        raise typer.Exit(NOT_MET)


def _prepared(context: typer.Context, o: RunOptions) -> DeployedRun:
    from flexhinf.design import load_design
    from flexhinf.design.deployed_run import Conditions, perturbed, prepare_run
    from flexhinf.design.design_file import is_design_file
    from flexhinf.robot.mujoco import check_expressed

    path = file_of(o.source)
    if not is_design_file(path):
        raise InvalidInput(
            "A run needs a design file, which states robot, start and goal.",
            f"expected design.toml or a report's folder, got {o.source!r}",
            "flexhinf design ROBOT --out DIR, then flexhinf run DIR --mujoco",
        )
    request = request_of(context, o, str(path))
    check_expressed(request.specification.extras)
    robot = perturbed(request.robot, o.perturb)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # `request_of` has told them
        designed = load_design(path)
        controller, _ = controller_of(o.source)
    conditions = Conditions(o.noise, o.load, o.load_at)
    return prepare_run(controller, designed, robot, request.specification, conditions)
