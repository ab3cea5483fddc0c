"""What a kernel runs: traced functions, sums, copies and guards over named flat arrays, inside loops.

A program is data. It says nothing about machine code, lanes or threads, so that the compiler and the
interpreter read the very same text.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

from flexhinf.errors import InvalidInput

if TYPE_CHECKING:
    import casadi

#: Every emitted name begins so: a function called `step` once bound to a symbol of the C library. ENTRY runs all.
PREFIX = "flexhinf_"
ENTRY = PREFIX + "run"

Role = Literal["in", "out", "state", "work"]
Order = Literal["C", "F"]


@dataclass(frozen=True)
class Buffer:
    """A flat float64 array, known by name.

    Parameters
    ----------
    name : str
        An identifier, unique in the program.
    size : int or None
        Number of elements per lane; None leaves it to the array given at run time.
    role : {"in", "out", "state", "work"}
        "in" is only read; "out" is written; "state" is read and written; "work" belongs to the kernel: the
        caller gives no array for it, and it is zero at the start of every run.
    shared : bool
        One copy for all lanes (only for "in").
    cleared : bool
        False for a work buffer of which every element is written before it is read: then nothing is spent on
        zeros.

    Raises
    ------
    InvalidInput
        Bad name, size or role; a shared buffer that is not "in"; a work buffer without a size; `cleared` for
        another.
    """

    name: str
    size: int | None
    role: Role
    shared: bool = False
    cleared: bool = True

    def __post_init__(self) -> None:
        _check_identifier(self.name, "buffer")
        if self.role not in get_args(Role):
            raise InvalidInput(
                f"Buffer '{self.name}' has an unknown role.",
                f"expected one of {', '.join(get_args(Role))}, got {self.role!r}",
                "'in' for data, 'state' for what is updated in place, 'out' for results, 'work' for scratch",
            )
        if self.size is not None and not (_is_integer(self.size) and self.size > 0):
            raise InvalidInput(
                f"Buffer '{self.name}' has no usable size.",
                f"expected a positive integer or None, got {self.size!r}",
                "None when the array given at run time decides",
            )
        if self.size is None and self.role == "work":
            raise InvalidInput(
                f"Work buffer '{self.name}' has no size.",
                "the kernel makes work buffers itself and must know how long they are; got size=None",
                "a size, or the role 'state' with an array of your own",
            )
        if not self.cleared and self.role != "work":
            raise InvalidInput(
                f"Buffer '{self.name}' is never cleared.",
                f"only work buffers are, got cleared=False and role {self.role!r}",
                "cleared=True",
            )
        if self.shared and self.role != "in":
            raise InvalidInput(
                f"Buffer '{self.name}' cannot be shared.",
                f"lanes may only share what they all read (role 'in'), got role {self.role!r}",
                "shared=False",
            )


@dataclass(frozen=True)
class Slice:
    """Elements ``offset + Σ_d strides[d]·k_d + (0 … size-1)`` of a buffer; k_d counts the d-th loop around.

    Parameters
    ----------
    buffer : str
    offset : int
        First element, in elements.
    size : int
        Number of elements.
    strides : tuple of int
        Elements to move per turn of each enclosing `Repeat`, outermost first; ``()`` stays in place.

    Raises
    ------
    InvalidInput
        Negative offset, size below one, or strides that are not integers.
    """

    buffer: str
    offset: int = 0
    size: int = 1
    strides: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "strides", tuple(self.strides))
        numbers = (self.offset, self.size, *self.strides)
        if not all(map(_is_integer, numbers)) or self.offset < 0 or self.size < 1:
            raise InvalidInput(
                f"A slice of '{self.buffer}' is not usable.",
                f"expected integers with offset ≥ 0 and size ≥ 1, got offset={self.offset!r}, "
                f"size={self.size!r}, strides={self.strides!r}",
                "Slice(buffer, offset, size, strides)",
            )

    def __str__(self) -> str:
        moves = "".join(f" + {stride}·k{depth}" for depth, stride in enumerate(self.strides) if stride)
        return f"{self.buffer}[{self.offset}{moves} : +{self.size}]"


@dataclass(frozen=True, eq=False)
class Call:
    """Evaluate a traced function; all inputs are read before any output is written, so in-place is safe.

    Parameters
    ----------
    function : casadi.Function
        An SX function whose arguments and results are dense.
    inputs, outputs : tuple of Slice
        One per argument and per result, of the same number of elements.
    """

    function: casadi.Function
    inputs: tuple[Slice, ...]
    outputs: tuple[Slice, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "inputs", tuple(self.inputs))
        object.__setattr__(self, "outputs", tuple(self.outputs))
        check_function(self.function, self.inputs, self.outputs)


@dataclass(frozen=True)
class Columns:
    """A slice read as a matrix, of which a `Map` takes one column at a time.

    Parameters
    ----------
    whole : Slice
        All of the matrix.
    count : int
        Number of columns, a divisor of the slice's size.
    order : {"C", "F"}
        Rows one after the other, or columns one after the other.

    Raises
    ------
    InvalidInput
        A count that does not divide the size, or another order.
    """

    whole: Slice
    count: int
    order: Order = "C"

    def __post_init__(self) -> None:
        if self.order not in get_args(Order):
            raise InvalidInput(
                "A matrix has an unknown order.", f"expected C or F, got {self.order!r}", "'C'"
            )
        if not _is_integer(self.count) or self.count < 1 or self.whole.size % self.count:
            raise InvalidInput(
                f"{self.whole} is no matrix of {self.count} columns.",
                f"expected a positive divisor of {self.whole.size}, got {self.count!r}",
                "a slice of rows times columns elements, rows one after the other",
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


@dataclass(frozen=True, eq=False)
class Map:
    """Evaluate a traced function on every column of matrices, in any order: several at once where that is faster.

    Parameters
    ----------
    function : casadi.Function
        As for `Call`.
    inputs : tuple of Slice or Columns
        A slice is the same for all columns.
    outputs : tuple of Columns
        May be the very columns of an input (in place), but overlap no input otherwise.
    times : int
        How often: with more than once, what is computed takes the place of the columns that are read.

    Raises
    ------
    InvalidInput
        As `Call`; columns of different numbers, no columns, results that overlap arguments, or that cannot take
        their place.
    """

    function: casadi.Function
    inputs: tuple[Slice | Columns, ...]
    outputs: tuple[Columns, ...]
    times: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "inputs", tuple(self.inputs))
        object.__setattr__(self, "outputs", tuple(self.outputs))
        check_function(self.function, self.inputs, self.outputs)
        counts = {piece.count for piece in (*self.inputs, *self.outputs) if isinstance(piece, Columns)}
        if len(counts) != 1 or not all(isinstance(piece, Columns) for piece in self.outputs):
            raise InvalidInput(
                f"Function '{self.function.name()}' is not mapped over the columns of matrices.",
                f"expected results in columns, and one number of columns, got {sorted(counts)}",
                "Columns(slice, count) for every result, with the same count",
            )
        moving = [piece.size for piece in self.inputs if isinstance(piece, Columns)]
        again = self.times == 1 or moving == [piece.size for piece in self.outputs]
        if not _is_integer(self.times) or self.times < 1 or not again:
            raise InvalidInput(
                f"Function '{self.function.name()}' cannot be mapped again and again.",
                f"expected times >= 1, and columns in of the sizes of those out, got {self.times!r} and {moving}",
                "times=1",
            )
        for result in self.outputs:
            for piece in self.inputs:
                if piece != result and _overlap(whole(piece), result.whole):
                    raise InvalidInput(
                        f"Function '{self.function.name()}' would overwrite arguments of other columns.",
                        f"result {result} overlaps argument {piece}",
                        "another place for the result, or exactly that of the argument's columns",
                    )

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.outputs[0].count


@dataclass(frozen=True)
class OuterSum:
    """Σ_k weights[k] · left[k, :]ᵀ right[k, :] + plus, of matrices in C order.

    The sum runs in eight parts, k modulo 8, which are added in pairs at the end: the same order for any number
    of lanes.

    Parameters
    ----------
    left, right : Slice
        (N, r) and (N, c).
    target : Slice
        (r, c), not in the memory of left, right and weights.
    count : int
        N.
    weights : Slice or None
        (N,); ones by default.
    plus : Slice or None
        (r, c); zero by default.
    symmetric : bool
        Left and right are the same: half of the sums are computed, and the result is exactly symmetric if
        `plus` is.

    Raises
    ------
    InvalidInput
        Sizes that do not fit, or a target that overlaps what is read.
    """

    left: Slice
    right: Slice
    target: Slice
    count: int
    weights: Slice | None = None
    plus: Slice | None = None
    symmetric: bool = False

    def __post_init__(self) -> None:
        count = self.count if _is_integer(self.count) and self.count > 0 else 0
        rows, columns = self.shape if count else (0, 0)
        fits = rows * columns == self.target.size and rows * count == self.left.size
        fits = fits and columns * count == self.right.size
        fits = fits and (self.weights is None or self.weights.size == count)
        fits = fits and (self.plus is None or self.plus.size == self.target.size)
        fits = fits and (not self.symmetric or self.left == self.right)
        read = [piece for piece in (self.left, self.right, self.weights) if piece is not None]
        if not fits or any(_overlap(piece, self.target) for piece in read):
            raise InvalidInput(
                "A sum of outer products joins slices that do not fit.",
                f"expected N·r, N·c, r·c and N elements apart from the target, got {self}",
                "one row of left and right per weight; left equal to right if symmetric",
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(r, c)."""
        return self.left.size // self.count, self.right.size // self.count


