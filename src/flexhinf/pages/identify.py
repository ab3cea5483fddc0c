"""The page of an identification: the numbers with their intervals, what the log does not tell, and how it fits."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.identification import Excitation, Identification
from flexhinf.pages.drawing import Line, Panel, draw_figure, note, with_figures
from flexhinf.pages.estimate import FilteredLog, innovation_blocks, judgement, log_table, measured_blocks
from flexhinf.pages.page import files_section
from flexhinf.pages.settings import robot_rows, settings_in_groups
from flexhinf.report import (
    SERIES,
    Cell,
    Column,
    KeyNumber,
    Page,
    Provenance,
    Section,
    Settings,
    Status,
    Table,
    finite,
    house_style,
    number,
    to_json,
)
from flexhinf.robot import Robot


@dataclass(frozen=True, eq=False)
class IdentifiedRobot:
    """What `identify` found in a log, for the page, the files and the terminal.

    `stated`: the robot before. `found`: the identification. `filtered`: the log through the filter of what was found.
    `motion`: what is proposed where the log does not tell a number, or None.
    """

    stated: Robot
    found: Identification
    filtered: FilteredLog
    motion: Excitation | None

    @property
    def hopeless(self) -> bool:
        """Whether the motion tells none of the numbers that the log does not."""
        if self.motion is None:
            return False
        hidden = [name for name, error in self.found.standard_errors.items() if not np.isfinite(error)]
        return not any(np.isfinite(self.motion.standard_errors[name]) for name in hidden)


def identified_verdict(result: IdentifiedRobot) -> list[str]:
    """What the log tells and what not, in sentences."""
    found = result.found
    hidden = [name for name, error in found.standard_errors.items() if not np.isfinite(error)]
    clear = [name for name in found.names if name not in hidden]
    texts = []
    if clear:
        texts.append(f"The log tells {_listed(clear)}, if the other numbers of the robot are right.")
    if hidden:
        texts.append(f"It does not tell {_listed(hidden)}.")
    texts += [f"{each.text[0].upper()}{each.text[1:]}." for each in found.unidentifiable]
    if result.hopeless:
        texts.append("No motion tells them with these sensors: state some of them, or measure more.")
    if not judgement(result.filtered)[0]:
        texts.append(
            "The innovations do not fit the filter: the model lacks something, and intervals may be too short."
        )
    return texts


def _listed(names: Sequence[str]) -> str:
    labels = [name.replace("_", " ") for name in names]
    return labels[0] if len(labels) == 1 else f"{', '.join(labels[:-1])} and {labels[-1]}"


def identified_table(result: IdentifiedRobot) -> Table:
    """A row for each number: as stated, as found, with its interval."""
    found, rows = result.found, []
    for name, value in found.values.items():
        stated, error = result.stated[name], found.standard_errors[name]
        clear = bool(np.isfinite(error))
        low, high = found.intervals[name]
        share = 100.0 * error / abs(value) if clear and value else np.inf
        rows.append(
            (
                name.replace("_", " "), f"{number(stated.value, 5)} {stated.unit}".rstrip(),
                f"{number(value, 5)} {stated.unit}".rstrip() if clear else "",
                f"{number(low, 5)} to {number(high, 5)}" if clear else "",
                f"{number(share, 2)} %" if np.isfinite(share) else "",
                Cell("yes", "green") if clear else Cell("no", "yellow"),
            )
        )  # fmt: skip
    return Table(
        (
            "number", Column("stated", right=True), Column("identified", right=True),
            Column("95 % interval", right=True, brief="95 %"), Column("standard error", right=True, brief="error"),
            "told by the log",
        ),
        rows, "Numbers of the robot as its file states them, and as the log tells them", "table-numbers",
        title="Numbers of the robot",
    )  # fmt: skip


def noise_table(result: IdentifiedRobot) -> Table:
    """Levels of the noises that were found beside."""
    plant, rows = result.found.plant, []
    for name, level in result.found.noise.items():
        measured = name in plant.outputs
        unit = plant.unit(name) if measured else f"{plant.unit(name)}·√s"
        rows.append(
            (
                name.replace("_", " "),
                "measurement" if measured else "disturbance",
                f"{number(level, 3)} {unit}",
            )
        )
    return Table(
        ("signal", "noise", Column("level", right=True)), rows,
        "Standard deviations of what is measured, and levels of white disturbances that the model leaves out",
        "table-noise",
    )  # fmt: skip


def correlation_table(result: IdentifiedRobot) -> Table:
    """Correlations of the errors of the numbers."""
    names = [name.replace("_", " ") for name in result.found.names]
    matrix = result.found.correlations
    rows = [
        (name, *("" if not np.isfinite(value) else number(float(value), 2) for value in row))
        for name, row in zip(names, matrix)
    ]
    return Table(
        ("", *(Column(name, right=True) for name in names)), rows,
        "Correlations of the errors: near 1 or −1, the log tells only what two numbers have together",
        "table-correlations",
    )  # fmt: skip


def _motion_blocks(result: IdentifiedRobot) -> Any:
    motion = result.motion
    assert motion is not None
    errors = motion.standard_errors
    clear = [
        f"{name.replace('_', ' ')} to ± {number(100 * e, 2)} %"
        for name, e in errors.items()
        if np.isfinite(e)
    ]
    texts = [f"Driven on the robot, motion.csv would tell {', '.join(clear)}."] if clear else []
    texts += [
        f"No motion tells this: {each.text}. State one of these numbers." for each in motion.unidentifiable
    ]
    yield note(" ".join(texts))
    units = ["m" if slides else "rad" for slides in result.stated.links.slides]
    panels = [
        Panel(
            f"position of {name}",
            unit,
            [Line(motion.times, column, "", {"color": SERIES[0], "linewidth": 1.3})],
        )
        for name, unit, column in zip(result.stated.joint_names, units, motion.positions.T)
    ]
    yield draw_figure(
        "motion", panels[:4], "Link positions of the proposed motion, within limits.", "Proposed motion"
    )


def identified_page(
    result: IdentifiedRobot, command: Sequence[str], warnings: Sequence[str], files: Sequence[str]
) -> Page:
    """The page; `command` makes it again, `warnings` are of the robot's file, `files` beside it."""
    found, filtered = result.found, result.filtered
    clear = [bool(np.isfinite(error)) for error in found.standard_errors.values()]
    tables = [
        identified_table(result),
        noise_table(result),
        *([correlation_table(result)] if len(clear) > 1 else []),
    ]
    with house_style():
        sections = [Section("What the log tells", tuple(tables), "numbers")]
        if result.motion is not None and not result.hopeless:
            blocks = tuple(with_figures(_motion_blocks(result)))
            sections.append(Section("A motion that would tell more", blocks, "motion"))
        sections += [
            Section(title, tuple(with_figures(blocks(filtered))), anchor)
            for anchor, title, blocks in (
                ("innovations", "Does the model fit the log?", innovation_blocks),
                ("signals", "Measured and predicted", measured_blocks),
            )
        ]
    sections.append(Section("The log", (*(note(text) for text in warnings), log_table(filtered)), "log"))
    sections.append(files_section(files))
    log = filtered.log
    keys = [
        KeyNumber(
            name.replace("_", " "), number(value, 4), result.stated[name].unit, _plus_minus(found, name)
        )
        for name, value in list(found.values.items())[:4]
    ]
    many = "all numbers" if all(clear) else f"{sum(clear)} of {len(clear)} numbers"
    return Page(
        f"What the log {log.source} tells of “{result.stated.name}”",
        f"Numbers of the robot “{result.stated.name}” by maximum likelihood, from {len(log)} samples in "
        f"{number(float(log.times[-1] - log.times[0]))} s.",
        " ".join(identified_verdict(result)),
        sections,
        Settings(settings_in_groups({"Robot": robot_rows(result.stated)})),
        Provenance(shlex.join(command), None),
        keys,
        [Status("met" if all(clear) else "risky", f"The log tells {many}.")],
    )


