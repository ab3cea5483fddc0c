"""Places in a buffer by the names of its parts, for the text of C."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from flexhinf.codegen.c import algebra
from flexhinf.codegen.c.identifiers import identifier
from flexhinf.codegen.memory import BufferPart, Slice
from flexhinf.codegen.naming import Names


@dataclass
class Parts:
    """The parts of a buffer: pointers by their names, or constants of C, whose names are in capitals.

    `size`: Numbers of the buffer, each `lanes` times. `names`: Of the function that has the pointers.
    """

    buffer: str
    size: int
    parts: Sequence[BufferPart]
    names: Names
    lanes: int = 1
    _said: set[str] = field(default_factory=set[str])

    def __post_init__(self) -> None:
        self._pointers = [
            part.name if part.name.isupper() else self.names.allot(identifier(part.name))
            for part in self.parts
        ]

    def at(self, piece: Slice) -> str:
        """Where a piece begins, but for how it moves in loops."""
        k = bisect_right(self.parts, piece.offset, key=lambda part: part.offset) - 1
        if k < 0 or (piece.offset == 0 and piece.size == self.size):
            return algebra.ahead(self.buffer, piece.offset * self.lanes)
        part = self.parts[k]
        begin = f"{self.buffer} + {part.name}" if part.name.isupper() else self._pointers[k]
        return algebra.ahead(begin, (piece.offset - part.offset) * self.lanes)

    def about(self, pieces: Sequence[Slice]) -> str:
        """What begins with a step that writes these pieces, said once."""
        for part in self.parts:
            begun = any((p.buffer, p.offset) == (self.buffer, part.offset) for p in pieces)
            if begun and part.about and part.name not in self._said:
                self._said.add(part.name)
                return part.about
        return ""

    def declared(self, lines: Sequence[str], real: str) -> Iterator[str]:
        """The pointers that lines use, but for words of comments."""
        text = re.sub(r"/\*.*?\*/", "", "\n".join(lines), flags=re.DOTALL)
        used = set(re.findall(r"\w+", text))
        for part, name in zip(self.parts, self._pointers, strict=True):
            if name in used and not name.isupper():
                at = part.offset * self.lanes
                yield f"{real} *const {name} = {f'&{self.buffer}[{at}]' if at else self.buffer};"
