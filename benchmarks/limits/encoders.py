"""Encoders of a trial: their step, their noise, the samples at which they tell nothing new."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.workspace.arm import PERIOD, Arm
from benchmarks.workspace.trip import RESOLUTION

if TYPE_CHECKING:
    from benchmarks.limits.trials import Trial

__all__ = ["BITS", "Encoders", "step_of"]

#: Bits of a turn of the encoders of all other trials.
BITS = 19


def step_of(arm: Arm, bits: int) -> np.ndarray:
    """Step of the encoders' values of links and motors (2n,), rad or m."""
    return 2.0 ** (BITS - bits) * np.tile(np.where(arm.slides, RESOLUTION[1], RESOLUTION[0]), 2)


@dataclass(frozen=True, eq=False)
class Encoders:
    """What a law is told of true positions (2n,), sample by sample; `errors` (N, 2n) are noise."""

    step: np.ndarray  # (2n,)
    errors: np.ndarray
    slow: np.ndarray  # (2n,), of those that tell something new at every second sample
    silent: range  # samples at which the last frame is there again
    missing: bool  # whether these are NaN in its place
    last: np.ndarray  # (2n,), what was told

    @staticmethod
    def of(arm: Arm, errors: np.ndarray, trial: Trial | None, middle: int) -> Encoders:
        """Those of a trial whose event begins at the sample `middle`."""
        every = np.tile(False, 2 * arm.n)
        if trial is None:
            return Encoders(step_of(arm, BITS), errors, every, range(0), False, np.zeros(2 * arm.n))
        every[: {"links": arm.n, "all": 2 * arm.n}.get(trial.half_rate, 0)] = True
        silent = range(middle, middle + round(trial.silent / PERIOD))
        noise = errors if trial.noisy else 0.0 * errors
        return Encoders(step_of(arm, trial.bits), noise, every, silent, trial.missing, np.zeros(2 * arm.n))

    def read(self, sample: int, positions: np.ndarray) -> np.ndarray:
        """What the encoders tell at this sample (2n,)."""
        if sample in self.silent:
            return np.full(len(self.last), np.nan) if self.missing else self.last.copy()
        told = self.step * np.rint((positions + self.errors[sample]) / self.step)
        self.last[:] = np.where(self.slow & (sample % 2 == 1), self.last, told)
        return self.last.copy()
