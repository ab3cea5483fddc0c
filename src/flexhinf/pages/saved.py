"""What objects save of themselves, as the files of a report."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

from flexhinf import copies
from flexhinf.errors import InvalidInput
from flexhinf.processors import in_threads

#: Threads that read files at most.
_THREADS = 4


@contextmanager
def saved_files(
    files: Mapping[str, Callable[[Path], object]], beside: bool = True
) -> Generator[Callable[[], dict[str, bytes]]]:
    """A function that gives, once, the contents of files by name, each saved by a function of its path.

    What cannot be saved is left out. `beside`: Another process saves them meanwhile, where there are several; this one
    joins in when it has to wait.
    """
    middle = len(files) // 2 if beside else 0
    halves = [dict(islice(files.items(), *ends)) for ends in ((middle,), (middle, None))]
    with TemporaryDirectory() as folder, ExitStack() as begun:
        parts = [partial(_save, half, folder) for half in halves]
        names = [begun.enter_context(copies.beside(part)) if beside else part for part in parts]
        yield lambda: _contents([name for part in names for name in part()], folder)


def _save(files: Mapping[str, Callable[[Path], object]], folder: str) -> list[str]:
    """Write files into a folder; returns the names of those that can be written."""
    names: list[str] = []
    for name, save in files.items():
        path = Path(folder) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(InvalidInput):  # what cannot be written, as a law that is code, is left out
            save(path)
            names.append(name)
    return names


def _contents(names: Sequence[str], folder: str) -> dict[str, bytes]:
    """What files contain, which are deleted."""

    def taken(name: str) -> bytes:
        path = Path(folder) / name
        content = path.read_bytes()
        path.unlink()
        return content

    return dict(zip(names, in_threads(taken, names, _THREADS)))
