"""``make bench-frozen``: designs of an earlier commit beside those of the present tree, number by number.

``python -m benchmarks.frozen`` designs with both; ``python -m benchmarks.frozen COMMIT`` with another commit, and
``--after COMMIT`` with another one in place of the present tree, which tells where a number changed. Designs of a
commit are kept in .benchmarks/frozen, and rows in benchmarks/frozen.json, of which ``--table`` makes the table of
docs/architecture.md. It needs the history of the repository.

Compared are the coefficients of V or the numbers of a law for a workspace, γ and γ*, the gains at poses, the poles of
the running loop there, and of each requirement its limit, its number and its verdict.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
KEPT = Path(__file__).with_suffix(".json")
DESIGNS = ROOT / ".benchmarks" / "frozen"

#: The last commit before definitions of designs of one pose and of a workspace were made one, after what governs joints
#: that are far from their command was in.
BEFORE = "80ce51bb"

#: Numbers that differ by less, relative to the largest of their kind, are equal: processors round differently.
ROUNDING = 1e-6

#: Poses of a workspace at which gains and poles are compared.
POSES = 3

#: The designs: a robot, and the fields of its specification that are stated.
DESIGNED: dict[str, tuple[str, dict[str, Any]]] = {
    "paper at 90°, `--preset paper`": ("paper", {"pose": "90deg", "start": "0", "preset": "paper"}),
    "paper at 180°, `--preset paper`": ("paper", {"pose": "180deg", "start": "0", "preset": "paper"}),
    "paper at 90°": ("paper", {"pose": "90deg", "start": "0"}),
    "quanser-rotflex at 45°, `--preset paper`": (
        "quanser-rotflex",
        {"pose": "45deg", "start": "0", "preset": "paper"},
    ),
    "quanser-rotflex at 45°": ("quanser-rotflex", {"pose": "45deg", "start": "0"}),
    "vertical-rig at 30°": ("vertical-rig", {"pose": "30deg", "start": "0"}),
    "planar-two-link at 30°, 60°": ("planar-two-link", {"pose": "30deg,60deg", "start": "0,0"}),
    "planar-two-link, workspace": ("planar-two-link", {}),
    "scara, workspace": ("scara", {}),
    "spatial-three-link, workspace": ("spatial-three-link", {}),
}  # fmt: skip

#: Numbers of a linear loop and of runs that moved.
LOOP = ("poles", "peak sensitivity", "gain margin", "delay margin", "damping of oscillations")
RUNS = ("overshoot", "remaining error", "motion the wrong way", "limit cycle at rest")
#: Why a number is another one: designs whose names begin so, requirements or numbers, the commit, and what it decided.
REASONS: tuple[tuple[str, tuple[str, ...], str, str], ...] = (
    ("quanser-rotflex", (*LOOP, *RUNS), "8b4a68f5", "springs are judged damped"),
    ("vertical-rig", (*LOOP, *RUNS), "8b4a68f5", "springs are judged damped"),
    ("planar-two-link at", (*LOOP, *RUNS), "8b4a68f5", "springs are judged damped"),
    ("planar-two-link at", RUNS[0::2], "399823c0", "every run has the dry friction of the file"),
)


# One tree ---------------------------------------------------------------------------------------------
def designed(robot: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """What a design of the imported package is compared by; of every version since `BEFORE`."""
    import flexhinf as fh

    found = fh.design(fh.load_robot(robot), fh.Specification(**fields))
    evidence: Any = getattr(found, "evidence", found)
    if hasattr(evidence, "synthesis"):
        solution, poses = evidence.solution, [evidence.goal]
        V = [solution.coefficient_array(k) for k in range(2, solution.degree + 1)]
        numbers = {
            "coefficients of V": np.concatenate([np.ravel(part) for part in V]),
            "γ": [evidence.gamma],
            "γ*": [evidence.gamma_star],
            "gains": solution.gain,
        }
    else:
        law, poses = evidence.setup.law, list(evidence.poses[:POSES])
        numbers = {"numbers of the law": law.numbers, "gains": [law.slope_at(pose) for pose in poses]}
    poles = np.concatenate([found.poles(pose) for pose in poses])
    numbers["poles"] = np.concatenate([poles.real, poles.imag])
    keys = ("what", "joint", "where", "limit", "found", "unit", "met")
    return {
        "numbers": {name: np.ravel(values).tolist() for name, values in numbers.items()},
        "requirements": [{key: _plain(getattr(line, key)) for key in keys} for line in evidence.requirements],
    }


def _plain(value: Any) -> str | bool | float:
    return value if isinstance(value, str | bool) else float(value)


def designs(tree: Path, names: Iterable[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The designs of a tree by name, each made in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(tree / "src")}
    for name in names:
        command = [sys.executable, str(Path(__file__).resolve()), "--one", name]
        made = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
        if made.returncode:
            raise SystemExit(f"{name}, in {tree}:\n{made.stderr}")
        yield name, json.loads(made.stdout)


def designs_of(commit: str, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The designs of a commit, those that are kept and others."""
    folder, found = DESIGNS / commit, {}
    for name in names:
        file = folder / f"{list(DESIGNED).index(name)}.json"
        if file.exists() and (kept := json.loads(file.read_text(encoding="utf-8")))["design"] == name:
            found[name] = kept
    missing = [name for name in names if name not in found]
    if not missing:
        return found
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        tree = Path(place) / "tree"
        _git("worktree", "add", "--quiet", "--detach", str(tree), commit)
        try:
            for name, made in designs(tree, missing):
                found[name] = {"design": name, **made}
                file = folder / f"{list(DESIGNED).index(name)}.json"
                file.write_text(json.dumps(found[name]), encoding="utf-8")
        finally:
            _git("worktree", "remove", "--force", str(tree))
    return found


