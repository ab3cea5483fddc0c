"""The search for a workspace: the fastest law that keeps the limits at some poses, and the best estimator for it."""

from __future__ import annotations

import mmap
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from flexhinf.copies import shared_out
from flexhinf.designs.judge import missed_by, motion_requirements
from flexhinf.designs.specification import Specification
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.resting_loops import (
    CHOSEN_POSES,
    CHOSEN_SEED,
    EXPECTED,
    corner_damping,
    gain_limit,
    pose_limits,
)
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import NumericalFailure
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.plant import Penalty
from flexhinf.processors import thread_count
from flexhinf.robot import Robot
from flexhinf.robot.elastic import stated_friction
from flexhinf.robot.workspace import Workspace

#: Poses by which the range of λ is found; corners of the tolerances at each pose by which a law is chosen.
MODAL_POSES, CORNERS = 500, 4

#: Bandwidths that are tried, rad/s, the fastest first; weight of integrals, and γ/γ*.
BANDWIDTHS, INTEGRAL, GAMMA = (40.0, 28.0, 20.0, 14.0, 10.0, 7.0), 0.5, 1.5

#: Other γ/γ* at a bandwidth whose law with `GAMMA` keeps the limits, but does not tolerate what is asked.
OTHER_GAMMAS = (1.2, 2.0, 4.0)

#: Largest bandwidth of a soft pair, as a multiple of √λ, without and with dry friction. Friction nearly holds a motor
#: in small motions; the link then vibrates at √λ, and a law that is faster excites it: a limit cycle. Without friction,
#: twice √λ and more holds unknown loads better; 1.5 was chosen when bare steps at the motors' limits did not come to
#: rest above it, before integrals followed their motors.
SHARE = (1.5, 1.0)

#: Weights with encoders of the motors alone: a soft spring that is not seen is moved slower than it vibrates, and no
#: vibration is damped by much more than is required.
MOTORS_WEIGHTS = {"share": 0.5, "damping": 0.3}

#: Random torques that the estimator expects each sample, in parts of the motors' limits, on links and on motors, in the
#: order in which they are tried. Larger torques on motors make the loop tolerate a larger gain, with more ripple, and
#: with much noise they hide the vibration. With encoders of the motors alone they always do: half the ratio of the two
#: torques is about the damping of the estimator's own vibration.
RANDOM = (
    EXPECTED,
    (0.00125, 0.03),
    (0.0006, 0.01),
    (0.02, 0.03),
    (0.01, 0.01),
    (0.005, 0.005),
    (0.001, 0.01),
    (0.0006, 0.04),
    (0.0006, 0.07),
    (0.0025, 0.1),
)
MOTORS_RANDOM = (
    (0.033, 0.03),
    (0.02, 0.03),
    (0.011, 0.01),
    (0.005, 0.005),
    (0.0055, 0.01),
    (0.0045, 0.01),
    (0.002, 0.01),
)

#: The search asks for this factor more than each limit, since other poses are judged. Where no estimator for a law has
#: all that is wanted, a later one has to miss less than this share.
RESERVE, LESS = 1.1, 0.9

#: A law that is slower for the sake of the gain margin has to arrive in some moves of robots at corners of their
#: tolerances. Where it does not, and no margin was stated, a faster one need only tolerate this gain.
TOLERATED, TRIED_MOVES = 1.5, 4

#: Where no law meets what is required at rest, the nearest to it may be a slow one. The stiffness of a loop grows with
#: the square of its bandwidth, and springs that are softer than in the model twist by more under the same weight: a
#: slow law then leaves its path. One that misses what is required of moves so many times gives way to a faster one, if
#: that damps every oscillation at rest: its excess is less than the second number.
ASTRAY, DAMPED = 100.0, 1.0


