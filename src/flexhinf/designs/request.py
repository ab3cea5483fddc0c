"""Request of a design: a robot and a specification, from their files and from what wins over these.

Goals and waypoints of a point of the robot, x, y, z in the world, become positions of the joints here; all later steps
use these only. Between two waypoints the joints move smoothly; the point does not follow a straight line.
"""

# Not checked strictly: what a caller passes may be of another type than stated.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.designs.design_file import DESIGN_FILE, is_design_file, point_of, read_tables, tool_of
from flexhinf.designs.fields import resolved, with_home
from flexhinf.designs.own_sensors import with_own_sensors
from flexhinf.designs.specification import Specification
from flexhinf.designs.stated_units import check_stated_units
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.robot import Robot, kinematics, load_robot
from flexhinf.robot.waypoints import ORIGIN, Tool, WaypointTable, in_space, reached_waypoints
from flexhinf.validation import checked_kind, checked_path, value_text


@dataclass(frozen=True, eq=False)
class DesignRequest:
    """Robot and specification that a command works on, and where they come from."""

    robot: Robot
    specification: Specification
    # source, elastic, payload: Where the robot came from and what it carries, as `load_robot` takes them
    source: str
    elastic: str | None = None
    notes: tuple[str, ...] = ()  # Notes for the user, printed before the work
    payload: str | None = None
    warnings: tuple[str, ...] = ()  # Warnings of the robot's file, for the report
    file: Path | None = None  # The design file, beside which a controller may be

    @property
    def argument(self) -> str:
        """How a command names it: its design file or the folder of that, or the robot's files."""
        if self.file is not None:
            return shlex.quote(str(self.file.parent if self.file.name == DESIGN_FILE else self.file))
        springs = "" if self.elastic is None else f" --elastic {shlex.quote(self.elastic)}"
        return f"{shlex.quote(self.source)}{springs}"


def read_request(
    source: str | Path,
    elastic: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    payload: str | None = None,
    is_file: bool | None = None,
    goal: str = "",
    tool: str = "",
    of_run: bool = False,
) -> DesignRequest:
    """The request of a robot, or of a design file over which `settings` win.

    `source`: as for `load_robot`, or a design file; `is_file` says which where that is known.
    `elastic`: with a URDF; wins over a design file's.
    `settings`: fields of a specification; None restores the default instead of the file's value. A preset, bandwidth or
    damping in `settings` replaces weights in the file, and the other way round, with an entry in `DesignRequest.notes`.
    `payload`: as for `load_robot`; wins over a design file's.
    `goal`, `tool`: a point ``x,y,z`` that the tool is to reach, in place of a pose, and the tool.
    `of_run`: whether `settings` are of a run, with a motion of its own, of the controller that the file is of.
    Raises InvalidInput: for a file or a value that cannot be used.
    """
    settings, places, fields, file = dict(settings or {}), {"robot": str(source)}, {}, None
    if is_design_file(source) if is_file is None else is_file:
        file = checked_path("The design file", source)
        places, fields = read_tables(file)
        fields = {name: value for name, value in fields.items() if name not in settings}
    # fields that contradict one of the settings where the file states the preset paper or another; see `preset_of`
    preset, other = (("preset",), ()) if fields.get("preset") == "paper" else ((), ("preset",))
    contradicted: dict[str, tuple[str, ...]] = {
        "penalty": ("bandwidth", "damping", "preset"),
        "effort": ("bandwidth", "damping", *other),
        "bandwidth": ("penalty", "effort", *preset),
        "damping": ("penalty", "effort", *preset),
        "preset": ("penalty", "bandwidth", "damping")
        if settings.get("preset") == "paper"
        else ("penalty", "effort"),
    }
    rivals = {
        rival: name
        for name, value in settings.items()
        for rival in contradicted.get(name, ())
        if value is not None and rival in fields
    }
    notes = [f"{Path(source).name}: {rival} gives way to `{name}`" for rival, name in rivals.items()]
    if not of_run:
        fields, more = _of_task(fields, settings, goal, Path(source).name)
        notes += more
    stated = {name: value for name, value in fields.items() if name not in rivals} | settings
    s = Specification(**{name: value for name, value in stated.items() if value is not None})
    beside = places.get("elastic") if elastic is None else str(elastic)
    load = places.get("payload") if payload is None else payload
    robot = load_robot(places["robot"], beside, payload=load)
    check_stated_units(robot, s)
    s = with_own_sensors(robot, with_home(robot, s))
    own = {
        "peak_effort": robot.effort_limits,
        "saturation": robot.effort_limits,
        "peak_speed": robot.speed_limits,
    }
    for name, limits in own.items():  # an infinite limit is the default where the robot states none
        if np.isinf(np.array(limits, dtype=float)).all() and getattr(s, name) == np.inf:
            s = replace(s, **{name: None})
    request = DesignRequest(robot, s, places["robot"], beside, tuple(notes), load, file=file)
    request = with_joints(request, goal, tool)
    return request if of_run else replace(request, specification=resolved(robot, request.specification))


