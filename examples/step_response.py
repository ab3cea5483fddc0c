"""A 180° step of the paper's arm: cubic against linear H∞ law, with the estimator in the loop.

Only the link position is measured. Prints the figures of merit and saves the comparison as an SVG.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import flexhinf as fh


def main(folder: str | Path = ".") -> dict[str, dict]:
    """Simulate both laws; returns their metrics."""
    robot = fh.paper_arm()
    problem = robot.problem()
    gamma = 2 * fh.smallest_gamma(problem)
    laws = {
        "cubic H∞ law": fh.solve_hji(problem, gamma=gamma, degree=4),
        "linear H∞ law": fh.linear_law(problem, gamma=gamma),
    }
    runs = {}
    for name, law in laws.items():
        ukf = fh.UnscentedKalmanFilter(robot.plant(), 1e-3, 1e-6, 1e-6, mean=np.zeros(4), covariance=1e-4)
        loop = fh.Loop(robot.plant(inductance=True), fh.Controller(law, ukf, period=1e-3))
        runs[name] = loop.run(fh.Step(np.pi), noise=1e-3, duration=6.0)
        metrics = runs[name].metrics()
        print(
            f"{name}: overshoot {metrics['overshoot_percent']:.1f} %, "
            f"settling time {metrics['settling_time_s']:.2f} s, peak {metrics['peak_input']:.1f} V"
        )
    picture = Path(folder) / "step_180.svg"
    draw(runs, picture)
    print(f"picture: {picture}")
    return {name: run.metrics() for name, run in runs.items()}


def draw(runs: dict[str, fh.Trajectory], path: Path) -> None:
    """Link position above, motor voltage below."""
    from flexhinf.report import (
        SERIES,
        figure_to_svg,
        label,
        legend,
        new_figure,
        reference_line,
        settling_band,
        time_response,
    )

    figure, (above, below) = new_figure(2, height=4.4)
    first = next(iter(runs.values()))
    reference_line(above, first.time, np.degrees(first.signals["reference"][:, 0]))
    settling_band(above, 180.0, 180.0)
    for colour, (name, run) in zip(SERIES, runs.items(), strict=False):
        time_response(
            above, run.time, np.degrees(run.signal("state", "link_position")), name=name, colour=colour
        )
        time_response(below, run.time, run.signal("input", "motor_voltage"), name=name, colour=colour)
    label(above, "link position", "°")
    label(below, "motor voltage", "V")
    legend(above)
    figure.set_facecolor("white")
    path.write_text(figure_to_svg(figure), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:2])
