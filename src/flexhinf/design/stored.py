"""A design read back from the folder of its report, with its numbers."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.design import pipeline
from flexhinf.design.design_file import (
    CONTROLLER_FILE,
    DESIGN_FILE,
    DesignRequest,
    fields_text,
    has_controller,
    read_request,
    why_anew,
)
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.judged import Judged
from flexhinf.design.laws import DESIGN
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.noise_levels import EstimatorNoise, Levels
from flexhinf.design.plans import stated_move
from flexhinf.design.pose_loop import LoopAtPose
from flexhinf.design.problem.weights import TargetBehaviour
from flexhinf.design.requirements import REQUIREMENTS, Requirement
from flexhinf.design.responses import SAMPLES, start_and_goal
from flexhinf.design.result import Design, DesignedLoop, judged_by, verdict_on
from flexhinf.design.specification import Specification, is_for_workspace
from flexhinf.design.verdict import DesignVerdict
from flexhinf.design.workspace.evidence import LoopOverWorkspace
from flexhinf.design.workspace.law_file import NUMBERS_FILE, read_setup
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop import load_controller
from flexhinf.report import contents, is_report, unchanged
from flexhinf.robot import Robot
from flexhinf.robot.parts import file_warnings
from flexhinf.robot.waypoints import LIMITS
from flexhinf.validation import checked_path, is_file, read_bytes, read_toml, value_text

#: Largest size of the file of numbers, bytes.
MOST = 100_000_000

#: What a report's numbers have of a requirement besides its row of the design file.
KEPT = ("criterion", "stated_by", "joint", "at", "field", "tolerance", "detail", "judged")


@dataclass(frozen=True, eq=False)
class StoredReport(Judged):
    """What the folder of a report says of its design."""

    request: DesignRequest
    requirements: tuple[Requirement, ...]
    loop: DesignedLoop
    folder: Path
    result: Mapping[str, Any]  # the table [result] of the design file, without its requirements

    @property
    def robot(self) -> Robot:
        """Of the design."""
        return self.request.robot

    @property
    def specification(self) -> Specification:
        """Of the design."""
        return self.request.specification

    @property
    def files(self) -> dict[str, str | bytes]:
        """All files of the report but its design file, by name; InvalidInput where one was changed or lost."""
        return {name: content for name, content in contents(self.folder).items() if name != DESIGN_FILE}

    def summary(self) -> Mapping[str, str]:
        """Robot, whether the requirements are met, and the folder."""
        return {
            "robot": self.robot.name,
            "requirements": self.judgement,
            "read from": str(self.folder),
        }


def load_design(folder: str | Path) -> Design:
    """A design with its numbers, from the folder of its report: of `flexhinf design`, or of `Design.save`.

    Parameters
    ----------
    folder : path
        The folder, or the ``design.toml`` in it.

    Returns
    -------
    Design
        With the requirements as they were judged. Its controller has the bits of the one that was saved; margins, runs
        and campaigns are computed when they are read. ``evidence`` says where it is from, and ``save`` copies the
        report.

    Raises
    ------
    InvalidInput
        With the command that makes the design anew: for a design file without a report, and for a folder whose files,
        or whose robot's file, were changed or lost since.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import tempfile
    >>> quick = dict(degrees="2", draws=0, rays=0, proof_seconds=0, compare_rigid=False, estimator="none")
    >>> found = fh.design(fh.load_robot("paper"), fh.Specification(pose="10deg", start="0", **quick))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     same = fh.load_design(found.save(f"{folder}/arm"))
    >>> same.met == found.met, len(same.requirements) == len(found.requirements)
    (True, True)
    """
    path = checked_path("The design's folder", folder)
    inside = path / DESIGN_FILE
    file = inside if is_file(inside) else path
    refuse_if(
        not is_file(file),
        f"There is no design {value_text(str(folder), 120)}.",
        f"expected the folder of a report, in which there is a {DESIGN_FILE}",
        "the folder of `flexhinf design ROBOT --out DIR`, or of design.save(folder)",
    )
    request = read_request(file, is_file=True)
    if file.name != DESIGN_FILE or not is_report(file.parent):
        raise _anew(file, f"{file.name} without the report of its design")
    if why := why_anew(file, request.robot):
        raise _anew(file, why)
    for name in (DESIGN_FILE, NUMBERS_FILE, CONTROLLER_FILE):
        if not unchanged(file.parent, (name,)):
            raise _anew(file, f"{name}, which was changed or lost since the report")
    return judged_by(_stored(request, file))


def known_design(request: DesignRequest) -> Design | None:
    """The design of a request that names an unchanged report of it; None for another request."""
    file = request.file
    if file is None or file.name != DESIGN_FILE or not has_controller(file):
        return None
    with file_warnings(str):  # the request has told them
        stored = read_request(file, is_file=True)
    same = fields_text(stored.specification) == fields_text(request.specification)
    if not same or stored.robot != request.robot or not unchanged(file.parent, (NUMBERS_FILE,)):
        return None
    return judged_by(_stored(stored, file))


def requested_loop(
    request: DesignRequest, progress: pipeline.Progress = lambda text: None
) -> tuple[DesignedLoop, DesignVerdict]:
    """The loop of a requested design and the verdict on it: of an unchanged report, or designed and not judged."""
    known = known_design(request)
    loop = pipeline.loop_of(request.robot, request.specification, progress) if known is None else known.loop
    return loop, verdict_on(known)


def _anew(file: Path, why: str) -> InvalidInput:
    other = file.parent.with_name(f"{file.parent.resolve().name}-new")
    command = ("flexhinf", "design", str(file), "--out", str(other))
    return InvalidInput(
        "The numbers of this design cannot be read.",
        f"expected the folder of a report as it was written, got {why}",
        f"{shlex.join(command)}, which makes it anew, and then the folder {other.name}",
    )


def _stored(request: DesignRequest, file: Path) -> StoredReport:
    try:
        numbers = json.loads(read_bytes(file.parent / NUMBERS_FILE, MOST))
        table = read_toml(file, "design file")["result"]
        for_workspace = is_for_workspace(request.specification)  # without a pose 0.2 took the robot's home
        if numbers["robot"] != request.robot.name or for_workspace != (numbers.get("kind") == "workspace"):
            raise _anew(file, f"{NUMBERS_FILE} of another design than {DESIGN_FILE}")
        loop = _loop_of(request, file.parent, numbers, table)
        lines = _requirements(table["specification"], numbers)
    except InvalidInput:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        why = f"{NUMBERS_FILE} and {DESIGN_FILE}, of which one lacks {value_text(str(error), 120)}"
        raise _anew(file, why) from error
    result = {name: value for name, value in table.items() if name != "specification"}
    return StoredReport(request, lines, loop, file.parent.resolve(), result)


def requirement_numbers(line: Requirement) -> dict[str, Any]:
    """What `KEPT` names of a requirement, for the numbers of a report."""
    return {name: getattr(line, name) for name in KEPT}


def _requirements(rows: list[dict[str, Any]], numbers: Mapping[str, Any]) -> tuple[Requirement, ...]:
    """The judged requirements: rows of the design file, which has infinite numbers, with the rest of each from the
    report's numbers; a ValueError where the two contradict each other."""
    others = numbers.get("requirements", numbers.get("specification"))
    lines = list[Requirement]()
    for row, numbered in zip(rows, others, strict=True):
        other = {"at": numbered.get("at_s"), **numbered}
        kind = next((kind for kind in REQUIREMENTS.values() if kind.what == row["what"]), None)
        known = Requirement("") if kind is None else kind.judge(None, math.nan, math.nan, "")
        known = replace(known, stated_by="default" if row.get("by_default", True) else "design.toml")
        line = replace(
            known,
            **{name: row[name] for name in ("what", "found", "unit", "where")},
            limit=row["asked"],
            at_most=row["limit"] == "at most",
            **{name: other[name] for name in KEPT if name in other},
        )
        stated = other.get("limit", other.get("asked"))
        same = [row["what"], row["asked"], row["found"]] == [
            other["what"],
            stated,
            _known(other["found"], line),
        ]
        if not same or line.met != row["holds"] or line.met != other["met"]:
            raise ValueError(f"one and the same requirement on the {row['what']}")
        lines.append(line)
    return tuple(lines)


