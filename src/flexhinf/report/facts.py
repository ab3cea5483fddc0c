"""Facts, each a number with its name and unit; in groups they are the settings of a result, beside its provenance."""

from __future__ import annotations

import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import metadata

from flexhinf import __version__
from flexhinf.numerals import short_numbers
from flexhinf.report.blocks import PageBlock, prose, scalar, unit_html


@dataclass(frozen=True)
class Fact:
    """One number or choice (text, a number, yes or no, None, or a list of these) with its name and unit.

    `note`: a sentence beside it, such as its interval, the joint that has it, or who states it: ``Table 1``, ``ours``.
    """

    name: str
    value: object
    unit: str = ""
    note: str = ""

    @property
    def text(self) -> str:
        """Name, value and unit in a line, as a terminal has them."""
        space = "" if self.unit.startswith("°") else " "
        return f"{self.name} {scalar(self.value)}{space}{self.unit}".rstrip()


@dataclass(frozen=True)
class Settings(PageBlock):
    """Settings in named groups, in the order given."""

    groups: Mapping[str, Sequence[Fact]]

    @property
    def noted(self) -> bool:
        """Whether any says where it is from."""
        return any(row.note for group in self.groups.values() for row in group)

    def html(self) -> str:
        """The settings as HTML: a table for each group."""
        parts, noted = "", self.noted
        last = '<th scope="col">From</th>' * noted
        for name, group in self.groups.items():
            rows = ""
            for row in group:
                value, note = (prose(short_numbers(text)) for text in (scalar(row.value), row.note))
                rows += (
                    f'<tr><th scope="row">{prose(row.name)}</th><td>{value}{unit_html(row.unit)}</td>'
                    f"{f'<td>{note}</td>' * noted}</tr>"
                )
            parts += (
                f'<div class="table"><table class="settings"><caption>{prose(name)}</caption><thead><tr>'
                f'<th scope="col">Setting</th><th scope="col">Value</th>{last}</tr></thead>'
                f"<tbody>{rows}</tbody></table></div>"
            )
        return parts


@dataclass(frozen=True)
class Provenance(PageBlock):
    """Origin of a report: the command that makes it again ("" for a report written from Python),
    the seed (None where nothing was drawn), and name and version of what had a part, as `versions` finds them."""

    command: str
    seed: int | None
    versions: Mapping[str, str] = field(default_factory=lambda: versions())

    def html(self) -> str:
        """The command as a listing, then seed and versions."""
        listed = ", ".join(f"{escape(name)} {escape(version)}" for name, version in self.versions.items())
        seed = "nothing was drawn at random" if self.seed is None else f"seed {self.seed}"
        again = "<p>Written from Python with the settings above.</p>"
        if self.command:
            command = f'<pre class="command"><code>{escape(self.command)}</code></pre>'
            again = f"<p>This command makes the report again:</p>{command}"
        return f'{again}<p class="versions">Random numbers: {seed}. Versions: {listed}.</p>'


def versions() -> dict[str, str]:
    """Versions of the flexhinf that runs, of the packages that it requires, of Python, and the kind of machine."""
    required = (r for r in metadata.requires("flexhinf") or () if "extra" not in r.partition(";")[2])
    names = (re.split(r"[^A-Za-z0-9._-]", line.strip(), maxsplit=1)[0] for line in required)
    return {
        "flexhinf": __version__,
        **{name: metadata.version(name) for name in names},
        "Python": platform.python_version(),
        "on": f"{platform.system()} {platform.machine()}",
    }
