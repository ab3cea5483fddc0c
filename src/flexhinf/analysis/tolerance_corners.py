"""True plants within tolerances: drawn, at corners, with one number at one end.

A campaign knows no robot: it is given a function from signs (−1, 0 or 1 for each uncertain number) to parameters of a
plant, `flexhinf.robot.Robot.corner`, and one from a generator, `Robot.draw`.

How many plants of a population make a loop unstable, over the process noise that its estimator assumes.

No paper gives R^v, and the gain of an estimator depends on its ratio to R^n alone. Two forms are usual: q on every
state (R^v = q I), and q on the velocities only, since what a model misses are torques.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.errors import InvalidInput

__all__ = [
    "ALL_STATES",
    "VELOCITIES",
    "Population",
    "ProcessNoise",
    "Swept",
    "corner_population",
    "corners",
    "unstable_share",
]


@dataclass(frozen=True, eq=False)
class Population:
    """Plants of a campaign.

    Attributes
    ----------
    values : tuple of mappings by name
        Parameters of each plant, numbers or arrays.
    kinds : (N,) array of str
        "draw", "corner", "single" or "nominal".
    signs : (N, p) array
        Of the uncertain numbers; NaN for draws.
    nominal : mapping by name
        Parameters of the nominal plant.
    """

    values: tuple[Mapping[str, Any], ...]
    kinds: np.ndarray
    signs: np.ndarray
    nominal: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.values)

    def describe(self, k: int) -> str:
        """A plant by its changes in per cent."""
        parts = []
        for name, value in self.values[k].items():
            new, old = (np.ravel(np.asarray(v, dtype=float)) for v in (value, self.nominal[name]))
            for i in np.flatnonzero((new != 0.0) & (old != 0.0)):
                change = 100.0 * (new[i] / old[i] - 1.0)
                place = f" {i + 1}" if len(new) > 1 else ""
                if abs(change) > 1e-9:
                    parts.append(f"{name.replace('_', ' ')}{place} {change:+.3g} %")
        return ", ".join(parts) or "nominal"


def corners(uncertain: int, count: int, seed: int = 0) -> np.ndarray:
    """Signs (N, p) of corners: all 2^p of them if they are at most `count`, else `count` random ones.

    Raises
    ------
    InvalidInput
        If a number is negative or no integer.
    """
    for name, number in (("uncertain", uncertain), ("count", count), ("seed", seed)):
        if isinstance(number, bool) or not isinstance(number, (int, np.integer)) or number < 0:
            raise InvalidInput(
                "The corners cannot be counted.",
                f"expected integers >= 0, got {name}={number!r}",
                "count=400",
            )
    if uncertain < 63 and 2**uncertain <= count:
        return np.array(list(itertools.product((-1.0, 1.0), repeat=uncertain))).reshape(
            2**uncertain, uncertain
        )
    return np.random.default_rng([seed, 1]).choice([-1.0, 1.0], (count, uncertain))


def corner_population(
    at: Callable[[Sequence[float]], Mapping[str, Any]],
    uncertain: int,
    count: int = 400,
    seed: int = 0,
    draw: Callable[[np.random.Generator], Mapping[str, Any]] | None = None,
    draws: int = 100,
) -> Population:
    """Draws, corners, every uncertain number alone at both of its ends, and the nominal plant, in this order.

    Parameters
    ----------
    at : callable
        Signs (one per uncertain number) → parameters of a plant: `Robot.corner`.
    uncertain : int
        How many uncertain numbers there are: ``len(robot.uncertain)``.
    count : int
        Corners, if there are more than so many.
    seed : int
        Of corners and draws, each with a generator of its own.
    draw : callable, optional
        Generator → parameters: `Robot.draw`. Without it nothing is drawn.
    draws : int
    """
    rng, found = np.random.default_rng(seed), corners(uncertain, count, seed)
    drawn = [] if draw is None else [draw(rng) for _ in range(draws)]
    unit = np.eye(uncertain)
    singles = np.array([sign * row for row in unit for sign in (-1.0, 1.0)]).reshape(-1, uncertain)
    signs = np.vstack([found, singles, np.zeros((1, uncertain))])
    values = (*drawn, *(at(row.tolist()) for row in signs))
    kinds = ["draw"] * len(drawn) + ["corner"] * len(found) + ["single"] * len(singles) + ["nominal"]
    whole = np.vstack([np.full((len(drawn), uncertain), np.nan), signs])
    return Population(values, np.array(kinds), whole, values[-1])


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
        Growth rate with each plant, 1/s; infinite for a loop without equilibrium.
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
    loop: EquilibriumLoop, population: Population, noises: Sequence[ProcessNoise | None] = (None,)
) -> tuple[Swept, ...]:
    """Growth rates of a loop for every plant and every R^v.

    Parameters
    ----------
    loop : EquilibriumLoop
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
