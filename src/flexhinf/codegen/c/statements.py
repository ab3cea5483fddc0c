"""A long row of statements of C as several functions, which it calls one after the other.

Statements that follow on each other go together, up to `PART` lines, best from one comment to another. What is
declared, what may return, and a few lines between such, stay where they are. A statement that is too long for a
function, such as the body of a loop, is cut inside.

A compiler keeps each pointer that several calls get on the stack from one call to another, below all that the calls
need. So a function with many is cut too, and its parts are not put back into it: each then keeps its own alone.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from flexhinf.codegen.c.layout import INDENT, block, length
from flexhinf.codegen.cut import LINES
from flexhinf.codegen.naming import Names

#: What a block declares, by how a function that is called in it declares the same.
DECLARED = {
    r"(?:for \(|const )int (\w+) = ": "int {name}",
    r"(?:const )?(\w+ \*)const (\w+) = ": "{kind}{name}",
}

#: Lines that are not worth a function.
FEW = 3

#: Lines of a part at most, with its head and its braces.
PART = 40

#: Pointers into memory of the caller that a function declares at most.
POINTERS = 40


class Statements:
    """The functions of a row of statements.

    `name`: Of the function that has all of them; the others are called so with a number. `arguments`: Their
    declarations by name. `pointers`: Lines that declare what other lines use and no argument is. `functions`: Texts of
    all that may be called, by name. `names`: Those of the file.
    """

    def __init__(
        self,
        name: str,
        arguments: Mapping[str, str],
        pointers: Callable[[Sequence[str]], Sequence[str]],
        functions: Mapping[str, str],
        names: Names,
    ) -> None:
        self.name, self.arguments, self._pointers, self._functions = name, arguments, pointers, functions
        self._names = names
        self._parts = dict[str, str]()

    def texts(self, lines: Sequence[str], result: str) -> dict[str, str]:
        """Functions by name, in an order in which C can read them; the last has all statements, and gives a result."""
        head = f"static int {self.name}({', '.join(self.arguments.values())})"

        def text(own: Sequence[str]) -> str:
            return "\n".join(block(f"{head}\n{{", [*self._pointers(own), *own, f"return {result};"]))

        whole = text(lines)
        if length(whole) > LINES or len(self._pointers(lines)) > POINTERS:
            whole = text([*self._called(lines, self.arguments)])
        return {**self._parts, self.name: whole}

    def _called(self, lines: Sequence[str], scope: Mapping[str, str]) -> Iterator[str]:
        """Statements, or calls of functions that have some of them. `scope`: Declarations of what they may use."""
        run = list[list[str]]()
        for statement in split(lines):
            scope = {**scope, **_declared(statement[-1])}
            if _stays(statement):
                yield from self._part(run, scope)
                yield from statement
                run = []
                continue
            run.append(statement)
            if length(self._text("", run, scope)) <= PART:
                continue
            begins = [k for k, own in enumerate(run) if k and own[0].startswith("/*")]
            cut = begins[-1] if begins else len(run) - 1
            yield from self._part(run[:cut], scope)
            run = run[cut:]
            if length(self._text("", run, scope)) > PART and len(run) == 1:
                yield from self._inside(run[0], scope)
                run = []
        yield from self._part(run, scope)

    def _part(self, run: Sequence[list[str]], scope: Mapping[str, str]) -> Iterator[str]:
        """The call of a function that has a run of statements."""
        if sum(map(len, run)) <= FEW:
            yield from (line for own in run for line in own)
        else:
            name = self._names.numbered(f"{self.name}_part", "_")
            self._parts[name] = self._text(name, run, scope)
            yield f"{name}({', '.join(self._used(run, scope))});"

    def _inside(self, statement: list[str], scope: Mapping[str, str]) -> Iterator[str]:
        """A block with calls in the place of its statements."""
        begin = next(k for k, line in enumerate(statement) if line.endswith("{"))
        yield from statement[: begin + 1]
        inner = [line.removeprefix(INDENT) for line in statement[begin + 1 : -1]]
        for line in self._called(inner, {**scope, **_declared(statement[begin])}):
            yield INDENT + line
        yield statement[-1]

    def _used(self, run: Sequence[list[str]], scope: Mapping[str, str]) -> list[str]:
        """What of a scope a run of statements uses."""
        lines = [line for own in run for line in own]
        known = _names([*self._pointers(lines), *lines])
        return [name for name in scope if name in known]

    def _text(self, name: str, run: Sequence[list[str]], scope: Mapping[str, str]) -> str:
        lines = [line for own in run for line in own]
        pointers = self._pointers(lines)
        kept = _names(pointers)
        declared = [
            scope[used] if used in kept or self._changes(lines, used) else _constant(scope[used])
            for used in self._used(run, scope)
        ]
        head = f"static NOINLINE void {name}({', '.join(declared)})"
        return "\n".join(block(f"{head}\n{{", [*pointers, *lines]))

    def _changes(self, lines: Sequence[str], name: str) -> bool:
        """Whether statements may write to a name: by themselves, or by a function that does not promise otherwise."""
        word = re.compile(rf"\b{name}\b")
        for line in filter(word.search, _code(lines)):
            called = re.fullmatch(r"\s*(\w+)\((.*)\);", line)
            if called is None:
                if re.search(rf"\b{name}\b.* = |\*const \w+ = .*\b{name}\b", line):
                    return True
                continue
            *_, head = self._functions[called[1]].partition(f"{called[1]}(")
            arguments = zip(head.partition(")")[0].split(", "), called[2].split(", "))
            if any(word.search(argument) and not said.startswith("const ") for said, argument in arguments):
                return True
        return False


def split(lines: Sequence[str]) -> Iterator[list[str]]:
    """Lines of one statement after the other, each under its comment."""
    statement = list[str]()
    for line in lines:
        statement.append(line)
        if line == "}" or (line.endswith(";") and not line.startswith(" ")):
            yield statement
            statement = []
    if statement:
        yield statement


def _stays(statement: Sequence[str]) -> bool:
    """Whether it declares something, or may return."""
    return bool(_declared(statement[-1])) or any(line.lstrip().startswith("return ") for line in statement)


def _declared(line: str) -> dict[str, str]:
    """What a line declares: how a function that is called behind it does, by its name."""
    for pattern, said in DECLARED.items():
        if found := re.match(pattern, line):
            *kind, name = found.groups()
            return {name: said.format(name=name, kind="".join(kind))}
    return {}


def _constant(declaration: str) -> str:
    """A declaration that promises not to write."""
    return declaration if declaration.startswith(("const ", "int ")) else f"const {declaration}"


def _code(lines: Iterable[str]) -> Iterator[str]:
    """Lines that are no comments."""
    return (line for line in lines if not line.lstrip().startswith(("/*", "* ")))


def _names(lines: Iterable[str]) -> set[str]:
    return {word for line in _code(lines) for word in re.findall(r"\w+", line)}
