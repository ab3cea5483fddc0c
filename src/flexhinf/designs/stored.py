"""A design read back from the folder of its report, with its numbers."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.designs.about_pose import in_scenario
from flexhinf.designs.compare import Progress
from flexhinf.designs.design_file import (
    CONTROLLER_FILE,
    DESIGN_FILE,
    fields_text,
    why_anew,
)
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.evidence import DesignedLoop
from flexhinf.designs.fields import law_of
from flexhinf.designs.judged import Judged
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.noise_levels import EstimatorNoise, Levels
from flexhinf.designs.numbers_file import NUMBERS_FILE, VERSION
from flexhinf.designs.pipeline import loop_of
from flexhinf.designs.plans import stated_move
from flexhinf.designs.pose_loop import LoopAtPose
from flexhinf.designs.problem.weights import TargetBehaviour
from flexhinf.designs.request import DesignRequest, read_request
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.responses import start_and_goal
from flexhinf.designs.result import Design, judged_by, verdict_on
from flexhinf.designs.specification import Specification
from flexhinf.designs.verdict import DesignVerdict
from flexhinf.designs.workspace.evidence import LoopOverWorkspace
from flexhinf.designs.workspace.law_file import known_law
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop import load_controller
from flexhinf.report import contents, finite, is_listed, is_report, unchanged
from flexhinf.robot import Robot
from flexhinf.robot.parts import file_warnings
from flexhinf.validation import checked_path, is_file, read_bytes, read_toml, value_text

#: Largest size of the file of numbers, bytes.
MOST = 100_000_000


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
    >>> quick = dict(degrees="2", draws=0, rays=0, proof_seconds=0, estimator="none")
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
    kept = (CONTROLLER_FILE,) if is_listed(file.parent, CONTROLLER_FILE) else ()
    for name in (DESIGN_FILE, NUMBERS_FILE, *kept):
        if not unchanged(file.parent, (name,)):
            raise _anew(file, f"{name}, which was changed or lost since the report")
    return judged_by(_stored(request, file))


def known_design(request: DesignRequest) -> Design | None:
    """The design of a request that names an unchanged report of it; None for another request."""
    file = request.file
    if file is None or file.name != DESIGN_FILE or not unchanged(file.parent, (DESIGN_FILE, NUMBERS_FILE)):
        return None
    if why_anew(file):
        return None
    with file_warnings(str):  # the request has told them
        stored = read_request(file, is_file=True)
    same = fields_text(stored.specification) == fields_text(request.specification)
    if not same or stored.robot != request.robot:
        return None
    return judged_by(_stored(stored, file))


def requested_loop(
    request: DesignRequest, progress: Progress = lambda text: None
) -> tuple[DesignedLoop, DesignVerdict]:
    """The loop of a requested design and the verdict on it: of an unchanged report, or designed and not judged."""
    known = known_design(request)
    loop = loop_of(request.robot, request.specification, progress) if known is None else known.loop
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
        if numbers["version"] != VERSION:
            raise _anew(file, f"{NUMBERS_FILE} of version {numbers['version']}, not {VERSION}")
        if (numbers["robot"], numbers["law"]) != (request.robot.name, request.specification.law):
            raise _anew(file, f"{NUMBERS_FILE} of another design than {DESIGN_FILE}")
        loop = _loop_of(request, file.parent, numbers["facts"], table)
        rows = zip(table["requirements"], numbers["requirements"], strict=True)
        lines = tuple(_requirement(*each) for each in rows)
    except InvalidInput:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        why = f"{NUMBERS_FILE} and {DESIGN_FILE}, of which one lacks {value_text(str(error), 120)}"
        raise _anew(file, why) from error
    result = {name: value for name, value in table.items() if name != "requirements"}
    return StoredReport(request, lines, loop, file.parent.resolve(), result)


def _requirement(row: Mapping[str, Any], numbers: Mapping[str, Any]) -> Requirement:
    """A judged requirement: its row of the design file, which has infinite numbers, with the rest from the report's
    numbers; a ValueError where the two contradict each other."""
    whole = {**numbers, **row}
    line = Requirement(**{field.name: whole[field.name] for field in fields(Requirement)})
    if finite(line.row) != numbers:
        raise ValueError(f"one and the same requirement on the {row['what']}")
    return line


def _loop_of(
    request: DesignRequest, folder: Path, facts: Mapping[str, Any], result: Mapping[str, Any]
) -> DesignedLoop:
    robot, s = request.robot, request.specification
    if law_of(s).any_pose:
        return LoopOverWorkspace(known_law(robot, s, facts))
    start, goal = start_and_goal(robot, s, stated_move(robot, s))
    standstill: Mapping[str, Any] = facts.get("rest") or {}
    zone = standstill.get("dead_zone")
    setup = LoopSetup(
        robot,
        s.of_loop,
        load_controller(folder / CONTROLLER_FILE).law,
        goal,
        start,
        _noise(facts["estimator_noise"]),
        chosen_zone=None if zone is None else np.array(zone, dtype=float),
    )
    wanted, length = facts["weights"]["wanted"], float(result["duration"])
    target = wanted and TargetBehaviour(np.array(wanted["bandwidth"], dtype=float), float(wanted["damping"]))

    def in_runs() -> LawEvaluation:
        return in_scenario(LawEvaluation(setup), length, target or None)

    return LoopAtPose(robot, s, setup, length, in_runs)


def _noise(stored: Mapping[str, Any] | None) -> EstimatorNoise | None:
    if stored is None:
        return None
    links, motors = (_levels(stored[name]) for name in ("link_velocities", "motor_velocities"))
    return EstimatorNoise(float(stored["all_states"]), links, motors, str(stored["source"]))


def _levels(stored: float | list[float]) -> Levels:
    return tuple(map(float, stored)) if isinstance(stored, list) else float(stored)
