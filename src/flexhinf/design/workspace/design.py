"""One controller for a workspace, judged at random poses and in moves between random goals.

The law is `flexhinf.modal.ModalLaw`, whose gains follow the commanded pose, with `flexhinf.estimation.ModalFilter`. The
search takes the largest bandwidth of a list with which the loops at 16 random poses meet the requirements. The
judgement uses other poses, and moves. The words are those of docs/workspace.md.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np

from flexhinf.analysis import LinearLoop
from flexhinf.arrays import Numbers
from flexhinf.design.noise_levels import sensor_steps
from flexhinf.design.requirements import Requirement
from flexhinf.design.responses import Move, Response, joint_limits
from flexhinf.design.result import Design
from flexhinf.design.specification import TOLERANCE, Specification
from flexhinf.design.stated_units import check_stated_units
from flexhinf.design.workspace.judgement import (
    corner_requirements,
    holding_requirement,
    move_requirements,
    pose_requirements,
    standstill_requirement,
)
from flexhinf.design.workspace.law_file import stated_workspace
from flexhinf.design.workspace.proof import WorkspaceProof, prove_workspace
from flexhinf.design.workspace.search import BANDWIDTHS, tuned_setup
from flexhinf.design.workspace.setup import CornerLoop, PoseLoop, WorkspaceSetup
from flexhinf.errors import refuse_if
from flexhinf.loop import Controller, Trajectory
from flexhinf.robot import Robot, kinematics
from flexhinf.robot.elastic import checked_pose
from flexhinf.robot.parameters import PlantValues, per_joint
from flexhinf.robot.signals import SENSORS, expanded, signal_names
from flexhinf.robot.waypoints import LIMITS

#: Limits by which loops and moves are judged, and which change neither; margins with which loops are computed.
JUDGED = ("damping", "ripple", "undershoot", "path_distance", "remaining_error", "tracking_error")
MARGINS = ("gain_margin", "delay_margin")

T = TypeVar("T")

#: Called between poses, moves and candidates with the requirements judged so far; what it raises ends the work.
Watch = Callable[[Sequence[Requirement]], None]

#: Rounds of further moves of robots at corners: how many there are where the worst of those before uses a share of a
#: limit between these. Of 40 goals in another simulator 9 passed a limit of which the worst of the first 20 had used
#: 0.7; of 240 by other seeds 5 passed one of which the worst of 60 had used 0.96, by up to 1.8 times.
FURTHER = ((40, 0.6, 3.0), (100, 0.8, 1.0))

#: Poses and goals that are judged, and seeds, to which 100 times the seed of the specification is added.
POSES, GOALS = 200, 20
POSES_SEED, GOALS_SEED, SAMPLED_SEED = 1, 7, 11


@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceDesign(Design):
    """One controller for a workspace, its loops at poses and its moves, and the judgement of both.

    Poses, moves and robots are random samples by the seed of the specification: nothing is proved between them.

    Examples
    --------
    A box of one degree:

    >>> import flexhinf as fh
    >>> wanted = fh.Specification(workspace=((0.0, 0.02),), draws=0, estimator="none")
    >>> found = fh.design(fh.load_robot("paper"), wanted)  # doctest: +SKIP
    >>> found.margins((0.01,)).stable  # doctest: +SKIP
    True
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
        return np.array([self.moves[0].response.start, *(move.response.goal for move in self.moves)])

    robot = property(attrgetter("setup.robot"))
    specification = property(attrgetter("setup.specification"))

    def _pose(self, at: Any) -> np.ndarray:
        return checked_pose(at, np.asarray(self.setup.workspace.home), self.robot.links, self.robot.name)

    def linear(self, at: Numbers = None) -> LinearLoop:
        """The running loop at rest at a pose, linearised."""
        return self.setup.linear(
            checked_pose(self._pose(at), self.poses[0], self.robot.links, self.robot.name)
        )

    def step(self, goal: Numbers, start: Numbers = None, duration: float = 2.0) -> Trajectory:
        """The run of a bare step of the command: from rest at `start` to `goal`, (n,) each, rad or m.

        The robot is the nominal one, with the sensors' noise and the dry friction that it states. A step asks for more
        than a robot can do at once; `move` is what the design is judged by.
        """
        robot, begin = self.setup.true.robot, self._pose(start)
        controller, end = self.controller(begin), np.concatenate(robot.operating_point(goal))
        return self.setup.loop(controller).run(
            dict(zip(controller.commanded, end.tolist())), noise=self.setup.noise, duration=duration,
            initial_state=robot.operating_point(begin, self.setup.extras)[0], seed=self.specification.seed,
        )  # fmt: skip

    def move(self, goal: Numbers = None, start: Numbers = None) -> Trajectory:
        """The run of a quintic move with feedforward, at half the speed limits, from rest at `start` to `goal`, (n,)
        each, rad or m, by default the home, and a second of rest."""
        return self.setup.move(np.array([self._pose(start), self._pose(goal)])).response.run

    def certificate(self) -> WorkspaceProof:
        """The errors of the model that small motions about rest are proved to tolerate, at every pose.

        Raises `InvalidInput` where nothing is proved.
        """
        found = prove_workspace(self.setup)
        refuse_if(
            not found.is_proved,
            "Nothing is proved of this design.",
            "expected pairs of a link and a motor that are proved stable, got none",
            "encoders on both sides of the springs, or a smaller bandwidth",
        )
        return found

    def controller(self, at: Numbers = None, **options: Any) -> Controller:
        """A new controller as it is deployed, which begins at rest at a pose (n,), by default the robot's home or,
        where that is not in the workspace, a pose in it.

        It follows references that come with states and inputs, such as `Moving`; the same one serves every pose.
        `options` are those of `flexhinf.Controller`: ``offset_time`` is by default `OFFSET_TIME`, and ``supervision``
        that of the setup, which brakes along the path; ``Supervision(workspace=…)`` without reactions only reports.
        """
        return self.setup.controller(self._pose(at), **{"supervision": self.setup.supervision, **options})


