"""The design or the controller that a command works on, and where the report of another robot is kept."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import flexhinf as fh
from flexhinf import export, pages, report
from flexhinf.cli.messages import note, step_progress
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.validation import checked_path, nearest, value_text

if TYPE_CHECKING:
    from flexhinf.designs import DesignRequest
    from flexhinf.designs.verdict import DesignVerdict


@dataclass(frozen=True, eq=False)
class DesignedController:
    """A controller with robot, specification and judged requirements of its design; of a controller's own file none."""

    controller: fh.Controller
    robot: fh.Robot | None = None
    specification: fh.Specification | None = None
    rows: Sequence[dict[str, Any]] = ()

    @property
    def verdict(self) -> DesignVerdict:
        """On the design, in the units of its pages."""
        from flexhinf.designs.verdict import UNKNOWN, DesignVerdict

        if self.robot is None or self.specification is None:
            return UNKNOWN
        return DesignVerdict.of(self.rows, self.specification.shows_degrees(self.robot))


def controller_file(source: str) -> Path:
    """As `file_of`, of a controller's file or a design file; a robot is refused."""
    from flexhinf.designs.design_file import is_design_file

    path = file_of(source)
    robot_file = path.suffix.lower() in (".toml", ".urdf", ".xml") and path.exists()
    refuse_if(
        (source in fh.catalogue() or robot_file) and not Path(source).is_dir() and not is_design_file(path),
        "A robot has no controller; a design of it has one.",
        f"expected design.toml, the folder of a report or the file of a controller, got {source!r}",
        f"flexhinf design {source} --out DIR, then DIR in the place of {source}",
    )
    return path


def controller_of(
    path: Path, tell: bool = True, limits: bool = False, estimates: bool = True, unmet: bool = True
) -> DesignedController:
    """The controller of a report, of a file, or of a design that is made now, from a `controller_file`; `tell`:
    whether warnings about the robot's file are printed; `limits`: whether inputs without limits are refused;
    `estimates`: whether numbers of the robot may be estimates; `unmet`: whether it may miss its requirements."""
    from flexhinf.designs.design_file import is_design_file

    designed = (
        _of_design(path, tell, limits, estimates)
        if is_design_file(path)
        else DesignedController(fh.load_controller(path))
    )
    refuse_if(
        not unmet and designed.verdict.missed,
        "The design misses its own requirements.",
        f"expected all to be met before a controller leaves for a machine, got {designed.verdict.unmet}",
        "what the report of the design advises, and design again; or --accept-unmet",
    )
    if limits:
        export.check_limits(designed.controller)
    return designed


def _of_design(path: Path, tell: bool, limits: bool, estimates: bool) -> DesignedController:
    from flexhinf.designs.design_file import has_controller
    from flexhinf.designs.verdict import result_row, stored_rows

    if has_controller(path):
        request = _request(path, tell, estimates)
        stored = fh.load_controller(path.parent / "controller")
        return DesignedController(stored, request.robot, request.specification, stored_rows(path))
    design = design_of(path, tell, limits, estimates)
    rows = [result_row(line) for line in design.requirements]
    return DesignedController(design.controller(), design.robot, design.specification, rows)


def design_of(path: Path, tell: bool = True, limits: bool = False, estimates: bool = True) -> fh.Design:
    """The design of a report, or of a design file that is designed now; options as of `controller_of`."""
    from flexhinf.designs import known_design, stages
    from flexhinf.designs.design_file import why_anew

    request = _request(path, tell, estimates)
    if (known := known_design(request)) is not None:
        return known
    robot, specification = request.robot, request.specification
    if why := why_anew(path, robot):
        note(f"{why}: it is designed anew.")
    if limits:  # before the work of a design
        refuse_unlimited(robot, specification)
    with step_progress(stages(robot, specification)) as progress:
        design = fh.design(robot, specification, progress)
    note(pages.ending(design).text)
    return design


def _request(path: Path, tell: bool, estimates: bool) -> DesignRequest:
    from flexhinf.designs import read_request
    from flexhinf.robot.parts import file_warnings

    with file_warnings(note if tell else str):
        request = read_request(path, is_file=True)
    if not estimates:  # before the work of a design
        refuse_estimates(request.robot)
    return request


