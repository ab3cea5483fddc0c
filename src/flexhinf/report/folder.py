"""A report's folder, written as a whole or not at all.

Everything is first written into a hidden folder beside the target, which then takes the target's name. An
earlier report gives way; anything else is left alone. A marker file says what is a report.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Collection, Generator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import cast

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.files import ABANDONED_AFTER_S, exchange, locked, publish
from flexhinf.processors import in_threads
from flexhinf.report.blocks import to_json
from flexhinf.validation import checked_path, file_digest, read_bytes

MARKER = "flexhinf-report.json"

_WHAT = "flexhinf report"

#: Seconds for which a run waits while another one publishes in the same place, which takes less than one.
_PATIENCE = 60.0

#: Threads that compute digests and write files at most.
_THREADS = 4

#: Characters of a file's path, as systems allow; its folders, one within another, are listed each with its whole path.
_LONGEST = 4000

#: Seconds for which the check before a run waits; what another run is publishing is no report to judge yet.
_BRIEFLY = 1.0


def is_report(path: str | os.PathLike[str]) -> bool:
    """Whether a folder is a report of flexhinf, by its marker file."""
    return _marker(Path(path)) is not None


def unchanged(path: str | os.PathLike[str], names: Sequence[str]) -> bool:
    """Whether a folder is a report of flexhinf whose files of these names are there and unchanged."""
    listed = _texts_of(path, "files")
    digests = ((name, _digest(Path(path) / name)) for name in names)
    return all(digest and listed.get(name) == digest for name, digest in digests)


def is_listed(path: str | os.PathLike[str], name: str) -> bool:
    """Whether a report of flexhinf was written with a file of this name."""
    return name in _texts_of(path, "files")


def contents(path: str | os.PathLike[str]) -> dict[str, bytes]:
    """The files of a report by name; InvalidInput where it is none, or one of its files was changed or lost."""
    names, folder = list(_texts_of(path, "files")), Path(path)
    changed = [name for name in names if not unchanged(folder, (name,))]
    refuse_if(
        changed or not names,
        "The files of this report cannot be read.",
        f"expected a report as it was written, in {folder}; changed or lost: {changed or [MARKER]}",
        "a copy of the folder, or its command again",
    )
    return {name: (folder / name).read_bytes() for name in names}


def sources(path: str | os.PathLike[str]) -> dict[str, str]:
    """SHA-256 of the files outside a report that it was made of, by name, as `write` got them; empty if unknown."""
    return _texts_of(path, "sources")


def written_on(path: str | os.PathLike[str]) -> str:
    """The day on which a report was written, such as 2026-11-24 (UTC); empty if unknown."""
    stated = (_marker(Path(path)) or {}).get("date")
    return stated if isinstance(stated, str) else ""


def _texts_of(path: str | os.PathLike[str], key: str) -> dict[str, str]:
    """What a report's marker maps names to under a key; empty if there is no such marker."""
    stated = (_marker(Path(path)) or {}).get(key)
    return cast("dict[str, str]", stated) if isinstance(stated, dict) else {}


def _digest(path: Path) -> str:
    try:
        return file_digest(path)
    except OSError:
        return ""


def _marker(folder: Path) -> dict[str, object] | None:
    try:
        marker = json.loads(read_bytes(folder / MARKER, 10_000_000))  # that of a thousand files has 100,000
    except (OSError, ValueError, RecursionError):
        return None
    known = cast("dict[str, object]", marker) if isinstance(marker, dict) else {}
    return known if known.get("what") == _WHAT else None


def check(path: str | os.PathLike[str]) -> Path:
    """Check before any work that a report can be written to `path`; returns the absolute path, links followed.

    Nothing is changed, but for hidden left-overs of runs that were killed, which are cleared away.

    `path`: a folder that does not exist yet (nor need its parents), an empty one, or an earlier report as it was
    written, without other files or folders in it, and none of its files changed.
    Raises InvalidInput: `path` is a file, a folder that holds something else, the working folder, or cannot be written.
    """
    with _refusals(path) as target:
        if target.parent.is_dir():
            with locked(_lock(target), _BRIEFLY) as state:
                if state != "busy":
                    _clear(target, sure=state == "held")
                    _refuse(target)
        else:
            _refuse(target)
        # Can a folder be made where the target, or the first of its parents, will be?
        above = next(folder for folder in target.parents if folder.exists())
        refuse_if(
            not above.is_dir(),
            "A folder of the path is a file.",
            f"{above} in {target}",
            "another name",
        )
        trial = above / _beside(target, "new").name
        trial.mkdir()
        trial.rmdir()
    return target


