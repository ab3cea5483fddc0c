"""A smooth motion through samples, from rest to rest, with four continuous derivatives, [deboor2001]."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.signals.references import checked_order, checked_samples
from flexhinf.untrusted import HUGE

#: Degree: interpolation takes one number per sample, rest at both ends four more each.
DEGREE = 9


@dataclass(frozen=True, eq=False)
class Spline:
    """The spline of degree nine through samples, held at both ends, with four continuous derivatives everywhere.

    All four are zero at both ends. Between the samples it may go a little beyond them, as every smooth curve
    through them; `Samples` does not.

    Parameters
    ----------
    times : (N,) array
        Increasing, s.
    values : (N,) array, or (N, k) with one column per channel

    Raises
    ------
    InvalidInput
        If the samples do not describe a function of time.
    """

    times: Any
    values: Any

    def __post_init__(self) -> None:
        times, values = checked_samples(self.times, self.values, smooth=True)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)
        if np.abs(self.values).max() > HUGE:
            raise InvalidInput(
                "The values of a spline are out of all proportion.",
                f"expected a magnitude of at most {HUGE:g}, got {np.abs(self.values).max():g}",
                "values in SI units",
            )

    @property
    def name(self) -> str:
        """A short description."""
        return f"spline through {len(self.times)} samples over {self.duration:g} s"

    @property
    def duration(self) -> float:
        """From the first sample to the last, s."""
        return float(self.times[-1] - self.times[0])

    @cached_property
    def _curve(self) -> Any:
        """SciPy's spline over the time in units of the mean distance of the samples, which keeps it well scaled."""
        from scipy.interpolate import make_interp_spline

        rest = [(k, np.zeros(self.values.shape[1:])) for k in range(1, 5)]
        where = (self.times - self.times[0]) / self._unit
        return make_interp_spline(where, self.values, DEGREE, bc_type=(rest, rest))

    @property
    def _unit(self) -> float:
        return self.duration / max(1, len(self.times) - 1)

    def __call__(self, t: Any) -> Any:
        """The position."""
        return self._derivative(np.asarray(t, dtype=float), 0)

    def derivatives(self, t: Any, order: int = 4) -> Any:
        """The value and its time derivatives, (order + 1, …).

        Raises
        ------
        InvalidInput
            For an order above 4, which jumps at the ends.
        """
        order = checked_order(order, "spline", 4, "the fifth jumps at its ends", "an order of at most 4")
        return np.stack([self._derivative(np.asarray(t, dtype=float), k) for k in range(order + 1)])

    def _derivative(self, t: np.ndarray, order: int) -> np.ndarray:
        shape = (*t.shape, *self.values.shape[1:])
        if len(self.times) == 1:
            return np.broadcast_to(self.values[0], shape) if order == 0 else np.zeros(shape)
        inside = np.clip(t, self.times[0], self.times[-1])
        found = self._curve((inside - self.times[0]) / self._unit, nu=order) / self._unit**order
        if order == 0:
            return found
        moving = (t > self.times[0]) & (t < self.times[-1])
        return np.where(moving.reshape((*t.shape, *(1,) * (len(shape) - t.ndim))), found, 0.0)
