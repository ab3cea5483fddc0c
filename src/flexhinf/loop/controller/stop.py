"""A protective stop: whether the output of a controller may act, and what acts until the robot rests.

The decision is latched: a reason that was there once stays until the controller is started anew. What follows is a stop
category of IEC 60204-1 [iec60204]: 0, the drives lose their power at once, and brakes close; 1, a controlled stop, then
the same; 2, a controlled stop, after which the drives keep their power.

A controlled stop does not trust the estimate, which may be what failed. Drives of torques, currents and voltages get
the input that holds the commanded pose, less a damping of the motors' speeds, `flexhinf.loop.controller.slowing`, and
of the ways since the stop began. A command of positions goes on, slower and slower, for some 30 ms; one of velocities
falls to 0 likewise. The stop ends at rest or after `LONGEST`. It ends at once, and the power goes, where a joint
becomes faster or does not do what the input should make of it: then the drive is what failed.
"""

from __future__ import annotations

from functools import reduce
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from flexhinf.arrays import Element, Elements, Vector
from flexhinf.loop.controller.protection import LONGEST_UNSEEN
from flexhinf.loop.controller.readings import Readings
from flexhinf.loop.controller.signs import PAUSES, SIGNS
from flexhinf.loop.controller.slowing import Masses, Moving, Voters, first_moving, masses_of, moved, voters_of
from flexhinf.scalars import absolute, clip, maximum, minimum, trace, where
from flexhinf.stops import STOPS, Stop

if TYPE_CHECKING:
    import casadi as ca

#: Longest controlled stop, and how long joints must stand before it ends, s; time after which it must have made them
#: slower, s.
LONGEST, STANDS, SOON = 1.0, 0.05, 0.02

#: Time over which speeds are averaged, s; how much faster than one that stands a motor may be, in times of that, beyond
#: the share of its first speed that is left: it falls within `SLOWS` s to `LEFT`.
AVERAGED, FASTER, SLOWS, LEFT = 0.02, 5.0, 0.1, 0.3

#: Change of a joint's speed that an input should have made, as a share of the speed when the stop began, from which on
#: it is judged, the share of it that must be there, and the time from which on weight may have made more of it, s.
JUDGED, DONE, EARLY = 0.25, 0.3, 0.03

#: Time after which a link no longer swings on its spring, s.
RINGS = 0.2

#: Part of the rate at which a controlled stop slows a joint down, with which it goes back where the stop began.
HOLDING = 0.125

#: Time constant of a command of positions or velocities that ends, s.
ENDING = 0.03


#: Codes of a step that cannot go on, by their names in exported C.
FAILED = ("NOT_INITIALISED", "BAD_ARITHMETIC", "BAD_START", "STOPPED", "WENT_BACK")


class StopNumbers(NamedTuple):
    """Numbers of a protective stop: limits of the inputs (m,), input per speed (m,), and those of the masses."""

    lower: Elements
    upper: Elements
    damping: Elements
    masses: Masses


class StopState(NamedTuple):
    """What a protective stop remembers: `reasons` (r,), 1 or 0 each in the order of `Stop`; `power`, whether drives may
    have it, `samples` since the stop began, and those for which all joints have been `standing`, (1,) each; of each
    input (m,) its `last` value, the `base` of a controlled stop, its `rate` per sample, the mean speed of the motor
    (`motor_mean`), that when the stop began (`first`), and the mean speed of the link (`swing`), the speed of motor and
    link together then (`whole`), and what inputs should have made of that (`impulse`); behind these the elements of
    `Moving`."""

    reasons: Elements
    power: Elements
    samples: Elements
    standing: Elements
    last: Elements
    base: Elements
    rate: Elements
    motor_mean: Elements
    first: Elements
    swing: Elements
    whole: Elements
    impulse: Elements
    motor: Elements
    link: Elements
    twist: Elements
    seen: Elements
    there: Elements

    @property
    def moving(self) -> Moving:
        """The motion."""
        return Moving(*self[-len(Moving._fields) :])


def first_stop(u: Vector) -> StopState:
    """Before a stop, with the input before the first sample (m,)."""
    alone = np.zeros(len(Stop)), np.ones(1), np.zeros(1), np.zeros(1)
    return StopState(*[*alone, u, *[0.0 * u] * 7, *first_moving(len(u))])


