"""What an operation is, said once: its opcode, NumPy function, C, LLVM, where it switches, and how its result deviates.

Every row follows the meaning of CasADi's own evaluator, NaN and signed zero included; the tests compare them one by
one, in NumPy, C and LLVM in lanes. Certificates compute with polynomials by the same rows. Derivatives are CasADi's.

To add an operation: a file that calls `register` with its row, see CONTRIBUTING.md. A row of `_TABLE` has its line in
`flexhinf.scalars.symbol`.
"""

# SciPy has no types, and operands of `numpy` are of any kind.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownLambdaType=false

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import cast

import casadi
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.codegen.emit import sines
from flexhinf.codegen.emit.writer import Lanes, ModuleText, Writer
from flexhinf.errors import refuse_if
from flexhinf.scalars import deviations
from flexhinf.scalars.jet import SMOOTH, Jet, Series, expand
from flexhinf.scalars.symbol import Symbol, record
from flexhinf.scalars.trace import NAMES

# Operations of several in one, numbered beside CasADi's own (which are not negative).
MULTIPLY_ADD = -1  # a·b + c
MULTIPLY_SUBTRACT = -2  # a·b - c
SUBTRACT_PRODUCT = -3  # c - a·b, arguments (a, b, c)
#: a where c is not zero, else b, arguments (c, a, b). It stands for OP_IF_ELSE_ZERO too, whose b is zero.
SELECT = -4

#: (writer, name of each operand) → name of the result.
LlvmRule = (
    Callable[[Writer, str], str] | Callable[[Writer, str, str], str] | Callable[[Writer, str, str, str], str]
)
#: The same on floats and arrays; sums and products on whatever has their operators, of which they make one more.
NumpyRule = Callable[..., object]
#: Of the operands, expressions of CasADi: where one of those that it returns is zero, something is the case.
Zeros = Callable[..., list[casadi.SX]]
#: Of the operands, as `Deviated`.
Difference = Callable[..., casadi.SX]


def nowhere(*operands: casadi.SX) -> list[casadi.SX]:
    """Of what never is the case."""
    return []


def anywhere(*operands: casadi.SX) -> list[casadi.SX]:
    """Of what may depend on each operand, as is assumed where nothing is stated."""
    return list(operands)


def _first(a: casadi.SX, *_: casadi.SX) -> list[casadi.SX]:
    return [a]


def _last(*operands: casadi.SX) -> list[casadi.SX]:
    return [operands[-1]]


def _gap(a: casadi.SX, b: casadi.SX) -> list[casadi.SX]:
    return [a - b]


def _branch_points(a: casadi.SX) -> list[casadi.SX]:
    return [1.0 - a**2]


