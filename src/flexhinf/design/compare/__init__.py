"""Laws compared by name: one loop, one set of plants, disturbances and seeds, one table, one figure."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "Comparison": "result",
    "DEFAULT_LAWS": "names",
    "Row": "result",
    "compare": "corridor",
    "comparison_files": "page",
    "comparison_stages": "corridor",
    "comparison_tables": "terminal",
    "law_names": "names",
    "notes": "words",
    "verdict": "words",
}

__all__ = [
    "DEFAULT_LAWS", "Comparison", "Row", "compare", "comparison_files", "comparison_stages", "comparison_tables",
    "law_names", "notes", "verdict",
]  # fmt: skip

if TYPE_CHECKING:
    from flexhinf.design.compare.corridor import compare, comparison_stages
    from flexhinf.design.compare.names import DEFAULT_LAWS, law_names
    from flexhinf.design.compare.page import comparison_files
    from flexhinf.design.compare.result import Comparison, Row
    from flexhinf.design.compare.terminal import comparison_tables
    from flexhinf.design.compare.words import notes, verdict


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'flexhinf.design.compare' has no attribute {name!r}")
    value = getattr(import_module(f"flexhinf.design.compare.{_HOME[name]}"), name)
    globals()[name] = value
    return value
