"""What the arms are told to do: moves, curves at full speed, jumps of the command, and rest.

Every law gets the same command: the states of the nominal robot by its inverse dynamics, and the input for the middle
of the hold in which this sample's input acts. A path is slower where the heaviest robot of the tolerances would need
more than `SHARE` of a motor's limit on the way; that is computed by Pinocchio.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.workspace.arm import LATENCY, PERIOD, Arm, pin
from benchmarks.workspace.goals import Reference, goals, quintic

__all__ = [
    "CURVES",
    "HALF",
    "Path",
    "chain",
    "curve",
    "goals_of",
    "heaviest",
    "held",
    "jump",
    "move",
    "pick_and_place",
    "whole",
]

#: Share of a motor's limit that a path may need; factor of time by which it is made slower; rest behind it, s.
SHARE, SLOWER, REST = 0.9, 1.1, 1.0
#: Shortest move, s; share of the speed limits of moves between goals.
SHORTEST, HALF = 0.5, 0.5
#: Amplitude of curves, rad or share of the range of a joint that slides; turns; time in which their speed rises, s.
AMPLITUDE, TURNS, RISE = 0.3, 2, 0.4
#: Robots of which the heaviest is taken, and their seed.
CORNERS, SEED = 16, 3

#: q and four derivatives (N, n) at times (N,).
Planned = Callable[[np.ndarray], list[np.ndarray]]


@dataclass(frozen=True, eq=False)
class Path:
    """A command, one row per sample; `moving` samples of it move, the rest is at the goal."""

    start: np.ndarray  # (n,)
    goal: np.ndarray
    links: np.ndarray  # (N, n), where the links should be
    own: np.ndarray  # (N, states) of the robot
    states: np.ndarray  # (N, 4n), q, q̇, θ, θ̇
    inputs: np.ndarray  # (N, n)
    moving: int

    def __len__(self) -> int:
        return len(self.links)

    def reference(self, sample: int, own: bool) -> Reference:
        """What a law is told: states of the robot's own, or of all motors."""
        states = self.own if own else self.states
        return Reference(states[sample], self.inputs[sample], states[min(sample + LATENCY, len(self) - 1)])


def whole(arm: Arm, states: np.ndarray) -> np.ndarray:
    """States (N, 4n) of a robot whose joints without springs have no motor states."""
    n, elastic = arm.n, np.flatnonzero(np.isfinite(arm.stiffness))
    q, dq = states[:, :n], states[:, n : 2 * n]
    theta, dtheta = q.copy(), dq.copy()
    theta[:, elastic] = states[:, 2 * n : 2 * n + len(elastic)]
    dtheta[:, elastic] = states[:, 2 * n + len(elastic) :]
    return np.hstack([q, dq, theta, dtheta])


def _path(arm: Arm, at: Planned, duration: float, rest: float) -> Path:
    time = PERIOD * np.arange(round((duration + rest) / PERIOD))
    rows = at(time)
    own, _ = arm.robot.inverse_dynamics(*rows)
    _, inputs = arm.robot.inverse_dynamics(*at(time + (LATENCY + 0.5) * PERIOD))
    links = rows[0]
    return Path(links[0], links[-1], links, own, whole(arm, own), inputs, round(duration / PERIOD))


def heaviest(robot: Any) -> Arm:
    """The heaviest of robots at corners of the tolerances."""
    arms = [Arm.of(robot, values) for values in robot.random_corners(CORNERS, SEED)]
    return max(arms, key=lambda arm: float(arm.mass.sum()))


