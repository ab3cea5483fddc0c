"""Arguments of a run, checked before it starts: length, initial state, size of commands; and references, disturbances
and noise as arrays, which a kernel takes in.

Noise is made by a counter-based generator, so that the noise of any sample, step and channel can be computed alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NotRequired, Protocol, TypeAlias, TypedDict, cast

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Numbers, Vector
from flexhinf.codegen.noise import seed_key
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.controller.memory import Told
from flexhinf.loop.signals.motions import JerkLimited, Spline
from flexhinf.loop.signals.references import Constant, Moving, Quintic, Samples, SignalLike, Sine, Step
from flexhinf.loop.simulation.program import BLOCK, noise_kernel
from flexhinf.loop.simulation.trajectory import STARTED
from flexhinf.numerals import number_text
from flexhinf.plant import BlackBox, Plant
from flexhinf.validation import checked_positive, one_of, real_array, real_number, value_text

#: A state: one value per state in order, or some by name; None where a default takes their place.
StateLike: TypeAlias = Numbers | Mapping[str, float]


class RunOptions(TypedDict, total=False):
    """Arguments of `flexhinf.Loop.run` by name, those that are stated."""

    reference: SignalLike
    disturbance: SignalLike
    noise: Numbers
    duration: float
    initial_state: StateLike
    initial_input: Numbers
    multi_turn: bool


class SampleOptions(RunOptions, total=False):
    """The same of a `Plant` alone, whose controller may have a memory."""

    initial_memory: Numbers


class Stepped(Protocol):
    """What a run on a black box steps: a `Controller`, or one whose steps are timed."""

    def step(self, y: Vector, reference: Vector | None, /) -> Vector:
        """The input (m,) for a measurement and a command."""
        ...

    @property
    def estimate(self) -> Vector:
        """That of the last step."""
        ...

    @property
    def path_rate(self) -> float:
        """How fast the command goes on along its path."""
        ...

    @property
    def told(self) -> Told:
        """Counts since the start."""
        ...


#: Parameters of N plants: an array (N, P), N mappings by name, or a mapping of arrays (N, …) by name.
PlantParameters: TypeAlias = ArrayLike | Sequence[Mapping[str, ArrayLike]] | Mapping[str, ArrayLike]


class EnsembleArguments(TypedDict):
    """Arguments of `flexhinf.loop.Ensemble.run` by name, of N plants."""

    parameters: PlantParameters
    seeds: ArrayLike
    initial_states: Numbers
    loads: Numbers
    initial_inputs: NotRequired[Numbers]


#: Longest run, in samples.
MOST_SAMPLES = 20_000_000

#: A full turn, rad, with its rounding.
FULL_TURN = 2.0 * np.pi * (1.0 + 1e-9)

#: Signals whose values are written by a person.
WRITTEN = (Constant, JerkLimited, Quintic, Sine, Step)


def sample_count(duration: float, period: float) -> int:
    """Number of samples of a run at 0, period, …, duration; a duration, s, that is not positive, shorter than a period,
    or longer than `MOST_SAMPLES` samples is refused."""
    seconds = checked_positive("The duration of a run", duration, "seconds", "8.0")
    samples = seconds / period + 1.0
    refuse_if(
        samples < 1.5,
        "The run is shorter than one period.",
        f"expected at least {period:g} s, got {seconds:g} s",
        "a duration in seconds, for example 8.0",
    )
    refuse_if(
        samples > MOST_SAMPLES,
        "The run is too long for its period.",
        f"expected at most {MOST_SAMPLES - 1} samples = {(MOST_SAMPLES - 1) * period:g} s, got {seconds:g} s",
        f"duration={1e-3 * seconds:g} if {seconds:g} ms was meant",
    )
    return round(samples)


def starting_state(initial: StateLike, states: Sequence[str], controller: Controller) -> np.ndarray:
    """Initial state (n,) of a plant with these states.

    An array has one value per state of the plant, or per state of the plant that the law was designed for (the others
    are zero, as those that a mapping by name leaves out). None: where the controller starts, where its estimate
    begins; without an estimator, the law's operating point. Unknown names, another number of values, or values that are
    not finite are refused.
    """
    if initial is None:
        named = {name: value for name, value in _designed_start(controller).items() if name in states}
    elif isinstance(initial, Mapping):
        named = dict(initial)
    else:
        values = real_array(initial)
        fitting = [names for names in (states, controller.states) if values.shape == (len(names),)]
        refuse_if(
            not fitting,
            "The initial state does not fit the true plant.",
            f"expected {len(states)} values for {list(states)}, got {value_text(initial)}",
            "a mapping by name, for example {'link_position': 0.1}, leaves the others at zero",
        )
        named = {name: float(value) for name, value in zip(fitting[0], values)}
    for name in named:
        one_of(f"There is no state {name!r}.", name, states)
    x = np.array([real_number(named.get(name, 0.0)) for name in states])
    refuse_if(
        not np.all(np.isfinite(x)),
        "The initial state is not finite.",
        f"got {value_text(initial)}",
        "finite numbers",
    )
    return x


def _designed_start(controller: Controller) -> dict[str, float]:
    estimator = controller.estimator
    start = controller.law.operating_point if estimator is None else estimator.initial[0]
    return dict(zip(controller.estimated, np.asarray(start, dtype=float).tolist()))


def operating_state(states: Sequence[str], controller: Controller) -> np.ndarray:
    """The law's operating point as a state (n,) of a plant with these states, the others where the estimate begins, or
    zero."""
    point = _designed_start(controller) | dict(
        zip(controller.states, np.asarray(controller.law.operating_point, dtype=float).tolist())
    )
    return np.array([point.get(name, 0.0) for name in states])


#: A state starts elsewhere from this difference on, and is at rest up to this rate, both relative to 1 and the plant's.
SAME_START = 1e-6


#: So many positions are named of a start.
MOST_PLACES = 3


def start_text(
    plant: Plant | BlackBox, x: np.ndarray, placed: bool, controller: Controller, before: np.ndarray
) -> str:
    """Where a run starts, beside where the controller does, and whether the true plant rests there.

    The state x (n,) is that of the run, by the plant's states, which the user may have `placed`; `before` (m,) is the
    input before the first sample.
    """
    own = _designed_start(controller)
    apart = ((value, own[name], name) for name, value in zip(plant.states, x.tolist()) if name in own)
    value, start, name = max(apart, key=lambda item: abs(item[0] - item[1]), default=(0.0, 0.0, ""))
    away = abs(value - start) > SAME_START * max(1.0, abs(start))
    unit = plant.units.get(name, "")
    places = [
        f"{state} = {number_text(value, plant.units.get(state, ''))}"
        for state, value in zip(plant.states, x.tolist())
        if state in controller.judged
    ]
    at = f" ({', '.join(places[:MOST_PLACES])}{', …' if len(places) > MOST_PLACES else ''})" if places else ""
    text = (
        f"{name} = {number_text(value, unit, 6)}, the controller starts at {number_text(start, unit, 6)}"
        if away
        else f"{STARTED}{at}"
    )
    if placed or not isinstance(plant, Plant):
        return text
    rates = plant.change(x, before)
    worst = int(np.argmax(np.abs(rates)))
    rate = abs(rates[worst])
    if rate <= SAME_START or rate <= SAME_START * plant.fastest_mode(x, before):
        return f"{text}, at rest"
    change = number_text(float(rates[worst]), plant.units.get(plant.states[worst], ""), 3)
    each = "" if plant.sampled else " per s"
    return f"{text}; the true plant does not rest there: {plant.change_text(worst)} = {change}{each}"


#: A command may exceed a limit by this fraction of the range, for rounding.
ROUNDING = 1e-9


def check_ranges(
    commands: np.ndarray,
    times: np.ndarray,
    names: Sequence[str],
    limits: Mapping[str, tuple[float, float]],
    units: Mapping[str, str],
) -> None:
    """Refuse commands (N, k) at times (N,) that leave the range of a state, by the names of the columns; what has no
    limits has no range. The InvalidInput names the state, the first time, the value and the range."""
    for name, column in zip(names, commands.T):
        low, high = limits.get(name, (-np.inf, np.inf))
        slack = ROUNDING * (high - low)
        outside = np.flatnonzero((column < low - slack) | (column > high + slack))
        if len(outside):
            unit, first = units.get(name, ""), outside[0]
            raise InvalidInput(
                f"The reference leaves the range of {name!r}.",
                f"expected {low:g} to {high:g} {unit}, got {column[first]:.6g} {unit} at t = {times[first]:g} s",
                "a command within the joint's limits; angles are in rad",
            )


def is_written(argument: object, depth: int = 4) -> bool:
    """Whether an argument's text says all of it: numbers, signals of `WRITTEN` with plain numbers, also in lists and
    mappings, at most `depth` in one another. The digits of an array are not all in its text."""
    kind = type(argument)
    if kind in (bool, int, float, str, type(None), np.float64):
        return True
    parts = {**vars(argument)} if kind in WRITTEN else argument
    if not depth or type(parts) not in (dict, list, tuple):
        return False
    entries = cast("Mapping[object, object] | Sequence[object]", parts)
    several = [*entries, *entries.values()] if isinstance(entries, Mapping) else entries
    return all(is_written(part, depth - 1) for part in several)


def check_turns(
    reference: SignalLike, commands: np.ndarray, names: Sequence[str], units: Mapping[str, str]
) -> None:
    """Refuse commands (N, k) beyond 2π rad that are written as a number: these are degrees more often than turns.

    Of the reference, as for `flexhinf.Loop.run`, numbers and the signals of `WRITTEN` are looked at; samples and
    functions are computed, not written. The InvalidInput names the state, the value, and as many degrees in rad.
    """
    parts: Sequence[SignalLike] = [reference] * len(names)
    if (named := _by_channel(reference)) is not None:
        parts = [named.get(name) for name in names]
    elif isinstance(reference, (list, tuple)):
        parts = cast("Sequence[SignalLike]", reference)
    for name, part, column in zip(names, parts, commands.T):
        written = isinstance(part, WRITTEN) or not callable(part)
        largest = float(column[np.argmax(np.abs(column))])
        refuse_if(
            written and units.get(name) == "rad" and abs(largest) > FULL_TURN,
            f"The command of {name!r} is more than a full turn.",
            f"expected at most 2π = 6.283 rad, got {largest:.6g} rad",
            f"np.radians({largest:.6g}) = {np.radians(largest):.4g} if degrees were meant; "
            "run(..., multi_turn=True) for several turns",
        )


VECTORISED = (Constant, JerkLimited, Moving, Quintic, Samples, Sine, Spline, Step)

#: Stage times are this far (in sub-steps) inside their sub-step, so that a jump at a sample acts from it on.
INSIDE = 1e-6

#: A sample time is a product with a rounding error: it is taken this much (relative) later, so that it is
#: never before the decimal number that a user writes for the same time.
LATER = 1.0 + 4.0 * np.finfo(float).eps

#: More numbers than this for one run's disturbance are refused (8 bytes each).
MOST_NUMBERS = 200_000_000


def _by_channel(signal: SignalLike) -> Mapping[str, SignalLike] | None:
    """A signal that has a part for each of some names; None for any other."""
    return cast("Mapping[str, SignalLike]", signal) if isinstance(signal, Mapping) else None


def by_name(signal: SignalLike, plant: Plant | BlackBox) -> SignalLike:
    """A mapping with the plant's groups (``link_torque`` of all joints) replaced by single names, which win."""
    if (named := _by_channel(signal)) is None:
        return signal
    members = {member: part for name, part in named.items() for member in plant.groups.get(name, ())}
    return {**members, **{name: part for name, part in named.items() if name not in plant.groups}}


