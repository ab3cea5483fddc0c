"""The corridor: from a robot and a specification to a judged design, one call per arrow."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from flexhinf.campaign import margins
from flexhinf.design.bench import Bench
from flexhinf.design.comparison import compare_rigid
from flexhinf.design.degrees import DegreeChoice, rays_of, tried_degrees, try_degrees
from flexhinf.design.disturbed import default_load, disturbed_response
from flexhinf.design.draws import Draws, drawn_steps
from flexhinf.design.estimator import estimator_modes
from flexhinf.design.met import Met, linear_met, step_met, within_tolerances
from flexhinf.design.modes import Mode, closed_loop, modes_of, stiffness_and_inertia
from flexhinf.design.move import move_response, planned
from flexhinf.design.presets.behaviour import behaviour_of
from flexhinf.design.presets.choose import Chosen
from flexhinf.design.presets.linear_family import LinearFamily
from flexhinf.design.presets.weights import JointScales
from flexhinf.design.response import Response, default_start, run_length
from flexhinf.design.resting import resting_loop
from flexhinf.design.result import Design
from flexhinf.design.schedule import law_of
from flexhinf.design.specification import Specification
from flexhinf.design.within_peak import choose_within_peak
from flexhinf.plant import Penalty, Plant, sub_steps
from flexhinf.robot import Robot, check_holding

__all__ = ["Design", "design", "stages"]


def design(
    robot: Robot, specification: Specification, tell: Callable[[str], None] = lambda text: None
) -> Design:
    """Everything from the robot to its judged loop; nothing is written.

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
    tell("rest, and weights")
    rest = robot.operating_point(s.pose)
    goal = rest[0][: len(robot.joint_names)]
    start = default_start(robot, goal) if s.start is None else robot.operating_point(s.start)[0][: len(goal)]
    _check_holding(robot, s, goal, start)
    game = choose_within_peak(robot, goal, start, s, tell)
    plant = game.nominal.plant
    energy = stiffness_and_inertia(plant, rest)

    states = len(game.problem.state_names)
    degrees, rays = tried_degrees(states, s), rays_of(states, s)
    choices = tuple(
        try_degrees(
            game.problem, degrees, s.gamma_ratio, s.checked_gamma_ratio, _checked(s, game), rays, s.seed, tell,
            game.gamma_star,
        )
    )  # fmt: skip
    chosen = _best(choices)
    gain = chosen.solution.gain
    law = law_of(robot, s, game, chosen.solution, goal, start, tell)
    bench = Bench(robot, s, plant, law, goal, start)
    closed_modes = modes_of(closed_loop(game.nominal, gain), robot.joint_names, *energy)
    bandwidth = behaviour_of(LinearFamily.of(robot, goal, members=0), gain).bandwidth

    tell("margins of the loop with its estimator")
    resting = resting_loop(bench, chosen.solution)
    with_state = resting_loop(bench, chosen.solution, estimated=False)

    tell("compile the closed loop, and run the step")
    slowest = min(-mode.eigenvalue.real for mode in closed_modes)
    duration = run_length(slowest) if s.duration is None else s.duration
    response = bench.step(duration)
    taken = response.run.settings["sub_steps"]
    tell("torques on the links")
    load = _load(s, JointScales.of(plant, rest), np.abs(response.run.signals["input"]).max(axis=0))
    disturbed = disturbed_response(bench, load, 2.0 * duration)
    tell("a move with feedforward")
    move = move_response(bench, planned(bench, bandwidth))

    mujoco = None
    if s.mujoco:
        tell("the step on MuJoCo's plant")
        mujoco = bench.step(duration, mujoco_plant(robot, bench.true_plant, rest, s))
    draws = None
    count = draws_of(robot, states, s)
    if count:
        tell(f"the step of {count} robots within their tolerances")
        draws = drawn_steps(bench, count, duration, taken)
    rigid = None
    if s.compare_rigid:
        tell("the rigid design on the same robot")
        rigid = compare_rigid(
            game.nominal, bench.true_plant, chosen.degree, s, energy, bench.rest(start), goal, duration
        )
    estimator = bench.estimator(start)
    error_modes: tuple[Mode, ...] = ()
    if estimator is not None and max(s.noises) > 0.0:
        error_modes = estimator_modes(estimator, rest, robot.joint_names, *energy)
    return Design(
        robot, s, game, goal, start, modes_of(plant.linearise(*rest)[0], robot.joint_names, *energy), closed_modes,
        error_modes, bandwidth, choices, chosen, _inside(bench, chosen), bench, margins(resting), margins(with_state), response, disturbed, move,
        draws, _met(s, bench, game, (response, mujoco), draws, closed_modes, bandwidth),
        (0 if estimator is None else estimator.sub_steps, taken), duration, rays, rigid, mujoco,
    )  # fmt: skip


