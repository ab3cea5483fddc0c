"""The corridor: from a robot and a specification to a judged design, one call per arrow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.comparison import RigidComparison, compare_rigid
from flexhinf.design.degrees import DegreeChoice, shrinking, try_degrees
from flexhinf.design.estimator import estimator_for, estimator_modes, noise_variances
from flexhinf.design.modes import Mode, closed_loop, modes_of, stiffness_and_inertia
from flexhinf.design.penalty import ChosenPenalty, chosen_penalty
from flexhinf.design.response import Response, default_start, run_length, step_response
from flexhinf.design.specification import Specification
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller
from flexhinf.plant import GeneralisedPlant, Penalty, Plant, sub_steps
from flexhinf.robot import Robot

__all__ = ["Design", "design", "stages"]


@dataclass(frozen=True, eq=False)
class Design:
    """A design and everything its report shows.

    Attributes
    ----------
    robot, specification
        What was asked.
    penalty : ChosenPenalty
    problem : GeneralisedPlant
        About the goal pose.
    goal, start : (n,)
        Link positions of the step, rad or m.
    open_modes, closed_modes : tuple of Mode
        Of the linearisation at the goal, without control, and with the law (true state).
    estimator_modes : tuple of Mode
        Of the estimation error, with the filter's stationary gain; none without an estimator, or without noise.
    gamma_star : float
    choices : tuple of DegreeChoice
    chosen : DegreeChoice
    inside : bool or None
        Whether the step starts inside the region of the chosen solution; None if that was not looked at.
    response : Response
        With the estimator.
    sub_steps : tuple of int
        Runge–Kutta steps per period: of the estimator's model (0 without one), of the true plant.
    duration : float
        s.
    rays : int
    rigid : RigidComparison or None
    mujoco : Response or None
        The same run on MuJoCo's plant, if asked for.
    """

    robot: Robot
    specification: Specification
    penalty: ChosenPenalty
    problem: GeneralisedPlant
    goal: np.ndarray
    start: np.ndarray
    open_modes: tuple[Mode, ...]
    closed_modes: tuple[Mode, ...]
    estimator_modes: tuple[Mode, ...]
    gamma_star: float
    choices: tuple[DegreeChoice, ...]
    chosen: DegreeChoice
    inside: bool | None
    response: Response
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
    def shrinking(self) -> list[tuple[int, int]]:
        """Pairs of degrees where the higher allows a smaller step."""
        return shrinking(self.choices)


def design(
    robot: Robot, specification: Specification, tell: Callable[[str], None] = lambda text: None
) -> Design:
    """Everything from the robot to the step response; nothing is written.

    Parameters
    ----------
    robot : Robot
    specification : Specification
    tell : callable, optional
        Told what comes next, `stages` times in all.

    Raises
    ------
    InvalidInput, InfeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        With what to change.
    """
    s = specification
    tell("rest and linearisation")
    rest = robot.operating_point(s.pose)
    goal = rest[0][: len(robot.joint_names)]
    start = default_start(robot, goal) if s.start is None else robot.operating_point(s.start)[0][: len(goal)]
    true_start = robot.operating_point(start, s.extras)
    penalty = chosen_penalty(robot, goal, s)
    problem = robot.problem(
        penalty.penalty,
        pose=goal,
        measured=s.measured,
        command="disturbance" if s.command or s.disturbances is None else None,
        disturbances=s.disturbances,
    )
    energy = stiffness_and_inertia(problem.plant, rest)
    open_modes = modes_of(problem.plant.linearise(*rest)[0], robot.joint_names, *energy)
    estimator = estimator_for(
        s.estimator, problem.plant, rest, robot.operating_point(start)[0],
        s.period, s.process_noise, s.measurement_noise,
    )  # fmt: skip

    true_plant = robot.plant(s.measured, extras=s.extras)
    independent = mujoco_plant(robot, true_plant, rest, s) if s.mujoco else None

    degrees, rays = degrees_and_rays(len(problem.state_names), s)
    choices = tuple(
        try_degrees(
            problem, degrees, s.gamma_ratio, s.checked_gamma_ratio, _checked(s, problem), rays, s.seed, tell
        )
    )
    chosen = max(
        choices,
        key=lambda c: (c.step_amplitude if c.looked else 0.0, c.degree if not c.looked else -c.degree),
    )
    law = chosen.solution
    deviation = np.zeros(len(problem.state_names))
    deviation[: problem.plant.n] = robot.operating_point(start)[0] - rest[0]
    inside = bool(law.value(deviation) <= chosen.level) if chosen.looked else None
    e = law.expansion
    gain = -np.linalg.solve(e.r2, e.g2_parts[0][:, :, 0].T @ law.P)
    closed_modes = modes_of(closed_loop(problem, gain), robot.joint_names, *energy)

    error_modes: tuple[Mode, ...] = ()
    if estimator is not None and s.process_noise > 0.0:
        error_modes = estimator_modes(estimator, rest, robot.joint_names, *energy)

    tell("compile the closed loop, and run the step")
    slowest = min(-mode.eigenvalue.real for mode in closed_modes)
    duration = run_length(slowest) if s.duration is None else s.duration
    controller = Controller(law, estimator, s.period, s.saturation)
    noise = None if estimator is None else np.sqrt(noise_variances(problem.plant, s.measurement_noise))
    response = step_response(true_plant, controller, true_start, goal, noise, duration, s.seed)
    steps = (0 if estimator is None else estimator.sub_steps, response.run.settings["sub_steps"])

    mujoco = None
    if independent is not None:
        tell("the same run on MuJoCo's plant")
        mujoco = step_response(independent, controller, true_start, goal, noise, duration, s.seed)
    rigid = None
    if s.compare_rigid:
        tell("the rigid design on the same robot")
        rigid = compare_rigid(problem, true_plant, chosen.degree, s, energy, true_start, goal, duration)
    return Design(
        robot, s, penalty, problem, goal, start, open_modes, closed_modes, error_modes, law.gamma / s.gamma_ratio,
        choices, chosen, inside, response, steps, duration, rays, rigid, mujoco,
    )  # fmt: skip


def mujoco_plant(robot: Robot, plant: Plant, rest: tuple[np.ndarray, np.ndarray], s: Specification) -> Any:
    """The same robot in MuJoCo, its step a tenth of a radian of the fastest mode's phase or less.

    Raises
    ------
    InvalidInput
        If MuJoCo is not installed, or does not express the extras.
    """
    from flexhinf.robot import MuJoCoPlant

    x = robot.operating_point(rest[0][: len(robot.joint_names)], s.extras)[0]
    step = s.period / sub_steps(s.period, plant.fastest_mode(x, rest[1]), MUJOCO_STEP)
    measured = None if s.estimator == "none" else s.measured
    return MuJoCoPlant(robot, measured=measured, step=step, extras=s.extras)


#: Largest step of MuJoCo's Runge–Kutta method times the fastest mode.
MUJOCO_STEP = 0.1


def _checked(s: Specification, problem: GeneralisedPlant) -> Any:
    """The checked penalty with plain names spelled out for every joint."""
    if s.checked_penalty is None or callable(s.checked_penalty):
        return s.checked_penalty
    return Penalty.of(s.checked_penalty).expanded(problem.plant.groups).states


def degrees_and_rays(states: int, specification: Specification) -> tuple[tuple[int, ...], int]:
    """Degrees that are tried, and rays: as asked, or fewer for more states."""
    s = specification
    few = states <= 10
    degrees = tuple(s.degrees) if s.degrees is not None else ((2, 4, 6) if few else (2, 4))
    rays = next((count for most, count in RAYS if states <= most), 0) if s.rays is None else s.rays
    return degrees, rays


#: Up to so many states, so many rays; no region is looked at beyond.
RAYS = ((5, 4000), (10, 1000), (20, 200))


def stages(states: int, specification: Specification) -> int:
    """How many steps of work there are, for a progress bar."""
    degrees, rays = degrees_and_rays(states, specification)
    return 2 + len(degrees) * (2 if rays else 1) + specification.compare_rigid + specification.mujoco
