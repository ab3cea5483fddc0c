"""Second half of the corridor: every run of the nonlinear loop that a report shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.bench import Bench
from flexhinf.design.comparison import RigidComparison, compare_rigid
from flexhinf.design.disturbed import Disturbed, default_load, disturbed_response
from flexhinf.design.draws import Draws, drawn_steps
from flexhinf.design.linearised import Linearised
from flexhinf.design.modes import stiffness_and_inertia
from flexhinf.design.move import Move, move_response, planned
from flexhinf.design.presets.weights import JointScales
from flexhinf.design.response import Response
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis import Synthesis
from flexhinf.plant import sub_steps

__all__ = ["Runs", "draws_of", "mujoco_plant", "run_all"]

#: Robots within their tolerances: with up to so many states, and with more.
DRAWS = ((15, 200), (10_000, 20))

#: The rigid law is of the design's degree with up to so many states, and linear with more: its text is not a table.
RIGID_STATES = 15

#: Largest step of MuJoCo's Runge–Kutta method times the fastest mode.
MUJOCO_STEP = 0.1


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs with the estimator, unless said otherwise.

    Attributes
    ----------
    response : Response
        The step.
    disturbed : Disturbed
    move : Move
    mujoco : Response or None
        The step on MuJoCo's plant, if asked for.
    draws : Draws or None
    rigid : RigidComparison or None
        The rigid design, fed the true state.
    sub_steps : tuple of int
        Runge–Kutta steps per period: of the estimator's model (0 without one), of the true plant.
    duration : float
        Of the step, s.
    """

    response: Response
    disturbed: Disturbed
    move: Move
    mujoco: Response | None
    draws: Draws | None
    rigid: RigidComparison | None
    sub_steps: tuple[int, int]
    duration: float


def run_all(bench: Bench, synthesis: Synthesis, linear: Linearised, tell: Callable[[str], None]) -> Runs:
    """All of them."""
    s, robot = bench.specification, bench.robot
    tell("compile the closed loop, and run the step")
    duration = linear.step_length(s)
    response = bench.step(duration)
    taken = response.run.settings["sub_steps"]
    tell("torques on the links")
    disturbed = disturbed_response(bench, _load(bench, response), 2.0 * duration)
    tell("a move with feedforward")
    move = move_response(bench, planned(bench, linear.bandwidth))
    mujoco = None
    if s.mujoco:
        tell("the step on MuJoCo's plant")
        mujoco = bench.step(duration, mujoco_plant(bench))
    draws, count = None, draws_of(robot, len(synthesis.problem.state_names), s)
    if count:
        tell(f"the step of {count} robots within their tolerances")
        draws = drawn_steps(bench, count, duration, taken)
    rigid = None
    if s.compare_rigid:
        tell("the rigid design on the same robot")
        rigid = _rigid(bench, synthesis, duration)
    estimator = bench.estimator(bench.start)
    steps = (0 if estimator is None else estimator.sub_steps, taken)
    return Runs(response, disturbed, move, mujoco, draws, rigid, steps, duration)


def _load(bench: Bench, response: Response) -> np.ndarray:
    scales = JointScales.of(bench.model, bench.robot.operating_point(bench.goal))
    load = bench.specification.load
    if load is not None:
        return np.full(len(scales.stiffness), load)
    return default_load(scales.per_input, np.abs(response.run.signals["input"]).max(axis=0))


def _rigid(bench: Bench, synthesis: Synthesis, duration: float) -> RigidComparison | None:
    energy = stiffness_and_inertia(bench.model, bench.robot.operating_point(bench.goal))
    few = len(synthesis.problem.state_names) <= RIGID_STATES
    return compare_rigid(
        synthesis.problem, bench.true_plant, synthesis.chosen.degree if few else 2, bench.specification, energy,
        bench.rest(bench.start), bench.goal, duration,
    )  # fmt: skip


def mujoco_plant(bench: Bench) -> Any:
    """The same robot in MuJoCo, its step a tenth of a radian of the fastest mode's phase or less.

    Raises
    ------
    InvalidInput
        If MuJoCo is not installed, or does not express the extras.
    """
    from flexhinf.robot import MuJoCoPlant

    s = bench.specification
    x, u = bench.rest(bench.goal)
    step = s.period / sub_steps(s.period, bench.true_plant.fastest_mode(x, u), MUJOCO_STEP)
    measured = None if s.estimator == "none" else s.measured
    return MuJoCoPlant(bench.robot, measured=measured, step=step, extras=s.extras)


def draws_of(robot: Any, states: int, s: Specification) -> int:
    """How many robots are drawn: as asked, or fewer for more states; none without tolerances."""
    if not robot.uncertain:
        return 0
    return next(count for most, count in DRAWS if states <= most) if s.draws is None else s.draws
