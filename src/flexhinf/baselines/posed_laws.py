"""Laws for all poses of an arm: linear about a moving reference, with gains that follow the commanded pose.

Some gains have a formula that is code (`flexhinf.modal.ModalLaw`). Others are solved anew at each pose, such as those
of an LQG, or are made of the inertia matrix there. A straight move passes through few poses, so `GainsOnTheWay` has
the gains at some of them, and those between are on straight lines between neighbours. At rest they are exact.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from flexhinf.arrays import Elements, Matrix, Vector
from flexhinf.baselines.equilibrium_law import PlacedLaw
from flexhinf.plant.joints import ElasticJoints, LinkCompliance, elastic_joints, link_compliance
from flexhinf.scalars import absolute, clip

#: Poses of a move at which gains are solved. On a way of 3 rad lines between them miss a cosine by 2 %.
KNOTS = 9


class PosedLaw(PlacedLaw):
    """A law for every pose of a plant of elastic and rigid joints, which integrates the errors of all links."""

    @cached_property
    def joints(self) -> ElasticJoints:
        """The numbers of the joints at the equilibrium, of rigid ones as `elastic_joints` takes them."""
        return elastic_joints(self.plant, *self.equilibrium, rigid=True)

    @cached_property
    def compliance(self) -> LinkCompliance:
        """M(q)⁻¹ of the plant."""
        return link_compliance(self.plant)

    @abc.abstractmethod
    def slope_at(self, q: Vector) -> Matrix:
        """∂k/∂x (n, states), integrals last, about a reference at rest at link positions q (n,), rad or m."""

    def along(self, start: Vector, goal: Vector) -> Self:
        """The law for a straight move between two poses (n,); the same law where it has no numbers of a move."""
        return self

    def serves(self, poses: Matrix) -> bool:
        """Whether its code has the gains of all these poses (N, n), with no other numbers for each motion."""
        return True


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GainsOnTheWay(PosedLaw):
    """u = u_d + K(q_d) x for gains K that are a function of the pose.

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`; the link positions are integrated.
    gain : callable
        K (n, states), integrals last, at link positions (n,), rad or m.
    way : (2, n) array, optional
        Start and goal of the move, rad or m; by default the law rests at its equilibrium.
    """

    gain: Callable[[Vector], Matrix]
    way: Matrix | None = None

    def slope_at(self, q: Vector) -> Matrix:
        """K at a pose."""
        return self.gain(q)

    def along(self, start: Vector, goal: Vector) -> Self:
        """The law with the gains of a move."""
        return replace(self, way=np.array([start, goal]))

    def serves(self, poses: Matrix) -> bool:
        """Whether the gains of all poses are the same."""
        first = self.gain(poses[0])
        return all(np.array_equal(self.gain(pose), first) for pose in poses[1:])

    @property
    def law_key(self) -> str:
        """One text for all numbers of a size."""
        return f"gains on the way {len(self.input_names)} {self.plant.n}"

    @property
    def numbers(self) -> np.ndarray:
        """Start, direction by which the way is measured, and the gains of the knots, flat."""
        return self._numbers

    @cached_property
    def _numbers(self) -> np.ndarray:
        n = len(self.input_names)
        if self.way is None:
            here = self.equilibrium[0][:n]
            return np.concatenate([here, np.zeros(n), np.tile(self.gain(here).ravel(), KNOTS)])
        start, step = self.way[0], self.way[1] - self.way[0]
        knots = [self.gain(start + share * step) for share in np.linspace(0.0, 1.0, KNOTS)]
        length = float(step @ step)
        return np.concatenate([start, step / length if length else step, np.ravel(knots)])

    def evaluate_about(self, x: Elements, state: Elements, input: Elements, data: Elements) -> Elements:
        """k (n,) for a deviation x from the reference, of any element."""
        n, states = len(self.input_names), len(self.state_names)
        share = clip(((state[:n] - data[:n]) * data[n : 2 * n]).sum(), 0.0, 1.0)
        table = data[2 * n : 2 * n + KNOTS * n * states].reshape(KNOTS, n, states)
        total = np.zeros(n)
        for k in range(KNOTS):
            near = clip(1.0 - absolute(share * (KNOTS - 1) - k), 0.0, 1.0)
            total = total + near * (table[k] @ x)
        return total
