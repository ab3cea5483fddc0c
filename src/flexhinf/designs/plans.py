"""Commands from one pose to another: the shaped step, the planned move, and the stated move; a settled start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np

from flexhinf.analysis import LinearLoop, modes
from flexhinf.designs.motions import Plan, plan_ends
from flexhinf.designs.problem.weights import required_bandwidth
from flexhinf.designs.responses import JointLimits, joint_limits, start_and_goal
from flexhinf.designs.specification import RUN_SAMPLES, Specification
from flexhinf.errors import InvalidInput
from flexhinf.loop import Backlash, Controller, DryFriction, JerkLimited, Moving, Waypoints
from flexhinf.plant import Law, Parameters
from flexhinf.robot import Robot, check_reference, elastic, kinematics
from flexhinf.robot.command_limits import check_commands, command_limits, command_shares
from flexhinf.robot.drive_limits import largest_drive_torques
from flexhinf.robot.parameters import per_joint
from flexhinf.robot.springs import DAMPED, DAMPING
from flexhinf.robot.waypoints import WaypointError, WaypointTable
from flexhinf.robot.workspace import ranges
from flexhinf.validation import value_text

#: Duration of a quintic times the bandwidth, such that the quintic keeps the limits below.
QUINTIC_TIME = 4.7

#: Moves of a workspace: share of the speed limits, speed without one (rad/s, m/s), shortest duration, s, and rest at
#: the end, s.
SPEED, UNLIMITED, SHORTEST, STILL = 0.5, 0.6, 0.5, 1.0

#: A spline through waypoints may go beyond two neighbouring ones by this fraction of the joint's way.
BEYOND = 0.02

#: Shortest move, in sampling periods: a loop does not follow a shorter one.
MOVE_SAMPLES = 10

#: Most instants at which a stated move is checked.
INSTANTS = 20_000


#: Limits of the move's velocity, acceleration and jerk, as multiples of the travel times ω, ω², ω³ for a bandwidth ω.
VELOCITY, ACCELERATION, JERK = 0.4, 0.4, 0.8

#: How often a settled pose is corrected where the links are beside the command.
CORRECTIONS = 4

#: Distance by which slopes of what is wrong at rest are found, rad or m.
SMALL = 1e-6

#: Largest fraction of the effort limit, after the holding input, that feedforward may use; the rest is left for
#: feedback. The second factor slows the move until it keeps this, at most as often as the third number says.
EFFORT_FRACTION, STRETCH, STRETCHES = 0.7, 1.15, 25

#: Largest speed of a move of degree 9 over that of a quintic of the same time.
OF_DEGREE_9 = (630.0 / 256.0) / 1.875

#: Instants at which a move of a workspace is checked.
ON_THE_WAY = 41

#: Smallest travel of a joint for the limits of its plan, as a fraction of the largest travel: also a resting joint
#: needs limits.
MIN_TRAVEL = 1e-3


def has_integrals(law: Law) -> bool:
    """Whether a law integrates the error of link positions, so that a command enters through the integrals."""
    return any(name.endswith("_integral") for name in law.state_names)


def step_command(
    robot: Robot, s: Specification, start: np.ndarray, goal: np.ndarray, law: Law | None = None
) -> Plan | None:
    """The command of the step from start to goal by the shaping; None for a jump, or where the law does not take one.

    The command does not depend on the law, so that laws are compared with the same command. It is planned for the
    stated or default bandwidth.
    """
    if s.shaping == "jump" or not np.any(goal != start) or (law is not None and not has_integrals(law)):
        return None
    scales = modes.JointScales.of(robot.plant(), robot.operating_point(goal))
    bandwidth = required_bandwidth(s.bandwidth, scales, len(goal))
    holding_inputs = [robot.operating_point(at)[1] for at in (start, goal)]
    return plan_move(robot, s, start, goal, bandwidth, float(scales.vibration.min()), holding_inputs)


def plan_move(
    robot: Robot,
    s: Specification,
    start: np.ndarray,
    goal: np.ndarray,
    bandwidth: np.ndarray,
    slowest_vibration: float,
    holding_inputs: Sequence[np.ndarray],
) -> Plan:
    """The move from start to goal for this bandwidth, slowed down until it keeps the joints' limits of speed and
    effort.

    `robot`, `s`: limits of effort and speed are the specification's, or the robot's.
    `start`, `goal`, `bandwidth`: (n,), Link positions, rad or m, and rad/s.
    `slowest_vibration`: its period smooths the plan, rad/s.
    `holding_inputs`: inputs that hold the robot at start and goal; feedforward may use a part of the remaining limit.
    """
    limits, limit = joint_limits(robot, s), None
    if limits.limits_effort:  # the largest input (n,) that the feedforward may use of each motor
        needed = np.abs(holding_inputs).max(axis=0)
        limit = needed + EFFORT_FRACTION * np.maximum(0.0, limits.effort - needed)
    travel = np.abs(goal - start)
    travel = np.maximum(travel, MIN_TRAVEL * max(float(travel.max()), 1e-6))
    for k in range(STRETCHES):
        rate = np.asarray(bandwidth, dtype=float) / STRETCH**k
        if s.shaping == "quintic":
            plan: Plan = Waypoints([0.0, QUINTIC_TIME / float(rate.min())], [start, goal], "quintic")
        else:
            plan = JerkLimited(
                start,
                goal,
                VELOCITY * travel * rate,
                ACCELERATION * travel * rate**2,
                JERK * travel * rate**3,
                smoothing=2.0 * math.pi / slowest_vibration,
            )
        try:
            check_reference(robot, plan, plan.duration, limit, s.period, limits.speed)
        except InvalidInput:
            if (limit is None and not limits.limits_speed) or k == STRETCHES - 1:
                raise
        else:
            if k == STRETCHES - 1 or (_drives_spare(robot, plan) and _changes_slowly(robot, plan, s.period)):
                return plan
    raise AssertionError("unreachable")


def shortest_time(limits: JointLimits, start: np.ndarray, goal: np.ndarray) -> float:
    """The duration of a quintic from pose to pose (n,) at half the speed limits, s."""
    speed = np.where(np.isfinite(limits.speed), limits.speed, UNLIMITED)
    return max(SHORTEST, float(np.max(1.875 * np.abs(goal - start) / (SPEED * speed))))


def quintic_move(robot: Robot, limits: JointLimits, start: np.ndarray, goal: np.ndarray) -> Waypoints:
    """A quintic from pose to pose (n,): how a controller for a workspace is sent anywhere.

    It keeps half the speed limits, and is slowed down while a motor of the heaviest robot of the tolerances would need
    more than `EFFORT_FRACTION` of what its weight leaves of the limit, or a command more than that of its largest rate
    or acceleration. Where a drive limits accelerations it is of degree 9: of a quintic the jerk, and with it the
    command, jumps at its ends.
    """
    smooth = limits.limits_acceleration
    shortest = shortest_time(limits, start, goal) * (OF_DEGREE_9 if smooth else 1.0)

    def plan(stretch: int) -> Waypoints:
        profile = "through" if smooth else "quintic"
        return Waypoints([0.0, shortest * STRETCH**stretch], [start, goal], profile)

    slower = (each for each in map(plan, range(STRETCHES)) if _spares(robot, limits, each))
    return next(slower, None) or plan(0)


def _spares(robot: Robot, limits: JointLimits, plan: Waypoints) -> bool:
    """Whether the motors of the heaviest robot move it along a plan with a part of what its weight leaves of them."""
    if not (_drives_spare(robot, plan) and _changes_slowly(robot, plan, limits.period)):
        return False
    if not limits.limits_effort:
        return True
    motion = plan.derivatives(np.linspace(0.0, plan.duration, ON_THE_WAY))
    weight, whole = (
        np.abs(robot.inverse_dynamics(*rows, parameters=robot.heaviest)[1]) for rows in (motion[:1], motion)
    )
    return bool(np.all(whole <= weight + EFFORT_FRACTION * np.maximum(limits.effort - weight, 0.0)))


def drive_torques(
    robot: Robot, motion: Sequence[Any] | np.ndarray, values: Mapping[str, Any] | None = None
) -> np.ndarray:
    """Torques (N, n) of motors with an inner loop along a motion of the links, one to five arrays (N, n), of a robot
    with the parameters `values`."""
    x, u = robot.inverse_dynamics(*motion, parameters=values)
    p = Parameters({**robot.plant_parameters(), **(values or {})})
    q, dq, angle, speed = robot.layout.split(x.T)
    motors, speeds = robot.layout.motors(q, angle).T, robot.layout.motors(dq, speed).T
    springs = robot.layout.elastic
    twists = ((angle - robot.layout.at_springs(q)).T, (speed - robot.layout.at_springs(dq)).T)
    load = np.broadcast_to(p.friction, u.shape) * speeds
    load[:, springs] += elastic.spring_torque(*twists, p, elastic.stated_curve(vars(p)))
    loop = robot.drive_kind.driven(u, motors, speeds, p, limited=True).torque
    return loop + (1.0 - p.load_share) * load


def holding_shares(robot: Robot, poses: np.ndarray, values: Mapping[str, Any] | None = None) -> np.ndarray:
    """The largest share (N,) of a drive's torque that holds a robot at poses (N, n); 0 without a limit."""
    most = largest_drive_torques(Parameters(robot.plant_parameters()), len(robot.joint_names))
    if not np.isfinite(most).any():
        return np.zeros(len(poses))
    return np.max(np.abs(drive_torques(robot, (poses,), values)) / most, axis=1)


