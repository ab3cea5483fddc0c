"""The preset `robust` with its estimator: more damping, until no corner of the tolerances is unstable for any R^v.

The game of the preset covers the tolerances for the true state; an estimator comes between, and nobody knows its R^v.
What its delay takes away is given back as damping of the vibrations: the damping asked for is raised step by step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from flexhinf.design.bench import Bench
from flexhinf.design.presets.choose import DAMPING, Chosen
from flexhinf.design.specification import Specification
from flexhinf.design.tolerances import tolerance_corners
from flexhinf.errors import FlexhinfError
from flexhinf.hinf import solve_hji

__all__ = ["choose_withstanding"]

#: The damping grows by this factor, so many times at most.
GROWTH, TURNS = 1.25, 6

Choose = Callable[[Any, np.ndarray, np.ndarray, Specification], Chosen]


def choose_withstanding(
    choose: Choose,
    robot: Any,
    goal: np.ndarray,
    start: np.ndarray,
    s: Specification,
    tell: Callable[[str], None] = lambda text: None,
) -> Chosen:
    """The game of a specification; of the preset robust, the first that withstands the sweep, or the best found.

    Parameters
    ----------
    choose : callable
        (robot, goal, start, specification) → Chosen.
    robot, goal, start, s
        As for `choose`.
    tell : callable
    """
    best = game = choose(robot, goal, start, s)
    if game.robustness is None or s.estimator == "none":
        return game
    fewest, damping = np.inf, DAMPING if s.damping is None else s.damping
    for turn in range(TURNS + 1):
        unstable = _unstable(robot, goal, start, s, game)
        if unstable < fewest:
            fewest, best = unstable, game
        if not unstable or turn == TURNS:
            break
        damping = min(0.95, GROWTH * damping)
        tell(f"{unstable} corners unstable over R^v: damping {damping:.2g}")
        try:
            game = choose(robot, goal, start, replace(s, damping=damping))
        except FlexhinfError:
            break
    return best


def _unstable(robot: Any, goal: np.ndarray, start: np.ndarray, s: Specification, game: Chosen) -> int:
    """Corners that are unstable at one R^v of the sweep, at most."""
    law = solve_hji(game.problem, game.gamma, 2)
    found = tolerance_corners(Bench(robot, s, game.nominal.plant, law, goal, start), law)
    return 0 if found is None else found.unstable_anywhere
