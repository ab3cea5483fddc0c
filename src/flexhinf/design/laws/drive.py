"""The drive alone: the loop that a drive of positions or velocities has anyway, with the planned motion as its command.

The command of a position is that of the plan, nothing is fed back. That of a velocity is θ̇_d − ω (θ − θ_d), with the
gain of the motor's position that every program for such drives has. Neither needs a sensor of the link. Where a drive
rejects its load its motor tells nothing of the link, so the estimator beside it has the design's sensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from flexhinf.design.laws.kinds import ESTIMATOR, IN_USE, LawKind, LawOver, register
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Matrix, Vector
    from flexhinf.design.laws.pose_model import PoseModel
    from flexhinf.plant import GeneralisedPlant, Law
else:
    np = late_package("numpy")


def _motor_gain(problem: GeneralisedPlant, bandwidth: float) -> Law:
    from flexhinf.baselines import LinearQuadratic
    from flexhinf.baselines.equilibrium_law import equilibrium_of
    from flexhinf.plant.joints import joint_places

    plant = problem.plant
    gain = np.zeros((len(plant.inputs), plant.n))
    gain[:, joint_places(plant)[2]] = -bandwidth * np.eye(len(gain))
    return LinearQuadratic(plant=plant, equilibrium=equilibrium_of(problem), gain=gain)


def _position(problem: GeneralisedPlant) -> Law:
    return _motor_gain(problem, 0.0)


def _at_pose(model: PoseModel, numbers: Mapping[str, Vector]) -> Matrix:
    from flexhinf.plant.joints import joint_places

    n = len(model.pose)
    gain = np.zeros((n, model.plant.n + n))
    gain[:, joint_places(model.plant)[2]] = -np.diag(np.broadcast_to(numbers["bandwidth"], n))
    return gain


def _no_gain(model: PoseModel, numbers: Mapping[str, Vector]) -> Matrix:
    n = len(model.pose)
    return np.zeros((n, model.plant.n + n))


register(
    LawKind(
        "position-drive",
        "the drive of positions alone, with the plan as its command",
        IN_USE,
        "the usual interface of industrial arms",
        "the feedforward's",
        _position,
        ESTIMATOR,
        place=7,
        over=LawOver(_no_gain, (), usual=True, of_states=True),
        drives=("position",),
    )
)
register(
    LawKind(
        "velocity-drive",
        "the drive of velocities with a gain of the motor's position",
        IN_USE,
        "the usual interface of servo drives",
        "the feedforward's",
        _motor_gain,
        ("bandwidth", *ESTIMATOR),
        place=7,
        over=LawOver(_at_pose, ("bandwidth",), usual=True, of_states=True),
        drives=("velocity",),
    )
)
