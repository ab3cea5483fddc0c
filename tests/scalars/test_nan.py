"""A NaN that goes into an operation comes out: of numbers, symbols, machine code, slopes and differences."""

from __future__ import annotations

import inspect
import operator
import types
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest

from flexhinf import scalars
from flexhinf.codegen import DIRECT, Block, Buffer, Call, Composer, Program, Slice, compile_program
from flexhinf.codegen.differences import difference
from flexhinf.codegen.operations import OPERATIONS
from flexhinf.errors import InvalidInput
from flexhinf.scalars import Jet, Series, Symbol, jets, spectral, trace
from flexhinf.scalars.trace import BINARY, UNARY, built

#: Of `flexhinf.scalars`, what is no operation on numbers: elements, and what makes or reads programs.
MAKERS = {
    "Jet", "Series", "Symbol", "apply", "coefficients", "derivative", "digest", "divide", "drop_empty",
    "function_arrays", "function_from_arrays", "jacobian", "jets", "pack", "serial", "series", "symbols", "trace",
    "unpack",
}  # fmt: skip

#: Python's operators that floats do not have, and operations that only move numbers.
NO_FLOATS = {"and", "or", "invert"}
PLACES = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}

#: Of an element, what gives no number.
NO_NUMBERS = {"__init__", "__repr__", "__bool__", "__float__", "__int__"}

MATRIX = np.array([[2.0, 0.5], [0.5, 3.0]])
LOWER = np.array([[2.0, 0.0], [0.5, 3.0]])
#: Arguments of operations on arrays, and of those on elements that two numbers in (0, 1) do not suit.
ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "where": (1.0, 0.3, 0.6),
    "masked": (1.0, 0.3),
    "maximum": (0.3, 0.6),
    "minimum": (0.3, 0.6),
    "clip": (0.3, 0.1, 0.6),
    "arccosh": (1.3,),
    "ACOSH": (1.3,),
    "cholesky": (MATRIX,),
    "eigensystem": (MATRIX,),
    "gram": (MATRIX, np.array([1.0, 2.0])),
    "householder": (np.array([[1.0, 2.0], [0.5, -1.0], [0.2, 0.3]]),),
    "residual": (np.array([[0.1, 0.2, 0.3]]), np.array([[0.5]])),
    "solve_definite": (MATRIX, np.array([1.0, 2.0])),
    "solve_lower": (LOWER, np.array([1.0, 2.0])),
    "solve_lower_transposed": (LOWER, np.array([1.0, 2.0])),
}


class Operation(NamedTuple):
    """A function of arrays, and arrays at which it is finite."""

    name: str
    function: Callable[..., Any]
    arguments: tuple[np.ndarray, ...]

    def of(self, numbers: Any) -> np.ndarray:
        """All its results, of all its numbers in one vector."""
        parts, place = [], 0
        for array in self.arguments:
            part = numbers[place : place + array.size].reshape(array.shape)
            parts.append(part if part.ndim else part[()])
            place += array.size
        results = self.function(*parts)
        return np.concatenate([np.ravel(r) for r in (results if isinstance(results, tuple) else (results,))])

    @property
    def point(self) -> np.ndarray:
        return np.concatenate([array.ravel() for array in self.arguments])


def operation(name: str, function: Callable[..., Any], count: int) -> Operation:
    arguments = ARGUMENTS.get(name, (0.3, 0.6)[:count])
    return Operation(name, function, tuple(np.asarray(a, dtype=float) for a in arguments))


def _named(name: str) -> Callable[..., Any]:
    ends = (f"{name}_", name)  # operator.and_
    return next(getattr(home, end) for home in (operator, np) for end in ends if hasattr(home, end))


def of_elements(kind: type) -> Iterator[Operation]:
    """What an element can do, by Python's operators and NumPy's functions."""
    for name, method in vars(kind).items():
        if (
            not isinstance(method, types.FunctionType)
            or name in NO_NUMBERS
            or "_refused" in method.__qualname__
        ):
            continue
        plain = name.strip("_")
        if name.startswith("__r") and hasattr(operator, plain[1:]):
            yield operation(plain, partial(_named(plain[1:]), 0.3), 1)
        elif (plain == name and not name.startswith("_")) or name.startswith("__"):
            yield operation(plain, _named(plain), len(inspect.signature(method).parameters))


def of_scalars() -> Iterator[Operation]:
    """The public functions of the room, and those of its file on spectra."""
    for name, function in vars(scalars).items():
        if isinstance(function, types.FunctionType) and name not in MAKERS:
            given = partial(function, count=1) if name == "householder" else function
            yield operation(name, given, 1)
    yield operation("eigensystem", partial(spectral.eigensystem, run=DIRECT), 1)


