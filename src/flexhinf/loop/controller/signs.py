"""Signs that a joint no longer moves as a robot within its tolerances can: what ends in a protective stop.

The estimate explains whatever is measured, a broken sensor too. So these signs are taken from the readings themselves,
with a few numbers of each joint in place of the whole model, and each lasts for some ms before it counts:

- *Inconsistent.* Encoders on both sides of a spring, or one and a sensor of its torque, tell the torque τ_s that the
  spring has. Then the motor moves by J θ̈ = k_u u − B θ̇ − k_p θ − τ_s, whatever is done to the link: a push, a
  payload, an obstacle. An observer of the motor [luenberger1964] follows the encoder; the acceleration ρ that it lacks
  is compared with what robots at the ends of their tolerances lack there, Σ_i |∂θ̈/∂p_i| δp_i, and a floor of dry
  friction, offsets and noise; of a drive with a loop of its own also with what that wants beyond its limit. A drive
  that is dead, reversed or full on, an encoder that jumps, sticks or drifts, a spring that is broken are larger.
- *Running away.* A joint is far from its command, and went there by itself: its own way away from it is summed while it
  is beyond `distance`. A command that leaves a held joint, and a joint that comes back, sum nothing. Beyond `travel` it
  runs away; where the model does not explain what drives it, beyond `distance` already.
- *Too fast.* The speed of a sensor, `flexhinf.loop.controller.readings`, is beyond a limit.
- *Opposed.* An input is at its limit against the motion, which does not slow down.
- *Oscillating.* An input swings by most of its range again and again, or by more each time. Dry friction makes small
  slow swings (a limit cycle), which are reported alone.
- *Stuck.* The encoder of a motor gives one value, though it moved so fast that its motor could not have stood so soon.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import numpy as np

from flexhinf.arrays import Element, Elements, Vector
from flexhinf.codegen import gives
from flexhinf.loop.controller.readings import MOVED, Readings
from flexhinf.loop.controller.slowing import STANDING, UNSTATED
from flexhinf.plant import known, turned
from flexhinf.scalars import absolute, clip, maximum, minimum, where
from flexhinf.scalars.run import Run

#: How many times what the tolerances explain an acceleration may be: they are linearised.
MARGIN = 1.2

#: Times for which a sign must last, s: a contradiction, a way, an input at its limit, an encoder that stands.
LASTING = {"inconsistent": 0.005, "away": 0.005, "opposed": 0.02, "stuck": 0.01}

#: Share of the largest speed against an input below which that slows the motion down.
FALLS = 0.9

#: Swings of an input one after the other that are an oscillation, how much larger than the last one a swing is that
#: grows, and the longest time of one, s.
SWINGS, GROWS, LONGEST = 6.0, 1.2, 0.25

#: Long pauses of the loop that are one too many, and the time in which one is forgotten, s.
PAUSES, PAUSED = 1.25, 1.0

#: Part of the distance at which an own way begins to count that it may grow in a sample: a jump is none.
SMALL = 0.25

#: Share of a governor's resistance from which on the model does not explain what drives a joint.
DRIVEN = 0.5


class Pair(NamedTuple):
    """Two readings of a joint that tell the twist of its spring, by their places in a measurement: the motor's
    position, and those of the links that move with it, with their rows in `Protection.shares`, or one of the twist or
    its torque.
    `input`: the place of its input; `looped`: whether its drive has a loop of its own. `terms`: of each tolerance,
    which of the five rates it changes."""

    motor: int
    links: tuple[tuple[int, int], ...]
    twist: int | None
    input: int
    looped: bool
    terms: tuple[tuple[int, ...], ...]


class Observer(NamedTuple):
    """Numbers of the observers of motors, (g,) each: in a sample a speed makes a `way` and is `left`, an acceleration
    has
    `pushed` the position; `first` and `second` are the gains of position and speed, `scale` the lacking acceleration
    per lacking way, `floor` what is left out of the accelerations, `compliance` the twist per unit of the signal that
    tells it, `most` the acceleration at which a drive's own loop saturates, and `unsure` the share of what is beyond it
    that may be there."""

    way: Elements
    left: Elements
    pushed: Elements
    first: Elements
    second: Elements
    scale: Elements
    floor: Elements
    compliance: Elements
    most: Elements
    unsure: Elements


class Watch(NamedTuple):
    """Places of what is watched, which are part of a step's code: of pairs of readings, of the reading that tells the
    speed of what each input moves, and of encoders of motors that no other sensor contradicts with their inputs."""

    pairs: tuple[Pair, ...] = ()
    moved: tuple[int | None, ...] = ()
    alone: tuple[tuple[int, int], ...] = ()

    @property
    def driven(self) -> tuple[int | None, ...]:
        """The reading of what each input moves in the end: of the one link beyond its spring, else of its motor."""
        links = {pair.input: pair.links[0][0] for pair in self.pairs if len(pair.links) == 1}
        return tuple(links.get(k, place) for k, place in enumerate(self.moved))


#: Signs of a protective stop, in the order of their flags, behind whether a frame is a repeated one.
SIGNS = (
    "sensor_lost", "inconsistent", "runaway", "too_fast", "opposed", "oscillating", "stuck",
)  # fmt: skip


@gives("motion_next", "inconsistent")
def inconsistent(
    pairs: Sequence[Pair],
    turns: Sequence[int],
    y: Elements,
    u: Elements,
    readings: Elements,
    motion: Elements,
    period: Elements,
    rates: Elements,
    spreads: Elements,
    numbers: Elements,
) -> tuple[Elements, Elements]:
    """Observed motors (4, g), their positions, speeds, whether these are known (below 0: not for so many samples),
    and for how many samples a contradiction lasts; and whether there is one (1,).

    y (p,) is what is believed, u (m,) the input that acted since the last sample. `rates` (5, g) are accelerations of a
    motor per input, per position, per twist of its spring, per its speed and per that of the twist; `spreads` (G, 5, g)
    by how much these differ within tolerances that do not depend on each other. `numbers` are those of `Observer`, and
    the shares of the links (n, g). But for its own speed, what moves the motor is that of the readings, in the middle
    of the sample.
    """
    speeds, columns, flags = Readings(*readings).speed / period[0], list[list[Element]](), list[Element]()
    own, shares = Observer(*numbers[: len(Observer._fields)]), numbers[len(Observer._fields) :]
    for j, pair in enumerate(pairs):
        at, speed, is_known, count = motion[:, j]
        theta, twist, seen = _twisted(pair, turns, y, at, own.compliance[j], shares[:, j])
        unwinds, half = _unwinding(pair, speeds, own.compliance[j], shares[:, j]), 0.5 * period[0]
        parts = u[pair.input], theta - half * speed, twist - half * unwinds, speeds[pair.motor], unwinds
        ahead, turning, beside = _ahead(
            pair, at, speed, parts, rates[:, j], Observer(*(part[j] for part in own)), period[0]
        )
        goes_on = where(is_known > 0.5, seen, 0.0)
        lacking = where(goes_on > 0.5, theta - ahead, 0.0)
        rows = [(terms, row) for terms, row in zip(pair.terms, spreads) if terms]
        allowed = sum(absolute(sum(row[term, j] * parts[term] for term in terms)) for terms, row in rows)
        beyond = absolute(own.scale[j] * lacking) - MARGIN * allowed - own.floor[j] - beside
        count = where(beyond > 0.0, count + seen, maximum(count - 1.0, 0.0))
        columns.append([
            where(goes_on > 0.5, ahead + own.first[j] * lacking, theta),
            where(goes_on > 0.5, turning + own.second[j] * lacking, where(seen > 0.5, speeds[pair.motor], speed)),
            where(is_known < -0.5, is_known + 1.0, seen),
            count,
        ])  # fmt: skip
        flags.append(where(count * period[0] > LASTING["inconsistent"], 1.0, 0.0))
    return np.array(columns).T, np.array([reduce(maximum, flags)])


def _ahead(
    pair: Pair,
    at: Element,
    speed: Element,
    parts: tuple[Element, ...],
    rate: Elements,
    own: Observer,
    period: Element,
) -> tuple[Element, Element, Element]:
    """Where a motor is a sample later, how fast it is then, and by how much its acceleration is not known, where a
    drive's own loop saturates."""
    loop, rest = rate[0] * parts[0] + rate[1] * parts[1], rate[2] * parts[2] + rate[4] * parts[4]
    driven = loop + rest
    later = at + own.way * speed + own.pushed * driven, own.left * speed + own.way * driven
    if not pair.looped:
        return *later, 0.0
    wanted = loop + rate[3] * speed
    got = clip(wanted, -own.most, own.most)
    excess, full = absolute(wanted - got), at + period * (speed + 0.5 * period * (got + rest))
    here = where(excess > 0.0, full, later[0]), where(excess > 0.0, speed + period * (got + rest), later[1])
    return *here, own.unsure * excess


