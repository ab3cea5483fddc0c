"""Results in files: each is written under a temporary name and then renamed, so that it is whole or not there.

Arrays end with a digest of all bytes before it, in the comment that a ZIP archive may have: a changed bit is refused,
also where it would give other numbers and no error.

`recorded` tells what has been written so, also where Ctrl-C comes right after the renaming; `locked` keeps others from
the same place meanwhile.
"""

from __future__ import annotations

import ctypes
import errno
import glob
import io
import os
import re
import stat
import sys
import threading
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.validation import array_of, checked_path, late_package, read_bytes, way_to_read

if TYPE_CHECKING:
    import hashlib
    import shutil
    import tempfile
    import zipfile

    import numpy as np
else:
    late = ("hashlib", "shutil", "tempfile", "zipfile", "numpy")
    hashlib, shutil, tempfile, zipfile, np = map(late_package, late)

try:
    import fcntl
except ModuleNotFoundError:  # not on Windows
    fcntl = None

#: Names given, and the device and number of the file or folder that got it, in the order of writing.
_record: ContextVar[list[tuple[Path, tuple[int, int]]] | None] = ContextVar("record", default=None)

#: The mode of new files is read by setting it, for the whole process: two threads at once would leave it at 0.
_umask = threading.Lock()

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

#: How often a file that vanished before it was locked is looked for again.
MOST_TRIES = 1000

#: Seconds after which a left-over is cleared away where no lock can tell whether somebody still writes it.
ABANDONED_AFTER_S = 86400.0

#: How the name of a file ends that is being written; how a symbolic link or a FIFO is not waited for.
_PART = ".part"
_NO_FOLLOWING = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

_DIGEST = 64  # bytes of a SHA-256 in hexadecimal
_LARGEST_FILE, _LARGEST = 16 << 30, 32 << 30  # bytes of an archive, and bytes that it may unpack to


def write_file(path: str | os.PathLike[str], what: str, write: Callable[[str], Any]) -> None:
    """Write a file by `write`, which gets a temporary name in the same folder; then rename it to `path`.

    `path`: No suffix is added. `what`: For the message: "controller", "run". `write`: Takes the temporary name. Raises
    InvalidInput: if this is no path, or the place cannot be written.
    """
    path = checked_path(f"The {what}", path)
    try:
        if path.exists() and not path.is_file():  # a device would be replaced by a file, for everybody
            raise OSError("there is a folder, a pipe or a device of this name")
        with part_file(path.parent, f".{path.name}.") as name:
            write(name)
            make_durable(name)
            publish(name, path)
    except (OSError, ValueError) as error:  # a ValueError: a NUL in the name
        _raise_interruption(error)
        raise InvalidInput(
            f"The {what} cannot be written.",
            f"{path}: {getattr(error, 'strerror', None) or error}",
            "a writable folder that exists",
        ) from error


