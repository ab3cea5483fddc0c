"""No file imports in a circle: not at the top, not inside a function, not for the type checker alone."""

from __future__ import annotations

import ast
from collections.abc import Container
from pathlib import Path

import pytest


def imported_files(nodes: list[ast.AST], modules: Container[str]) -> set[str]:
    """The modules that a file imports anywhere in its text, by name."""
    found = set()
    for node in nodes:
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in modules else node.module for name in inside]
        found |= {name for name in names if name in modules}
    return found


def import_graph(source: Path, files: dict[Path, list[ast.AST]]) -> dict[str, set[str]]:
    """Every module of a package in this folder, with the modules of the package it imports.

    A package's lazy ``__init__`` names its files for users: only what imports the package itself depends on it.
    """
    modules: dict[str, list[ast.AST]] = {}
    for file, nodes in files.items():
        parts = file.relative_to(source.parent).with_suffix("").parts
        modules[".".join(part for part in parts if part != "__init__")] = nodes
    return {name: imported_files(nodes, modules) - {name} for name, nodes in modules.items()}


def written_graph(source: Path) -> dict[str, set[str]]:
    """The same of the files as they stand there now."""
    texts = {file: file.read_text(encoding="utf-8") for file in source.rglob("*.py")}
    return import_graph(source, {file: list(ast.walk(ast.parse(text))) for file, text in texts.items()})


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected components of more than one module, by Tarjan's algorithm."""
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        order[name] = lowest[name] = len(order)
        stack.append(name)
        for other in sorted(graph[name]):
            if other not in order:
                visit(other)
            if other in stack:
                lowest[name] = min(lowest[name], lowest[other])
        if lowest[name] == order[name]:
            component = [stack.pop()]
            while component[-1] != name:
                component.append(stack.pop())
            if len(component) > 1:
                found.append(sorted(component))

    for name in graph:
        if name not in order:
            visit(name)
    return sorted(found)


@pytest.mark.costs("parses the package, for tests/test_house.py too")
def test_no_files_import_in_a_circle(repository: Path, sources: dict[Path, list[ast.AST]]) -> None:
    assert circles(import_graph(repository / "src" / "flexhinf", sources)) == []


@pytest.mark.parametrize(
    "line",
    ["from pack.a import one", "def f():\n    from pack import a", "if TYPE_CHECKING:\n    import pack.a"],
)
def test_a_circle_is_seen_wherever_the_import_stands(tmp_path: Path, line: str) -> None:
    pack = tmp_path / "pack"
    pack.mkdir()
    (pack / "__init__.py").write_text("from pack.a import two\n", encoding="utf-8")
    (pack / "a.py").write_text("from pack.b import two\none = 1\n", encoding="utf-8")
    (pack / "b.py").write_text("two = 2\n", encoding="utf-8")
    assert circles(written_graph(pack)) == []
    (pack / "b.py").write_text(f"{line}\ntwo = 2\n", encoding="utf-8")
    assert circles(written_graph(pack)) == [["pack.a", "pack.b"]]
