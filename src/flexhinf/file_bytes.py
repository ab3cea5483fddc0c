"""Bytes of files, in memory for what is there: not for the most that a reader takes, nor for what a file promises."""

from __future__ import annotations

import hashlib
import io
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

import numpy as np

__all__ = ["array_of", "file_digest", "read_bytes"]


def read_bytes(path: Path, most: int) -> bytes:
    """The first `most` bytes of a regular file, all for −1, in no more memory than they take; nobody is kept waiting
    by a FIFO or a device.

    Raises
    ------
    OSError, ValueError
        There is no such file, it cannot be read, or it is not a regular one.
    """
    with _regular(path) as file:
        step = max(os.fstat(file.fileno()).st_size, 1 << 16)  # what the kernel makes up says that it is empty
        parts, left = [], most
        while left and (part := file.read(min(step, left) if left > 0 else step)):
            parts.append(part)
            left -= len(part) if left > 0 else 0
    return parts[0] if len(parts) == 1 else b"".join(parts)


def file_digest(path: Path) -> str:
    """SHA-256 of a regular file, in hexadecimal, in little memory; raises as `read_bytes`."""
    with _regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def _regular(path: Path) -> Iterator[BufferedReader]:
    """An open file; OSError for a folder, a pipe or a device."""
    with open(path, "rb", opener=_without_waiting) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError("not a file, but a folder, a pipe or a device")
        yield file


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def array_of(content: bytes) -> np.ndarray:
    """An array from its file in an archive; what its head promises beyond the file's own bytes takes no memory."""
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, by_columns, kind = header(file)
    if kind.hasobject or min(shape, default=0) < 0:
        raise ValueError("no array of numbers or texts")
    order = "F" if by_columns else "C"
    return np.ndarray(shape, kind, content, file.tell(), order=order).copy(order)
