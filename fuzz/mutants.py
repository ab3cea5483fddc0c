"""Change the source in one place at a time, and see whether the quick tests notice; docs/mutants.md has what was found.

    python -m fuzz.mutants checker                       every change of the checker, quotients and enclosures: hours
    python -m fuzz.mutants rest --sample 300 --seed 21   a random sample of those of the other rooms
    python -m fuzz.mutants FILE ...                      every change of these files

The changes are those of cosmic-ray (``pip install cosmic-ray``) that `OPERATORS` names, and `SWAPS`; messages and
annotations stay as they are. In a copy of the repository pytest runs the quick tests of the room until one fails: those
named like the changed file, then those that mention it. What ``--out`` has already is not run again.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

CHECKER = ("certify/checker/*.py", "certify/inequality.py")  # with the enclosures of the search
ROOMS = ("hinf", "estimation", "loop", "campaign", "export", "certify")
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


def tests_of(root: Path, path: Path) -> list[str]:
    """The test files of its room: first those of its own name, then those that mention it or what it defines."""
    source, room = path.read_text(encoding="utf-8"), path.relative_to(root / "src" / "flexhinf").parts[0]
    defined = set(re.findall(r"^(?:def|class) ([A-Za-z]\w{3,})", source, re.MULTILINE)) | {path.stem}
    named = re.compile(rf"\b({'|'.join(sorted(defined))})\b")
    files = sorted((root / "tests" / room).rglob("test_*.py"))
    own = [file for file in files if file.stem.removeprefix("test_").rstrip("s") == path.stem.rstrip("s")]
    mentioned = [file for file in files if file not in own and named.search(file.read_text(encoding="utf-8"))]
    return [str(file.relative_to(root)) for file in own + mentioned or files]


def outcome(copy: Path, path: Path, text: str, tests: list[str]) -> str:
    """What the tests say of a file with this text; the copy is as it was afterwards."""
    source = path.read_text(encoding="utf-8")
    for old in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        old.unlink()
    path.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": str(copy / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, timeout=300, check=False
        )
    except subprocess.TimeoutExpired:
        return "timeout"
    finally:
        path.write_text(source, encoding="utf-8")
    return "killed" if done.returncode else "survived"


def main() -> None:
    """Change, run, and write a line for each change."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.mutants", description=__doc__.split("\n")[0])
    parser.add_argument("what", nargs="+", help="checker, rest, or files")
    parser.add_argument("--sample", type=int, help="so many of the changes, drawn at random")
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--out", type=Path, default=Path("mutants.jsonl"))
    given = parser.parse_args()
    root, out = Path(__file__).resolve().parents[1], given.out.absolute()
    package = root / "src" / "flexhinf"
    checker = [path for pattern in CHECKER for path in sorted(package.glob(pattern))]
    rest = [path for room in ROOMS for path in sorted((package / room).rglob("*.py")) if path not in checker]
    files = {"checker": checker, "rest": rest}.get(given.what[0]) or [
        Path(name).resolve() for name in given.what
    ]
    changes = [change for path in files for change in changes_of(root, path)]
    if given.sample:
        changes = random.Random(given.seed).sample(changes, given.sample)
    known = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    tally = Counter(one.pop("result") for one in known)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(
            shutil.copytree(root, Path(folder) / "copy", ignore=shutil.ignore_patterns(".venv*", ".git"))
        )
        for change, text in (one for one in changes if one[0] not in known):
            path = copy / change["file"]
            change = {**change, "result": outcome(copy, path, text(), tests_of(copy, path))}
            tally[change["result"]] += 1
            with out.open("a") as file:
                print(json.dumps(change), file=file, flush=True)
            print(dict(tally), *change.values(), flush=True)


if __name__ == "__main__":
    main()