def sample_signal(
    signal: SignalLike, times: np.ndarray, channels: Sequence[str], what: str, depth: int = 3
) -> np.ndarray:
    """Values (N, channels) of a command or disturbance at times (N,), s.

    The signal is None, a number, a callable of time, a mapping by channel name, or a sequence with one per channel, at
    most `depth` sequences and mappings in one another, as a list may contain itself. `what` is "reference" or
    "disturbance", for the messages. Unknown channels, another number of values than channels, and values that are not
    finite are refused.
    """
    if signal is None:
        return np.zeros((len(times), len(channels)))
    if (named := _by_channel(signal)) is not None:
        for name in named:
            one_of(f"There is no {what} {name!r}.", name, channels)
        signal = [named.get(name) for name in channels]
    if depth and isinstance(signal, Sequence) and not isinstance(signal, str):
        parts = cast("Sequence[SignalLike]", signal)
        if len(parts) == len(channels):
            columns = [
                sample_signal(part, times, [name], what, depth - 1) for part, name in zip(parts, channels)
            ]
            return np.hstack(columns) if columns else np.zeros((len(times), 0))
    later, whole = times * LATER, cast(Any, signal)
    function = cast("Callable[[Any], ArrayLike] | None", whole if callable(whole) else None)
    try:
        if function is None:
            values = real_array(cast(object, signal))
        elif isinstance(function, VECTORISED):
            values = real_array(function(later))
        else:
            values = real_array([function(float(t)) for t in later])
    except (TypeError, ValueError):
        values = np.zeros((0, 0, 0))
    lead = (len(times),) if function else ()  # per time if it is a function, else once
    if values.shape != (*lead, len(channels)) and (len(channels) != 1 or values.shape != lead):
        raise InvalidInput(
            f"The {what} does not fit its channels.",
            f"expected {len(channels)} values for {list(channels)} at each time, got "
            f"{value_text(cast(object, signal))}",
            f"a mapping by name, for example {{{channels[0]!r}: fh.Step(1.0)}}" if channels else f"no {what}",
        )
    values = values.reshape(len(times), -1) if function else values
    values = np.array(np.broadcast_to(values, (len(times), len(channels))))
    if not np.all(np.isfinite(values)):
        row = int(np.argmin(np.all(np.isfinite(values), axis=1)))
        raise InvalidInput(
            f"The {what} is not finite.", f"got {values[row]} at t = {times[row]:g} s", "finite values"
        )
    return values


