"""Polynomials between waypoints: their ways, their speeds, what smoothing takes of their jumps."""

from __future__ import annotations

from typing import Annotated

from flexhinf.codegen.c.source import counters, room, zeros
from flexhinf.robot.follow_limits import FollowLimits
from flexhinf.robot.follow_records import Joints, Long, Point, Six, Three

#: Halvings of a part of a polynomial whose coefficients leave a range and whose ends do not. Coefficients are off the
#: curve by a quarter at each: what is left is 2e-10 of them, and counts as rounding.
HALVINGS = 16

#: Parts of a polynomial that are looked at, at most: more than one that stays within a range has, however near it is.
PARTS = 256


def between(begin: Three, end: Three, time: float, at: float, order: int, result: Three) -> None:
    """On the polynomial between two waypoints, `at` seconds from the first: linear, cubic or quintic."""
    s, way = at / time, end[0] - begin[0]
    if order == 1:
        result[0] = begin[0] + s * way
        result[1] = way / time
        result[2] = 0.0
    else:
        v0, v1 = time * begin[1], time * end[1]
        c2, c3, c4, c5 = 3.0 * way - (2.0 * v0 + v1), (v0 + v1) - 2.0 * way, 0.0, 0.0
        if order == 3:
            a0, a1 = time * time * begin[2], time * time * end[2]
            c2 = 0.5 * a0
            c3 = 10.0 * way - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
            c4 = 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1 - 15.0 * way
            c5 = 6.0 * way - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1
        result[0] = begin[0] + s * (v0 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
        result[1] = (v0 + s * (2.0 * c2 + s * (3.0 * c3 + s * (4.0 * c4 + s * (5.0 * c5))))) / time
        result[2] = (2.0 * c2 + s * (6.0 * c3 + s * (12.0 * c4 + s * (20.0 * c5)))) / (time * time)


def spanned(begin: Three, end: Three, time: float, order: int, place: Six, speed: Six) -> int:
    """Bernstein coefficients of that polynomial and of its velocity; its degree."""
    degree, mean = 2 * order - 1, (end[0] - begin[0]) / time
    speed[0] = mean
    if order > 1:
        speed[0] = begin[1]
        speed[degree - 1] = end[1]
    if order == 2:
        speed[1] = 3.0 * mean - begin[1] - end[1]
    if order == 3:
        speed[1] = begin[1] + 0.25 * time * begin[2]
        speed[3] = end[1] - 0.25 * time * end[2]
        speed[2] = 5.0 * mean - (begin[1] + speed[1]) - (speed[3] + end[1])
    place[0] = begin[0]
    for i in range(degree):
        place[i + 1] = place[i] + time * speed[i] / float(degree)
    return degree


def leaves(coefficients: Six, degree: int, low: float, high: float) -> int:
    """Whether a polynomial in Bernstein's form is beyond a range somewhere from 0 to 1, or is no number: it is halved
    until the coefficients of a part say that it is not, or an end of one that it is."""
    parts = room(HALVINGS + 1, 6)
    halved = counters(HALVINGS + 1)
    count, found, looked = 1, 0, 0
    for i in range(degree + 1):
        parts[0][i] = coefficients[i]
    while count > 0 and found == 0:
        part, half = parts[count - 1], halved[count - 1]
        looked += 1
        if not (low <= part[0] <= high and low <= part[degree] <= high) or looked > PARTS:
            found = 1
        elif half == HALVINGS or is_inside(part, degree, low, high) != 0:
            count -= 1
        else:  # the second half stays in its place, the first one is the next
            for i in range(degree + 1):
                parts[count][i] = part[0]
                for k in range(degree - i):
                    part[k] = 0.5 * (part[k] + part[k + 1])
            halved[count - 1] = half + 1
            halved[count] = half + 1
            count += 1
    return found


def is_inside(coefficients: Six, degree: int, low: float, high: float) -> int:
    """Whether all coefficients are in a range."""
    inside = 1
    for i in range(degree + 1):
        if not low <= coefficients[i] <= high:
            inside = 0
    return inside


def width(coefficients: Six, degree: int) -> float:
    """How far coefficients are apart."""
    least, most = coefficients[0], coefficients[0]
    for i in range(degree + 1):
        least = min(least, coefficients[i])
        most = max(most, coefficients[i])
    return most - least


def at_point(point: Point, j: int, result: Three) -> None:
    """Joint j of a waypoint."""
    result[0] = point.position[j]
    result[1] = point.velocity[j]
    result[2] = point.acceleration[j]


def column(motion: Annotated[list[list[float]], 3, "JOINTS"], j: int, result: Three) -> None:
    """Joint j of a motion."""
    for k in range(3):
        result[k] = motion[k][j]


def spent_after(
    own: FollowLimits, j: int, begin: Three, end: Three, time: float, order: int, spent: float
) -> float:
    """What joint j has spent of the jump that smoothing takes, after a way; below 0 where it leaves its range on that
    way, or is faster than its speed limit, but for such a jump."""
    place, speed = room(6), room(6)
    degree = spanned(begin, end, time, order, place, speed)
    size, left, quick = abs(end[0] - begin[0]), 0.0, 1 if time < own.smoothing else 0
    if own.paced:
        if leaves(speed, degree - 1, -own.peak[j], own.peak[j]) != 0:  # a jump, as far as it goes
            size, quick = width(place, degree), 1
        if size > own.fastest[j] * time:
            quick = 1
        left = max(spent + size - own.peak[j] * time, 0.0)
        if left > own.farthest[j]:
            left = -1.0
    if size > own.farthest[j] and quick != 0:
        left = -1.0
    low, high = min(own.low[j], begin[0]) - own.rounding[j], max(own.high[j], begin[0]) + own.rounding[j]
    if leaves(place, degree, low, high) != 0:
        left = -1.0
    return left


def streams(own: FollowLimits, spent: Joints, periods: Long, before: Joints, r: Joints) -> int:
    """Whether joints can be at a row so many periods after another: within range and speed, but for a jump."""
    fits = 1
    for j in range(own.joints):
        low, high = (
            min(own.low[j], before[j]) - own.rounding[j],
            max(own.high[j], before[j]) + own.rounding[j],
        )
        if not (low <= r[j] <= high and abs(r[j] - before[j]) <= own.farthest[j]):
            fits = 0
    if own.paced and fits != 0:
        fits = spend(own, spent, own.period * float(periods), before, r)
    return fits


def spend(own: FollowLimits, spent: Joints, time: float, before: Joints, r: Joints) -> int:
    """Whether a row is within the speed limits, but for a jump; what is spent of that then."""
    left = zeros(own.joints)
    fits = 1
    for j in range(own.joints):
        left[j] = max(spent[j] + abs(r[j] - before[j]) - own.peak[j] * time, 0.0)
        if not (left[j] <= own.farthest[j] and abs(r[own.joints + j]) <= own.peak[j]):
            fits = 0
    for j in range(own.joints):
        spent[j] = left[j] if fits != 0 else spent[j]
    return fits
