"""The model of a robot at rest at a pose, of which laws over a workspace make their gains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Vector
    from flexhinf.plant import Plant
    from flexhinf.plant.joints import ElasticJoints
else:
    np = late_package("numpy")


@dataclass(frozen=True, eq=False)
class PoseModel:
    """The model at rest at a pose, and at home.

    A joint's bandwidth is ω_j = (ω⁻⁴ + (share ω_own)⁻⁴)^-¼ with ω_own = √(K_j/M_jj), its vibration with the motor held.
    """

    plant: Plant
    equilibrium: tuple[Vector, Vector]  # State (N,) and input (n,) at rest at the pose
    pose: Vector  # (n,), rad or m
    period: float  # Of the controller, s
    authority: Vector  # (n,). Limits of the inputs; of a motor without one what it needs
    joints: ElasticJoints  # Inertias, springs and weight at the pose
    home: ElasticJoints
    names: tuple[str, ...]  # Of the joints
    elastic: np.ndarray  # (n,), bool: which joints have a spring

    def bandwidths(self, numbers: Mapping[str, Vector], fixed: bool = False) -> Vector:
        """ω_j (n,), rad/s; by the inertia at home where gains are `fixed`."""
        m = self.home.link_inertia if fixed else self.joints.link_inertia
        wanted = np.broadcast_to(numbers.get("bandwidth", 1.0), len(self.pose)).astype(float)
        if "share" not in numbers:
            return wanted
        own = numbers["share"] * np.sqrt(self.joints.stiffness / np.diag(m))
        return np.where(self.elastic, (wanted**-4 + own**-4) ** -0.25, wanted)

    @property
    def turns(self) -> Vector:
        """ω_v (n,): vibrations with free motors, at home, rad/s."""
        k, m, rotor = self.home.stiffness, np.diag(self.home.link_inertia), self.home.motor_inertia
        return np.sqrt(k * (1.0 / m + 1.0 / rotor))