def tuned_setup(
    robot: Robot,
    s: Specification,
    task: Task,
    progress: Callable[[str], None] = lambda text: None,
    tick: Callable[[], None] = lambda: None,
) -> WorkspaceSetup:
    """The fastest law whose loops at some random poses meet the requirements with a reserve, for the nominal robot and
    some at corners of the tolerances, with the best estimator for it; or the nearest to it. With encoders of the motors
    alone what is only preferred does not count: it would cost bandwidth.

    `tick` is called before each pose; what it raises ends the search.
    """
    chosen = fastest_setup(robot, s, task, progress, tick, list)
    assert chosen is not None
    return chosen


def fastest_setup(
    robot: Robot,
    s: Specification,
    task: Task,
    progress: Callable[[str], None],
    tick: Callable[[], None],
    tolerant: Callable[[Sequence[WorkspaceSetup]], list[WorkspaceSetup]],
) -> WorkspaceSetup | None:
    """As `tuned_setup`, of laws that tolerate something; None where there is none.

    `tolerant` gives those of some laws that do, the one that tolerates most first. It is asked only of what is nearer
    to the requirements than all before. A law that does not is left, with all its estimators; if it keeps the limits,
    `OTHER_GAMMAS` are tried at its bandwidth before a slower one. Where no law is found that keeps the limits, they are
    tried at last at the bandwidths of the others that were left, of the one that misses least first.
    """
    poses = ChosenPoses(robot, s, task.space, 2 if motors_alone(robot, s) else 4, tick)
    chosen: WorkspaceSetup | None = None
    faster: WorkspaceSetup | None = None
    least: list[float] | None = None
    damped: list[WorkspaceSetup] = []  # each nearer to the requirements than those before
    left: list[tuple[list[float], WorkspaceSetup, list[WorkspaceSetup]]] = []  # laws that miss the limits

    def of_other_gammas() -> Iterator[list[WorkspaceSetup]]:
        for _, setup, own in sorted(left, key=lambda one: one[0]):
            if least is None or any(least[:2]):
                yield from _with_other_gammas(setup, own, progress, tolerant)

    for estimators in chain(_candidates(robot, poses.wanted, task, progress), of_other_gammas()):
        if least is not None and not any(least[:3]):
            break
        before, laws = chosen, [estimators]
        while laws:
            own = laws.pop(0)
            for setup, excess in zip(own, poses.excesses(own, least)):
                if excess is None or (least is not None and excess.tolist() >= least):
                    continue
                if not tolerant([setup]):
                    if own is estimators and not any(excess[:2]):
                        laws = _with_other_gammas(setup, own, progress, tolerant)
                    elif setup.gains.weights.gamma == GAMMA:
                        left.append((excess.tolist(), setup, own))
                    break
                if least is not None and chosen is before and faster is None and not least[0]:
                    faster = before
                chosen, least = setup, (LESS * excess).tolist()
                damped += [setup] * bool(0.0 < excess[0] < DAMPED)
            if least is not None and not any(least[:2]):
                break
        if least is not None and not any(least):
            break
    if chosen is None or least is None:
        return None
    chosen = replace(chosen, specification=s)
    if least[0] and len(damped) > 1:
        return _following(chosen, [replace(setup, specification=s) for setup in damped])
    if faster is None or s.stated_by("gain_margin") != "default":
        return chosen
    faster = replace(faster, specification=s)
    return faster if tolerates(faster, TOLERATED) and 1.0 < missed(chosen) > missed(faster) else chosen


def _with_other_gammas(
    refused: WorkspaceSetup,
    estimators: Sequence[WorkspaceSetup],
    progress: Callable[[str], None],
    tolerant: Callable[[Sequence[WorkspaceSetup]], list[WorkspaceSetup]],
) -> list[list[WorkspaceSetup]]:
    """The same estimators with each law of another γ that tolerates what a law does not, as `fastest_setup` orders
    them."""
    weights, found = refused.gains.weights, list[WorkspaceSetup]()
    progress(f"gains of the pairs: {weights.bandwidth:g} rad/s, other γ")
    for gamma in OTHER_GAMMAS:
        own = replace(weights, gamma=gamma)
        try:
            found.append(known_setup(refused.robot, refused.specification, refused.task, own, refused.random))
        except NumericalFailure:
            continue
    return [[replace(one, law=other.law) for one in estimators] for other in tolerant(found)]


