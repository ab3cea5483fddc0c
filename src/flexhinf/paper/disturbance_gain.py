"""Eq. (5) measured for the paper's arm: ∫|z|² and ∫|d|² of a run, and the worst disturbance found of a given energy.

d is the paper's disturbance, the command in ė = x1 − d, and z = (h(x), √R2 u). The true state is fed back, from
rest at x(0) = 0. The search is that of `flexhinf.analysis` [tierno1997]: what it attains is a lower bound of the gain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis import DisturbanceSearch
from flexhinf.paper.loop_setup import PaperSetup
from flexhinf.plant import Law

#: Horizon, s: disturbances die out well before, and the response with them.
HORIZON = 20.0

#: Inside this |x1|, rad, gains are judged: the paper's largest command. Eq. (5) is a local statement.
RANGE = math.pi

#: Turns of the search for each energy.
TURNS = 12

Signal = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class RunGain:
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

    @property
    def inside(self) -> bool:
        """Whether the link stayed within ±180° of the hanging rest; false for a run that diverged."""
        return self.reach <= RANGE


class GainRuns:
    """Runs of a law's loop under disturbances of Eq. (5)."""

    def __init__(self, setup: PaperSetup, law: Law) -> None:
        self.setup = setup
        self.search = DisturbanceSearch(setup.problem, law, None, setup.settings.period, HORIZON)

    @property
    def times(self) -> np.ndarray:
        """Samples of the search, s."""
        return self.search.search_runs.times

    def attained(self, disturbance: Any) -> RunGain:
        """Of a disturbance given as a function of time (arrays in, arrays out), held between samples."""
        d = np.asarray(disturbance(self.search.runs.times), dtype=float)
        found = self.search.runs.attained(d[:, None])
        if np.isinf(found.gain):
            return RunGain(np.inf, found.energy, np.inf)
        reach = float(np.abs(found.trajectory.signals["state"][:, 0]).max())
        return RunGain(found.gain, found.energy, reach)

    def worst(self, start: np.ndarray, energy: float, turns: int) -> np.ndarray | None:
        """The disturbance (N,) of this energy found from `start` (N,); None if the loop diverges on the way."""
        found = self.search.ascend(start[:, None], energy, turns)
        return None if found is None else found[:, 0]

    def held(self, d: np.ndarray) -> Any:
        """d (N,) of the search as a function of time."""
        return lambda t: self.search.on(t, d)

    def searched(self, energies: Sequence[float]) -> list[RunGain]:
        """The worst disturbance found for each energy, each search begun from the last; up to where the loop
        diverges."""
        found: list[RunGain] = []
        d: Any = self.search.small()[1][:, 0]  # the worst sinusoid of small motions
        for energy in energies:
            d = self.worst(d, energy, TURNS)
            if d is None:
                return [*found, RunGain(math.inf, energy, math.inf)]
            found.append(self.attained(self.held(d)))
        return found


# Stated disturbances -----------------------------------------------------------------------------------
def pulse(height: float, width: float) -> Signal:
    """Of a height in rad for a time in s."""
    return lambda t: np.where(t < width, height, 0.0)


def decaying_sine(height: float, frequency: float, decay: float) -> Signal:
    """Of an amplitude in rad, a frequency in Hz and a time constant in s."""
    return lambda t: height * np.exp(-t / decay) * np.sin(2.0 * math.pi * frequency * t)


def stated_disturbances() -> list[tuple[str, Signal]]:
    """Pulses and decaying sines, small and large, by name."""
    found: list[tuple[str, Signal]] = []
    for degrees, seconds in ((10, 0.5), (10, 2.0), (90, 0.5), (90, 2.0), (180, 0.5)):
        found.append((f"pulse of {degrees}°, {seconds:g} s", pulse(math.radians(degrees), seconds)))
    for degrees, hertz in ((10, 0.25), (10, 0.5), (90, 0.25), (90, 0.5), (90, 1.0)):
        wave = decaying_sine(math.radians(degrees), hertz, 3.0)
        found.append((f"sine of {degrees}°, {hertz:g} Hz, decaying in 3 s", wave))
    return found
