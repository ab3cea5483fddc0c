"""C from the text of Python functions: for what no trace can say, such as loops that change memory.

A module is written once, runs in Python as it stands, and is translated line by line. It keeps to what both languages
have: functions with stated types, `Record` classes, arrays whose sizes are stated, local names, `if`, `while`, `for`
over `range`, and arithmetic of numbers; what else it has is refused. Records and arrays are passed as they are and
changed in place, whole numbers are divided where they are not negative, and no quotient is by 0. An argument `own` is
what the caller of the translation fixes: its numbers become constants, and what its truths exclude is left out.

    Three = Annotated[list[float], 3]             # double[3]

    def scaled(own: Sizes, x: Three, k: int) -> float:
        "A sentence, which is the comment of the function."
        return own.factor * x[k] if k > 0 else 0.0
"""

# Not checked strictly: annotations are objects of any kind.
# pyright: reportUnknownVariableType=false, reportUnknownMemberType=false, reportUnknownArgumentType=false

from __future__ import annotations

import ast
import ctypes
import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from types import ModuleType
from typing import Annotated, Any, NamedTuple, NoReturn, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np

from flexhinf.codegen.c.algebra import Real, comment, constant
from flexhinf.codegen.c.identifiers import KEYWORDS
from flexhinf.codegen.c.layout import block, headed
from flexhinf.codegen.program import Unsupported

OPERATORS: Mapping[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "/", ast.Mod: "%",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
    ast.And: "&&", ast.Or: "||",
}  # fmt: skip

#: Functions of numbers by their names in Python, {f} is the suffix of the type; and those that are written here.
LIBRARY, CHOICES = {"abs": "fabs{f}", "math.sqrt": "sqrt{f}"}, {"min": "<", "max": ">"}


#: Largest whole number of C's int on every machine.
SHORT = 32767


class Kind(NamedTuple):
    """The type of a value: "real", "int", "long", "truth" of a condition, "" of nothing, or the name of a record."""

    name: str
    shape: tuple[str, ...] = ()
    many: bool = False  # records of the caller's, as many as he says


#: Of what a value is made: its type in Python, its sizes, and whether the caller says how many there are.
Content: TypeAlias = "tuple[type, tuple[str | int, ...], bool]"


class Value(NamedTuple):
    """An expression of C. `reached`: It is a pointer to a record. `bare`: It stands as an operand without brackets."""

    text: str
    kind: Kind
    reached: bool = False
    bare: bool = True


# What Python has of it ----------------------------------------------------------------------------------
class Record:
    """Numbers by name, 0 at first: a struct in C. Sizes that are names are those of `own`."""

    def __init__(self, own: Any) -> None:
        for name, (element, shape, many) in fields(type(self)).items():
            setattr(self, name, [] if many else _zero(element, shape, own))


@cache
def fields(record: type[Record]) -> dict[str, Content]:
    """Fields by name: what each is made of, its sizes, and whether the caller says how many there are."""
    return {name: _content_of(hint) for name, hint in get_type_hints(record, include_extras=True).items()}


def _content_of(hint: Any) -> Content:
    base, *said = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    element = base
    while get_origin(element) is list:
        (element,) = get_args(element)
    if said == ["long"]:
        return np.int64, (), False
    return element, tuple(size for size in said if size != "many"), "many" in said


def _zero(element: type, shape: tuple[str | int, ...], own: Any) -> Any:
    sizes = [size if isinstance(size, int) else own.sizes[size] for size in shape]
    if element is np.ndarray:
        return np.zeros(sizes)
    if sizes:
        return [_zero(element, shape[1:], own) for _ in range(sizes[0])]
    return element(own) if issubclass(element, Record) else 0.0 if element is float else 0


def zeros(size: int, *others: int) -> Any:
    """An array of zeros."""
    return [zeros(*others) for _ in range(size)] if others else [0.0] * size


#: An array whose numbers are written before they are read: C has no zeros there.
room = zeros


def counters(size: int) -> list[int]:
    """An array of whole numbers, 0 at first."""
    return [0] * size


