"""The running loop linearised at poses along a stated move, and laws scheduled along it where one is not enough.

In error coordinates about a move the law's gain is the same everywhere, and the robot is not: its inertia and the
estimator's stationary gain change with the pose. At each pose the loop is that of a robot at rest there: velocities
along the move, and the change from one law to another, are not in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.analysis import EquilibriumLoop, Margins, margins
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.requirements import REQUIREMENTS, Requirement
from flexhinf.design.responses import Plan
from flexhinf.design.specification import TOLERANCE, Specification
from flexhinf.errors import FlexhinfError
from flexhinf.loop import Schedule
from flexhinf.plant import Law

#: Poses at which the loop is linearised, for up to so many states of the linear loop.
POSES = ((30, 13), (60, 7), (10_000, 5))

#: Most laws of a schedule that is made without being asked for, the goal's included.
MOST_LAWS = 4

#: Instants by which the way is measured.
INSTANTS = 400


@dataclass(frozen=True)
class MarginLimits:
    """Limits of the margins at every pose: at most, at least, and at least (None where no damping is required)."""

    peak_sensitivity: float
    gain_margin: float
    damping: float | None = None

    def shares(self, found: Margins) -> dict[str, float]:
        """Share of each limit that is used: above 1 it is exceeded."""
        if not found.stable:
            return dict.fromkeys(("peak_sensitivity", "gain_margin", "damping"), np.inf)
        shares = {
            "peak_sensitivity": found.peak_sensitivity / self.peak_sensitivity,
            "gain_margin": self.gain_margin / found.gain_margin,
        }
        if self.damping:
            shares["damping"] = self.damping / found.damping if found.damping > 0.0 else np.inf
        return shares


@dataclass(frozen=True, eq=False)
class AlongMove:
    """Margins at poses along a move."""

    times: np.ndarray  # (P,). When the move passes the poses, s
    poses: np.ndarray  # (P, n). Link positions, rad or m
    laws: tuple[int, ...]  # Which law of a schedule acts at each pose; 0 is the goal's
    margins: tuple[Margins, ...]  # Of the running loop, linearised at each pose
    least: MarginLimits  # What they are to be
    count: int = 1  # How many laws there are
    added: int = 0  # How many of them were added because the margins did not hold

    def worst(self, figure: str) -> int:
        """The pose at which this figure is nearest to its limit, or furthest beyond it."""
        shares = [self.least.shares(one).get(figure, 0.0) for one in self.margins]
        return int(np.argmax(shares))

    @property
    def share(self) -> float:
        """The largest share of a limit that is used at any pose."""
        return max(max(self.least.shares(one).values()) for one in self.margins)

    @property
    def worst_pose(self) -> int:
        """The pose at which that is."""
        return int(np.argmax([max(self.least.shares(one).values()) for one in self.margins]))


def margins_along(setup: LoopSetup, plan: Plan, least: MarginLimits) -> AlongMove:
    """Margins of the running loop at poses that are evenly apart on the way of a move."""
    size = setup.equilibrium_loop().states
    count, times = (
        next(count for most, count in POSES if size <= most),
        np.linspace(0.0, plan.duration, INSTANTS),
    )
    q = np.reshape(plan(times), (INSTANTS, -1))
    covered = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    covered += 1e-9 * max(float(covered[-1]), 1e-9) * np.arange(INSTANTS)
    times = np.interp(
        np.linspace(0.0, covered[-1], count), covered, times
    )  # equal parts of the way, ends included
    poses = np.reshape(plan(times), (len(times), -1))
    laws = setup.law.laws if isinstance(setup.law, Schedule) else (setup.law,)
    places = tuple(setup.law.acting(pose) if isinstance(setup.law, Schedule) else 0 for pose in poses)
    s = setup.specification
    found = tuple(
        margins(
            EquilibriumLoop(
                laws[k], setup.estimator(pose), setup.smooth_plant, s.period,
                equilibrium=setup.robot.operating_point(pose), moving=True, delay=round(s.delay / s.period),
                positions=setup.model.states[: len(pose)],
            )
        )
        for pose, k in zip(poses, places)
    )  # fmt: skip
    return AlongMove(times, poses, places, found, least, len(laws))


def scheduled(
    setup: LoopSetup,
    plan: Plan,
    least: MarginLimits,
    another: Callable[[np.ndarray], Law] | None,
    most: int = MOST_LAWS,
) -> tuple[Law, AlongMove]:
    """The law, or a schedule with laws at the worst poses of a move, until the margins hold or there are `most` laws.

    `another` designs a law at a pose (n,); None adds none. A law that does not help is not added.
    """
    law, along = setup.law, margins_along(setup, plan, least)
    laws = [law]
    while another is not None and along.share > 1.0 and len(laws) < most:
        pose = along.poses[along.worst_pose]
        try:
            laws.append(another(pose))
            schedule = Schedule(laws)
        except FlexhinfError:  # no law there, or one at this pose already
            break
        found = margins_along(replace(setup, law=schedule), plan, least)
        if not found.share < along.share:
            break
        law, along = schedule, replace(found, added=len(laws) - 1)
    return law, along


def along_requirements(s: Specification, along: AlongMove) -> list[Requirement]:
    """Peak sensitivity, gain margin and, where it is required, damping at the worst pose along a move."""
    laws = f", {along.count} laws" if along.count > 1 else ""
    where = f"running loop at {len(along.times)} poses along the move{laws}"
    limits = {
        "peak_sensitivity": s.peak_sensitivity_limit,
        "gain_margin": s.gain_margin_limit,
        "damping": along.least.damping and along.least.damping * (1.0 + TOLERANCE),
    }
    worst = {name: along.worst(name) for name in limits}
    return [
        REQUIREMENTS[name].judge(
            s, limit, getattr(along.margins[worst[name]], name), where, at=float(along.times[worst[name]]),
            criterion="worst pose; linearised about the robot at rest there",
        )
        for name, limit in limits.items()
        if limit
    ]  # fmt: skip
