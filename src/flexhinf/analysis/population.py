"""True plants within the tolerances: at the corners, with one number at one end, and Monte Carlo samples.

This room knows no robot: it is given a function from signs (−1, 0 or 1 for each uncertain number) to parameters of a
plant, `flexhinf.robot.Robot.corner`, and one from a generator, `Robot.draw`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput


@dataclass(frozen=True, eq=False)
class Population:
    """True plants.

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
        """A plant by its changes in per cent: ``stiffness 2 -12 %, mass 1 +3 %``."""
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
    singles: bool = True,
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
    singles : bool
        Whether plants with one number at one end are among them.
    """
    rng, found = np.random.default_rng(seed), corners(uncertain, count, seed)
    drawn = [] if draw is None else [draw(rng) for _ in range(draws)]
    unit = np.eye(uncertain) if singles else np.zeros((0, uncertain))
    alone = np.array([sign * row for row in unit for sign in (-1.0, 1.0)]).reshape(-1, uncertain)
    signs = np.vstack([found, alone, np.zeros((1, uncertain))])
    values = (*drawn, *(at(row.tolist()) for row in signs))
    kinds = ["draw"] * len(drawn) + ["corner"] * len(found) + ["single"] * len(alone) + ["nominal"]
    whole = np.vstack([np.full((len(drawn), uncertain), np.nan), signs])
    return Population(values, np.array(kinds), whole, values[-1])