def _known(found: float | None, line: Requirement) -> float:
    """A number of a file of numbers, which has none for an infinite one."""
    return line.found if found is None and np.isinf(line.found) else float("nan" if found is None else found)


def _loop_of(
    request: DesignRequest, folder: Path, numbers: Mapping[str, Any], result: Mapping[str, Any]
) -> DesignedLoop:
    robot, s = request.robot, request.specification
    if is_for_workspace(s):
        s = replace(s, workspace=LIMITS) if s.workspace is None else s
        return LoopOverWorkspace(read_setup(robot, s, folder / NUMBERS_FILE))
    start, goal = start_and_goal(robot, s, stated_move(robot, s))
    standstill: Mapping[str, Any] = numbers.get("rest") or {}
    zone = standstill.get("dead_zone")
    setup = LoopSetup(
        robot,
        s.of_loop,
        load_controller(folder / CONTROLLER_FILE).law,
        goal,
        start,
        _noise(numbers["estimator_noise"]),
        chosen_zone=None if zone is None else np.array(zone, dtype=float),
    )
    wanted, length = numbers["weights"]["wanted"], float(result["duration"])
    target = wanted and TargetBehaviour(np.array(wanted["bandwidth"], dtype=float), float(wanted["damping"]))

    def in_runs() -> LawEvaluation:
        return pipeline.in_scenario(LawEvaluation(DESIGN, setup), length, target or None, SAMPLES)

    return LoopAtPose(robot, s, setup, length, in_runs)


def _noise(stored: Mapping[str, Any] | None) -> EstimatorNoise | None:
    if stored is None:
        return None
    links, motors = (_levels(stored[name]) for name in ("link_velocities", "motor_velocities"))
    return EstimatorNoise(float(stored["all_states"]), links, motors, str(stored["source"]))


def _levels(stored: float | list[float]) -> Levels:
    return tuple(map(float, stored)) if isinstance(stored, list) else float(stored)
