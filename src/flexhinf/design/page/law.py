"""The law: what solves which equation, its linear part, and what was measured of it."""

from __future__ import annotations

import numpy as np

from flexhinf.design.page.notes import section_notes
from flexhinf.design.result import Design
from flexhinf.report import Listing, Paragraph, Section, Table, number

__all__ = ["law_section"]


def law_section(design: Design) -> Section:
    """In words, and its gain."""
    solution, names = design.solution, design.problem.state_names
    gain = solution.gain
    rows = [
        (name.replace("_", " "), *(number(float(value)) for value in gain[:, i]))
        for i, name in enumerate(names)
    ]
    table = Table(("state", *(name.replace("_", " ") for name in design.problem.input_names)), rows)
    blocks = (*section_notes(design, "law"), Paragraph(_words(design)), table, Listing(solution.report()))
    return Section("The law", blocks, "law")


def _words(design: Design) -> str:
    solution = design.solution
    n, m, terms = len(solution.P), len(solution.input_names), np.size(solution.law_data)
    at = (
        f" The same was done at {len(design.specification.via)} poses on the way."
        if design.specification.via
        else ""
    )
    return (
        f"V of degree {solution.degree} solves the Hamilton–Jacobi–Isaacs equation at γ = {number(solution.gamma, 5)} "
        f"about the goal: a law of degree {solution.degree - 1} in {n} states for {m} "
        f"input{'s' if m > 1 else ''}, {terms} coefficients.{at} Its linear part, u − u* = K (x − x*):"
    )
