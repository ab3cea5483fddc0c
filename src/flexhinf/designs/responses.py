"""Responses of a loop to a step, to a load torque and along a planned move, and their use of the joints' limits.

The design's own law fixes the scenario, so all laws of a comparison have the same command, load, move, robots and
seeds.

The limits of inputs, speeds and positions of each joint come from the specification or the robot.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from flexhinf.designs.drives import check_loop_of_drives
from flexhinf.designs.motions import Plan, plan_ends
from flexhinf.designs.requirements import STILL, Motion, on_motions
from flexhinf.designs.specification import FIELDS, Specification, per_joint
from flexhinf.loop import Trajectory
from flexhinf.loop.simulation import metrics
from flexhinf.plant import Plant
from flexhinf.robot import Robot, kinematics, signals
from flexhinf.robot.command_limits import command_limits
from flexhinf.robot.drive_limits import per_second
from flexhinf.robot.drives import DriveKind

#: Default step: rad for a joint that turns, m for one that slides.
TURN, SLIDE = 0.1, 0.01

#: Length of a run: in time constants of the slowest mode, and the shortest and longest run, s.
TIME_CONSTANTS, SHORTEST, LONGEST = 8.0, 0.5, 20.0

#: The transient of a run is over after this multiple of its settling time: an exponential that is within 2 % of its
#: step by then is within 0.04 % after twice the time.
TRANSIENT = 2.0

#: Default load, as a fraction of the motor torque at the peak input of the step.
LOAD_FRACTION = 0.1

#: The load begins at this fraction of its run.
LOAD_START = 0.1

#: Robots sampled within the tolerances by default: (largest number of states, robots).
SAMPLES = ((15, 200), (10_000, 20))


@dataclass(frozen=True, eq=False)
class Scenario:
    """The runs that every law is evaluated in."""

    step_duration: float  # Of the step, bumpless or as a jump, s
    load: np.ndarray  # (n,). Constant torques on the links, N·m or N
    load_duration: float  # Of the run with the load, s; the load begins at `LOAD_START` of it
    plan: Plan  # The move from start to goal, or the stated one
    robots: tuple[Mapping[str, Any], ...]  # Parameters of the robots sampled within their tolerances
    sub_steps: int  # Runge–Kutta steps per period of the true plant
    dwell: float | None = None  # How long the move is observed at its end, s; None for half of its duration


def default_start(robot: Robot, goal: np.ndarray) -> np.ndarray:
    """Start (n,) of a small step to the goal, towards the middle of each joint's range (down where it has none)."""
    start = np.array(goal, dtype=float)
    for joint, (limits, slides) in enumerate(zip(robot.links.limits, robot.links.slides)):
        size, (low, high) = SLIDE if slides else TURN, limits or (-np.inf, np.inf)
        up = np.isfinite(low + high) and goal[joint] < (low + high) / 2.0
        start[joint] = np.clip(goal[joint] + (size if up else -size), low, high)
    return start


def start_and_goal(robot: Robot, s: Specification, move: Plan | None) -> tuple[np.ndarray, np.ndarray]:
    """Link positions (n,) between which the step goes: as stated; the goal is by default the end of a move."""
    n = len(robot.joint_names)
    end = None if move is None else np.reshape(move(move.duration), -1)
    goal = robot.operating_point(end if s.pose is None else s.pose)[0][:n]
    return default_start(robot, goal) if s.start is None else robot.operating_point(s.start)[0][:n], goal


def with_values(plant: Plant, values: Mapping[str, Any] | None) -> Plant:
    """A plant with those of these parameters that it has."""
    return plant if values is None else plant.with_parameters(**plant.parameters.known(values))


def run_length(slowest: float) -> float:
    """Length of a run, s, for the slowest decay rate (1/s); `LONGEST` for a loop that does not decay."""
    length = math.ceil(2.0 * TIME_CONSTANTS / slowest) / 2.0 if slowest > 0.0 else LONGEST
    return min(max(length, SHORTEST), LONGEST)


