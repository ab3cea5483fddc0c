"""Files of a report: page, numbers in SI units, controller, every run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomlkit

from flexhinf import copies
from flexhinf.designs import design_file
from flexhinf.designs.advice import Advice
from flexhinf.designs.compare import Comparison
from flexhinf.designs.design_file import CONTROLLER_FILE, plain
from flexhinf.designs.fields import estimator_of
from flexhinf.designs.numbers_file import NUMBERS_FILE, TASK, VERSION
from flexhinf.designs.request import DesignRequest
from flexhinf.designs.requirements import REPORT
from flexhinf.designs.result import Design
from flexhinf.designs.verdict import result_row
from flexhinf.designs.workspace.evidence import WorkspaceEvidence
from flexhinf.errors import InvalidInput
from flexhinf.loop import Trajectory
from flexhinf.pages.comparison import comparison_numbers, comparison_page
from flexhinf.pages.page import files_section
from flexhinf.pages.parts import PARTS, run_file
from flexhinf.pages.saved import saved_files
from flexhinf.pages.terminal import Ending
from flexhinf.pages.workspace import Pictures, workspace_pictures
from flexhinf.report import finite, to_json, write
from flexhinf.robot import catalogue, load_robot
from flexhinf.robot.saved_file import robot_text

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: In the folder of a report: the robot's file, where its numbers are not those of the file that it was read from.
ROBOT_FILE = "robot.toml"


def design_files(
    design: Design,
    command: Sequence[str],
    warnings: Sequence[str] = (),
    beside: Sequence[str] = (),
    advice: Advice | None = None,
    early: EarlyParts | None = None,
) -> dict[str, str | bytes]:
    """Files of a report: index.html, design.json, controller, runs of the nominal robot, and what is proved.

    `command` makes the report again (none for one that is written from Python), `warnings` are about the robot's file,
    and `beside` names files that the caller writes into the same folder: the page lists them. `advice` is what was
    tried afterwards, and `early` has figures and runs that another process makes, where there is one.
    """
    parts = PARTS(design.evidence)
    with nullcontext(early.runs) if early else saved_files(_run_files(parts.runs)) as runs:
        # while another process writes the runs
        page, numbers = (
            parts.page(command, warnings, advice, early and early.pictures),
            to_json(design_numbers(design)),
        )
        own = {CONTROLLER_FILE: design.controller().save} if design.loop.has_controller else {}
        with saved_files(own, beside=False) as controller:
            files = {NUMBERS_FILE: numbers, **controller(), **runs(), **parts.files()}
    page = replace(page, sections=(*page.sections, files_section((*files, *beside))))
    return {"index.html": page.html(), **files}


class EarlyParts(ExitStack):
    """The figures and the runs of a report on a design for a workspace, by functions that wait for them.

    Where there are other processes, these draw and save them from `begin` on.
    """

    pictures: Callable[[], Pictures]
    runs: Callable[[], Mapping[str, bytes]]  # contents of files by name

    def begin(self, evidence: WorkspaceEvidence) -> None:
        """Begin both; when this is left, they are known or given up."""
        self.pictures = self.enter_context(copies.beside(lambda: workspace_pictures(evidence)))
        self.runs = cache(self.enter_context(saved_files(_run_files(PARTS(evidence).runs))))


def design_numbers(design: Design) -> dict[str, Any]:
    """What design.json holds, by `designs.numbers_file.numbers_schema`."""
    parts, s = PARTS(design.evidence), design.specification
    task = {
        name: None if (value := getattr(s, name)) is None else plain(name, value)
        for name in TASK["properties"]
    }
    return finite(
        {
            "version": VERSION,
            "robot": design.robot.name,
            "joints": design.robot.joint_names,
            "task": task,
            "law": s.law,
            "estimator": estimator_of(design.robot, s),
            "controller": CONTROLLER_FILE if design.loop.has_controller else None,
            "verdict": parts.verdict(),
            "met": design.met,
            "notes": parts.notes(),
            "requirements": [line.row for line in design.requirements],
            "loops": parts.loops(),
            "runs": parts.run_rows(),
            "facts": parts.facts(),
        }
    )


def _run_files(runs: Mapping[str, Trajectory]) -> dict[str, Callable[[Path], object]]:
    return {run_file(name): run.save for name, run in runs.items()}


def comparison_files(
    comparison: Comparison,
    command: Sequence[str],
    warnings: Sequence[str] = (),
    beside: Sequence[str] = (),
) -> dict[str, str | bytes]:
    """Files of a report: index.html and comparison.json; parameters as for `design_files`."""
    files = {"comparison.json": to_json(comparison_numbers(comparison))}
    return {"index.html": comparison_page(comparison, command, warnings, (*files, *beside)).html(), **files}


@REPORT.register(Comparison)
def write_comparison(result: Comparison, folder: str | Path) -> Path:
    """Write the report of a comparison into a folder, which is returned; raises as `report.write`."""
    return write(folder, comparison_files(result, ()))


@REPORT.register(Design)
def write_report(result: Design, folder: str | Path) -> Path:
    """Write the report of a design into a folder, which is returned; raises as `report.write`.

    Beside it stands its design file, where the robot is of the catalogue or of a file that states its numbers.
    """
    own, origins = _design_file(result, folder)
    parts = PARTS(result.evidence)
    files = design_files(result, (), beside=tuple(own)) if parts.read is None else parts.files()
    return write(folder, {**files, **own}, origins)


def _design_file(design: Design, folder: str | Path) -> tuple[dict[str, str | bytes], dict[str, str]]:
    """The design file of a design that was made or read in Python, with the robot's file where its numbers were
    changed, and digests of the robot's files; empty for a robot or a penalty that no file states."""
    robot, files = design.robot, dict[str, str | bytes]()
    if robot.file is None:
        return files, {}
    names = {path: name for name, path in catalogue().items()}
    source = names.get(robot.file, str(robot.file))
    request = PARTS(design.evidence).read or DesignRequest(robot, design.specification, source)
    with suppress(InvalidInput):
        origins = design_file.robot_digests(request.source, request.elastic, folder)
        if load_robot(request.source, request.elastic, payload=request.payload) != robot:
            text = robot_text(robot, Path(folder))
            files[ROBOT_FILE] = text
            origins |= {ROBOT_FILE: sha256(text.encode("utf-8")).hexdigest()}
            request = DesignRequest(robot, design.specification, str(Path(folder) / ROBOT_FILE))
        return {**files, design_file.DESIGN_FILE: design_text(design, request, folder)}, origins
    return {}, {}


def details(design: Design) -> tuple[list[Terminal], Sequence[str], str]:
    """Every table, note and sentence of a design for a terminal."""
    parts = PARTS(design.evidence)
    return parts.tables(), parts.notes(), parts.verdict()


def ending(design: Design, advice: Advice | None = None) -> Ending:
    """What a terminal says of a design at the end, with what was tried after it."""
    return PARTS(design.evidence).ending(advice)


def design_text(design: Design, request: DesignRequest, folder: str | Path = ".") -> str:
    """Text of the design file of a design: the request, and the result.

    `request`: where the robot came from, and its payload.
    `folder`: of the file; its paths are relative to it.

    InvalidInput if the penalty is code.
    """
    document = design_file.request_document(
        design.specification,
        request.source,
        request.elastic,
        folder,
        request.payload,
        design.robot.links.slides,
    )
    document.add(tomlkit.nl())
    document.add(tomlkit.comment("What came of it. This part is not read: changing it changes nothing."))
    rows = [result_row(line) for line in design.requirements]
    table = {**PARTS(design.evidence).result(), "requirements": rows}
    document.add("result", design_file.toml_table({k: v for k, v in table.items() if v is not None}))
    return tomlkit.dumps(document)
