"""The session that the test program of the C plays: goals that are followed or refused, events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Vector
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.follow import follower_of
from flexhinf.robot.follow_goal import FollowGoal
from flexhinf.robot.follow_machine import PASSED, RESTING
from flexhinf.robot.follower import Follower

#: How many rows are compared at most; and at how many poses in all the range, rad or m, of joints without one.
ROWS, POSES, FREE = 142, 40, 6.0

#: The session without these poses, in smoothing times.
LASTS = 72.0

#: How far from the robot's home the session begins, rad or m, so that no angle is 0.
ASIDE = 1.1

#: Speed of a joint without a limit, rad/s or m/s: quick, so that what is played of it is short.
QUICK = 40.0

#: What no joint does, in units that float has.
HUGE = 1e30

#: Largest way of a joint, rad or m, and what part of range and speed limit it takes.
WAY, OF_RANGE, OF_SPEED = 0.2, 0.1, 0.3


class GoalChange(TypedDict, total=False):
    """What a `FollowGoal` states otherwise than another."""

    joint_names: Sequence[str]
    times: ArrayLike
    positions: ArrayLike
    velocities: ArrayLike | None
    accelerations: ArrayLike | None
    begins: float
    path_tolerance: Mapping[str, Sequence[float]]
    goal_tolerance: Mapping[str, Sequence[float]]
    goal_time: float


@dataclass(frozen=True)
class Event:
    """What happens before a step, and what holds from it on.

    `what`: A goal to start, "cancel", "end" of every goal, or a pose (n,) to be reset to. `away`: Errors (2, n) of what
    is measured. `back`: Which goal is cancelled, by how many started last; 0: every one.
    """

    step: int
    what: FollowGoal | str | Vector | None = None
    back: int = field(default=0, kw_only=True)
    speed: float = 1.0
    rate: float = 1.0
    away: Vector | None = None


@dataclass(frozen=True)
class FollowerTrial:
    """A follower with the goals and events that it is tested with.

    `follower`: With options of its own, whose times end between samples, so that no rounding decides.
    `way`: (n,), rad or m, within which goals lie beside `home`.
    """

    follower: Follower
    home: Vector
    way: Vector

    @property
    def count(self) -> int:
        """Samples of the smoothing time."""
        return round(self.follower.smoothing / self.follower.period)

    @property
    def every(self) -> int:
        """Of every how many samples the row is compared: the table has as many rows whatever the period."""
        return -(-self.at(LASTS) // ROWS)

    def at(self, multiple: float) -> int:
        """A multiple of the smoothing time, in samples."""
        return round(multiple * self.count)

    def time(self, multiple: float) -> float:
        """A multiple of the smoothing time that ends between two samples, s."""
        return (self.at(multiple) + 0.41) * self.follower.period

    def goal(
        self,
        multiples: Sequence[float],
        shares: Sequence[float],
        order: int = 1,
        /,
        **other: Unpack[GoalChange],
    ) -> FollowGoal:
        """Waypoints at multiples of the smoothing time, at shares of the way from home; joints in reversed order."""
        joints, sizes = self.follower.robot.joint_names, self.way * np.linspace(1.0, 0.6, len(self.way))
        rows = np.zeros((3, len(multiples), len(joints)))
        rows[0] = self.home + np.outer(shares, sizes)
        seconds = np.array([self.time(multiple) for multiple in multiples])
        slopes = np.outer(np.linspace(0.3, 0.1, len(multiples)), sizes) / seconds[-1]
        rows[1, :-1], rows[2] = slopes[:-1], -slopes / seconds[-1]
        velocities, accelerations = (rows[k, :, ::-1] if k < order else None for k in (1, 2))
        own = FollowGoal(joints[::-1], seconds, rows[0, :, ::-1], velocities, accelerations)
        return replace(own, **other)

    def bulge(self, order: int, joint: int, beyond: float, ends: bool = False) -> GoalChange:
        """From home to home, with a velocity or an acceleration that takes one joint to a place in between: that of the
        first waypoint, or of the second, behind which it is at rest a little later."""
        wide = abs(beyond - self.home[joint])
        speed = 0.5 * min(self.follower.speeds[joint], QUICK)
        # q = v t (1 - s)², farthest at s = 1/3; and a t²/2 (1 - s)³, at s = 2/5
        time = (27.0 / 4.0 if order == 2 else 4.0) * wide / speed
        rates = np.zeros((2, 3, len(self.way)))
        size = 27.0 / 4.0 / time if order == 2 else 2.0 * 3125.0 / 108.0 / time**2
        rates[order - 2, int(ends), joint] = size * (beyond - self.home[joint])
        rates[0] *= -1.0 if ends else 1.0
        times = self.time(1.5) + np.array([0.0, time, 1.1 * time])
        velocities, accelerations = rates[:, :, ::-1]
        change: GoalChange = {
            "times": times,
            "positions": np.tile(self.home[::-1], (3, 1)),
            "velocities": velocities,
        }
        return change if order == 2 else {**change, "accelerations": accelerations}

    def leap(self, share: float) -> FollowGoal:
        """A waypoint at home whose acceleration takes the last joint so far beyond its range, or short of it."""
        (_, high), last = self.follower.ranges, len(self.way) - 1
        end = high[last] if np.isfinite(high[last]) else FREE
        return replace(
            self.goal([1.2], [0.0]), **self.bulge(3, last, self.home[last] + share * (end - self.home[last]))
        )

    def partial(
        self,
        joints: slice,
        multiples: Sequence[float],
        shares: Sequence[float],
        order: int,
        **other: Unpack[GoalChange],
    ) -> FollowGoal:
        """The goal of some joints alone; of all where there is one."""
        whole = self.goal(multiples, shares, order, **other)
        if len(whole.joint_names) == 1:
            return whole
        rows = zip(("positions", "velocities", "accelerations"), whole.arrays)
        chosen = {name: values[:, joints] for name, values in rows}
        return replace(whole, joint_names=whole.joint_names[joints], **chosen)

    def hop(self, share: float) -> FollowGoal:
        """All joints from home by so much of the jump that smoothing takes, at once."""
        far = self.home + share * self.follower.jumps
        return replace(self.goal([0.2], [0.0]), times=[0.4 * self.follower.period], positions=[far[::-1]])

    def jump(self, joints: slice, begins: float = 0.0) -> FollowGoal:
        """A first waypoint that is too far for its time."""
        far = self.home + 4.0 * self.follower.jumps
        return self.partial(joints, [0.2], [0.0], 1, positions=[far[::-1]], begins=begins)


def session_of(code: ControllerCode) -> FollowerTrial:
    """The session of a controller that follows trajectories: beside its robot's home, within the joints' ranges."""
    own = follower_of(code)
    assert own is not None
    (low, high), speeds = own.ranges, own.speeds
    way = np.minimum(np.minimum(WAY, OF_RANGE * (high - low)), 2.0 * OF_SPEED * own.smoothing * speeds)
    home = np.clip(np.asarray(own.robot.home, dtype=float) + ASIDE, low + 3.0 * way, high - 3.0 * way)
    count, last = round(own.smoothing / own.period), len(way) - 1
    follower = replace(
        own,
        partial=True,
        limited=False,
        stop_time=(2 * count + count // 2 + 0.41) * own.period,
        path_tolerance={own.robot.joint_names[0]: (1.5 * way[0], 0.0)},
        goal_tolerance={own.robot.joint_names[last]: (0.5 * way[last], 0.0)},
        goal_time=(count // 2 + 0.41) * own.period,
        timeout=(count + 0.41) * own.period,
    )
    return FollowerTrial(follower, home, way)


def events(session: FollowerTrial) -> list[Event]:
    """Goals at rest, at speed, past and future ones; slowed, braked, cancelled, refused, partial; and each end."""
    at, goal, n = session.at, session.goal, len(session.way)
    first, last = session.follower.robot.joint_names[0], session.follower.robot.joint_names[-1]
    away = np.zeros((2, n))
    aside, faster = away.copy(), away.copy()
    aside[0, 0], faster[1, -1] = 2.0 * session.way[0], 1000.0 * session.way[-1]
    askew = away.copy()
    askew[0, -1] = -session.way[-1]
    anywhere = away.copy()
    anywhere[:, 0] = 1000.0
    low, high = session.follower.ranges
    up, down = (np.where(np.isfinite(end), end, session.home) for end in (high, low))
    near, period = 0.1 * session.way, session.follower.period
    steps = [(at(LASTS) // session.every + 1 + k) * session.every for k in range(POSES)]
    ends = np.where(np.isfinite(session.follower.ranges), session.follower.ranges, [[-FREE], [FREE]])
    shares = (0.618 * np.arange(POSES)[:, None] + 0.37 * np.arange(n) + 0.5) % 1.0
    shares[0], shares[1] = 0.0, 1.0  # the largest angles
    poses = ends[0] + shares * (ends[1] - ends[0])
    narrow = {first: (3.0 * session.way[0], 0.0)} | {last: (3.0 * session.way[-1], 20.0 * session.way[-1])}
    return [
        Event(0, goal([1.2, 2.6, 4.0], [0.3, 1.0, 0.5], 3)),
        Event(at(1.0), speed=0.4),
        Event(at(2.0), goal([0.3, 1.6, 3.0], [0.9, 0.2, -0.8], 2, begins=-session.time(0.4))),
        Event(at(3.0), rate=0.6),
        Event(at(3.2), rate=0.05),
        Event(at(3.4), speed=0.5),
        Event(at(3.9), "cancel"),
        Event(at(4.2), goal([1.3, 2.6], [0.1, 0.3], 2)),
        Event(at(4.4), "cancel", speed=0.5),
        Event(at(4.4), goal([1.3, 2.6], [0.2, 0.0], 3)),
        Event(at(4.8), "cancel", speed=0.0),
        Event(at(5.0), goal([1.2, 2.4], [-0.2, 0.5], begins=(at(4.0) + 0.56) * period)),
        Event(at(6.8), speed=np.nan),
        Event(at(7.1), goal([1.2], [0.1], begins=at(6.0) * period)),
        Event(at(7.2), rate=np.nan),  # its path stands
        Event(at(7.3)),
        Event(at(7.4), goal([1.2], [0.1], begins=at(6.0) * period)),
        Event(at(7.5), goal([1.2, 2.5], [0.3, 0.0], 2)),  # and the one that waits is over
        Event(at(7.6), goal([1.2], [0.1], begins=at(6.0) * period)),
        Event(at(7.7), "cancel", back=1),
        Event(at(7.8), "cancel", back=1),  # it is over
        Event(at(7.9), goal([1.2], [0.1], begins=at(6.0) * period)),
        Event(at(8.0), goal([1.2], [0.2], begins=at(6.0) * period)),
        Event(at(8.1), "cancel", back=4),  # the one that is followed, and with it the one that waits
        Event(at(8.2), goal([1.2], [0.0])),
        Event(at(8.3), goal([1.2], [0.2], begins=at(6.0) * period)),
        Event(at(8.4), "cancel"),
        Event(at(8.5), goal([1.2], [0.2], begins=at(6.0) * period)),
        Event(at(8.5), goal([1.2], [0.1])),
        Event(at(8.5), "cancel"),
        Event(at(8.6), goal([1.2], [0.1])),
        Event(at(8.7), goal([1.2], [0.2], begins=at(6.0) * period)),
        Event(at(8.8), goal([1.2], [0.1])),
        Event(at(8.8), "end"),
        Event(at(9.0), session.jump(slice(-1, None))),
        Event(at(9.2), session.jump(slice(0, 1)), np.inf, np.inf),
        Event(at(9.5), session.jump(slice(-1, None), begins=(at(3.0) + 1) * period), 1.1, -0.5),
        Event(at(12.7), goal([1.2], [0.1], begins=at(8.0) * period), -0.5, 1.1),
        Event(at(13.2), session.partial(slice(-1, None), [8.0], [0.1], 1), speed=0.3),
        Event(at(13.3), speed=0.8),
        Event(at(14.5), rate=0.618),
        Event(at(16.3)),
        Event(at(17.2), session.partial(slice(0, 1), [1.2, 2.4], [0.6, 0.9], 1)),
        Event(at(18.4), session.partial(slice(1, None), [1.1, 2.3], [0.1, -0.5], 2)),
        Event(at(19.6), away=aside),
        Event(at(20.0), goal([1.2, 2.4], [0.4, 0.8], begins=at(3.5) * period)),
        Event(at(20.2), "cancel"),
        Event(at(20.4), goal([1.2], [0.5], path_tolerance=narrow)),
        Event(at(20.8), away=aside),
        Event(at(21.0), away=faster),
        Event(at(21.4)),
        Event(
            at(22.0),
            session.partial(
                slice(0, 1),
                [1.2],
                [0.3],
                1,
                path_tolerance={first: (-1.0, -1.0)},
                goal_time=session.time(0.3),
            ),
        ),
        Event(at(22.1), away=anywhere),
        Event(at(22.2), away=askew),
        Event(
            at(31.4),
            session.partial(
                slice(-1, None),
                [1.2],
                [0.3],
                1,
                goal_time=-1.0,
                goal_tolerance={first: (session.way[0], -1.0)},
            ),
            away=askew,
        ),
        Event(at(39.9), up - 3.0 * near, rate=0.5),
        Event(at(40.5), goal([1.2], [0.0], 3, positions=[(up - near)[::-1]])),
        Event(at(41.0), "cancel"),
        Event(at(43.5), down + 3.0 * near),
        Event(at(44.0), goal([1.2], [0.0], positions=[down[::-1]])),
        Event(at(44.6), "cancel"),
        Event(at(46.0), up + near),
        Event(at(46.2), session.partial(slice(-1, None), [1.2], [0.0], 1, positions=[(up - near)[::-1]])),
        Event(at(46.5), "cancel"),
        Event(at(48.0), session.home),
        Event(at(48.2), goal([1.2], [0.3]), away=askew),
        Event(at(57.0), goal([1.2], [0.5])),
        Event(at(64.0), away=faster),
        Event(at(64.5)),
        Event(at(66.0), session.leap(1.02)),
        Event(at(66.1), session.leap(0.98)),
        Event(at(67.0), session.home),
        Event(at(67.0), session.hop(0.7)),
        Event(at(67.0) + 1, session.hop(0.0)),
        Event(at(71.0), session.hop(0.0)),
        *(Event(step, pose, rate=(1.0, 0.5)[k % 2]) for k, (step, pose) in enumerate(zip(steps, poses))),
        Event(steps[-1] + session.every),
    ]


def refusals(session: FollowerTrial) -> list[FollowGoal]:
    """Goals that `Follower.check` refuses, each for one reason, between some that it takes."""
    own = session.follower
    joints, period, (low, high) = own.robot.joint_names, own.period, own.ranges
    first, last, n = joints[0], joints[-1], len(joints)
    times = np.array([session.time(1.5), session.time(3.0)])
    rows, still = np.array([session.home, session.home + 0.1 * session.way])[:, ::-1], np.zeros((2, n))
    ended, infinite = still.copy(), still.copy()
    ended[1, -1], infinite[0, 0] = 0.1, np.inf
    none = np.full((1, n), np.nan)
    base = FollowGoal(joints[::-1], times, rows)

    def moved(to: Vector) -> Vector:
        return np.array([rows[0], to[::-1]])

    changes: list[GoalChange] = [
        {},
        {"times": times[::-1]},
        {"times": times[0] + np.array([0.0, 0.9 * period / PASSED])},
        {"times": times[0] + np.array([0.0, 1.1 * period / PASSED])},
        {"times": [times[0], np.inf]},
        {"times": [np.nan, times[1]]},
        {"times": [-period, times[1]]},
        {"times": [0.0, times[1]]},
        {"positions": np.where(still == ended, rows, np.nan)},
        {"positions": moved(session.home + 1.1 * own.speeds * (times[1] - times[0]))},
        {"positions": moved(np.where(np.arange(n) == n - 1, high + 0.01, session.home))},
        {"positions": moved(np.where(np.arange(n) == 0, low - 0.01, session.home))},
        {
            "positions": moved(session.home + 1.1 * own.jumps),
            "times": [times[0], times[0] + 0.5 * own.smoothing],
        },
        {
            "positions": moved(session.home + 0.9 * own.jumps),
            "times": [times[0], times[0] + 0.1 * own.smoothing],
        },
        {"velocities": ended},
        {"velocities": 9.0 * RESTING * ended},  # nine tenths
        {"velocities": -11.0 * RESTING * ended},
        {"velocities": infinite},
        {"velocities": still, "accelerations": infinite},
        {"velocities": still, "accelerations": still},
        {"path_tolerance": {first: (-0.5, 0.0)}},
        {"path_tolerance": {last: (0.0, np.nan)}},
        {"goal_tolerance": {first: (np.inf, 0.0)}},
        {"goal_tolerance": {last: (0.0, -1.1)}},
        {"goal_tolerance": {last: (-1.0, 0.1)}},
        {"goal_time": -2.0},
        {"goal_time": -1.0},
        {"goal_time": np.nan},
        {"begins": -times[1] - 0.1 * period},
        {"begins": -times[1] + 0.1 * period},
        {"begins": np.nan},
        {"times": [], "positions": np.zeros((0, n))},
        {"times": [0.0], "positions": rows[:1]},
        {"times": times[:1], "positions": [np.where(np.arange(n) == n - 1, high + 0.01, session.home)[::-1]]},
        {"times": times[:1], "positions": [np.where(np.arange(n) == 0, low - 0.01, session.home)[::-1]]},
        {"times": times[:1], "positions": rows[:1], "velocities": none},
        {"times": times[:1], "positions": rows[:1], "velocities": still[:1], "accelerations": none},
        {"joint_names": joints[:1], "positions": rows[:, -1:]},
        {"joint_names": [], "positions": np.zeros((2, 0))},
    ]
    changes += _between(session)
    if own.own.limited:  # one half, and half more, of the largest bend at the end
        for share in (0.5, 1.5):
            limits = own.own
            slope = share * np.minimum(
                np.divide(limits.rates, limits.bent_rates), np.divide(limits.changes, limits.bent_changes)
            )
            changes.append(
                {"positions": moved(session.home + np.minimum(slope, 1e3) * (times[1] - times[0]))}
            )
    return [replace(base, **change) for change in changes]


def _between(session: FollowerTrial) -> list[GoalChange]:
    """Goals that are at home at their waypoints, and between them just within a range and a speed limit, or beyond; and
    small jumps one behind another."""
    own, home, n = session.follower, session.home, len(session.way)
    period, limits, found = own.period, own.own, list[GoalChange]()
    for joint in (0, n - 1):
        for end in own.ranges[:, joint]:
            for order, ends in product((2, 3), (False, True)) if np.isfinite(end) else ():
                places = home[joint] + np.array([0.998, 1.002]) * (end - home[joint])
                found += [session.bulge(order, joint, place, ends) for place in places]
    wide, still = np.where(np.arange(n) == n - 1, 3.0 * own.jumps, 0.0), np.zeros((2, n))
    for order, peak in ((2, 1.5), (3, 1.875)):
        for sign, share in ((1.0, 0.98), (1.0, 1.02), (-1.0, 1.02)):
            rows = np.array([home, home + sign * wide])[:, ::-1]
            times = session.time(1.5) + np.array([0.0, peak * wide[-1] / (share * limits.peak[-1])])
            change: GoalChange = {"times": times, "positions": rows, "velocities": still}
            found.append(change if order == 2 else {**change, "accelerations": still})
    for speed in (0.98 * limits.peak[0], -1.02 * limits.peak[0]):
        rates = still.copy()
        rates[0, -1] = speed
        times = session.time(1.5) + np.array([0.0, abs(20.0 * own.jumps[0] / speed)])
        found.append({"times": times, "positions": np.tile(home[::-1], (2, 1)), "velocities": rates})
    for sign, share in ((-1.0, 0.3), (1.0, 0.3), (1.0, 0.6)):  # fast, and no farther than a jump
        rates = still.copy()
        rates[0, -1] = 1.5 * sign * limits.peak[0]
        times = session.time(1.5) + np.array([0.0, share * 4.5 * own.jumps[0] / limits.peak[0]])
        found.append({"times": times, "positions": np.tile(home[::-1], (2, 1)), "velocities": rates})
    for share in (0.3, 0.6):
        rows = [home[::-1], (home + share * own.jumps)[::-1]] * 2
        found.append({"times": session.time(1.5) + 0.1 * period * np.arange(4.0), "positions": rows})
    huge = still.copy()
    huge[0, -1] = HUGE
    return [*found, {"velocities": huge}, {"velocities": still, "accelerations": huge}]