def sample_disturbance(
    signal: SignalLike,
    period: float,
    samples: int,
    parts: int,
    channels: Sequence[str],
    room: int | None = None,
) -> np.ndarray:
    """Values at the start, middle and end of every sub-step, (samples, room, 3, channels); zero beyond the last one.

    `parts` are the sub-steps of a sample, and `room` those that there is room for, so many by default; the period is in
    s. Refused is what `sample_signal` refuses, and what would be too many numbers.
    """
    count, room = samples * parts * 3, parts if room is None else room
    refuse_if(
        count * max(1, len(channels)) > MOST_NUMBERS,
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
    times, disturbance = times.ravel(), np.zeros((samples, room, 3, len(channels)))
    named = _by_channel(signal)
    if named is None or set(named) - set(channels):
        values = sample_signal(signal, times, channels, "disturbance")
        disturbance[:, :parts] = values.reshape(samples, parts, 3, len(channels))
        return disturbance
    for name, part in named.items():  # one channel at a time: all of them are 0.2 GB for 5 s of seven links
        values = sample_signal(part, times, [name], "disturbance")
        disturbance[:, :parts, :, tuple(channels).index(name)] = values.reshape(samples, parts, 3)
    return disturbance


def sample_noise(
    noise: Numbers, seed: int, samples: int, channels: Sequence[str], sample: int = 0
) -> np.ndarray:
    """Measurement noise (samples, channels); `noise` is the standard deviation, one number or one each; `sample` is the
    plant of a campaign, below 2³²; see `flexhinf.codegen.noise`.

    Refused are a deviation that is negative, not finite or of another size, and a seed that is no integer in
    0 … 2⁶⁴ − 1.
    """
    check_seed(seed)
    if noise is None:
        return np.zeros((samples, len(channels)))
    return white_noise(np.ascontiguousarray(checked_deviation(noise, channels)), seed, samples, sample)


def white_noise(deviation: np.ndarray, seed: int, samples: int, sample: int = 0) -> np.ndarray:
    """As `sample_noise`, of deviations (p,) and a seed that are checked."""
    blocks, width = -(-samples // BLOCK), len(deviation)
    if not width:
        return np.zeros((samples, 0))
    numbers = np.empty((blocks * width, BLOCK))
    key, step = np.array([sample, *seed_key(int(seed))], dtype=float), np.arange(float(BLOCK))
    arrays = {"step": step[None, :], "key": key, "deviation": deviation, "noise": numbers}
    noise_kernel(width).run(arrays, {"blocks": blocks})
    return numbers.reshape(blocks, width, BLOCK).transpose(0, 2, 1).reshape(-1, width)[:samples]


def check_seed(seed: object) -> None:
    """Refuse a seed that is no integer in 0 … 2⁶⁴ − 1."""
    if (
        isinstance(seed, bool)
        or not isinstance(seed, (int, np.integer))
        or not 0 <= int(cast(int, seed)) < 2**64
    ):
        raise InvalidInput(
            "The seed is not usable.",
            f"expected 0 <= integer < 2**64, got {value_text(cast(object, seed))}",
            "seed=0",
        )


def checked_deviation(noise: ArrayLike, channels: Sequence[str]) -> np.ndarray:
    """The standard deviation of each channel's noise, (p,); one that is negative, not finite or of another size is
    refused."""
    deviation = real_array(noise)
    if deviation.shape not in ((), (len(channels),)) or not all(0.0 <= d < np.inf for d in deviation.flat):
        raise InvalidInput(  # the text of an array takes longer than a short run
            "The measurement noise does not fit the measurements.",
            f"expected one standard deviation >= 0 or one for each of {list(channels)}, got {value_text(noise)}",
            "noise=1e-3, a standard deviation in the unit of the measurement (not a variance)",
        )
    return np.broadcast_to(deviation, len(channels))
