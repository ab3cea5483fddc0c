"""Decisions about the output, for the rehearsal of the contract: protective stops, with what must come of them.

A stop is decided from what was remembered of it before. Such memories are drawn, at the scales that its numbers are
compared at, and what comes of them is computed in Python. Before a start, readings are judged one by one: each set is
the robot at rest with one reading moved, just within what is accepted and just beyond.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.loop.controller.readings import Readings
from flexhinf.loop.controller.signs import PAUSES, SIGNS
from flexhinf.loop.controller.slowing import masses_of
from flexhinf.loop.controller.stop import (
    AVERAGED,
    EARLY,
    FAILED,
    LEFT,
    LONGEST,
    SLOWS,
    SOON,
    STANDS,
    StopState,
    first_stop,
)
from flexhinf.stops import Stop

if TYPE_CHECKING:
    from flexhinf.arrays import Vector
    from flexhinf.export.controller_c import ControllerCode

#: Numbers of all decisions together, the fewest and the most of these, and how many are drawn for each; the seed.
ROOM, FEWEST, MOST, CANDIDATES, SEED = 8000, 24, 96, 6, 20261130

#: By how many units of the last place a memory is moved to see whether rounding could decide, and by how many, relative
#: to 1 and each number, what comes of it may move.
MOVED, STEADY = 4.0, 100.0

#: How often a reason is there beside another one.
OFTEN = 0.3

#: Readings before a start are moved by these shares of what is accepted.
BESIDE = (-1.1, -0.9, 0.9, 1.1)


@dataclass(frozen=True)
class Decision:
    """What was remembered of a stop (s,), the input of the step (m,), readings, reasons, and the category; then whether
    the drives have power, the input that acts (m,), and what is remembered."""

    before: Vector
    u: Vector
    readings: Vector
    reasons: int
    category: int
    power: int
    acts: Vector
    after: Vector


@dataclass(frozen=True)
class Beginning:
    """Readings before a start (p,), whether those of the robot at rest were looked at before, and what speaks against
    them."""

    y: Vector
    looked: int
    why: int


def stop_values(code: ControllerCode) -> dict[str, Any]:
    """What the rehearsal of stops and starts consists of."""
    c, protected = code.controller, code.controller.protection is not None
    kept, starting = c.memory.places, code.stop.starting
    status, readings = kept.get("status", slice(0, 0)), kept.get("readings", slice(0, 0))
    return {
        "decisions": _decisions(code),
        "reason_of": [(code.upper(name), _reason(name)) for name in code.codes],
        "reasons": list(Stop),
        "signs": len(SIGNS),
        "checkable": code.stop.is_checkable,
        "start_twists": bool(_twists(code)),
        "signs_at": status.stop - len(SIGNS) if protected else None,
        "misplaced_at": kept["misplaced"].start if protected else None,
        "pauses_at": kept["pauses"].start if protected else None,
        "most_pauses": PAUSES,
        "readings": readings,
        "looks": starting["samples"],
        "beginnings": _beginnings(code) if protected else [],
    }


def _reason(name: str) -> int:
    """The bit of the reason that a code is."""
    if name == "BAD_PERIOD":
        return int(Stop.WRONG_PERIOD)
    return int(Stop.STEP_FAILED) if name in FAILED else 0


# Stops ------------------------------------------------------------------------------------------------
def _decisions(code: ControllerCode) -> list[Decision]:
    """Some of those that are drawn, no two alike in what decides, if there are enough."""
    rng = np.random.default_rng(SEED)
    draw = _Draw(code, rng)
    width = 2 * draw.size + 2 * code.sizes["u"] + draw.count
    most = int(np.clip(ROOM // width, FEWEST, MOST))
    found: dict[tuple[int, ...], list[Decision]] = {}
    for k in range(CANDIDATES * most):
        before, u, readings, reasons, category = draw.one(k)
        acts, after = draw.decided(before, u, readings, reasons, category)
        own, moved = np.concatenate([acts, after]), MOVED * code.real.epsilon
        signs = (np.ones(draw.size), -np.ones(draw.size), rng.choice([-1.0, 1.0], draw.size))
        away = [
            np.abs(
                np.concatenate(draw.decided((1.0 + moved * sign) * before, u, readings, reasons, category))
                - own
            )
            for sign in signs
        ]
        if np.all(np.array(away) <= STEADY * code.real.epsilon * (1.0 + np.abs(own))):
            power = int(after[len(Stop)] > 0.0)
            one = Decision(before, u, readings, reasons, category, power, acts, after)
            begins = int(not before[: len(Stop)].any() and reasons > 0)
            key = begins, category, power, int(before[len(Stop)] > 0.0), int(after[: len(Stop)].any())
            found.setdefault(key, []).append(one)
    ordered = [one for k in range(most) for row in found.values() for one in row[k : k + 1]]
    return ordered[:most]


class _Draw:
    """What is drawn for the decisions of a controller."""

    def __init__(self, code: ControllerCode, rng: np.random.Generator) -> None:
        self.code, self.rng, self.m = code, rng, code.sizes["u"]
        c = code.controller
        self.period, self.kind = c.period, code.real.kind
        first = first_stop(np.asarray(c.input_before()))
        self.ends = np.cumsum([np.size(part) for part in first])
        self.size = int(self.ends[-1])
        place = c.memory.places.get("readings", slice(0, 0))
        self.count = place.stop - place.start
        slow = np.asarray(masses_of(c).rest, dtype=float)
        self.speed = np.where(slow > 0.0, 10.0 * slow, 1.0)
        limits = c.limits
        low, high = np.asarray(limits.lower, dtype=float), np.asarray(limits.upper, dtype=float)
        self.low, self.high = np.where(np.isfinite(low), low, -1.0), np.where(np.isfinite(high), high, 1.0)
        self.numbers = code.defaults.astype(self.kind).astype(float)
        self.hold = self._hold()

    def _hold(self) -> Vector | None:
        """What holds the robot at the command of the start, if the model tells."""
        code = self.code
        if not code.rests or code.standstill is None:
            return None
        assert code.controller.estimator is not None
        q = code.initial_memory[code.controller.memory.places["reference"]][: code.standstill.size1_in(0)]
        model = np.asarray(code.controller.estimator.plant.parameters.vector(), dtype=float)
        found = code.standstill.call([q.astype(self.kind).astype(float), model])
        return np.concatenate([np.asarray(one.full()).ravel() for one in found])[code.sizes["estimate"] :]

    def one(self, k: int) -> tuple[Vector, Vector, Vector, int, int]:
        """A memory, an input, readings, reasons, and a category: number `k`, whose reasons are those of its turn."""
        rng, m = self.rng, self.m
        runs = rng.random() < 0.5
        reasons = np.zeros(len(Stop))
        if runs:
            reasons[rng.random(len(Stop)) < OFTEN] = 1.0
            reasons[k % len(Stop)] = 1.0
        reasons *= [bit in self.code.stop.reasons for bit in Stop]
        runs = bool(reasons.any())
        speeds = self.speed * 10.0 ** rng.uniform(-3.0, 1.0)
        inputs, middle = self.high - self.low, 0.5 * (self.high + self.low)

        def signed(size: Vector) -> Vector:
            return size * rng.uniform(-1.0, 1.0, np.size(size))

        first, motor = np.abs(signed(speeds)), signed(speeds)
        mean = np.abs(signed(speeds))
        if rng.random() < 0.5:  # beside what is left of the first speed, and staying there
            mean = LEFT * rng.choice([0.9, 1.1, 3.0]) * first
            motor = np.sign(motor) * mean
        parts = StopState(
            reasons, np.array([float(not runs or rng.random() < 0.8)]), *self._counts(),
            middle + signed(inputs), middle + signed(inputs), signed(0.1 * inputs),
            mean, first, np.abs(signed(speeds)), signed(speeds), signed(speeds),
            motor, signed(speeds), signed(speeds * self.period * 10.0),
            signed(np.tile(speeds, 2)), rng.integers(0, 2, 2 * m).astype(float),
        )  # fmt: skip
        before, u = self._rounded(np.concatenate(parts)), self._rounded(rng.uniform(self.low, self.high))
        return before, u, self._readings(), self._reasons(k, runs), int(rng.integers(3))

    def _counts(self) -> tuple[Vector, Vector]:
        """Samples since a stop began, and of standing joints, near what they are compared with."""
        times = [0.0, AVERAGED, SOON, EARLY, SLOWS, 2.0 * SLOWS, LONGEST]
        since = max(0.0, round(self.rng.choice(times) / self.period) + self.rng.integers(-2, 3))
        stands = max(0.0, round(self.rng.choice([0.0, STANDS]) / self.period) + self.rng.integers(-2, 3))
        return np.array([since]), np.array([stands])

    def _readings(self) -> Vector:
        """What is remembered of the sensors."""
        rng = self.rng
        table = rng.uniform(-1.0, 1.0, (len(Readings._fields), self.count // len(Readings._fields)))
        speed = float(np.max(self.speed)) * self.period * 10.0 ** rng.uniform(-3.0, 1.0)
        fields = Readings(*(speed * table))._asdict()
        fields["since"] = np.asarray(rng.integers(0, 3, table.shape[1]), dtype=float)
        return self._rounded(np.concatenate(list(fields.values()))) if self.count else np.zeros(0)

    def _reasons(self, k: int, runs: bool) -> int:
        """Reasons of this sample, which the C can be given, or none: a code is one of the first two alone."""
        known = self.code.stop.reasons
        if self.rng.random() < (0.5 if runs else 0.2):
            return 0
        others = [bit for bit in known[2:] if self.rng.random() < OFTEN]
        return int(sum({known[k // 2 % len(known)], *others}))

    def _rounded(self, numbers: Vector) -> Vector:
        return np.asarray(numbers, dtype=self.kind).astype(float)

    def decided(
        self, before: Vector, u: Vector, readings: Vector, reasons: int, category: int
    ) -> tuple[Vector, Vector]:
        """The input that acts, and what is remembered."""
        flags = np.array([float(bool(reasons & bit)) for bit in Stop])
        last = before[self.ends[3] : self.ends[4]]
        hold = last if self.hold is None or not reasons else self.hold
        table = readings if self.count else np.zeros(1)
        found = self.code.stop.deciding.call(
            [before, flags, u, hold, table, np.array([float(category)]), self.numbers]
        )
        acts, after = (np.asarray(one.full()).ravel() for one in found)
        return acts, after


# Starts -----------------------------------------------------------------------------------------------
#: Bits of what speaks against a start, as the header has them.
MOVES, OUT_OF_RANGE, TWISTED = 2, 4, 8


def _beginnings(code: ControllerCode) -> list[Beginning]:
    """The robot at rest, and with each reading moved alone: after a first look by shares of what it may move, out of
    its range, and by shares of the twist that a spring may have."""
    c, protection = code.controller, code.controller.protection
    assert protection is not None
    assert c.estimator is not None
    standing, twists = _standing(code), _twists(code)
    data = c.data.named(code.defaults)
    low, high = np.asarray(data.measurement_lower), np.asarray(data.measurement_upper)
    rows = [(standing, 0), (standing, 1)]
    for i, moved in enumerate(protection.moved_at_start):
        own = np.arange(len(standing)) == i
        moves = [(standing + share * moved * own, 1) for share in BESIDE if np.isfinite(moved)]
        ends = [(end, side) for end, side in ((low[i], -1.0), (high[i], 1.0)) if np.isfinite(end)]
        moves += [(np.where(own, end + side * (1e-3 + 1e-3 * abs(end)), standing), 0) for end, side in ends]
        rows += moves
    for motor, most, _ in twists:
        own = np.arange(len(standing)) == motor
        rows += [(standing + share * most * own, 0) for share in BESIDE]
    rows = [(np.asarray(y, dtype=code.real.kind).astype(float), looked) for y, looked in rows]

    def why(y: Vector, looked: int) -> int:
        found = OUT_OF_RANGE * bool(np.any((y < low) | (y > high)))
        found += MOVES * bool(looked and np.any(np.abs(y - rows[0][0]) > protection.moved_at_start))
        at = _standing(code, y)
        twisted = [(y - at)[motor] - sum(s * (y - at)[link] for s, link in own) for motor, _, own in twists]
        return found + TWISTED * any(abs(one) > most for one, (_, most, _) in zip(twisted, twists))

    return [Beginning(y, looked, why(y, looked)) for y, looked in rows]


def _standing(code: ControllerCode, y: Vector | None = None) -> Vector:
    """Measurements (p,) of the robot at rest where the controller begins, or where the links of others are."""
    c, protection = code.controller, code.controller.protection
    assert c.estimator is not None
    assert code.belief is not None
    assert protection is not None
    plant, x, u = c.estimator.plant, code.belief, np.asarray(code.safe_input)
    model = np.asarray(plant.parameters.vector(), dtype=float)
    if code.standstill is not None:
        links = [c.measured.index(name) for name in protection.links]
        q = x[: code.standstill.size1_in(0)] if y is None or not links else y[links]
        row = np.concatenate([np.asarray(one.full()).ravel() for one in code.standstill.call([q, model])])
        x, u = row[: len(x)], row[len(x) :]
    return np.array([float(one) for one in plant.evaluate_output(x, u, model)])


def _twists(code: ControllerCode) -> list[tuple[int, float, list[tuple[float, int]]]]:
    """Of each spring whose twist two encoders tell the place of the motor's, the most that it may differ at rest, and
    shares and places of the links'."""
    protection, watch = code.controller.protection, code.controller.mode.protected
    if protection is None or watch is None or code.standstill is None or not protection.links:
        return []
    return [
        (
            pair.motor,
            protection.twist_at_start[j],
            [(protection.shares[row][j], place) for place, row in pair.links],
        )
        for j, pair in enumerate(watch.pairs)
    ]
