"""Goals over the joint range, the moves between them, and the poses at which linear loops are judged.

A move is a quintic in time at half the speed limits of the joints, then a second of rest. A bare step moves one joint
at once, the others rest. Every law gets the same reference: the state of the robot on the way by inverse dynamics of
the nominal robot without dry friction and damping of its springs, and the input that belongs to the middle of the hold
in which this sample's input will act.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.workspace.arm import LATENCY, PERIOD, Arm

__all__ = ["POSES_SEED", "REST", "STEP", "Move", "Reference", "goals", "moves", "planned", "poses", "steps"]

#: Largest share of a motor's limit that gravity with the payload may need at a goal.
HOLD = 0.7
#: Share of the range that goals keep from each end.
MARGIN = 0.02
#: Share of the speed limits, rest after a move (s), shortest move (s).
SPEED, REST, SHORTEST = 0.5, 1.0, 0.5
#: A bare step, in parts of the joint's range.
STEP = 0.02
GOALS_SEED, POSES_SEED, STEPS_SEED = 7, 1, 9


class Reference(NamedTuple):
    """What a law is told at a sample: x_d (4n,) = (q, q̇, θ, θ̇) now, u_d (n,) for when its input acts, and x_d then."""

    state: np.ndarray
    input: np.ndarray
    ahead: np.ndarray


@dataclass(frozen=True, eq=False)
class Move:
    """From a pose to another, (n,) each; one row per sample."""

    start: np.ndarray
    goal: np.ndarray
    states: np.ndarray  # (N, 4n)
    inputs: np.ndarray  # (N, n)
    latency: int = LATENCY  # samples, that the law knows

    def __len__(self) -> int:
        return len(self.states)

    def reference(self, sample: int) -> Reference:
        """What the law is told at a sample."""
        ahead = min(sample + self.latency, len(self) - 1)  # a move ends at rest
        return Reference(self.states[sample], self.inputs[sample], self.states[ahead])


def poses(arm: Arm, count: int, seed: int = POSES_SEED) -> np.ndarray:
    """Poses (count, n), uniform in the joint range."""
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, arm.n))


def goals(arm: Arm, loaded: Arm, count: int, seed: int = GOALS_SEED) -> tuple[np.ndarray, int]:
    """Goals (count, n), uniform in the joint range, and how many more were left out.

    Left out are those at which the weight with the payload needs more than 70 % of a motor's limit. The first goals of
    a larger number are those of a smaller one.
    """
    rng, keep = np.random.default_rng(seed), MARGIN * (arm.upper - arm.lower)
    found: list[np.ndarray] = []
    left = 0
    while len(found) < count:
        goal = rng.uniform(arm.lower + keep, arm.upper - keep)
        if np.all(np.abs(loaded.rest(goal)[1]) <= HOLD * arm.limit):
            found.append(goal)
        else:
            left += 1
        if left > 1000 + 100 * count:
            raise ValueError(f"{arm.robot.name}: its motors hold the payload at hardly any pose of its range")
    return np.array(found), left


def quintic(start: np.ndarray, goal: np.ndarray, duration: float) -> Callable[[np.ndarray], list[np.ndarray]]:
    """q and four derivatives (N, n) at times (N,): rest, 10 x³ − 15 x⁴ + 6 x⁵, rest."""
    shape = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])

    def at(time: np.ndarray) -> list[np.ndarray]:
        x = np.clip(time / duration, 0.0, 1.0)[:, None]
        moving = ((time >= 0.0) & (time <= duration))[:, None]
        rows = [start + (goal - start) * shape(x)]
        for order in range(1, 5):
            rows.append((goal - start) * shape.deriv(order)(x) * moving / duration**order)
        return rows

    return at


def planned(arm: Arm, start: np.ndarray, goal: np.ndarray, latency: int, duration: float) -> Move:
    """A move of this duration (s) and its second of rest."""
    at, time = quintic(start, goal, duration), PERIOD * np.arange(round((duration + REST) / PERIOD))
    states, _ = arm.robot.inverse_dynamics(*at(time))
    _, inputs = arm.robot.inverse_dynamics(*at(time + (latency + 0.5) * PERIOD))
    return Move(start, goal, states, inputs, latency)


def moves(arm: Arm, goals: np.ndarray, latency: int = LATENCY) -> list[Move]:
    """Moves from home to the first goal, and on to each next one; `latency` (samples) is what the law knows."""
    found = []
    for start, goal in zip([arm.home, *goals[:-1]], goals):
        duration = max(SHORTEST, float(np.max(1.875 * np.abs(goal - start) / (SPEED * arm.speed))))
        found.append(planned(arm, start, goal, latency, duration))
    return found


def steps(arm: Arm, goals: np.ndarray, latency: int = LATENCY, seed: int = STEPS_SEED) -> list[Move]:
    """Bare steps of one joint in turn by 2 % of its range, each from rest at a goal, towards the middle."""
    found, rng, middle = [], np.random.default_rng(seed), 0.5 * (arm.lower + arm.upper)
    first = int(rng.integers(arm.n))
    for k, start in enumerate(goals):
        joint, goal = (first + k) % arm.n, np.array(start)
        goal[joint] += STEP * (arm.upper - arm.lower)[joint] * (1.0 if start[joint] < middle[joint] else -1.0)
        count = round(REST / PERIOD)
        state, held = arm.robot.inverse_dynamics(goal)
        found.append(Move(start, goal, np.tile(state, (count, 1)), np.tile(held, (count, 1)), latency))
    return found