def _drives_spare(robot: Robot, plan: Plan) -> bool:
    """Whether drives of limited torque move the heaviest robot along a plan with a part of what its weight leaves."""
    most = largest_drive_torques(Parameters(robot.plant_parameters()), len(robot.joint_names))
    if not np.isfinite(most).any():
        return True
    motion = plan.derivatives(np.linspace(0.0, plan.duration, ON_THE_WAY), 4)
    weight, whole = (np.abs(drive_torques(robot, rows, robot.heaviest)) for rows in (motion[:1], motion))
    return bool(np.all(whole <= weight + EFFORT_FRACTION * np.maximum(most - weight, 0.0)))


def plan_commands(robot: Robot, plan: Plan, period: float) -> np.ndarray:
    """Commands (N, n) of the feedforward along a plan, one per period, the rest after it included."""
    times = period * np.arange(int(plan.duration / period) + 4, dtype=float)
    return robot.inverse_dynamics(*plan.derivatives(times, 4))[1]


def _changes_slowly(robot: Robot, plan: Plan, period: float) -> bool:
    """Whether the commands along a plan leave feedback a part of the largest rates and accelerations."""
    if not np.isfinite(command_limits(robot)).any():
        return True
    shares = command_shares(robot, plan_commands(robot, plan, period), period)
    return bool(np.max(shares) <= EFFORT_FRACTION)


