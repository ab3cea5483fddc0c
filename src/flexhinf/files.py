"""Results in files: each is written under a temporary name and then renamed, so that it is whole or not there."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput

__all__ = ["write_arrays", "write_file"]


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
        os.replace(name, path)
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


def _remove(name: str) -> None:
    if name and os.path.exists(name):
        os.unlink(name)
