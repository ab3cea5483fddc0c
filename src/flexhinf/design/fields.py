"""A field of a specification as people read it: help, unit, range, example, and its option at the command line."""

from __future__ import annotations

import dataclasses
from typing import Any, get_args

from flexhinf.design.units import Allowed


@dataclasses.dataclass(frozen=True)
class About:
    """What people read about a field.

    Attributes
    ----------
    group : str
        Heading of its option in the help.
    example : str
        As on the command line; the same text is understood in Python and in a design file.
    options : tuple of str
        Names of its option; by default the field's name with hyphens.
    zero : str
        What 0 stands for at the command line, where it is not a number of the range.
    default : str
        What is chosen where the default is None.
    """

    group: str
    help: str
    example: str
    unit: str = ""
    options: tuple[str, ...] = ()
    zero: str = ""
    default: str = ""


@dataclasses.dataclass(frozen=True)
class FieldInfo:
    """One field, as the command line, the design file and the docs see it.

    Attributes
    ----------
    allowed : str
        Its range in words.
    options : tuple of str
        Names of its option; for a flag one text with both.
    """

    name: str
    about: About
    allowed: str
    default: Any
    options: tuple[str, ...]


def info_of(field: dataclasses.Field, annotation: Any) -> FieldInfo:
    """What is declared in the annotation of a field: its `About`, and the first range in words of its type."""
    about = next(part for part in annotation.__metadata__ if isinstance(part, About))
    options = about.options or (f"--{field.name.replace('_', '-')}",)
    return FieldInfo(field.name, about, _allowed(annotation), field.default, options)


def _allowed(annotation: Any) -> str:
    """The first range in words that stands in a type."""
    for part in getattr(annotation, "__metadata__", ()):
        if isinstance(part, Allowed):
            return part.words
    return next((words for part in get_args(annotation) if (words := _allowed(part))), "")