@dataclass(frozen=True)
class OperationKind:
    """One operation.

    `code`: CasADi's opcode, or one of ours. `numpy`: The same on floats and arrays, see `NumpyRule`. `llvm`: Writes it.
    `c`: An expression of the operands {0}, {1}, … in brackets where they need some, of {0.bare} without, of {one} and
    {zero}; {f} ends the names of functions of the type.

    `library`: The function of the C library that it calls; empty where it is instructions. `truth`: Its result is 1 or
    0, and in C a condition. `logic`: Its operands are conditions. `named`: Operands stand twice in the C, or are chosen
    between: they are values that were computed before. `near`, `alone`: LLVM for arguments that are not far, see
    `flexhinf.codegen.emit.sines`, and for those of which only one of sine and cosine is wanted. `costs`: It is as long
    as a call of a function, where others are a few instructions.

    `switches`: Where it has a kink or jumps. `poles`: Where it has a pole, arctan(sin x / cos x) jumps at those, or a
    branch point, √(x²) is |x| and arcsin(sin x) a triangle wave. What states neither counts as able to switch with each
    operand, and no model that is expanded may have it. `angle`: It jumps by whole turns, so that its derivatives go on.
    `linear`: Places of operands in which, together, its result is linear.

    `difference`: How far its result moves where operands do, see `flexhinf.scalars.deviations`; without one, two
    results are subtracted, unless it is linear. `factors`: Places of the operands whose product it is. `fused`: What it
    is where its left or its right operand is a product that nothing else uses. `of_truths`: What it is of two truth
    values. `whole`: LLVM's instruction for integers. `c_of_number`: C that is enough where the first operand is no NaN.
    """

    code: int
    numpy: NumpyRule
    llvm: LlvmRule
    c: str
    library: str = ""
    truth: bool = False
    logic: bool = False
    named: bool = False
    near: LlvmRule | None = None
    alone: LlvmRule | None = None
    costs: bool = False
    switches: Zeros = anywhere
    poles: Zeros = anywhere
    angle: bool = False
    linear: tuple[tuple[int, ...], ...] = ()
    difference: Difference | None = None
    factors: tuple[int, ...] = ()
    fused: tuple[int, int] | None = None
    of_truths: int | None = None
    whole: str = ""
    c_of_number: str = ""

    @property
    def operands(self) -> int:
        """How many there are."""
        return len(set(re.findall(r"\{(\d)", self.c)))

    @property
    def smooth(self) -> bool:
        """Whether it switches nowhere."""
        return not self.switches(*self._symbols())

    @property
    def polynomial(self) -> bool:
        """Whether its result is a polynomial of its operands."""
        return self.smooth and not self.costs and not self.poles(*self._symbols())

    def _symbols(self) -> Iterator[casadi.SX]:
        return (casadi.SX.sym(f"x{k}") for k in range(self.operands))

    @property
    def name(self) -> str:
        """What NumPy calls it; a rule of ours has another name."""
        return getattr(self.numpy, "__name__", "")


#: A sum or a product.
_smooth = partial(OperationKind, switches=nowhere, poles=nowhere)

#: Where operations of one operand, and of two, are linear.
_FIRST, _TOGETHER = ((0,),), ((0, 1),)


def _library(
    name: str,
    numpy: NumpyRule,
    operands: int = 1,
    code: int | None = None,
    switches: Zeros = nowhere,
    poles: Zeros = nowhere,
    angle: bool = False,
    difference: Difference | None = None,
) -> OperationKind:
    """A function of the C library."""
    arguments = ", ".join(f"{{{k}.bare}}" for k in range(operands))

    def called(w: Writer, *x: str) -> str:
        return w.library(name, *x)

    return OperationKind(
        getattr(casadi, f"OP_{name.upper()}") if code is None else code,
        numpy,
        called,
        f"{name}{{f}}({arguments})",
        library=name,
        costs=True,
        switches=switches,
        poles=poles,
        angle=angle,
        difference=difference,
    )


def _instruction(
    name: str,
    numpy: NumpyRule,
    switches: Zeros,
    operands: int = 1,
    costs: bool = False,
    poles: Zeros = nowhere,
    difference: Difference | None = None,
) -> OperationKind:
    """A single instruction, by the name that it has as a function in C and as an intrinsic in LLVM."""
    arguments = ", ".join(f"{{{k}.bare}}" for k in range(operands))
    code = getattr(casadi, f"OP_{name.upper()}")

    def called(w: Writer, *x: str) -> str:
        return w.intrinsic(name, *x)

    c = f"{name}{{f}}({arguments})"
    return OperationKind(
        code, numpy, called, c, costs=costs, switches=switches, poles=poles, difference=difference
    )


def _turn(name: str, numpy: NumpyRule, difference: Difference) -> OperationKind:
    """Sine or cosine, which are written here instead of called."""
    return OperationKind(
        getattr(casadi, f"OP_{name.upper()}"),
        numpy,
        lambda w, x: sines.turn(w, name, x),
        f"{name}{{f}}({{0.bare}})",
        near=lambda w, x: sines.turn(w, name, x, "near"),
        alone=lambda w, x: sines.turn(w, name, x, "alone"),
        costs=True,
        switches=nowhere,
        poles=nowhere,
        difference=difference,
    )


def _compared(code: int, numpy: NumpyRule, predicate: str, c: str) -> OperationKind:
    def llvm(w: Writer, a: str, b: str) -> str:
        return w.number(w.compare(predicate, a, b))

    return OperationKind(code, numpy, llvm, f"{{0}} {c} {{1}}", truth=True, switches=_gap, poles=nowhere)


