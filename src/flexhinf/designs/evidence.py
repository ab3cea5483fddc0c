"""Evidence of a design: its law in the loop, and what it was judged by, whatever the law is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, Unpack

from flexhinf.analysis import LinearLoop
from flexhinf.arrays import Numbers
from flexhinf.certify import Certificate
from flexhinf.designs.about_pose import pose_evidence
from flexhinf.designs.fields import law_of
from flexhinf.designs.loop_setup import LoopPlants
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.responses import Move
from flexhinf.designs.specification import Specification
from flexhinf.designs.workspace.design import Meanwhile, design_workspace
from flexhinf.designs.workspace.proof import WorkspaceProof
from flexhinf.designs.workspace.rivals import Gains
from flexhinf.loop import Controller, ControllerOptions, Trajectory
from flexhinf.robot import Robot


class DesignedLoop(Protocol):
    """What a law does in its loop at the poses of its task; `Design` has the same names, and says what they are."""

    @property
    def length(self) -> float:
        """Of the step that the design was judged by, s; 0 of moves, each of which has its own."""
        ...

    @property
    def has_controller(self) -> bool:
        """Whether one controller serves every pose of the task; else `controller` is refused."""
        ...

    def controller(self, at: Numbers = None, **options: Unpack[ControllerOptions]) -> Controller:
        """See `Design.controller`."""
        ...

    def linear(self, at: Numbers = None) -> LinearLoop:
        """See `Design.linear`."""
        ...

    def step(self, goal: Numbers = None, start: Numbers = None, duration: float | None = None) -> Trajectory:
        """See `Design.step`."""
        ...

    def move(self, goal: Numbers = None, start: Numbers = None) -> Trajectory:
        """See `Design.move`."""
        ...

    def certificate(self) -> Certificate | WorkspaceProof:
        """See `Design.certificate`."""
        ...


class DesignEvidence(Protocol):
    """What a design was judged by: `PoseEvidence`, `WorkspaceEvidence`, or a `StoredReport`."""

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


class JudgedRuns(DesignEvidence, Protocol):
    """What a design was judged by in this process, with its runs."""

    @property
    def setup(self) -> LoopPlants:
        """Robot, sensors, limits and latency of every run."""
        ...

    @property
    def moves(self) -> tuple[Move, ...]:
        """Of the nominal robot: every move, or the motion of the task."""
        ...

    @property
    def sampled(self) -> tuple[Move, ...]:
        """The same of robots within their tolerances, of those whose runs are kept."""
        ...

    @property
    def bandwidth(self) -> float | None:
        """Of which the law is made, the largest of all joints, rad/s; None of a law without one."""
        ...

    @property
    def numbers(self) -> Gains:
        """Of which the gains are made, by name."""
        ...

    @property
    def missed(self) -> tuple[Requirement, ...]:
        """Requirements that are not met."""
        ...

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        ...


def evidence_of(
    robot: Robot,
    s: Specification,
    progress: Callable[[str], None],
    meanwhile: Meanwhile | None = None,
    numbers: Gains | None = None,
) -> JudgedRuns:
    """Make the law of a checked specification, and judge it.

    `meanwhile`: as of `design_workspace`; without it nothing is computed that decides nothing. `numbers`: those that
    the user states for the law, which is then not tuned.
    """
    if not law_of(s).any_pose:
        return pose_evidence(robot, s, progress)
    return design_workspace(
        robot, s, progress, meanwhile=meanwhile, undamped=meanwhile is not None, numbers=numbers
    )
