"""Motions from rest to rest: time-optimal within limits, through samples, through waypoints at stated times."""

# SciPy's interpolation and ruckig have no types; a profile is checked, since callers may pass anything.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnnecessaryIsInstance=false
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Vector
from flexhinf.errors import refuse_if
from flexhinf.loop.signals.references import Quintic, Sampled, checked_order
from flexhinf.notebook import StatedRepr
from flexhinf.validation import HUGE, real_array, unknown_name, value_text

# Jerk-limited motion [berscheid2021] --------------------------------------------------------------------
LIMITS = ("velocity", "acceleration", "jerk")


class _Motion(StatedRepr):
    derivatives: Callable[..., Vector]

    def __call__(self, t: float | Vector) -> Vector:
        return self.derivatives(t, 0)[0]


@dataclass(frozen=True, eq=False)
class _RestToRest:
    """A motion from `start` to `goal` at rest, of phases of constant jerk (`lengths` in s, `jerks` in unit/s³, (K,)
    each), or its moving average.

    A scale corrects rounding, so that the motion ends at the goal. `average` is T of the moving average over the last T
    seconds, s; none for zero. Its jerk rises by (j(t) − j(t − T))/T, which is constant between the corners of both.
    """

    start: float
    goal: float
    lengths: np.ndarray
    jerks: np.ndarray
    average: float

    @cached_property
    def times(self) -> np.ndarray:  # corners of the piecewise constant highest derivative, s from the start
        corners = np.concatenate([[0.0], np.cumsum(self.lengths)])
        return np.unique(np.concatenate([corners, corners + self.average]))

    @cached_property
    def _curve(self) -> Any:  # the highest derivative, integrated from rest
        from scipy.interpolate import PPoly

        middle = (self.times[1:] + self.times[:-1]) / 2.0
        rate, order = self._jerk(middle), 3
        if self.average:
            rate, order = (rate - self._jerk(middle - self.average)) / self.average, 4
        curve = PPoly(rate[None, :], self.times).antiderivative(order)
        curve.c *= (self.goal - self.start) / float(curve(self.times[-1]))
        curve.c[-1] += self.start
        return curve

    def _jerk(self, t: np.ndarray) -> np.ndarray:
        phase = np.searchsorted(np.cumsum(self.lengths), t, side="right")
        return np.where(t < 0.0, 0.0, np.append(self.jerks, 0.0)[phase])

    def __call__(self, t: np.ndarray, order: int) -> np.ndarray:
        inside = (t >= self.times[0]) & (t < self.times[-1])  # from the right where a derivative jumps
        outside = np.where(t < self.times[0], self.start, self.goal) if order == 0 else np.zeros(np.shape(t))
        if self.goal == self.start:
            return outside
        return np.where(inside, self._curve(np.clip(t, *self.times[[0, -1]]), nu=order), outside)


