"""A run: how an algorithm of many pieces calls them, one after the other or as steps of a program."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol, TypeVar

Result = TypeVar("Result")


class Run(Protocol):
    """What `flexhinf.codegen.Direct` and `Composer` have in common, with their documentation.

    `Direct` hands on arrays of elements, a composer blocks of its program, and the pieces are called on arrays by both.
    So what a run takes beside the pieces has no type here; a piece's own result is that of the call.
    """

    def section(self, about: str) -> None:
        """Say what the next steps do, up to the next section."""
        ...

    def call(self, function: Callable[..., Result], *arrays: Any) -> Result:
        """``function(*arrays)``."""
        ...

    def when(self, flag: Any) -> AbstractContextManager[Any]:
        """A context for steps whose results count only where the flag (1,) is not zero."""
        ...

    def repeat(self, times: int, function: Callable[..., tuple[Any, ...]], *arrays: Any) -> tuple[Any, ...]:
        """``arrays = function(*arrays)``, again and again; the function calls the run by itself."""
        ...

    def columns(self, function: Callable[..., Result], moving: Any, *held: Any) -> Result:
        """``function(column, *held)`` for every column of a matrix, or of a tuple of such."""
        ...

    def sweep(self, stages: Callable[..., Any], matrix: Any, *held: Any) -> Any:
        """``stages(run, column, *held)`` for every column."""
        ...

    def beside(self, first: Any, function: Callable[..., Any], matrix: Any, *held: Any) -> Any:
        """A vector, as a column, and right of it the matrices of `columns`."""
        ...

    def gram(self, columns: Any, weights: Any, plus: Any = None) -> Any:
        """Σ wᵢ aᵢ aᵢᵀ over columns aᵢ, plus a symmetric matrix."""
        ...

    def product(self, columns: Any, weights: Any, other: Any) -> Any:
        """Σ wᵢ aᵢ bᵢᵀ over columns aᵢ and bᵢ."""
        ...

    def combination(self, columns: Any, weights: Any, plus: Any = None) -> Any:
        """Σ wᵢ aᵢ over columns aᵢ, plus a vector."""
        ...

    def cholesky(self, matrix: Any) -> Any:
        """L of L Lᵀ."""
        ...

    def householder(self, rows: Any, count: int, triangle: int = 0) -> Any:
        """Rows with the same TᵀT, the first columns zero below the diagonal."""
        ...

    def residual(self, rows: Any, slope: Any) -> Any:
        """e − C x − v of rows (e, x, v) in twice the digits."""
        ...

    def stacked(self, *matrices: Any) -> Any:
        """Matrices of one width, one below the other."""
        ...
