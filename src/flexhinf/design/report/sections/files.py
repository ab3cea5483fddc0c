"""The files beside a page: numbers, the controller, the runs, and how to read them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath

from flexhinf.report import Section, Table

__all__ = ["files_section"]

#: What a file is, by its name or its ending; the first that fits.
MEANING = (
    ("design.toml", "the request and its result; `flexhinf design design.toml` makes the design again"),
    ("design.json", "every number of this page"),
    ("comparison.json", "every number of this page"),
    ("controller.json", "the controller: `flexhinf.load_controller`"),
    ("controller", "the controller: `flexhinf.load_controller`"),
    (".csv", "one run, one column for each signal, SI units, time in s"),
    (".nc", "one run as NetCDF: `xarray.open_dataset`, units as attributes"),
)


def files_section(files: Sequence[str]) -> Section:
    """One row for each file."""
    rows = [(f"`{name}`", _meaning(name)) for name in sorted(files)]
    return Section("Files beside this page", (Table(("file", "content"), rows, stacks=True),), "files")


def _meaning(name: str) -> str:
    for key, text in MEANING:
        if name == key or PurePath(name).suffix == key or PurePath(name).stem == key:
            return text
    return ""
