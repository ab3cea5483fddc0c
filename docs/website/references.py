"""The page of references, from docs/references.bib."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path

from sphinx.application import Sphinx

_ENTRY = re.compile(r"^@(\w+)\{(\w+),\n(.*?)^\}", re.DOTALL | re.MULTILINE)
_DEEP = r"\{(?:[^{}]|\{(?:[^{}]|\{[^{}]*\})*\})*\}"
_FIELD = re.compile(rf"(\w+)\s*=\s*({_DEEP}|\w+)")
_MARKS = {
    r"\'": "\u0301",
    r"\`": "\u0300",
    r"\"": "\u0308",
    r"\^": "\u0302",
    r"\~": "\u0303",
    r"\v": "\u030c",
}
_ACCENT = re.compile(r"\{?\\(['`\"^~v])\s*\{?\\?(\w)\}?\}?")


def plain(text: str) -> str:
    """A value of BibTeX as text."""
    text = _ACCENT.sub(lambda match: match[2] + _MARKS[f"\\{match[1]}"], text)
    text = (
        text.replace(r"{\AA}", "Å")
        .replace(r"{\o}", "ø")
        .replace(r"$\mathcal{H}_\infty$", "H∞")
        .replace("_\\infty", "∞")
    )
    text = text.replace("$", "").replace(r"\texttt", "").replace(r"\&", "&")
    text = re.sub(r"\\url\b|[{}]", "", text).replace("--", "–").replace("~", " ")
    return unicodedata.normalize("NFC", " ".join(text.split()))


def entries(bibliography: Path) -> dict[str, dict[str, str]]:
    """Fields of every entry, by key."""
    text = bibliography.read_text(encoding="utf-8")
    return {
        key: {"kind": kind, **{name: plain(value) for name, value in _FIELD.findall(body)}}
        for kind, key, body in _ENTRY.findall(text)
    }


def people(authors: str) -> str:
    """Names in the order of a sentence."""
    names = [
        " ".join(reversed([part.strip() for part in name.split(",", 1)])) for name in authors.split(" and ")
    ]
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def line(fields: dict[str, str]) -> str:
    """One entry as a sentence of Markdown."""
    where = fields.get("journal") or fields.get("booktitle") or ""
    volume = fields.get("volume", "") + (f"({fields['number']})" if "number" in fields else "")
    pages = f"pp. {fields['pages']}" if "pages" in fields else ""
    parts = [
        people(fields.get("author") or fields.get("editor", "")),
        f"*{fields['title']}*",
        " ".join(filter(None, (where, volume))),
        *(fields.get(name, "") for name in ("publisher", "institution", "school", "howpublished", "note")),
        pages,
        fields.get("year", ""),
    ]
    return ", ".join(part.strip().rstrip(".") for part in parts if part.strip()) + "."


def text(bibliography: Path) -> str:
    """An entry a paragraph, each with its key as anchor, in the order of the keys."""
    found = sorted(entries(bibliography).items())
    return "\n".join(f"({key})=\n**[{key}]** {line(fields)}\n" for key, fields in found)


def read_source(app: Sphinx, name: str, source: list[str]) -> None:
    """Handler of ``source-read``."""
    if name == "references":
        source[0] += "\n" + text(Path(app.srcdir) / "references.bib")


def setup(app: Sphinx) -> None:
    """Register all of this file."""
    app.connect("source-read", read_source)
