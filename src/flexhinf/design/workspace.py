"""One controller for a workspace: the modal law, its loops at poses, its moves between random goals, the judgement.

The law is `flexhinf.modal.ModalLaw`, whose gains follow the commanded pose, with `flexhinf.estimation.ModalFilter`. Its
bandwidth is the largest of a list with which the loops at some random poses keep what is required of them. Poses and
moves that are judged are others. The words are those of docs/workspace.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexhinf.analysis import EquilibriumLoop, LinearLoop
from flexhinf.design import requirements as required
from flexhinf.design.evaluation import damped_springs
from flexhinf.design.loop_setup import EstimatorNoise, LoopPlants
from flexhinf.design.plans import move_reference
from flexhinf.design.requirements import REQUIREMENTS, Requirement
from flexhinf.design.responses import Move, Response, motion_metrics
from flexhinf.design.specification import RIPPLE, TOLERANCE, Specification
from flexhinf.errors import NumericalFailure
from flexhinf.estimation import ExtendedKalmanFilter, ModalFilter
from flexhinf.loop import Controller, Loop, Waypoints
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.notebook import Summarised
from flexhinf.plant import Penalty
from flexhinf.robot import Robot
from flexhinf.robot.workspace import Workspace, workspace_of

#: The room whose pages show results. It reads designs, so it is loaded when one is saved.
PAGES = "flexhinf.pages"

#: Poses by which the bandwidth is chosen, poses that are judged, goals, robots within their tolerances; and seeds.
CHOSEN_POSES, POSES, GOALS, SAMPLED = 16, 200, 20, 8
CHOSEN_SEED, POSES_SEED, GOALS_SEED, SAMPLED_SEED = 17, 1, 7, 11

#: Poses by which the range of λ is found.
MODAL_POSES = 500

#: Bandwidths that are tried, rad/s, the fastest first; a soft pair gets at most this share of √λ.
BANDWIDTHS, SHARE = (80.0, 56.0, 40.0, 28.0, 20.0, 14.0, 10.0, 7.0, 5.0), 1.0

#: Least damping of slow oscillations; factor of all inputs at once that a loop tolerates, up and down.
DAMPING, GAIN = 0.2, 2.0

#: Random torques that the estimator expects each sample, in parts of the motors' limits: on links, on motors.
LINKS, MOTORS = 0.005, 0.03

#: Moves: share of the speed limits, speed without one (rad/s, m/s), shortest duration and rest at the end, s.
SPEED, UNLIMITED, SHORTEST, STILL = 0.5, 0.6, 0.5, 1.0

#: Largest share of a motor's limit that the weight at a goal may need.
HOLD = 0.7


class PoseLoop(NamedTuple):
    """The loop at rest at one pose. Growth is the largest modulus of a mode in the z plane."""

    growth: float
    damping: float  # smallest of slow oscillations, see `Specification.damped_below_limit`
    fast_damping: float  # smallest of faster ones
    damped_fast: float  # the same with springs that are damped more
    late: float  # growth with the extra delay that is required
    damped_late: float  # the same with springs that are damped more
    louder: float  # growth with all inputs times `GAIN`
    softer: float  # and divided by it
    ripple: float  # largest deviation of an input by the noise of the sensors, per cent of its limit

    def excess(self, damping: float, ripple: float) -> float:
        """How far it is from what is required: at most 0 where it keeps everything."""
        growth = max(self.growth, self.late, self.louder, self.softer)
        return max(np.log(growth), 1.0 - self.damping / damping, np.log(max(self.ripple, 1e-9) / ripple))


@dataclass(frozen=True, eq=False)
class WorkspaceSetup(LoopPlants):
    """A modal law with its estimator and controller, at any pose of the workspace."""

    workspace: Workspace
    law: ModalLaw

    @cached_property
    def noise_levels(self) -> EstimatorNoise:
        """R^v: as stated, or random torques on links and motors in parts of the motors' limits."""
        s, joints = self.specification, self.law.joints
        if s.process_noise is not None or s.torque_noise is not None:
            return EstimatorNoise.stated(s)
        limit = self.authority * joints.torque_per_input
        rates = LINKS * limit / np.diag(joints.link_inertia), MOTORS * limit / joints.motor_inertia
        return EstimatorNoise(0.0, *(tuple((s.period * rate) ** 2) for rate in rates))

    @cached_property
    def authority(self) -> np.ndarray:
        """Limits of the motors (n,); of one without a limit five times the weight's input, at least that of 1 rad."""
        joints, effort = self.law.joints, self.limits.effort
        held = np.abs(
            [self.robot.operating_point(pose)[1] for pose in self.workspace.sample(50, CHOSEN_SEED)]
        )
        own = np.maximum(5.0 * held.max(axis=0), joints.stiffness / joints.torque_per_input)
        return np.where(np.isfinite(effort), effort, own)

    def estimator(self, at: np.ndarray) -> Any:
        """The estimator, which begins at rest at a pose (n,); None where the true state is fed back."""
        s = self.specification
        if s.estimator == "none":
            return None
        model, mean = self.model, self.robot.operating_point(at)[0]
        process, measurement = self.noise_levels.covariance(model.states), np.asarray(self.noise) ** 2
        covariance = process + 1e-12 * np.eye(len(mean))
        return ModalFilter(
            ExtendedKalmanFilter(model, s.period, process, measurement, mean=mean, covariance=covariance)
        )

    def controller(self, at: np.ndarray) -> Controller:
        """A controller that begins at rest at a pose (n,), with the input that holds the model there."""
        s = self.specification
        return Controller(
            self.law, self.estimator(at), s.period, self.limits.saturated, moving=True, start="zero",
            before_first=self.robot.operating_point(at)[1], latency=s.known_latency,
        )  # fmt: skip

    # At rest ------------------------------------------------------------------------------------------
    def linear(self, at: np.ndarray) -> LinearLoop:
        """The sampled loop linearised at rest at a pose (n,)."""
        s = self.specification
        return EquilibriumLoop(
            self.law, self.estimator(at), self.smooth_plant, s.period, equilibrium=self.robot.operating_point(at),
            moving=True, delay=s.unknown_samples, latency=s.known_latency,
            positions=self.model.states[: len(self.joints)],
        ).linear()  # fmt: skip

    def at_pose(self, at: np.ndarray) -> PoseLoop:
        """The loop at rest at a pose (n,)."""
        s, loop = self.specification, self.linear(at)
        soft, extra = (
            damped_springs(loop, self.smooth_plant, self.joints),
            (s.delay_margin_limit or 0.0) * s.period,
        )

        def growth(loop: LinearLoop, extra: float = 0.0) -> float:
            return float(np.abs(loop.system(loop.delay + extra).multipliers).max())

        noise = np.zeros(len(self.joints)) if self.noise is None else loop.part("v", "u").spread(self.noise)
        return PoseLoop(
            growth(loop), *loop.closed_loop.damping_about(s.damped_below_limit),
            soft.closed_loop.damping_about(s.damped_below_limit)[1], growth(loop, extra), growth(soft, extra),
            *(growth(replace(loop, b=by * loop.b, d=by * loop.d)) for by in (GAIN, 1.0 / GAIN)),
            100.0 * float((noise / self.authority).max()),
        )  # fmt: skip

    # Moves --------------------------------------------------------------------------------------------
    def goals(self, count: int, seed: int) -> np.ndarray:
        """Goals (count, n) that the motors hold with `HOLD` of their limits."""
        kept: list[np.ndarray] = []
        for pose in self.workspace.sample(50 * count, seed):
            if np.all(np.abs(self.robot.operating_point(pose)[1]) <= HOLD * self.limits.effort):
                kept.append(pose)
                if len(kept) == count:
                    return np.array(kept)
        raise NumericalFailure(
            "The motors hold hardly any pose of the workspace.",
            f"{len(kept)} of {50 * count} random poses need at most {100.0 * HOLD:g} % of the limits",
            "a smaller workspace, a lighter payload, or larger limits",
        )

    def plan(self, start: np.ndarray, goal: np.ndarray) -> Waypoints:
        """A quintic from pose to pose at half the speed limits."""
        speed = np.where(np.isfinite(self.limits.speed), self.limits.speed, UNLIMITED)
        duration = max(SHORTEST, float(np.max(1.875 * np.abs(goal - start) / (SPEED * speed))))
        return Waypoints([0.0, duration], [start, goal], "quintic")

    def move(self, ends: np.ndarray, values: Mapping[str, Any] | None = None, seed: int = 0) -> Move:
        """A move with feedforward between the rows of `ends` (2, n), and a second of rest; the true robot has the
        parameters `values`."""
        s, (start, goal) = self.specification, ends
        plan, plant = self.plan(start, goal), self.true_plant
        if values is not None:
            plant = plant.with_parameters(**plant.parameters.known(values))
        loop = Loop(plant, self.controller(start), quantisation=self.quantisation, delay=s.unknown_delay)
        run = loop.run(
            reference=move_reference(self.robot, plan, self.dry_friction), noise=self.noise,
            duration=s.period * round((plan.duration + STILL) / s.period), seed=s.seed + seed,
            initial_state=self.robot.operating_point(start, s.extras, values)[0],
        )  # fmt: skip
        return Move(plan, Response(run, goal, start, self.joints))


