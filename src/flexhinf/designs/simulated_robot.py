"""MuJoCo's robot of a run as hardware: what its sensors read, and where its inputs go."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from flexhinf.designs.loop_setup import LoopPlants
from flexhinf.designs.plans import true_robot
from flexhinf.designs.specification import Specification
from flexhinf.loop import Controller, Loop
from flexhinf.loop.simulation.inputs import sample_noise
from flexhinf.robot import MuJoCoPlant, Robot

#: Samples whose noise is drawn at once.
BLOCK = 1000


class SimulatedRobot:
    """The driven robot with the sensors, noise and delays of its run; what is written acts for one period.

    Numbers are those of `Loop.run`, but for the noise, which goes on for ever.
    """

    def __init__(
        self, box: MuJoCoPlant, loop: Loop, noise: Any, seed: int, start: np.ndarray, input: np.ndarray
    ) -> None:
        controller = loop.controller
        self.box, self._channel, self._seed = box, loop.channel, seed
        self._period, self._measured = controller.period, controller.measured
        self._noise, self._samples = self._channel.noise(noise), 0
        self._waiting = np.full(sum(self._channel.late), np.nan)
        self._block = np.zeros((0, len(self._measured)))
        self._none = np.zeros(len(box.disturbances))
        self.box.reset(start)
        self._inputs = deque(
            [np.array(input, dtype=float)] * self._channel.delay
        )  # before the first one acts

    @classmethod
    def of(
        cls,
        controller: Controller,
        model: Robot,
        robot: Robot,
        specification: Specification,
        pose: np.ndarray,
        noise: bool = True,
    ) -> SimulatedRobot:
        """`robot`, driven by the controller of a design of `model`, at rest at a pose (n,), rad or m.

        `noise`: whether measurements have the stated noise. Raises InvalidInput: as `LoopPlants.mujoco_plant`.
        """
        plants = LoopPlants(model, specification)
        driven, true = true_robot(robot, specification)
        box = LoopPlants(driven, true).mujoco_plant(pose)
        loop = Loop(box, controller, quantisation=plants.quantisation, delay=specification.unknown_delay)
        x, u = driven.operating_point(pose, true.extras)
        noises = plants.noise if noise else None
        return cls(box, loop, noises, specification.seed, x[: len(box.states)], u)

    def read(self) -> np.ndarray:
        """The measurement (p,), NaN where a sensor gives nothing; once for each input that is written."""
        k, channel = self._samples, self._channel
        if k % BLOCK == 0:
            self._block = sample_noise(self._noise, self._seed, BLOCK, self._measured, k // BLOCK)
        y = channel.quantised(np.asarray(self.box.output(), dtype=float) + self._block[k % BLOCK])
        if channel.periods:
            gaps = np.where(k % np.array(channel.periods) != 0, np.nan, 0.0)
            y, self._waiting = channel.arrived(y, self._waiting, gaps)
        self._samples += 1
        return np.asarray(y, dtype=float)

    def write(self, input: np.ndarray) -> None:
        """Let the robot move for a period, under the input that is as late as the run says."""
        self._inputs.append(np.array(input, dtype=float))
        self.box.step(self._inputs.popleft(), self._none, self._period)
