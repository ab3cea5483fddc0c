"""One algorithm, run in two ways: as plain NumPy code, or as a program composed of traced pieces.

An algorithm is written once, against a *run* that offers a few ways of calling a function (once: `call`; on every
column of a matrix: `columns`) and a few sums of linear algebra. `Direct` does just that with whatever arrays it is
given: numbers, symbols, intervals. A `Composer` traces each function once, on symbols of the right shapes, and
writes steps of a program that apply it: a 7-link estimator, which would be half a million operations as one
trace, is some thousand operations in loops over its sigma points.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from math import prod
from typing import TYPE_CHECKING, TypeAlias, TypeVar, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.codegen.memory import COLUMN, Block, Buffer, BufferPart, Order, Slice
from flexhinf.codegen.naming import (
    Names,
    argument_names,
    documentation,
    function_name,
    names_of,
    result_names,
)
from flexhinf.codegen.program import (
    Call,
    Cholesky,
    Copy,
    Householder,
    Map,
    OuterSum,
    Polynomial,
    Repeat,
    Residual,
    Step,
    Sweep,
    When,
)

if TYPE_CHECKING:
    import casadi

    from flexhinf.scalars.run import Run

SCRATCH = "scratch"

#: What a piece gives.
Result = TypeVar("Result")

#: A function of arrays, or of a run and arrays.
Traceable = TypeVar("Traceable", bound=Callable[..., object])

#: Traced, the shapes of its results, and whether these are several.
TracedPiece: TypeAlias = "tuple[casadi.Function, list[tuple[int, ...]], bool]"


def gives(*names: str) -> Callable[[Traceable], Traceable]:
    """Names of a function's results, for C; one that begins with ``*`` stands for any number of them."""

    def named(function: Traceable) -> Traceable:
        function.results = names  # pyright: ignore[reportFunctionMemberAccess]  # for `result_names`
        return function

    return named


class Direct:
    """Plain evaluation, on any elements."""

    def begin(self) -> None:
        """Let go of what was recorded: a traced function is called more than once."""

    def recorded(self) -> list[Elements]:
        """What was computed on the way, (k,) arrays, where the run keeps it."""
        return []

    def section(self, about: str) -> None:
        """Say what the next steps do, up to the next section: a comment in exported C."""

    def call(self, function: Callable[..., Result], *arrays: object) -> Result:
        """``function(*arrays)``, for small functions."""
        return function(*arrays)

    def when(self, flag: Elements) -> AbstractContextManager[object]:
        """A context for steps whose results count only where the flag (1,) is not zero: select them by the flag."""
        return nullcontext(flag)

    def repeat(
        self, times: int, function: Callable[..., tuple[Elements, ...]], *arrays: Elements
    ) -> tuple[Elements, ...]:
        """``arrays = function(*arrays)``, again and again; the function calls the run by itself."""
        for _ in range(times):
            arrays = function(*arrays)
        return arrays

    def columns(
        self, function: Callable[..., Result], moving: Elements | tuple[Elements, ...], *held: object
    ) -> Result:
        """``function(column, *held)`` for every column.

        `function`: Takes a vector per moving matrix, and what is held; returns a vector, or a tuple of vectors.
        `moving`: a matrix (r, s) or a tuple of such, as the result (r', s) is.
        """
        matrices: tuple[Elements, ...] = moving if isinstance(moving, tuple) else (moving,)
        results = [function(*column, *held) for column in zip(*(m.T for m in matrices), strict=True)]
        several = isinstance(results[0], tuple)
        columns = cast(list[tuple[Elements, ...]], results if several else [(result,) for result in results])
        stacks = tuple(np.stack(parts, axis=1) for parts in zip(*columns, strict=True))
        return cast(Result, stacks if several else stacks[0])

    def sweep(self, stages: Callable[..., Elements], matrix: Elements, *held: object) -> Elements:
        """``stages(run, column, *held)`` for every column of a matrix (n, s), where one function would be too large.

        Returns (n', s).
        """
        return self.columns(partial(stages, self), matrix, *held)

    def beside(
        self, first: Elements, function: Callable[..., tuple[Elements, ...]], matrix: Elements, *held: object
    ) -> Elements:
        """A vector, as a column, and right of it the matrices of `columns` for a function of several results."""
        return np.column_stack((first, *self.columns(function, matrix, *held)))

    def gram(self, columns: Elements, weights: Elements, plus: Elements | None = None) -> Elements:
        """Σ wᵢ aᵢ aᵢᵀ over columns aᵢ, plus a symmetric matrix; exactly symmetric."""
        from flexhinf.scalars import gram

        return gram(columns, weights) if plus is None else gram(columns, weights) + plus

    def product(self, columns: Elements, weights: Elements, other: Elements) -> Elements:
        """Σ wᵢ aᵢ bᵢᵀ over columns aᵢ and bᵢ."""
        from flexhinf.scalars import gram

        return gram(columns, weights, other)

    def combination(self, columns: Elements, weights: Elements, plus: Elements | None = None) -> Elements:
        """Σ wᵢ aᵢ over columns aᵢ, plus a vector."""
        return columns @ weights if plus is None else plus + columns @ weights

    @gives("root")
    def cholesky(self, matrix: Elements) -> Elements:
        """L of L Lᵀ, see `flexhinf.scalars.cholesky`."""
        from flexhinf.scalars import cholesky

        return cholesky(matrix)

    def householder(self, rows: Elements, count: int, triangle: int = 0) -> Elements:
        """Rows with the same TᵀT, the first columns zero below the diagonal, see `flexhinf.scalars.householder`.

        `triangle`: So many of the last rows are upper triangular, 0 or at least `count`.
        """
        from flexhinf.scalars import householder

        return householder(rows, count)

    def residual(self, rows: Elements, slope: Elements) -> Elements:
        """e − C x − v of rows (e, x, v) in twice the digits, see `flexhinf.scalars.residual`."""
        from flexhinf.scalars import residual

        return residual(rows, slope)

    def stacked(self, *matrices: Elements) -> Elements:
        """Matrices of one width, one below the other."""
        return np.concatenate(matrices)


