"""Named arrays in one flat vector: how a kernel's memory and data are laid out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput

__all__ = ["Layout"]

Shape = tuple[int, ...]


@dataclass(frozen=True)
class Layout:
    """Shapes by name; a list of shapes for a part that is a tuple of arrays.

    Parameters
    ----------
    parts : mapping of str to shape or list of shapes
        In the order of the vector.
    """

    parts: Mapping[str, Shape | list[Shape]]

    @cached_property
    def size(self) -> int:
        """Length of the vector."""
        return sum(int(np.prod(shape, dtype=int)) for part in self.parts.values() for shape in _shapes(part))

    def named(self, vector: Any) -> SimpleNamespace:
        """The parts of a vector (size,) by name."""
        start, named = 0, {}
        for name, part in self.parts.items():
            arrays = []
            for shape in _shapes(part):
                length = int(np.prod(shape, dtype=int))
                arrays.append(vector[start : start + length].reshape(shape))
                start += length
            named[name] = tuple(arrays) if isinstance(part, list) else arrays[0]
        return SimpleNamespace(**named)

    def pairs(self, values: Mapping[str, Any]) -> list[tuple[Any, slice]]:
        """Every array of named parts, and its place in the vector."""
        pairs, start = [], 0
        for name, part in self.parts.items():
            arrays = values[name] if isinstance(part, list) else [values[name]]
            for shape, array in zip(_shapes(part), arrays, strict=True):
                size = int(np.prod(shape, dtype=int))
                pairs.append((array, slice(start, start + size)))
                start += size
        return pairs

    def flat(self, values: Mapping[str, Any]) -> np.ndarray:
        """The vector (size,) of named parts; a plain number fills its part.

        Raises
        ------
        InvalidInput
            If an array has another shape than its part.
        """
        flat = []
        for name, part in self.parts.items():
            arrays = values[name] if isinstance(part, list) else [values[name]]
            for shape, array in zip(_shapes(part), arrays, strict=True):
                if np.shape(array) not in ((), shape):
                    raise InvalidInput(
                        f"The array {name!r} has the wrong shape.",
                        f"expected {shape}, got {np.shape(array)}",
                        "one element for each place",
                    )
                flat.append(np.broadcast_to(np.asarray(array), shape).ravel())
        return np.concatenate(flat)


def _shapes(part: Any) -> list[Shape]:
    return part if isinstance(part, list) else [part]