def _logical(code: int, numpy: NumpyRule, name: str, c: str) -> OperationKind:
    """Of two truth values, of which the second is not left out: both are computed before. NaN is true, as in C."""

    def llvm(w: Writer, a: str, b: str) -> str:
        return w.number(w.joined(name, w.truth(a), w.truth(b)))

    c = f"{{0}} {c} {{1}}"
    return OperationKind(
        code, numpy, llvm, c, truth=True, logic=True, named=True, switches=anywhere, poles=nowhere
    )


def _extremum(code: int, numpy: NumpyRule, better: str, c: str, of_truths: int) -> OperationKind:
    """fmin or fmax of C: a NaN loses, the first operand wins a tie."""

    def llvm(w: Writer, a: str, b: str) -> str:
        beaten, missing = w.compare(better, b, a), w.compare("uno", a, a)
        return w.select(w.joined("or", beaten, missing), b, a)

    return OperationKind(
        code,
        numpy,
        llvm,
        f"(({{1}} {c} {{0}}) || (isnan({{0}}) != 0)) ? {{1}} : {{0}}",
        named=True,
        switches=_gap,
        poles=nowhere,
        of_truths=of_truths,
        c_of_number=f"({{1}} {c} {{0}}) ? {{1}} : {{0}}",
    )


def _sign(w: Writer, x: str) -> str:
    zero = w.lanes.constant(0.0)
    positive = w.select(w.compare("ogt", x, zero), w.lanes.constant(1.0), x)
    return w.select(w.compare("olt", x, zero), w.lanes.constant(-1.0), positive)


def _sign_of(x: ArrayLike) -> np.ndarray:
    value = np.asarray(x, dtype=float)
    return np.where(value == 0.0, value, np.sign(value))


def _erf(x: ArrayLike) -> ArrayLike:
    from scipy import special

    return cast("Callable[[ArrayLike], ArrayLike]", special.erf)(x)


def _remainder(x: ArrayLike, y: ArrayLike) -> np.ndarray:
    """x - n·y for the integer n nearest to x/y, the even one of two (IEEE 754), without rounding."""
    size: np.ndarray = np.abs(y)
    half, left = size / 2.0, np.fmod(np.abs(x), 2.0 * size)
    once = np.where(left > half, left - size, left)
    return np.copysign(1.0, x) * np.where((left > half) & (once >= half), once - size, once)


