"""What a command ends with: what is missed or nearly missed, the verdict, the worst numbers and what to try.

All of it fits on one screen of `SCREEN` lines of 80 columns; the page has everything, and so has a terminal with
``--verbose``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from textwrap import fill
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from flexhinf.analysis.modes import JointScales
from flexhinf.designs.advice import OF_MOVES, WITHIN
from flexhinf.designs.judge import STANDSTILL_SHARE, missed_by
from flexhinf.designs.loop_setup import LoopPlants
from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.problem.presets import robust_applies
from flexhinf.designs.problem.weights import vibration_text
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.specification import FIELDS, Specification
from flexhinf.numerals import count_text
from flexhinf.options import with_value
from flexhinf.pages.design import region
from flexhinf.pages.drawing import listed, range_text, units_of
from flexhinf.pages.page import (
    BRIEF,
    key_numbers,
    notes,
    requirement_table,
    requirements_text,
    sampled_text,
    scope_text,
)
from flexhinf.report import Fact, Page, Table
from flexhinf.report.blocks import WIDTH
from flexhinf.robot import Robot

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: Numbers of a robot whose errors move its vibrations most.
DECISIVE = ("stiffness", "motor inertia", "rotor inertia", "mass")

#: A requirement is near its limit where it has at most this share of it to spare.
NEAR = 0.2

#: Lines of a screen, without those of the report and of the next command.
SCREEN = 23


class Ending(NamedTuple):
    """Tables of a terminal, and the text below them."""

    tables: list[Terminal]
    text: str


def screen(
    table: Callable[[int], Table], sizes: Sequence[int], parts: Sequence[str], notes: Sequence[str] = ()
) -> Ending:
    """Paragraphs, below a table of as many rows as leave them room: the first of the `sizes` that does, or the last;
    and as many of the `notes` as there is room for."""
    text = "\n".join(map(wrapped, filter(None, parts)))
    tables: list[Terminal] = []
    room = SCREEN - len(text.splitlines())
    for size in sizes:
        tables = [table(size).terminal()]
        if _height(tables[0]) + bool(notes) <= room:
            break
    return Ending(tables, "\n".join([text, *_noted(notes, room - sum(map(_height, tables)))]))


def table_screen(table: Table, parts: Sequence[str], notes: Sequence[str] = ()) -> Ending:
    """Paragraphs, below as many rows of a table as leave them room, and the number of the others."""
    count = len(table.rows)

    def some(size: int) -> Table:
        left = [f"and {count - size} more on the page"] if size < count else []
        return replace(table, rows=[*table.rows[:size], *left])

    return screen(some, range(count, 0, -1), parts, notes)


def page_ending(page: Page, notes: Sequence[str] = ()) -> Ending:
    """What a page says, below as many rows of its first table for a terminal as leave it room, and notes."""
    tables = (block for part in page.sections for block in part.present if isinstance(block, Table))
    table = next(block for block in tables if block.title)
    return table_screen(
        table, [" ".join(page.said).replace("`", "")], [text.replace("`", "") for text in notes]
    )


def _noted(notes: Sequence[str], room: int) -> list[str]:
    """Lines of notes, as many as there is room for, and the number of the others."""
    lines: list[str] = []
    for k, text in enumerate(notes):
        more = wrapped(f"Note: {text}").splitlines()
        if len(lines) + len(more) + (k + 1 < len(notes)) > room:
            return [*lines, *[f"{count_text(len(notes) - k, 'note')} on the page."][: room - len(lines)]]
        lines += more
    return lines


def wrapped(text: str) -> str:
    """A paragraph in lines of a terminal."""
    return fill(" ".join(text.split()), WIDTH, break_on_hyphens=False)


def _height(table: Terminal) -> int:
    from rich.console import Console

    return len(Console(width=WIDTH).render_lines(table))


def requirements_screen(
    lines: Sequence[Requirement], degrees: bool, parts: Sequence[str], notes: Sequence[str] = ()
) -> Ending:
    """Requirements that are not met or near their limits, the worst of each kind that is missed and as many others as
    there is room for, above the paragraphs."""
    near = sorted(filter(_near, lines), key=lambda line: (not line.missed, line.met))
    kinds = {line.what: line for line in sorted(near, key=missed_by) if line.missed}
    near.sort(key=lambda line: kinds.get(line.what) is not line)
    least, title = max(len(kinds), 1), "Requirements that are missed or nearly missed (* our default)"

    def table_of(count: int) -> Table:
        some = (
            near[:count]
            if count
            else [replace(line, where="the worst of each kind") for line in near[:least]]
        )
        left = [f"and {len(near) - len(some)} more on the page"] if near[len(some) :] else []
        table = requirement_table(some, degrees, title)
        return replace(table, rows=[*table.rows, *left])

    sizes = [*range(min(max(BRIEF, least), len(near)), least - 1, -1), 0] if near else []
    return screen(table_of, sizes, parts, notes)


def _near(line: Requirement) -> bool:
    return not line.met or (line.limit > 0.0 and abs(line.found / line.limit - 1.0) <= NEAR)


def numbers_text(numbers: Sequence[Fact]) -> str:
    """Some numbers with their names and units, between commas."""
    return ", ".join(fact.text for fact in numbers)


def advice_text(
    missed: Sequence[Requirement], s: Specification, tried: dict[str, bool], last: dict[str, bool]
) -> str:
    """What to try, of what applies: looser limits where they alone are enough, then `tried`, other sensors, the `last`
    and other limits; or nothing."""
    both = {"link_position", "motor_position"} <= {*s.measured} or s.estimator == "none"
    options = dict.fromkeys(_limit_text(line.field, missed) for line in missed if line.field)
    errors = all(line.field in OF_MOVES for line in missed if line.field)
    tried = {
        enough_text(missed): True,
        **tried,
        "sensors of links and motors (--measured link_position,motor_position)": bool(missed) and not both,
        **last,
        f"{'allow more error' if errors else 'other limits'}: {', '.join(options)}": bool(options),
    }
    texts = [text for text, applies in tried.items() if text and applies]
    return f"To try: {'; '.join(texts)}." if texts else ""


def enough_text(missed: Sequence[Requirement]) -> str:
    """Limits of errors with which the design, as it is, meets all; "" where other requirements are missed too."""
    if not missed or not all(line.field in OF_MOVES for line in missed):
        return ""
    least: dict[str, float] = {}
    for line in missed:
        cycle = line.what == REQUIREMENTS["limit_cycle"].what
        found = line.found / STANDSTILL_SHARE if cycle else line.found
        if not line.found <= WITHIN * line.limit:
            return ""
        least[line.field] = max(found, least.get(line.field, 0.0))
    limits = [
        with_value(FIELDS[field].option, f"{_two_digits_up(value):g}") for field, value in least.items()
    ]
    return f"{' '.join(limits)}: with {'this' if len(limits) == 1 else 'these'} the same design meets all"


def _two_digits_up(value: float) -> float:
    """The number with two digits that is not less."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1.0)
    return float(f"{np.ceil(value / unit * (1.0 - 1e-9)) * unit:.2g}")


