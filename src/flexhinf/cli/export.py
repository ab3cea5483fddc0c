"""``flexhinf export``: a design as what runs on a robot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexhinf.cli.messages import Progress, note

if TYPE_CHECKING:
    from flexhinf.loop import Controller

__all__ = ["app"]

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
        typer.Option(help="Room for constants, such as 32kB; refused if they need more.", show_default=False),
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
    from flexhinf.export import check_room, checked_folder, controller_files, identifier_of, write_files
    from flexhinf.export.names import checked_identifier

    if name:
        checked_identifier(name)
    folder = checked_folder(out, force)
    controller, title = controller_of(source)
    name = name or identifier_of(title)
    check_room(controller, real, period=period, flash=flash, ram=ram)
    write_files(folder, controller_files(controller, name, real))
    typer.echo(f"{name}.h, {name}.c and what goes with them: {folder}")
    typer.echo(f"test:  make -C {out} test")


def controller_of(source: str) -> tuple[Controller, str]:
    """The controller of a report, of a file, or of a design that is made now; and a name for it."""
    from flexhinf.design.design_file import is_design_file
    from flexhinf.loop import load_controller
    from flexhinf.report import unchanged

    path = Path(source)
    if path.is_dir():
        path = path / "design.toml"
    if not is_design_file(path):
        return load_controller(path), "controller"
    beside = path.parent / "controller"
    if unchanged(path.parent, ("design.toml", "controller")):
        return load_controller(beside), _robot_name(path)
    if beside.exists():
        note("design.toml was changed since the report: it is designed anew.")
    return _designed(path)


def _robot_name(path: Path) -> str:
    from flexhinf.design import load_design

    return load_design(path)[0].name


def _designed(path: Path) -> tuple[Controller, str]:
    from flexhinf.design import design, load_design, report, stages

    robot, specification = load_design(path)
    with Progress(stages(robot, specification)) as progress:
        result: Any = design(robot, specification, progress)
    note(report.verdict(result))
    return result.controller(), robot.name
