"""The report of one controller for a workspace: what was looked at, where, and what came of it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.design.design_file import plain
from flexhinf.design.plans import SPEED, UNLIMITED
from flexhinf.design.responses import Move
from flexhinf.design.specification import FIELDS, OF_WORKSPACE
from flexhinf.design.workspace import (
    FASTEST,
    HOLD,
    LATEST,
    LOUDEST,
    PoseLoop,
    Robustness,
    WorkspaceDesign,
    corner_damping,
    gain_limit,
    pose_limits,
    robustness,
)
from flexhinf.estimation import ModalFilter
from flexhinf.loop.simulation.metrics import WINDOW
from flexhinf.pages.drawing import (
    Line,
    Panel,
    Units,
    count_text,
    draw_figure,
    joint_count,
    joint_panel,
    line_style,
    pose_text,
)
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

#: What the section about tolerance begins with.
PAIRS = (
    "At any pose an arm of n elastic joints vibrates in n ways, each of which is like one link on one spring with one "
    "motor. The law knows only their frequencies, which change with the pose. So what holds for every frequency of a "
    "range holds at every pose that has its vibrations there."
)

#: Columns of the table of moves: key of `motion_metrics`, heading, factor of the number that is shown.
COLUMNS = {
    "remaining_error": ("remains, {small}", 1e3), "wrong_way_percent": ("wrong way, %", 1.0),
    "path_distance": ("off the path, {small}", 1e3), "ripple_percent": ("ripple, % of the limit", 1.0),
}  # fmt: skip


def workspace_verdict(design: WorkspaceDesign) -> str:
    """Whether the requirements are met, and by what."""
    missed = _missed_text(design)
    tested = f"{count_text(len(design.loops), 'random pose')}, {count_text(len(design.moves), 'move')}"
    if design.corner_loops:
        tested += ", the poses again with robots at corners of their tolerances"
    if design.sampled:
        tested += f", {count_text(len(design.sampled), 'move')} of robots at corners of their tolerances"
    judged = f"Not met: {missed}" if missed else "Every requirement is met"
    return f"{judged}. One controller for {range_of(design)}; looked at: {tested}."


def _missed_text(design: WorkspaceDesign) -> str:
    return "; ".join(map(requirement_text, design.missed))


def workspace_tables(design: WorkspaceDesign) -> list[Any]:
    """Requirements, poses and moves for a terminal."""
    return [
        t.terminal()
        for t in (
            requirement_table(design.requirements, design.specification.in_degrees),
            _pose_table(design),
            _move_table(design),
        )
    ]


def range_of(design: WorkspaceDesign) -> str:
    """The workspace in words."""
    space = design.setup.workspace
    where = "the joint ranges" if space.path is None else "the stated moves"
    return "the stated box in space" if space.box is not None else where


def worst_motion(moves: Sequence[Move]) -> list[dict[str, float]]:
    """The worst joint of each move, by the keys of `COLUMNS`; NaN where a number does not exist."""
    rows = []
    for move in moves:
        found = move.motion
        rows.append({key: _largest([row.get(key) for row in found], bool(found)) for key in COLUMNS})
    return rows


def _titles(design: WorkspaceDesign) -> list[str]:
    """Headings of `COLUMNS`, small deviations in the units of the joints."""
    small = Units(design.setup.model, design.setup.joints).small[0]
    return [title.format(small=small) for title, _ in COLUMNS.values()]


def _largest(values: Sequence[float | None], exists: bool = True) -> float:
    """The largest value that is known; NaN if none is, infinite where a run diverged and has none."""
    return max((value for value in values if value is not None), default=np.nan) if exists else np.inf


def workspace_page(
    design: WorkspaceDesign, command: Sequence[str], warnings: Sequence[str] = (), files: Sequence[str] = ()
) -> Page:
    """The page of a controller for a workspace; parameters as for `flexhinf.pages.page.design_page`."""
    setup, loops = design.setup, design.loops
    robot, s, tolerated = setup.robot, setup.specification, robustness(design)
    with house_style():
        sections = {
            ("Requirements", "specification"): [
                requirement_table(design.requirements, s.in_degrees),
                *(Paragraph(" ".join(text.split())) for text in warnings),
            ],
            (f"Loops at {len(loops)} poses", "poses"): [_pose_table(design), _pose_figure(loops)],
            (f"{count_text(len(design.moves), 'move')} between random goals", "moves"): [
                _move_table(design),
                _joint_table(design),
                _goal_table(design, tolerated),
                _move_figure(design),
            ],
            ("What it tolerates beyond that", "tolerance"): [
                Paragraph(PAIRS),
                _margin_table(design, tolerated),
                _pair_table(design, tolerated),
            ],
        }
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
            for name in OF_WORKSPACE if getattr(s, name) != FIELDS[name].default
        ]}),
        Provenance(shlex.join(command), s.seed),
        _key_numbers(design),
        [
            Status("met", f"{len(design.requirements)} requirements.") if design.met else
            Status("not met", f"{_missed_text(design)}."),
            Status("not proved", _not_proved(design, tolerated)),
        ],
    )  # fmt: skip


def _key_numbers(design: WorkspaceDesign) -> list[KeyNumber]:
    rows = worst_motion(design.moves)
    worst = {key: max(row[key] for row in rows) for key in COLUMNS}
    return [
        KeyNumber(
            "least damping",
            number(min(loop.damping for loop in (*design.loops, *design.corner_loops)), 3),
            "",
            "at any pose",
        ),
        *(
            KeyNumber(
                title.partition(",")[0], number(factor * worst[key], 3), title.partition(",")[2], "worst"
            )
            for title, (key, (_, factor)) in zip(_titles(design), COLUMNS.items())
            if not np.isnan(worst[key])
        ),
    ]


def _pose_table(design: WorkspaceDesign) -> Table:
    loops, (damping, ripple) = design.loops, pose_limits(design.specification)
    s = design.specification
    period, fastest = s.period, s.damped_below_limit
    with np.errstate(divide="ignore"):
        slowest = [-period / np.log(loop.growth) if loop.growth < 1.0 else np.inf for loop in loops]
    rows = [
        (
            f"damping ratio of oscillations up to {fastest:g} rad/s",
            *_ends([loop.damping for loop in loops]),
            f"≥ {damping:g}",
        ),
        ("damping ratio of faster ones", *_ends([loop.fast_damping for loop in loops]), "stable"),
        ("the same, springs with 0.5 % more damping", *_ends([loop.damped_fast for loop in loops]), ""),
        *(
            []
            if not design.corner_loops
            else [
                (
                    f"damping ratio up to {fastest:g} rad/s, robots at corners of their tolerances",
                    *_ends([loop.damping for loop in design.corner_loops]),
                    f"≥ {corner_damping(s):g}",
                )
            ]
        ),
        ("ripple by the sensors' noise, %", *_ends([loop.ripple for loop in loops]), f"≤ {ripple:g}"),
        ("slowest mode: time constant, s", *_ends(slowest), "stable"),
    ]
    caption = "Sampled loops, linearised at rest at each pose, with the estimator and the latency."
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
        found = worst_motion(moves)
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
    head = ("moves of the", *(f"{title}: median, worst" for title in _titles(design)))
    caption = (
        f"Quintics at half the speed limits ({SPEED * UNLIMITED:g} rad/s or m/s where there is none), each from rest, "
        f"with feedforward; what remains is the largest error in the last {WINDOW:g} s."
    )
    return Table(head, rows, caption, stacks=True)


def _joint_table(design: WorkspaceDesign) -> Table:
    """Of each joint the largest number of all moves, and the move."""
    moves = [*design.moves, *design.sampled]
    found = [move.motion for move in moves]
    names = [str(k + 1) for k in range(len(design.moves))]
    names += [f"{names[k % len(names)]} of a sampled robot" for k in range(len(design.sampled))]
    rows = []
    for k, joint in enumerate(design.setup.joints):
        cells = [joint]
        for key, (_, factor) in COLUMNS.items():
            values = [row[k].get(key) if row else np.inf for row in found]
            known = np.array([np.nan if value is None else value for value in values], dtype=float)
            worst = None if np.isnan(known).all() else int(np.nanargmax(known))
            cells.append(
                "–" if worst is None else f"{number(factor * known[worst], 3)} (move {names[worst]})"
            )
        rows.append(cells)
    head = ("joint", *_titles(design))
    return Table(head, rows, "The worst move of each joint; goals are in the next table.", stacks=True)


def _goal_table(design: WorkspaceDesign, tolerated: Robustness) -> Table:
    slides, degrees = design.robot.links.slides, design.specification.in_degrees
    rows = [
        (
            str(k + 1),
            pose_text(move.response.start, slides, degrees),
            pose_text(move.response.goal, slides, degrees),
        )
        for k, move in enumerate(design.moves)
    ]
    caption = (
        f"Random goals that the motors hold with {100.0 * HOLD:g} % of their limits. Of the "
        f"{len(design.loops)} random poses above {tolerated.heavy} need more and could be no goal."
    )
    return Table(("move", "from", "to"), rows, caption, stacks=True)


def _move_figure(design: WorkspaceDesign) -> Any:
    """The move in which most error remains, or that is furthest from its path."""
    moves = (*design.moves, *design.sampled)
    rows = worst_motion(moves)
    key = next(
        (key for key in ("remaining_error", "path_distance") if not np.isnan(rows[0][key])), "path_distance"
    )
    worst = int(np.nanargmax([row[key] for row in rows]))
    move, joints, units = moves[worst], design.setup.joints, Units(design.setup.model, design.setup.joints)
    run, (small, factor) = move.response, units.small
    time, authority = run.run.time, design.setup.authority
    planned = np.reshape(move.plan(time), (len(time), -1))
    panels = [
        joint_panel("position", units.position, time, joints, run.positions),
        joint_panel("error", small, time, joints, factor * (run.positions - planned), zero=True),
        joint_panel("input", "% of the limit", time, joints, 100.0 * run.inputs / authority, zero=True),
    ]
    which = "nominal robot" if worst < len(design.moves) else "robot at a corner of its tolerances"
    caption = (
        f"Move {worst % len(design.moves) + 1} of the {which}, the one with the largest {key.replace('_', ' ')}. "
        f"Error: position of the link less that of the plan, which ends after {number(move.plan.duration, 3)} s. A "
        "motor without a limit has the one that the estimator takes it to have."
    )
    return draw_figure("move", panels, caption, "The worst move")


def _margin_table(design: WorkspaceDesign, tolerated: Robustness) -> Table:
    s = design.specification
    extra, gain = s.delay_margin_limit or 0.0, gain_limit(s)
    rows = [
        ("extra delay beside the latency, samples", _margin(tolerated.delay, LATEST), f"≥ {extra:g}"),
        ("the same, springs damped by 0.5 % more", _margin(tolerated.damped_delay, LATEST), ""),
        ("all inputs at once times", _margin(tolerated.louder, LOUDEST), f"≥ {gain:g}"),
        ("all inputs at once times", _margin(1.0 / tolerated.softer, LOUDEST, "1/"), f"≤ 1/{gain:g}"),
    ]
    caption = "Where the loop becomes unstable, at the pose that is nearest to it with the required delay or factor."
    return Table(("margin", "found", "required"), rows, caption)


def _margin(value: float, most: float, before: str = "") -> str:
    return f"{before}{number(value, 3)}" if value < 0.99 * most else f"beyond {before}{most:g}"


def _pair_table(design: WorkspaceDesign, tolerated: Robustness) -> Table:
    error, proved, (low, high) = tolerated.tolerance, tolerated.proved, np.sqrt(design.setup.law.gains.ends)
    rows = [
        (
            "vibrations of the workspace", f"{number(low, 3)} to {number(high, 3)} rad/s",
            "random poses, and 1.2 times beyond",
        ),
        (
            f"stable, with latency{' and estimator' if isinstance(design.setup.filter, ModalFilter) else ''}",
            f"{number(np.sqrt(proved.low), 3)} to {number(np.sqrt(proved.high), 3)} rad/s"
            if proved.high > proved.low else "none",
            f"proved, in {count_text(proved.intervals, 'interval')}",
        ),
        (
            f"errors of all accelerations, up to {FASTEST:g} rad/s", f"{number(100.0 * error.error, 3)} %",
            "computed for 30 vibrations; errors may change with time",
        ),
        (
            "the same, errors that do not change with time", f"{number(100.0 * error.constant, 3)} %",
            "computed for 30 vibrations",
        ),
    ]  # fmt: skip
    caption = (
        "For motors made alike, gravity without slope, springs without damping, small motions. An error of an "
        "acceleration is that of a mass, a spring or a motor: 10 % more mass at all links is one of 9 %."
    )
    return Table(
        ("of the vibrations one by one", "range or size", "how it is known"), rows, caption, stacks=True
    )


def _not_proved(design: WorkspaceDesign, tolerated: Robustness) -> str:
    proved, high = tolerated.proved, design.setup.law.gains.ends[1]
    pairs = (
        "Stability at rest is proved for all vibrations"
        if proved.high >= high
        else f"Stability at rest is proved up to {number(np.sqrt(proved.high), 3)} rad/s of the vibrations"
    )  # fmt: skip
    return (
        f"{pairs} of an arm with motors alike and without gravity. Unlike motors, gravity, moves and "
        "tolerances were tested on random samples; nothing is proved of them."
    )


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
            {"pose": pose.tolist(), **dict(zip(loop._fields, finite(list(loop))))}
            for pose, loop in zip(design.poses, design.loops)
        ],
        "corner_poses": [dict(zip(loop._fields, finite(list(loop)))) for loop in design.corner_loops],
        "moves": _known(worst_motion(design.moves)),
        "sampled_moves": _known(worst_motion(design.sampled)),
    }  # fmt: skip


def _known(rows: list[dict[str, float]]) -> list[dict[str, float | None]]:
    return [{key: value if np.isfinite(value) else None for key, value in row.items()} for row in rows]
