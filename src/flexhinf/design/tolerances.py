"""The linearised loop with its estimator at the corners of the robot's tolerances, over the noise that is assumed.

R^v decides how fast the estimator is and nobody knows it, so a loop that is stable for one R^v only is not robust.
Only the ratio to R^n counts. Both forms are looked at: q on every state, and q on the velocities alone.
"""

from __future__ import annotations

from dataclasses import dataclass

from flexhinf.analysis import Population, ProcessNoise, Swept, corner_population, unstable_share
from flexhinf.analysis.tolerance_corners import ALL_STATES, VELOCITIES
from flexhinf.design.bench import Bench
from flexhinf.design.resting import resting_loop
from flexhinf.plant import Law

__all__ = ["Tolerances", "tolerance_corners"]

#: Corners, and ratios q / R^n, for up to so many states; fewer with more.
CORNERS = ((15, 400, tuple(10.0**k for k in range(-4, 13, 2))), (10_000, 60, (1e-2, 1e2, 1e6)))

#: With a delay each plant's loop is put together by itself: fewer of both.
DELAYED = (100, (1e-2, 1e2, 1e6))


@dataclass(frozen=True, eq=False)
class Tolerances:
    """Growth rates of the loop at the goal.

    Attributes
    ----------
    population : Population
        Corners, each tolerance alone at its ends, and the nominal robot.
    own : Swept
        With the estimator as it is, or the true state where there is none.
    with_state : Swept
        With the true state fed back.
    swept : tuple of Swept
        Over R^v; none without an estimator.
    ratios : tuple of float
        q / R^n of each.
    """

    population: Population
    own: Swept
    with_state: Swept
    swept: tuple[Swept, ...]
    ratios: tuple[float, ...]

    @property
    def unstable(self) -> int:
        """Plants that are unstable with the estimator as it is."""
        return int((self.own.rates >= 0.0).sum())

    @property
    def unstable_anywhere(self) -> int:
        """The most that are unstable at one R^v of the sweep."""
        return max((int((swept.rates >= 0.0).sum()) for swept in (self.own, *self.swept)), default=0)


def tolerance_corners(bench: Bench, law: Law) -> Tolerances | None:
    """Corners of all tolerances; None for a robot that states none.

    Parameters
    ----------
    bench : Bench
    law : Law
        The one at the goal.
    """
    robot, s = bench.robot, bench.specification
    if not robot.uncertain:
        return None
    count, ratios = next((c, r) for most, c, r in CORNERS if len(law.state_names) <= most)
    if s.delay:
        count, ratios = min(count, DELAYED[0]), DELAYED[1]
    table = bench.true_plant.parameters

    def at(signs: object) -> dict[str, object]:
        return table.known(robot.corner(signs))

    population = corner_population(at, len(robot.uncertain), count, s.seed)
    fed = unstable_share(resting_loop(bench, law, estimated=False), population)[0]
    if s.estimator == "none":
        return Tolerances(population, fed, fed, (), ())
    loop = resting_loop(bench, law)
    noises, told = [], []
    if s.estimator != "observer":  # its gain is part of it
        for form in (ALL_STATES, VELOCITIES):
            noises += [ProcessNoise(form, ratio * s.measurement_noise) for ratio in ratios]
            told += list(ratios)
    own, *swept = unstable_share(loop, population, (None, *noises))
    return Tolerances(population, own, fed, tuple(swept), tuple(told))