def design_workspace(
    robot: Robot, s: Specification, progress: Callable[[str], None] = lambda text: None,
    watch: Watch = lambda lines: None, like: WorkspaceDesign | None = None, changed: Collection[str] = (),
) -> WorkspaceDesign:  # fmt: skip
    """Design one controller for a workspace, and judge it at poses and in moves that the search did not use.

    Parameters
    ----------
    robot : Robot
        From `load_robot`.
    s : Specification
        Its workspace, by default all poses within the joint ranges; what the loop has to keep; sensors, noise, limits,
        period and latency.
    progress : callable, optional
        Called with what comes next.
    watch : callable, optional
        See `Watch`.
    like, changed : WorkspaceDesign and names of fields, optional
        A design of the same robot whose specification differs in these fields alone. Loops and moves that the search
        finds again are taken from it.

    Raises
    ------
    InvalidInput
        For a workspace, sensors or limits that do not fit the robot.
    NumericalFailure
        Where the motors hold hardly any pose of the workspace.
    """
    check_loop(robot, s)
    s = replace(s, workspace=LIMITS) if s.workspace is None else s
    setup = tuned_setup(robot, s, stated_workspace(robot, s.workspace), progress, lambda: watch(()))
    return judged_design(setup, progress, watch, like, changed)


def judged_design(
    setup: WorkspaceSetup, progress: Callable[[str], None] = lambda text: None, watch: Watch = lambda lines: None,
    like: WorkspaceDesign | None = None, changed: Collection[str] = (), undamped: bool = True,
) -> WorkspaceDesign:  # fmt: skip
    """Judge a law at poses and in moves that no search uses; parameters as of `design_workspace`.

    `undamped`: whether the loops whose springs nothing damps are computed too; they decide nothing.
    """
    s, lines = setup.specification, list[Requirement]()

    def watched(items: Iterable[T]) -> Iterator[T]:
        for item in items:
            watch(lines)
            yield item

    known, ran = (None, None) if like is None else _reused(like, setup, changed)
    progress(f"loops at {POSES} poses")
    poses = setup.workspace.sample(POSES, POSES_SEED + 100 * s.seed)
    loops = known.loops if known else tuple(setup.at_pose(pose, TOLERANCE) for pose in watched(poses))
    lines += (*pose_requirements(s, loops), *holding_requirement(setup, poses))
    true = setup.true.robot
    corners = true.random_corners(POSES, POSES_SEED + 100 * s.seed)
    cornered = known.corner_loops if known else tuple(map(setup.at_corner, watched(poses), corners))
    lines += corner_requirements(s, cornered)
    bare: tuple[tuple[CornerLoop, ...], tuple[CornerLoop, ...]] = ((), ())
    if known:
        bare = known.undamped
    elif undamped:
        bare = (
            tuple(setup.at_corner(pose, None, damped=False) for pose in poses),
            tuple(setup.at_corner(*one, damped=False) for one in zip(poses, corners)),
        )
    progress(f"moves between {GOALS} goals")
    goals, left_out = setup.goals(GOALS + 1, GOALS_SEED + 100 * s.seed)
    nominal = [(goals[k : k + 2], None, k) for k in range(GOALS)]
    moves = ran.moves if ran else tuple(setup.move(*one) for one in watched(nominal))
    sampled, power_on = (), None
    lines += move_requirements(setup, moves, "nominal robot")
    if others := corner_moves(setup, 0, goals):
        progress("moves of sampled robots")
        sampled = ran.sampled if ran else tuple(setup.move(*one) for one in watched(others))
        which = "robots at corners of their tolerances"
        judged = move_requirements(setup, sampled, which)
        for k, (_, *shares) in enumerate(FURTHER if s.draws is None else (), 1):
            if len(sampled) <= len(others) and not decided_by_few(judged, *shares):
                break
            others += corner_moves(setup, k, goals)
            sampled += tuple(setup.move(*one) for one in watched(others[len(sampled) :]))
            judged = move_requirements(setup, sampled, which)
        lines += judged
        power_on = setup.power_on(*max(others, key=lambda one: setup.unknown_load(*one[:2])))
    if setup.may_swing:
        watch(lines)
        lines.append(standstill_requirement(setup, [*nominal, *others], [*moves, *sampled]))
    return WorkspaceDesign(
        setup, poses, loops, cornered, bare, moves, left_out, sampled, power_on, tuple(lines)
    )  # fmt: skip


