"""Numbers of a linear loop at rest at one pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

#: A ripple below which an estimator is preferred, per cent.
QUIET = 1.2


class CornerLoop(NamedTuple):
    """The loop at rest at one pose, of a robot at a corner of its tolerances; as in `PoseLoop`."""

    growth: float
    damping: float
    fast_damping: float


class PoseLoop(NamedTuple):
    """The loop at rest at one pose. Growth is the largest modulus of the poles in the z plane; below 1 is stable."""

    growth: float
    damping: float  # smallest damping ratio of slow oscillations, see `Specification.damped_below_limit`
    fast_damping: float  # smallest of faster ones
    late: float  # growth with the extra delay that is required
    later: float  # the same with twice that delay
    louder: float  # growth with all inputs times the gain margin that is required
    softer: float  # and divided by it
    ripple: float  # largest deviation of an input by the noise of the sensors, per cent of its limit

    def excess(self, damping: float, ripple: float, period: float) -> np.ndarray:
        """How far it misses, (4,), in order of importance: stability with the extra delay (1/s), damping and ripple
        (relative); the gain margins (1/s); twice the delay (1/s), and a ripple of `QUIET`, which are only preferred. At
        most 0 where it misses nothing."""
        late, gain, wished = np.log([self.late, max(self.louder, self.softer), self.later]) / period
        loud = np.log(np.clip(self.ripple, 1e-9, 1e5) / np.array([ripple, QUIET]))
        needed = max(np.log(self.growth) / period, late, 1.0 - self.damping / damping, loud[0])
        return np.array([needed, gain, wished, loud[1]])
