"""A progress bar over degrees, for solves long enough to wonder about."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from flexhinf.polynomial.basis import count

__all__ = ["degree_progress"]

_LONG = 2e9  # estimated operations (about a second) below which nothing is shown


def work(n: int, k: int) -> float:
    """Operations of one change of variables at degree `k`, which dominates that degree."""
    return float(sum(count(n, k - s - 1) * n * count(n, s + 1) for s in range(k)))


@contextmanager
def degree_progress(n: int, degree: int) -> Iterator[Callable[[int], None]]:
    """Yield a callable to be told each degree that is done. Shown on a terminal only, on standard error."""
    total = sum(work(n, k) for k in range(3, degree + 1))
    if total < _LONG or not sys.stderr.isatty():
        yield lambda degree_done: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(f"V to degree {degree}, {n} states", total=total)
        yield lambda degree_done: bar.update(
            task, advance=work(n, degree_done), description=f"degree {degree_done} of {degree} done"
        )
