"""How results and what a user states look in a terminal and in a notebook: one line, and a small table."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping, Sequence
from html import escape
from typing import ClassVar, cast

from flexhinf.drawers import Drawer
from flexhinf.numerals import stated_number
from flexhinf.validation import is_array

#: The longest array whose numbers stand in a text.
LONGEST_ARRAY = 12


class Summarised(abc.ABC):
    """Base of public results: `summary` is written once, ``__repr__`` and ``_repr_html_`` follow from it.

    A dataclass that derives from it needs ``@dataclass(repr=False)``, because the generated ``__repr__`` would print
    every array.
    """

    @abc.abstractmethod
    def summary(self) -> Mapping[str, str]:
        """The main facts in words, {name: text with unit}, in the order in which they are shown."""

    def __repr__(self) -> str:
        facts = ", ".join(f"{name}: {text}" for name, text in self.summary().items())
        return f"<{type(self).__name__}: {facts}>"

    def _repr_html_(self) -> str:
        return table_html(type(self).__name__, self.summary())


#: Pictures of a result as HTML.
PICTURES: Drawer[[], str] = Drawer("")


class Pictured(Summarised):
    """Base of results that show pictures in a notebook too, below their table."""

    def _repr_html_(self) -> str:
        return super()._repr_html_() + PICTURES(self)


class StatedRepr:
    """Base of dataclasses that a user writes: their text has the fields that are not as by default.

    Numbers have ten digits; longer arrays are their shape. It needs ``@dataclass(repr=False)``.
    """

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[object]]]

    def __repr__(self) -> str:
        stated: list[str] = []
        for field in dataclasses.fields(self):
            text = stated_text(getattr(self, field.name))
            make = field.default_factory
            default = field.default if make is dataclasses.MISSING else make()
            if field.repr and (default is dataclasses.MISSING or text != stated_text(default)):
                stated.append(f"{field.name}={text}")
        return f"{type(self).__name__}({', '.join(stated)})"


def stated_text(value: object) -> str:
    """A value as it is written in Python, numbers in ten digits."""
    if is_array(value):
        numbers = value.dtype.kind in "fiu" and value.size <= LONGEST_ARRAY
        return stated_text(value.tolist()) if numbers else f"<array of {' × '.join(map(str, value.shape))}>"
    if isinstance(value, float):
        return stated_number(value)
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(
                f"{key!r}: {stated_text(each)}" for key, each in cast("dict[object, object]", value).items()
            )
            + "}"
        )
    if type(value) is list:
        return f"[{', '.join(map(stated_text, cast('list[object]', value)))}]"
    if type(value) is tuple:
        entries = cast("tuple[object, ...]", value)
        return f"({', '.join(map(stated_text, entries))}{',' * (len(entries) == 1)})"
    return getattr(value, "__qualname__", None) or repr(value)


def table_html(title: str, facts: Mapping[str, str]) -> str:
    """Facts as an HTML table with two columns; names and texts are escaped.

    Parameters
    ----------
    title : str
        Caption of the table.
    """
    rows = "".join(
        f'<tr><th style="text-align: left">{escape(name)}</th>'
        f'<td style="text-align: left">{escape(text)}</td></tr>'
        for name, text in facts.items()
    )
    caption = f'<caption style="text-align: left"><b>{escape(title)}</b></caption>'
    return f"<table>{caption}<tbody>{rows}</tbody></table>"


def names_text(names: Sequence[str], most: int = 6) -> str:
    """How many names there are and which; beyond `most`, the first ones and dots."""
    text = ", ".join(names[:most]) + (", …" if len(names) > most else "")
    return f"{len(names)} ({text})" if names else "none"
