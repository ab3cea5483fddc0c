"""Kinematics of a robot: where points of its links are, poses that reach a place, references and poses it can follow.

Inverse kinematics is a least-squares problem within the joints' ranges, solved by SciPy's trust-region method:
its steps are damped as in Levenberg's and Marquardt's method [marquardt1963], so that singular poses do no harm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant import Parameters
from flexhinf.plant.plant import motion_of
from flexhinf.robot.dynamics import frames_of
from flexhinf.robot.elastic import DRIVES
from flexhinf.robot.parameters import checked_limits
from flexhinf.robot.robot import Robot
from flexhinf.robot.signals import UNITS, signal_names
from flexhinf.validation import HUGE, checked_array, checked_positive, one_of


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
    duration, period : float
        s; checked every `period`, both ends included.
    effort : number, (n,) or mapping by joint, optional
        Largest absolute input of each motor, V, A, or N·m (N): the feedforward along the reference must stay below it.
        Needs signals with four derivatives; ``robot.effort_limits`` are those that the robot states.
    speed : number, (n,) or mapping by joint, optional
        Largest absolute velocity of each link, rad/s or m/s; by default what the robot states.

    Returns
    -------
    float
        The largest share of the effort that the feedforward uses; 0 without `effort`.
    """
    duration, period = (
        checked_positive(f"The {name}", value, "seconds", "seconds")
        for name, value in (("duration", duration), ("period", period))
    )
    times = np.append(np.arange(0.0, duration, period), duration)
    names, rates, motors = (
        signal_names(quantity, robot.joint_names)
        for quantity in ("link_position", "link_velocity", DRIVES[robot.drive])
    )
    if isinstance(signals, Mapping):
        full = dict(zip(robot.joint_names, names))
        signals = {full.get(name, name): signal for name, signal in signals.items()}
    fastest = checked_limits(
        "The speeds", robot.speed_limits if speed is None else speed, robot.joint_names, rates
    )
    order = 4 if effort is not None else 1 if np.isfinite(fastest).any() else 0
    motion = motion_of(signals, times, order, names)
    low, high = position_ranges(robot)
    for row, joint in np.argwhere((motion[0] < low) | (motion[0] > high) | ~np.isfinite(motion[0]))[
        :1
    ].tolist():
        raise InvalidInput(
            f"The reference leaves the limits of joint {robot.joint_names[joint]!r}.",
            f"expected {low[joint]:g} to {high[joint]:g} {'m' if robot.links.slides[joint] else 'rad'}, got "
            f"{motion[0, row, joint]:.6g} at t = {times[row]:g} s",
            "a reference within the limits; angles are in rad",
        )
    checks = [(motion[1], fastest, "link_velocity")] if order else []
    if effort is not None:
        limit = checked_limits("The efforts", effort, robot.joint_names, motors)
        checks.append((robot.inverse_dynamics(*motion)[1], limit, DRIVES[robot.drive]))
    largest = 0.0
    for rows, limit, quantity in checks:
        share = np.abs(rows) / limit
        row, joint = divmod(int(np.argmax(share)), share.shape[1])
        largest = float(share[row, joint])
        if largest > 1.0:
            name, unit = robot.joint_names[joint], UNITS[quantity][robot.links.slides[joint]]
            fast = quantity == "link_velocity"
            raise InvalidInput(
                f"The reference moves joint {name!r} faster than it may."
                if fast
                else f"The reference needs more of joint {name!r} than its motor gives.",
                f"expected at most {limit[joint]:g} {unit}, got {'' if fast else 'a feedforward of '}"
                f"{rows[row, joint]:.4g} {unit} at t = {times[row]:g} s",
                "a slower reference (JerkLimited with lower limits, a longer Quintic), or a larger limit",
            )
    return largest if effort is not None else 0.0


def check_holding(
    robot: Robot,
    pose: Any,
    limit: Any = None,
    explain: Callable[[int], tuple[str, str]] = lambda joint: ("", "effort"),
) -> tuple[np.ndarray, np.ndarray]:
    """The operating point (x, u) at a pose; refuses one that the motors cannot hold.

    The pose is as for `Robot.operating_point`. `limit` is the largest absolute input of each motor, V, A, or N·m (N), a
    number, (n,) or by joint; by default what the robot states. `explain(joint)` returns two texts for
    an error, by the number of the joint: where its limit is stated, and what a larger limit is called.
    """
    x, u = robot.operating_point(pose)
    stated = robot.effort_limits if limit is None else limit
    limits = checked_limits(
        "The efforts", stated, robot.joint_names, signal_names(DRIVES[robot.drive], robot.joint_names)
    )
    worst = int(np.argmax(np.abs(u) / limits))
    if abs(u[worst]) > limits[worst]:
        unit = UNITS[DRIVES[robot.drive]][robot.links.slides[worst]]
        stated, larger = explain(worst)
        raise InvalidInput(
            f"The motor of joint {robot.joint_names[worst]!r} cannot hold this pose.",
            f"expected a holding input of at most {limits[worst]:g} {unit}, got {u[worst]:.4g} {unit} at the pose "
            f"{[float(f'{q:.4g}') for q in x[: len(u)]]}{stated}",
            f"a pose nearer to where the arm hangs, a lighter load, or a larger {larger}",
        )
    return x, u


#: Starts of the search beside the given one; a place counts as reached within this fraction of the robot's size.
STARTS, CLOSE = 12, 1e-7

#: A pose is near-singular where the point moves in its worst direction by less than this fraction of the best one.
SINGULAR = 0.05


