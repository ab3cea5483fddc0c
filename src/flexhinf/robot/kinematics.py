"""Where the links are at joint positions, and joint positions at which a point of a link is at a place.

The way back is a least-squares problem within the joints' ranges, solved by SciPy's trust-region method: its steps are
damped as in Levenberg's and Marquardt's method [marquardt1963], so that singular poses do no harm.

Where the links of a robot are, as straight lines: for drawings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.dynamics.bodies import frames_of
from flexhinf.robot.limits import position_ranges
from flexhinf.robot.robot import Robot
from flexhinf.untrusted import HUGE, real_array, value_text, within_proportion

#: Starts of the search beside the given one; a place counts as reached within this fraction of the robot's size.
STARTS, CLOSE = 12, 1e-7

#: A pose is near-singular where the point moves in its worst direction by less than this fraction of the best one.
SINGULAR = 0.05


@dataclass(frozen=True, eq=False)
class Reached:
    """A pose at which a point of a link is at a place.

    Attributes
    ----------
    pose : (n,)
        rad or m.
    mobility : float
        Smallest singular value of the point's Jacobian, in the directions that the robot can move it in, over
        the largest that it has at other poses: 0 at a singular pose.
    """

    pose: np.ndarray
    mobility: float

    @property
    def near_singular(self) -> bool:
        """Whether the point hardly moves in some direction."""
        return self.mobility < SINGULAR


def link_frames(robot: Robot, positions: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (n, 3, 3) and origins (n, 3), m, of the links' own frames in the world, at joint positions (n,)."""
    table = robot.plant().parameters
    tree, *_ = robot.links.rigid(table.named(table.vector()))
    n = len(tree)
    turns, places = np.zeros((n, 3, 3)), np.zeros((n, 3))
    for i, frame in enumerate(frames_of(tree, np.asarray(positions, dtype=float))):
        parent = tree.parents[i]
        base, at = (np.eye(3), np.zeros(3)) if parent < 0 else (turns[parent], places[parent])
        turns[i] = base @ np.asarray(frame.rotation, dtype=float)
        places[i] = at + base @ np.asarray(frame.translation, dtype=float)
    own = np.array([np.asarray(joint.alignment, dtype=float).T for joint in tree.joints])
    return turns @ own, places


def position_of(
    robot: Robot, positions: Any, link: str | None = None, offset: Sequence[float] = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """Where a point is in the world (3,), m.

    Parameters
    ----------
    positions : (n,)
        rad or m.
    link : str, optional
        Name of the joint that carries it; the last one by default.
    offset : (3,)
        Of the point in the link's frame, m.
    """
    turns, places = link_frames(robot, positions)
    k = _place(robot, link)
    return places[k] + turns[k] @ np.asarray(offset, dtype=float)


def pose_at(
    robot: Robot,
    place: Sequence[float] | np.ndarray,
    link: str | None = None,
    offset: Sequence[float] = (0.0, 0.0, 0.0),
    near: Sequence[float] | np.ndarray | None = None,
) -> Reached:
    """Joint positions at which a point of a link is at a place, by a search that begins near a pose.

    Parameters
    ----------
    place : (3,)
        In the world's frame, m.
    link, offset
        As for `position_of`.
    near : (n,), optional
        Where the search begins; the robot's home by default. Other starts are tried only where it fails.

    Raises
    ------
    InvalidInput
        For what is no place, a link that is not there, and a place out of reach, with how near the point gets.
    """
    from scipy.optimize import least_squares

    wanted, shift = _three("place", place), _three("offset", offset)
    k, n = _place(robot, link), len(robot.joint_names)
    low, high = position_ranges(robot)

    def at(q: np.ndarray) -> np.ndarray:
        turns, places = link_frames(robot, q)
        return places[k] + turns[k] @ shift - wanted

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
        found = least_squares(
            at, q, bounds=(low - 1e-12, high + 1e-12), xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=60
        )
        if best is None or found.cost < best.cost:
            best = found
        if np.linalg.norm(best.fun) < CLOSE * size:
            break
    assert best is not None
    if np.linalg.norm(best.fun) >= CLOSE * size:
        nearest = [float(f"{value:.4g}") for value in best.fun + wanted]
        raise InvalidInput(
            "The place is out of the robot's reach, or of the ranges of its joints.",
            f"expected a place that {robot.joint_names[k]!r} can bring its point to, got {wanted.tolist()} m; the "
            f"nearest that was found is {nearest} m, {np.linalg.norm(best.fun):.3g} m away",
            "a place nearer by, or the point of another link",
        )
    pose = np.clip(best.x, low, high)
    return Reached(pose, _mobility(at, pose, rng))


def _mobility(at: Any, pose: np.ndarray, rng: np.random.Generator) -> float:
    """The smallest singular value that is not zero at poses in general, over its largest there."""

    def values(q: np.ndarray) -> np.ndarray:
        step = 1e-6 * np.eye(len(q))
        return np.linalg.svd(np.array([(at(q + e) - at(q - e)) / 2e-6 for e in step]).T, compute_uv=False)

    typical = np.max([values(pose + rng.uniform(-1.0, 1.0, len(pose))) for _ in range(8)], axis=0)
    rank = max(1, int(np.sum(typical > 1e-6 * typical[0])))
    return float(values(pose)[rank - 1] / typical[rank - 1])


def _place(robot: Robot, link: str | None) -> int:
    names = robot.joint_names
    if link is None:
        return len(names) - 1
    if link not in names:
        raise InvalidInput(
            "There is no such link.",
            f"expected one of {list(names)}, got {value_text(link, 60)}",
            repr(names[-1]),
        )
    return names.index(link)


def _three(what: str, value: Any) -> np.ndarray:
    array = real_array(value)
    if array.shape != (3,) or not all(map(within_proportion, array)):
        raise InvalidInput(
            f"The {what} is no point.",
            f"expected three numbers of at most {HUGE:g}, m, got {value_text(value, 80)}",
            "(0.4, 0.0, 0.3)",
        )
    return array


def skeleton(robot: Robot, positions: Sequence[float] | np.ndarray) -> tuple[np.ndarray, ...]:
    """The links at some joint positions, one line for each link.

    A link is drawn from its own joint through the joints that it carries. One that carries none ends at twice the
    distance of its centre of mass, where a uniform rod would end: a robot file states no shapes.

    Parameters
    ----------
    positions : (n,)
        rad or m.

    Returns
    -------
    tuple of (2 or more, 3) arrays
        Points of each link in the world's frame, m, in the order of the joints; the joint's own place is the first.
    """
    table = robot.plant().parameters
    tree, _, centres, _ = robot.links.rigid(table.named(table.vector()))
    turns, places = link_frames(robot, positions)
    n = len(tree)
    lines = []
    for i in range(n):
        carried = [places[k] for k in range(n) if tree.parents[k] == i]
        end = places[i] + 2.0 * turns[i] @ np.asarray(centres[i], dtype=float)
        lines.append(np.array([places[i], *(carried or [end])]))
    return tuple(lines)
