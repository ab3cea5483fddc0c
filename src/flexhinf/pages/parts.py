"""What the report of a design needs of its evidence, whatever that is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from flexhinf.designs.advice import Advice
from flexhinf.designs.request import DesignRequest
from flexhinf.designs.responses import Response
from flexhinf.drawers import Drawer
from flexhinf.loop import Trajectory
from flexhinf.pages.terminal import Ending
from flexhinf.report import Figure, Page

if TYPE_CHECKING:
    from rich.table import Table as Terminal

    from flexhinf.pages.workspace import Pictures


#: Runs are NetCDF files: a fifth of the size of text, with units.
ENDING = "nc"


def run_file(name: str) -> str:
    """The file of a run in the folder of a report."""
    return f"runs/{name}.{ENDING}"


class DesignParts(Protocol):
    """Page, numbers and texts of a design."""

    @property
    def read(self) -> DesignRequest | None:
        """The request of a design that was read from a folder; None for one that was made here."""
        ...

    @property
    def runs(self) -> Mapping[str, Trajectory]:
        """Those that are kept, by name."""
        ...

    def files(self) -> Mapping[str, str | bytes]:
        """Contents of what is read or proved, by names of files."""
        ...

    def page(
        self,
        command: Sequence[str],
        warnings: Sequence[str],
        advice: Advice | None,
        pictures: Callable[[], Pictures] | None,
    ) -> Page:
        """The page without the list of its files; arguments as of `design_files`, and figures drawn before."""
        ...

    def figures(self) -> Sequence[Figure]:
        """What a notebook shows of the design, and the page first."""
        ...

    def verdict(self) -> str:
        """Whether the requirements are met and by what, in sentences."""
        ...

    def notes(self) -> Sequence[str]:
        """What the reader must know, in sentences."""
        ...

    def tables(self) -> list[Terminal]:
        """Every table, for a terminal."""
        ...

    def ending(self, advice: Advice | None) -> Ending:
        """What a terminal says at the end."""
        ...

    def result(self) -> Mapping[str, object]:
        """The table [result] of a design file, without the requirements."""
        ...

    def loops(self) -> list[dict[str, Any]]:
        """Rows of `loops` in design.json."""
        ...

    def run_rows(self) -> list[dict[str, Any]]:
        """Rows of `runs` in design.json."""
        ...

    def facts(self) -> dict[str, Any]:
        """What the law knows of itself, for design.json."""
        ...


class Run(NamedTuple):
    """A row of `runs` in design.json."""

    name: str
    file: str | None
    robot: str
    start: object
    goal: object
    duration_s: float
    diverged_at_s: float | None
    joints: Sequence[Mapping[str, Any]]

    @staticmethod
    def of(
        name: str, robot: str, response: Response, joints: Sequence[Mapping[str, Any]], kept: bool = True
    ) -> Run:
        """The row of a run, with the numbers of its joints; `kept`: whether the report has its file."""
        file, length = run_file(name) if kept else None, float(response.run.time[-1])
        return Run(name, file, robot, response.start, response.goal, length, response.diverged_at, joints)


class Loop(NamedTuple):
    """A row of `loops` in design.json."""

    pose: object
    robot: str
    stable: bool
    damping: float
    numbers: Mapping[str, Any]


#: What the report of a design needs of each type of evidence.
PARTS: Drawer[[], DesignParts] = Drawer()