@contextmanager
def _refusals(path: str | os.PathLike[str]) -> Generator[Path]:
    """Yield the absolute path, symbolic links followed; errors of the system within the block become `InvalidInput`."""
    try:
        yield checked_path("The report's folder", path).expanduser().resolve()
    except InvalidInput:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        raise InvalidInput(
            "The report's folder cannot be written.",
            f"{path}: {error}",
            "a folder that you may write to, with room",
        ) from error


def write(
    path: str | os.PathLike[str], files: Mapping[str, str | bytes], origins: Mapping[str, str] | None = None
) -> Path:
    """Write a report's folder: `files` and the marker, and nothing else; an earlier report is replaced.

    Interrupted, it leaves what was there before. `path` as in `check`; `files` are contents by relative paths, with
    ``/`` between their parts; text is written as UTF-8. `origins`: SHA-256 of the files that the report was made of,
    by name, for `sources`.
    Raises InvalidInput: as `check`; or a file's name leaves the folder; or the system refuses to write (full disk, …).
    """
    contents: dict[str, bytes] = {}
    for name, content in files.items():
        pure, outside = PurePosixPath(name), "\\" in name or name == MARKER or not name.isprintable()
        refuse_if(
            outside or not pure.parts or ".." in pure.parts or pure.is_absolute() or len(name) > _LONGEST,
            f"A file of a report has a relative path of at most {_LONGEST} characters.",
            f"got {name[:_LONGEST]!r}, {len(name)} characters",
            "figure_03.svg",
        )
        contents[name] = content.encode("utf-8") if isinstance(content, str) else content
    names = sorted(contents)
    digests = in_threads(lambda name: hashlib.sha256(contents[name]).hexdigest(), names, _THREADS)
    marker = {
        "what": _WHAT,
        "version": 2,
        "date": _today(),
        "note": "A new report replaces this folder whole, unless one of these files (SHA-256) was changed.",
        "files": {str(PurePosixPath(name)): digest for name, digest in zip(names, digests)},
        **({"sources": dict(origins)} if origins else {}),
    }
    contents[MARKER] = to_json(marker).encode("utf-8")
    with _refusals(path) as target:
        target.parent.mkdir(parents=True, exist_ok=True)
        with locked(_lock(target), _PATIENCE) as state:
            refuse_if(
                state == "busy",
                "Another run is writing this report.",
                f"{target}: its lock {_lock(target).name} was held for {_PATIENCE:g} s",
                "another folder; or end that run and try again",
            )
            _clear(target, sure=state == "held")
            _refuse(target)
            _replace(target, contents)
    return target


def _today() -> str:
    """UTC; SOURCE_DATE_EPOCH, s, is another time, for builds that must give the same bytes."""
    stated = os.environ.get("SOURCE_DATE_EPOCH", "")
    return time.strftime("%Y-%m-%d", time.gmtime(int(stated) if stated.isdigit() else None))


def _replace(target: Path, contents: Mapping[str, bytes]) -> None:
    fresh = _beside(target, "new")
    try:
        fresh.mkdir()
        for name in contents:
            for folder in reversed(PurePosixPath(name).parents[:-1]):
                (fresh / folder).mkdir(exist_ok=True)  # never `fresh`: who deleted it would delete again
        for _ in in_threads(lambda name: (fresh / name).write_bytes(contents[name]), contents, _THREADS):
            pass
        sizes = {
            str(path.relative_to(fresh).as_posix()): path.stat().st_size
            for path in [path for path in fresh.rglob("*") if path.is_symlink() or not path.is_dir()]
        }
        refuse_if(
            sizes != {str(PurePosixPath(name)): len(content) for name, content in contents.items()},
            "The report's folder was changed while it was written; nothing was published.",
            f"expected {len(contents)} files, got {len(sizes)} in {fresh.name}",
            "write again; and no other program that clears this folder",
        )
        _exchange(fresh, target)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _refuse(target: Path) -> None:
    here, folder = Path.cwd(), target.is_dir()
    refusals = (
        (
            target == here or target in here.parents,
            "The report cannot take the place of the folder you are in, nor of one above it.",
            "a folder below it, for example flexhinf-report",
        ),
        (target.exists() and not folder, "The report needs a folder, and there is a file.", "another name"),
        (
            folder and target.is_mount(),
            "The report replaces its folder whole, and this one is a mount point, which cannot be replaced.",
            f"a folder below it, for example {target / 'report'}",
        ),
        (
            folder and any(target.iterdir()) and not is_report(target),
            f"The folder holds something that is not a report of flexhinf (no {MARKER}), and is left alone.",
            "another name, or an empty folder",
        ),
    )
    for refused, what, hint in refusals:
        refuse_if(refused, what, f"got {target}", hint)
    if folder:
        _refuse_strangers(target, target)


