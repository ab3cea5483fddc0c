"""A long run at rest after the step: whether dry friction and integral action keep a joint in a limit cycle (hunting).

A joint that dry friction holds beside the command stays there until the integral of the error has broken it loose; it
passes the command, and is held on the other side. No linear metric shows that. The remedy is a dead zone of the
integrals as wide as the cycle: docs/design.md has its cost, and what else was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.plans import has_integrals
from flexhinf.design.requirements import REQUIREMENTS, Requirement, of_several
from flexhinf.design.responses import Response
from flexhinf.loop.simulation.metrics import LimitCycle, limit_cycle, steady_state_error
from flexhinf.plant import sub_steps
from flexhinf.robot.elastic import stated_friction

#: Length of the run, s, and in samples at most. A joint is held for as long as the integral needs to grow by twice the
#: friction, which may be tens of seconds.
LENGTH, MOST_SAMPLES = 120.0, 240_000

#: Most samples times sub-steps times disturbances.
MOST_NUMBERS = 30_000_000

#: Largest sub-step times the fastest mode, and fewest sub-steps per period: RK4 errs by 3e-6 per radian of its phase,
#: and the time at which a joint turns round or sticks is known to a sub-step.
RK4_STEP, LEAST_PARTS = 0.2, 4

#: An oscillation up to so many standard deviations of a measured position, or one step of its sensor, is not hunting.
DEVIATIONS = 3.0

#: A dead zone is at most this fraction of the joint's step (of the largest, where it makes none): half of the band in
#: which a step counts as settled. It is widened so many times.
WIDEST, WIDENED = 0.01, 2


@dataclass(frozen=True, eq=False)
class LimitCycleCheck:
    """The step, followed for long without measurement noise, on a true plant whose dry friction holds."""

    response: Response
    # Of its true plant: those of the specification, and the dry friction that the robot states
    extras: tuple[str, ...]
    limit: float  # Largest amplitude that is no limit cycle, rad or m
    # Whether dry friction holds a resting joint; smoothed, as with rigid joints, it creeps, and may hide a cycle
    sharp: bool = True
    dead_zone: np.ndarray | None = None  # (n,) or None. Of the integrals in this run, rad or m
    # without, tried: The run without the dead zone, where that ended the cycle; that with the widest one, where none
    # did
    without: LimitCycleCheck | None = None
    tried: LimitCycleCheck | None = None

    @cached_property
    def cycles(self) -> tuple[LimitCycle, ...]:
        """Motion of each link position in the last half of the run; none where the run diverged."""
        diverged, time = self.response.diverged_at is not None, self.response.run.time
        return () if diverged else tuple(limit_cycle(time, q) for q in self.response.positions.T)

    @cached_property
    def errors(self) -> np.ndarray:
        """Largest distance (n,) of each link from the goal in the last tenth of the run, rad or m."""
        if self.response.diverged_at is not None:
            return np.full(len(self.response.goal), np.inf)
        pairs = zip(self.response.positions.T, self.response.goal)
        return np.array([steady_state_error(q, np.full(len(q), goal)) for q, goal in pairs])

    @property
    def amplitudes(self) -> np.ndarray:
        """Of `cycles` (n,); infinite where the run diverged."""
        return np.array([cycle.amplitude for cycle in self.cycles] or [np.inf] * len(self.response.goal))

    @property
    def worst(self) -> int:
        """The joint with the largest amplitude."""
        return int(np.argmax(self.amplitudes))

    @property
    def oscillating(self) -> tuple[int, ...]:
        """Joints that move by more than the limit; all where the run diverged."""
        return tuple(np.flatnonzero(self.amplitudes > self.limit).tolist())

    @property
    def oscillates(self) -> bool:
        """Whether any joint does."""
        return bool(self.oscillating)

    def requirement(self, units: Sequence[str]) -> Requirement:
        """That dry friction and integral action keep no joint moving; `units` are those of the link positions."""
        worst = self.worst
        return REQUIREMENTS["limit_cycle"].judge(
            None, self.limit, self.amplitudes[worst], "long run at rest, nominal robot with dry friction, no noise",
            unit=units[worst], joint=of_several(self.response.joints, worst),
        )  # fmt: skip


def end_limit_cycle(setup: LoopSetup) -> tuple[LoopSetup, LimitCycleCheck | None]:
    """The loop, with a dead zone of its integrals where that ends a limit cycle, and its run at rest.

    The zone is as wide as the cycle of the joint, then twice that, and at most `WIDEST` of the step.
    """
    first = check_limit_cycle(setup)
    stated = setup.specification.integral_dead_zone is not None
    if first is None or stated or not (first.oscillates and first.cycles and has_integrals(setup.law)):
        return setup, first
    step = np.abs(setup.goal - setup.start)
    most = WIDEST * np.where(step > 0.0, step, step.max())
    run, zone = first, np.zeros(len(step))
    for _ in range(WIDENED):
        wanted = np.where(run.amplitudes > run.limit, np.maximum(run.amplitudes, 2.0 * zone), zone)
        zone = np.array([float(f"{size:.1e}") for size in np.minimum(wanted, most)])
        changed = replace(setup, chosen_zone=zone)
        run = check_limit_cycle(changed)
        if run is None or not run.cycles:
            break
        if not run.oscillates:
            return changed, replace(run, without=first)
    return setup, replace(first, tried=run)


def check_limit_cycle(setup: LoopSetup) -> LimitCycleCheck | None:
    """The run; None for a robot without dry friction, or with none above zero."""
    s = setup.specification
    dry = stated_friction(setup.robot.plant_parameters())
    if not dry:
        return None
    chosen = tuple(name for name in dry if name in s.extras) or dry
    extras = tuple(dict.fromkeys((*s.extras, *chosen)))
    plant = setup.robot.plant(s.measured, extras=extras, sticking=True)
    fastest = plant.fastest_mode(*setup.equilibrium(setup.goal))
    parts = max(LEAST_PARTS, sub_steps(s.period, fastest, RK4_STEP))
    samples = min(MOST_SAMPLES, MOST_NUMBERS // (parts * len(plant.disturbances)))
    quiet = setup.without_noise  # noise is a dither that may hide what sticks
    response = quiet.step(min(LENGTH, samples * s.period), plant=plant, sub_steps=parts)
    zone = setup.dead_zone if has_integrals(setup.law) else None
    limit = setup.position_resolution(DEVIATIONS)
    return LimitCycleCheck(response, extras, limit, plant.arrest is not None, zone)
