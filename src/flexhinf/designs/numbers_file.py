"""Schema of design.json, the numbers of a design."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

#: The file of a report that has its numbers.
NUMBERS_FILE = "design.json"

#: Of the schema: it rises when a key changes its meaning or goes.
VERSION = 2

_TEXT: dict[str, Any] = {"type": "string"}
_YES: dict[str, Any] = {"type": "boolean"}
_NUMBER: dict[str, Any] = {"type": ["number", "null"]}
_POSE: dict[str, Any] = {"type": ["array", "null"], "items": {"type": "number"}}


def _said(of: Mapping[str, Any], text: str) -> dict[str, Any]:
    return {**of, "description": text}


def _rows(about: str, keys: Mapping[str, Mapping[str, Any]], more: bool = False) -> dict[str, Any]:
    row = {"type": "object", "properties": keys, "required": [*keys], "additionalProperties": more}
    return {"type": "array", "items": row, "description": about}


REQUIREMENTS = _rows(
    "Every requirement, judged. A number that is infinite or unknown is null.",
    {
        "what": _said(_TEXT, "Its name."),
        "limit": _said(_NUMBER, "In `unit`."),
        "found": _said(_NUMBER, "In `unit`; null also where a run diverged."),
        "unit": _TEXT,
        "at_most": _said(_YES, "Whether the limit is an upper one."),
        "where": _said(_TEXT, "The loops or runs that were judged."),
        "criterion": _said(_TEXT, "Definition of what was found."),
        "stated_by": _said(_TEXT, "The option that states the limit, robot, or default."),
        "joint": _said(_TEXT, "Of the worst number; empty for a robot of one joint."),
        "at": _said(_NUMBER, "Time of the worst number, s."),
        "field": _said(_TEXT, "Field of the specification that states the limit; empty if none does."),
        "tolerance": _said(_NUMBER, "Relative tolerance of the limit."),
        "detail": _said(_TEXT, "What else is known of the number."),
        "judged": _said(_YES, "No: the run was too short to tell."),
        "met": _YES,
        "within_tolerance": _said(_YES, "Whether the limit is exceeded by less than the tolerance."),
    },
)

LOOPS = _rows(
    "Loops at rest, linearised and sampled: pose by pose, robot by robot.",
    {
        "pose": _said(_POSE, "Link positions, rad or m."),
        "robot": _said(_TEXT, "nominal, or at a corner of its tolerances."),
        "stable": _YES,
        "damping": _said(_NUMBER, "Least damping ratio of its oscillations."),
        "numbers": {"type": "object", "description": "Others, as the law measures them."},
    },
)

RUNS = _rows(
    "Runs of the simulation: motion by motion, robot by robot.",
    {
        "name": _TEXT,
        "file": _said(
            {"type": ["string", "null"]}, "In the folder of the report; null for a run that is not kept."
        ),
        "robot": _said(_TEXT, "nominal, or another one."),
        "start": _said(_POSE, "Link positions, rad or m."),
        "goal": _said(_POSE, "Likewise."),
        "duration_s": _NUMBER,
        "diverged_at_s": _said(_NUMBER, "null for a run that did not diverge."),
        "joints": {
            "type": "array",
            "items": {"type": "object"},
            "description": "Numbers of each joint, by name.",
        },
    },
)

TASK: dict[str, Any] = {
    "type": "object",
    "description": "What the robot is asked: a pose, or a workspace.",
    "properties": {
        "pose": _said(_POSE, "rad or m; null for a workspace."),
        "start": _said(_POSE, "Where the motion to the pose begins."),
        "workspace": _said({}, "Its name, box, path or file; null for a pose."),
    },
    "required": ["pose", "start", "workspace"],
    "additionalProperties": False,
}

KEYS: dict[str, dict[str, Any]] = {
    "version": {"const": VERSION},
    "robot": _TEXT,
    "joints": {"type": "array", "items": _TEXT},
    "task": TASK,
    "law": _said(_TEXT, "Its name, as --law takes it."),
    "estimator": _said(_TEXT, "Its name, as --estimator takes it."),
    "controller": _said(
        {"type": ["string", "null"]}, "Its file; null where no one controller has every gain."
    ),
    "verdict": _said(_TEXT, "In sentences."),
    "met": _said(_YES, "Whether every requirement is met."),
    "notes": {"type": "array", "items": _TEXT},
    "requirements": REQUIREMENTS,
    "loops": LOOPS,
    "runs": RUNS,
    "facts": {"type": "object", "description": "What the law knows of itself, under keys of its own."},
}


def numbers_schema() -> dict[str, Any]:
    """The JSON schema of design.json, with the same keys for every task and law."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Numbers of a design of flexhinf",
        "description": "In SI units.",
        "type": "object",
        "properties": KEYS,
        "required": [*KEYS],
        "additionalProperties": False,
    }
