"""A change of variables of a large symmetric tensor, in machine code.

Step s of a change of variables (`flexhinf.hinf.homological`) has a tensor of count(n, k−s) rows, its old indices, and
count(n, s) columns, its new ones. It opens one old index and makes

    result[β, (i, tail)] = Σ_j matrix[j, i] · tensor[β with j, tail]    for i ≤ the first index of tail.

The tensors halfway are a hundred times as large as the polynomial, and to write them costs more than their arithmetic.
So only the one of two new indices is kept. The first two steps go together, for one β after the other. The others work
on eight columns at a time: each column is a polynomial in the old variables by itself, and its tensors of three, four,
… new indices fit into a processor's cache (`descend`).

Every element is one sum over j in order, whatever the threads, so its bits depend on the processor alone.
"""

from __future__ import annotations

import ctypes
import threading
from functools import cache
from typing import Any

import numpy as np

from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import run_all

LANES = 8  # columns at a time
_VECTOR = f"<{LANES} x double>"
_HEIGHTS = 12  # new indices at a time, at most
_ROWS = 128  # of the tensor of two new indices, one task of a thread
_SLOTS = 5  # of a level in what `descend` reads: opening, its rows, offsets of results, tensors, first lanes

_EXPAND = """
define internal void @expand{h}(ptr %x, i64 %stride, ptr %opening, i64 %rows, ptr %m, i64 %n, ptr %out, ptr %off) {{
entry:
  br label %many
many:
  %r = phi i64 [ 0, %entry ], [ %r.next, %many.w ]
  %r.next = add i64 %r, {rows}
  %fits = icmp sle i64 %r.next, %rows
  br i1 %fits, label %many.b, label %few
{many}
many.w:
{many_stores}
  br label %many
few:
  %f = phi i64 [ %r, %many ], [ %f.next, %few.w ]
  %f.next = add i64 %f, 1
  %more = icmp sle i64 %f.next, %rows
  br i1 %more, label %few.b, label %end
{few}
few.w:
{few_stores}
  br label %few
end:
  ret void
}}
"""

_DESCEND = """
define void @{entry}(ptr %task) {{
{arguments}
  call void @descend(ptr %p0, i64 %a1, ptr %p2, i64 %a3, i64 %a4, i64 %a5, i64 %a6, i64 %a7)
  ret void
}}

define internal void @descend(ptr %c, i64 %d, ptr %x, i64 %stride, i64 %f, i64 %base, i64 %lo, i64 %hi) {{
entry:
  %n = load i64, ptr %c
  %matrix.at = getelementptr i64, ptr %c, i64 1
  %matrix = load ptr, ptr %matrix.at
  %result.at = getelementptr i64, ptr %c, i64 2
  %result = load ptr, ptr %result.at
  %level = mul i64 %d, {slots}
  %opening.at = getelementptr i64, ptr %c, i64 %level
  %opening = load ptr, ptr %opening.at
  %rows.at = getelementptr i64, ptr %opening.at, i64 1
  %rows = load i64, ptr %rows.at
  %places.at = getelementptr i64, ptr %opening.at, i64 2
  %places = load ptr, ptr %places.at
  %tensors.at = getelementptr i64, ptr %opening.at, i64 3
  %tensors = load ptr, ptr %tensors.at
  %lows.at = getelementptr i64, ptr %opening.at, i64 4
  %lows = load ptr, ptr %lows.at
  %offsets = getelementptr i64, ptr %places, i64 %n
  %below = sub i64 %d, 1
  %all = add i64 %f, 1
  %rounded = add i64 %f, {most}
  %parts = sdiv i64 %rounded, {most}
  %size = mul i64 %rows, {lanes}
  br label %part
part:
  %g = phi i64 [ 0, %entry ], [ %g.next, %part.next ]
  %g.next = add i64 %g, 1
  %from.all = mul i64 %g, %all
  %from = sdiv i64 %from.all, %parts
  %to.all = mul i64 %g.next, %all
  %to = sdiv i64 %to.all, %parts
  %high = sub i64 %to, %from
  %m = getelementptr double, ptr %matrix, i64 %from
  call void @expand(i64 %high, ptr %x, i64 %stride, ptr %opening, i64 %rows, ptr %m, i64 %n,
      ptr %tensors, ptr %offsets)
  br label %index
index:
  %i = phi i64 [ %from, %part ], [ %i.next, %index.next ]
  %i.next = add i64 %i, 1
  %q = sub i64 %i, %from
  %at = mul i64 %q, %size
  %tensor = getelementptr double, ptr %tensors, i64 %at
  %place.at = getelementptr i64, ptr %places, i64 %i
  %place = load i64, ptr %place.at
  %where = add i64 %base, %place
  %low.at = getelementptr i64, ptr %lows, i64 %i
  %low = load i64, ptr %low.at
  %later = icmp sgt i64 %low, %lo
  %first = select i1 %later, i64 %low, i64 %lo
  %nothing = icmp sge i64 %first, %hi
  br i1 %nothing, label %index.next, label %some
some:
  %last = icmp eq i64 %below, 0
  br i1 %last, label %lane, label %deeper
deeper:
  call void @descend(ptr %c, i64 %below, ptr %tensor, i64 {lanes}, i64 %i, i64 %where, i64 %first, i64 %hi)
  br label %index.next
lane:
  %l = phi i64 [ %first, %some ], [ %l.next, %lane ]
  %from.at = getelementptr double, ptr %tensor, i64 %l
  %value = load double, ptr %from.at
  %rank = add i64 %where, %l
  %to.at = getelementptr double, ptr %result, i64 %rank
  store double %value, ptr %to.at
  %l.next = add i64 %l, 1
  %more.lanes = icmp slt i64 %l.next, %hi
  br i1 %more.lanes, label %lane, label %index.next
index.next:
  %more.indices = icmp slt i64 %i.next, %to
  br i1 %more.indices, label %index, label %part.next
part.next:
  %more.parts = icmp slt i64 %g.next, %parts
  br i1 %more.parts, label %part, label %end
end:
  ret void
}}
"""

