"""Springs of a linearised plant, with the damping that no real spring is without."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flexhinf.plant import Plant
from flexhinf.robot.layout import Layout
from flexhinf.robot.signals import signal_names

#: Damping ratio of its own vibration that a spring is given where none is stated: no real one is undamped.
SPRING_DAMPING = 5e-3

#: The extra of a plant whose springs are damped, and the quantity that states by how much.
DAMPED, DAMPING = "joint_damping", "damping"


def without_damping(plant: Plant) -> Plant:
    """A robot's plant with springs that nothing damps."""
    stated = plant.parameters.values.get(DAMPING)
    return plant if stated is None else plant.with_parameters(**{DAMPING: np.zeros_like(stated)})


class Spring(NamedTuple):
    """One elastic joint in a linearised plant."""

    joint: str
    time: float  # τ = 2ζ/ω, s, with ζ of `SPRING_DAMPING`
    motor: int  # places of states
    motor_rate: int
    link_rate: int


def springs_of(a: np.ndarray, plant: Plant, joints: Sequence[str], layout: Layout) -> list[Spring]:
    """Springs of a plant linearised as `a` (n, n); ω is the vibration of link and motor on this spring alone."""
    found, kinds = list[Spring](), ("motor_position", "motor_velocity", "link_velocity")
    rates = [plant.index(name) for name in signal_names("link_velocity", joints)]
    for joint, *names in zip(joints, *(signal_names(kind, joints) for kind in kinds)):
        if names[0] in plant.states:  # else a rigid joint
            motor, motor_rate, link_rate = map(plant.index, names)
            pushed = float(
                layout.matrix[joints.index(joint)] @ a[rates, motor]
            )  # T M⁻¹ Tᵀ K, of its own torque
            time = 2.0 * SPRING_DAMPING / float(np.sqrt(pushed - a[motor_rate, motor]))
            found.append(Spring(joint, time, motor, motor_rate, link_rate))
    return found
