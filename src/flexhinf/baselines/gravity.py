"""The gravity torque G(q) of a plant, as a function that laws can use: from its flow, or one that is given.

At rest and with its springs relaxed (q2 = q1) a robot falls by q̈1 = −M⁻¹ G, and a torque at the links moves it by
M⁻¹: the flow says both, so G = −(∂q̈1/∂d_link)⁻¹ q̈1 is exact for any plant of elastic joints. A function made for the
robot (inverse dynamics) costs less.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.baselines.joints import check_joints
from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant
from flexhinf.scalars import apply, digest, trace

#: Largest difference of a given function from the plant's own gravity torque, relative to the largest torque.
AGREEMENT = 1e-9


@dataclass(frozen=True, eq=False)
class GravityTorque:
    """G(q1) of a plant, on any element, with the plant's parameters as data.

    Parameters
    ----------
    plant : Plant
        Of elastic joints.
    function : callable, optional
        ``function(q, p)`` → G (n,), NumPy code on any element; p has the plant's parameters as attributes. By
        default G comes from the plant's flow.

    Raises
    ------
    InvalidInput
        If the plant has no elastic joints, or the function disagrees with its flow.
    """

    plant: Plant
    function: Callable[[Any, Any], Any] | None = None

    def __post_init__(self) -> None:
        n, p = check_joints(self.plant), self.plant.parameters.vector()
        if self.function is None:
            return
        own = GravityTorque(self.plant)
        for angle in (0.3, 1.1, -0.7):  # generic poses
            q = angle * (1.0 + 0.1 * np.arange(n))
            given, expected = apply(self.traced, q, p)[0], own.torque(q, p)
            if given.shape != (n,) or np.abs(given - expected).max() > AGREEMENT * max(
                1.0, np.abs(expected).max()
            ):
                raise InvalidInput(
                    "The gravity torque that was given is not the plant's.",
                    f"expected {expected.tolist()} at q = {q.tolist()}, got {given.tolist()}",
                    "gravity=None: it is taken from the plant's flow",
                )

    @cached_property
    def traced(self) -> Any:
        """(q, parameter vector) → G as a CasADi function."""
        import casadi as ca

        plant, n = self.plant, len(self.plant.inputs)
        if self.function is not None:
            function, named = self.function, plant.parameters.named
            return trace(lambda q, p: function(q, named(p)), n, plant.parameters.size, name="gravity")
        q, p = ca.SX.sym("q", n), ca.SX.sym("p", plant.parameters.size)
        d = ca.SX.sym("d", len(plant.disturbances))
        still = ca.SX.zeros(n)
        flow = plant.traced_flow(ca.vertcat(q, still, q, still), ca.SX.zeros(n), d, p)
        fall = flow[n : 2 * n]
        links = [plant.disturbances.index(name) for name in plant.expanded("link_torque")]  # type: ignore[union-attr]
        compliance = ca.jacobian(fall, d)[:, links]
        torque = -ca.solve(compliance, fall)
        free = ca.substitute(torque, d, ca.SX.zeros(d.numel()))
        return ca.Function("gravity", [q, p], [ca.densify(free)], {"cse": True})

    @cached_property
    def _with_rate(self) -> Any:
        """(q, dq, parameter vector) → G, ∂G/∂q q̇ as one CasADi function."""
        import casadi as ca

        n = len(self.plant.inputs)
        q, dq, p = ca.SX.sym("q", n), ca.SX.sym("dq", n), ca.SX.sym("p", self.plant.parameters.size)
        torque = self.traced(q, p)
        rate = ca.densify(ca.jtimes(torque, q, dq))
        return ca.Function("gravity_rate", [q, dq, p], [torque, rate], {"cse": True})

    def torque(self, q: Any, p: Any) -> Any:
        """G(q), (n,), N·m, at the parameter vector p."""
        return apply(self.traced, q, p)[0]

    def torque_and_rate(self, q: Any, dq: Any, p: Any) -> tuple[Any, Any]:
        """G(q) and its rate ∂G/∂q q̇, (n,) each."""
        torque, rate = apply(self._with_rate, q, dq, p)
        return torque, rate

    @cached_property
    def key(self) -> str:
        """What distinguishes the code of two gravity torques."""
        return digest(self.traced)