_BEGIN = """
define void @{entry}(ptr %task) {{
entry:
{arguments}
  %wide = mul i64 %a9, {lanes}
  %shared = sub i64 %a9, 1
  %last.column = sub i64 %a1, {lanes}
  br label %row
row:
  %b = phi i64 [ %a11, %entry ], [ %b.next, %row.next ]
  %b.n = mul i64 %b, %a1
  %inner = getelementptr i32, ptr %p3, i64 %b.n
  br label %gather
gather:
  %j = phi i64 [ 0, %row ], [ %j.next, %gather.next ]
  %j.at = getelementptr i32, ptr %inner, i64 %j
  %j.rank = load i32, ptr %j.at
  %j.long = sext i32 %j.rank to i64
  %j.n = mul i64 %j.long, %a1
  %outer = getelementptr i32, ptr %p2, i64 %j.n
  %x.at = mul i64 %j, %a1
  %x.row = getelementptr double, ptr %p5, i64 %x.at
  br label %element
element:
  %l = phi i64 [ 0, %gather ], [ %l.next, %element ]
  %l.at = getelementptr i32, ptr %outer, i64 %l
  %l.rank = load i32, ptr %l.at
  %l.long = sext i32 %l.rank to i64
  %entry.at = getelementptr double, ptr %p0, i64 %l.long
  %value = load double, ptr %entry.at
  %to.at = getelementptr double, ptr %x.row, i64 %l
  store double %value, ptr %to.at
  %l.next = add i64 %l, 1
  %more.l = icmp slt i64 %l.next, %a1
  br i1 %more.l, label %element, label %gather.next
gather.next:
  %j.next = add i64 %j, 1
  %more.j = icmp slt i64 %j.next, %a1
  br i1 %more.j, label %gather, label %block
block:
  %k = phi i64 [ 0, %gather.next ], [ %k.next, %block.next ]
  %k.column = mul i64 %k, {lanes}
  %is.last = icmp eq i64 %k, %shared
  %column = select i1 %is.last, i64 %last.column, i64 %k.column
  %m.block = getelementptr double, ptr %p4, i64 %column
  %y.block = getelementptr double, ptr %p6, i64 %column
  %highest = add i64 %column, {lanes}
  br label %down
down:
  %top = phi i64 [ %a1, %block ], [ %bottom, %down ]
  %lowest = sub i64 %top, {most}
  %under = icmp slt i64 %lowest, 0
  %bottom = select i1 %under, i64 0, i64 %lowest
  %high = sub i64 %top, %bottom
  %x.part = getelementptr double, ptr %p5, i64 %bottom
  %y.offsets = getelementptr i64, ptr %p13, i64 %bottom
  call void @expand(i64 %high, ptr %m.block, i64 %wide, ptr %p14, i64 1, ptr %x.part, i64 %a1, ptr %y.block,
      ptr %y.offsets)
  %more.down = icmp sgt i64 %bottom, 0
  br i1 %more.down, label %down, label %second
second:
  %top2 = phi i64 [ %highest, %down ], [ %bottom2, %second ]
  %lowest2 = sub i64 %top2, {most}
  %under2 = icmp slt i64 %lowest2, 0
  %bottom2 = select i1 %under2, i64 0, i64 %lowest2
  %high2 = sub i64 %top2, %bottom2
  %m.part = getelementptr double, ptr %p15, i64 %bottom2
  %offsets = getelementptr i64, ptr %p8, i64 %bottom2
  %out.block = getelementptr double, ptr %p16, i64 %column
  call void @expand(i64 %high2, ptr %y.block, i64 %wide, ptr %p14, i64 1, ptr %m.part, i64 %a1, ptr %out.block,
      ptr %offsets)
  %more.second = icmp sgt i64 %bottom2, 0
  br i1 %more.second, label %second, label %block.next
block.next:
  %k.next = add i64 %k, 1
  %more.blocks = icmp slt i64 %k.next, %a9
  br i1 %more.blocks, label %block, label %copy
copy:
  %q = phi i64 [ 0, %block.next ], [ %q.next, %copy ]
  %q.column = mul i64 %q, {lanes}
  %q.from = getelementptr double, ptr %p16, i64 %q.column
  %q.value = load {vector}, ptr %q.from, align 8
  %q.rows = mul i64 %q, %a17
  %q.row = add i64 %q.rows, %b
  %q.place = mul i64 %q.row, {lanes}
  %q.to = getelementptr double, ptr %p7, i64 %q.place
  store {vector} %q.value, ptr %q.to, align 64, !nontemporal !0
  %q.next = add i64 %q, 1
  %more.q = icmp slt i64 %q.next, %a10
  br i1 %more.q, label %copy, label %row.next
row.next:
  %b.next = add i64 %b, 1
  %more.rows = icmp slt i64 %b.next, %a12
  br i1 %more.rows, label %row, label %end
end:
  ret void
}}
!0 = !{{ i32 1 }}
"""

