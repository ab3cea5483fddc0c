"""How many plants of a population make a loop unstable, over the process noise that its estimator assumes.

No paper gives R^v, and the gain of an estimator depends on its ratio to R^n alone. Two forms are usual: q on every
state (R^v = q I), and q on the velocities only, since what a model misses are torques.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.analysis.population import Population
from flexhinf.analysis.resting import RestingLoop
from flexhinf.errors import InvalidInput

__all__ = ["ALL_STATES", "VELOCITIES", "ProcessNoise", "Swept", "unstable_share"]

ALL_STATES, VELOCITIES = "all states", "velocities only"


@dataclass(frozen=True)
class ProcessNoise:
    """R^v = q on the diagonal: of all states, or of velocities (states with "velocity" as a word of their name).

    Parameters
    ----------
    form : {"all states", "velocities only"}
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
        if self.form not in (ALL_STATES, VELOCITIES) or not (np.isfinite(self.q) and self.q >= 0.0):
            raise InvalidInput(
                "The process noise is not known.",
                f"expected {ALL_STATES!r} or {VELOCITIES!r} and a finite q >= 0, got {self.form!r} and {self.q!r}",
                f"ProcessNoise({ALL_STATES!r}, 1e-6)",
            )

    def covariance(self, states: Sequence[str]) -> np.ndarray:
        """R^v (n, n) of a plant with these states.

        Raises
        ------
        InvalidInput
            If velocities are asked for and there are none.
        """
        moves = [self.form == ALL_STATES or "velocity" in name.split("_") for name in states]
        if not any(moves):
            raise InvalidInput(
                "No state is a velocity.", f"got {list(states)}", f"ProcessNoise({ALL_STATES!r}, …)"
            )
        return self.q * np.diag(np.array(moves, dtype=float))


@dataclass(frozen=True, eq=False)
class Swept:
    """What a population does to a loop at one R^v.

    Attributes
    ----------
    noise : ProcessNoise or None
        None: the estimator's own R^v, or the true state fed back.
    rates : (N,) array
        Growth rate with each plant, 1/s; infinite for a loop without rest.
    kinds : (N,) array of str
    """

    noise: ProcessNoise | None
    rates: np.ndarray
    kinds: np.ndarray

    def share(self, kind: str | None = None) -> float:
        """Share of unstable plants of a kind ("corner", …), or of all; NaN where there is none."""
        chosen = self.rates if kind is None else self.rates[self.kinds == kind]
        return float(np.mean(chosen >= 0.0)) if len(chosen) else float("nan")

    @property
    def worst(self) -> int:
        """The plant with which the loop grows fastest."""
        return int(np.argmax(self.rates))


def unstable_share(
    loop: RestingLoop, population: Population, noises: Sequence[ProcessNoise | None] = (None,)
) -> tuple[Swept, ...]:
    """Growth rates of a loop for every plant and every R^v.

    Parameters
    ----------
    loop : RestingLoop
    population : Population
    noises : sequence of ProcessNoise or None
        None stands for the loop as it is.

    Raises
    ------
    InvalidInput
        If R^v is asked for and no Kalman filter is in the loop.
    """
    vectors, found = loop.vectors(population.values), []
    for noise in noises:
        covariance = None if noise is None else noise.covariance(loop.step.states)
        found.append(Swept(noise, loop.modes(vectors, covariance).rate, population.kinds))
    return tuple(found)
