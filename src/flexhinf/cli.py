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
def design(
    robot: Annotated[str, typer.Argument(help="Robot: paper is the built-in arm.")],
    degrees: Annotated[str, typer.Option(help="Degrees of V to compare.")] = "2,4,6",
    goal: Annotated[str, typer.Option(help="Goal pose, one angle per joint: 180deg, or 3.14 (rad).")] = "0",
    penalty: Annotated[
        str, typer.Option(help="Weights, one per state (integrals last). Default: the robot's.")
    ] = "",
    effort: Annotated[float, typer.Option(help="R2, the price of the input; 0 keeps the robot's.")] = 0.0,
    gamma_ratio: Annotated[float, typer.Option(help="γ/γ* of the design.")] = 1.5,
    checked_gamma_ratio: Annotated[float, typer.Option(help="γ/γ* of the inequality that is checked.")] = 1.6,
    checked_penalty: Annotated[
        str, typer.Option(help="Weights of the checked inequality. Default: 0.9 × penalty.")
    ] = "",
    rays: Annotated[int, typer.Option(help="Directions in which the region is looked at.")] = 4000,
    seed: Annotated[int, typer.Option(help="Seed of the directions.")] = 0,
) -> None:
    """Choose the degree by data: where can each solution be trusted, and which step fits in it?"""
    from flexhinf.design import shrinking, try_degrees
    from flexhinf.plant import Penalty
    from flexhinf.robot import paper_arm

    if robot != "paper":
        raise InvalidInput(
            "There is no such robot.", f"expected 'paper', got {robot!r}", "flexhinf design paper"
        )
    arm = paper_arm()
    asked = _numbers("degrees", degrees, int)
    price = arm.penalty.effort if effort == 0.0 else effort
    weights = (
        Penalty(tuple(_numbers("penalty", penalty)), price) if penalty else Penalty(arm.penalty.states, price)
    )
    problem = arm.problem(weights, pose=_angles("goal", goal))
    weaker = _numbers("checked penalty", checked_penalty) if checked_penalty else None
    with _progress(2 * len(asked)) as tell:
        choices = list(
            try_degrees(problem, asked, gamma_ratio, checked_gamma_ratio, weaker, rays, seed, tell)
        )
    _print_choices(choices)
    for low, high in shrinking(choices):
        typer.secho(f"note: degree {high} allows a smaller step than degree {low}.", fg="yellow", err=True)


def _numbers(what: str, text: str, kind: Callable[[str], Any] = float) -> list[Any]:
    """Numbers between commas."""
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        raise InvalidInput(
            f"The {what} cannot be read.", f"expected numbers between commas, got {text!r}", "2,4,6"
        ) from None


def _angles(what: str, text: str) -> list[float]:
    """Angles between commas, in rad, or in degrees with the suffix deg."""

    def angle(part: str) -> float:
        part = part.strip()
        return math.radians(float(part.removesuffix("deg"))) if part.endswith("deg") else float(part)

    return _numbers(what, text, angle)


def _print_choices(choices: Sequence[Any]) -> None:
    """A table of what each degree gives."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Where each solution can be trusted: sampled, not proved", title_justify="left")
    for column in ("degree", "law", "V ≤", "step, rad", "°", "residual", "solve, ms", "check, s"):
        table.add_column(column, justify="left" if column == "law" else "right", no_wrap=True)
    names = {2: "linear", 3: "quadratic", 4: "cubic", 5: "quartic", 6: "quintic"}
    for c in choices:
        law = names.get(c.degree, f"degree {c.degree - 1}")
        step = f"{c.step_amplitude:.3f}", f"{math.degrees(c.step_amplitude):.0f}"
        times = f"{1e3 * c.solve_seconds:.1f}", f"{c.check_seconds:.1f}"
        table.add_row(str(c.degree), law, f"{c.level:.4g}", *step, f"{c.residual:.0e}", *times)
    Console().print(table)


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