_SHAPE = "ptr %x, i64 %stride, ptr %opening, i64 %rows, ptr %m, i64 %n, ptr %out, ptr %off"


def _loop(p: str, row: str, rows: int, height: int) -> tuple[str, str]:
    """The sums over j for `rows` rows from `row` on and `height` new indices, and the stores, the last index first."""
    each = [(r, i) for r in range(rows) for i in range(height)]
    lines = [f"{p}.b:"]
    for r in range(rows):
        lines += [
            f"  %{p}.row{r} = add i64 {row}, {r}",
            f"  %{p}.first{r} = mul i64 %{p}.row{r}, %n",
            f"  %{p}.opened{r} = getelementptr i32, ptr %opening, i64 %{p}.first{r}",
        ]
    lines += [f"  br label %{p}.j", f"{p}.j:", f"  %{p}.jj = phi i64 [ 0, %{p}.b ], [ %{p}.jn, %{p}.j ]"]
    lines += [
        f"  %{p}.s{r}.{i} = phi {_VECTOR} [ zeroinitializer, %{p}.b ], [ %{p}.t{r}.{i}, %{p}.j ]"
        for r, i in each
    ]
    for r in range(rows):
        lines += [
            f"  %{p}.oa{r} = getelementptr i32, ptr %{p}.opened{r}, i64 %{p}.jj",
            f"  %{p}.o{r} = load i32, ptr %{p}.oa{r}",
            f"  %{p}.ol{r} = sext i32 %{p}.o{r} to i64",
            f"  %{p}.os{r} = mul i64 %{p}.ol{r}, %stride",
            f"  %{p}.xa{r} = getelementptr double, ptr %x, i64 %{p}.os{r}",
            f"  %{p}.x{r} = load {_VECTOR}, ptr %{p}.xa{r}, align 8",
        ]
    lines += [f"  %{p}.jr = mul i64 %{p}.jj, %n", f"  %{p}.mj = getelementptr double, ptr %m, i64 %{p}.jr"]
    for i in range(height):
        lines += [
            f"  %{p}.ma{i} = getelementptr double, ptr %{p}.mj, i64 {i}",
            f"  %{p}.m{i} = load double, ptr %{p}.ma{i}",
            f"  %{p}.e{i} = insertelement {_VECTOR} poison, double %{p}.m{i}, i64 0",
            f"  %{p}.f{i} = shufflevector {_VECTOR} %{p}.e{i}, {_VECTOR} poison, <{LANES} x i32> zeroinitializer",
        ]
        lines += [
            f"  %{p}.t{r}.{i} = call {_VECTOR} @llvm.fmuladd.v{LANES}f64({_VECTOR} %{p}.f{i}, {_VECTOR} %{p}.x{r}, "
            f"{_VECTOR} %{p}.s{r}.{i})"
            for r in range(rows)
        ]
    lines += [
        f"  %{p}.jn = add i64 %{p}.jj, 1",
        f"  %{p}.more = icmp slt i64 %{p}.jn, %n",
        f"  br i1 %{p}.more, label %{p}.j, label %{p}.w",
    ]
    stores = []
    for i in reversed(range(height)):
        stores += [
            f"  %{p}.pa{i} = getelementptr i64, ptr %off, i64 {i}",
            f"  %{p}.p{i} = load i64, ptr %{p}.pa{i}",
            f"  %{p}.out{i} = getelementptr double, ptr %out, i64 %{p}.p{i}",
        ]
        for r in range(rows):
            stores += [
                f"  %{p}.at{r}.{i} = mul i64 %{p}.row{r}, {LANES}",
                f"  %{p}.to{r}.{i} = getelementptr double, ptr %{p}.out{i}, i64 %{p}.at{r}.{i}",
                f"  store {_VECTOR} %{p}.t{r}.{i}, ptr %{p}.to{r}.{i}, align 8",
            ]
    return "\n".join(lines), "\n".join(stores)