def of_programs() -> Iterator[Operation]:
    """Operations of traced functions as such: files may name more than code does."""

    def function(code: int, *numbers: Symbol) -> Symbol:
        return Symbol(built(code, [number.sx for number in numbers]))

    for count, names in ((1, sorted(UNARY)), (2, sorted(BINARY))):
        for name in names:
            yield operation(name, partial(function, getattr(ca, f"OP_{name}")), count)


#: Forms of an operation.
NUMBERS, VALUE, SLOPE, OF_NAN, BY_NAN = "numbers", "value", "slope", "change of NaN", "change by NaN"
EVERY = (NUMBERS, VALUE, SLOPE, OF_NAN, BY_NAN)

#: What may make a number of a NaN: operations, places of their numbers (None: all), forms, and why.
ALLOWED: list[tuple[str, tuple[int, ...] | None, tuple[str, ...], str]] = [
    ("lt le gt ge eq ne LT LE EQ NE", None, EVERY, "a comparison says yes or no; of a NaN no, but != yes"),
    ("and or invert AND OR NOT", None, EVERY, "so does logic, to which NaN is true as in C"),
    ("where IF_ELSE_ZERO", (0,), EVERY, "a NaN as the condition is true, as in NumPy and C"),
    ("where", (2,), EVERY, "the branch that is not chosen does not count"),
    ("cholesky solve_definite solve_lower_transposed solve_lower", (1,), EVERY, "the other triangle"),
    ("eigensystem", (2,), EVERY, "of a symmetric matrix one triangle is read"),
    ("COPYSIGN", (1,), EVERY, "a NaN has a sign; no code makes this operation, a file may"),
    ("FMIN FMAX", None, EVERY, "those of C; no code makes them, a file may"),
    (
        "add radd sub rsub rmul neg pos conjugate residual",
        None,
        (SLOPE, OF_NAN),
        "the value beside it is NaN",
    ),
    ("ADD SUB NEG TWICE ASSIGN", None, (SLOPE, OF_NAN), "so is the value of all that is linear"),
    ("maximum minimum clip masked where", None, (SLOPE, OF_NAN), "and of what is linear in pieces"),
    ("eigensystem IF_ELSE_ZERO", None, (SLOPE, OF_NAN), "and of what is linear in pieces"),
    ("sign floor ceil SIGN FLOOR CEIL", None, (SLOPE,), "and of what is constant in pieces"),
]


def is_allowed(name: str, place: int, form: str) -> bool:
    return any(
        name in names.split() and (places is None or place in places) and form in forms
        for names, places, forms, _ in ALLOWED
    )


def forms_of(op: Operation) -> ca.Function:
    """Of (x, d): the value at x, its slope along d, and its change from x to x + d."""
    n = len(op.point)
    x, d, traced = ca.SX.sym("x", n), ca.SX.sym("d", n), trace(op.of, n)
    value = traced(x)
    return ca.Function("forms", [x, d], [value, ca.densify(ca.jtimes(value, x, d)), difference(traced)(x, d)])


#: A number of a function for x and d.
Evaluator = Callable[[np.ndarray, np.ndarray], Any]


def machine_code(functions: list[ca.Function]) -> list[Evaluator]:
    """All functions as one kernel, which is compiled once."""
    steps, ends = [], {"x": 0, "d": 0, "y": 0}

    def slice_of(buffer: str, size: int) -> Slice:
        ends[buffer] += size
        return Slice(buffer, ends[buffer] - size, size)

    for function in functions:
        inputs = tuple(slice_of(name, function.size1_in(k)) for k, name in enumerate("xd"))
        steps.append(Call(function, inputs, tuple(slice_of("y", function.size1_out(k)) for k in range(3))))
    buffers = tuple(Buffer(name, size, "out" if name == "y" else "in") for name, size in ends.items())
    kernel = compile_program(Program("nan", buffers, tuple(steps)))

    def run(step: Call, *given: np.ndarray) -> list[np.ndarray]:
        arrays = {name: np.ones((size, 1)) for name, size in ends.items()}
        for place, numbers in zip(step.inputs, given, strict=True):
            arrays[place.buffer][place.offset : place.offset + place.size, 0] = numbers
        kernel.run(arrays)
        return [arrays["y"][p.offset : p.offset + p.size, 0] for p in step.outputs]

    return [partial(run, step) for step in steps]


def lost(numbers: Any) -> bool:
    return not np.isnan(np.asarray(numbers, dtype=float)).any()


