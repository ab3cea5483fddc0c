"""Time-optimal motion within limits of velocity, acceleration and jerk, [berscheid2021]."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.signals.references import checked_order
from flexhinf.validation import real_array

LIMITS = ("velocity", "acceleration", "jerk")


@dataclass(frozen=True, eq=False)
class RestToRest:
    """A motion between two positions at rest, whose jerk is piecewise constant, or a moving average of such a motion.

    Parameters
    ----------
    start, goal : float
        What rounding leaves of the way to the goal is made up for by a scale.
    lengths, jerks : ndarray, (K,)
        Of the phases of constant jerk, s and unit/s³.
    average : float
        T of the moving average over the last T seconds, s; none for zero. Its jerk rises by (j(t) − j(t − T))/T, which
        is constant between the corners of both.
    """

    start: float
    goal: float
    lengths: np.ndarray
    jerks: np.ndarray
    average: float

    @cached_property
    def times(self) -> np.ndarray:
        """Corners of the piecewise constant highest derivative, s from the start."""
        corners = np.concatenate([[0.0], np.cumsum(self.lengths)])
        return np.unique(np.concatenate([corners, corners + self.average]))

    @cached_property
    def _curve(self) -> Any:
        """The position as SciPy's piecewise polynomial: the highest derivative, integrated from rest."""
        from scipy.interpolate import PPoly

        middle = (self.times[1:] + self.times[:-1]) / 2.0
        if self.average:
            rate, order = (self._jerk(middle) - self._jerk(middle - self.average)) / self.average, 4
        else:
            rate, order = self._jerk(middle), 3
        curve = PPoly(rate[None, :], self.times).antiderivative(order)
        curve.c *= (self.goal - self.start) / float(curve(self.times[-1]))
        curve.c[-1] += self.start
        return curve

    def _jerk(self, t: np.ndarray) -> np.ndarray:
        """Of the phases, zero before and after them."""
        phase = np.searchsorted(np.cumsum(self.lengths), t, side="right")
        return np.where(t < 0.0, 0.0, np.append(self.jerks, 0.0)[phase])

    def __call__(self, t: np.ndarray, order: int) -> np.ndarray:
        """The derivative of an order at times (N,), from the right where it jumps; at rest before and after."""
        inside = (t >= self.times[0]) & (t < self.times[-1])
        outside = np.where(t < self.times[0], self.start, self.goal) if order == 0 else np.zeros(np.shape(t))
        if self.goal == self.start:
            return outside
        return np.where(inside, self._curve(np.clip(t, *self.times[[0, -1]]), nu=order), outside)


