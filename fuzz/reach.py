"""A plugin of pytest for `fuzz.mutants`: which tests reach marked places, and an end after some CPU seconds.

In a marked copy of the source a statement notes its number with `hit` before it runs. ``FLEXHINF_REACH`` names a file
to which each test adds a line: its name, its CPU seconds, how it ended, and the numbers that it reached, also in the
processes of flexhinf that it started. ``FLEXHINF_WITHIN`` is the number of CPU seconds after which no test begins.
"""

from __future__ import annotations

import ast
import atexit
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

#: Numbers of the places that were reached since a test began.
reached: set[int] = set()


def hit(place: int) -> None:
    """Note that a place was reached."""
    reached.add(place)


def marked(source: str, lines: Iterable[tuple[int, int]]) -> tuple[str, list[int]]:
    """The source with a note before the statement of each (line, place), and the places that are not in a function.

    What a module computes as it is imported is not noted: every test that imports the module reaches it.
    """
    tree, outside = ast.parse(source), []
    for line, place in lines:
        body, index, inside = _statement(tree, line)
        if not inside:
            outside.append(place)
            continue
        note = ast.parse(f"__import__('fuzz.reach', fromlist=['hit']).hit({place})").body[0]
        body.insert(index, note)
    return ast.unparse(ast.fix_missing_locations(tree)) + "\n", outside


def _statement(tree: ast.Module, line: int) -> tuple[list[ast.stmt], int, bool]:
    """The list of statements that has the innermost one with this line, its place there, and whether it is in a
    function; what a test has inserted has line 1."""
    found: tuple[list[ast.stmt], int, bool] = (tree.body, 0, False)

    def search(node: ast.AST, inside: bool) -> None:
        nonlocal found
        for _, value in ast.iter_fields(node):
            for index, child in enumerate(value if isinstance(value, list) else [value]):
                if not isinstance(child, ast.AST):
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


def _write(name: str, cost: float, ended: str) -> None:
    line = json.dumps({"test": name, "cost": round(cost, 3), "ended": ended, "places": sorted(reached)})
    with Path(os.environ["FLEXHINF_REACH"]).open("a", encoding="utf-8") as file:
        file.write(f"{line}\n")


def _at_exit() -> None:
    """Of a process that a test started."""
    test = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")[0]
    if test and reached and os.environ.get("FLEXHINF_REACH"):
        _write(test, 0.0, "")


class Reach:
    """The plugin itself."""

    def __init__(self) -> None:
        from tests.costs import spent

        self.spent, self.ended = spent, ""
        self.within = float(os.environ.get("FLEXHINF_WITHIN", "inf"))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        """Measure a test, if there is time left for it."""
        if self.spent() > self.within:
            pytest.exit("no test begins after so many CPU seconds", returncode=5)
        reached.clear()
        self.ended, before = "", self.spent()
        outcome = yield
        if os.environ.get("FLEXHINF_REACH"):
            _write(item.nodeid, self.spent() - before, self.ended)
        return outcome

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
        """Keep how a test ended."""
        report = yield
        if report.outcome != "passed" or (call.when == "call" and not self.ended):
            self.ended = report.outcome
        return report

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Quick tests first, each kind in the order that was asked for."""
        items.sort(key=lambda item: any(item.get_closest_marker(tier) for tier in ("slow", "ci")))


def pytest_configure(config: pytest.Config) -> None:
    """Tests note for themselves what they reach."""
    atexit.unregister(_at_exit)
    config.pluginmanager.register(Reach(), "flexhinf-reach")


atexit.register(_at_exit)