@dataclass(frozen=True, eq=False)
class Reached:
    """A pose, (n,) in rad or m, at which a point of a link is at a place.

    Its mobility is the smallest singular value of the point's Jacobian, in the directions that the robot can move it
    in, over the largest that it has at other poses: 0 at a singular pose.
    """

    pose: np.ndarray
    mobility: float

    @property
    def near_singular(self) -> bool:
        """Whether the point hardly moves in some direction."""
        return self.mobility < SINGULAR


def link_frames(robot: Robot, positions: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (n, 3, 3) and origins (n, 3), m, of the links' own frames in the world, at joint positions (n,)."""
    tree, *_ = robot.links.rigid(Parameters(robot.plant_parameters()))
    n = len(tree)
    turns, places = np.zeros((n, 3, 3)), np.zeros((n, 3))
    for i, frame in enumerate(frames_of(tree, np.asarray(positions, dtype=float))):
        parent = tree.parents[i]
        base, at = (np.eye(3), np.zeros(3)) if parent < 0 else (turns[parent], places[parent])
        turns[i] = base @ np.asarray(frame.rotation, dtype=float)
        places[i] = at + base @ np.asarray(frame.translation, dtype=float)
    return turns @ np.array([np.asarray(joint.alignment, dtype=float).T for joint in tree.joints]), places


def position_of(
    robot: Robot, positions: Any, link: str | None = None, offset: Sequence[float] = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """Where a point is in the world (3,), m, at joint positions (n,): `offset` (m) in the frame of a link, the last."""
    names = robot.joint_names
    one_of("There is no such link.", names[-1] if link is None else link, names, repr(names[-1]))
    turns, places = link_frames(robot, positions)
    k = names.index(link or names[-1])
    return places[k] + turns[k] @ np.asarray(offset, dtype=float)


def pose_at(
    robot: Robot,
    place: Sequence[float] | np.ndarray,
    link: str | None = None,
    offset: Sequence[float] = (0.0, 0.0, 0.0),
    near: Sequence[float] | np.ndarray | None = None,
) -> Reached:
    """Joint positions (n,) at which a point of a link is at a place (3,), m, by a search that begins near a pose.

    `link` and `offset` as for `position_of`. The search begins at `near`, or at the robot's home; other starts are
    tried only where it fails. A place out of reach is refused, with how near the point gets.
    """
    from scipy.optimize import least_squares

    points = f"three numbers of at most {HUGE:g}, m"
    wanted, shift = (
        checked_array(f"The {name} is no point.", value, (3,), points, "(0.4, 0.0, 0.3)", HUGE)
        for name, value in (("place", place), ("offset", offset))
    )
    low, high = position_ranges(robot)
    n = len(low)

    def at(q: np.ndarray) -> np.ndarray:
        return position_of(robot, q, link, shift.tolist()) - wanted

    begin = np.clip(np.asarray(robot.home if near is None else near, dtype=float), low, high)
    rng, best = np.random.default_rng(0), None
    size = max(float(np.linalg.norm(at(begin) + wanted)), float(np.linalg.norm(wanted)), 1e-3)
    for start in range(1 + STARTS):
        free = np.where(
            np.isfinite(high - low),
            rng.uniform(0.0, 1.0, n) * (high - low) + low,
            rng.uniform(-np.pi, np.pi, n),
        )
        q = begin if start == 0 else np.clip(free, low, high)
        fit = least_squares(
            at, q, bounds=(low - 1e-12, high + 1e-12), xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=60
        )
        if best is None or fit.cost < best.cost:
            best = fit
        if np.linalg.norm(best.fun) < CLOSE * size:
            break
    assert best is not None
    refuse_if(
        np.linalg.norm(best.fun) >= CLOSE * size,
        "The place is out of the robot's reach, or of the ranges of its joints.",
        f"expected a place that {link or robot.joint_names[-1]!r} can bring its point to, got {wanted.tolist()} m; "
        f"the nearest that was found is {[float(f'{value:.4g}') for value in best.fun + wanted]} m, "
        f"{np.linalg.norm(best.fun):.3g} m away",
        "a place nearer by, or the point of another link",
    )
    pose = np.clip(best.x, low, high)

    def values(q: np.ndarray) -> np.ndarray:
        return np.linalg.svd(
            np.array([(at(q + e) - at(q - e)) / 2e-6 for e in (1e-6 * np.eye(len(q)))]).T, compute_uv=False
        )

    # Over the smallest singular value that is not zero at poses in general.
    typical = np.max([values(pose + rng.uniform(-1.0, 1.0, n)) for _ in range(8)], axis=0)
    rank = max(1, int(np.sum(typical > 1e-6 * typical[0])))
    return Reached(pose, float(values(pose)[rank - 1] / typical[rank - 1]))


def skeleton(robot: Robot, positions: Sequence[float] | np.ndarray) -> tuple[np.ndarray, ...]:
    """The links at joint positions (n,), rad or m: for each the points (2 or more, 3) of a line in the world, m.

    A link is drawn from its own joint through the joints that it carries. One that carries none ends at twice the
    distance of its centre of mass, where a uniform rod would end: a robot file states no shapes.
    """
    tree, _, centres, _ = robot.links.rigid(Parameters(robot.plant_parameters()))
    turns, places = link_frames(robot, positions)
    lines = []
    for i in range(len(tree)):
        carried = [places[k] for k, parent in enumerate(tree.parents) if parent == i]
        lines.append(
            np.array(
                [places[i], *(carried or [places[i] + 2.0 * turns[i] @ np.asarray(centres[i], dtype=float)])]
            )
        )
    return tuple(lines)
