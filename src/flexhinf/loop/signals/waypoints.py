"""A motion through waypoints at stated times: passed through smoothly, or stopped at.

A smooth motion through samples, from rest to rest, with four continuous derivatives, [deboor2001].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.signals.jerk_limited import JerkLimited
from flexhinf.loop.signals.references import Quintic, checked_order, checked_samples
from flexhinf.validation import HUGE, value_text

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


#: How the way between two waypoints is covered.
PROFILES = ("spline", "through", "quintic", "jerk-limited")

#: A jerk-limited way of length 1 that takes UNIT_TIME / rate seconds with these limits times rate, rate² and rate³.
VELOCITY, ACCELERATION, JERK = 0.4, 0.4, 0.8
UNIT_TIME = 1.0 / VELOCITY + VELOCITY / ACCELERATION + ACCELERATION / JERK

#: Largest slope at a waypoint over the smaller of the mean slopes beside it: up to there the way between two waypoints
#: has no reversal.
STEEPEST = 1.25

#: Most waypoints that a motion stops at: each has a profile of its own.
MOST_STOPS = 1000


@dataclass(frozen=True, eq=False)
class Waypoints:
    """From rest at the first waypoint to rest at the last one, through all others, each at its time.

    Parameters
    ----------
    times : (N,) array
        Increasing, s.
    values : (N,) array, or (N, k) with one column per channel
    profile : {"spline", "through", "quintic", "jerk-limited"}
        spline and through pass through the waypoints with four continuous derivatives. spline is that of `Spline`, best
        for many samples of a smooth motion; between few waypoints it may go far beyond them. through never leaves the
        range between two neighbouring waypoints: a polynomial of degree nine from each to the next, with slopes by the
        harmonic mean [fritsch1984], and without acceleration at the waypoints.
        The other two stop at every waypoint and go straight to the next one, all channels together: by `Quintic`, or by
        `JerkLimited`.
    smoothing : float
        Length of the moving average of jerk-limited motions, s; every way between two waypoints must take longer.

    Raises
    ------
    InvalidInput
        If the samples do not describe a function of time, there is no such profile, there are more than 1000 stops, or
        a way is shorter than the smoothing.
    """

    times: Any
    values: Any
    profile: str = "spline"
    smoothing: float = 0.0

    def __post_init__(self) -> None:
        times, values = checked_samples(self.times, self.values, smooth=True)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)
        if self.profile not in PROFILES:
            raise InvalidInput(
                "There is no such profile of a motion.",
                f"expected one of {list(PROFILES)}, got {value_text(self.profile)}",
                "profile='jerk-limited'",
            )
        if self.profile in ("spline", "through"):
            return
        if len(self.times) > MOST_STOPS:
            raise InvalidInput(
                "A motion stops at too many waypoints.",
                f"expected at most {MOST_STOPS}, got {len(self.times)}",
                "profile='spline', which passes through them",
            )
        shortest = float(np.diff(self.times).min(initial=np.inf))
        if self.profile == "jerk-limited" and not 0.0 <= self.smoothing < shortest:
            raise InvalidInput(
                "The smoothing of a motion does not fit its waypoints.",
                f"expected 0 s to less than the shortest way of {shortest:.4g} s, got {value_text(self.smoothing)} s",
                "waypoints further apart in time, or profile='spline'",
            )

    @property
    def name(self) -> str:
        """A short description."""
        how = {"spline": "spline through", "through": "smoothly through"}.get(
            self.profile, f"{self.profile} from stop to stop of"
        )
        return f"{how} {len(self.times)} waypoints in {self.duration:.4g} s"

    @property
    def duration(self) -> float:
        """From the first waypoint to the last, s."""
        return float(self.times[-1] - self.times[0])

    def __call__(self, t: Any) -> Any:
        """The position."""
        return self.derivatives(t, 0)[0]

    def derivatives(self, t: Any, order: int = 4) -> Any:
        """The value and its time derivatives, (order + 1, …), from the right where they jump.

        Raises
        ------
        InvalidInput
            For an order above the profile's highest finite derivative: 4 of a spline and of smoothed jerk-limited
            motions, 3 without smoothing. The jerk of a quintic jumps at every stop, as `Quintic` says.
        """
        t = np.asarray(t, dtype=float)
        if self.profile == "spline":
            return self._spline.derivatives(t, order)
        if self.profile == "through":
            order = checked_order(
                order, "motion through waypoints", 4, "the fifth jumps", "an order of at most 4"
            )
            inside = np.clip(t, self.times[0], self.times[-1])
            moving = (t > self.times[0]) & (t < self.times[-1])
            held = moving.reshape((*t.shape, *(1,) * (self.values.ndim - 1)))
            rows = [self._smooth(inside, nu=k) for k in range(order + 1)]
            return np.stack([rows[0], *(np.where(held, row, 0.0) for row in rows[1:])])
        order = checked_order(order, "motion through waypoints")
        found = np.zeros((order + 1, *t.shape, *self.values.shape[1:]))
        found[0] += self.values[0]
        for way, covered in zip(np.diff(self.values, axis=0), self._covered):
            found += np.multiply.outer(covered.derivatives(t, order), way)
        return found

    @cached_property
    def _spline(self) -> Spline:
        return Spline(self.times, self.values)

    @cached_property
    def _smooth(self) -> Any:
        """SciPy's piecewise polynomial with the slopes of `_slopes`; its next three derivatives are zero there."""
        from scipy.interpolate import BPoly

        nothing = np.zeros((3, *self.values.shape[1:]))
        if len(self.times) == 1:
            return BPoly(self.values[None, :], [self.times[0], self.times[0] + 1.0])
        both = zip(self.values, self._slopes)
        return BPoly.from_derivatives(self.times, [[value, slope, *nothing] for value, slope in both])

    @property
    def _slopes(self) -> np.ndarray:
        """At the waypoints: zero at both ends and at reversals, else the harmonic mean of the neighbouring ones."""
        steps = np.diff(self.times).reshape((-1, *(1,) * (self.values.ndim - 1)))
        mean, slopes = np.diff(self.values, axis=0) / steps, np.zeros(self.values.shape)
        before, after = mean[:-1], mean[1:]
        same = before * after > 0.0
        product, total = np.where(same, before * after, 0.0), np.where(same, before + after, 1.0)
        most = STEEPEST * np.minimum(np.abs(before), np.abs(after))
        slopes[1:-1] = np.clip(2.0 * product / total, -most, most)
        return slopes

    @cached_property
    def _covered(self) -> tuple[Quintic | JerkLimited, ...]:
        """For each way between two waypoints, the part of it that is covered: from 0 to 1."""
        pairs = zip(self.times[:-1].tolist(), np.diff(self.times).tolist())
        if self.profile == "quintic":
            return tuple(Quintic(0.0, 1.0, length, at=begin) for begin, length in pairs)
        return tuple(self._jerk_limited(begin, length) for begin, length in pairs)

    def _jerk_limited(self, begin: float, length: float) -> JerkLimited:
        rate = UNIT_TIME / (length - self.smoothing)
        limits = VELOCITY * rate, ACCELERATION * rate**2, JERK * rate**3
        return JerkLimited(0.0, 1.0, *limits, at=begin, smoothing=self.smoothing)
