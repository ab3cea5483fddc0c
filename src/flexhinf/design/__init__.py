"""From a robot and a specification to a judged design, and to a comparison of laws.

`pipeline` is the way in: `design` and `compare`, one call per step. What they compute is in `synthesis`, `loop_setup`,
`evaluation`, `requirements` and `result`; what is shown of it in `report`.

The room has the name of its main function, so calling the room is calling that function: ``fh.design(robot, spec)`` and
``from flexhinf.design import design`` are the same.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

_HOME = {
    "ComparedLaw": "result",
    "Comparison": "result",
    "DEFAULT_LAWS": "laws",
    "DegreeChoice": "degrees",
    "Design": "result",
    "DesignRequest": "design_file",
    "EstimatorNoise": "estimators",
    "LawEvaluation": "evaluation",
    "LoopSetup": "loop_setup",
    "Requirement": "requirements",
    "Specification": "specification",
    "Status": "status",
    "compare": "pipeline",
    "comparison_stages": "pipeline",
    "design": "pipeline",
    "design_schema": "design_file",
    "design_text": "design_file_text",
    "law_names": "laws",
    "load_design": "design_file",
    "read_request": "design_file",
    "shrinking": "degrees",
    "stages": "pipeline",
    "try_degrees": "degrees",
}

__all__ = [
    "DEFAULT_LAWS", "ComparedLaw", "Comparison", "DegreeChoice", "Design", "DesignRequest", "EstimatorNoise",
    "LawEvaluation", "LoopSetup", "Requirement", "Specification", "Status", "compare", "comparison_stages", "design",
    "design_schema", "design_text", "law_names", "load_design", "read_request", "shrinking", "stages", "try_degrees",
]  # fmt: skip

if TYPE_CHECKING:
    from flexhinf.design.degrees import DegreeChoice, shrinking, try_degrees
    from flexhinf.design.design_file import DesignRequest, design_schema, load_design, read_request
    from flexhinf.design.design_file_text import design_text
    from flexhinf.design.estimators import EstimatorNoise
    from flexhinf.design.evaluation import LawEvaluation
    from flexhinf.design.laws import DEFAULT_LAWS, law_names
    from flexhinf.design.loop_setup import LoopSetup
    from flexhinf.design.pipeline import compare, comparison_stages, design, stages
    from flexhinf.design.requirements import Requirement
    from flexhinf.design.result import ComparedLaw, Comparison, Design
    from flexhinf.design.specification import Specification
    from flexhinf.design.status import Status


class _CallableRoom(ModuleType):
    """The room as a function: importing any of its files would otherwise hide ``flexhinf.design`` the function."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """See `flexhinf.design.pipeline.design`."""
        return self.design(*arguments, **options)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'flexhinf.design' has no attribute {name!r}")
    value = getattr(import_module(f"flexhinf.design.{_HOME[name]}"), name)
    globals()[name] = value
    return value


sys.modules[__name__].__class__ = _CallableRoom
