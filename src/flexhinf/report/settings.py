"""What a reader needs to make a report again: every setting with its source, versions, seed, command."""

from __future__ import annotations

import platform
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata

from flexhinf.report.text import escape, prose, scalar


@dataclass(frozen=True)
class Setting:
    """One number or choice that had a part in the result.

    Parameters
    ----------
    value : object
        Text, a number, yes or no, None, or a list of these.
    source : str, optional
        Who says so: ``Table 1``, ``ours``, ``option --period``.
    """

    name: str
    value: object
    unit: str = ""
    source: str = ""


@dataclass(frozen=True)
class Settings:
    """Settings in named groups, in the order given; folded on the page, open on paper."""

    groups: Mapping[str, Sequence[Setting]]

    def html(self) -> str:
        """One folded table per group inside one folded part."""
        count = sum(len(group) for group in self.groups.values())
        parts = "".join(
            f'<div class="table"><table class="settings"><caption>{prose(name)}</caption>'
            '<thead><tr><th scope="col">Setting</th><th scope="col">Value</th>'
            '<th scope="col">From</th></tr></thead>'
            f"<tbody>{''.join(_row(setting) for setting in group)}</tbody></table></div>"
            for name, group in self.groups.items()
        )
        return f"<details><summary>Every assumption and setting ({count})</summary>{parts}</details>"

    def ids(self) -> tuple[str, ...]:
        """No anchors."""
        return ()


@dataclass(frozen=True)
class Provenance:
    """Where a report comes from.

    Parameters
    ----------
    command : sequence of str
        The words of the command that makes the report again; none for a report written from Python.
    seed : int or None
        None where nothing was drawn.
    versions : mapping of str to str
        Name and version of what had a part, as `versions` finds them.
    """

    command: Sequence[str]
    seed: int | None
    versions: Mapping[str, str] = field(default_factory=lambda: versions())

    def html(self) -> str:
        """The command as a listing, then seed and versions."""
        listed = ", ".join(f"{escape(name)} {escape(version)}" for name, version in self.versions.items())
        seed = "nothing was drawn at random" if self.seed is None else f"seed {self.seed}"
        again = (
            "<p>This command makes the report again:</p>"
            f'<pre class="command"><code>{escape(shlex.join(self.command))}</code></pre>'
        )
        if not self.command:
            again = "<p>Written from Python with the settings above.</p>"
        return f'{again}<p class="versions">Random numbers: {seed}. Versions: {listed}.</p>'

    def ids(self) -> tuple[str, ...]:
        """No anchors."""
        return ()


def versions(distribution: str = "flexhinf") -> dict[str, str]:
    """Versions of a distribution, of what it requires, of Python, and the kind of machine."""
    names = [distribution]
    for line in metadata.requires(distribution) or ():
        requirement, _, marker = line.partition(";")
        if "extra" not in marker:
            names.append(re.split(r"[^A-Za-z0-9._-]", requirement.strip(), maxsplit=1)[0])
    found = {name: metadata.version(name) for name in names}
    return {**found, "Python": platform.python_version(), "on": f"{platform.system()} {platform.machine()}"}


def _row(setting: Setting) -> str:
    unit = f' <span class="unit">{escape(setting.unit)}</span>' if setting.unit else ""
    return (
        f'<tr><th scope="row">{prose(setting.name)}</th>'
        f"<td>{prose(scalar(setting.value))}{unit}</td><td>{prose(setting.source)}</td></tr>"
    )