@dataclass(frozen=True)
class Cholesky:
    """The Cholesky factor of a symmetric positive semidefinite matrix, as `flexhinf.scalars.cholesky`.

    Parameters
    ----------
    source : Slice
        (n, n), symmetric.
    target : Slice
        Lᵀ in C order, that is L column by column; apart from the source.

    Raises
    ------
    InvalidInput
        Slices that are not square and of one size, or overlap.
    """

    source: Slice
    target: Slice

    def __post_init__(self) -> None:
        square = self.order**2 == self.source.size == self.target.size
        if not square or _overlap(self.source, self.target):
            raise InvalidInput(
                "A Cholesky factor does not fit its matrix.",
                f"expected two slices of n² elements apart from each other, got {self.source} and {self.target}",
                "square matrices",
            )

    @property
    def order(self) -> int:
        """n."""
        return math.isqrt(self.source.size)


@dataclass(frozen=True)
class Copy:
    """Copy one slice onto another of the same size (they may overlap)."""

    source: Slice
    target: Slice

    def __post_init__(self) -> None:
        if self.source.size != self.target.size:
            raise InvalidInput(
                "A copy joins slices of different sizes.",
                f"source {self.source}, target {self.target}",
                "slices of the same size",
            )


@dataclass(frozen=True)
class Guard:
    """Stop unless every element is finite.

    Parameters
    ----------
    source : Slice
    code : int
        Positive; becomes the `Status.code`, beside the index of the outermost loop (0 outside of loops).
    """

    source: Slice
    code: int

    def __post_init__(self) -> None:
        if not _is_integer(self.code) or self.code < 1:
            raise InvalidInput(
                f"The guard of {self.source} has no usable code.",
                f"expected an integer ≥ 1 (0 means that all is well), got {self.code!r}",
                "a small positive number per kind of failure",
            )


