"""The loops of a design: one law, one estimator and one true plant, in every run of its report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.design.estimator import estimator_for, noise_variances
from flexhinf.design.response import Response, step_response
from flexhinf.design.specification import Specification
from flexhinf.loop import Controller, Loop
from flexhinf.plant import Law, Plant

__all__ = ["Bench"]


@dataclass(frozen=True, eq=False)
class Bench:
    """What all runs of a design share.

    Parameters
    ----------
    robot : Robot
    specification : Specification
    model : Plant
        What the estimator believes in.
    law : Law
        Or a schedule of laws.
    goal, start : (n,)
        Link positions.
    """

    robot: Any
    specification: Specification
    model: Plant
    law: Law
    goal: np.ndarray
    start: np.ndarray

    @cached_property
    def true_plant(self) -> Plant:
        """The nominal robot with the extras."""
        s = self.specification
        return self.robot.plant(s.measured, extras=s.extras)

    @cached_property
    def noise(self) -> np.ndarray | None:
        """Standard deviations of the measurement noise; None where the true state is fed back."""
        s = self.specification
        return None if s.estimator == "none" else np.sqrt(noise_variances(self.model, s.measurement_noise))

    def estimator(self, at: np.ndarray) -> Any:
        """The estimator, believing at first that the robot rests at a pose (n,)."""
        s = self.specification
        return estimator_for(
            s.estimator, self.model, self.robot.operating_point(self.goal), self.robot.operating_point(at)[0],
            s.period, s.noises, s.measurement_noise,
        )  # fmt: skip

    def controller(self, at: np.ndarray, moving: bool = False, law: Law | None = None) -> Controller:
        """A controller that begins at a pose (n,): its input continues from what held the robot there.

        Parameters
        ----------
        at : (n,)
        moving : bool
            In error coordinates about a moving reference.
        law : Law, optional
            Instead of the design's.
        """
        s, estimator = self.specification, self.estimator(at)
        begin = "zero" if moving else "bumpless"
        law = self.law if law is None else law
        return Controller(law, estimator, s.period, s.saturation, moving=moving, start=begin)

    def loop(self, controller: Controller, plant: Any = None, sub_steps: int | None = None) -> Loop:
        """A loop round the true plant, or round another one, with the delay and the grain of the specification."""
        s = self.specification
        return Loop(
            self.true_plant if plant is None else plant,
            controller,
            sub_steps,
            quantisation=s.quantisation or None,
            delay=s.delay,
        )

    def rest(self, at: np.ndarray, values: Mapping[str, Any] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """State and input with which the true robot rests at a pose, of these parameters."""
        return self.robot.operating_point(at, self.specification.extras, values)

    def departure(self, law: Law) -> np.ndarray:
        """Deviation (n,) from the goal's rest at which a law takes over at the start, its integrals included."""
        controller = self.controller(self.start, law=law)
        x, u = self.rest(self.start)
        count = len(controller.states)
        controller.reset(input=u) if controller.estimator is None else controller.reset(x[:count], input=u)
        measured = x[:count] if controller.estimator is None else self._measured(x[:count], u)
        controller.step(measured)
        return np.concatenate([x[:count], controller.integrals]) - law.operating_point

    def _measured(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        table = self.model.parameters
        return np.asarray(self.model.traced_output(x, u, table.vector()), dtype=float).ravel()

    def step(self, duration: float, plant: Any = None) -> Response:
        """The step from start to goal, of the nominal robot or of another plant (MuJoCo's)."""
        loop = self.loop(self.controller(self.start), plant)
        return step_response(
            loop, self.rest(self.start), self.goal, self.noise, duration, self.specification.seed
        )
