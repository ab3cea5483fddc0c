"""One tab: its robot, its specification, what was computed of them last, and what it may do with files."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tomlkit

from flexhinf import export, pages, report
from flexhinf.designs import design, stages as design_stages
from flexhinf.designs.design_file import is_design_file, meant_file, request_document
from flexhinf.designs.fields import home_of
from flexhinf.designs.laws import NL_HINF
from flexhinf.designs.request import DesignRequest, read_request
from flexhinf.designs.responses import Response, default_start
from flexhinf.designs.specification import TORQUE_NOISE, Specification
from flexhinf.designs.stated_units import check_stated_units
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.files import write_file
from flexhinf.studio import controls
from flexhinf.studio.controls import Control
from flexhinf.studio.folder import WorkingFolder
from flexhinf.studio.preview import Band, LinearParts, Nominal, PreviewStage, stages
from flexhinf.studio.worker import Ticket, Work
from flexhinf.validation import one_of, value_text

#: Largest factor of the tolerances.
MOST_TOLERANCES = 10.0

#: The arm without an argument, and its first step, which is long enough for the laws to differ.
FIRST = ("paper", {"pose": "90deg", "start": "0deg", "duration": "4s"})


@dataclass(frozen=True, eq=False)
class Replay:
    """A run that was picked: of robot `k` of a band, or of the nominal robot (−1)."""

    band: Band
    k: int
    run: Response


@dataclass(frozen=True)
class FileNote:
    """A sentence for the page: what was written or is under way."""

    text: str
    done: bool = True


def opened(source: str = "", elastic: str = "") -> DesignRequest:
    """The request of a robot or a design file, as named at the command line; of the paper's arm without a source.

    Of a robot alone, a law of degree 2 or 4 with a stated noise level of the estimator, so that a slider is answered at
    once; a design for a workspace becomes one at the robot's home. Raises InvalidInput as `read_request`.
    """
    name, fields = (source, {}) if source else FIRST
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        file = meant_file(name)
        request = read_request(file, elastic or None, fields)
    texts = tuple(str(warning.message) for warning in caught)
    return replace(at_single_pose(request, design=is_design_file(file)), warnings=texts)


def at_single_pose(request: DesignRequest, design: bool) -> DesignRequest:
    """The request with a goal, a start and, unless it comes from a design file, degree and noise level stated."""
    robot, s, notes = request.robot, request.specification, request.notes
    own: dict[str, Any] = {"law": NL_HINF, "workspace": None}
    if s.law != NL_HINF:
        own |= {"estimator": "none" if s.estimator == "none" else "ukf", "preset": None}
    if s.pose is None:
        own["pose"] = home_of(robot)
        if design:
            notes = (
                *notes,
                "The studio tunes nl-hinf at one pose: the workspace is left out, the goal is the robot's home.",
            )
    if s.start is None and s.move is None:
        goal = robot.operating_point(own.get("pose", s.pose))[0][: len(robot.joint_names)]
        own["start"] = tuple(default_start(robot, goal).tolist())
    if not design:
        if s.degrees is None:
            own["degrees"] = "4" if len(robot.joint_names) == 1 else "2"
        if s.torque_noise is None and s.process_noise is None and s.estimator != "none":
            own["torque_noise"] = TORQUE_NOISE
    return replace(request, specification=replace(s, **own), notes=notes)


class Session:
    """State of one tab; everything on the event loop but the works, which the worker runs."""

    def __init__(self, folder: WorkingFolder, request: DesignRequest) -> None:
        self.folder, self.request, self.tolerances = folder, request, 1.0
        self.robot = request.robot
        self.nominal: Nominal | None = None
        self.band: Band | None = None
        self.linear: LinearParts | None = None

    @property
    def specification(self) -> Specification:
        """What is asked of the loop now."""
        return self.request.specification

    # What is asked ----------------------------------------------------------------------------------------
    def change(self, control: Control, text: str) -> None:
        """Take another value of a control. Raises InvalidInput, and changes nothing, for one that cannot be used."""
        refuse_if(
            len(text) > 2000,
            f"{control.label}: this text is too long.",
            f"expected at most 2000 characters, got {len(text)}",
            "a number, or one per joint",
        )
        if control.key == controls.TOLERANCES:
            self._scale(text)
            return
        s = controls.changed(self.specification, control, text, self.robot)
        check_stated_units(self.robot, s)
        self.request = replace(self.request, specification=s)

    def _scale(self, text: str) -> None:
        factor = _number(text.strip() or "1")
        refuse_if(
            not 0.0 <= factor <= MOST_TOLERANCES,
            "The factor of the tolerances cannot be used.",
            f"expected a number from 0 to {MOST_TOLERANCES:g}, got {value_text(text, 60)}",
            "1",
        )
        base = self.request.robot
        scaled = [replace(p, tolerance=factor * p.tolerance) for p in base.parameters if p.tolerance]
        self.robot = base if factor == 1.0 else base.with_parameters(*scaled)
        self.tolerances = factor

    def preview(self, ticket: Ticket) -> Iterator[PreviewStage]:
        """Work: the stages of the design as it is asked for now."""
        return stages(self.robot, self.specification, ticket.check)

    def keep(self, stage: PreviewStage) -> None:
        """Keep a finished stage; the later ones of an earlier design are forgotten with the first."""
        if isinstance(stage, Nominal):
            self.nominal = stage
        elif isinstance(stage, Band):
            self.band = stage
        else:
            self.linear = stage

    # Runs of the band -----------------------------------------------------------------------------------------
    def replay(self, k: int) -> Work:
        """Work: the run of robot k of the band, or of the nominal robot for −1."""
        band = self.band

        def work(_: Ticket) -> Iterator[Replay]:
            if band is not None:
                yield Replay(band, k, band.nominal.step if k < 0 else band.run(k))

        return work

    # Files ------------------------------------------------------------------------------------------------
    def load(self, name: object) -> None:
        """Take the design of a file of the working folder. Raises InvalidInput, and changes nothing."""
        path = self.folder.check_design(name)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            request = at_single_pose(read_request(path, is_file=True), design=True)
        self.request = replace(request, warnings=tuple(str(warning.message) for warning in caught))
        self.robot, self.tolerances = request.robot, 1.0
        self.nominal = self.band = self.linear = None

    def save(self, name: object) -> str:
        """Write the design as a file of the working folder; what was written, as a sentence.

        Other tolerances than the robot's own go into a robot file beside it. Raises InvalidInput: for a name outside
        the folder, or that of a file which is no design.
        """
        path = self.folder.place("design file", name)
        refuse_if(
            path.suffix != ".toml",
            "A design is saved as TOML.",
            f"expected a name that ends in .toml, got {value_text(str(name), 80)}",
            f"{Path(str(name)).stem}.toml",
        )
        refuse_if(
            path.exists() and not is_design_file(path),
            f"{path.name} is another file.",
            "expected a new name or that of a design file, which is replaced, got one without [design]",
            "design.toml",
        )
        refuse_if(
            not path.parent.is_dir(),
            "There is no such folder.",
            f"expected a folder in {self.folder.root}, got {value_text(str(name), 80)}",
            path.name,
        )
        text, beside = self._design_text(path), ""
        if self.tolerances != 1.0:
            beside = f", with its tolerances in {self._robot_beside(path).name}"
        write_file(path, "design file", lambda part: Path(part).write_text(text, encoding="utf-8"))
        return f"Saved {path.relative_to(self.folder.root)}{beside}."

    def _design_text(self, path: Path) -> str:
        request = self.request
        source, elastic = request.source, request.elastic
        if self.tolerances != 1.0:
            file = str(self._robot_beside(path, write=True))
            source, elastic = (source, file) if elastic else (file, None)
        document = request_document(
            self.specification, source, elastic, path.parent, request.payload, self.robot.links.slides
        )
        return tomlkit.dumps(document)

    def _robot_beside(self, path: Path, write: bool = False) -> Path:
        beside = path.with_name(f"{path.stem}-robot.toml")
        if write:
            self.robot.save(beside, like=self.request.elastic)
        return beside

    def exported(self, kind: str) -> Work:
        """Work: C ("c"), an FMU ("fmu") or a report ("report") of the design that is shown, under a free name of the
        working folder. Raises InvalidInput: for another kind."""
        one_of("There is no such export.", kind, ("c", "fmu", "report"), "report")
        robot, s, nominal, request = self.robot, self.specification, self.nominal, self.request
        folder = self.folder

        def work(ticket: Ticket) -> Iterator[FileNote]:
            if nominal is None:
                raise InvalidInput(
                    "There is no controller yet.",
                    "expected a design whose step is shown, got none",
                    "settings that can be met",
                )
            if kind == "report":
                yield from _report(folder, replace(request, robot=robot, specification=s), ticket)
                return
            name, unlimited = export.identifier_of(robot.name), export.unlimited_inputs(nominal.controller())
            free = f" Nothing limits {', '.join(unlimited)}: state --saturation." if unlimited else ""
            if kind == "c":
                yield FileNote("writing C …", done=False)
                place = folder.free_name(f"{name}-c")
                files = export.controller_files(nominal.controller(), name, robot=robot)
                export.write_files(export.checked_folder(folder.place("folder", place), force=False), files)
                yield FileNote(
                    f"C in {place}: {len(files)} files; make -C {place} test compiles and runs them.{free}"
                )
            else:
                yield FileNote("compiling the FMU …", done=False)
                place = folder.free_name(name, ".fmu")
                export.export_fmu(nominal.controller(), folder.place("file", place), name, limits=False)
                yield FileNote(f"FMU: {place}.{free}")

        return work


def _report(folder: WorkingFolder, request: DesignRequest, ticket: Ticket) -> Iterator[FileNote]:
    place = folder.free_name("flexhinf-design")
    target = report.check(folder.place("folder", place))
    yield FileNote(
        f"designing for the report, about {len(design_stages(request.robot, request.specification))} steps …",
        False,
    )
    result = design(request.robot, request.specification, ticket.check)
    files = pages.design_files(result, (), request.warnings, ("design.toml",))
    files["design.toml"] = pages.design_text(result, request, target)
    report.write(target, files)
    yield FileNote(f"Report: {place}/index.html. Requirements: {result.judgement}.")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