def stated_move(robot: Robot, s: Specification) -> Plan | None:
    """The move of a specification, checked against ranges, speeds and efforts of the joints; None without one."""
    if s.move is None:
        return None
    try:
        plan = _through(robot, s, 1.0)
    except InvalidInput as error:  # the profile of a signal is the field `shaping` of a specification
        advice = error.advice.replace("profile='spline'", "shaping='jump'")
        raise WaypointError(error.what, error.found, advice) from None
    long = 1.5 * plan.duration / s.period > RUN_SAMPLES
    if long or plan.duration < MOVE_SAMPLES * s.period:
        raise WaypointError(
            f"The move takes too {'long' if long else 'little time'}.",
            f"expected {MOVE_SAMPLES * s.period:g} s, {MOVE_SAMPLES} samples, to {RUN_SAMPLES * s.period / 1.5:g} s, "
            f"got {plan.duration:g} s",
            "times in seconds; 'time [ms]' in the header where they are not",
        )
    limits = joint_limits(robot, s)
    try:
        _check(robot, s.period, plan, limits, INSTANTS)
    except InvalidInput as error:
        what, advice = error.what.replace("The reference", "The move"), _slower(robot, s, limits)
        raise WaypointError(what, error.found, advice or error.advice) from None
    return plan


def run_ends(robot: Robot, s: Specification) -> tuple[Plan | None, np.ndarray, np.ndarray]:
    """The stated move, None for a step, and the link positions (n,) where a run begins and should end, rad or m."""
    plan = stated_move(robot, s)
    return (plan, *(start_and_goal(robot, s, None) if plan is None else plan_ends(plan)))


def refuse_workspace(s: Specification, robot: Robot, what: str, advice: str = "`pose` {pose}") -> None:
    """Refuse a workspace where only one pose is looked at; `what` that is, and what to try, with a `{pose}` to move
    to."""
    if s.workspace is None:
        return
    home, (low, high) = np.array(robot.home), ranges(robot)
    goal = 0.5 * (home + cast("np.ndarray", np.where(high - home >= home - low, high, low)))
    pose = ",".join(f"{position:.3g}" for position in goal)
    raise InvalidInput(
        f"{what} is of one pose.",
        f"expected no workspace, got {value_text(s.workspace, 60)}",
        f"{advice.format(pose=pose)}: another goal or this one, in the place of the workspace",
    )


