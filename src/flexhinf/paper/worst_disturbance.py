"""Eq. (5) measured for the paper's arm: ∫|z|² and ∫|d|² of a run, and the worst disturbance of a given energy.

d is the paper's disturbance, the command in ė = x1 − d, and z = (h(x), √R2 u). The true state is fed back, from
rest at x(0) = 0. The search is that of `flexhinf.analysis` [tierno1997].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis import DisturbanceSearch
from flexhinf.hinf import HJISolution
from flexhinf.paper.bench import PaperBench

__all__ = ["Attained", "GainBench"]

#: Horizon, s: disturbances die out well before, and the response with them.
HORIZON = 20.0


@dataclass(frozen=True)
class Attained:
    """One disturbance and what it attained.

    Attributes
    ----------
    gain : float
        √(∫|z|²/∫|d|²), the largest over all horizons; infinite if the run diverged.
    energy : float
        ∫|d|², rad²·s.
    reach : float
        Largest |x1|, rad.
    """

    gain: float
    energy: float
    reach: float


class GainBench:
    """Runs of a law's loop under disturbances of Eq. (5).

    Parameters
    ----------
    bench : PaperBench
    law : HJISolution
    """

    def __init__(self, bench: PaperBench, law: HJISolution) -> None:
        self.bench = bench
        self.search = DisturbanceSearch(bench.problem, law, None, bench.settings.period, HORIZON)

    @property
    def times(self) -> np.ndarray:
        """Samples of the search, s."""
        return self.search.search_runs.times

    def attained(self, disturbance: Any) -> Attained:
        """Of a disturbance given as a function of time (arrays in, arrays out), held between samples."""
        d = np.asarray(disturbance(self.search.runs.times), dtype=float)
        found = self.search.runs.attained(d[:, None])
        if np.isinf(found.gain):
            return Attained(np.inf, found.energy, np.inf)
        reach = float(np.abs(found.trajectory.signals["state"][:, 0]).max())
        return Attained(found.gain, found.energy, reach)

    def worst(self, start: np.ndarray, energy: float, turns: int) -> np.ndarray | None:
        """The disturbance (N,) of this energy found from `start` (N,); None if the loop diverges on the way."""
        found = self.search.ascend(start[:, None], energy, turns)
        return None if found is None else found[:, 0]

    def held(self, d: np.ndarray) -> Any:
        """d (N,) of the search as a function of time."""
        return lambda t: self.search.on(t, d)
