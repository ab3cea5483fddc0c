"""What `flexhinf.codegen.c.source` translates: each form of a statement and of an expression once, for its tests."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Annotated

import numpy as np

from flexhinf.codegen.c.source import Record, counters, room, zeros

MOST, SHARE = 40_000, 0.25

Pair = Annotated[list[float], 2]
Row = Annotated[list[float], "WIDTH"]


class Fixed:
    """What is fixed."""

    width, scale, rows, doubles, never = 3, 1.5, [0.5, -2.0, 7.0], True, False
    sizes = {"WIDTH": 3}  # noqa: RUF012


class Answer(IntEnum):
    NO = 0
    YES = 7


class Inner(Record):
    """A part."""

    values: Row
    count: int


class Memory(Record):
    """All of it."""

    inner: Inner  # by value
    several: Annotated[list[Inner], 2]
    matrix: Annotated[np.ndarray, 2, "WIDTH"]
    far: Annotated[int, "long"]
    given: Annotated[list[Inner], "many"]
    last: float


def helper(own: Fixed, inner: Inner, factor: float) -> float:
    """A sum; the record is changed."""
    total = 0.0
    for i in range(own.width):
        total += factor * inner.values[i] * own.rows[i]
    inner.count += 1
    return total


def chosen(own: Fixed, x: float, k: int) -> int:
    """Branches, of which some are decided before."""
    found = Answer.NO if x < 0.0 else int(Answer.YES)
    if own.never:
        found = -1
    elif k > 3 and own.doubles:
        found *= 2
    elif not k < 2 or x == 1.0:
        found -= k % 2
    else:  # of two
        found = k // 2
    if own.never and k > 0:
        found = -5
    if own.doubles:
        found += 1
    if own.doubles or k > 3:
        found += 1 if own.never and k > 0 else 3
    if not own.never and (own.never or k > 1):
        found += 7
    return found


def between(x: float) -> int:
    """A comparison of three, and what is no number."""
    return 1 if not math.isfinite(x) or not -1.0 <= x <= 1.0 else 0


def run(own: Fixed, memory: Memory, pair: Pair, row: Row, count: int) -> float:
    """Loops to and fro, arrays, records, and their parts."""
    kept, marks = room(2, own.width), counters(2)
    sums, steps = zeros(own.width), 0
    for i in range(own.width):
        kept[0][i] = row[i]
        kept[1][i] = -row[i] if row[i] > 0.0 else abs(row[i]) + SHARE
    for i in range(own.width - 1, 0, -1):
        sums[i] = kept[1][i] - kept[1][i - 1]
    while steps < count and steps < 5:
        steps += 1
        part = kept[steps % 2]
        part[0] = max(part[0], min(pair[1], own.scale)) / 2.0
        marks[steps % 2] += 2
    one = Memory(own)
    one.inner = memory.given[count - 1]
    memory.several[1].count = marks[1] - marks[0]
    memory.inner = memory.given[0]
    memory.far = min(memory.far + int(1e3 * abs(pair[0])), MOST)
    memory.matrix[1][2] = sums[2]
    memory.last = helper(own, memory.several[1], pair[0]) + one.inner.values[1]
    before, after = memory.several[0], float(chosen(own, pair[0], count))
    pair[0] = (
        after + float(before.count) + float(between(row[0]) + max(count, 2)) + math.sqrt(pair[1] * pair[1])
    )
    return kept[1][0] + kept[0][0] * (sums[1] + own.rows[2])
