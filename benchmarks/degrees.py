"""When does the nonlinear law pay? Linear, cubic and quintic laws of one problem, over what makes a robot nonlinear.

Criterion, stated before: a law pays where it settles earlier by a tenth or more, with at most 5 % overshoot, than
the linear law of the same bandwidth and noise. Two opponents of the nonlinear laws run beside them: the linear law of
a loop that is 1.3 times as fast (it pays with noise), and linear laws scheduled between start and goal.

    python -m benchmarks.degrees                    every case, kept in .benchmarks; begun again, it goes on (3 minutes)
    python -m benchmarks.degrees --figure FILE.svg  the same, and draws the figure of docs/degrees.md
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.degrees_study import CASES, FACTORS, FASTER, ROBOTS, SCHEDULED, Case, study
from benchmarks.record import FOLDER

#: Values that the table shows.
SHOWN = {"step": (60.0, 120.0), "pose": (90.0,), "gravity": (0.2,), "hardening": (0.3, 1.0)}


def ratio(row: Mapping[str, Any], linear: Mapping[str, Any], name: str) -> float:
    """A figure of one law over the linear law's."""
    return row[name] / linear[name]


def by_case(rows: Sequence[Mapping[str, Any]]) -> dict[Case, dict[str, Mapping[str, Any]]]:
    """Rows by case and law."""
    found: dict[Case, dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(Case(row["row"], row["factor"], row["value"]), {})[row["law"]] = row
    return found


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Settling, cost and peak input over the linear law's, for the values that are `SHOWN`."""
    head = (
        "case", "linear: settling, overshoot, peak input", "cubic: settling, cost, peak", "quintic: the same",
        "the linear opponent: the same, noise", "used",
    )  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for case, laws in by_case(rows).items():
        if case.value not in SHOWN[case.factor]:
            continue
        linear, unit = laws["linear"], "V" if fh.load_robot(ROBOTS[case.row][0]).drive == "voltage" else "N·m"
        opponent = next((laws[name] for name in (FASTER, SCHEDULED) if name in laws), None)
        used = next((name for name, row in laws.items() if row.get("used")), "–")
        cells = (
            f"{case.row}, {case.text}",
            f"{linear['settling']:.2f} s, {linear['overshoot']:.1f} %, {linear['peak']:.3g} {unit}",
            *(_cell(laws.get(name), linear) for name in ("cubic", "quintic")),
            _cell(opponent, linear)
            + ("" if opponent is None else f", {ratio(opponent, linear, 'noise'):.2f}"),
            used,
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(row: Mapping[str, Any] | None, linear: Mapping[str, Any]) -> str:
    if row is None:
        return "–"
    if np.isinf(row["cost"]):
        return "diverges"
    found = ", ".join(f"{ratio(row, linear, name):.2f}" for name in ("settling", "cost", "peak"))
    return f"{found}, overshoots by {row['overshoot']:.0f} %" if row["overshoot"] > 5.0 else found


AXES = {
    "step": "step (°),\nlaw about the goal",
    "pose": "step (°),\nlaw about the start",
    "gravity": "m g L/K (rad),\nstep of 60°",
    "hardening": "cubic over linear torque\nof the springs, step of 60°",
}
STYLES = {"cubic": (1, "o-"), "quintic": (2, "s-"), FASTER: (4, "--"), SCHEDULED: (5, "-.")}
LOW, HIGH, FAILED = 0.4, 1.6, 1.54


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """A panel per robot and factor: settling time over the linear law's; × diverges, or overshoots by over 5 %."""
    from matplotlib.figure import Figure

    from flexhinf.report import SERIES, figure_to_svg, house_style

    found = by_case(rows)
    with house_style():
        figure = Figure(figsize=(9.6, 9.4))
        figure.subplots_adjust(left=0.09, right=0.99, top=0.98, bottom=0.145, wspace=0.1, hspace=0.16)
        panels = figure.subplots(len(ROBOTS), len(FACTORS), sharey=True, sharex="col", squeeze=False)
        for (row, name), panel in np.ndenumerate(panels):
            robot, factor = list(ROBOTS)[row], list(FACTORS)[name]
            cases = [case for case in found if (case.row, case.factor) == (robot, factor)]
            places = range(len(cases))
            panel.axhspan(0.9, 1.0, color="#d9dee5", lw=0, label="less than a tenth earlier")
            panel.axhline(1.0, color="#1f2328", lw=1.1, label="linear")
            for law, (colour, style) in STYLES.items():
                points = [_settling(found[case], law) for case in cases]
                if all(np.isnan(points)):
                    continue
                panel.plot(
                    places,
                    np.where(np.isinf(points), np.nan, points),
                    style,
                    color=SERIES[colour],
                    ms=4,
                    label=law,
                )
                aside = 0.09 * (colour - 1.5)  # so that two laws that fail are both seen
                lost = [place + aside for place in places if np.isinf(points[place])]
                panel.plot(lost, [FAILED] * len(lost), "x", color=SERIES[colour], ms=8, mew=2)
            used = [_used(found[case]) for case in cases]
            panel.plot(places, used, "o", ms=9, mfc="none", mec="#1f2328", mew=1.0, label="used by the rule")
            panel.plot([], [], "x", color="#1f2328", ms=8, mew=2, label="diverges, or overshoots by over 5 %")
            panel.set_xticks(list(places))
            panel.set_xticklabels([f"{case.value:g}" for case in cases])
            panel.set(ylim=(LOW, HIGH), xlim=(-0.3, len(FACTORS[factor]) - 0.7))
            if row == len(ROBOTS) - 1:
                panel.set_xlabel(AXES[factor])
            if name == 0:
                panel.set_ylabel(f"{robot}\nsettling over linear")
        labels = {
            text: line for panel in panels.flat for line, text in zip(*panel.get_legend_handles_labels())
        }
        figure.legend(labels.values(), labels.keys(), loc="lower center", ncols=4)
        figure.set_facecolor("white")
        path.write_text(figure_to_svg(figure), encoding="utf-8")


def _settling(laws: Mapping[str, Mapping[str, Any]], law: str) -> float:
    """Over the linear law's; infinite with more than 5 % overshoot, nan for a law that the case has not."""
    row = laws.get(law)
    if row is None:
        return np.nan
    return ratio(row, laws["linear"], "settling") if row["overshoot"] <= 5.0 else np.inf


def _used(laws: Mapping[str, Mapping[str, Any]]) -> float:
    """Settling time of the law that the rule uses over the linear law's; nan where it does not apply."""
    return next((ratio(row, laws["linear"], "settling") for row in laws.values() if row.get("used")), np.nan)


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute what is missing, print the table, draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--figure", type=Path, help="SVG to write")
    parser.add_argument(
        "--results", type=Path, default=FOLDER / "degrees.jsonl", help="where results are kept"
    )
    options = parser.parse_args(arguments)
    rows = study(CASES, options.results)
    print(table(rows))
    if options.figure:
        draw(rows, options.figure)
        print(f"figure: {options.figure}")


if __name__ == "__main__":
    main()