def _following(chosen: WorkspaceSetup, others: Sequence[WorkspaceSetup]) -> WorkspaceSetup:
    """What was chosen, or where it goes astray in moves of robots at corners of their tolerances, the one of the others
    that misses least there."""
    return chosen if missed(chosen) <= ASTRAY else min(others, key=missed)


#: A pose, and values of robots at corners of their tolerances.
Chosen = tuple[np.ndarray, Sequence[Mapping[str, Any]]]


class _Judging:
    """What is known of some candidates at some poses, which copies of this process share.

    Each number is whole whenever it is read; one that is not seen yet makes others do more, and nothing else.
    """

    def __init__(self, setups: int, poses: int, least: list[float] | None) -> None:
        self._limit, self._processes, self._none_left = least, thread_count(), False
        self.begun = np.frombuffer(mmap.mmap(-1, setups * poses), bool).reshape(setups, poses)
        self._failed = np.frombuffer(mmap.mmap(-1, setups), bool)
        self._excesses = np.frombuffer(mmap.mmap(-1, 32 * setups * poses)).reshape(setups, poses, 4)
        self._excesses[:] = np.nan  # not known yet

    def next(self, turn: int) -> tuple[int, list[float] | None] | None:
        """The candidate that is to be tried at one more pose, and its limit; None where none is left.

        It is the first that has not failed where it was tried, or that was not tried: at their first pose most fail.
        Where all of them wait for what another process finds there, it is the first of these. By the number of the
        turn, processes that begin at once begin with one candidate each.
        """
        waiting: tuple[int, list[float] | None] | None = None
        for k, limit in () if self._none_left else enumerate(self._limits()):
            begun = self.begun[k]
            if begun.all() or not self.is_open(k, limit):
                continue
            waiting = waiting or (k, limit)
            tried = not np.isnan(self._excesses[k]).all()
            if (tried or not begun.any()) and not k < turn < self._processes:
                return k, limit
        self._none_left = waiting is None  # nor later: limits fall
        return waiting

    def _limits(self) -> Iterator[list[float] | None]:
        """What each candidate has to miss less than, by those before it; no less than when all of these are known."""
        limit, share = self._limit, LESS
        for k, found in enumerate(self._excesses):
            yield limit
            missed = found.max(axis=0)
            if self._failed[k]:
                continue
            if np.isnan(missed).any():  # by what it misses, others beyond it may not count
                share = 1.0
            elif limit is None or missed.tolist() < limit:
                limit = (share * missed).tolist()

    def is_open(self, k: int, limit: list[float] | None) -> bool:
        """Whether a candidate may miss less than a limit, by what is known of it."""
        if limit is None:
            return True
        seen = np.fmax.reduce(self._excesses[k], axis=0, initial=0.0).tolist()
        return any(limit) and not self._failed[k] and seen < limit

    def fails(self, k: int, pose: int, found: np.ndarray, limit: list[float] | None) -> bool:
        """Whether a candidate misses no less than a limit, with what it misses at one more pose."""
        self._excesses[k, pose] = found
        self._failed[k] = not self.is_open(k, limit)
        return bool(self._failed[k])


