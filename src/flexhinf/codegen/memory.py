"""Where a kernel's numbers lie: named flat arrays, slices of them, and slices read as matrices.

Steps of dense algebra: sums of outer products, polynomials, Cholesky factors, reflections.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.polynomial import basis
from flexhinf.validation import is_integer, one_of

if TYPE_CHECKING:
    import casadi

#: Bytes of a line of the cache.
LINE = 64

Role = Literal["in", "out", "state", "work"]
Order = Literal["C", "F"]

#: The memory of the column in hand, inside of a `flexhinf.codegen.program.Sweep`; no buffer of a program.
COLUMN = "column"


@dataclass(frozen=True)
class BufferPart:
    """A part of a buffer, up to the next one, by its name, for readers of C.

    `name`: In capitals, it is a constant that the C has for the place. `offset`: Where it begins. `about`: What is done
    from the step on that writes it first; empty for the same as before.
    """

    name: str
    offset: int
    about: str = ""


@dataclass(frozen=True)
class Buffer:
    """A flat float64 array, known by name.

    `name`: An identifier, unique in the program. `size`: Number of elements per lane; None leaves it to the array
    given at run time. `role`: {"in", "out", "state", "work"}, "in" is only read; "out" is written; "state" is read and
    written; "work" belongs to the kernel: the caller gives no array for it, and it is zero at the start of every run.
    `shared`: One copy for all lanes (only for "in"). `cleared`: False for a work buffer of which every element is
    written before it is read: then nothing is spent on zeros. `parts`: What lies in it, in order. Raises InvalidInput:
    bad name, size or role; a shared buffer that is not "in"; a work buffer without a size; `cleared` for another.
    """

    name: str
    size: int | None
    role: Role
    shared: bool = False
    cleared: bool = True
    parts: tuple[BufferPart, ...] = ()

    def __post_init__(self) -> None:
        check_identifier(self.name, "buffer")
        rows = (
            (self.role not in get_args(Role), f"one of the roles {', '.join(get_args(Role))}"),
            (
                self.size is not None and not (is_integer(self.size) and self.size > 0),
                "a positive size, or None",
            ),
            (
                self.size is None and self.role == "work",
                "a size of a work buffer, which the kernel makes itself",
            ),
            (not self.cleared and self.role != "work", "cleared=True: only work buffers are cleared"),
            (self.shared and self.role != "in", "shared=False: lanes may only share what they all read"),
        )
        for wrong, expected in rows:
            if wrong:
                raise misfit(f"Buffer '{self.name}' is not usable.", expected, self)


@dataclass(frozen=True)
class Slice:
    """Elements ``offset + shift + Σ_d strides[d]·k_d + (0 … size-1)`` of a buffer; k_d counts the d-th loop around.

    `offset`: First element, in elements. `size`: Number of elements. `strides`: Elements to move per turn of each
    enclosing `Repeat`, outermost first; ``()`` stays in place. `shift`: Name of a count of the program: so many
    elements further on, known when it runs. A row of a record that is read so many rows after it was written is a
    queue of any length. Empty for none. Raises InvalidInput: negative offset, size below one, or strides that are not
    integers.
    """

    buffer: str
    offset: int = 0
    size: int = 1
    strides: tuple[int, ...] = ()
    shift: str = ""

    def __post_init__(self) -> None:
        numbers = (self.offset, self.size, *self.strides)
        if not all(map(is_integer, numbers)) or self.offset < 0 or self.size < 1:
            raise misfit(
                f"A slice of '{self.buffer}' is not usable.",
                "integers with offset ≥ 0 and size ≥ 1",
                repr(numbers),
            )

    def __str__(self) -> str:
        moves = "".join(f" + {stride}·k{depth}" for depth, stride in enumerate(self.strides) if stride)
        return f"{self.buffer}[{self.offset}{f' + {self.shift}' if self.shift else ''}{moves} : +{self.size}]"


@dataclass(frozen=True)
class Columns:
    """A slice read as a matrix, of which a `Map` takes one column at a time.

    `whole`: All of the matrix. `count`: Number of columns, a divisor of the slice's size. `order`: {"C", "F"}, rows
    one after the other, or columns one after the other. Raises InvalidInput: A count that does not divide the size, or
    another order.
    """

    whole: Slice
    count: int
    order: Order = "C"

    def __post_init__(self) -> None:
        one_of("A matrix has an unknown order.", self.order, get_args(Order))
        if not is_integer(self.count) or self.count < 1 or self.whole.size % self.count:
            raise misfit(
                f"{self.whole} is no matrix of {self.count} columns.",
                f"a positive divisor of {self.whole.size}",
                repr(self.count),
            )

    @property
    def size(self) -> int:
        """Elements of one column."""
        return self.whole.size // self.count

    @property
    def moves(self) -> tuple[int, int]:
        """Elements from one element of a column to the next, and from one column to the next."""
        return (self.count, 1) if self.order == "C" else (1, self.size)

    def __str__(self) -> str:
        return f"columns of {self.whole}"


@dataclass(frozen=True)
class Block:
    """An array of a program that is being composed: where it lies, its shape, and its order.

    `piece`: None for an array without elements. `order`: {"C", "F"}, of a matrix: rows, or columns, one after the
    other. Only matrices may have "F".
    """

    piece: Slice | None
    shape: tuple[int, ...]
    order: Order = "C"

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)

    @property
    def place(self) -> Slice:
        """Where it lies; only for arrays with elements."""
        if self.piece is None:
            raise InvalidInput("An empty array has no place.", f"got shape {self.shape}", "no step for it")
        return self.piece

    @property
    def T(self) -> Block:
        """The transposed matrix: the same elements in the other order."""
        return Block(self.piece, self.shape[::-1], "F" if self.order == "C" else "C")

    @property
    def columns(self) -> Columns:
        """The columns of a matrix, for a `Map`."""
        return Columns(self.place, self.shape[1], self.order)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, part: slice) -> Block:
        """Neighbouring elements of a vector, or rows of a matrix in C order."""
        if self.order == "F":
            raise InvalidInput("Rows of a block are not neighbours.", f"got {self}", "C order")
        start, stop, _ = part.indices(self.shape[0])
        shape = (max(0, stop - start), *self.shape[1:])
        if not prod(shape):
            return Block(None, shape)
        width, piece = prod(self.shape[1:]), self.place
        return Block(replace(piece, offset=piece.offset + start * width, size=prod(shape)), shape)

    def reshape(self, *shape: int | tuple[int, ...]) -> Block:
        """The same elements in C order in another shape."""
        wanted = tuple(n for part in shape for n in (part if isinstance(part, tuple) else (part,)))
        if prod(wanted) != self.size or self.order == "F":
            raise InvalidInput("A block does not fit another shape.", f"got {self} and {wanted}", "C order")
        return Block(self.piece, wanted)


def whole(piece: Slice | Columns) -> Slice:
    """The slice that the columns of a matrix cover; a slice itself is returned."""
    return piece.whole if isinstance(piece, Columns) else piece


def overlap(first: Slice, second: Slice) -> bool:
    """Whether slices share elements, as far as that can be told (same shift, same moves in all loops)."""
    alike = (first.buffer, first.strides, first.shift) == (second.buffer, second.strides, second.shift)
    return alike and first.offset < second.offset + second.size and second.offset < first.offset + first.size


def aligned(size: int) -> np.ndarray:
    """Zeros, (size,), that begin where a line of the cache does: vectors of eight then lie in one line each."""
    memory = np.zeros(size + LINE // 8)
    return memory[-memory.ctypes.data % LINE // 8 :][:size]


def misfit(what: str, expected: str, found: object) -> InvalidInput:
    """The error of a part of a program that does not fit the others."""
    return InvalidInput(
        what, f"expected {expected}, got {found}", "what flexhinf.codegen.program says of the step"
    )


def check_identifier(name: object, kind: str) -> None:
    """Refuse what is no ASCII identifier."""
    if not (isinstance(name, str) and name.isidentifier() and name.isascii()):
        raise misfit(f"A {kind} has no usable name.", "an ASCII identifier", repr(name))


def check_function(
    function: casadi.Function, inputs: Sequence[Slice | Columns], outputs: Sequence[Slice | Columns]
) -> None:
    """Refuse a function that is not of SX operations, or does not fit the pieces."""
    refuse_if(
        not function.is_a("SXFunction"),
        f"Function '{function.name()}' cannot be compiled.",
        f"expected a casadi.Function of SX operations, got {function.class_name()}",
        "function.expand(), or trace it with flexhinf.scalars.trace",
    )
    refuse_if(
        function.has_free(),
        f"Function '{function.name()}' has symbols that are no arguments.",
        f"free symbols: {', '.join(function.get_free())}",
        "pass them as arguments",
    )
    for kind, names, sparsity, pieces in (
        ("argument", function.name_in(), function.sparsity_in, inputs),
        ("result", function.name_out(), function.sparsity_out, outputs),
    ):
        if len(names) != len(pieces):
            what = f"Function '{function.name()}' is called with the wrong number of {kind}s."
            raise misfit(what, f"{len(names)} slices ({', '.join(names)})", len(pieces))
        for k, (name, piece) in enumerate(zip(names, pieces, strict=True)):
            shape = sparsity(k)
            refuse_if(
                not shape.is_dense(),
                f"Function '{function.name()}' has the sparse {kind} '{name}'.",
                f"expected a dense vector, got {shape.nnz()} nonzeros in {shape.numel()} elements",
                "casadi.densify",
            )
            if shape.numel() != piece.size:
                what = f"Function '{function.name()}' does not fit the slice for its {kind} '{name}'."
                raise misfit(what, f"{shape.numel()} elements", piece)


@dataclass(frozen=True)
class OuterSum:
    """Σ_k weights[k] · left[k, :]ᵀ right[k, :] + plus, of matrices in C order.

    The sum runs in eight parts, k modulo 8, which are added in pairs at the end: the same order for any number
    of lanes.

    `left`, `right`: (N, r) and (N, c). `target`: (r, c), not in the memory of left, right and weights. `count`: N.
    `weights`: (N,); ones by default. `plus`: (r, c); zero by default. `symmetric`: Left and right are the same: half
    of the sums are computed, and the result is exactly symmetric if `plus` is. Raises InvalidInput: sizes that do not
    fit, or a target that overlaps what is read.
    """

    left: Slice
    right: Slice
    target: Slice
    count: int
    weights: Slice | None = None
    plus: Slice | None = None
    symmetric: bool = False

    def __post_init__(self) -> None:
        count = self.count if is_integer(self.count) and self.count > 0 else 0
        rows, columns = self.shape if count else (0, 0)
        fits = (
            (rows * columns, rows * count, columns * count)
            == (self.target.size, self.left.size, self.right.size)
            and (self.weights is None or self.weights.size == count)
            and (self.plus is None or self.plus.size == self.target.size)
            and (not self.symmetric or self.left == self.right)
        )
        read = [piece for piece in (self.left, self.right, self.weights) if piece is not None]
        if not fits or any(overlap(piece, self.target) for piece in read):
            raise misfit(
                "A sum of outer products joins slices that do not fit.",
                "N·r, N·c, r·c and N elements apart from the target, left equal to right if symmetric",
                self,
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(r, c) of the target."""
        return self.left.size // self.count, self.right.size // self.count