def _of_task(
    fields: Mapping[str, Any], settings: Mapping[str, Any], goal: str, name: str
) -> tuple[dict[str, Any], list[str]]:
    """The fields of a file without those that a task of the settings replaces, and notes; files before laws had names
    said `ukf` of what ran the modal filter."""
    kept, notes = dict(fields), list[str]()
    for stated, other in (("pose", "workspace"), ("workspace", "pose")):
        if (settings.get(stated) is not None or (goal and stated == "pose")) and other in kept:
            del kept[other]
            notes.append(f"{name}: {other} gives way to `{stated}`")
    if kept.get("estimator") == "ukf" and not {"law", "pose"} & {*kept}:
        del kept["estimator"]
        notes.append(f"{name}: estimator ukf, without a law, is read as auto; it ran the modal filter")
    return kept, notes


def with_joints(request: DesignRequest, goal: str = "", tool: str = "") -> DesignRequest:
    """The request with its goal ``x,y,z`` (m, or with a unit) and waypoints as positions of the joints, and notes."""
    robot, s, notes, point = request.robot, request.specification, list(request.notes), tool_of(tool)
    tables = {name: getattr(s, name) for name in ("move", "workspace")}
    tables = {name: table for name, table in tables.items() if in_space(robot, table)}
    box = tool and isinstance(s.workspace, str) and "=" in s.workspace and "@" not in s.workspace
    s = replace(s, workspace=f"{s.workspace}@{tool}") if box else s
    refuse_if(
        tool and not goal and not tables and not box,
        "A tool is stated, and nothing that it is to reach.",
        "expected --pose-xyz, a box in space, or waypoints with columns x, y, z, got --tool "
        f"{value_text(tool, 60)} alone",
        "--pose-xyz 0.4,0,0.3, --workspace x=0.2:0.5, or leave out --tool",
    )
    if goal:
        refuse_if(
            s.pose is not None,
            "The goal is stated twice.",
            f"expected --pose-xyz or --pose, got {value_text(goal, 60)} and {s.pose}",
            'leave out one of them (--pose "" takes back that of a design file)',
        )
        reached = kinematics.pose_at(robot, point_of("pose-xyz", goal), point.link, point.offset, s.start)
        s = replace(s, pose=tuple(reached.pose.tolist()))
        notes += [f"The goal is the pose {_text(reached.pose)}.", *_singular("the goal", reached)]
    for name, table in tables.items():
        table, worst = reached_waypoints(robot, table, point)
        s = replace(s, **{name: table})
        notes += _singular("one of the waypoints", worst)
    return replace(request, specification=s, notes=tuple(notes))


def joint_waypoints(robot: Robot, table: WaypointTable, tool: Tool = ORIGIN) -> WaypointTable:
    """Waypoints x, y, z of a point as waypoints of the joints, each pose by a search from the one before.

    Raises InvalidInput: for a place out of reach, with its time; for more than 500 waypoints; for columns that are
        not x, y, z.
    """
    return reached_waypoints(robot, table, tool)[0]


def _singular(what: str, at: kinematics.Reached) -> list[str]:
    text = (
        f"At {what}, {_text(at.pose)}, the robot is near a singular pose: in one direction its point moves by only "
        f"{at.mobility:.2g} of what it does elsewhere, so small errors of the place are large ones of the joints."
    )
    return [text] if at.mobility < kinematics.SINGULAR else []


def _text(pose: np.ndarray) -> str:
    return f"({', '.join(f'{value:.4g}' for value in pose)})"


def checked_specification(robot: Robot, specification: Specification | None) -> Specification:
    """The specification, by default its defaults; refuses what is no robot, such as its file, or no specification."""
    checked_kind("This is no robot.", robot, Robot, "a flexhinf.Robot", "flexhinf.load_robot('arm.toml')")
    specification = Specification() if specification is None else specification
    if not isinstance(specification, Specification):
        found = f"expected a flexhinf.Specification, got {value_text(specification)}"
        raise InvalidInput("This is no specification.", found, "flexhinf.Specification(pose='90deg')")
    return resolved(robot, with_own_sensors(robot, specification))
