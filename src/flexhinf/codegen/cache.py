"""Object code kept on disk, by the hash of what it was made from; only a file that is exactly right is used.

The folder is the environment variable ``FLEXHINF_CACHE``, else ``flexhinf`` in the user's cache folder. A
file holds a magic line, the key, the SHA-256 of the object code, and the object code. It is used only if it
belongs to the user and all three agree; it is written under another name and then renamed, so that no reader
sees half of it.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

_MAGIC = b"flexhinf object code 1\n"
_DIGEST = 32
_MOST_FILES = 500  # the oldest go first


def cached(parts: tuple[str, ...], make: Callable[[], bytes]) -> bytes:
    """Object code from the cache, or made and kept.

    Parameters
    ----------
    parts : tuple of str
        Everything that the code depends on.
    make : callable
        Makes the code; called when no usable file is there.

    Returns
    -------
    bytes

    Notes
    -----
    Never raises for the cache's own sake: a folder that cannot be written only costs time.
    """
    key = _key(parts)
    path = folder() / f"{key.hex()}.o"
    image = _read(path, key)
    if image is None:
        image = make()
        _write(path, key, image)
    return image


def folder() -> Path:
    """Where object code is kept (the folder may not exist)."""
    chosen = os.environ.get("FLEXHINF_CACHE")
    if chosen:
        return Path(chosen)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/AppData/Local")
    elif sys.platform == "darwin":
        base = os.path.expanduser("~/Library/Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "flexhinf"


def _key(parts: tuple[str, ...]) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        encoded = part.encode()
        digest.update(len(encoded).to_bytes(8, "little"))
        digest.update(encoded)
    return digest.digest()


def _read(path: Path, key: bytes) -> bytes | None:
    try:
        with path.open("rb") as file:
            if not _is_ours(os.fstat(file.fileno())):
                return None
            content = file.read()
    except OSError:
        return None
    head = _MAGIC + key
    image = content[len(head) + _DIGEST :]
    if not image or content[: len(head) + _DIGEST] != head + hashlib.sha256(image).digest():
        return None
    return image


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
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_MAGIC + key + hashlib.sha256(image).digest() + image)
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
        _prune(path.parent)
    except OSError:
        return


def _prune(directory: Path) -> None:
    files = list(directory.glob("*.o"))
    if len(files) <= _MOST_FILES:
        return
    for path in sorted(files, key=lambda path: path.stat().st_mtime)[: len(files) - _MOST_FILES]:
        path.unlink(missing_ok=True)