def _limit_text(field: str, missed: Sequence[Requirement]) -> str:
    """The option of a limit that is missed, with what else it changes, or a value that can be kept."""
    option, lines = FIELDS[field].option, [line for line in missed if line.field == field]
    if any(line.what == REQUIREMENTS["limit_cycle"].what for line in lines):
        return f"{option} (a quarter of it may be vibration at rest)"
    least = min(line.found for line in lines)
    if field == "damping" and least >= 0.1 and any(line.stated_by != "default" for line in lines):
        return f"{with_value(option, f'{np.floor(100.0 * least) / 100.0:g}')}, the most that was found"
    return option


def tolerances_text(robot: Robot) -> str:
    """What makes a robot's tolerances narrower, as an advice: measurements of what is known least."""
    own = [p for p in robot.uncertain if not p.name.startswith("payload")]
    errors: dict[str, float] = {}
    for kind in DECISIVE:
        known = [p for p in own if p.name.startswith(kind.replace(" ", "_")) and p.value]
        errors[kind] = max(((p.interval[1] - p.interval[0]) / abs(p.value) for p in known), default=0.0)
    kinds = [kind for kind in DECISIVE if errors[kind] and errors[kind] >= 0.99 * max(errors.values())]
    payload = len(own) < len(robot.uncertain)
    what = listed([f"the {kind}" for kind in kinds]) or "the stiffness"
    texts = [f"narrower tolerances: measure {what} better (flexhinf identify)"] * bool(own or not payload)
    return "; ".join([*texts, *["a smaller range of the payload"] * payload])


def noise_text(setup: LoopPlants) -> str:
    """Noise of the sensors, rms by unit, and whether it is stated; nothing where the true state is fed back."""
    s, plant = setup.specification, setup.model
    if s.estimator == "none":
        return ""
    sizes: dict[str, list[float]] = {}
    for name, variance in zip(plant.outputs, setup.noise_variances):
        sizes.setdefault(plant.unit(name), []).append(float(np.sqrt(variance)))
    small = {"rad": ("mrad", 1e3), "m": ("mm", 1e3)}
    texts: list[str] = []
    for unit, values in sizes.items():
        name, factor = small.get(unit, (unit, 1.0))
        texts.append(f"{range_text([factor * value for value in values])} {name} rms")
    stated = s.measurement_noise is not FIELDS["measurement_noise"].default
    return f"Sensor noise: {listed(texts)} ({'as stated' if stated else 'assumed'})."


def design_ending(design: PoseEvidence) -> Ending:
    """What a terminal says at the end of a design of one pose."""
    risks = "; ".join(design.status.risky)
    parts = (
        f"{requirements_text(design.requirements)} {scope_text(design)} {_vibration(design)}",
        f"Nominal robot: {numbers_text(key_numbers(design))}. {sampled_text(design)} {noise_text(design.setup)}",
        region.brief_proof_text(design),
        f"Risky: {risks}." if risks else "",
        _advice(design),
    )
    lines = design.requirements
    return requirements_screen(lines, units_of(design.evaluation).degrees, parts, notes(design))


def _vibration(design: PoseEvidence) -> str:
    """The arm's own lowest vibration, where a bandwidth is asked for."""
    if design.specification.bandwidth is None:
        return ""
    scales = JointScales.of(design.robot.plant(), design.robot.operating_point(design.goal))
    text = vibration_text(scales.antiresonance)
    return f"{text[0].upper()}{text[1:]}." if np.isfinite(scales.antiresonance) else ""


def _advice(design: PoseEvidence) -> str:
    """What to try where a requirement is not met; nothing otherwise."""
    missed = design.missed
    fields = {line.field for line in missed}
    several = any("corner" in line.where or "sampled" in line.where for line in missed)
    first = {
        "a lower --bandwidth": bool(
            fields & {"peak_effort", "peak_sensitivity", "gain_margin", "delay_margin"}
        ),
        "--preset robust": several and robust_applies(design.robot, design.specification, design.goal),
    }
    return advice_text(missed, design.specification, first, {tolerances_text(design.robot): several})
