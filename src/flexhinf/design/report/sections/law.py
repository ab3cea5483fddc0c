"""The law: equilibrium at the goal, linear part, and what was measured of the solution."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexhinf.design.report.formatting import count_text, units_of
from flexhinf.design.report.remarks import Remark, notes_of
from flexhinf.design.result import Design
from flexhinf.report import Column, Listing, Paragraph, Section, Table, number

__all__ = ["remarks", "section"]


def section(design: Design) -> Section:
    """In words, with its linear gain and the equilibrium about which it acts."""
    solution, names = design.solution, design.problem.state_names
    rows = [
        (name.replace("_", " "), *(number(float(value)) for value in solution.gain[:, i]))
        for i, name in enumerate(names)
    ]
    inputs = (name.replace("_", " ") for name in design.problem.input_names)
    gain = Table(("state", *inputs), rows, "Linear part K of u − u* = K (x − x*)", "table-gain")
    blocks = (
        *notes_of(remarks(design)),
        Paragraph(_text(design)),
        _equilibrium(design),
        gain,
        Listing(solution.report()),
    )
    return Section("The law", blocks, "law")


def remarks(design: Design) -> Iterator[Remark]:
    """A rigid design that was asked for and could not be made."""
    if design.specification.compare_rigid and design.rigid is None:
        yield Remark(
            "law", "no rigid design",
            "No rigid design was made: a penalty that is code cannot be applied to a rigid robot.",
        )  # fmt: skip


def _text(design: Design) -> str:
    solution, via = design.solution, design.specification.via
    n, m, terms = len(solution.P), len(solution.input_names), np.size(solution.law_data)
    at = f" The same was done at {count_text(len(via), 'pose')} on the way." if via else ""
    return (
        f"V of degree {solution.degree} solves the Hamilton–Jacobi–Isaacs equation at γ = {number(solution.gamma, 5)} "
        f"about the goal, as a power series. The law has degree {solution.degree - 1} in {n} states, "
        f"{count_text(m, 'input')} and {terms} coefficients.{at}{_rescaled(design)}"
    )


def _rescaled(design: Design) -> str:
    """Why the solver's listing has another γ* where tolerances have channels."""
    if design.design_problem.robustness is None:
        return ""
    return (
        " The channels of the tolerances enter in proportion to γ; the listing below keeps them as they are at this γ, "
        f"so its gamma* is not the γ* = {number(design.gamma_star)} of the whole problem."
    )


def _equilibrium(design: Design) -> Table:
    """State and input with which the robot is held at the goal."""
    n, plant, units = len(design.goal), design.problem.plant, units_of(design.evaluation)
    x, u = design.problem.operating_point, design.problem.operating_input
    stiffness = np.atleast_1d(plant.parameters.named(plant.parameters.vector()).stiffness)
    rows = [
        (
            name,
            units.scale * float(x[j]),
            units.scale * float(x[2 * n + j]),
            float(stiffness[j] * (x[2 * n + j] - x[j])),
            float(u[j]),
        )
        for j, name in enumerate(design.robot.joint_names)
    ]
    columns = (
        "joint",
        Column("link position", units.angle, 4),
        Column("motor position, seen from the link", units.angle, 4),
        Column("spring torque", units.spring, 3),
        Column("input", units.effort, 3),
    )
    return Table(columns, rows, "Equilibrium at the goal", "table-rest")
