"""The linear part of a design at its goal: the nominal robot, and the same robot within its tolerances.

A search asks for many gains. What does not change with the gain is computed once here: ẋ = A x + B u + G d of every
member, the integrals of the tracking errors appended, deviations from each member's own rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.design.modes import stiffness_and_inertia

__all__ = ["MEMBERS", "LinearFamily"]

#: Corners of the tolerances that a search looks at, beside the nominal robot.
MEMBERS = 32


@dataclass(frozen=True, eq=False)
class LinearFamily:
    """Linearisations of N members, the nominal one first.

    Attributes
    ----------
    a, b : (N, n, n), (N, n, m)
        With one integral per joint as last states.
    torques : (n, 2 joints)
        Where torques at links and motors enter, nominal.
    joints : tuple of str
    energy : (stiffness, inertia)
        Of the nominal robot, to tell vibrations from other modes.
    """

    a: np.ndarray
    b: np.ndarray
    torques: np.ndarray
    joints: tuple[str, ...]
    energy: tuple[np.ndarray, np.ndarray]

    @property
    def nominal(self) -> tuple[np.ndarray, np.ndarray]:
        """(A, B) of the nominal robot."""
        return self.a[0], self.b[0]

    def with_members(self, other: LinearFamily, places: Any) -> LinearFamily:
        """The same family with some members of another one."""
        chosen = sorted(set(places))
        a, b = np.concatenate([self.a, other.a[chosen]]), np.concatenate([self.b, other.b[chosen]])
        return replace(self, a=a, b=b)

    @staticmethod
    def of(robot: Any, goal: np.ndarray, members: int = MEMBERS, seed: int = 0) -> LinearFamily:
        """Of a robot, its corners drawn with a fixed seed.

        Parameters
        ----------
        robot : Robot
        goal : (n,)
            Link positions, rad or m.
        members : int
            Corners; none for a robot without tolerances.
        seed : int
            Of the corners.
        """
        plant, rest = robot.plant(), robot.operating_point(goal)
        plant.traced_jacobians  # noqa: B018  traced once, shared by all members
        joints, n = len(robot.joint_names), plant.n
        corners = [plant.parameters.known(values) for values in _corners(robot, members, seed)]
        matrices = [plant.linearise(*rest)]
        for values in corners:
            changed = plant.with_parameters(**values)
            matrices.append(changed.linearise(*robot.operating_point(goal, parameters=values)))
        a = np.zeros((len(matrices), n + joints, n + joints))
        b = np.zeros((len(matrices), n + joints, len(plant.inputs)))
        for k, (state, inputs, _, _) in enumerate(matrices):
            a[k, :n, :n], b[k, :n] = state, inputs
        a[:, n:, :joints] = np.eye(joints)
        torques = np.zeros((n + joints, 2 * joints))
        torques[:n] = matrices[0][2]
        return LinearFamily(a, b, torques, robot.joint_names, stiffness_and_inertia(plant, rest))


def _corners(robot: Any, count: int, seed: int = 0) -> list[dict[str, Any]]:
    """All corners where there are no more than `count`; otherwise so many at random, whatever the parameters' order."""
    names = sorted(parameter.name for parameter in robot.uncertain)
    if not names or not count:
        return []
    if 2 ** len(names) <= count:
        signs = 1.0 - 2.0 * ((np.arange(2 ** len(names))[:, None] >> np.arange(len(names))) & 1)
    else:
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], (count, len(names)))
    return [robot.corner(dict(zip(names, row.tolist()))) for row in signs]