DIRECT = Direct()


class Composer:
    """Writes the steps of a program; arrays are `Block`, and anything else is a constant.

    Matrices whose columns are points have the order "F", so that a point is one row of numbers; what is computed
    from columns has the order of the (first) matrix they belong to.
    """

    scratch = SCRATCH

    def __init__(self) -> None:
        self.body: list[Step] = []
        self.size = 0  # numbers of scratch memory so far
        self.parts: list[BufferPart] = []
        self._names = Names()
        self._about = ""
        self._pieces = dict[Hashable, TracedPiece]()
        self._kept = list[object]()

    @property
    def buffers(self) -> tuple[Buffer, ...]:
        """The scratch memory that the steps need."""
        work = Buffer(self.scratch, self.size or 1, "work", cleared=False, parts=tuple(self.parts))
        return (work,) if self.size else ()

    def section(self, about: str) -> None:
        """As `Direct.section`."""
        self._about = about

    def work(self, shape: tuple[int, ...], order: Order = "C", name: str = "part") -> Block:
        """New scratch memory; `name` says in C what is computed there, with a number where another has it."""
        size = prod(shape)
        if not size:
            return Block(None, shape, order)
        self.parts.append(BufferPart(self._names.allot(name, ""), self.size, self._about))
        self._about = ""
        self.size += size
        return Block(Slice(self.scratch, self.size - size, size), shape, order)

    def copy(self, source: Block, target: Block) -> None:
        """Copy elements, if there are any."""
        source = self._ordered(source, target.order)
        if source.size and source.place != target.place:
            self.body.append(Copy(source.place, target.place))

    @property
    def as_run(self) -> Run:
        """This one, for algorithms: blocks stand for the arrays that they are written for."""
        return cast("Run", self)

    @overload
    def call(self, function: Callable[..., Elements], *arrays: object) -> Block: ...

    @overload
    def call(self, function: Callable[..., tuple[object, ...]], *arrays: object) -> tuple[Block, ...]: ...

    def call(self, function: Callable[..., object], *arrays: object) -> Block | tuple[Block, ...]:
        """As `Direct.call`: one traced piece."""
        traced, shapes, several = self._traced(function, arrays, [None] * len(arrays))
        results = self._results(function, shapes)
        filled = [result.place for result in results if result.size]
        inputs = [array.place for array in arrays if isinstance(array, Block) and array.size]
        if filled:
            names = names_of(function, arrays, [prod(shape) > 0 for shape in shapes])
            self.body.append(Call(traced, tuple(inputs), tuple(filled), documentation(function), names))
        return tuple(results) if several else results[0]

    @contextmanager
    def when(self, flag: Block) -> Generator[None, None, None]:
        """As `Direct.when`: steps that are left out where the flag is zero."""
        outside, self.body = self.body, []
        try:
            yield
        finally:
            inside, self.body = self.body, outside
        self.body.append(When(flag.place, tuple(inside)))

    def repeat(
        self, times: int, function: Callable[..., tuple[Block, ...]], *arrays: Block
    ) -> tuple[Block, ...]:
        """As `Direct.repeat`: one loop; the function gives new memory, and uses none that moves with outer loops."""
        if times < 2:
            return function(*arrays) if times else arrays
        names = argument_names(function, arrays) or ("repeated",) * len(arrays)
        held = tuple(self.work(a.shape, name=name) for a, name in zip(arrays, names, strict=True))
        for array, place in zip(arrays, held, strict=True):
            self.copy(array, place)
        outside, self.body = self.body, []
        try:
            for result, place in zip(function(*held), held, strict=True):
                self.copy(result, place)
        finally:
            inside, self.body = self.body, outside
        self.body.append(Repeat(times, tuple(inside)))
        return held

    @overload
    def columns(
        self,
        function: Callable[..., Elements],
        moving: Block | tuple[Block, ...],
        *held: object,
        into: tuple[Block, ...] | None = None,
    ) -> Block: ...

    @overload
    def columns(
        self,
        function: Callable[..., tuple[object, ...]],
        moving: Block | tuple[Block, ...],
        *held: object,
        into: tuple[Block, ...] | None = None,
    ) -> tuple[Block, ...]: ...

    def columns(
        self,
        function: Callable[..., object],
        moving: Block | tuple[Block, ...],
        *held: object,
        into: tuple[Block, ...] | None = None,
    ) -> Block | tuple[Block, ...]:
        """As `Direct.columns`: one piece, traced for one column; into new memory, or that of given blocks."""
        matrices: tuple[Block, ...] = moving if isinstance(moving, tuple) else (moving,)
        count, order = matrices[0].shape[1], matrices[0].order
        traced, shapes, several = self._traced(
            function, (*matrices, *held), [(matrix.shape[0],) for matrix in matrices] + [None] * len(held)
        )
        results = into or tuple(self._results(function, [(prod(shape), count) for shape in shapes], order))
        inputs = (
            *(matrix.columns for matrix in matrices),
            *(array.place for array in held if isinstance(array, Block) and array.size),
        )
        outputs, names = (
            tuple(result.columns for result in results),
            names_of(function, (*matrices, *held), [True] * len(results)),
        )
        self.body.append(Map(traced, inputs, outputs, documentation(function), names))
        return results if several else results[0]

    def sweep(self, stages: Callable[..., object], matrix: Block, *held: object) -> Block:
        """As `Direct.sweep`: steps in the memory of a column."""
        inside = _ColumnComposer(self)
        column = inside.work((matrix.shape[0],), name="start")
        result = cast(Block, stages(inside, column, *held))
        target = self.work((len(result), matrix.shape[1]), matrix.order, "moved")
        read, written = (matrix.columns, column.place), (target.columns, result.place)
        self.body.append(Sweep(tuple(inside.body), (read,), (written,), inside.size, tuple(inside.parts)))
        return target

    def beside(self, first: Block, function: Callable[..., object], matrix: Block, *held: object) -> Block:
        """As `Direct.beside`: every result is computed where it belongs."""
        n, count = matrix.shape
        shapes = self._traced(function, (matrix, *held), [(n,), *[None] * len(held)])[1]
        whole = self.work((len(first), 1 + count * len(shapes)), "F", function_name(function))
        self.copy(first, whole.T[:1].reshape(len(first)))
        places = [whole.T[1 + k * count : 1 + (k + 1) * count].T for k in range(len(shapes))]
        self.columns(cast("Callable[..., tuple[object, ...]]", function), matrix, *held, into=tuple(places))
        return whole

    def gram(self, columns: Block, weights: Block | ArrayLike, plus: Block | None = None) -> Block:
        """As `Direct.gram`."""
        points = self._ordered(columns.T, "C")
        return self._outer_sum("gram", points, points, self._weights(weights), plus, symmetric=True)

    def product(self, columns: Block, weights: Block | ArrayLike, other: Block) -> Block:
        """As `Direct.product`."""
        return self._outer_sum("product", columns.T, other.T, self._weights(weights), None)

    def combination(self, columns: Block, weights: Block | ArrayLike, plus: Block | None = None) -> Block:
        """As `Direct.combination`."""
        factors = self._block(weights)
        left = factors.reshape(len(factors), 1)
        return self._outer_sum("combination", left, columns.T, None, plus).reshape(columns.shape[0])

    def cholesky(self, matrix: Block) -> Block:
        """As `Direct.cholesky`."""
        factor = self.work(matrix.shape, "F", "root")
        self.body.append(Cholesky(matrix.place, factor.place))
        return factor

    def householder(self, rows: Block, count: int, triangle: int = 0) -> Block:
        """As `Direct.householder`."""
        rows = self._ordered(rows, "C")
        target = self.work(rows.shape, name="reflected")
        shape = (rows.shape[0], rows.shape[1])
        self.body.append(Householder(rows.place, target.place, shape, count, triangle))
        return target

    def residual(self, rows: Block, slope: Block) -> Block:
        """As `Direct.residual`."""
        rows, slope = self._ordered(rows, "C"), self._ordered(slope, "C")
        target = self.work((len(rows), len(slope)), name="residual")
        self.body.append(Residual(rows.place, slope.place, target.place, (slope.shape[0], slope.shape[1])))
        return target

    def stacked(self, *matrices: Block) -> Block:
        """As `Direct.stacked`."""
        rows, first = sum(len(matrix) for matrix in matrices), 0
        whole = self.work((rows, matrices[0].shape[1]), name="stacked")
        for matrix in matrices:
            self.copy(matrix, whole[first : first + len(matrix)])
            first += len(matrix)
        return whole

    def polynomial(self, point: Block, table: Block, degrees: tuple[int, ...], values: int) -> Block:
        """Values of polynomials at a point (n,), see `flexhinf.codegen.memory.Polynomial`; table is (Nmon, columns)."""
        target = self.work((values,), name="polynomials")
        self.body.append(Polynomial(point.place, table.place, target.place, degrees))
        return target

    # Inside ----------------------------------------------------------------------------------------
    def _results(
        self, function: Callable[..., object], shapes: Sequence[tuple[int, ...]], order: Order = "C"
    ) -> list[Block]:
        """Memory for the results of a function, by its name."""
        names = result_names(function, len(shapes))
        return [self.work(shape, order, name) for shape, name in zip(shapes, names)]

    def _outer_sum(
        self,
        name: str,
        left: Block,
        right: Block,
        weights: Block | None,
        plus: Block | None,
        symmetric: bool = False,
    ) -> Block:
        left, right = self._ordered(left, "C"), self._ordered(right, "C")
        target = self.work((left.shape[1], right.shape[1]), name=name)
        factor, added = (None if block is None else block.place for block in (weights, plus))
        self.body.append(OuterSum(left.place, right.place, target.place, len(left), factor, added, symmetric))
        return target

    def _block(self, array: Block | ArrayLike) -> Block:
        return array if isinstance(array, Block) else self.call(_constants, np.asarray(array, dtype=float))

    def _weights(self, weights: Block | ArrayLike) -> Block | None:
        ones = not isinstance(weights, Block) and np.all(np.equal(weights, 1.0))
        return None if ones else self._block(weights)

    def _ordered(self, block: Block, order: Order) -> Block:
        if len(block.shape) < 2 or block.order == order or not block.size:
            return block
        target = self.work(block.shape, order, "ordered")
        return self.columns(_same, block, into=(target,))

    def _traced(
        self,
        function: Callable[..., object],
        arrays: Sequence[object],
        shapes: Sequence[tuple[int, ...] | None],
    ) -> TracedPiece:
        """A function of the blocks among the arrays, the shapes of its results, and whether they are several.

        `shapes`: A shape instead of the array's own, or None.
        """
        from flexhinf.scalars import drop_empty, trace

        seen: list[tuple[int, ...]] = []
        several = False
        blocks = [(block, shape) for block, shape in zip(arrays, shapes) if isinstance(block, Block)]
        flipped = [shape is None and block.order == "F" for block, shape in blocks]
        lying = [
            shape or (block.T.shape if flip else block.shape) for (block, shape), flip in zip(blocks, flipped)
        ]
        key = (
            function,
            tuple(lying),
            tuple(flipped),
            tuple(id(array) for array in arrays if not isinstance(array, Block)),
        )
        if key in self._pieces:
            return self._pieces[key]

        def on_symbols(*symbols: Elements) -> tuple[Elements, ...]:
            nonlocal several
            columns = iter(s.T if flip else s for s, flip in zip(symbols, flipped))
            results = function(*(next(columns) if isinstance(array, Block) else array for array in arrays))
            several = isinstance(results, tuple)
            flat = cast("tuple[ArrayLike, ...]", results if several else (results,))
            elements = [np.asarray(result) for result in flat]
            seen[:] = [result.shape for result in elements]
            return tuple(result for result in elements if result.size)

        self._pieces[key] = (
            drop_empty(trace(on_symbols, *lying, name=function_name(function))),
            seen,
            several,
        )
        self._kept.extend((function, *arrays))  # so that no other function or constant gets their place
        return self._pieces[key]