@dataclass(frozen=True, repr=False)
class JerkLimited(_Motion):
    """From rest at `start` to rest at `goal`, from `at` on, as fast as the limits allow.

    Several channels arrive together. The motion is made by the ruckig library and kept as polynomials, so that values
    and derivatives are exact. Without smoothing the jerk jumps, and a feedforward of elastic joints would need pulses
    of its input; the moving average over `smoothing` seconds makes the snap finite, keeps all limits and takes so much
    longer.

    Parameters
    ----------
    start, goal : float or (k,)
        With arrays the values have one column per channel.
    velocity, acceleration, jerk : float or (k,)
        Largest absolute values, positive.
    at, smoothing : float
        s; length of the moving average, none for zero.

    Raises
    ------
    InvalidInput
        For limits that are not positive, or shapes that do not fit.

    Examples
    --------
    >>> import flexhinf as fh
    >>> move = fh.JerkLimited(0.0, 1.0, velocity=1.0, acceleration=4.0, jerk=40.0)
    >>> float(move(0.0)), round(float(move(2.0)), 9)
    (0.0, 1.0)
    """

    start: ArrayLike
    goal: ArrayLike
    velocity: ArrayLike
    acceleration: ArrayLike
    jerk: ArrayLike
    at: float = 0.0
    smoothing: float = 0.0

    def __post_init__(self) -> None:
        arrays = {
            name: real_array(getattr(self, name)) for name in ("start", "goal", *LIMITS, "at", "smoothing")
        }
        for name, array in arrays.items():
            most, lower = 0 if name in ("at", "smoothing") else 1, 0.0 if name == "smoothing" else -np.inf
            refuse_if(
                array.ndim > most or not np.all(np.isfinite(array) & (array >= lower)),
                "A jerk-limited motion needs finite numbers.",
                f"got {name}={value_text(getattr(self, name))}",
                "one number in seconds" if not most else "one number, or one per channel",
            )
        sizes = {a.size for a in arrays.values() if a.ndim}
        shapes = {name: a.shape for name, a in arrays.items()}
        refuse_if(
            len(sizes) > 1 or 0 in sizes,
            "The channels of a motion differ in number.",
            f"expected one number or k each, got {shapes}",
            "one start, goal and limit per channel; one number counts for all",
        )
        for name in LIMITS:
            refuse_if(
                not np.all(arrays[name] > 0.0),
                f"The limit of {name} must be positive.",
                f"expected > 0, got {getattr(self, name)!r}",
                "the largest absolute value that is allowed",
            )
        for name, array in arrays.items():  # tuples, so that equal motions are equal
            object.__setattr__(self, name, tuple(array.tolist()) if array.ndim else float(array))

    @property
    def name(self) -> str:
        """A short description."""
        smooth = f", smoothed over {self.smoothing:g} s" if self.smoothing else ""
        ends = (
            f"({', '.join(f'{v:.6g}' for v in end)})" if isinstance(end, tuple) else f"{end:.6g}"
            for end in (self.start, self.goal)
        )
        return f"jerk-limited from {' to '.join(ends)} in {self.duration:.4g} s{smooth}"

    @property
    def duration(self) -> float:
        """From `at` to the goal, s, smoothing included."""
        return max(float(channel.times[-1]) for channel in self._channels)

    @cached_property
    def _channels(self) -> tuple[_RestToRest, ...]:
        """Of each channel the seven phases by ruckig, whose tolerances are absolute: so it works in units of the
        longest distance and of the longest time that one limit alone requires; both are powers of two, so that nothing
        is rounded."""
        from ruckig import InputParameter, Result, Ruckig, RuckigError, Trajectory

        arrays = (np.atleast_1d(getattr(self, name)) for name in ("start", "goal", *LIMITS))
        start, goal, *limits = (array.tolist() for array in np.broadcast_arrays(*arrays))
        k, distances, bounds = len(start), [b - a for a, b in zip(start, goal)], np.array(limits)
        distance, request, trajectory = np.array(distances), InputParameter(k), Trajectory(k)
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):  # refused below
            length = _power(np.abs(distance).max())
            time = _power(np.max((np.abs(distance) / bounds) ** (1.0 / np.array([[1.0], [2.0], [3.0]]))))
            scaled, jerk = bounds * [[time], [time**2], [time**3]] / length, length / time**3
        request.target_position = (distance / length).tolist()  # from rest at zero
        request.max_velocity, request.max_acceleration, request.max_jerk = scaled.tolist()
        try:
            result = Ruckig(k).calculate(request, trajectory)
        except RuckigError:
            result = Result.Error
        refuse_if(
            result not in (Result.Working, Result.Finished) or not 0.0 < jerk < np.inf,
            "No motion was found within the limits.",
            f"got {result} for ways of {distances} with velocity, acceleration and jerk {limits}",
            "limits of a size that fits the way",
        )
        return tuple(
            _RestToRest(a, b, time * np.array(profile.t), jerk * np.array(profile.j), self.smoothing)
            for a, b, profile in zip(start, goal, trajectory.profiles[0])
        )

    def derivatives(self, t: float | Vector, order: int = 4) -> Vector:
        """The value and its time derivatives, (order + 1, …), from the right where they jump.

        An order above 3, or 4 with smoothing, is refused: the next derivative is not finite.
        """
        smooth = (4, "its snap jumps", "an order of at most 4")
        bound = smooth if self.smoothing else (3, "its jerk jumps", "JerkLimited(..., smoothing=0.05)")
        orders = range(checked_order(order, "jerk-limited motion", *bound) + 1)
        since = np.asarray(t, dtype=float) - self.at
        several = any(isinstance(getattr(self, name), tuple) for name in ("start", "goal", *LIMITS))
        columns = [np.stack([channel(since, k) for k in orders]) for channel in self._channels]
        return np.stack(columns, axis=-1) if several else columns[0]


