"""One controller for a workspace: its search, its loop at random poses, its moves between random goals, the judgement.

The law is `flexhinf.modal.ModalLaw`, whose gains follow the commanded pose, with `flexhinf.estimation.ModalFilter`. The
search takes the largest bandwidth of a list with which the loops at 16 random poses meet the requirements. The
judgement uses other poses, and moves. The words are those of docs/workspace.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import zip_longest
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from flexhinf.analysis import LinearLoop
from flexhinf.analysis.linear_loop import exponential
from flexhinf.design import requirements as required
from flexhinf.design.design_file import check_stated_units, tool_of
from flexhinf.design.evaluation import damped_springs
from flexhinf.design.loop_setup import DEVIATIONS, EstimatorNoise, LoopPlants, sensor_steps
from flexhinf.design.plans import BEYOND, move_reference, quintic_move, settled
from flexhinf.design.requirements import REQUIREMENTS, Judged, Requirement
from flexhinf.design.responses import Move, Response, joint_limits, with_values
from flexhinf.design.specification import RINGS, RIPPLE, Specification
from flexhinf.errors import NumericalFailure
from flexhinf.estimation import ExtendedKalmanFilter, ModalFilter, stationary_gain
from flexhinf.loop import Controller, Loop, Moving, Supervision, Waypoints
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.plant import Penalty, Plant
from flexhinf.robot import Robot, kinematics
from flexhinf.robot.elastic import stated_friction
from flexhinf.robot.waypoints import LIMITS
from flexhinf.robot.workspace import Workspace, workspace_of

#: Poses by which the range of λ is found, by which a bandwidth is chosen, that are judged; goals; and seeds. The seeds
#: of what is judged are these plus 100 times the seed of the specification.
MODAL_POSES, CHOSEN_POSES, POSES, GOALS = 500, 16, 200, 20
CHOSEN_SEED, POSES_SEED, GOALS_SEED, SAMPLED_SEED = 17, 1, 7, 11

#: Bandwidths that are tried, rad/s, the fastest first; weight of integrals, and γ/γ*.
BANDWIDTHS, INTEGRAL, GAMMA = (40.0, 28.0, 20.0, 14.0, 10.0, 7.0), 0.5, 1.5

#: Largest bandwidth of a soft pair, as a multiple of √λ, without and with dry friction. Friction nearly holds a motor
#: in small motions; the link then vibrates at √λ, and a law that is faster excites it: a limit cycle.
SHARE = (2.0, 1.0)

#: Weights with encoders of the motors alone: a soft spring that is not seen is moved slower than it vibrates, and no
#: vibration is damped by much more than is required.
MOTORS_WEIGHTS = {"share": 0.5, "damping": 0.3}

#: Random torques that the estimator expects each sample, in parts of the motors' limits, on links and on motors, in the
#: order in which they are tried. Larger torques on motors make the loop tolerate a larger gain, with more ripple, and
#: with much noise they hide the vibration. With encoders of the motors alone they always do: half the ratio of the two
#: torques is about the damping of the estimator's own vibration.
RANDOM = (
    (0.0025, 0.03), (0.00125, 0.03), (0.0006, 0.01), (0.02, 0.03), (0.01, 0.01), (0.005, 0.005), (0.001, 0.01),
    (0.0006, 0.04), (0.0006, 0.07), (0.0025, 0.1),
)  # fmt: skip
MOTORS_RANDOM = (
    (0.033, 0.03), (0.02, 0.03), (0.011, 0.01), (0.005, 0.005), (0.0055, 0.01), (0.0045, 0.01), (0.002, 0.01),
)  # fmt: skip

#: Least damping of slow oscillations; factor of all inputs at once that a loop tolerates, up and down.
DAMPING, GAIN = 0.2, 2.0

#: The search asks for this factor more than each limit, since other poses are judged; and of estimators for the same
#: law prefers one with a ripple below this, per cent. Where none has all, a later one has to miss less than this share.
RESERVE, QUIET, LESS = 1.1, 1.2, 0.9

#: Offsets of the encoders are taken in with this time constant, s. A difference of 0.5 mrad between link and motor
#: looks like a twisted spring; acting at once it would move a stiff arm by 14 mrad.
OFFSET_TIME = 0.5

#: Share of a joint's range by which a command may lie beyond it: rounding, also that of C in single precision.
#: Acceleration that a motor without a stated limit is assumed to have, rad/s² or m/s². Stated limits allow up to twice.
ROUNDING, ACCELERATION = 1e-6, 50.0

#: Rest at the end of a move, s, and of the one that is made again to see whether links rest; largest deviation by noise
#: in some 10,000 samples, as a multiple of its standard deviation.
#: A goal is left out if holding the arm there needs more than the last share of a motor's limit.
STILL, LONG, LARGEST_OF_NOISE, HOLD = 1.0, 20.0, 4.5, 0.7


class CornerLoop(NamedTuple):
    """The loop at rest at one pose, of a robot at a corner of its tolerances; as in `PoseLoop`."""

    growth: float
    damping: float
    fast_damping: float


class PoseLoop(NamedTuple):
    """The loop at rest at one pose. Growth is the largest modulus of the poles in the z plane; below 1 is stable."""

    growth: float
    damping: float  # smallest damping ratio of slow oscillations, see `Specification.damped_below_limit`
    fast_damping: float  # smallest of faster ones
    damped_fast: float  # the same with springs that are damped more
    late: float  # growth with the extra delay that is required
    damped_late: float  # the same with twice that delay and springs that are damped more
    louder: float  # growth with all inputs times the gain margin that is required
    softer: float  # and divided by it
    ripple: float  # largest deviation of an input by the noise of the sensors, per cent of its limit

    def excess(self, damping: float, ripple: float, period: float) -> np.ndarray:
        """How far it misses, (4,), in order of importance: stability with the extra delay (1/s), damping and ripple
        (relative); the gain margins (1/s); twice the delay with damped springs (1/s), and a ripple of `QUIET`, which
        are only preferred. At most 0 where it misses nothing."""
        late, gain, wished = np.log([self.late, max(self.louder, self.softer), self.damped_late]) / period
        loud = np.log(np.clip(self.ripple, 1e-9, 1e5) / np.array([ripple, QUIET]))
        needed = max(np.log(self.growth) / period, late, 1.0 - self.damping / damping, loud[0])
        return np.array([needed, gain, wished, loud[1]])


@dataclass(frozen=True, eq=False)
class WorkspaceSetup(LoopPlants):
    """A modal law with its estimator and controller, at any pose of the workspace.

    Poses are link positions (n,), rad or m. The loop runs with the period, latency, sensors, noise and limits of the
    specification.
    """

    workspace: Workspace
    law: ModalLaw
    random: tuple[float, float] = RANDOM[0]  # torques on links and motors, in parts of the limits

    @cached_property
    def noise_levels(self) -> EstimatorNoise:
        """R^v: as stated, or random torques on links and motors in parts of the motors' limits."""
        s, joints = self.specification, self.law.joints
        if s.process_noise is not None or s.torque_noise is not None:
            return EstimatorNoise.stated(s)
        limit = self.authority * joints.torque_per_input
        links, motors = self.random
        on_links = links * limit / np.diag(joints.link_inertia)
        on_motors = motors * limit / joints.motor_inertia
        return EstimatorNoise(0.0, tuple((s.period * on_links) ** 2), tuple((s.period * on_motors) ** 2))

    @cached_property
    def authority(self) -> np.ndarray:
        """Limits of the motors (n,); of one without a limit the input that holds the weight and accelerates link and
        motor by `ACCELERATION`, at some random poses."""
        joints, p = self.law.joints, self.law.plant.parameters.vector()
        needed = [
            np.abs(self.robot.operating_point(pose)[1]) + ACCELERATION / joints.torque_per_input
            * (np.diag(np.linalg.inv(self.law.compliance.matrix(pose, p))) + joints.motor_inertia)
            for pose in self.workspace.sample(CHOSEN_POSES, CHOSEN_SEED)
        ]  # fmt: skip
        return np.where(np.isfinite(self.limits.effort), self.limits.effort, np.max(needed, axis=0))

    def estimator(self, at: np.ndarray) -> Any:
        """The estimator, started at rest at a pose (n,), of which its gains do not depend; None where the true state is
        fed back."""
        s = self.specification
        if s.estimator == "none":
            return None
        model, mean = self.model, self.robot.operating_point(at)[0]
        process, measurement = self.noise_levels.covariance(model.states), self.noise_variances
        covariance = process + 1e-12 * np.eye(len(mean))
        kalman = ExtendedKalmanFilter(model, s.period, process, measurement, mean=mean, covariance=covariance)
        return kalman if self.robot.rigid else ModalFilter(kalman, self.law.equilibrium[0])

    @property
    def supervision(self) -> Supervision:
        """What a deployed controller watches: commands outside the box of the workspace (of a path with room for what a
        spline swings beyond its points), saturation, and limit cycles."""
        space = self.workspace
        share = ROUNDING if space.path is None else BEYOND
        margin = np.maximum(share * (space.upper - space.lower), ROUNDING)
        return Supervision(workspace=(space.lower - margin, space.upper + margin))

    def controller(self, at: np.ndarray, **options: Any) -> Controller:
        """A controller that begins at rest at a pose (n,), with the input that holds the model there, and holds it
        until there is a command; with further options of `flexhinf.Controller`."""
        s, held = self.specification, self.robot.operating_point(at)
        options = {"offset_time": None if s.estimator == "none" else OFFSET_TIME, **options}
        return Controller(
            replace(self.law, equilibrium=held), self.estimator(at), s.period, self.limits.saturated, moving=True,
            start="zero", latency=s.known_latency, **options,
        )  # fmt: skip

    # At rest ------------------------------------------------------------------------------------------
    @cached_property
    def filter(self) -> Any:
        """The estimator at home, from which `linear` takes the gains."""
        return self.estimator(np.asarray(self.robot.home))

    def linear(self, at: np.ndarray, values: Mapping[str, Any] | None = None) -> LinearLoop:
        """The sampled loop linearised at rest at a pose (n,), of a robot with the parameters `values`.

        It is built from the gains of law and filter. `EquilibriumLoop` gives the same from derivatives of the traced
        step, more slowly.
        """
        s, states, plant = self.specification, self.model.states, with_values(self.smooth_plant, values)
        smooth, n = tuple(name for name in s.extras if name not in self.left_out), len(self.joints)
        a, b, g, c = plant.linearise(*self.robot.operating_point(at, smooth, values))
        whole = np.eye(plant.n)[[plant.index(name) for name in states]]
        c = whole if self.filter is None else c
        if at.tobytes() not in self._steps:  # robots at corners of the tolerances have the same controller
            self._steps[at.tobytes()] = self._step(at)
        memory, law = self._steps[at.tobytes()]
        return LinearLoop(
            s.period, a, b, c, np.zeros((len(c), n)), memory, law, np.zeros((len(memory), n)), np.zeros((n, n)),
            whole[:n], tuple(states[:n]), g, tuple(plant.disturbances), tuple(plant.inputs),
            delay=(s.known_latency + s.unknown_samples) * s.period,
        )  # fmt: skip

    @cached_property
    def _steps(self) -> dict[bytes, tuple[np.ndarray, np.ndarray]]:
        return {}

    def _step(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The controller's step at rest at a pose (n,): its next memory (s, s + p) and the input (n, s + p), by its
        memory and what is measured. The memory is the estimator's prediction, the inputs that have not acted yet, and
        the integrals with the half of the last error that the next step adds."""
        s, model, n = self.specification, self.model, len(self.joints)
        x, u = self.robot.operating_point(at)
        inner, driven, _, seen = model.linearise(x, u)
        moved, driven = exponential(inner, driven, s.period)
        gain, measured = np.eye(model.n), model.outputs
        if self.filter is None:
            seen, measured = np.eye(model.n), model.states
        elif isinstance(self.filter, ModalFilter):
            gain = self.filter.gain(x)
        else:
            gain = stationary_gain((moved, seen), self.filter.process_noise, self.filter.measurement_noise)
        size = model.n + (s.known_latency + 1) * n
        unit = np.eye(size + len(seen))
        prediction, integral, y = unit[: model.n], unit[size - n : size], unit[size:]
        waiting = [unit[k : k + n] for k in range(model.n, size - n, n)]  # which acts next first
        estimate = prediction + gain @ (y - seen @ prediction)
        links = tuple(model.states[:n])
        seen_links = [measured.index(name) for name in links if name in measured]
        half = 0.5 * s.period * (y[seen_links] if len(seen_links) == n else estimate[:n])
        ahead = estimate
        for late in waiting:
            ahead = moved @ ahead + driven @ late
        law = self.law.slope_at(at)
        waiting.append(law[:, : model.n] @ ahead + law[:, model.n :] @ (integral + half))
        memory = [moved @ estimate + driven @ waiting[0], *waiting[1:], integral + 2.0 * half]
        return np.vstack(memory), waiting[-1]

    def at_corner(self, at: np.ndarray, values: Mapping[str, Any]) -> CornerLoop:
        """The loop at rest at a pose (n,), of a robot with the parameters `values`."""
        loop = self.linear(at, values).closed_loop
        growth, limit = float(np.abs(loop.multipliers).max()), self.specification.damped_below_limit
        return CornerLoop(growth, *loop.damping_about(limit))

    def at_pose(self, at: np.ndarray) -> PoseLoop:
        """The loop at rest at a pose (n,)."""
        s, loop = self.specification, self.linear(at)
        soft = damped_springs(loop, self.smooth_plant, self.joints)
        extra = (s.delay_margin_limit or 0.0) * s.period

        def growth(loop: LinearLoop, extra: float = 0.0) -> float:
            return float(np.abs(loop.system(loop.delay + extra).multipliers).max())

        ripple = float((self.noise_spread(loop)[0] / self.authority).max())
        damping, fast = loop.closed_loop.damping_about(s.damped_below_limit)
        factors = gain_limit(s), 1.0 / gain_limit(s)
        louder, softer = (growth(replace(loop, b=k * loop.b, d=k * loop.d)) for k in factors)
        return PoseLoop(
            growth=float(np.abs(loop.closed_loop.multipliers).max()), damping=damping, fast_damping=fast,
            damped_fast=soft.closed_loop.damping_about(s.damped_below_limit)[1], late=growth(loop, extra),
            damped_late=growth(soft, 2.0 * extra), louder=louder, softer=softer, ripple=100.0 * ripple,
        )  # fmt: skip

    def noise_spread(self, loop: LinearLoop) -> np.ndarray:
        """Standard deviations (2, n) of inputs, and of link positions, rad or m, by the sensors' noise and steps."""
        m, p, noise = len(self.joints), len(loop.c), np.zeros(loop.closed_loop.b.shape[1])
        if self.noise is not None:
            steps = 0.0 if self.quantisation is None else self.quantisation
            noise[m : m + p] = np.hypot(self.noise, steps / np.sqrt(12.0))
        return loop.closed_loop.spread(noise)[m:].reshape(2, m)

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

    @cached_property
    def dry_plant(self) -> tuple[tuple[str, ...], Plant, int | None]:
        """Extras of the true robot, dry friction included; its plant, and Runge–Kutta steps per period."""
        extras = self.specification.extras
        return self.plant_with_friction(np.array(self.robot.home)) or (extras, self.true_plant, None)

    @cached_property
    def _command(self) -> Callable[[bytes, bytes], tuple[Waypoints, Moving]]:
        """Plan and reference of a move; sampled robots make the moves of the nominal one."""

        @lru_cache(GOALS)
        def command(*ends: bytes) -> tuple[Waypoints, Moving]:
            plan = quintic_move(self.limits, *map(np.frombuffer, ends))
            return plan, move_reference(self.robot, plan, self.dry_friction)

        return command

    def move(
        self, ends: np.ndarray, values: Mapping[str, Any] | None = None, seed: int = 0, dwell: float = STILL
    ) -> Move:
        """A move with feedforward between the rows of `ends` (2, n), and a dwell, s; the true robot has the parameters
        `values`, and the dry friction that the robot states. The loop has held it at the start for long."""
        s, (start, goal) = self.specification, ends
        (plan, reference), controller = self._command(*map(bytes, ends)), self.controller(start)
        linear, extras = self.linear(start, values), self.dry_plant[0]
        state, held, memory = settled(self.robot, self.limits, controller, linear, start, extras, values)
        run = self.loop(controller, values).prepared(
            reference=reference, noise=self.noise,
            duration=s.period * round((plan.duration + dwell) / s.period), seed=s.seed + seed,
            initial_state=state, initial_input=held,
        )  # fmt: skip
        trajectory, *_ = replace(run, arrays=run.arrays | {"memory": memory}).run()
        return Move(plan, Response(trajectory, goal, start, self.joints), self.limits)

    def power_on(self, ends: np.ndarray, values: Mapping[str, Any], seed: int = 0) -> Response:
        """The first second at the start of a move, of a controller that does not know the robot's parameters."""
        s, at = self.specification, ends[0]
        run = self.loop(self.controller(at), values).run(
            noise=self.noise, duration=s.period * round(STILL / s.period), seed=s.seed + seed,
            initial_state=self.robot.operating_point(at, self.dry_plant[0], values)[0],
        )  # fmt: skip
        return Response(run, at, at, self.joints)

    def unknown_load(self, ends: np.ndarray, values: Mapping[str, Any]) -> float:
        """Largest difference of an input that holds the start of a move from the model's, as a share of its limit."""
        held = [self.robot.operating_point(ends[0], (), own)[1] for own in (values, None)]
        return float((np.abs(held[0] - held[1]) / self.authority).max())

    def loop(self, controller: Controller, values: Mapping[str, Any] | None = None) -> Loop:
        """A controller and the true robot with its dry friction and the parameters `values`."""
        plant, late = with_values(self.dry_plant[1], values), self.specification.unknown_delay
        return Loop(plant, controller, self.dry_plant[2], quantisation=self.quantisation, delay=late)


# The design ---------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceDesign(Judged):
    """One controller for a workspace, its loops at poses and its moves, and the judgement of both.

    Poses, moves and robots are random samples by the seed of the specification: nothing is proved between them.
    """

    setup: WorkspaceSetup  # law, estimator and controller at any pose
    poses: np.ndarray  # (N, n), link positions, rad or m
    loops: tuple[PoseLoop, ...]  # linearised and sampled, at rest at each pose
    corner_loops: tuple[CornerLoop, ...]  # of robots at corners of their tolerances; none without tolerances
    moves: tuple[Move, ...]  # of the nominal robot
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

    robot = property(attrgetter("setup.robot"))
    specification = property(attrgetter("setup.specification"))

    def controller(self, at: Any = None, **options: Any) -> Controller:
        """A new controller as it is deployed, which begins at rest at a pose (n,), by default the robot's home or,
        where that is not in the workspace, a pose in it.

        It follows references that come with states and inputs, such as `Moving`; the same one serves every pose.
        `options` are those of `flexhinf.Controller`: ``offset_time`` is by default `OFFSET_TIME`, and ``supervision``
        that of the setup, which reports and does not react.
        """
        home = np.atleast_1d(np.asarray(self.setup.workspace.home if at is None else at, dtype=float))
        return self.setup.controller(home, **{"supervision": self.setup.supervision, **options})


def design_workspace(
    robot: Robot, s: Specification, progress: Callable[[str], None] = lambda text: None
) -> WorkspaceDesign:
    """Design one controller for a workspace, and judge it at poses and in moves that the search did not use.

    Parameters
    ----------
    robot : Robot
        From `load_robot`.
    s : Specification
        Its workspace, by default all poses within the joint ranges; what the loop has to keep; sensors, noise, limits,
        period and latency.
    progress : callable, optional
        Called with what comes next, at most `workspace_stages` times.

    Raises
    ------
    InvalidInput
        For a workspace, sensors or limits that do not fit the robot.
    NumericalFailure
        Where the motors hold hardly any pose of the workspace.
    """
    check_loop(robot, s)
    s = replace(s, workspace=LIMITS) if s.workspace is None else s
    setup = tuned_setup(robot, s, stated_workspace(robot, s.workspace), progress)
    progress(f"loops at {POSES} poses")
    poses = setup.workspace.sample(POSES, POSES_SEED + 100 * s.seed)
    loops = tuple(map(setup.at_pose, poses))
    corners = robot.random_corners(POSES, POSES_SEED + 100 * s.seed)
    cornered = tuple(map(setup.at_corner, poses, corners))
    progress(f"moves between {GOALS} goals")
    goals = setup.goals(GOALS + 1, GOALS_SEED + 100 * s.seed)
    nominal = [(goals[k : k + 2], None, k) for k in range(GOALS)]
    moves, sampled, power_on = tuple(setup.move(*one) for one in nominal), (), None
    lines = (*pose_requirements(s, loops), *corner_requirements(s, cornered))
    lines += tuple(move_requirements(setup, moves, "nominal robot"))
    robots = robot.random_corners(sampled_moves(robot, s), SAMPLED_SEED + 100 * s.seed)
    others = [(nominal[k % GOALS][0], values, k) for k, values in enumerate(robots)]
    if others:
        progress("moves of sampled robots")
        sampled = tuple(setup.move(*one) for one in others)
        lines += tuple(move_requirements(setup, sampled, "robots at corners of their tolerances"))
        power_on = setup.power_on(*max(others, key=lambda one: setup.unknown_load(*one[:2])))
    if setup.dry_plant[2] is not None:  # dry friction
        lines += (standstill_requirement(setup, [*nominal, *others], [*moves, *sampled]),)
    return WorkspaceDesign(setup, poses, loops, cornered, moves, sampled, power_on, lines)


def stated_workspace(robot: Robot, stated: Any) -> Workspace:
    """The workspace of a specification; a box in space has its tool behind an @."""
    if not isinstance(stated, str):
        return workspace_of(robot, stated)
    place, _, tool = stated.partition("@")
    return workspace_of(robot, place, tool_of(tool))


def sampled_moves(robot: Robot, s: Specification) -> int:
    """How many robots at corners of their tolerances make a move each; none without tolerances."""
    return (GOALS if s.draws is None else s.draws) if robot.uncertain else 0


def workspace_stages(robot: Robot, s: Specification) -> int:
    """Largest number of calls of `progress` by `design_workspace`."""
    return len(BANDWIDTHS) + 2 + bool(sampled_moves(robot, s))


def check_loop(robot: Robot, s: Specification) -> None:
    """Refuse, before any work, numbers that do not fit the robot."""
    check_stated_units(robot, s)
    kinematics.check_fast(robot, s.period)
    kinematics.check_delay(robot, s.unknown_delay)
    robot.plant(s.measured, extras=s.extras)
    sensor_steps(robot, s.measured, s.quantisation, s.estimator)
    joint_limits(robot, s)


def tuned_setup(
    robot: Robot, s: Specification, workspace: Workspace, progress: Callable[[str], None] = lambda text: None
) -> WorkspaceSetup:
    """The fastest law whose loops at some random poses meet the requirements with a reserve, for the nominal robot and
    one at a corner of the tolerances, with the best estimator for it; or the nearest to it. With encoders of the motors
    alone what is only preferred does not count: it would cost bandwidth."""
    poses, (damping, ripple) = workspace.sample(CHOSEN_POSES, CHOSEN_SEED), pose_limits(s)
    corners, delay = robot.random_corners(CHOSEN_POSES, CHOSEN_SEED), s.delay_margin_limit
    wanted = replace(
        s, damping=min(1.0, RESERVE * damping), ripple=ripple / RESERVE, gain_margin=RESERVE * gain_limit(s),
        delay_margin=None if delay is None else RESERVE * delay,
    )  # fmt: skip
    chosen, least, order = None, [np.inf], list(zip_longest(poses, corners))
    counted = 2 if motors_alone(robot, s) else 4
    for setup in _candidates(robot, wanted, workspace, progress):
        if chosen is not None and not any(least[:3]) and setup.law.gains.weights != chosen.law.gains.weights:
            break  # a slower law
        excess = np.zeros(4)
        for k, (pose, corner) in enumerate(order):
            found = setup.at_pose(pose).excess(*pose_limits(wanted), s.period)
            found[counted:] = 0.0
            if corner is not None:
                loop = setup.at_corner(pose, corner)
                lacking = 1.0 - loop.damping / (RESERVE * corner_damping(s))
                found[0] = max(found[0], lacking, np.log(loop.growth) / s.period)
            excess = np.maximum(excess, found)
            if chosen is not None and excess.tolist() >= least:
                order.insert(0, order.pop(k))  # the next candidate may fail here too
                break
        else:
            chosen, least = setup, (LESS * excess).tolist()
        if not any(least):
            break
    assert chosen is not None
    return replace(chosen, specification=s)


def _candidates(
    robot: Robot, s: Specification, workspace: Workspace, progress: Callable[[str], None]
) -> Iterator[WorkspaceSetup]:
    """Laws and estimators in the order in which they are tried, the fastest law first."""
    modal = workspace.sample(MODAL_POSES, CHOSEN_SEED)
    problem = robot.problem(penalty=Penalty({"link_position": 1.0}))
    stated = s.estimator == "none" or s.process_noise is not None or s.torque_noise is not None
    for bandwidth in BANDWIDTHS:
        progress(f"gains of the pairs: {bandwidth:g} rad/s")
        weights, tried = (pair_weights(robot, bandwidth),), RANDOM
        if motors_alone(robot, s):
            weights, tried = (replace(weights[0], **MOTORS_WEIGHTS), *weights), MOTORS_RANDOM
        for own in weights:
            law = ModalLaw.tuned(problem, s.period, own, modal)
            for random in tried[: 1 if stated else None]:
                yield WorkspaceSetup(robot, s, workspace, law, random)


def motors_alone(robot: Robot, s: Specification) -> bool:
    """Whether there is an estimator, and it sees the motors and nothing else."""
    return s.estimator != "none" and all(y.startswith("motor") for y in robot.plant(s.measured).outputs)


def pair_weights(robot: Robot, bandwidth: float, gamma: float = GAMMA) -> PairWeights:
    """Weights of pairs with encoders of links, for a bandwidth, rad/s, and γ/γ*."""
    share = SHARE[bool(stated_friction(robot.plant_parameters()))]
    return PairWeights(bandwidth=bandwidth, share=share, integral=INTEGRAL, gamma=gamma)


def pose_limits(s: Specification) -> tuple[float, float]:
    """Least damping of slow oscillations, and largest ripple, per cent."""
    return DAMPING if s.damping is None else s.damping, RIPPLE if s.ripple is None else s.ripple


def gain_limit(s: Specification) -> float:
    """Factor by which all inputs may grow or shrink at once."""
    return GAIN if s.gain_margin is None else s.gain_margin


def pose_requirements(s: Specification, loops: Sequence[PoseLoop]) -> list[Requirement]:
    """Requirements on the loops at all poses."""
    where, (damping, ripple), gain = f"{len(loops)} random poses, sampled loop", pose_limits(s), gain_limit(s)
    extra = 1e3 * s.period * (s.delay_margin_limit or 0.0)
    gains = [max(loop.louder, loop.softer) for loop in loops]
    unstable = {
        "unstable poses": [loop.growth for loop in loops],
        f"poses unstable with {extra:g} ms more delay": [loop.late for loop in loops],
        f"poses unstable with a gain of {gain:g} or {1.0 / gain:.3g}": gains,
    }
    row = REQUIREMENTS["corners"]
    return [
        *(replace(row, what=what, criterion="a pole outside the unit circle").judge(
            None, 0.0, int(np.sum(np.array(growths) >= 1.0)), where) for what, growths in unstable.items()),
        required.damping_requirement(s, damping, min(l.damping for l in loops), s.damped_below_limit, where),
        REQUIREMENTS["ripple"].judge(s, ripple, max(loop.ripple for loop in loops), where,
            criterion="largest standard deviation of an input by the noise of the sensors, per cent of its limit"),
    ]  # fmt: skip


def corner_damping(s: Specification) -> float:
    """Least damping of slow oscillations of robots at corners of their tolerances; a smaller one rings."""
    return min(RINGS, pose_limits(s)[0])


def corner_requirements(s: Specification, loops: Sequence[CornerLoop]) -> list[Requirement]:
    """Requirements on the loops of robots at corners of their tolerances."""
    if not loops:
        return []
    where = f"{len(loops)} random poses, each of another robot at a corner of the tolerances"
    unstable = int(np.sum([loop.growth >= 1.0 for loop in loops]))
    damping = min(loop.damping for loop in loops)
    return [
        REQUIREMENTS["corners"].judge(None, 0.0, unstable, where),
        required.damping_requirement(None, corner_damping(s), damping, s.damped_below_limit, where),
    ]


def move_requirements(setup: WorkspaceSetup, moves: Sequence[Move], which: str) -> list[Requirement]:
    """Requirements on each kind of motion, for the worst of the moves."""
    lines: dict[str, Requirement] = {}
    s, where = setup.specification, f"the worst of {len(moves)} moves, {which}"
    for move in moves:
        for line in required.motion_requirements(s, setup.limits, move.motion, 0.0, where, rests=True):
            other = lines.get(line.what)
            if other is None or line.found / line.limit > other.found / other.limit:
                lines[line.what] = line
    return list(lines.values())


def standstill_requirement(setup: WorkspaceSetup, runs: Sequence[Any], moves: Sequence[Move]) -> Requirement:
    """The requirement that links rest, for the move at whose end they swing most, made again with a longer rest;
    `runs` are the arguments of `WorkspaceSetup.move`. What the linear loop does by noise is no limit cycle."""
    worst = int(np.argmax([move.swing.max() for move in moves]))
    noisy = LARGEST_OF_NOISE * setup.noise_spread(setup.linear(runs[worst][0][1], runs[worst][1]))[1]
    noisy[~np.isfinite(noisy)] = 0.0  # an unstable loop, which friction may hold for a while
    resolution = np.maximum(setup.position_resolution(DEVIATIONS), noisy)
    swing, where = setup.move(*runs[worst], dwell=LONG).swing, f"{LONG:g} s of rest after the worst move"
    return required.standstill_requirement(setup.specification, setup.limits, swing, resolution, where)
