"""What a controller for a workspace was judged by: its loops at poses, its moves, what it tolerates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis import LinearLoop
from flexhinf.arrays import Numbers
from flexhinf.designs.judged import Judged
from flexhinf.designs.protecting import deployed
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.responses import Move, Response
from flexhinf.designs.resting import CornerLoop, PoseLoop
from flexhinf.designs.specification import Specification
from flexhinf.designs.workspace.proof import WorkspaceProof, prove_workspace
from flexhinf.designs.workspace.rivals import Gains, home_bandwidths
from flexhinf.designs.workspace.robustness import Cause, PairResults, Robustness, remaining_cause, robustness
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import refuse_if
from flexhinf.loop import Controller, Trajectory
from flexhinf.notebook import Summarised
from flexhinf.numerals import count_text
from flexhinf.robot import Robot
from flexhinf.robot.poses import checked_pose

#: Length of a step, s.
STEP = 2.0


@dataclass(frozen=True, eq=False, repr=False)
class LoopOverWorkspace:
    """A `DesignedLoop` at all poses."""

    setup: WorkspaceSetup

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: robot: {self.setup.robot.name}>"

    @property
    def length(self) -> float:
        """Of the run of a jump, s; 0 where moves have lengths of their own."""
        motion = self.setup.motion
        return self.setup.step_length if motion is not None and motion.jumps else 0.0

    def _pose(self, at: Numbers) -> np.ndarray:
        robot = self.setup.robot
        return checked_pose(at, np.asarray(self.setup.workspace.home), robot.links, robot.name)

    def controller(self, at: Numbers = None, **options: Any) -> Controller:
        """It follows references that come with states and inputs, such as `Moving`; the same one serves every pose. By
        default ``offset_time`` is `OFFSET_TIME`, ``supervision`` that of the setup, which brakes along the path, and
        ``protection`` that of the robot, see `flexhinf.export.protected`."""
        setup = self.setup
        refuse_if(
            not setup.has_controller,
            f"The gains of {setup.specification.law} are solved anew at each pose: no one controller has them all.",
            "expected a law whose code has the gains of every pose, or a task of one pose, got a workspace",
            "another design, with law='modal'; or with this law and pose='home'",
        )
        own: dict[str, Any] = {"supervision": setup.supervision, **options}
        motion = setup.motion
        law = None if motion is None else setup.law.along(motion.start, motion.goal)
        controller = setup.controller(self._begin(at), law, **own)
        return deployed(controller, self.setup.robot, self.setup.specification, options)

    @property
    def has_controller(self) -> bool:
        """Whether one controller serves every pose of the task."""
        return self.setup.has_controller

    def _begin(self, at: Numbers) -> np.ndarray:
        """A pose at which something begins: by default that of the motion, where there is one."""
        motion = self.setup.motion
        return motion.start if motion is not None and at is None else self._pose(at)

    def linear(self, at: Numbers = None) -> LinearLoop:
        """At rest at a pose."""
        return self.setup.linear(self._pose(at))

    def step(self, goal: Numbers = None, start: Numbers = None, duration: float | None = None) -> Trajectory:
        """Of the nominal robot, with the noise of its sensors and its dry friction. It asks for more than a robot can
        do at once; `move` is what the design is judged by."""
        setup, begin = self.setup, self._begin(start)
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
        """A quintic at half the speed limits, or the motion of the task."""
        return self.setup.move(np.array([self._begin(start), self._pose(goal)])).response.run

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
        moves = len(self.moves) + len(self.sampled)
        return {
            "robot": self.setup.robot.name,
            "requirements": self.judgement,
            "looked at": f"{count_text(len(self.loops), 'pose')}, {count_text(moves, 'move')}",
        }

    @property
    def goals(self) -> np.ndarray:
        """Poses (M + 1, n) between which the M nominal moves go, one after another."""
        return np.array([self.moves[0].response.start, *(move.response.goal for move in self.moves)])

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

    @property
    def numbers(self) -> Gains:
        """Of which the gains are made, by name; none of the modal law."""
        return self.setup.numbers

    @property
    def bandwidth(self) -> float | None:
        """The largest of all joints, rad/s, at home what the springs leave of it; None where gains are stated without
        one."""
        stated = self.setup.bandwidth
        return float(home_bandwidths(self.setup, self.numbers).max()) if stated and self.numbers else stated

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
