"""The design that the others are compared with: the same weights, game, level and degree as ``flexhinf design``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexhinf.design.bench import Bench
from flexhinf.design.disturbed import default_load
from flexhinf.design.modes import closed_loop, modes_of, stiffness_and_inertia
from flexhinf.design.move import planned
from flexhinf.design.presets.behaviour import behaviour_of
from flexhinf.design.presets.linear_family import LinearFamily
from flexhinf.design.presets.weights import JointScales
from flexhinf.design.response import LONGEST, run_length
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis import Synthesis, synthesise
from flexhinf.hinf import smallest_gamma
from flexhinf.loop import JerkLimited
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot

__all__ = ["Reference", "reference_of"]

#: Steps last so many times as long as the design's own: a law that is slower than it may settle.
LONGER = 3.0


@dataclass(frozen=True, eq=False)
class Reference:
    """The design's own law, and what its loop fixes for all others.

    Attributes
    ----------
    robot, specification
    synthesis : Synthesis
        Its law, weights, game and degrees.
    bench : Bench
        Estimator, noise, delay and true plant of all runs.
    """

    robot: Robot
    specification: Specification
    synthesis: Synthesis
    bench: Bench

    @property
    def problem(self) -> GeneralisedPlant:
        """The nominal problem about the goal."""
        return self.synthesis.problem

    @cached_property
    def rest(self) -> tuple[np.ndarray, np.ndarray]:
        """State and input of the model at the goal."""
        return self.problem.operating_point[: self.problem.plant.n], self.problem.operating_input

    @cached_property
    def energy(self) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and inertia at the goal, to tell vibrations from other modes."""
        return stiffness_and_inertia(self.problem.plant, self.rest)

    @cached_property
    def own_gamma_star(self) -> float:
        """Smallest level of the problem as it is solved; of a robust game, with channels that stay as they are."""
        return smallest_gamma(self.synthesis.game.problem)

    @cached_property
    def bandwidth(self) -> np.ndarray:
        """Of each joint, rad/s, as ``flexhinf design`` has it."""
        family = LinearFamily.of(self.robot, self.bench.goal, members=0)
        return behaviour_of(family, self.synthesis.solution.gain).bandwidth

    @cached_property
    def duration(self) -> float:
        """Of the design's own step, s: as asked, or by the slowest mode of this law."""
        if self.specification.duration is not None:
            return self.specification.duration
        loop = closed_loop(self.problem, self.synthesis.solution.gain)
        modes = modes_of(loop, self.robot.joint_names, *self.energy)
        return run_length(min(-mode.eigenvalue.real for mode in modes))

    @property
    def step_duration(self) -> float:
        """Of the steps of all laws, s: as asked, or `LONGER` times the design's own, at most `LONGEST`."""
        if self.specification.duration is not None:
            return self.duration
        return min(LONGER * self.duration, LONGEST)

    @cached_property
    def plan(self) -> JerkLimited:
        """The move that all laws follow."""
        return planned(self.bench, self.bandwidth)

    @cached_property
    def load(self) -> np.ndarray:
        """Torques on the links, (n,): as asked, or by the peak of this design's own step."""
        asked = self.specification.load
        if asked is not None:
            return np.full(len(self.bench.goal), asked)
        peak = np.abs(self.bench.step(self.duration).run.signals["input"]).max(axis=0)
        return default_load(JointScales.of(self.problem.plant, self.rest).per_input, peak)

    @property
    def unit(self) -> str:
        """Of the inputs."""
        return self.problem.plant.unit(self.problem.input_names[0])

    @property
    def units(self) -> Mapping[str, str]:
        """Of positions, of small ones, and of torques at the links; both kinds for joints of both kinds."""
        slides = tuple(bool(slide) for slide in self.robot.links.slides)
        kinds = {"position": ("rad", "m"), "error": ("mrad", "mm"), "torque": ("N·m", "N")}
        return {
            name: " or ".join(unit for unit, there in zip(pair, (not all(slides), any(slides))) if there)
            for name, pair in kinds.items()
        }


def reference_of(robot: Robot, specification: Specification, tell: Callable[[str], None]) -> Reference:
    """The design of a specification, without its report.

    Raises
    ------
    InvalidInput, InfeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        As `flexhinf.design.design`.
    """
    found = synthesise(robot, specification, tell)
    bench = Bench(robot, specification, found.problem.plant, found.law, found.goal, found.start)
    return Reference(robot, specification, found, bench)
