"""What a controller for a workspace was found to do, in words: its verdict, the worst numbers, and what to try."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from textwrap import fill
from typing import Any

import numpy as np

from flexhinf.design.requirements import REQUIREMENTS, Requirement
from flexhinf.design.responses import Move
from flexhinf.design.robustness import LATEST, LOUDEST, robustness
from flexhinf.design.specification import FIELDS
from flexhinf.design.workspace.design import WorkspaceDesign
from flexhinf.design.workspace.search import BANDWIDTHS
from flexhinf.design.workspace.setup import OFFSET
from flexhinf.loop.simulation.metrics import peak_of
from flexhinf.pages.drawing import Units, count_text
from flexhinf.pages.page import requirement_table, requirement_text
from flexhinf.report import KeyNumber, number
from flexhinf.report.blocks import WIDTH
from flexhinf.robot.waypoints import LIMITS

#: Columns of the table of moves: key of `motion_metrics`, heading, unit, factor of the number that is shown.
COLUMNS = {
    "remaining_error": ("remaining error", "{small}", 1e3), "wrong_way_percent": ("motion the wrong way", "%", 1.0),
    "path_distance": ("distance from the path", "{small}", 1e3), "ripple_percent": ("ripple of the motors", "%", 1.0),
}  # fmt: skip

#: A requirement is near its limit where it has at most this share of it to spare; lines of a terminal that say so, and
#: all its lines, less that of the report.
NEAR, BRIEF, SCREEN = 0.2, 6, 24

#: Motion at power-on, or by offsets of the encoders, that a terminal names, rad or m.
FAR = 0.01

#: Fast vibrations with less damping are named beside the verdict.
HARDLY = 0.05


def workspace_verdict(design: WorkspaceDesign) -> str:
    """Whether the requirements are met, and by what."""
    missed = missed_text(design)
    return f"{f'Not met: {missed}' if missed else 'Every requirement is met'}. {_scope(design)}"


def _scope(design: WorkspaceDesign) -> str:
    poses, moves = count_text(len(design.loops), "random pose"), count_text(len(design.moves), "move")
    again = "both" if design.corner_loops and design.sampled else "the poses" if design.corner_loops else ""
    again = f", {again} again with robots at corners of their tolerances" if again else ""
    scope = f"One controller for {range_of(design)}, judged at {poses} and in {moves}{again}."
    if unheld := robustness(design).unheld:
        scope += f" {unheld} of these poses need{'s' * (unheld == 1)} more than the motors have."
    fast = min(loop.fast_damping for loop in (*design.loops, *design.corner_loops))
    if fast < HARDLY:
        limit = design.specification.damped_below_limit
        scope += f" Vibrations above {limit:g} rad/s are hardly damped: {number(fast, 2)} at least."
    return scope


def missed_text(design: WorkspaceDesign) -> str:
    """The requirements that are not met, in one phrase each."""
    return "; ".join(map(requirement_text, design.missed))


def advice(design: WorkspaceDesign) -> str:
    """What to try where a requirement is not met, or the motors cannot hold a pose; nothing otherwise."""
    s, missed, unheld = design.specification, design.missed, robustness(design).unheld
    both = {"link_position", "motor_position"} <= {*s.measured} or s.estimator == "none"
    options = dict.fromkeys(FIELDS[line.field].option for line in missed if line.field)
    slow = design.setup.law.gains.weights.bandwidth < max(BANDWIDTHS)
    loud = slow or any(line.field in ("gain_margin", "delay_margin") for line in missed)
    noise, stated = s.measurement_noise, s.measurement_noise != FIELDS["measurement_noise"].default
    rms = f": {number(1e3 * noise**0.5, 3)} mrad rms was {'stated' if stated else 'assumed'}"
    finer = f"finer sensors (--measurement-noise{rms if isinstance(noise, float) else ''})"
    full = any(line.what == REQUIREMENTS["at_limit"].what for line in missed)
    tried = {
        "larger limits of the motors (is effort_limit as seen from the link?)": unheld > 0 or full,
        "slower moves (--peak-speed)": full,
        "sensors of links and motors (--measured link_position,motor_position)": bool(missed) and not both,
        finer: bool(missed) and loud and s.estimator != "none",
        "narrower tolerances, of a payload too": any("corner" in line.where for line in missed),
        f"other limits ({', '.join(options)})": bool(options),
        "a smaller --workspace": True,
    }
    texts = "; ".join(text for text, applies in tried.items() if applies)
    return f"To try: {texts}." if missed or unheld else ""


def workspace_tables(design: WorkspaceDesign) -> list[Any]:
    """Requirements that are not met or near their limits, for a terminal: one of each kind that is missed, and as many
    others as fit on a screen with the text."""
    from rich.console import Console

    lines = sorted(filter(_near, requirements_with_margins(design)), key=lambda line: line.met)
    kinds = {line.what: line for line in reversed(lines) if not line.met}
    lines.sort(key=lambda line: kinds.get(line.what) is not line)
    least, title = max(len(kinds), 1), "Requirements that are missed or nearly missed (* our default)"
    space = SCREEN - len(workspace_text(design).splitlines())

    def table_of(some: Sequence[Requirement]) -> Any:
        table = requirement_table(some, design.specification.in_degrees, title)
        left = [f"and {len(lines) - len(some)} more on the page"] if lines[len(some) :] else []
        return replace(table, rows=[*table.rows, *left]).terminal()

    for count in range(min(max(BRIEF, least), len(lines)), least - 1, -1):
        table = table_of(lines[:count])
        if len(Console(width=WIDTH).render_lines(table)) <= space:
            return [table]
    return [table_of([replace(line, where="one of each kind") for line in lines[:least]])] if lines else []


def requirements_with_margins(design: WorkspaceDesign) -> list[Requirement]:
    """The requirements; those on gain and delay with what the worst pose tolerates, if it is stable."""
    if max(loop.growth for loop in design.loops) >= 1.0:
        return list(design.requirements)
    t = robustness(design)
    known = {
        "gain_margin": f"{margin_text(min(t.louder, 1.0 / t.softer), LOUDEST)} tolerated",
        "delay_margin": f"{margin_text(t.delay, LATEST)} samples tolerated",
    }
    return [replace(line, detail=known.get(line.field, line.detail)) for line in design.requirements]


def _near(line: Requirement) -> bool:
    return not line.met or (line.limit > 0.0 and abs(line.found / line.limit - 1.0) <= NEAR)


def workspace_text(design: WorkspaceDesign) -> str:
    """The verdict for a terminal, under `workspace_tables`: what is met, the worst numbers, what to try."""
    names = list(dict.fromkeys(line.what for line in design.missed))
    missed = ", ".join([*names[:BRIEF], *([f"and {len(names) - BRIEF} more"] if names[BRIEF:] else [])])
    met = f"Not met: {missed}." if missed else f"All {len(design.requirements)} requirements are met."
    worst = ", ".join(f"{n.name} {n.value} {n.unit}".rstrip() for n in key_numbers(design))
    parts = f"{met} {_scope(design)}", f"At worst: {worst}.", _starts(design), advice(design)
    return "\n".join(fill(part, WIDTH, break_on_hyphens=False) for part in parts if part)


def _starts(design: WorkspaceDesign) -> str:
    """How far links move by an unknown load at power-on, and by offsets of the encoders, where it is much."""
    setup, run, texts = design.setup, design.power_on, []
    units, offsets = Units(setup.model, setup.joints), robustness(design).offsets[1]
    sizes = {
        "at power-on {} in the first second": 0.0 * offsets
        if run is None
        else peak_of(run.positions - run.goal),
        f"by encoders that are off by {units.small_text(OFFSET, 2)} {{}}": offsets
        * (setup.noise is not None),
    }
    for text, moved in sizes.items():
        if FAR < moved.max() < np.inf:
            k = int(np.argmax(moved))
            texts.append(text.format(f"{setup.joints[k]} moves by up to {units.small_text(moved[k], 3)}"))
    text = "; ".join(texts)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def range_of(design: WorkspaceDesign) -> str:
    """The workspace in words."""
    space = design.setup.workspace
    where = (
        "the joint ranges" if design.specification.workspace == LIMITS else "the stated ranges of the joints"
    )
    where = where if space.path is None else "the stated waypoints"
    return "the stated box in space" if space.box is not None else where


def worst_motion(moves: Sequence[Move]) -> list[dict[str, float]]:
    """The worst joint of each move, by the keys of `COLUMNS`; NaN where a number does not exist, as a ripple without
    limits of the motors."""
    rows = []
    for move in moves:
        found = move.motion
        rows.append({key: _largest([row.get(key) for row in found], bool(found)) for key in COLUMNS})
    return rows


def columns_of(design: WorkspaceDesign) -> dict[str, tuple[str, str, float]]:
    """Those of `COLUMNS` that the robot has, small deviations in the units of the joints."""
    setup = design.setup
    small, limited = Units(setup.model, setup.joints).small[0], setup.limits.limits_effort
    kept = {key: row for key, row in COLUMNS.items() if limited or key != "ripple_percent"}
    return {key: (title, unit.format(small=small), factor) for key, (title, unit, factor) in kept.items()}


def _largest(values: Sequence[float | None], exists: bool = True) -> float:
    """The largest value that is known; NaN if none is, infinite where a run diverged and has none."""
    return max((value for value in values if value is not None), default=np.nan) if exists else np.inf


def key_numbers(design: WorkspaceDesign) -> list[KeyNumber]:
    """The worst numbers of poses and moves."""
    moves = (*design.moves, *design.sampled)
    rows, least = worst_motion(moves), min(l.damping for l in (*design.loops, *design.corner_loops))
    below, worst = f"below {design.specification.damped_below_limit:g} rad/s", f"worst of {len(moves)} moves"
    return [
        KeyNumber("least damping", number(least, 3), "", below),
        *(
            KeyNumber(title, number(factor * max(row[key] for row in rows), 3), unit, worst)
            for key, (title, unit, factor) in columns_of(design).items()
        ),
    ]


def margin_text(value: float, most: float, before: str = "") -> str:
    """A margin that is searched for up to `most`."""
    return f"{before}{number(value, 3)}" if value < 0.99 * most else f"beyond {before}{most:g}"
