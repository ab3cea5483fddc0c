"""From NumPy code to a CasADi function: run the code on symbols and keep the result.

Then: a traced function as arrays, for files.
"""

from __future__ import annotations

import hashlib
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, pairwise
from typing import Any, TypeVar, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput
from flexhinf.scalars.symbol import Symbol
from flexhinf.validation import is_real, value_text

#: CasADi's operations by number and by name; files hold the names.
NAMES = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}

#: Of a function: opcode, places in the work vector that are read and written (for arguments and results: which one, and
#: where in it), and the value of a constant.
Instruction = tuple[int, list[int], list[int], float]

#: What is no operation, and moves numbers.
MOVES = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER}

#: What a function is evaluated on.
Kind = TypeVar("Kind")


def instructions(function: ca.Function) -> Iterator[Instruction]:
    """The instructions of a scalar-expanded (SX) function, in order."""
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        constant = function.instruction_constant(k) if code == ca.OP_CONST else 0.0
        yield code, list(function.instruction_input(k)), list(function.instruction_output(k)), constant


def opcodes(function: ca.Function) -> Iterator[int]:
    """The opcodes of a function, in order, without those that move numbers."""
    return (code for code, *_ in instructions(function) if code not in MOVES)


def walk(
    function: ca.Function,
    argument: Callable[[int, int], Kind],
    constant: Callable[[float], Kind],
    operation: Callable[[int, list[Kind]], Kind],
) -> Iterator[tuple[int, int, Kind]]:
    """Evaluate a function on any kind of number, one instruction after the other.

    `argument`: The number of an element of an argument. `constant`: Of a float. `operation`: Of an opcode and its
    operands. Yields result, element and number of each output, in the order of the instructions.
    """
    work: dict[int, Kind] = {}
    for code, read, written, value in instructions(function):
        if code == ca.OP_OUTPUT:
            yield written[0], written[1], work[read[0]]
        elif code == ca.OP_INPUT:
            work[written[0]] = argument(read[0], read[1])
        elif code == ca.OP_CONST:
            work[written[0]] = constant(value)
        else:
            work[written[0]] = operation(code, [work[place] for place in read])


def built(code: int, operands: Sequence[ca.SX]) -> ca.SX:
    """An operation of one or two expressions."""
    return (ca.SX.unary if len(operands) == 1 else ca.SX.binary)(code, *operands)


COLUMNS = ("first", "second", "result", "value")

#: Operations of one and of two numbers that a file may name. CasADi takes any number of an operation here, also of
#: those that are none of scalars.
UNARY = {
    "ASSIGN",
    "EXP",
    "LOG",
    "SQRT",
    "SQ",
    "TWICE",
    "NEG",
    "SIN",
    "COS",
    "TAN",
    "ASIN",
    "ACOS",
    "ATAN",
    "FLOOR",
    "CEIL",
    "FABS",
    "SIGN",
    "ERF",
    "ERFINV",
    "INV",
    "SINH",
    "COSH",
    "TANH",
    "ASINH",
    "ACOSH",
    "ATANH",
    "NOT",
    "LOG1P",
    "EXPM1",
}
BINARY = {
    "ADD",
    "SUB",
    "MUL",
    "DIV",
    "POW",
    "CONSTPOW",
    "LT",
    "LE",
    "EQ",
    "NE",
    "AND",
    "OR",
    "FMOD",
    "REMAINDER",
    "COPYSIGN",
    "IF_ELSE_ZERO",
    "FMIN",
    "FMAX",
    "ATAN2",
    "HYPOT",
}

#: Most entries of an argument or a result that a file may claim.
LONGEST = 1_000_000

#: Stands for the second operand of a function of one.
ONE_OPERAND = -1


def function_arrays(function: ca.Function) -> dict[str, np.ndarray]:
    """The instructions of a scalar-expanded (SX) function.

    `function`: As `trace` makes it: dense columns as arguments and results. Returns ``operation`` (K,) names;
    ``first``, ``second``, ``result`` (K,) places in a work vector, or, for arguments and results, which one and where
    in it; ``value`` (K,) constants; ``sizes`` of arguments, then of results; ``arguments``, how many there are.
    """
    operations: list[str] = []
    rows: list[tuple[int, int, int, float]] = []
    for code, read, written, constant in instructions(function):
        if code == ca.OP_OUTPUT:
            read, written = written, read
        empty = 0 if code == ca.OP_CONST else ONE_OPERAND
        first, second = (*read, empty, empty)[:2]
        operations.append(NAMES[code])
        rows.append((first, second, written[0], constant))
    sizes = [
        *(function.size1_in(k) for k in range(function.n_in())),
        *(function.size1_out(k) for k in range(function.n_out())),
    ]
    return {
        **{
            name: np.array(column, dtype=float if name == "value" else np.int64)
            for name, column in zip(COLUMNS, zip(*rows) if rows else ((),) * 4)
        },
        "operation": np.array(operations, dtype=np.str_),
        "sizes": np.array(sizes, dtype=np.int64),
        "arguments": np.array(function.n_in()),
    }


