"""A change of variables of a large symmetric tensor, in machine code.

Step s of a change of variables (`flexhinf.hinf.homological`) has a tensor of count(n, k−s) rows, its old indices, and
count(n, s) columns, its new ones. It opens one old index and makes

    result[β, (i, tail)] = Σ_j matrix[j, i] · tensor[β with j, tail]    for i ≤ the first index of tail.

The tensors halfway are a hundred times as large as the polynomial, and to write them costs more than their arithmetic.
So only the one of two new indices is kept. The first two steps go together, for eight β at a time. The others work on
eight columns at a time: each column is a polynomial in the old variables by itself, and its tensors of three, four, …
new indices fit into a processor's cache (`descend`).

Every element is one sum over j in order, whatever the threads, so its bits depend on the processor alone.
"""

from __future__ import annotations

import threading
from functools import cache

import numpy as np

from flexhinf.codegen.emit.writer import ModuleText
from flexhinf.codegen.loops import (
    DOUBLE,
    INT,
    LANES,
    LONG,
    VECTOR,
    LoopText,
    NativeFunction,
    Value,
    fields,
    new_module,
    wide,
)
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import run_all

_HEIGHTS = 12  # new indices at a time, at most
_ROWS = 128  # of the tensor of two new indices, one task of a thread
_SLOTS = 5  # of a level in what `descend` reads: opening, its rows, offsets of results, tensors, first lanes


def _expand(module: ModuleText, height: int, rows: int) -> None:
    """`height` new indices of eight columns, for some rows at a time; each result begins at an offset of its own."""
    text = LoopText(f"expand{height}", "X stride Opening rows M n Out Offsets", True, module)
    x, stride, opening, all_rows, m, n, out, offsets = text.fields()

    def some(row: Value, rows: int) -> None:
        opened = [opening.at(INT, (row + r) * n) for r in range(rows)]
        sums = [[text.sum() for _ in range(height)] for _ in opened]
        with text.loop(0, n) as j:
            vectors = [x.load(VECTOR, places.load(INT, j) * stride) for places in opened]
            numbers = m.at(DOUBLE, j * n)
            for i in range(height):
                number = numbers.load(DOUBLE, i).all_lanes()
                for vector, part in zip(vectors, sums, strict=True):
                    part[i].set(text.fused(number, vector, part[i].get()))
        for i in range(height):
            result = out.at(DOUBLE, offsets.load(LONG, i))
            for r, part in enumerate(sums):
                result.store(part[i].get(), (row + r) * LANES)

    whole = all_rows / rows * rows
    with text.loop(0, whole, rows) as row:
        some(row, rows)
    with text.loop(whole, all_rows) as row:
        some(row, 1)
    text.finish()


