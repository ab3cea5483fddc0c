"""The settings of ``flexhinf paper``: its options, declared as those of a design are."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flexhinf.errors import refuse_if
from flexhinf.options import (
    ADVANCED,
    SENSORS,
    Real,
    Text,
    Whole,
    declared,
    option,
    option_name,
    with_parameters,
)

ESTIMATORS = ("ukf", "ekf", "none")
PERIODS = "1e-4 to 0.05 s (the joint vibrates at 14 rad/s)"


@dataclass(frozen=True)
class PaperSettings:
    """Options of ``flexhinf paper``.

    Raises
    ------
    InvalidInput
        For a value outside its range.
    """

    gamma_ratio: Real = option(
        2.0, ADVANCED, "γ/γ*, above 1: attenuation level over the smallest feasible one.", "2"
    )
    degree: Whole = option(
        4, ADVANCED, "Degree of V, 2 to 12; the law has one less. 4 is the paper's cubic law.", "4"
    )
    period: Real = option(1e-3, SENSORS, "Sampling period of estimator and law, s.", "1e-3", "s")
    seed: Whole = option(0, ADVANCED, "Seed of noise and of the sampled plants.", "0")
    estimator: Text = option("ukf", SENSORS, "ukf, ekf, or none (feeds back the true state).", "ukf")
    process_noise: Real = option(
        1e-6, ADVANCED, "q of R^v = q I, variance added to each state per sample.", "1e-6"
    )
    measurement_noise: Real = option(
        1e-6,
        ADVANCED,
        "R^n, variance of the measured link position, rad²; the simulated noise has the same.",
        "1e-6",
        "rad²",
    )

    def __post_init__(self) -> None:
        degree, seed = (value if type(value) is int else -1 for value in (self.degree, self.seed))
        allowed = (
            ("γ/γ*", "gamma_ratio", 0.0 < self.gamma_ratio <= 1e6, "a number above 1, up to 1e6"),
            ("degree of V", "degree", 2 <= degree <= 12, "an integer from 2 to 12"),
            ("sampling period", "period", 1e-4 <= self.period <= 0.05, PERIODS),
            ("seed", "seed", 0 <= seed < 2**53, "an integer from 0"),
            ("estimator", "estimator", self.estimator in ESTIMATORS, ", ".join(ESTIMATORS)),
            ("process noise", "process_noise", self.process_noise >= 0.0, "a variance >= 0"),
            ("measurement noise", "measurement_noise", self.measurement_noise > 0.0, "a variance > 0, rad²"),
        )
        for what, name, valid, expected in allowed:
            value = getattr(self, name)
            refuse_if(
                not valid or (isinstance(value, float) and not math.isfinite(value)),
                f"The {what} cannot be used.",
                f"expected {expected}, got {value!r}",
                f"{option_name(name)} {getattr(PaperSettings, name)}",
            )


PaperSettings.__doc__ = with_parameters(str(PaperSettings.__doc__), declared(PaperSettings))
