"""Springs in series with the masses of an arm: the sum that a modal law is, on any element and in any run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise

import casadi as ca
import numpy as np

from flexhinf.arrays import Elements
from flexhinf.codegen import DIRECT, gives
from flexhinf.scalars import apply, digest, solve_definite
from flexhinf.scalars.run import Run

#: Functions of λ: gains of q, q̇, θ, θ̇ and the integral, and that of what makes motors alike.
FUNCTIONS = 6


@dataclass(frozen=True, eq=False)
class SpringSeries:
    """u - u_d = -share (K y_∞ + Σ_j (M(q)⁻¹/p_j + K⁻¹)⁻¹ y_j), y_j = Σ_i k_ij x_i; see `flexhinf.modal.law`.

    `compliance`: (q, parameters) → M(q)⁻¹, flat, as a CasADi function. `places` (4, n): of q, q̇, θ, θ̇ in a state.
    `poles`: How many p_j there are. `holding`: whether motors are made alike in what holds their position too.
    `coupling`: T (n, n) of coupled joints, whose compliance is that at the outputs of the gears.
    """

    compliance: ca.Function
    places: np.ndarray
    poles: int
    holding: bool = False
    coupling: np.ndarray | None = None

    @cached_property
    def key(self) -> str:
        """What distinguishes the code of two series."""
        turned = "" if self.coupling is None else f" {self.coupling.tolist()}"
        return f"{self.poles}{' holding' * self.holding}{turned} {self.places.tolist()} {digest(self.compliance)}"

    @property
    def sizes(self) -> tuple[int, ...]:
        """Of the law's numbers: k_ij and k_i∞, 1/p_j, K, two or three that make motors alike, the share, parameters."""
        n = self.places.shape[1]
        alike = (n,) * (3 if self.holding else 2)
        return (FUNCTIONS * (self.poles + 1), self.poles, n, *alike, n, self.compliance.size1_in(1))

    def evaluate(
        self, x: Elements, data: Elements, state: Elements | None = None, run: Run = DIRECT
    ) -> Elements:
        """k (n,) for a deviation x, integrals last, from a reference state, with the numbers first in data; by default
        from x*, which stands behind them, before u* (n,)."""
        if state is None:
            state = data[sum(self.sizes) : -self.places.shape[1]]
        parts = (data[a:b] for a, b in pairwise(accumulate(self.sizes, initial=0)))
        rows, softness, stiffness, torque, friction, *holding, share, parameters = parts
        compliance = run.call(self._compliance, state, parameters)
        targets, last = run.call(self._targets, x, rows, torque, friction, *holding)
        moving = targets.T, softness.reshape(1, self.poles)
        springs = run.columns(_spring, moving, compliance, stiffness)
        return run.call(_feedback, springs, last, stiffness, share)

    @gives("compliance")
    def _compliance(self, state: Elements, parameters: Elements) -> Elements:
        """M(q)^-1 at the reference."""
        n = self.places.shape[1]
        return apply(self.compliance, state[self.places[0]], parameters)[0].reshape(n, n)

    @gives("targets", "last")
    def _targets(
        self, x: Elements, rows: Elements, torque: Elements, friction: Elements, *holding: Elements
    ) -> tuple[Elements, Elements]:
        """y_j = sum of k_ij x_i for each pole, and y_oo."""
        (q, dq, theta, dtheta), errors = x[self.places], x[-self.places.shape[1] :]
        if self.coupling is not None:
            q, dq, errors = (self.coupling @ links for links in (q, dq, errors))
        unlike = torque * (theta - q) + friction * dtheta
        for stiffness in holding:
            unlike = unlike + stiffness * theta
        targets = rows.reshape(FUNCTIONS, -1).T @ np.array([q, dq, theta, dtheta, errors, unlike])
        return targets[:-1], targets[-1]


@gives("springs")
def _spring(target: Elements, softness: Elements, compliance: Elements, stiffness: Elements) -> Elements:
    """(M^-1 / p_j + K^-1)^-1 y_j: springs K in series with masses p_j M."""
    return solve_definite(softness[0] * compliance + np.diag(1.0 / stiffness), target)


@gives("feedback")
def _feedback(springs: Elements, last: Elements, stiffness: Elements, share: Elements) -> Elements:
    """-share (K y_oo + what the springs give)."""
    total = stiffness * last
    for spring in springs.T:
        total = total + spring
    return -share * total
