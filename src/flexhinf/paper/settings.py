"""Everything the paper leaves open, chosen here and stated in the report."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from flexhinf.errors import InvalidInput

__all__ = ["ESTIMATORS", "PaperSettings"]

ESTIMATORS = ("ukf", "ekf", "none")
PERIODS = "1e-4 to 0.05 s (the joint vibrates at 14 rad/s)"


@dataclass(frozen=True)
class PaperSettings:
    """Options of ``flexhinf paper``.

    Parameters
    ----------
    gamma_ratio : float
        γ/γ*; more than 1.
    degree : int
        Degree of V, at least 2; the law has one less. 4 is the paper's cubic law.
    period : float
        Sampling period of estimator and controller, s.
    seed : int
        Of measurement noise and of the sampled plants.
    estimator : {"ukf", "ekf", "none"}
        "none" feeds back the true state.
    process_noise : float
        Variance q of R^v = q I, added to each state at each sample.
    measurement_noise : float
        Variance R^n of the measured link position, rad². The simulated noise has the same variance.

    Raises
    ------
    InvalidInput
        For a value outside its range.
    """

    gamma_ratio: float = 2.0
    degree: int = 4
    period: float = 1e-3
    seed: int = 0
    estimator: str = "ukf"
    process_noise: float = 1e-6
    measurement_noise: float = 1e-6

    def __post_init__(self) -> None:
        _require("γ/γ*", self.gamma_ratio, self.gamma_ratio > 0.0, "a number above 1", "--gamma-ratio 2")
        whole = isinstance(self.degree, int) and not isinstance(self.degree, bool)
        _require(
            "degree of V",
            self.degree,
            whole and 2 <= self.degree <= 12,
            "an integer from 2 to 12",
            "--degree 4",
        )
        _require(
            "sampling period",
            self.period,
            1e-4 <= self.period <= 0.05,
            PERIODS,
            "--period 1e-3",
        )
        known = isinstance(self.seed, int) and not isinstance(self.seed, bool)
        _require("seed", self.seed, known and 0 <= self.seed < 2**53, "an integer from 0", "--seed 0")
        _require(
            "estimator",
            self.estimator,
            self.estimator in ESTIMATORS,
            ", ".join(ESTIMATORS),
            "--estimator ukf",
        )
        _require(
            "process noise",
            self.process_noise,
            self.process_noise >= 0.0,
            "a variance >= 0",
            "--process-noise 1e-6",
        )
        _require(
            "measurement noise", self.measurement_noise, self.measurement_noise > 0.0,
            "a variance > 0, rad²", "--measurement-noise 1e-6",
        )  # fmt: skip


def _require(what: str, value: Any, holds: bool, expected: str, advice: str) -> None:
    finite = not isinstance(value, float) or math.isfinite(value)
    if not (holds and finite):
        raise InvalidInput(f"The {what} cannot be used.", f"expected {expected}, got {value!r}", advice)