def _plus_minus(found: Identification, name: str) -> str:
    low, high = found.intervals[name]
    clear = np.isfinite(found.standard_errors[name])
    return f"95 %: {number(low, 4)} to {number(high, 4)}" if clear else "not told by the log"


def identified_numbers(result: IdentifiedRobot) -> dict[str, Any]:
    """Every number of the page, for identify.json."""
    found = result.found
    return finite({
        "robot": result.stated.name, "log": result.filtered.log.source, "samples": found.samples,
        "log_likelihood": found.log_likelihood, "says": identified_verdict(result),
        "numbers": {
            name: {
                "stated": result.stated[name].value, "value": value, "standard_error": found.standard_errors[name],
                "interval": list(found.intervals[name]), "unit": result.stated[name].unit,
                "identifiable": bool(np.isfinite(found.standard_errors[name])),
            } for name, value in found.values.items()
        },
        "correlations": found.correlations.tolist(),
        "unidentifiable": [
            {"direction": each.direction, "standard_error": each.standard_error} for each in found.unidentifiable
        ],
        "noise": found.noise,
        "motion": None if result.motion is None else {
            "duration_s": result.motion.reference.duration, "standard_errors": result.motion.standard_errors,
        },
    })  # fmt: skip


def identified_files(
    result: IdentifiedRobot, command: Sequence[str], warnings: Sequence[str], robot_file: str
) -> dict[str, str | bytes]:
    """The files of the report by name: the page, the numbers, the robot file, and the motion where one is proposed."""
    files: dict[str, str | bytes] = {
        "robot.toml": robot_file,
        "identify.json": to_json(identified_numbers(result)),
    }
    if result.motion is not None and not result.hopeless:
        files["motion.csv"] = result.motion.table()
    page = identified_page(result, command, warnings, list(files))
    return {"index.html": page.html(), **files}
