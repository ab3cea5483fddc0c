"""A plant in the coordinates of its own outputs: y, ẏ, ÿ … up to the derivative that the input reaches.

Each output is differentiated along ẋ = f(x, u) until u appears, after r_j turns (Lie derivatives, [isidori1995b]):

    y_j^(r_j) = b_j(x) + A_j(x) u.

Where A(x), the decoupling matrix, is invertible, u = A⁻¹ (v − b) makes it y_j^(r_j) = v_j: chains of integrators. For
elastic joints and their link positions r = 4 and A = M⁻¹ K J⁻¹ k_u [spong1987]; with damped springs r = 3.
The derivatives are exact, formed by CasADi from the plant's own flow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant
from flexhinf.scalars import apply
from flexhinf.scalars.dependence import linear


@dataclass(frozen=True, eq=False)
class NormalForm:
    """Outputs of a plant with their derivatives; undisturbed, with the parameters as data.

    Parameters
    ----------
    plant : Plant
        As many inputs as outputs.
    outputs : sequence of str
        States of the plant.

    Raises
    ------
    InvalidInput
        If their numbers differ, an output is not reached by any input, or the input does not enter linearly.
    """

    plant: Plant
    outputs: Sequence[str]

    def __post_init__(self) -> None:
        names = tuple(self.outputs)
        object.__setattr__(self, "outputs", names)
        if len(set(names)) != len(names) or len(names) != len(self.plant.inputs):
            raise InvalidInput(
                "A normal form needs as many outputs as inputs.",
                f"expected {len(self.plant.inputs)} distinct states, got {list(names)}",
                "one state per input, the link positions of a robot",
            )
        for name in names:
            self.plant.index(name)
        _ = self._derivatives

    @cached_property
    def _derivatives(self) -> tuple[Any, Any, Any, list[list[Any]], list[Any]]:
        """x, u, p, and for each output its derivatives below r_j, and the r_j-th."""
        import casadi as ca

        plant = self.plant
        x, u = ca.SX.sym("x", plant.n), ca.SX.sym("u", len(plant.inputs))
        p = ca.SX.sym("p", plant.parameters.size)
        rate = plant.traced_flow(x, u, ca.SX.zeros(len(plant.disturbances)), p)
        places = [plant.index(name) for name in self.outputs]
        lower: list[list[Any]] = [[] for _ in places]
        top: list[Any] = [None for _ in places]
        current, open_ = x[places], list(range(len(places)))
        for _ in range(plant.n):
            following = ca.cse(ca.jtimes(current, x, rate))
            reached = ca.which_depends(following, u, 1, True)
            for row, j in enumerate(open_):
                lower[j].append(current[row])
                if reached[row]:
                    top[j] = following[row]
            kept = [row for row in range(len(open_)) if not reached[row]]
            current, open_ = following[kept], [open_[row] for row in kept]
            if not open_:
                break
        if open_:
            raise InvalidInput(
                f"No input reaches {self.outputs[open_[0]]!r}, however often it is differentiated.",
                f"expected a relative degree of at most {plant.n} for each of {list(self.outputs)}",
                "states that the inputs move",
            )
        if not linear(ca.Function("top", [u, x, p], [ca.densify(ca.vertcat(*top))])):
            raise InvalidInput(
                "The inputs do not enter linearly.", f"in the derivatives of {list(self.outputs)}",
                "a model that is affine in its inputs",
            )  # fmt: skip
        return x, u, p, lower, top

    @cached_property
    def degrees(self) -> tuple[int, ...]:
        """Relative degree r_j of each output."""
        return tuple(len(each) for each in self._derivatives[3])

    @cached_property
    def chains(self) -> Any:
        """(x, u, p) → y, ẏ … below r_j of the first output, of the second …, (Σ r_j,), and y^(r) (m,)."""
        import casadi as ca

        x, u, p, lower, top = self._derivatives
        below = ca.vertcat(*(derivative for each in lower for derivative in each))
        return ca.Function(
            "chains", [x, u, p], [ca.densify(below), ca.densify(ca.vertcat(*top))], {"cse": True}
        )

    @cached_property
    def linearising(self) -> Any:
        """(x, v, p) → u with y^(r) = v."""
        import casadi as ca

        x, u, p, _, top = self._derivatives
        highest, v = ca.vertcat(*top), ca.SX.sym("v", u.numel())
        decoupling = ca.jacobian(highest, u)
        free = ca.substitute(highest, u, ca.SX.zeros(u.numel()))
        return ca.Function(
            "linearising", [x, v, p], [ca.densify(ca.solve(decoupling, v - free))], {"cse": True}
        )

    @cached_property
    def _decoupling(self) -> Any:
        import casadi as ca

        x, u, p, _, top = self._derivatives
        return ca.Function(
            "decoupling", [x, p], [ca.densify(ca.jacobian(ca.vertcat(*top), u))], {"cse": True}
        )

    def coordinates(self, x: Any, u: Any, p: Any) -> tuple[Any, Any]:
        """(ξ, y^(r)): see `chains`; of any element, p the parameter vector."""
        xi, top = apply(self.chains, x, u, p)
        return xi, top

    def input(self, x: Any, v: Any, p: Any) -> Any:
        """u (m,) with y^(r) = v (m,), of any element."""
        return apply(self.linearising, x, v, p)[0]

    def decoupling_matrix(self, x: np.ndarray) -> np.ndarray:
        """A(x), (m, m), at the nominal parameters."""
        return np.asarray(self._decoupling(x, self.plant.parameters.vector()), dtype=float)