def write_folder(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files by their names into a folder, all or none; other files there stay.

    They are written under another name first. A new folder then gets its name at once; in one that exists each file
    takes its place, and where one cannot, or on Ctrl-C, the earlier ones are put back. Raises OSError.
    """
    there = folder.exists()
    place = folder if there else folder.parent
    place.mkdir(parents=True, exist_ok=True)
    _clear_stages(place, folder.name)
    stage = Path(tempfile.mkdtemp(dir=place, prefix=_stage_prefix(folder.name)))
    try:
        fresh, earlier = stage / "new", stage / "old"
        for name, content in contents.items():
            (fresh / name).parent.mkdir(parents=True, exist_ok=True)
            (fresh / name).write_bytes(content)
            make_durable(str(fresh / name))
        if not there:
            publish(fresh, folder)
            return
        moved: list[str] = []
        try:
            for name in contents:
                moved.append(name)
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (earlier / name).parent.mkdir(parents=True, exist_ok=True)
                if os.path.lexists(folder / name):
                    os.replace(folder / name, earlier / name)
                publish(fresh / name, folder / name)
        except BaseException:
            for name in reversed(moved):
                if os.path.lexists(earlier / name):
                    os.replace(earlier / name, folder / name)
                elif not (fresh / name).exists():
                    (folder / name).unlink(missing_ok=True)
            raise
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def _stage_prefix(name: str) -> str:
    return f".{name}.flexhinf-files-"


def _clear_stages(place: Path, name: str) -> None:
    """Remove what killed processes had begun to write for a folder of this name, a day ago or earlier."""
    for stage in place.glob(f"{glob.escape(_stage_prefix(name))}*"):
        with suppress(OSError):
            if time.time() - stage.lstat().st_mtime > ABANDONED_AFTER_S and not stage.is_symlink():
                shutil.rmtree(stage, ignore_errors=True)


def check_replaceable(path: Path, what: str, is_own: Callable[[bytes], bool]) -> None:
    """Refuse to replace a file that is there and is none of its kind, such as a design's controller.

    `what`: For the message: "library". `is_own`: Tells by the content whether it is one. Raises InvalidInput.
    """
    if not path.is_file():
        return
    try:
        own = is_own(read_bytes(path, _LARGEST_FILE))
    except (OSError, ValueError):
        own = False
    refuse_if(
        not own,
        f"There is another file in the place of the {what}, and it is left alone.",
        f"expected no file, or a {what} that flexhinf has written; got {path}",
        "another name",
    )


def make_durable(name: str) -> None:
    """Force a file to the disk, and give it the mode of a file that `open` makes."""
    with open(name, "rb") as file:
        os.fsync(file.fileno())
    with _umask:
        mask = os.umask(0)
        os.umask(mask)
    os.chmod(name, 0o666 & ~mask)


def _raise_interruption(error: BaseException) -> None:
    """Raise the Ctrl-C that this error came of: an archive that is left half-way cannot be closed."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):
            raise cause
        cause = cause.__context__


@contextmanager
def part_file(folder: Path, prefix: str, cleared: bool = False) -> Generator[str]:
    """The name of a new file to write and then to rename; it is removed where that does not happen.

    The file is locked until the end of the block, so that others can tell it from one whose process was killed. Of
    those with this prefix nothing is left: they are removed first, unless `clear_parts` has `cleared` them.

    Raises OSError, ValueError: the folder cannot be written.
    """
    if not cleared:
        clear_parts(folder, re.escape(prefix))
    handle, name = _locked_part(folder, prefix)
    try:
        yield name
    finally:
        Path(name).unlink(missing_ok=True)
        if handle >= 0:
            os.close(handle)


def _lock(handle: int) -> Literal["held", "busy", "none"]:
    """Lock an open file without waiting: held from now on, held by another one, or there are no such locks here."""
    if fcntl is None:
        return "none"
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return "busy"
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        return "none"
    return "held"


def _locked_part(folder: Path, prefix: str) -> tuple[int, str]:
    """A new file, and the handle that keeps it locked; -1 where there are no locks."""
    while True:
        handle, name = tempfile.mkstemp(dir=folder, prefix=prefix, suffix=_PART)
        state = _lock(handle)
        if state == "held" and _is_file(handle, name):
            return handle, name
        os.close(handle)
        if state == "none":
            return -1, name
        # else it was taken for a left-over before, or at the very moment when, it was locked


def clear_parts(folder: Path, prefix: str) -> None:
    """Remove the files that killed processes had begun, whose names begin with a prefix, a regular expression: nobody
    holds their lock, or there are none and they are old."""
    begun = re.compile(prefix + r"\w{8}" + re.escape(_PART))
    for path in [folder / name for name in os.listdir(folder) if begun.fullmatch(name)]:
        with suppress(OSError):
            if not stat.S_ISREG(os.lstat(path).st_mode):
                continue
            handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC | _NO_FOLLOWING)
            try:
                state, age = _lock(handle), time.time() - os.fstat(handle).st_mtime
                left = state == "held" or (state == "none" and age > ABANDONED_AFTER_S)
                if left and _is_file(handle, path):
                    os.unlink(path)
            finally:
                os.close(handle)


def _is_file(handle: int, name: str | os.PathLike[str]) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.lstat(name))
    except FileNotFoundError:
        return False