def decided(
    drive: str,
    kept: StopState,
    flags: Elements,
    u: Elements,
    hold: Elements,
    readings: Elements | None,
    voters: Voters,
    category: Element,
    numbers: StopNumbers,
) -> tuple[Elements, StopState]:
    """The input that acts (m,), and what is remembered.

    `flags` (r,) are the reasons of this sample that count, 1 or 0; u (m,) is what the controller gives, `hold` what
    holds the robot at its command; `readings` are those of `flexhinf.loop.controller.readings.Readings`. `drive` says
    what the inputs are: "torque", "velocity" or "position".
    """
    lower, upper, damping, masses = numbers
    period, share = masses.period, masses.share
    before = reduce(maximum, kept.reasons)
    reasons = _chosen(before, kept.reasons, flags)
    stops = reduce(maximum, reasons)
    begins, push = stops * (1.0 - before), before * (kept.last - kept.base)
    moving = kept.moving
    if readings is not None:  # a step that computed nothing looked at none
        looked = 1.0 - maximum(flags[0], flags[1])
        moving = moved(moving, readings, voters, masses, before, push, looked)
    samples = stops * (kept.samples[0] + 1.0)
    new = 1.0 - np.exp(-period / AVERAGED)
    motor_mean = kept.motor_mean + new * (absolute(moving.motor) - kept.motor_mean)
    swing = kept.swing + new * (absolute(moving.link) - kept.swing)
    first = _chosen(begins, motor_mean, kept.first)
    body = share * moving.motor + (1.0 - share) * moving.link
    whole = _chosen(begins, body, kept.whole)
    impulse = stops * (kept.impulse + period * share * masses.response * push)
    ends, standing = _ends(
        kept, motor_mean, swing, first, body - whole, impulse, samples, stops, category, numbers, reasons[0]
    )
    power = kept.power[0] * (1.0 - stops * ends)
    base, rate = _base(drive, kept, u, hold, moving, stops, begins, numbers)
    slowed = clip(base - damping * moving.motor, lower, upper)
    off = base if drive == "position" else clip(0.0 * u, lower, upper)
    acts = _chosen(stops, _chosen(power, slowed, off), u)
    parts = np.array([power]), np.array([samples]), np.array([standing])
    return acts, StopState(
        reasons, *parts, acts, base, rate, motor_mean, first, swing, whole, impulse, *moving
    )


def _ends(
    kept: StopState, motor_mean: Elements, swing: Elements, first: Elements, gained: Elements, impulse: Elements,
    samples: Element, stops: Element, category: Element, numbers: StopNumbers, blind: Element,
) -> tuple[Element, Element]:  # fmt: skip
    """Whether the power goes, 1 or 0, and for how many samples all joints have been standing: at rest, after the
    longest time, and at once where a joint is faster, or inputs should have made more than the change of its speed
    that is `gained`,
    or a link goes on whose motor is said to stand, or a loop is `blind` that does not keep its period."""
    rest, period = numbers.masses.rest, numbers.masses.period
    stands = reduce(minimum, [where(maximum(w, v) > r, 0.0, 1.0) for w, v, r in zip(motor_mean, swing, rest)])
    standing = stops * stands * (kept.standing[0] + 1.0)
    left = maximum(1.0 - samples * period / SLOWS, LEFT)
    faster = [where(w > left * most + FASTER * r, 1.0, 0.0) for w, most, r in zip(motor_mean, first, rest)]
    judged = JUDGED * first + FASTER * rest
    fails = [
        where(absolute(g) > j, where(done * g > DONE * g * g, 0.0, 1.0), 0.0)
        for g, j, done in zip(impulse, judged, gained)
    ]
    apart = [
        where(v > w + left * most + FASTER * r, 1.0, 0.0)
        for w, v, most, r in zip(motor_mean, swing, first, rest)
    ]
    broken = reduce(
        maximum,
        [
            *_when(samples * period > SOON, faster),
            *_when(samples * period < EARLY, fails),
            *_when(samples * period > RINGS, apart),
        ],
    )
    over = where(standing * period > STANDS, 1.0, where(samples * period > LONGEST, 1.0, 0.0))
    ends = where(category < 0.5, 1.0, where(category < 1.5, maximum(over, broken), broken))
    return maximum(ends, blind), standing


def _when(when: Element, flags: list[Element]) -> list[Element]:
    """Flags where a condition holds, else 0."""
    return [where(when, flag, 0.0) for flag in flags]


