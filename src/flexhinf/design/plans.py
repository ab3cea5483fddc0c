"""Commands from one pose to another: the shaped step, the planned move, and the stated move."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import cast

import numpy as np

from flexhinf.analysis import modes
from flexhinf.design.problem import presets
from flexhinf.design.responses import JointLimits, Plan, joint_limits, plan_ends, start_and_goal
from flexhinf.design.specification import RUN_SAMPLES, Specification
from flexhinf.errors import InvalidInput
from flexhinf.loop import JerkLimited, Moving, Waypoints
from flexhinf.plant import Law
from flexhinf.robot import Robot, check_reference, kinematics
from flexhinf.robot.waypoints import WaypointError, WaypointTable

#: Time of a quintic times the bandwidth: then it keeps the limits below.
QUINTIC_TIME = 4.7

#: A spline through waypoints may go beyond two neighbouring ones by this fraction of the joint's way.
BEYOND = 0.02

#: A move takes so many sampling periods at least: a loop does not follow a shorter one.
MOVE_SAMPLES = 10

#: Most instants at which a stated move is checked.
INSTANTS = 20_000

#: Limits of the move's velocity, acceleration and jerk, over the way times ω, ω², ω³ for a bandwidth ω.
VELOCITY, ACCELERATION, JERK = 0.4, 0.4, 0.8

#: Largest fraction of what an effort limit leaves beside the weight that the feedforward may use; the rest is left for
#: feedback. The move is slowed down by the second factor until it does, at most so many times.
EFFORT_FRACTION, STRETCH, STRETCHES = 0.7, 1.15, 25

#: A joint that does not move still needs limits of its plan: those of this fraction of the largest way.
LEAST_WAY = 1e-3


def has_integrals(law: Law) -> bool:
    """Whether a law integrates the error of link positions, so that a command enters through the integrals."""
    return any(name.endswith("_integral") for name in law.state_names)


def step_command(
    robot: Robot, s: Specification, start: np.ndarray, goal: np.ndarray, law: Law | None = None
) -> Plan | None:
    """The command of the step from start to goal by the shaping; None for a jump, or where the law does not take one.

    Otherwise it does not depend on the law, so that laws are compared with the same command: it is made for the
    stated bandwidth, or for its default.
    """
    if s.shaping == "jump" or not np.any(goal != start) or (law is not None and not has_integrals(law)):
        return None
    scales = modes.JointScales.of(robot.plant(), robot.operating_point(goal))
    bandwidth = presets.required_bandwidth(s.bandwidth, scales, len(goal))
    held = [robot.operating_point(at)[1] for at in (start, goal)]
    return plan_move(robot, s, start, goal, bandwidth, float(scales.vibration.min()), held)


def plan_move(
    robot: Robot,
    s: Specification,
    start: np.ndarray,
    goal: np.ndarray,
    bandwidth: np.ndarray,
    slowest_vibration: float,
    held: Sequence[np.ndarray],
) -> Plan:
    """The move from start to goal as fast as the loop follows, slower until it keeps the joints' speeds and efforts.

    `robot`, `s`: limits of effort and speed are the specification's, or the robot's.
    `start`, `goal`, `bandwidth`: (n,), Link positions, rad or m, and rad/s.
    `slowest_vibration`: its period smooths the plan, rad/s.
    `held`: inputs that hold the robot at start and goal, beside which the limit leaves room.
    """
    limits, limit = joint_limits(robot, s), None
    if limits.limits_effort:  # the largest input (n,) that the feedforward may use of each motor
        needed = np.abs(held).max(axis=0)
        limit = needed + EFFORT_FRACTION * np.maximum(0.0, limits.effort - needed)
    way = np.abs(goal - start)
    way = np.maximum(way, LEAST_WAY * max(float(way.max()), 1e-6))
    for k in range(STRETCHES):
        rate = np.asarray(bandwidth, dtype=float) / STRETCH**k
        if s.shaping == "quintic":
            plan: Plan = Waypoints([0.0, QUINTIC_TIME / float(rate.min())], [start, goal], "quintic")
        else:
            plan = JerkLimited(
                start, goal, VELOCITY * way * rate, ACCELERATION * way * rate**2, JERK * way * rate**3,
                smoothing=2.0 * math.pi / slowest_vibration,
            )  # fmt: skip
        try:
            check_reference(robot, plan, plan.duration, limit, s.period, limits.speed)
        except InvalidInput:
            if (limit is None and not limits.limits_speed) or k == STRETCHES - 1:
                raise
        else:
            return plan
    raise AssertionError("unreachable")


def stated_move(robot: Robot, s: Specification) -> Plan | None:
    """The move of a specification, checked against ranges, speeds and efforts of the joints; None without one."""
    if s.move is None:
        return None
    try:
        plan = _through(robot, s, 1.0)
    except InvalidInput as error:  # what a signal is told about its profile is the shaping of a specification
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


def move_reference(robot: Robot, plan: Plan, dry_friction: Sequence[str]) -> Moving:
    """A planned move with the feedforward of the elastic inverse dynamics, which knows these kinds of dry friction."""
    return Moving(plan, partial(robot.inverse_dynamics, extras=tuple(dry_friction)))


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


def _slower(robot: Robot, s: Specification, limits: JointLimits) -> str:
    """Advice with the least factor of `STRETCH` to some power by which a slower move keeps all limits; "" for none."""
    if not isinstance(s.move, WaypointTable):
        return ""
    for factor in (STRETCH**k for k in range(1, STRETCHES)):
        with suppress(InvalidInput):
            _check(robot, s.period, _through(robot, s, factor), limits, INSTANTS // 10)
            longest = factor * s.move.times[-1]
            return f"waypoints {factor:.3g} times as far apart in time: the move keeps its limits in {longest:.3g} s"
    return ""
