"""References, disturbances and noise as arrays for a run: what a kernel takes in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.noise import standard_normal
from flexhinf.loop.references import Constant, Quintic, Samples, Sine, Step

__all__ = ["sample_disturbance", "sample_noise", "sample_signal", "signal_name"]

VECTORISED = (Constant, Quintic, Samples, Sine, Step)

#: Stage times are taken this far (in sub-steps) inside their sub-step, so that a jump at a sample acts from it on.
INSIDE = 1e-9


def sample_signal(signal: Any, times: np.ndarray, channels: Sequence[str], what: str) -> np.ndarray:
    """Values (N, channels) of a command or disturbance at times (N,).

    Parameters
    ----------
    signal : None, number, callable of time, mapping by channel name, or sequence with one of these per channel
    """
    if signal is None:
        return np.zeros((len(times), len(channels)))
    if isinstance(signal, Mapping):
        unknown = [name for name in signal if name not in channels]
        if unknown:
            raise InvalidInput(
                f"There is no {what} {unknown[0]!r}.",
                f"expected names out of {list(channels)}",
                "one of these names",
            )
        columns = [sample_signal(signal.get(name), times, [name], what) for name in channels]
        return np.hstack(columns) if columns else np.zeros((len(times), 0))
    if (
        not callable(signal)
        and np.ndim(signal) == 1
        and len(signal) == len(channels)
        and any(map(callable, signal))
    ):
        return np.hstack(
            [sample_signal(s, times, [name], what) for s, name in zip(signal, channels, strict=True)]
        )
    if not callable(signal):
        values = np.asarray(signal, dtype=float)
    elif isinstance(signal, VECTORISED):
        values = np.asarray(signal(times), dtype=float)
    else:
        values = np.asarray([signal(float(t)) for t in times], dtype=float)
    values = values[:, None] if values.shape == (len(times),) and len(channels) == 1 else values
    if (
        values.ndim > 2
        or (values.ndim and values.shape[-1] != len(channels))
        or (not values.ndim and len(channels) != 1)
    ):
        raise InvalidInput(
            f"The {what} does not fit its channels.",
            f"expected {len(channels)} values for {list(channels)} at each time, got shape {values.shape}",
            f"a mapping by name, for example {{{channels[0]!r}: fh.Step(1.0)}}" if channels else f"no {what}",
        )
    values = np.array(np.broadcast_to(values, (len(times), len(channels))))
    if not np.all(np.isfinite(values)):
        row = int(np.argmin(np.all(np.isfinite(values), axis=1)))
        raise InvalidInput(
            f"The {what} is not finite.", f"got {values[row]} at t = {times[row]:g} s", "finite values"
        )
    return values


def sample_disturbance(
    signal: Any, period: float, samples: int, parts: int, channels: Sequence[str]
) -> np.ndarray:
    """Values at the start, middle and end of every sub-step, (samples, parts, 3, channels)."""
    if signal is None or not channels:
        return sample_signal(signal, np.zeros(1), channels, "disturbance").repeat(samples * parts * 3, axis=0)
    step = period / parts
    starts = (np.arange(samples)[:, None] * period + np.arange(parts)[None, :] * step).ravel()
    times = starts[:, None] + step * np.array([INSIDE, 0.5, 1.0 - INSIDE])[None, :]
    return sample_signal(signal, times.ravel(), channels, "disturbance")


def sample_noise(noise: Any, seed: int, samples: int, channels: Sequence[str], sample: int = 0) -> np.ndarray:
    """Measurement noise (samples, channels): `noise` is the standard deviation, one number or one per channel."""
    if noise is None:
        return np.zeros((samples, len(channels)))
    deviation = np.asarray(noise, dtype=float)
    if (
        deviation.shape not in ((), (len(channels),))
        or not np.all(np.isfinite(deviation))
        or np.any(deviation < 0.0)
    ):
        raise InvalidInput(
            "The measurement noise does not fit the measurements.",
            f"expected one standard deviation >= 0 or one for each of {list(channels)}, got {noise!r}",
            "noise=1e-3, in the unit of the measurement",
        )
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InvalidInput("The seed is not usable.", f"expected an integer >= 0, got {seed!r}", "seed=0")
    return deviation * standard_normal(int(seed), samples, len(channels), sample)


def signal_name(signal: Any) -> str:
    """A short description of a command or disturbance."""
    if signal is None:
        return "none"
    if isinstance(signal, Mapping):
        return "; ".join(f"{name}: {signal_name(part)}" for name, part in signal.items())
    if callable(signal):
        return str(getattr(signal, "name", getattr(signal, "__name__", type(signal).__name__)))
    return f"constant {signal}"
