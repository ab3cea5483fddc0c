"""What a run is given, checked before it starts: its length, the initial state, and the size of commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.controller.options import positive
from flexhinf.loop.signals.jerk_limited import JerkLimited
from flexhinf.loop.signals.references import Constant, Quintic, Sine, Step
from flexhinf.loop.simulation.trajectory import STARTED
from flexhinf.plant import BlackBox, Plant
from flexhinf.untrusted import real_array, real_number, value_text

#: Longest run, in samples.
MOST_SAMPLES = 20_000_000

#: A full turn, rad, with its rounding.
FULL_TURN = 2.0 * np.pi * (1.0 + 1e-9)

#: Signals whose values are written by a person.
WRITTEN = (Constant, JerkLimited, Quintic, Sine, Step)


def sample_count(duration: Any, period: float) -> int:
    """Number of samples of a run at 0, period, …, duration.

    Raises
    ------
    InvalidInput
        If the duration, s, is not positive, shorter than a period, or longer than `MOST_SAMPLES` samples.
    """
    seconds = positive(duration, "duration of a run", "8.0")
    samples = seconds / period + 1.0
    if samples < 1.5:
        raise InvalidInput(
            "The run is shorter than one period.",
            f"expected at least {period:g} s, got {seconds:g} s",
            "a duration in seconds, for example 8.0",
        )
    if samples > MOST_SAMPLES:
        raise InvalidInput(
            "The run is too long for its period.",
            f"expected at most {MOST_SAMPLES - 1} samples = {(MOST_SAMPLES - 1) * period:g} s, got {seconds:g} s",
            f"duration={1e-3 * seconds:g} if {seconds:g} ms was meant",
        )
    return round(samples)


def starting_state(given: Any, states: Sequence[str], controller: Controller) -> np.ndarray:
    """Initial state (n,) of a plant with these states.

    Parameters
    ----------
    given : array, mapping by name, or None
        An array has one value per state of the plant, or per state of the plant that the law was designed for
        (the others are zero, as those that a mapping leaves out). None: where the controller starts, which is where its
        estimate begins; without an estimator, the law's operating point.
    states : sequence of str
        Of the true plant.

    Raises
    ------
    InvalidInput
        For unknown names, another number of values, or values that are not finite.
    """
    if given is None:
        named = {name: value for name, value in _designed_start(controller).items() if name in states}
    elif isinstance(given, Mapping):
        named = dict(given)
    else:
        named = _by_name(given, states, controller.states)
    unknown = [name for name in named if name not in states]
    if unknown:
        raise InvalidInput(
            f"There is no state {unknown[0]!r}.", f"expected names out of {list(states)}", "one of these"
        )
    x = np.array([real_number(named.get(name, 0.0)) for name in states])
    if not np.all(np.isfinite(x)):
        raise InvalidInput("The initial state is not finite.", f"got {value_text(given)}", "finite numbers")
    return x


def _designed_start(controller: Controller) -> dict[str, float]:
    """Where the controller starts, by name."""
    start = (
        controller.law.operating_point if controller.estimator is None else controller.estimator.initial[0]
    )
    return dict(zip(controller.states, np.asarray(start, dtype=float).tolist()))


def operating_state(states: Sequence[str], controller: Controller) -> np.ndarray:
    """The law's operating point as a state (n,) of a plant with these states, the others zero."""
    point = dict(zip(controller.states, np.asarray(controller.law.operating_point, dtype=float).tolist()))
    return np.array([point.get(name, 0.0) for name in states])


#: A state starts elsewhere from this difference on, and is at rest up to this rate, both relative to 1 and the plant's.
SAME_START = 1e-6


