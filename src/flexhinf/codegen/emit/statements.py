"""Steps that hold loops of their own: functions mapped over columns, and weighted sums of rows."""

from __future__ import annotations

from collections.abc import Callable

from flexhinf.codegen.emit.function import load, store
from flexhinf.codegen.emit.text import Lanes, Writer

__all__ = ["BLOCK", "PARTS", "Loop", "pack", "unpack", "weighted_sum"]

BLOCK = 8
"""Columns of a `Map` that travel together in the lanes of a kernel for a single run."""

PARTS = 8
"""Parts of a weighted sum: as many sums as the latency of an addition asks for."""

Loop = Callable[[int, Callable[[str], None]], None]
"""(turns, body): a loop, or its turns written out if they are few."""


def pack(
    writer: Writer,
    each: Loop,
    wide: Lanes,
    source: tuple[str, bool],
    rows: int,
    count: int,
    left: int,
    target: str,
) -> None:
    """Copy `left` neighbouring columns of a matrix with `count` columns into elements of as many lanes.

    Parameters
    ----------
    writer, each : Writer, Loop
    wide : Lanes
        Of the elements; lanes without a column are zero.
    source : (str, bool)
        Address of the first of these columns in the first row, and whether one number serves all lanes.
    rows, count, left : int
    target : str
        Address of `rows` elements.
    """

    address, shared = source
    single = writer.lanes.width == 1
    unit = "double" if shared else writer.lanes.element

    def row(element: str) -> None:
        place = _row(writer, address, element, count, unit)
        if shared and not single:
            value = load(writer, place, 0, shared=True)
        elif left == wide.width or not single:
            value = writer.let(f"load {wide.real}, ptr {place}, align 8")
        else:
            value = "zeroinitializer"
            for lane in range(left):
                number = writer.let(f"getelementptr double, ptr {place}, i64 {lane}")
                number = writer.let(f"load double, ptr {number}, align 8")
                value = writer.let(f"insertelement {wide.real} {value}, double {number}, i64 {lane}")
        kept = writer.let(f"getelementptr {wide.element}, ptr {target}, i64 {element}")
        writer.do(f"store {wide.real} {value}, ptr {kept}, align 8")

    each(rows, row)


def unpack(
    writer: Writer, each: Loop, wide: Lanes, source: str, rows: int, count: int, left: int, target: str
) -> None:
    """The inverse of `pack`: from `rows` elements at `source` to columns at `target`."""

    def row(element: str) -> None:
        kept = writer.let(f"getelementptr {wide.element}, ptr {source}, i64 {element}")
        value = writer.let(f"load {wide.real}, ptr {kept}, align 8")
        place = _row(writer, target, element, count, writer.lanes.element)
        if left == wide.width or writer.lanes.width > 1:
            writer.do(f"store {wide.real} {value}, ptr {place}, align 8")
            return
        for lane in range(left):
            number = writer.let(f"extractelement {wide.real} {value}, i64 {lane}")
            position = writer.let(f"getelementptr double, ptr {place}, i64 {lane}")
            writer.do(f"store double {number}, ptr {position}, align 8")

    each(rows, row)


def _row(writer: Writer, matrix: str, element: str, count: int, unit: str) -> str:
    offset = writer.let(f"mul nsw i64 {element}, {count}")
    return writer.let(f"getelementptr {unit}, ptr {matrix}, i64 {offset}")


def weighted_sum(
    writer: Writer,
    loop: Callable[[str, Callable[[str], None]], None],
    weights: tuple[str, bool],
    rows: tuple[str, bool],
    target: str,
    sizes: tuple[int, int],
    fused: bool,
) -> None:
    """Emit Σ_a weights[a] · rows[a, :] in `PARTS` parts.

    Parameters
    ----------
    writer : Writer
    loop : callable
        (turns, body), a loop.
    weights, rows : (str, bool)
        Address, and whether one number serves all lanes.
    target : str
    sizes : (int, int)
        N and M.
    fused : bool
        The target has a fused multiply-add.

    Notes
    -----
    For a single run, neighbouring columns travel in the lanes of one vector, and every lane does what it does
    alone: the order of a sum does not depend on it.
    """
    count, width = sizes
    column = 0
    while column < width:
        together = 1
        while writer.lanes.width == 1 and together < BLOCK and column + 2 * together <= width:
            together *= 2
        lanes = Lanes(together) if writer.lanes.width == 1 else writer.lanes
        _columns_sum(writer, loop, lanes, weights, rows, target, (count, width, column), fused)
        column += together


def _columns_sum(
    writer: Writer,
    loop: Callable[[str, Callable[[str], None]], None],
    lanes: Lanes,
    weights: tuple[str, bool],
    rows: tuple[str, bool],
    target: str,
    sizes: tuple[int, int, int],
    fused: bool,
) -> None:
    count, width, column = sizes
    outer, writer.lanes = writer.lanes, lanes
    single = outer.width == 1
    parts = [writer.allocate(lanes.real) for _ in range(PARTS)]
    for part in parts:
        writer.do(f"store {lanes.real} {lanes.constant(0.0)}, ptr {part}, align 8")

    def term(number: str, part: str) -> None:
        weight = load(writer, weights[0], number, shared=single or weights[1])
        place = writer.let(f"add nsw i64 {writer.let(f'mul nsw i64 {number}, {width}')}, {column}")
        if single:
            start = writer.let(f"getelementptr double, ptr {rows[0]}, i64 {place}")
            value = load(writer, start, 0, shared=False)
        else:
            value = load(writer, rows[0], place, shared=rows[1])
        so_far = writer.let(f"load {lanes.real}, ptr {part}, align 8")
        if fused:
            total = writer.intrinsic("fma", weight, value, so_far)
        else:
            total = writer.real("fadd", writer.real("fmul", weight, value), so_far)
        writer.do(f"store {lanes.real} {total}, ptr {part}, align 8")

    def block(turn: str) -> None:
        first = writer.let(f"mul nsw i64 {turn}, {PARTS}")
        for k, part in enumerate(parts):
            term(writer.let(f"add nsw i64 {first}, {k}"), part)

    loop(str(count // PARTS), block)
    for k in range(count - count % PARTS, count):
        term(str(k), parts[k % PARTS])
    sums = [writer.let(f"load {lanes.real}, ptr {part}, align 8") for part in parts]
    while len(sums) > 1:
        sums = [writer.real("fadd", a, b) for a, b in zip(sums[::2], sums[1::2], strict=True)]
    if single:
        store(writer, writer.let(f"getelementptr double, ptr {target}, i64 {column}"), 0, sums[0])
    else:
        store(writer, target, column, sums[0])
    writer.lanes = outer