def function_from_arrays(arrays: Mapping[str, np.ndarray], name: str = "stored") -> ca.Function:
    """The function of `function_arrays`, rebuilt.

    Raises ValueError, IndexError, KeyError: if the arrays are no function's.
    """
    count, sizes = int(arrays["arguments"]), [int(size) for size in arrays["sizes"]]
    if not (0 <= count <= len(sizes) and all(0 <= size <= LONGEST for size in sizes)):
        raise ValueError("sizes that no function has")
    if any(
        arrays[column].dtype != np.int64 or (arrays[column] < ONE_OPERAND).any() for column in COLUMNS[:3]
    ):
        raise ValueError("places that no function has")
    arguments = [ca.SX.sym(f"i{k}", size) for k, size in enumerate(sizes[:count])]
    results = [ca.SX.zeros(size) for size in sizes[count:]]
    work: dict[int, ca.SX] = {}
    rows = zip(arrays["operation"].tolist(), *(arrays[column].tolist() for column in COLUMNS), strict=True)
    for operation, first, second, result, value in rows:
        code, kind = getattr(ca, operation, -1), operation.removeprefix("OP_")
        if code == ca.OP_CONST:
            work[result] = ca.SX(value)
        elif code == ca.OP_INPUT:
            work[result] = arguments[first][second]
        elif code == ca.OP_OUTPUT:
            results[first][second] = work[result]
        elif kind in (UNARY if second == ONE_OPERAND else BINARY):
            work[result] = built(code, [work[place] for place in (first, second) if place != ONE_OPERAND])
        else:
            raise ValueError(f"unknown operation {operation!r}")
    return ca.Function(name, arguments, [ca.densify(result) for result in results])


ArgumentShape = int | tuple[int, ...]


def symbols(name: str, shape: ArgumentShape) -> Elements:
    """Object array of fresh symbols, for example ``symbols("x", 4)``."""
    shape = (shape,) if isinstance(shape, int) else tuple(shape)
    return unpack(ca.SX.sym(name, int(np.prod(shape, dtype=int))), shape)


def unpack(column: ca.SX, shape: tuple[int, ...]) -> Elements:
    """A column of SX as an object array of `Symbol`, in C order."""
    array = np.empty(column.numel(), dtype=object)
    elements = cast(list[ca.SX], column.elements())
    array[:] = [Symbol(element) for element in elements]
    return array.reshape(shape)


def pack(array: object) -> ca.SX:
    """A dense SX column from an array of symbols and numbers, in C order.

    Raises InvalidInput: for text, complex numbers and whatever else is no real number.
    """
    flat = np.asarray(array, dtype=object).ravel()
    strange = next((a for a in flat if not isinstance(a, Symbol) and not is_real(a)), None)
    if strange is not None:
        raise InvalidInput(
            "The code computes something that is no real number.",
            f"expected numbers and expressions of its arguments, got {value_text(strange)}",
            "an array of them: np.array([...])",
        )
    parts = [a.sx if isinstance(a, Symbol) else ca.SX(float(a)) for a in flat]
    column = ca.vertcat(*parts) if parts else ca.SX.zeros(0, 1)
    return column if column.is_dense() else ca.densify(column)


