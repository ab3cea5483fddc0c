"""The laws of the product: that of one pose, about the robot's home, and the one for the whole workspace.

Everything is at its default but what is of the loop: the sensors, their noise, and a latency of one sample; and the
ripple that the criterion allows, which the law for the workspace is told. A controller is saved by the design and
loaded by every row, and its own step runs. Its command is that of the instant at
which its input acts: the reference's state then, and the feedforward that all laws get.

The law of one pose is what ``flexhinf design ROBOT --pose …`` makes at the robot's home, run in error coordinates about
the moving reference, as designs run moves. Its estimator has the robot's nonlinear model; the gain of its law is that
of home.

The law for the workspace is what ``flexhinf design ROBOT`` makes. Here it is designed, and not judged: its bandwidth is
found at random poses, and neither these nor the moves by which a design is judged are those of the benchmark.
"""

from __future__ import annotations

import json
import time
from abc import abstractmethod
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.workspace.arm import LATENCY, PERIOD, Arm
from benchmarks.workspace.goals import Reference
from benchmarks.workspace.linear import Linear
from benchmarks.workspace.trip import NOISE, RESOLUTION
from flexhinf.analysis import EquilibriumLoop, LinearLoop
from flexhinf.designs.plans import stated_dry_friction
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.search import tuned_setup
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.robot.workspace import LIMITS, workspace_of

__all__ = ["OnePose", "OverWorkspace"]

#: Ripple that the criterion allows, per cent of a motor's limit.
RIPPLE = 1.5

#: Variance of the encoders' noise, rad² (m²).
VARIANCE = NOISE[0] ** 2


class Product:
    """A controller of the product, saved in a folder; it is designed where it is not there yet."""

    name: str  # of its file, behind the robot's

    def __init__(self, arm: Arm, links: bool, folder: Path) -> None:
        self.arm, self.measured = arm, ("link_position", "motor_position") if links else ("motor_position",)
        file = Path(folder) / f"{arm.robot.name}{self.name}{'' if links else '-motors'}.controller"
        note = file.with_suffix(".note")
        if not (file.exists() and note.exists()):
            began = time.process_time()
            with np.errstate(
                over="ignore", invalid="ignore"
            ):  # corners of the tolerances that have no equilibrium
                controller, said = self.designed()
            said["design_cpu"] = time.process_time() - began
            part = file.with_suffix(".part")
            controller.save(part)
            part.replace(file)
            note.write_text(json.dumps(said), encoding="utf-8")
        self.controller = fh.load_controller(file).fresh(dry_friction=None)  # see `overcome`
        self.note = json.loads(note.read_text(encoding="utf-8"))

    @abstractmethod
    def designed(self) -> tuple[fh.Controller, dict[str, Any]]:
        """The controller, at rest at home, and what else is to be kept."""

    def specification(self, **more: Any) -> fh.Specification:
        """What is asked of the design."""
        return fh.Specification(measured=self.measured, measurement_noise=VARIANCE, latency=LATENCY, **more)

    def overcome(self) -> None:
        """From now on with the dry friction of the robot's file, as a design deploys it."""
        self.controller = self.controller.fresh(dry_friction=stated_dry_friction(self.arm.robot))

    def start(self, q: np.ndarray) -> None:
        """Begin at rest: the estimator is told the pose, as firmware would be."""
        state, held = self.arm.robot.operating_point(q)
        self.controller.reset(state, input=held)

    def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
        """The controller's own step; where it refuses one, the caller hears of it."""
        return self.controller.step(y, np.concatenate([reference.ahead, reference.input]))

    def linear(self, q: np.ndarray) -> Linear:
        """Memory and input by memory and measurement, with the filter's gain at this pose."""
        loop = self.loop(q)
        size = len(loop.memory)
        return loop.memory[:, :size], loop.memory[:, size:], loop.law[:, :size], loop.law[:, size:]

    @abstractmethod
    def loop(self, q: np.ndarray) -> LinearLoop:
        """The sampled loop at rest at a pose, of which the controller's part counts."""


class OnePose(Product):
    """The law of one pose."""

    name = ""

    def designed(self) -> tuple[fh.Controller, dict[str, Any]]:
        """A design at home."""
        home = tuple(self.arm.home.tolist())
        asked = self.specification(pose=home, draws=0, rays=0)
        found = fh.design(self.arm.robot, asked)
        missed = [line.what for line in found.requirements if line.met is False]
        return found.loop.setup.controller(self.arm.home, moving=True), {"missed": missed}

    def loop(self, q: np.ndarray) -> LinearLoop:
        """With the filter's stationary gain."""
        return EquilibriumLoop(
            self.controller.law, self.controller.estimator, self.arm.robot.plant(self.measured), PERIOD,
            equilibrium=self.arm.robot.operating_point(q), moving=True, latency=LATENCY,
        ).linear()  # fmt: skip


class OverWorkspace(Product):
    """The law for the whole workspace, all poses within the joint limits."""

    name = "-workspace"

    @cached_property
    def setup(self) -> WorkspaceSetup:
        """The setup that a design judges, without the judgement."""
        robot = self.arm.robot
        steps = np.tile(np.where(self.arm.slides, RESOLUTION[1], RESOLUTION[0]), len(self.measured))
        asked = self.specification(workspace=LIMITS, quantisation=tuple(steps.tolist()), ripple=RIPPLE)
        return tuned_setup(robot, asked, Task(workspace_of(robot, LIMITS)))

    def designed(self) -> tuple[fh.Controller, dict[str, Any]]:
        """Its controller."""
        return self.setup.controller(self.arm.home), {}

    def loop(self, q: np.ndarray) -> LinearLoop:
        """By the design, which is made anew where the controller is loaded: much faster than from the controller."""
        return self.setup.linear(q)