def default_load(per_input: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """`LOAD_FRACTION` of the torques (n,) that the motors give at the peak inputs of a step, with the same signs.

    `per_input`: torque per unit of input (n,). A motor's peak input (n,) counts as at least a tenth of the largest one.
    """
    return LOAD_FRACTION * per_input * np.maximum(peak, LOAD_FRACTION * peak.max())


def sample_count(robot: Robot, states: int, stated: int | None) -> int:
    """Number of sampled robots: as stated, or by the number of states; zero for a robot without tolerances."""
    count = next(count for most, count in SAMPLES if states <= most) if stated is None else stated
    return count if robot.uncertain else 0


def sample_robots(robot: Robot, count: int, seed: int) -> tuple[Mapping[str, Any], ...]:
    """Parameters of robots that are uniformly distributed within their tolerances, the same for the same seed."""
    generator = np.random.default_rng([seed, 7])
    return tuple(robot.draw(generator) for _ in range(count))


@dataclass(frozen=True)
class Worst:
    """The worst value of all joints and its joint.

    The value is infinite where a run diverged (then the joint is empty), or where a joint never settles.
    """

    value: float
    joint: str


def worst_of(rows: list[dict[str, Any]], key: str) -> Worst:
    """The largest value of `key` in rows of metrics. None counts as infinite; a row without the key is not counted.

    Infinite without any row (the run diverged), zero where no joint has the metric.
    """
    counted = [row for row in rows if key in row]
    if not counted:
        return Worst(0.0 if rows else np.inf, "")
    values = [np.inf if row[key] is None else float(row[key]) for row in counted]
    k = int(np.argmax(values))
    return Worst(values[k], counted[k]["joint"])


def _worst(key: str, doc: str) -> Worst:
    return cast("Worst", property(lambda response: worst_of(response.metrics, key), doc=doc))


@dataclass(frozen=True, eq=False)
class Response:
    """One run to its end, or to where it diverged; goal and start are link positions (n,), rad or m."""

    run: Trajectory
    goal: np.ndarray
    start: np.ndarray
    joints: tuple[str, ...]

    @property
    def diverged_at(self) -> float | None:
        """When the loop left the finite numbers, s; None for a run that was completed."""
        return self.run.diverged_at

    @cached_property
    def positions(self) -> np.ndarray:
        """True link positions (N, n)."""
        return self.run.signals["state"][:, : len(self.goal)]

    @property
    def inputs(self) -> np.ndarray:
        """Inputs of the motors (N, m)."""
        return self.run.signals["input"]

    @property
    def peak_inputs(self) -> np.ndarray:
        """Largest |input| of each motor (m,), up to where a run diverged."""
        return metrics.peak_of(self.inputs)

    @property
    def velocities(self) -> np.ndarray:
        """True link velocities (N, n)."""
        return self.run.signals["state"][:, len(self.goal) : 2 * len(self.goal)]

    @cached_property
    def metrics(self) -> list[dict[str, Any]]:
        """Metrics of each joint's true link position; an empty list where the run diverged.

        Keys: joint, overshoot_percent, settling_time_s, rise_time_s (these three only of joints that move; None: not
        within the run), steady_state_error, peak_input, peak_speed, input_noise.
        """
        if self.diverged_at is not None:
            return []
        rows = list[dict[str, Any]]()
        for k, (name, begin, end) in enumerate(zip(self.joints, self.start, self.goal)):
            position, u = self.positions[:, k], self.inputs[:, k]
            shape = metrics.step_metrics(
                self.run.time, position, metrics.StepShape(float(begin), float(end), 0.0)
            )
            rows.append(
                {
                    "joint": name,
                    **(shape if begin != end else {}),
                    "steady_state_error": metrics.steady_state_error(position, np.full(len(position), end)),
                    "peak_input": float(metrics.peak_of(u)),
                    "peak_speed": float(metrics.peak_of(self.velocities[:, k])),
                    "input_noise": float(metrics.tail_of(u).std()),
                }
            )
        return rows

    peak = _worst("peak_input", "Largest |input| of all motors, with the joint that it drives.")

    @property
    def peak_input(self) -> float:
        """Largest |input| of all motors; infinite where the run diverged."""
        return self.peak.value

    overshoot = _worst(
        "overshoot_percent", "Largest overshoot of all joints that move, per cent of the joint's own step."
    )
    settling = _worst("settling_time_s", "Slowest settling to ±2 % of the joint's own step, s.")
    remaining = _worst("steady_state_error", "Largest error in the last tenth of the run, rad or m.")


def rests(run: Response, begun: float = 0.0) -> bool:
    """Whether the end of a run to rest, in which the remaining error and the ripple are judged, begins after its
    transient; a longer run is no other where this one diverged. `begun`: when its command ends, s."""
    over = transient_end(run, begun)
    return run.diverged_at is not None or bool(run.run.time[-1] - metrics.WINDOW >= over - metrics.ROUNDING)


def transient_end(run: Response, begun: float = 0.0) -> float:
    """When the transient of a run to rest is over, s; infinite where it does not settle. `begun` as of `rests`."""
    return begun + TRANSIENT * max(run.settling.value - begun, 0.0)


def settled_run(run: Response, again: Callable[[float], Response], begun: float = 0.0) -> Response:
    """The run, or the first longer one that `rests`, up to `LONGEST`; `again` makes one of a length, s."""
    while not rests(run, begun) and (length := float(run.run.time[-1])) < LONGEST * (1.0 - metrics.ROUNDING):
        run = again(min(2.0 * length, LONGEST))
    return run


@dataclass(frozen=True, eq=False)
class LoadResponse:
    """A run at the goal with constant torques on all links."""

    response: Response  # In equilibrium at the goal, until the torques begin
    load: np.ndarray  # (n,), N·m or N
    at: float  # When they begin, s
    # (n,). The step whose 2 % are the band that recovery is judged by: that from start to goal, rad or m
    reference_step: np.ndarray

    @cached_property
    def metrics(self) -> list[dict[str, Any]]:
        """Metrics of each joint; an empty list where the run diverged.

        Keys: joint, load, peak_deviation, recovery_time_s (from the load's beginning to the last time outside 2 % of
        the reference step; None: not within the run), remaining_error (largest deviation in the last tenth).
        """
        run = self.response
        if run.diverged_at is not None:
            return []
        columns = zip(run.joints, self.load, run.positions.T, run.goal, self.reference_step)
        return [
            {"joint": name, "load": float(load)}
            | metrics.load_metrics(
                run.run.time, position, command=float(goal), step=float(step), start=self.at
            )
            for name, load, position, goal, step in columns
        ]

    deflection = _worst("peak_deviation", "Largest deviation of a link, rad or m.")
    recovery = _worst("recovery_time_s", "Slowest return to within 2 % of the reference step, s.")
    remaining = _worst("remaining_error", "Largest deviation in the last tenth of the run, rad or m.")


@dataclass(frozen=True, eq=False)
class Move:
    """A planned move with feedforward, followed in error coordinates, or a jump of the command."""

    plan: Plan
    response: Response  # Its start and goal are the ends of the plan
    limits: JointLimits

    @staticmethod
    def along(plan: Plan, response: Response, limits: JointLimits) -> Move:
        """A run along a plan, its goal where the plan ends."""
        return Move(plan, replace(response, goal=plan_ends(plan)[1]), limits)

    @cached_property
    def planned(self) -> np.ndarray:
        """Link positions of the plan at the samples of the run (N, n), rad or m."""
        time = self.response.run.time
        return np.reshape(self.plan(time), (len(time), -1))

    @property
    def error(self) -> np.ndarray:
        """Link positions minus the plan (N, n), rad or m."""
        return self.response.positions - self.planned

    @property
    def travel(self) -> np.ndarray:
        """Travel (n,) of each joint: distance of its extreme positions on the way, rad or m."""
        return np.ptp(np.vstack([self.response.start, self.planned]), axis=0)

    @cached_property
    def metrics(self) -> list[dict[str, Any]]:
        """Metrics of each joint; an empty list where the run diverged. Keys: joint, largest_error, rms_error,
        peak_input, peak_speed, final_error (the largest in the last tenth of the run)."""
        if self.response.diverged_at is not None:
            return []
        return [
            {
                "joint": row["joint"],
                "largest_error": float(metrics.peak_of(position - planned)),
                "rms_error": float(np.sqrt(cast("float", np.mean((position - planned) ** 2)))),
                "peak_input": row["peak_input"],
                "peak_speed": row["peak_speed"],
                "final_error": metrics.steady_state_error(position, planned),
            }
            for row, position, planned in zip(
                self.response.metrics, self.response.positions.T, self.planned.T
            )
        ]

    @cached_property
    def motion(self) -> list[dict[str, Any]]:
        """`motion_metrics` of the move."""
        return motion_metrics(self.limits, self.response, self.plan)

    @cached_property
    def swing(self) -> np.ndarray:
        """Amplitude (n,) of each link position in the last half of the rest after the plan, rad or m; infinite where
        the run diverged."""
        run, rests = self.response, self.response.run.time > self.plan.duration
        if run.diverged_at is not None:
            return np.full(len(run.goal), np.inf)
        return np.array(
            [metrics.limit_cycle(run.run.time[rests], q).amplitude for q in run.positions[rests].T]
        )

    largest = _worst("largest_error", "Largest error behind the plan, rad or m.")
    remaining = _worst("final_error", "Largest error in the last tenth of the run, rad or m.")
    peak = _worst("peak_input", "Largest |input| of all motors.")


#: How many times the speed limit a command of a drive with its own loop may ask for.
CLAMPED = 1.5

#: Source of a limit that no option states.
ROBOT = "the robot's file"


class Bound(NamedTuple):
    """A limit of each joint (n,), with its units (n,), and what states it."""

    limit: np.ndarray
    units: tuple[str, ...]
    source: str


def _limited(name: str, doc: str) -> bool:
    return cast("bool", property(lambda limits: bool(np.isfinite(getattr(limits, name)).any()), doc=doc))


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of inputs, speeds and positions, one number per joint; infinite where there is none."""

    joints: tuple[str, ...]
    peak: np.ndarray  # (n,). Required limit of the absolute input, V, or N·m (N)
    saturation: np.ndarray  # (n,). Limits ± of controller and motors
    speed: np.ndarray  # (n,). Largest absolute velocity of the links, rad/s or m/s
    # lower, upper: (n,). Ranges of the link positions, rad or m
    lower: np.ndarray
    upper: np.ndarray
    effort_units: tuple[str, ...]
    speed_units: tuple[str, ...]
    position_units: tuple[str, ...]
    # peak_source, saturation_source, speed_source: The option that states them, or `ROBOT`
    peak_source: str
    saturation_source: str
    speed_source: str
    # rate, acceleration: (n,). Largest changes of the inputs that the drives take, per s and per s²
    rate: np.ndarray
    acceleration: np.ndarray
    # clamp: (n,). Largest speeds that commands of a drive with its own loop may ask for: controllers keep them, no plan
    clamp: np.ndarray
    drive: DriveKind
    period: float  # Time between two inputs, s

    @property
    def effort(self) -> np.ndarray:
        """Effort limit of each motor (n,): the smaller of the required one and the saturation."""
        return np.minimum(self.peak, self.saturation)

    @property
    def saturated(self) -> np.ndarray | None:
        """Limits (n,) of a controller: those of the motors, and stated peaks below them; None where there is none."""
        limits = self.saturation if self.peak_source == ROBOT else self.effort
        limits = np.minimum(limits, self.clamp) if self.drive.takes_velocities else limits
        return limits if np.isfinite(limits).any() else None

    @property
    def input_rate(self) -> np.ndarray | None:
        """Largest rates (n,) of the inputs, which a controller keeps; None where there is none."""
        rate = np.minimum(self.rate, self.clamp) if self.drive.takes_positions else self.rate
        return rate if np.isfinite(rate).any() else None

    @property
    def limits_inputs(self) -> bool:
        """Whether a controller has a limit of some input, or of its rate."""
        return self.saturated is not None or self.input_rate is not None

    limits_rate = _limited("rate", "Whether the rate of any input has a limit.")
    limits_acceleration = _limited("acceleration", "Whether the acceleration of any input has a limit.")
    limits_peak = _limited("peak", "Whether the peak input of any joint has a limit.")
    limits_effort = _limited("effort", "Whether any input has a limit, required or by saturation.")
    limits_speed = _limited("speed", "Whether the speed of any joint has a limit.")

    @property
    def span(self) -> np.ndarray:
        """Length of the range of each joint (n,), rad or m; one turn, or infinite, where there is none."""
        turn = np.where(np.array(self.position_units) == "rad", 2.0 * np.pi, np.inf)
        return np.where(np.isfinite(self.upper - self.lower), self.upper - self.lower, turn)

    def bound(self, name: str) -> Bound:
        """The limit of a requirement that limits of the joints bound; of a range its length."""
        per_time = [tuple(per_second(unit, order) for unit in self.effort_units) for order in (1, 2)]
        return {
            "peak": Bound(self.peak, self.effort_units, self.peak_source),
            "speed": Bound(self.speed, self.speed_units, self.speed_source),
            "range": Bound(self.span, self.position_units, ROBOT),
            "input_rate": Bound(self.rate, per_time[0], ROBOT),
            "input_acceleration": Bound(self.acceleration, per_time[1], ROBOT),
        }[name]


#: Points of a path from which distances are measured.
PATH_POINTS = 400


def motion_of(limits: JointLimits, run: Response, plan: Plan | None = None) -> Motion:
    """A run that did not diverge as requirements measure it, along a plan, by default the straight one of a step, as of
    a jump."""
    time, planned, path = (
        run.run.time,
        np.tile(run.goal, (len(run.run.time), 1)),
        np.array([run.start, run.goal]),
    )
    plan = None if plan is not None and plan.duration == 0.0 else plan
    if plan is not None:
        instants = np.linspace(0.0, plan.duration, PATH_POINTS), time
        path, planned = (np.reshape(plan(t), (len(t), -1)) for t in instants)
    duration = 0.0 if plan is None else plan.duration
    return Motion(
        time=time,
        positions=run.positions,
        velocities=run.velocities,
        inputs=run.inputs,
        planned=planned,
        path=path,
        duration=duration,
        step=True,
        plans=plan is not None,
        rests=plan is None or time[-1] - duration >= metrics.WINDOW,
        effort=limits.effort,
        span=limits.span,
        lower=limits.lower,
        upper=limits.upper,
        kept=np.full(len(limits.joints), np.inf) if limits.saturated is None else limits.saturated,
        rate=limits.rate,
        period=limits.period,
        slides=np.array(limits.position_units) == "m",
    )


def motion_metrics(limits: JointLimits, run: Response, plan: Plan | None = None) -> list[dict[str, Any]]:
    """Metrics of the motion of each joint along a plan, by default the straight one of a step; an empty list where the
    run diverged.

    Keys: joint, travel (rad or m), excursion_percent (of one that should rest; None where no travel compares with it),
    and the `metric` of each kind of requirement that measures motions, of joints that have it: wrong_way_percent (of a
    joint that moves), path_distance, tracking_error (along a plan) and remaining_error (rad or m), ripple_percent (of a
    motor with a limit). The last two are those of joints at rest, so a run that ends too soon after its plan has none.
    """
    if run.diverged_at is not None:
        return []
    motion = motion_of(limits, run, plan)
    columns = {
        kind.metric: values
        for kind in on_motions()
        if not (kind.steps or kind.bounded) and (values := kind.measured(motion)) is not None
    }
    rows = list[dict[str, Any]]()
    for k, (joint, q) in enumerate(zip(run.joints, run.positions.T)):
        own: dict[str, Any] = {"joint": joint, "travel": float(motion.travel[k])}
        if not motion.moves[k]:
            largest, at = motion.largest[k], motion.path[0, k]
            own["excursion_percent"] = metrics.excursion(q, at, largest) if largest > STILL else None
        rows.append(own | {name: float(x[k]) for name, x in columns.items() if not np.isnan(x[k])})
    return rows


def joint_limits(robot: Robot, s: Specification) -> JointLimits:
    """The limits of a specification, and those of the robot where it states none.

    Raises InvalidInput: for a loop that commands the robot's drives more often, or earlier, than they take it.
    """
    check_loop_of_drives(robot, s)
    joints, effort = robot.joint_names, robot.effort_limits
    own = {"peak_effort": effort, "saturation": effort, "peak_speed": robot.speed_limits}
    stated = {name: getattr(s, name) for name in own}
    values: list[Any] = [
        np.array(own[name], dtype=float) if value is None else per_joint(joints, name, value)
        for name, value in stated.items()
    ]
    sources = (ROBOT if value is None else FIELDS[name].option for name, value in stated.items())
    pairs = robot.drive_kind.units, signals.UNITS["link_velocity"], signals.UNITS["link_position"]
    units = (tuple(pair[slides] for slides in robot.links.slides) for pair in pairs)
    changes = dict(zip(("rate", "acceleration"), command_limits(robot)))
    ends = kinematics.position_ranges(robot)
    turned, speeds = np.abs(robot.layout.matrix), values[2]
    known = np.where(np.isfinite(speeds), speeds, 0.0)
    unknown = turned[:, ~np.isfinite(speeds)].any(axis=1)
    clamp = np.where(unknown, np.inf, CLAMPED * (turned @ known))
    own = {"clamp": clamp, "drive": robot.drive_kind, "period": s.period}
    return JointLimits(joints, *values, *ends, *units, *sources, **changes, **own)


def integral_dead_zone(joints: Sequence[str], stated: Any, chosen: np.ndarray | None) -> np.ndarray | None:
    """Errors (n,) that are not integrated, rad or m: as stated, or `chosen`; None without any."""
    zone = chosen if stated is None else stated
    return per_joint(joints, "integral_dead_zone", zone) if zone is not None and np.any(zone) else None
