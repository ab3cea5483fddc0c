"""Report folders that others use too: several processes and containers, foreign files, links, pipes, a full disk.

Whoever publishes has a whole report there or an error of ours; whatever was not ours is as it was.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from flexhinf import report
from flexhinf.errors import FlexhinfError
from flexhinf.report.folder import MARKER
from fuzz.tally import Tally

ATTEMPTS = 300

NEW_USER, NEW_PROCESSES, NEW_MOUNTS = 0x10000000, 0x20000000, 0x00020000
"""Flags of the kernel's ``unshare``."""

FILES, SIZE = 8, 20_000
"""Files of a report, and bytes of each."""

TYPED, BROKEN = 3, 4
"""Exit codes of a child: an error of ours; anything else."""


def run(attempts: int, seed: int) -> Tally:
    """One folder, one kind of trouble at a time."""
    tally = Tally("report folders: several processes and containers, foreign files, links, pipes, full disks")
    rng = np.random.default_rng([seed, 8])
    kinds = (_several, _several, _deleted, _foreign, _foreign, _in_the_way, _beside, _read_only, _full)
    with tempfile.TemporaryDirectory() as name:
        for attempt in range(attempts):
            folder = Path(name) / str(attempt)
            folder.mkdir()
            kind = kinds[rng.integers(len(kinds))]
            how = f"seed {seed}, attempt {attempt}, {kind.__name__}"
            try:
                tally.answered(kind(folder, rng), how)
            except Exception as error:
                tally.raised(error, how)
            folder.chmod(0o700)
            shutil.rmtree(folder, ignore_errors=True)
    return tally


