"""The law of a controller for a workspace in a file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexhinf.designs.fields import law_of
from flexhinf.designs.specification import Specification
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.gain_search import known_gains
from flexhinf.designs.workspace.search import known_setup
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput
from flexhinf.modal.pair import PairWeights
from flexhinf.report import finite
from flexhinf.robot import Robot
from flexhinf.validation import checked_path


def law_numbers(setup: WorkspaceSetup) -> dict[str, Any]:
    """The numbers that the search has found, for a file; with robot and specification they make the setup again."""
    numbers = {name: list(values) for name, values in setup.numbers.items()}
    return {**pair_numbers(setup), "gains": numbers}


def pair_numbers(setup: WorkspaceSetup) -> dict[str, Any]:
    """Those of a law of pairs, and of its estimator."""
    weights: dict[str, Any] = {} if setup.pairs is None else finite(vars(setup.pairs.weights))
    return {"weights": weights, "random_torques": list(setup.random)}


def read_setup(robot: Robot, s: Specification, file: str | Path) -> WorkspaceSetup:
    """The setup of `law_numbers` in a file, bit by bit; InvalidInput where they cannot be read."""
    path = checked_path("The numbers of the law", file)
    try:
        return known_law(robot, s, json.loads(path.read_text(encoding="utf-8")))
    except InvalidInput:
        raise
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidInput(
            "The numbers of the law cannot be read.", f"{path}: {str(error)[:200]}", "a copy of its folder"
        ) from error


def known_law(robot: Robot, s: Specification, numbers: Mapping[str, Any]) -> WorkspaceSetup:
    """The setup of `law_numbers`; a KeyError, ValueError or TypeError for other numbers."""
    kind, task = law_of(s), Task.of(robot, s)
    links, motors = map(float, numbers["random_torques"])
    gains = {name: tuple(map(float, values)) for name, values in numbers.get("gains", {}).items()}
    weights = PairWeights(**_floats(numbers["weights"])) if kind.over is None else None
    if weights is None:
        return known_gains(robot, s, task, kind, gains, (links, motors))
    return known_setup(robot, s, task, weights, (links, motors))


def _floats(numbers: Mapping[str, Any]) -> dict[str, float]:
    return {name: math.inf if value is None else float(value) for name, value in numbers.items()}
