"""Speeds of motors and links in a protective stop, from the readings that are still believed.

The estimate is not asked, since it may be what failed. A motor's speed is that of its own reading: what acts against it
takes energy out of motor, spring and link, whatever these are. Where it is missing or refused, the link's reading tells
the motor's speed, by a model of two masses and the spring between them, in which all three eigenvalues of the error are
the natural frequency of the two, as real numbers. Without any reading that model goes on from the last speeds.
"""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from flexhinf.arrays import Element, Elements, Vector
from flexhinf.loop.controller.readings import Readings
from flexhinf.scalars import maximum, minimum, where

if TYPE_CHECKING:
    from collections.abc import Sequence


#: Speed of a joint that stands, in parts of the largest one, which is taken for this one at most, rad/s or m/s.
STANDING, UNSTATED = 0.02, 2.0


class Voters(NamedTuple):
    """Readings that tell the speed of what each input moves: the place of its motor's, or only one, in a measurement,
    None where there is none; and the places of those of the links that move with it, with what each adds, () where
    another one tells nothing of its own."""

    own: tuple[int | None, ...]
    links: tuple[tuple[tuple[int, float], ...], ...]

    @property
    def sides(self) -> tuple[Sequence[tuple[tuple[int, float], ...]], ...]:
        """Places and shares of the motors' readings, and of the links'."""
        return tuple(() if place is None else ((place, 1.0),) for place in self.own), self.links


class Masses(NamedTuple):
    """Numbers of motors and links: the period, s, accelerations of a motor per input (m,), of motor and link per twist
    of their spring (m,), the share of a reading's change by which a speed follows it in a sample (m,), and
    speeds of joints that stand (m,)."""

    period: Element
    response: Elements
    winds: Elements
    swings: Elements
    follows: Elements
    rest: Elements

    @property
    def share(self) -> Elements:
        """Of a motor in the inertia of its joint (m,)."""
        return self.swings / (self.winds + self.swings)


class Moving(NamedTuple):
    """What is remembered of motion: speeds of the motors (`motor`) and of their links (`link`), and by how much the
    springs were twisted since a stop began (`twist`), (m,) each; and of both sides, motors and links, the speeds that
    readings tell (`seen`, 2 m), and whether they are there (`there`, 2 m)."""

    motor: Elements
    link: Elements
    twist: Elements
    seen: Elements
    there: Elements


def first_moving(inputs: int) -> Moving:
    """At rest."""
    return Moving(*(np.zeros(inputs) for _ in range(3)), *(np.zeros(2 * inputs) for _ in range(2)))


def moved(
    kept: Moving,
    readings: Elements,
    voters: Voters,
    masses: Masses,
    stops: Element,
    push: Elements,
    looked: Element,
) -> Moving:
    """The motion a sample later. In a stop (`stops` is 1, else 0) the inputs were larger by `push` (m,) than what holds
    the robot; where `looked` is 0 the readings are those of an earlier sample."""
    m = len(voters.own)
    seen, there = _told(kept, Readings(*readings), voters, masses, looked)
    columns = list[tuple[Element, ...]]()
    for k in range(m):
        own, other, linked = there[k], there[m + k], seen[m + k] if voters.links[k] else seen[k]
        going = _two_masses([part[k] for part in kept[:3]], push[k], (1.0 - own) * other, linked, masses, k)
        motor = where(own > 0.5, seen[k], where(stops > 0.5, going[0], kept.motor[k]))
        known = where(other > 0.5, linked, seen[k])
        link = where(maximum(own, 1.0 - stops) > 0.5, known, going[1])
        columns.append((motor, link, stops * going[2]))
    motor, link, twist = np.array(columns).T
    return Moving(motor, link, twist, seen, there)


def _two_masses(
    kept: Sequence[Element], push: Element, corrected: Element, told: Element, masses: Masses, k: int
) -> tuple[Element, Element, Element]:
    """Speeds of a motor and of its link, and the twist between them, a sample later: by `push`, the spring, and where
    `corrected` is 1 by what the link's reading has `told`."""
    motor, link, twist = kept
    period, n, s = masses.period, masses.winds[k], masses.swings[k]
    pole = np.sqrt(n + s)
    error = period * corrected * (told - link)
    return (
        motor + period * (masses.response[k] * push - n * twist) + pole * (pole * pole - 3.0 * n) / s * error,
        link + period * s * twist + 3.0 * pole * error,
        twist + period * (motor - link) + ((3.0 * pole * pole - n) / s - 1.0) * error,
    )


def _told(
    kept: Moving, now: Readings, voters: Voters, masses: Masses, looked: Element
) -> tuple[Elements, Elements]:
    """Speeds that readings tell (2 m,), and whether these are believed (2 m,): a change counts between two readings of
    samples one after the other."""
    seen, there = list[Element](), list[Element]()
    for at, terms in enumerate([terms for side in voters.sides for terms in side]):
        is_there = reduce(
            minimum, [where(now.since[place] > 1.0, 0.0, minimum(now.since[place], 1.0)) for place, _ in terms],
            looked * bool(terms),
        )  # fmt: skip
        change = _sum(now.change, terms) / masses.period
        follows = masses.follows[at % len(voters.own)]
        new = where(kept.there[at] > 0.5, kept.seen[at] + follows * (change - kept.seen[at]), kept.seen[at])
        seen.append(where(is_there > 0.5, new, kept.seen[at]))
        there.append(is_there)
    return np.array(seen), np.array(there)


def _sum(values: Elements, terms: Sequence[tuple[int, float]]) -> Element:
    """The sum of values at places, times shares."""
    return sum((share * values[place] for place, share in terms), 0.0)


def voters_of(controller: Any) -> Voters:
    """Which readings of a controller tell speeds in a stop."""
    watch, protection, m = controller.mode.protected, controller.protection, len(controller.law.input_names)
    if watch is None:
        return Voters((None,) * m, ((),) * m)
    links: list[tuple[tuple[int, float], ...]] = [()] * m
    for j, pair in enumerate(watch.pairs):
        links[pair.input] = tuple((place, float(protection.shares[row][j])) for place, row in pair.links)
    return Voters(watch.moved, tuple(links))


def masses_of(controller: Any) -> Masses:
    """Numbers of a controller's motors and links."""
    protection, none = controller.protection, np.zeros(len(controller.law.input_names))
    if protection is None:
        return Masses(controller.period, none, none, none + 1.0, none, none)
    follows: Vector = np.minimum(controller.period / np.array(protection.smoothing), 1.0)
    fastest = dict(zip(controller.measured, protection.speed))
    rest = np.array([STANDING * min(fastest.get(name, np.inf), UNSTATED) for name in protection.moved])
    winding = np.array(protection.winding)
    return Masses(controller.period, np.array(protection.response), winding[0], winding[1], follows, rest)
