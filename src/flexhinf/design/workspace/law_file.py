"""The law of a controller for a workspace in a file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexhinf.design.design_file import tool_of
from flexhinf.design.specification import Specification
from flexhinf.design.workspace.search import known_setup
from flexhinf.design.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput
from flexhinf.modal.pair import PairWeights
from flexhinf.report import finite
from flexhinf.robot import Robot
from flexhinf.robot.waypoints import LIMITS
from flexhinf.robot.workspace import Workspace, workspace_of
from flexhinf.validation import checked_path

#: The file of a report that has the numbers of a law among others.
NUMBERS_FILE = "design.json"


def stated_workspace(robot: Robot, stated: Any) -> Workspace:
    """The workspace of a specification, by default the joint ranges; a box in space has its tool behind an @."""
    if not isinstance(stated, str):
        return workspace_of(robot, LIMITS if stated is None else stated)
    place, _, tool = stated.partition("@")
    return workspace_of(robot, place, tool_of(tool))


def law_numbers(setup: WorkspaceSetup) -> dict[str, Any]:
    """The numbers that the search has found, for a file; with robot and specification they make the setup again."""
    return {"weights": finite(vars(setup.gains.weights)), "random_torques": list(setup.random)}


def read_setup(robot: Robot, s: Specification, file: str | Path) -> WorkspaceSetup:
    """The setup of `law_numbers` in a file, bit by bit; InvalidInput where they cannot be read."""
    path = checked_path("The numbers of the law", file)
    try:
        numbers = json.loads(path.read_text(encoding="utf-8"))
        links, motors = map(float, numbers["random_torques"])
        weights = PairWeights(**_floats(numbers["weights"]))
    except InvalidInput:
        raise
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidInput(
            "The numbers of the law cannot be read.", f"{path}: {str(error)[:200]}", "a copy of its folder"
        ) from error
    return known_setup(robot, s, stated_workspace(robot, s.workspace), weights, (links, motors))


def _floats(numbers: Mapping[str, Any]) -> dict[str, float]:
    return {name: math.inf if value is None else float(value) for name, value in numbers.items()}
