"""The corridor: from a robot and a specification to a judged design, one call per arrow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from flexhinf.design.bench import Bench
from flexhinf.design.degrees import rays_of, tried_degrees
from flexhinf.design.guarantee import guarantee
from flexhinf.design.linearised import Linearised, linearise
from flexhinf.design.met import Met, corners_met, linear_met, step_met, within_tolerances
from flexhinf.design.presets.choose import preset_of
from flexhinf.design.response import Response
from flexhinf.design.result import Design
from flexhinf.design.runs import Runs, draws_of, run_all
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis import Synthesis, synthesise
from flexhinf.design.tolerances import Tolerances, tolerance_corners
from flexhinf.robot import Robot

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
    synthesis = synthesise(robot, s, tell)
    bench = Bench(robot, s, synthesis.problem.plant, synthesis.law, synthesis.goal, synthesis.start)
    tell("margins of the loop with its estimator")
    linear = linearise(bench, synthesis)
    tell("corners of the tolerances")
    tolerances = tolerance_corners(bench, synthesis.solution)
    tell("the worst disturbance, and what the parts of the controller spend")
    promised = guarantee(bench, synthesis, linear)
    runs = run_all(bench, synthesis, linear, tell)
    return Design(
        robot=robot,
        specification=s,
        bench=bench,
        tolerances=tolerances,
        guarantee=promised,
        inside=_inside(bench, synthesis),
        met=_met(bench, synthesis, linear, runs, tolerances),
        **vars(synthesis),
        **vars(linear),
        **vars(runs),
    )


def _inside(bench: Bench, synthesis: Synthesis) -> bool | None:
    """Whether the start, with the integrals that the controller chooses, lies in the sampled region."""
    if not synthesis.chosen.looked or np.isnan(synthesis.chosen.level):
        return None
    law = synthesis.solution
    return bool(law.value(bench.departure(law)) <= synthesis.chosen.level)


def _met(
    bench: Bench, synthesis: Synthesis, linear: Linearised, runs: Runs, tolerances: Tolerances | None
) -> tuple[Met, ...]:
    """The specification line by line."""
    s, unit = bench.specification, bench.model.unit(bench.model.inputs[0])
    oscillations = (mode for mode in linear.closed_modes if mode.eigenvalue.imag > 0.0)
    damping = min((mode.damping for mode in oscillations), default=np.inf)
    lines = linear_met(s, synthesis.game.wanted, linear.bandwidth, damping)
    lines += step_met(s, runs.response, unit, "the step, nominal robot", _unlimited(bench, runs))
    if runs.mujoco is not None:
        lines += step_met(s, runs.mujoco, unit, "the step on MuJoCo's plant")
    if tolerances is not None:
        lines.append(corners_met(len(tolerances.population), tolerances.unstable))
    if runs.draws is not None:
        lines += within_tolerances(s, runs.draws, unit)
    return tuple(lines)


def _unlimited(bench: Bench, runs: Runs) -> Response:
    """The step without the limits of the inputs: what it asks for, where a peak is judged that limits would hide."""
    s = bench.specification
    if s.peak_effort is None or s.saturation is None:
        return runs.response
    return replace(bench, specification=replace(s, saturation=None)).step(runs.duration)


def stages(robot: Robot, specification: Specification) -> int:
    """How many steps of work there are, for a progress bar."""
    s, states = specification, 5 * len(robot.joint_names)
    solved = len(tried_degrees(states, s)) * (2 if rays_of(states, s) else 1)
    searched = preset_of(robot, s) in ("damped", "robust")
    more = [s.peak_effort is not None and searched, s.mujoco, draws_of(robot, states, s) > 0, s.compare_rigid]
    return 7 + solved + len(s.via) + sum(more)
