"""The report of one controller for a workspace: what was looked at, where, and what came of it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.design.design_file import plain
from flexhinf.design.responses import motion_metrics
from flexhinf.design.specification import FIELDS
from flexhinf.design.workspace import GAIN, PoseLoop, WorkspaceDesign, pose_limits
from flexhinf.loop.simulation.metrics import WINDOW
from flexhinf.pages.drawing import Line, Panel, count_text, draw_figure, joint_count, line_style
from flexhinf.pages.page import files_section, requirement_table, requirement_text
from flexhinf.report import (
    KeyNumber,
    Page,
    Paragraph,
    Provenance,
    Section,
    Setting,
    Settings,
    Status,
    Table,
    finite,
    house_style,
    number,
)

#: Columns of the table of moves: key of `motion_metrics`, heading, factor of the number that is shown.
COLUMNS = {
    "remaining_error": ("remains, mrad or mm", 1e3), "wrong_way_percent": ("wrong way, %", 1.0),
    "path_distance": ("off the path, mrad or mm", 1e3), "ripple_percent": ("ripple, % of the limit", 1.0),
}  # fmt: skip


def workspace_verdict(design: WorkspaceDesign) -> str:
    """Whether the requirements are met, and by what."""
    missed = [requirement_text(line) for line in design.requirements if not line.met]
    law = design.setup.law.gains
    text = (
        f"One controller for {range_of(design)}; over it the frequencies of the pairs range from "
        f"{number(np.sqrt(law.ends[0]), 3)} to {number(np.sqrt(law.ends[1]), 3)} rad/s."
    )
    return f"{text} {'Not met: ' + '; '.join(missed) if missed else 'Every requirement is met'}."


def workspace_tables(design: WorkspaceDesign) -> list[Any]:
    """Requirements, poses and moves for a terminal."""
    return [
        t.terminal()
        for t in (requirement_table(design.requirements), _pose_table(design), _move_table(design))
    ]


def range_of(design: WorkspaceDesign) -> str:
    """The workspace in words."""
    space = design.setup.workspace
    where = "the joint ranges" if space.path is None else "the stated moves"
    return "the stated box in space" if space.box is not None else where


def worst_motion(design: WorkspaceDesign, moves: Sequence[Any]) -> list[dict[str, float]]:
    """The worst joint of each move, by the keys of `COLUMNS`; NaN where a number does not exist."""
    rows = []
    for move in moves:
        found = motion_metrics(design.setup.limits, move.response, move.plan)
        rows.append({key: max((row.get(key, np.nan) for row in found), default=np.inf) for key in COLUMNS})
    return rows


def workspace_page(
    design: WorkspaceDesign, command: Sequence[str], warnings: Sequence[str] = (), files: Sequence[str] = ()
) -> Page:
    """The page of a controller for a workspace; parameters as for `flexhinf.pages.page.design_page`."""
    setup, loops = design.setup, design.loops
    robot, s = setup.robot, setup.specification
    with house_style():
        sections = {
            ("Requirements", "specification"): [
                requirement_table(design.requirements),
                *(Paragraph(" ".join(text.split())) for text in warnings),
            ],
            (f"Loops at {len(loops)} poses", "poses"): [_pose_table(design), _pose_figure(loops)],
            (f"{count_text(len(design.moves), 'move')} between random goals", "moves"): [_move_table(design)],
        }
    met = all(line.met for line in design.requirements)
    lines = [requirement_text(line) for line in design.requirements if not line.met]
    return Page(
        f"A controller for the workspace of {robot.name}",
        f"{joint_count(len(robot.joint_names)).capitalize()}, {robot.drive} driven. Measured: "
        f"{', '.join(s.measured).replace('_', ' ') if s.estimator != 'none' else 'the true state'}.",
        workspace_verdict(design),
        (
            *(Section(title, tuple(blocks), anchor) for (title, anchor), blocks in sections.items()),
            *([files_section(files)] if files else []),
        ),
        Settings({"Specification": [
            Setting(name.replace("_", " "), str(plain(name, getattr(s, name))))
            for name, field in FIELDS.items() if getattr(s, name) != field.default
        ]}),
        Provenance(shlex.join(command), s.seed),
        _key_numbers(design),
        [
            Status("met", f"{len(design.requirements)} requirements.") if met else
            Status("not met", f"{'; '.join(lines)}."),
            Status("not proved", "Poses, moves and robots are random samples; nothing is proved between them."),
        ],
    )  # fmt: skip


def _key_numbers(design: WorkspaceDesign) -> list[KeyNumber]:
    rows = worst_motion(design, design.moves)
    worst = {key: max(row[key] for row in rows) for key in COLUMNS}
    return [
        KeyNumber("least damping", number(min(loop.damping for loop in design.loops), 3), "", "at any pose"),
        *(
            KeyNumber(
                title.partition(",")[0], number(factor * worst[key], 3), title.partition(",")[2], "worst"
            )
            for key, (title, factor) in COLUMNS.items()
            if not np.isnan(worst[key])
        ),
    ]


def _pose_table(design: WorkspaceDesign) -> Table:
    loops, (damping, ripple) = design.loops, pose_limits(design.setup.specification)
    extra = design.setup.specification.delay_margin_limit or 0.0
    rows = [
        ("slow oscillations: damping", *_ends([loop.damping for loop in loops]), f"≥ {damping:g}"),
        ("faster ones", *_ends([loop.fast_damping for loop in loops]), "stable"),
        ("faster ones, springs damped by 0.5 % more", *_ends([loop.damped_fast for loop in loops]), ""),
        ("ripple by the sensors' noise, %", *_ends([loop.ripple for loop in loops]), f"≤ {ripple:g}"),
        ("growth in a sample", *_ends([loop.growth for loop in loops]), "< 1"),
        (f"{extra:g} more samples of delay", *_ends([loop.late for loop in loops]), "< 1"),
        ("the same, springs damped by 0.5 % more", *_ends([loop.damped_late for loop in loops]), ""),
        (f"all inputs times {GAIN:g}", *_ends([loop.louder for loop in loops]), "< 1"),
        (f"all inputs times {1.0 / GAIN:g}", *_ends([loop.softer for loop in loops]), "< 1"),
    ]
    caption = (
        "Sampled loops, linearised at rest, with estimator and latency. Growth is the largest |z| of a mode."
    )
    return Table(("of the loops at random poses", "least", "largest", "required"), rows, caption)


def _ends(values: Sequence[float]) -> tuple[str, str]:
    return number(min(values), 4), number(max(values), 4)


def _pose_figure(loops: Sequence[PoseLoop]) -> Any:
    shares = np.linspace(0.0, 100.0, len(loops))
    lines = [
        Line(shares, np.sort([getattr(loop, key) for loop in loops]), name, line_style(k))
        for k, (key, name) in enumerate(
            {"damping": "slow oscillations", "fast_damping": "faster ones"}.items()
        )
    ]
    panel = Panel("smallest damping ratio", "", lines, across="poses with less (%)")
    caption = "The smallest damping ratio at each pose, in ascending order."
    return draw_figure("poses", [panel], caption, "Damping over the workspace")


def _move_table(design: WorkspaceDesign) -> Table:
    rows = []
    for which, moves in (("nominal robot", design.moves), ("corners of the tolerances", design.sampled)):
        found = worst_motion(design, moves)
        if found:
            columns = [np.array([factor * row[key] for row in found]) for key, (_, factor) in COLUMNS.items()]
            rows.append(
                (
                    which,
                    *(
                        "–" if np.isnan(c).any() else f"{number(np.median(c), 3)}, {number(c.max(), 3)}"
                        for c in columns
                    ),
                )
            )
    head = ("moves of the", *(f"{title}: median, worst" for title, _ in COLUMNS.values()))
    caption = (
        "Quintics at half the speed limits, one after the other, with feedforward; what remains is the largest error "
        f"in the last {WINDOW:g} s."
    )
    return Table(head, rows, caption, stacks=True)


def workspace_numbers(design: WorkspaceDesign) -> dict[str, Any]:
    """What design.json holds of a controller for a workspace."""
    law = design.setup.law.gains
    return {
        "version": 1, "kind": "workspace", "met": design.met,
        "pairs": {"ends": list(law.ends), "motor": law.motor, "damping": law.damping},
        "requirements": [
            {key: getattr(line, key) for key in ("what", "where", "limit", "found", "unit", "met")}
            for line in design.requirements
        ],
        "poses": [
            {"pose": pose.tolist(), **dict(zip(PoseLoop._fields, finite(list(loop))))}
            for pose, loop in zip(design.poses, design.loops)
        ],
        "moves": _known(worst_motion(design, design.moves)),
        "sampled_moves": _known(worst_motion(design, design.sampled)),
    }  # fmt: skip


def _known(rows: list[dict[str, float]]) -> list[dict[str, float | None]]:
    return [{key: value if np.isfinite(value) else None for key, value in row.items()} for row in rows]
