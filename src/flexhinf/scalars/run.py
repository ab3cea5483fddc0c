"""A run: how an algorithm of many pieces calls them, one after the other or as steps of a program."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar

from flexhinf.arrays import Elements

Result = TypeVar("Result")


class Run(Protocol):
    """What `flexhinf.codegen.Direct` and `Composer` have in common, with their documentation.

    `Direct` hands on arrays of elements. A composer hands on blocks of its program, which stand for them: its `as_run`
    is one of these. What is handed on to a piece may be anything that the piece takes.
    """

    def section(self, about: str) -> None:
        """Say what the next steps do, up to the next section."""
        ...

    def call(self, function: Callable[..., Result], *arrays: object) -> Result:
        """``function(*arrays)``."""
        ...

    def when(self, flag: Elements) -> AbstractContextManager[object]:
        """A context for steps whose results count only where the flag (1,) is not zero."""
        ...

    def repeat(
        self, times: int, function: Callable[..., tuple[Elements, ...]], *arrays: Elements
    ) -> tuple[Elements, ...]:
        """``arrays = function(*arrays)``, again and again; the function calls the run by itself."""
        ...

    def columns(
        self, function: Callable[..., Result], moving: Elements | tuple[Elements, ...], *held: object
    ) -> Result:
        """``function(column, *held)`` for every column of a matrix, or of a tuple of such."""
        ...

    def sweep(self, stages: Callable[..., Elements], matrix: Elements, *held: object) -> Elements:
        """``stages(run, column, *held)`` for every column."""
        ...

    def beside(
        self, first: Elements, function: Callable[..., tuple[Elements, ...]], matrix: Elements, *held: object
    ) -> Elements:
        """A vector, as a column, and right of it the matrices of `columns`."""
        ...

    def gram(self, columns: Elements, weights: Elements, plus: Elements | None = None) -> Elements:
        """Σ wᵢ aᵢ aᵢᵀ over columns aᵢ, plus a symmetric matrix."""
        ...

    def product(self, columns: Elements, weights: Elements, other: Elements) -> Elements:
        """Σ wᵢ aᵢ bᵢᵀ over columns aᵢ and bᵢ."""
        ...

    def combination(self, columns: Elements, weights: Elements, plus: Elements | None = None) -> Elements:
        """Σ wᵢ aᵢ over columns aᵢ, plus a vector."""
        ...

    def cholesky(self, matrix: Elements) -> Elements:
        """L of L Lᵀ."""
        ...

    def householder(self, rows: Elements, count: int, triangle: int = 0) -> Elements:
        """Rows with the same TᵀT, the first columns zero below the diagonal."""
        ...

    def residual(self, rows: Elements, slope: Elements) -> Elements:
        """e − C x − v of rows (e, x, v) in twice the digits."""
        ...

    def stacked(self, *matrices: Elements) -> Elements:
        """Matrices of one width, one below the other."""
        ...
