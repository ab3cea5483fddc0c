"""``flexhinf certify``: what is proved about a design."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from flexhinf.cli.messages import NOT_MET

__all__ = ["certify"]


def certify(
    check: Annotated[
        Path,
        typer.Option(
            "--check", metavar="FILE", help="A certificate.json to prove again, from its data alone."
        ),
    ],
    threads: Annotated[int, typer.Option(min=1, max=64, help="Threads of the checker.")] = 2,
) -> None:
    """Prove a certificate again: another program than the one that found it reads nothing but the file.

    Prints the theorem with all its hypotheses, what is not proved, and how the check ended. The exit code is 1 where
    the claim is not proved.
    """
    from flexhinf.certify import load_certificate
    from flexhinf.certify.theorem import theorem_text, verification_text

    certificate = load_certificate(check)
    with _counted() as tick:
        found = certificate.check(threads=threads, tick=tick)
    typer.echo(theorem_text(certificate, found))
    typer.echo("")
    typer.echo(verification_text(found))
    if not found.proved:
        raise typer.Exit(NOT_MET)


@contextmanager
def _counted() -> Iterator[Callable[[int], None]]:
    """A count of cells on standard error, silent where that is no terminal; their number is not known before."""
    from rich import progress
    from rich.console import Console

    columns = (
        progress.SpinnerColumn(),
        progress.TextColumn("{task.completed:,} cells"),
        progress.TimeElapsedColumn(),
    )
    bar = progress.Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task("", total=None)
    with bar:
        yield lambda cells: bar.advance(task, cells)