def refuse_estimates(robot: fh.Robot) -> None:
    """Refuse a robot of which numbers are estimates: a controller for a machine would rest on them."""
    from flexhinf.designs.verdict import estimated_text

    text = estimated_text(robot)
    refuse_if(
        text,
        "The controller rests on numbers that nobody measured.",
        f"expected numbers with a source in the robot's file, got {text}",
        "flexhinf identify on a log of the robot, and its numbers in the robot's file; or --accept-estimates",
    )


def refuse_unlimited(robot: fh.Robot, s: fh.Specification) -> None:
    """Refuse a design, before it is made, whose controller `flexhinf.export.check_limits` would refuse."""
    export.refuse_unlimited(*_unlimited(robot, s))


def note_unlimited(robot: fh.Robot, s: fh.Specification) -> None:
    """Say the same as a note, where the design may be made for something else than an export."""
    free, units = _unlimited(robot, s)
    if free:
        refusal = InvalidInput(
            "flexhinf export c will refuse this design without --no-limits.",
            f"expected a limit of every input, which the drives can take, got none of {', '.join(free)}",
            export.limiting(free, units),
        )
        note(str(refusal))


def _unlimited(robot: fh.Robot, s: fh.Specification) -> tuple[list[str], Mapping[str, str]]:
    """Names of the inputs that neither the robot's file nor the specification limits, and units by signal."""
    import numpy as np

    from flexhinf.designs.responses import joint_limits

    plant, stated = robot.plant(s.measured, extras=s.extras), joint_limits(robot, s).saturated
    most = np.full(len(plant.inputs), np.inf) if stated is None else stated
    return export.unlimited(plant.inputs, -most, most), plant.units


def file_of(source: str, only_design: str = "", then: str = "") -> Path:
    """The file that a source names: of a report's folder its design file; refused where there is none.

    With `only_design`, the first sentence of the refusal, and the command `then`: also where it is no design file.
    """
    from flexhinf.designs.design_file import is_design_file
    from flexhinf.robot.robot_file import usable_below

    path = checked_path("The design", source)
    file = path / "design.toml" if os.path.isdir(path) else path
    what = "path leads to no file and no" if file == path else f"folder {value_text(source, 120)} holds no"
    below = usable_below(path) if file != path else []
    refuse_if(
        not os.path.exists(file) and source not in fh.catalogue(),
        f"There is no file or design {value_text(source, 120)}.",
        f"expected design.toml, the folder of a report or the file of a controller; the {what} design.toml",
        below[0]
        if below
        else nearest(
            path.name, _designs_beside(path), "flexhinf design ROBOT --out DIR, then DIR in its place"
        ).strip("'"),
    )
    refuse_if(
        only_design and not is_design_file(file),
        only_design,
        f"expected design.toml or a report's folder, got {source!r}",
        f"flexhinf design ROBOT --out DIR, then {then}",
    )
    return file


def _designs_beside(path: Path) -> list[str]:
    """Names of folders of designs and of TOML files where a path leads to."""
    with suppress(OSError):
        entries = islice(path.parent.iterdir(), 1000)
        return [e.name for e in entries if e.suffix == ".toml" or (e / "design.toml").is_file()]
    return []


def other_robot(folder: Path, robot: str) -> Path | None:
    """The folder in which the report of another robot is kept where one is in `folder`; a note says so."""
    for name in ("design.json", "comparison.json"):
        if report.unchanged(folder, (name,)):
            earlier = json.loads((folder / name).read_text(encoding="utf-8")).get("robot", robot)
            if earlier != robot:
                base = f"{folder.name}-{export.identifier_of(earlier)}"
                names = (base, *(f"{base}-{k}" for k in range(2, 1000)))
                kept = next(path for path in map(folder.with_name, names) if not path.exists())
                note(f"{folder.name} holds the report of {earlier!r}, which is kept as {kept.name}.")
                return kept
    return None


def keep(folder: Path, kept: Path | None) -> None:
    """Give the report of another robot its own name, before a new one is written in its place."""
    if kept is not None:
        folder.rename(kept)
