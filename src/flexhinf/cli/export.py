"""``flexhinf export``, ``compile`` and ``run``: a controller as code for a robot, and driving one in real time."""

from __future__ import annotations

import os
import warnings
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from flexhinf import export, pages
from flexhinf.cli.arguments import NOT_MET, note, request_of, show, step_progress, with_options
from flexhinf.cli.options import RUN_FIELDS, CompileOptions, ExportCOptions, ExportFmuOptions, RunOptions
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.validation import checked_path, value_text

if TYPE_CHECKING:
    from flexhinf.design.deployed_run import DeployedRun
    from flexhinf.loop import Controller


app = typer.Typer(help="Write the controller of a design as what runs on a robot.")


@app.command("c")
@with_options(ExportCOptions)
def export_c(context: typer.Context, o: ExportCOptions) -> None:
    """Dependency-free C99: two files, a test vector, and what firmware needs around them.

    `make test` in the folder compiles them and runs the recorded samples: the
    numbers are those of the simulation. README.md there has signals, units,
    memory and cost.
    """
    if o.name:
        export.checked_identifier(o.name)
    folder = export.checked_folder(o.out, o.force)
    controller, title = controller_of(o.source)
    name = o.name or export.identifier_of(title)
    export.check_room(controller, o.real, period=o.period, flash=o.flash, ram=o.ram)
    export.write_files(folder, export.controller_files(controller, name, o.real))
    typer.echo(f"{name}.h, {name}.c and what goes with them: {folder}\ntest:  make -C {o.out} test")


@app.command("fmu")
@with_options(ExportFmuOptions)
def export_fmu(context: typer.Context, o: ExportFmuOptions) -> None:
    """A co-simulation FMU (FMI 2.0) for Simulink, OpenModelica and others.

    Of the controller: one communication step is one sample. With --plant, of
    the robot: motor inputs and disturbances in, measurements and states out,
    its parameters to be set. Needs a C compiler.
    """
    from flexhinf.design import load_design

    if o.plant:
        path = file_of(o.source, "A plant is that of a design file.", "flexhinf export fmu DIR --plant")
        robot, s = load_design(path)
        rest = robot.operating_point(s.pose if s.start is None else s.start, s.extras)
        name = o.name or export.identifier_of(robot.name)
        written = export.export_plant_fmu(
            robot.plant(s.measured, extras=s.extras), o.out, name, s.period, *rest
        )
    else:
        controller, title = controller_of(o.source)
        written = export.export_fmu(controller, o.out, o.name or export.identifier_of(title))
    typer.echo(f"FMU: {written}")


@with_options(CompileOptions)
def compile_design(context: typer.Context, o: CompileOptions) -> None:
    """The controller as a shared library that starts in milliseconds.

    fh.load_compiled(FILE) steps it from Python, without LLVM and CasADi; every
    output is the simulation's. For this platform; needs a C compiler.
    """
    controller, _ = controller_of(o.source)
    typer.echo(f"library: {export.compile_controller(controller, o.out, o.processor)}")


def controller_of(source: str) -> tuple[Controller, str]:
    """The controller of a report, of a file, or of a design that is made now; and a name for it."""
    from flexhinf.design.design_file import is_design_file, load_design
    from flexhinf.loop import load_controller
    from flexhinf.report import unchanged
    from flexhinf.robot import catalogue

    path = file_of(source)
    if not is_design_file(path):
        robot_file = path.suffix.lower() in (".toml", ".urdf", ".xml") and path.exists()
        refuse_if(
            (source in catalogue() or robot_file) and not Path(source).is_dir(),
            "A robot has no controller; a design of it has one.",
            f"expected design.toml, the folder of a report or the file of a controller, got {source!r}",
            f"flexhinf design {source} --out DIR, then DIR in the place of {source}",
        )
        return load_controller(path), "controller"
    robot, specification = load_design(path)
    beside = path.parent / "controller"
    if unchanged(path.parent, ("design.toml", "controller")):
        return load_controller(beside), robot.name
    if beside.exists():
        other = "the controller" if unchanged(path.parent, ("design.toml",)) else "design.toml"
        note(f"{other} was changed since the report: it is designed anew.")
    from flexhinf.design import design, stages

    with step_progress(stages(robot, specification)) as progress:
        result: Any = design(robot, specification, progress)
    note(pages.verdict(result))
    return result.controller(), robot.name


