"""A law drives a true robot from goal to goal, through encoders, a queue of inputs, and its motors' limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.workspace.arm import LATENCY, Arm
from benchmarks.workspace.goals import Move
from benchmarks.workspace.laws import Law
from benchmarks.workspace.metrics import PUSH, PUSH_LENGTH, PUSHED, MoveMetrics, metrics
from benchmarks.workspace.plants import Plant

__all__ = ["CONDITIONS", "NOISE", "RESOLUTION", "Condition", "Trip", "drive", "trip"]

#: Encoders: noise and step of joints that turn, rad, and of joints that slide, m. The step is that of 19 bits.
NOISE, RESOLUTION = (1e-5, 2e-6), (2.0 * np.pi / 2**19, 1e-6)
NOISE_SEED = 3


@dataclass(frozen=True)
class Condition:
    """What is true of a run and not known to the law, but for the sensors and one sample of latency."""

    title: str
    robots: str = "nominal"  # or "payload", "sampled": see `robots.true_arms`
    friction: bool = True  # of the motors; the law feeds it forward by their planned speeds
    links: bool = True  # encoders on both sides, or on the motors alone
    latency: int = LATENCY  # samples; the law counts on `LATENCY`
    pushed: bool = False
    steps: bool = False  # bare steps of one joint, each from rest


#: By name.
CONDITIONS = {
    "nominal": Condition("the robot of the file, with dry friction"),
    "payload": Condition("with a payload that the law does not know", robots="payload"),
    "sampled": Condition("robots at corners of their tolerances", robots="sampled"),
    "late": Condition("a second sample of latency, unknown", latency=LATENCY + 1),
    "motors": Condition("motor encoders alone", links=False),
    "motors-payload": Condition("the same with the payload", robots="payload", links=False),
    "frictionless": Condition("without dry friction", friction=False),
    "push": Condition("30 % of the limits on all links for 50 ms, at rest", pushed=True),
    "steps": Condition("bare steps of one joint by 2 % of its range", steps=True),
}


@dataclass
class Trip:
    """The moves of a run, and what the law's steps took."""

    moves: list[MoveMetrics]
    step_cpu: float  # mean CPU time of a step, s
    refused: int  # steps that the law refused; its last input is held


def drive(
    arm: Arm, plant: Plant, law: Law, move: Move, queue: list[np.ndarray], condition: Condition,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, float, int]:  # fmt: skip
    """One move: true link positions and inputs at each sample (N, n), until it is lost; CPU time, refused steps."""
    n, count = arm.n, len(move)
    sensors = 2 if condition.links else 1
    noise, size = (np.tile(np.where(arm.slides, pair[1], pair[0]), sensors) for pair in (NOISE, RESOLUTION))
    errors = noise * rng.standard_normal((count, sensors * n))
    q, u = np.zeros((count, n)), np.zeros((count, n))
    middle, span = 0.5 * (arm.lower + arm.upper), arm.upper - arm.lower
    cpu, refused, last = 0.0, 0, queue[-1]
    links = PUSH * arm.limit * arm.per_input
    for k in range(count):
        true, motors = plant.read()
        if not (np.abs(true - middle) <= span).all():  # NaN too
            return q[:k], u[: max(k, 1)], cpu, refused
        q[k] = true
        y = np.concatenate((true, motors)) if condition.links else motors
        y = size * np.rint((y + errors[k]) / size)
        began = time.process_time()
        try:
            last = law.step(y, move.reference(k))
        except fh.FlexhinfError:
            refused += 1
        cpu += time.process_time() - began
        u[k] = last = arm.limited(last)
        queue.append(last)
        push = condition.pushed and count - PUSHED <= k < count - PUSHED + PUSH_LENGTH
        plant.advance(queue.pop(0), links if push else None)
    return q, u, cpu, refused


def trip(
    make_plant: Callable[[Arm], Plant],
    law: Law,
    arms: Sequence[Arm],
    moves: Sequence[Move],
    condition: Condition,
    done: Callable[[], Any] = lambda: None,
) -> Trip:
    """All moves, one after the other; several true robots share them in equal parts.

    A run begins at rest at the first move's start, with the input that holds the true robot there in the queue. A robot
    whose link leaves its joint range by half of it is lost: it is put at rest at the goal, and the law begins anew.
    Bare steps begin at rest each. The noise of a move has a seed of its own.
    """
    found, cpu, samples, refused = [], 0.0, 0, 0
    for arm, part in zip(arms, np.array_split(np.arange(len(moves)), len(arms))):
        if not len(part):
            continue
        plant, begin, queue = make_plant(arm), True, []
        for index in part:
            move = moves[index]
            if begin or condition.steps:
                plant.rest(move.start)
                law.start(move.start)
                queue = [arm.rest(move.start)[1]] * condition.latency
            rng = np.random.default_rng([NOISE_SEED, index])
            with np.errstate(all="ignore"):  # what is lost may overflow before it is seen
                q, u, seconds, refusals = drive(arm, plant, law, move, queue, condition, rng)
            one = metrics(move, q, u, arm.limit, arm.slides, arm.upper - arm.lower, condition.pushed)
            begin = one.lost
            found.append(one)
            cpu, samples, refused = cpu + seconds, samples + len(u), refused + refusals
            done()
    return Trip(found, cpu / max(samples, 1), refused)
