"""What the rigid design does to the elastic robot, fed back from either side of the springs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.modes import Mode, modes_of
from flexhinf.design.response import Response, step_response
from flexhinf.design.rigid import SIDES, RigidLaw, rigid_problem, rigid_solution
from flexhinf.design.specification import Specification
from flexhinf.loop import Controller, Loop
from flexhinf.plant import GeneralisedPlant, Plant

__all__ = ["RigidComparison", "RigidLoop", "compare_rigid"]


@dataclass(frozen=True, eq=False)
class RigidLoop:
    """The rigid law on the elastic robot.

    Attributes
    ----------
    side : {"link", "motor"}
        Whose true position and velocity it is fed.
    modes : tuple of Mode
    response : Response
    """

    side: str
    modes: tuple[Mode, ...]
    response: Response

    @property
    def stable(self) -> bool:
        """Whether every mode decays."""
        return all(mode.stable for mode in self.modes)


@dataclass(frozen=True, eq=False)
class RigidComparison:
    """The rigid design.

    Attributes
    ----------
    gamma : float
    degree : int
    loops : tuple of RigidLoop
    """

    gamma: float
    degree: int
    loops: tuple[RigidLoop, ...]


def compare_rigid(
    problem: GeneralisedPlant,
    true_plant: Plant,
    degree: int,
    specification: Specification,
    energy: tuple[np.ndarray, np.ndarray],
    start: tuple[np.ndarray, np.ndarray],
    goal: np.ndarray,
    duration: float,
) -> RigidComparison | None:
    """Design the same specification on the rigid model, and close the loop round the elastic robot.

    The rigid law is fed the true state of one side, without estimator or noise: more than it would have. None if
    the penalty is code, which says nothing about a rigid robot.
    """
    rigid = rigid_problem(problem)
    if rigid is None:
        return None
    solution = rigid_solution(rigid, specification.gamma_ratio, degree)
    joints = [
        name.removeprefix("link_position").lstrip("_") or "joint"
        for name in problem.plant.states[: len(goal)]
    ]
    loops: list[Any] = []
    for side in SIDES:
        law = RigidLaw(solution, problem, side)
        controller = Controller(law, None, specification.period, specification.saturation, start="bumpless")
        loop = Loop(true_plant, controller)
        response = step_response(loop, start, goal, None, duration, specification.seed)
        loops.append(RigidLoop(side, modes_of(law.closed_loop(), joints, *energy), response))
    return RigidComparison(solution.gamma, degree, tuple(loops))