def _reused(
    like: WorkspaceDesign, setup: WorkspaceSetup, changed: Collection[str]
) -> tuple[WorkspaceDesign | None, WorkspaceDesign | None]:
    """The design whose loops, and whose moves, are those of a setup of which only the fields `changed` differ."""
    before = like.setup
    same = (before.gains.weights, before.random) == (setup.gains.weights, setup.random)
    loops = like if same and {*changed} <= {*JUDGED, "peak_speed"} else None
    return loops, like if same and {*changed} <= {*JUDGED, *MARGINS} else None


def sampled_moves(robot: Robot, s: Specification) -> int:
    """How many robots at corners of their tolerances make a move each; none without tolerances."""
    return (GOALS if s.draws is None else s.draws) if robot.uncertain else 0


def decided_by_few(lines: Sequence[Requirement], near: float, far: float) -> bool:
    """Whether the worst of moves uses a share of a limit between these, so that others may pass it, or that it says
    little of a larger limit."""
    return any(near < line.found / line.limit < far for line in lines if line.field in JUDGED and line.limit)


def corner_moves(
    setup: WorkspaceSetup, after: int, first: np.ndarray
) -> list[tuple[np.ndarray, PlantValues, int]]:
    """Arguments of `WorkspaceSetup.move` of robots at corners: of the first round between the goals of the nominal
    moves, `first` (GOALS + 1, n), of each round `after` it between goals of their own."""
    own = 100 * setup.specification.seed + after
    count = FURTHER[after - 1][0] if after else sampled_moves(setup.robot, setup.specification)
    between = count if after else GOALS
    before = GOALS + sum(count for count, *_ in FURTHER[: after - 1]) if after else 0
    goals = setup.goals(between + 1, GOALS_SEED + own)[0] if after else first
    ends = [goals[k % between : k % between + 2] for k in range(count)]
    robots = setup.true.robot.random_corners(count, SAMPLED_SEED + own)
    return [(ends[k], values, before + k) for k, values in enumerate(robots)]


def workspace_stages(robot: Robot, s: Specification) -> list[tuple[str, float]]:
    """How the names begin with which `design_workspace` calls `progress` at most, and parts of its work; the first law
    is often the one."""
    tries = [("gains of the pairs", 0.6), *[("gains of the pairs", 0.3)] * (len(BANDWIDTHS) - 1)]
    sampled = [("moves of sampled robots", 0.6)] * bool(sampled_moves(robot, s))
    return [*tries, ("loops", 1.2), ("moves between", 1.1), *sampled]


def check_loop(robot: Robot, s: Specification) -> None:
    """Refuse, before any work, numbers that do not fit the robot."""
    check_stated_units(robot, s)
    kinematics.check_fast(robot, s.period)
    kinematics.check_delay(robot, s.unknown_delay)
    expanded(s.measured, SENSORS, robot.joint_names, robot.rigid)
    plant = robot.plant(s.measured, extras=s.extras)
    sensor_steps(robot, s.measured, s.quantisation, s.estimator)
    joint_limits(robot, s)
    if s.estimator != "none":
        check_seen(robot, plant.outputs)


def check_seen(robot: Robot, signals: Sequence[str]) -> None:
    """Refuse signals by which the position of a joint is not measured, at its link or at its motor."""
    joints = robot.joint_names
    seen = {
        name
        for side in ("link_position", "motor_position")
        for name, signal in zip(joints, signal_names(side, joints))
        if signal in signals
    }
    unseen = [name for name in joints if name not in seen]
    missing = [per_joint("motor_position", name, len(joints)) for name in unseen]
    refuse_if(
        unseen,
        f"No sensor measures where {', '.join(unseen)} {'is' if len(unseen) == 1 else 'are'}.",
        f"expected link_position or motor_position of every joint, got {list(signals)}",
        f"measured={(*signals, *missing)}",
    )