def _power(value: np.float64) -> np.float64:
    return np.ldexp(1.0, np.frexp(value)[1] - 1) if 0.0 < value < np.inf else np.float64(1.0)


# Through samples [deboor2001] -----------------------------------------------------------------------------
#: Degree: interpolation takes one number per sample, rest at both ends four more each.
DEGREE = 9


class _SampledMotion(_Motion, Sampled):
    smooth: ClassVar[bool] = True

    @property
    def duration(self) -> float:
        """From the first sample to the last, s."""
        return float(self.times[-1] - self.times[0])

    def _resting(self, t: np.ndarray, rows: list[Any]) -> np.ndarray:
        moving = (t > self.times[0]) & (t < self.times[-1])  # else all derivatives are zero
        moving = moving.reshape((*t.shape, *(1,) * (self.values.ndim - 1)))
        return np.stack([rows[0], *(np.where(moving, row, 0.0) for row in rows[1:])])


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Spline(_SampledMotion):
    """The spline of degree nine through samples, held at both ends, with four continuous derivatives everywhere.

    All four are zero at both ends. Between the samples it may go a little beyond them, as every smooth curve through
    them; `Samples` does not. Times (N,) increase, s; values are (N,), or (N, k) with one column per channel; samples
    that do not describe a function of time are an InvalidInput.

    Examples
    --------
    >>> import flexhinf as fh
    >>> spline = fh.Spline([0.0, 1.0, 2.0], [0.0, 0.5, 1.0])
    >>> round(float(spline(1.0)), 9)
    0.5
    """

    def __init__(self, times: ArrayLike, values: ArrayLike) -> None:
        super().__init__(times, values)
        largest = np.abs(self.values).max()
        refuse_if(
            largest > HUGE,
            "The values of a spline are out of all proportion.",
            f"expected a magnitude of at most {HUGE:g}, got {largest:g}",
            "values in SI units",
        )

    @property
    def name(self) -> str:
        """A short description."""
        return f"spline through {len(self.times)} samples over {self.duration:g} s"

    @cached_property
    def _curve(self) -> Any:
        from scipy.interpolate import make_interp_spline

        zeros = [(k, np.zeros(self.values.shape[1:])) for k in range(1, 5)]
        where = (self.times - self.times[0]) / self._unit
        return make_interp_spline(where, self.values, DEGREE, bc_type=(zeros, zeros))

    @property
    def _unit(self) -> float:  # the mean distance of the samples keeps the spline well scaled
        return self.duration / max(1, len(self.times) - 1)

    def derivatives(self, t: float | Vector, order: int = 4) -> Vector:
        """The value and its time derivatives, (order + 1, …); an order above 4, which jumps at the ends, is
        refused."""
        order = checked_order(order, "spline", 4, "the fifth jumps at its ends", "an order of at most 4")
        t = np.asarray(t, dtype=float)
        if len(self.times) == 1:
            shape = (*t.shape, *self.values.shape[1:])
            return np.stack([np.broadcast_to(self.values[0], shape), *[np.zeros(shape)] * order])
        where = (np.clip(t, self.times[0], self.times[-1]) - self.times[0]) / self._unit
        return self._resting(t, [self._curve(where, nu=k) / self._unit**k for k in range(order + 1)])


# Through waypoints ----------------------------------------------------------------------------------------
#: How the way between two waypoints is covered, and what a short description says of it.
PROFILES = {
    "spline": "spline through",
    "through": "smoothly through",
    "quintic": "quintic from stop to stop of",
    "jerk-limited": "jerk-limited from stop to stop of",
}

#: A jerk-limited way of length 1 that takes UNIT_TIME / rate seconds with these limits times rate, rate² and rate³.
VELOCITY, ACCELERATION, JERK = 0.4, 0.4, 0.8
UNIT_TIME = 1.0 / VELOCITY + VELOCITY / ACCELERATION + ACCELERATION / JERK

#: Largest slope at a waypoint over the smaller of the mean slopes beside it: up to there the way between two waypoints
#: has no reversal.
STEEPEST = 1.25