class ChosenPoses:
    """Some random poses by which laws are chosen, each with robots at corners of the tolerances.

    `counted`: how many parts of `PoseLoop.excess` count; the last are only preferred. `tick` is called before each
    pose; what it raises ends the search. `sizes`: other numbers of poses, and of robots at each.
    """

    def __init__(
        self,
        robot: Robot,
        s: Specification,
        workspace: Workspace,
        counted: int,
        tick: Callable[[], None] = lambda: None,
        sizes: tuple[int, int] | None = None,
    ) -> None:
        count, corners_each = sizes or (CHOSEN_POSES, CORNERS)
        poses, (damping, ripple) = workspace.sample(count, CHOSEN_SEED), pose_limits(s)
        delay = s.limit("delay_margin")
        corners = robot.damped.random_corners(corners_each * count, CHOSEN_SEED)
        #: The specification with a reserve, since other poses are judged.
        self.wanted = replace(
            s,
            damping=min(1.0, RESERVE * damping),
            ripple=ripple / RESERVE,
            gain_margin=RESERVE * gain_limit(s),
            delay_margin=RESERVE * delay or None,
        )
        self._corner_damping, self._counted, self._tick = RESERVE * corner_damping(s), counted, tick
        self._chosen = [(pose, corners[k::count]) for k, pose in enumerate(poses)]
        #: When a candidate failed at each pose; copies of this process share it.
        self._failed = np.frombuffer(mmap.mmap(-1, 8 * count))

    def excess(self, setup: WorkspaceSetup, least: list[float] | None = None) -> np.ndarray | None:
        """How far the loops of a setup, whose specification is the wanted one, miss it at worst, as `PoseLoop.excess`;
        None as soon as that is no less than `least`."""
        return self.excesses([setup], least)[0]

    def excesses(
        self, setups: Sequence[WorkspaceSetup], least: list[float] | None
    ) -> list[np.ndarray | None]:
        """The `excess` of each setup; None where it is no less than `least`, or not by `LESS` less than that of one
        before it, or where one before it misses nothing."""
        judging, poses = _Judging(len(setups), len(self._chosen), least), len(self._chosen)

        def turn(number: int) -> tuple[int, int, np.ndarray | Exception] | None:
            """What a candidate misses at one more pose, that at which another failed last; None where none is left."""
            if (found := judging.next(number)) is None:
                return None
            k, limit = found
            order: list[int] = np.argsort(-self._failed, kind="stable").tolist()
            pose = next(each for each in order if not judging.begun[k, each])
            judging.begun[k, pose] = True
            try:
                found = self._excess_at(setups[k], self._chosen[pose], limit)
            except Exception as error:  # raised by whoever needs all poses of this candidate
                return k, pose, error
            if judging.fails(k, pose, found, limit):
                self._failed[pose] = time.monotonic()
            return k, pose, found

        first = [turn(0)] if len(setups) == 1 else []  # alone: most candidates fail there
        if first and not judging.is_open(0, least):
            return [None]
        turns = range(len(first), len(setups) * poses)
        done = [*first, *shared_out(turn, turns, self._tick, compiles=False)]
        found: dict[int, dict[int, np.ndarray | Exception]] = {k: {} for k in range(len(setups))}
        for k, pose, each in filter(None, done):
            found[k][pose] = each
        excesses: list[np.ndarray | None] = []
        for setup, each in zip(setups, found.values()):
            excess = self._worst(setup, each, least)
            excesses.append(excess)
            least = least if excess is None else (LESS * excess).tolist()
        return excesses

    def _worst(
        self, setup: WorkspaceSetup, found: dict[int, np.ndarray | Exception], least: list[float] | None
    ) -> np.ndarray | None:
        """The largest of what is missed at all poses, some of them known; None where it is no less than `least`."""
        excess = np.zeros(4)
        for pose in sorted(range(len(self._chosen)), key=lambda pose: pose not in found):
            if least is not None and excess.tolist() >= least:
                return None
            if pose not in found:  # a copy has not sent it
                self._tick()
                found[pose] = self._excess_at(setup, self._chosen[pose], least)
            each = found[pose]
            excess = excess if isinstance(each, Exception) else np.maximum(excess, each)
        if least is not None and excess.tolist() >= least:
            return None
        for each in found.values():
            if isinstance(each, Exception):
                raise each
        return excess

    def _excess_at(self, setup: WorkspaceSetup, one: Chosen, least: list[float] | None) -> np.ndarray:
        """What is missed at one pose, of all robots, at least 0."""
        s, (pose, corners) = self.wanted, one
        found = np.maximum(setup.at_pose(pose).excess(*pose_limits(s), s.period), 0.0)
        found[self._counted :] = 0.0
        for corner in corners:
            if least is not None and found.tolist() >= least:
                break  # where the pose alone is too much, corners are not computed
            loop = setup.at_corner(pose, corner)
            lacking = 1.0 - loop.damping / self._corner_damping
            found[0] = max(found[0], lacking, np.log(loop.growth) / s.period)
        return found