# The design ---------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceDesign(Summarised):
    """One controller for a workspace, its loops at poses and its moves, and the judgement of both."""

    setup: WorkspaceSetup
    poses: np.ndarray  # (N, n), rad or m
    loops: tuple[PoseLoop, ...]  # one for each pose
    moves: tuple[Move, ...]  # of the nominal robot
    sampled: tuple[
        Move, ...
    ]  # the same moves, of robots at corners of their tolerances; none without tolerances
    requirements: tuple[Requirement, ...]

    def summary(self) -> dict[str, str]:
        """Robot, whether the requirements are met, and how many poses and moves were looked at."""
        missed = sum(not line.met for line in self.requirements)
        return {
            "robot": self.setup.robot.name,
            "requirements": f"{missed} of {len(self.requirements)} not met" if missed else "met",
            "looked at": f"{len(self.loops)} poses, {len(self.moves) + len(self.sampled)} moves",
        }

    def save(self, folder: str | Path) -> Path:
        """Write the report, its numbers, the controller and every run into a folder, which is returned."""
        return import_module(PAGES).write_report(self, folder)

    robot = property(attrgetter("setup.robot"))
    specification = property(attrgetter("setup.specification"))

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        return all(line.met for line in self.requirements)

    def controller(self, at: Any = None) -> Controller:
        """A new controller that begins at rest at a pose (n,), by default the robot's home."""
        home = self.setup.robot.home if at is None else at
        return self.setup.controller(np.atleast_1d(np.asarray(home, dtype=float)))


