"""The step on robots within their tolerances, with the controller as it was designed."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.bench import Bench
from flexhinf.design.response import Response, step_response

__all__ = ["Draws", "drawn_steps"]

#: Runs side by side.
THREADS = 2

#: Of each run so many instants are kept, at most.
KEPT = 400


@dataclass(frozen=True, eq=False)
class Draws:
    """One row per robot.

    Attributes
    ----------
    values : list of mapping
        Parameters of each plant.
    overshoot : (N,)
        Largest of all joints, per cent; infinite where the run diverged.
    settling : (N,)
        Slowest of all joints, s; infinite where one never settles.
    peak : (N,)
        Largest input of all joints; infinite where the run diverged.
    time : (T,)
        Of the positions that are kept, s.
    positions : (N, T, n)
        Link positions; NaN from where a run diverged.
    """

    values: list[Any]
    overshoot: np.ndarray
    settling: np.ndarray
    peak: np.ndarray
    time: np.ndarray
    positions: np.ndarray

    def __len__(self) -> int:
        return len(self.values)

    @property
    def diverged(self) -> int:
        """How many runs diverged."""
        return int(np.isinf(self.overshoot).sum())

    @property
    def unsettled(self) -> int:
        """How many did not settle, those that diverged among them."""
        return int(np.isinf(self.settling).sum())


def drawn_steps(
    bench: Bench,
    count: int,
    duration: float,
    sub_steps: int,
    law: Any = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Draws:
    """The step of `count` robots drawn uniformly within their tolerances, each with noise of its own.

    Parameters
    ----------
    bench : Bench
    count : int
    duration : float
        s.
    sub_steps : int
        Of the true plants: the nominal one's, so that all run on one kernel.
    law : Law, optional
        Instead of the design's.
    tell : callable
    """
    s = bench.specification
    rng = np.random.default_rng([s.seed, 7])
    values = [bench.robot.draw(rng) for _ in range(count)]
    controller = bench.controller(bench.start, law=law)
    bench.loop(controller, sub_steps=sub_steps).kernel  # noqa: B018  compiled once, before the threads

    def one(k: int) -> Response:
        plant = bench.true_plant
        plant = plant.with_parameters(**plant.parameters.known(values[k]))
        loop = bench.loop(controller, plant, sub_steps)
        begin = bench.rest(bench.start, values[k])
        return step_response(loop, begin, bench.goal, bench.noise, duration, s.seed + 1 + k)

    found = []
    time = _kept(duration, s.period)
    positions = np.full((count, len(time), len(bench.goal)), np.nan)
    with ThreadPoolExecutor(THREADS) as pool:
        for k, response in enumerate(pool.map(one, range(count))):
            found.append(_merits(response))
            passed = int(np.searchsorted(time, response.run.time[-1] + 0.5 * s.period))
            at = np.searchsorted(response.run.time, time[:passed] - 0.5 * s.period)
            positions[k, :passed] = response.positions[at]
            if (k + 1) % max(1, count // 10) == 0:
                tell(f"robots within the tolerances: {k + 1} of {count}")
    merits = np.array(found).reshape(-1, 3)
    return Draws(values, merits[:, 0], merits[:, 1], merits[:, 2], time, positions)


def _kept(duration: float, period: float) -> np.ndarray:
    """Instants of samples (T,), evenly apart."""
    samples = round(duration / period)
    return period * np.arange(0, samples, max(1, -(-samples // KEPT)))


def _merits(response: Response) -> tuple[float, float, float]:
    """Largest overshoot, slowest settling, peak input."""
    if response.diverged is not None:
        return np.inf, np.inf, np.inf
    peak = float(np.abs(response.run.signals["input"]).max())
    moved = [m for m in response.metrics if m["overshoot_percent"] is not None]
    times = [np.inf if m["settling_time_s"] is None else m["settling_time_s"] for m in moved]
    return max((m["overshoot_percent"] for m in moved), default=0.0), max(times, default=0.0), peak