def tolerates(setup: WorkspaceSetup, gain: float) -> bool:
    """Whether the loops at the poses of the search are stable with this factor of all inputs, up and down."""
    setup = replace(setup, specification=replace(setup.specification, gain_margin=gain))
    poses = setup.workspace.sample(CHOSEN_POSES, CHOSEN_SEED)
    loops = shared_out(setup.at_pose, [*poses], compiles=False)
    return all(max(loop.louder, loop.softer) < 1.0 for loop in loops)


def missed(setup: WorkspaceSetup) -> float:
    """Worst of what is required of motions, found over allowed, in some moves of robots at corners of their tolerances;
    at most 1 where all is met."""
    s, limits, (move_ends, _) = setup.specification, setup.limits, setup.move_ends(TRIED_MOVES, CHOSEN_SEED)
    robots = setup.true.robot.random_corners(TRIED_MOVES, CHOSEN_SEED) or [None] * TRIED_MOVES
    moves = setup.moves([(move_ends[k], values, 0) for k, values in enumerate(robots)])
    lines = motion_requirements(s, limits, [move.motion for move in moves], 0.0, "", rests=True)
    return max(missed_by(line) for line in lines)


def _candidates(
    robot: Robot, s: Specification, task: Task, progress: Callable[[str], None]
) -> Iterator[list[WorkspaceSetup]]:
    """The estimators of each law in the order in which they are tried, the fastest law first; NumericalFailure where
    samples of the period carry the law of no bandwidth."""
    modal = task.space.sample(MODAL_POSES, CHOSEN_SEED)
    problem = robot.problem(penalty=Penalty({"link_position": 1.0}))
    stated = s.estimator == "none" or s.process_noise is not None or s.torque_noise is not None
    unstable, found = None, False
    for bandwidth in BANDWIDTHS:
        progress(f"gains of the pairs: {bandwidth:g} rad/s")
        weights, tried = (pair_weights(robot, bandwidth),), RANDOM
        if motors_alone(robot, s):
            weights, tried = (replace(weights[0], **MOTORS_WEIGHTS), *weights), MOTORS_RANDOM
        for own in weights:
            try:
                law = ModalLaw.tuned(problem, s.period, own, modal)
            except NumericalFailure as error:
                unstable = error
                continue
            randoms = tried[: 1 if stated else None]
            yield [_setup(robot, s, task, law, random) for random in randoms]
            found = True
    if unstable is not None and not found:
        raise unstable


def motors_alone(robot: Robot, s: Specification) -> bool:
    """Whether there is an estimator, and it sees the motors and nothing else."""
    return s.estimator != "none" and all(y.startswith("motor") for y in robot.plant(s.measured).outputs)


def known_setup(
    robot: Robot, s: Specification, task: Task, weights: PairWeights, random: tuple[float, float]
) -> WorkspaceSetup:
    """The setup that a search has found before, by the weights of its pairs and the torques that its estimator
    expects."""
    problem = robot.problem(penalty=Penalty({"link_position": 1.0}))
    modal = task.space.sample(MODAL_POSES, CHOSEN_SEED)
    return _setup(robot, s, task, ModalLaw.tuned(problem, s.period, weights, modal), random)


def _setup(
    robot: Robot, s: Specification, task: Task, law: ModalLaw, random: tuple[float, float]
) -> WorkspaceSetup:
    return WorkspaceSetup(robot, s, task.space, law, random, motion=task.motion)


def pair_weights(robot: Robot, bandwidth: float, gamma: float = GAMMA) -> PairWeights:
    """Weights of pairs with encoders of links, for a bandwidth, rad/s, and γ/γ*."""
    share = SHARE[bool(stated_friction(robot.plant_parameters()))]
    return PairWeights(bandwidth=bandwidth, share=share, integral=INTEGRAL, gamma=gamma)
