"""The door for commands. No mathematics here: options come in, rooms do the work, errors go out in three parts."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from flexhinf import __version__
from flexhinf.errors import FlexhinfError, InvalidInput

__all__ = ["app", "main"]

app = typer.Typer(
    name="flexhinf",
    help="Robust nonlinear H∞ control of robots with elastic joints.",
    add_completion=False,
    pretty_exceptions_enable=False,
)

#: Exit code for everything the user can put right; 130 is the shells' code for an interruption.
USER_ERROR, INTERRUPTED = 2, 130


def _version(value: bool) -> None:
    if value:
        typer.echo(f"flexhinf {__version__}")
        raise typer.Exit()


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Robust nonlinear H∞ control of robots with elastic joints."""


@app.command()
def paper(
    out: Annotated[
        Path, typer.Option(help="Folder of the report; an earlier report there is replaced whole.")
    ] = Path("flexhinf-paper"),
    gamma_ratio: Annotated[
        float, typer.Option(help="γ/γ*, above 1: attenuation level over the smallest feasible one.")
    ] = 2.0,
    degree: Annotated[
        int, typer.Option(help="Degree of V, 2 to 12; the law has one less. 4 is the paper's cubic law.")
    ] = 4,
    period: Annotated[float, typer.Option(help="Sampling period of estimator and law, s.")] = 1e-3,
    seed: Annotated[int, typer.Option(help="Seed of noise and of the drawn plants.")] = 0,
    estimator: Annotated[str, typer.Option(help="ukf, ekf, or none (feeds back the true state).")] = "ukf",
    process_noise: Annotated[
        float, typer.Option(help="q of R^v = q I, variance added to each state per sample.")
    ] = 1e-6,
    measurement_noise: Annotated[
        float, typer.Option(help="R^n, variance of the measured link position, rad².")
    ] = 1e-6,
) -> None:
    """Reproduce every figure and judge every claim of Elsa & Akbari (2014)."""
    from flexhinf.paper import STAGES, PaperSettings, reproduce
    from flexhinf.report import check, write

    settings = PaperSettings(gamma_ratio, degree, period, seed, estimator, process_noise, measurement_noise)
    check(out)
    if degree % 2:
        typer.secho(
            f"note: the paper's arm is odd, so V has no terms of degree {degree}: this is degree {degree - 1} again.",
            fg="yellow",
            err=True,
        )
    with _progress(STAGES) as tell:
        result = reproduce(settings, _command(settings, out), tell)
    folder = write(out, result.files)
    _print_claims([judged.claim for judged in result.judged], result.metrics)
    typer.echo(f"report: {folder / 'index.html'}")


@app.command()
def robots() -> None:
    """List the robots that ship with flexhinf, and where their numbers come from."""
    from rich.console import Console

    from flexhinf.design.terminal import robots_table

    Console().print(robots_table())