class _ColumnComposer(Composer):
    """Composes the steps of a sweep; what does not depend on the column is computed outside, once for all of them."""

    scratch = COLUMN

    def __init__(self, outside: Composer) -> None:
        super().__init__()
        self._outside, self._names = outside, outside._names
        self._divisions: dict[
            Hashable, tuple[casadi.Function | None, casadi.Function | None, tuple[bool, ...]]
        ] = {}
        self._parts: dict[Hashable, tuple[tuple[Slice, ...], list[Block]]] = {}

    @overload
    def call(self, function: Callable[..., Elements], *arrays: object) -> Block: ...

    @overload
    def call(self, function: Callable[..., tuple[object, ...]], *arrays: object) -> tuple[Block, ...]: ...

    def call(self, function: Callable[..., object], *arrays: object) -> Block | tuple[Block, ...]:
        """As `Direct.call`: one traced piece, or two."""
        from flexhinf.scalars import divide

        blocks = [array for array in arrays if isinstance(array, Block) and array.size]
        moving = tuple(block.place.buffer == COLUMN for block in blocks)
        if not any(moving):
            return self._outside.call(cast("Callable[..., Elements]", function), *arrays)
        traced, shapes, several = self._traced(function, arrays, [None] * len(arrays))
        key = (traced.__hash__(), moving)
        if key not in self._divisions:
            self._divisions[key] = divide(traced, moving)
        _, later, moves = self._divisions[key]
        filled = [shape for shape in shapes if prod(shape)]
        known = argument_names(function, arrays)
        more, still = self._before(
            key,
            tuple(block.place for block, moves in zip(blocks, moving) if not moves),
            tuple(name for name, moves in zip(known, moving) if not moves),
            [shape for shape, m in zip(filled, moves) if not m],
        )
        moved = self._results(function, [shape for shape, m in zip(filled, moves) if m])
        if later is not None:
            inputs = (*(block.place for block in blocks), *more)
            names = *known, *["before"] * len(more)
            self.body.append(
                Call(later, inputs, tuple(result.place for result in moved), documentation(function), names)
            )
        kinds, places = {True: iter(moved), False: iter(still)}, iter(moves)
        results = [next(kinds[next(places)]) if prod(shape) else self.work(shape) for shape in shapes]
        return tuple(results) if several else results[0]

    def _before(
        self, key: Hashable, held: tuple[Slice, ...], known: tuple[str, ...], shapes: list[tuple[int, ...]]
    ) -> tuple[tuple[Slice, ...], list[Block]]:
        """Where the numbers are that are computed once outside, and the results that do not move, of these shapes."""
        before = self._divisions[key][0]
        if before is None:
            return (), []
        if (key, held) not in self._parts:
            column = (
                (self._outside.work((before.size1_out(0),), name="before").place,)
                if before.n_out() > len(shapes)
                else ()
            )
            still = [self._outside.work(shape, name="before") for shape in shapes]
            written = (*column, *(block.place for block in still))
            self._outside.body.append(Call(before, held, written, "What is the same for all columns", known))
            self._parts[key, held] = column, still
        return self._parts[key, held]


def _constants(array: Elements) -> Elements:
    """Constants."""
    return array


def _same(column: Elements) -> Elements:
    """A copy in another order."""
    return column
