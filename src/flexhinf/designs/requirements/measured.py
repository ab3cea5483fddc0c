"""Runs to rest, with linear loops at rest, as requirements measure them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.analysis import LinearLoop, Margins
    from flexhinf.arrays import Matrix, Vector
else:
    np = late_package("numpy")

#: A travel that is rounding, rad or m.
STILL = 1e-9


@dataclass(frozen=True, eq=False)
class Motion:
    """One run to rest, of a step or of a move along a plan, as requirements measure it.

    All joints are columns, in rad or m. `positions` and `velocities` are the true ones of the links.
    """

    time: Vector  # (N,), s
    positions: Matrix  # (N, n)
    velocities: Matrix  # (N, n), rad/s or m/s
    inputs: Matrix  # (N, n), V, A, N·m or N
    planned: Matrix  # (N, n): where the plan is at the same time; the goal of a step
    path: Matrix  # (P, n): the way of the plan
    duration: float  # When the command ends, s; 0 of a step
    step: bool  # Whether it is a step, whose way may be shaped
    plans: bool  # Whether there is a plan that is followed in time
    rests: bool  # Whether the run is long enough for what is measured at rest
    effort: Vector  # (n,). Limits of the inputs; infinite where there is none
    span: Vector  # (n,). Lengths of the joints' ranges
    lower: Vector  # (n,). Ends of the ranges
    upper: Vector  # (n,)
    kept: Vector  # (n,). Limits of the inputs that the controller keeps; infinite where there is none
    rate: Vector  # (n,). Largest changes of the inputs that the drives take, per s
    period: float  # Time between two inputs, s
    slides: np.ndarray  # (n,), bool: which joints slide

    @cached_property
    def travel(self) -> Vector:
        """Distance (n,) of the extreme positions on the way."""
        return np.ptp(self.path, axis=0)

    @property
    def moves(self) -> np.ndarray:
        """Which joints travel (n,)."""
        return self.travel > STILL

    @cached_property
    def largest(self) -> Vector:
        """Largest travel (n,) of all joints, in the unit of each."""
        from flexhinf.loop.simulation import metrics

        return metrics.largest_travel(self.travel, self.slides, self.span)


@dataclass(frozen=True, eq=False)
class RestingLoop:
    """One linear loop at rest, as requirements measure it."""

    margins: Margins  # Each is computed when it is first read
    damped_below: float  # Frequency below which oscillations have to be damped, rad/s

    @property
    def linear(self) -> LinearLoop:
        """The loop itself."""
        return self.margins.linear