@dataclass(frozen=True)
class Polynomial:
    """Polynomials of several variables in nested form, all of the same monomials.

    Σ_i x_i (c_i + Σ_j≥i x_j (c_ij + Σ_k≥j x_k c_ijk)) and so on: every sum begins with its coefficient, and grows in
    the order of its variables by one fused multiply-add each; the same bits for any number of lanes. Rows are read in
    their order within each degree.

    `point`: x, (n,). `table`: (Nmon, columns): a row for each monomial in the order of `flexhinf.polynomial.basis`,
    degree after degree; its first numbers are coefficients of the values, the others are padding. `target`: The
    values, not in the memory of point and table. `degrees`: Ascending. Raises InvalidInput: sizes that do not fit,
    degrees that do not ascend, or a target that overlaps what is read.
    """

    point: Slice
    table: Slice
    target: Slice
    degrees: tuple[int, ...]

    def __post_init__(self) -> None:
        degrees = self.degrees
        fits = (
            bool(degrees)
            and all(is_integer(k) and k >= 0 for k in degrees)
            and list(degrees) == sorted(set(degrees))
            and not self.table.size % self.rows
            and self.columns >= self.target.size
        )
        if not fits or any(overlap(piece, self.target) for piece in (self.point, self.table)):
            raise misfit(
                "Polynomials join slices that do not fit.",
                "ascending degrees, a row for each monomial, a column for each value, a target apart",
                self,
            )

    @property
    def rows(self) -> int:
        """Monomials."""
        return sum(basis.count(self.point.size, k) for k in self.degrees)

    @property
    def columns(self) -> int:
        """Numbers of a row."""
        return self.table.size // self.rows


