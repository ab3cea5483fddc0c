"""What a tolerance does to a robot, as a disturbance: each uncertain parameter a channel (Shen & Tamura 1995).

A parameter p in p0 ± δ changes the accelerations; seen as torques at links and motors the change is, on the linear
part,

    w = Δ (T_x x + T_u u),   |Δ| ≤ 1,

with T taken between the ends of the interval, the robot at its own equilibrium at each of them. Split into rank-one
parts, each is a torque t w' driven by a signal z_Δ = c x or z_Δ = e u that is seen through the unknown Δ: for the
stiffness t = δ^½ (−1, 1), z_Δ = δ^½ (q1 − q2). Where the change bends, as with 1/R, a part is as long as towards the
end where more changes, so that |Δ| ≤ 1 holds at both. What is constant, such as the weight that is carried, is left
to the integral.

A channel covers its tolerance alone. At a corner of the tolerances products of them act, such as m·g·l and k_t/R, and a
robot there changes by a little more than the sum of its channels. So the linear part of the dissipation inequality is
checked at the corners themselves, and the tolerances of the channels are enlarged step by step until it holds there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from flexhinf.analysis import DissipationCorners, LinearCorners
from flexhinf.errors import FlexhinfError
from flexhinf.hinf import linear_law
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot

#: Rank-one parts smaller than this fraction of a parameter's largest are left out.
SMALL = 1e-3

#: A change smaller than this, relative to the robot's own torques, is rounding.
ROUNDING = 1e-10

#: Factors by which the tolerances are enlarged, one after the other, until the inequality holds at the corners.
ENLARGED = (1.0, 1.05, 1.1, 1.15, 1.2, 1.3)

Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class Channel:
    """A rank-one part of what a tolerance does.

    Attributes
    ----------
    quantity : str
        The parameter without its joint; channels of one quantity and kind share a scaling.
    torque : (2 joints,)
        t, at links and motors.
    by_state : (n,)
        c, on the plant's states; zero for a channel of the input.
    by_input : (m,)
        e; zero for a channel of the state.
    """

    quantity: str
    torque: np.ndarray
    by_state: np.ndarray
    by_input: np.ndarray

    @property
    def group(self) -> tuple[str, str]:
        """Quantity, and what drives it."""
        return self.quantity, "input" if np.any(self.by_input) else "state"


def channels(robot: Robot, poses: Sequence[np.ndarray]) -> tuple[Channel, ...]:
    """Of all uncertain parameters, each at that of the poses where it does most."""
    plant = robot.plant()
    plant.traced_jacobians  # noqa: B018  traced once, shared by all corners
    found: list[Channel] = []
    for parameter in robot.uncertain:
        changes = [_changes(robot, plant, parameter.name, pose) for pose in poses]
        largest = max(changes, key=lambda ends: float(np.abs(ends).max()))
        found += _rank_one(_quantity(parameter.name, robot.joint_names), largest, plant.n)
    return tuple(found)


def _changes(robot: Robot, plant: Any, name: str, pose: np.ndarray) -> np.ndarray:
    """[T_x T_u] from the nominal robot to each end of the interval, (2, 2 joints, n + m), each at its own
    equilibrium."""
    a, b, torques, _ = plant.linearise(*robot.operating_point(pose))
    nominal = np.hstack([a, b])
    size = np.abs(np.linalg.lstsq(torques, nominal, rcond=None)[0]).max()
    ends = []
    for sign in (1.0, -1.0):
        known = plant.parameters.known(robot.corner({name: sign}))
        equilibrium = robot.operating_point(pose, parameters=known)
        there = np.hstack(plant.with_parameters(**known).linearise(*equilibrium)[:2])
        change = np.linalg.lstsq(torques, there - nominal, rcond=None)[0]
        ends.append(np.where(np.abs(change) > ROUNDING * size, change, 0.0))
    return np.array(ends)


def _quantity(name: str, joints: Sequence[str]) -> str:
    return next((name.removesuffix(f"_{joint}") for joint in joints if name.endswith(f"_{joint}")), name)


def _rank_one(quantity: str, ends: np.ndarray, n: int) -> list[Channel]:
    """Singular parts of half the difference between the ends, each made as long as the end that it reaches less."""
    found, inputs = [], ends.shape[2] - n
    for by_state in (True, False):
        up, down = ends[:, :, :n] if by_state else ends[:, :, n:]
        left, sizes, right = np.linalg.svd(0.5 * (up - down), full_matrices=False)
        for size, t, c in zip(sizes, left.T, right):
            if size > max(SMALL * sizes[0], 0.0):
                root = np.sqrt(max(size, abs(t @ up @ c), abs(t @ down @ c)))
                state = root * c if by_state else np.zeros(n)
                found.append(Channel(quantity, root * t, state, np.zeros(inputs) if by_state else root * c))
    return found


# Products of tolerances ---------------------------------------------------------------------------------
def acting_corners(robot: Robot, goal: np.ndarray, problem: GeneralisedPlant) -> LinearCorners:
    """The problem's plant at the corners of those tolerances that change it, each at its own equilibrium at the goal.

    Parameters
    ----------
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
