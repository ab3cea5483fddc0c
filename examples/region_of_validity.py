"""
Where can a law be trusted? The largest step of each degree
===========================================================

About each goal pose the arm's law is designed with the weights of a row at γ = 1.5 γ* and R2 = 10. Checked is
the dissipation inequality for the paper's weights (60, 0, 0, 0, 300) at 1.6 γ*, with the exact sine: the extra
weights are the margin. The level set on which nothing against it was found gives the largest step between equilibria
whose start lies in it, the integrator's start chosen where V is smallest. Sampled, not proved. The paper's own weights
leave no margin in some direction, and so no region.

``python examples/region_of_validity.py --whole FOLDER`` computes the whole table and its figure, as in docs/regions.md.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from flexhinf.designs import try_degrees

CHECKED = (60.0, 0.0, 0.0, 0.0, 300.0)  # the paper's penalty, Eq. (11)
ROWS = (
    CHECKED,
    (65.0, 9.0, 30.0, 9.0, 310.0),
    (70.0, 18.0, 60.0, 18.0, 320.0),
    (75.0, 27.0, 90.0, 27.0, 330.0),
    (80.0, 36.0, 120.0, 36.0, 340.0),
)
GOALS = (0, 90, 180)  # degrees
DEGREES = (2, 4, 6)
LAWS = {2: "linear", 4: "cubic", 6: "quintic"}


@dataclass(frozen=True)
class Case:
    """A row of the table: what is weighted, what disturbs, where to, and the largest step by degree, rad
    (nan where there is no region)."""

    weights: tuple[float, ...]
    channels: str
    goal: int
    gamma_star: float
    steps: dict[int, float]

    @property
    def name(self) -> str:
        """Weights and channels in words."""
        weights = ", ".join(f"{weight:g}" for weight in self.weights)
        return f"({weights})" + ("" if self.channels == "command" else f", {self.channels}")

    @property
    def row(self) -> str:
        """The row of the table in docs/regions.md."""
        steps = " | ".join("no region" if np.isnan(step) else f"{step:.2f}" for step in self.steps.values())
        return f"| {self.name} | {self.goal}° | {self.gamma_star:.4g} | {steps} |"


def largest_steps(weights: tuple[float, ...], channels: str, goal: int, seed: int = 0) -> Case:
    """One row: solve to each degree, look where the solution holds."""
    arm, penalty, pose = fh.paper_arm(), fh.Penalty(weights, effort=10.0), (np.radians(goal),)
    if channels == "command":
        problem = arm.problem(penalty, pose=pose)
    else:
        torques = ("link_torque", "motor_torque")
        problem = arm.plant().with_objective(
            penalty, integrate=("link_position",), pose=pose, disturbances=torques
        )
    choices = try_degrees(problem, DEGREES, checked_penalty=CHECKED, seed=seed)
    steps = {choice.degree: choice.step_amplitude for choice in choices}
    return Case(weights, channels, goal, fh.smallest_gamma(problem), steps)


def wanted_rows() -> list[tuple[tuple[float, ...], str, int]]:
    """Weights, channels and goal of each row of the whole table."""
    wanted = [(row, "command", goal) for row in ROWS for goal in GOALS]
    return wanted + [(row, "torques", goal) for row in ROWS[2:] for goal in GOALS]


def main(folder: str | Path | None = None, whole: bool = False) -> list[Case]:
    """Fill the table and print it; with a folder also write its figure there."""
    wanted = wanted_rows()
    if not whole:
        wanted = [(row, "command", 90) for row in ROWS[1:3]]
    heads = " | ".join(LAWS[degree] for degree in DEGREES)
    print(f"| weights on x1 … x5, channels | goal | γ* | {heads} |\n|---|---|---|---|---|---|")
    cases = []
    for row, channels, goal in wanted:
        case = largest_steps(row, channels, goal)
        cases.append(case)
        print(case.row, flush=True)
    if folder is not None:
        from flexhinf.report import figure_to_svg

        picture = Path(folder) / "regions.svg"
        picture.write_text(figure_to_svg(draw(cases)), encoding="utf-8")
        print(f"picture: {picture}")
    return cases


def draw(cases: Sequence[Case]) -> Any:
    """A panel per goal: the largest step over the degree of the law, a line per row of weights."""
    from matplotlib.figure import Figure

    from flexhinf.report import SERIES, house_style

    cases = [case for case in cases if not all(np.isnan(step) for step in case.steps.values())]
    by_goal = {
        goal: list(group)
        for goal, group in groupby(sorted(cases, key=lambda c: c.goal), key=lambda c: c.goal)
    }
    colours = dict(zip(ROWS[1:], SERIES))
    with house_style():
        figure = Figure(figsize=(7.2, 3.9), layout="constrained")
        panels = figure.subplots(1, len(by_goal), sharey=True, squeeze=False)[0]
        for panel, (goal, group) in zip(panels, by_goal.items()):
            for case in group:
                style = (
                    {"ls": "-", "marker": "o"} if case.channels == "command" else {"ls": ":", "marker": "s"}
                )
                steps = np.degrees(list(case.steps.values()))
                panel.plot(
                    range(len(steps)), steps, color=colours[case.weights], ms=4, label=case.name, **style
                )
            if goal:
                panel.axhline(goal, color="#1f2328", lw=1.1, ls="--", label="from hanging to the goal")
            panel.set(title=f"goal {goal}°", xticks=range(len(DEGREES)), ylim=(0, None))
            panel.set_xlim(-0.25, len(DEGREES) - 0.75)
            panel.set_xticklabels([LAWS[degree] for degree in DEGREES])
        panels[0].set_ylabel("largest step between equilibria (°)")
        figure.legend(*panels[-1].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        figure.set_facecolor("white")
    return figure


if __name__ == "__main__":
    found = main(*[word for word in sys.argv[1:] if word != "--whole"][:1], whole="--whole" in sys.argv)
    figure = draw(found)