@cache
def structure(record: type[Record], sizes: tuple[tuple[str, int], ...], real: type) -> type[ctypes.Structure]:
    """The record as C has it in this process."""
    number = ctypes.c_double if np.dtype(real).itemsize == 8 else ctypes.c_float
    whole, known = {int: ctypes.c_int, np.int64: ctypes.c_long}, dict(sizes)

    def place(element: type, shape: tuple[str | int, ...], many: bool) -> Any:
        if many:
            return ctypes.c_void_p
        content: Any = (
            structure(element, sizes, real) if issubclass(element, Record) else whole.get(element, number)
        )
        for size in reversed(shape):
            content = content * (size if isinstance(size, int) else known[size])
        return content

    places = [(name, place(*content)) for name, content in fields(record).items()]
    return type(record.__name__, (ctypes.Structure,), {"_fields_": places})


# The translation ----------------------------------------------------------------------------------------
class Source:
    """Modules as C, which import one another's names.

    `prefix`: What names of functions, types and constants begin with, in capitals those of enumerations. `own`: What is
    fixed. `sizes`: How C calls sizes that are names, and whole numbers of `own`. `external`: Functions that C has
    otherwise. Raises Unsupported: for what C has not, with the line.
    """

    def __init__(
        self,
        modules: Sequence[ModuleType],
        prefix: str,
        real: Real,
        own: Any,
        sizes: Mapping[str, str],
        external: Sequence[str] = (),
    ) -> None:
        self.prefix, self.real, self.own = prefix, real, own
        self.sizes, self.external = sizes, external
        self.lines = {module.__name__: inspect.getsource(module).splitlines() for module in modules}
        self.defined, self.classes = dict[str, ast.FunctionDef](), dict[str, ast.ClassDef]()
        self.modules = dict[str, ModuleType]()  # by functions and classes that are theirs
        for module in modules:
            for node in ast.parse(inspect.getsource(module)).body:
                if isinstance(node, ast.FunctionDef):
                    self.defined[node.name], self.modules[node.name] = node, module
                elif isinstance(node, ast.ClassDef):
                    self.classes[node.name], self.modules[node.name] = node, module
        self.constants, self.written = dict[str, str](), dict[str, Function | str]()

    def record(self, name: str) -> str:
        """The struct of a record, with the comments of its fields."""
        contents, lines = fields(self.named(name)), list[str]()
        for node in self.classes[name].body:
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                kind = self.kind(contents[_allowed(node.target.id, node)])
                pointer = f"const {self.type_of(kind)} *" if kind.many else f"{self.type_of(kind)} "
                lines.append(f"    {pointer}{node.target.id}{_sizes(kind)};{self.remark(name, node.lineno)}")
        about = headed(self.named(name).__doc__ or "")
        return "\n".join([*about, "typedef struct {", *lines, f"}} {self.type_of(Kind(name))};"])

    def named(self, name: str) -> Any:
        """The function or class of a name, in Python."""
        return getattr(self.modules[name], name)

    def line(self, name: str, number: int) -> str:
        """A line of the module in which a function or class stands."""
        return self.lines[self.modules[name].__name__][number - 1]

    def functions(self, *public: str) -> str:
        """Functions that others may call, behind what they need."""
        for name in public:
            self.function(name)
        return "\n\n".join(
            one if isinstance(one, str) else one.text(name not in public)
            for name, one in self.written.items()
        )

    def function(self, name: str) -> Function:
        """A function, written at its first use."""
        function = self.written.get(name)
        if not isinstance(function, Function):
            function = Function(self, self.defined[name])
            if name not in self.external:
                self.written[name] = function
        return function

    def choice(self, name: str) -> str:
        """The name of the function for the smaller or the larger of two numbers: the first one, where neither is."""
        place = f"{self.prefix}_{name}"
        lines, R = block("{", [f"return (b {CHOICES[name]} a) ? b : a;"]), self.real.written
        self.written.setdefault(place, "\n".join([f"static {R} {place}({R} a, {R} b)", *lines]))
        return place

    def fixed(self, name: str, node: ast.AST) -> Value:
        """A number, or a row of them, of `own`."""
        value = getattr(self.own, name)
        if name in self.sizes:
            return Value(self.sizes[name], Kind("int"))
        if isinstance(value, (bool, int)):
            return Value(str(int(value)), Kind("int"))
        if isinstance(value, float):
            return Value(constant(value, self.real), Kind("real"))
        row = np.asarray(value, dtype=float)
        if row.ndim != 1:
            refuse(node, f"{name} of own, which is neither a number nor a row")
        numbers, place = ", ".join(constant(float(x), self.real) for x in row), f"{self.prefix}_{name}"
        self.constants[name] = f"static const {self.real.written} {place}[{len(row)}] = {{{numbers}}};"
        return Value(place, Kind("real", (str(len(row)),)))

    def kind(self, content: Content) -> Kind:
        """The type of a content."""
        element, shape, many = content
        names = {float: "real", int: "int", np.int64: "long", np.ndarray: "real", type(None): ""}
        sizes = tuple(self.sizes.get(str(size), str(size)) for size in shape)
        return Kind(names.get(element, element.__name__), sizes, many)

    def type_of(self, kind: Kind) -> str:
        """How C calls a type."""
        known = {"real": self.real.written, "int": "int", "long": "long", "truth": "int", "": "void"}
        return known.get(kind.name) or f"{self.prefix}_{kind.name.lower()}"

    def remark(self, name: str, number: int) -> str:
        """The comment behind a line of the module in which a function or class stands."""
        _, sign, text = self.line(name, number).partition("  # ")
        return f" /* {comment(text)} */" if sign else ""


