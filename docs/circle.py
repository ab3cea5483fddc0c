"""The table of docs/identify.md: designs by wrong robot files, and by files with the numbers of a log."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

#: Numbers of the arm that a file has wrong, and by how much each time.
NUMBERS = ("stiffness", "friction", "motor_inertia")
WRONG = ((1.3, 0.7, 1.3), (1.3, 0.7, 0.75), (1.3, 1.4, 0.75), (0.75, 1.4, 1.3), (0.75, 0.7, 0.75))

#: What the design has to be.
REQUIRED: dict[str, Any] = {
    "pose": "90deg",
    "start": 0.0,
    "bandwidth": 5.5,
    "draws": 0,
    "rays": 0,
}

#: Standard deviation of the link's encoder, rad; runs of the robot by RK4, steps per sample.
NOISE, PARTS = 1e-4, 4


def driven(robot: Any, motion: Any, path: Path, seed: int) -> None:
    """A CSV of the robot under the motion's inputs, without feedback: its link encoder and its voltage."""
    rng, plant = np.random.default_rng(seed), robot.plant()
    x, h, rows = robot.operating_point(motion.positions[0])[0], motion.times[1] / PARTS, []
    for t, u in zip(motion.times, motion.inputs):
        rows.append([t, u[0], x[0] + NOISE * rng.normal()])
        for _ in range(PARTS):
            a = plant.derivative(x, u)
            b = plant.derivative(x + h / 2 * a, u)
            c = plant.derivative(x + h / 2 * b, u)
            x = x + h / 6 * (a + 2 * b + 2 * c + plant.derivative(x + h * c, u))
    np.savetxt(path, rows, delimiter=",", header="time,motor_voltage,link_position", comments="")


def judged(design: Any, robot: Any) -> str:
    """What the step of a design's controller misses on a robot, judged as `flexhinf run --mujoco` judges it."""
    import flexhinf as fh
    from flexhinf.designs.deployed_run import prepare_run

    own = design.robot, design.specification
    run = prepare_run(design.controller(), own, robot, design.specification)
    done = fh.run_realtime(run.loop, **run.arguments, real_time=False)
    missed = [line.what for line in run.requirements(done) if not line.met]
    response = run.response(done)
    if not np.isfinite(response.settling.value):
        return "**missed**: does not settle"
    seen = f"overshoot {response.overshoot.value:.1f} %"
    if missed:
        return f"**missed** ({', '.join(missed)}): {seen}"
    return f"met: {seen}, settled after {response.settling.value:.2f} s"


def circle() -> str:
    """A row for each wrong file: the step of its design on the robot, and after an identification."""
    import flexhinf as fh

    arm = fh.load_robot("paper")
    head = (
        "error of stiffness, friction, motor inertia in the file", "its design on the robot",
        "largest error after the log", "the new design on the robot",
    )  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for seed, factors in enumerate(WRONG):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            wrong = arm.with_values({n: f * arm.nominal[n] for n, f in zip(NUMBERS, factors)})
            wrong.save(folder / "guess.toml")
            guess = fh.load_robot(folder / "guess.toml")
            motion = fh.excitation(guess, NUMBERS, duration=6.0)
            driven(arm, motion, folder / "log.csv", seed)
            found = fh.identify(guess, fh.read_log(folder / "log.csv", guess.plant()), NUMBERS)
            found.save(folder / "robot.toml")
            robots = guess, fh.load_robot(folder / "robot.toml")
        before, after = (judged(fh.design(robot, fh.Specification(**REQUIRED)), arm) for robot in robots)
        worst = max(abs(value / arm.nominal[n] - 1.0) for n, value in found.values.items())
        off = ", ".join(f"{100.0 * (factor - 1.0):+.0f} %".replace("-", "−") for factor in factors)
        lines.append(f"| {off} | {before} | {100.0 * worst:.2g} % | {after} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)
