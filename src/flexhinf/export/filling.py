"""Templates of exported files, and what stands for their marks ``@MARK@``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np

from flexhinf.codegen.c import Real, constant

_MARK = re.compile(r"@([A-Z][A-Z0-9_]*)@")


def template(name: str) -> str:
    """A text with marks ``@MARK@``."""
    return (files("flexhinf.export") / "templates" / name).read_text(encoding="utf-8")


def arithmetic(name: str, real: Real) -> str:
    """C code against flags that change results: guards, and ``int NAME_exact(void)`` for flags without a macro."""
    about = np.finfo(np.float64 if real.name == "double" else np.float32)
    return fill(
        template("arithmetic.c"), name, real, BYTES=real.bytes, F=real.suffix, SUFFIX=real.suffix.upper(),
        EPSILON=constant(float(about.eps), real), SMALLEST=constant(float(about.tiny), real),
        LARGEST=constant(float(about.max), real),
    )  # fmt: skip


def fill(
    text: str, name: str, real: Real, users: Mapping[str, str] = MappingProxyType({}), **marks: Any
) -> str:
    """A template with ``@NAME@`` for the name, ``@BIG@`` for the same in capitals, ``@REAL@`` and other marks.

    `users`: What stands for the marks of these names holds texts of users, such as names of joints. It enters last and
    at once: what looks like a mark in it is none.
    """
    for mark, value in {**marks, "NAME": name, "BIG": name.upper(), "REAL": real.name}.items():
        text = text.replace(f"@{mark}@", str(value))
    return at_once(text, users)


def at_once(text: str, marks: Mapping[str, str]) -> str:
    """A text in which what stands for one mark is not read for others; a mark without a text stays."""
    return _MARK.sub(lambda found: marks.get(found[1], found[0]), text)