#: Most waypoints that a motion stops at: each has a profile of its own.
MOST_STOPS = 1000


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Waypoints(_SampledMotion):
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

    Examples
    --------
    Two joints, which stop at each waypoint:

    >>> import flexhinf as fh
    >>> way = fh.Waypoints([0.0, 1.0, 2.0], [[0.0, 0.0], [0.5, 1.0], [0.0, 1.0]], "quintic")
    >>> way(1.0).tolist()
    [0.5, 1.0]
    """

    profile: str = "spline"
    smoothing: float = 0.0

    def __init__(
        self, times: ArrayLike, values: ArrayLike, profile: str = "spline", smoothing: float = 0.0
    ) -> None:
        super().__init__(times, values)
        vars(self).update(profile=profile, smoothing=smoothing)
        if not isinstance(self.profile, str) or self.profile not in PROFILES:
            raise unknown_name("There is no such profile of a motion.", self.profile, PROFILES)
        if self.profile in ("spline", "through"):
            return
        refuse_if(
            len(self.times) > MOST_STOPS,
            "A motion stops at too many waypoints.",
            f"expected at most {MOST_STOPS}, got {len(self.times)}",
            "profile='spline', which passes through them",
        )
        shortest = float(np.diff(self.times).min(initial=np.inf))
        refuse_if(
            self.profile == "jerk-limited" and not 0.0 <= self.smoothing < shortest,
            "The smoothing of a motion does not fit its waypoints.",
            f"expected 0 s to less than the shortest way of {shortest:.4g} s, got {value_text(self.smoothing)} s",
            "waypoints further apart in time, or profile='spline'",
        )

    @property
    def name(self) -> str:
        """A short description."""
        return f"{PROFILES[self.profile]} {len(self.times)} waypoints in {self.duration:.4g} s"

    def derivatives(self, t: float | Vector, order: int = 4) -> Vector:
        """The value and its time derivatives, (order + 1, …), from the right where they jump.

        Refused is an order above the profile's highest finite derivative: 4 of a spline and of smoothed jerk-limited
        motions, 3 without smoothing. The jerk of a quintic jumps at every stop, as `Quintic` says.
        """
        t, what = np.asarray(t, dtype=float), "motion through waypoints"
        if self.profile == "spline":
            return self._curve.derivatives(t, order)
        if self.profile == "through":
            order = checked_order(order, what, 4, "the fifth jumps", "an order of at most 4")
            inside = np.clip(t, self.times[0], self.times[-1])
            return self._resting(t, [self._curve(inside, nu=k) for k in range(order + 1)])
        order = checked_order(order, what)
        rows = np.zeros((order + 1, *t.shape, *self.values.shape[1:]))
        rows[0] += self.values[0]
        for way, part in zip(np.diff(self.values, axis=0), self._parts):
            rows += np.multiply.outer(part.derivatives(t, order), way)
        return rows

    @cached_property
    def _curve(self) -> Any:
        """The spline; or SciPy's piecewise polynomial whose second to fourth derivatives are zero at the waypoints, and
        whose slopes there are zero at both ends and at reversals, else the harmonic mean of the neighbouring ones."""
        from scipy.interpolate import BPoly

        if self.profile == "spline":
            return Spline(self.times, self.values)
        if len(self.times) == 1:
            return BPoly(self.values[None, :], [self.times[0], self.times[0] + 1.0])
        steps = np.diff(self.times).reshape((-1, *(1,) * (self.values.ndim - 1)))
        mean, slopes = np.diff(self.values, axis=0) / steps, np.zeros(self.values.shape)
        before, after = mean[:-1], mean[1:]
        same = before * after > 0.0
        product, total = np.where(same, before * after, 0.0), np.where(same, before + after, 1.0)
        most = STEEPEST * np.minimum(np.abs(before), np.abs(after))
        slopes[1:-1] = np.clip(2.0 * product / total, -most, most)
        nothing = np.zeros((3, *self.values.shape[1:]))
        rows = [[value, slope, *nothing] for value, slope in zip(self.values, slopes)]
        return BPoly.from_derivatives(self.times, rows)

    @cached_property
    def _parts(self) -> list[Quintic | JerkLimited]:
        intervals = zip(self.times[:-1].tolist(), np.diff(self.times).tolist())
        if self.profile == "quintic":
            return [Quintic(0.0, 1.0, length, at=begin) for begin, length in intervals]
        rates = [(begin, UNIT_TIME / (length - self.smoothing)) for begin, length in intervals]
        limits = [(begin, (VELOCITY * rate, ACCELERATION * rate**2, JERK * rate**3)) for begin, rate in rates]
        return [JerkLimited(0.0, 1.0, *most, at=begin, smoothing=self.smoothing) for begin, most in limits]