def design_workspace(
    robot: Robot, s: Specification, stated: Any, progress: Callable[[str], None] = lambda text: None
) -> WorkspaceDesign:
    """Design one controller for a workspace, and judge it at poses and in moves that did not choose it."""
    setup = tuned_setup(robot, s, workspace_of(robot, stated), progress)
    progress(f"loops at {POSES} poses")
    poses = setup.workspace.sample(POSES, POSES_SEED)
    loops = tuple(map(setup.at_pose, poses))
    progress(f"moves between {GOALS} goals")
    goals = setup.goals(GOALS + 1, GOALS_SEED)
    ends = [goals[k : k + 2] for k in range(GOALS)]
    moves = tuple(setup.move(pair, seed=k) for k, pair in enumerate(ends))
    rng, sampled = np.random.default_rng(SAMPLED_SEED), ()
    if robot.uncertain:
        progress("the same moves of sampled robots")
        corners = [robot.corner(rng.choice([-1.0, 1.0], len(robot.uncertain))) for _ in range(SAMPLED)]
        sampled = tuple(setup.move(pair, corners[k % SAMPLED], k) for k, pair in enumerate(ends))
    lines = (*pose_requirements(s, loops), *move_requirements(setup, moves, "nominal robot"))
    lines += (
        tuple(move_requirements(setup, sampled, "robots at corners of their tolerances")) if sampled else ()
    )
    return WorkspaceDesign(setup, poses, loops, moves, sampled, lines)