def needed(arm: Arm, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """Largest input (n,) along rows (N, n), in parts of the limits, as if the springs were rigid."""
    most = np.zeros(arm.n)
    for a, b, c in zip(q, dq, ddq):
        torque = (
            pin.rnea(arm.model, arm.memory, a, b, c) + arm.rotor * c + arm.viscous * b + arm.dry * np.sign(b)
        )
        most = np.maximum(most, np.abs(torque / arm.per_input) / arm.limit)
    return most


def _possible(heavy: Arm, make: Callable[[float], Planned], duration: float) -> float:
    """The duration, longer where the heaviest robot's motors could not follow."""
    for _ in range(20):
        q, dq, ddq, *_ = make(duration)(np.linspace(0.0, duration, 60))
        if needed(heavy, q, dq, ddq).max() <= SHARE:
            break
        duration *= SLOWER
    return duration


def move(
    arm: Arm, heavy: Arm, start: np.ndarray, goal: np.ndarray, speed: float = HALF, rest: float = REST
) -> Path:
    """A quintic in time at a share of the speed limits."""
    duration = max(SHORTEST, float(np.max(1.875 * np.abs(goal - start) / (speed * arm.speed))))
    duration = _possible(heavy, lambda time: quintic(start, goal, time), duration)
    return _path(arm, quintic(start, goal, duration), duration, rest)


def goals_of(arm: Arm, heavy: Arm, count: int, seed: int) -> np.ndarray:
    """Goals (count, n) at which the heaviest robot needs 70 % of its motors or less, from home to each other too."""
    found = list[np.ndarray]()
    for goal in goals(arm, heavy, 20 * count, seed)[0]:
        way = quintic((found or [arm.home])[-1], goal, 1.0)(np.linspace(0.0, 1.0, 20))[0]
        if needed(heavy, way, 0.0 * way, 0.0 * way).max() <= SHARE:
            found.append(goal)
        if len(found) == count:
            break
    return np.array(found)


def held(arm: Arm, q: np.ndarray, rest: float) -> Path:
    """Rest at a pose."""
    return jump(arm, q, q, rest)


def jump(arm: Arm, start: np.ndarray, goal: np.ndarray, rest: float) -> Path:
    """The command jumps to a goal at once; `start` is where the arm is."""
    count = round(rest / PERIOD)
    state, u = arm.robot.inverse_dynamics(goal)
    own = np.tile(state, (count, 1))
    return Path(start, goal, np.tile(goal, (count, 1)), own, whole(arm, own), np.tile(u, (count, 1)), 0)


def chain(arm: Arm, heavy: Arm, start: np.ndarray, goals: np.ndarray) -> list[Path]:
    """Moves from goal to goal at half the speed limits."""
    return [move(arm, heavy, a, b) for a, b in zip([start, *goals[:-1]], goals)]


def pick_and_place(arm: Arm, heavy: Arm, goals: np.ndarray) -> list[Path]:
    """From home to a place, to another, back to the first: at the full speed limits."""
    a, b = goals[:2]
    return [move(arm, heavy, *pair, speed=1.0) for pair in ((arm.home, a), (a, b), (b, a))]


# Curves ---------------------------------------------------------------------------------------------
def _circle(phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.sin(phase), 1.0 - np.cos(phase)


def _eight(phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.sin(phase), 0.5 * np.sin(2.0 * phase)


#: Curves of the first two joints, in parts of the amplitude.
CURVES: dict[str, Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]] = {
    "eight": _eight,
    "circle": _circle,
}

#: Speed rises as 126 x⁵ − 420 x⁶ + 540 x⁷ − 315 x⁸ + 70 x⁹, with four continuous derivatives.
_RISING = np.polynomial.Polynomial([0.0] * 5 + [126.0, -420.0, 540.0, -315.0, 70.0])
_RISEN = _RISING.integ()
#: Derivatives by differences of this time, s: the third and fourth are exact to 1e-4 of theirs.
_DIFFERENCE = 2e-3
_STENCILS = np.array(
    [
        [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        [-1 / 60, 3 / 20, -3 / 4, 0.0, 3 / 4, -3 / 20, 1 / 60],
        [1 / 90, -3 / 20, 3 / 2, -49 / 18, 3 / 2, -3 / 20, 1 / 90],
        [1 / 8, -1.0, 13 / 8, 0.0, -13 / 8, 1.0, -1 / 8],
        [-1 / 6, 2.0, -13 / 2, 28 / 3, -13 / 2, 2.0, -1 / 6],
    ]
)


def curve(arm: Arm, heavy: Arm, shape: str) -> Path:
    """Two turns of a curve about home by the first two joints, at the speed limits where the motors can."""
    count = min(2, arm.n)
    room = np.minimum(arm.upper - arm.home, arm.home - arm.lower)[:count]
    size = np.zeros(arm.n)
    size[:count] = np.minimum(AMPLITUDE, 0.45 * room)

    def at_speed(rate: float) -> tuple[Planned, float]:
        whole_time = 2.0 * np.pi * TURNS / rate + RISE  # rising and falling cover half of what they last

        def phase(time: np.ndarray) -> np.ndarray:
            t = np.clip(time, 0.0, whole_time)
            up, down = np.minimum(t, RISE) / RISE, np.maximum(t - whole_time + RISE, 0.0) / RISE
            run = RISE * _RISEN(up) + np.clip(t - RISE, 0.0, whole_time - 2.0 * RISE)
            return rate * (run + RISE * (down - _RISEN(down)))

        def planned(time: np.ndarray) -> list[np.ndarray]:
            values = []
            for k in range(-3, 4):
                q = np.tile(arm.home, (len(time), 1))
                for i, part in enumerate(CURVES[shape](phase(time + k * _DIFFERENCE))[:count]):
                    q[:, i] += size[i] * part
                values.append(q)
            return [np.tensordot(row, values, 1) / _DIFFERENCE**order for order, row in enumerate(_STENCILS)]

        return planned, whole_time

    slope = np.array(CURVES[shape](np.linspace(0.0, 2.0 * np.pi, 400)))[:count]
    steepest = np.abs(np.gradient(slope, 2.0 * np.pi / 399, axis=1)).max(axis=1)
    rate = float(np.min(arm.speed[:count] / (size[:count] * steepest)))
    rate = min(rate, 2.0 * np.pi * TURNS / RISE)  # rising and falling do not meet
    for _ in range(40):
        planned, duration = at_speed(rate)
        q, dq, ddq, *_ = planned(np.linspace(0.0, duration, 80))
        if needed(heavy, q, dq, ddq).max() <= SHARE:
            break
        rate /= SLOWER
    return _path(arm, planned, duration, 0.5)
