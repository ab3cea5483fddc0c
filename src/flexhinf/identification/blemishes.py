"""What a log shows of itself before any model is blamed: dead sensors, gaps, turns that begin anew, rows far apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.identification.log import Log
from flexhinf.identification.plausibility import vibration_periods
from flexhinf.identification.quantisation import smallest_step
from flexhinf.robot import Robot

#: A gap is so many times as long as the time between most samples; a jump is this share of all that a signal spans, and
#: so many times as far as it usually moves; rows show a vibration that are at most this share of its period apart.
GAP, JUMP, FAR, SEEN = 10.0, 0.7, 20.0, 0.5

#: Rows for which a value is lost, at most.
MOMENT = 3


@dataclass(frozen=True)
class Turns:
    """Jumps of a signal from one end of a turn to the other: how many, and how far."""

    count: int
    size: float


@dataclass(frozen=True)
class Lost:
    """A value to which a signal jumps for a moment, and in how many places."""

    count: int
    value: float


@dataclass(frozen=True)
class Blemishes:
    """What is conspicuous in a log.

    `dead`: signals that never change, with their value. `gaps`: number, and the longest, s, with its time, s. `turns`:
    by signal. `lost`: values where a sensor had none, by signal. `apart`: the time between rows, and the period of the
    fastest vibration that they do not show, s.
    """

    dead: dict[str, float]
    gaps: tuple[int, float, float] | None
    turns: dict[str, Turns]
    lost: dict[str, Lost]
    apart: tuple[float, float] | None


def blemishes(robot: Robot, log: Log) -> Blemishes:
    """What is conspicuous in a log of a robot."""
    names = log.names.get("output", tuple(f"output {k + 1}" for k in range(log.outputs.shape[1])))
    columns = {name: column[np.isfinite(column)] for name, column in zip(names, log.outputs.T)}
    dead = {
        name: float(known[0]) for name, known in columns.items() if known.size > 1 and not np.ptp(known) > 0.0
    }
    jumps = {name: found for name, known in columns.items() if (found := _jumps(known)) is not None}
    turns = {name: found for name, found in jumps.items() if isinstance(found, Turns)}
    lost = {name: found for name, found in jumps.items() if isinstance(found, Lost)}
    steps, fastest = np.diff(log.times), float(vibration_periods(robot)[0])
    long = steps > GAP * np.median(steps)
    longest = int(np.argmax(steps))
    gaps = (int(long.sum()), float(steps[longest]), float(log.times[longest])) if long.any() else None
    return Blemishes(dead, gaps, turns, lost, (log.period, fastest) if log.period > SEEN * fastest else None)


def _jumps(known: np.ndarray) -> Turns | Lost | None:
    """Jumps of values (N,) by nearly all that they span, beside which they move little.

    They are lost values if each jump leads to one and the same value, which no turn of an encoder does, and the next
    jump back after `MOMENT` rows at most.
    """
    if known.size < 3:
        return None
    moves = np.abs(np.diff(known))
    step = smallest_step(known)  # a sensor at rest changes by one
    far = moves > max(JUMP * float(np.ptp(known)), FAR * max(float(np.median(moves)), step), 1e-9)
    if not far.any():
        return None
    places, size = np.flatnonzero(far), float(np.median(moves[far]))
    there, back = places[::2], places[1::2]
    if len(there) == len(back) and (back - there <= MOMENT).all():
        away = np.concatenate([known[a + 1 : b + 1] for a, b in zip(there, back)])
        if np.ptp(away) == 0.0 and not abs(size - 2.0 * np.pi) < 0.1 * 2.0 * np.pi:
            return Lost(len(there), float(away[0]))
    return Turns(len(places), size)