def _refuse_strangers(folder: Path, target: Path) -> None:
    """Raise if the report in `folder` (at `target`, now or before) has foreign files, or files that were changed."""
    marker = _marker(folder)
    if marker is None:
        return
    listed = marker.get("files", ())  # before version 2, a list of names
    digests = cast("dict[str, object]", listed) if isinstance(listed, dict) else {}
    names = cast("Collection[object]", listed) if isinstance(listed, (dict, list)) else ()
    known = {MARKER, *(str(PurePosixPath(name)) for name in names if isinstance(name, str))}
    homes = {str(parent) for name in known for parent in PurePosixPath(name).parents}
    strangers: list[str] = []
    changed: list[str] = []
    for path in sorted(folder.rglob("*")):
        if path.name in (".DS_Store", "Thumbs.db", "desktop.ini") and not path.is_dir():
            continue  # systems put these into folders that somebody looks at
        name = str(path.relative_to(folder).as_posix())
        if name not in (homes if path.is_dir() and not path.is_symlink() else known):
            strangers.append(name)
        elif name in digests:
            digest = "" if path.is_symlink() else _digest(path)  # of a link the digest is no file's
            changed += [name] if digest != digests[name] else []
    if paths := strangers or changed:
        what, hint = "Files of the report were changed", "copy them elsewhere, delete the folder"
        if strangers:
            what, hint = "The report's folder holds files that are not of the report", "move them elsewhere"
        got = f"got {', '.join(map(repr, paths[:3]))}{' …' if len(paths) > 3 else ''} in {target}"
        raise InvalidInput(f"{what}; it is left alone.", got, f"{hint}, or another folder for the report")


def _beside(target: Path, kind: str) -> Path:
    return target.with_name(f".{target.name}.flexhinf-{kind}-{secrets.token_hex(8)}")


def _lock(target: Path) -> Path:
    return target.with_name(f".{target.name}.flexhinf-lock")


def _exchange(fresh: Path, target: Path) -> None:
    """Give `fresh` the target's name; should that fail, the earlier report has, or gets back, its name.

    What was put into the earlier report since it was checked is looked for once nobody finds it by that name any more.
    Where names cannot be exchanged there are two renamings, and for a moment there is no report.
    """
    if not target.exists():
        publish(fresh, target)
    elif exchange(fresh, target):
        try:
            _refuse_strangers(fresh, target)
        except BaseException:
            exchange(fresh, target)
            raise
    else:
        earlier = _beside(target, "old")
        try:
            os.rename(target, earlier)
            _refuse_strangers(earlier, target)
            publish(fresh, target)
        except BaseException:
            if earlier.exists() and not target.exists():
                os.rename(earlier, target)
            raise
        shutil.rmtree(earlier, ignore_errors=True)


def _clear(target: Path, sure: bool) -> None:
    """Delete what killed runs left beside the target; a report that they had moved aside is put back.

    `sure`: the lock is held, so nobody else is writing. Else only what is old is taken for left over.
    """
    for folder in sorted(target.parent.iterdir()):
        match = re.fullmatch(r"\.(?P<name>.+)\.flexhinf-(?P<kind>new|old)-[0-9a-f-]+", folder.name, re.DOTALL)
        if not match or match["name"] != target.name:
            continue
        try:
            old = sure or time.time() - folder.stat().st_mtime > ABANDONED_AFTER_S
        except OSError:
            continue
        if old and folder.is_dir() and not folder.is_symlink():  # else not ours; a pipe would keep us waiting
            if match["kind"] == "old" and is_report(folder) and not target.exists():
                os.rename(folder, target)
            else:
                shutil.rmtree(folder, ignore_errors=True)