def write_arrays(path: str | os.PathLike[str], what: str, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays as a compressed NumPy archive without pickles, with a digest; see `write_file`."""

    def write(name: str) -> None:
        with open(name, "wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)
        with zipfile.ZipFile(name, "a") as archive:
            archive.comment = b"0" * _DIGEST
        with open(name, "r+b") as file:
            end = os.path.getsize(name) - _DIGEST
            digest = hashlib.sha256(file.read(end)).hexdigest().encode()
            file.seek(end)
            file.write(digest)

    write_file(path, what, write)


def read_arrays(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], bool]:
    """The arrays that `write_arrays` wrote, and whether a digest stands under them (older files have none).

    Raises InvalidInput: not a file, damaged, or no archive of arrays. Its `found` says which, for the reader's own
    message. Raises MemoryError: its arrays do not fit into the memory that is free; nothing is wrong with the file.
    """
    try:
        content = read_bytes(Path(path), _LARGEST_FILE + 1)
    except FileNotFoundError as error:
        raise _unreadable("no such file") from error
    except (OSError, ValueError) as error:
        reason, advice = getattr(error, "strerror", None) or str(error), way_to_read(Path(path), error)
        raise _unreadable(f"{reason} (try: {advice})" if advice else reason) from error
    if len(content) > _LARGEST_FILE:
        raise _unreadable(f"more than {_LARGEST_FILE} bytes")
    whole = content[-_DIGEST:] == hashlib.sha256(memoryview(content)[:-_DIGEST]).hexdigest().encode()
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if archive.comment and not whole:
                raise _unreadable("damaged: its digest is that of another content")
            unpacked = sum(member.file_size for member in archive.infolist())
            if unpacked > min(_LARGEST, 64_000_000 + 2000 * len(content)):
                raise _unreadable(f"an archive of {len(content)} bytes that unpacks to {unpacked}")
            return {
                name.removesuffix(".npy"): array_of(archive.read(name)) for name in archive.namelist()
            }, whole
    except (InvalidInput, MemoryError):
        raise
    except Exception as error:  # whatever a damaged archive makes zipfile, zlib and NumPy raise
        raise _unreadable(f"damaged or not such a file ({type(error).__name__})") from error


def _unreadable(found: str) -> InvalidInput:
    return InvalidInput("The file cannot be read.", found, "the file as it was written")


def publish(temporary: str | os.PathLike[str], path: Path) -> None:
    """Give a finished file or folder its name; `recorded` tells of it from the very moment that it has it."""
    note_written(temporary, path)
    os.replace(temporary, path)


def exchange(temporary: str | os.PathLike[str], path: Path) -> bool:
    """Give a finished folder the name of another one, which gets the temporary name, in one act of the kernel.

    Returns false where this system or file system has no such act; nothing was done then.
    """
    swap = _exchange_of_names()
    note_written(temporary, path)
    return swap is not None and not swap(os.fsencode(temporary), os.fsencode(path))


@cache
def _exchange_of_names() -> Callable[[bytes, bytes], int] | None:
    """The C library's function, as (one, other) → 0 for success."""
    try:
        library: Any = ctypes.CDLL(None)
        if sys.platform == "darwin":
            renamed = library.renamex_np
            renamed.argtypes = (ctypes.c_char_p, ctypes.c_char_p, ctypes.c_uint)
            return lambda path, other: renamed(path, other, 2)
        renamed, here = library.renameat2, -100
        renamed.argtypes = (ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint)
        return lambda path, other: renamed(here, path, here, other, 2)
    except (OSError, TypeError, AttributeError):  # Windows, an old or another C library
        return None


def note_written(temporary: str | os.PathLike[str], path: Path) -> None:
    """Let `recorded` tell of a file or folder that is to get this name, or that has it and gets more files."""
    record = _record.get()
    if record is not None:
        record.append((path, _identity(temporary)))


@contextmanager
def recorded() -> Generator[Callable[[], list[Path]]]:
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
    status = os.stat(path)
    return status.st_dev, status.st_ino


@contextmanager
def locked(path: Path, patience: float = 0.0) -> Generator[Literal["held", "busy", "none"]]:
    """Hold a lock file for the block; it is removed afterwards.

    The lock is the kernel's and ends with the process that holds it, however that ends. It needs no process ids, which
    mean nothing from one container to another.

    `path`: The file, in a folder that exists. `patience`: How long to wait for another one who holds it, s. Yields
    {"held", "busy", "none"}: Held; still held by another one after that time; or there are no such locks here.
    """
    until = time.monotonic() + patience
    handle, state = _acquired(path)
    while state == "busy" and time.monotonic() < until:
        time.sleep(POLL_S)
        handle, state = _acquired(path)
    try:
        yield state
    finally:
        if fcntl is not None and handle >= 0:
            path.unlink(missing_ok=True)
            fcntl.flock(handle, fcntl.LOCK_UN)  # a child process may have a copy of the handle
            os.close(handle)


def _acquired(path: Path) -> tuple[int, Literal["held", "busy", "none"]]:
    """The handle of the lock file, -1 where it is not held, and whether it is."""
    for _ in range(0 if fcntl is None else MOST_TRIES):
        try:
            # never through a symbolic link, which would make a file elsewhere
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | _NO_FOLLOWING, 0o666)
        except OSError as error:
            if error.errno in NO_LOCKS:
                return -1, "none"
            if error.errno != errno.ENOENT or not path.parent.is_dir():
                raise
            continue
        state = _lock(handle)
        if state == "held" and _is_file(handle, path):
            return handle, state
        os.close(handle)
        if state != "held":
            return -1, state
        # else whoever held it has removed the file meanwhile
    return -1, "none"  # a folder that is there and takes no files, as /proc is