@dataclass(frozen=True, eq=False)
class Repeat:
    """Run `body` as many times as the run-time count says.

    Parameters
    ----------
    count : str
        Name of a count of the program.
    body : tuple of steps
    """

    count: str
    body: tuple[Step, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "body", tuple(self.body))


Simple: TypeAlias = Call | Map | OuterSum | Cholesky | Copy | Guard
Step: TypeAlias = Simple | Repeat


@dataclass(frozen=True, eq=False)
class Program:
    """Steps over buffers, validated as a whole.

    Parameters
    ----------
    name : str
        An identifier.
    buffers : tuple of Buffer
    body : tuple of Call, Map, OuterSum, Cholesky, Copy, Guard or Repeat
    counts : tuple of str
        Names of the run-time integers that `Repeat` uses.

    Raises
    ------
    InvalidInput
        Duplicate names, unknown buffers or counts, a write to an "in" buffer, a slice outside of a sized
        buffer, or strides whose number is not the depth of the loop.
    """

    name: str
    buffers: tuple[Buffer, ...]
    body: tuple[Step, ...]
    counts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for field in ("buffers", "body", "counts"):
            object.__setattr__(self, field, tuple(getattr(self, field)))
        _check_identifier(self.name, "program")
        for count in self.counts:
            _check_identifier(count, "count")
        names = [*(buffer.name for buffer in self.buffers), *self.counts]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InvalidInput(
                f"Program '{self.name}' uses a name twice.",
                f"every buffer and count needs its own name, got twice: {', '.join(twice)}",
                "rename one of them",
            )
        for step, loops in self.steps():
            self._check_step(step, len(loops))

    def buffer(self, name: str) -> Buffer:
        """The buffer of that name (KeyError when there is none)."""
        for buffer in self.buffers:
            if buffer.name == name:
                return buffer
        raise KeyError(name)

    def steps(self) -> Iterator[tuple[Step, tuple[str, ...]]]:
        """Every step with the counts of its enclosing loops, outermost first; a `Repeat` before its body."""
        stack: list[tuple[Step, tuple[str, ...]]] = [(step, ()) for step in reversed(self.body)]
        while stack:
            step, loops = stack.pop()
            yield step, loops
            if isinstance(step, Repeat):
                stack.extend((inner, (*loops, step.count)) for inner in reversed(step.body))

    def _check_step(self, step: Step, depth: int) -> None:
        if isinstance(step, Repeat):
            if step.count not in self.counts:
                raise InvalidInput(
                    f"Program '{self.name}' repeats by an unknown count.",
                    f"expected one of {list(self.counts)}, got {step.count!r}",
                    f"add {step.count!r} to counts",
                )
            return
        if not isinstance(step, Simple):
            raise InvalidInput(
                f"Program '{self.name}' holds something that is no step.",
                f"expected Call, Map, OuterSum, Cholesky, Copy, Guard or Repeat, got {type(step).__name__}",
                "wrap a casadi.Function in Call",
            )
        read, written = slices(step)
        for piece in (*read, *written):
            self._check_slice(piece, depth)
        for piece in written:
            if self.buffer(piece.buffer).role == "in":
                raise InvalidInput(
                    f"Program '{self.name}' writes to an input.",
                    f"{piece} is written, but buffer '{piece.buffer}' has the role 'in'",
                    "the role 'state' (read and written), 'out' or 'work'",
                )

    def _check_slice(self, piece: Slice, depth: int) -> None:
        names = [buffer.name for buffer in self.buffers]
        if piece.buffer not in names:
            raise InvalidInput(
                f"Program '{self.name}' uses an unknown buffer.",
                f"expected one of {names}, got {piece.buffer!r}",
                "declare the buffer, or correct the name",
            )
        if piece.strides and len(piece.strides) != depth:
            raise InvalidInput(
                f"A slice of '{piece.buffer}' has the wrong number of strides.",
                f"expected one per enclosing Repeat ({depth}), outermost first, got {piece.strides}",
                "strides of that length, with 0 for the loops that do not move it, or ()",
            )
        size = self.buffer(piece.buffer).size
        if size is not None and not any(piece.strides) and piece.offset + piece.size > size:
            raise InvalidInput(
                f"A slice leaves buffer '{piece.buffer}'.",
                f"{piece} ends at {piece.offset + piece.size}, the buffer has {size} elements",
                "a smaller offset or size, or a larger buffer",
            )


