"""What a controller for a workspace was judged by: its loops at poses, its moves, what it tolerates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis import LinearLoop
from flexhinf.arrays import Numbers
from flexhinf.design.judged import Judged
from flexhinf.design.loop_setup import deployed
from flexhinf.design.requirements import REQUIREMENTS, Requirement
from flexhinf.design.responses import Move, Response
from flexhinf.design.specification import Specification
from flexhinf.design.workspace.proof import WorkspaceProof, prove_workspace
from flexhinf.design.workspace.robustness import Cause, PairResults, Robustness, remaining_cause, robustness
from flexhinf.design.workspace.samples import goals_of
from flexhinf.design.workspace.setup import CornerLoop, PoseLoop, WorkspaceSetup
from flexhinf.errors import refuse_if
from flexhinf.loop import Controller, Trajectory
from flexhinf.notebook import Summarised
from flexhinf.robot import Robot
from flexhinf.robot.poses import checked_pose

#: Length of a step, s.
STEP = 2.0


@dataclass(frozen=True, eq=False, repr=False)
class LoopOverWorkspace:
    """A `DesignedLoop` at all poses."""

    setup: WorkspaceSetup
    length = 0.0  # a move has its own

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: robot: {self.setup.robot.name}>"

    def _pose(self, at: Numbers) -> np.ndarray:
        robot = self.setup.robot
        return checked_pose(at, np.asarray(self.setup.workspace.home), robot.links, robot.name)

    def controller(self, at: Numbers = None, **options: Any) -> Controller:
        """It follows references that come with states and inputs, such as `Moving`; the same one serves every pose. By
        default ``offset_time`` is `OFFSET_TIME`, ``supervision`` that of the setup, which brakes along the path, and
        ``protection`` that of the robot, see `flexhinf.export.protected`."""
        own: dict[str, Any] = {"supervision": self.setup.supervision, **options}
        made = self.setup.controller(self._pose(at), **own)
        return deployed(made, self.setup.robot, self.setup.specification, options)

    def linear(self, at: Numbers = None) -> LinearLoop:
        """At rest at a pose."""
        return self.setup.linear(self._pose(at))

    def step(self, goal: Numbers = None, start: Numbers = None, duration: float | None = None) -> Trajectory:
        """Of the nominal robot, with the noise of its sensors and its dry friction. It asks for more than a robot can
        do at once; `move` is what the design is judged by."""
        setup, begin = self.setup, self._pose(start)
        robot, controller = setup.true.robot, self.controller(begin)
        end = np.concatenate(robot.operating_point(self._pose(goal)))
        return setup.loop(controller).run(
            dict(zip(controller.commanded, end.tolist())),
            noise=setup.noise,
            duration=STEP if duration is None else duration,
            initial_state=robot.operating_point(begin, setup.extras)[0],
            seed=setup.specification.seed,
        )

    def move(self, goal: Numbers = None, start: Numbers = None) -> Trajectory:
        """A quintic at half the speed limits."""
        return self.setup.move(np.array([self._pose(start), self._pose(goal)])).response.run

    def certificate(self) -> WorkspaceProof:
        """The errors of the model that small motions about rest are proved to tolerate, at every pose."""
        proof = prove_workspace(self.setup)
        refuse_if(
            not proof.is_proved,
            "Nothing is proved of this design.",
            "expected pairs of a link and a motor that are proved stable, got none",
            "encoders on both sides of the springs, or a smaller bandwidth",
        )
        return proof


@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceEvidence(Judged, Summarised):
    """Loops at poses and moves of one controller for a workspace, and the judgement of both.

    Poses, moves and robots are random samples by the seed of the specification: nothing is proved between them.
    """

    setup: WorkspaceSetup  # law, estimator and controller at any pose
    poses: np.ndarray  # (N, n), link positions, rad or m
    loops: tuple[PoseLoop, ...]  # linearised and sampled, at rest at each pose
    corner_loops: tuple[CornerLoop, ...]  # of robots at corners of their tolerances; none without tolerances
    # the loops of both, whose springs nothing damps: they decide nothing
    undamped: tuple[tuple[CornerLoop, ...], tuple[CornerLoop, ...]]
    moves: tuple[Move, ...]  # of the nominal robot
    left_out: int  # goals between theirs to which the motors do not carry the heaviest robot
    sampled: tuple[Move, ...]  # the same, of robots at corners of their tolerances; none without tolerances
    power_on: Response | None  # at rest, of the sampled robot whose weight the model knows least
    requirements: tuple[Requirement, ...]
    proof: WorkspaceProof | None = None  # of the preset `proved`, for what the file states
    pairs: PairResults | None = None  # what holds for all pairs, where that was begun already

    def summary(self) -> dict[str, str]:
        """Robot, whether the requirements are met, and how many poses and moves were looked at."""
        return {
            "robot": self.setup.robot.name,
            "requirements": self.judgement,
            "looked at": f"{len(self.loops)} poses, {len(self.moves) + len(self.sampled)} moves",
        }

    @property
    def goals(self) -> np.ndarray:
        """Poses (M + 1, n) between which the M nominal moves go, one after another."""
        return goals_of(self.moves)

    @property
    def robot(self) -> Robot:
        """Of the setup."""
        return self.setup.robot

    @property
    def specification(self) -> Specification:
        """Of the setup."""
        return self.setup.specification

    @property
    def loop(self) -> LoopOverWorkspace:
        """What the law does at any pose."""
        return LoopOverWorkspace(self.setup)

    def look_beyond(self) -> tuple[Robustness, Cause | None]:
        """What it tolerates, and the cause of what remains, now."""
        return self.robustness, self.remaining_cause

    @cached_property
    def robustness(self) -> Robustness:
        """What it tolerates beyond what is required of it."""
        return robustness(self.setup, self.poses, self.loops, self.undamped[0], self.pairs)

    @cached_property
    def remaining_cause(self) -> Cause | None:
        """What the largest remaining error of all moves comes from; None where no more remains than is allowed."""
        missed = any(line.what == REQUIREMENTS["remaining"].what for line in self.missed)
        return remaining_cause(self.setup, self.moves, self.sampled) if missed else None
