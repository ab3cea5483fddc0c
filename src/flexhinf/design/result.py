"""What a design comes to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexhinf.campaign import Margins
from flexhinf.design.bench import Bench
from flexhinf.design.comparison import RigidComparison
from flexhinf.design.degrees import DegreeChoice, shrinking
from flexhinf.design.disturbed import Disturbed
from flexhinf.design.draws import Draws
from flexhinf.design.met import Met
from flexhinf.design.modes import Mode
from flexhinf.design.move import Move
from flexhinf.design.presets.choose import Chosen
from flexhinf.design.response import Response
from flexhinf.design.specification import Specification
from flexhinf.hinf import HJISolution
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot

__all__ = ["Design"]


@dataclass(frozen=True, eq=False)
class Design:
    """A design and everything its report shows.

    Attributes
    ----------
    robot, specification
        What was asked.
    game : Chosen
        Penalty, disturbances and level, with who says so.
    goal, start : (n,)
        Link positions of the step, rad or m.
    open_modes, closed_modes : tuple of Mode
        Of the linearisation at the goal, without control, and with the law (true state).
    estimator_modes : tuple of Mode
        Of the estimation error, with the filter's stationary gain; none without an estimator, or without noise.
    bandwidth : (n,)
        Of each joint of the nominal robot, rad/s.
    choices : tuple of DegreeChoice
    chosen : DegreeChoice
    inside : bool or None
        Whether the step starts inside the region of the chosen solution; None if that was not looked at.
    bench : Bench
        Law, estimator and true plant of all runs.
    margins, state_margins : Margins
        Of the sampled loop at the goal, with the estimator, and with the true state fed back.
    response : Response
        The step, with the estimator.
    disturbed : Disturbed
    move : Move
    draws : Draws or None
    met : tuple of Met
        The specification, line by line.
    sub_steps : tuple of int
        Runge–Kutta steps per period: of the estimator's model (0 without one), of the true plant.
    duration : float
        s.
    rays : int
    rigid : RigidComparison or None
    mujoco : Response or None
        The step on MuJoCo's plant, if asked for.
    """

    robot: Robot
    specification: Specification
    game: Chosen
    goal: np.ndarray
    start: np.ndarray
    open_modes: tuple[Mode, ...]
    closed_modes: tuple[Mode, ...]
    estimator_modes: tuple[Mode, ...]
    bandwidth: np.ndarray
    choices: tuple[DegreeChoice, ...]
    chosen: DegreeChoice
    inside: bool | None
    bench: Bench
    margins: Margins
    state_margins: Margins
    response: Response
    disturbed: Disturbed
    move: Move
    draws: Draws | None
    met: tuple[Met, ...]
    sub_steps: tuple[int, int]
    duration: float
    rays: int
    rigid: RigidComparison | None
    mujoco: Response | None = None

    @property
    def solution(self) -> HJISolution:
        """The chosen solution."""
        return self.chosen.solution

    @property
    def problem(self) -> GeneralisedPlant:
        """The nominal problem about the goal."""
        return self.game.nominal

    @property
    def gamma_star(self) -> float:
        """Smallest level of the game."""
        return self.game.gamma_star

    @cached_property
    def shrinking(self) -> list[tuple[int, int]]:
        """Pairs of degrees where the higher allows a smaller step."""
        return shrinking(self.choices)