@app.command()
def design(
    context: typer.Context,
    robot: Annotated[
        str, typer.Argument(help="A robot file (arm.toml), a URDF, or a name that `flexhinf robots` lists.")
    ],
    out: Annotated[
        Path, typer.Option(help="Folder of the report; an earlier report there is replaced whole.")
    ] = Path("flexhinf-design"),
    elastic: Annotated[
        str, typer.Option(help="With a URDF: the robot file with spring and motor of each joint.")
    ] = "",
    goal: Annotated[
        str,
        typer.Option(
            "--pose", "--goal", help="Goal, one position per joint: 0.3,-0.5 (rad, m) or 30deg,-10deg."
        ),
    ] = "",
    start: Annotated[
        str, typer.Option("--from-pose", help="Where the step to it starts. Default: 0.1 rad from the goal.")
    ] = "",
    penalty: Annotated[
        str,
        typer.Option(
            help="Weights: link_position=60,link_position_integral=300, or one per state (integrals last). "
            "Default: the robot file's, or for a bandwidth."
        ),
    ] = "",
    effort: Annotated[float, typer.Option(help="R2, the price of the input; 0 keeps the robot's.")] = 0.0,
    bandwidth: Annotated[
        float, typer.Option(help="Hz, of the default weights; 0: half the lowest vibration with held motors.")
    ] = 0.0,
    gamma_ratio: Annotated[float, typer.Option(help="γ/γ* of the design.")] = 1.5,
    checked_gamma_ratio: Annotated[float, typer.Option(help="γ/γ* of the inequality that is checked.")] = 1.6,
    checked_penalty: Annotated[
        str, typer.Option(help="Weights of the checked inequality. Default: 0.9 × penalty.")
    ] = "",
    degrees: Annotated[
        str, typer.Option(help="Degrees of V to compare: 4, or 2,4,6. Default: by the number of states.")
    ] = "",
    measured: Annotated[
        str,
        typer.Option(
            help="link_position, motor_position, joint_torque, link_velocity, motor_velocity; "
            "NAME_JOINT for single ones."
        ),
    ] = "link_position",
    disturbances: Annotated[
        str, typer.Option(help="Disturbance torques: link_torque,motor_torque. Default: the command instead.")
    ] = "",
    command: Annotated[
        bool,
        typer.Option("--command", help="The command as a disturbance (the paper's), beside --disturbances."),
    ] = False,
    estimator: Annotated[str, typer.Option(help="ukf, ekf, or none (feeds back the true state).")] = "ukf",
    period: Annotated[float, typer.Option(help="Sampling period of estimator and law, s.")] = 1e-3,
    process_noise: Annotated[
        float, typer.Option(help="q of R^v = q I, variance added to each state per sample.")
    ] = 1e-10,
    measurement_noise: Annotated[
        float,
        typer.Option(
            help="R^n, variance of a measured position, rad² or m²; the simulated noise has it too."
        ),
    ] = 1e-8,
    saturation: Annotated[float, typer.Option(help="± limit of every input, V or N·m; 0: none.")] = 0.0,
    extras: Annotated[
        str,
        typer.Option(
            help="What the true plant has beside the model: inductance, joint_damping, "
            "spring_hardening, backlash, coulomb_friction, stribeck_friction."
        ),
    ] = "",
    rays: Annotated[
        int,
        typer.Option(
            help="Directions in which the region is looked at; 0: none; −1: by the number of states."
        ),
    ] = -1,
    duration: Annotated[
        float, typer.Option(help="Length of the step response, s; 0: by the slowest mode.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of directions and noise.")] = 0,
    compare_rigid: Annotated[
        bool, typer.Option(help="Design the same on the rigid model too, and run it on the elastic robot.")
    ] = True,
    mujoco: Annotated[
        bool, typer.Option("--mujoco", help="Run the step on MuJoCo's plant too (needs flexhinf[mujoco]).")
    ] = False,
) -> None:
    """From a robot to a judged controller: modes, γ*, law, region, step response, and a report."""
    import warnings

    from rich.console import Console

    from flexhinf import design as corridor
    from flexhinf.design.terminal import design_tables
    from flexhinf.report import check, write
    from flexhinf.robot import RobotFileWarning, load_robot

    asked = corridor.Specification(
        pose=_angles("pose", goal) if goal else None,
        start=_angles("start pose", start) if start else None,
        penalty=_weights("penalty", penalty),
        effort=_unless_zero(effort),
        bandwidth=_unless_zero(bandwidth),
        gamma_ratio=gamma_ratio,
        checked_gamma_ratio=checked_gamma_ratio,
        checked_penalty=_weights("checked penalty", checked_penalty),
        degrees=_numbers("degrees", degrees, int, "2,4,6") if degrees else None,
        measured=_names(measured),
        disturbances=_names(disturbances) or None,
        command=command,
        estimator=estimator,
        period=period,
        process_noise=process_noise,
        measurement_noise=measurement_noise,
        saturation=_unless_zero(saturation),
        extras=_names(extras),
        rays=None if rays == -1 else rays,
        duration=_unless_zero(duration),
        seed=seed,
        compare_rigid=compare_rigid,
        mujoco=mujoco,
    )
    check(out)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RobotFileWarning)
        arm = load_robot(robot, elastic or None)
    told = [str(warning.message) for warning in caught if issubclass(warning.category, RobotFileWarning)]
    for text in told:
        typer.secho(f"note: {text}", fg="yellow", err=True)
    with _progress(corridor.stages(5 * len(arm.joint_names), asked) + 1) as tell:
        result = corridor.design(arm, asked, tell)
        tell("report")
        files = corridor.design_files(result, _again(context), told)
    folder = write(out, files)
    for table in design_tables(result):
        Console().print(table)
    for text in corridor.notes(result):
        typer.secho(f"note: {text}", fg="yellow", err=True)
    typer.echo(corridor.verdict(result))
    typer.echo(f"report: {folder / 'index.html'}")


def _unless_zero(value: float) -> float | None:
    return None if value == 0.0 else value