_TABLE = (
    # sums and products
    _smooth(casadi.OP_ASSIGN, operator.pos, lambda w, x: x, "{0}", linear=_FIRST),
    _smooth(
        casadi.OP_ADD,
        operator.add,
        lambda w, a, b: w.real("fadd", a, b),
        "{0} + {1}",
        linear=_TOGETHER,
        difference=deviations.total,
        fused=(MULTIPLY_ADD, MULTIPLY_ADD),
        whole="add",
    ),
    _smooth(
        casadi.OP_SUB,
        operator.sub,
        lambda w, a, b: w.real("fsub", a, b),
        "{0} - {1}",
        linear=_TOGETHER,
        difference=deviations.less,
        fused=(MULTIPLY_SUBTRACT, SUBTRACT_PRODUCT),
        whole="sub",
    ),
    _smooth(
        casadi.OP_MUL,
        operator.mul,
        lambda w, a, b: w.real("fmul", a, b),
        "{0} * {1}",
        linear=((0,), (1,)),
        difference=deviations.product,
        factors=(0, 1),
        of_truths=casadi.OP_AND,
        whole="mul",
    ),
    _smooth(
        casadi.OP_DIV,
        np.divide,
        lambda w, a, b: w.real("fdiv", a, b),
        "{0} / {1}",
        poles=_last,
        linear=_FIRST,
        difference=deviations.quotient,
        whole="sdiv",
    ),
    _smooth(casadi.OP_NEG, operator.neg, lambda w, x: w.real("fneg", x), "-{0}", linear=_FIRST),
    _smooth(
        casadi.OP_SQ,
        lambda x: x * x,
        lambda w, x: w.real("fmul", x, x),
        "{0} * {0}",
        named=True,
        difference=deviations.square,
        factors=(0, 0),
    ),
    _smooth(
        casadi.OP_TWICE,
        lambda x: x + x,
        lambda w, x: w.real("fadd", x, x),
        "{0} + {0}",
        named=True,
        linear=_FIRST,
    ),
    _smooth(
        casadi.OP_INV,
        np.reciprocal,
        lambda w, x: w.real("fdiv", 1.0, x),
        "{one} / {0}",
        poles=_last,
        difference=deviations.inverse,
    ),
    _smooth(
        MULTIPLY_ADD,
        lambda a, b, c: a * b + c,
        lambda w, a, b, c: w.intrinsic("fma", a, b, c),
        "FMA({0.bare}, {1.bare}, {2.bare})",
    ),
    _smooth(
        MULTIPLY_SUBTRACT,
        lambda a, b, c: a * b - c,
        lambda w, a, b, c: w.intrinsic("fma", a, b, w.real("fneg", c)),
        "FMA({0.bare}, {1.bare}, -{2})",
    ),
    _smooth(
        SUBTRACT_PRODUCT,
        lambda a, b, c: c - a * b,
        lambda w, a, b, c: w.intrinsic("fma", w.real("fneg", a), b, c),
        "FMA(-{0}, {1.bare}, {2.bare})",
    ),
    # choices
    OperationKind(
        casadi.OP_SIGN,
        _sign_of,
        _sign,
        "({0} < {zero}) ? -{one} : (({0} > {zero}) ? {one} : {0})",
        named=True,
        switches=_first,
        poles=nowhere,
    ),
    _extremum(casadi.OP_FMIN, np.fmin, "olt", "<", casadi.OP_AND),
    _extremum(casadi.OP_FMAX, np.fmax, "ogt", ">", casadi.OP_OR),
    _compared(casadi.OP_LT, operator.lt, "olt", "<"),
    _compared(casadi.OP_LE, operator.le, "ole", "<="),
    _compared(casadi.OP_EQ, operator.eq, "oeq", "=="),
    _compared(casadi.OP_NE, operator.ne, "une", "!="),
    OperationKind(
        casadi.OP_NOT,
        np.logical_not,
        lambda w, x: w.number(w.compare("oeq", x, w.lanes.constant(0.0))),
        "!{0}",
        truth=True,
        logic=True,
        switches=_first,
        poles=nowhere,
    ),
    _logical(casadi.OP_AND, np.logical_and, "and", "&&"),
    _logical(casadi.OP_OR, np.logical_or, "or", "||"),
    OperationKind(
        SELECT,
        np.where,
        lambda w, flag, a, b: w.select(w.truth(flag), a, b),
        "{0.choice} ? {1} : {2}",
        switches=_first,
        poles=nowhere,
        difference=deviations.chosen,
    ),
    # functions
    _instruction("sqrt", np.sqrt, nowhere, costs=True, poles=_last, difference=deviations.root),
    _instruction("fabs", np.fabs, _first),
    _instruction("floor", np.floor, _first),
    _instruction("ceil", np.ceil, _first),
    _instruction("copysign", np.copysign, anywhere, 2),
    _turn("sin", np.sin, deviations.sine),
    _turn("cos", np.cos, deviations.cosine),
    _library("tan", np.tan, poles=_last),
    _library("asin", np.arcsin, poles=_branch_points),
    _library("acos", np.arccos, poles=_branch_points),
    _library("atan", np.arctan, difference=deviations.arctan),
    _library("atan2", np.arctan2, 2, switches=_first, angle=True, difference=deviations.angle),
    _library("sinh", np.sinh),
    _library("cosh", np.cosh),
    _library("tanh", np.tanh, difference=deviations.tanh),
    _library("asinh", np.arcsinh),
    _library("acosh", np.arccosh),
    _library("atanh", np.arctanh),
    _library("exp", np.exp, difference=deviations.exponential),
    _library("expm1", np.expm1),
    _library("log", np.log),
    _library("log1p", np.log1p),
    _library("erf", _erf),
    _library("pow", np.power, 2),
    _library("pow", np.power, 2, casadi.OP_CONSTPOW),
    _library("hypot", np.hypot, 2),
    _library("fmod", np.fmod, 2, switches=anywhere),
    _library("remainder", _remainder, 2, switches=anywhere),
)

