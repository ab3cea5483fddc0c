"""``flexhinf run``: the controller of a design drives a robot in real time."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexhinf.cli.arguments import Payload, PoseXyz, Tool, request_of, with_specification
from flexhinf.cli.export import controller_of, file_of
from flexhinf.cli.messages import NOT_MET, Progress, note
from flexhinf.design.specification import FIELDS
from flexhinf.errors import InvalidInput

if TYPE_CHECKING:
    from flexhinf.design.deployed_run import DeployedRun
    from flexhinf.export import RealTimeRun

#: Fields of a specification that change a run and not the controller, with an option of ``flexhinf run``.
OF_A_RUN = (
    "pose", "start", "shaping", "move", "tracking_error", "overshoot", "angle_unit", "extras", "delay", "quantisation",
    "measurement_noise",
)  # fmt: skip

ROBOT, CLOCK, FILES = "The robot", "The clock", "What is kept"


@with_specification(*(name for name in FIELDS if name not in OF_A_RUN))
def run_design(
    context: typer.Context,
    source: Annotated[
        str,
        typer.Argument(
            metavar="DESIGN",
            help="design.toml or the folder of a report, whose controller is taken as it was judged; a design.toml "
            "without one is designed first.",
            show_default=False,
        ),
    ],
    mujoco: Annotated[
        bool,
        typer.Option(
            "--mujoco",
            rich_help_panel=ROBOT,
            help="Drive the elastic robot in MuJoCo (needs flexhinf\\[mujoco]).",
        ),
    ] = False,
    library: Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=ROBOT,
            help="Step this shared library of `flexhinf compile` instead of the controller in Python.",
            show_default=False,
        ),
    ] = None,
    payload: Payload = "",
    perturb: Annotated[
        list[str],
        typer.Option(
            rich_help_panel=ROBOT,
            help="Another number in the robot that is driven: stiffness=-20%, friction_elbow=0.4. Several times.",
            metavar="<name=value>",
            show_default=False,
        ),
    ] = [],  # noqa: B006 (typer copies it)
    load: Annotated[
        str,
        typer.Option(
            rich_help_panel=ROBOT,
            help="Torque on every link from --load-at on: 0.5.",
            metavar="<N·m or N>",
            show_default=False,
        ),
    ] = "",
    load_at: Annotated[
        str,
        typer.Option(
            rich_help_panel=ROBOT,
            help="When the load begins; in the middle by default.",
            metavar="<s>",
            show_default=False,
        ),
    ] = "",
    noise: Annotated[
        bool,
        typer.Option("--noise/--no-noise", rich_help_panel=ROBOT, help="Whether measurements have noise."),
    ] = True,
    seed: Annotated[
        str,
        typer.Option(rich_help_panel=ROBOT, help="Seed of the noise.", metavar="<value>", show_default=False),
    ] = "0",
    pose_xyz: PoseXyz = "",
    tool: Tool = "",
    duration: Annotated[
        str,
        typer.Option(
            rich_help_panel=CLOCK,
            help="Length of the run: 3s. Default: that of the design file, or 5 s; of a move its time and half of it "
            "again.",
            metavar="<s>",
            show_default=False,
        ),
    ] = "",
    realtime: Annotated[
        bool,
        typer.Option(
            "--realtime/--no-realtime",
            rich_help_panel=CLOCK,
            help="Whether samples wait for the clock, or follow each other as fast as possible.",
        ),
    ] = True,
    priority: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=CLOCK,
            help="Of SCHED_FIFO, 1 to 99, where the system permits it.",
            show_default=False,
        ),
    ] = None,
    core: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=CLOCK, help="Processor core that the loop is kept on.", show_default=False
        ),
    ] = None,
    view: Annotated[
        bool,
        typer.Option("--view", rich_help_panel=FILES, help="Show the robot in MuJoCo's viewer meanwhile."),
    ] = False,
    log: Annotated[
        list[Path],
        typer.Option(
            rich_help_panel=FILES,
            help="Write everything to a file: .csv or .parquet (PlotJuggler), .mcap (Foxglove). Several times.",
            show_default=False,
        ),
    ] = [],  # noqa: B006
    record: Annotated[
        list[Path],
        typer.Option(
            rich_help_panel=FILES,
            help="Write a film of links and motors: .mp4 or .gif. Several times.",
            show_default=False,
        ),
    ] = [],  # noqa: B006
    **options: Any,
) -> None:
    """The controller of a design drives the robot in MuJoCo, in real time.

    By default it makes the step of the design, or its move: what no option states
    is as in the design file. Options change the run and the robot that is driven,
    never the controller. Ctrl-C ends the run: what was recorded until then is
    written whole.

    Exit code: 0 if every deadline and every requirement was met; 1 if not;
    2 for a mistake; 130 if interrupted.
    """
    file_of(source)
    if not mujoco:
        raise InvalidInput(
            "It is not said which robot is driven.", "expected --mujoco, the robot in MuJoCo, got none", "--mujoco"
        )  # fmt: skip
    from rich.console import Console

    from flexhinf.export import check_log, load_compiled, write_log
    from flexhinf.pages import check_film, run_met, run_notes, run_tables, run_verdict
    from flexhinf.robot.mujoco import check_display

    logs, films = [check_log(path) for path in log], [check_film(path) for path in record]
    if view:
        check_display()
    compiled = None if library is None else load_compiled(library)
    prepared = _prepared(context, source, payload, pose_xyz, tool, perturb, load, load_at, noise)
    with _view(prepared) if view else nullcontext() as watch:
        run = prepared.make(library=compiled, real_time=realtime, priority=priority, core=core, watch=watch)
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
    _write_films(prepared, run, films)
    if run.stopped:
        raise typer.Exit(128 + run.stopped)
    if run.stopped is None and not run_met(prepared, run):
        raise typer.Exit(NOT_MET)


@contextmanager
def _view(prepared: DeployedRun) -> Iterator[Callable[[], bool]]:
    """MuJoCo's viewer: a function that draws the robot as it stands."""
    from flexhinf.robot.mujoco import MuJoCoView

    with MuJoCoView(prepared.robot, prepared.box) as viewer:
        yield viewer.show


