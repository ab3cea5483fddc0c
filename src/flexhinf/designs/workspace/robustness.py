"""What a controller of a workspace tolerates beyond what is required of it: the least margins of its poses, and
the errors and the stability of pairs."""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from flexhinf.analysis import LinearLoop
from flexhinf.analysis.optimiser import bisected
from flexhinf.copies import beside, shared_out
from flexhinf.designs.plans import STILL
from flexhinf.designs.responses import Move, with_values
from flexhinf.designs.resting import CornerLoop, PoseLoop
from flexhinf.designs.workspace.proof import computed_tolerance, proved_stability
from flexhinf.designs.workspace.samples import FURTHER, POSES_SEED, corner_moves, ends_of
from flexhinf.designs.workspace.setup import HOLD, WorkspaceSetup
from flexhinf.modal import ProvedRange
from flexhinf.modal.multipliers import PopovTolerance

#: Largest extra delay, samples, and largest factor of the inputs up to which margins are searched for; share of that
#: range to which they are found.
LATEST, LOUDEST, ACCURACY = 20.0, 100.0, 3e-4

#: Dry friction by its numbers; a cause is named where this share of the remaining error, or less, is left without it; a
#: longer rest after a move, s.
DRY_FRICTION, MOSTLY, LONGER = ("coulomb_friction", "static_friction"), 0.7, 5.0


class Robustness(NamedTuple):
    """What a controller of a workspace tolerates, beyond what is required of it."""

    delay: float  # extra delay until the first pose is unstable, samples
    undamped_delay: float  # the same with springs that nothing damps; 0 where one is unstable as it is
    louder: float  # factor of all inputs until the first pose is unstable
    softer: float  # the same below 1
    heavy: int  # number of the judged poses at which the heaviest robot needs more than `HOLD` of a motor's limit
    unheld: int  # number of those at which it needs more than the limit
    fastest: tuple[
        float, str
    ]  # frequency of the fastest vibration of the robot and its corners, Hz, and its joint
    # errors of masses of either sign, all pairs; computed. None of a law that is not made of pairs
    tolerance: PopovTolerance | None
    proved: ProvedRange | None  # pairs whose stability is proved, latency and filter included; None likewise
    # (3, n), by offsets of encoders at home, rad or m: transient, at once and as deployed; rest
    offsets: np.ndarray


class PairResults(NamedTuple):
    """What holds for all pairs, each by a function that waits for it; None of a law that is not made of pairs."""

    stable: Callable[[], ProvedRange | None]  # pairs that are proved to be stable
    tolerance: Callable[[], PopovTolerance | None]  # errors of masses of either sign; computed


@contextmanager
def pair_results(setup: WorkspaceSetup) -> Generator[PairResults]:
    """Begin both, each by a process of its own as soon as one is free."""
    if setup.pairs is None:
        yield PairResults(lambda: None, lambda: None)
        return
    with (
        beside(lambda: proved_stability(setup)) as stable,
        beside(lambda: computed_tolerance(setup)) as tolerance,
    ):
        yield PairResults(stable, tolerance)


def robustness(
    setup: WorkspaceSetup,
    poses: np.ndarray,
    judged: Sequence[PoseLoop],
    undamped_loops: Sequence[CornerLoop],
    pairs: PairResults | None = None,
) -> Robustness:
    """Margins at the worst of some poses (N, n), and what holds for every pair.

    `judged` are the loops at these poses, `undamped_loops` those whose springs nothing damps; `pairs` what holds for
    all pairs, where it was begun before.
    """
    s, loops = setup.specification, [setup.linear(pose) for pose in poses]

    def margin(key: str, end: float, tried: list[LinearLoop]) -> float:
        """Samples of delay, or the factor of the inputs, `end` its logarithm, at which the first loop is unstable."""
        late = key == "late"

        def stable(k: int, size: float) -> bool:
            by, extra = (1.0, size * s.period) if late else (np.exp(size), 0.0)
            loop = replace(tried[k], b=by * tried[k].b, d=by * tried[k].d)
            return loop.system(loop.delay + extra).stable

        least, order = end, np.argsort([-getattr(loop, key) for loop in judged]).tolist()
        for k in order:
            if k == order[0] or not stable(k, least):
                least, _ = bisected(partial(stable, k), 0.0, least, ACCURACY * abs(end), relative=False)
        return least if late else float(np.exp(least))

    def undamped() -> float:
        if max(loop.growth for loop in undamped_loops) >= 1.0:
            return 0.0
        return margin("late", LATEST, [setup.linear(pose, damped=False) for pose in poses])

    needs = setup.needs(poses, setup.robot.heaviest)
    at = np.array(setup.workspace.home)
    independent: list[Callable[[], Any]] = [  # about the longest first
        undamped,
        lambda: margin("late", LATEST, loops),
        lambda: margin("louder", np.log(LOUDEST), loops),
        lambda: margin("softer", -np.log(LOUDEST), loops),
        lambda: fastest_vibration(setup, poses),
        lambda: np.vstack([setup.encoder_offsets(at, None)[0], setup.encoder_offsets(at)]),
    ]
    with pair_results(setup) if pairs is None else nullcontext(pairs) as own:
        undamped_delay, delay, louder, softer, fastest, offsets = shared_out(
            lambda each: each(), independent, compiles=False
        )
        tolerance, proved = own.tolerance(), own.stable()
    return Robustness(
        delay,
        undamped_delay,
        louder,
        softer,
        int(np.sum(needs > HOLD)),
        int(np.sum(needs > 1.0)),
        fastest,
        tolerance,
        proved,
        offsets,
    )


