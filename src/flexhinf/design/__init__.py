"""The corridor from a robot to a judged design: one call per arrow."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "DesignRequest": "design_file",
    "Design": "result",
    "DegreeChoice": "degrees",
    "Specification": "specification",
    "design_schema": "design_file",
    "design": "corridor",
    "design_files": "page",
    "design_text": "design_file_text",
    "load_design": "design_file",
    "read_request": "design_file",
    "notes": "page.notes",
    "shrinking": "degrees",
    "stages": "corridor",
    "try_degrees": "degrees",
    "verdict": "page.words",
}

__all__ = [
    "DegreeChoice", "Design", "DesignRequest", "Specification", "design", "design_files", "design_schema",
    "design_text",
    "load_design", "notes", "read_request", "shrinking", "stages", "try_degrees", "verdict",
]  # fmt: skip

if TYPE_CHECKING:
    from flexhinf.design.corridor import design, stages
    from flexhinf.design.degrees import DegreeChoice, shrinking, try_degrees
    from flexhinf.design.design_file import DesignRequest, design_schema, load_design, read_request
    from flexhinf.design.design_file_text import design_text
    from flexhinf.design.page import design_files
    from flexhinf.design.page.notes import notes
    from flexhinf.design.page.words import verdict
    from flexhinf.design.result import Design
    from flexhinf.design.specification import Specification


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'flexhinf.design' has no attribute {name!r}")
    value = getattr(import_module(f"flexhinf.design.{_HOME[name]}"), name)
    globals()[name] = value
    return value
