"""One index of large symmetric tensors contracted with a matrix, in machine code.

Step s of a change of variables (`flexhinf.hinf.homological`) has a tensor of count(n, k−s) rows, its old indices, and
count(n, s) columns, its new ones. It opens one old index and makes

    result[β, (i, tail)] = Σ_j matrix[j, i] · tensor[β with j, tail]    for i ≤ the first index of tail.

The sum is a product of a small matrix with rows of the tensor that are not beside each other. BLAS wants them copied
together, and adds its calls; here each is read where it stands. Every element is one sum over j in order, whatever the
tiles and the threads, so its bits depend on the processor alone.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import run_all

_ROWS, _LANES = 4, 16  # of the result, formed together: as many sums as hide the latency of an addition
_COLUMNS = 256  # of the tensor at a time: what they are read for again stays in cache
_WHOLE = 1024  # columns up to which they are not divided
_TASKS = 64  # about as many parts as there are for threads, at most
_ENTRY = "flexhinf_contract"

_HEAD = """
define void @{entry}(ptr %tensor, ptr %opening, ptr %matrix, ptr %result, ptr %spans, ptr %sizes) {{
entry:
  %n = load i64, ptr %sizes
  %width.at = getelementptr i64, ptr %sizes, i64 1
  %width = load i64, ptr %width.at
  %wide.at = getelementptr i64, ptr %sizes, i64 2
  %wide = load i64, ptr %wide.at
  %top.at = getelementptr i64, ptr %sizes, i64 3
  %top = load i64, ptr %top.at
  %bottom.at = getelementptr i64, ptr %sizes, i64 4
  %bottom = load i64, ptr %bottom.at
  %count.at = getelementptr i64, ptr %sizes, i64 5
  %count = load i64, ptr %count.at
  br label %row
row:
  %b = phi i64 [ %top, %entry ], [ %b.next, %row.next ]
  %b.n = mul i64 %b, %n
  %opened = getelementptr i32, ptr %opening, i64 %b.n
  %b.wide = mul i64 %b, %wide
  %out = getelementptr double, ptr %result, i64 %b.wide
  br label %span
span:
  %k = phi i64 [ 0, %row ], [ %k.next, %span.next ]
  %span.first = mul i64 %k, {length}
  %span.at = getelementptr i64, ptr %spans, i64 %span.first
  %kind = load i64, ptr %span.at
  %i.at = getelementptr i64, ptr %span.at, i64 1
  %i = load i64, ptr %i.at
  %low.at = getelementptr i64, ptr %span.at, i64 2
  %low = load i64, ptr %low.at
  %high.at = getelementptr i64, ptr %span.at, i64 3
  %high = load i64, ptr %high.at
  %places = getelementptr i64, ptr %span.at, i64 4
  %column = getelementptr double, ptr %matrix, i64 %i
  switch i64 %kind, label %span.next [ {cases} ]
"""

_TAIL = """
span.next:
  %k.next = add i64 %k, 1
  %more.spans = icmp slt i64 %k.next, %count
  br i1 %more.spans, label %span, label %row.next
row.next:
  %b.next = add i64 %b, 1
  %more.rows = icmp slt i64 %b.next, %bottom
  br i1 %more.rows, label %row, label %end
end:
  ret void
}
"""


def _kind(rows: int, lanes: int, number: int) -> str:
    """Loops over columns and over j for `rows` rows of the result and `lanes` columns; the last ones overlap."""
    v, p = f"<{lanes} x double>", f"k{number}"
    each = range(rows)
    sums = "\n".join(
        f"  %{p}.s{r} = phi {v} [ zeroinitializer, %{p}.c ], [ %{p}.t{r}, %{p}.j ]" for r in each
    )
    adds = "\n".join(
        f"""  %{p}.ma{r} = getelementptr double, ptr %{p}.m, i64 {r}
  %{p}.m{r} = load double, ptr %{p}.ma{r}
  %{p}.e{r} = insertelement {v} poison, double %{p}.m{r}, i64 0
  %{p}.f{r} = shufflevector {v} %{p}.e{r}, {v} poison, <{lanes} x i32> zeroinitializer
  %{p}.t{r} = call {v} @llvm.fmuladd.v{lanes}f64({v} %{p}.f{r}, {v} %{p}.x, {v} %{p}.s{r})"""
        for r in each
    )
    stores = "\n".join(
        f"""  %{p}.pa{r} = getelementptr i64, ptr %places, i64 {r}
  %{p}.p{r} = load i64, ptr %{p}.pa{r}
  %{p}.q{r} = add i64 %{p}.p{r}, %{p}.col
  %{p}.o{r} = getelementptr double, ptr %out, i64 %{p}.q{r}
  store {v} %{p}.t{r}, ptr %{p}.o{r}, align 8"""
        for r in reversed(each)
    )
    return f"""
{p}:
  %{p}.last = sub i64 %high, {lanes}
  br label %{p}.c
{p}.c:
  %{p}.col = phi i64 [ %low, %{p} ], [ %{p}.next, %{p}.w ]
  br label %{p}.j
{p}.j:
  %{p}.jj = phi i64 [ 0, %{p}.c ], [ %{p}.jn, %{p}.j ]
{sums}
  %{p}.oa = getelementptr i32, ptr %opened, i64 %{p}.jj
  %{p}.o = load i32, ptr %{p}.oa
  %{p}.o64 = sext i32 %{p}.o to i64
  %{p}.ow = mul i64 %{p}.o64, %width
  %{p}.oc = add i64 %{p}.ow, %{p}.col
  %{p}.xa = getelementptr double, ptr %tensor, i64 %{p}.oc
  %{p}.x = load {v}, ptr %{p}.xa, align 8
  %{p}.jr = mul i64 %{p}.jj, %n
  %{p}.m = getelementptr double, ptr %column, i64 %{p}.jr
{adds}
  %{p}.jn = add i64 %{p}.jj, 1
  %{p}.more = icmp slt i64 %{p}.jn, %n
  br i1 %{p}.more, label %{p}.j, label %{p}.w
{p}.w:
{stores}
  %{p}.after = add i64 %{p}.col, {lanes}
  %{p}.fits = icmp slt i64 %{p}.after, %{p}.last
  %{p}.next = select i1 %{p}.fits, i64 %{p}.after, i64 %{p}.last
  %{p}.done = icmp sge i64 %{p}.col, %{p}.last
  br i1 %{p}.done, label %span.next, label %{p}.c
"""


_KINDS = tuple((rows, lanes) for rows in (1, _ROWS) for lanes in (1, 4, _LANES))
_SPAN = 4 + _ROWS  # of a span: kind, first row, first and last column, where the rows begin


@cache
def _compiled() -> tuple[Any, Any]:
    """The code, which must live on, and its function."""
    from flexhinf.codegen import machine
    from flexhinf.codegen.compiler import cached

    cases = " ".join(f"i64 {number}, label %k{number}" for number in range(len(_KINDS)))
    declared = "".join(
        f"declare <{lanes} x double> @llvm.fmuladd.v{lanes}f64({', '.join(3 * [f'<{lanes} x double>'])})\n"
        for lanes in sorted({lanes for _, lanes in _KINDS})
    )
    kinds = "".join(_kind(*kind, number) for number, kind in enumerate(_KINDS))
    text = declared + _HEAD.format(entry=_ENTRY, length=_SPAN, cases=cases) + kinds + _TAIL
    host = machine.host()
    code = cached(
        ("hinf", text, host.triple, host.cpu, host.features, host.version),
        lambda: machine.assemble(text, 3),
        lambda image: machine.Code(image, _ENTRY, {}),
    )
    return code, ctypes.CFUNCTYPE(None, *6 * [ctypes.c_void_p])(code.address)


def contract(
    tensor: np.ndarray, opening: np.ndarray, n: int, s: int, matrix: np.ndarray, result: np.ndarray
) -> None:
    """Fill `result` (rows, count(n, s+1)) from `tensor` (…, count(n, s)), s ≥ 1, and `opening` int32 (rows, n).

    All arrays are of doubles, C-contiguous; `matrix` (n, n).
    """
    function, rows, width = _compiled()[1], len(opening), tensor.shape[1]
    columns = width if width <= _WHOLE else max(_COLUMNS, -(-width // _TASKS))
    chunks = [(left, min(left + columns, width)) for left in range(0, width, columns)]
    high = max(1, -(-rows * len(chunks) // _TASKS))
    spans = {chunk: np.array(list(_spans(n, s, *chunk)), np.int64) for chunk in chunks}

    def task(top: int, left: int, right: int) -> None:
        table = spans[left, right]
        sizes = np.array([n, width, result.shape[1], top, min(top + high, rows), len(table)], np.int64)
        function(*(part.ctypes.data for part in (tensor, opening, matrix, result, table, sizes)))

    run_all(task, ((top, *chunk) for chunk in chunks for top in range(0, rows, high)), large=True)


def _spans(n: int, s: int, left: int, right: int) -> Iterator[tuple[int, ...]]:
    """What to form of the columns from `left` to `right`, `_ROWS` rows i at a time where all of them are wanted.

    Where no columns are left out, columns that only the first of the rows want are formed of all. What is too much lies
    in rows before, which are formed later: rows are stored from the last to the first.
    """
    start = basis.offsets(n, s)[:n]
    place, whole = basis.offsets(n, s + 1)[:n] - start, right - left == basis.count(n, s)
    for i in reversed(range(0, n, _ROWS)):
        rows = range(i, min(i + _ROWS, n))
        common = right if len(rows) < _ROWS else max(start[i if whole else rows[-1]], left)
        yield from _pieces(_ROWS, i, common, right, place)
        for row in reversed(rows):
            yield from _pieces(1, row, max(start[row], left), min(common, right), place)


def _pieces(rows: int, row: int, low: int, high: int, place: np.ndarray) -> Iterator[tuple[int, ...]]:
    """One span, in the widest vectors that fit into it."""
    if low < high:
        lanes = max(lanes for _, lanes in _KINDS if lanes <= high - low)
        places = [*place[row : row + rows], *(_ROWS - rows) * [0]]
        yield (_KINDS.index((rows, lanes)), row, int(low), int(high), *map(int, places))
