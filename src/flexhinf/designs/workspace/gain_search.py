"""Search for the numbers of a law with gains at any pose: the largest bandwidth that keeps all limits.

It is the largest whose loops keep them with the reserve of the search, at poses of its own, and whose first moves of
robots at corners of the tolerances keep all limits of moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from flexhinf.baselines.posed_laws import GainsOnTheWay
from flexhinf.designs.judge import missed_by, worst_move_requirements
from flexhinf.designs.laws import LawKind
from flexhinf.designs.specification import Specification
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.resting_loops import CHOSEN_SEED
from flexhinf.designs.workspace.rivals import Gains, over_of, rival_law
from flexhinf.designs.workspace.search import MOTORS_RANDOM, RANDOM, ChosenPoses, motors_alone
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import NumericalFailure
from flexhinf.robot import Robot

#: Bandwidths of the search, rad/s, the fastest first; their ratio, and the steps of the bisection between two of them.
RATIO, BISECTIONS = math.sqrt(2.0), 2
BANDWIDTHS = tuple(160.0 * 2.0 ** (-0.5 * k) for k in range(12))

#: Poses by which a rival is tuned, and robots at corners of the tolerances at each: its fastest gains are at a limit,
#: so it needs more poses than the design, which has a choice of six bandwidths.
TUNING_POSES = (100, 1)

#: Moves by which a rival is tuned, and how many bandwidths are tried in them.
TUNING_MOVES, TIMES = 10, 4

#: Least excess of a loop that lacks something.
TINY = [0.0, 1e-12, 0.0, 0.0]


def without_law(robot: Robot, s: Specification, task: Task) -> WorkspaceSetup:
    """The setup of a task before a law is found: one that feeds nothing back."""
    plant, n = robot.plant(s.measured), len(robot.joint_names)
    law = GainsOnTheWay(
        plant=plant,
        equilibrium=robot.operating_point(),
        integrate=("link_position",),
        gain=lambda pose: np.zeros((n, plant.n + n)),
    )
    return WorkspaceSetup(robot, s, task.space, law, motion=task.motion)


def known_gains(
    robot: Robot, s: Specification, task: Task, kind: LawKind, numbers: Gains, random: tuple[float, float]
) -> WorkspaceSetup:
    """The setup that a search has found before, by its numbers."""
    base = without_law(robot, s, task)
    return replace(base, law=rival_law(base, kind.name, numbers), random=random, numbers=numbers)


class GainSearch:
    """The search for the numbers of a law; `own` is a setup of any law with task, robot and specification.

    `progress` is called with each bandwidth, `tick` before each pose; what that raises ends the search.
    """

    def __init__(
        self,
        own: WorkspaceSetup,
        kind: LawKind,
        progress: Callable[[str], None] = lambda text: None,
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        s = own.specification
        self.own, self.kind, self.specification, self.progress = own, kind, s, progress
        self.poses = ChosenPoses(own.robot, s, own.workspace, 2, tick, sizes=TUNING_POSES)
        known = s.estimator == "none" or s.process_noise is not None or s.torque_noise is not None
        tried = MOTORS_RANDOM if motors_alone(own.robot, s) else RANDOM
        self.torques = tried[: 1 if known else None]

    def stated(self, numbers: Gains) -> WorkspaceSetup:
        """The setup with stated numbers, with the estimator that lacks least."""
        setups = [*self._at(numbers)]
        least, best = [math.inf], setups[0]
        for setup in setups:
            excess = self.poses.excess(setup, least)  # ends at the first pose at which it lacks more
            if excess is not None:
                least, best = excess.tolist(), setup
            if not any(least):
                break
        return replace(best, specification=self.specification)

    def tuned(self) -> WorkspaceSetup:
        """The fastest that keeps all limits; where none does, that which lacks least."""
        place, lack, setup = self._scan(0)
        if any(lack) or not setup.numbers:
            return setup
        tried = [(self._missed(setup), setup)]
        while tried[-1][0] > 1.0 and len(tried) < TIMES and place + 1 < len(BANDWIDTHS):
            place, lack, setup = self._scan(place + 1)
            if any(lack):
                break
            tried.append((self._missed(setup), setup))
        missed, setup = min(tried, key=lambda one: one[0])
        step = RATIO
        for _ in range(BISECTIONS if missed <= 1.0 and place > 0 else 0):
            step = math.sqrt(step)
            setup = self._faster(setup, step)
        return setup

    def _scan(self, first: int) -> tuple[int, list[float], WorkspaceSetup]:
        """The first place in `BANDWIDTHS` from one on with a setup whose loops lack nothing, or least of all: the
        place, what they lack, and the setup."""
        least, chosen = [math.inf], None
        for place, setup in self._candidates(first):
            excess = self.poses.excess(setup, least)
            if excess is not None:
                least, chosen = excess.tolist(), (place, setup)
            if not any(least):
                break
        if chosen is None:
            raise NumericalFailure(
                f"No loop of {self.kind.name} can be judged.",
                "all that were tried are far from stable",
                f"another law than {self.kind.name}, or gains of your own (flexhinf compare --gains)",
            )
        place, setup = chosen
        return place, least, replace(setup, specification=self.specification)

    def _candidates(self, first: int) -> Iterator[tuple[int, WorkspaceSetup]]:
        """Setups from a place in `BANDWIDTHS` on, the fastest first."""
        law = over_of(self.kind.name)
        if not law.names:  # no gain to choose
            yield from ((first, setup) for setup in self._at({}))
            return
        for place in range(first, len(BANDWIDTHS)):
            self.progress(f"gains of {self.kind.name}: {BANDWIDTHS[place]:.3g} rad/s")
            for more in law.variants:
                numbers = {name: (x,) for name, x in {"bandwidth": BANDWIDTHS[place], **more}.items()}
                yield from ((place, setup) for setup in self._at(numbers))

    def _at(self, numbers: Gains) -> Iterator[WorkspaceSetup]:
        """The law with each estimator, to be judged with the reserve."""
        base = replace(self.own, specification=self.poses.wanted)
        law = rival_law(base, self.kind.name, numbers)
        for random in self.torques:
            yield replace(base, law=law, random=random, numbers=numbers)

    def _faster(self, setup: WorkspaceSetup, step: float) -> WorkspaceSetup:
        """The setup with bandwidths that are larger by the factor `step` if it keeps all limits, else this one."""
        more = {**setup.numbers, "bandwidth": tuple(step * x for x in setup.numbers["bandwidth"])}
        for other in self._at(more):
            if self.poses.excess(other, TINY) is not None:
                other = replace(other, specification=self.specification)
                return other if self._missed(other) <= 1.0 else setup
        return setup

    def _missed(self, setup: WorkspaceSetup) -> float:
        """Worst of what is required of moves, found over allowed, in the first moves of robots at corners; at most 1
        where all is met."""
        move_ends, _ = setup.move_ends(TUNING_MOVES, CHOSEN_SEED)
        robots = setup.true.robot.random_corners(TUNING_MOVES, CHOSEN_SEED) or [None] * TUNING_MOVES
        moves = setup.moves([(move_ends[k], values, k) for k, values in enumerate(robots)])
        lines = worst_move_requirements(setup.specification, setup.limits, moves, "")
        missed = [missed_by(line) for line in lines if line.missed]
        return max((float(np.nan_to_num(each, nan=math.inf)) for each in missed), default=1.0)
