"""The worst disturbances of a campaign's design, in words, as a table and as a figure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.campaign import CampaignJudgement
from flexhinf.design.campaign_gain import FoundGains, GainRow
from flexhinf.design.report.campaign_text import change_text, replay_command
from flexhinf.design.report.drawing import figure_block
from flexhinf.report import (
    INK,
    SERIES,
    Listing,
    Paragraph,
    Section,
    Status,
    Table,
    house_style,
    label,
    legend,
    new_figure,
    number,
)

CLAIMS = {"designed": "designed for", "proved": "proved", "not claimed": "designed for another loop"}


def gain_text(row: GainRow, nominal: Mapping[str, float]) -> str:
    """``∫|z|²/∫|d|² 5.1·10³, 77 % of γ² of the synthesis: nominal robot, true state``."""
    of = "the proved γ²" if row.claim == "proved" else f"γ² of the {row.pair}"
    robot = "nominal robot" if row.robot == "nominal" else f"worst robot found ({_changes(row, nominal)})"
    return (
        f"worst disturbance found: ∫|z|²/∫|d|² = {_square(row.gain)}, {_share(row)} of {of}: {robot}, "
        f"{'the true state fed back' if row.loop == 'true state' else 'with the estimator'}."
    )


def _square(gain: float) -> str:
    return "infinite" if math.isinf(gain) else number(gain**2, 4)


def _share(row: GainRow) -> str:
    return "more" if math.isinf(row.gain) else f"{number(100.0 * (row.gain / row.gamma) ** 2, 3)} %"


def _changes(row: GainRow, nominal: Mapping[str, float]) -> str:
    found = [change_text(name, value, nominal.get(name), "") for name, value in row.numbers.items()]
    return ", ".join(text for text in found if text) or "nominal numbers"


def gain_statuses(found: FoundGains) -> list[Status]:
    """Rows that no theorem allows: a proof or this program is wrong."""
    return [
        Status("not proved", "A disturbance attains more than the proved γ: the proof or the loop is wrong.")
        for row in found.rows
        if row.claim == "proved" and not row.kept
    ]


def gain_section(judged: CampaignJudgement, found: FoundGains) -> Section:
    """What each search attained, against the level that belongs to it."""
    rows = found.rows
    if not rows:
        return Section("Worst disturbance", [], "worst-disturbance")
    cells = [
        (
            "nominal" if row.robot == "nominal" else "worst found",
            row.loop, f"of the {row.pair}", _square(row.gain), number(row.gamma**2, 4), _share(row), CLAIMS[row.claim],
        )
        for row in rows
    ]  # fmt: skip
    columns = ("robot", "loop", "z and d", "attained ∫|z|²/∫|d|²", "γ²", "share", "γ is")
    worst = next((row for row in rows if row.robot == "worst"), None)
    numbers = "" if worst is None else f" The worst robot found: {_changes(worst, judged.nominal)}."
    text = (
        "Finite-energy disturbances from rest at the goal, found by power iteration on the gradient of ∫|z|², under "
        "which V stays inside the sampled or proved level. Where a robot within the tolerances is searched too, robot "
        "and disturbance are improved in turn, each robot about its own equilibrium. Inputs are held for a period. "
        "An attained gain is a lower bound. A designed γ is that of the nominal robot with the true state; a proved "
        "one holds for the z, d, robots and level of its certificate, and for the loop with the true state alone."
        f"{numbers}{f' No γ is proved of this law: {found.unproved}.' if found.unproved else ''}"
    )
    return Section("Worst disturbance", [
        Paragraph(text), Table(columns, cells, "Attained gains", "table-worst-disturbance", stacks=True), _figure(rows),
        Paragraph("This command, in the folder above, runs the disturbances again:"),
        Listing(replay_command(judged.table.journal.folder.name, "--worst-case gain")),
    ], "worst-disturbance")  # fmt: skip


def _figure(rows: Sequence[GainRow]) -> Any:
    """The first channel of each disturbance."""
    figure, (axis,) = new_figure(1)
    styles: tuple[dict[str, Any], ...] = (
        {"color": SERIES[0]}, {"color": SERIES[1]}, {"color": INK, "dashes": (5.0, 1.5)}, {"color": SERIES[2]},
    )  # fmt: skip
    with house_style():
        for row, style in zip(rows, styles):
            name = f"{row.robot}, {row.loop}, {row.pair}"
            values = np.array(row.disturbance)[:, 0]
            axis.plot(row.times, values, linewidth=1.1, label=name, **style)
    label(axis, rows[0].names[0].replace("_", " "), "")
    axis.set_xlabel("time (s)")
    legend(axis)
    return figure_block(
        "worst-disturbance", figure, "The first component of d.", "The worst disturbances found"
    )


def gain_replay_table(rows: Sequence[GainRow], again: Sequence[float]) -> Any:
    """Gains in the folder, and run again."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as Terminal

    same = all(row.gain == value for row, value in zip(rows, again))
    title = f"worst disturbances: {'the same bits' if same else 'differ'}"
    table = Terminal(title=title, box=SIMPLE_HEAD, title_justify="left")
    for column in ("", "found", "run again", "γ"):
        table.add_column(column, justify="left" if not column else "right")
    for row, value in zip(rows, again):
        name = f"{row.robot}, {row.loop}, {row.pair}"
        table.add_row(name, f"{row.gain:.10g}", f"{value:.10g}", f"{row.gamma:.10g}")
    return table