def true_robot(robot: Robot, s: Specification) -> tuple[Robot, Specification]:
    """The robot by which a design is judged, and the specification of its plants: it has the curves, errors and ripples
    of gears, the backlash, the limits of drives and the dry friction that are stated, of which `extras` may name one
    kind, and springs damped as the robot states, or as no real spring is without."""
    robot, values = robot.damped, robot.plant_parameters()
    gaps = np.any(np.asarray(values.get("backlash", 0.0)) > 0.0)
    dry = elastic.with_dry_friction(s.extras, values)
    damped = any(p.interval[1] > 0.0 for p in robot.parameters if p.name.startswith(DAMPING))
    gears = *elastic.stated_curve(values), *elastic.stated_teeth(values)
    limited = ["drive_torque_limit"] * ("drive_torque_limit" in values)
    names = *s.extras, *[DAMPED] * damped, *gears, *dry, *["backlash"] * bool(gaps), *limited
    return robot, replace(s, extras=tuple(dict.fromkeys(names)))


def stated_dry_friction(robot: Robot) -> DryFriction | None:
    """Dry friction of a robot's file, for a controller that overcomes it; None without any."""
    values, joints = robot.plant_parameters(), robot.joint_names
    if not (dry := elastic.stated_friction(values)):
        return None
    p = Parameters(values)
    gain: Any = robot.drive_kind.torque_per_input(p)
    share = robot.drive_kind.share(p)  # of friction, that the drive leaves
    quantities = ("link_velocity" if joint in robot.rigid else "motor_velocity" for joint in joints)
    speeds = [per_joint(name, joint, len(joints)) for name, joint in zip(quantities, joints)]

    def each(number: Any) -> list[float]:
        return np.broadcast_to(number, len(joints)).tolist()

    falls = "stribeck_friction" in dry
    curve = (each(share * p.static_friction / gain), each(p.stribeck_velocity)) if falls else ()
    return DryFriction(each(share * p.coulomb_friction / gain), each(p.friction_smoothing), speeds, *curve)


def stated_backlash(robot: Robot, measured: Sequence[str]) -> Backlash | None:
    """Backlash of a robot's file, for a controller with these measured signals; None without any that both sides of the
    spring are measured of."""
    width, joints = np.ravel(robot.plant_parameters().get("backlash", 0.0)), robot.joint_names
    pairs = [
        [per_joint(name, joint, len(joints)) for name in ("link_position", "motor_position")]
        for joint in joints
    ]
    coupled = [row != own for row, own in zip(robot.layout.matrix.tolist(), np.eye(len(joints)).tolist())]
    pairs = [["", ""] if other else pair for pair, other in zip(pairs, coupled)]
    seen = [
        (gap, *pair)
        for gap, pair in zip(width.tolist(), robot.layout.of_springs(np.array(pairs)).tolist())
        if gap > 0.0 and {*pair} <= {*measured}
    ]
    return Backlash(*map(list, zip(*seen))) if seen else None


def move_reference(robot: Robot, plan: Plan, dry_friction: Sequence[str] = ()) -> Moving:
    """A planned move with feedforward by inverse dynamics of the elastic robot, including these kinds of dry
    friction, where no controller with `dry_friction` adds it, and the stiffness curves of its gears."""
    extras = *dry_friction, *elastic.stated_curve(robot.plant_parameters())
    return Moving(plan, partial(robot.inverse_dynamics, extras=extras))


def _through(robot: Robot, s: Specification, factor: float) -> Plan:
    if not isinstance(s.move, WaypointTable):
        return cast("Plan", s.move)
    positions = s.move.positions(robot.joint_names, robot.links.slides)
    times, smoothing = factor * np.array(s.move.times), 0.0
    if s.shaping == "jump":
        spline = Waypoints(times, positions, "spline")
        return Waypoints(times, positions, "through") if _wanders(spline) else spline
    if s.shaping == "jerk-limited":
        pose = np.clip(positions[-1], *kinematics.position_ranges(robot))
        scales = modes.JointScales.of(robot.plant(), robot.operating_point(pose))
        smoothing = 2.0 * math.pi / float(scales.vibration.min())
    return Waypoints(times, positions, s.shaping, smoothing)