def _base(
    drive: str, kept: StopState, u: Elements, hold: Elements, moving: Moving, stops: Element, begins: Element,
    numbers: StopNumbers,
) -> tuple[Elements, Elements]:  # fmt: skip
    """What the inputs of a controlled stop are without damping (m,), and how they change (m,)."""
    masses = numbers.masses
    left = np.exp(-masses.period / ENDING)
    rate = _chosen(begins, u - kept.last, left * kept.rate)
    if drive == "position":
        return _chosen(begins, kept.last, kept.base) + rate, rate
    if drive == "velocity":
        return left * _chosen(begins, kept.last, kept.base), rate
    slows = numbers.damping * masses.share * masses.response
    seen = moving.there[: len(moving.motor)]
    back = stops * (1.0 - begins) * masses.period * HOLDING * slows * numbers.damping * seen
    return clip(_chosen(begins, hold, kept.base) - back * moving.motor, numbers.lower, numbers.upper), rate


def _chosen(flag: Element, those: Elements, others: Elements) -> Elements:
    """Elements of `those` where the flag is 1, else of `others`."""
    return np.array([where(flag > 0.5, a, b) for a, b in zip(those, others, strict=True)])


def stop_numbers(controller: Any) -> tuple[str, StopNumbers]:
    """What the inputs of a controller are for a stop, and its numbers."""
    protection, limits, masses = controller.protection, controller.limits, masses_of(controller)
    damping = np.zeros(len(limits.lower)) if protection is None else np.array(protection.damping)
    drive = "torque" if protection is None else protection.drive
    return drive, StopNumbers(limits.lower, limits.upper, damping, masses)


def stop_size(inputs: int) -> int:
    """Numbers that a stop remembers, of m inputs."""
    return sum(np.size(part) for part in first_stop(np.zeros(inputs)))


def possible_stops(controller: Any) -> tuple[Stop, ...]:
    """Reasons that may stop the robot."""
    return tuple(Stop) if controller.protection else (Stop.WRONG_PERIOD, Stop.STEP_FAILED, Stop.SENSOR_LOST)


def decision(controller: Any) -> ca.Function:
    """(kept, flags, u, hold, readings, category, data) → (acts, kept) of `decided`, with what a stop remembers in one
    vector, as a CasADi function: the same for a controller in Python and for exported C."""
    c, (drive, numbers), voters = controller, stop_numbers(controller), voters_of(controller)
    m, able = len(c.law.input_names), possible_stops(controller)
    readings = c.memory.places.get("readings", slice(0, 1))

    def decide(kept: Elements, *others: Elements) -> tuple[Elements, Elements]:
        flags, u, hold, read, category, data = others
        table = np.reshape(read, (len(Readings._fields), -1)) if c.protection else None
        limits = c.data.named(data)
        now, parts = numbers._replace(lower=limits.lower, upper=limits.upper), stop_state(kept, m)
        before, flags = (
            np.array([flag if bit in able else 0.0 for bit, flag in zip(Stop, row)])
            for row in (parts.reasons, flags)
        )
        parts = parts._replace(reasons=before)
        acts, after = decided(drive, parts, flags, u, hold, table, voters, category[0], now)
        return acts, np.concatenate(after)

    shapes = (stop_size(m), len(Stop), m, m, readings.stop - readings.start, 1, c.data.size)
    return trace(decide, *shapes, name="decided")


def stop_state(kept: Elements, inputs: int) -> StopState:
    """What a stop of m inputs remembers, of one vector."""
    ends = np.cumsum([np.size(part) for part in first_stop(np.zeros(inputs))]).tolist()
    return StopState(*(kept[begin:end] for begin, end in pairwise((0, *ends))))


def reasons(controller: Any, history: Any) -> np.ndarray:
    """Reasons for a stop after the last step (r,), 1 or 0 each, of those that count."""
    protection, found = controller.protection, np.zeros(len(Stop))
    found[0], found[1] = history.code == "BAD_PERIOD", history.code in FAILED
    if protection is None and history.code != "WAITING":
        found[list(STOPS).index("sensor_lost")] = max(history.unseen, default=0) > LONGEST_UNSEEN
    if protection is not None and history.code != "WAITING":
        found[0] = max(found[0], history.memory[controller.memory.places["pauses"]][0] > PAUSES)
        found[2] = history.memory[controller.memory.places["misplaced"]][0]
        found[-len(SIGNS) :] = history.memory[controller.memory.places["status"]][-len(SIGNS) :]
    counted = tuple(STOPS) if protection is None else protection.stop_on
    return np.where([name in counted for name in STOPS], found, 0.0)
