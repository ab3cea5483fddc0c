"""The output-injection form ẋ = A x + φ(y, u), y = H x + η(u): where a plant's nonlinearity is measured.

A plant has it exactly where ∂f/∂x along every direction that the measurement does not see (the null space of H) is
a constant, whatever x and u are [krener1983]. Nothing is transformed: the states stay the plant's. How the linear
part is divided between A and φ is free on what is measured; here φ has no slope at one point, so that a linear
plant is all A.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant
from flexhinf.scalars.dependence import nonzero, sizes_of_rows, switches, varying

#: Relative size of a diagonal entry of a triangular factor that counts as zero.
RANK = 1e-12

OTHER = "UnscentedKalmanFilter, which takes any plant"


def output_form(plant: Plant, about: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """A (n, n) and H (p, n) of a plant with its nominal parameters and no disturbance.

    `about`: (n,), state at which φ(·, 0) has no slope; the origin by default. Raises InvalidInput: if the plant does
    not have the form: which states enter nonlinearly, and what to measure in addition. If it has no linearisation at
    `about`.
    """
    slopes = _Slopes(plant)
    slopes.check_output()
    drift, _, _, measured = plant.linearise(about)
    if not (np.all(np.isfinite(drift)) and np.all(np.isfinite(measured))):
        raise InvalidInput(
            "The plant has no linearisation at the point about which it is split.",
            f"expected finite derivatives at x = {np.zeros(plant.n).tolist() if about is None else about.tolist()}",
            "about=, a state where the model is smooth",
        )
    slopes.check_flow(measured)
    return drift, measured


class _Slopes:
    """Derivatives of flow and output as expressions of (x, u)."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        x, u = ca.SX.sym("x", plant.n), ca.SX.sym("u", len(plant.inputs))
        numbers = plant.parameters.vector()
        self.x, self.z = x, ca.vertcat(x, u)
        self.flow = plant.traced_flow(x, u, np.zeros(len(plant.disturbances)), numbers)
        self.output = plant.traced_output(x, u, numbers)
        self.by_state = ca.jacobian(self.flow, x)

    @cached_property
    def deciding(self) -> ca.SX:
        """Derivatives of what decides where the flow is not smooth, (s, n)."""
        return ca.jacobian(switches(self.flow, self.z), self.x)

    def check_output(self) -> None:
        """Refuse a measurement that is not H x + η(u)."""
        slope = ca.jacobian(self.output, self.x)
        bad: Any = varying(slope, self.z, sizes_of_rows(slope))
        for row in range(len(self.plant.outputs)):
            decides = ca.jacobian(switches(self.output[row], self.z), self.x)
            bad[row] |= np.asarray(ca.DM(decides.sparsity(), 1.0)).astype(bool).any(axis=0)
        if not bad.any():
            return
        row = int(np.argmax(bad.any(axis=1)))
        names = [name for name, wrong in zip(self.plant.states, bad[row]) if wrong]
        raise InvalidInput(
            f"The output-injection observer does not fit this plant: its measurement "
            f"{self.plant.outputs[row]!r} is not linear in the state.",
            f"expected y = H x + η(u) with constant H, got ∂{self.plant.outputs[row]}/∂({', '.join(names)}) "
            "that is not constant",
            f"measured signals that are linear in the state; or {OTHER}",
        )

    def check_flow(self, measured: np.ndarray) -> None:
        """Refuse a flow that is not A x + φ(H x, u)."""
        if self._holds(measured):
            return
        varies = varying(self.by_state, self.z, sizes_of_rows(self.by_state))
        jumps: Any = np.asarray(ca.DM(self.deciding.sparsity(), 1.0)).astype(bool).any(axis=0)
        states, unit, unseen = self.plant.states, np.eye(self.plant.n), null_space(measured)
        hidden = [j for j in range(self.plant.n) if np.abs(unit[j] @ unseen).max(initial=0.0) > RANK]
        entering = [j for j in hidden if varies[:, j].any() or jumps[j]]
        wanted = list(entering)
        for j in reversed(entering):  # of what enters, only what the other measurements do not settle
            fewer = [i for i in wanted if i != j]
            if self._holds(np.vstack([measured, unit[fewer]])):
                wanted = fewer
        j, one = wanted[0], len(entering) == 1
        rate = (
            f"∂({states[int(np.argmax(varies[:, j]))]}')/∂({states[j]})" if varies[:, j].any() else "a switch"
        )
        raise InvalidInput(
            f"The output-injection observer does not fit this plant: {self._names(entering)} "
            f"{'enters' if one else 'enter'} nonlinearly and {'is' if one else 'are'} not measured.",
            f"expected ẋ = A x + φ(y, u) with y = {list(self.plant.outputs)}, got {rate} that depends on the state "
            "or the input",
            f"measure {self._names(wanted)} in addition; or {OTHER}",
        )

    def _names(self, places: list[int]) -> str:
        """States by name; by the plain name that stands for all of a kind where all are meant."""
        names = [self.plant.states[j] for j in places]
        for group, members in self.plant.groups.items():
            if set(members) <= set(names):
                names = [group if name == members[0] else name for name in names if name not in members[1:]]
        return ", ".join(names)

    def _holds(self, measured: np.ndarray) -> bool:
        """Is the flow A x + φ(y, u) for these measurements?"""
        hidden = ca.DM(null_space(measured))
        if not hidden.numel():
            return True
        along, decides = self.by_state @ hidden, self.deciding @ hidden
        scale = sizes_of_rows(self.by_state, hidden.shape[1])
        if varying(along, self.z, scale).any():
            return False
        return not nonzero(decides, self.z, sizes_of_rows(self.deciding, hidden.shape[1])).any()


def null_space(matrix: np.ndarray) -> np.ndarray:
    """Basis (n, k) of what a matrix (p, n) maps to zero; unit vectors where its rows are.

    By a triangular factor with pivoting, which unlike singular vectors mixes no states without need.
    """
    from scipy.linalg import qr

    n, size = matrix.shape[1], np.linalg.norm(matrix, axis=1, keepdims=True)
    rows = matrix / np.where(size > 0.0, size, 1.0)
    found: Any = qr(rows, mode="r", pivoting=True)
    factor, order = found
    diagonal = np.abs(np.diag(factor))
    rank = int(np.sum(diagonal > RANK * max(1.0, diagonal[0]))) if len(diagonal) else 0
    basis = np.zeros((n, n - rank))
    basis[order[rank:]] = np.eye(n - rank)
    basis[order[:rank]] = -np.linalg.solve(factor[:rank, :rank], factor[:rank, rank:])
    return basis[:, np.argsort(order[rank:])]
