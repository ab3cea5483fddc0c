"""``flexhinf export``: a design as what runs on a robot."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexhinf.cli.messages import Progress, note
from flexhinf.errors import InvalidInput
from flexhinf.validation import checked_path, value_text

if TYPE_CHECKING:
    from flexhinf.loop import Controller
    from flexhinf.plant import Plant

app = typer.Typer(help="Write the controller of a design as what runs on a robot.")

Source = Annotated[
    str,
    typer.Argument(
        metavar="DESIGN",
        help="design.toml, the folder of a report, or the file of a controller. The controller of a report is taken as "
        "it was judged; a design.toml without one is designed first.",
        show_default=False,
    ),
]


@app.command("c")
def export_c(
    source: Source,
    out: Annotated[Path, typer.Option(help="A new or empty folder.")] = Path("flexhinf-c"),
    name: Annotated[
        str,
        typer.Option(
            help="A C identifier: of the files, and the beginning of all names.", show_default=False
        ),
    ] = "",
    real: Annotated[str, typer.Option(help="Type of all numbers: double or float.")] = "double",
    period: Annotated[
        str,
        typer.Option(
            help="Period of your firmware's loop; refused if it is not the design's.", show_default=False
        ),
    ] = "",
    flash: Annotated[
        str,
        typer.Option(
            help="Room for code and constants, such as 32kB; refused if they need more. The code is counted for a "
            "Cortex-M4F, where arm-none-eabi-gcc is installed.",
            show_default=False,
        ),
    ] = "",
    ram: Annotated[
        str,
        typer.Option(help="Room for the state, such as 8kB; refused if it needs more.", show_default=False),
    ] = "",
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that is not empty.")] = False,
) -> None:
    """Dependency-free C99: two files, a test vector, and what firmware needs around them.

    `make test` in the folder compiles them and runs the recorded samples: the
    numbers are those of the simulation. README.md there has signals, units,
    memory and cost.
    """
    from flexhinf import export

    if name:
        export.checked_identifier(name)
    folder = export.checked_folder(out, force)
    controller, title = controller_of(source)
    name = name or export.identifier_of(title)
    export.check_room(controller, real, period=period, flash=flash, ram=ram)
    export.write_files(folder, export.controller_files(controller, name, real))
    typer.echo(f"{name}.h, {name}.c and what goes with them: {folder}")
    typer.echo(f"test:  make -C {out} test")


@app.command("fmu")
def export_fmu(
    source: Source,
    out: Annotated[Path, typer.Option(help="The file that is written.")] = Path("flexhinf.fmu"),
    name: Annotated[str, typer.Option(help="A C identifier: the model's name.", show_default=False)] = "",
    plant: Annotated[
        bool,
        typer.Option(
            "--plant", help="The elastic robot instead of the controller, with the design's extras."
        ),
    ] = False,
) -> None:
    """A co-simulation FMU (FMI 2.0) for Simulink, OpenModelica and others.

    Of the controller: one communication step is one sample. With --plant, of
    the robot: motor inputs and disturbances in, measurements and states out,
    its parameters to be set. Needs a C compiler.
    """
    from flexhinf import export

    if plant:
        model, title, period, rest = plant_of(source)
        written = export.export_plant_fmu(model, out, name or export.identifier_of(title), period, *rest)
    else:
        controller, title = controller_of(source)
        written = export.export_fmu(controller, out, name or export.identifier_of(title))
    typer.echo(f"FMU: {written}")


def compile_design(
    source: Source,
    out: Annotated[Path, typer.Option(help="The file that is written.")] = Path("flexhinf-controller.so"),
    processor: Annotated[
        str,
        typer.Option(
            help="On which it runs: portable (PCs since about 2015), any (older ones too, ten times slower), or native "
            "(those that have all that this one has). Others refuse it."
        ),
    ] = "portable",
) -> None:
    """The controller as a shared library that starts in milliseconds.

    fh.load_compiled(FILE) steps it from Python, without LLVM and CasADi; every
    output is the simulation's. For this platform; needs a C compiler.
    """
    from flexhinf import export

    written = export.compile_controller(controller_of(source)[0], out, processor)
    typer.echo(f"library: {written}")


def plant_of(source: str) -> tuple[Plant, str, float, tuple[Any, Any]]:
    """The true plant of a design file, a name for it, the period, and the equilibrium from which its step starts."""
    from flexhinf.design import load_design
    from flexhinf.design.design_file import is_design_file

    path = file_of(source)
    if not is_design_file(path):
        raise InvalidInput(
            "A plant is that of a design file.",
            f"expected design.toml or a report's folder, got {source!r}",
            "flexhinf design ROBOT --out DIR, then flexhinf export fmu DIR --plant",
        )
    robot, s = load_design(path)
    pose = s.start if s.start is not None else s.pose
    return (
        robot.plant(s.measured, extras=s.extras),
        robot.name,
        s.period,
        robot.operating_point(pose, s.extras),
    )


def controller_of(source: str) -> tuple[Controller, str]:
    """The controller of a report, of a file, or of a design that is made now; and a name for it."""
    from flexhinf.design.design_file import is_design_file
    from flexhinf.loop import load_controller
    from flexhinf.report import unchanged

    path = file_of(source)
    if not is_design_file(path):
        _refuse_robot(source, path)
        return load_controller(path), "controller"
    beside = path.parent / "controller"
    if unchanged(path.parent, ("design.toml", "controller")):
        return load_controller(beside), _robot_name(path)
    if beside.exists():
        note("design.toml was changed since the report: it is designed anew.")
    return _designed(path)


def file_of(source: str) -> Path:
    """The file that is meant: of a report's folder its design file; refused where nothing is."""
    from flexhinf.robot import catalogue

    path = checked_path("The design", source)
    found = path / "design.toml" if os.path.isdir(path) else path
    if not os.path.exists(found) and source not in catalogue():
        what = (
            f"folder {value_text(source, 120)} holds no" if found != path else "path leads to no file and no"
        )
        raise InvalidInput(
            f"There is no file or design {value_text(source, 120)}.",
            f"expected design.toml, the folder of a report or the file of a controller; the {what} design.toml",
            "flexhinf design ROBOT --out DIR, then DIR in its place",
        )
    return found


def _refuse_robot(source: str, path: Path) -> None:
    """Refuse a robot, which has no controller yet."""
    from flexhinf.robot import catalogue

    robot = path.suffix.lower() in (".toml", ".urdf", ".xml") or source in catalogue()
    if robot and not Path(source).is_dir() and (path.exists() or source in catalogue()):
        raise InvalidInput(
            "A robot has no controller; a design of it has one.",
            f"expected design.toml, the folder of a report or the file of a controller, got {source!r}",
            f"flexhinf design {source} --out DIR, then DIR in the place of {source}",
        )


def _robot_name(path: Path) -> str:
    from flexhinf.design import load_design

    return load_design(path)[0].name


def _designed(path: Path) -> tuple[Controller, str]:
    from flexhinf.design import design, load_design, stages
    from flexhinf.pages import verdict

    robot, specification = load_design(path)
    with Progress(stages(robot, specification)) as progress:
        result: Any = design(robot, specification, progress)
    note(verdict(result))
    return result.controller(), robot.name
