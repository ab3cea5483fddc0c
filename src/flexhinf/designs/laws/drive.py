"""The drive alone: the loop that a drive of positions or velocities has anyway, with the planned motion as its command.

The command of a position is that of the plan, nothing is fed back. That of a velocity is θ̇_d − ω (θ − θ_d), with the
gain of the motor's position that every program for such drives has. Neither needs a sensor of the link. Where a drive
rejects its load its motor tells nothing of the link, so the estimator beside it has the design's sensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from flexhinf.designs.laws.kinds import LawKind, LawOver, register
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Matrix, Vector
    from flexhinf.designs.laws.pose_model import PoseModel
else:
    np = late_package("numpy")


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
        "the usual interface of industrial arms",
        LawOver(_no_gain, (), of_states=True),
        usual=True,
        place=7,
        commands="position",
    )
)
register(
    LawKind(
        "velocity-drive",
        "the drive of velocities with a gain of the motor's position",
        "the usual interface of servo drives",
        LawOver(_at_pose, ("bandwidth",), of_states=True),
        usual=True,
        place=7,
        commands="velocity",
    )
)
