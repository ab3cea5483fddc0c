"""Functions mapped over the columns of matrices: columns are packed into lanes, and unpacked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flexhinf.codegen.emit.function import load
from flexhinf.codegen.emit.text import Lanes, Writer

BLOCK = 8
"""Columns of a `Map` that travel together in the lanes of a kernel for a single run."""


@dataclass(frozen=True)
class Packer:
    """Copies neighbouring columns of a matrix into elements of as many lanes, and back.

    Parameters
    ----------
    each : callable
        (turns, body): a loop, or its turns written out if they are few.
    wide : Lanes
        Of the packed elements; in a kernel of several lanes these are the kernel's, and a column goes alone.
    left : int
        Columns; lanes without one are zero.
    """

    writer: Writer
    each: Callable[[int, Callable[[str], None]], None]
    wide: Lanes
    left: int

    def pack(self, source: str, shared: bool, rows: int, moves: tuple[int, int], target: str) -> None:
        """From the first of these columns at `source` to `rows` elements at `target`.

        Parameters
        ----------
        shared : bool
            One number serves all lanes of the kernel.
        moves : (int, int)
            See `flexhinf.codegen.memory.Columns.moves`.
        """
        writer, wide, single = self.writer, self.wide, self.writer.lanes.width == 1
        unit = "double" if shared else writer.lanes.element

        def row(element: str) -> None:
            place = self._place(source, element, moves[0], unit)
            if not single:
                value = load(writer, place, 0, shared)
            elif self._neighbours(moves):
                value = writer.let(f"load {wide.real}, ptr {place}, align 8")
            else:
                value = "zeroinitializer"
                for lane in range(self.left):
                    number = writer.let(f"getelementptr double, ptr {place}, i64 {lane * moves[1]}")
                    number = writer.let(f"load double, ptr {number}, align 8")
                    value = writer.let(f"insertelement {wide.real} {value}, double {number}, i64 {lane}")
            kept = writer.let(f"getelementptr {wide.element}, ptr {target}, i64 {element}")
            writer.do(f"store {wide.real} {value}, ptr {kept}, align 8")

        self.each(rows, row)

    def unpack(self, source: str, rows: int, moves: tuple[int, int], target: str) -> None:
        """The inverse: from `rows` elements at `source` to the first of these columns at `target`."""
        writer, wide = self.writer, self.wide

        def row(element: str) -> None:
            kept = writer.let(f"getelementptr {wide.element}, ptr {source}, i64 {element}")
            value = writer.let(f"load {wide.real}, ptr {kept}, align 8")
            place = self._place(target, element, moves[0], writer.lanes.element)
            if writer.lanes.width > 1 or self._neighbours(moves):
                writer.do(f"store {wide.real} {value}, ptr {place}, align 8")
                return
            for lane in range(self.left):
                number = writer.let(f"extractelement {wide.real} {value}, i64 {lane}")
                position = writer.let(f"getelementptr double, ptr {place}, i64 {lane * moves[1]}")
                writer.do(f"store double {number}, ptr {position}, align 8")

        self.each(rows, row)

    def _neighbours(self, moves: tuple[int, int]) -> bool:
        return self.left == self.wide.width and (moves[1] == 1 or self.left == 1)

    def _place(self, matrix: str, element: str, move: int, unit: str) -> str:
        offset = self.writer.let(f"mul nsw i64 {element}, {move}")
        return self.writer.let(f"getelementptr {unit}, ptr {matrix}, i64 {offset}")
