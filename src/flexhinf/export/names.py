"""Names in C: what may be one, what signals are called, and what may stand in a comment."""

from __future__ import annotations

import re
from collections.abc import Sequence

from flexhinf.errors import InvalidInput
from flexhinf.untrusted import value_text

#: Words of C99 and of C++, and names of their headers: NAME.h must not be found in the place of one.
RESERVED = frozenset({
    "asm", "auto", "bool", "break", "case", "catch", "char", "class", "const", "continue", "default", "delete", "do",
    "double", "else", "enum", "explicit", "export", "extern", "false", "float", "for", "friend", "goto", "if",
    "inline", "int", "long", "main", "mutable", "namespace", "new", "not", "operator", "or", "private", "protected",
    "public", "register", "restrict", "return", "short", "signed", "sizeof", "static", "struct", "switch", "template",
    "this", "throw", "true", "try", "typedef", "typename", "union", "unsigned", "using", "virtual", "void", "volatile",
    "while", "xor",
    "assert", "complex", "ctype", "errno", "fenv", "inttypes", "iso646", "limits", "locale", "math", "memory", "setjmp",
    "signal", "stdarg", "stdbool", "stddef", "stdint", "stdio", "stdlib", "string", "strings", "tgmath", "threads",
    "time", "unistd", "wchar", "wctype",
})  # fmt: skip

LONGEST = 31  # characters that every linker keeps apart


def checked_identifier(name: object) -> str:
    """A name for functions and files.

    Raises
    ------
    InvalidInput
        If it is no identifier of C, is reserved, or is too long.
    """
    good = isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) is not None
    if not good or str(name).lower() in RESERVED or len(str(name)) > LONGEST:
        raise InvalidInput(
            "This is no name for C.",
            f"expected a letter, then up to {LONGEST - 1} letters, digits and underscores, no word of C and no "
            f"header of its library, got {value_text(name)}",
            f"{identifier_of(name) if isinstance(name, str) else 'my_arm'}",
        )
    return str(name)


def identifier_of(text: str) -> str:
    """A name for C that looks like the text."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_").lower()[:LONGEST] or "controller"
    if not name[0].isalpha() or name in RESERVED:
        name = f"arm_{name}"[:LONGEST]
    return name


def constants(prefix: str, names: Sequence[str]) -> list[str]:
    """Names of constants for signals, each once: ``ARM_Y_LINK_POSITION``."""
    found: list[str] = []
    for k, name in enumerate(names):
        plain = re.sub(r"[^A-Z0-9]+", "_", name.upper()).strip("_")
        full = f"{prefix}_{plain}" if plain else f"{prefix}_{k}"
        found.append(full if full not in found else f"{full}_{k}")
    return found


#: How characters of units and names are written in ASCII.
ASCII = str.maketrans({"·": " ", "²": "^2", "³": "^3", "Ω": "Ohm", "°": "deg", "µ": "u", "−": "-"})


def comment(text: str) -> str:
    """A text as it may stand in a comment of one line: printable ASCII that neither ends it nor goes on behind it."""
    plain = "".join(c if " " <= c <= "~" else "?" for c in text.translate(ASCII))
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/").replace("??", "? ?")
