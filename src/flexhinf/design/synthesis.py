"""First half of the corridor: from a specification to a law at the goal, and on the way to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.degrees import DegreeChoice, rays_of, tried_degrees, try_degrees
from flexhinf.design.estimator import estimator_for
from flexhinf.design.presets.choose import Chosen
from flexhinf.design.response import default_start
from flexhinf.design.schedule import law_of
from flexhinf.design.specification import Specification
from flexhinf.design.within_peak import choose_within_peak
from flexhinf.hinf import HJISolution
from flexhinf.plant import GeneralisedPlant, Law, Penalty
from flexhinf.robot import Robot, check_holding

__all__ = ["Synthesis", "synthesise"]


@dataclass(frozen=True, eq=False)
class Synthesis:
    """The law of a design.

    Attributes
    ----------
    goal, start : (n,)
        Link positions of the step, rad or m.
    game : Chosen
        Penalty, disturbances and level, with who says so.
    choices : tuple of DegreeChoice
    chosen : DegreeChoice
    rays : int
    law : Law
        The chosen solution, or a schedule with those of other poses.
    """

    goal: np.ndarray
    start: np.ndarray
    game: Chosen
    choices: tuple[DegreeChoice, ...]
    chosen: DegreeChoice
    rays: int
    law: Law

    @property
    def solution(self) -> HJISolution:
        """The chosen solution at the goal."""
        return self.chosen.solution

    @property
    def problem(self) -> GeneralisedPlant:
        """The nominal problem about the goal."""
        return self.game.nominal


def synthesise(robot: Robot, s: Specification, tell: Callable[[str], None]) -> Synthesis:
    """Weights, every degree, the best of them, and laws at other poses."""
    n = len(robot.joint_names)
    goal = robot.operating_point(s.pose)[0][:n]
    start = default_start(robot, goal) if s.start is None else robot.operating_point(s.start)[0][:n]
    _refuse_early(robot, s, goal, start)
    game = choose_within_peak(robot, goal, start, s, tell)
    states = len(game.problem.state_names)
    degrees, rays = tried_degrees(states, s), rays_of(states, s)
    ratios = s.gamma_ratio, s.checked_gamma_ratio
    choices = tuple(
        try_degrees(game.problem, degrees, *ratios, _checked(s, game), rays, s.seed, tell, game.gamma_star)
    )
    chosen = _best(choices)
    law = law_of(robot, s, game, chosen.solution, goal, start, tell)
    return Synthesis(goal, start, game, choices, chosen, rays, law)


def _best(choices: tuple[DegreeChoice, ...]) -> DegreeChoice:
    """The degree with the largest step; where no degree has a region, the highest degree."""
    return max(
        choices, key=lambda c: (c.step_amplitude, -c.degree) if c.step_amplitude > 0.0 else (0.0, c.degree)
    )


def _refuse_early(robot: Robot, s: Specification, goal: np.ndarray, start: np.ndarray) -> None:
    """What does not fit is refused before the work: extras, sensors and estimator, poses that cannot be held."""
    robot.plant(s.measured, extras=s.extras)
    rest, begin = robot.operating_point(goal), robot.operating_point(start)[0]
    estimator_for(s.estimator, robot.plant(s.measured), rest, begin, s.period, s.noises, s.measurement_noise)
    for pose in (goal, start, *s.via):
        if s.effort_limit is not None:
            check_holding(robot, pose, s.effort_limit)
        else:
            robot.operating_point(pose)


def _checked(s: Specification, game: Chosen) -> Any:
    """The checked penalty with plain names spelled out for every joint."""
    if s.checked_penalty is None or callable(s.checked_penalty):
        return s.checked_penalty
    return Penalty.of(s.checked_penalty).expanded(game.nominal.plant.groups).states