def trace(
    function: Callable[..., object],
    *shapes: ArgumentShape,
    name: str = "traced",
    names: Sequence[str] | None = None,
) -> ca.Function:
    """Run `function` on symbols and return its results as a CasADi function.

    `function`: Takes one array per entry of `shapes`; returns an array, or a tuple of arrays. It is called twice.
    `shapes`: Shape of each argument. `name`, `names`: Name of the function, and of its arguments. Every argument and
    result of the returned function is a dense column, the array in C order; common subexpressions are computed once.
    Raises InvalidInput: if `function` branches on a symbol, takes its float value, or computes something else when it
    is called again.
    """
    labels = list(names) if names is not None else [f"i{k}" for k in range(len(shapes))]
    arguments = [symbols(label, shape) for label, shape in zip(labels, shapes, strict=True)]
    inputs = [pack(argument) for argument in arguments]

    def called() -> list[ca.SX]:
        results = function(*(argument.copy() for argument in arguments))  # the code may write into them
        every = cast(tuple[Elements, ...], results if isinstance(results, tuple) else (results,))
        return [pack(result) for result in every]

    outputs = called()
    _check_repeats(name, inputs, outputs, called)
    sizes = [output.numel() for output in outputs]
    shared = ca.cse(ca.vertcat(*outputs)) if outputs else ca.SX.zeros(0, 1)
    split = [ca.densify(shared[a:b]) for a, b in pairwise(accumulate(sizes, initial=0))]
    return ca.Function(name, inputs, split, labels, [f"o{k}" for k in range(len(split))])


#: States of the generators that every module shares, as text.
GENERATORS: dict[str, Callable[[], str]] = {
    "random": lambda: repr(random.getstate()),
    "np.random": lambda: repr(np.random.get_state(legacy=False)),  # noqa: NPY002  # it is what code may read
}


def _check_repeats(
    name: str, inputs: list[ca.SX], first: list[ca.SX], called: Callable[[], list[ca.SX]]
) -> None:
    """Refuse code that computes something else the second time: what it drew the first time would stay for good.

    The programs are compared, which sees every source of such numbers: a generator, a clock, a counter.
    """
    once, again = (ca.Function("program", inputs, results) for results in (first, called()))
    if once.serialize() == again.serialize():
        return
    pairs = zip(*([row[3] for row in instructions(f) if row[0] == ca.OP_CONST] for f in (once, again)))
    numbers = next((f"{a!r} and then {b!r}" for a, b in pairs if a != b), "other operations")
    before = {source: state() for source, state in GENERATORS.items()}
    called()
    sources = [source for source, state in GENERATORS.items() if state() != before[source]]
    raise InvalidInput(
        f"The code of {name!r} computes something else each time it is called.",
        f"expected the same operations and numbers, as those of one call are kept for all; got {numbers}, from "
        + (" and ".join(sources) or "a random generator, a clock or a counter"),
        "noise as a disturbance of the plant or as noise of its sensors, time as a state, what else changes as a "
        "parameter; a random number that is to stay is drawn before, outside this code",
    )


def apply(function: ca.Function, *arrays: ArrayLike) -> tuple[Elements, ...]:
    """Call a CasADi function on arrays of numbers or of symbols; results are flat arrays of the same kind."""
    if len(arrays) != function.n_in():
        raise InvalidInput(
            f"The function {function.name()} was called with the wrong number of arguments.",
            f"expected {function.n_in()}, got {len(arrays)}",
            "one array per argument it was traced with",
        )
    if any(np.asarray(a).dtype == object for a in arrays):
        return tuple(unpack(r, (r.numel(),)) for r in function.call([pack(a) for a in arrays]))
    numbers: list[Any] = [np.array(a, dtype=float, order="C").ravel() for a in arrays]
    sizes = [function.size1_out(k) for k in range(function.n_out())]
    if [a.size for a in numbers] + 2 * sizes != [
        *(function.nnz_in(k) for k in range(function.n_in())),
        *(function.nnz_out(k) for k in range(function.n_out())),
        *(function.numel_out(k) for k in range(function.n_out())),
    ]:  # a number for a vector, or no dense columns
        return tuple(np.asarray(r, dtype=float).ravel() for r in function.call([ca.DM(a) for a in numbers]))
    results: list[Any] = [np.zeros(size) for size in sizes]
    buffer, run = cast(Any, function).buffer()  # a third of the time of a call with matrices of CasADi's
    for place, column in enumerate(numbers):
        buffer.set_arg(place, memoryview(column))
    for place, column in enumerate(results):
        buffer.set_res(place, memoryview(column))
    run()
    return tuple(results)


def serial(columns: Sequence[ca.SX], result: Elements) -> str:
    """Expressions of symbols in CasADi's serial form, equal for the same symbols, code and numbers."""
    return ca.Function("serial", list(columns), [pack(result)]).serialize()


def digest(function: ca.Function) -> str:
    """SHA-256 of a traced function's content: CasADi's serial form, which holds its instructions and constants."""
    return hashlib.sha256(function.serialize().encode()).hexdigest()


