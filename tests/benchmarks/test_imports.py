"""What benchmarks import of flexhinf is there: most of them run only when something is measured."""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks").rglob("*.py")), ids=lambda path: path.stem)
def test_names_are_where_they_are_imported_from(path: Path) -> None:
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    for node in (each for each in nodes if isinstance(each, ast.ImportFrom)):
        if (node.module or "").split(".")[0] in ("flexhinf", "benchmarks") and not node.level:
            try:
                module = import_module(str(node.module))
            except ModuleNotFoundError as error:  # a peer that is not installed here
                if str(error.name).split(".")[0] in ("flexhinf", "benchmarks"):
                    raise
                continue
            missing = [each.name for each in node.names if not hasattr(module, each.name)]
            submodules = {each.stem for each in Path(str(module.__file__)).parent.iterdir()}
            assert {*missing} <= submodules, (node.module, missing)