def _wanders(spline: Waypoints) -> bool:
    inside = spline.times[:-1, None] + np.linspace(0.0, 1.0, 12)[1:-1] * np.diff(spline.times)[:, None]
    between, ends = np.asarray(spline(inside)), np.stack([spline.values[:-1], spline.values[1:]])
    low, high = ends.min(axis=0)[:, None], ends.max(axis=0)[:, None]
    beyond = np.maximum(between - high, low - between).max(axis=(0, 1))
    return bool(np.any(beyond > BEYOND * np.ptp(spline.values, axis=0) + 1e-12))


def _check(robot: Robot, period: float, plan: Plan, limits: JointLimits, instants: int) -> None:
    effort = limits.effort if limits.limits_effort else None
    check_reference(robot, plan, plan.duration, effort, max(period, plan.duration / instants), limits.speed)
    if np.isfinite(command_limits(robot)).any():
        check_commands(robot, plan_commands(robot, plan, period), period)


def _slower(robot: Robot, s: Specification, limits: JointLimits) -> str:
    """Advice with the smallest power of `STRETCH` by which a slower move keeps all limits; "" if none does."""
    if not isinstance(s.move, WaypointTable):
        return ""
    for factor in (STRETCH**k for k in range(1, STRETCHES)):
        with suppress(InvalidInput):
            _check(robot, s.period, _through(robot, s, factor), limits, INSTANTS // 10)
            longest = factor * s.move.times[-1]
            return f"waypoints {factor:.3g} times as far apart in time: the move keeps its limits in {longest:.3g} s"
    return ""


def settled(
    robot: Robot,
    point: tuple[np.ndarray, np.ndarray],
    limits: JointLimits,
    controller: Controller,
    loop: LinearLoop,
    at: np.ndarray,
    extras: Sequence[str],
    values: Mapping[str, Any] | None = None,
    offset: Any = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """State and input of a true robot, with the parameters `values`, and memory of a controller, wherever that begins,
    all as they are once the loop has come to rest at a pose (n,), of which `point` is the model's state and input.

    Integrals and estimate supply what the model does not know, and the tracked positions are at the command; where
    these are estimates, the links are beside it. A law without integrals leaves the links where its feedback holds
    them. `loop` is linearised at the pose; the memory of its controller begins with the estimator's prediction and ends
    with the integrals, if the law has some. `offset`: of the measurements (p,).
    """
    n, size, estimator, (x, u) = len(at), len(loop.memory), controller.estimator, point
    seen = np.eye(len(x)) if estimator is None else estimator.plant.linearise(x, u)[3]
    change = loop.memory - np.eye(*loop.memory.shape)
    integrals = size - len(x) - controller.mode.latency * n
    # The integrals stand still where the errors are zero, and give the input that holds the robot.
    rows = np.vstack([change[: size - n], loop.law]) if integrals else change

    def equilibrium(beside: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """State, input and memory with the links beside the pose, and what is wrong there."""
        pose = np.clip(at + beside, limits.lower, limits.upper)
        state, held = robot.operating_point(pose, extras, values)
        y = loop.c @ state + offset - seen @ x
        right = np.zeros(size)
        if integrals:
            right[size - n :] = held - u
        found = cast("np.ndarray", np.linalg.solve(rows[:, :size], right - rows[:, size:] @ y))
        both = np.concatenate([found, y])
        wrong = change[size - n :] @ both / loop.period if integrals else loop.law @ both - (held - u)
        return state, held, found, wrong

    slope, beside = np.eye(n), np.zeros(n)
    if not integrals:
        first = equilibrium(beside)[-1]
        slope = np.column_stack([equilibrium(small)[-1] - first for small in SMALL * np.eye(n)]) / SMALL
    state, held, found, wrong = equilibrium(beside)
    for _ in range(CORRECTIONS - 1):
        beside = beside - np.linalg.solve(slope, wrong)
        state, held, found, wrong = equilibrium(beside)
    held = np.clip(held, controller.limits.lower, controller.limits.upper)
    memory = controller.initial_memory(None if estimator is None else x + found[: len(x)], held)
    settled_parts = {
        "integral": found[size - n :] if integrals else np.zeros(n),
        "position": at,
        "started": 1.0,
        "reference": np.append(x, u),
    }
    if controller.mode.has_offset:
        settled_parts["offset_known"] = 1.0
    if controller.mode.changes_command:
        settled_parts["command"] = settled_parts["reference"]
    if lead := controller.mode.command_lead:
        settled_parts["commands"] = np.tile(settled_parts["reference"], lead)
    for name, value in settled_parts.items():
        memory[controller.memory.places[name]] = value
    return state, held, memory