def fastest_vibration(setup: WorkspaceSetup, poses: np.ndarray) -> tuple[float, str]:
    """Frequency of the fastest vibration at some poses (N, n), Hz, and the joint that moves most.

    Motors are free and springs undamped; of the robot and of those at corners of its tolerances.
    """
    robot, plant, s = setup.robot, setup.robot.plant(), setup.specification
    corners = robot.random_corners(len(poses), POSES_SEED + 100 * s.seed)
    fastest, worst = -1.0, (poses[0], None)
    for pose, values in [*((pose, None) for pose in poses), *zip(poses, corners)]:
        a, *_ = with_values(plant, values).linearise(*robot.operating_point(pose, (), values))
        if (rate := float(np.abs(np.linalg.eigvals(a).imag).max())) > fastest:
            fastest, worst = rate, (pose, values)
    joint = max(robot.modes(*worst), key=lambda mode: abs(mode.eigenvalue.imag)).joint
    return fastest / (2.0 * np.pi), joint


class Cause(NamedTuple):
    """What the largest remaining error of all moves comes from; errors of the worst joint, rad or m."""

    kind: str  # a quantity whose tolerance it is, "dry friction", "rest" for too short a rest; "" for none of them
    joint: int
    error: float
    without: float  # as much remains without this cause
    tolerance: bool  # whether it is that of a quantity of the robot at a corner of its tolerances


def remaining_cause(setup: WorkspaceSetup, own_moves: Sequence[Move], sampled: Sequence[Move]) -> Cause:
    """The cause of the largest remaining error: the worst move is made again without each, by itself.

    `own_moves` are those of the nominal robot, one after another; `sampled` those of robots at corners.

    The causes are the tolerances of each quantity, of all joints at once, the dry friction of the robot, and the end of
    the rest.
    """
    nominal, moves = len(own_moves), (*own_moves, *sampled)
    found = [remaining_errors(move) for move in moves]
    worst = int(np.argmax([errors.max() for errors in found]))
    joint, move = int(np.argmax(found[worst])), moves[worst]
    error = float(found[worst][joint])
    ends, seed, own = np.array([move.response.start, move.response.goal]), worst, setup.true.robot.nominal
    if worst >= nominal:
        rounds = (
            one
            for after in range(1 + len(FURTHER))
            for one in corner_moves(setup, after, [*ends_of(own_moves)])
        )
        _, values, seed = next(islice(rounds, worst - nominal, None))
        own = values.numbers
    tried: dict[str, tuple[dict[str, float], float]] = {"rest": (own, LONGER)}
    if setup.dry_friction:
        still = {name: 0.0 for name in own if name.startswith(DRY_FRICTION)}
        tried["dry friction"] = {**own, **still}, STILL
    changed = {name for name, value in own.items() if value != setup.true.robot.nominal[name]}
    kinds = {name: quantity_of(name, setup.joints) for name in sorted(changed)}
    for kind in dict.fromkeys(kinds.values()):
        tried[kind] = {**own, **{k: setup.true.robot.nominal[k] for k in kinds if kinds[k] == kind}}, STILL

    def without(kind: str) -> float:
        values, dwell = tried[kind]
        move = setup.move(ends, setup.true.robot.plant_parameters(values), seed, dwell)
        return float(remaining_errors(move)[joint])

    left = dict(zip(tried, shared_out(without, [*tried], compiles=False)))
    least = min(left, key=lambda kind: left[kind])
    known = np.isfinite(error) and left[least] <= MOSTLY * error
    return Cause(least if known else "", joint, error, left[least], least in kinds.values())


def remaining_errors(move: Move) -> np.ndarray:
    """Remaining errors (n,) of the joints at the end of a move, rad or m; infinite where it diverges."""
    rows = move.motion
    return np.array([row["remaining_error"] for row in rows] or [np.inf] * len(move.response.goal))


def quantity_of(name: str, joints: Sequence[str]) -> str:
    """The quantity of a robot's parameter in words: of ``stiffness_elbow`` "stiffness", of ``mass_hand`` "mass"."""
    for joint in joints:
        name = name.removesuffix(f"_{joint}")
    return re.sub("_(xx|yy|zz|xy|xz|yz|x|y|z)$", "", name).replace("_", " ")