def tuned_setup(
    robot: Robot, s: Specification, workspace: Workspace, progress: Callable[[str], None] = lambda text: None
) -> WorkspaceSetup:
    """The loop with the fastest law that keeps what is required at some random poses, or the one nearest to it."""
    poses, modal = workspace.sample(CHOSEN_POSES, CHOSEN_SEED), workspace.sample(MODAL_POSES, CHOSEN_SEED)
    problem, nearest = robot.problem(penalty=Penalty({"link_position": 1.0})), (np.inf, None)
    for bandwidth in BANDWIDTHS:
        progress(f"gains of the pairs: {bandwidth:g} rad/s")
        law = ModalLaw.tuned(problem, s.period, PairWeights(bandwidth=bandwidth, share=SHARE), modal)
        setup = WorkspaceSetup(robot, s, workspace, law)
        excess = max(setup.at_pose(pose).excess(*pose_limits(s)) for pose in poses)
        if excess < nearest[0] - TOLERANCE:  # a slower law has to be better by more than that
            nearest = excess, setup
        if excess <= 0.0:
            break
    assert nearest[1] is not None
    return nearest[1]


def pose_limits(s: Specification) -> tuple[float, float]:
    """Least damping of slow oscillations, and largest ripple, per cent."""
    return DAMPING if s.damping is None else s.damping, RIPPLE if s.ripple is None else s.ripple


def pose_requirements(s: Specification, loops: Sequence[PoseLoop]) -> list[Requirement]:
    """Requirements on the loops at all poses."""
    where, (damping, ripple) = f"{len(loops)} random poses, sampled loop", pose_limits(s)
    unstable = {
        "unstable poses": [loop.growth for loop in loops],
        f"poses that {s.delay_margin_limit or 0.0:g} more samples of delay make unstable": [
            loop.late for loop in loops
        ],
        f"poses that a gain of {GAIN:g} or {1.0 / GAIN:g} makes unstable": [
            max(l.louder, l.softer) for l in loops
        ],
    }
    row = REQUIREMENTS["corners"]
    return [
        *(replace(row, what=what, criterion="a pole outside the unit circle").judge(
            None, 0.0, int(np.sum(np.array(growths) >= 1.0)), where) for what, growths in unstable.items()),
        REQUIREMENTS["damping"].judge(s, damping, min(loop.damping for loop in loops), where),
        REQUIREMENTS["ripple"].judge(s, ripple, max(loop.ripple for loop in loops), where),
    ]  # fmt: skip


def move_requirements(setup: WorkspaceSetup, moves: Sequence[Move], which: str) -> list[Requirement]:
    """Requirements on each kind of motion, for the worst of the moves."""
    lines: dict[str, Requirement] = {}
    s, where = setup.specification, f"the worst of {len(moves)} moves, {which}"
    for move in moves:
        rows = motion_metrics(setup.limits, move.response, move.plan)
        for line in required.motion_requirements(s, setup.limits, rows, 0.0, where):
            other = lines.get(line.what)
            if other is None or line.found / line.limit > other.found / other.limit:
                lines[line.what] = line
    return list(lines.values())
