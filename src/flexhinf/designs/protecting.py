"""A designed controller with the protection of its robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.designs.noise_levels import sensor_steps
from flexhinf.designs.responses import joint_limits
from flexhinf.export import protected

if TYPE_CHECKING:
    from flexhinf.designs.specification import Specification
    from flexhinf.loop import Controller
    from flexhinf.robot import Robot


def deployed(
    controller: Controller, robot: Robot, s: Specification, options: Mapping[str, object]
) -> Controller:
    """A controller for a robot: with its protection, unless one is among the options, or nothing reads its signs."""
    if "protection" in options or controller.estimator is None or controller.supervision is None:
        return controller
    steps = np.broadcast_to(
        sensor_steps(robot, s.measured, s.quantisation, s.estimator), len(controller.measured)
    )
    return protected(controller, robot, joint_limits(robot, s).speed, steps if steps.any() else None)[0]
