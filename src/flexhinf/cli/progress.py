"""A progress bar on the terminal; silent where standard error is not one."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["Progress"]


class Progress:
    """Around some work; yields what is to be told of each step before it begins.

    Parameters
    ----------
    total : int
        Steps.
    """

    def __init__(self, total: int) -> None:
        from rich import progress
        from rich.console import Console

        columns = (
            progress.BarColumn(),
            progress.MofNCompleteColumn(),
            progress.TimeElapsedColumn(),
            progress.TextColumn("{task.description}"),
        )
        self._bar = progress.Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._bar.add_task("", total=total)
        self._started = False

    def __enter__(self) -> Callable[[str], None]:
        self._bar.start()
        return self._tell

    def _tell(self, text: str) -> None:
        self._bar.update(self._task, advance=1 if self._started else 0, description=text)
        self._started = True

    def __exit__(self, *error: object) -> None:
        self._bar.stop()
