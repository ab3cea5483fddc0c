"""What the loop of a design does when the robot carries a mass that its model need not know."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.analysis import EquilibriumLoop, margins
from flexhinf.design import Design
from flexhinf.design.responses import worst_of
from flexhinf.robot import weigh_payload

__all__ = ["carried"]

#: The motors are weighed by their mean over this last part of the step's run.
TAIL = 0.2


def carried(design: Design, mass: float) -> dict[str, Any]:
    """Step, deflection, margins and weighing with a true payload of this mass (kg).

    The step begins in equilibrium with the payload. The deflection is that when the robot, at rest at the goal, grips
    it: the weight beyond what the model carries acts on all links at once, as a constant torque.
    """
    setup, runs = design.setup, design.scenario
    robot, name = setup.robot, next(p.name for p in setup.robot.parameters if p.name.startswith("payload"))
    true = robot.plant_parameters({**robot.nominal, name: mass})
    step = setup.step(runs.step_duration, values=true, sub_steps=runs.sub_steps)
    last = step.inputs[-round(TAIL * len(step.inputs)) :].mean(axis=0)
    weighed = weigh_payload(robot, setup.goal, last)
    weight = robot.operating_point(setup.goal, (), true)[1] - setup.goal_equilibrium[1]
    gripped = setup.load_response(-weight, runs.load_duration, runs.sub_steps)
    linear = margins(_linear(design, true))
    limits = setup.limits.effort
    inputs = np.maximum(np.abs(step.inputs).max(axis=0), np.abs(gripped.response.inputs).max(axis=0))
    return {
        "mass": mass,
        "overshoot": step.overshoot.value,
        "settling": step.settling.value,
        "peak_share": float((np.abs(step.inputs) / limits).max()),
        "gripping_share": float((inputs / limits).max()),
        "sag": worst_of(gripped.metrics, "peak_deviation").value,
        "sag_joint": worst_of(gripped.metrics, "peak_deviation").joint,
        "recovery": worst_of(gripped.metrics, "recovery_time_s").value,
        "remaining": worst_of(gripped.metrics, "remaining_error").value,
        "damping": linear.damping,
        "peak_sensitivity": linear.peak_sensitivity,
        "gain_margin": linear.gain_margin,
        "weighed": weighed.masses[name],
        "hidden": weighed.hidden[name],
    }


def _linear(design: Design, true: dict[str, Any]) -> EquilibriumLoop:
    """The running loop about the goal, round the true robot."""
    setup, own = design.setup, design.evaluation.loop
    plant = setup.smooth_plant.with_parameters(**setup.smooth_plant.parameters.known(true))
    return EquilibriumLoop(
        own.law, setup.estimator(setup.goal), plant, own.period, equilibrium=setup.goal_equilibrium,
        moving=own.moving, delay=own.delay - own.step.latency, latency=own.step.latency, positions=own.positions,
    )  # fmt: skip
