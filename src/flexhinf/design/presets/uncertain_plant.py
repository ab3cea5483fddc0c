"""The plant of a robust synthesis: the robot with more disturbances, one per independent torque of its tolerances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.plant import Plant

__all__ = ["PREFIX", "UncertainFlow", "with_channels"]

#: Names of the disturbances that stand for tolerances, numbered from 1.
PREFIX = "tolerance"


@dataclass(frozen=True)
class UncertainFlow:
    """ẋ with torques L w at links and motors, beside the robot's own disturbances; L is a parameter.

    Parameters
    ----------
    flow : callable
        The robot's.
    torques : int
        Number of the robot's own disturbances: torques at links and motors.
    """

    flow: Any
    torques: int

    def __call__(self, x: Any, u: Any, d: Any, p: Any) -> Any:
        """The rates of all states, of any element."""
        own, tolerances = d[: self.torques], d[self.torques :]
        return self.flow(x, u, own + np.asarray(p.tolerance_channels) @ tolerances, p)


def with_channels(plant: Plant, enter: np.ndarray) -> Plant:
    """The robot's plant with disturbances w that enter as torques L w.

    Parameters
    ----------
    plant : Plant
    enter : (2 joints, k)
        L.
    """
    names = tuple(f"{PREFIX}_{k + 1}" for k in range(enter.shape[1]))
    return Plant(
        UncertainFlow(plant.flow, len(plant.disturbances)),
        plant.output,
        states=plant.states,
        inputs=plant.inputs,
        disturbances=(*plant.disturbances, *names),
        parameters={**plant.parameters.values, "tolerance_channels": enter},
        outputs=plant.outputs,
        units=plant.units,
        groups=plant.groups,
        limits=plant.limits,
    )