def _twisted(
    pair: Pair, turns: Sequence[int], y: Elements, at: Element, compliance: Element, shares: Elements
) -> tuple[Element, Element, Element]:
    """A motor's position, the twist of its spring, and whether its readings are there; `at` where they are not."""
    there, angle = known(y), [0] if pair.motor in turns else []
    places = (pair.motor, *(place for place, _ in pair.links), *(() if pair.twist is None else (pair.twist,)))
    seen = reduce(minimum, [there[place] for place in places])
    (theta,) = turned([where(seen > 0.5, y[pair.motor], at)], [at], angle)
    if pair.twist is not None:
        return theta, compliance * where(seen > 0.5, y[pair.twist], 0.0), seen
    links = sum(shares[row] * where(seen > 0.5, y[place], at) for place, row in pair.links)
    return theta, theta - turned([links], [theta], angle)[0], seen


def _unwinding(pair: Pair, speeds: Elements, compliance: Element, shares: Elements) -> Element:
    """Speed of the twist of a spring."""
    if pair.twist is not None:
        return compliance * speeds[pair.twist]
    return speeds[pair.motor] - sum(shares[row] * speeds[place] for place, row in pair.links)


@gives("away_next", "runs_away")
def runaway(
    places: Sequence[int], position: Elements, command: Elements, away: Elements, started: Elements, period: Elements,
    limits: Elements, *hold: Elements,
) -> tuple[Elements, Elements]:  # fmt: skip
    """The positions of joints, their own ways away from their commands, and for how many samples these were too long
    (3, k); and whether one runs away (1,).

    `position` (k,) is where the joints are; their commands for this instant stand in `command`, at these places;
    `limits` (2, k) are `distance` and `travel`. How a governor holds them (4, k) says what drives them beyond the
    model. A way below 0 is one that a joint has free.
    """
    columns, flags = list[list[Element]](), list[Element]()
    pushes = hold[0][1] if hold else [0.0] * len(places)
    rows = zip(position, [command[place] for place in places], pushes, *away, *limits, strict=True)
    for at, goal, push, before, way, count, distance, travel in rows:
        side = where(at > goal, 1.0, -1.0)
        step = clip(at - before, -SMALL * distance, SMALL * distance)
        way = where(started[0] > 0.5, maximum(way + side * step, minimum(way, 0.0)), 0.0)
        way = where(absolute(at - goal) > distance, way, 0.0)
        most = where(side * push > DRIVEN, minimum(distance, travel), travel)
        count = where(way > most, count + 1.0, 0.0)
        columns.append([at, way, count])
        flags.append(where(count * period[0] > LASTING["away"], 1.0, 0.0))
    return np.array(columns).T, np.array([reduce(maximum, flags)])


