"""Change the source in one place at a time, and see whether the tests notice; docs/mutants.md has what was found.

    python -m fuzz.mutants checker                        every change of the checker, quotients and enclosures: hours
    python -m fuzz.mutants all --sample 300 --seed 42     so many of all of src, each room with its share
    python -m fuzz.mutants all --sample 300 --before REV  and the same source with the tests of a revision beside it
    python -m fuzz.mutants FILE ...                       every change of these files

The changes are those of cosmic-ray (``pip install cosmic-ray``) that `OPERATORS` names, and `SWAPS`; messages and
annotations stay as they are. All tests but the nightly ones first run once on a source whose places are marked: so it
is known which ones reach a place, and what each costs. Each change is then made in a copy of the repository, and the
tests that reach it run, quick and cheap ones first, until one fails or `WITHIN` CPU seconds are spent. What the folder
``--out`` has already is not run again.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from fuzz.reach import OUT_OF_TIME

CHECKER = ("certify/checker/*.py", "certify/inequality.py")  # with the enclosures of the search
#: CPU seconds of one change with one set of tests, and the wall time after which it counts as too slow, s.
WITHIN, PATIENCE = 120.0, 900.0
#: Marks of tests that are not tried; those of revisions before there were tiers are `slow` and quick.
LEFT_OUT = "not nightly"
BINARY = (
    "Add_Sub Sub_Add Mul_Div Div_Mul Pow_Mul FloorDiv_Mul Mod_Mul BitAnd_BitOr BitOr_BitAnd LShift_RShift"
)
COMPARISON = "Lt_LtE Lt_Gt LtE_Lt LtE_GtE Gt_GtE Gt_Lt GtE_Gt GtE_LtE Eq_NotEq NotEq_Eq Is_IsNot IsNot_Is"
OPERATORS = (
    *(f"ReplaceBinaryOperator_{pair}" for pair in BINARY.split()),
    *(f"ReplaceComparisonOperator_{pair}" for pair in COMPARISON.split()),
    *(f"ReplaceUnaryOperator_Delete_{sign}" for sign in ("USub", "Not", "Invert")),
    "AddNot", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd",
    "ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "NumberReplacer", "RemoveDecorator", "ZeroIterationForLoop",
)  # fmt: skip
SWAPS = {
    "max": "min", "min": "max", "maximum": "minimum", "minimum": "maximum", "any": "all", "all": "any",
    "ceil": "floor", "floor": "ceil", "upper": "lower", "lower": "upper", "abs": "", "+=": "-=", "-=": "+=",
    "*=": "/=", "/=": "*=", "@": "*",
}  # fmt: skip
WORDS = {"fstring", "raise_stmt", "tfpdef", "annassign", "assert_stmt"}


def changes_of(root: Path, path: Path) -> Iterator[tuple[dict[str, Any], Callable[[], str]]]:
    """Where and what each change of a file is, and what makes the changed text."""
    import cosmic_ray.plugins as plugins
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code

    source = path.read_text(encoding="utf-8")
    lines, nodes = source.split("\n"), list(ast_nodes(get_ast(source)))

    def place(node: Any, what: str) -> dict[str, Any] | None:
        leaf, seen = node.get_first_leaf(), set()
        above = leaf
        while above.parent is not None and above.parent.type not in ("file_input", "suite"):
            above = above.parent
            seen.add(above.type)
        line, column = leaf.start_pos
        returned = leaf.value == "|" and "->" in lines[line - 1]
        if seen & WORDS or returned or "__all__" in lines[above.start_pos[0] - 1]:
            return None
        before = lines[line - 1].strip()
        return {
            "file": str(path.relative_to(root)),
            "line": line,
            "column": column,
            "what": what,
            "before": before,
        }

    for name in OPERATORS:
        operator, count = plugins.get_operator(f"core/{name}")(), 0
        for node in nodes:
            for _ in operator.mutation_positions(node):
                if found := place(node, f"{name} {count}"):
                    yield found, lambda operator=operator, count=count: mutate_code(source, operator, count)
                count += 1
    for leaf in (node for node in nodes if getattr(node, "value", None) in SWAPS):
        called = not leaf.value.isalpha() or (leaf.get_next_leaf() and leaf.get_next_leaf().value == "(")
        if (
            called
            and leaf.parent.type != "decorator"
            and (found := place(leaf, f"{leaf.value} -> {SWAPS[leaf.value]}"))
        ):
            text, column = lines[found["line"] - 1], found["column"]
            begin = text[:column].removesuffix("" if SWAPS[leaf.value] else "np.")
            changed = begin + SWAPS[leaf.value] + text[column + len(leaf.value) :]
            after = [*lines[: found["line"] - 1], changed, *lines[found["line"] :]]
            yield found, lambda after=after: "\n".join(after)


@dataclass(frozen=True)
class Reached:
    """Which tests reach each changed place, of one set of tests.

    `tests`: Of each place the functions that reach it, cheap before dear. `of_rooms`: Of each room its functions, for
    places that are reached as a module is imported.
    """

    tests: dict[int, list[str]]
    of_rooms: dict[str, list[str]]

    def of(self, place: int, room: str) -> list[str]:
        """What is run for a change."""
        return self.tests.get(place) or self.of_rooms.get(room, [])


def room_of(file: str) -> str:
    """The room of a file of src; "(top)" for those beside the rooms."""
    parts = Path(file).parts[2:]
    return parts[0] if len(parts) > 1 else "(top)"


def sample_of(changes: list[Any], number: int, seed: int) -> list[Any]:
    """So many changes, each room with its share of them and three at least."""
    rooms: dict[str, list[Any]] = defaultdict(list)
    for change in changes:
        rooms[room_of(change[0]["file"])].append(change)
    shares = {room: max(3, round(number * len(of) / len(changes))) for room, of in rooms.items()}
    while (over := sum(shares.values()) - number) != 0:
        shares[max(shares, key=lambda room: shares[room])] -= 1 if over > 0 else -1
    draw = random.Random(seed)
    return [change for room in sorted(rooms) for change in draw.sample(rooms[room], shares[room])]


def copied(root: Path, folder: Path, revision: str | None = None) -> Path:
    """A copy of the repository; with the tests and settings of a revision where one is given."""
    copy = Path(
        shutil.copytree(root, folder, ignore=shutil.ignore_patterns(".venv*", ".git", "build", "__pycache__"))
    )
    if revision:
        shutil.rmtree(copy / "tests")
        archive = subprocess.run(
            ["git", "archive", revision, "tests", "pyproject.toml"], cwd=root, capture_output=True, check=True
        )
        with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as tar:
            tar.extractall(copy, filter="data")
        shutil.copy(root / "tests" / "costs.py", copy / "tests")
    return copy


#: Tests with the plugin that says what each cost, and at which places it was.
PYTEST = (sys.executable, "-m", "pytest", "-q", "-p", "fuzz.reach_plugin")


def pytest_in(copy: Path, tests: Sequence[str], **settings: str) -> subprocess.CompletedProcess[bytes]:
    """Run tests of a copy with the plugin of `fuzz.reach`; raises TimeoutExpired."""
    command = [*PYTEST, "-p", "no:cacheprovider", *tests]
    paths = [str(copy / "src"), str(copy), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths)), **settings}
    return subprocess.run(
        command, cwd=copy, env=environment, capture_output=True, timeout=PATIENCE, check=False
    )


def record(copy: Path, changes: list[dict[str, Any]], kept: Path, markers: Sequence[str]) -> None:
    """Run the tests on a source whose places are noted, and keep what each reached and what it cost."""
    places: dict[str, list[tuple[int, int]]] = defaultdict(list)
    for place, change in enumerate(changes):
        places[str(copy / change["file"])].append((change["line"], place))
    part = kept.with_suffix(".part")
    part.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "sitecustomize.py").write_text("import fuzz.reach\n", encoding="utf-8")
        (Path(folder) / "places.json").write_text(json.dumps(places), encoding="utf-8")
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([folder, str(copy / "src"), str(copy)]),
            "FLEXHINF_PLACES": str(Path(folder) / "places.json"),
            "FLEXHINF_REACH": str(part),
        }
        for marker in markers:
            subprocess.run(
                [*PYTEST, "-n", "auto", "--dist", "loadfile", "-m", marker],
                cwd=copy,
                env=environment,
                check=False,
            )
    part.rename(kept)


def reached_by(kept: Path) -> Reached:
    """What a record says; tests that fail on the source as it is notice nothing."""
    cost: dict[str, float] = defaultdict(float)
    places: dict[str, set[int]] = defaultdict(set)
    failing = set()
    for line in kept.read_text(encoding="utf-8").splitlines():
        row = json.loads(line)
        name = row["test"].partition("[")[0]
        cost[name] += row["cost"]
        places[name] |= set(row["places"])
        failing |= {name} if row["ended"] == "failed" else set()
    tests: dict[int, list[str]] = defaultdict(list)
    of_rooms: dict[str, list[str]] = defaultdict(list)
    for name in sorted(cost.keys() - failing, key=lambda name: cost[name]):
        for place in places[name]:
            tests[place].append(name)
        parts = name.partition("::")[0].split("/")
        of_rooms[parts[1] if len(parts) > 2 else "(top)"].append(name)
    return Reached(tests, of_rooms)


def outcome(copy: Path, change: dict[str, Any], text: str, tests: list[str]) -> str:
    """What the tests say of a file with this text: the test that fails, "survived", "out of time" where some were left
    out, or "too slow"."""
    path = copy / change["file"]
    source = path.read_text(encoding="utf-8")
    for old in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        old.unlink()
    path.write_text(text, encoding="utf-8")
    try:
        done = pytest_in(copy, ["-x", "-m", LEFT_OUT, *tests], FLEXHINF_WITHIN=str(WITHIN))
    except subprocess.TimeoutExpired:
        return "too slow"
    finally:
        path.write_text(source, encoding="utf-8")
    if done.returncode in (0, OUT_OF_TIME):
        return "survived" if done.returncode == 0 else "out of time"
    lines = done.stdout.decode().splitlines()
    failed = [line.split()[1] for line in lines if line.startswith(("FAILED", "ERROR"))]
    # what cannot be imported is noticed too
    return failed[0] if failed else "killed" if done.returncode == 1 else f"not run: {lines[-1:]}"


def judged(root: Path, changes: list[Any], out: Path, revision: str | None, jobs: int) -> dict[str, str]:
    """How each change ended with one set of tests, which is kept in `out` as it goes on."""
    name = revision or "now"
    kept, rows = out / f"{name}-reach.jsonl", out / f"{name}.jsonl"
    known = [json.loads(line) for line in rows.read_text().splitlines()] if rows.exists() else []
    ended = {json.dumps(row["change"]): row["ended"] for row in known}
    with tempfile.TemporaryDirectory() as folder:
        first = copied(root, Path(folder) / "0", revision)
        if not kept.exists():
            markers = ("not slow", "slow") if revision else ("not ci and not nightly", "ci and not nightly")
            record(first, [change for change, _ in changes], kept, markers)
        reach = reached_by(kept)
        free: SimpleQueue[Path] = SimpleQueue()
        for number in range(jobs):
            free.put(first if number == 0 else copied(root, Path(folder) / str(number), revision))

        todo = [place for place, (change, _) in enumerate(changes) if json.dumps(change) not in ended]
        texts = {place: changes[place][1]() for place in todo}

        def judge(place: int) -> None:
            change = changes[place][0]
            tests = reach.of(place, room_of(change["file"]))
            copy = free.get()
            try:
                found = outcome(copy, change, texts[place], tests) if tests else "survived"
            finally:
                free.put(copy)
            ended[json.dumps(change)] = found
            with rows.open("a") as file:
                print(json.dumps({"change": change, "ended": found}), file=file, flush=True)
            print(name, len(ended), found, *change.values(), flush=True)

        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(judge, todo))
    return ended


def tally(ended: dict[str, str]) -> dict[str, Counter[str]]:
    """Of each room how many changes ended in each way."""
    found: dict[str, Counter[str]] = defaultdict(Counter)
    for change, how in ended.items():
        word = (
            how if how in ("survived", "too slow", "out of time") or how.startswith("not run") else "killed"
        )
        found[room_of(json.loads(change)["file"])][word] += 1
    return found


def main() -> None:
    """Draw, record, change, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.mutants", description=__doc__.split("\n")[0])
    parser.add_argument("what", nargs="+", help="checker, all, or files")
    parser.add_argument("--sample", type=int, help="so many of the changes, each room with its share")
    parser.add_argument("--seed", type=int, default=42)
    parser.add_argument("--before", help="a revision whose tests are tried too, on the source as it is")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("build/mutants"))
    given = parser.parse_args()
    root, out = Path(__file__).resolve().parents[1], given.out.absolute()
    package = root / "src" / "flexhinf"
    patterns = {"checker": CHECKER, "all": ("**/*.py",)}.get(given.what[0])
    files = [path for pattern in patterns or () for path in sorted(package.glob(pattern))]
    changes = [
        change
        for path in files or map(Path.resolve, map(Path, given.what))
        for change in changes_of(root, path)
    ]
    if given.sample:
        changes = sample_of(changes, given.sample, given.seed)
    out.mkdir(parents=True, exist_ok=True)
    sets = [judged(root, changes, out, revision, given.jobs) for revision in filter(None, [given.before])]
    sets.append(judged(root, changes, out, None, given.jobs))
    for ended in sets:
        for room, counts in sorted(tally(ended).items()):
            print(room, dict(counts))
        print("all", dict(sum(tally(ended).values(), Counter())))


if __name__ == "__main__":
    main()
