"""Kinds of exports that take a controller and write one file or folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from flexhinf.designs.specification import Specification
from flexhinf.errors import refuse_if
from flexhinf.extensions import Registry
from flexhinf.loop import Controller
from flexhinf.robot import Robot


@dataclass(frozen=True, eq=False)
class Exported:
    """What is exported: a controller with its design."""

    controller: Controller
    robot: Robot | None = None  # None of a controller's file, which states none
    specification: Specification | None = None
    not_met: str = ""  # Requirements that the design does not meet, in a sentence; empty if it meets all


@dataclass(frozen=True)
class ExportKind:
    """An export that has no options of its own."""

    name: str  # of ``flexhinf export NAME``
    help: str  # one line
    ending: str  # of the file that is written, such as ``.json``; of a folder ``-name``
    write: Callable[
        [Exported, Path], Path
    ]  # writes to a path that is free or may be replaced, and returns it
    check: Callable[[], object] | None = None  # refuses, before any work, what is not installed
    of_design: bool = True  # whether it needs the robot, which the file of a controller does not state


#: All kinds, by name.
EXPORTS: Registry[ExportKind] = Registry("export", __package__ or "")

#: Exports that are commands by themselves.
COMMANDS = ("c", "fmu", "ros2", "compile")


def register(kind: ExportKind) -> ExportKind:
    """Add an export, and return it. Raises `InvalidInput` for a name that is there already or cannot be used."""
    refuse_if(
        kind.name in COMMANDS,
        f"There are two of the export {kind.name!r}.",
        f"expected another name than {', '.join(COMMANDS)}, got {kind.name!r}",
        f"my_{kind.name}",
    )
    return EXPORTS.register(kind)