@gives("opposed_next", "opposed")
def opposed(
    places: Sequence[int | None], u: Elements, readings: Elements, held: Elements, lower: Elements, upper: Elements,
    swings: Elements, period: Elements, fastest: Elements,
) -> tuple[Elements, Elements]:  # fmt: skip
    """Of each input the largest speed against it while it is at its limit, and for how many samples it is (2, m);
    and whether one does not slow the motion down (1,).

    `places` are those of the readings of what the inputs move, None where nothing tells it: links, since a spring may
    carry a motor while the link that pushes it slows down. The first row of `swings` is how near an input is at its
    limit, and `fastest` (p,) are limits of the readings' speeds: what stands is not opposed. Below 0 samples, speeds
    are not known for so many.
    """
    speeds = Readings(*readings).speed / period[0]
    columns, flags = list[list[Element]](), list[Element]()
    for place, value, low, high, near, most, count in zip(places, u, lower, upper, swings[0], *held):
        push = where(value >= high - near, 1.0, where(value <= low + near, -1.0, 0.0))
        against = 0.0 if place is None else -push * speeds[place]
        stands = 0.0 if place is None else STANDING * minimum(fastest[place], UNSTATED)
        full = where(count < -0.5, count + 1.0, where(against > stands, count + 1.0, 0.0))
        most = where(full < 1.5, against, maximum(most, against))
        columns.append([most, full])
        lasts = where(full * period[0] > LASTING["opposed"], 1.0, 0.0)
        flags.append(where(against < FALLS * most, 0.0, lasts))
    return np.array(columns).T, np.array([reduce(maximum, flags)])