@dataclass(frozen=True)
class JerkLimited:
    """From rest at `start` to rest at `goal`, from `at` on, as fast as the limits allow.

    Several channels arrive together. The motion is made by the ruckig library and kept as polynomials, so that
    values and derivatives are exact. Without smoothing the jerk jumps, and a feedforward of elastic joints would
    need pulses of its input; the moving average over `smoothing` seconds makes the snap finite, keeps all limits
    and takes so much longer.

    Parameters
    ----------
    start, goal : float or (k,)
        With arrays the values have one column per channel.
    velocity, acceleration, jerk : float or (k,)
        Largest absolute values, positive.
    at : float
        s.
    smoothing : float
        Length of the moving average, s; none for zero.

    Raises
    ------
    InvalidInput
        For limits that are not positive, or shapes that do not fit.
    """

    start: Any
    goal: Any
    velocity: Any
    acceleration: Any
    jerk: Any
    at: float = 0.0
    smoothing: float = 0.0

    def __post_init__(self) -> None:
        arrays = {name: _numbers(name, getattr(self, name)) for name in ("start", "goal", *LIMITS)}
        sizes = {array.size for array in arrays.values() if array.ndim}
        if len(sizes) > 1 or 0 in sizes:
            raise InvalidInput(
                "The channels of a motion differ in number.",
                f"expected one number or k each, got { ({name: a.shape for name, a in arrays.items()}) }",
                "one start, goal and limit per channel; one number counts for all",
            )
        for name in LIMITS:
            if not np.all(arrays[name] > 0.0):
                raise InvalidInput(
                    f"The limit of {name} must be positive.",
                    f"expected > 0, got {getattr(self, name)!r}",
                    "the largest absolute value that is allowed",
                )
        for name in ("at", "smoothing"):
            value = _numbers(name, getattr(self, name))
            if value.ndim or (name == "smoothing" and value < 0.0):
                raise InvalidInput(
                    f"The time {name!r} of a motion is not usable.",
                    f"expected one number{' >= 0' if name == 'smoothing' else ''}, got {getattr(self, name)!r}",
                    "seconds",
                )
            object.__setattr__(self, name, float(value))
        for name, array in arrays.items():  # tuples, so that equal motions are equal
            object.__setattr__(self, name, tuple(array.tolist()) if array.ndim else float(array))

    @property
    def name(self) -> str:
        """A short description."""
        smooth = f", smoothed over {self.smoothing:g} s" if self.smoothing else ""
        return (
            f"jerk-limited from {_words(self.start)} to {_words(self.goal)} in {self.duration:.4g} s{smooth}"
        )

    @property
    def duration(self) -> float:
        """From `at` to the goal, s, smoothing included."""
        return max(float(channel.times[-1]) for channel in self._channels)

    @property
    def _several(self) -> bool:
        return any(isinstance(getattr(self, name), tuple) for name in ("start", "goal", *LIMITS))

    @cached_property
    def _channels(self) -> tuple[RestToRest, ...]:
        arrays = (np.atleast_1d(getattr(self, name)) for name in ("start", "goal", *LIMITS))
        start, goal, *limits = (array.tolist() for array in np.broadcast_arrays(*arrays))
        phases = _phases([b - a for a, b in zip(start, goal)], limits)
        return tuple(RestToRest(a, b, t, j, self.smoothing) for a, b, (t, j) in zip(start, goal, phases))

    def __call__(self, t: Any) -> Any:
        """The position."""
        return self._derivative(t, 0)

    def derivatives(self, t: Any, order: int = 4) -> Any:
        """The value and its time derivatives, (order + 1, …), from the right where they jump.

        Raises
        ------
        InvalidInput
            For an order above 3, or 4 with smoothing: the next derivative is not finite.
        """
        if self.smoothing:
            bound = (4, "its snap jumps", "an order of at most 4")
        else:
            bound = (3, "its jerk jumps", "JerkLimited(..., smoothing=0.05)")
        order = checked_order(order, "jerk-limited motion", *bound)
        return np.stack([self._derivative(t, k) for k in range(order + 1)])

    def _derivative(self, t: Any, order: int) -> Any:
        since = np.asarray(t, dtype=float) - self.at
        columns = [channel(since, order) for channel in self._channels]
        return np.stack(columns, axis=-1) if self._several else columns[0]


def _phases(ways: list[float], limits: list[list[float]]) -> list[Any]:
    """Lengths and jerks of each channel's seven phases.

    ruckig's tolerances are absolute, so it is asked in units of the longest way and of the longest time that one limit
    alone makes a way take; both are powers of two, so that nothing is rounded.
    """
    from ruckig import (
        InputParameter,
        Result,
        Ruckig,
        RuckigError,
        Trajectory,
    )  # imported when a motion is made

    k, way, bounds = len(ways), np.array(ways), np.array(limits)
    request, found = InputParameter(k), Trajectory(k)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):  # refused below
        length = _power(np.abs(way).max())
        time = _power(np.max((np.abs(way) / bounds) ** (1.0 / np.array([[1.0], [2.0], [3.0]]))))
        scaled, jerk = bounds * [[time], [time**2], [time**3]] / length, length / time**3
    request.target_position = (way / length).tolist()  # from rest at zero
    request.max_velocity, request.max_acceleration, request.max_jerk = scaled.tolist()
    try:
        result = Ruckig(k).calculate(request, found)
    except RuckigError:
        result = Result.Error
    if result not in (Result.Working, Result.Finished) or not 0.0 < jerk < np.inf:
        raise InvalidInput(
            "No motion was found within the limits.",
            f"got {result} for ways of {ways} with velocity, acceleration and jerk {limits}",
            "limits of a size that fits the way",
        )
    return [(time * np.array(profile.t), jerk * np.array(profile.j)) for profile in found.profiles[0]]


def _power(value: np.float64) -> np.float64:
    """The power of two next below; 1 for what has none."""
    fine = 0.0 < value < np.inf
    return np.ldexp(1.0, np.frexp(value)[1] - 1) if fine else np.float64(1.0)


def _numbers(name: str, value: Any) -> np.ndarray:
    array = real_array(value)
    if array.ndim > 1 or not np.all(np.isfinite(array)):
        raise InvalidInput(
            "A jerk-limited motion needs finite numbers.",
            f"got {name}={value!r}",
            "one number, or one per channel",
        )
    return array


def _words(value: Any) -> str:
    return f"({', '.join(f'{v:.6g}' for v in value)})" if isinstance(value, tuple) else f"{value:.6g}"