@dataclass(frozen=True)
class Cholesky:
    """The Cholesky factor of a symmetric positive semidefinite matrix, as `flexhinf.scalars.cholesky`.

    `source`: (n, n), symmetric. `target`: Lᵀ in C order, that is L column by column; apart from the source. Raises
    InvalidInput: slices that are not square and of one size, or overlap.
    """

    source: Slice
    target: Slice

    def __post_init__(self) -> None:
        square = self.order**2 == self.source.size == self.target.size
        if not square or overlap(self.source, self.target):
            raise misfit(
                "A Cholesky factor does not fit its matrix.",
                "two slices of n² elements apart from each other",
                self,
            )

    @property
    def order(self) -> int:
        """n of the (n, n) matrix."""
        return math.isqrt(self.source.size)


@dataclass(frozen=True)
class Householder:
    """Reflections of the rows of a matrix, as `flexhinf.scalars.householder`.

    `source`, `target`: (m, k) in C order; the same place, or apart. `shape`: (m, k). `count`: Reflections, at most m
    and k. `triangle`: So many of the last rows are upper triangular, 0 or as many as reflections or more: what is zero
    below them is left out. Raises InvalidInput: slices of another size, or that overlap in part; another number of
    reflections, or of such rows.
    """

    source: Slice
    target: Slice
    shape: tuple[int, int]
    count: int
    triangle: int = 0

    def __post_init__(self) -> None:
        fits = prod(self.shape) == self.source.size == self.target.size and 1 <= self.count <= min(self.shape)
        fits = fits and (self.triangle == 0 or self.count <= self.triangle <= self.shape[0])
        if not fits or (self.source != self.target and overlap(self.source, self.target)):
            raise misfit(
                "Reflections do not fit their matrix.",
                "two slices of its size, one or apart, and at most as many reflections as rows and columns",
                self,
            )


@dataclass(frozen=True)
class Residual:
    """e − C x − v of rows (e, x, v) in twice the digits, rounded once, as `flexhinf.scalars.residual`.

    `rows`: (s, p + n + p) in C order. `slope`: C (p, n), likewise. `target`: (s, p), apart from both. `shape`: (p, n).
    Raises InvalidInput: slices of another size, or a target that overlaps what is read.
    """

    rows: Slice
    slope: Slice
    target: Slice
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        p, n = self.shape
        fits = (
            min(p, n) >= 1
            and self.slope.size == p * n
            and self.rows.size == self.count * (2 * p + n)
            and self.target.size == self.count * p
        )
        if not fits or any(overlap(piece, self.target) for piece in (self.rows, self.slope)):
            raise misfit(
                "A residual does not fit its rows.",
                "rows (s, 2p + n), a slope (p, n), and apart from them a target (s, p)",
                self,
            )

    @property
    def count(self) -> int:
        """s, the number of rows."""
        return self.target.size // self.shape[0]