def _git(*words: str) -> str:
    return subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


# Two trees --------------------------------------------------------------------------------------------
def compared(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """What differs between two designs by more than `ROUNDING`, and the largest difference of each kind of number."""
    apart = {name: apart_by(before["numbers"][name], after["numbers"][name]) for name in before["numbers"]}
    lines = []
    for what, first, second in _paired(before["requirements"], after["requirements"]):
        one: Mapping[str, Any] = first or second or {}
        sides = [None if side is None else side["found"] for side in (first, second)]
        line = {"what": what, "where": one["where"], "unit": one["unit"], "found": sides}
        line["limit"] = [None if side is None else side["limit"] for side in (first, second)]
        line["met"] = [None if side is None else side["met"] for side in (first, second)]
        pairs = [(line[key][0], line[key][1]) for key in ("found", "limit")]
        line["same"] = line["met"][0] is line["met"][1] and all(
            one is not None and other is not None and apart_by([one], [other]) <= ROUNDING
            for one, other in pairs
        )
        lines.append(line)
    return {"apart": apart, "requirements": lines}


def apart_by(before: Sequence[float], after: Sequence[float]) -> float:
    """Largest difference relative to the largest number; infinite where there are more of one than of the other."""
    if len(before) != len(after):
        return np.inf
    one, other = np.array(before), np.array(after)
    differ = ~((one == other) | (np.isnan(one) & np.isnan(other)))
    if not differ.any():
        return 0.0
    return float(np.max(np.abs(one - other)[differ]) / np.max(np.abs([one, other])))


def _paired(
    before: Sequence[Mapping[str, Any]], after: Sequence[Mapping[str, Any]]
) -> Iterator[tuple[str, Mapping[str, Any] | None, Mapping[str, Any] | None]]:
    """Lines of one requirement in the order in which they stand; None where one side has none."""
    for what in dict.fromkeys(line["what"] for line in (*before, *after)):
        sides = [[line for line in lines if line["what"] == what] for lines in (before, after)]
        for k in range(max(map(len, sides))):
            yield what, *(side[k] if k < len(side) else None for side in sides)


def reasons(name: str, what: str) -> list[tuple[str, str]]:
    """The commits that changed a number of a design, with what each decided."""
    return [
        (commit, text)
        for begins, numbers, commit, text in REASONS
        if name.startswith(begins) and what in numbers
    ]


def differences(row: Mapping[str, Any]) -> list[str]:
    """The kinds of numbers and the requirements of a row that are not equal."""
    kinds = [name for name, apart in row["apart"].items() if not apart <= ROUNDING]
    return [*kinds, *dict.fromkeys(line["what"] for line in row["requirements"] if not line["same"])]


# Table ------------------------------------------------------------------------------------------------
def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A row for the designs of one outcome: whether law and verdicts are equal, and why numbers are not."""
    outcomes: dict[tuple[str, ...], list[str]] = {}
    for row in rows:
        outcomes.setdefault(_outcome(row), []).append(row["design"])
    lines = [
        "| designs | law, γ | verdicts | other numbers; nearest to its limit | since |",
        "|---|---|---|---|---|",
    ]
    return "\n".join(
        [*lines, *(f"| {'; '.join(each)} | {' | '.join(cells)} |" for cells, each in outcomes.items())]
    )


def _outcome(row: Mapping[str, Any]) -> tuple[str, ...]:
    law = max(apart for name, apart in row["apart"].items() if name != "poles")
    changed = [line for line in row["requirements"] if line["met"][0] is not line["met"][1]]
    verdicts = dict.fromkeys(f"{line['what']}: {_words(line['met'])}" for line in changed)
    since = dict.fromkeys(
        f"{text} ({commit})" for what in differences(row) for commit, text in reasons(row["design"], what)
    )
    equal = "equal" if law <= ROUNDING else f"apart by {law:.1g}"
    return equal, "; ".join(verdicts) or "equal", _moved(row), "; ".join(since) or "–"


def _moved(row: Mapping[str, Any]) -> str:
    """How many requirements have another number, and that of the one that is nearest to its limit."""
    moved = [line for line in row["requirements"] if not line["same"]]
    both = [line for line in moved if None not in line["found"]]
    if not both:
        return f"{len(moved)} requirements" if moved else "none"

    def use(line: Mapping[str, Any]) -> float:
        ratio = line["found"][1] / line["limit"][1] if line["limit"][1] else np.inf
        return min(ratio, 1.0 / ratio) if ratio else 0.0

    nearest = max(both, key=use)
    numbers = " → ".join(f"{value:.4g}" for value in nearest["found"])
    return (
        f"{len(moved)} of {len(row['requirements'])}; {nearest['what']} {numbers} {nearest['unit']}".strip()
    )


def _words(met: Sequence[bool | None]) -> str:
    return " → ".join("not judged" if one is None else "met" if one else "missed" for one in met)


def main(arguments: list[str] | None = None) -> int:
    """Design with both trees and keep the rows, or print what is kept."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.frozen", description=__doc__)
    parser.add_argument("before", nargs="?", default=BEFORE, metavar="COMMIT")
    parser.add_argument("--after", metavar="COMMIT", help="in place of the present tree; nothing is kept")
    parser.add_argument(
        "--designs", nargs="+", choices=list(DESIGNED), default=list(DESIGNED), metavar="NAME"
    )
    parser.add_argument("--kept", type=Path, default=KEPT, metavar="FILE")
    parser.add_argument("--table", action="store_true", help="print the table of the rows that are kept")
    parser.add_argument("--one", choices=list(DESIGNED), help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.one:
        print(json.dumps(designed(*DESIGNED[chosen.one])))
        return 0
    kept = json.loads(chosen.kept.read_text(encoding="utf-8")) if chosen.kept.exists() else {"rows": []}
    if chosen.table:
        print(table(kept["rows"]))
        return 0
    before = designs_of(chosen.before, chosen.designs)
    rows = {row["design"]: row for row in kept["rows"]}
    after = (
        designs_of(chosen.after, chosen.designs).items() if chosen.after else designs(ROOT, chosen.designs)
    )
    for name, made in after:
        rows[name] = {"design": name, "before": chosen.before, **compared(before[name], made)}
        _tell(rows[name])
        if not chosen.after:
            rows[name] |= {"after": _git("describe", "--always", "--dirty"), "versions": _versions()}
            ordered = [rows[design] for design in DESIGNED if design in rows]
            chosen.kept.write_text(json.dumps({"rows": ordered}, indent=1) + "\n", encoding="utf-8")
    return 0


def _tell(row: Mapping[str, Any]) -> None:
    print(row["design"], {name: float(f"{apart:.2g}") for name, apart in row["apart"].items()}, flush=True)
    for line in row["requirements"]:
        if not line["same"]:
            print("   ", *(line[key] for key in ("what", "where", "limit", "found", "met")), flush=True)


def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("numpy", "scipy", "llvmlite")}


if __name__ == "__main__":
    sys.exit(main())