@gives("swung_next", "oscillates")
def oscillating(u: Elements, swung: Elements, period: Elements, sizes: Elements) -> tuple[Elements, Elements]:
    """Of each input its last extreme, the one before, the direction (±1), the samples since its last swing ended, the
    size of that, and how many large or growing ones there were in a row (6, m); and whether that is an oscillation
    (1,).

    `sizes` (2, m) are the smallest swing that counts where it grows, and the one that counts always.
    """
    columns, flags = list[list[Element]](), list[Element]()
    for value, extreme, foot, direction, since, size, count, small, large in zip(
        u, *swung, *sizes, strict=True
    ):
        turns, late = (
            direction * (extreme - value) > small,
            where((since + 1.0) * period[0] > LONGEST, 0.0, 1.0),
        )
        now = absolute(extreme - foot)
        grows = where(size > 0.0, now - GROWS * size, 0.0)
        counts = where(now > large, 1.0, where(grows > 0.0, 1.0, 0.0))
        further = where(direction * (extreme - value) < 0.0, value, extreme)
        columns.append([
            where(turns, value, further), where(turns, extreme, foot), where(turns, -direction, direction),
            where(turns, 0.0, since + 1.0), where(turns, now, late * size), where(turns, (count + 1.0) * counts, late *
            count),
        ])  # fmt: skip
        flags.append(where(columns[-1][-1] > SWINGS - 0.5, 1.0, 0.0))
    return np.array(columns).T, np.array([reduce(maximum, flags)])


@gives("too_fast")
def too_fast(readings: Elements, fastest: Elements, period: Elements) -> Elements:
    """Whether a sensor is faster than its limit (p,): 1 (1,), else 0."""
    speeds = absolute(Readings(*readings).speed) / period[0]
    fast = [where(speed > most, 1.0, 0.0) for speed, most in zip(speeds, fastest, strict=True)]
    return np.array([reduce(maximum, fast)])


@gives("standstill_next", "stuck")
def stuck(
    places: Sequence[tuple[int, int]], u: Elements, readings: Elements, standstill: Elements, period: Elements,
    steps: Elements, hardest: Elements, breakaway: Elements,
) -> tuple[Elements, Elements]:  # fmt: skip
    """Speeds of encoders of motors and the inputs when their readings changed last, and for how many samples the input
    has been larger by enough to move the motor (3, s); and whether one stands though its motor could not have stopped
    so soon, or must have moved (1,).

    `places` are those of the readings and of the inputs u (m,) that acted until now; `hardest` (s,) are the largest
    accelerations of the motors, and `breakaway` (s,) changes of their inputs that move them.
    """
    now, columns, flags = Readings(*readings), list[list[Element]](), list[Element]()
    for (place, input), before, pushed, count, most, least in zip(
        places, *standstill, hardest, breakaway, strict=True
    ):
        moves = now.still[place] < 0.5
        speed = where(moves, now.speed[place] / period[0], before)
        pushed = where(moves, u[input], pushed)
        count = where(absolute(u[input]) > absolute(pushed) + least, count + 1.0, 0.0)
        further = speed * speed - 2.0 * most * MOVED * steps[place]
        stands = where(further > 0.0, now.still[place], count)
        columns.append([speed, pushed, count])
        flags.append(where(stands * period[0] > LASTING["stuck"], 1.0, 0.0))
    return np.array(columns).T, np.array([reduce(maximum, flags)])


@gives("bad_start")
def bad_start(
    turns: Sequence[int],
    y: Elements,
    predicted: Elements,
    before: Elements,
    started: Elements,
    most: Elements,
) -> Elements:
    """Whether the robot was not where the controller began (1,): at the first sample, an element of the measurement was
    farther from its prediction than `most` (p,); `before` what was said then."""
    there, away = known(y), absolute(turned(y, predicted, turns) - predicted)
    flags = [
        where(seen > 0.5, where(far > limit, 1.0, 0.0), 0.0) for seen, far, limit in zip(there, away, most)
    ]
    return np.array([where(started[0] > 0.5, before[0], reduce(maximum, flags))])


@gives("sensor_lost")
def sensor_lost(readings: Elements, longest: Elements) -> Elements:
    """Whether a sensor was missing or refused for longer than so many samples (1,): 1 (1,), else 0."""
    now = Readings(*readings)
    lost = [maximum(since - 1.0, count) for since, count in zip(now.since, now.lost, strict=True)]
    return np.array([reduce(maximum, [where(samples > longest[0], 1.0, 0.0) for samples in lost])])


