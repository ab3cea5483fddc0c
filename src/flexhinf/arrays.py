"""Types of arrays that all rooms share: of numbers, or of the elements that model code runs on."""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Numbers along one axis, (n,).
Vector: TypeAlias = NDArray[np.float64]

#: Numbers along two axes, (n, m).
Matrix: TypeAlias = NDArray[np.float64]

#: An array of elements of one kind: floats, or objects with the arithmetic of `Element`. NumPy has no type for what an
#: array of objects holds. Of code that runs on a `Run`, a block of a program stands for such an array.
Elements: TypeAlias = NDArray[Any]

#: A number, or an array of numbers for many robots at once.
Number: TypeAlias = float | NDArray[np.float64]

#: Numbers of any shape that NumPy reads, or None where a default takes their place.
Numbers: TypeAlias = ArrayLike | None


class Element(Protocol):
    """What model code computes with: a number, a symbol, a truncated polynomial, a power series, an interval.

    Arithmetic with a float, and with another of its kind, gives one of its kind; NumPy's functions call the methods of
    the same name. Operands and results have no type here, since each kind knows its own alone.
    """

    def __add__(self, other: Any, /) -> Any: ...

    def __radd__(self, other: Any, /) -> Any: ...

    def __sub__(self, other: Any, /) -> Any: ...

    def __rsub__(self, other: Any, /) -> Any: ...

    def __mul__(self, other: Any, /) -> Any: ...

    def __rmul__(self, other: Any, /) -> Any: ...

    def __truediv__(self, other: Any, /) -> Any: ...

    def __rtruediv__(self, other: Any, /) -> Any: ...

    def __neg__(self) -> Any: ...

    def __lt__(self, other: Any, /) -> Any: ...

    def __gt__(self, other: Any, /) -> Any: ...