def _names(text: str) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _numbers(
    what: str, text: str, kind: Callable[[str], Any] = float, example: str = "60,0,0,0,300"
) -> list[Any]:
    """Numbers between commas."""
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        raise InvalidInput(
            f"The {what} cannot be read.", f"expected numbers between commas, got {text!r}", example
        ) from None


def _weights(what: str, text: str) -> Any:
    """Weights by name, or numbers, between commas; None for nothing."""
    if "=" not in text:
        return tuple(_numbers(what, text)) if text else None
    named = {}
    for part in text.split(","):
        name, _, value = part.partition("=")
        named[name.strip()] = _numbers(what, value)[0]
    return named


def _angles(what: str, text: str) -> list[float]:
    """Angles between commas, in rad, or in degrees with the suffix deg."""

    def angle(part: str) -> float:
        part = part.strip()
        return math.radians(float(part.removesuffix("deg"))) if part.endswith("deg") else float(part)

    return _numbers(what, text, angle, "0.3,-0.5 in rad, or 30deg,-20deg")


def _again(context: typer.Context) -> list[str]:
    """The words that make the same report again: every option that is not its default."""
    words = context.command_path.split()
    for parameter in context.command.params:
        value = context.params.get(str(parameter.name))
        if parameter.param_type_name == "argument":
            words.append(str(value))
        elif isinstance(value, bool) and value != parameter.default:
            words.append((parameter.opts if value else parameter.secondary_opts)[0])
        elif not isinstance(value, bool) and value is not None and str(value) != str(parameter.default):
            words += [parameter.opts[0], value.name if isinstance(value, Path) else str(value)]
    return words


def _command(settings: Any, out: Path) -> list[str]:
    """The words that make the same report again."""
    words = ["flexhinf", "paper"]
    for name, value in vars(settings).items():
        words += [f"--{name.replace('_', '-')}", str(value)]
    return words if out == Path("flexhinf-paper") else [*words, "--out", out.name]


class _progress:
    """A progress bar on the terminal; silent where standard error is not one."""

    def __init__(self, total: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        console = Console(stderr=True)
        columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
        self._bar = Progress(*columns, console=console, transient=True)
        self._task = self._bar.add_task("", total=total)
        self._started = False

    def __enter__(self) -> Any:
        self._bar.start()
        return self._tell

    def _tell(self, text: str) -> None:
        self._bar.update(self._task, advance=1 if self._started else 0, description=text)
        self._started = True

    def __exit__(self, *error: object) -> None:
        self._bar.stop()


def _print_claims(claims: Sequence[Any], metrics: dict[str, Any]) -> None:
    """A short table of the verdicts."""
    from rich.console import Console
    from rich.table import Table

    from flexhinf.report import summary

    colours = {"holds": "green", "fails": "red", "ties": "yellow", "not judged": "bright_black"}
    table = Table(title=f"γ* = {metrics['gamma_star']:.4f}, γ = {metrics['gamma']:.4f}", title_justify="left")
    table.add_column("verdict")
    table.add_column("claim")
    for claim in claims:
        table.add_row(f"[{colours[claim.verdict]}]{claim.verdict}[/]", claim.text)
    console = Console()
    console.print(table)
    console.print(summary(claims))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code. A user's mistake is told in three parts, without a traceback."""
    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        code = app(args=words, prog_name="flexhinf", standalone_mode=False)
        if code == INTERRUPTED:  # the option parser has caught Ctrl-C
            return _tell("Interrupted; nothing was written.", INTERRUPTED)
        return code if isinstance(code, int) else 0
    except FlexhinfError as error:
        return _tell(str(error))
    except TyperException as error:
        return _tell(_three_parts(error, words))
    except (KeyboardInterrupt, typer.Abort):
        return _tell("Interrupted; nothing was written.", INTERRUPTED)


def _three_parts(error: TyperException, words: Sequence[str]) -> str:
    """What the option parser found wrong, in the house's form."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "flexhinf"
    known = getattr(error, "possibilities", None)
    advice = ", ".join(known) if known else f"{path} --help"
    what = error.format_message().split(" (Possible")[0].rstrip(".")
    return str(
        FlexhinfError(f"{what}.", f"expected what `{path} --help` lists, got: {' '.join(words)}", advice)
    )


def _tell(text: str, code: int = USER_ERROR) -> int:
    typer.secho("error: ", fg="red", err=True, nl=False)
    typer.echo(text, err=True)
    return code
