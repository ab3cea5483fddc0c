"""What a robot carries: its step with a payload, and the moment in which it grips it.

A law and its estimator know the payload's nominal mass. Here the true robot has the masses at the ends of their ranges:
it makes the step in equilibrium with them, and, at rest at the goal, grips what is heavier than the model carries,
whose weight then acts on all links at once (as constant torques; the inertia is in the step). No estimator has a
payload among its states: the integrals of the position errors carry what is untold.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexhinf.analysis import Margins, margins
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.responses import LoadResponse, Response, Worst, worst_of
from flexhinf.errors import InvalidInput
from flexhinf.loop.simulation.metrics import tail_of
from flexhinf.plant import Parameters
from flexhinf.robot import Robot, Weighing, weigh_payload
from flexhinf.robot.payload import payload_ends


@dataclass(frozen=True, eq=False)
class PayloadEvaluation:
    """One evaluation with other masses in the true robot than in the model.

    Attributes
    ----------
    robot : Robot
        The model's.
    masses : mapping of str to float
        Of each payload, kg, by the robot's parameters.
    step : Response
        From start to goal, with the payload.
    load_step : LoadResponse or None
        The weight beyond the model's as constant torques; None where the model carries as much or more.
    margins : Margins
        Of the running loop about the goal, with the payload.
    """

    robot: Robot
    masses: Mapping[str, float]
    step: Response
    load_step: LoadResponse | None
    margins: Margins

    @property
    def mass(self) -> float:
        """Of all payloads, kg."""
        return float(sum(self.masses.values()))

    @property
    def deflection(self) -> Worst:
        """Largest deviation of a link after gripping, rad or m; zero where nothing is gripped."""
        return self._load_metric("peak_deviation")

    @property
    def recovery(self) -> Worst:
        """Until all links are back within 2 % of their step, s; infinite where one is not within the run."""
        return self._load_metric("recovery_time_s")

    @property
    def remaining(self) -> Worst:
        """Largest deviation in the last tenth of the run, rad or m."""
        return self._load_metric("remaining_error")

    def _load_metric(self, key: str) -> Worst:
        return Worst(0.0, "") if self.load_step is None else worst_of(self.load_step.metrics, key)

    @cached_property
    def weighed(self) -> Weighing | None:
        """What the motors say of the masses at the end of the step; None where the pose does not show them."""
        if self.step.diverged_at is not None:
            return None
        try:
            return weigh_payload(self.robot, self.step.goal, tail_of(self.step.inputs).mean(axis=0))
        except InvalidInput:
            return None


def evaluate_payloads(evaluation: LawEvaluation) -> tuple[PayloadEvaluation, ...]:
    """With all payloads at the upper ends of their ranges, and at the lower ones where the model carries more.

    Empty for a robot whose payloads have no range.
    """
    robot = evaluation.setup.robot
    return tuple(evaluate_payload(evaluation, masses) for masses in payload_ends(robot.uncertain))


def evaluate_payload(evaluation: LawEvaluation, masses: Mapping[str, float]) -> PayloadEvaluation:
    """The runs of an evaluation with these masses (kg, by the robot's parameters) in the true robot."""
    setup, runs = evaluation.setup, evaluation.scenario
    assert runs is not None, "an evaluation without a scenario has no runs"
    robot = setup.robot
    true = robot.plant_parameters({**robot.nominal, **masses})
    step = setup.step(runs.step_duration, values=true, sub_steps=runs.sub_steps)
    gripped = None
    if any(mass > robot.nominal[name] for name, mass in masses.items()):
        held = [
            robot.links.gravity_torque(setup.goal, Parameters(p)) for p in (robot.plant_parameters(), true)
        ]
        weight = np.asarray(held[1], dtype=float) - np.asarray(held[0], dtype=float)
        gripped = setup.load_response(-weight, runs.load_duration, runs.sub_steps)
    return PayloadEvaluation(
        robot,
        masses,
        step,
        gripped,
        margins(setup.equilibrium_loop(evaluation.loop.filter is not None, true)),
    )
