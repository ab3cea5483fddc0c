"""Products of tolerances in the preset `robust`.

A channel covers its tolerance alone. At a corner of the tolerances products of them act, such as m·g·l and k_t/R, and a
robot there changes by a little more than the sum of its channels. So the linear part of the dissipation inequality is
checked at the corners themselves, and the tolerances of the channels are enlarged step by step until it holds there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from flexhinf.analysis import DissipationCorners, LinearCorners
from flexhinf.errors import FlexhinfError
from flexhinf.hinf import linear_law
from flexhinf.plant import GeneralisedPlant

__all__ = ["ENLARGED", "acting_corners", "covering_products", "dissipation_of"]

#: Factors by which the tolerances are enlarged, one after the other, until the inequality holds at the corners.
ENLARGED = (1.0, 1.05, 1.1, 1.15, 1.2, 1.3)

Made = TypeVar("Made")


def acting_corners(robot: Any, goal: np.ndarray, problem: GeneralisedPlant) -> LinearCorners:
    """The problem's plant at the corners of those tolerances that change it, each at its own equilibrium at the goal.

    Parameters
    ----------
    robot : Robot
    goal : (n,)
        Link positions, rad or m.
    problem : GeneralisedPlant
        Without channels of the tolerances.
    """
    plant = problem.plant
    plant.traced_jacobians  # noqa: B018  traced once, shared by all corners

    def linearised(signs: dict[str, float]) -> np.ndarray:
        known = plant.parameters.known(robot.corner(signs))
        equilibrium = robot.operating_point(goal, parameters=known)
        return np.hstack(plant.with_parameters(**known).linearise(*equilibrium)[:2])

    nominal = linearised({})

    def acts(name: str) -> bool:
        return not np.allclose(linearised({name: 1.0}), nominal, rtol=1e-12, atol=0.0)

    names = [parameter.name for parameter in robot.uncertain if acts(parameter.name)]
    return LinearCorners.of(
        problem,
        lambda signs: robot.corner(dict(zip(names, signs, strict=True))),
        len(names),
        lambda values: robot.operating_point(goal, parameters=values),
    )


def dissipation_of(
    corners: LinearCorners, nominal: GeneralisedPlant, problem: GeneralisedPlant, gamma: float
) -> DissipationCorners:
    """The inequality with d and z of the nominal problem, for the linear law of the robust one, at the corners."""
    law = linear_law(problem, gamma)
    return replace(corners, problem=nominal).dissipation(law.P, law.gain, gamma)


def covering_products(first: Made, covering: Callable[[float], Made], failing: Callable[[Made], int]) -> Made:
    """The design with the least enlarged tolerances that no corner breaks; the first one where there is none.

    Parameters
    ----------
    first : design
        Of the tolerances as they are.
    covering : callable
        Factor of the tolerances → design; it may raise where the larger tolerances are out of reach.
    failing : callable
        Design → corners that break the inequality.
    """
    if not failing(first):
        return first
    for factor in ENLARGED[1:]:
        try:
            found = covering(factor)
        except FlexhinfError:  # out of reach: the page says how many corners the first design leaves
            return first
        if not failing(found):
            return found
    return first
