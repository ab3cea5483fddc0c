"""The page with the moving arm: how fast the PD beside the design is sent."""

from __future__ import annotations

from typing import Any

import numpy as np

import flexhinf as fh
from flexhinf.designs import Specification
from flexhinf.designs.live_page import TIMES, quickest_move
from flexhinf.designs.loop_setup import LoopPlants
from flexhinf.loop import Waypoints


def test_the_pd_moves_as_fast_as_the_limits_allow_whatever_the_design_needs() -> None:
    """As compared laws do: a timid design makes no timid rival. The controller is not even run."""
    robot, start, goal = fh.load_robot("paper"), np.zeros(1), np.array([0.5])
    not_run: Any = None
    found = {}
    for volts in (40.0, 80.0, 400.0):
        plants = LoopPlants(robot, Specification(saturation=volts))
        found[volts] = quickest_move(not_run, plants, start, goal)
        motion = Waypoints([0.0, found[volts]], [start, goal], "quintic")
        inputs = robot.inverse_dynamics(*motion.derivatives(np.linspace(0.0, found[volts], 50), 4))[1]
        assert np.abs(inputs).max() <= volts
    assert TIMES[0] <= found[400.0] < found[80.0] < found[40.0] < TIMES[-1]
