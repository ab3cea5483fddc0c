"""Change the source one place at a time, and see whether the quick tests of its room notice: docs/mutants.md.

    python -m fuzz.mutants checker                       every change of the checker, quotients and enclosures
    python -m fuzz.mutants rest --sample 300 --seed 21   a random sample of the other rooms

Changes are those of cosmic-ray (``pip install cosmic-ray``) that `OPERATORS` names, and `SWAPS`. Each runs in a
copy of the repository, in a fork of a process that has loaded the libraries: the room's quick tests that reach the
changed statement, those first that found earlier changes, then the rest of their files, until one fails. One line of
JSON for each change goes to ``--out``.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

CHECKER = ["certify/checker/*.py", "certify/quotients.py", "certify/enclosures.py"]
ROOMS = ["hinf", "estimation", "loop", "campaign", "export", "certify"]
OPERATORS = [
    *(f"ReplaceBinaryOperator_{pair}" for pair in ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Pow_Mul",
      "FloorDiv_Mul", "Mod_Mul", "BitAnd_BitOr", "BitOr_BitAnd", "LShift_RShift")),
    *(f"ReplaceComparisonOperator_{pair}" for pair in ("Lt_LtE", "Lt_Gt", "LtE_Lt", "LtE_GtE", "Gt_GtE", "Gt_Lt",
      "GtE_Gt", "GtE_LtE", "Eq_NotEq", "NotEq_Eq", "Is_IsNot", "IsNot_Is")),
    *(f"ReplaceUnaryOperator_{pair}" for pair in ("Delete_USub", "Delete_Not", "Delete_Invert")),
    "AddNot", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd",
    "ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "NumberReplacer", "RemoveDecorator", "ZeroIterationForLoop",
]  # fmt: skip
SWAPS = {
    "max": "min", "min": "max", "maximum": "minimum", "minimum": "maximum", "any": "all", "all": "any",
    "ceil": "floor", "floor": "ceil", "upper": "lower", "lower": "upper", "abs": "", "+=": "-=", "-=": "+=",
    "*=": "/=", "/=": "*=", "@": "*",
}  # fmt: skip
WORDS = {
    "fstring",
    "raise_stmt",
    "tfpdef",
    "annassign",
    "assert_stmt",
}  # messages and annotations stay as they are
LONGEST_S = 20.0  # of the processor, beyond three times what the tests take on the source as it is


def mutants_of(root: Path, path: Path) -> list[dict[str, Any]]:
    """Every change of a file: where, what, and the text of the file with it."""
    import cosmic_ray.plugins as plugins
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code

    source, found = path.read_text(), []
    lines, nodes = source.split("\n"), list(ast_nodes(get_ast(source)))

    def add(node: Any, what: str, mutated: Any) -> None:
        above, seen = node, set()
        while above.parent is not None and above.parent.type not in ("file_input", "suite"):
            above = above.parent
            seen.add(above.type)
        annotation = (
            node.search_ancestor("funcdef") and "->" in lines[node.start_pos[0] - 1] and node.value == "|"
        )
        if seen & WORDS or annotation or "__all__" in lines[above.start_pos[0] - 1]:
            return
        function = above if above.type in ("funcdef", "classdef") else None
        while above is not None:  # the outermost function around it
            function = above if above.type == "funcdef" else function
            above = above.parent
        if function is not None and function.type == "funcdef":
            around = function.parent if function.parent.type == "decorated" else function
            reach = [around.start_pos[0], function.end_pos[0]]
        else:
            reach = [0, -1]
        found.append({
            "file": str(path.relative_to(root)), "line": node.start_pos[0], "column": node.start_pos[1], "what": what,
            "reach": reach, "text": mutated,
        })  # fmt: skip

    for name in OPERATORS:
        operator, count = plugins.get_operator(f"core/{name}")(), 0
        for node in nodes:
            for _ in operator.mutation_positions(node):
                add(node if hasattr(node, "value") else node.get_first_leaf(), f"{name} {count}",
                    lambda operator=operator, count=count: mutate_code(source, operator, count))  # fmt: skip
                count += 1
    for node in nodes:
        value, after = getattr(node, "value", None), node.get_next_leaf() if hasattr(node, "value") else None
        if value in SWAPS and (not value.isalpha() or after is not None and after.value == "("):
            if value == "@" and node.parent.type == "decorator":
                continue
            line, column = node.start_pos
            begin = (
                lines[line - 1][: column - 3]
                if lines[line - 1][column - 3 : column] == "np." and not SWAPS[value]
                else lines[line - 1][:column]
            )
            changed = [
                *lines[: line - 1],
                begin + SWAPS[value] + lines[line - 1][column + len(value) :],
                *lines[line:],
            ]
            add(node, f"{value} -> {SWAPS[value]}", "\n".join(changed))
    return found


class Watch:
    """A pytest plugin: runs the tests in an order, says which failed; or notes what each costs and reaches."""

    def __init__(self, order: list[str] | None, src: str) -> None:
        self.order, self.src, self.failed, self.tests = order, src, "", {}

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        if self.order is not None:
            place = {name: i for i, name in enumerate(self.order)}
            items[:] = sorted((i for i in items if i.nodeid in place), key=lambda i: place[i.nodeid])

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.failed = self.failed or (report.nodeid if report.failed else "")

    def pytest_runtest_protocol(self, item: Any, nextitem: Any) -> None:
        if self.order is None:
            self.lines: set[tuple[str, int]] = set()
            self.tests[item.nodeid] = [time.process_time(), self.lines]
            threading.settrace(self.trace)
            sys.settrace(self.trace)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        if self.order is None:
            sys.settrace(None)
            threading.settrace(None)  # type: ignore[arg-type]
            self.tests[nodeid][0] = time.process_time() - self.tests[nodeid][0]

    def trace(self, frame: Any, event: str, arg: Any) -> None:
        name = frame.f_code.co_filename
        if name.startswith(self.src):
            self.lines.add((name[len(self.src) :], frame.f_code.co_firstlineno))


def forked(job: Any, limit: float) -> Any:
    """What a job returns in a fork; "timeout" beyond so many seconds of the processor, "died" where it ends otherwise."""
    inward, outward = os.pipe()
    child = os.fork()
    if child == 0:
        os.setsid()
        os.close(inward)
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit) + 1, int(limit) + 2))
        resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
        nothing = os.open(os.devnull, os.O_RDWR)
        for number in (0, 1, 2):
            os.dup2(nothing, number)
        with os.fdopen(outward, "w") as pipe:
            json.dump(job(), pipe)
        os._exit(0)
    os.close(outward)
    alarm = threading.Timer(20 * limit + 60, os.killpg, (child, signal.SIGKILL))
    alarm.start()
    with os.fdopen(inward) as pipe:
        answer = pipe.read()
    status = os.waitpid(child, 0)[1]
    alarm.cancel()
    try:
        os.killpg(child, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass
    if answer:
        return json.loads(answer)
    return (
        "timeout"
        if os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
        else "died"
    )


def run_tests(files: list[str], order: list[str] | None, src: str) -> Any:
    """Of a run of pytest: the exit code, the test that failed, and what was noted."""
    import pytest

    watch = Watch(order, src)
    sys.dont_write_bytecode = order is not None
    code = pytest.main([*files, "-x" if order is not None else "-q", "-q", "-m", "not slow", "-p", "no:cacheprovider",
                        "-W", "ignore::pytest.PytestAssertRewriteWarning"],
                       plugins=[watch])  # fmt: skip
    notes = {name: [cost, sorted(lines)] for name, (cost, lines) in watch.tests.items()}
    return int(code), watch.failed, notes


def tests_for(mutant: dict[str, Any], notes: dict[str, Any], found: Counter[str], budget: float) -> list[str]:
    """The tests for a change: those that found others in its file, those that reach it, the rest of their files."""
    name, (first, last) = mutant["file"].removeprefix("src"), mutant["reach"]
    at = {test: [line for file, line in lines if file == name] for test, (_, lines) in notes.items()}
    direct = {test for test, lines in at.items() if any(first <= line <= last for line in lines)}
    mutant["reached"] = len(direct)
    files = {test.split("::")[0] for test in direct or (test for test, lines in at.items() if lines)}
    every = [test for test in notes if test.split("::")[0] in files]
    every.sort(key=lambda test: (test not in direct, -found[test] if test in direct else 0, notes[test][0]))
    spent, chosen = 0.0, []
    for test in every:
        spent += notes[test][0]
        if spent > budget and chosen:
            mutant["left_out"] = mutant.get("left_out", 0) + 1
        else:
            chosen.append(test)
    return chosen


def prepare(root: Path, work: Path, rooms: set[str]) -> dict[str, Any]:
    """Copy the repository, load what its tests load from elsewhere, and note what each quick test costs and reaches."""
    shutil.rmtree(work, ignore_errors=True)
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True)
    for name in filter(None, tracked.stdout.split("\0")):
        (work / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(root / name, work / name)
    os.chdir(work)
    os.environ.update(PYTHONPATH=f"{work}/src", FLEXHINF_CACHE=f"{work}/cache", OMP_NUM_THREADS="1",
                      OPENBLAS_NUM_THREADS="1", PYTEST_ADDOPTS=f"--basetemp={work}/tmp")  # fmt: skip
    sys.path[0] = f"{work}/src"
    for name in ("numpy", "scipy.linalg", "scipy.optimize", "scipy.integrate", "scipy.signal", "flint", "casadi",
                 "llvmlite.binding", "xarray", "hypothesis", "pytest", "pydantic", "matplotlib.pyplot", "typer", "rich",
                 "_pytest.doctest", "hypothesis.extra.numpy", "mpmath", "unittest.mock", "tomlkit"):  # fmt: skip
        __import__(name)
    return {room: forked(lambda room=room: run_tests([f"tests/{room}"], None, f"{work}/src"), 3000)[2]
            for room in sorted(rooms)}  # fmt: skip


def main() -> None:
    """Change, run, and write a line for each change."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.mutants", description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=["checker", "rest"])
    parser.add_argument("--sample", type=int, help="so many of the changes, drawn at random")
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument(
        "--part", default="1/1", help="k/n: every n-th change from the k-th on, for n processes"
    )
    parser.add_argument(
        "--budget", type=float, default=60.0, help="seconds of the processor that one change's tests get"
    )
    parser.add_argument("--only", type=Path, help="run again those that survived, by this file of results")
    parser.add_argument("--work", type=Path, default=Path("/tmp/flexhinf-mutants"))
    parser.add_argument("--out", type=Path, default=Path("mutants.jsonl"))
    given = parser.parse_args()
    root, out = Path.cwd(), given.out.absolute()
    package = root / "src" / "flexhinf"
    checker = [path for pattern in CHECKER for path in sorted(package.glob(pattern))]
    rest = [p for room in ROOMS for p in sorted((package / room).rglob("*.py")) if p not in checker]
    mutants = [m for path in (checker if given.what == "checker" else rest) for m in mutants_of(root, path)]
    if given.sample:
        mutants = random.Random(given.seed).sample(mutants, given.sample)
    if given.only:
        again = {(r["file"], r["line"], r["column"], r["what"]) for r in map(json.loads, given.only.open())
                 if r["result"] == "survived"}  # fmt: skip
        mutants = [m for m in mutants if (m["file"], m["line"], m["column"], m["what"]) in again]
    k, n = map(int, given.part.split("/"))
    mutants = mutants[k - 1 :: n]
    print(f"{len(mutants)} changes", flush=True)
    notes = prepare(root, given.work, {m["file"].split("/")[2] for m in mutants})
    found: dict[str, Counter[str]] = {}
    for mutant in mutants:
        path, here = given.work / mutant["file"], notes[mutant["file"].split("/")[2]]
        source, text = path.read_text(), mutant.pop("text")
        text = text() if callable(text) else text
        order = tests_for(mutant, here, found.setdefault(mutant["file"], Counter()), given.budget)
        mutant["before"], mutant["after"] = ("\n".join(t.split("\n")[mutant["line"] - 1 : mutant["line"]]).strip()
                                             for t in (source, text))  # fmt: skip
        for old in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
            old.unlink()
        path.write_text(text)
        limit = LONGEST_S + 3 * sum(here[test][0] for test in order)
        answer = forked(lambda: run_tests(sorted({t.split("::")[0] for t in order}), order, ""), limit)
        path.write_text(source)
        code, by = answer[:2] if isinstance(answer, list) else (answer, "")
        mutant["result"] = "survived" if code == 0 else "killed" if code in (1, 2, 3, 4) else str(code)
        mutant["by"], mutant["tests"] = by, len(order)
        found[mutant["file"]][by] += 1
        with out.open("a") as file:
            print(json.dumps(mutant), file=file)


if __name__ == "__main__":
    main()
