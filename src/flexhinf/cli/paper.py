"""``flexhinf paper``: every figure and every claim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import typer

from flexhinf.cli.arguments import with_options
from flexhinf.cli.messages import note, step_progress
from flexhinf.cli.options import PaperOptions
from flexhinf.design.options import option_name


@with_options(PaperOptions)
def paper(context: typer.Context, o: PaperOptions) -> None:
    """Reproduce every figure and judge every claim of Elsa & Akbari (2014)."""
    from flexhinf.paper import STAGES, PaperSettings, reproduce
    from flexhinf.report import check, write

    settings = PaperSettings(**{name: value for name, value in asdict(o).items() if name != "out"})
    check(o.out)
    if o.degree % 2:
        note(
            f"the paper's arm is odd, so V has no terms of degree {o.degree}: it is degree {o.degree - 1} again."
        )
    words = ["flexhinf", "paper"]  # every setting, as defaults change
    for name, value in asdict(settings).items():
        words += [option_name(name), str(value)]
    words += [] if o.out == PaperOptions().out else ["--out", o.out.name]
    with step_progress(STAGES) as progress:
        result = reproduce(settings, words, progress)
    folder = write(o.out, result.files)
    _print_claims(result.judged, result.metrics)
    typer.echo(f"report: {folder / 'index.html'}")


def _print_claims(judged: Sequence[Any], metrics: dict[str, Any]) -> None:
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