def _expansion(module: ModuleText, most: int, sums: int) -> None:
    """`expand` for any number of new indices up to `most`."""
    text = LoopText("expand", "height X stride Opening rows M n Out Offsets", True, module)
    height, *others = text.fields()
    for h in text.cases(height, most):
        _expand(module, h, max(1, min(8, sums // h)))
        text.call(f"expand{h}", *others)
    text.finish()


def _descent(module: ModuleText, most: int) -> None:
    """All new indices up to `highest` of eight columns, each with the columns from the first it may have on."""
    text = LoopText("descend", "Context level X stride highest base low high", True, module)
    context, level, x, stride, highest, base, low, high = text.fields()
    n, matrix, result = context.load(LONG), context.load("ptr", 1), context.load("ptr", 2)
    slots = context.at(LONG, level * _SLOTS)
    opening, places, tensors, lows = (slots.load("ptr", slot) for slot in (0, 2, 3, 4))
    rows, offsets, below = slots.load(LONG, 1), places.at(LONG, n), level - 1
    size, number = rows * LANES, (highest + most) / most
    with text.loop(0, number) as part:
        begin, end = part * (highest + 1) / number, (part + 1) * (highest + 1) / number
        text.call(
            "expand", end - begin, x, stride, opening, rows, matrix.at(DOUBLE, begin), n, tensors, offsets
        )
        with text.loop(begin, end) as i:
            tensor, where = tensors.at(DOUBLE, (i - begin) * size), base + places.load(LONG, i)
            first = lows.load(LONG, i).most(low)
            with text.when(first.compare("slt", high)):
                with text.when(below.compare("eq", 0)), text.loop(first, high) as lane:
                    result.store(tensor.load(DOUBLE, lane), where + lane)
                with text.when(below.compare("ne", 0)):
                    text.call("descend", context, below, tensor, LANES, i, where, first, high)
    text.finish()


def _begin(module: ModuleText, most: int) -> LoopText:
    """Two new indices of the rows from `top` to `bottom`, eight rows at a time."""
    text = LoopText(
        "begin",
        "Entries Outer Inner n rows Matrix Two One Offsets Places X Y Pair Pairs packs top bottom",
        module=module,
    )
    entries, outer, inner, n, rows, matrix, two, one, offsets, places, x, y, pair, pairs, *others = (
        text.fields()
    )
    packs, top, bottom = others
    with text.loop(top, bottom, LANES) as some:
        row = some.least(rows - LANES)  # what two threads may write both is the same
        opened = [inner.at(INT, (row + lane) * n) for lane in range(LANES)]
        with text.loop(0, n) as j:
            ranks = [outer.at(INT, places_of.load(INT, j) * n) for places_of in opened]
            to = x.at(DOUBLE, places.load(LONG, j))
            with text.loop(j, n) as l:
                for lane, places_of in enumerate(ranks):
                    to.store(entries.load(DOUBLE, places_of.load(INT, l)), l * LANES + lane)
        number = (n + (most - 1)) / most
        with text.loop(0, number) as part:
            begin, end = part * n / number, (part + 1) * n / number
            text.call("expand", end - begin, x, LANES, two, n, matrix.at(DOUBLE, begin), n, y, offsets)
            with text.loop(begin, end) as i:
                opened, to, pieces = (
                    y.at(DOUBLE, (i - begin) * n * LANES),
                    pair.at(DOUBLE, i * LANES),
                    (i + most) / most,
                )
                with text.loop(0, pieces) as piece:
                    low, high = piece * (i + 1) / pieces, (piece + 1) * (i + 1) / pieces
                    place = places.at(LONG, low)
                    text.call(
                        "expand", high - low, opened, LANES, one, 1, matrix.at(DOUBLE, low), n, to, place
                    )
        with text.loop(0, packs) as pack:
            columns = [pair.load(VECTOR, (pack * LANES + c) * LANES) for c in range(LANES)]
            to = pairs.at(VECTOR, pack * rows + row)
            for r, vector in enumerate(_transposed(columns)):
                to.set_row(vector, r, past_cache=True)
    return text


def _transposed(vectors: list[Value]) -> list[Value]:
    """Eight vectors of eight as rows, from columns: blocks of 1, 2 and 4 off the diagonal change places."""
    lanes, rows = range(LANES), list(vectors)
    for size in (1, 2, 4):
        for i in (i for i in lanes if not i & size):
            a, b = rows[i], rows[i + size]
            rows[i] = a.shuffled(b, [LANES + lane - size if lane & size else lane for lane in lanes])
            rows[i + size] = a.shuffled(b, [LANES + lane if lane & size else lane + size for lane in lanes])
    return rows


@cache
def _compiled(entry: str) -> NativeFunction:
    """The function "begin" or "finish"."""
    most, sums = (_HEIGHTS, 16) if wide() else (6, 6)  # as registers hold
    module = new_module()
    _expansion(module, most, sums)
    if entry == "begin":
        return NativeFunction(_begin(module, most))
    _descent(module, most)
    text = LoopText("finish", "Context level X stride highest base low high", module=module)
    text.call("descend", *text.fields())
    return NativeFunction(text)


class Rotation:
    """The change of variables of tensor entries (count(n, k),), k ≥ 3, with a matrix (n, n), both of doubles.

    There are eight tuples of k − 2 indices or more.
    """

    def __init__(self, n: int, k: int, matrix: np.ndarray) -> None:
        self.n, self.k, self.matrix = n, k, np.ascontiguousarray(matrix)
        self.width = _padded(basis.count(n, 2))
        self.size = basis.count(n, k - 2) * self.width

    def apply(self, entries: np.ndarray, workspace: np.ndarray) -> np.ndarray:
        """The entries in the new variables; `workspace` is `size` doubles from a multiple of 64 bytes on."""
        entries, result = np.ascontiguousarray(entries), np.empty(len(entries))
        rows = basis.count(self.n, self.k - 2)
        local = threading.local()
        for entry in ("begin", "finish"):
            _compiled(entry)  # once, before threads would

        def begin(top: int) -> None:
            if not hasattr(local, "begin"):
                local.begin = _Begin(self, entries, workspace)
            local.begin(top, min(top + _ROWS, rows))

        def finish(column: int) -> None:
            if not hasattr(local, "finish"):
                local.finish = _Finish(self, result)
            local.finish(workspace, column)

        run_all(begin, ((top,) for top in range(0, rows, _ROWS)), large=True)
        columns = reversed(range(0, basis.count(self.n, 2), LANES))
        run_all(finish, ((column,) for column in columns), large=True)
        return result


def _padded(size: int) -> int:
    return -(-size // LANES) * LANES


def _places(n: int, s: int) -> np.ndarray:
    """What is added to the rank of s − 1 sorted indices where each index is put before them, int64 (n,)."""
    return (basis.offsets(n, s) - basis.offsets(n, s - 1))[:n].astype(np.int64)


class _Begin:
    """Two new indices of rows of tuples of k − 2 old ones; what one thread needs."""

    def __init__(self, rotation: Rotation, entries: np.ndarray, pairs: np.ndarray) -> None:
        n, k, matrix = rotation.n, rotation.k, rotation.matrix
        tables = basis.insertion(n, k), basis.insertion(n, k - 1), n, basis.count(n, k - 2), matrix
        openings = (
            basis.insertion(n, 2),
            basis.insertion(n, 1),
            np.arange(n) * n * LANES,
            _places(n, 2) * LANES,
        )
        rooms = (np.zeros(size * LANES) for size in (basis.count(n, 2), min(n, _HEIGHTS) * n, rotation.width))
        self._kept = entries, *tables, *openings, *rooms, pairs, rotation.width // LANES
        self._function, self._fields = _compiled("begin"), fields(*self._kept)

    def __call__(self, top: int, bottom: int) -> None:
        self._function.run(self._fields, fields(top, bottom))


class _Finish:
    """All other new indices of eight columns; what one thread needs."""

    def __init__(self, rotation: Rotation, result: np.ndarray) -> None:
        n, k = rotation.n, rotation.k
        self._rows, self._deep = basis.count(n, k - 2), k - 2
        self._lows = [np.zeros(n, np.int64) for _ in range(k - 1)]
        self._kept, self._context = [result, rotation.matrix], np.zeros(_SLOTS * (k - 1), np.int64)
        self._context[:3] = n, rotation.matrix.ctypes.data, result.ctypes.data
        for level in range(1, k - 1):
            opening = basis.insertion(n, level)
            rows = len(opening)
            places = np.concatenate([_places(n, k - level + 1), np.arange(n) * rows * LANES])
            tensors = np.empty(min(n, _HEIGHTS) * rows * LANES)
            self._kept += [opening, places, tensors]
            self._context[_SLOTS * level : _SLOTS * (level + 1)] = [
                rows if slot is None else slot.ctypes.data
                for slot in (opening, None, places, tensors, self._lows[level])
            ]
        self._start, self._first = basis.offsets(n, 2), basis.factors(n, 2)[0]
        self._function = _compiled("finish")

    def __call__(self, pairs: np.ndarray, column: int) -> None:
        lanes = min(LANES, int(self._start[-1]) - column)
        self._lows[self._deep][:] = self._start[:-1] - column
        last = int(self._first[column + lanes - 1])
        x = pairs[column * self._rows :]
        self._function(self._context, self._deep, x, LANES, last, column, 0, lanes)