#: The table, by opcode.
OPERATIONS = dict[int, OperationKind]()

#: Those that are truth values; of truth values; comparisons of numbers; and as long as a call of a function.
TRUTHS, LOGIC, COMPARISONS, COSTLY = set[int](), set[int](), set[int](), set[int]()

#: Arithmetic, sine and cosine.
ELEMENTARY = set[int]()

#: Sine and cosine, which have forms for arguments that are not far, and their names.
TURNS = {row.code: row.c.partition("{")[0] for row in _TABLE if row.near is not None}

#: What a model does where an operation does not say whether it switches.
UNSTATED = "a row of the operation that states `switches` and `poles`: `nowhere` if it is smooth, see CONTRIBUTING.md"

#: Rows that other files registered.
_ADDED = dict[int, OperationKind]()


def _enter(row: OperationKind) -> None:
    OPERATIONS[row.code] = row
    kinds = (TRUTHS, row.truth), (LOGIC, row.logic), (COMPARISONS, row.truth and not row.logic)
    elementary = row.smooth and (row.code in TURNS or not row.costs)
    for codes, belongs in (*kinds, (COSTLY, row.costs), (ELEMENTARY, elementary)):
        (codes.add if belongs else codes.discard)(row.code)


for _row in _TABLE:
    _enter(_row)


def row_of(code: int) -> OperationKind | None:
    """The row of an operation of CasADi; None without one."""
    return OPERATIONS.get(SELECT if code == casadi.OP_IF_ELSE_ZERO else code)


def register(row: OperationKind) -> None:
    """Add an operation of CasADi, or put it in the place of its row. The function of NumPy, if `numpy` is one, then
    records it on symbols, and expands it where models are linearised or expanded, unless it switches.

    Raises InvalidInput: for sine and cosine, which are written whole in C too.
    """
    refuse_if(
        row.code in TURNS,
        "Sine and cosine cannot be replaced by a row.",
        f"expected another opcode of CasADi, got {NAMES.get(row.code, row.code)}",
        "a change of codegen/emit/sines.py and codegen/c/templates/turning.c, which compute the same bits",
    )
    _enter(row)
    _ADDED[row.code] = row
    if isinstance(row.numpy, np.ufunc):
        record(row.name, row.code, row.numpy.nin)
        refusal = UNSTATED if row.switches is anywhere else SMOOTH
        expand(row.name, row.code, row.numpy.nin, "" if row.smooth or row.angle else refusal)


def formula(function: np.ufunc, of: Callable[..., object]) -> None:
    """Let a function of NumPy that CasADi lacks be a formula of others, wherever models are traced or expanded.

    `function`: Of elements, as the first operand; on numbers it stays as it is. `of`: The same, of functions that
    models may call. Raises InvalidInput: for a function that models have, or that NumPy has for numbers alone.
    """
    name, taken = function.__name__, "which NumPy has for numbers alone"
    if any(kind.startswith("O") for kind in function.types):
        taken = ""
        with suppress(TypeError, AttributeError):
            function(*[Symbol(casadi.SX.sym("x"))] * function.nin)
            taken = "which models have"
    refuse_if(
        bool(taken),
        f"The function np.{name} cannot be a formula.",
        f"expected a function of NumPy for objects that models lack, got np.{name}, {taken}",
        f"a function in the model's file, such as my_{name}",
    )
    for element in (Symbol, Jet, Series):
        setattr(element, name, of)


def written_by_others() -> str:
    """What the operations that other files registered write as LLVM: machine code that is kept depends on it."""
    texts = list[str]()
    for row, width in product(_ADDED.values(), (1, 2)):
        writer = Writer(ModuleText(Lanes(width)))
        operands = [f"%in{k}" for k in range(row.operands)]
        texts.append(f"{row.code} {row.llvm(writer, *operands)} {writer.lines} {writer.module}")
    return "\n".join(texts)
