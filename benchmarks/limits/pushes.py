"""Pushes of arms at rest: the controller of a design beside its own law, without governor, within the same limits.

A push gives links a velocity at once. It is of one joint or of all, on either side, of 0.5 to 20 rad/s, a tenth of that
in m/s where a joint slides, at home, raised and hanging, of the nominal robot and of robots at corners of their
tolerances. The law returns from it where all joints stay within `WITHIN` of their command within `LONGEST`. The rule is
that the controller then returns too, within the law's time, the time for the law's furthest way at half the governor's
speed, and a second, and goes at most `TIMES` as far.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from benchmarks.limits.laws import Product
from benchmarks.limits.paths import heaviest, held, needed
from benchmarks.limits.plant import TrueArm
from benchmarks.limits.trials import CORNERS_SEED, NOISE_SEED, ROBOTS, WITHIN, drive, noise_of, said
from benchmarks.workspace.arm import LATENCY, PERIOD, Arm, damped, pin

__all__ = ["PUSHES", "Push", "back_from", "pushed", "pushes_of"]

#: Pushes of an arm, and their seed; slowest and fastest, rad/s; a radian of a joint that slides, m.
PUSHES, SEED, SLOWEST, FASTEST, RADIAN = 24, 2030, 0.5, 20.0, 0.1
#: Rest before a push, s; time in which a law returns or does not, s; share of its furthest way.
BEFORE, LONGEST, TIMES = 0.5, 4.0, 1.1
#: Poses of which the highest and the lowest are taken, and what they keep from the ends of the range; share of the
#: motors' limits that the heaviest robot may need there.
POSES, MARGIN, HOLD = 300, 0.1, 0.7
#: Share of the pushes that is of all joints; of robots that is at corners.
OF_ALL, AT_CORNERS = 0.35, 0.6


class Push(NamedTuple):
    """A push of a true robot that rests at a pose: velocities (n,) that its links have at once."""

    where: str
    pose: np.ndarray
    speeds: np.ndarray
    robot: Arm


def pushes_of(arm: Arm, count: int = PUSHES) -> Iterator[Push]:
    """The pushes of an arm, of every third one in turn raised, hanging and at home."""
    rng, poses = np.random.default_rng(SEED), _poses(arm)
    corners = [Arm.of(arm.robot, values) for values in arm.robot.random_corners(ROBOTS, CORNERS_SEED)]
    for k in range(count):
        where = [*poses][k % len(poses)]
        speed = np.exp(rng.uniform(np.log(SLOWEST), np.log(FASTEST))) * rng.choice([-1.0, 1.0])
        shares = speed * np.eye(arm.n)[rng.integers(arm.n)]
        if arm.n > 1 and rng.random() < OF_ALL:
            shares = speed * rng.choice([-1.0, 1.0], arm.n) * rng.uniform(0.3, 1.0, arm.n)
        corner = corners[rng.integers(len(corners))]
        robot = corner if rng.random() < AT_CORNERS else arm
        yield Push(where, poses[where], shares * np.where(arm.slides, RADIAN, 1.0), damped(robot))


def _poses(arm: Arm) -> dict[str, np.ndarray]:
    """Where the arm's weight is highest and lowest, of random poses at which the heaviest robot can be held, and
    home."""
    edge, heavy = MARGIN * (arm.upper - arm.lower), heaviest(arm.robot)
    tried = np.random.default_rng(SEED).uniform(arm.lower + edge, arm.upper - edge, (POSES, arm.n))
    found = [q for q in tried if needed(heavy, q[None], 0.0 * q[None], 0.0 * q[None]).max() <= HOLD]
    heights = [pin.computePotentialEnergy(arm.model, arm.memory, q) for q in found]
    return {
        "raised": found[int(np.argmax(heights))],
        "hanging": found[int(np.argmin(heights))],
        "home": arm.home,
    }


def back_from(arm: Arm, law: Product, push: Push, seconds: float, seed: int) -> tuple[float, float | None]:
    """Furthest distance of a joint from its command after a push, rad or m, and the time until all stay within
    `WITHIN`, s; None where they do not, or the arm is lost."""
    plant, rng = TrueArm(push.robot), np.random.default_rng([NOISE_SEED, seed])
    plant.rest(push.pose)
    law.start(push.pose)
    queue = [push.robot.rest(push.pose)[1]] * LATENCY
    drive(plant, law, held(arm, push.pose, BEFORE), queue, noise_of(arm), rng)
    plant.push(push.speeds)
    law.status = 0
    with np.errstate(all="ignore"):
        run = drive(plant, law, held(arm, push.pose, seconds), queue, noise_of(arm), rng)
    away = np.abs(run.q - push.pose)
    outside = np.flatnonzero((away > WITHIN).any(axis=1))
    late = PERIOD * (int(outside[-1]) + 1) if len(outside) else 0.0
    back = None if run.lost or late >= PERIOD * len(away) else late
    return float(away.max(initial=0.0)), back


def pushed(arm: Arm, own: Product, bare: Product, count: int = PUSHES) -> dict[str, Any]:
    """What the controller and its law do after each push: numbers of the law, of the controller, and the time that the
    rule gives it."""
    governor = own.controller.governor
    assert governor is not None
    speed = 0.5 * np.array(governor.speed)
    rows = list[dict[str, Any]]()
    for k, push in enumerate(pushes_of(arm, count)):
        furthest, back = back_from(arm, bare, push, LONGEST, k)
        row: dict[str, Any] = {
            "where": push.where, "speeds": [float(f"{one:.3g}") for one in push.speeds],
            "law": [_rounded(furthest), _rounded(back)],
        }  # fmt: skip
        if back is not None:
            allowed = back + float(np.max(furthest / speed)) + 1.0
            found = back_from(arm, own, push, allowed + 0.5, k)
            row |= {"own": [*map(_rounded, found)], "allowed": _rounded(allowed), "status": own.status}
            row |= said([{"said": own.said, "cause": BEFORE}])
        rows.append(row)
    return {"pushes": rows}


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")
