"""What is done to the arms, and what is measured of each run.

A run begins at rest, with the input that holds the true robot. Encoders have noise and the step of 19 bits; inputs act
one sample later. Numbers of a run are of true link positions, joints that slide in m where others count in rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.limits.encoders import BITS, Encoders
from benchmarks.limits.laws import Product, Runs
from benchmarks.limits.paths import (
    CURVES,
    HALF,
    Path,
    chain,
    curve,
    goals_of,
    heaviest,
    held,
    jump,
    move,
    pick_and_place,
)  # fmt: skip
from benchmarks.limits.plant import Stop, TrueArm
from benchmarks.workspace.arm import LATENCY, PERIOD, Arm, damped
from benchmarks.workspace.trip import NOISE

__all__ = [
    "CURVED",
    "ENCODERS",
    "FRAMES",
    "TRIALS",
    "WITHIN",
    "Run",
    "Trial",
    "drive",
    "follow",
    "limits_of",
    "many_goals",
    "noise_of",
]

#: A joint is back where it stays within this of the command, rad or m.
WITHIN = 5e-3
#: Goals of a trial, those of "met", and robots at corners that share these; their seeds.
GOALS, MANY, ROBOTS, SEED, MANY_SEED, NOISE_SEED, CORNERS_SEED = 2, 40, 8, 5, 2026, 3, 17
#: Rest behind a trial, s; rest before the goals in which a loop learns the payload.
AFTER, SETTLE = 2.5, 2.0
#: A move ends: samples that count for the remaining error and the ripple.
TAIL = 300
#: Slow moves: share of the speed limits, and of the way to a goal.
SLOW, SHORT = 0.02, 0.1
#: Robots of continuous tracking beside the nominal one.
CORNERS = 2


@dataclass(frozen=True)
class Trial:
    """Something that happens to an arm."""

    title: str
    brake: float = 0.0  # s, from the middle of a move on
    stop: float = 0.0  # s, an obstacle from the middle of a move on
    jump: float = 0.0  # rad, of the command of the first joint
    power: float = 1.0  # what the drives give, of the limits
    off: float = 0.0  # rad, how far all joints are from where the controller begins
    late: int = 0  # more samples of latency
    bits: int = BITS  # of a turn of the encoders
    noisy: bool = True
    half_rate: str = ""  # "links" or "all", whose encoders tell something new at every second sample
    slow: bool = False  # a short slow move
    rest: bool = False
    silent: float = 0.0  # s, from the middle of a move on the sensors repeat what they told
    missing: bool = False  # or give NaN

    @property
    def lasts(self) -> float:
        """Time from the middle of a move on for which something happens, s."""
        return self.brake + self.stop + self.silent


#: By name.
TRIALS = {
    "brake-0.02": Trial("brakes for 0.02 s in mid-move", brake=0.02),
    "brake-0.1": Trial("brakes for 0.1 s in mid-move", brake=0.1),
    "brake-0.5": Trial("brakes for 0.5 s in mid-move", brake=0.5),
    "stop": Trial("an obstacle for 0.5 s in mid-move", stop=0.5),
    "jump-0.05": Trial("the command jumps by 0.05 rad", jump=0.05),
    "jump-0.2": Trial("the command jumps by 0.2 rad", jump=0.2),
    "jump-0.5": Trial("the command jumps by 0.5 rad", jump=0.5),
    "undersized": Trial("drives with half of the torque, full speed", power=0.5),
    "power-on": Trial("power-on 0.2 rad from the command", off=0.2),
    "late": Trial("two more samples of latency", late=2),
}
#: What encoders tell, by name: without noise, of few bits, at half of the rate; and frames that do not come.
ENCODERS = {
    **{
        f"{name}-{bits}": replace(trial, title=f"{bits} bits: {trial.title}", bits=bits, noisy=False)
        for bits in (13, 17, BITS)
        for name, trial in {
            "rest": Trial("at rest", rest=True),
            "slow": Trial("a slow move", slow=True),
            "brake": Trial("brakes for 0.1 s", brake=0.1),
            "held": Trial("an obstacle for 0.5 s", stop=0.5),
        }.items()
    },
    "half-rate": Trial("all at half of the rate", noisy=False, half_rate="all"),
    "half-rate-links": Trial("those of links at half of the rate", noisy=False, half_rate="links"),
}
FRAMES = {
    f"{'missing' if missing else 'repeated'}-{ms}": Trial(f"{ms} ms", silent=1e-3 * ms, missing=missing)
    for missing in (False, True)
    for ms in (2, 3, 5, 10)
}
#: Paths that are followed.
CURVED = {"eight": "figure of eight", "circle": "circle", "pick": "pick and place"}


@dataclass(frozen=True, eq=False)
class Run:
    """One run: true links (N, n), their velocities, inputs, and whether the arm was lost."""

    q: np.ndarray
    dq: np.ndarray
    u: np.ndarray
    lost: bool


def noise_of(arm: Arm) -> np.ndarray:
    """Standard deviation of the encoders' noise, (n,)."""
    return np.where(arm.slides, NOISE[1], NOISE[0])


