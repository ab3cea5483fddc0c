"""Numbers by name that one tree gives for ten designs, four exports, and the help of every command.

`Trees` runs this file as a program of its own for each design, with the package of that tree; so nothing but numpy and
flexhinf is imported. It reads what does not depend on the insides of a tree: `flexhinf.design`, ``requirements``,
``poles`` and ``controller`` of the design, the files of ``design.save``, and ``flexhinf export c``.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DESIGNS = ROOT / ".benchmarks" / "frozen"

#: Version of what is read; files of another one are made anew.
FORMAT = 1

#: The name under which help is kept.
COMMANDS = "commands"

#: What a requirement is compared by.
ROW = ("what", "joint", "where", "limit", "found", "unit", "met")

#: Names that a law's own number has had: in a mapping ``facts`` of the design or of its evidence, as attributes of the
#: evidence or the law, and in the table [result].
FACTS = {"γ": ("gamma", "γ"), "γ*": ("gamma_star", "γ*"), "degree": ("degree",)}

#: Numbers of a report that depend on the machine.
MACHINE = ("cpu_s",)

#: Names of source files end so; other files of an export are about it.
CODE = (".c", ".h", ".cpp", ".hpp")

#: A one-core process: sums have one order, and text one width.
ONE = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONUTF8": "1",
    "COLUMNS": "100",
    "NO_COLOR": "1",
}


@dataclass(frozen=True)
class Case:
    """A design: a robot, the fields of its specification, and poses (rad, m) where gains and poles are read; None: its
    own pose. Those that are exported are exported as C, with doubles."""

    robot: str
    fields: Mapping[str, Any] = field(default_factory=dict)
    poses: tuple[tuple[float, ...] | None, ...] = (None,)
    exported: bool = False


CASES: dict[str, Case] = {
    "paper at 10°, `--preset damped`, EKF": Case(
        "paper", {"pose": "10deg", "start": "0", "preset": "damped", "estimator": "ekf"}
    ),
    "paper at 180°": Case("paper", {"pose": "180deg", "start": "0"}),
    "paper at 90°": Case("paper", {"pose": "90deg", "start": "0"}, exported=True),
    "quanser-rotflex at 45°, `--preset damped`, observer": Case(
        "quanser-rotflex", {"pose": "45deg", "start": "0", "preset": "damped", "estimator": "observer"}
    ),
    "quanser-rotflex at 45°": Case("quanser-rotflex", {"pose": "45deg", "start": "0"}, exported=True),
    "vertical-rig at 30°": Case("vertical-rig", {"pose": "30deg", "start": "0"}),
    "planar-two-link at 30°, 60°": Case("planar-two-link", {"pose": "30deg,60deg", "start": "0,0"}),
    "planar-two-link, workspace": Case(
        "planar-two-link", poses=((0.0, 0.0), (-2.0, 1.5), (1.0, -2.0)), exported=True
    ),
    "scara, workspace": Case(
        "scara",
        poses=((0.0, 0.0, 0.09, 0.0), (-2.0, 2.0, 0.02, 1.0), (1.0, -1.5, 0.16, -2.0)),
        exported=True,
    ),
    "spatial-three-link, workspace": Case(
        "spatial-three-link", poses=((0.0, 0.0, 0.0), (-2.0, 1.0, 2.0), (1.0, -1.5, -1.0))
    ),
}


# One design -------------------------------------------------------------------------------------------
def read_design(case: Case, folder: Path) -> dict[str, Any]:
    """All that a design of the imported package is compared by; its report is written into the folder."""
    import flexhinf as fh

    found = fh.design(fh.load_robot(case.robot), fh.Specification(**case.fields))
    found.save(folder)
    controller = fh.load_controller(folder)
    arrays, options = controller_file(folder / "controller")
    law = {name: values for name, values in arrays.items() if name.startswith("laws.")}
    result = tomllib.loads((folder / "design.toml").read_text(encoding="utf-8"))["result"]
    page = json.loads((folder / "design.json").read_text(encoding="utf-8"))
    groups = {
        "bits": {
            "SHA-256 of the law": digest(law),
            "SHA-256 of the controller": digest(arrays),
            **facts(found, result),
        },
        "controller": {name: plain(values) for name, values in arrays.items()},
        "step": {
            name: plain(controller.data_vector[place]) for name, place in controller.data.places.items()
        },
        "options": options,
        "loop": {name: value for pose in case.poses for name, value in at_pose(found, pose)},
        "result": dict(flat(result)),
        "report": dict(flat(page)),
    }
    rows = [{key: plain(getattr(line, key)) for key in ROW} for line in found.requirements]
    return {
        "met": found.met,
        "requirements": rows,
        "groups": groups,
        "export": read_export(folder) if case.exported else None,
    }


def facts(found: Any, result: Mapping[str, Any]) -> dict[str, Any]:
    """γ, γ* and degree of a law that has them, and its coefficients of V."""
    evidence, law = getattr(found, "evidence", None), found.controller().law
    mappings = [getattr(owner, "facts", None) for owner in (found, evidence)]
    tables = [*(each for each in mappings if isinstance(each, Mapping)), result]
    read: dict[str, Any] = {}
    for name, names in FACTS.items():
        stated = [table.get(key) for table in tables for key in names]
        attributes = [getattr(owner, names[0], None) for owner in (evidence, law)]
        numbers = [value for value in (*stated, *attributes) if isinstance(value, float | int)]
        if numbers:
            read[name] = float(numbers[0])
    if hasattr(law, "coefficient_array"):
        parts = [np.ravel(law.coefficient_array(k)) for k in range(2, law.degree + 1)]
        read["coefficients of V"] = plain(np.concatenate(parts))
    return read


def at_pose(found: Any, pose: Sequence[float] | None) -> Iterator[tuple[str, Any]]:
    """The gains of the law and the poles of the running loop at a pose."""
    where = "its pose" if pose is None else ", ".join(f"{value:g}" for value in pose)
    law, poles = found.controller(pose).law, found.poles(pose)
    yield f"gains at {where}", plain(law.gain if hasattr(law, "gain") else law.slope_at(pose))
    yield f"poles at {where}", plain([poles.real, poles.imag])


def controller_file(file: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The arrays of a saved controller by name, and the settings in its header."""
    with np.load(file) as stored:
        arrays = {name: stored[name] for name in stored.files}
    return arrays, dict(flat(json.loads(str(arrays.pop("header")))))


def digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of the names and bytes of arrays."""
    made = hashlib.sha256()
    for name in sorted(arrays):
        made.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape}".encode())
        made.update(np.ascontiguousarray(arrays[name]).tobytes())
    return made.hexdigest()


def plain(value: Any) -> Any:
    """A text or a truth as it is, a number as a float, an array as a flat list of them."""
    array = np.asarray(value)
    if array.dtype.kind == "U":
        return " ".join(np.ravel(array).tolist())
    if isinstance(value, bool | np.bool_):
        return bool(value)
    return np.ravel(array).astype(float).tolist() if array.ndim else float(array)


def flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Values of nested tables by name, such as ``margins.damping``: numbers, texts, and lists of numbers. Tables in a
    list give a list for each key; rows of requirements, compared on their own, are left out."""
    if isinstance(value, Mapping):
        for key, each in value.items():
            if key not in MACHINE:
                yield from flat(each, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and value and all(isinstance(each, Mapping) for each in value):
        keys = dict.fromkeys(key for each in value for key in each)
        if not {"what", "found"} <= keys.keys():
            for key in keys:
                yield from flat([each.get(key) for each in value], f"{name}[].{key}")
    elif isinstance(value, list):
        leaves = list(_leaves(value))
        if any(isinstance(leaf, Mapping) for leaf in leaves):
            yield from flat([leaf for leaf in leaves if isinstance(leaf, Mapping)], name)
        elif any(isinstance(leaf, str) for leaf in leaves):
            yield name, ", ".join(map(str, leaves))
        else:
            yield name, [np.nan if leaf is None else float(leaf) for leaf in leaves]
    elif value is not None:
        yield name, value if isinstance(value, str | bool) else float(value)


def _leaves(value: Any) -> Iterator[Any]:
    for each in value:
        if isinstance(each, list):
            yield from _leaves(each)
        else:
            yield each


# Its export -------------------------------------------------------------------------------------------
def read_export(folder: Path) -> dict[str, Any]:
    """Digests of the files of exported C, the numbers of its test vectors, and whether it answers as they say; None
    where no compiler is installed."""
    out = folder.parent / "c"
    accepted = ("--accept-unmet", "--accept-estimates", "--no-limits")
    command = (sys.executable, "-m", "flexhinf", "export", "c", folder.name, *accepted, "--out", out.name)
    _said(command, cwd=folder.parent)  # the text of the command is in the files
    files = sorted(each for each in out.rglob("*") if each.is_file())
    digests = {
        each.relative_to(out).as_posix(): hashlib.sha256(lasting(each).encode()).hexdigest() for each in files
    }
    tests = sorted(out.glob("*_test.c"))
    vector = {
        f"{test.stem}: {name}": numbers
        for test in tests
        for name, numbers in c_arrays(test.read_text(encoding="utf-8")).items()
    }
    answers = None
    if shutil.which("make") and shutil.which("cc"):
        _said(["make", "-C", str(out), *(test.stem for test in tests)])
        runs = [subprocess.run([out / test.stem], capture_output=True, check=False) for test in tests]
        answers = not any(run.returncode for run in runs)
    return {"digests": digests, "vector": vector, "answers as recorded": answers}


def lasting(file: Path) -> str:
    """The text of an exported file without dates, digests and commits, which are of the day and of other files, and
    without the comments of code, which have the words of the design."""
    text = file.read_text(encoding="utf-8", errors="replace")
    text = re.sub(r"\b(?:[0-9a-f]{64}|[0-9a-f]{40}|\d{4}-\d\d-\d\d)\b", "", text)
    if file.name.endswith(CODE):
        comment_or_text = re.compile(r'"(?:\\.|[^"\\\n])*"|/\*.*?\*/|//[^\n]*', re.DOTALL)
        text = comment_or_text.sub(lambda found: found[0] if found[0].startswith('"') else "", text)
    return text


def c_arrays(text: str) -> dict[str, list[float]]:
    """The numbers of all constant arrays of a C file by name; of a name that is no number, such as NAN, NaN."""
    arrays = re.findall(r"static const [\w ]+ (\w+)(?:\[[^=\n]*\])+ = \{(.*?)\};", text, re.DOTALL)
    return {
        name: [_c_number(word) for word in re.findall(r"[^\s{},]+", inside)]
        for name, inside in arrays
        if '"' not in inside
    }


def _c_number(word: str) -> float:
    word = word.rstrip("uU") if word.startswith("0x") else word.rstrip("uUlLfF")
    try:
        return float(int(word, 16)) if word.startswith("0x") else float(word)
    except ValueError:
        return -np.inf if word == "-INFINITY" else np.inf if word == "INFINITY" else np.nan


# Its commands -----------------------------------------------------------------------------------------
def read_commands() -> dict[str, Any]:
    """What ``--help`` of every command prints, and ``--help-all`` where there is one."""
    return {"help": dict(_helped(()))}


def _helped(words: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    text = _said([sys.executable, "-m", "flexhinf", *words, "--help"])
    yield " ".join(("flexhinf", *words)), text
    if "--help-all" in text:
        yield (
            " ".join(("flexhinf", *words, "--help-all")),
            _said([sys.executable, "-m", "flexhinf", *words, "--help-all"]),
        )
    for name in commands(text):
        yield from _helped((*words, name))


def commands(text: str) -> list[str]:
    """Commands that the help of a command lists."""
    return re.findall(r"^│ ([a-z][\w-]*) {2,}", text.partition("─ Commands ─")[2], re.MULTILINE)


# Trees ------------------------------------------------------------------------------------------------
def of_tree(tree: Path, names: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """What a tree gives by name, each made in a process of its own."""
    for name in names:
        with tempfile.TemporaryDirectory() as place:
            file = Path(place) / "read.json"
            program = [sys.executable, "-P", str(Path(__file__).resolve()), name, str(file)]
            _said(program, cwd=tree, PYTHONPATH=str(tree / "src"))
            yield name, json.loads(file.read_text(encoding="utf-8"))


def of_commit(commit: str, names: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The same of a commit, kept in .benchmarks/frozen or made anew."""
    folder = DESIGNS / commit
    files = {name: folder / (re.sub(r"\W+", "-", name).strip("-") + ".json") for name in names}
    kept = {
        name: read
        for name, file in files.items()
        if file.exists() and (read := json.loads(file.read_text(encoding="utf-8")))["format"] == FORMAT
    }
    yield from kept.items()
    missing = [name for name in names if name not in kept]
    if not missing:
        return
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        tree = Path(place) / "tree"
        git("worktree", "add", "--quiet", "--detach", str(tree), commit)
        try:
            for name, read in of_tree(tree, missing):
                files[name].write_text(json.dumps(read), encoding="utf-8")
                yield name, read
        finally:
            git("worktree", "remove", "--force", str(tree))


def git(*words: str) -> str:
    """What git says in this repository."""
    return _said(["git", *words], cwd=ROOT).strip()


def _said(command: Sequence[str], cwd: Path | None = None, **environment: str) -> str:
    run = subprocess.run(
        command,
        cwd=cwd,
        env={**os.environ, **ONE, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {run.returncode}:\n{run.stdout}{run.stderr}")
    return run.stdout


def main(name: str, file: str) -> None:
    """Write what the imported package gives under a name."""
    with tempfile.TemporaryDirectory() as place:
        read = read_commands() if name == COMMANDS else read_design(CASES[name], Path(place) / "design")
    Path(file).write_text(json.dumps({"format": FORMAT, **read}), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
