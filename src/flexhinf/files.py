"""Results in files: each is written under a temporary name and then renamed, so that it is whole or not there.

Arrays end with a digest of all bytes before it, in the comment that a ZIP archive may have: a changed bit is refused,
also where it would give other numbers and no error.
"""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput

__all__ = ["read_arrays", "write_arrays", "write_file"]

_DIGEST = 64  # bytes of a SHA-256 in hexadecimal
_LARGEST = 32 << 30  # bytes that an archive may unpack to


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
    """Write arrays as a compressed NumPy archive without pickles, with a digest; see `write_file`."""

    def write(name: str) -> None:
        with open(name, "wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)
        with zipfile.ZipFile(name, "a") as archive:
            archive.comment = b"0" * _DIGEST
        with open(name, "r+b") as file:
            end = os.path.getsize(name) - _DIGEST
            digest = _digest(file.read(end))
            file.seek(end)
            file.write(digest)

    write_file(path, what, write)


def read_arrays(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], bool]:
    """The arrays that `write_arrays` wrote, and whether a digest stands under them (older files have none).

    Raises
    ------
    InvalidInput
        Not a file, damaged, or no archive of arrays. Its `found` says which, for the reader's own message.
    """
    path = Path(path)
    if not path.is_file():  # a pipe would wait for ever
        raise _unreadable("no such file" if not path.exists() else "not a file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise _unreadable(error.strerror or str(error)) from error
    whole = content[-_DIGEST:] == _digest(content[:-_DIGEST])
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if archive.comment and not whole:
                raise _unreadable("damaged: its digest is that of another content")
            unpacked = sum(member.file_size for member in archive.infolist())
            if unpacked > min(_LARGEST, 64_000_000 + 2000 * len(content)):
                raise _unreadable(f"an archive of {len(content)} bytes that unpacks to {unpacked}")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}, whole
    except InvalidInput:
        raise
    except Exception as error:  # whatever a damaged archive makes zipfile, zlib and NumPy raise
        raise _unreadable(f"damaged or not such a file ({type(error).__name__})") from error


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def _unreadable(found: str) -> InvalidInput:
    return InvalidInput("The file cannot be read.", found, "the file as it was written")


def _remove(name: str) -> None:
    if name and os.path.exists(name):
        os.unlink(name)
