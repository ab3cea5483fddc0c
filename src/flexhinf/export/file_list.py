"""Files of an export as rows of a list: path, template, and what the template needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Generic, TypeVar

from flexhinf.codegen.c import Real
from flexhinf.export.rendering import render_c, render_text

NOTHING: Mapping[str, object] = MappingProxyType({})

#: What an export is made of; a row for less is one for more, too.
Exported = TypeVar("Exported", contravariant=True)
Whole = TypeVar("Whole")


@dataclass(frozen=True)
class File(Generic[Exported]):
    """A file of an export: its path, itself a template; its template; and what that needs beside what all have.

    `template`: One of `export/templates` by its name, or any other file, as a `Path`. `condition`: Whether an export
    has it. `copies`: Folders that have the same text.
    """

    path: str
    template: str | Path
    values: Callable[[Exported], Mapping[str, object]] = lambda export: NOTHING
    condition: Callable[[Exported], bool] = lambda export: True
    copies: tuple[str, ...] = ()

    def within(self, part: Callable[[Whole], Exported], copies: tuple[str, ...] = ()) -> File[Whole]:
        """The same file in an export that has this one's as a part. `copies`: Folders of it with the same text."""
        return File[Whole](
            self.path,
            self.template,
            lambda whole: self.values(part(whole)),
            lambda whole: self.condition(part(whole)),
            copies,
        )


def rendered(
    files: Sequence[File[Exported]], export: Exported, name: str, real: Real, /, **shared: object
) -> dict[str, str]:
    """The files that an export has: path to text. `shared`: What their paths and templates may use."""
    texts = dict[str, str]()
    for file in files:
        if file.condition(export):
            path = render_text(file.path, name=name, **shared)
            template = str(file.template.absolute()) if isinstance(file.template, Path) else file.template
            texts[path] = render_c(template, name, real, **{**shared, **file.values(export)})
            texts |= {f"{folder}/{path}": texts[path] for folder in file.copies}
    return texts