# What is published, and what is there -------------------------------------------------------------------
def _publish(target: Path, version: int, size: int = SIZE) -> None:
    text = f"{version:04d}" * (size // 4)
    report.write(target, {"index.html": text, **{f"runs/{k}.txt": text for k in range(FILES - 1)}})


def _version(target: Path) -> int:
    """Version of the report that is there; AssertionError where it is not whole."""
    found = {path.relative_to(target).as_posix() for path in target.rglob("*") if path.is_file()}
    listed = {MARKER, *json.loads((target / MARKER).read_text())["files"]}
    texts = {(target / name).read_text() for name in listed - {MARKER}}
    if found != listed or len(texts) != 1 or len(listed) != FILES + 1:
        raise AssertionError(f"{len(found)} of {len(listed)} files of {len(texts)} versions")
    return int(next(iter(texts))[:4])


def _beside_of(target: Path) -> list[str]:
    return [path.name for path in target.parent.iterdir() if path != target and "flexhinf-" in path.name]


# Other processes ------------------------------------------------------------------------------------
def _forked(works: Iterable[Callable[[], None]]) -> list[int]:
    """Process ids of children that do these, each with a code of `TYPED` or `BROKEN` where it fails."""
    children = []
    for work in works:
        child = os.fork()
        if not child:
            code = 0
            try:
                work()
            except FlexhinfError:
                code = TYPED
            except BaseException as error:
                sys.stderr.write(f"{type(error).__name__}: {error}\n")
                code = BROKEN
            finally:
                os._exit(code)
        children.append(child)
    return children


def _ends(children: Iterable[int]) -> list[int]:
    return [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]


def _unshared(flags: int) -> bool:
    """Whether this process has namespaces of its own from now on."""
    root = os.getuid() == 0
    return ctypes.CDLL(None).unshare(flags if root else flags | NEW_USER) == 0


def _contained(work: Callable[[], None]) -> Callable[[], None]:
    """The work in a child that is the first process of its own namespace, where the system allows that."""

    def inside() -> None:
        _unshared(NEW_PROCESSES)
        code = _ends(_forked([work]))[0]
        os._exit(code if code >= 0 else BROKEN)

    return inside


def _several(folder: Path, rng: np.random.Generator) -> str:
    """Two to four processes publish several times, in one or in several process namespaces; one may be killed."""
    target, count, turns = folder / "r", int(rng.integers(2, 5)), int(rng.integers(2, 5))
    apart, kill = rng.random() < 0.5, rng.random() < 0.4

    def publisher(who: int) -> Callable[[], None]:
        def work() -> None:
            for turn in range(turns):
                _publish(target, 100 * who + turn)

        return _contained(work) if apart else work

    children = _forked(publisher(who) for who in range(1, count + 1))
    if kill and not apart:
        time.sleep(float(rng.uniform(0.0, 0.02)))
        os.kill(children[0], signal.SIGKILL)
    codes = _ends(children)
    if any(code != 0 for code in (codes[1:] if kill and not apart else codes)):
        return f"processes ended with {codes}"
    version = _version(target)
    if version % 100 != turns - 1 and not kill:
        return f"version {version} stands, which was not the last of its process"
    _publish(target, 999)
    left = _beside_of(target)
    return f"{left[0]} is left" if left or _version(target) != 999 else ""


def _deleted(folder: Path, rng: np.random.Generator) -> str:
    """Somebody deletes the report, its parts or its parents while it is written."""
    target = folder / "parent" / "r"
    _publish(target, 1)
    victim = (target, target.parent, target / "runs")[rng.integers(3)]

    def delete() -> None:
        until = time.monotonic() + 0.1
        while time.monotonic() < until:
            for path in (victim, *victim.parent.glob(".r.flexhinf-new*")):
                shutil.rmtree(path, ignore_errors=True)

    def publish() -> None:
        for version in (2, 3, 4):
            _publish(target, version)

    deleting = _forked([delete])
    codes = _ends(_forked([publish]))
    _ends(deleting)
    if codes[0] not in (0, TYPED):
        return f"the process ended with {codes[0]}"
    if (target / "runs").exists():
        shutil.rmtree(target / "runs")
    _publish(target, 9)
    return "" if _version(target) == 9 and not _beside_of(target) else "the next report is not whole"


# Foreign files --------------------------------------------------------------------------------------
def _foreign(folder: Path, rng: np.random.Generator) -> str:
    """The user's own file in a report, or a file of it that was edited or replaced by something else."""
    target = folder / "r"
    _publish(target, 1)
    places = (
        target / "mine.txt",
        target / "runs" / "mine.txt",
        target / "runs" / "0.txt",
        target / "own" / "a",
    )
    place = places[rng.integers(len(places))]
    place.parent.mkdir(exist_ok=True)
    place.unlink(missing_ok=True)
    _MADE[rng.integers(len(_MADE))](place, folder)
    before = _shape(folder)
    try:
        report.check(target)
        _publish(target, 2)
    except FlexhinfError:
        return "" if _shape(folder) == before else "refused, and something else is there now"
    return f"{place.name} was replaced"


def _in_the_way(folder: Path, rng: np.random.Generator) -> str:
    """Something else has the name of the report, of its marker, of its lock or of its parent."""
    target = folder / "p" / "r"
    places = (target, target / MARKER, target.parent / ".r.flexhinf-lock", target.parent)
    place = places[rng.integers(len(places))]
    place.parent.mkdir(parents=True, exist_ok=True)
    made = _MADE[rng.integers(len(_MADE))]
    made(place, folder)
    before = _shape(folder)
    try:
        _publish(target, 2)
    except FlexhinfError as error:
        if _shape(folder) != before:
            return "refused, and something else is there now"
        raise error
    return "" if _version(target.resolve()) == 2 else "no whole report"


def _beside(folder: Path, rng: np.random.Generator) -> str:
    """Names like our own left-overs, of all kinds: what is no folder of ours is not followed nor removed elsewhere."""
    target, precious = folder / "r", folder / "precious"
    precious.mkdir()
    (precious / "a").write_text("years of work")
    _publish(target, 1)
    for kind in ("new", "old"):
        place = folder / f".r.flexhinf-{kind}-{rng.integers(1 << 60):016x}"
        if rng.random() < 0.5:
            place.symlink_to(precious)
        else:
            _MADE[rng.integers(len(_MADE))](place, folder)
    _publish(target, 2)
    kept = (precious / "a").read_text() == "years of work"
    return "" if kept and _version(target) == 2 else "something else was followed or removed"


def _fifo(place: Path, folder: Path) -> None:
    os.mkfifo(place)


def _socket(place: Path, folder: Path) -> None:
    before = Path.cwd()
    os.chdir(place.parent)  # the name of a socket may have a hundred bytes
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(place.name)
    finally:
        os.chdir(before)


def _linked(place: Path, folder: Path) -> None:
    other = folder / "linked"
    other.mkdir(exist_ok=True)
    (other / "a").write_text("mine")
    place.symlink_to(other)


_MADE: tuple[Callable[[Path, Path], object], ...] = (
    lambda place, folder: place.write_text("years of work"),
    lambda place, folder: place.write_bytes(b""),
    lambda place, folder: place.symlink_to(folder / "nowhere"),
    lambda place, folder: place.symlink_to(place),
    lambda place, folder: place.symlink_to("/dev/zero"),
    lambda place, folder: place.mkdir() or (place / "mine").write_text("years of work"),
    _fifo,
    _socket,
    _linked,
)


def _shape(folder: Path) -> dict[str, str]:
    """Everything below a folder: kind and content."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_symlink():
            text = os.readlink(path)
        elif path.is_file():
            text = path.read_text(errors="replace")
        else:
            text = oct(path.lstat().st_mode)
        found[str(path)] = text
    return found


# Places that cannot be written ----------------------------------------------------------------------
def _read_only(folder: Path, rng: np.random.Generator) -> str:
    """The report, or the folder around it, may not be written; as another user where this one is never refused."""
    target = folder / "r"
    folder.chmod(0o777)
    nobody = 65534

    def publish(version: int, user: bool) -> Callable[[], None]:
        def work() -> None:
            if user and os.getuid() == 0:
                os.setuid(nobody)
            _publish(target, version)

        return work

    _publish(target, 1)
    whole = rng.random() < 0.5
    for path in [*target.rglob("*"), target]:
        path.chmod(0o555)
    folder.chmod(0o555 if whole else 0o777)
    for above in (folder.parent, *folder.parent.parents):  # the temporary folder is for its owner only
        if above.stat().st_uid == os.getuid() and not above.stat().st_mode & 0o001:
            above.chmod(above.stat().st_mode | 0o011)
    code = _ends(_forked([publish(2, True)]))[0]
    if code not in (0, TYPED) or (whole and code == 0):
        return f"the process ended with {code}"
    version = _version(target)
    return "" if version == (2 if code == 0 else 1) else f"version {version} stands"


def _full(folder: Path, rng: np.random.Generator) -> str:
    """A disk with little room, where this process may mount one: all of the new report, or all of the old."""
    kilobytes = int(rng.integers(150, 600))
    inodes = int(rng.choice([15, 30, 1000]))

    def work() -> None:
        if not _unshared(NEW_MOUNTS):
            return
        library, options = ctypes.CDLL(None), f"size={kilobytes}k,nr_inodes={inodes}".encode()
        library.mount(b"none", b"/", None, ctypes.c_ulong(1 << 18 | 1 << 14), None)  # private, all of it
        if library.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", ctypes.c_ulong(0), options):
            return
        target, stands = folder / "r", 0
        for version in range(1, 5):
            try:
                _publish(target, version, int(rng.integers(4, 40_000)))
                stands = version
            except FlexhinfError:
                pass
            if (target.exists() or stands) and _version(target) != stands:
                raise AssertionError("another version")
            if [name for name in _beside_of(target) if not name.endswith("-lock")]:
                raise AssertionError("a left-over")

    code = _ends(_forked([work]))[0]
    return "" if code == 0 else f"the process ended with {code}"
