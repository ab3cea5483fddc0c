"""What commands of flexhinf leave behind, made once in a run of tests.

A command is known by its words, by the files and folders that it names and what these name in turn, and by the digest
of the source and the locks. Where it has run before, its files are copied and its output is repeated. Workers of a
run, `make test`, `make docs` and `make ci` share a store if ``FLEXHINF_TEST_STORE`` names one folder; another run has
another.

    python -m tests.store design planar-two-link --out arm    as `flexhinf design planar-two-link --out arm`
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from tests import served
from tests.served import Outcome

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCE = ("src/flexhinf", "requirements.lock", "requirements-dev.lock", "requirements-docs.lock")
#: Commands whose results are kept: they take longer than to copy what they wrote.
KEPT = {"design", "compare", "campaign", "identify", "estimate", "certify", "export"}
#: Those that replace what they find in their folder, whatever it is.
REPLACE = {"design", "compare"}
#: Variables that change what a command prints or writes.
SETTINGS = ("COLUMNS", "FLEXHINF_OPTIMISATION", "SOURCE_DATE_EPOCH")
#: Columns of the terminal for commands of the documentation, whose tests and site share what these leave behind.
COLUMNS = "160"
#: The variable with the address of an interpreter of `tests.served` for commands, where there is one.
INTERPRETER = "FLEXHINF_TEST_INTERPRETER"
#: How long to wait for another worker that makes the same, s.
PATIENCE = 1200.0


def folder() -> Path | None:
    """The store of this run; None outside of one."""
    place = os.environ.get("FLEXHINF_TEST_STORE")
    return Path(place).absolute() if place else None


def command(words: Sequence[str], work: Path) -> Outcome:
    """Run ``flexhinf WORDS`` in the folder `work`, or bring back what the same command left there before."""
    from flexhinf.files import locked

    store = folder()
    elsewhere = any(Path(word).is_absolute() or ".." in Path(word).parts for word in words)
    if store is None or elsewhere or not words or words[0] not in KEPT or "--help" in words:
        return _run(words, work)
    place = store / _key(words, work)
    store.mkdir(parents=True, exist_ok=True)
    with locked(place.with_suffix(".lock"), patience=PATIENCE) as state:
        if state == "busy":  # rather once more than never
            return _run(words, work)
        if not place.is_dir():
            return _make(words, work, place)
    for made in (place / "files").iterdir():
        _remove(work / made.name)
        _copy(made, work / made.name)
    return _outcome(place)


def _run(words: Sequence[str], work: Path) -> Outcome:
    if address := os.environ.get(INTERPRETER):
        return served.ask(address, served.command, words, work)
    program = [sys.executable, "-m", "flexhinf", *words]
    done = subprocess.run(program, cwd=work, capture_output=True, text=True, check=False)
    return Outcome(done.returncode, done.stdout, done.stderr)


def _make(words: Sequence[str], work: Path, place: Path) -> Outcome:
    """Run the command, and keep what it changed, whole or not at all; what fails is run again."""
    before = {entry.name: _digest(entry) for entry in work.iterdir()}
    outcome = _run(words, work)
    if outcome.code in (0, 1):
        part = Path(mkdtemp(dir=place.parent))
        (part / "files").mkdir()
        for entry in work.iterdir():
            if before.get(entry.name) != _digest(entry):
                _copy(entry, part / "files" / entry.name)
        (part / "outcome.json").write_text(json.dumps(outcome._asdict()), encoding="utf-8")
        if not place.exists():
            part.rename(place)
    return outcome


def _outcome(place: Path) -> Outcome:
    return Outcome(**json.loads((place / "outcome.json").read_text(encoding="utf-8")))


def _key(words: Sequence[str], work: Path) -> str:
    """Of the words and of every file and folder of `work` that they name, or that one of these files names."""
    entries = {entry.name: entry for entry in work.iterdir() if not entry.name.startswith(".")}
    named = {name for name in entries if any(name in word for word in words)}
    own = words[words.index("--out") + 1] if "--out" in words[:-1] else f"flexhinf-{words[0]}"
    named = named - {own} if words[0] in REPLACE else named | {own} & entries.keys()
    todo = list(named)
    while todo:
        entry = entries[todo.pop()]
        text = entry.read_text(encoding="utf-8", errors="replace") if entry.is_file() else ""
        more = {name for name in entries if name in text} - named
        named |= more
        todo += more
    parts = [source_digest(), json.dumps(list(words)), *(os.environ.get(name, "") for name in SETTINGS)]
    parts += [f"{name} {_digest(entries[name])}" for name in sorted(named)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


@cache
def source_digest() -> str:
    """Of all of the source, whatever kind of file, and of the locks."""
    found = hashlib.sha256()
    for name in SOURCE:
        for file in sorted(_files(REPOSITORY / name)):
            if "__pycache__" not in file.parts:
                found.update(f"{file.relative_to(REPOSITORY)}\0".encode() + file.read_bytes())
    return found.hexdigest()


def _digest(entry: Path) -> str:
    found = hashlib.sha256()
    for file in sorted(_files(entry)):
        found.update(f"{file.relative_to(entry)}\0".encode() + hashlib.sha256(file.read_bytes()).digest())
    return found.hexdigest()


def _files(entry: Path) -> Iterator[Path]:
    return (file for file in ([entry] if entry.is_file() else entry.rglob("*")) if file.is_file())


def _copy(source: Path, target: Path) -> None:
    if source.is_dir():
        shutil.copytree(source, target)
    else:
        shutil.copy2(source, target)


def _remove(entry: Path) -> None:
    if entry.is_dir():
        shutil.rmtree(entry)
    else:
        entry.unlink(missing_ok=True)


def main() -> int:
    """As flexhinf."""
    done = command(sys.argv[1:], Path.cwd())
    sys.stdout.write(done.output)
    sys.stderr.write(done.errors)
    return done.code


if __name__ == "__main__":
    sys.exit(main())