def dropped(op: Operation, evaluators: list[Evaluator]) -> Iterator[tuple[str, int, str]]:
    """Name, place and form where a NaN goes into an operation, and a number comes out."""
    step = np.full(len(op.point), 0.05)
    for place in range(len(step)):
        x, d = (np.where(np.arange(len(step)) == place, np.nan, v) for v in (op.point, step))
        with np.errstate(all="ignore"):
            found = {NUMBERS: op.name.islower() and op.name not in NO_FLOATS and lost(op.of(x))}
        for evaluate in evaluators:
            assert np.isfinite(np.concatenate(evaluate(op.point, step))).all(), op.name
            for form, numbers in zip((VALUE, SLOPE, OF_NAN), evaluate(x, step), strict=True):
                found[form] = found.get(form, False) or lost(numbers)
            found[BY_NAN] = found.get(BY_NAN, False) or lost(evaluate(op.point, d)[2])
        yield from ((op.name, place, form) for form, is_lost in found.items() if is_lost)


@pytest.mark.property
def test_a_nan_that_goes_in_comes_out_of_every_operation() -> None:
    """In numbers, CasADi's evaluator and machine code; every exception is needed."""
    operations = [*of_elements(Symbol), *of_scalars(), *of_programs()]
    functions = [forms_of(op) for op in operations]
    codes = [{f.instruction_id(k) for k in range(f.n_instructions())} for f in functions]
    has_code = [c <= {*OPERATIONS, *PLACES} for c in codes]
    kernels = iter(machine_code([f for f, has in zip(functions, has_code) if has]))
    found: set[tuple[str, int, str]] = set()
    for op, function, has in zip(operations, functions, has_code, strict=True):

        def evaluator(*given: np.ndarray, function: ca.Function = function) -> list[np.ndarray]:
            return [np.asarray(r, dtype=float)[:, 0] for r in function(*given)]

        found |= set(dropped(op, [evaluator, *([next(kernels)] if has else [])]))
    assert {case for case in found if not is_allowed(*case)} == set()
    assert {name for names, *_ in ALLOWED for name in names.split()} == {name for name, *_ in found}


@pytest.mark.property
def test_so_it_does_of_programs_own_algebra() -> None:
    """Steps that are loops in machine code: the functions of `scalars` that a run has by their names."""
    named = [op for op in of_scalars() if hasattr(Composer, op.name)]
    assert {"cholesky", "gram", "householder", "residual"} <= {op.name for op in named}
    run, sizes, ends = Composer(), [len(op.point) for op in named], {"x": 0, "y": 0}
    outputs = []
    for op in named:
        blocks = []
        for array in op.arguments:
            blocks.append(Block(Slice("x", ends["x"], array.size), array.shape))
            ends["x"] += array.size
        keywords = op.function.keywords if isinstance(op.function, partial) else {}
        result = getattr(run, op.name)(*blocks, **keywords)
        outputs.append(slice(ends["y"], ends["y"] + result.size))
        run.copy(result, Block(Slice("y", ends["y"], result.size), result.shape))
        ends["y"] += result.size
    buffers = (Buffer("x", ends["x"], "in"), Buffer("y", ends["y"], "out"), *run.buffers)
    kernel, found = compile_program(Program("algebra", buffers, tuple(run.body))), set()
    for place in range(max(sizes)):
        given = [np.where(np.arange(len(op.point)) == place, np.nan, op.point) for op in named]
        y = np.zeros((ends["y"], 1))
        kernel.run({"x": np.concatenate(given)[:, None], "y": y})
        found |= {
            (op.name, place)
            for op, output in zip(named, outputs)
            if lost(y[output]) and place < len(op.point)
        }
    assert found == {("cholesky", 2)}  # it reads the upper triangle


@pytest.mark.property
@pytest.mark.parametrize("kind", [Jet, Series])
def test_a_polynomial_of_nan_is_nan_or_refused(kind: type) -> None:
    """A truncated polynomial or series whose first coefficient is NaN, or that meets NaN."""
    nan = np.float64(np.nan)
    bad = jets([0.3, 0.6], 2)[0] + nan if kind is Jet else Series((nan, 1.0, 0.5))
    good = jets([0.3, 0.6], 2)[1] if kind is Jet else Series((0.3, 1.0, 0.5))
    for op in of_elements(kind):
        pairs = [(bad,)] if len(op.arguments) == 1 else [(bad, good), (good, bad), (good, nan)]
        for given in pairs:
            try:
                result = op.function(*given)
            except InvalidInput:
                continue
            assert not np.isfinite(result.values if kind is Jet else result.coefficients).all(), (
                op.name,
                given,
            )
