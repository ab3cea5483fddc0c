"""References, disturbances and noise as arrays for a run: what a kernel takes in.

Noise is made by a counter-based generator, so that any sample, step and channel can ask for its own alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.codegen.noise import normal_numbers
from flexhinf.errors import InvalidInput
from flexhinf.loop.signals.motions import JerkLimited, Spline
from flexhinf.loop.signals.references import Constant, Moving, Quintic, Samples, Sine, Step
from flexhinf.plant import BlackBox, Plant
from flexhinf.validation import real_array, unknown_name, value_text

VECTORISED = (Constant, JerkLimited, Moving, Quintic, Samples, Sine, Spline, Step)

#: Stage times are this far (in sub-steps) inside their sub-step, so that a jump at a sample acts from it on.
INSIDE = 1e-6

#: A sample time is a product with a rounding error: it is taken this much (relative) later, so that it is
#: never before the decimal number that a user writes for the same time.
LATER = 1.0 + 4.0 * np.finfo(float).eps

#: More numbers than this for one run's disturbance are refused (8 bytes each).
MOST_NUMBERS = 200_000_000


def by_name(signal: Any, plant: Plant | BlackBox) -> Any:
    """A mapping with the plant's groups (``link_torque`` of all joints) replaced by single names, which win."""
    groups = plant.groups
    if not isinstance(signal, Mapping):
        return signal
    single = {name: part for name, part in signal.items() if name not in groups}
    return {**{one: part for name, part in signal.items() for one in groups.get(name, ())}, **single}


def sample_signal(
    signal: Any, times: np.ndarray, channels: Sequence[str], what: str, depth: int = 3
) -> np.ndarray:
    """Values (N, channels) of a command or disturbance at times (N,), s.

    The signal is None, a number, a callable of time, a mapping by channel name, or a sequence with one per channel, at
    most `depth` sequences and mappings in one another, as a list may contain itself. `what` is "reference" or
    "disturbance", for the messages. Unknown channels, another number of values than channels, and values that are not
    finite are refused.
    """
    if signal is None:
        return np.zeros((len(times), len(channels)))
    if isinstance(signal, Mapping):
        for name in signal:
            if name not in channels:
                raise unknown_name(f"There is no {what} {name!r}.", name, channels)
        signal = [signal.get(name) for name in channels]
    several = isinstance(signal, Sequence) and not isinstance(signal, str)
    if depth and several and len(signal) == len(channels):
        columns = [
            sample_signal(part, times, [name], what, depth - 1) for part, name in zip(signal, channels)
        ]
        return np.hstack(columns) if columns else np.zeros((len(times), 0))
    later = times * LATER
    try:
        if not callable(signal):
            values = real_array(signal)
        elif isinstance(signal, VECTORISED):
            values = real_array(signal(later))
        else:
            values = real_array([signal(float(t)) for t in later])
    except (TypeError, ValueError):
        values = np.zeros((0, 0, 0))
    lead = (len(times),) if callable(signal) else ()  # per time if it is a function, else once
    if values.shape != (*lead, len(channels)) and (len(channels) != 1 or values.shape != lead):
        raise InvalidInput(
            f"The {what} does not fit its channels.",
            f"expected {len(channels)} values for {list(channels)} at each time, got {value_text(signal)}",
            f"a mapping by name, for example {{{channels[0]!r}: fh.Step(1.0)}}" if channels else f"no {what}",
        )
    values = values.reshape(len(times), -1) if callable(signal) else values
    values = np.array(np.broadcast_to(values, (len(times), len(channels))))
    if not np.all(np.isfinite(values)):
        row = int(np.argmin(np.all(np.isfinite(values), axis=1)))
        raise InvalidInput(
            f"The {what} is not finite.", f"got {values[row]} at t = {times[row]:g} s", "finite values"
        )
    return values


def sample_disturbance(
    signal: Any, period: float, samples: int, parts: int, channels: Sequence[str], room: int | None = None
) -> np.ndarray:
    """Values at the start, middle and end of every sub-step, (samples, room, 3, channels); zero beyond the last one.

    `parts` are the sub-steps of a sample, and `room` those that there is room for, so many by default; the period is in
    s. Refused is what `sample_signal` refuses, and what would be too many numbers.
    """
    count, room = samples * parts * 3, parts if room is None else room
    if count * max(1, len(channels)) > MOST_NUMBERS:
        raise InvalidInput(
            "The run is too long for its sub-steps.",
            f"expected at most {MOST_NUMBERS} numbers for the disturbance, got {samples} samples of {parts} "
            f"sub-steps with 3 stages and {len(channels)} channels",
            "a shorter run; or Loop(..., sub_steps=...) with fewer",
        )
    if signal is None:
        return np.broadcast_to(0.0, (samples, room, 3, len(channels)))  # no memory for zeros
    step = period / parts
    starts = (np.arange(samples)[:, None] * period + np.arange(parts)[None, :] * step).ravel()
    times = starts[:, None] + step * np.array([INSIDE, 0.5, 1.0 - INSIDE])[None, :]
    times, found = times.ravel(), np.zeros((samples, room, 3, len(channels)))
    if not isinstance(signal, Mapping) or set(signal) - set(channels):
        values = sample_signal(signal, times, channels, "disturbance")
        found[:, :parts] = values.reshape(samples, parts, 3, len(channels))
        return found
    for name in signal:  # one channel at a time: all of them are 0.2 GB for 5 s of seven links
        values = sample_signal(signal[name], times, [name], "disturbance")
        found[:, :parts, :, tuple(channels).index(name)] = values.reshape(samples, parts, 3)
    return found


def sample_noise(noise: Any, seed: int, samples: int, channels: Sequence[str], sample: int = 0) -> np.ndarray:
    """Measurement noise (samples, channels); `noise` is the standard deviation, one number or one each.

    Refused are a deviation that is negative, not finite or of another size, and a seed that is no integer in
    0 … 2⁶⁴ − 1.
    """
    check_seed(seed)
    if noise is None:
        return np.zeros((samples, len(channels)))
    return checked_deviation(noise, channels) * standard_normal(int(seed), samples, len(channels), sample)


def check_seed(seed: Any) -> None:
    """Refuse what is no integer in 0 … 2⁶⁴ − 1."""
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= int(seed) < 2**64:
        raise InvalidInput(
            "The seed is not usable.", f"expected 0 <= integer < 2**64, got {value_text(seed)}", "seed=0"
        )


def checked_deviation(noise: Any, channels: Sequence[str]) -> np.ndarray:
    """The standard deviation of each channel's noise, (p,); one that is negative, not finite or of another size is
    refused."""
    deviation = real_array(noise)
    usable = np.all(np.isfinite(deviation) & (deviation >= 0.0))
    if deviation.shape not in ((), (len(channels),)) or not usable:
        raise InvalidInput(
            "The measurement noise does not fit the measurements.",
            f"expected one standard deviation >= 0 or one for each of {list(channels)}, got {value_text(noise)}",
            "noise=1e-3, a standard deviation in the unit of the measurement (not a variance)",
        )
    return np.broadcast_to(deviation, len(channels))


def standard_normal(seed: int, steps: int, channels: int, sample: int = 0) -> np.ndarray:
    """Independent N(0, 1) numbers, (steps, channels), for a seed 0 … 2⁶⁴ − 1; `sample` is the plant of a campaign,
    below 2³²; see `flexhinf.codegen.noise`."""
    return normal_numbers(seed, np.arange(steps)[:, None], np.arange(channels)[None, :], sample)
