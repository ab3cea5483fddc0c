"""A protective stop: whether the output of a controller may act, and what acts until the robot rests.

The decision is latched: a reason that was there once stays until the controller is started anew. What follows is a stop
category of IEC 60204-1 [iec60204]: 0, the drives lose their power at once, and brakes close; 1, a controlled stop, then
the same; 2, a controlled stop, after which the drives keep their power.

A controlled stop does not trust the estimate, which may be what failed. Drives of torques, currents and voltages get
the input that holds the commanded pose, less a damping of the speeds of those sensors that are still believed. A
command of positions goes on, slower and slower, for some 30 ms; one of velocities falls to 0 likewise. The stop ends at
rest, after
`LONGEST`, or at once where a joint becomes faster, as one does whose drive is reversed: then the power goes.
"""

from __future__ import annotations

import enum
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from flexhinf.arrays import Element, Elements, Vector
from flexhinf.loop.controller.protection import STOPS
from flexhinf.loop.controller.readings import Readings
from flexhinf.loop.controller.signs import SIGNS
from flexhinf.scalars import absolute, clip, maximum, minimum, where

#: Longest controlled stop, and how long joints must stand before it ends, s; time after which it must have made them
#: slower, s.
LONGEST, STANDS, SOON = 1.0, 0.05, 0.05

#: Speed of a joint that stands, in parts of the largest one, which is taken for this one at most, rad/s or m/s.
STANDING, UNSTATED = 0.02, 2.0

#: Time constant of a command of positions or velocities that ends, s.
ENDING = 0.03


class Stop(enum.IntFlag):
    """Reasons of a protective stop, in the order of their bits; the exported C has the same numbers."""

    WRONG_PERIOD = 1
    STEP_FAILED = 2
    BAD_START = 4
    SENSOR_LOST = 8
    INCONSISTENT = 16
    RUNNING_AWAY = 32
    TOO_FAST = 64
    OPPOSED = 128
    OSCILLATING = 256
    STUCK = 512

    def __str__(self) -> str:
        """What each reason says; `format` and the exported C have the number."""
        return (
            "; ".join(text for name, text in STOPS.items() if Stop[name.upper()] in self)
            or "nothing stops it"
        )


#: Codes of a step that cannot go on, by their names in exported C.
FAILED = ("NOT_INITIALISED", "BAD_ARITHMETIC", "BAD_START", "STOPPED", "WENT_BACK")


class StopNumbers(NamedTuple):
    """Numbers of a protective stop: the period, s, limits of the inputs (m,), input per speed (m,), and speeds of
    joints that stand (m,)."""

    period: Element
    lower: Elements
    upper: Elements
    damping: Elements
    rest: Elements


class StopState(NamedTuple):
    """What a protective stop remembers: `reasons` (r,), 1 or 0 each in the order of `Stop`; `power`, whether drives may
    have it, `samples` since the stop began, and those for which all joints have been `standing`, (1,) each; of each
    input (m,) its `last` value, the `base` of a controlled stop, the `rate` of that per sample, and the `pace` of what
    it moves when the stop began."""

    reasons: Elements
    power: Elements
    samples: Elements
    standing: Elements
    last: Elements
    base: Elements
    rate: Elements
    pace: Elements


def first_stop(u: Vector) -> StopState:
    """Before a stop, with the input before the first sample (m,)."""
    none = 0.0 * u
    return StopState(np.zeros(len(Stop)), np.ones(1), np.zeros(1), np.zeros(1), u, none, none, none)