def _sizes(kind: Kind) -> str:
    return "".join(f"[{size}]" for size in kind.shape)


def refuse(node: ast.AST, what: str) -> NoReturn:
    """Refuse what C has no form of."""
    line = getattr(node, "lineno", 0)
    raise Unsupported("The text of a function has no form in C.", f"line {line} has {what}")


class Function:
    """A function as C. `kind`: Of what it returns. `arguments`: By name. `changed`: Those that it changes."""

    def __init__(self, source: Source, node: ast.FunctionDef) -> None:
        self.source, self.node, self.module = source, node, source.modules[node.name]
        hints = get_type_hints(source.named(node.name), include_extras=True)
        kinds = {name: source.kind(_content_of(hint)) for name, hint in hints.items() if name != "own"}
        self.kind, self.arguments, self.changed = kinds.pop("return"), kinds, set[str]()
        self.names = {name: Value(name, kind, self._is_record(kind)) for name, kind in kinds.items()}
        self.roots = dict[str, str]()  # of what a name is a part
        stored = [
            one.id for one in ast.walk(node) if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
        ]
        self.once = {name for name in stored if stored.count(name) == 1}
        body = node.body[1:] if ast.get_docstring(node) else node.body
        if node.name in source.external:
            self._note_changes(body)
        else:
            self.top, self.depth = list[str](), 0
            lines = self._block(body)
            used = set(re.findall(r"\w+", "\n".join(lines)))
            unused = [f"(void){name};" for name in self.arguments if name not in used]
            self.lines = [*self.top, *unused, *lines]

    def text(self, is_static: bool) -> str:
        """The function under its comment."""
        declared = ", ".join(self._argument(name, kind) for name, kind in self.arguments.items())
        kind, name = self.source.type_of(self.kind), f"{self.source.prefix}_{self.node.name}"
        head = f"{'static ' if is_static else ''}{kind} {name}({declared or 'void'})"
        about = headed(ast.get_docstring(self.node) or "")
        return "\n".join([*about, head, *block("{", self.lines)])

    def _argument(self, name: str, kind: Kind) -> str:
        element, stays = self.source.type_of(kind), "" if name in self.changed else "const "
        if kind.shape:
            return f"{stays if len(kind.shape) == 1 else ''}{element} {name}{_sizes(kind)}"
        return f"{stays}{element} *{name}" if self._is_record(kind) else f"{element} {name}"

    @staticmethod
    def _is_record(kind: Kind) -> bool:
        return kind.name[:1].isupper() and not kind.shape and not kind.many

    def _note_changes(self, body: list[ast.stmt]) -> None:
        for node in (inner for statement in body for inner in ast.walk(statement)):
            if isinstance(node, (ast.Subscript, ast.Attribute)) and isinstance(node.ctx, ast.Store):
                self.changed.add(self._root(node))

    def _root(self, node: ast.expr) -> str:
        """The argument, or the name, of which it is a part."""
        while isinstance(node, (ast.Attribute, ast.Subscript)):
            node = node.value
        name = node.id if isinstance(node, ast.Name) else ""
        return self.roots.get(name, name)

    def _line(self, number: int) -> str:
        return self.source.line(self.node.name, number)

    def _remark(self, number: int) -> str:
        return self.source.remark(self.node.name, number)

    # Statements -------------------------------------------------------------------------------------
    def _block(self, body: list[ast.stmt]) -> list[str]:
        self.depth, lines = self.depth + 1, list[str]()
        for node in body:
            written = self._statement(node)
            if written and not isinstance(node, ast.If):
                written[0] += self._remark(node.lineno)
            lines += written
        self.depth -= 1
        return lines

    def _statement(self, node: ast.stmt) -> list[str]:
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                self._check_order(targets, values, node)
                return [self._assignment(*pair) for pair in zip(targets, values, strict=True)]
            case ast.Assign(targets=[target], value=value):
                return [self._assignment(target, value)]
            case ast.AugAssign(target=target, op=operator, value=value):
                return [f"{self._target(target).text} {_sign(operator, node)}= {self._value(value).text};"]
            case ast.If():
                return list(self._choice(node))
            case ast.While(test=test, orelse=[]):
                return block(f"while ({self._condition(test)}) {{", self._block(node.body))
            case ast.For(
                target=ast.Name(id=i), iter=ast.Call(func=ast.Name(id="range"), args=ends), orelse=[]
            ) if [ast.unparse(step) for step in ends[2:]] in ([], ["-1"]):
                self.names[i] = Value(i, Kind("int"))
                first, *others = [self._value(end).text for end in ends]
                begin, end = (first, others[0]) if others else ("0", first)
                sign, step = (">", "--") if len(others) == 2 else ("<", "++")
                return block(
                    f"for (int {i} = {begin}; {i} {sign} {end}; {step}{i}) {{", self._block(node.body)
                )
            case ast.Return(value=ast.expr() as value):
                return [f"return {self._value(value).text};"]
            case ast.Expr(value=ast.Call() as call):
                found = self._value(call)
                return [f"{'(void)' if found.kind.name else ''}{found.text};"]
            case _:
                refuse(node, f"the statement {ast.unparse(node)!r}")

    def _choice(self, node: ast.If) -> Iterator[str]:
        """Conditions one behind another, but for those that `own` decides."""
        arms, after = list[ast.If](), list[ast.stmt]([node])
        while (
            len(after) == 1 and isinstance(after[0], ast.If) and (after[0] is node or self._is_elif(after[0]))
        ):
            truth = self._fixed(after[0].test)
            arms += [after[0]] if truth is None else []
            after = after[0].body if truth else after[0].orelse
            if truth:
                break
        for k, one in enumerate(arms):
            yield f"{'} else ' if k else ''}if ({self._condition(one.test)}) {{{self._remark(one.lineno)}"
            yield from (f"    {line}" for line in self._block(one.body))
        if not arms:
            yield from self._block(after)
        elif after or len(arms) > 1:
            above = after[0].lineno - 1 if after else 0
            says = after and self._line(above).lstrip().startswith("else:")
            yield "} else {" + (self._remark(above) if says else "")
            yield from (f"    {line}" for line in (self._block(after) if after else ["/* as it is */"]))
        if arms:
            yield "}"

    def _check_order(self, targets: list[ast.expr], values: list[ast.expr], node: ast.stmt) -> None:
        """Refuse assignments of which a later one reads what an earlier one has written: Python makes them at once."""
        for k, value in enumerate(values):
            read = {one.id for one in ast.walk(value) if isinstance(one, ast.Name)}
            if read & {self._root(target) for target in targets[:k]}:
                refuse(node, f"values that depend on each other's places in {ast.unparse(node)!r}")

    def _is_elif(self, node: ast.If) -> bool:
        return self._line(node.lineno).lstrip().startswith("elif ")

    def _assignment(self, target: ast.expr, value: ast.expr) -> str:
        """A name is declared where it is assigned first, or at the top where that is within a block."""
        if not isinstance(target, ast.Name) or target.id in self.names:
            found, place = self._value(value), self._target(target)
            return f"{place.text} = {'*' if found.reached else ''}{found.text};"
        declared, text = self._declared(target.id, value)
        if self.depth == 1:
            return f"{declared} = {text};" if text else f"{declared};"
        self.top.append(f"{declared};")
        return f"{target.id} = {text};"

    def _declared(self, name: str, value: ast.expr) -> tuple[str, str]:
        """The declaration of a name, and what it is at first."""
        _allowed(name, value)
        match value:
            case ast.Call(func=ast.Name(id="zeros" | "room" | "counters" as array), args=sizes) if (
                self.depth == 1
            ):
                shape = tuple(self._value(size).text for size in sizes)
                found = Value(
                    "" if array == "room" else "{0}", Kind("int" if array == "counters" else "real", shape)
                )
            case ast.Call(func=ast.Name(id=record), args=[ast.Name(id="own")]) if self.depth == 1:
                found = Value("{0}", Kind(record))
            case _:
                found = self._value(value)
                if (
                    self._is_record(found.kind) or found.kind.shape
                ):  # a part of something, under a name of its own
                    self.roots[name], part = self._root(value), not found.kind.shape
                    self.names[name] = Value(name, found.kind, part)
                    reached = f"{'const ' if part else ''}{self.source.type_of(found.kind)} *{name}"
                    return reached, found.text if found.reached or not part else f"&{found.text}"
        self.names[name] = Value(name, found.kind)
        stays = "const " if name in self.once and self.depth == 1 and found.text not in ("", "{0}") else ""
        return f"{stays}{self.source.type_of(found.kind)} {name}{_sizes(found.kind)}", found.text

    def _target(self, node: ast.expr) -> Value:
        """A place that is written."""
        if isinstance(node, (ast.Attribute, ast.Subscript)):
            self.changed.add(self._root(node))
        return self._value(node)

    # Expressions ------------------------------------------------------------------------------------
    def _fixed(self, node: ast.expr) -> bool | None:
        """Whether a condition holds, where `own` says it."""
        match node:
            case ast.Attribute(value=ast.Name(id="own"), attr=name):
                value = getattr(self.source.own, name)
                return value if isinstance(value, bool) else None
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                truth = self._fixed(operand)
                return None if truth is None else not truth
            case ast.BoolOp(op=operator, values=values):
                truths, decides = [self._fixed(one) for one in values], isinstance(operator, ast.Or)
                if decides in truths:
                    return decides
                return None if None in truths else not decides
            case _:
                return None

    def _condition(self, node: ast.expr) -> str:
        found = self._value(node)
        return found.text if found.kind.name == "truth" else f"{_bracketed(found)} != 0"

    def _value(self, node: ast.expr) -> Value:
        match node:
            case ast.Constant(value=int() as number):
                return Value(
                    f"{number}{'L' if number > SHORT else ''}", Kind("long" if number > SHORT else "int")
                )
            case ast.Constant(value=float() as number):
                return Value(constant(number, self.source.real), Kind("real"))
            case ast.Name(id=name):
                return self.names.get(name) or self._value(ast.Constant(getattr(self.module, name)))
            case ast.Attribute(value=ast.Name(id="own"), attr=name):
                return self.source.fixed(name, node)
            case ast.Attribute(value=ast.Name(id=name), attr=member) if name not in self.names:
                getattr(getattr(self.module, name), member)
                return Value(f"{self.source.prefix.upper()}_{member}", Kind("int"))
            case ast.Attribute(value=whole, attr=member):
                found = self._value(whole)
                kind = self.source.kind(fields(self.source.named(found.kind.name))[member])
                return Value(f"{found.text}{'->' if found.reached else '.'}{member}", kind)
            case ast.Subscript(value=whole, slice=place):
                found = self._value(whole)
                text = f"{found.text}[{self._value(place).text}]"
                return Value(text, Kind(found.kind.name, found.kind.shape[1:]))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                found = self._value(operand)
                return Value(f"-{_bracketed(found)}", found.kind)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                found = self._value(operand)
                is_truth = found.kind.name == "truth"
                none = "NULL" if found.kind.many else "0"
                text = f"!({found.text})" if is_truth else f"{_bracketed(found)} == {none}"
                return Value(text, Kind("truth"), bare=is_truth)
            case ast.BinOp(left=left, op=operator, right=right):
                return self._computed(self._value(left), operator, self._value(right), node)
            case ast.Compare(left=left, ops=operators, comparators=others):
                terms = [_bracketed(self._value(one)) for one in (left, *others)]
                signs = [_sign(one, node) for one in operators]
                pairs = [f"{a} {sign} {b}" for a, sign, b in zip(terms, signs, terms[1:])]
                return Value(" && ".join(pairs) if len(pairs) > 1 else pairs[0], Kind("truth"), bare=False)
            case ast.BoolOp() if (truth := self._fixed(node)) is not None:
                return Value(str(int(truth)), Kind("truth"))
            case ast.BoolOp(op=operator, values=values):
                left = [self._condition(one) for one in values if self._fixed(one) is None]
                text = f" {_sign(operator, node)} ".join(f"({one})" for one in left)
                return Value(text if len(left) > 1 else left[0], Kind("truth"), bare=False)
            case ast.IfExp(test=test, body=body, orelse=other):
                found, no = self._value(body), _bracketed(self._value(other))
                return Value(
                    f"({self._condition(test)}) ? {_bracketed(found)} : {no}", found.kind, bare=False
                )
            case ast.Call(func=function, args=arguments, keywords=[]):
                return self._call(ast.unparse(function), arguments, node)
            case _:
                refuse(node, f"the expression {ast.unparse(node)!r}")

    def _computed(self, left: Value, operator: ast.operator, right: Value, node: ast.expr) -> Value:
        kinds = {left.kind.name, right.kind.name}
        kind = next(name for name in ("real", "long", "int") if name in kinds)
        # Python and C divide whole numbers by one sign, and others by another one.
        if isinstance(operator, ast.Div) != (kind == "real") and _sign(operator, node) in ("/", "%"):
            refuse(node, f"a quotient in which Python and C differ, {ast.unparse(node)!r}")
        text = f"{_bracketed(left)} {_sign(operator, node)} {_bracketed(right)}"
        return Value(text, Kind(kind), bare=False)

    def _call(self, name: str, arguments: list[ast.expr], node: ast.expr) -> Value:
        if name in self.source.defined:
            return self._call_own(name, arguments)
        found = [self._value(one) for one in arguments]
        texts, real = ", ".join(one.text for one in found), found[0].kind.name == "real"
        match name:
            case "float":
                return Value(f"({self.source.real.written}){_bracketed(found[0])}", Kind("real"))
            case "int":
                return Value(f"(long){_bracketed(found[0])}", Kind("long")) if real else found[0]
            case "math.isfinite":
                return Value(f"isfinite({texts})", Kind("int"))
            case "min" | "max" if real:
                return Value(f"{self.source.choice(name)}({texts})", Kind("real"))
            case "min" | "max":
                a, b = map(_bracketed, found)
                return Value(f"({b} {CHOICES[name]} {a}) ? {b} : {a}", found[0].kind, bare=False)
            case _ if name in LIBRARY:
                return Value(f"{LIBRARY[name].format(f=self.source.real.suffix)}({texts})", Kind("real"))
            case _:
                refuse(node, f"the function {name!r}")

    def _call_own(self, name: str, arguments: list[ast.expr]) -> Value:
        """`own` itself is no argument in C."""
        called, texts = self.source.function(name), list[str]()
        passed = [one for one in arguments if not (isinstance(one, ast.Name) and one.id == "own")]
        for argument, node in zip(called.arguments, passed, strict=True):
            found = self._value(node)
            if (
                argument in called.changed or len(found.kind.shape) > 1
            ):  # C takes no matrix for one that stays
                self.changed.add(self._root(node))
            reached = self._is_record(found.kind) and not found.reached
            texts.append(f"{'&' if reached else ''}{found.text}")
        return Value(f"{self.source.prefix}_{name}({', '.join(texts)})", called.kind)


def _allowed(name: str, node: ast.AST) -> str:
    if name in KEYWORDS:
        refuse(node, f"the name {name!r}, which is a word of C")
    return name


def _sign(operator: ast.AST, node: ast.AST) -> str:
    if type(operator) not in OPERATORS:
        refuse(node, f"the operator of {ast.unparse(node)!r}")
    return OPERATORS[type(operator)]


def _bracketed(value: Value) -> str:
    return value.text if value.bare else f"({value.text})"
