"""Eq. (5) measured: ∫|z|² and ∫|d|² of a run, and the finite-energy disturbance that makes their ratio largest.

d is the paper's disturbance, the command in ė = x1 − d, and z = (h(x), √R2 u). The true state is fed back, from
rest at x(0) = 0. The search is power iteration: d is replaced by the gradient of ∫|z|², scaled to the same energy
(Tierno, Murray, Doyle & Gregory 1997), with the gradient by the adjoint of the sampled loop along the run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from flexhinf.campaign.rows import Rows, one_period
from flexhinf.errors import NumericalFailure
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller, Loop, Samples
from flexhinf.paper.bench import PaperBench
from flexhinf.scalars import trace

__all__ = ["Attained", "GainBench"]

#: Horizon, s: disturbances die out well before, and the response with them.
HORIZON = 20.0

#: Sampling period of the search, s, unless the settings' is longer. What is found is run at the settings' period.
SEARCH_PERIOD = 1e-2

#: Horizons count from where this share of ∫|d|² has passed: before, both integrals are rounding.
BEGUN = 1e-6


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
        self.bench, self.law = bench, law
        self.period = bench.settings.period
        self.search_period = max(self.period, SEARCH_PERIOD)
        self._loops: dict[float, Loop] = {}
        problem = bench.problem
        self.weights = problem.penalty.weights(problem.state_names)
        self.effort = float(problem.r2[0, 0])

    def _loop(self, period: float) -> Loop:
        if period not in self._loops:
            self._loops[period] = Loop(self.bench.model, Controller(self.law, None, period))
        return self._loops[period]

    # Runs -----------------------------------------------------------------------------------------
    def times(self, period: float) -> np.ndarray:
        """Samples of the horizon, s."""
        return np.arange(round(HORIZON / period) + 1) * period

    def attained(self, disturbance: Any) -> Attained:
        """Of a disturbance given as a function of time (arrays in, arrays out), held between samples."""
        times = self.times(self.period)
        d = np.asarray(disturbance(times), dtype=float)
        energy = float(d[:-1] @ d[:-1]) * self.period
        states, u = self._simulate(self.period, d)
        z = self._cost(states, u)
        if len(u) < len(d) or not np.all(np.isfinite(z)):
            return Attained(np.inf, energy, np.inf)
        inner = 0.5 * (z[1:] + z[:-1])
        outer = np.cumsum(d[:-1] ** 2)
        begun = outer > BEGUN * outer[-1]
        ratio = np.cumsum(inner)[begun] / outer[begun]
        return Attained(float(np.sqrt(ratio.max())), energy, float(np.abs(states[:, 0]).max()))

    def _simulate(self, period: float, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(states with the integral (N, 5), u (N,)); shorter than d if the loop diverged."""
        times = self.times(period)
        try:
            run = self._loop(period).run(Samples(times, d), None, None, HORIZON)
        except NumericalFailure as failure:
            run = failure.trajectory  # type: ignore[attr-defined]
        x, u = run.signals["state"], run.signals["input"][:, 0]
        growth = period * (0.5 * (x[1:, 0] + x[:-1, 0]) - d[: len(x) - 1])
        integral = np.concatenate([[0.0], np.cumsum(growth)])
        return np.column_stack([x, integral]), u

    def _cost(self, states: np.ndarray, u: np.ndarray) -> np.ndarray:
        """|z|² at each sample."""
        with np.errstate(over="ignore", invalid="ignore"):
            return ((states * self.weights) ** 2).sum(axis=1) + self.effort * u**2

    # Search ---------------------------------------------------------------------------------------
    @cached_property
    def _feedback(self) -> Rows:
        """(x, integral) → u and |z|²."""
        n, data = self.bench.model.n, np.ravel(self.law.law_data)
        s = ca.SX.sym("s", n + 1)
        u = trace(self.law.evaluate_law, n + 1, data.size)(s, ca.DM(data))
        z = ca.vertcat(ca.DM(self.weights) * s, np.sqrt(self.effort) * u)
        both = ca.densify(ca.vertcat(u, ca.dot(z, z)))
        function = ca.Function("feedback", [s, ca.SX.sym("none", 0)], [both])
        return Rows(
            ("feedback", self.law.law_key, tuple(data), self.effort, tuple(self.weights)), lambda: function
        )

    def _slopes(self, states: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂(next)/∂(x, integral) (N, 5, 5) and ∂|z|²/∂(x, integral) (N, 5), at the search's period."""
        (count, k), plant, period = states.shape, self.bench.model, self.search_period
        by_state = self._feedback(states)[1]
        p = np.tile(plant.parameters.vector(), (count, 1))
        parts, n = self._loop(period).sub_steps, k - 1
        moved = one_period(plant, period, parts, states[:, :n], u[:, None], p)[1]
        slope = np.zeros((count, k, k))
        slope[:, :n] = moved[:, :, n : n + 1] @ by_state[:, :1]
        slope[:, :n, :n] += moved[:, :, :n]
        slope[:, n] = 0.5 * period * slope[:, 0]  # the integral, by the trapezoidal rule
        slope[:, n, 0] += 0.5 * period
        slope[:, n, n] += 1.0
        return slope, by_state[:, 1]

    def gradient(self, d: np.ndarray) -> tuple[np.ndarray, float] | None:
        """(∂∫|z|²/∂d, ∫|z|²) at the search's samples; None if the loop diverged."""
        states, u = self._simulate(self.search_period, d)
        if len(u) < len(d):
            return None
        count = len(states)
        slopes, costs = self._slopes(states, u)
        adjoint, gradient = costs[-1], np.zeros(count)
        for k in range(count - 2, -1, -1):
            gradient[k] = -adjoint[-1]  # d acts on the next integral only, by −period
            adjoint = costs[k] + adjoint @ slopes[k]
        return gradient * self.search_period**2, float(self._cost(states, u).sum() * self.search_period)

    def worst(self, start: np.ndarray, energy: float, turns: int) -> np.ndarray | None:
        """The disturbance of this energy found from `start`; None if the loop diverges on the way."""
        d, best = self.scaled(start, energy), (-np.inf, start)
        for _ in range(turns):
            found = self.gradient(d)
            if found is None:
                return None
            slope, value = found
            if not math.isfinite(value) or not np.all(np.isfinite(slope)):
                return None
            best = max(best, (value, d), key=lambda pair: pair[0])
            d = self.scaled(slope, energy)
        return best[1]

    def scaled(self, d: np.ndarray, energy: float) -> np.ndarray:
        """d with ∫|d|² = energy."""
        return d * np.sqrt(energy / (self.search_period * float(d @ d)))

    def held(self, d: np.ndarray) -> Any:
        """d of the search as a function of time."""
        return lambda t: d[np.minimum((t / self.search_period + 1e-6).astype(int), len(d) - 1)]
