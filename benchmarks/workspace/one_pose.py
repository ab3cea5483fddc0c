"""The law of one pose: what ``flexhinf design ROBOT`` makes today, about the robot's home, run along moves.

Everything is at its default but the sensors, their noise, and the loop's latency of one sample, which is stated as
``--latency 1``. The controller runs in error coordinates about the moving reference, as designs run moves: its command
is that of the instant at which its input acts. Its estimator has the robot's nonlinear model and predicts over the
latency; the gain of its law is that of home.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np

import flexhinf as fh
from benchmarks.workspace.arm import LATENCY, PERIOD, Arm
from benchmarks.workspace.goals import Reference
from benchmarks.workspace.linear import Linear
from flexhinf.analysis import EquilibriumLoop

__all__ = ["OnePose"]

#: Variance of the encoders' noise, rad² (m²).
VARIANCE = 1e-10


class OnePose:
    """A saved controller of one pose; it is designed where it is not in the folder yet."""

    def __init__(self, arm: Arm, links: bool, folder: Path) -> None:
        self.arm, self.measured = arm, ("link_position", "motor_position") if links else ("motor_position",)
        file = Path(folder) / f"{arm.robot.name}{'' if links else '-motors'}.controller"
        note = file.with_suffix(".note")
        if not (file.exists() and note.exists()):
            began = time.process_time()
            with np.errstate(
                over="ignore", invalid="ignore"
            ):  # corners of the tolerances that have no equilibrium
                found = fh.design(arm.robot, self.specification())
            seconds = time.process_time() - began
            controller = found.setup.controller(arm.home, moving=True)
            part = file.with_suffix(".part")
            controller.save(part)
            part.replace(file)
            missed = [line.what for line in found.requirements if line.met is False]
            note.write_text(json.dumps({"design_cpu": seconds, "missed": missed}), encoding="utf-8")
        self.controller = fh.load_controller(file)
        self.note = json.loads(note.read_text(encoding="utf-8"))

    def specification(self) -> fh.Specification:
        """What is asked of the design."""
        return fh.Specification(
            measured=self.measured, measurement_noise=VARIANCE, latency=LATENCY, draws=0, rays=0,
            compare_rigid=False,
        )  # fmt: skip

    def start(self, q: np.ndarray) -> None:
        """Begin at rest: the estimator is told the pose, as firmware would be."""
        state, held = self.arm.robot.operating_point(q)
        self.controller.reset(state, input=held)

    def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
        """The controller's own step; where it refuses one, the caller hears of it."""
        return self.controller.step(y, np.concatenate([reference.ahead, reference.input]))

    def linear(self, q: np.ndarray) -> Linear:
        """Memory and input by memory and measurement, with the filter's stationary gain at this pose."""
        loop = EquilibriumLoop(
            self.controller.law, self.controller.estimator, self.arm.robot.plant(self.measured), PERIOD,
            equilibrium=self.arm.robot.operating_point(q), moving=True, latency=LATENCY,
        ).linear()  # fmt: skip
        size = len(loop.memory)
        return loop.memory[:, :size], loop.memory[:, size:], loop.law[:, :size], loop.law[:, size:]
