"""How far the tolerances of a robot may grow, all by one factor, until a loop is unstable at one of their corners."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.population import Population
from flexhinf.analysis.tolerance_corners import corner_plants

#: Doublings of the tolerances until a corner is unstable; width of the bisection afterwards, relative to the factor.
DOUBLINGS, WIDTH = 4, 2.5e-4


@dataclass(frozen=True, eq=False)
class ToleranceBox:
    """The corners of the tolerances as parameter vectors, to be moved away from the nominal plant.

    Parameters are moved along the straight line through each corner. A corner that would change a parameter's sign is
    none from there on.

    Attributes
    ----------
    population : Population
        The corners, and the nominal plant last.
    middle : (q,)
        Of the nominal plant.
    away : (N, q)
        From there to each corner.
    """

    population: Population
    middle: np.ndarray
    away: np.ndarray

    @staticmethod
    def of(
        loop: EquilibriumLoop,
        at: Callable[[Sequence[float]], Mapping[str, Any]],
        uncertain: int | Sequence[Any],
        seed: int = 0,
    ) -> ToleranceBox:
        """Parameters as for `tolerance_corners`."""
        population, _ = corner_plants(loop, at, uncertain, seed)
        table = loop.plant.parameters
        *ends, middle = loop.vectors([table.known(values) for values in population.values])
        return ToleranceBox(population, middle, np.array(ends) - middle)

    def __len__(self) -> int:
        return len(self.away)

    def unstable(
        self,
        loop: EquilibriumLoop,
        scale: float,
        which: np.ndarray | None = None,
        process_noise: np.ndarray | None = None,
    ) -> np.ndarray:
        """Those of some corners (all by default) that are unstable with all tolerances times a factor, the fastest
        first."""
        which = np.arange(len(self)) if which is None else which
        moved = self.middle + scale * self.away[which]
        which = which[np.all((moved * self.middle > 0.0) | (self.away[which] == 0.0), axis=1)]
        if not len(which):
            return which
        rates = loop.modes(self.middle + scale * self.away[which], process_noise).rate
        order = np.argsort(-rates, kind="stable")
        return which[order][rates[order] >= 0.0]

    def edge(
        self,
        loop: EquilibriumLoop,
        which: np.ndarray | None = None,
        process_noise: np.ndarray | None = None,
        most: float = 2.0**DOUBLINGS,
        width: float = WIDTH,
    ) -> tuple[float, int]:
        """Smallest factor with which one of some corners is unstable, and this corner, found by doubling and bisection.

        Parameters
        ----------
        which : (M,) array of int, optional
            Corners; all by default.
        process_noise : (n, n) array, optional
            R^v instead of the filter's.
        most, width : float
            Where the search ends; relative width of the bisection.

        Returns
        -------
        scale : float
            Infinite if no corner is unstable up to `most`; zero if the nominal loop is unstable.
        corner : int
            −1 where there is none.
        """
        if loop.modes(self.middle[None, :], process_noise).rate[0] >= 0.0:
            return 0.0, -1
        low, high = 0.0, 1.0
        while not len(found := self.unstable(loop, high, which, process_noise)):
            if high >= most:
                return np.inf, -1
            low, high = high, min(2.0 * high, most)
        while high - low > width * high:
            centre = 0.5 * (low + high)
            now = self.unstable(loop, centre, which, process_noise)
            low, high, found = (low, centre, now) if len(now) else (centre, high, found)
        return high, int(found[0])


def destabilising_scale(
    loop: EquilibriumLoop,
    at: Callable[[Sequence[float]], Mapping[str, Any]],
    uncertain: int | Sequence[Any],
    process_noise: np.ndarray | None = None,
    *,
    most: float = 2.0**DOUBLINGS,
    seed: int = 0,
) -> tuple[float, int]:
    """Smallest common factor of all tolerances with which some corner is unstable, and this corner.

    Parameters as for `tolerance_corners` and `ToleranceBox.edge`, whose result it is.
    """
    return ToleranceBox.of(loop, at, uncertain, seed).edge(loop, None, process_noise, most)
