"""One law at the goal, or laws at several poses on the way with a rule for switching."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from flexhinf.design.presets.choose import Chosen, choose
from flexhinf.design.specification import Specification
from flexhinf.design.withstand import choose_withstanding
from flexhinf.hinf import HJISolution, solve_hji
from flexhinf.loop import Schedule
from flexhinf.plant import Law

__all__ = ["law_of"]


def law_of(
    robot: Any,
    s: Specification,
    game: Chosen,
    solution: HJISolution,
    goal: np.ndarray,
    start: np.ndarray,
    tell: Callable[[str], None],
) -> Law:
    """The solution at the goal; with ``via`` a `Schedule` of it and of the same design at each of these poses.

    The preset, the behaviour, γ/γ* and the degree are the same at all poses; weights are found for each. Penalties
    that are stated are the same everywhere.

    Raises
    ------
    InvalidInput
        If what is asked for cannot be met at one of the poses.
    """
    laws = [solution]
    for pose in s.via:
        tell(f"the law at {', '.join(f'{value:.3g}' for value in pose)}")
        place = robot.operating_point(pose)[0][: len(goal)]
        asked = replace(s, bandwidth=None if game.wanted is None else game.wanted.bandwidth.tolist())
        there = choose_withstanding(choose, robot, place, start, asked)
        laws.append(solve_hji(there.problem, there.gamma, solution.degree))
    return solution if len(laws) == 1 else Schedule(laws)
