"""Choices of an estimator's R^v: which states are taken to be disturbed, and how much.

The gain of a Kalman filter depends on the ratio of R^v to R^n alone, and on which states R^v has on its diagonal: every
state, all velocities (what a model misses are torques), those of the links or those of the motors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.errors import InvalidInput

ALL_STATES, VELOCITIES = "all states", "velocities only"
LINK_VELOCITIES, MOTOR_VELOCITIES = "link velocities only", "motor velocities only"
FORMS = (ALL_STATES, VELOCITIES, LINK_VELOCITIES, MOTOR_VELOCITIES)

#: Words that a disturbed state's name has, by form; none are asked of it where every state is disturbed.
WORDS: dict[str, set[str]] = {
    ALL_STATES: set(),
    VELOCITIES: {"velocity"},
    LINK_VELOCITIES: {"velocity", "link"},
    MOTOR_VELOCITIES: {"velocity", "motor"},
}

#: A linear loop of more states is large: fewer choices of R^v are looked at.
LARGE = 40

#: Ratios q / R^n that are swept over, for loops of up to `LARGE` states and larger ones.
RATIOS = tuple(10.0**k for k in range(-4, 13, 2)), (1e-2, 1e2, 1e6)


@dataclass(frozen=True)
class ProcessNoise:
    """R^v = q on the diagonal, for the states of a form.

    Parameters
    ----------
    form : {"all states", "velocities only", "link velocities only", "motor velocities only"}
        Velocities are states with "velocity" as a word of their name, "link" and "motor" words of it too.
    q : float
        Variance per sample, in the states' units squared.

    Raises
    ------
    InvalidInput
        For another form, or a q that is negative or not finite.
    """

    form: str
    q: float

    def __post_init__(self) -> None:
        if self.form not in FORMS or not (np.isfinite(self.q) and self.q >= 0.0):
            raise InvalidInput(
                "The process noise is not known.",
                f"expected one of {list(FORMS)} and a finite q >= 0, got {self.form!r} and {self.q!r}",
                f"ProcessNoise({ALL_STATES!r}, 1e-6)",
            )

    def disturbed(self, states: Sequence[str]) -> np.ndarray:
        """Which of the states have noise, (n,)."""
        return np.array([WORDS[self.form] <= set(name.split("_")) for name in states])

    def covariance(self, states: Sequence[str]) -> np.ndarray:
        """R^v (n, n) of a plant with these states.

        Raises
        ------
        InvalidInput
            If no state is of the form.
        """
        disturbed = self.disturbed(states)
        if not disturbed.any():
            raise InvalidInput(
                f"No state is disturbed by noise on {self.form}.",
                f"expected names with the words {sorted(WORDS[self.form])}, got {list(states)}",
                f"ProcessNoise({ALL_STATES!r}, …)",
            )
        return self.q * np.diag(disturbed.astype(float))


def standard_noises(
    loop: EquilibriumLoop, measurement_noise: float | None = None
) -> tuple[ProcessNoise, ...]:
    """All forms that the loop's states have, each with q over a range of ratios to R^n; none without a Kalman filter.

    Parameters
    ----------
    measurement_noise : float, optional
        R^n that the ratios are to; by default the smallest variance of the filter's measurements.
    """
    if not loop.tunable:
        return ()
    if measurement_noise is None:
        measurement_noise = float(np.diag(loop.filter.measurement_noise).min())
    forms = [form for form in FORMS if ProcessNoise(form, 0.0).disturbed(loop.step.states).any()]
    ratios = RATIOS[loop.states > LARGE]
    return tuple(ProcessNoise(form, ratio * measurement_noise) for form in forms for ratio in ratios)