def _best(choices: tuple[DegreeChoice, ...]) -> DegreeChoice:
    """The degree with the largest step; of regions that were not looked at, the highest degree."""
    return max(choices, key=lambda c: (c.step_amplitude, -c.degree) if c.looked else (0.0, c.degree))


def _check_holding(robot: Robot, s: Specification, goal: np.ndarray, start: np.ndarray) -> None:
    limits = [limit for limit in (s.peak_effort, s.saturation) if limit is not None]
    for pose in (goal, start, *s.via):
        if limits:
            check_holding(robot, pose, min(limits))


def _load(s: Specification, scales: JointScales, peak: np.ndarray) -> np.ndarray:
    if s.load is not None:
        return np.full(len(scales.stiffness), s.load)
    return default_load(scales.per_input, peak)


def _inside(bench: Bench, chosen: DegreeChoice) -> bool | None:
    """Whether the start, with the integrals that the controller chooses, lies in the sampled region."""
    if not chosen.looked:
        return None
    return bool(chosen.solution.value(bench.departure(chosen.solution)) <= chosen.level)


def _met(
    s: Specification,
    bench: Bench,
    game: Chosen,
    runs: tuple[Response, Response | None],
    draws: Draws | None,
    modes: tuple[Mode, ...],
    bandwidth: np.ndarray,
) -> tuple[Met, ...]:
    """The specification line by line."""
    unit = bench.model.unit(bench.model.inputs[0])
    damping = min((mode.damping for mode in modes if mode.vibration), default=np.inf)
    lines = linear_met(s, game.wanted, bandwidth, damping)
    lines += step_met(s, runs[0], unit, "the step, nominal robot")
    if runs[1] is not None:
        lines += step_met(s, runs[1], unit, "the step on MuJoCo's plant")
    if draws is not None:
        lines += within_tolerances(s, draws, unit)
    return tuple(lines)


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


def _checked(s: Specification, game: Chosen) -> Any:
    """The checked penalty with plain names spelled out for every joint."""
    if s.checked_penalty is None or callable(s.checked_penalty):
        return s.checked_penalty
    return Penalty.of(s.checked_penalty).expanded(game.nominal.plant.groups).states


#: Robots within their tolerances: with up to so many states, and with more.
DRAWS = ((15, 200), (10_000, 20))


def draws_of(robot: Robot, states: int, s: Specification) -> int:
    """How many robots are drawn: as asked, or fewer for more states; none without tolerances."""
    if not robot.uncertain:
        return 0
    return next(count for most, count in DRAWS if states <= most) if s.draws is None else s.draws


def stages(robot: Robot, specification: Specification) -> int:
    """How many steps of work there are, for a progress bar."""
    s, states = specification, 5 * len(robot.joint_names)
    degrees, rays = tried_degrees(states, s), rays_of(states, s)
    more = [s.peak_effort is not None, s.mujoco, draws_of(robot, states, s) > 0, s.compare_rigid]
    return 5 + len(degrees) * (2 if rays else 1) + len(s.via) + sum(more)
