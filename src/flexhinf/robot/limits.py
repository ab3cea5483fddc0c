"""Whether a robot can follow a reference and hold a pose: joints within their limits, inputs within their own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant.equilibrium import motion_of
from flexhinf.robot.extras import DRIVES
from flexhinf.robot.robot import Robot
from flexhinf.robot.signals import UNITS, signal_names
from flexhinf.untrusted import real_array, value_text


def position_ranges(robot: Robot) -> np.ndarray:
    """Lower and upper ends (2, n) of the joints' ranges, rad or m; infinite where a joint has no limit."""
    return np.array([(-np.inf, np.inf) if pair is None else pair for pair in robot.links.limits]).T


def check_reference(
    robot: Robot, signals: Any, duration: float, effort: Any = None, period: float = 1e-3, speed: Any = None
) -> float:
    """Refuse a reference that leaves the range of a joint, moves it too fast, or needs more input than there is.

    Parameters
    ----------
    signals : sequence, mapping by joint or link position, or one signal with a column per joint
        Commands with ``derivatives`` (`flexhinf.loop.signals.references`), or numbers.
    duration : float
        s; checked every `period` seconds, both ends included.
    effort : number, (n,) or mapping by joint, optional
        Largest absolute input of each motor, V, or N·m (N): the feedforward along the reference must stay
        below it. Needs signals with four derivatives; ``robot.effort_limits`` are those that the robot states.
    period : float
        s.
    speed : number, (n,) or mapping by joint, optional
        Largest absolute velocity of each link, rad/s or m/s; by default what the robot states.

    Returns
    -------
    float
        The largest share of the effort that the feedforward uses; 0 without `effort`.

    Raises
    ------
    InvalidInput
        Naming the joint, the time, the value and the limit.
    """
    for name, value in (("duration", duration), ("period", period)):
        if not np.isfinite(value) or value <= 0.0:
            raise InvalidInput(f"The {name} is not usable.", f"expected > 0 s, got {value!r}", "seconds")
    times = np.append(np.arange(0.0, duration, period), duration)
    names = signal_names("link_position", robot.joint_names)
    if isinstance(signals, Mapping):
        full = dict(zip(robot.joint_names, names))
        signals = {full.get(name, name): signal for name, signal in signals.items()}
    fastest = np.array(robot.speed_limits) if speed is None else _per_joint(robot, "speed", speed)
    order = 4 if effort is not None else 1 if np.isfinite(fastest).any() else 0
    motion = motion_of(signals, times, order, names)
    _within_positions(robot, motion[0], times)
    if order:
        _within_speeds(robot, motion[1], fastest, times)
    if effort is None:
        return 0.0
    limit = _per_joint(robot, "effort", effort)
    _, inputs = robot.inverse_dynamics(*motion)
    share = np.abs(inputs) / limit
    row, joint = divmod(int(np.argmax(share)), share.shape[1])
    if share[row, joint] > 1.0:
        raise InvalidInput(
            f"The reference needs more of joint {robot.joint_names[joint]!r} than its motor gives.",
            f"expected at most {limit[joint]:g} {_unit(robot, joint)}, got a feedforward of "
            f"{inputs[row, joint]:.4g} {_unit(robot, joint)} at t = {times[row]:g} s",
            "a slower reference (JerkLimited with lower limits, a longer Quintic), or a larger effort",
        )
    return float(share[row, joint])


def check_holding(
    robot: Robot,
    pose: Any,
    limit: Any = None,
    explain: Callable[[int], tuple[str, str]] = lambda joint: ("", "effort"),
) -> tuple[np.ndarray, np.ndarray]:
    """Refuse a pose that the motors cannot hold.

    Parameters
    ----------
    pose : sequence, mapping by joint name, or number for one joint
        As for `Robot.operating_point`.
    limit : number, (n,) or mapping by joint, optional
        Largest absolute input of each motor, V, or N·m (N); by default what the robot states.
    explain : callable, optional
        What an error adds on the limit of a joint, by its place: who states it, and what a larger one is called.

    Returns
    -------
    x, u : ndarray
        The operating point.

    Raises
    ------
    InvalidInput
        Naming the joint, the input that holds it and the limit; or for a pose outside the joints' limits.
    """
    x, u = robot.operating_point(pose)
    limits = np.array(robot.effort_limits) if limit is None else _per_joint(robot, "effort", limit)
    worst = int(np.argmax(np.abs(u) / limits))
    if abs(u[worst]) > limits[worst]:
        unit, (stated, larger) = _unit(robot, worst), explain(worst)
        raise InvalidInput(
            f"The motor of joint {robot.joint_names[worst]!r} cannot hold this pose.",
            f"expected a holding input of at most {limits[worst]:g} {unit}, got {u[worst]:.4g} {unit} at the pose "
            f"{[float(f'{q:.4g}') for q in x[: len(u)]]}{stated}",
            f"a pose nearer to where the arm hangs, a lighter load, or a larger {larger}",
        )
    return x, u


def _within_positions(robot: Robot, positions: np.ndarray, times: np.ndarray) -> None:
    """The first time at which any joint is outside."""
    low, high = position_ranges(robot)
    outside = (positions < low) | (positions > high) | ~np.isfinite(positions)
    if not np.any(outside):
        return
    row = int(np.argmax(np.any(outside, axis=1)))
    joint = int(np.argmax(outside[row]))
    slides = robot.links.slides[joint]
    raise InvalidInput(
        f"The reference leaves the limits of joint {robot.joint_names[joint]!r}.",
        f"expected {low[joint]:g} to {high[joint]:g} {'m' if slides else 'rad'}, got "
        f"{positions[row, joint]:.6g} at t = {times[row]:g} s",
        "a reference within the limits; angles are in rad",
    )


def _within_speeds(robot: Robot, rates: np.ndarray, limits: np.ndarray, times: np.ndarray) -> None:
    """The joint that is furthest beyond its limit, when it is."""
    share = np.abs(rates) / limits
    row, joint = divmod(int(np.argmax(share)), share.shape[1])
    if share[row, joint] > 1.0:
        unit = "m/s" if robot.links.slides[joint] else "rad/s"
        raise InvalidInput(
            f"The reference moves joint {robot.joint_names[joint]!r} faster than it may.",
            f"expected at most {limits[joint]:g} {unit}, got {rates[row, joint]:.4g} {unit} at t = {times[row]:g} s",
            "a slower reference (JerkLimited with a lower velocity, a longer Quintic)",
        )


def _per_joint(robot: Robot, what: str, stated: Any) -> np.ndarray:
    """One positive limit of the effort or the speed per joint (n,); may be infinite."""
    joints = robot.joint_names
    given = stated
    if isinstance(stated, Mapping):
        signal = DRIVES[robot.drive] if what == "effort" else "link_velocity"
        signals = dict(zip(signal_names(signal, joints), joints))
        named = {signals.get(name, name): value for name, value in stated.items()}
        given = [named.pop(joint, np.nan) for joint in joints]
        given = [np.nan] if named else given
    try:
        limits = np.broadcast_to(real_array(given), (len(joints),))
    except ValueError:
        limits = np.array([np.nan])
    if not np.all(limits > 0.0):
        raise InvalidInput(
            f"The limit of the {what} does not fit the {'motors' if what == 'effort' else 'joints'}.",
            f"expected one positive number, or one for each of {list(joints)}, got {value_text(stated)}",
            f"{what}=60.0",
        )
    return limits


def _unit(robot: Robot, joint: int) -> str:
    return UNITS[DRIVES[robot.drive]][robot.links.slides[joint]]
