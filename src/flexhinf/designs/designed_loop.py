"""What a law does in its loop, whatever it is."""

from __future__ import annotations

from typing import Protocol, Unpack

from flexhinf.analysis import LinearLoop
from flexhinf.arrays import Numbers
from flexhinf.certify import Certificate
from flexhinf.designs.workspace.proof import WorkspaceProof
from flexhinf.loop import Controller, ControllerOptions, Trajectory


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
