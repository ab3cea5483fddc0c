"""The rigid design on the same robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flexhinf.design.modes import Mode
from flexhinf.design.page.rigid_figure import rigid_figure
from flexhinf.design.page.words import largest_overshoot, rigid_words, slowest_settling, vibrations
from flexhinf.design.response import Response
from flexhinf.design.result import Design
from flexhinf.report import Column, Paragraph, Section, Table, number

__all__ = ["rigid_section"]


def rigid_section(design: Design) -> Section | None:
    """What neglecting the springs would have done; None if it was not made."""
    rigid, figure = design.rigid, rigid_figure(design)
    if rigid is None or figure is None:
        return None
    text = (
        "The same weights, γ/γ* and degree, designed on the model whose springs are infinitely stiff, link and "
        "reflected rotor inertia as one, then put to work on the elastic robot. On a rigid robot it does not "
        "matter on which side of the springs position and velocity are taken; here it does. The rigid law is fed "
        f"the true values, more than it would have. Its own γ is {number(rigid.gamma)}."
    )
    return Section("The rigid design on the same robot", (Paragraph(text), _table(design), figure), "rigid")


def _table(design: Design) -> Table:
    assert design.rigid is not None
    fed = "estimator" if design.specification.estimator != "none" else "true state"
    ours = "stable" if all(mode.stable for mode in design.closed_modes) else "unstable"
    rows = [
        _compared("this law", fed, design.closed_modes, design.response, ours),
        *(
            _compared("rigid", f"{loop.side} side, true", loop.modes, loop.response, rigid_words(loop))
            for loop in design.rigid.loops
        ),
    ]
    columns = (
        "law",
        "fed from",
        "linearised loop",
        Column("lowest damping ratio of a vibration"),
        Column("largest overshoot", "%", 1),
        Column("settling time", "s", 3),
        "run",
    )
    return Table(columns, rows, "", "table-rigid")


def _compared(law: str, fed: str, modes: Sequence[Mode], response: Response, words: str) -> tuple[Any, ...]:
    stable = all(mode.stable for mode in modes)
    ended = "to its end" if response.diverged is None else f"diverged at {response.diverged:.3g} s"
    return (
        law,
        fed,
        words,
        min(vibrations(modes), default=None),
        largest_overshoot(response) if stable else None,
        slowest_settling(response) if stable else None,
        ended,
    )