def slices(step: Simple) -> tuple[tuple[Slice, ...], tuple[Slice, ...]]:
    """The slices that a step reads, and those that it writes."""
    if isinstance(step, Call | Map):
        return tuple(map(whole, step.inputs)), tuple(map(whole, step.outputs))
    if isinstance(step, OuterSum):
        read = (step.left, step.right, step.weights, step.plus)
        return tuple(piece for piece in read if piece is not None), (step.target,)
    if isinstance(step, Copy | Cholesky):
        return (step.source,), (step.target,)
    return (step.source,), ()


def whole(piece: Slice | Columns) -> Slice:
    """All that the columns of a matrix cover; a slice is its own."""
    return piece.whole if isinstance(piece, Columns) else piece


def check_function(function: casadi.Function, inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
    """Refuse a function that is not of SX operations, or does not fit the pieces (anything with a `size`)."""
    if not function.is_a("SXFunction"):
        raise InvalidInput(
            f"Function '{function.name()}' cannot be compiled.",
            f"expected a casadi.Function of SX operations, got {function.class_name()}",
            "function.expand(), or trace it with flexhinf.scalars.trace",
        )
    if function.has_free():
        raise InvalidInput(
            f"Function '{function.name()}' has symbols that are no arguments.",
            f"free symbols: {', '.join(function.get_free())}",
            "pass them as arguments",
        )
    arguments = [function.sparsity_in(k) for k in range(function.n_in())]
    results = [function.sparsity_out(k) for k in range(function.n_out())]
    _check_sizes(function.name(), "argument", function.name_in(), arguments, inputs)
    _check_sizes(function.name(), "result", function.name_out(), results, outputs)


def _overlap(one: Slice, other: Slice) -> bool:
    """Do they share elements, as far as that can be told (the same moves in all loops)?"""
    if one.buffer != other.buffer or one.strides != other.strides:
        return False
    return one.offset < other.offset + other.size and other.offset < one.offset + one.size


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _check_identifier(name: object, kind: str) -> None:
    if not (isinstance(name, str) and name.isidentifier() and name.isascii()):
        raise InvalidInput(
            f"A {kind} has no usable name.",
            f"expected an ASCII identifier, got {name!r}",
            "letters, digits and underscores, not starting with a digit",
        )


def _check_sizes(function: str, kind: str, names: list[str], shapes: list, pieces: Sequence[Any]) -> None:
    if len(shapes) != len(pieces):
        raise InvalidInput(
            f"Function '{function}' is called with the wrong number of {kind}s.",
            f"expected {len(shapes)} slices ({', '.join(names)}), got {len(pieces)}",
            f"one slice per {kind}",
        )
    for name, shape, piece in zip(names, shapes, pieces, strict=True):
        if not shape.is_dense():
            raise InvalidInput(
                f"Function '{function}' has the sparse {kind} '{name}'.",
                f"expected a dense vector, got {shape.nnz()} nonzeros in {shape.numel()} elements",
                "casadi.densify",
            )
        if shape.numel() != piece.size:
            raise InvalidInput(
                f"Function '{function}' does not fit the slice for its {kind} '{name}'.",
                f"expected {shape.numel()} elements, got {piece}",
                f"a slice of size {shape.numel()}",
            )
