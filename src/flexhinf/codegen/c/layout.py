"""Lines of C: in blocks, under comments, folded."""

from __future__ import annotations

import re
from collections.abc import Iterable
from textwrap import wrap

from flexhinf.codegen.c.algebra import comment

INDENT = "    "

#: Characters of a line.
WIDTH = 120

#: Where a line of code may be cut, the best first.
CUTS = (", ", " ? ", " || ", " && ", " = ", " + ", " - ")


def folded(text: str) -> str:
    """Lines of at most `WIDTH` characters: code cut at commas and operators, comments at blanks, directives with their
    further lines as they are. What a line of a comment is too long for begins the next one. A long comment behind code
    goes before it."""
    lines, done = text.split("\n")[::-1], list[str]()
    while lines:
        *short, last = _folded(lines.pop())
        done += short
        goes_on = lines and short and _is_inside(last) and _is_inside(lines[-1]) and not last.endswith("*/")
        if goes_on:
            lines[-1] = f"{last} {lines[-1].lstrip()[2:]}"
        else:
            done.append(last)
    return "\n".join(done)


def length(text: str) -> int:
    """Lines that a text has when it is folded."""
    return folded(text).count("\n") + 1


def _is_inside(line: str) -> bool:
    """Whether it is a line of words in a comment, behind its first one."""
    return line.lstrip().startswith("* ")


def _folded(line: str, inside: str = "") -> list[str]:
    """The lines of one; those that follow the first are `inside`. No string is cut."""
    if len(line) <= WIDTH or line.lstrip().startswith("#") or line.endswith("\\"):
        return [line]
    indent = line[: len(line) - len(line.lstrip())]
    plain = re.sub(r'"(?:\\.|[^"\\])*"', lambda text: "s" * len(text[0]), line)  # strings are one word
    code, mark, _ = min((plain.partition(mark) for mark in ("/* ", "// ")), key=lambda parts: len(parts[0]))
    about = line[len(code) + len(mark) :]
    if mark and code.strip() and (about.endswith("*/") or mark == "// "):
        return [*_folded(f"{indent}{mark}{about}"), *_folded(line[: len(code)].rstrip())]
    if mark or _is_inside(line):
        cut = line.rfind(" ", 0, WIDTH + 1)
        cut = line.rfind(" ", 0, cut) if line[cut:] == " */" else cut
        sign = " * " if mark == "/* " else mark or "* "
        if cut <= len(indent) + len(sign):  # a word that no line takes
            return [line]
        return [line[:cut], *_folded(indent + sign + line[cut + 1 :])]
    inside = inside or indent + " " * 8
    for sign in CUTS:
        if (cut := plain.rfind(sign, len(inside), WIDTH)) > 0:
            end = cut + 1 if sign == ", " else cut
            return [line[:end], *_folded(inside + line[end:].lstrip(), inside)]
    return [line]


def headed(about: str, indent: str = "") -> list[str]:
    """A comment: the first sentence of a docstring, without what it refers to."""
    sentence = re.split(r"(?<!Eq)\. ", " ".join(about.split("\n\n")[0].split()))[0]
    sentence = sentence.partition("; see ")[0].partition(", see ")[0].rstrip(".")
    lines = wrap(comment(sentence).replace("`", ""), 114 - len(indent))
    return f"/* {(chr(10) + ' * ').join(lines)} */".splitlines() if lines else []


def block(head: str, lines: Iterable[str]) -> list[str]:
    """Lines of C after a head that ends with a brace, and the other brace."""
    return [head, *(INDENT + line for line in lines), "}"]


def loop(counter: str, end: int | str, lines: Iterable[str]) -> list[str]:
    """Lines of C for every `counter` from 0 to `end`."""
    return block(f"for (int {counter} = 0; {counter} < {end}; ++{counter}) {{", lines)
