"""The test vector of the C that follows trajectories: goals and events with what `Follower` answers to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from flexhinf.arrays import Matrix, Vector
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.follow import follow_values
from flexhinf.export.follow_trial import Event, FollowerTrial, events, refusals, session_of
from flexhinf.export.rehearsal import FAR, LARGEST
from flexhinf.robot.follow_goal import FollowGoal
from flexhinf.robot.follow_limits import ANYWHERE
from flexhinf.robot.follower import FollowCode, Follower, FollowMotion, FollowReason

#: Largest difference of C and Python, relative to the largest number of its column, by type.
CLOSE = {"double": 1e-13, "float": 2e-4}


class PointRow(NamedTuple):
    """A waypoint as the program reads it: time, position, derivatives (n,), NaN where not stated; order."""

    time: float
    position: Vector
    velocity: Vector
    acceleration: Vector
    order: int


@dataclass(frozen=True)
class GoalRow:
    """A goal as the program reads it: its part of all points, which joints move (n,), and tolerances (2, 2, n)."""

    first: int
    count: int
    moves: Vector
    begins: float
    tolerances: Matrix
    time: float


class EventRow(NamedTuple):
    """An event as the program reads it; `kind`: 0 nothing, 1 a goal, 2 cancel, 3 another pose, 4 the end of every goal;
    `number`: of the goal, or with which code goals end."""

    step: int
    kind: int
    goal: int
    number: int
    answer: int
    rates: tuple[float, float]
    away: Matrix
    pose: Vector


def follow_test_values(code: ControllerCode) -> dict[str, object]:
    """What the template of the test program needs."""
    session = session_of(code)
    follower, happens, refused = session.follower, events(session), refusals(session)
    plain = replace(
        follower,
        partial=False,
        limited=True,
        goal_tolerance={},
        path_tolerance={},
        goal_time=0.0,
        timeout=0.0,
    )
    checked = [(one, follower.check(one), plain.check(one)) for one in refused]
    started = [event.what for event in happens if isinstance(event.what, FollowGoal)]
    played = _played(session, happens)
    samples, says = played.samples, played.says
    kept = _rows(session, samples[:: session.every])
    sizes = np.abs(kept).max(axis=0)
    values = follow_values(code)
    points, goals = _tables([*started, *refused], follower)
    return {
        **values,
        "options": follower,
        "points": points,
        "goals": goals,
        "checks": [(len(started) + k, int(own), int(other)) for k, (_, own, other) in enumerate(checked)],
        "lows": [low if low > -ANYWHERE else 0.0 for low in follower.own.low],
        "highs": [high if high < ANYWHERE else 0.0 for high in follower.own.high],
        "peaks": follower.own.peak,
        "paced": follower.own.paced,
        "events": _event_rows(happens, played, len(session.way)),
        "ended": played.ended,
        "home": session.home,
        "kept": kept,
        "sizes": np.maximum(sizes, 1e-6 * sizes.max()),
        "every": session.every,
        "steps": len(samples),
        "says": [(k, *one) for k, one in enumerate(says) if k == 0 or one != says[k - 1]],
        "close": CLOSE[code.real.name],
        "far": Markup(FAR[code.real.name]),
        "largest": Markup(LARGEST[code.real.name]),
    }


class Played(NamedTuple):
    """What a follower made of a session."""

    samples: list[FollowMotion]
    says: list[tuple[int, int]]  # of each sample, and whether a goal waits
    answers: list[int]  # to events
    numbers: list[int]  # of their goals
    ended: list[tuple[int, int, int, int]]  # step, number, code and reason


def _ends_of(step: int, follower: Follower) -> list[tuple[int, int, int, int]]:
    return [(step, number, int(code), int(reason)) for number, code, reason in follower.ends]


def _played(session: FollowerTrial, happens: Sequence[Event]) -> Played:
    """Play the session."""
    follower, n = session.follower, len(session.way)
    follower.reset(session.home)
    at, moves, now = session.home, np.zeros(n), happens[0]
    found, started, later = Played([], [], [], [], []), 0, list(happens)
    for k in range(happens[-1].step):
        while later[0].step <= k:
            now = later.pop(0)
            answer, number = int(FollowCode.ACTIVE), 0
            if isinstance(now.what, FollowGoal):
                started = number = started + 1
                answer = int(follower.start(now.what, number))
            elif isinstance(now.what, str) and now.what == "end":
                number = int(FollowCode.PATH_TOLERANCE_VIOLATED)
                follower.end_all(FollowCode.PATH_TOLERANCE_VIOLATED, FollowReason.DROPPED)
            elif isinstance(now.what, str):
                number = started + 1 - now.back if now.back else 0
                follower.cancel(number)
            elif now.what is not None:
                follower.reset(now.what)
                at, moves = now.what, np.zeros(n)
            found.answers.append(answer)
            found.numbers.append(number)
            if now.what is not None:
                found.ended.extend(_ends_of(k, follower))
        away = np.zeros((2, n)) if now.away is None else now.away
        sample = follower.advance(at + away[0], moves + away[1], now.speed, now.rate)
        at, moves = sample.position, sample.velocity
        found.samples.append(sample)
        found.says.append((int(sample.result), int(follower.waits)))
        found.ended.extend(_ends_of(k, follower))
    return found


def _rows(session: FollowerTrial, samples: Sequence[FollowMotion]) -> np.ndarray:
    """What the program compares of samples: state, input, places and velocities."""
    motions, positions, velocities, _ = map(np.array, zip(*samples))
    state, u = session.follower.robot.inverse_dynamics(*motions.transpose(1, 0, 2))
    return np.hstack([state, u, positions, velocities])


def _event_rows(happens: Sequence[Event], played: Played, n: int) -> list[EventRow]:
    """Events as the program reads them."""
    rows, goals = list[EventRow](), 0
    for event, answer, number in zip(
        happens, played.answers, played.numbers
    ):  # the last one ends the session
        kind = 1 if isinstance(event.what, FollowGoal) else 3
        kind = {"cancel": 2, "end": 4}[event.what] if isinstance(event.what, str) else kind
        kind = 0 if event.what is None else kind
        rows.append(
            EventRow(
                event.step,
                kind,
                goals if kind == 1 else 0,
                number,
                answer,
                (event.speed, event.rate),
                np.zeros((2, n)) if event.away is None else event.away,
                event.what if isinstance(event.what, np.ndarray) else np.zeros(n),
            )
        )
        goals += kind == 1
    return rows


def _tables(goals: Sequence[FollowGoal], follower: Follower) -> tuple[list[PointRow], list[GoalRow]]:
    """Waypoints of all goals in the robot's order, what is not stated as no number; and each goal with its part."""
    points, rows = list[PointRow](), list[GoalRow]()
    for goal in goals:
        found = goal.ordered(follower.robot.joint_names)
        moves = np.zeros(len(follower.robot.joint_names), dtype=int) if found is None else found.moves
        if found is None:  # joints that the program has no names of: none
            rows.append(
                GoalRow(len(points), 0, moves, goal.begins, np.zeros((2, 2, len(moves))), goal.goal_time)
            )
            continue
        rows.append(
            GoalRow(len(points), len(found.times), moves, goal.begins, found.tolerances, goal.goal_time)
        )
        points += [PointRow(*row) for row in zip(found.times, *found.points, found.orders, strict=True)]
    return points, rows