def _expand(height: int, sums: int) -> str:
    rows = max(1, min(8, sums // height))
    many, few = _loop("many", "%r", rows, height), _loop("few", "%f", 1, height)
    return _EXPAND.format(
        h=height, rows=rows, many=many[0], many_stores=many[1], few=few[0], few_stores=few[1]
    )


def _arguments(kinds: str) -> str:
    """Loads of what a task holds, one letter each: an address (p) or an integer (a)."""
    return "\n".join(
        f"  %at{i} = getelementptr i64, ptr %task, i64 {i}\n"
        f"  %{kind}{i} = load {'ptr' if kind == 'p' else 'i64'}, ptr %at{i}"
        for i, kind in enumerate(kinds)
    )


@cache
def _compiled(entry: str) -> tuple[Any, Any]:
    """The code, which must live on, and its function: `entry` is "begin" or "finish"."""
    from flexhinf.codegen import machine
    from flexhinf.codegen.compiler import cached

    host = machine.host()
    most, sums = (_HEIGHTS, 16) if "+avx512f" in host.features.split(",") else (6, 6)  # as registers hold
    heights = range(1, most + 1)
    values = ", ".join(part.split()[0] + " " + part.split()[1] for part in _SHAPE.split(", "))
    calls = "".join(f"h{h}:\n  call void @expand{h}({values})\n  ret void\n" for h in heights)
    cases = " ".join(f"i64 {h}, label %h{h}" for h in heights)
    body = _BEGIN if entry == "begin" else _DESCEND
    text = (
        f"declare {_VECTOR} @llvm.fmuladd.v{LANES}f64({', '.join(3 * [_VECTOR])})\n"
        + "".join(_expand(h, sums) for h in heights)
        + f"define internal void @expand(i64 %h, {_SHAPE}) {{\n  switch i64 %h, label %end [ {cases} ]\n{calls}"
        + "end:\n  ret void\n}\n"
        + body.format(
            entry=entry,
            lanes=LANES,
            vector=_VECTOR,
            most=most,
            slots=_SLOTS,
            arguments=_arguments("papaaaaa" if entry == "finish" else "papppppppaaaappppa"),
        )
    )
    code = cached(
        ("hinf", text, host.triple, host.cpu, host.features, host.version),
        lambda: machine.assemble(text, 3),
        lambda image: machine.Code(image, entry, {}),
    )
    return code, ctypes.CFUNCTYPE(None, ctypes.c_void_p)(code.address)


class Rotation:
    """The change of variables of tensor entries (count(n, k),), k ≥ 3, with a matrix (n, n), n ≥ 8, both of doubles."""

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
        run_all(
            finish, ((column,) for column in reversed(range(0, basis.count(self.n, 2), LANES))), large=True
        )
        return result


def _padded(size: int) -> int:
    return -(-size // LANES) * LANES


def _places(n: int, s: int) -> np.ndarray:
    """What is added to the rank of s − 1 sorted indices where each index is put before them, int64 (n,)."""
    return (basis.offsets(n, s) - basis.offsets(n, s - 1))[:n].astype(np.int64)


class _Begin:
    """Two new indices of rows of tuples of k − 2 old ones; what one thread needs."""

    def __init__(self, rotation: Rotation, entries: np.ndarray, pairs: np.ndarray) -> None:
        n, k, wide = rotation.n, rotation.k, _padded(rotation.n)
        rows = basis.count(n, k - 2)
        padded = np.zeros((n, wide))
        padded[:, :n] = rotation.matrix
        arrays = [
            entries, basis.insertion(n, k), basis.insertion(n, k - 1), padded, np.empty((n, n)), np.empty((n, wide)),
            pairs, _places(n, 2), np.arange(n) * wide, np.arange(n, dtype=np.int32), rotation.matrix,
            np.zeros(rotation.width),
        ]  # fmt: skip
        first, *middle = (array.ctypes.data for array in arrays[:8])
        sizes = wide // LANES, rotation.width // LANES, 0, 0
        self._kept, (self._code, self._function) = arrays, _compiled("begin")
        self._task = np.array(
            [first, n, *middle, *sizes, *(array.ctypes.data for array in arrays[8:]), rows], np.int64
        )

    def __call__(self, top: int, bottom: int) -> None:
        self._task[11:13] = top, bottom
        self._function(self._task.ctypes.data)


class _Finish:
    """All other new indices of eight columns; what one thread needs."""

    def __init__(self, rotation: Rotation, result: np.ndarray) -> None:
        n, k = rotation.n, rotation.k
        self._rows, self._deep = basis.count(n, k - 2), k - 2
        self._lows = [np.zeros(n, np.int64) for _ in range(k - 1)]
        self._kept, self._context = [result, rotation.matrix], np.zeros(_SLOTS * (k - 1), np.int64)
        self._context[:3] = n, rotation.matrix.ctypes.data, result.ctypes.data
        for d in range(1, k - 1):
            opening = basis.insertion(n, d)
            rows = len(opening)
            places = np.concatenate([_places(n, k - d + 1), np.arange(n) * rows * LANES])
            tensors = np.empty(min(n, _HEIGHTS) * rows * LANES)
            self._kept += [places, tensors]
            parts = (
                opening.ctypes.data,
                rows,
                places.ctypes.data,
                tensors.ctypes.data,
                self._lows[d].ctypes.data,
            )
            self._context[_SLOTS * d : _SLOTS * (d + 1)] = parts
        self._start, self._first = basis.offsets(n, 2), basis.factors(n, 2)[0]
        self._code, self._function = _compiled("finish")

    def __call__(self, pairs: np.ndarray, column: int) -> None:
        lanes = min(LANES, int(self._start[-1]) - column)
        self._lows[self._deep][:] = self._start[:-1] - column
        last = int(self._first[column + lanes - 1])
        x = pairs.ctypes.data + 8 * column * self._rows
        task = np.array(
            [self._context.ctypes.data, self._deep, x, LANES, last, column, 0, lanes], np.int64
        )  # is read from without the interpreter, so it must outlive the call
        self._function(task.ctypes.data)
