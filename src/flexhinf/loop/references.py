"""Commands and disturbances: functions of time that carry a name.

All take a time (s) or an array of times and return an array with one more axis, the channels, unless the value is a
plain number. They are NumPy code with `flexhinf.scalars` pieces, so they can be traced too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.scalars import clip, where

__all__ = ["Constant", "Quintic", "Samples", "Signal", "Sine", "Step"]


class Signal(Protocol):
    """A function of time with a name."""

    @property
    def name(self) -> str: ...

    def __call__(self, t: Any) -> Any: ...


def _finite(name: str, **numbers: Any) -> None:
    for key, value in numbers.items():
        if not np.all(np.isfinite(np.asarray(value, dtype=float))):
            raise InvalidInput(f"{name} needs finite numbers.", f"got {key}={value!r}", "a finite number")


@dataclass(frozen=True)
class Constant:
    """The same value at all times."""

    value: float = 0.0

    def __post_init__(self) -> None:
        _finite("Constant", value=self.value)

    @property
    def name(self) -> str:
        return f"constant {self.value:g}"

    def __call__(self, t: Any) -> Any:
        return self.value + 0.0 * t


@dataclass(frozen=True)
class Step:
    """`initial` before the time `at` (s), `value` from then on."""

    value: float
    at: float = 0.0
    initial: float = 0.0

    def __post_init__(self) -> None:
        _finite("Step", value=self.value, at=self.at, initial=self.initial)

    @property
    def name(self) -> str:
        return f"step to {self.value:.6g} at {self.at:g} s"

    def __call__(self, t: Any) -> Any:
        return where(t >= self.at, self.value, self.initial)


@dataclass(frozen=True)
class Sine:
    """offset + amplitude · sin(2π frequency (t − at) + phase) from the time `at` on, `offset` before.

    Parameters
    ----------
    amplitude, offset : float
    frequency : float
        Hz.
    phase : float
        rad.
    at : float
        s.
    """

    amplitude: float
    frequency: float
    offset: float = 0.0
    phase: float = 0.0
    at: float = 0.0

    def __post_init__(self) -> None:
        _finite(
            "Sine",
            amplitude=self.amplitude,
            frequency=self.frequency,
            offset=self.offset,
            phase=self.phase,
            at=self.at,
        )

    @property
    def name(self) -> str:
        return f"{self.offset:.6g} + {self.amplitude:.6g} sin(2π·{self.frequency:g} Hz (t − {self.at:g} s))"

    def __call__(self, t: Any) -> Any:
        wave = self.amplitude * np.sin(2.0 * math.pi * self.frequency * (t - self.at) + self.phase)
        return self.offset + where(t >= self.at, wave, 0.0)


@dataclass(frozen=True)
class Quintic:
    """From `start` to `goal` in `duration` seconds from the time `at` on, with zero speed and acceleration at both ends."""

    start: float
    goal: float
    duration: float
    at: float = 0.0

    def __post_init__(self) -> None:
        _finite("Quintic", start=self.start, goal=self.goal, duration=self.duration, at=self.at)
        if self.duration <= 0.0:
            raise InvalidInput(
                "A quintic needs time.", f"expected duration > 0 s, got {self.duration!r}", "1.0"
            )

    @property
    def name(self) -> str:
        return f"quintic from {self.start:.6g} to {self.goal:.6g} in {self.duration:g} s"

    def __call__(self, t: Any) -> Any:
        s = clip((t - self.at) / self.duration, 0.0, 1.0)
        return self.start + (self.goal - self.start) * s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)


@dataclass(frozen=True)
class Samples:
    """Linear interpolation of samples, held at both ends.

    Parameters
    ----------
    times : sequence of float
        Increasing, s.
    values : sequence of float, or of sequences with one value per channel
    """

    times: Sequence[float]
    values: Sequence[Any]

    def __post_init__(self) -> None:
        times, values = np.asarray(self.times, dtype=float), np.asarray(self.values, dtype=float)
        _finite("Samples", times=times, values=values)
        if times.ndim != 1 or len(times) != len(values) or len(times) < 1 or np.any(np.diff(times) <= 0.0):
            raise InvalidInput(
                "The samples do not describe a function of time.",
                f"expected increasing times with one value each, got {times.shape} times and {values.shape} values",
                "sort the samples and drop repeated times",
            )

    @property
    def name(self) -> str:
        return f"{len(self.times)} samples over {self.times[-1] - self.times[0]:g} s"

    def __call__(self, t: Any) -> Any:
        values = np.asarray(self.values, dtype=float)
        if values.ndim == 1:
            return np.interp(t, self.times, values)
        channels = [np.interp(t, self.times, values[:, k]) for k in range(values.shape[1])]
        return np.stack(channels, axis=-1)