def jacobian(
    function: Callable[..., object], *shapes: ArgumentShape, name: str = "jacobian"
) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Exact value and Jacobian of `function` with respect to its first argument.

    Returns called like `function` (first result only), on numbers or symbols; returns the flat value (k,) and the
    Jacobian (k, n), n the size of the first argument.
    """
    traced = trace(function, *shapes, name=name)
    inputs = [ca.SX.sym(f"i{k}", traced.size1_in(k)) for k in range(traced.n_in())]
    value = traced.call(inputs)[0]
    derivative = ca.jacobian(value, inputs[0])
    flat = ca.densify(ca.vec(derivative.T))  # SX is column-major: the transpose flattens in C order
    # A partial can be pickled, unlike a nested function.
    return partial(
        _value_and_jacobian, ca.Function(name, inputs, [value, flat], {"cse": True}), derivative.shape
    )


def _value_and_jacobian(
    both: ca.Function, shape: tuple[int, int], *arrays: ArrayLike
) -> tuple[np.ndarray, np.ndarray]:
    y, dy = apply(both, *arrays)
    return y, dy.reshape(shape)


def drop_empty(function: ca.Function) -> ca.Function:
    """The function without its arguments of length zero, which no buffer can hold."""
    arguments = [ca.SX.sym(function.name_in(k), function.size1_in(k)) for k in range(function.n_in())]
    kept = [a for a in arguments if a.numel()]
    whole = len(kept) == len(arguments)
    return function if whole else ca.Function(function.name(), kept, function.call(arguments), {"cse": True})


def divide(
    function: ca.Function, moving: Sequence[bool]
) -> tuple[ca.Function | None, ca.Function | None, tuple[bool, ...]]:
    """Divide a function in two: the part without the `moving` arguments, and the rest.

    Quotients by what is computed before are products with its reciprocal, which is computed before too.

    `function`: As `trace` makes it. `moving`: Which arguments the rest alone may read. Returns `before`, of the other
    arguments: a column of numbers (it may be empty), and the results that do not move; None where there is nothing to
    compute. Returns `rest`, of all arguments, and of that column if it is not empty: the other results; None where
    there are none. Returns which results move.
    """
    arguments = [ca.SX.sym(function.name_in(k), function.size1_in(k)) for k in range(function.n_in())]
    results = [ca.SX.zeros(function.size1_out(k)) for k in range(function.n_out())]
    before: list[ca.SX] = []
    names: list[ca.SX] = []

    def named(value: ca.SX) -> ca.SX:
        before.append(value)
        names.append(ca.SX.sym(f"before{len(names)}"))
        return names[-1]

    def outside(value: _Divided) -> ca.SX:
        if not value.moves and not value.leaf and value.name is None:
            value.name = named(value.sx)
        return value.sx if value.name is None else value.name

    def operation(code: int, operands: list[_Divided]) -> _Divided:
        if not any(operand.moves for operand in operands):
            return _Divided(built(code, [operand.sx for operand in operands]), False, False)
        symbols = [outside(operand) for operand in operands]
        if code == ca.OP_DIV and not operands[1].moves and not operands[1].sx.is_constant():
            code, symbols[1] = ca.OP_MUL, operands[1].reciprocal(named)
        return _Divided(built(code, symbols), True, False)

    values = list(
        walk(
            function,
            lambda k, element: _Divided(arguments[k][element], moving[k], True),
            lambda constant: _Divided(ca.SX(constant), False, True),
            operation,
        )
    )
    moves = tuple(any(v.moves for k, _, v in values if k == result) for result in range(len(results)))
    for result, element, value in values:
        results[result][element] = outside(value) if moves[result] else value.sx
    still, moved = (
        [ca.densify(r) for r, m in zip(results, moves) if m is wanted] for wanted in (False, True)
    )
    fixed = [argument for argument, moves in zip(arguments, moving, strict=True) if not moves]
    column = [ca.densify(ca.vertcat(*before))] if before else []
    once = ca.Function("before", fixed, [*column, *still], {"cse": True}) if before or still else None
    later = [*arguments, *([ca.vertcat(*names)] if before else [])]
    return once, ca.Function(function.name(), later, moved) if moved else None, moves


@dataclass
class _Divided:
    """A number of a function that is divided: whether it moves, is an argument or a constant, and its later names."""

    sx: ca.SX
    moves: bool
    leaf: bool
    name: ca.SX | None = None
    inverse: ca.SX | None = None

    def reciprocal(self, named: Callable[[ca.SX], ca.SX]) -> ca.SX:
        if self.inverse is None:
            self.inverse = named(1.0 / self.sx)
        return self.inverse
