"""What the reader of a report must not miss: a sentence, and the section it stands in."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from flexhinf.report import Note

__all__ = ["Remark", "notes_of"]

_OPTION = re.compile(r"(?<!`)(--[a-z]+(?:-[a-z]+)*)(?!`)")


@dataclass(frozen=True)
class Remark:
    """A note of one section.

    Attributes
    ----------
    section : str
        Anchor of the section.
    about : str
        In a few words.
    text : str
        Whole sentences; options of the command line between backticks.
    """

    section: str
    about: str
    text: str

    @property
    def plain(self) -> str:
        """Without backticks, for a terminal."""
        return self.text.replace("`", "")


def notes_of(remarks: Iterable[Remark]) -> list[Note]:
    """As blocks of a page, options set as code."""
    return [Note(_OPTION.sub(r"`\g<1>`", remark.text)) for remark in remarks]
