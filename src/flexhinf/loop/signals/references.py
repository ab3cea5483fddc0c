"""Commands and disturbances: functions of time that carry a name, and their derivatives.

All take a time (s) or an array of times and return a value for each, in the unit of the signal that they are given for,
which their descriptions do not know; `Samples` of several channels return one more axis. All but `Samples` are NumPy
code with `flexhinf.scalars` pieces, so they can be traced too.

`derivatives` are for feedforward. They are exact, and those from the right where a signal jumps or has a kink: a `Step`
has none, a `Sine` starts with its speed, a `Quintic` with its jerk.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Vector
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop.shared import BRAKING
from flexhinf.notebook import StatedRepr
from flexhinf.plant.plant import motion_of
from flexhinf.scalars import clip, where
from flexhinf.validation import checked_positive, read_only, real_array, real_number, value_text

#: Shortest part of a motion with derivatives, s: those of fourth order grow with its fourth power, and stay finite.
SHORTEST = 1e-9


#: A reference or a disturbance: numbers, a function of time that gives them, or several of these, for one channel each,
#: in order or by name; None where a default takes their place.
SignalLike: TypeAlias = (
    Callable[[float], ArrayLike] | ArrayLike | Sequence["SignalLike"] | Mapping[str, "SignalLike"] | None
)


class Signal(Protocol):
    """A function of time with a name."""

    @property
    def name(self) -> str:
        """A short description."""
        ...

    def __call__(self, t: Any) -> Any:
        """The value at a time, or at each of an array of times, s."""

    def derivatives(self, t: float | Vector, order: int = 4) -> Vector:
        """The value and its time derivatives up to an order, (order + 1, …)."""
        ...


def signal_name(signal: Any, depth: int = 3) -> str:
    """A short description of a command or disturbance, of lists and mappings at most `depth` in one another."""
    if isinstance(signal, (Mapping, list, tuple)):
        parts = cast("Mapping[object, object] | Sequence[object]", signal)
        named = isinstance(parts, Mapping)
        several = [(f"{name}: ", part) for name, part in parts.items()] if named else [("", p) for p in parts]
        return "; ".join(f"{label}{signal_name(p, depth - 1)}" for label, p in several) if depth else "…"
    if callable(signal):
        return str(getattr(signal, "name", getattr(signal, "__name__", type(signal).__name__)))
    return "none" if signal is None else f"constant {signal}"


def checked_order(order: Any, what: str, highest: int | None = None, why: str = "", advice: str = "") -> int:
    """The highest derivative that is wanted, refused if it is no integer >= 0, or higher than the signal's highest
    finite derivative; `why` says what is wrong with that."""
    if isinstance(order, bool) or not isinstance(order, (int, np.integer)) or order < 0:
        raise InvalidInput(
            "The order of a derivative is a number.",
            f"expected >= 0, got {value_text(cast(object, order))}",
            "4",
        )
    if highest is not None and order > highest:
        raise InvalidInput(
            f"A {what} has no derivative of order {order}: {why}.",
            f"expected an order of at most {highest}, got {order}",
            advice,
        )
    return int(cast(int, order))


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Sampled(StatedRepr):
    """Base of signals through samples: copies of times (N,), s, and values (N,) or (N, k), read only; `smooth` ones are
    for a motion with derivatives. Refused are those that are no function of time, or so near to each other that its
    derivatives are lost."""

    times: Vector
    values: Vector
    smooth: ClassVar[bool] = False

    def __init__(self, times: ArrayLike, values: ArrayLike) -> None:
        times, values = real_array(times), real_array(values)
        finite = np.all(np.isfinite(times)) and np.all(np.isfinite(values))
        shaped = times.ndim == 1 and len(times) > 0 and values.ndim in (1, 2) and len(values) == len(times)
        if not (finite and shaped and np.all(np.diff(times) > 0.0)):
            found = f"got times {times.shape} and values {values.shape}"
            raise InvalidInput(
                "The samples do not describe a function of time.",
                f"expected finite increasing times with one value (or row) each, {found}",
                "sort the samples and drop repeated times",
            )
        if self.smooth:
            _check_shortest("samples of a motion", float(np.diff(times).min(initial=np.inf)))
        vars(self).update(times=read_only(times), values=read_only(values))


def _check_shortest(what: str, seconds: float) -> None:
    refuse_if(
        seconds < SHORTEST,
        f"Two {what} are too near to each other in time.",
        f"expected at least {SHORTEST:g} s between them, got {seconds:g} s",
        "times in seconds",
    )


class _Finite(StatedRepr):
    """Base of signals whose fields are finite numbers; piecewise constant unless the subclass has derivatives."""

    #: A short description, with the fields' values in it.
    text: ClassVar[str]

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            refuse_if(
                not np.isfinite(real_number(value)),
                f"{type(self).__name__} needs finite numbers.",
                f"got {key}={value_text(value)}",
                "one number; for several channels a mapping of names to signals",
            )

    @property
    def name(self) -> str:
        return self.text.format(**vars(self))

    __call__: Callable[[Any], Any]

    def derivatives(self, t: float | Vector, order: int = 4) -> Vector:
        """The value and zeros, (order + 1, …): at rest on both sides of a jump, which itself has no derivative."""
        return np.stack([self(t), *[0.0 * t] * checked_order(order, "signal")])


@dataclass(frozen=True, repr=False)
class Constant(_Finite):
    """The same value at all times.

    Examples
    --------
    >>> import flexhinf as fh
    >>> fh.Constant(2.0)(0.5)
    2.0
    """

    text: ClassVar[str] = "constant {value:g}"
    value: float = 0.0

    def __call__(self, t: Any) -> Any:
        """The value."""
        return self.value + 0.0 * t


@dataclass(frozen=True, repr=False)
class Step(_Finite):
    """`initial` before the time `at` (s), `value` from then on.

    Examples
    --------
    >>> import flexhinf as fh
    >>> float(fh.Step(2.0, at=1.0)(1.5))
    2.0
    """

    text: ClassVar[str] = "step to {value:.6g} at {at:g} s"
    value: float
    at: float = 0.0
    initial: float = 0.0

    def __call__(self, t: Any) -> Any:
        """The value from `at` on, else `initial`."""
        return where(t >= self.at, self.value, self.initial)


@dataclass(frozen=True, repr=False)
class Sine(_Finite):
    """offset + amplitude · sin(2π frequency (t − at) + phase) from the time `at` (s) on, `offset` before.

    The frequency is in Hz, the phase in rad.

    Examples
    --------
    >>> import flexhinf as fh
    >>> round(float(fh.Sine(2.0, frequency=1.0, offset=1.0)(0.25)), 12)
    3.0
    """

    text: ClassVar[str] = "{offset:.6g} + {amplitude:.6g} sin(2π·{frequency:g} Hz (t − {at:g} s))"
    amplitude: float
    frequency: float
    offset: float = 0.0
    phase: float = 0.0
    at: float = 0.0

    def __call__(self, t: Any) -> Any:
        """The wave from `at` on, else `offset`."""
        wave = self.amplitude * np.sin(2.0 * math.pi * self.frequency * (t - self.at) + self.phase)
        return self.offset + where(t >= self.at, wave, 0.0)

    def derivatives(self, t: float | Vector, order: int = 4) -> Vector:
        """The value and its time derivatives, (order + 1, …); zero before `at`."""
        pulsation = 2.0 * math.pi * self.frequency
        angle = pulsation * (t - self.at) + self.phase
        sine, cosine = np.sin(angle), np.cos(angle)
        turned, orders = (sine, cosine, -sine, -cosine), range(1, checked_order(order, "sine") + 1)
        waves = [self.amplitude * pulsation**k * turned[k % 4] for k in orders]
        return np.stack([self(t), *(where(t >= self.at, wave, 0.0) for wave in waves)])


@dataclass(frozen=True, repr=False)
class Quintic(_Finite):
    """From `start` to `goal` in `duration` seconds from `at` on; zero speed and acceleration at both ends.

    Examples
    --------
    >>> import flexhinf as fh
    >>> move = fh.Quintic(0.0, 1.0, 2.0)
    >>> float(move(1.0)), float(move(2.0))
    (0.5, 1.0)
    """

    text: ClassVar[str] = "quintic from {start:.6g} to {goal:.6g} in {duration:g} s"
    start: float
    goal: float
    duration: float
    at: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_positive("The duration of a quintic", self.duration, "seconds", "1.0")
        _check_shortest("ends of a quintic", self.duration)

    def __call__(self, t: Any) -> Any:
        """s³ (10 − 15 s + 6 s²) of the way, s the fraction of the time that has passed."""
        s = clip((t - self.at) / self.duration, 0.0, 1.0)
        return self.start + (self.goal - self.start) * s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)

    def derivatives(self, t: float | Vector, order: int = 4) -> Vector:
        """The value and its time derivatives, (order + 1, …); zero before and after the motion.

        The jerk jumps at both ends; a feedforward needs a pulse there that this does not show. `JerkLimited`
        with smoothing, or a `Spline`, needs none.
        """
        s = clip((t - self.at) / self.duration, 0.0, 1.0)
        rows: list[Any] = []
        polynomial = [0.0, 0.0, 0.0, 10.0, -15.0, 6.0]
        for k in range(1, checked_order(order, "quintic") + 1):
            polynomial = [j * c for j, c in enumerate(polynomial)][1:]
            value = 0.0 * s
            for c in reversed(polynomial):
                value = value * s + c
            value = (self.goal - self.start) / self.duration**k * value
            rows.append(where(t >= self.at, where(t < self.at + self.duration, value, 0.0), 0.0))
        return np.stack([self(t), *rows])


class Samples(Sampled):
    """Linear interpolation of values (N,) or (N, k) at increasing times (N,), s; held at both ends.

    Examples
    --------
    >>> import flexhinf as fh
    >>> float(fh.Samples([0.0, 1.0, 2.0], [0.0, 4.0, 4.0])(0.5))
    2.0
    """

    @property
    def name(self) -> str:
        """A short description."""
        return f"{len(self.times)} samples over {self.times[-1] - self.times[0]:g} s"

    def __call__(self, t: Any) -> Any:
        """The value between the neighbouring samples, by linear interpolation."""
        columns: list[Vector] = [np.interp(t, self.times, column) for column in np.atleast_2d(self.values.T)]
        return columns[0] if self.values.ndim == 1 else np.stack(columns, axis=-1)

    def derivatives(self, t: float | Vector, order: int = 4) -> Vector:
        """The value alone, (1, …): the speed of a linear interpolation jumps at every sample, so that an order above 0
        is refused."""
        why, advice = "its speed jumps at every sample", "fh.Spline(times, values)"
        checked_order(order, "linear interpolation", 0, why, advice)
        return np.stack([self(t)])


@dataclass(frozen=True, eq=False, repr=False)
class Braked(StatedRepr):
    """A signal that is slowed to rest along its own path: its time stands still `time` seconds after `at`, s.

    The path time is that of `Controller.path_rate`: it goes on by half of `time`, and its rate falls from 1 to 0 with
    three continuous derivatives. Derivatives are by the chain rule, up to the fourth.

    Raises
    ------
    InvalidInput
        If the times are no numbers, or the braking time is not positive.

    Examples
    --------
    A ramp of 1 rad/s that is braked at 1 s stands still 0.15 rad later:

    >>> import flexhinf as fh
    >>> ramp = fh.Quintic(0.0, 10.0, 10.0)
    >>> stopped = fh.Braked(ramp, at=5.0, time=0.3)
    >>> round(float(stopped(9.0) - ramp(5.15)), 12)
    0.0
    """

    signal: Signal | Callable[[Vector], Vector]
    at: float
    time: float = 0.3

    def __post_init__(self) -> None:
        checked_positive("The braking time", self.time, "seconds", "0.3")
        refuse_if(
            not np.isfinite(real_number(self.at)),
            "The time at which braking begins is no number.",
            f"expected seconds, got {value_text(self.at)}",
            "at=1.0",
        )

    @property
    def name(self) -> str:
        """A short description."""
        return f"{signal_name(self.signal)}, braked at {self.at:g} s within {self.time:g} s"

    def __call__(self, t: Any) -> Any:
        """The signal at the path time."""
        return self.signal(self._path_time(np.asarray(t, dtype=float)))

    def _path_time(self, t: np.ndarray) -> np.ndarray:
        passed = np.clip((t - self.at) / self.time, 0.0, 1.0)
        return np.where(t < self.at, t, self.at + self.time * np.polynomial.Polynomial(BRAKING)(passed))

    def derivatives(self, t: float | Vector, order: int = 4) -> Vector:
        """The value and its time derivatives, (order + 1, …)."""
        checked_order(order, "braked signal", 4, "the fifth of its path time jumps", "order=4")
        refuse_if(
            not hasattr(self.signal, "derivatives"),
            "The signal that is braked has no derivatives.",
            f"expected a signal with derivatives(t, order), got {value_text(self.signal)}",
            "fh.Quintic, fh.Sine; fh.Spline(times, values) for samples",
        )
        t, path = np.asarray(t, dtype=float), np.polynomial.Polynomial(BRAKING)
        passed, early = np.clip((t - self.at) / self.time, 0.0, 1.0), t < self.at
        q = [*cast(Signal, self.signal).derivatives(self._path_time(t), order), *np.zeros(4 - order)]
        a, b, c, d = (
            np.where(early, float(k == 1), self.time ** (1 - k) * path.deriv(k)(passed)).reshape(
                t.shape + (1,) * (np.ndim(q[0]) - t.ndim)
            )
            for k in range(1, 5)
        )
        rows = [
            q[0], q[1] * a, q[2] * a**2 + q[1] * b, q[3] * a**3 + 3.0 * q[2] * a * b + q[1] * c,
            q[4] * a**4 + 6.0 * q[3] * a**2 * b + q[2] * (3.0 * b**2 + 4.0 * a * c) + q[1] * d,
        ]  # fmt: skip
        return np.stack(rows[: order + 1])


@dataclass
class _Evaluated:
    """What a `Moving` gave last: times, states and inputs; None before the first time."""

    parts: Sequence[np.ndarray] | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Moving(StatedRepr):
    """(x_d, u_d) along signals, by inverse dynamics: the command of ``Controller(moving=True)``.

    Where a signal jumps it is at rest on both sides: the feedforward of a `Step` is that of the pose before, then of
    the pose after. A signal with a kink in its position, velocity or acceleration gives an x_d that jumps there; the
    law then treats the difference as an error.

    Parameters
    ----------
    signals : sequence, mapping by name, or one signal
        One per joint, in the order of the robot, each with ``derivatives``; a number is constant. One signal may
        have a column per joint (`JerkLimited`, `Spline`).
    inverse : callable
        ``inverse(q, dq, ddq, dddq, ddddq)`` → x (N, n), u (N, m) of (N, joints) arrays, for example
        ``robot.inverse_dynamics``.
    names : sequence of str, optional
        Of the joints' positions, in the order of `inverse`; needed for a mapping.

    Raises
    ------
    InvalidInput
        If the signals do not fit, or have no four derivatives.

    Examples
    --------
    >>> import flexhinf as fh
    >>> arm = fh.paper_arm()
    >>> reference = fh.Moving(fh.Quintic(0.0, 1.0, 2.0), arm.inverse_dynamics)
    >>> reference.state(2.0).shape
    (4,)
    """

    signals: Sequence[Signal] | Signal
    inverse: Callable[..., tuple[ArrayLike, ArrayLike]]
    names: Sequence[str] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", (self.names,) if isinstance(self.names, str) else tuple(self.names))
        self(0.0)

    @property
    def name(self) -> str:
        """A short description."""
        return f"moving along {signal_name(self.signals)}"

    def derivatives(self, t: float | Vector, order: int = 4) -> np.ndarray:
        """Positions of the joints and their time derivatives, (order + 1, k) at a time or (order + 1, N, k)."""
        motion = motion_of(self.signals, np.array(t, dtype=float, ndmin=1), order, self.names)
        return motion if np.ndim(t) else motion[:, 0]

    def state(self, t: float | Vector) -> np.ndarray:
        """x_d, (n,) at a time or (N, n); at the start, the initial state of a run without error."""
        return self._both(t)[0]

    def input(self, t: float | Vector) -> np.ndarray:
        """u_d, (m,) at a time or (N, m)."""
        return self._both(t)[1]

    def __call__(self, t: Any) -> np.ndarray:
        """(x_d, u_d), (n + m,) at a time or (N, n + m)."""
        return np.concatenate(self._both(t), axis=-1)

    @property
    def last(self) -> Sequence[np.ndarray] | None:
        """What it gave last, for the instants of a run: times (N,), x_d, u_d; the next robot may be commanded alike."""
        return self._evaluated.parts

    def resume(self, last: Sequence[np.ndarray]) -> None:
        """Go on from what the same command gave `last` in another process."""
        self._evaluated.parts = last

    @cached_property
    def _evaluated(self) -> _Evaluated:
        return _Evaluated()

    def _both(self, t: Any) -> tuple[np.ndarray, np.ndarray]:
        times, kept = np.array(t, dtype=float, ndmin=1), self.last
        if kept is None or not np.array_equal(kept[0], times):
            motion = motion_of(self.signals, times, 4, self.names)
            parts = tuple(np.asarray(part, dtype=float) for part in self.inverse(*motion))
            refuse_if(
                len(parts) != 2 or any(part.ndim != 2 or len(part) != len(times) for part in parts),
                "The inverse does not give a state and an input for each time.",
                f"expected two arrays of {len(times)} rows, got shapes {[part.shape for part in parts]}",
                "robot.inverse_dynamics",
            )
            kept = times, *parts
            self._evaluated.parts = kept  # many robots are commanded the same
        _, x, u = kept
        return (x.copy(), u.copy()) if np.ndim(t) else (x[0].copy(), u[0].copy())


def braked(reference: Any, at: float, time: float) -> Any:
    """A command that is slowed to rest along its path, see `Braked`: a signal, a `Moving` with its inverse dynamics, or
    several of them by name or in a list; numbers stay as they are."""
    if isinstance(reference, Moving):
        return Moving(Braked(reference, at, time), reference.inverse, reference.names)
    if isinstance(reference, Mapping):
        named = cast("Mapping[str, Any]", reference)
        return {name: braked(part, at, time) for name, part in named.items()}
    if isinstance(reference, (list, tuple)):
        return [braked(part, at, time) for part in cast("Sequence[Any]", reference)]
    return Braked(cast(Signal, reference), at, time) if callable(reference) else reference
