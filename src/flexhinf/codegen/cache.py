"""Object code kept on disk, by the hash of what it was made from; only a file that is exactly right is used.

The folder is the environment variable ``FLEXHINF_CACHE``, else ``flexhinf`` in the user's cache folder; a user
without a home has none. A file is named by its key in hexadecimal digits and holds a magic line, the key, the SHA-256
of the object code, and the object code. It is used only if it is a regular file of the user, all three agree, and the
code can be loaded; it is written under another name and then renamed, so that no reader sees half of it. A file that is
not used is told through `logging`, and replaced. Whatever else lies in the folder is not ours and stays.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flexhinf.files import part_file

_LOGGER = logging.getLogger("flexhinf.codegen")

_MAGIC = b"flexhinf object code 1\n"
_DIGEST = 32
_MOST_FILES = 500  # the oldest go first
_LARGEST = 1 << 28  # bytes; the object code of seven links has some hundred thousand
_NAME = re.compile(r"[0-9a-f]{64}\.o")


def cached(parts: tuple[str, ...], make: Callable[[], bytes], load: Callable[[bytes], Any] = bytes) -> Any:
    """What is loaded from object code in the cache, or from code that is made and kept.

    Parameters
    ----------
    parts : tuple of str
        Everything that the code depends on.
    make : callable
        Makes the code; called when no usable file is there.
    load : callable
        Loads it. What it raises for a file's code means that the file is replaced. By default the code is returned.

    Notes
    -----
    Never raises for the cache's own sake: a folder that cannot be written only costs time.
    """
    key, directory = _key(parts), folder()
    path = None if directory is None else directory / f"{key.hex()}.o"
    if path is not None:
        try:
            if (image := _read(path, key)) is not None:
                return load(image)
        except Exception as reason:  # whatever is wrong with the file, what is made anew is right, or tells
            wrong = " ".join(str(reason).split())[:100]
            _LOGGER.warning("the compiled code %s is not used (%s); it is compiled anew.", path, wrong)
    image = make()
    code = load(image)
    if path is not None:
        _write(path, key, image)
    return code


def folder() -> Path | None:
    """Where object code is kept (the folder may not exist); None where there is no place for it."""
    chosen = os.environ.get("FLEXHINF_CACHE")
    if chosen:
        return Path(os.path.expanduser(chosen))
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/AppData/Local")
    elif sys.platform == "darwin":
        base = os.path.expanduser("~/Library/Caches")
    else:
        wanted = os.environ.get("XDG_CACHE_HOME", "")
        base = wanted if os.path.isabs(wanted) else os.path.expanduser("~/.cache")
    return Path(base) / "flexhinf" if os.path.isabs(base) else None  # of an unknown user "~" is left as it is


def _key(parts: tuple[str, ...]) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        encoded = part.encode()
        digest.update(len(encoded).to_bytes(8, "little"))
        digest.update(encoded)
    return digest.digest()


def _read(path: Path, key: bytes) -> bytes | None:
    """The code in a file; None where there is no file.

    Raises
    ------
    OSError, ValueError
        What is wrong with it.
    """
    try:
        with open(path, "rb", opener=_without_waiting) as file:
            info = os.fstat(file.fileno())
            if not _is_ours(info):
                raise ValueError("it is no file of this user alone")
            if info.st_size > _LARGEST:
                raise ValueError("it is too large")
            content = file.read()
    except FileNotFoundError:
        return None
    head = _MAGIC + key
    image = content[len(head) + _DIGEST :]
    if not image or content[: len(head) + _DIGEST] != head + hashlib.sha256(image).digest():
        raise ValueError("it is damaged")
    return image


def _without_waiting(path: str, flags: int) -> int:
    """Open for reading at once: a FIFO would otherwise keep its reader until somebody writes to it."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _is_ours(info: os.stat_result) -> bool:
    """A regular file of this user that nobody else may write (where the system knows of users)."""
    if not stat.S_ISREG(info.st_mode):
        return False
    if not hasattr(os, "getuid"):
        return True
    return info.st_uid == os.getuid() and not info.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _write(path: Path, key: bytes, image: bytes) -> None:
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with part_file(path.parent, "flexhinf-") as temporary:
            with open(temporary, "wb") as file:
                file.write(_MAGIC + key + hashlib.sha256(image).digest() + image)
            os.replace(temporary, path)
        _prune(path.parent)
    except OSError:
        return


def _prune(directory: Path) -> None:
    """Remove the oldest files of ours beyond `_MOST_FILES`."""
    files = {path: os.lstat(path) for path in directory.iterdir()}
    ours = [path for path, info in files.items() if _NAME.fullmatch(path.name) and _is_ours(info)]
    ours.sort(key=lambda path: files[path].st_mtime)
    for path in ours[: max(0, len(ours) - _MOST_FILES)]:
        if _has_magic(path):
            path.unlink(missing_ok=True)


def _has_magic(path: Path) -> bool:
    with open(path, "rb", opener=_without_waiting) as file:
        return file.read(len(_MAGIC)) == _MAGIC
