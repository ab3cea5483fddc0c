"""What the linearisation at the goal says of a design: modes, bandwidth, margins of the loop with its estimator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.analysis import Margins, margins
from flexhinf.design.bench import Bench
from flexhinf.design.estimator import estimator_modes
from flexhinf.design.modes import Mode, closed_loop, modes_of, stiffness_and_inertia
from flexhinf.design.presets.behaviour import behaviour_of
from flexhinf.design.presets.linear_family import LinearFamily
from flexhinf.design.response import run_length
from flexhinf.design.resting import resting_loop
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis import Synthesis

__all__ = ["Linearised", "linearise"]


@dataclass(frozen=True, eq=False)
class Linearised:
    """Figures of the linearised loops at the goal.

    Attributes
    ----------
    open_modes, closed_modes : tuple of Mode
        Without control, and with the law (true state).
    estimator_modes : tuple of Mode
        Of the estimation error, with the filter's stationary gain; none without an estimator, or without noise.
    bandwidth : (n,)
        Of each joint of the nominal robot, rad/s.
    margins, state_margins : Margins
        Of the sampled loop, with the estimator, and with the true state fed back.
    """

    open_modes: tuple[Mode, ...]
    closed_modes: tuple[Mode, ...]
    estimator_modes: tuple[Mode, ...]
    bandwidth: np.ndarray
    margins: Margins
    state_margins: Margins

    def step_length(self, s: Specification) -> float:
        """Length of the step's run, s: as asked, or by the slowest mode."""
        if s.duration is not None:
            return s.duration
        return run_length(min(-mode.eigenvalue.real for mode in self.closed_modes))


def linearise(bench: Bench, synthesis: Synthesis) -> Linearised:
    """All of them."""
    robot, goal, plant, law = bench.robot, bench.goal, bench.model, synthesis.solution
    rest = robot.operating_point(goal)
    energy, joints = stiffness_and_inertia(plant, rest), robot.joint_names
    estimator = bench.estimator(bench.start)
    error_modes: tuple[Mode, ...] = ()
    if estimator is not None and max(bench.specification.noises) > 0.0:
        error_modes = estimator_modes(estimator, rest, joints, *energy)
    return Linearised(
        modes_of(plant.linearise(*rest)[0], joints, *energy),
        modes_of(closed_loop(synthesis.problem, law.gain), joints, *energy),
        error_modes,
        behaviour_of(LinearFamily.of(robot, goal, members=0), law.gain).bandwidth,
        margins(resting_loop(bench, law)),
        margins(resting_loop(bench, law, estimated=False)),
    )
