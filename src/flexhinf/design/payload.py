"""Payload evaluation: the step with a payload, and the load step when the robot grips it.

A law and its estimator know the payload's nominal mass. Here the true robot has the masses at the ends of their ranges:
it makes the step in equilibrium with them, and, at rest at the goal, grips what is heavier than the model carries,
whose weight then acts on all links at once (as constant torques; the inertia is in the step). No estimator has a
payload among its states: integral action compensates the unmodelled weight.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexhinf.analysis import Margins, margins
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.joint_limits import JointLimits
from flexhinf.design.requirements import (
    REQUIREMENTS,
    Requirement,
    limit_requirements,
    of_several,
    step_requirements,
)
from flexhinf.design.responses import LoadResponse, Response, Worst, worst_of
from flexhinf.design.specification import RINGS, Specification
from flexhinf.errors import InvalidInput
from flexhinf.loop.simulation.metrics import SETTLING_BAND, tail_of
from flexhinf.plant import Parameters
from flexhinf.robot import Robot, Weighing, weigh_payload
from flexhinf.robot.arm import payload_ends


@dataclass(frozen=True, eq=False)
class PayloadEvaluation:
    """One evaluation with other masses in the true robot than in the model."""

    robot: Robot  # The model's
    masses: Mapping[str, float]  # Of each payload, kg, by the robot's parameters
    step: Response  # From start to goal, with the payload
    # The weight beyond the model's as constant torques; None where the model carries as much or more
    load_step: LoadResponse | None
    margins: Margins  # Of the running loop about the goal, with the payload

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
        """Masses by the motors' torques at the end of the step; None where the pose does not show them."""
        if self.step.diverged_at is not None:
            return None
        try:
            return weigh_payload(self.robot, self.step.goal, tail_of(self.step.inputs).mean(axis=0))
        except InvalidInput:
            return None


def evaluate_payloads(evaluation: LawEvaluation) -> tuple[PayloadEvaluation, ...]:
    """With all payloads at the ends of their ranges, the lower one where the model carries more; empty without any."""
    ends = payload_ends(evaluation.setup.robot.uncertain)
    return tuple(evaluate_payload(evaluation, masses) for masses in ends)


def evaluate_payload(evaluation: LawEvaluation, masses: Mapping[str, float]) -> PayloadEvaluation:
    """The runs of an evaluation with these masses (kg, by the robot's parameters) in the true robot."""
    setup, runs = evaluation.setup, evaluation.scenario
    assert runs is not None, "an evaluation without a scenario has no runs"
    robot = setup.robot
    true = robot.plant_parameters({**robot.nominal, **masses})
    step = setup.step(runs.step_duration, values=true, sub_steps=runs.sub_steps)
    gripped = None
    if any(mass > robot.nominal[name] for name, mass in masses.items()):
        nominal, held = (
            np.asarray(robot.links.gravity_torque(setup.goal, Parameters(p)), dtype=float)
            for p in (robot.plant_parameters(), true)
        )
        weight = held - nominal
        gripped = setup.load_response(-weight, runs.load_duration, runs.sub_steps)
    loop = setup.equilibrium_loop(evaluation.loop.filter is not None, true)
    return PayloadEvaluation(robot, masses, step, gripped, margins(loop))


def payload_requirements(
    s: Specification, limits: JointLimits, load: PayloadEvaluation, damping: float | None
) -> list[Requirement]:
    """With a payload that the model does not know: the step, gripping it at the goal, and whether the loop rings.

    `damping`: required with the model's payload; with others the loop must not ring.
    """
    name = f"with {load.mass:.3g} kg of payload"
    lines = step_requirements(s, limits, load.step, f"the step {name}")
    if damping is not None:
        lines.append(
            REQUIREMENTS["damping"].judge(
                None, min(RINGS, damping), load.margins.damping, f"running loop at the goal {name}",
                criterion="smallest damping ratio; below 0.1 a loop rings",
            )
        )  # fmt: skip
    if load.load_step is None:
        return lines
    where, remaining = f"gripping {load.mass:.3g} kg at the goal", load.remaining
    joint = limits.joints.index(remaining.joint) if remaining.joint else 0
    lines.append(
        REQUIREMENTS["load_step"].judge(
            None, SETTLING_BAND * float(load.load_step.reference_step[joint]), remaining.value, where,
            unit=limits.position_units[joint], joint=of_several(limits.joints, remaining.joint),
        )
    )  # fmt: skip
    return lines + limit_requirements(limits, load.load_step.response, where, always=False)
