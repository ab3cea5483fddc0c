"""A single link in closed form, as in Sec. 6: its inertia is stated about the joint's axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.robot.dynamics import Joint, Tree


@dataclass(frozen=True)
class Pendulum:
    """I q̈1 + m g l sin q1 = spring torque + disturbance; q1 = 0 hangs.

    Parameters of the plant are plain numbers with the names of the paper's Tables 1 and 2.

    Parameters
    ----------
    joint : str
        Name of the joint.
    range : (lower, upper), optional
        rad.
    """

    joint: str = "joint"
    range: tuple[float, float] | None = None

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return (self.joint,)

    @property
    def slides(self) -> tuple[bool, ...]:
        """It turns."""
        return (False,)

    @property
    def limits(self) -> tuple[tuple[float, float] | None, ...]:
        """Range of the joint, rad."""
        return (self.range,)

    def required(self) -> tuple[str, ...]:
        """Names of the parameters that the link must have."""
        return ("mass", "length", "gravity", "link_inertia")

    def packed(self, values: Any) -> dict[str, Any]:
        """The link's parameters as the plant has them, with its payload.

        Of a payload only what is in the plane of motion counts: its distance x from the axis along the link, and its
        moment zz.
        """
        own = {name: values[name] for name in self.required()}
        own["link_inertia"] *= values.get("inertia_scale", 1.0)
        if load := values.get("payload_mass", 0.0):
            arm, about = (
                values.get(f"payload_{name}", 0.0) for name in ("centre_of_mass_x", "inertia_per_mass_zz")
            )
            mass = own["mass"] + load
            own["length"] = (own["mass"] * own["length"] + load * arm) / mass
            own["link_inertia"] += load * (arm * arm + about)
            own["mass"] = mass
        return own

    def joint_array(self, column: list[float]) -> Any:
        """A plain number."""
        return column[0]

    def accelerations(self, q: Any, dq: Any, torque: Any, p: Any, armature: Any = None) -> Any:
        """q̈1 = (τ − m g l sin q1) / I."""
        assert armature is None  # a single joint is elastic
        inverse, weight = 1.0 / p.link_inertia, p.mass * p.gravity * p.length / p.link_inertia
        return inverse * torque - weight * np.sin(q)

    def torques(self, q: Any, dq: Any, ddq: Any, p: Any) -> Any:
        """I q̈1 + m g l sin q1, (1,) of any element."""
        return p.link_inertia * ddq + p.mass * p.gravity * p.length * np.sin(q)

    def gravity_torque(self, q: Any, p: Any) -> Any:
        """M g l sin q1, (1,), N·m, of any element."""
        return p.mass * p.gravity * p.length * np.sin(np.asarray(q))

    @property
    def down(self) -> tuple[float, float, float]:
        """Direction of free fall in the frame of `rigid`."""
        return (1.0, 0.0, 0.0)

    def fall(self, p: Any) -> tuple[Any, ...]:
        """Acceleration of free fall in the frame of `rigid`, m/s²."""
        return (p.gravity, 0.0, 0.0)

    def rigid(self, p: Any) -> tuple[Tree, np.ndarray, np.ndarray, np.ndarray]:
        """A rigid link that moves alike, about z with x pointing down: tree, mass, centre of mass, inertia.

        Only m l and I count. Half the lever with twice the mass keeps both, and leaves an inertia about the centre
        of mass, I − m l²/2, that is positive even for a point mass.
        """
        mass, length = float(p.mass), float(p.length)
        about = float(p.link_inertia) - 0.5 * mass * length**2
        tree = Tree((Joint(self.joint, limits=self.range),))
        six = [[about, 0.0, 0.0, about, 0.0, about]]
        return tree, np.array([2.0 * mass or 1.0]), np.array([[0.5 * length, 0.0, 0.0]]), np.array(six)