@gives("pauses_next")
def forgotten(pauses: Elements, period: Elements) -> Elements:
    """Long pauses of the loop (1,), of which some part is forgotten in a sample."""
    return pauses * (1.0 - period / PAUSED)


@gives("stop_record_next")
def stop_record(flags: Elements, before: Elements, counts: Elements) -> Elements:
    """Samples so far, the first one at which a sign would stop the robot, 0 for none, and the sum of the bits of the
    signs there (3,). `counts` (8,) are these bits, 0 of a sign that stops nothing; the first one is of a bad start."""
    samples, first, bits = before
    found = sum(where(flag > 0.5, bit, 0.0) for flag, bit in zip(flags, counts, strict=True))
    begins = where(first > 0.5, 0.0, where(found > 0.5, 1.0, 0.0))
    now = samples + 1.0
    return np.array([now, where(begins > 0.5, now, first), where(begins > 0.5, found, bits)])


def first_signs(watch: Watch, u: Vector, positions: Vector) -> dict[str, np.ndarray]:
    """Parts of the memory before the first sample, of an input (m,) and as many commanded positions (k,)."""
    none, up = 0.0 * u, 1.0 + 0.0 * u
    return {
        **({"motion": np.zeros((4, len(watch.pairs)))} if watch.pairs else {}),
        "away": np.zeros((3, len(positions))),
        "opposed": np.zeros((2, len(u))),
        "swung": np.array([u, u, up, none, none, none]),
        **({"standstill": np.zeros((3, len(watch.alone)))} if watch.alone else {}),
        "misplaced": np.zeros(1),
        "pauses": np.zeros(1),
        "stop_record": np.zeros(3),
    }


class Seen(NamedTuple):
    """What the signs of a sample are read from: y (p,) that is believed, its prediction, its readings, the input (m,)
    that acted until now, and the one that is computed now, the positions (k,), their command, and how a governor holds
    the joints."""

    y: Elements
    predicted: Elements
    readings: Elements
    turns: Sequence[int]
    acted: Elements
    u: Elements
    position: Elements
    command: Elements
    hold: Elements | None


def signs(
    run: Run, watch: Watch, places: Sequence[int], seen: Seen, memory: Any, data: Any
) -> tuple[Elements, dict[str, Elements]]:
    """Flags of `SIGNS` (7,), 1 or 0, and what is remembered by name; the positions stand in a command at these
    places."""
    after: dict[str, Elements] = {}
    flags: dict[str, Elements] = dict.fromkeys(SIGNS, np.zeros(1))
    flags["sensor_lost"] = run.call(sensor_lost, seen.readings, data.longest_unseen)
    if watch.pairs:
        after["motion"], flags["inconsistent"] = run.call(
            partial(inconsistent, watch.pairs, seen.turns), seen.y, seen.acted, seen.readings, memory.motion,
            data.period, data.motor_rates, data.motor_spreads, data.motor_numbers,
        )  # fmt: skip
    after["away"], flags["runaway"] = run.call(
        partial(runaway, places), seen.position, seen.command, memory.away, memory.started, data.period,
        data.distances, *(() if seen.hold is None else (seen.hold,)),
    )  # fmt: skip
    flags["too_fast"] = run.call(too_fast, seen.readings, data.fastest, data.period)
    after["opposed"], flags["opposed"] = run.call(
        partial(opposed, watch.driven), seen.u, seen.readings, memory.opposed, data.lower, data.upper, data.swings,
        data.period, data.fastest,
    )  # fmt: skip
    after["swung"], flags["oscillating"] = run.call(
        oscillating, seen.u, memory.swung, data.period, data.swing_sizes
    )
    if watch.alone:
        after["standstill"], flags["stuck"] = run.call(
            partial(stuck, watch.alone), seen.acted, seen.readings, memory.standstill, data.period, data.reading_steps,
            data.hardest, data.breakaway,
        )  # fmt: skip
    after["misplaced"] = run.call(
        partial(bad_start, seen.turns),
        seen.y,
        seen.predicted,
        memory.misplaced,
        memory.started,
        data.misplaced,
    )
    after["pauses"] = run.call(forgotten, memory.pauses, data.period)
    after["stop_record"] = run.call(
        stop_record, run.call(_all, after["misplaced"], *flags.values()), memory.stop_record, data.stop_on
    )
    return run.call(_joined, *flags.values()), after


@gives("reasons")
def _all(*flags: Elements) -> Elements:
    return np.concatenate(flags)


@gives("signs")
def _joined(*flags: Elements) -> Elements:
    return np.concatenate(flags)