def start_text(
    plant: Plant | BlackBox, x: np.ndarray, given: bool, controller: Controller, before: np.ndarray
) -> str:
    """Where a run starts, beside where the controller does, and whether the true plant rests there.

    Parameters
    ----------
    x : (n,)
        Of the run, in the order of the plant's states.
    given : bool
        Whether somebody gave it.
    before : (m,)
        The input before the first sample.
    """
    own = _designed_start(controller)
    apart = {name: (value, own[name]) for name, value in zip(plant.states, x.tolist()) if name in own}
    name, (value, start) = max(
        apart.items(), key=lambda one: abs(one[1][0] - one[1][1]), default=("", (0.0, 0.0))
    )
    text = STARTED
    if abs(value - start) > SAME_START * max(1.0, abs(start)):
        text = f"{name} = {value:.6g}, the controller starts at {start:.6g}"
    if given or not isinstance(plant, Plant):
        return text
    rates = plant.derivative(x, before)
    worst = int(np.argmax(np.abs(rates)))
    if abs(rates[worst]) <= SAME_START * max(1.0, plant.fastest_mode(x, before)):
        return f"{text}, at rest"
    return f"{text}; the true plant does not rest there: d/dt {plant.states[worst]} = {rates[worst]:.3g}"


def _by_name(given: Any, states: Sequence[str], designed: Sequence[str]) -> dict[str, float]:
    values = real_array(given)
    for names in (states, designed):
        if values.shape == (len(names),):
            return {name: float(value) for name, value in zip(names, values)}
    raise InvalidInput(
        "The initial state does not fit the true plant.",
        f"expected {len(states)} values for {list(states)}, got {value_text(given)}",
        "a mapping by name, for example {'link_position': 0.1}, leaves the others at zero",
    )


#: A command may exceed a limit by this fraction of the range, for rounding.
ROUNDING = 1e-9


def check_ranges(
    commands: np.ndarray,
    times: np.ndarray,
    names: Sequence[str],
    limits: Mapping[str, tuple[float, float]],
    units: Mapping[str, str],
) -> None:
    """Refuse commands (N, k) that leave the range of a state.

    Parameters
    ----------
    commands : ndarray, (N, k)
    times : ndarray, (N,)
        s.
    names : sequence of str
        Of the columns.
    limits : mapping of str to (float, float)
        By name; what is not named has none.
    units : mapping of str to str
        For the message.

    Raises
    ------
    InvalidInput
        Naming the state, the first time, the value and the range.
    """
    for name, column in zip(names, commands.T):
        if name not in limits:
            continue
        low, high = limits[name]
        slack = ROUNDING * (high - low)
        outside = np.flatnonzero((column < low - slack) | (column > high + slack))
        if len(outside):
            unit, first = units.get(name, ""), outside[0]
            raise InvalidInput(
                f"The reference leaves the range of {name!r}.",
                f"expected {low:g} to {high:g} {unit}, got {column[first]:.6g} {unit} at t = {times[first]:g} s",
                "a command within the joint's limits; angles are in rad",
            )


def check_turns(reference: Any, commands: np.ndarray, names: Sequence[str], units: Mapping[str, str]) -> None:
    """Refuse a command beyond 2π rad that somebody wrote as a number: it is degrees more often than several turns.

    Parameters
    ----------
    reference : as for `flexhinf.Loop.run`
        Numbers and the signals of `WRITTEN` are looked at; samples and functions are computed, not written.
    commands : ndarray, (N, k)
        What it gives.
    names : sequence of str
        Of the columns.
    units : mapping of str to str
        Only positions in rad are looked at.

    Raises
    ------
    InvalidInput
        Naming the state, the value, and the same number of degrees in rad.
    """
    parts = list(reference) if isinstance(reference, (list, tuple)) else [reference] * len(names)
    if isinstance(reference, Mapping):
        parts = [reference.get(name) for name in names]
    for name, part, column in zip(names, parts, commands.T):
        written = isinstance(part, WRITTEN) or not callable(part)
        largest = float(column[np.argmax(np.abs(column))])
        if written and units.get(name) == "rad" and abs(largest) > FULL_TURN:
            raise InvalidInput(
                f"The command of {name!r} is more than a full turn.",
                f"expected at most 2π = 6.283 rad, got {largest:.6g} rad",
                f"np.radians({largest:.6g}) = {np.radians(largest):.4g} if degrees were meant; "
                "run(..., multi_turn=True) for several turns",
            )
