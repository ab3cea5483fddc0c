"""Which places of the source a process reaches, for `fuzz.mutants`; `fuzz.reach_plugin` has the hooks of pytest.

``FLEXHINF_PLACES`` names a JSON file with the places: of each source file pairs of a line and a number. As such a file
is imported, a note is put before the statement of each line; the file stays as it is. ``FLEXHINF_REACH`` names a file
to which each test adds a line: its name, its CPU seconds, how it ended, and the numbers that it reached, also in the
processes of flexhinf that it started, which import this module first.
"""

from __future__ import annotations

import ast
import atexit
import json
import os
from collections.abc import Iterable
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any

#: Exit code of pytest where tests were left out for want of time.
OUT_OF_TIME = 75

#: Numbers of the places that were reached since a test began.
reached: set[int] = set()


def hit(place: int) -> None:
    """Note that a place was reached."""
    reached.add(place)


def marked(source: str, lines: Iterable[tuple[int, int]]) -> ast.Module:
    """The source with a note before the statement of each (line, place) that is in a function.

    What a module computes as it is imported is not noted: every test that imports the module reaches it.
    """
    tree = ast.parse(source)
    for line, place in lines:
        body, index, inside = _statement(tree, line)
        if inside:
            note = ast.parse(f"__import__('fuzz.reach', fromlist=['hit']).hit({place})").body[0]
            for node in ast.walk(note):
                ast.copy_location(node, body[index])
            note.noted = True  # type: ignore[attr-defined]
            body.insert(index, note)
    return tree


def _statement(tree: ast.Module, line: int) -> tuple[list[ast.stmt], int, bool]:
    """The list of statements that has the innermost one with this line, its place there, and whether it is in a
    function."""
    found: tuple[list[ast.stmt], int, bool] = (tree.body, 0, False)

    def search(node: ast.AST, inside: bool) -> None:
        nonlocal found
        for _, value in ast.iter_fields(node):
            for index, child in enumerate(value if isinstance(value, list) else [value]):
                if not isinstance(child, ast.AST) or hasattr(child, "noted"):
                    continue
                within = inside
                if isinstance(child, ast.stmt):
                    first = min(
                        [child.lineno, *(each.lineno for each in getattr(child, "decorator_list", []))]
                    )
                    if not first <= line <= (child.end_lineno or first):
                        continue
                    found = (value, index, inside)
                    within = inside or isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef))
                search(child, within)

    search(tree, False)
    return found


def _mark_imports(file: str) -> None:
    """From now on the source files that this file names are imported with their notes."""
    places = {os.path.realpath(name): lines for name, lines in json.loads(Path(file).read_text()).items()}
    usual = SourceFileLoader.get_code

    def get_code(self: SourceFileLoader, fullname: str) -> Any:
        lines = places.get(os.path.realpath(self.path))
        if lines is None:
            return usual(self, fullname)
        return compile(
            marked(Path(self.path).read_text(encoding="utf-8"), lines), self.path, "exec", dont_inherit=True
        )

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]


def write(name: str, cost: float, ended: str) -> None:
    """Add the line of a test: its name, CPU seconds, how it ended, and what it reached."""
    line = json.dumps({"test": name, "cost": round(cost, 3), "ended": ended, "places": sorted(reached)})
    with Path(os.environ["FLEXHINF_REACH"]).open("a", encoding="utf-8") as file:
        file.write(f"{line}\n")


def at_exit() -> None:
    """Of a process that a test started."""
    test = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")[0]
    if test and reached and os.environ.get("FLEXHINF_REACH"):
        write(test, 0.0, "")


if os.environ.get("FLEXHINF_PLACES"):
    _mark_imports(os.environ["FLEXHINF_PLACES"])
atexit.register(at_exit)