def decided(
    drive: str,
    kept: StopState,
    flags: Elements,
    u: Elements,
    hold: Elements,
    speeds: Elements,
    category: Element,
    numbers: StopNumbers,
) -> tuple[Elements, StopState]:
    """The input that acts (m,), and what is remembered.

    `flags` (r,) are the reasons of this sample that count, 1 or 0; u (m,) is what the controller gives, `hold` what
    holds the robot at its command; `speeds` (m,) are those of what the inputs move, 0 of one that is not believed.
    `drive` says what the inputs are: "torque", "velocity" or "position".
    """
    period, lower, upper, damping, rest = numbers
    before = reduce(maximum, kept.reasons)
    reasons = _chosen(before, kept.reasons, flags)
    stops = reduce(maximum, reasons)
    begins = stops * (1.0 - before)
    size, left = absolute(np.asarray(speeds)), np.exp(-period / ENDING)
    samples = stops * (kept.samples[0] + 1.0)
    pace = _chosen(begins, size, kept.pace)
    rate = _chosen(begins, u - kept.last, left * kept.rate)
    base = _chosen(begins, hold if drive == "torque" else kept.last, kept.base)
    base = base + rate if drive == "position" else left * base if drive == "velocity" else base
    stands = reduce(minimum, [where(v > r, 0.0, 1.0) for v, r in zip(size, rest)])
    standing = stops * stands * (kept.standing[0] + 1.0)
    faster = reduce(maximum, [where(v > p + r, 1.0, 0.0) for v, p, r in zip(size, pace, rest)])
    faster = where(samples * period > SOON, faster, 0.0)
    over = where(standing * period > STANDS, 1.0, where(samples * period > LONGEST, 1.0, 0.0))
    ends = where(category < 0.5, 1.0, where(category < 1.5, maximum(over, faster), faster))
    power = kept.power[0] * (1.0 - stops * ends)
    slowed = clip(base - damping * speeds, lower, upper)
    off = base if drive == "position" else clip(0.0 * u, lower, upper)
    acts = _chosen(stops, _chosen(power, slowed, off), u)
    after = StopState(
        reasons, np.array([power]), np.array([samples]), np.array([standing]), acts, base, rate, pace
    )
    return acts, after


def _chosen(flag: Element, those: Elements, others: Elements) -> Elements:
    """Elements of `those` where the flag is 1, else of `others`."""
    return np.array([where(flag > 0.5, a, b) for a, b in zip(those, others, strict=True)])


def stop_numbers(controller: Any) -> tuple[str, StopNumbers]:
    """What the inputs of a controller are for a stop, and its numbers."""
    protection, limits = controller.protection, controller.limits
    none = np.zeros(len(limits.lower))
    if protection is None:
        return "torque", StopNumbers(controller.period, limits.lower, limits.upper, none, none)
    fastest = dict(zip(controller.measured, protection.speed))
    rest = [STANDING * min(fastest.get(name, np.inf), UNSTATED) for name in protection.moved]
    numbers = np.array(protection.damping), np.array(rest)
    return protection.drive, StopNumbers(controller.period, limits.lower, limits.upper, *numbers)


def stop_size(inputs: int) -> int:
    """Numbers that a stop remembers, of m inputs."""
    return sum(np.size(part) for part in first_stop(np.zeros(inputs)))


def reasons(controller: Any, history: Any) -> np.ndarray:
    """Reasons for a stop after the last step (r,), 1 or 0 each, of those that count."""
    protection, found = controller.protection, np.zeros(len(Stop))
    found[0], found[1] = history.code == "BAD_PERIOD", history.code in FAILED
    if protection is not None and history.code != "WAITING":
        found[2] = history.memory[controller.memory.places["misplaced"]][0]
        found[-len(SIGNS) :] = history.memory[controller.memory.places["status"]][-len(SIGNS) :]
    counted = tuple(STOPS) if protection is None else protection.stop_on
    return np.where([name in counted for name in STOPS], found, 0.0)


def stop_speeds(controller: Any, history: Any) -> np.ndarray:
    """Speeds of what the inputs move (m,), 0 where no reading is believed that tells it."""
    watch, speeds = controller.mode.protected, np.zeros(len(controller.law.input_names))
    if watch is not None:
        kept = Readings(*controller.memory.named(history.memory).readings)
        for k, place in enumerate(watch.moved):
            if place is not None and kept.since[place] <= 1.0:
                speeds[k] = kept.speed[place] / controller.period
    return speeds
