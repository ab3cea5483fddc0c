"""A report's folder, written as a whole or not at all.

Everything is first written into a hidden folder beside the target, which then takes the target's name. An
earlier report gives way; anything else is left alone. A marker file says what is a report.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from flexhinf.errors import InvalidInput
from flexhinf.report.text import to_json

__all__ = ["MARKER", "check", "is_report", "write"]

MARKER = "flexhinf-report.json"

_WHAT = "flexhinf report"
_TEMPORARY = re.compile(r"\.(?P<name>.+)\.flexhinf-(?P<kind>new|old)-(?P<process>\d+)-[0-9a-f]+\Z", re.DOTALL)
_ABANDONED_AFTER = 86400.0  # s, where a process cannot be asked after by its number


def is_report(path: str | os.PathLike[str]) -> bool:
    """Whether a folder is a report of ours, by its marker file."""
    try:
        marker = json.loads((Path(path) / MARKER).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(marker, dict) and marker.get("what") == _WHAT


def check(path: str | os.PathLike[str]) -> Path:
    """Make sure, before any work is done, that a report can be written to `path`.

    Nothing is changed, but for hidden left-overs of runs that were killed, which are cleared away.

    Parameters
    ----------
    path : path
        A folder that does not exist yet (nor need its parents), an empty one, or an earlier report.

    Returns
    -------
    pathlib.Path
        The absolute path, symbolic links followed.

    Raises
    ------
    InvalidInput
        `path` is a file, a folder that holds something else, the working folder, or cannot be written.
    """
    try:
        target = Path(path).expanduser().resolve() if str(path) else None
        if target is None:
            raise InvalidInput(
                "The report needs a folder.", "got an empty path", "for example flexhinf-report"
            )
        _refuse(target)
        _probe(target)
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(
            "The report's folder cannot be written.", f"{path}: {error}", "a folder that you may write to"
        ) from error
    return target


def write(path: str | os.PathLike[str], files: Mapping[str, str | bytes]) -> Path:
    """Write a report's folder: `files` and the marker, and nothing else; an earlier report is replaced.

    Interrupted, it leaves what was there before.

    Parameters
    ----------
    path : path
        As in `check`.
    files : mapping
        Relative path, with ``/`` between its parts, to content; text is written as UTF-8.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    InvalidInput
        As `check`; or a file's name leaves the folder; or the system refuses to write (full disk, …).
    """
    target = check(path)
    for name in files:
        _check_name(name)
    marker = {
        "what": _WHAT,
        "version": 1,
        "note": "A new report replaces this folder whole.",
        "files": sorted(files),
    }
    fresh = _beside(target, "new")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        fresh.mkdir()
        for name, content in {**files, MARKER: to_json(marker)}.items():
            file = fresh / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        _exchange(fresh, target)
    except OSError as error:
        raise InvalidInput(
            "The report could not be written.",
            f"{target}: {error}",
            "more room, or a folder that you may write to",
        ) from error
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    return target


def _refuse(target: Path) -> None:
    """Raise unless `target` is free, empty, or an earlier report."""
    _clear(target)
    here = Path.cwd()
    if target == here or target in here.parents:
        raise InvalidInput(
            "The report cannot take the place of the folder you are in, nor of one above it.",
            f"got {target}",
            "a folder below it, for example flexhinf-report",
        )
    if not target.exists():
        return
    if not target.is_dir():
        raise InvalidInput("The report needs a folder, and there is a file.", f"got {target}", "another name")
    if target.is_mount():
        raise InvalidInput(
            "The report replaces its folder whole, and this one is a mount point, which cannot be replaced.",
            f"got {target}",
            f"a folder below it, for example {target / 'report'}",
        )
    if any(target.iterdir()) and not is_report(target):
        raise InvalidInput(
            "The folder holds something that is not a report of flexhinf, and is left alone.",
            f"expected no folder, an empty one, or one with {MARKER}; got {target}",
            "another name, or an empty folder",
        )


def _probe(target: Path) -> None:
    """Try whether a folder can be made where the target, or the first of its parents, will be."""
    above = next(folder for folder in target.parents if folder.exists())
    if not above.is_dir():
        raise InvalidInput("A folder of the path is a file.", f"{above} in {target}", "another name")
    trial = above / _beside(target, "new").name
    trial.mkdir()
    trial.rmdir()


def _check_name(name: str) -> None:
    parts = PurePosixPath(name).parts
    if not parts or "\\" in name or ".." in parts or PurePosixPath(name).is_absolute() or name == MARKER:
        raise InvalidInput(
            "A file of a report stays inside its folder, and is not the marker.",
            f"expected a relative path, got {name!r}",
            "for example figure_03.svg",
        )


def _beside(target: Path, kind: str) -> Path:
    return target.with_name(f".{target.name}.flexhinf-{kind}-{os.getpid()}-{secrets.token_hex(4)}")


def _exchange(fresh: Path, target: Path) -> None:
    """Give `fresh` the target's name; should that fail, the earlier report gets its name back."""
    if not target.exists():
        os.rename(fresh, target)
        return
    earlier = _beside(target, "old")
    try:
        os.rename(target, earlier)
        os.rename(fresh, target)
    except BaseException:
        if earlier.exists() and not target.exists():
            os.rename(earlier, target)
        raise
    shutil.rmtree(earlier, ignore_errors=True)


def _clear(target: Path) -> None:
    """Clear away what killed runs left beside the target; a report that they had set aside comes back."""
    if not target.parent.is_dir():
        return
    for folder in sorted(target.parent.iterdir()):
        match = _TEMPORARY.match(folder.name)
        if not match or match["name"] != target.name or not _abandoned(folder, int(match["process"])):
            continue
        if match["kind"] == "old" and is_report(folder) and not target.exists():
            os.rename(folder, target)
        else:
            shutil.rmtree(folder, ignore_errors=True)


def _abandoned(folder: Path, process: int) -> bool:
    if os.name == "posix":
        try:
            os.kill(process, 0)
        except (ProcessLookupError, OverflowError):
            return True
        except PermissionError:
            pass
    try:
        return time.time() - folder.stat().st_mtime > _ABANDONED_AFTER
    except OSError:
        return False