def file_of(source: str, only_design: str = "", then: str = "") -> Path:
    """The file that a source names: of a report's folder its design file; refused where there is none.

    With `only_design`, the first sentence of the refusal, and the command `then`: also where it is no design file.
    """
    from flexhinf.design.design_file import is_design_file
    from flexhinf.robot import catalogue

    path = checked_path("The design", source)
    file = path / "design.toml" if os.path.isdir(path) else path
    what = "path leads to no file and no" if file == path else f"folder {value_text(source, 120)} holds no"
    if not os.path.exists(file) and source not in catalogue():
        raise InvalidInput(
            f"There is no file or design {value_text(source, 120)}.",
            f"expected design.toml, the folder of a report or the file of a controller; the {what} design.toml",
            "flexhinf design ROBOT --out DIR, then DIR in its place",
        )
    refuse_if(
        only_design and not is_design_file(file),
        only_design,
        f"expected design.toml or a report's folder, got {source!r}",
        f"flexhinf design ROBOT --out DIR, then {then}",
    )
    return file


@with_options(RunOptions, RUN_FIELDS)
def run_design(context: typer.Context, o: RunOptions) -> int:
    """The controller of a design drives the robot in MuJoCo, in real time.

    By default it makes the step of the design, or its move: what no option states
    is as in the design file. Options change the run and the robot that is driven,
    never the controller. Ctrl-C ends the run: what was recorded until then is
    written whole.

    Exit code: 0 if every deadline and every requirement was met; 1 if not;
    2 for a mistake; 130 if interrupted.
    """
    file_of(o.source)
    refuse_if(
        not o.mujoco,
        "It is not said which robot is driven.",
        "expected --mujoco, the robot in MuJoCo, got none",
        "--mujoco",
    )
    from flexhinf.robot.mujoco import MuJoCoView, check_display

    logs, films = [export.check_log(path) for path in o.log], [pages.check_film(path) for path in o.record]
    if o.view:
        check_display()
    compiled = None if o.library is None else export.load_compiled(o.library)
    prepared = _prepared(context, o)
    with MuJoCoView(prepared.robot, prepared.box) if o.view else nullcontext() as viewer:
        watch = None if viewer is None else viewer.show
        run = prepared.make(
            library=compiled, real_time=o.realtime, priority=o.priority, core=o.core, watch=watch
        )
    try:
        for path in logs:
            export.write_log(run, path)
    finally:  # a full disk takes the log, and not what the run has shown
        show(pages.run_tables(prepared, run), pages.run_notes(run))
        typer.echo(pages.run_verdict(prepared, run))
    for path in logs:
        typer.echo(f"log: {path}")
    if films:
        with step_progress(len(films)) as progress:
            for path in films:
                progress(f"draw {path.name}")
                pages.write_film(prepared, run, path)
    for path in films:
        typer.echo(f"film: {path}")
    if run.stopped is None:
        return 0 if pages.run_met(prepared, run) else NOT_MET
    return 128 + run.stopped if run.stopped else 0  # 0: the view was closed


def _prepared(context: typer.Context, o: RunOptions) -> DeployedRun:
    from flexhinf.design import load_design
    from flexhinf.design.deployed_run import perturbed, prepare_run
    from flexhinf.robot.mujoco import check_expressed

    needs = "A run needs a design file, which states robot, start and goal."
    path = file_of(o.source, needs, "flexhinf run DIR --mujoco")
    request = request_of(context, o, str(path))
    check_expressed(request.specification.extras)
    robot = perturbed(request.robot, o.perturb)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # `request_of` has told them
        designed = load_design(path)
        controller, _ = controller_of(o.source)
    return prepare_run(controller, designed, robot, request.specification, o.noise, o.load, o.load_at)
