"""``flexhinf paper``: every figure and every claim."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from flexhinf.cli.messages import Progress, note

FOLDER = Path("flexhinf-paper")


def paper(
    out: Annotated[
        Path, typer.Option(help="Folder of the report; an earlier report there is replaced whole.")
    ] = FOLDER,
    gamma_ratio: Annotated[
        float, typer.Option(help="γ/γ*, above 1: attenuation level over the smallest feasible one.")
    ] = 2.0,
    degree: Annotated[
        int, typer.Option(help="Degree of V, 2 to 12; the law has one less. 4 is the paper's cubic law.")
    ] = 4,
    period: Annotated[float, typer.Option(help="Sampling period of estimator and law, s.")] = 1e-3,
    seed: Annotated[int, typer.Option(help="Seed of noise and of the sampled plants.")] = 0,
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
        note(
            f"the paper's arm is odd, so V has no terms of degree {degree}: this is degree {degree - 1} again."
        )
    with Progress(STAGES) as progress:
        result = reproduce(settings, _words(settings, out), progress)
    folder = write(out, result.files)
    _print_claims(result.judged, result.metrics)
    typer.echo(f"report: {folder / 'index.html'}")


def _words(settings: Any, out: Path) -> list[str]:
    """The words that make the same report again."""
    words = ["flexhinf", "paper"]
    for name, value in vars(settings).items():
        words += [f"--{name.replace('_', '-')}", str(value)]
    return words if out == FOLDER else [*words, "--out", out.name]


def _print_claims(judged: Sequence[Any], metrics: dict[str, Any]) -> None:
    """A table of the paper's claims, what fails first, and our own questions below it."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from flexhinf.report import by_verdict, summary

    colours = {"holds": "green", "fails": "red", "ties": "yellow", "not judged": "bright_black"}
    title = (
        f"γ* of the paper's problem = {metrics['gamma_star']:.4f}, γ of its law here = {metrics['gamma']:.4f}"
    )
    console = Console()
    for ours in (False, True):
        claims = by_verdict([one.claim for one in judged if one.ours == ours])
        table = Table(title="Our own question" if ours else title, title_justify="left", show_lines=True)
        table.add_column("claim, and by what it is judged")
        table.add_column("verdict", no_wrap=True)
        for claim in claims:
            text = f"{escape(claim.text)}\n[dim]{escape(claim.criterion)}[/]"
            table.add_row(text, f"[{colours[claim.verdict]}]{claim.verdict}[/]")
        console.print(table)
        if not ours:
            console.print(f"{summary(claims)} No printed curve was compared with a computed one.")
