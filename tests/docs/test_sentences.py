"""Sentences of the README, of docs/*.md and of the help are short enough to be read aloud; README.md has 600 words."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from flexhinf.cli.commands import app

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]

#: Words of the longest sentence.
LONGEST = 40

_NO_SENTENCE = re.compile(r"^```.*?^```$|<!--.*?-->|^#.*?$|^\|.*?$|^ {4,}.*?$", re.DOTALL | re.MULTILINE)
_ITEM = re.compile(r"^\s*(?:[-*]|\d+\.) ")


def sentences(text: str) -> list[str]:
    """Sentences of a page, without code, tables and headings; a formula or a name in code counts as one word."""
    found, paragraph = [], ""
    for line in [*_NO_SENTENCE.sub("", text).splitlines(), ""]:
        if not line.strip() or _ITEM.match(line):
            found.append(paragraph)
            paragraph = ""
        paragraph += " " + _ITEM.sub("", line).strip()
    found.append(paragraph)
    plain = [re.sub(r"`[^`]*`", "X", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", each)) for each in found]
    return [part for each in plain for part in re.split(r"(?<=[.!?:])\*{0,2}\s+", each.strip()) if part]


def test_what_counts_as_a_sentence() -> None:
    text = "# A head\n\nOne two three. Four\nfive:\n\n- six\n- `seven eight` nine [ten](eleven)\n\n"
    text += "| a | b |\n```sh\nx y\n```\n"
    assert sentences(text) == ["One two three.", "Four five:", "six", "X nine ten"]


def longest(text: str) -> str:
    return max(sentences(text), key=lambda each: len(each.split()), default="")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_no_sentence_is_longer_than_forty_words(page: Path) -> None:
    found = longest(page.read_text(encoding="utf-8"))
    assert len(found.split()) <= LONGEST, found


def test_the_readme_is_read_in_three_minutes() -> None:
    assert len(PAGES[0].read_text(encoding="utf-8").split()) <= 600


def test_help_is_short() -> None:
    """An option's first sentence, which --help shows alone, is one line or two of 100 columns."""
    from typer.main import get_command

    def commands(group: object) -> list[object]:
        inner = getattr(group, "commands", None)
        return [group] if inner is None else [each for one in inner.values() for each in commands(one)]

    for command in commands(get_command(app)):
        for parameter in command.params:  # type: ignore[attr-defined]
            if parameter.param_type_name == "option" and not parameter.hidden:
                found = re.split(r"(?<=\.) (?=[A-Z])", str(parameter.help))[0]
                assert len(found.split()) <= 35, (command.name, found)  # type: ignore[attr-defined]
