"""Evidence of a design: its law in the loop, and what it was judged by, whatever the law is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from flexhinf.designs.designed_loop import DesignedLoop
from flexhinf.designs.fields import law_of
from flexhinf.designs.laws import NL_HINF
from flexhinf.designs.pose_evidence import pose_evidence
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.specification import Specification
from flexhinf.designs.workspace.design import Meanwhile, design_workspace
from flexhinf.designs.workspace.evidence import WorkspaceEvidence
from flexhinf.designs.workspace.rivals import Gains
from flexhinf.robot import Robot

#: Of laws with a synthesis of their own, how they are made and judged.
SEARCHES: Mapping[str, Callable[[Robot, Specification, Callable[[str], None]], WorkspaceEvidence]] = {
    NL_HINF: pose_evidence
}


class DesignEvidence(Protocol):
    """What a design was judged by: `WorkspaceEvidence`, or a `StoredReport`."""

    @property
    def robot(self) -> Robot:
        """Of the design."""
        ...

    @property
    def specification(self) -> Specification:
        """Of the design."""
        ...

    @property
    def requirements(self) -> tuple[Requirement, ...]:
        """All of them, judged."""
        ...

    @property
    def loop(self) -> DesignedLoop:
        """In which the law runs."""
        ...

    def summary(self) -> Mapping[str, str]:
        """The main facts in words, {name: text with unit}."""
        ...


def evidence_of(
    robot: Robot,
    s: Specification,
    progress: Callable[[str], None],
    meanwhile: Meanwhile | None = None,
    numbers: Gains | None = None,
) -> WorkspaceEvidence:
    """Make the law of a checked specification, and judge it.

    `meanwhile`: as of `design_workspace`; without it nothing is computed that decides nothing. `numbers`: those that
    the user states for the law, which is then not tuned.
    """
    if (own := SEARCHES.get(law_of(s).name)) is not None:
        return own(robot, s, progress)
    return design_workspace(
        robot, s, progress, meanwhile=meanwhile, undamped=meanwhile is not None, numbers=numbers
    )