def drive(
    plant: TrueArm, law: Runs, path: Path, queue: list[np.ndarray], noise: np.ndarray, rng: np.random.Generator,
    trial: Trial | None = None,
) -> Run:  # fmt: skip
    """One path; the run ends where the arm is lost: half of its range beyond it, or not a number."""
    arm, count = plant.arm, len(path)
    errors = np.tile(noise, 2) * rng.standard_normal((count, 2 * arm.n))
    encoders = Encoders.of(arm, errors, trial, path.moving // 2)
    q, dq, u = (np.zeros((count, arm.n)) for _ in range(3))
    middle, span = 0.5 * (arm.lower + arm.upper), arm.upper - arm.lower
    begin, own = path.moving // 2, isinstance(law, Product)
    limit = arm.limit * (1.0 if trial is None else trial.power)
    for k in range(count):
        if trial is not None and k == begin:
            if trial.brake:
                plant.brake(True)
            if trial.stop:
                j = int(np.argmax(np.abs(path.goal - path.start) / arm.speed))
                plant.stop = Stop(j, path.links[begin, j], float(np.sign(path.goal - path.start)[j]))
        if trial is not None and k == ended(trial, path):
            plant.brake(False)
            plant.stop = None
        links, motors = plant.read()
        if not (np.abs(links - middle) <= span).all():
            return Run(q[:k], dq[:k], u[:k], True)
        q[k] = links
        y = encoders.read(k, np.concatenate((links, motors)))
        u[k] = np.minimum(np.maximum(law.step(y, path.reference(k, own)), -limit), limit)
        queue.append(u[k])
        plant.advance(queue.pop(0))
    dq[1:] = np.diff(q, axis=0) / PERIOD
    return Run(q, dq, u, False)


def ended(trial: Trial, path: Path) -> int:
    """The sample from which recovery counts: brakes are let go, the obstacle goes, the command stands still."""
    if trial.lasts:
        return path.moving // 2 + round(trial.lasts / PERIOD)
    return path.moving


# Limits ---------------------------------------------------------------------------------------------
def paths_of(arm: Arm, heavy: Arm, trial: Trial) -> list[tuple[Path, np.ndarray]]:
    """The paths of a trial, and where the arm is when each begins."""
    goals, found = goals_of(arm, heavy, GOALS, SEED), list[tuple[Path, np.ndarray]]()
    if trial.off:
        away = np.where(arm.slides, 0.05 * (arm.upper - arm.lower), trial.off)
        away = np.where(arm.home + away > arm.upper, -away, away)
        return [(held(arm, arm.home, AFTER), arm.home + away)]
    if trial.rest:
        return [(held(arm, arm.home, AFTER), arm.home)]
    for k, goal in enumerate(goals):
        if trial.jump:
            start, to = (arm.home, goal)[k], np.array((arm.home, goal)[k])
            side = 1.0 if start[0] < 0.5 * (arm.lower + arm.upper)[0] else -1.0
            to[0] += side * trial.jump
            found.append((jump(arm, start, to, AFTER), start))
        else:
            speed = SLOW if trial.slow else 1.0 if trial.power < 1.0 else HALF
            to = arm.home + SHORT * (goal - arm.home) if trial.slow else goal
            found.append((move(arm, heavy, arm.home, to, speed, AFTER), arm.home))
    return found


def limits_of(arm: Arm, law: Runs, trial: Trial) -> dict[str, Any]:
    """The worst of a trial's runs: beyond the goal or the start, speed, time until all joints are back, status."""
    heavy, rows = heaviest(arm.robot), list[dict[str, Any]]()
    true = damped(arm)
    for index, (path, begin) in enumerate(paths_of(arm, heavy, trial)):
        plant = TrueArm(true)
        plant.rest(begin)
        law.start(path.start)
        queue = [true.rest(begin)[1]] * (LATENCY + trial.late)
        rng = np.random.default_rng([NOISE_SEED, index])
        with np.errstate(all="ignore"):
            run = drive(plant, law, path, queue, noise_of(arm), rng, trial)
        end = ended(trial, path)
        cause = PERIOD * (path.moving // 2) if trial.lasts else 0.0
        rows.append(
            _numbers(arm, path, begin, run, end, end if trial.stop else 0)
            | {"status": law.status, "said": law.said, "cause": cause}
        )
    status = 0
    for row in rows:
        status |= row["status"]
    back = [row["back"] for row in rows]
    return {
        "beyond": _most(rows, "beyond"), "speed": _most(rows, "speed"),
        "back": None if None in back else max(back), "status": status, "runs": len(rows),
        "lost": sum(row["lost"] for row in rows), "refused": getattr(law, "refused", 0),
        "hold": float(max(row["hold"] for row in rows)), "away": _most(rows, "away"), **said(rows),
    }  # fmt: skip


def said(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What a controller said in runs whose causes begin at times `cause`, s: when after these a protective stop would
    have begun, and its bits, of each run; the longest time for which frames counted as repeated ones, in samples; and
    readings that were not believed. Nothing of a rival."""
    told = [row["said"] for row in rows if row["said"]]
    stops = [None if one["stop"] is None else [round(one["stop"][0] - row["cause"], 3), one["stop"][1]]
             for one, row in zip(told, rows)]  # fmt: skip
    return {} if not told else {
        "stops": stops, "unseen": max(one["unseen"] for one in told), "rejected": sum(one["rejected"] for one in told),
    }  # fmt: skip


def _numbers(arm: Arm, path: Path, begin: np.ndarray, run: Run, end: int, first: int) -> dict[str, Any]:
    """Of a run that recovers from the sample `end` on; speeds count from `first` on: an impact is not the law's."""
    weight = max(
        float((np.abs(arm.rest(q)[1]) / arm.limit).max()) for q in path.links[:: max(1, len(path) // 20)]
    )
    if run.lost:
        return {"lost": True, "beyond": None, "speed": None, "back": None, "hold": weight, "away": None}
    ends = np.array([begin, path.start, path.goal])
    beyond = np.maximum(run.q - ends.max(axis=0), ends.min(axis=0) - run.q).max()
    away = np.abs(run.q - path.links)
    outside = np.flatnonzero(np.any(away > WITHIN, axis=1))
    last = int(outside[-1]) + 1 if len(outside) else 0
    return {
        "lost": False, "beyond": max(0.0, float(beyond)), "speed": float((np.abs(run.dq[first:]) / arm.speed).max()),
        "back": None if last >= len(run.q) else max(0.0, PERIOD * (last - end)), "hold": weight,
        "away": float(away.max()),
    }  # fmt: skip


def _most(rows: Sequence[dict[str, Any]], name: str) -> float | None:
    """The largest; None where an arm is lost."""
    values = [row[name] for row in rows]
    return None if None in values else float(f"{max(values):.4g}")


# Tracking -------------------------------------------------------------------------------------------
def follow(arm: Arm, law: Runs, path: str) -> dict[str, Any]:
    """Peak and root mean square of the links' distance from where they should be at the time: nominal and corners."""
    heavy = heaviest(arm.robot)
    if path in CURVES:
        paths = [curve(arm, heavy, path)]
    else:
        paths = pick_and_place(arm, heavy, goals_of(arm, heavy, 2, SEED))
    corners = [Arm.of(arm.robot, values) for values in arm.robot.random_corners(CORNERS, CORNERS_SEED)]
    row: dict[str, Any] = {"seconds": sum(len(one) for one in paths) * PERIOD, "status": 0}
    for name, arms in (("nominal", [arm]), ("corners", corners)):
        peak, rms = 0.0, 0.0
        for true in map(damped, arms):
            errors = _errors(true, law, paths)
            row["status"] |= law.status
            peak = max(peak, np.inf if errors is None else float(np.abs(errors).max()))
            rms = max(rms, np.inf if errors is None else float(np.sqrt(np.mean(errors**2, axis=0)).max()))
        row[name] = {"peak": _finite(peak), "rms": _finite(rms)}
    return row


def _errors(true: Arm, law: Runs, paths: Sequence[Path]) -> np.ndarray | None:
    """Errors (N, n) of all paths after a rest in which the loop learns the payload; None where the arm is lost."""
    plant, queue, rng = begun(true, law, paths[0].start)
    found = list[np.ndarray]()
    for path in paths:
        with np.errstate(all="ignore"):
            run = drive(plant, law, path, queue, noise_of(true), rng)
        if run.lost:
            return None
        found.append(run.q - path.links)
    return np.concatenate(found)


def begun(
    true: Arm, law: Runs, start: np.ndarray, noise: np.ndarray | None = None
) -> tuple[TrueArm, list[np.ndarray], np.random.Generator]:
    """A true arm that the law has held for some time: plant, inputs that are on their way, noise."""
    plant, rng = TrueArm(true), np.random.default_rng(NOISE_SEED)
    plant.rest(start)
    law.start(start)
    queue = [true.rest(start)[1]] * LATENCY
    nominal = Arm.of(true.robot)
    drive(plant, law, held(nominal, start, SETTLE), queue, noise_of(true) if noise is None else noise, rng)
    law.status = 0
    return plant, queue, rng


def _finite(value: float) -> float | None:
    return float(f"{value:.4g}") if np.isfinite(value) else None


# Met ------------------------------------------------------------------------------------------------
def many_goals(arm: Arm, law: Runs, noise: np.ndarray, count: int = MANY) -> dict[str, Any]:
    """Moves of robots at corners of their tolerances, each robot its share of the goals: the worst of each number."""
    heavy, goals = heaviest(arm.robot), np.empty((0, arm.n))
    goals = goals_of(arm, heavy, count, MANY_SEED)
    arms = [damped(Arm.of(arm.robot, values)) for values in arm.robot.random_corners(ROBOTS, CORNERS_SEED)]
    rows, lost, status = list[dict[str, float]](), 0, 0
    for true, part in zip(arms, np.array_split(goals, ROBOTS)):
        if not len(part):
            continue
        plant, queue, rng = begun(true, law, arm.home, noise)
        for path in chain(arm, heavy, arm.home, part):
            with np.errstate(all="ignore"):
                run = drive(plant, law, path, queue, noise, rng)
            status |= law.status
            if run.lost:
                lost += 1
                break
            rows.append(_move(arm, path, run))
    keys = rows[0] if rows else {}
    return {
        "moves": len(goals), "run": len(rows), "lost": lost, "status": status,
        **{key: [float(f"{row[key]:.4g}") for row in rows] for key in keys},
    }  # fmt: skip


def _move(arm: Arm, path: Path, run: Run) -> dict[str, float]:
    """The numbers of a move that a design is judged by."""
    travel = np.abs(path.goal - path.start)
    low, high = np.minimum(path.start, path.goal), np.maximum(path.start, path.goal)
    wrong = np.where(path.goal > path.start, low - run.q.min(axis=0), run.q.max(axis=0) - high)
    share = travel / (arm.upper - arm.lower)
    largest = np.array([np.where(arm.slides == kind, travel, share * span).max()
                        for kind, span in zip(arm.slides, arm.upper - arm.lower)])  # fmt: skip
    scale = np.maximum(travel, 0.05 * largest)
    return {
        "remaining error": float(np.abs(run.q[-TAIL:] - path.goal).max()),
        "tracking error": float(np.abs(run.q - path.links).max()),
        "motion the wrong way": float(np.max(100.0 * np.maximum(wrong, 0.0) / scale)),
        "ripple of the motors": 100.0 * float((run.u[-TAIL:].std(axis=0) / arm.limit).max()),
    }
