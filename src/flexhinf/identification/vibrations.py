"""Periods of a robot's vibrations at its home, beside which the times of a log are judged."""

from __future__ import annotations

import numpy as np

from flexhinf.robot import Robot


def vibration_periods(robot: Robot) -> np.ndarray:
    """Periods of the vibrations at the home, s, the shortest first; 0.1 s where there are none."""
    x, _ = robot.operating_point()
    modes = np.linalg.eigvals(robot.plant().linearise(x)[0])
    fast = np.abs(modes.imag)[np.abs(modes.imag) > 1.0]
    return np.sort(2.0 * np.pi / fast) if fast.size else np.array([0.1])
