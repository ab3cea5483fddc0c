"""The homological equation in the real columns p, q of conjugate eigenvectors p ± iq, in machine code.

To mix every pair, to divide by the sums of eigenvalues, and to go back is one pass over the entries. The entries whose
indices are in the same pairs, each as often, are a *block*: a tensor with one axis of m + 1 entries for a pair that
occurs m times. No other entry is needed for a block. Of conjugate entries only one is computed: half of the first axis.

Blocks with the same multiplicities have one *pattern*, and eight of them go through the same operations side by side.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property, lru_cache

import numpy as np

from flexhinf.codegen.loops import DOUBLE, INT, LANES, LONG, VECTOR, LoopText, NativeFunction, Value, fields
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import run_all

_BLOCKS = 2048  # one task of a thread
_LARGE = 100_000  # entries from which a second thread pays


def divide_by_sums(
    entries: np.ndarray, eigenvalues: np.ndarray, powers: list[list[np.ndarray]], k: int
) -> None:
    """Replace r, real tensor entries of degree `k` in the columns p, q, by V of V_z Λ z + r = 0 there, in place.

    `eigenvalues` (n,): Conjugate pairs first, then real ones. `powers`: What mixing a pair does to the m + 1 entries of
    degree m in its two variables, and what the way back does; from m = 0 on, each of shape (old, new).
    """
    n, pairs = len(eigenvalues), int(np.count_nonzero(np.imag(eigenvalues))) // 2
    own = np.concatenate([eigenvalues[: 2 * pairs : 2], eigenvalues[2 * pairs :]])
    offsets = np.cumsum([0, *((m + 1) ** 2 for m in range(k + 1))])
    there, back = (np.concatenate([part.ravel() for part in each]) for each in powers)
    # the real part of a sum over a first axis, of which half the rows are at hand
    twice = [
        np.where(2 * np.arange(m + 1) == m, 1.0, 2.0)[:, None] * part for m, part in enumerate(powers[1])
    ]
    last = np.concatenate([part.ravel() for part in twice])
    tables = [
        np.ascontiguousarray(part)
        for each in (there, back, last, own)
        for part in (np.real(each), np.imag(each))
    ]
    patterns, function, common = _patterns(n, k, pairs), _compiled(), fields(entries, offsets, *tables)

    def some(which: int, begin: int) -> None:
        size, blocks = patterns[which].ranks.shape
        rooms = np.empty((5, size + k + 1, LANES))
        function.run(patterns[which].fields, common, fields(*rooms, begin, min(begin + _BLOCKS, blocks)))

    run_all(
        some,
        ((which, begin) for which, p in enumerate(patterns) for begin in range(0, p.ranks.shape[1], _BLOCKS)),
        large=len(entries) > _LARGE,
    )


@dataclass(frozen=True)
class _Pattern:
    """Blocks side by side, their number a multiple of the lanes; the last ones may be repeated.

    `ranks` (entries of a block, blocks), `own` (axes, blocks): The pair or lone variable of each axis, `times` and
    `sizes` (axes,): How often it occurs, and the entries of the axis.
    """

    ranks: np.ndarray
    own: np.ndarray
    times: np.ndarray
    sizes: np.ndarray

    @cached_property
    def fields(self) -> np.ndarray:
        """Of the task."""
        return fields(self.ranks, *self.ranks.shape, self.own, self.times, self.sizes, len(self.sizes))


@lru_cache(8)
def _patterns(n: int, k: int, pairs: int) -> list[_Pattern]:
    tuples = basis.indices(n - pairs, k)  # of pairs and lone variables
    begins = np.ones(tuples.shape, bool)
    begins[:, 1:] = tuples[:, 1:] != tuples[:, :-1]
    lone, kind = tuples >= pairs, np.zeros(len(tuples), np.int64)
    for place in range(k):
        kind = 4 * kind + 2 * begins[:, place] + lone[:, place]
        if place % 16 == 15 or place == k - 1:  # before the number is too large
            kind = np.unique(kind, return_inverse=True)[1].ravel()
    order = np.argsort(kind, kind="stable")
    result: list[_Pattern] = []
    for some in np.split(order, np.cumsum(np.bincount(kind))[:-1]):
        blocks = np.concatenate([some, np.repeat(some[-1:], -len(some) % LANES)])
        starts, axis = np.flatnonzero(begins[some[0]]), np.cumsum(begins[some[0]]) - 1
        times, own = np.diff(starts, append=k), tuples[blocks][:, starts].T
        sizes = np.where(lone[some[0], starts], 1, times + 1)
        # which places of a tuple have the second variable of their pair: the last ones of the axis
        chosen = np.indices(tuple(sizes.tolist())).reshape(len(sizes), -1)[axis].T
        second = np.arange(k) - starts[axis] >= times[axis] - chosen
        first = np.where(lone[blocks], tuples[blocks] + pairs, 2 * tuples[blocks])
        ranks = basis.rank(n, (first + second[:, None]).reshape(-1, k)).reshape(len(second), -1)
        types = (ranks, np.int32), (own, np.int32), (times, np.int64), (sizes, np.int64)
        result.append(_Pattern(*(np.ascontiguousarray(part, kind) for part, kind in types)))
    return result


@cache
def _compiled() -> NativeFunction:
    """Blocks from `begin` to `end` of a pattern, eight at a time."""
    text = LoopText(
        "divide_blocks",
        "Ranks size blocks Own Times Sizes axes Entries Offsets ThereRe ThereIm BackRe BackIm LastRe LastIm Re Im "
        "Given Real Imag Sums Mixed begin end",
    )
    ranks, size, blocks, own, times, sizes, axes, entries, offsets, *others = text.fields()
    there, back, last, eigenvalue = others[:2], others[2:4], others[4:6], others[6:8]
    block, *z, sums, mixed, begin, end = others[8:]
    with text.loop(begin, end, LANES) as column:
        with text.loop(0, size) as e:
            for lane in range(LANES):
                block.store(
                    entries.load(DOUBLE, ranks.load(INT, e * blocks + column + lane)), e * LANES + lane
                )
        first = sizes.load(LONG)
        inner, half, offset = size / first, (first + 1) / 2, offsets.load(LONG, first - 1)
        with text.loop(0, half) as h, text.loop(0, inner) as r:
            parts = [text.sum() for _ in z]
            with text.loop(0, first) as b:
                value, at = block.load(VECTOR, (b * inner + r) * LANES), offset + b * first + h
                for part, table in zip(parts, there, strict=True):
                    part.set(text.fused(table.load(DOUBLE, at).all_lanes(), value, part.get()))
            for part, room in zip(parts, z, strict=True):
                room.store(part.get(), (h * inner + r) * LANES)
        _mix(text, z, mixed, there, sizes, axes, offsets, half, inner)
        real = _sums(text, own.at(INT, column), blocks, times, sizes, axes, eigenvalue, sums, mixed)
        with text.loop(0, half * inner) as e:
            re, im, turn = (room.load(VECTOR, e * LANES) for room in (*z, sums))
            size_squared = text.fused(turn, turn, real * real)
            z[0].store((re * real + im * turn) / size_squared, e * LANES)
            z[1].store((im * real - re * turn) / size_squared, e * LANES)
        _mix(text, z, mixed, back, sizes, axes, offsets, half, inner)
        with text.loop(0, first) as b, text.loop(0, inner) as r:
            total = text.sum()
            with text.loop(0, half) as h:
                at, place = offset + h * first + b, (h * inner + r) * LANES
                re, im = (
                    table.load(DOUBLE, at).all_lanes() * room.load(VECTOR, place)
                    for table, room in zip(last, z, strict=True)
                )
                total.set(total.get() - re + im)
            e = b * inner + r
            block.store(total.get(), e * LANES)
            for lane in range(LANES):
                entries.store(
                    block.load(DOUBLE, e * LANES + lane), ranks.load(INT, e * blocks + column + lane)
                )
    return NativeFunction(text)


def _mix(
    text: LoopText,
    z: list[Value],
    mixed: Value,
    tables: list[Value],
    sizes: Value,
    axes: Value,
    offsets: Value,
    half: Value,
    inner: Value,
) -> None:
    """Every axis but the first, times the complex matrix of its size, in place."""
    outer, below = text.variable(half), text.variable(inner)
    with text.loop(1, axes) as axis:
        size = sizes.load(LONG, axis)
        below.set(below.get() / size)
        step, offset, other = below.get(), offsets.load(LONG, size - 1), mixed.at(VECTOR, size)
        with text.loop(0, outer.get()) as o, text.loop(0, step) as i:
            place = o * size * step + i
            with text.loop(0, size) as new:
                re, im = (text.sum() for _ in z)
                with text.loop(0, size) as old:
                    x, y = (room.load(VECTOR, (place + old * step) * LANES) for room in z)
                    a, b = (table.load(DOUBLE, offset + old * size + new).all_lanes() for table in tables)
                    re.set(text.fused(a, x, re.get()) - b * y)
                    im.set(text.fused(a, y, text.fused(b, x, im.get())))
                mixed.store(re.get(), new * LANES)
                other.store(im.get(), new * LANES)
            with text.loop(0, size) as new:
                for room, now in zip(z, (mixed, other), strict=True):
                    room.store(now.load(VECTOR, new * LANES), (place + new * step) * LANES)
        outer.set(outer.get() * size)


def _sums(
    text: LoopText,
    own: Value,
    blocks: Value,
    times: Value,
    sizes: Value,
    axes: Value,
    eigenvalue: list[Value],
    sums: Value,
    mixed: Value,
) -> Value:
    """The real part of the sums of eigenvalues, which all entries of a block share; `sums` has the imaginary parts."""
    real, count = text.sum(), text.variable(1)
    sums.store(text.number(0, VECTOR))
    with text.loop(0, axes) as axis:
        often, size = times.load(LONG, axis), sizes.load(LONG, axis)
        parts: list[Value] = []
        for table in eigenvalue:
            for lane in range(LANES):
                mixed.store(table.load(DOUBLE, own.load(INT, axis * blocks + lane)), lane)
            parts.append(mixed.load(VECTOR))
        re, im = parts
        real.set(text.fused(often.real().all_lanes(), re, real.get()))
        with text.loop(0, count.get()) as e:  # from the last one on, as each makes room for several
            place = count.get() - 1 - e
            before = sums.load(VECTOR, place * LANES)
            with text.loop(0, size) as b:
                turned = text.fused((often - b * 2).real().all_lanes(), im, before)
                sums.store(turned, (place * size + b) * LANES)
        count.set(count.get() * size)
    return real.get()
