"""Results in files: each is written under a temporary name and then renamed, so that it is whole or not there.

`recorded` tells what has been written so, also where Ctrl-C comes right after the renaming; `locked` keeps others from
the same place meanwhile.
"""

from __future__ import annotations

import errno
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Literal

import numpy as np

from flexhinf.errors import InvalidInput

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None

__all__ = ["locked", "publish", "recorded", "write_arrays", "write_file"]

#: Names given, and the device and number of the file or folder that got it, in the order of writing.
_record: ContextVar[list[tuple[Path, tuple[int, int]]] | None] = ContextVar("record", default=None)

#: What a file system without locks answers.
NO_LOCKS = {
    errno.ENOLCK,
    errno.EOPNOTSUPP,
    errno.ENOSYS,
    errno.EINVAL,
    errno.EROFS,
    errno.EACCES,
    errno.EPERM,
}

#: Between two tries of a lock that another one holds, s.
POLL_S = 0.02


def write_file(path: str | os.PathLike[str], what: str, write: Callable[[str], Any]) -> None:
    """Write a file by `write`, which gets a temporary name in the same folder; then rename it to `path`.

    Parameters
    ----------
    path : path
        No suffix is added.
    what : str
        For the message: "controller", "run".
    write : callable
        Takes the temporary name.

    Raises
    ------
    InvalidInput
        If the place cannot be written.
    """
    path = Path(path)
    name = ""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        os.close(handle)
        write(name)
        with open(name, "rb") as file:
            os.fsync(file.fileno())
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(name, 0o666 & ~mask)
        publish(name, path)
    except OSError as error:
        _remove(name)
        raise InvalidInput(
            f"The {what} cannot be written.",
            f"{path}: {error.strerror or error}",
            "a writable folder that exists",
        ) from error
    except BaseException:
        _remove(name)
        raise


def write_arrays(path: str | os.PathLike[str], what: str, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays as a compressed NumPy archive without pickles; see `write_file`."""

    def write(name: str) -> None:
        with open(name, "wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    write_file(path, what, write)


def publish(temporary: str | os.PathLike[str], path: Path) -> None:
    """Give a finished file or folder its name; `recorded` tells of it from the very moment that it has it."""
    record = _record.get()
    if record is not None:
        record.append((path, _identity(temporary)))
    os.replace(temporary, path)


@contextmanager
def recorded() -> Iterator[Callable[[], list[Path]]]:
    """What is written inside of the block: a function that tells the names, whenever it is asked.

    It looks on the disk for what was to get each name. A list kept after each renaming would miss one that Ctrl-C
    follows.
    """
    record: list[tuple[Path, tuple[int, int]]] = []

    def written() -> list[Path]:
        return [
            path for path, identity in dict(record).items() if path.exists() and _identity(path) == identity
        ]

    token = _record.set(record)
    try:
        yield written
    finally:
        _record.reset(token)


def _identity(path: str | os.PathLike[str]) -> tuple[int, int]:
    found = os.stat(path)
    return found.st_dev, found.st_ino


@contextmanager
def locked(path: Path, patience: float = 0.0) -> Iterator[Literal["held", "busy", "none"]]:
    """Hold a lock file for the block; it is removed afterwards.

    The lock is the kernel's and ends with the process that holds it, however that ends. It needs no process ids, which
    mean nothing from one container to another.

    Parameters
    ----------
    path : Path
        The file, in a folder that exists.
    patience : float
        How long to wait for another one who holds it, s.

    Yields
    ------
    {"held", "busy", "none"}
        Held; still held by another one after that time; or there are no such locks here.
    """
    handle, state, until = -1, "busy", time.monotonic() + patience
    while state == "busy":
        try:
            handle = _acquired(path)
            state = "none" if handle < 0 else "held"
        except BlockingIOError:
            if time.monotonic() >= until:
                break
            time.sleep(POLL_S)
    try:
        yield state
    finally:
        if handle >= 0:
            _remove(str(path))
            if fcntl is not None:
                fcntl.flock(handle, fcntl.LOCK_UN)  # a child process may have a copy of the handle
            os.close(handle)


def _acquired(path: Path) -> int:
    """The handle of the locked file, or -1 where there are no locks; BlockingIOError where another one has it."""
    while fcntl is not None:
        handle = -1
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.exists(path) and os.path.samestat(os.fstat(handle), os.stat(path)):
                return handle
            os.close(
                handle
            )  # whoever held it has removed the file meanwhile: another one is there now, or will be
        except BlockingIOError:
            os.close(handle)
            raise
        except OSError as error:
            if handle >= 0:
                os.close(handle)
            if error.errno in NO_LOCKS:
                return -1
            if error.errno != errno.ENOENT or not path.parent.is_dir():
                raise
    return -1


def _remove(name: str) -> None:
    if name and os.path.exists(name):
        os.unlink(name)
