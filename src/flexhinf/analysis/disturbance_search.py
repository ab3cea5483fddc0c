"""The finite-energy disturbance that makes ∫|z|²/∫|d|² largest, from rest: Eq. (5) searched for a counterexample.

Power iteration: d is replaced by the gradient of ∫|z|², scaled to the same energy [tierno1997]. For a linear loop
that is the power iteration of its H∞ norm squared, and the search begins with what is worst for small motions, a
sinusoid at the frequency of that norm under a window. What is attained is a lower bound of the gain.

The search may run at a longer period than the loop, and takes an estimator at its stationary gain; what it finds is
then run with the loop itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.analysis.disturbance_gradient import gradient, small_motions
from flexhinf.analysis.disturbance_runs import Attained, DisturbanceRuns
from flexhinf.analysis.resting import RestingLoop
from flexhinf.errors import InvalidInput
from flexhinf.plant import GeneralisedPlant, Law

__all__ = ["DisturbanceSearch", "worst_disturbance"]

#: Period of the search without an estimator, s, unless the loop's is longer.
SEARCH_PERIOD = 1e-2

#: The energy grows by this factor while the state stays in the level set, and shrinks by it while it does not; at
#: most so often.
FACTOR, ROUNDS = 1.5, 12


class DisturbanceSearch:
    """Ascent on ∫|z|²/∫|d|².

    Parameters
    ----------
    problem, law, estimator, period, horizon
        As of `DisturbanceRuns`; a Kalman filter is taken at its stationary gain in the search.
    search_period : float, optional
        s; 10 ms, or the loop's where that is longer. With an estimator always the loop's.
    """

    def __init__(
        self,
        problem: GeneralisedPlant,
        law: Law,
        estimator: Any = None,
        period: float = 1e-3,
        horizon: float = 20.0,
        search_period: float | None = None,
    ) -> None:
        if estimator is not None and search_period not in (None, period):
            raise InvalidInput(
                "An estimator has one period.",
                f"expected search_period={period:g} s or none, got {search_period!r}",
                "search_period only where the true state is fed back",
            )
        if search_period is None:
            search_period = max(period, SEARCH_PERIOD) if estimator is None else period
        steady = (
            None if estimator is None else RestingLoop(law, estimator, problem.plant, period).step.estimator
        )
        self.search_runs = DisturbanceRuns(problem, law, steady, search_period, horizon)
        same = estimator is steady and search_period == period
        self.runs = self.search_runs if same else DisturbanceRuns(problem, law, estimator, period, horizon)

    def attained(self, d: np.ndarray) -> Attained:
        """Of samples (N, k) at the search's period, run by the loop itself."""
        return self.runs.attained(self.on(self.runs.times, d))

    def on(self, times: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Samples of the search, held, at other times."""
        place = (times / self.search_runs.period + 1e-6).astype(int)
        return d[np.minimum(place, len(d) - 1)]

    def scaled(self, d: np.ndarray, energy: float) -> np.ndarray:
        """d with ∫|d|² = energy."""
        return d * np.sqrt(energy / (self.search_runs.period * float((d**2).sum())))

    def small(self) -> tuple[float, np.ndarray]:
        """(gain of small motions of the sampled loop, the sinusoid that attains it, under a window)."""
        system = small_motions(self.search_runs)
        gain, frequency = system.norm()
        if not np.isfinite(gain):
            return gain, np.ones((len(self.search_runs.times), self.search_runs.channels))
        direction = np.linalg.svd(system.response(frequency)[0])[2][0].conj()
        t = self.search_runs.times
        window = np.sin(np.pi * (t + self.search_runs.period) / (t[-1] + 2.0 * self.search_runs.period)) ** 2
        wave = np.real(np.exp(1j * frequency * t)[:, None] * direction)
        return gain, wave * window[:, None]

    def random(self, seed: int) -> np.ndarray:
        """Noise that fades: a start without a preference."""
        t = self.search_runs.times
        noise = np.random.default_rng(seed).normal(size=(len(t), self.search_runs.channels))
        return noise * np.exp(-3.0 * t / t[-1])[:, None]

    def ascend(self, start: np.ndarray, energy: float, turns: int) -> np.ndarray | None:
        """The disturbance (N, k) of this energy found from `start`; None if the loop diverges on the way."""
        d, best = self.scaled(start, energy), (-np.inf, start)
        for _ in range(turns):
            found = gradient(self.search_runs, d)
            if found is None or not np.all(np.isfinite(found[0])):
                return None
            slope, value = found
            best = max(best, (value, d), key=lambda pair: pair[0])
            if not slope.any():
                break
            d = self.scaled(slope, energy)
        return best[1]


def worst_disturbance(
    problem: GeneralisedPlant,
    law: Law,
    estimator: Any = None,
    period: float = 1e-3,
    *,
    energy: float | None = None,
    level: float | None = None,
    horizon: float = 20.0,
    turns: int = 12,
    starts: int = 2,
    seed: int = 0,
    search_period: float | None = None,
) -> Attained:
    """The worst disturbance found, of a given energy or with the state inside {V ≤ level}.

    Parameters
    ----------
    problem, law, estimator, period, horizon, search_period
        See `DisturbanceSearch`.
    energy : float, optional
        ∫|d|².
    level : float, optional
        Instead of an energy: begins with 2 level/γ², up to which the dissipation inequality itself keeps V below the
        level, and then takes more or less, as long as the state stays inside.
    turns : int
        Of each ascent.
    starts : int
        The worst sinusoid of small motions, then fading noise with the seeds `seed`, `seed` + 1, …

    Returns
    -------
    Attained
        The largest gain; infinite if the loop diverged under a disturbance of this energy.

    Raises
    ------
    InvalidInput
        If neither or both of energy and level are given, or the law has no V where a level is.
    """
    given = [number for number in (energy, level) if number is not None]
    if len(given) != 1 or not (np.isfinite(given[0]) and given[0] > 0.0):
        raise InvalidInput(
            "The disturbance has no size.",
            f"expected energy or level, a positive number, got energy={energy!r} and level={level!r}",
            "level=solution.sampled_region().level",
        )
    if level is not None and not (hasattr(law, "value") and np.isfinite(getattr(law, "gamma", np.inf))):
        raise InvalidInput(
            "The law has no level sets.", f"got level={level!r} and {type(law).__name__}", "energy=…"
        )
    search = DisturbanceSearch(problem, law, estimator, period, horizon, search_period)
    first = [search.small()[1], *(search.random(seed + k) for k in range(starts - 1))]
    if energy is not None:
        return max((_climbed(search, start, energy, turns) for start in first), key=lambda a: a.gain)
    assert level is not None
    found = [_inside(search, start, level, turns) for start in first]
    return max(found, key=lambda a: a.gain)


def _climbed(search: DisturbanceSearch, start: np.ndarray, energy: float, turns: int) -> Attained:
    d = search.ascend(start, energy, turns)
    return search.attained(search.scaled(start, energy) if d is None else d)


def _inside(search: DisturbanceSearch, start: np.ndarray, level: float, turns: int) -> Attained:
    """The best of all energies tried with which V stayed below the level; the smallest energy if there is none."""
    gamma = search.runs.law.gamma  # type: ignore[attr-defined]
    energy, best, grows = 2.0 * level / gamma**2, None, None
    for _ in range(ROUNDS):
        found = _climbed(search, start, energy, turns)
        inside = found.largest_value <= level
        if inside and (best is None or found.gain > best.gain):
            best = found
        if grows is None:
            grows = inside
        if inside != grows:
            break
        energy *= FACTOR if inside else 1.0 / FACTOR
    return found if best is None else best
