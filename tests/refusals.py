"""Refusals and texts compared by what they name - arguments, options, files, numbers - and not by their sentences."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from flexhinf.errors import FlexhinfError

#: What a text names: a word, a name, a quotation as it stands, or a number with whatever digits it is written.
Anchor = str | float

#: A number that stands alone: the 2 of `joint2` and of `x_2` is none.
_NUMBER = re.compile(r"(?<![\w.])[-+−]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?(?![\w]*[a-zA-Z_]\d)", re.IGNORECASE)


def unnamed(text: str, *anchors: Anchor) -> list[Anchor]:
    """Those of the anchors that the text does not name.

    Words are whole ones, in capitals or not; 0.5 is named by `0.5`, `0.50` and `5e-1`, and not by `10.5`.
    """
    numbers = [float(token.replace("−", "-")) for token in _NUMBER.findall(text)]
    return [
        anchor
        for anchor in anchors
        if not (anchor in numbers if isinstance(anchor, (int, float)) else _stands(anchor.strip(), text))
    ]


def _stands(words: str, text: str) -> bool:
    """Whether the words stand in the text, whatever the spaces between them, and not inside longer words."""
    before = r"(?<![\d.])" if words[:1].isdigit() else r"(?<!\w)" if words[:1].isalpha() else ""
    after = r"(?!\.?\d)" if words[-1:].isdigit() else r"(?!\w)" if words[-1:].isalpha() else ""
    spaced = r"\s+".join(map(re.escape, words.split()))
    return re.search(before + spaced + after, text, re.IGNORECASE) is not None


@contextmanager
def refused_with(kind: type[Exception], *anchors: Anchor) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """A block that must raise this class; the message names all anchors, and flexhinf's own has its three parts."""
    with pytest.raises(kind) as caught:
        yield caught
    error = caught.value
    assert unnamed(str(error), *anchors) == [], str(error)
    if isinstance(error, FlexhinfError):
        assert error.what, str(error)
        assert error.found, str(error)
        assert error.advice, str(error)
