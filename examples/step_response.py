"""A 180° step of the paper's arm by the linear and by the cubic H∞ law, put together by hand.

The laws are designed once about the goal, as ``flexhinf design`` does it, and once about the hanging rest, as in the
paper. Which law is better depends on that: about the goal the linear one, about the hanging rest the cubic one. Only
the link position is measured. Prints the metrics and saves the steps about the goal as an SVG.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import flexhinf as fh

GOAL = np.pi  # rad


def main(folder: str | Path = ".") -> dict[str, dict]:
    """Simulate both laws about both poses; returns their metrics."""
    runs = {}
    for about, pose in (("the goal", GOAL), ("the hanging rest", 0.0)):
        for law, degree in (("linear", 2), ("cubic", 4)):
            name = f"{law} about {about}"
            runs[name] = step(pose, degree)
            metrics = runs[name].metrics()
            print(
                f"{name}: overshoot {metrics['overshoot_percent']:.1f} %, "
                f"settling time {metrics['settling_time_s']:.2f} s, peak {metrics['peak_input']:.1f} V"
            )
    picture = Path(folder) / "step_180.svg"
    draw({name: run for name, run in runs.items() if "goal" in name}, picture)
    print(f"picture: {picture}")
    return {name: run.metrics() for name, run in runs.items()}


def step(pose: float, degree: int) -> fh.Trajectory:
    """From the hanging rest to the goal, with a law about `pose` from a V of this degree."""
    robot = fh.paper_arm()  # Tables 1 and 2
    problem = robot.problem(pose=pose)  # penalty, integral of the error, the command as disturbance
    solution = fh.solve_hji(problem, gamma=2 * fh.smallest_gamma(problem), degree=degree)
    ukf = fh.UnscentedKalmanFilter(robot.plant(), 1e-3, 1e-6, 1e-6, mean=np.zeros(4), covariance=1e-4)
    controller = fh.Controller(solution, ukf, period=1e-3, start="bumpless")  # the input does not jump
    rest, held = robot.operating_point(0.0, ("inductance",))
    loop = fh.Loop(robot.plant(inductance=True), controller)  # the true plant has the motor's coil too
    return loop.run(fh.Step(GOAL), noise=1e-3, duration=8.0, initial_state=rest, initial_input=held)


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
    settling_band(above, np.degrees(GOAL), np.degrees(GOAL))
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