def _write_films(prepared: DeployedRun, run: RealTimeRun, films: list[Path]) -> None:
    if not films:
        return
    from flexhinf.pages import write_film

    with Progress(len(films)) as progress:
        for path in films:
            progress(f"draw {path.name}")
            write_film(prepared, run, path)
    for path in films:
        typer.echo(f"film: {path}")


def _prepared(
    context: typer.Context,
    source: str,
    payload: str,
    pose_xyz: str,
    tool: str,
    perturb: list[str],
    load: str,
    load_at: str,
    noise: bool,
) -> DeployedRun:
    """The run that is asked for; everything is checked, and the controller made where it is not there."""
    from flexhinf.design import load_design
    from flexhinf.design.deployed_run import Conditions, perturbed, prepare_run
    from flexhinf.design.design_file import is_design_file
    from flexhinf.design.units import seconds
    from flexhinf.robot.mujoco import check_expressed

    path = file_of(source)
    if not is_design_file(path):
        raise InvalidInput(
            "A run needs a design file, which states robot, start and goal.",
            f"expected design.toml or a report's folder, got {source!r}",
            "flexhinf design ROBOT --out DIR, then flexhinf run DIR --mujoco",
        )
    request = request_of(context, str(path), "", payload, pose_xyz, tool).request
    check_expressed(request.specification.extras)
    robot = perturbed(request.robot, perturb)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # `request_of` has told them
        designed = load_design(path)
        controller, _ = controller_of(source)
    conditions = Conditions(
        noise, request.specification.load if load else None, seconds(load_at) if load_at else None
    )
    return prepare_run(controller, designed, robot, request.specification, conditions)
